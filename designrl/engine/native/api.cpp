// The library's interface, plain C for ctypes: picks the task and the instruction set and runs the
// threads. Compiled for the baseline, so that it runs on any x86-64.
#include <cstdlib>
#include <cstring>
#include <functional>
#include <system_error>
#include <thread>
#include <vector>

#include "common/batch.h"
#include "common/policy.h"

namespace engine_sse2 {
namespace walker { extern const TaskEntry kTask; }
namespace ant { extern const TaskEntry kTask; }
}
namespace engine_avx2 {
namespace walker { extern const TaskEntry kTask; }
namespace ant { extern const TaskEntry kTask; }
}
namespace engine_avx512 {
namespace walker { extern const TaskEntry kTask; }
namespace ant { extern const TaskEntry kTask; }
}

namespace {

struct Variant {
  const char* name;
  bool (*supported)();
  const TaskEntry* tasks[2];
};

const Variant kVariants[] = {  // the best first
    {"avx512",
     [] { return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
                 __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw"); },
     {&engine_avx512::walker::kTask, &engine_avx512::ant::kTask}},
    {"avx2",
     [] { return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"); },
     {&engine_avx2::walker::kTask, &engine_avx2::ant::kTask}},
    {"sse2", [] { return true; }, {&engine_sse2::walker::kTask, &engine_sse2::ant::kTask}},
};

const Variant* find_variant(const char* name) {
  for (const Variant& variant : kVariants)
    if (variant.supported() && (!name || !*name || !std::strcmp(name, variant.name)))
      return &variant;
  return nullptr;
}

const TaskEntry* find_task(const Variant* variant, const char* name) {
  if (variant)
    for (const TaskEntry* task : variant->tasks)
      if (!std::strcmp(name, task->name)) return task;
  return nullptr;
}

void work(const TaskEntry& task, Batch& batch, int64_t share) {
  const size_t bytes = (task.thread_bytes() + 63) / 64 * 64;
  void* memory = std::aligned_alloc(64, bytes);
  if (!memory) return;  // its episodes are left to the other threads
  std::memset(memory, 0, bytes);
  task.run_episodes(batch, memory, share);
  std::free(memory);
}

}  // namespace

extern "C" {

// Size of Batch, so that a caller written against another layout notices.
int64_t designrl_engine_batch_bytes() { return sizeof(Batch); }

// The instruction set that a name stands for ("" or null: the best one), or null if this processor
// does not have it.
const char* designrl_engine_isa(const char* name) {
  const Variant* variant = find_variant(name);
  return variant ? variant->name : nullptr;
}

// What a task says of itself: the names of its flags, and how many observations, actions and
// dimensions it has. Null if there is none of that name.
const char* designrl_engine_describe(const char* name, int32_t counts[3]) {
  const TaskEntry* task = find_task(find_variant(nullptr), name);
  if (!task) return nullptr;
  counts[0] = task->observations;
  counts[1] = task->actions;
  counts[2] = task->design;
  return task->flags;
}

// One action of a policy of any sizes up to designrl_policy_widest(), for episodes elsewhere.
int32_t designrl_policy_widest() { return ENGINE::kWidest; }
void designrl_policy_act(const float* weights, const int32_t* sizes, int32_t layers,
                         int32_t output_tanh, const float* input, const float* noise,
                         float* action) {
  ENGINE::act(weights, sizes, layers, output_tanh, input, noise, action);
}

// Runs all episodes of a batch. Returns 0, or 1 if there is no such task or the instruction set is
// not supported, or 2 if there was no memory.
int designrl_engine_run(Batch* batch, const char* name, const char* isa, int threads) {
  const TaskEntry* task = find_task(find_variant(isa), name);
  if (!task) return 1;
  const int64_t episodes = batch->candidates * batch->rollouts;
  batch->next_episode = batch->finished = 0;
  const int64_t share = (episodes + threads - 1) / threads;
  std::vector<std::thread> others;
  for (int i = 1; i < threads; ++i) {
    try {
      others.emplace_back(work, std::cref(*task), std::ref(*batch), share);
    } catch (const std::system_error&) {
      break;  // no more threads to be had: fewer do the same work
    }
  }
  work(*task, *batch, share);
  for (std::thread& thread : others) thread.join();
  return batch->finished == episodes || batch->stop ? 0 : 2;
}
}
