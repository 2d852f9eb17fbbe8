// Vectors of lanes: arithmetic comes with the compiler's vector types. For SSE2, AVX2 and AVX-512,
// comparisons, selection and minimum are spelled out, because compilers do not find the single
// instructions for them. All operations act on each lane alone and round as scalar code does.
#pragma once

#include <stdint.h>

#include "common/isa.h"

#if !ENGINE_PORTABLE
#include <immintrin.h>
#endif

namespace ENGINE {

typedef float Vector __attribute__((vector_size(ENGINE_VECTOR_BYTES)));

constexpr int kWidth = ENGINE_VECTOR_BYTES / 4;  // lanes in a vector
constexpr int kChunks = 4;                       // independent vectors that hide latencies
constexpr int kLanes = kWidth * kChunks;

// minimum(a, b) is a < b ? a : b, as for single numbers below, also where both are equal.
#if ENGINE_PORTABLE
typedef int32_t Mask __attribute__((vector_size(ENGINE_VECTOR_BYTES)));  // of all bits, or none
inline Mask less(Vector a, Vector b) { return (Mask)(a < b); }
inline Mask at_least(Vector a, Vector b) { return (Mask)(a >= b); }
inline Mask both(Mask a, Mask b) { return a & b; }
inline Mask either(Mask a, Mask b) { return a | b; }
inline Mask but_not(Mask a, Mask b) { return a & ~b; }
inline uint32_t lane_bits(Mask m) {
  m = m & Mask{1, 2, 4, 8};
  return uint32_t(m[0] | m[1] | m[2] | m[3]);
}
inline Vector select(Mask m, Vector a, Vector b) {
  return (Vector)(((Mask)a & m) | ((Mask)b & ~m));
}
inline Vector minimum(Vector a, Vector b) { return select(less(a, b), a, b); }
inline Vector maximum(Vector a, Vector b) { return select(less(b, a), a, b); }
inline Vector square_root(Vector a) {
  return Vector{__builtin_sqrtf(a[0]), __builtin_sqrtf(a[1]), __builtin_sqrtf(a[2]),
                __builtin_sqrtf(a[3])};
}
#elif ENGINE_VECTOR_BYTES == 64
typedef __mmask16 Mask;
inline Vector minimum(Vector a, Vector b) { return (Vector)_mm512_min_ps((__m512)a, (__m512)b); }
inline Vector maximum(Vector a, Vector b) { return (Vector)_mm512_max_ps((__m512)a, (__m512)b); }
inline Vector square_root(Vector a) { return (Vector)_mm512_sqrt_ps((__m512)a); }
inline Mask less(Vector a, Vector b) {
  return _mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_LT_OQ);
}
inline Mask at_least(Vector a, Vector b) {
  return _mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_GE_OQ);
}
inline Mask both(Mask a, Mask b) { return Mask(a & b); }
inline Mask either(Mask a, Mask b) { return Mask(a | b); }
inline Mask but_not(Mask a, Mask b) { return Mask(a & ~b); }
inline uint32_t lane_bits(Mask m) { return m; }
inline Vector select(Mask m, Vector a, Vector b) {
  return (Vector)_mm512_mask_blend_ps(m, (__m512)b, (__m512)a);
}
#elif ENGINE_VECTOR_BYTES == 32
typedef __m256 Mask;
inline Vector minimum(Vector a, Vector b) { return _mm256_min_ps(a, b); }
inline Vector maximum(Vector a, Vector b) { return _mm256_max_ps(a, b); }
inline Vector square_root(Vector a) { return _mm256_sqrt_ps(a); }
inline Mask less(Vector a, Vector b) { return _mm256_cmp_ps(a, b, _CMP_LT_OQ); }
inline Mask at_least(Vector a, Vector b) { return _mm256_cmp_ps(a, b, _CMP_GE_OQ); }
inline Mask both(Mask a, Mask b) { return _mm256_and_ps(a, b); }
inline Mask either(Mask a, Mask b) { return _mm256_or_ps(a, b); }
inline Mask but_not(Mask a, Mask b) { return _mm256_andnot_ps(b, a); }
inline uint32_t lane_bits(Mask m) { return uint32_t(_mm256_movemask_ps(m)); }
inline Vector select(Mask m, Vector a, Vector b) { return _mm256_blendv_ps(b, a, m); }
#else
typedef __m128 Mask;
inline Vector minimum(Vector a, Vector b) { return _mm_min_ps(a, b); }
inline Vector maximum(Vector a, Vector b) { return _mm_max_ps(a, b); }
inline Vector square_root(Vector a) { return _mm_sqrt_ps(a); }
inline Mask less(Vector a, Vector b) { return _mm_cmplt_ps(a, b); }
inline Mask at_least(Vector a, Vector b) { return _mm_cmpge_ps(a, b); }
inline Mask both(Mask a, Mask b) { return _mm_and_ps(a, b); }
inline Mask either(Mask a, Mask b) { return _mm_or_ps(a, b); }
inline Mask but_not(Mask a, Mask b) { return _mm_andnot_ps(b, a); }
inline uint32_t lane_bits(Mask m) { return uint32_t(_mm_movemask_ps(m)); }
inline Vector select(Mask m, Vector a, Vector b) {
  return _mm_or_ps(_mm_and_ps(m, a), _mm_andnot_ps(m, b));
}
#endif
constexpr uint32_t kAllLanes = (1u << kWidth) - 1;
inline bool any(Mask m) { return lane_bits(m) != 0; }
inline Vector clamp(Vector a, Vector low, Vector high) { return maximum(low, minimum(a, high)); }
inline Mask first_lanes(int count) {
  Vector lane;
  for (int l = 0; l < kWidth; ++l) lane[l] = float(l);
  return less(lane, Vector{} + float(count));
}

// Four numbers, with any instruction set.
typedef float Four __attribute__((vector_size(16)));
#if ENGINE_VECTOR_BYTES > 16
inline Four minimum(Four a, Four b) { return _mm_min_ps(a, b); }
inline Four maximum(Four a, Four b) { return _mm_max_ps(a, b); }
#endif
// Those at four places of a, followed by b.
template <int i, int j, int k, int l>
inline Four shuffle(Four a, Four b) {
#ifdef __clang__
  return __builtin_shufflevector(a, b, i, j, k, l);
#else
  typedef int32_t Places __attribute__((vector_size(16)));
  return __builtin_shuffle(a, b, Places{i, j, k, l});
#endif
}

// The same for a single number, so that a kernel can be written once for both.
inline float minimum(float a, float b) { return a < b ? a : b; }
inline float maximum(float a, float b) { return a > b ? a : b; }
inline float clamp(float a, float low, float high) { return maximum(low, minimum(a, high)); }
inline bool less(float a, float b) { return a < b; }
inline bool at_least(float a, float b) { return a >= b; }
inline bool both(bool a, bool b) { return a & b; }
inline bool either(bool a, bool b) { return a | b; }
inline bool but_not(bool a, bool b) { return a & !b; }
inline bool any(bool m) { return m; }
inline float square_root(float a) { return __builtin_sqrtf(a); }
inline float select(bool m, float a, float b) { return m ? a : b; }

// One number for each lane.
union alignas(ENGINE_VECTOR_BYTES) Row {
  float lane[kLanes];
  Vector chunk[kChunks];
};

// One truth for each lane.
class MaskRow {
 public:
#if ENGINE_VECTOR_BYTES == 64
  Mask chunk(int c) const { return bits_[c]; }
  bool operator[](int lane) const { return bits_[lane / kWidth] >> lane % kWidth & 1; }
  void set(int lane, bool value) {
    const Mask bit = Mask(1 << lane % kWidth);
    Mask& bits = bits_[lane / kWidth];
    bits = value ? bits | bit : bits & ~bit;
  }

 private:
  Mask bits_[kChunks];
#else
  Mask chunk(int c) const { return (Mask)chunks_[c]; }
  bool operator[](int lane) const { return lanes_[lane] != 0; }
  void set(int lane, bool value) { lanes_[lane] = value ? -1 : 0; }

 private:
  union {
    int32_t lanes_[kLanes];
    Vector chunks_[kChunks];
  };
#endif
};

}  // namespace ENGINE
