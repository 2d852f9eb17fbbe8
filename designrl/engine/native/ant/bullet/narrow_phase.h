// Contacts of the parts with the floor (btConvexPlaneCollisionAlgorithm). The legs do not meet each
// other nor the torso. The broad phase has nothing to say: a plane's box overlaps everything's.
#pragma once

#include "ant/bullet/manifold.h"

namespace ENGINE::ant {

struct Contacts {
  Manifold torso;
  Manifold legs[kLegs][kLegParts];

  // Finds the contacts at the parts' poses, and forgets those that have come apart.
  void update(const Body<Double>& body, const State& state, const Kinematics& parts) {
    collide<true>(torso, body.torso, parts.torso, state.position);
    for (int leg = 0; leg < kLegs; ++leg)
      for (int k = 0; k < kLegParts; ++k)
        collide<false>(legs[leg][k], body.legs[leg][k], parts.rotation(leg, k),
                       parts.origin[leg][k]);
  }

  void clear(int l) {
    torso.count[l] = 0.0;
    for (auto& leg : legs)
      for (Manifold& manifold : leg) manifold.count[l] = 0.0;
  }

 private:
  // The lowest point of a part, in the world's frame.
  template <bool kSphere>
  static Vector lowest(const Part<Double>& part, const Matrix& rotation, const Vector& origin) {
    // Down, in the part's frame (btConvexShape::localGetSupportingVertex normalises it).
    const Vector down = {-rotation.row[2].x, -rotation.row[2].y, -rotation.row[2].z};
    const Vector unit = down * (1.0 / square_root(dot(down, down)));
    if (kSphere) return rotation * (unit * part.radius) + origin;
    // btMultiSphereShape: of each sphere without its margin, the lower one, and then the margin.
    const Vector margin = unit * splat(kMargin);
    const Vector near = unit * part.radius - margin;
    const Vector far = (part.end + unit * part.radius) - margin;
    const DoubleMask at_end = less(dot(unit, near), dot(unit, far));
    const Vector lower = {select(at_end, far.x, near.x), select(at_end, far.y, near.y),
                          select(at_end, far.z, near.z)};
    // The compound's child is shifted, so that the frame's origin is the centre of mass.
    return rotation * (lower + margin) + (rotation * -part.arm + origin);
  }

  template <bool kSphere>
  static void collide(Manifold& manifold, const Part<Double>& part, const Matrix& rotation,
                      const Vector& origin) {
    const Vector low = lowest<kSphere>(part, rotation, origin);
    const DoubleMask near = less(low.z, part.breaking), cached = less(Double{}, manifold.count);
    if (!any(either(near, cached))) return;
    for (int l = 0; l < kDoubles; ++l) {
      const double breaking = part.breaking[l];
      const bool meets = low.z[l] < breaking;
      if (!meets && manifold.count[l] == 0.0) continue;
      const Pose pose = {lane_of(rotation, l), lane_of(origin, l)};
      Points points(manifold, l, pose, breaking);
      // A compound refreshes its children's manifolds before they collide, too.
      if (!kSphere) points.refresh();
      if (meets) points.add(lane_of(low, l));
      points.refresh();
    }
  }
};

}  // namespace ENGINE::ant
