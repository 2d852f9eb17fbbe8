// The ant's episodes; compiled once for each instruction set.
#include "ant/ant.h"

namespace ENGINE::ant {

// Constant, so that nothing is run for an instruction set that the processor may lack.
extern constexpr TaskEntry kTask = task_entry<Ant>("ant", kFlagNames);

}  // namespace ENGINE::ant
