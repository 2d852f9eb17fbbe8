// The library's interface, plain C for ctypes: picks the instruction set and runs the threads.
// Compiled for the baseline, so that it runs on any x86-64.
#include <cstdlib>
#include <cstring>
#include <functional>
#include <system_error>
#include <thread>
#include <vector>

#include "common/batch.h"
#include "common/policy.h"

#define DECLARE_ENGINE(name)                     \
  namespace name {                               \
  size_t thread_bytes();                          \
  void run_episodes(Batch&, void*, int64_t);     \
  }
DECLARE_ENGINE(engine_sse2)
DECLARE_ENGINE(engine_avx2)
DECLARE_ENGINE(engine_avx512)

namespace {

struct Variant {
  const char* name;
  size_t (*thread_bytes)();
  void (*run_episodes)(Batch&, void*, int64_t);
  bool (*supported)();
};

const Variant kVariants[] = {  // the best first
    {"avx512", engine_avx512::thread_bytes, engine_avx512::run_episodes,
     [] { return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
                 __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw"); }},
    {"avx2", engine_avx2::thread_bytes, engine_avx2::run_episodes,
     [] { return bool(__builtin_cpu_supports("avx2")); }},
    {"sse2", engine_sse2::thread_bytes, engine_sse2::run_episodes, [] { return true; }},
};

const Variant* find(const char* name) {
  for (const Variant& variant : kVariants)
    if (variant.supported() && (!name || !*name || !std::strcmp(name, variant.name)))
      return &variant;
  return nullptr;
}

void work(const Variant& variant, Batch& batch, int64_t share) {
  const size_t bytes = (variant.thread_bytes() + 63) / 64 * 64;
  void* memory = std::aligned_alloc(64, bytes);
  if (!memory) return;  // its episodes are left to the other threads
  std::memset(memory, 0, bytes);
  variant.run_episodes(batch, memory, share);
  std::free(memory);
}

}  // namespace

extern "C" {

// Size of Batch, so that a caller compiled or written against another layout notices.
int64_t designrl_engine_batch_bytes() { return sizeof(Batch); }

// The instruction set that a name stands for ("" or null: the best one), or null if this processor
// does not have it.
const char* designrl_engine_isa(const char* name) {
  const Variant* variant = find(name);
  return variant ? variant->name : nullptr;
}

// One action of a policy of any sizes up to designrl_policy_widest(), for episodes in PyBullet.
int32_t designrl_policy_widest() { return ENGINE::kWidest; }
void designrl_policy_act(const float* weights, const int32_t* sizes, int32_t layers,
                         int32_t output_tanh, const float* input, const float* noise,
                         float* action) {
  ENGINE::act(weights, sizes, layers, output_tanh, input, noise, action);
}

// Runs all episodes of a batch. Returns 0, or 1 if the instruction set is not supported, or 2 if
// there was no memory.
int designrl_engine_run(Batch* batch, const char* isa, int threads) {
  const Variant* variant = find(isa);
  if (!variant) return 1;
  const int64_t episodes = batch->candidates * batch->rollouts;
  batch->next_episode = batch->finished = 0;
  const int64_t share = (episodes + threads - 1) / threads;
  std::vector<std::thread> others;
  for (int i = 1; i < threads; ++i) {
    try {
      others.emplace_back(work, std::cref(*variant), std::ref(*batch), share);
    } catch (const std::system_error&) {
      break;  // no more threads to be had: fewer do the same work
    }
  }
  work(*variant, *batch, share);
  for (std::thread& thread : others) thread.join();
  return batch->finished == episodes || batch->stop ? 0 : 2;
}
}
