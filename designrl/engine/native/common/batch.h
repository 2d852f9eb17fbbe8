// What a rollout of many episodes is asked for and where its results go, and what a task says of
// itself. Shared by the code of all instruction sets; the batch, field by field, by
// designrl/engine/__init__.py, too.
#pragma once

#include <stddef.h>
#include <stdint.h>

struct Batch {
  const int32_t* sizes;          // (layers + 1,) of the network: inputs, each layer's outputs
  const float* weights;          // (candidates, weight_count), see policy.h
  const double* noise_stds;      // (candidates, actions) on the last layer's sums, or null: none
  double time_scale;             // steps; the last input is t / time_scale; 0: there is none such
  const double* designs;         // (candidates, the task's design) scales
  const double* reward_factors;  // (candidates,)
  const double* reward_weights;  // (the task's terms + 1,), see episodes.h, or null: none
  const uint64_t* seeds;         // (candidates, rollouts)
  int64_t candidates, rollouts, weight_count;
  int32_t layers, output_tanh;
  uint32_t flags;        // of the task: bit i is the i-th of its names
  int32_t shaped;        // the rewards of the published training code, see episodes.h
  int64_t max_steps;     // time limit
  double* returns;       // (candidates, rollouts)
  int64_t* steps;        // (candidates, rollouts); -1: a capacity of the engine was exceeded
  float* observations;   // (candidates, rollouts, max_steps + 1, the task's observations), or null
  int64_t next_episode;  // counters shared by all threads
  int64_t finished;
  int64_t stop;          // set to 1 by the caller: return after the current step
};

// A step, or a reset, of environments whose actions the caller has; field by field in
// designrl/engine/stepper.py, too. Rows are environments, if not said otherwise.
struct Stepping {
  enum Autoreset : int32_t { kDisabled, kNextStep, kSameStep };  // Gymnasium's modes
  enum Start : uint8_t { kGoOn, kStart, kStartSeeded };

  int64_t environments;
  uint32_t flags;                // of the task
  int32_t autoreset;
  int64_t max_steps;             // time limit
  const double* designs;         // (environments, the task's design) scales
  const double* reward_factors;  // (environments,), or null: none
  const double* reward_weights;  // (the task's terms + 1,), or null: none
  const double* actions;         // (environments, the task's actions); null: this is a reset
  const uint8_t* starts;         // (environments,) Start: of which, and from a seed or going on
  const uint64_t* seeds;         // (environments,)
  float* observations;           // (environments, the task's observations)
  float* final_observations;     // the same: of episodes that end, where reset follows at once
  double* rewards;               // (environments,), zeros; those below likewise
  uint8_t *terminated, *truncated;
  double* terms;    // (the task's terms + 1, environments) of the rewards; last, the factors' part
  uint8_t* failed;  // a capacity of the engine was exceeded
};

// A task compiled for one instruction set.
struct TaskEntry {
  const char* name;
  int32_t observations, actions, design, terms, parts;
  const char* flags;  // names, separated by spaces
  size_t (*thread_bytes)();
  // Runs episodes until none is left. memory: thread_bytes() zero bytes, aligned to 64. share: of
  // the batch's episodes, what one thread would get if they were dealt out evenly; it holds no more
  // at once.
  void (*run_episodes)(Batch&, void* memory, int64_t share);
  // Steps or resets a group of environments: `count` from `first` on, `held` at most. memory: their
  // own, group_bytes(count) zero bytes at first, aligned to 64.
  int32_t held;
  size_t (*group_bytes)(int count);
  void (*step_group)(const Stepping&, void* memory, int64_t first, int count);
  // Where the bodies of a group are: (count, parts, 7).
  void (*group_poses)(const void* memory, int count, double* poses);
  // Copies what a group's environments go on from: (count, state_bytes()), the same for every
  // instruction set and place in a group. restore: into the group, else out of it.
  size_t (*state_bytes)();
  void (*copy_states)(void* memory, int count, char* states, bool restore);
};
