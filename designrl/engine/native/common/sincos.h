// Sine and cosine of a vector of angles, with the bits of the C library's sincosf on x86-64, and
// with those of glibc there on any other machine.
//
// glibc (since 2.28) computes them in double precision: the angle less its quarter turns, two
// polynomials, and one rounding to float. Where the processor has fused multiply-adds it uses them,
// and the same operations in the same order have the same bits here: compared at every float up to
// 119. Any other library differs in the last bit of some results. So on x86-64, where Box2D calls
// it, a sample is compared once, and after a difference every angle is put to the library itself.
#pragma once

#include <math.h>
#include <string.h>

#include "common/doubles.h"
#include "common/lanes.h"

namespace ENGINE {

// glibc's sincosf_poly, with its table's coefficients: of angles within an eighth turn. D: a double,
// or a vector of them.
template <class D>
ENGINE_INLINE void polynomials(D x, D& sine, D& cosine) {
  const D zero = {}, x2 = x * x, x3 = x2 * x, x4 = x2 * x2;
  sine = fused(x2, zero + -0x1.994eb3774cf24p-13, zero + 0x1.1107605230bc4p-7);
  sine = fused(x3 * x2, sine, fused(x3, zero + -0x1.555545995a603p-3, x));
  cosine = fused(x2, zero + 0x1.99343027bf8c3p-16, zero + -0x1.6c087e89a359dp-10);
  const D start = fused(x2, zero + -0x1.ffffffd0c621cp-2, zero + 1.0);
  cosine = fused(x4 * x2, cosine, fused(x4, zero + 0x1.55553e1068f19p-5, start));
}

#if ENGINE_PORTABLE

// glibc's reduce_large: an angle >= 120 less its quarter turns, whose number comes out modulo 4.
inline double reduce_far(uint32_t bits, int& quadrant) {
  // Of 4/π, after three zeros.
  constexpr uint8_t kDigits[] = {0,    0,    0,    0xa2, 0xf9, 0x83, 0x6e, 0x4e, 0x44,
                                 0x15, 0x29, 0xfc, 0x27, 0x57, 0xd1, 0xf5, 0x34, 0xdd,
                                 0xc0, 0xdb, 0x62, 0x95, 0x99, 0x3c, 0x43, 0x90, 0x41};
  const auto word = [digits = kDigits + (bits >> 26 & 15)](int first) {
    const uint8_t* d = digits + first;
    return uint32_t(d[0]) << 24 | uint32_t(d[1]) << 16 | uint32_t(d[2]) << 8 | d[3];
  };
  const uint32_t mantissa = ((bits & 0xffffff) | 0x800000) << (bits >> 23 & 7);
  // Quarter turns modulo 4, times 2⁶².
  uint64_t turns = uint64_t(mantissa * word(0)) << 32;
  turns |= uint64_t(mantissa) * word(8) >> 32;
  turns += uint64_t(mantissa) * word(4);
  const uint64_t nearest = (turns + (uint64_t(1) << 61)) >> 62;
  quadrant = int(nearest);
  return double(int64_t(turns - (nearest << 62))) * 0x1.921FB54442D18p-62;
}

inline void sincos(float angle, float& sine, float& cosine) {
  const float size = __builtin_fabsf(angle);
  if (size < 0x1p-12f) {
    sine = angle;
    cosine = 1.0f;
    return;
  }
  double x;
  int quadrant;
  if (size < 120.0f) {
    const double wide = angle;
    // In units of 2⁻²⁴ quarter turns, to round to the nearest.
    quadrant = (int32_t(wide * 0x1.45F306DC9C883p+23) + 0x800000) >> 24;
    x = fused(-double(quadrant), 0x1.921FB54442D18p0, wide);
  } else if (size < HUGE_VALF) {
    uint32_t bits;
    memcpy(&bits, &size, sizeof bits);
    x = reduce_far(bits, quadrant);
    if (angle < 0.0f) {
      x = -x;
      quadrant = -quadrant;
    }
  } else {
    sine = cosine = angle - angle;
    return;
  }
  double s, c;
  polynomials(x, s, c);
  // Odd quarter turns swap the two, and each is negative in half of them.
  sine = float(quadrant & 1 ? c : s);
  cosine = float(quadrant & 1 ? s : c);
  if (quadrant & 2) sine = -sine;
  if ((quadrant + 1) & 2) cosine = -cosine;
}

#else

// One call has the bits of sinf and cosf (glibc shares their polynomials).
inline void sincos(float angle, float& sine, float& cosine) { sincosf(angle, &sine, &cosine); }

#endif

// Of some lanes, one by one; the others keep what they have.
inline void single_sincos(uint32_t lanes, Vector angle, Vector& sine, Vector& cosine) {
  for (; lanes; lanes &= lanes - 1) {
    const int l = __builtin_ctz(lanes);
    float s, c;
    sincos(angle[l], s, c);
    sine[l] = s;
    cosine[l] = c;
  }
}

#if ENGINE_VECTOR_BYTES == 16  // no vectors of fused multiply-adds

inline void sincos(Mask lanes, Vector angle, Vector& sine, Vector& cosine) {
  single_sincos(lane_bits(lanes), angle, sine, cosine);
}

#else

typedef int32_t Integers __attribute__((vector_size(ENGINE_VECTOR_BYTES)));
// As many as there are doubles in a vector.
typedef float HalfVector __attribute__((vector_size(ENGINE_VECTOR_BYTES / 2)));
typedef int32_t HalfIntegers __attribute__((vector_size(ENGINE_VECTOR_BYTES / 2)));

#if ENGINE_VECTOR_BYTES == 64
ENGINE_INLINE HalfVector half(Vector a, bool upper) {
  return (HalfVector)(upper ? _mm512_extractf32x8_ps((__m512)a, 1)
                            : _mm512_castps512_ps256((__m512)a));
}
ENGINE_INLINE Vector join(HalfVector lower, HalfVector upper) {
  return (Vector)_mm512_insertf32x8(_mm512_castps256_ps512((__m256)lower), (__m256)upper, 1);
}
#else
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

// glibc's reduce_fast and sincosf_poly.
ENGINE_INLINE Reduced reduced_sincos(HalfVector angle) {
  const Double wide = __builtin_convertvector(angle, Double);
  // In units of 2⁻²⁴ quarter turns, to round to the nearest.
  const HalfIntegers scaled = __builtin_convertvector(wide * 0x1.45F306DC9C883p+23, HalfIntegers);
  const HalfIntegers quadrant = (scaled + 0x800000) >> 24;
  const Double turns = __builtin_convertvector(quadrant, Double);
  const Double x = fused(-turns, splat(0x1.921FB54442D18p0), wide);
  Double sine, cosine;
  polynomials(x, sine, cosine);
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
      single_sincos(kAllLanes, angle, library_sine, library_cosine);
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
  if (!library_agrees()) return single_sincos(lane_bits(lanes), angle, sine, cosine);
  Vector s, c;
  vector_sincos(angle, s, c);
  sine = select(lanes, s, sine);
  cosine = select(lanes, c, cosine);
  const Mask far = but_not(lanes, less(maximum(angle, -angle), Vector{} + 119.0f));
  if (any(far)) single_sincos(lane_bits(far), angle, sine, cosine);
}

#endif

}  // namespace ENGINE
