// The walker's episodes; compiled once for each instruction set.
#include "walker/walker.h"

namespace ENGINE::walker {

// Constant, so that nothing is run for an instruction set that the processor may lack.
extern constexpr TaskEntry kTask = task_entry<Walker>("walker", kFlagNames);

}  // namespace ENGINE::walker
