// The name of the instruction set that is compiled for.
//
// Each task's source file is compiled for SSE2, AVX2, AVX-512 and, with the compilers' vector types
// alone, for any 64-bit processor ("portable": GCC and clang; ARM, WebAssembly), and all are linked
// into one library. Everything in these headers lives in a namespace named after the instruction
// set, so that the linker can never put an AVX-512 copy of a function into the baseline's code
// path. For the same reason nothing here uses containers or algorithms of the standard library.
//
//   common/    what every task uses
//     lanes, doubles, sincos
//                vectors of numbers, one lane for each of several bodies
//     elementary sine, cosine and their inverses of single doubles
//     random, ziggurat
//                NumPy's random numbers
//     policy     the tanh network
//     batch      what a caller asks for: many episodes, or steps; and what a task tells of itself
//     episodes   one episode after the other in every lane, of any task
//     stepping   steps of environments whose actions the caller has
//   walker/    the walker's task; walker.h lists its files
//   ant/       the ant's task; ant.h lists its files
//   page.cpp   what the browser page calls: walkers that their policies step, one by one
//   api.cpp    what ctypes calls: picks the task and the instruction set, runs the threads (crew.h)
//
// A task has a namespace of its own in that of the instruction set.
#pragma once

#if defined(ENGINE_PORTABLE) || !defined(__x86_64__)
#undef ENGINE_PORTABLE
#define ENGINE_PORTABLE 1
#define ENGINE engine_portable
#define ENGINE_VECTOR_BYTES 16
#elif defined(__AVX512F__)
#define ENGINE engine_avx512
#define ENGINE_VECTOR_BYTES 64
#elif defined(__AVX2__)
#define ENGINE engine_avx2
#define ENGINE_VECTOR_BYTES 32
#else
#define ENGINE engine_sse2
#define ENGINE_VECTOR_BYTES 16
#endif
