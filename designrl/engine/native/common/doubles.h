// Vectors of lanes in double precision; lanes.h has those in single precision and says more.
#pragma once

#include <math.h>
#include <stdint.h>

#include "common/isa.h"

#if !ENGINE_PORTABLE
#include <immintrin.h>
#endif

// Kernels pass vectors by the dozen: a call that is not inlined would send them through memory.
#define ENGINE_INLINE inline __attribute__((always_inline))

namespace ENGINE {

typedef double Double __attribute__((vector_size(ENGINE_VECTOR_BYTES)));  // d[l] is a lane

constexpr int kDoubles = ENGINE_VECTOR_BYTES / 8;  // lanes in a vector

#if ENGINE_PORTABLE
typedef int64_t DoubleMask __attribute__((vector_size(ENGINE_VECTOR_BYTES)));
ENGINE_INLINE double fused(double a, double b, double c) { return __builtin_fma(a, b, c); }
ENGINE_INLINE Double splat(double a) { return Double{a, a}; }
ENGINE_INLINE Double square_root(Double a) {
  return Double{__builtin_sqrt(a[0]), __builtin_sqrt(a[1])};
}
ENGINE_INLINE DoubleMask less(Double a, Double b) { return (DoubleMask)(a < b); }
ENGINE_INLINE DoubleMask at_most(Double a, Double b) { return (DoubleMask)(a <= b); }
ENGINE_INLINE DoubleMask both(DoubleMask a, DoubleMask b) { return a & b; }
ENGINE_INLINE DoubleMask either(DoubleMask a, DoubleMask b) { return a | b; }
ENGINE_INLINE DoubleMask but_not(DoubleMask a, DoubleMask b) { return a & ~b; }
ENGINE_INLINE bool any(DoubleMask m) { return (m[0] | m[1]) != 0; }
ENGINE_INLINE Double select(DoubleMask m, Double a, Double b) {
  return (Double)(((DoubleMask)a & m) | ((DoubleMask)b & ~m));
}
#elif ENGINE_VECTOR_BYTES == 64
typedef __mmask8 DoubleMask;
// a b + c, rounded once.
ENGINE_INLINE Double fused(Double a, Double b, Double c) {
  return (Double)_mm512_fmadd_pd((__m512d)a, (__m512d)b, (__m512d)c);
}
ENGINE_INLINE Double splat(double a) { return (Double)_mm512_set1_pd(a); }
ENGINE_INLINE Double square_root(Double a) { return (Double)_mm512_sqrt_pd((__m512d)a); }
ENGINE_INLINE DoubleMask less(Double a, Double b) {
  return _mm512_cmp_pd_mask((__m512d)a, (__m512d)b, _CMP_LT_OQ);
}
ENGINE_INLINE DoubleMask at_most(Double a, Double b) {
  return _mm512_cmp_pd_mask((__m512d)a, (__m512d)b, _CMP_LE_OQ);
}
ENGINE_INLINE DoubleMask both(DoubleMask a, DoubleMask b) { return DoubleMask(a & b); }
ENGINE_INLINE DoubleMask either(DoubleMask a, DoubleMask b) { return DoubleMask(a | b); }
ENGINE_INLINE DoubleMask but_not(DoubleMask a, DoubleMask b) { return DoubleMask(a & ~b); }
ENGINE_INLINE bool any(DoubleMask m) { return m != 0; }
ENGINE_INLINE Double select(DoubleMask m, Double a, Double b) {
  return (Double)_mm512_mask_blend_pd(m, (__m512d)b, (__m512d)a);
}
#elif ENGINE_VECTOR_BYTES == 32
typedef __m256d DoubleMask;
ENGINE_INLINE Double fused(Double a, Double b, Double c) { return _mm256_fmadd_pd(a, b, c); }
ENGINE_INLINE Double splat(double a) { return _mm256_set1_pd(a); }
ENGINE_INLINE Double square_root(Double a) { return _mm256_sqrt_pd(a); }
ENGINE_INLINE DoubleMask less(Double a, Double b) { return _mm256_cmp_pd(a, b, _CMP_LT_OQ); }
ENGINE_INLINE DoubleMask at_most(Double a, Double b) { return _mm256_cmp_pd(a, b, _CMP_LE_OQ); }
ENGINE_INLINE DoubleMask both(DoubleMask a, DoubleMask b) { return _mm256_and_pd(a, b); }
ENGINE_INLINE DoubleMask either(DoubleMask a, DoubleMask b) { return _mm256_or_pd(a, b); }
ENGINE_INLINE DoubleMask but_not(DoubleMask a, DoubleMask b) { return _mm256_andnot_pd(b, a); }
ENGINE_INLINE bool any(DoubleMask m) { return _mm256_movemask_pd(m) != 0; }
ENGINE_INLINE Double select(DoubleMask m, Double a, Double b) {
  return _mm256_blendv_pd(b, a, m);
}
#else
typedef __m128d DoubleMask;
ENGINE_INLINE Double splat(double a) { return _mm_set1_pd(a); }
ENGINE_INLINE Double square_root(Double a) { return _mm_sqrt_pd(a); }
ENGINE_INLINE DoubleMask less(Double a, Double b) { return _mm_cmplt_pd(a, b); }
ENGINE_INLINE DoubleMask at_most(Double a, Double b) { return _mm_cmple_pd(a, b); }
ENGINE_INLINE DoubleMask both(DoubleMask a, DoubleMask b) { return _mm_and_pd(a, b); }
ENGINE_INLINE DoubleMask either(DoubleMask a, DoubleMask b) { return _mm_or_pd(a, b); }
ENGINE_INLINE DoubleMask but_not(DoubleMask a, DoubleMask b) { return _mm_andnot_pd(b, a); }
ENGINE_INLINE bool any(DoubleMask m) { return _mm_movemask_pd(m) != 0; }
ENGINE_INLINE Double select(DoubleMask m, Double a, Double b) {
  return _mm_or_pd(_mm_and_pd(m, a), _mm_andnot_pd(m, b));
}
#endif

}  // namespace ENGINE
