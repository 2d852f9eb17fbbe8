// Vectors, rotations and sweeps in the plane (b2Math.h). float32, each operation rounded once, in
// Box2D's order: the sums below must not be rearranged.
#pragma once

#include <math.h>

#include "common/sincos.h"
#include "walker/box2d/settings.h"

namespace ENGINE::walker {

using ENGINE::maximum, ENGINE::minimum;  // of numbers, beside those of vectors below

inline float absolute(float a) { return a > 0.0f ? a : -a; }

struct Vec2 {
  float x, y;
};

inline Vec2 operator+(Vec2 a, Vec2 b) { return {a.x + b.x, a.y + b.y}; }
inline Vec2 operator-(Vec2 a, Vec2 b) { return {a.x - b.x, a.y - b.y}; }
inline Vec2 operator-(Vec2 a) { return {-a.x, -a.y}; }
inline Vec2 operator*(float s, Vec2 a) { return {s * a.x, s * a.y}; }
inline float dot(Vec2 a, Vec2 b) { return a.x * b.x + a.y * b.y; }
inline float cross(Vec2 a, Vec2 b) { return a.x * b.y - a.y * b.x; }
inline Vec2 cross(float s, Vec2 a) { return {-s * a.y, s * a.x}; }
// a × 1: the vector turned by -90°.
inline Vec2 right_normal(Vec2 a) { return {a.y, -a.x}; }
inline float length(Vec2 a) { return sqrtf(a.x * a.x + a.y * a.y); }
inline Vec2 minimum(Vec2 a, Vec2 b) { return {minimum(a.x, b.x), minimum(a.y, b.y)}; }
inline Vec2 maximum(Vec2 a, Vec2 b) { return {maximum(a.x, b.x), maximum(a.y, b.y)}; }

// Scales to unit length and returns the length; a shorter vector than epsilon stays as it is.
inline float normalize(Vec2& a) {
  float size = length(a);
  if (size < kEpsilon) return 0.0f;
  float inverse = 1.0f / size;
  a.x *= inverse;
  a.y *= inverse;
  return size;
}

struct Rot {
  float s, c;
};

inline Rot rotation(float angle) {
  Rot q;
  sincos(angle, q.s, q.c);
  return q;
}
inline Vec2 mul(Rot q, Vec2 v) { return {q.c * v.x - q.s * v.y, q.s * v.x + q.c * v.y}; }
inline Vec2 mul_t(Rot q, Vec2 v) { return {q.c * v.x + q.s * v.y, -q.s * v.x + q.c * v.y}; }

struct Transform {
  Vec2 p;
  Rot q;
};

inline Vec2 mul(const Transform& t, Vec2 v) {
  return {(t.q.c * v.x - t.q.s * v.y) + t.p.x, (t.q.s * v.x + t.q.c * v.y) + t.p.y};
}
inline Vec2 mul_t(const Transform& t, Vec2 v) {
  float px = v.x - t.p.x, py = v.y - t.p.y;
  return {t.q.c * px + t.q.s * py, -t.q.s * px + t.q.c * py};
}

// Motion of a body's centre of mass over a step (b2Sweep): from (c0, a0) at alpha0 to (c, a) at 1.
struct Sweep {
  Vec2 local_center;
  Vec2 c0, c;
  float a0, a;
  float alpha0;

  Transform at(float beta) const {
    Transform xf;
    xf.p = (1.0f - beta) * c0 + beta * c;
    xf.q = rotation((1.0f - beta) * a0 + beta * a);
    xf.p = xf.p - mul(xf.q, local_center);
    return xf;
  }

  void advance(float alpha) {
    float beta = (alpha - alpha0) / (1.0f - alpha0);
    c0 = (1.0f - beta) * c0 + beta * c;
    a0 = (1.0f - beta) * a0 + beta * a;
    alpha0 = alpha;
  }

  void normalize() {
    float two_pi = 2.0f * kPi;
    float turns = two_pi * floorf(a0 / two_pi);
    a0 -= turns;
    a -= turns;
  }
};

struct Aabb {
  Vec2 lower, upper;
};

// The same in one vector, for the tree.
inline Four to_vector(const Aabb& a) {
  Four v;
  __builtin_memcpy(&v, &a, sizeof v);
  return v;
}
inline Aabb to_box(Four v) {
  Aabb a;
  __builtin_memcpy(&a, &v, sizeof a);
  return a;
}
inline Four combine(Four a, Four b) {
  const Four low = minimum(a, b), high = maximum(a, b);
  return shuffle<0, 1, 6, 7>(low, high);
}
inline float perimeter(Four a) {
  const Four size = shuffle<2, 3, 2, 3>(a, a) - a;
  return 2.0f * (size[0] + size[1]);
}

// Without short circuits: one branch that is hard to predict instead of four.
inline bool contains(const Aabb& a, const Aabb& b) {
  return (a.lower.x <= b.lower.x) & (a.lower.y <= b.lower.y) & (b.upper.x <= a.upper.x) &
         (b.upper.y <= a.upper.y);
}
inline bool overlap(const Aabb& a, const Aabb& b) {
  return !((b.lower.x - a.upper.x > 0.0f) | (b.lower.y - a.upper.y > 0.0f) |
           (a.lower.x - b.upper.x > 0.0f) | (a.lower.y - b.upper.y > 0.0f));
}

}  // namespace ENGINE::walker
