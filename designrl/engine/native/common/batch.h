// What a rollout of many episodes is asked for and where its results go, and what a task says of
// itself. Shared by the code of all instruction sets; the batch, field by field, by
// designrl/engine/__init__.py, too.
#pragma once

#include <cstddef>
#include <cstdint>

struct Batch {
  const int32_t* sizes;          // (layers + 1,) of the network: inputs, each layer's outputs
  const float* weights;          // (candidates, weight_count), see policy.h
  const double* noise_stds;      // (candidates, actions) on the last layer's sums, or null: none
  double time_scale;             // steps; the last input is t / time_scale; 0: there is none such
  const double* designs;         // (candidates, the task's design) scales
  const double* reward_factors;  // (candidates,)
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

// A task compiled for one instruction set.
struct TaskEntry {
  const char* name;
  int32_t observations, actions, design;
  const char* flags;  // names, separated by spaces
  size_t (*thread_bytes)();
  // Runs episodes until none is left. memory: thread_bytes() zero bytes, aligned to 64. share: of
  // the batch's episodes, what one thread would get if they were dealt out evenly; it holds no more
  // at once.
  void (*run_episodes)(Batch&, void* memory, int64_t share);
};
