// Featherstone's articulated-body algorithm (btMultiBody::
// computeAccelerationsArticulatedBodyAlgorithmMultiDof and calcAccelerationDeltasMultiDof).
//
// In three passes: outward, each link's velocity and the force that would hold it; inward, each
// link's inertia and force with all that hangs on it; outward again, the accelerations. The first
// two are done leg by leg, as legs meet in the torso only; from the last leg to the first, as
// Bullet goes through its links: in that order the torso's sums are rounded.
//
// The names are Bullet's, which has them from Mirtich: h is the articulated inertia times a joint's
// axis (Featherstone's U), d its part along the axis (D), y the torque left to accelerate the joint
// (u).
//
// What folds away, to the bit: the rotation of a fixed link is the exact identity and its offset is
// flat (z = 0); a joint's own link has no mass, so that its inertia is that of the part which is
// fixed to it, seen from the joint; a hip turns about z, so that its rotation is a Turn.
#pragma once

#include "ant/bullet/kinematics.h"

namespace ENGINE::ant {

// A force or a motion in space, Bullet's btSpatialForceVector and btSpatialMotionVector. Of a
// motion, `top` is the angular part and `bottom` the linear one; of a force it is the other way
// round, so that their product is a plain sum.
struct Spatial {
  Vector top, bottom;
};

ENGINE_INLINE Double dot(const Spatial& motion, const Spatial& force) {
  return dot(motion.bottom, force.top) + dot(motion.top, force.bottom);
}

// The inertia of an articulated body, a symmetric 6 × 6 matrix (btSymmetricSpatialDyad).
struct Inertia {
  Matrix top_left, top_right, bottom_left;

  ENGINE_INLINE void operator+=(const Inertia& other) {
    top_left = top_left + other.top_left;
    top_right = top_right + other.top_right;
    bottom_left = bottom_left + other.bottom_left;
  }
};

// A rigid part's inertia about its centre of mass.
ENGINE_INLINE Inertia rigid(const Part<Double>& part) {
  const Double o = {}, m = part.mass;
  const Vector& i = part.inertia;
  return {{{{o, o, o}, {o, o, o}, {o, o, o}}},
          {{{m, o, o}, {o, m, o}, {o, o, m}}},
          {{{i.x, o, o}, {o, i.y, o}, {o, o, i.z}}}};
}
// The same about where it hangs.
ENGINE_INLINE Inertia rigid_at_joint(const Part<Double>& part) {
  const Double o = {}, m = part.mass;
  const Vector &i = part.inertia, &r = part.arm;
  const Matrix top_left = {{{o, o, -(m * r.y)}, {o, o, m * r.x}, {m * r.y, -(m * r.x), o}}};
  Matrix bottom_left = cross_flat_times(r, top_left);
  bottom_left.row[0].x = bottom_left.row[0].x + i.x;
  bottom_left.row[1].y = bottom_left.row[1].y + i.y;
  bottom_left.row[2].z = bottom_left.row[2].z + i.z;
  return {top_left, {{{m, o, o}, {o, m, o}, {o, o, m}}}, bottom_left};
}
// btSpatialTransformationMatrix::transformInverse, without its rotation: the inertia seen from a
// frame that is shifted by r.
ENGINE_INLINE Inertia shifted(const Inertia& in, const Vector& r) {
  const Matrix top_left = in.top_left - times_cross(in.top_right, r);
  return {top_left, in.top_right,
          (cross_times(r, top_left) + in.bottom_left) - times_cross(transpose(in.top_left), r)};
}
// The same where r.z is 0.
ENGINE_INLINE Inertia shifted_flat(const Inertia& in, const Vector& r) {
  const Matrix top_left = in.top_left - times_cross_flat(in.top_right, r);
  return {top_left, in.top_right,
          (cross_flat_times(r, top_left) + in.bottom_left) -
              times_cross_flat(transpose(in.top_left), r)};
}
template <class Rotation>
ENGINE_INLINE Inertia rotated_back(const Inertia& in, const Rotation& r) {
  return {rotated_back(in.top_left, r), rotated_back(in.top_right, r),
          rotated_back(in.bottom_left, r)};
}
// A force at the end of a flat arm, seen from the arm's start.
ENGINE_INLINE Spatial shifted_flat(const Spatial& force, const Vector& arm) {
  return {force.top, force.bottom + cross_flat(arm, force.top)};
}

ENGINE_INLINE Double clamp_velocity(Double v) {
  const Double most = splat(kMaxVelocity), least = splat(-kMaxVelocity);
  return select(less(v, least), least, select(less(most, v), most, v));
}

class Articulated {
 public:
  // Forces and torques of one substep; advances the velocities. torque: (kJoints,) N m.
  void accelerate(const Body<Double>& body, const Kinematics& parts, const Double* torque,
                  State& state);

  // What an impulse adds to the velocities, (kVelocities,). torso: the impulse as the torso feels
  // it directly, negative, in its frame. leg, joints: it acts beyond that many joints of that leg,
  // with the generalised impulses on_hip and on_ankle.
  void respond(const Body<Double>& body, const Kinematics& parts, Spatial torso, int leg,
               int joints, Double on_hip, Double on_ankle, Double* out) const;

  // Rotations of the current pose, from a frame to the next one farther out.
  Matrix base;            // world to torso
  Turn hip[kLegs];        // torso to middle part
  Matrix ankle[kLegs];    // middle to bottom part

 private:
  Spatial h_[kJoints];
  Double inverse_d_[kJoints];
  Double y_[kJoints];
  Spatial coriolis_[kJoints];  // accelerations that come of the velocities alone
  // The inverse of the torso's articulated inertia, in blocks.
  Matrix upper_left_, upper_right_, lower_left_, lower_right_;

  static Spatial holding_force(const Matrix& from_world, const Part<Double>& part,
                               const Vector& angular, const Vector& linear);
  void add_leg(const Body<Double>& body, const Kinematics& parts, const Double* torque,
               const Double* velocity, int leg, const Vector& angular, const Vector& linear,
               Inertia& inertia, Spatial& force);
  template <bool kAnkle>
  void pass_joint(int leg, Double torque, Inertia& inertia, Spatial& force);
  void invert(const Inertia& inertia);
  Spatial solve(const Spatial& force) const {
    return {-(upper_left_ * force.top + upper_right_ * force.bottom),
            -(lower_left_ * force.top + lower_right_ * force.bottom)};
  }
  template <bool kCoriolis, class Y>
  void accelerate_joints(const Body<Double>& body, const Kinematics& parts, const Spatial& torso,
                         Y y, Double* out) const;
  void to_world(const Vector& angular, const Vector& linear, Double* out) const;
};

// The force that would hold a part at its velocity (zeroAccSpatFrc): weight, damping, gyroscopic
// terms.
ENGINE_INLINE Spatial Articulated::holding_force(const Matrix& from_world, const Part<Double>& part,
                                                 const Vector& angular, const Vector& linear) {
  const Double weight = -kGravity * part.mass;
  Vector top = {-(from_world.row[0].z * weight), -(from_world.row[1].z * weight),
                -(from_world.row[2].z * weight)};
  top = top + (linear * part.mass) * (kDamping + kDamping * safe_length(linear));
  Vector bottom = times(part.inertia, angular) * (kDamping + kDamping * safe_length(angular));
  bottom = bottom + cross(angular, times(part.inertia, angular));
  top = top + cross(angular, linear) * part.mass;
  return {top, bottom};
}

// Inward over a joint. inertia, force: of the link in its own frame; out: what of them its parent
// feels, still in this frame.
template <bool kAnkle>
ENGINE_INLINE void Articulated::pass_joint(int leg, Double torque, Inertia& inertia,
                                           Spatial& force) {
  const int j = 2 * leg + kAnkle;
  const Spatial& coriolis = coriolis_[j];
  const Matrix &a = inertia.top_left, &b = inertia.bottom_left;
  Spatial& h = h_[j];
  Double along, d;  // the force's and the inertia's part along the axis
  if (kAnkle) {
    const double x = kAnkleX[leg];
    h.top = {a.row[0].x * x + a.row[0].y, a.row[1].x * x + a.row[1].y,
             a.row[2].x * x + a.row[2].y};
    h.bottom = {b.row[0].x * x + b.row[0].y, b.row[1].x * x + b.row[1].y,
                b.row[2].x * x + b.row[2].y};
    along = x * force.bottom.x + force.bottom.y;
    d = x * h.bottom.x + h.bottom.y;
  } else {
    h.top = {a.row[0].z, a.row[1].z, a.row[2].z};
    h.bottom = {b.row[0].z, b.row[1].z, b.row[2].z};
    along = force.bottom.z;
    d = h.bottom.z;
  }
  y_[j] = torque - along - dot(coriolis, h);
  const Double inverse_d = select(less(d, splat(kEpsilon)), Double{}, 1.0 / d);
  inverse_d_[j] = inverse_d;
  const Vector top = h.top * inverse_d, bottom = h.bottom * inverse_d;
  const Double acceleration = inverse_d * y_[j];
  const Vector held_bottom =
      force.bottom + (inertia.bottom_left * coriolis.top +
                      transposed_times(inertia.top_left, coriolis.bottom));
  const Vector held_top =
      force.top + (inertia.top_left * coriolis.top + inertia.top_right * coriolis.bottom);
  force.bottom = held_bottom + h.bottom * acceleration;
  force.top = held_top + h.top * acceleration;
  inertia.top_left = inertia.top_left - outer(h.top, bottom);
  inertia.top_right = inertia.top_right - outer(h.top, top);
  inertia.bottom_left = inertia.bottom_left - outer(h.bottom, bottom);
}

// The inverse of a symmetric 6 × 6 matrix in blocks (btMultiBody::solveImatrix, Featherstone).
ENGINE_INLINE void Articulated::invert(const Inertia& inertia) {
  const Matrix& top_left = inertia.top_left;
  const Matrix lower_right = transpose(top_left);
  const Matrix inverse_right = inverse(inertia.top_right) * splat(-1.0);
  Matrix t = lower_right * inverse_right;
  upper_right_ = inverse(t * top_left + inertia.bottom_left);
  t = upper_right_ * lower_right;
  upper_left_ = t * inverse_right;
  lower_right_ = transpose(upper_left_);
  t = top_left * upper_left_;
  t.row[0].x = t.row[0].x - 1.0;
  t.row[1].y = t.row[1].y - 1.0;
  t.row[2].z = t.row[2].z - 1.0;
  lower_left_ = inverse_right * t;
}

// The first two passes through a leg: adds to the torso's inertia and force what it feels of it.
// angular, linear: the torso's velocity in its own frame.
ENGINE_INLINE void Articulated::add_leg(const Body<Double>& body, const Kinematics& parts,
                                        const Double* torque, const Double* velocity, int leg,
                                        const Vector& angular, const Vector& linear,
                                        Inertia& inertia, Spatial& force) {
  const Part<Double>&top = body.legs[leg][kTop], &middle = body.legs[leg][kMiddle],
        &bottom = body.legs[leg][kBottom];
  const int a = 2 * leg, b = a + 1;
  const Vector &hip_arm = parts.joint_arm[a], &ankle_arm = parts.joint_arm[b];
  const Double zero = {}, hip_speed = velocity[6 + a], ankle_speed = velocity[6 + b];

  // Outward: w and u are the angular and the linear velocity of one link after the other.
  Vector w = angular, u = minus_cross_flat(top.arm, w) + linear;
  const Spatial top_force = holding_force(base, top, w, u);

  const Vector at_hip = hip[leg] * u;
  w = hip[leg] * w;
  u = minus_cross_flat(hip_arm, w) + at_hip;
  w.z = w.z + hip_speed;
  coriolis_[a] = {{w.y * hip_speed, -(w.x * hip_speed), zero},
                  {u.y * hip_speed, -(u.x * hip_speed), zero}};
  const Matrix middle_from_world = hip[leg] * base;
  u = minus_cross_flat(middle.arm, w) + u;
  const Spatial middle_force = holding_force(middle_from_world, middle, w, u);

  const Vector at_ankle = ankle[leg] * u;
  w = ankle[leg] * w;
  u = cross(-ankle_arm, w) + at_ankle;
  const Vector turning = {kAnkleX[leg] * ankle_speed, ankle_speed, zero};
  w.x = w.x + turning.x;
  w.y = w.y + turning.y;
  coriolis_[b] = {cross(w, turning), cross(u, turning)};
  const Matrix bottom_from_world = ankle[leg] * middle_from_world;
  u = minus_cross_flat(bottom.arm, w) + u;
  const Spatial bottom_force = holding_force(bottom_from_world, bottom, w, u);

  // Inward: the bottom part, over the ankle, the middle part, over the hip, the top part.
  Inertia i = rigid_at_joint(bottom);
  Spatial f = shifted_flat(bottom_force, bottom.arm);
  pass_joint<true>(leg, torque[b], i, f);
  Inertia whole = rigid(middle);
  whole += rotated_back(shifted(i, ankle_arm), ankle[leg]);
  f = {middle_force.top + transposed_times(ankle[leg], f.top),
       middle_force.bottom + transposed_times(ankle[leg], f.bottom + cross(ankle_arm, f.top))};
  i = shifted_flat(whole, middle.arm);
  f = shifted_flat(f, middle.arm);
  pass_joint<false>(leg, torque[a], i, f);
  whole = rigid(top);
  whole += rotated_back(shifted_flat(i, hip_arm), hip[leg]);
  f = {top_force.top + transposed_times(hip[leg], f.top),
       top_force.bottom + transposed_times(hip[leg], f.bottom + cross_flat(hip_arm, f.top))};
  inertia += shifted_flat(whole, top.arm);
  f = shifted_flat(f, top.arm);
  force = {force.top + f.top, force.bottom + f.bottom};
}

// The last pass: the joints' accelerations that go with the torso's. Of an impulse, they are the
// changes of speed, which no Coriolis term is part of. y(joint): its y; out: (kJoints,).
template <bool kCoriolis, class Y>
ENGINE_INLINE void Articulated::accelerate_joints(const Body<Double>& body,
                                                  const Kinematics& parts, const Spatial& torso,
                                                  Y y, Double* out) const {
  for (int leg = 0; leg < kLegs; ++leg) {
    const int a = 2 * leg, b = a + 1;
    Spatial link;
    Vector before = minus_cross_flat(body.legs[leg][kTop].arm, torso.top) + torso.bottom;
    link.top = hip[leg] * torso.top;
    link.bottom = minus_cross_flat(parts.joint_arm[a], link.top) + hip[leg] * before;
    const Double at_hip = inverse_d_[a] * (y(a) - dot(link, h_[a]));
    out[a] = at_hip;
    if (kCoriolis)
      link = {link.top + coriolis_[a].top, link.bottom + coriolis_[a].bottom};
    link.top.z = link.top.z + at_hip;
    before = minus_cross_flat(body.legs[leg][kMiddle].arm, link.top) + link.bottom;
    link.top = ankle[leg] * link.top;
    link.bottom = cross(-parts.joint_arm[b], link.top) + ankle[leg] * before;
    out[b] = inverse_d_[b] * (y(b) - dot(link, h_[b]));
  }
}

// Of the torso, from its frame to the world's: (6,).
ENGINE_INLINE void Articulated::to_world(const Vector& angular, const Vector& linear,
                                         Double* out) const {
  const Vector turn = transposed_times(base, angular), move = transposed_times(base, linear);
  out[0] = turn.x;
  out[1] = turn.y;
  out[2] = turn.z;
  out[3] = move.x;
  out[4] = move.y;
  out[5] = move.z;
}

inline void Articulated::accelerate(const Body<Double>& body, const Kinematics& parts,
                                    const Double* torque, State& state) {
  base = matrix(state.rotation);
  for (int leg = 0; leg < kLegs; ++leg) {
    hip[leg] = turn(parts.joint_rotation[2 * leg]);
    ankle[leg] = matrix(parts.joint_rotation[2 * leg + 1]);
  }
  const Double* v = state.velocity;
  const Vector angular = base * Vector{v[0], v[1], v[2]};
  const Vector linear = base * Vector{v[3], v[4], v[5]};
  Spatial force = holding_force(base, body.torso, angular, linear);
  Inertia inertia = rigid(body.torso);
  for (int leg = kLegs - 1; leg >= 0; --leg)
    add_leg(body, parts, torque, v, leg, angular, linear, inertia, force);
  invert(inertia);

  Double out[kVelocities];
  const Spatial torso = solve(force);
  accelerate_joints<true>(body, parts, torso, [this](int joint) { return y_[joint]; }, out + 6);
  // The torso's frame turns: its velocity changes in the world by this much more.
  to_world(torso.top, torso.bottom + cross(angular, linear), out);
  for (int i = 0; i < kVelocities; ++i)
    state.velocity[i] = clamp_velocity(state.velocity[i] + out[i] * kSubstep);
}

// Not inlined: it is called for many rows.
__attribute__((noinline)) inline void Articulated::respond(const Body<Double>& body,
                                                           const Kinematics& parts, Spatial torso,
                                                           int leg, int joints, Double on_hip,
                                                           Double on_ankle, Double* out) const {
  Double y_hip = {}, y_ankle = {};
  if (joints > 0) {
    const int a = 2 * leg, b = a + 1;
    Spatial f = {};
    if (joints > 1) {
      y_ankle = on_ankle;
      const Double acceleration = inverse_d_[b] * y_ankle;
      const Vector top = h_[b].top * acceleration, bottom = h_[b].bottom * acceleration;
      f.top = transposed_times(ankle[leg], top);
      f.bottom = transposed_times(ankle[leg], bottom + cross(parts.joint_arm[b], top));
      f = shifted_flat(f, body.legs[leg][kMiddle].arm);
    }
    y_hip = on_hip - f.bottom.z;
    const Double acceleration = inverse_d_[a] * y_hip;
    const Vector top = f.top + h_[a].top * acceleration;
    const Vector bottom = f.bottom + h_[a].bottom * acceleration;
    f.top = transposed_times(hip[leg], top);
    f.bottom = transposed_times(hip[leg], bottom + cross_flat(parts.joint_arm[a], top));
    f = shifted_flat(f, body.legs[leg][kTop].arm);
    torso = {torso.top + f.top, torso.bottom + f.bottom};
  }
  torso = solve(torso);
  const auto y = [=](int joint) {
    return joint / 2 != leg ? Double{} : joint % 2 == 0 ? y_hip : y_ankle;
  };
  accelerate_joints<false>(body, parts, torso, y, out + 6);
  to_world(torso.top, torso.bottom, out);
}

}  // namespace ENGINE::ant
