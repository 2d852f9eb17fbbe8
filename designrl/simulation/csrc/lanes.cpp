// Episodes side by side: one walker in each vector lane, the next episode as soon as one has ended.
// Compiled once for each instruction set.
#include "batch.h"
#include "policy.h"
#include "walker.h"

namespace ENGINE {
namespace {

constexpr double kSolvedReturn = 300.0, kSolvedBonus = 100.0;  // points, training only

class Lane {
 public:
  bool active = false;

  // Takes the next episode; false if there is none left.
  bool start(Batch& batch) {
    episode_ = __atomic_fetch_add(&batch.next_episode, 1, __ATOMIC_RELAXED);
    active = episode_ < batch.candidates * batch.rollouts;
    if (!active) return false;
    candidate_ = episode_ / batch.rollouts;
    walker_.reset(batch.seeds[episode_], batch.hardcore, batch.scales + 8 * candidate_);
    total_ = 0.0;
    steps_ = -1;  // reset takes a step of its own, with zero action
    fell_ = false;
    return true;
  }

  void begin_step(const Batch& batch, VelocitySolver& solver, int lane) {
    double action[kActions] = {};
    if (steps_ >= 0) {
      float out[kActions];
      act(batch.weights + batch.weight_count * candidate_, result_.observation, out);
      for (int i = 0; i < kActions; ++i) action[i] = out[i];
    }
    walker_.command(action);
    walker_.begin_step(solver, lane);
  }

  void finish_step(Batch& batch, const VelocitySolver& solver, int lane) {
    walker_.finish_step(solver, lane, batch.closest_hits, result_);
    ++steps_;
    if (batch.observations) {
      float* to = batch.observations +
                  (episode_ * (batch.max_steps + 1) + steps_) * int64_t(kObservations);
      for (int i = 0; i < kObservations; ++i) to[i] = result_.observation[i];
    }
    if (steps_ > 0) {
      double reward = result_.reward;
      if (!result_.fell) reward *= batch.reward_factors[candidate_];
      if (batch.training && result_.fell) reward = 0.0;
      total_ += reward;
    }
    const bool failed = walker_.world.overflow;
    if (!failed && (steps_ < 1 || (!result_.terminated && steps_ < batch.max_steps))) return;
    if (batch.training && !result_.fell && total_ > kSolvedReturn) total_ += kSolvedBonus;
    batch.returns[episode_] = total_;
    batch.steps[episode_] = failed ? -1 : steps_;
    active = false;
    __atomic_fetch_add(&batch.finished, 1, __ATOMIC_RELAXED);
  }

 private:
  Walker walker_;
  StepResult result_;
  int64_t episode_, candidate_, steps_;
  double total_;
  bool fell_;
};

struct Group {
  VelocitySolver solver;
  Lane lanes[kLanes];
};

}  // namespace

size_t group_bytes() { return sizeof(Group); }

// Runs episodes until none is left. memory: group_bytes() zero bytes, aligned to 64.
void run_episodes(Batch& batch, void* memory) {
  Group& group = *static_cast<Group*>(memory);
  bool left = true;
  for (;;) {
    bool busy = false;
    for (int l = 0; l < kLanes; ++l) {
      Lane& lane = group.lanes[l];
      if (!lane.active && left) left = lane.start(batch);
      if (!lane.active) {
        for (int b = 0; b < kBodies; ++b) group.solver.contact_count[b][l] = 0;
        continue;
      }
      lane.begin_step(batch, group.solver, l);
      busy = true;
    }
    if (!busy || __atomic_load_n(&batch.stop, __ATOMIC_RELAXED)) return;
    group.solver.solve(kVelocityIterations);
    for (int l = 0; l < kLanes; ++l)
      if (group.lanes[l].active) group.lanes[l].finish_step(batch, group.solver, l);
  }
}

}  // namespace ENGINE
