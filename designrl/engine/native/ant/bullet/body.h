// The body of a design: what Bullet's MJCF loader makes of it (BulletMJCFImporter, btCompoundShape,
// btMultiSphereShape). A capsule is a shape of two spheres in a compound of one child.
#pragma once

#include "ant/bullet/math3d.h"
#include "ant/scene.h"

namespace ENGINE::ant {

// A part's numbers in its own frame, whose origin is its centre of mass; F is a number or lanes.
template <class F>
struct Part {
  F mass;           // kg
  Vec3<F> inertia;  // kg m², about the axes
  Vec3<F> arm;      // m, from where it hangs to its centre of mass; from there to its end as well
  Vec3<F> end;      // m, of its axis, seen from where it hangs; z is 0
  F radius;         // m
  F breaking;       // m, distance from the floor from which on it has no contact
};

template <class F>
struct Body {
  Part<F> torso;  // a sphere: arm and end are 0
  Part<F> legs[kLegs][kLegParts];
};

// The sphere.
inline Part<double> make_torso() {
  Part<double> part = {};
  const double r = kTorsoRadius;
  part.mass = kDensity * (4.0 / 3.0 * kPi * r * r * r);
  const double inertia = 0.4 * part.mass * r * r;
  part.inertia = {inertia, inertia, inertia};
  part.radius = r;
  const double side = r + r;
  part.breaking = sqrt(side * side + side * side + side * side) * 0.5 * kBreakingShare;
  return part;
}

// A number as the loader reads it, in single precision. Volatile, because GCC 12 takes two such
// conversions side by side for nothing and leaves them out.
inline double read(double number) {
  volatile float single = float(number);
  return single;
}

// The capsule from the origin to (dx, dy, 0).
inline Part<double> make_capsule(double dx, double dy, double radius) {
  Part<double> part = {};
  const double end[3] = {read(dx), read(dy), 0.0}, r = read(radius);
  const double height = sqrt(end[0] * end[0] + end[1] * end[1] + end[2] * end[2]);
  part.mass = kDensity * (4.0 / 3.0 * kPi * r * r * r + kPi * r * r * height);

  // btConvexInternalAabbCachingShape: a box around the two spheres, found from the support points
  // without margin, with a margin around them and another around the box; then the compound's.
  double low[3], high[3], arm[3];
  for (int i = 0; i < 3; ++i) {
    arm[i] = 0.5 * end[i];
    // Of the two support points along the axis, the farther one; the first if they are alike.
    const double up0 = r - kMargin, up1 = (end[i] + r) - kMargin;
    const double down0 = -r + kMargin, down1 = (end[i] - r) + kMargin;
    const double top = (up1 > up0 ? up1 : up0) + kMargin;
    const double bottom = (-down1 > -down0 ? down1 : down0) - kMargin;
    double half = 0.5 * (top - bottom) + kMargin, middle = 0.5 * (top + bottom) + -arm[i];
    low[i] = middle - half;
    high[i] = middle + half;
    half = 0.5 * (high[i] - low[i]);
    middle = 0.5 * (high[i] + low[i]);
    low[i] = middle - half;
    high[i] = middle + half;
  }
  // btCompoundShape::calculateLocalInertia: of a solid box.
  double side[3];
  for (int i = 0; i < 3; ++i) side[i] = 2.0 * ((high[i] - low[i]) * 0.5);
  const double twelfth = part.mass / 12.0;
  part.inertia = {twelfth * (side[1] * side[1] + side[2] * side[2]),
                  twelfth * (side[0] * side[0] + side[2] * side[2]),
                  twelfth * (side[0] * side[0] + side[1] * side[1])};
  // btCollisionShape::getAngularMotionDisc.
  double diagonal = 0.0, offset = 0.0;
  for (int i = 0; i < 3; ++i) {
    const double extent = high[i] - low[i], middle = (low[i] + high[i]) * 0.5;
    diagonal += extent * extent;
    offset += middle * middle;
  }
  part.breaking = (sqrt(diagonal) * 0.5 + sqrt(offset)) * kBreakingShare;

  part.arm = {arm[0], arm[1], arm[2]};
  part.end = {end[0], end[1], end[2]};
  part.radius = r;
  return part;
}

inline void set_lane(Part<Double>& to, int l, const Part<double>& from) {
  to.mass[l] = from.mass;
  set_lane(to.inertia, l, from.inertia);
  set_lane(to.arm, l, from.arm);
  set_lane(to.end, l, from.end);
  to.radius[l] = from.radius;
  to.breaking[l] = from.breaking;
}
inline void set_lane(Body<Double>& to, int l, const Body<double>& from) {
  set_lane(to.torso, l, from.torso);
  for (int leg = 0; leg < kLegs; ++leg)
    for (int k = 0; k < kLegParts; ++k) set_lane(to.legs[leg][k], l, from.legs[leg][k]);
}

}  // namespace ENGINE::ant
