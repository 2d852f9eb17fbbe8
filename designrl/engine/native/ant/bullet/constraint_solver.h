// The sequential impulses (btMultiBodyConstraintSolver::solveSingleIteration and
// resolveSingleConstraintRowGeneric): up to five sweeps over limits, normals and friction. A lane
// whose last sweep changed next to nothing rests; nearly always there are five.
#pragma once

#include "ant/bullet/constraints.h"

namespace ENGINE::ant {

// Joints in the order of their limits: Bullet sorts the constraints by their island, which is one
// and the same here, with a quicksort that keeps no order among equals.
constexpr int kLimitOrder[kJoints] = {2, 3, 0, 1, 6, 7, 4, 5};

class ConstraintSolver {
 public:
  // Makes the rows of a substep and applies their impulses to the velocities.
  void solve(const Body<Double>& body, const Kinematics& parts, const Contacts& contacts,
             const Articulated& articulated, State& state) {
    count_ = 0;
    add(contacts.torso, body, state, parts, articulated, parts.torso, state.position, 0, 0);
    for (int leg = 0; leg < kLegs; ++leg)
      for (int k = 0; k < kLegParts; ++k)
        add(contacts.legs[leg][k], body, state, parts, articulated, parts.rotation(leg, k),
            parts.origin[leg][k], leg, k);
    bool limits = false;
    for (int joint = 0; joint < kJoints; ++joint)
      limits |= make_limit(body, state, parts, articulated, joint, limits_[joint]);
    if (count_ == 0 && !limits) return;

    // Never -0: an impulse of zero in a lane that does not take part changes nothing.
    Double change[kVelocities] = {};
    const Double zero = {};
    DoubleMask active = at_most(zero, zero);
    int iteration = 0;
    for (; iteration < kIterations - 1 && any(active); ++iteration)
      active = but_not(active, at_most(sweep<true>(iteration, active, change), splat(kResidual)));
    if (any(active)) sweep<false>(iteration, active, change);
    for (int i = 0; i < kVelocities; ++i)
      state.velocity[i] = clamp_velocity(state.velocity[i] + change[i]);
  }

 private:
  ContactSlot contacts_[kShapes * kMaxPoints];
  LimitSlot limits_[kJoints];
  int count_;  // contact slots in use

  // The contact points of a part, which is beyond so many joints of that leg.
  void add(const Manifold& manifold, const Body<Double>& body, const State& state,
           const Kinematics& parts, const Articulated& articulated, const Matrix& rotation,
           const Vector& origin, int leg, int joints) {
    for (int j = 0; j < kMaxPoints; ++j) {
      const DoubleMask used = less(splat(j), manifold.count);
      if (!any(used)) break;
      ContactSlot& slot = contacts_[count_++];
      slot.used = used;
      slot.leg = leg;
      slot.joints = joints;
      // m_positionWorldOnA, as the last refresh left it.
      const Vector at = rotation * manifold.local[j] + origin, from_torso = at - state.position;
      make_contact_row<kUp>(body, state, parts, articulated, from_torso, at.z, slot);
      make_contact_row<kMinusY>(body, state, parts, articulated, from_torso, at.z, slot);
      make_contact_row<kX>(body, state, parts, articulated, from_torso, at.z, slot);
    }
  }

  // Returns the largest residual, the square of a change in velocity; 0 where nobody asks for it.
  template <bool kResiduals>
  ENGINE_INLINE Double sweep(int iteration, DoubleMask active, Double* change) {
    const Double zero = {};
    Double residual = zero;
    for (int i = 0; i < kJoints; ++i) {
      const int joint = kLimitOrder[iteration % 2 ? i : kJoints - 1 - i];
      LimitSlot& limit = limits_[joint];
      if (!limit.any_used) continue;
      apply<kResiduals>(limit, limit.side * change[6 + joint], both(limit.used, active), zero,
                        splat(kMaxLimitImpulse), change, residual);
    }
    for (int i = 0; i < count_; ++i) {
      ContactSlot& slot = contacts_[i];
      apply_contact<kUp, kResiduals>(slot, both(slot.used, active), zero,
                                     splat(kMaxNormalImpulse), change, residual);
    }
    for (int i = 0; i < count_; ++i) {
      ContactSlot& slot = contacts_[i];
      const Double normal = slot.rows[kUp].impulse, most = kFriction * normal;
      const DoubleMask pressed = both(both(slot.used, active), less(zero, normal));
      if (!any(pressed)) continue;
      apply_contact<kMinusY, kResiduals>(slot, pressed, -most, most, change, residual);
      apply_contact<kX, kResiduals>(slot, pressed, -most, most, change, residual);
    }
    return residual;
  }

  template <Direction kDirection, bool kResiduals>
  ENGINE_INLINE void apply_contact(ContactSlot& slot, DoubleMask takes_part, Double least,
                                   Double most, Double* change, Double& residual) {
    ContactRow& row = slot.rows[kDirection];
    const Double speed = project<kDirection>(row, slot.leg, slot.joints, change);
    apply<kResiduals>(row, speed, takes_part, least, most, change, residual);
  }

  // speed: the Jacobian times `change`, the velocities that all impulses so far have added.
  template <bool kResiduals>
  ENGINE_INLINE static void apply(Row& row, Double speed, DoubleMask takes_part, Double least,
                                  Double most, Double* change, Double& residual) {
    const Double zero = {}, before = row.impulse;
    Double step = row.target - speed * row.inverse_mass_inverse;
    const Double sum = before + step;
    const DoubleMask below = less(sum, least), above = less(most, sum);
    step = select(below, least - before, select(above, most - before, step));
    const Double after = select(below, least, select(above, most, sum));
    row.impulse = select(takes_part, after, before);
    step = select(takes_part, step, zero);
    for (int i = 0; i < kVelocities; ++i) change[i] = change[i] + row.response[i] * step;
    if (!kResiduals) return;
    Double error = step / row.inverse_mass_inverse;
    error = select(takes_part, error * error, zero);
    residual = select(less(error, residual), residual, error);
  }
};

}  // namespace ENGINE::ant
