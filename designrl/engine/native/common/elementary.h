// Sine, cosine and their inverses in double precision: on x86-64 the C library's, which is the one
// that PyBullet calls. Elsewhere C libraries differ in the last bit of some results, and a
// simulation turns that into another episode within a few steps. So the portable engine brings its
// own, with the bits of glibc 2.28 and later on x86-64 with fused multiply-adds.
#pragma once

#include "common/doubles.h"

namespace ENGINE {

#if ENGINE_PORTABLE

// Sine and cosine at multiples of 1/128, each the sum of two doubles.
struct SineTable {
  struct Entry {
    double sine, sine_rest, cosine, cosine_rest;
  };
  Entry entries[110] = {};

  constexpr SineTable() {
    for (int k = 0; k < 110; ++k) {
      // Taylor's series in units of 2⁻¹²⁰.
      Fixed sums[2] = {}, term = Fixed(1) << 120;
      for (int n = 0; term != 0; ++n) {
        sums[n % 2] += n % 4 < 2 ? term : -term;
        const Fixed divisor = 128 * (n + 1);
        term = (term * k + divisor / 2) / divisor;
      }
      split(sums[1], entries[k].sine, entries[k].sine_rest);
      split(sums[0], entries[k].cosine, entries[k].cosine_rest);
    }
  }

 private:
  using Fixed = __int128;
  static constexpr void split(Fixed sum, double& number, double& rest) {
    number = double(sum) * 0x1p-120;
    rest = double(sum - Fixed(double(sum))) * 0x1p-120;
  }
};
inline constexpr SineTable kSines;

// The nearest entry; x, of either sign, becomes its distance from there.
inline const SineTable::Entry& nearest_sine(double& x) {
  constexpr double kShift = 0x1.8p45;  // sums with it have steps of 1/128
  const double size = __builtin_fabs(x), at = (size + kShift) - kShift;
  x = size - at;
  return kSines.entries[int(at * 128.0)];
}

// glibc's do_cos and do_sin: of x + more, |x| < 0.86. Sine and cosine of the distance to a point of
// the table by polynomials, then the angle sum. GCC fuses products into sums there wherever it can.
inline double near_cosine(double x, double more) {
  if (x < 0.0) more = -more;
  const SineTable::Entry& e = nearest_sine(x);
  x += more;
  const double xx = x * x;
  const double s = fused(x * xx, fused(xx, 8.33333214285722277379541354343671E-03,
                                       -1.66666666666664880952546298448555E-01), x);
  const double c = xx * fused(xx, fused(xx, 1.38888874007937613028114285595617E-03,
                                        -4.16666666666664434524222570944589E-02),
                              4.99999999999999999999950396842453E-01);
  return e.cosine +
         fused(-e.sine, s, fused(-e.cosine, c, fused(-s, e.sine_rest, e.cosine_rest)));
}
inline double near_sine(double x, double more) {
  if (__builtin_fabs(x) < 0.126) {
    const double xx = x * x;
    double p = fused(-0x1.ADDFFC2FCDF59p-26, xx, 0x1.71DE27B9A7ED9p-19);
    p = fused(fused(fused(p, xx, -0x1.A01A019DB08B8p-13), xx, 0x1.1111111110ECEp-7), xx,
              -0x1.5555555555555p-3);
    return x + fused(fused(p, x, -(0.5 * more)), xx, more);
  }
  const double whole = x;
  if (x <= 0.0) more = -more;
  const SineTable::Entry& e = nearest_sine(x);
  const double xx = x * x;
  const double s = x + fused(x * xx, fused(xx, 8.33333214285722277379541354343671E-03,
                                           -1.66666666666664880952546298448555E-01), more);
  const double c = fused(x, more, xx * fused(xx, fused(xx, 1.38888874007937613028114285595617E-03,
                                                       -4.16666666666664434524222570944589E-02),
                                             4.99999999999999999999950396842453E-01));
  const double more_sine =
      fused(e.cosine, s, fused(-e.sine, c, fused(s, e.cosine_rest, e.sine_rest)));
  return __builtin_copysign(e.sine + more_sine, whole);
}

// glibc's __sin and __cos. turns: 0 for the sine, 1 for the cosine. |a| < 1e8.
inline double sine_ahead(double a, int turns) {
  constexpr double kQuarter = 0x1.921FB54442D18p0, kQuarterRest = 0x1.1A62633145C07p-54;
  const double size = __builtin_fabs(a);
  if (size < (turns ? 0x1p-27 : 0x1p-26)) return turns ? 1.0 : a;
  if (size < 0x1.B6p-1) return turns ? near_cosine(a, 0.0) : near_sine(a, 0.0);
  if (size < 0x1.368FDp1) {
    const double left = kQuarter - size;
    if (!turns) return __builtin_copysign(near_cosine(left, kQuarterRest), a);
    const double x = left + kQuarterRest;
    return near_sine(x, (left - x) + kQuarterRest);
  }
  if (!(size < 1e8)) return a - a;
  constexpr double kRound = 0x1.8p52;
  const double count = fused(a, 0x1.45F306DC9C883p-1, kRound) - kRound;
  // Less quarter turns, in four parts.
  constexpr double kThird = -0x1.CB3B398p-55, kFourth = -0x1.D747F23E32ED7p-83;
  const double y = fused(-count, -0x1.DDE973Cp-27, fused(-count, 0x1.921FB58p0, a));
  const double z = fused(-count, kThird, y), x = fused(-count, kFourth, z);
  const double rest = fused(-count, kThird, y - z) + fused(-count, kFourth, z - x);
  turns = (turns + int(count)) & 3;
  const double result = turns & 1 ? near_cosine(x, rest) : near_sine(x, rest);
  return turns & 2 ? -result : result;
}

inline double sine(double a) { return sine_ahead(a, 0); }
inline double cosine(double a) { return sine_ahead(a, 1); }
inline void sincos(double a, double& sine_of, double& cosine_of) {
  sine_of = sine(a);
  cosine_of = cosine(a);
}

// The inverses are correctly rounded, but for one result in some ten thousand. glibc's are in 998
// of 1,000, too: their tables are long, and in the ant all results end in single precision, where
// next to nothing is left of a difference.

// Sine and cosine of an angle of at most π, to 1e-20.
struct PreciseSines {
  double sine, sine_rest, cosine, cosine_rest;

  explicit PreciseSines(double a) {
    constexpr double kQuarter = 0x1.921FB54442D18p0, kQuarterRest = 0x1.1A62633145C07p-54;
    const double size = __builtin_fabs(a);
    const int turns = size > 3 * kQuarter / 2 ? 2 : size > kQuarter / 2 ? 1 : 0;
    double x = size - turns * kQuarter, rest = -turns * kQuarterRest;
    const bool below = x < 0.0;
    if (below) rest = -rest;
    const SineTable::Entry& e = nearest_sine(x);
    const double xx = x * x, s = rest - x * xx * (1.0 / 6.0 - xx * (1.0 / 120.0 - xx / 5040.0));
    const double c = -xx * (0.5 - xx * (1.0 / 24.0 - xx / 720.0)) - x * rest;
    // Of x + s, whose sine is that and whose cosine is 1 + c, beside the table's angle.
    add(e.sine, e.cosine * x, fused(e.cosine, x, -(e.cosine * x)) + e.sine_rest +
                                  (e.sine * c + (e.cosine * s + e.cosine_rest * x)),
        sine, sine_rest);
    add(e.cosine, -(e.sine * x), e.cosine_rest - fused(e.sine, x, -(e.sine * x)) +
                                     (e.cosine * c - (e.sine * s + e.sine_rest * x)),
        cosine, cosine_rest);
    if (below) negate(sine, sine_rest);
    for (int i = 0; i < turns; ++i) {
      const double was = sine, was_rest = sine_rest;
      sine = cosine;
      sine_rest = cosine_rest;
      cosine = -was;
      cosine_rest = -was_rest;
    }
    if (a < 0.0) negate(sine, sine_rest);
  }

 private:
  static void add(double a, double b, double small, double& sum, double& rest) {
    sum = a + b;
    const double b_seen = sum - a;
    rest = ((a - (sum - b_seen)) + (b - b_seen)) + small;
  }
  static void negate(double& number, double& rest) {
    number = -number;
    rest = -rest;
  }
};

// The library's, and a step of Newton's.
inline double arc_sine(double s) {
  const double a = asin(s);
  const PreciseSines at(a);
  return a + ((s - at.sine) - at.sine_rest) / at.cosine;
}
inline double arc_tangent(double y, double x) {
  const double a = atan2(y, x), length = __builtin_sqrt(x * x + y * y);
  if (y == 0.0 || !(length > 1e-100 && length < 1e100)) return a;
  const PreciseSines at(a);
  const double up = y * at.cosine, down = x * at.sine;
  const double rest = fused(y, at.cosine, -up) - fused(x, at.sine, -down);
  return a + ((up - down) + (rest + (y * at.cosine_rest - x * at.sine_rest))) / length;
}

#else

ENGINE_INLINE double sine(double a) { return sin(a); }
ENGINE_INLINE double cosine(double a) { return cos(a); }
ENGINE_INLINE void sincos(double a, double& sine, double& cosine) { ::sincos(a, &sine, &cosine); }
ENGINE_INLINE double arc_sine(double s) { return asin(s); }
ENGINE_INLINE double arc_tangent(double y, double x) { return atan2(y, x); }

#endif

}  // namespace ENGINE
