// Environments that a caller steps with its own actions, of any task: the lanes and tasks of
// episodes.h, in groups that keep their worlds from call to call.
#pragma once

#include <string.h>

#include "common/episodes.h"

namespace ENGINE {

template <class Task>
class Environment {
 public:
  Task task;

  bool ended() const { return ended_; }
  void seed(uint64_t seed) { random_ = Generator(seed); }

  // Begins an episode; its random numbers go on where those of the one before ended.
  void start(const Stepping& all, int64_t i) {
    task.reset(random_, all.flags, all.designs + Task::kDesign * i);
    task.begin_step(nullptr);
    steps_ = -1;  // the first round leads to the first observation
    ended_ = false;
  }

  void begin_step(const Stepping& all, int64_t i) {
    if (ended_ && all.autoreset == Stepping::kNextStep) start(all, i);
    else task.begin_step(all.actions + Task::kActions * i);
  }

  void finish_step(const Stepping& all, int64_t i) {
    task.finish_step(all.flags, outcome_);
    if (task.failed()) all.failed[i] = 1;
    if (++steps_ == 0) return;
    const double* weights = all.reward_weights;
    double reward = weights ? outcome_.weigh(weights) : outcome_.reward, more = 0.0;
    if (all.reward_factors && !outcome_.fell) {
      more = reward * (all.reward_factors[i] - 1.0);
      if (weights) reward += more *= weights[Task::kTerms];
      else reward *= all.reward_factors[i];
    }
    all.rewards[i] = reward;
    for (int t = 0; t < Task::kTerms; ++t) all.terms[t * all.environments + i] = outcome_.terms[t];
    all.terms[Task::kTerms * all.environments + i] = more;
    all.terminated[i] = outcome_.terminated;
    all.truncated[i] = steps_ >= all.max_steps;
    ended_ = all.terminated[i] || all.truncated[i];
    if (ended_) write_observation(all.final_observations, i);
  }

  // All that the coming steps depend on; Task::kLaneBytes of it are in the solver.
  static size_t state_bytes() { return sizeof(Environment) + Task::kLaneBytes; }
  void save(const typename Task::Solver& solver, char* to) const {
    memcpy(to, static_cast<const void*>(this), sizeof *this);
    task.save_lane(solver, to + sizeof *this);
  }
  void restore(typename Task::Solver& solver, int lane, const char* from) {
    memcpy(static_cast<void*>(this), from, sizeof *this);
    task.restore_lane(solver, lane, from + sizeof *this);
  }

  void write_observation(float* observations, int64_t i) const {
    memcpy(observations + Task::kObservations * i, outcome_.observation,
                Task::kObservations * sizeof(float));
  }

 private:
  Outcome<Task> outcome_;
  Generator random_;
  int64_t steps_;
  bool ended_;
};

template <class Task>
struct Group {
  typename Task::Solver solver;
  Environment<Task> environments[Task::kLanes];
};

// TaskEntry::group_bytes.
template <class Task>
size_t group_bytes(int count) {
  return sizeof(Group<Task>) - (Task::kLanes - count) * sizeof(Environment<Task>);
}

// TaskEntry::step_group.
template <class Task>
void step_group(const Stepping& all, void* memory, int64_t first, int count) {
  Group<Task>& group = *static_cast<Group<Task>*>(memory);
  const auto finish = [&](int e) { group.environments[e].finish_step(all, first + e); };
  if (all.actions) {
    Round<Task> steps;
    for (int e = 0; e < count; ++e) {
      group.environments[e].begin_step(all, first + e);
      steps.add(group.environments[e].task, e);
    }
    steps.solve(group.solver, true, true, finish);
  }
  Round<Task> starts;
  for (int e = 0; e < count; ++e) {
    Environment<Task>& environment = group.environments[e];
    if (all.actions) {
      if (all.autoreset != Stepping::kSameStep || !environment.ended()) continue;
    } else {
      if (all.starts[first + e] == Stepping::kGoOn) continue;
      if (all.starts[first + e] == Stepping::kStartSeeded) environment.seed(all.seeds[first + e]);
    }
    environment.start(all, first + e);
    starts.add(environment.task, e);
  }
  starts.solve(group.solver, Task::kStartSolves, true, finish);
  for (int e = 0; e < count; ++e)
    group.environments[e].write_observation(all.observations, first + e);
}

// TaskEntry::group_poses.
template <class Task>
void group_poses(const void* memory, int count, double* poses) {
  const Group<Task>& group = *static_cast<const Group<Task>*>(memory);
  for (int e = 0; e < count; ++e)
    group.environments[e].task.poses(group.solver, poses + e * 7 * Task::kParts);
}

// TaskEntry::copy_states.
template <class Task>
void copy_states(void* memory, int count, char* states, bool restore) {
  Group<Task>& group = *static_cast<Group<Task>*>(memory);
  for (int e = 0; e < count; ++e, states += Environment<Task>::state_bytes()) {
    if (restore) group.environments[e].restore(group.solver, e, states);
    else group.environments[e].save(group.solver, states);
  }
}

// A task's entry. flags: the names of its bits, separated by spaces.
template <class Task>
constexpr TaskEntry task_entry(const char* name, const char* flags) {
  return {name,
          Task::kObservations,
          Task::kActions,
          Task::kDesign,
          Task::kTerms,
          Task::kParts,
          flags,
          [] { return sizeof(Thread<Task>); },
          run_episodes<Task>,
          Task::kLanes,
          group_bytes<Task>,
          step_group<Task>,
          group_poses<Task>,
          Environment<Task>::state_bytes,
          copy_states<Task>};
}

}  // namespace ENGINE
