// Episodes side by side, of any task: a thread holds some of them, begins a step of each, solves
// their physics in vector lanes, and finishes the step. Where one ends, the batch's next begins.
//
// A Task is one episode's body and world:
//
//   kObservations, kActions, kDesign     how many numbers each of them is
//   kLanes                               episodes that are solved at once
//   kPutOff                              tasks whose physics take longer are put off until there
//                                        are so many; 0: none is
//   kHeld                                episodes that a thread holds
//   kTerms                               of the environment's rewards
//   kParts                               of the body
//   kStartSolves                         whether the round after reset is a step of physics
//   kSolvedReturn, kSolvedBonus          points, of the shaped rewards
//   Networks                             its own policies, FixedNetworks
//   Solver                               lanes of physics; solve(n) solves the first n of them.
//                                        Where some are put off: solved(lane), put_off(lane, i) as
//                                        the i-th of them, and solve_rest(n) for the first n
//   reset(random, flags, design)         starts an episode; flags: bits of Batch::flags
//   begin_step(action)                   up to what the lanes solve. The round after reset has no
//                                        action, it is null: it leads to the first observation
//   order()                              uint32_t: episodes whose order is alike share the lanes
//   load(solver, lane)                   into a lane, and after solve() back
//   store(solver, lane)
//   store_solved(solver, lane)           where some are put off: what these have after the others,
//                                        the i-th in lane kLanes + i
//   finish_step(flags, outcome)          the rest of the step: observation, reward and its terms
//   poses(solver, to)                    (kParts, 7) of the parts' frames, those of
//                                        designrl/bodies: position in m, quaternion x, y, z, w
//   failed()                             a capacity was exceeded, the episode is void
//   kLaneBytes, save_lane(solver, to),   what of the task is in the solver between two steps, and
//   restore_lane(solver, lane, from)     copies of it; `lane` is the one that it takes from then on
//
// It begins as zero bytes, no constructor is called.
//
// Shaped rewards, of the published training code: a fall costs nothing, and an episode that ends
// without one above kSolvedReturn earns kSolvedBonus more.
//
// Reward factors multiply every reward but that of a fall; what they add is a term of its own, after
// the task's. With weights the reward is another sum: that of the terms, each times its weight, in
// their order.
#pragma once

#include "common/batch.h"
#include "common/policy.h"
#include "common/random.h"

namespace ENGINE {

// Of a step.
template <class Task>
struct Outcome {
  float observation[Task::kObservations + 1];  // and room for the time, if the policy sees it
  double reward;  // of the environment; with a fall, what that costs
  double terms[Task::kTerms];  // its parts, in the order of the environment
  bool terminated, fell;

  // Weights the terms; their sum.
  double weigh(const double* weights) {
    double sum = 0.0;
    for (int t = 0; t < Task::kTerms; ++t) sum += terms[t] *= weights[t];
    return sum;
  }
};

// Tasks that have begun a step: solves them side by side, in their order. Those that are put off
// stay until a later call.
template <class Task>
class Round {
 public:
  // index: the caller's name for it, below kHeld.
  void add(Task& task, int index) {
    // The order, above the index.
    const uint64_t key = uint64_t(task.order()) << 32 | unsigned(index);
    tasks_[index] = &task;
    int at = count_++;
    for (; at > 0 && keys_[at - 1] > key; --at) keys_[at] = keys_[at - 1];
    keys_[at] = key;
  }
  bool empty() const { return count_ == 0 && put_off_count_ == 0; }
  bool full() const { return count_ == Task::kLanes; }

  // physics: false where all of them start and have none to solve. all: none stays put off.
  // finish(index): the rest of a task's step.
  template <class Finish>
  void solve(typename Task::Solver& solver, bool physics, bool all, Finish finish) {
    for (int l = 0; l < count_; ++l) tasks_[index(l)]->load(solver, l);
    if (physics && count_ > 0) solver.solve(count_);
    for (int l = 0; l < count_; ++l) {
      Task& task = *tasks_[index(l)];
      task.store(solver, l);
      if constexpr (Task::kPutOff > 0) {
        if (!solver.solved(l)) {
          solver.put_off(l, put_off_count_);
          put_off_[put_off_count_++] = index(l);
          if (put_off_count_ == Task::kPutOff) solve_rest(solver, finish);
          continue;
        }
        task.store_solved(solver, l);
      }
      finish(index(l));
    }
    count_ = 0;
    if (all && put_off_count_ > 0) solve_rest(solver, finish);
  }

 private:
  Task* tasks_[Task::kHeld];
  uint64_t keys_[Task::kLanes];
  int put_off_[Task::kPutOff + 1];  // indices
  int count_ = 0, put_off_count_ = 0;

  int index(int lane) const { return int(uint32_t(keys_[lane])); }

  template <class Finish>
  void solve_rest(typename Task::Solver& solver, Finish finish) {
    if constexpr (Task::kPutOff > 0) {
      solver.solve_rest(put_off_count_);
      for (int i = 0; i < put_off_count_; ++i) {
        tasks_[put_off_[i]]->store_solved(solver, Task::kLanes + i);
        finish(put_off_[i]);
      }
      put_off_count_ = 0;
    }
  }
};

// An episode under way, and its place in the batch.
template <class Task>
class Episode {
 public:
  bool active = false;  // an episode is under way
  bool begun = false;   // and a step of it
  Task task;

  const Outcome<Task>& outcome() const { return outcome_; }
  double total() const { return total_; }  // of the rewards so far
  int64_t steps() const { return steps_; }

  // Takes the next episode; false if there is none left.
  bool start(Batch& batch) {
    episode_ = __atomic_fetch_add(&batch.next_episode, 1, __ATOMIC_RELAXED);
    active = episode_ < batch.candidates * batch.rollouts;
    if (!active) return false;
    candidate_ = episode_ / batch.rollouts;
    // A stream of its own, apart from the task's (designrl/policy.py, Agent.reset).
    if (batch.noise_stds) noise_ = Generator(SeedSequence(batch.seeds[episode_], 1));
    Generator random(batch.seeds[episode_]);
    task.reset(random, batch.flags, batch.designs + Task::kDesign * candidate_);
    total_ = 0.0;
    steps_ = -1;  // the first round leads to the first observation
    return true;
  }

  // own_network: where the batch's policy is one of the task's own; null: it is not.
  void begin_step(const Batch& batch, Act own_network) {
    float action[Task::kActions], noise[Task::kActions];
    if (steps_ >= 0) {
      const float* weights = batch.weights + batch.weight_count * candidate_;
      float* input = outcome_.observation;
      if (batch.time_scale) input[Task::kObservations] = float(double(steps_) / batch.time_scale);
      if (batch.noise_stds) {
        const double* stds = batch.noise_stds + Task::kActions * candidate_;
        for (int i = 0; i < Task::kActions; ++i)
          noise[i] = float(noise_.standard_normal() * stds[i]);
      }
      const float* added = batch.noise_stds ? noise : nullptr;
      if (own_network) own_network(weights, input, added, action);
      else act(weights, batch.sizes, batch.layers, batch.output_tanh, input, added, action);
    }
    double exact[Task::kActions];
    for (int i = 0; i < Task::kActions; ++i) exact[i] = action[i];
    task.begin_step(steps_ >= 0 ? exact : nullptr);
    begun = true;
  }

  void finish_step(Batch& batch) {
    task.finish_step(batch.flags, outcome_);
    begun = false;
    ++steps_;
    if (batch.observations) {
      float* to = batch.observations +
                  (episode_ * (batch.max_steps + 1) + steps_) * int64_t(Task::kObservations);
      for (int i = 0; i < Task::kObservations; ++i) to[i] = outcome_.observation[i];
    }
    if (steps_ > 0) {
      const double factor = batch.reward_factors[candidate_];
      double reward = outcome_.reward;
      if (const double* weights = batch.reward_weights) {
        reward = outcome_.weigh(weights);
        if (!outcome_.fell) reward += reward * (factor - 1.0) * weights[Task::kTerms];
      } else if (!outcome_.fell) {
        reward *= factor;
      }
      if (batch.shaped && outcome_.fell) reward = 0.0;
      total_ += reward;
    }
    const bool failed = task.failed();
    if (!failed && (steps_ < 1 || (!outcome_.terminated && steps_ < batch.max_steps))) return;
    if (batch.shaped && !outcome_.fell && total_ > Task::kSolvedReturn)
      total_ += Task::kSolvedBonus;
    batch.returns[episode_] = total_;
    batch.steps[episode_] = failed ? -1 : steps_;
    active = false;
    __atomic_fetch_add(&batch.finished, 1, __ATOMIC_RELAXED);
  }

 private:
  Outcome<Task> outcome_;
  Generator noise_;
  int64_t episode_, candidate_, steps_;
  double total_;
};

// What a thread has.
template <class Task>
struct Thread {
  typename Task::Solver solver;
  Episode<Task> episodes[Task::kHeld];
};

// TaskEntry::run_episodes.
template <class Task>
void run_episodes(Batch& batch, void* memory, int64_t share) {
  Thread<Task>& thread = *static_cast<Thread<Task>*>(memory);
  const Act own_network = Task::Networks::find(batch.sizes, batch.layers, batch.output_tanh);
  const int held = share < Task::kHeld ? int(share) : Task::kHeld;
  bool left = true;
  Round<Task> round;
  int e = 0;  // in turn
  for (;;) {
    for (int n = 0; n < held && !round.full(); ++n, e = e + 1 < held ? e + 1 : 0) {
      Episode<Task>& episode = thread.episodes[e];
      if (!episode.active && left) left = episode.start(batch);
      if (!episode.active || episode.begun) continue;
      episode.begin_step(batch, own_network);
      round.add(episode.task, e);
    }
    if (round.empty() || __atomic_load_n(&batch.stop, __ATOMIC_RELAXED)) return;
    // With lanes to spare, nothing is gained by putting tasks off.
    round.solve(thread.solver, true, !round.full(),
                [&](int done) { thread.episodes[done].finish_step(batch); });
  }
}

}  // namespace ENGINE
