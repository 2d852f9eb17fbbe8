// Sine and cosine of a vector of angles, with the bits of the C library's sincosf.
//
// glibc (since 2.28) computes them in double precision: the angle less its quarter turns, two
// polynomials, and one rounding to float. Where the processor has fused multiply-adds it uses them,
// and the same operations in the same order have the same bits here: compared at every float up to
// 119. Any other library differs in the last bit of some results. So a sample is compared once, and
// after a difference every angle is put to the library itself.
#pragma once

#include <cmath>
#include <cstring>

#include "common/doubles.h"
#include "common/lanes.h"

namespace ENGINE {

// Of some lanes, from the library; the others keep what they have.
inline void library_sincos(uint32_t lanes, Vector angle, Vector& sine, Vector& cosine) {
  for (; lanes; lanes &= lanes - 1) {
    const int l = __builtin_ctz(lanes);
    float s, c;
    sincosf(angle[l], &s, &c);
    sine[l] = s;
    cosine[l] = c;
  }
}

#if ENGINE_VECTOR_BYTES == 16  // no fused multiply-adds

inline void sincos(Mask lanes, Vector angle, Vector& sine, Vector& cosine) {
  library_sincos(lane_bits(lanes), angle, sine, cosine);
}

#else

typedef int32_t Integers __attribute__((vector_size(ENGINE_VECTOR_BYTES)));
// As many as there are doubles in a vector.
typedef float HalfVector __attribute__((vector_size(ENGINE_VECTOR_BYTES / 2)));
typedef int32_t HalfIntegers __attribute__((vector_size(ENGINE_VECTOR_BYTES / 2)));

#if ENGINE_VECTOR_BYTES == 64
// a b + c, rounded once.
ENGINE_INLINE Double fused(Double a, Double b, Double c) {
  return (Double)_mm512_fmadd_pd((__m512d)a, (__m512d)b, (__m512d)c);
}
ENGINE_INLINE HalfVector half(Vector a, bool upper) {
  return (HalfVector)(upper ? _mm512_extractf32x8_ps((__m512)a, 1)
                            : _mm512_castps512_ps256((__m512)a));
}
ENGINE_INLINE Vector join(HalfVector lower, HalfVector upper) {
  return (Vector)_mm512_insertf32x8(_mm512_castps256_ps512((__m256)lower), (__m256)upper, 1);
}
#else
ENGINE_INLINE Double fused(Double a, Double b, Double c) { return _mm256_fmadd_pd(a, b, c); }
ENGINE_INLINE HalfVector half(Vector a, bool upper) {
  return upper ? _mm256_extractf128_ps(a, 1) : _mm256_castps256_ps128(a);
}
ENGINE_INLINE Vector join(HalfVector lower, HalfVector upper) {
  return _mm256_set_m128(upper, lower);
}
#endif

// What is left of an angle within a quarter turn: the sine and cosine of that, and which quarter.
struct Reduced {
  HalfVector sine, cosine, quadrant;  // the last holds the bits of integers
};

// glibc's reduce_fast and sincosf_poly, with its table's coefficients.
ENGINE_INLINE Reduced reduced_sincos(HalfVector angle) {
  const Double wide = __builtin_convertvector(angle, Double);
  // In units of 2⁻²⁴ quarter turns, to round to the nearest.
  const HalfIntegers scaled = __builtin_convertvector(wide * 0x1.45F306DC9C883p+23, HalfIntegers);
  const HalfIntegers quadrant = (scaled + 0x800000) >> 24;
  const Double turns = __builtin_convertvector(quadrant, Double);
  const Double x = fused(-turns, splat(0x1.921FB54442D18p0), wide);
  const Double x2 = x * x, x3 = x2 * x, x4 = x2 * x2;
  Double sine = fused(x2, splat(-0x1.994eb3774cf24p-13), splat(0x1.1107605230bc4p-7));
  sine = fused(x3 * x2, sine, fused(x3, splat(-0x1.555545995a603p-3), x));
  Double cosine = fused(x2, splat(0x1.99343027bf8c3p-16), splat(-0x1.6c087e89a359dp-10));
  const Double start = fused(x2, splat(-0x1.ffffffd0c621cp-2), splat(1.0));
  cosine = fused(x4 * x2, cosine, fused(x4, splat(0x1.55553e1068f19p-5), start));
  return {__builtin_convertvector(sine, HalfVector), __builtin_convertvector(cosine, HalfVector),
          (HalfVector)quadrant};
}

// Of all lanes.
ENGINE_INLINE void vector_sincos(Vector angle, Vector& sine, Vector& cosine) {
  const Reduced lower = reduced_sincos(half(angle, false));
  const Reduced upper = reduced_sincos(half(angle, true));
  const Vector tiny = Vector{} + 0x1p-12f, s = join(lower.sine, upper.sine);
  const Integers quadrant = (Integers)join(lower.quadrant, upper.quadrant);
  const Integers a = (Integers)select(less(maximum(angle, -angle), tiny), angle, s);
  const Integers b = (Integers)join(lower.cosine, upper.cosine);
  // Odd quarter turns swap the two, and each is negative in half of them.
  const Integers swapped = (a ^ b) & -(quadrant & 1);
  sine = (Vector)(a ^ swapped ^ (quadrant & 2) << 30);
  cosine = (Vector)(b ^ swapped ^ ((quadrant + 1) & 2) << 30);
}

// Up to 119, all angles at which glibc without fused multiply-adds has another last bit.
constexpr float kTellingAngles[] = {
    0x1.1475b6p+4, 0x1.1475b8p+4, 0x1.1475bap+4, 0x1.1475bcp+4, 0x1.78edb2p+4, 0x1.05d696p+5,
    0x1.ab6152p+5, 0x1.d0f4aap+5, 0x1.019c5p+6,  0x1.0e1c8p+6,  0x1.46b80ep+6, 0x1.46ba88p+6,
    0x1.52e6cp+6,  0x1.8abf54p+6, 0x1.9eb0a8p+6, 0x1.b1a47cp+6, 0x1.d0f4aap+6};

// Those, then angles from 3e-5 to 119 on both sides of zero, as many for each power of two, for
// libraries with other polynomials.
inline float sample_angle(int i) {
  constexpr int kTelling = sizeof kTellingAngles / sizeof *kTellingAngles;
  if (i < kTelling) return kTellingAngles[i];
  const uint32_t bits = 0x38000000u + 11191u * unsigned(i - kTelling);
  float angle;
  memcpy(&angle, &bits, sizeof angle);
  return i & 1 ? -angle : angle;
}

// Whether the library's results have the bits of these vectors; asked once.
inline bool library_agrees() {
  static const bool agrees = [] {
    constexpr int kSample = 1 << 14;  // a millisecond
    for (int i = 0; i < kSample; i += kWidth) {
      Vector angle, sine, cosine, library_sine = {}, library_cosine = {};
      for (int l = 0; l < kWidth; ++l) angle[l] = sample_angle(i + l);
      vector_sincos(angle, sine, cosine);
      library_sincos(kAllLanes, angle, library_sine, library_cosine);
      if (memcmp(&sine, &library_sine, sizeof sine) ||
          memcmp(&cosine, &library_cosine, sizeof cosine))
        return false;
    }
    return true;
  }();
  return agrees;
}

// Of some lanes; the others keep what they have.
inline void sincos(Mask lanes, Vector angle, Vector& sine, Vector& cosine) {
  if (!library_agrees()) return library_sincos(lane_bits(lanes), angle, sine, cosine);
  Vector s, c;
  vector_sincos(angle, s, c);
  sine = select(lanes, s, sine);
  cosine = select(lanes, c, cosine);
  const Mask far = but_not(lanes, less(maximum(angle, -angle), Vector{} + 119.0f));
  if (any(far)) library_sincos(lane_bits(far), angle, sine, cosine);
}

#endif

}  // namespace ENGINE
