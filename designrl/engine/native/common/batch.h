// What a rollout of many episodes is asked for and where its results go; shared by the code of all
// instruction sets and, field by field, by designrl/engine/__init__.py.
#pragma once

#include <cstdint>

struct Batch {
  const float* weights;          // (candidates, weight_count)
  const double* scales;          // (candidates, 8) design
  const double* reward_factors;  // (candidates,)
  const uint64_t* seeds;         // (candidates, rollouts)
  int64_t candidates, rollouts, weight_count;
  int32_t hardcore, closest_hits, training;
  int32_t max_steps;     // time limit
  double* returns;       // (candidates, rollouts)
  int64_t* steps;        // (candidates, rollouts); -1: a capacity of the engine was exceeded
  float* observations;   // (candidates, rollouts, max_steps + 1, 24), or null
  int64_t next_episode;  // counters shared by all threads
  int64_t finished;
  int64_t stop;          // set to 1 by the caller: return after the current step
};
