// What the velocity solver needs to know of one world, and what it hands back
// (b2ContactSolver's and b2RevoluteJoint's initialisation, warm starting and stored impulses).
#pragma once

#include "walker/box2d/velocity_solver.h"

namespace ENGINE::walker {

// Position and velocity of a body while a step is solved (b2Position, b2Velocity).
struct Motion {
  Vec2 c;  // centre of mass, m
  float a;
  Rot q;   // rotation by a
  Vec2 v;
  float w;
};

// One touching contact, as the velocity solver sees it (b2ContactVelocityConstraint).
struct ContactConstraint {
  const Contact* contact;
  Vec2 normal;
  Vec2 r[2];
  float normal_mass[2], tangent_mass[2], normal_impulse[2], tangent_impulse[2];
  float k11, k12, k22;
  float inverse[4];  // column by column
  int count;         // points; one if two would be nearly the same constraint
};

// Constructor and InitializeVelocityConstraints of b2ContactSolver. `warm` scales the impulses of
// the step before; 0 starts without.
inline void prepare_contact(ContactConstraint& out, const Contact& contact, const Body& body,
                            const Motion& motion, float warm) {
  const Manifold& manifold = contact.manifold;
  out.contact = &contact;
  out.count = manifold.count;
  Transform xf;
  xf.q = motion.q;
  xf.p = motion.c - mul(xf.q, body.sweep.local_center);

  // b2WorldManifold::Initialize: points half way between the two skins.
  Vec2 points[2];
  Vec2 normal, plane;
  if (manifold.face_a) {
    normal = manifold.normal;
    plane = manifold.point;
  } else {
    normal = mul(xf.q, manifold.normal);
    plane = mul(xf, manifold.point);
  }
  for (int i = 0; i < manifold.count; ++i) {
    Vec2 clip = manifold.face_a ? mul(xf, manifold.points[i].local) : manifold.points[i].local;
    Vec2 on_face = clip + (kSkin - dot(clip - plane, normal)) * normal;
    Vec2 on_other = clip - kSkin * normal;
    points[i] = 0.5f * (on_face + on_other);
  }
  if (!manifold.face_a) normal = -normal;
  out.normal = normal;

  const float m = body.inverse_mass, inertia = body.inverse_inertia;
  const Vec2 tangent = right_normal(normal);
  float rn[2];
  for (int i = 0; i < manifold.count; ++i) {
    Vec2 r = points[i] - motion.c;
    rn[i] = cross(r, normal);
    float rt = cross(r, tangent);
    float k_normal = m + inertia * rn[i] * rn[i];
    float k_tangent = m + inertia * rt * rt;
    out.r[i] = r;
    out.normal_mass[i] = k_normal > 0.0f ? 1.0f / k_normal : 0.0f;
    out.tangent_mass[i] = k_tangent > 0.0f ? 1.0f / k_tangent : 0.0f;
    out.normal_impulse[i] = warm * manifold.points[i].normal_impulse;
    out.tangent_impulse[i] = warm * manifold.points[i].tangent_impulse;
  }
  if (out.count < 2) return;
  float k11 = m + inertia * rn[0] * rn[0];
  float k22 = m + inertia * rn[1] * rn[1];
  float k12 = m + inertia * rn[0] * rn[1];
  if (k11 * k11 < kMaxConditionNumber * (k11 * k22 - k12 * k12)) {
    float det = k11 * k22 - k12 * k12;
    if (det != 0.0f) det = 1.0f / det;
    out.k11 = k11;
    out.k12 = k12;
    out.k22 = k22;
    out.inverse[0] = det * k22;
    out.inverse[1] = -det * k12;
    out.inverse[2] = -det * k12;
    out.inverse[3] = det * k11;
  } else {
    out.count = 1;
  }
}

// b2ContactSolver::WarmStart for one contact.
inline void warm_start(const ContactConstraint& contact, const Body& body, Motion& motion) {
  const Vec2 tangent = right_normal(contact.normal);
  for (int i = 0; i < contact.count; ++i) {
    Vec2 p = contact.normal_impulse[i] * contact.normal + contact.tangent_impulse[i] * tangent;
    motion.w += body.inverse_inertia * cross(contact.r[i], p);
    motion.v = motion.v + body.inverse_mass * p;
  }
}

inline ContactTerms<float> contact_terms(const ContactConstraint& c, const Body& body) {
  const bool two = c.count == 2;
  auto second = [two](float value) { return two ? value : 0.0f; };
  return {c.normal.x,
          c.normal.y,
          c.contact->friction,
          body.inverse_mass,
          body.inverse_inertia,
          c.r[0].x,
          c.r[0].y,
          second(c.r[1].x),
          second(c.r[1].y),
          c.normal_mass[0],
          second(c.normal_mass[1]),
          c.tangent_mass[0],
          second(c.tangent_mass[1]),
          second(c.k11),
          second(c.k12),
          second(c.k22),
          second(c.inverse[0]),
          second(c.inverse[2]),
          second(c.inverse[1]),
          second(c.inverse[3])};
}

inline ContactImpulses<float> contact_impulses(const ContactConstraint& c) {
  const bool two = c.count == 2;
  return {c.normal_impulse[0], two ? c.normal_impulse[1] : 0.0f, c.tangent_impulse[0],
          two ? c.tangent_impulse[1] : 0.0f};
}

// Writes one lane of a structure of vectors from the same structure of floats.
template <template <class> class Terms>
inline void scatter(Terms<Vector>* chunks, int lane, const Terms<float>& terms) {
  constexpr int count = sizeof(Terms<float>) / sizeof(float);
  float* to = reinterpret_cast<float*>(&chunks[lane / kWidth]) + lane % kWidth;
  const float* from = reinterpret_cast<const float*>(&terms);
  for (int i = 0; i < count; ++i) to[i * kWidth] = from[i];
}
template <template <class> class Terms>
inline Terms<float> gather(const Terms<Vector>* chunks, int lane) {
  constexpr int count = sizeof(Terms<float>) / sizeof(float);
  Terms<float> terms;
  const float* from = reinterpret_cast<const float*>(&chunks[lane / kWidth]) + lane % kWidth;
  float* to = reinterpret_cast<float*>(&terms);
  for (int i = 0; i < count; ++i) to[i] = from[i * kWidth];
  return terms;
}

inline void load_contact(VelocitySolver& solver, int lane, int body_index, int slot,
                         const ContactConstraint& contact, const Body& body) {
  ContactRows& rows = solver.contacts[body_index][slot];
  scatter(rows.terms, lane, contact_terms(contact, body));
  scatter(rows.impulses, lane, contact_impulses(contact));
  rows.two.set(lane, contact.count == 2);
}

// b2ContactSolver::StoreImpulses for one contact.
inline void store_contact(const VelocitySolver& solver, int lane, int body_index, int slot,
                          Contact& contact) {
  const ContactRows& rows = solver.contacts[body_index][slot];
  const ContactImpulses<float> impulses = gather(rows.impulses, lane);
  ManifoldPoint* points = contact.manifold.points;
  points[0].normal_impulse = impulses.normal1;
  points[0].tangent_impulse = impulses.tangent1;
  if (!rows.two[lane]) return;
  points[1].normal_impulse = impulses.normal2;
  points[1].tangent_impulse = impulses.tangent2;
}

// b2RevoluteJoint::InitVelocityConstraints, with the solver's right-hand sides computed once.
inline void load_joint(VelocitySolver& solver, int lane, int index, Joint& joint,
                       const Body* bodies, Motion* motions, float dt_ratio) {
  const Body &body_a = bodies[kJointA[index]], &body_b = bodies[kJointB[index]];
  Motion &a = motions[kJointA[index]], &b = motions[kJointB[index]];
  JointRows& rows = solver.joints[index];
  const Vec2 ra = mul(a.q, joint.anchor_a - body_a.sweep.local_center);
  const Vec2 rb = mul(b.q, joint.anchor_b - body_b.sweep.local_center);
  const float ma = body_a.inverse_mass, mb = body_b.inverse_mass;
  const float ia = body_a.inverse_inertia, ib = body_b.inverse_inertia;

  const float k11 = ma + mb + ra.y * ra.y * ia + rb.y * rb.y * ib;
  const float k12 = -ra.y * ra.x * ia - rb.y * rb.x * ib;
  const float k13 = -ra.y * ia - rb.y * ib;
  const float k22 = ma + mb + ra.x * ra.x * ia + rb.x * rb.x * ib;
  const float k23 = ra.x * ia + rb.x * ib;
  const float k33 = ia + ib;
  float motor_mass = k33;
  if (motor_mass > 0.0f) motor_mass = 1.0f / motor_mass;

  const float angle = b.a - a.a - joint.reference_angle;
  LimitState limit = angle <= joint.lower   ? kAtLower
                     : angle >= joint.upper ? kAtUpper
                                            : kInactive;
  if (limit != joint.limit || limit == kInactive) joint.impulse_z = 0.0f;
  joint.limit = limit;

  joint.impulse_x *= dt_ratio;
  joint.impulse_y *= dt_ratio;
  joint.impulse_z *= dt_ratio;
  joint.motor_impulse *= dt_ratio;
  const Vec2 p = {joint.impulse_x, joint.impulse_y};
  a.v = a.v - ma * p;
  a.w -= ia * (cross(ra, p) + joint.motor_impulse + joint.impulse_z);
  b.v = b.v + mb * p;
  b.w += ib * (cross(rb, p) + joint.motor_impulse + joint.impulse_z);

  float det22 = k11 * k22 - k12 * k12;
  if (det22 != 0.0f) det22 = 1.0f / det22;
  const float c1 = k22 * k33 - k23 * k23, c2 = k23 * k13 - k12 * k33, c3 = k12 * k23 - k22 * k13;
  float det33 = k11 * c1 + k12 * c2 + k13 * c3;
  if (det33 != 0.0f) det33 = 1.0f / det33;

  rows.rax.lane[lane] = ra.x;
  rows.ray.lane[lane] = ra.y;
  rows.rbx.lane[lane] = rb.x;
  rows.rby.lane[lane] = rb.y;
  rows.ma.lane[lane] = ma;
  rows.mb.lane[lane] = mb;
  rows.ia.lane[lane] = ia;
  rows.ib.lane[lane] = ib;
  rows.k11.lane[lane] = k11;
  rows.k12.lane[lane] = k12;
  rows.k13.lane[lane] = k13;
  rows.k22.lane[lane] = k22;
  rows.k23.lane[lane] = k23;
  rows.inverse_det22.lane[lane] = det22;
  rows.minus_inverse_det33.lane[lane] = -det33;
  rows.c1.lane[lane] = c1;
  rows.c2.lane[lane] = c2;
  rows.c3.lane[lane] = c3;
  rows.motor_mass.lane[lane] = motor_mass;
  rows.motor_speed.lane[lane] = joint.motor_speed;
  rows.max_motor_impulse.lane[lane] = kTimeStep * joint.max_torque;
  rows.x.lane[lane] = joint.impulse_x;
  rows.y.lane[lane] = joint.impulse_y;
  rows.z.lane[lane] = joint.impulse_z;
  rows.motor.lane[lane] = joint.motor_impulse;
  rows.lower.set(lane, limit == kAtLower);
  rows.upper.set(lane, limit == kAtUpper);
}

inline void store_joint(const VelocitySolver& solver, int lane, int index, Joint& joint) {
  const JointRows& rows = solver.joints[index];
  joint.impulse_x = rows.x.lane[lane];
  joint.impulse_y = rows.y.lane[lane];
  joint.impulse_z = rows.z.lane[lane];
  joint.motor_impulse = rows.motor.lane[lane];
}

}  // namespace ENGINE::walker
