// Episodes of a task in the portable engine, on any machine: what tests/test_portable.py compiles
// for others than this one. Reads a batch from standard input, as that file writes it, and prints
// each episode's return in hexadecimal and its steps.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/batch.h"

namespace engine_portable {
namespace walker { extern const TaskEntry kTask; }
namespace ant { extern const TaskEntry kTask; }
}  // namespace engine_portable

// Numbers that the process keeps to its end: without the C++ library, which not every target has.
template <class T>
T* read(size_t count) {
  T* values = static_cast<T*>(malloc(count * sizeof(T)));
  if (!values || fread(values, sizeof(T), count, stdin) != count) exit(2);
  return values;
}

int main(int, char** arguments) {
  const bool ant = strcmp(arguments[1], "ant") == 0;
  const TaskEntry& task = ant ? engine_portable::ant::kTask : engine_portable::walker::kTask;
  const int64_t* header = read<int64_t>(8);
  const int64_t candidates = header[0], rollouts = header[1], episodes = candidates * rollouts;

  Batch batch = {};
  batch.candidates = candidates;
  batch.rollouts = rollouts;
  batch.weight_count = header[2];
  batch.layers = int32_t(header[3]);
  batch.output_tanh = int32_t(header[4]);
  batch.flags = uint32_t(header[5]);
  batch.max_steps = header[6];
  batch.time_scale = *read<double>(1);
  batch.sizes = read<int32_t>(batch.layers + 1);
  batch.weights = read<float>(candidates * batch.weight_count);
  if (header[7]) batch.noise_stds = read<double>(candidates * task.actions);
  batch.designs = read<double>(candidates * task.design);
  batch.reward_factors = read<double>(candidates);
  batch.seeds = read<uint64_t>(episodes);
  batch.returns = static_cast<double*>(malloc(episodes * sizeof(double)));
  batch.steps = static_cast<int64_t*>(malloc(episodes * sizeof(int64_t)));

  const size_t bytes = (task.thread_bytes() + 63) / 64 * 64;
  void* memory = aligned_alloc(64, bytes);
  if (!memory || !batch.returns || !batch.steps) return 3;
  memset(memory, 0, bytes);
  task.run_episodes(batch, memory, episodes);
  for (int64_t i = 0; i < episodes; ++i)
    printf("%a %lld\n", batch.returns[i], static_cast<long long>(batch.steps[i]));
}
