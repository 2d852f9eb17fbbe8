// The library's interface, plain C for ctypes: picks the task and the instruction set and runs the
// threads. Compiled for the baseline, so that on x86-64 it runs on any.
#include <sys/mman.h>

#include <atomic>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <memory>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include "common/batch.h"
#include "common/policy.h"
#include "crew.h"

namespace engine_portable {
namespace walker { extern const TaskEntry kTask; }
namespace ant { extern const TaskEntry kTask; }
}
#ifdef ENGINE_ALL_KINDS
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
#endif

namespace {

struct Variant {
  const char* name;
  bool (*supported)();
  const TaskEntry* tasks[2];
};

const Variant kVariants[] = {  // the best first
#ifdef ENGINE_ALL_KINDS
    {"avx512",
     [] { return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
                 __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw"); },
     {&engine_avx512::walker::kTask, &engine_avx512::ant::kTask}},
    {"avx2",
     [] { return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"); },
     {&engine_avx2::walker::kTask, &engine_avx2::ant::kTask}},
    {"sse2", [] { return true; }, {&engine_sse2::walker::kTask, &engine_sse2::ant::kTask}},
#endif
    {"portable", [] { return true; },
     {&engine_portable::walker::kTask, &engine_portable::ant::kTask}},
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

constexpr size_t kHugePage = 2 << 20;  // bytes

// Zero bytes, aligned to 64; null if there is no memory. Much of it comes in huge pages: a world is
// walked all over, and the processor's list of small pages does not hold many worlds.
void* allocate(size_t bytes) {
  const size_t alignment = bytes < kHugePage ? 64 : kHugePage;
  bytes = (bytes + alignment - 1) / alignment * alignment;
  void* memory = std::aligned_alloc(alignment, bytes);
  if (!memory) return nullptr;
#ifdef MADV_HUGEPAGE
  if (alignment == kHugePage) madvise(memory, bytes, MADV_HUGEPAGE);  // refused: nothing is lost
#endif
  return std::memset(memory, 0, bytes);
}

void work(const TaskEntry& task, Batch& batch, int64_t share) {
  void* memory = allocate(task.thread_bytes());
  if (!memory) return;  // its episodes are left to the other threads
  task.run_episodes(batch, memory, share);
  std::free(memory);
}

// Environments in groups, each of which one thread steps at a time.
class Stepper {
 public:
  Stepper(const TaskEntry& task, int64_t environments, int threads) : task_(task), crew_(threads) {
    // As few as hold them all, the same number for each thread.
    int64_t groups = (environments + task.held - 1) / task.held;
    groups = (groups + threads - 1) / threads * threads;
    if (groups > environments) groups = environments;
    for (int64_t g = 0; g < groups; ++g) {
      const int64_t first = g * environments / groups;
      const int count = int((g + 1) * environments / groups - first);
      groups_.push_back({first, count, {allocate(task.group_bytes(count)), std::free}});
    }
  }
  bool complete() const {
    for (const Group& group : groups_)
      if (!group.memory) return false;
    return true;
  }
  void run(const Stepping& stepping) {
    std::atomic<size_t> next{0};
    crew_.run([&] {
      for (size_t g; (g = next++) < groups_.size();)
        task_.step_group(stepping, groups_[g].memory.get(), groups_[g].first, groups_[g].count);
    });
  }
  int64_t state_bytes() const { return task_.state_bytes(); }
  void copy_states(char* states, bool restore) {
    for (const Group& group : groups_)
      task_.copy_states(group.memory.get(), group.count, states + group.first * state_bytes(),
                        restore);
  }

  void write_poses(double* poses) const {
    for (const Group& group : groups_)
      task_.group_poses(group.memory.get(), group.count, poses + group.first * 7 * task_.parts);
  }

 private:
  struct Group {
    int64_t first;
    int count;
    std::unique_ptr<void, void (*)(void*)> memory;
  };
  const TaskEntry& task_;
  std::vector<Group> groups_;
  Crew crew_;
};

}  // namespace

extern "C" {

// Size of Batch, so that a caller written against another layout notices.
// Of the sources that it was compiled from (designrl/provenance.py).
const char* designrl_engine_sources() { return ENGINE_SOURCES; }

int64_t designrl_engine_batch_bytes() { return sizeof(Batch); }

// The instruction set that a name stands for ("" or null: the best one), or null if this processor
// does not have it.
const char* designrl_engine_isa(const char* name) {
  const Variant* variant = find_variant(name);
  return variant ? variant->name : nullptr;
}

// What a task says of itself: the names of its flags, and how many observations, actions,
// dimensions it has, terms of its reward and parts of its body. Null if there is none of that name.
const char* designrl_engine_describe(const char* name, int32_t counts[5]) {
  const TaskEntry* task = find_task(find_variant(nullptr), name);
  if (!task) return nullptr;
  counts[0] = task->observations;
  counts[1] = task->actions;
  counts[2] = task->design;
  counts[3] = task->terms;
  counts[4] = task->parts;
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

// Environments that the caller steps. `owner` is the one place that holds them, null before and
// after: an interrupt between two calls finds them there, or finds nothing. One call at a time.
int64_t designrl_stepping_bytes() { return sizeof(Stepping); }
// The task and the instruction set must be there; the owner stays null if there is no memory.
void designrl_stepper_make(void** owner, const char* name, const char* isa, int64_t environments,
                           int threads) {
  const TaskEntry* task = find_task(find_variant(isa), name);
  try {
    auto stepper = std::make_unique<Stepper>(*task, environments, threads);
    if (stepper->complete()) *owner = stepper.release();
  } catch (const std::bad_alloc&) {
  }
}
// False: they are gone.
bool designrl_stepper_run(void** owner, const Stepping* stepping) {
  if (*owner) static_cast<Stepper*>(*owner)->run(*stepping);
  return *owner;
}
// Bytes of one environment's state, 0 if they are gone; and copies (environments, bytes) out of
// them, or into them, if there are any.
int64_t designrl_stepper_states(void** owner, char* states, bool restore) {
  if (!*owner) return 0;
  Stepper& stepper = *static_cast<Stepper*>(*owner);
  if (states) stepper.copy_states(states, restore);
  return stepper.state_bytes();
}
void designrl_stepper_free(void** owner) {
  delete static_cast<Stepper*>(std::exchange(*owner, nullptr));
}
// poses: (environments, parts, 7), see Task in common/episodes.h. False: they are gone.
bool designrl_stepper_poses(void* const* owner, double* poses) {
  if (*owner) static_cast<const Stepper*>(*owner)->write_poses(poses);
  return *owner;
}
}
