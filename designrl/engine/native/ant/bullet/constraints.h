// The rows that the constraint solver works on: contacts (btMultiBodyConstraintSolver::
// setupMultiBodyContactConstraint) and joint limits (btMultiBodyJointLimitConstraint).
//
// A row is a velocity, the Jacobian times the generalised velocities, and what a unit impulse along
// it does to all velocities. Rows of several ants share a place: one slot for a part's n-th contact
// point or a joint's limit, in which some lanes take part. An ant's slots are in Bullet's order,
// whatever the other lanes need.
#pragma once

#include "ant/bullet/articulated.h"
#include "ant/bullet/narrow_phase.h"

namespace ENGINE::ant {

struct Row {
  Double response[kVelocities];  // of all velocities to a unit impulse
  Double target;                 // of the impulse, if nothing else moved
  Double inverse_mass_inverse;   // m_jacDiagABInv: 1 / (Jacobian times response)
  Double impulse;                // so far
};

// A contact acts along three directions in turn: the normal, then friction along -y and along x
// (btPlaneSpace1 of the normal, and a pyramid instead of a cone).
enum Direction { kUp, kMinusY, kX, kDirections };

struct ContactRow : Row {
  Vector angular;     // the Jacobian: on the torso's rotation; on its velocity it is the direction
  Double hip, ankle;  // on the joints that the contact is beyond
};

struct ContactSlot {
  DoubleMask used;
  int leg, joints;  // the contact is beyond that many joints of that leg
  ContactRow rows[kDirections];
};

struct LimitSlot : Row {
  DoubleMask used;
  bool any_used;
  Double side;  // the Jacobian: 1 at the lower limit, -1 at the upper one
};

// The direction's own component of the torso's velocity.
template <Direction kDirection>
ENGINE_INLINE Double along(const Double* velocity) {
  return kDirection == kUp ? velocity[5] : kDirection == kMinusY ? -velocity[4] : velocity[3];
}
// The row's Jacobian times generalised velocities.
template <Direction kDirection>
ENGINE_INLINE Double project(const ContactRow& row, int leg, int joints, const Double* velocity) {
  Double sum = row.angular.x * velocity[0];
  sum = sum + row.angular.y * velocity[1];
  sum = sum + row.angular.z * velocity[2];
  sum = sum + along<kDirection>(velocity);
  if (joints > 0) sum = sum + row.hip * velocity[6 + 2 * leg];
  if (joints > 1) sum = sum + row.ankle * velocity[7 + 2 * leg];
  return sum;
}

// at: m, of the contact from the torso's centre; distance: m, from the floor.
template <Direction kDirection>
ENGINE_INLINE void make_contact_row(const Body<Double>& body, const State& state,
                                    const Kinematics& parts, const Articulated& articulated,
                                    const Vector& at, Double distance, ContactSlot& slot) {
  ContactRow& row = slot.rows[kDirection];
  const int leg = slot.leg, joints = slot.joints;
  const Double zero = {};
  const Matrix& base = articulated.base;
  // at × direction, and the direction as the torso sees it.
  Vector direction;
  if (kDirection == kUp) {
    row.angular = {at.y, -at.x, zero};
    direction = {base.row[0].z, base.row[1].z, base.row[2].z};
  } else if (kDirection == kMinusY) {
    row.angular = {at.z, zero, -at.x};
    direction = {-base.row[0].y, -base.row[1].y, -base.row[2].y};
  } else {
    row.angular = {zero, at.z, -at.y};
    direction = {base.row[0].x, base.row[1].x, base.row[2].x};
  }
  // btMultiBody::fillConstraintJacobianMultiDof: along the leg, direction and place in each frame.
  row.hip = row.ankle = zero;
  if (joints > 0) {
    const Part<Double>* leg_parts = body.legs[leg];
    const Turn& hip = articulated.hip[leg];
    const Vector seen = hip * direction;
    const Vector place = hip * (base * at - leg_parts[kTop].arm) - parts.joint_arm[2 * leg];
    row.hip = seen.x * (-place.y) + seen.y * place.x;
    if (joints > 1) {
      const Matrix& ankle = articulated.ankle[leg];
      const Vector n = ankle * seen;
      const Vector p = ankle * (place - leg_parts[kMiddle].arm) - parts.joint_arm[2 * leg + 1];
      const double x = kAnkleX[leg];
      row.ankle = n.x * p.z + n.y * (-(x * p.z)) + n.z * (x * p.y - p.x);
    }
  }
  const Spatial on_torso = {-direction, base * -row.angular};
  articulated.respond(body, parts, on_torso, leg, joints, row.hip, row.ankle, row.response);

  const Double mass = project<kDirection>(row, leg, joints, row.response);
  row.inverse_mass_inverse = select(less(splat(kEpsilon), mass), 1.0 / mass, zero);
  const Double speed = project<kDirection>(row, leg, joints, state.velocity);
  if (kDirection == kUp) {
    Double bounce = kRestitution * -speed;
    bounce = select(at_most(bounce, zero), zero, bounce);
    const Double gap = distance + kSlop;
    Double change = bounce - speed;
    const DoubleMask apart = less(zero, gap);
    change = select(apart, change - gap / kSubstep, change);
    const Double correction = select(apart, zero, (-gap) * kContactErp / kSubstep);
    row.target =
        correction * row.inverse_mass_inverse + change * row.inverse_mass_inverse;
  } else {
    row.target = (zero - speed) * row.inverse_mass_inverse;
  }
  row.impulse = zero;
}

// A joint beyond one of its limits, in some lane; false: in none.
inline bool make_limit(const Body<Double>& body, const State& state, const Kinematics& parts,
                       const Articulated& articulated, int joint, LimitSlot& slot) {
  const Double zero = {};
  const Double above = state.angle[joint] - kLower[joint];
  const Double below = kUpper[joint] - state.angle[joint];
  const DoubleMask low = at_most(above, zero), high = at_most(below, zero);
  slot.used = either(low, high);
  slot.any_used = any(slot.used);
  if (!slot.any_used) return false;
  const Double side = select(low, splat(1.0), select(high, splat(-1.0), zero));
  slot.side = side;
  const Spatial nothing = {};
  const bool ankle = joint % 2 == 1;
  articulated.respond(body, parts, nothing, joint / 2, ankle ? 2 : 1, ankle ? zero : side,
                      ankle ? side : zero, slot.response);
  const Double mass = side * slot.response[6 + joint];
  slot.inverse_mass_inverse = select(less(splat(kEpsilon), mass), 1.0 / mass, zero);
  const Double penetration = select(low, above, below);
  const Double from_speed = -(state.velocity[6 + joint] * side) * slot.inverse_mass_inverse;
  // A deeper one's position is left to split impulses, which a multi-body does not have.
  const Double from_position = (-penetration) * kLimitErp / kSubstep * slot.inverse_mass_inverse;
  slot.target = select(less(splat(kShallow), penetration), from_position + from_speed, from_speed);
  slot.impulse = zero;
  return true;
}

}  // namespace ENGINE::ant
