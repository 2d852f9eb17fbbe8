// Vectors, matrices and quaternions (Bullet's LinearMath), of single numbers and of lanes.
//
// The order of each sum is Bullet's. Where a factor is known to be zero, its product is left out:
// adding it would change nothing but the sign of a zero, and no bit that designrl.verify compares
// depends on one.
#pragma once

#include "ant/bullet/settings.h"
#include "common/doubles.h"

namespace ENGINE::ant {

template <class F>
struct Vec3 {
  F x, y, z;
};
typedef Vec3<Double> Vector;

template <class F>
ENGINE_INLINE Vec3<F> operator+(const Vec3<F>& a, const Vec3<F>& b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class F>
ENGINE_INLINE Vec3<F> operator-(const Vec3<F>& a, const Vec3<F>& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class F>
ENGINE_INLINE Vec3<F> operator-(const Vec3<F>& a) {
  return {-a.x, -a.y, -a.z};
}
template <class F>
ENGINE_INLINE Vec3<F> operator*(const Vec3<F>& a, F s) {
  return {a.x * s, a.y * s, a.z * s};
}
template <class F>
ENGINE_INLINE F dot(const Vec3<F>& a, const Vec3<F>& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
ENGINE_INLINE Vector cross(const Vector& a, const Vector& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
// Element by element.
ENGINE_INLINE Vector times(const Vector& a, const Vector& b) {
  return {a.x * b.x, a.y * b.y, a.z * b.z};
}
// d × v and -d × v, where d.z is 0.
ENGINE_INLINE Vector cross_flat(const Vector& d, const Vector& v) {
  return {d.y * v.z, -(d.x * v.z), d.x * v.y - d.y * v.x};
}
ENGINE_INLINE Vector minus_cross_flat(const Vector& d, const Vector& v) {
  return {-(d.y * v.z), d.x * v.z, d.y * v.x - d.x * v.y};
}
// The length, 0 where its square is no more than epsilon (btVector3::safeNorm).
ENGINE_INLINE Double safe_length(const Vector& v) {
  const Double squared = dot(v, v);
  return select(less(splat(kEpsilon), squared), square_root(squared), Double{});
}

template <class F>
struct Mat3 {
  Vec3<F> row[3];
};
typedef Mat3<Double> Matrix;

template <class F>
ENGINE_INLINE Vec3<F> operator*(const Mat3<F>& m, const Vec3<F>& v) {
  return {dot(m.row[0], v), dot(m.row[1], v), dot(m.row[2], v)};
}
// mᵀ v
template <class F>
ENGINE_INLINE Vec3<F> transposed_times(const Mat3<F>& m, const Vec3<F>& v) {
  return {m.row[0].x * v.x + m.row[1].x * v.y + m.row[2].x * v.z,
          m.row[0].y * v.x + m.row[1].y * v.y + m.row[2].y * v.z,
          m.row[0].z * v.x + m.row[1].z * v.y + m.row[2].z * v.z};
}
ENGINE_INLINE Matrix transpose(const Matrix& m) {
  return {{{m.row[0].x, m.row[1].x, m.row[2].x},
           {m.row[0].y, m.row[1].y, m.row[2].y},
           {m.row[0].z, m.row[1].z, m.row[2].z}}};
}
ENGINE_INLINE Matrix operator*(const Matrix& a, const Matrix& b) {
  return {{transposed_times(b, a.row[0]), transposed_times(b, a.row[1]),
           transposed_times(b, a.row[2])}};
}
ENGINE_INLINE Matrix operator+(const Matrix& a, const Matrix& b) {
  return {{a.row[0] + b.row[0], a.row[1] + b.row[1], a.row[2] + b.row[2]}};
}
ENGINE_INLINE Matrix operator-(const Matrix& a, const Matrix& b) {
  return {{a.row[0] - b.row[0], a.row[1] - b.row[1], a.row[2] - b.row[2]}};
}
ENGINE_INLINE Matrix operator*(const Matrix& m, Double s) {
  return {{m.row[0] * s, m.row[1] * s, m.row[2] * s}};
}
// a bᵀ
ENGINE_INLINE Matrix outer(const Vector& a, const Vector& b) {
  return {{{a.x * b.x, a.x * b.y, a.x * b.z},
           {a.y * b.x, a.y * b.y, a.y * b.z},
           {a.z * b.x, a.z * b.y, a.z * b.z}}};
}
// With [r] the matrix of r ×: m [r] and [r] m; in the second pair r.z is 0.
ENGINE_INLINE Matrix times_cross(const Matrix& m, const Vector& r) {
  Matrix out;
  for (int i = 0; i < 3; ++i) {
    const Vector& a = m.row[i];
    out.row[i] = {r.z * a.y + (-r.y) * a.z, (-r.z) * a.x + r.x * a.z, r.y * a.x + (-r.x) * a.y};
  }
  return out;
}
ENGINE_INLINE Matrix cross_times(const Vector& r, const Matrix& m) {
  return {{m.row[1] * (-r.z) + m.row[2] * r.y, m.row[0] * r.z + m.row[2] * (-r.x),
           m.row[0] * (-r.y) + m.row[1] * r.x}};
}
ENGINE_INLINE Matrix times_cross_flat(const Matrix& m, const Vector& r) {
  Matrix out;
  for (int i = 0; i < 3; ++i) {
    const Vector& a = m.row[i];
    out.row[i] = {-(r.y * a.z), r.x * a.z, r.y * a.x - r.x * a.y};
  }
  return out;
}
ENGINE_INLINE Matrix cross_flat_times(const Vector& r, const Matrix& m) {
  return {{m.row[2] * r.y, -(m.row[2] * r.x), m.row[1] * r.x - m.row[0] * r.y}};
}
// btMatrix3x3::inverse, by cofactors.
ENGINE_INLINE Matrix inverse(const Matrix& m) {
  const Vector &a = m.row[0], &b = m.row[1], &c = m.row[2];
  const Vector first = {b.y * c.z - b.z * c.y, b.z * c.x - b.x * c.z, b.x * c.y - b.y * c.x};
  const Double s = 1.0 / dot(a, first);
  return {{{first.x * s, (a.z * c.y - a.y * c.z) * s, (a.y * b.z - a.z * b.y) * s},
           {first.y * s, (a.x * c.z - a.z * c.x) * s, (a.z * b.x - a.x * b.z) * s},
           {first.z * s, (a.y * c.x - a.x * c.y) * s, (a.x * b.y - a.y * b.x) * s}}};
}

// A rotation about z: (c -s 0; s c 0; 0 0 1).
struct Turn {
  Double c, s;
};
ENGINE_INLINE Vector operator*(const Turn& r, const Vector& v) {
  return {r.c * v.x - r.s * v.y, r.s * v.x + r.c * v.y, v.z};
}
ENGINE_INLINE Vector transposed_times(const Turn& r, const Vector& v) {
  return {r.c * v.x + r.s * v.y, r.c * v.y - r.s * v.x, v.z};
}
ENGINE_INLINE Matrix operator*(const Turn& r, const Matrix& m) {
  return {{m.row[0] * r.c - m.row[1] * r.s, m.row[0] * r.s + m.row[1] * r.c, m.row[2]}};
}
// rᵀ m r
ENGINE_INLINE Matrix rotated_back(const Matrix& m, const Turn& r) {
  const Matrix t = {{m.row[0] * r.c + m.row[1] * r.s, m.row[1] * r.c - m.row[0] * r.s, m.row[2]}};
  return {{transposed_times(r, t.row[0]), transposed_times(r, t.row[1]),
           transposed_times(r, t.row[2])}};
}
ENGINE_INLINE Matrix rotated_back(const Matrix& m, const Matrix& r) {
  return (transpose(r) * m) * r;
}

struct Quaternion {
  Double x, y, z, w;
};
ENGINE_INLINE Quaternion inverse(const Quaternion& q) { return {-q.x, -q.y, -q.z, q.w}; }
ENGINE_INLINE Double length_squared(const Quaternion& q) {
  return q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w;
}
ENGINE_INLINE Quaternion operator*(const Quaternion& a, const Quaternion& b) {
  return {a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
          a.w * b.y + a.y * b.w + a.z * b.x - a.x * b.z,
          a.w * b.z + a.z * b.w + a.x * b.y - a.y * b.x,
          a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z};
}
// quatRotate: q v q⁻¹.
ENGINE_INLINE Vector rotate(const Quaternion& q, const Vector& v) {
  const Quaternion t = {q.w * v.x + q.y * v.z - q.z * v.y, q.w * v.y + q.z * v.x - q.x * v.z,
                        q.w * v.z + q.x * v.y - q.y * v.x, -q.x * v.x - q.y * v.y - q.z * v.z};
  const Quaternion r = t * inverse(q);
  return {r.x, r.y, r.z};
}
// btMatrix3x3::setRotation.
ENGINE_INLINE Matrix matrix(const Quaternion& q) {
  const Double s = 2.0 / length_squared(q);
  const Double xs = q.x * s, ys = q.y * s, zs = q.z * s;
  const Double wx = q.w * xs, wy = q.w * ys, wz = q.w * zs;
  const Double xx = q.x * xs, xy = q.x * ys, xz = q.x * zs;
  const Double yy = q.y * ys, yz = q.y * zs, zz = q.z * zs;
  return {{{1.0 - (yy + zz), xy - wz, xz + wy},
           {xy + wz, 1.0 - (xx + zz), yz - wx},
           {xz - wy, yz + wx, 1.0 - (xx + yy)}}};
}
// The same where x and y are 0.
ENGINE_INLINE Turn turn(const Quaternion& q) {
  const Double s = 2.0 / (q.z * q.z + q.w * q.w), zs = q.z * s;
  return {1.0 - q.z * zs, q.w * zs};
}

// One lane of many.
ENGINE_INLINE Vec3<double> lane_of(const Vector& v, int l) { return {v.x[l], v.y[l], v.z[l]}; }
ENGINE_INLINE Mat3<double> lane_of(const Matrix& m, int l) {
  return {{lane_of(m.row[0], l), lane_of(m.row[1], l), lane_of(m.row[2], l)}};
}
ENGINE_INLINE void set_lane(Vector& v, int l, const Vec3<double>& value) {
  v.x[l] = value.x;
  v.y[l] = value.y;
  v.z[l] = value.z;
}

}  // namespace ENGINE::ant
