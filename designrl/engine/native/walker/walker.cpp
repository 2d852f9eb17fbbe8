// Episodes side by side: many walkers, of which each step's velocities are solved in vector lanes.
// Compiled once for each instruction set.
#include "common/batch.h"
#include "common/policy.h"
#include "walker/walker.h"

namespace ENGINE {
namespace {

// Walkers of a thread. Enough to fill vectors with walkers in like contact with the ground.
constexpr int kEpisodes = 2 * kLanes;
constexpr double kSolvedReturn = 300.0, kSolvedBonus = 100.0;  // points, training only

class Episode {
 public:
  bool active = false;  // an episode is under way

  // Takes the next episode; false if there is none left.
  bool start(Batch& batch) {
    episode_ = __atomic_fetch_add(&batch.next_episode, 1, __ATOMIC_RELAXED);
    active = episode_ < batch.candidates * batch.rollouts;
    if (!active) return false;
    candidate_ = episode_ / batch.rollouts;
    walker_.reset(batch.seeds[episode_], batch.hardcore, batch.scales + 8 * candidate_);
    total_ = 0.0;
    steps_ = -1;  // reset takes a step of its own, with zero action
    return true;
  }

  void begin_step(const Batch& batch) {
    double action[kActions] = {};
    if (steps_ >= 0) {
      float out[kActions];
      act(batch.weights + batch.weight_count * candidate_, result_.observation, out);
      for (int i = 0; i < kActions; ++i) action[i] = out[i];
    }
    walker_.command(action);
    walker_.begin_step();
  }

  void finish_step(Batch& batch) {
    walker_.finish_step(batch.closest_hits, result_);
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

  Walker& walker() { return walker_; }

 private:
  Walker walker_;
  StepResult result_;
  int64_t episode_, candidate_, steps_;
  double total_;
};

struct Thread {
  VelocitySolver solver;
  Episode episodes[kEpisodes];
};

}  // namespace

size_t thread_bytes() { return sizeof(Thread); }

// Runs episodes until none is left. memory: thread_bytes() zero bytes, aligned to 64. share: of the
// batch's episodes, what one thread would get if they were dealt out evenly; it holds no more at
// once.
void run_episodes(Batch& batch, void* memory, int64_t share) {
  Thread& thread = *static_cast<Thread*>(memory);
  const int held = share < kEpisodes ? int(share) : kEpisodes;
  bool left = true;
  for (;;) {
    // Sorted by their contacts; the pattern is above the episode's index in a key.
    uint64_t keys[kEpisodes];
    int count = 0;
    for (int e = 0; e < held; ++e) {
      Episode& episode = thread.episodes[e];
      if (!episode.active && left) left = episode.start(batch);
      if (!episode.active) continue;
      episode.begin_step(batch);
      const uint64_t key = uint64_t(episode.walker().contact_pattern()) << 32 | unsigned(e);
      int at = count++;
      for (; at > 0 && keys[at - 1] > key; --at) keys[at] = keys[at - 1];
      keys[at] = key;
    }
    if (count == 0 || __atomic_load_n(&batch.stop, __ATOMIC_RELAXED)) return;
    for (int first = 0; first < count; first += kLanes) {
      const int lanes = count - first < kLanes ? count - first : kLanes;
      for (int l = 0; l < lanes; ++l)
        thread.episodes[uint32_t(keys[first + l])].walker().load(thread.solver, l);
      thread.solver.solve(kVelocityIterations, lanes);
      for (int l = 0; l < lanes; ++l) {
        Episode& episode = thread.episodes[uint32_t(keys[first + l])];
        episode.walker().store(thread.solver, l);
        episode.finish_step(batch);
      }
    }
  }
}

}  // namespace ENGINE
