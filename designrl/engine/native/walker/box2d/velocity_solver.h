// The velocity solver: 180 sweeps over joints and contacts (b2RevoluteJoint, b2ContactSolver).
//
// Nearly all of a step's time is spent here, so it runs on many worlds at once: every quantity is
// an array over lanes, one world per lane, and the loops below compute whole vectors of lanes.
// Each lane performs Box2D's operations in Box2D's order, so its bits do not depend on the vector
// width nor on what the other lanes hold. Where Box2D branches, both results are computed and the
// lane's own is selected.
//
// Contacts are stored per body, in the order of the island's bodies (see scene.h), which is the
// order in which Box2D meets them. The terrain has infinite mass and no velocity: its terms are
// zero and left out. Restitution is zero, and with it the velocity bias.
#pragma once

#include "common/lanes.h"
#include "walker/box2d/world.h"

namespace ENGINE::walker {

struct JointRows {
  Row rax, ray, rbx, rby;              // m, centres of mass to the anchors
  Row ma, mb, ia, ib;                  // inverse masses and inertias
  Row k11, k12, k13, k22, k23;         // effective mass matrix
  Row inverse_det22, minus_inverse_det33;
  Row c1, c2, c3;                      // second column × third column
  Row motor_mass, motor_speed, max_motor_impulse;
  Row x, y, z, motor;                  // accumulated impulses
  MaskRow lower, upper;                // the joint is at this limit
};

// What a contact's solution needs, and what it accumulates.
template <class F>
struct ContactTerms {
  F nx, ny;    // unit normal, away from the terrain
  F friction;
  F m, i;      // inverse mass and inertia of the body
  F r1x, r1y, r2x, r2y;  // m, centre of mass to the points
  F normal_mass1, normal_mass2, tangent_mass1, tangent_mass2;
  F k11, k12, k22;                               // of the two-point block
  F inverse11, inverse12, inverse21, inverse22;  // its inverse
};
template <class F>
struct ContactImpulses {
  F normal1, normal2, tangent1, tangent2;
};

struct ContactRows {
  ContactTerms<Vector> terms[kChunks];
  ContactImpulses<Vector> impulses[kChunks];
  MaskRow two;  // the contact has two points; where the slot is not used, anything
};

struct VelocitySolver {
  Row vx[kBodies], vy[kBodies], w[kBodies];
  JointRows joints[kJoints];
  ContactRows contacts[kBodies][kMaxTouching];
  Row contact_count[kBodies];

  // For the first `lanes` lanes.
  void solve(int lanes);

 private:
  // A contact slot of a body in one chunk.
  struct Pass {
    ContactRows* rows;
    int body, chunk;
    float place;    // among all passes, from 0 to 1
    Mask one, two;  // the slot is used; with two points
  };
  Mask used(int body, int slot, int c) const {
    return less(Vector{} + float(slot), contact_count[body].chunk[c]);
  }
  int find_passes(Pass* passes, int chunks);
  template <int kUsedChunks>
  void iterate(const Pass* passes, int pass_count);
  template <int kUsedChunks>
  void solve_joint(int joint, const bool* limits);
  void solve_contact(const Pass& pass);
};

// b2RevoluteJoint::SolveVelocityConstraints. `limits`: (kUsedChunks,) some lane's joint is at one.
template <int kUsedChunks>
inline void VelocitySolver::solve_joint(int joint, const bool* limits) {
  JointRows& j = joints[joint];
  const int a = kJointA[joint], b = kJointB[joint];
  for (int c = 0; c < kUsedChunks; ++c) {
    Vector ax = vx[a].chunk[c], ay = vy[a].chunk[c], aw = w[a].chunk[c];
    Vector bx = vx[b].chunk[c], by = vy[b].chunk[c], bw = w[b].chunk[c];
    const Vector ia = j.ia.chunk[c], ib = j.ib.chunk[c];
    const Vector ma = j.ma.chunk[c], mb = j.mb.chunk[c];
    const Vector rax = j.rax.chunk[c], ray = j.ray.chunk[c];
    const Vector rbx = j.rbx.chunk[c], rby = j.rby.chunk[c];

    // Motor.
    const Vector limit = j.max_motor_impulse.chunk[c], motor_before = j.motor.chunk[c];
    const Vector motor = clamp(
        motor_before - j.motor_mass.chunk[c] * (bw - aw - j.motor_speed.chunk[c]), -limit, limit);
    j.motor.chunk[c] = motor;
    const Vector push = motor - motor_before;
    aw -= ia * push;
    bw += ib * push;

    // Point to point, together with a limit that has let go. An inactive limit has z = 0, and the
    // right-hand side is then that of the joint alone.
    const Vector z = j.z.chunk[c];
    const Vector k11 = j.k11.chunk[c], k12 = j.k12.chunk[c], k22 = j.k22.chunk[c];
    const Vector k13 = j.k13.chunk[c], k23 = j.k23.chunk[c];
    const Vector cx = bx - bw * rby - ax + aw * ray;
    const Vector cy = by + bw * rbx - ay - aw * rax;
    const Vector hx = z * k13 - cx, hy = z * k23 - cy;
    const Vector det22 = j.inverse_det22.chunk[c];
    Vector px = det22 * (k22 * hx - k12 * hy);
    Vector py = det22 * (k11 * hy - k12 * hx);
    Vector pz = {};

    if (limits[c]) {
      const Mask lower = j.lower.chunk(c), upper = j.upper.chunk(c);
      const Vector zero = {};
      const Vector cz = bw - aw;
      const Vector c1 = j.c1.chunk[c], c2 = j.c2.chunk[c], c3 = j.c3.chunk[c];
      const Vector det33 = j.minus_inverse_det33.chunk[c], k33 = ia + ib;
      // b2Mat33::Solve33 by Cramer's rule; columns (k11 k12 k13), (k12 k22 k23), (k13 k23 k33).
      const Vector x = det33 * (cx * c1 + cy * c2 + cz * c3);
      const Vector y = det33 * (k11 * (cy * k33 - cz * k23) + k12 * (cz * k13 - cx * k33) +
                                k13 * (cx * k23 - cy * k13));
      const Vector dz = det33 * (k11 * (k22 * cz - k23 * cy) + k12 * (k23 * cx - k12 * cz) +
                                 k13 * (k12 * cy - k22 * cx));
      const Vector total = z + dz;
      const Mask keeps =
          either(but_not(lower, less(total, zero)), but_not(upper, less(zero, total)));
      px = select(keeps, x, px);
      py = select(keeps, y, py);
      pz = select(keeps, dz, zero - z);
      j.z.chunk[c] = select(keeps, total, zero);
    }
    j.x.chunk[c] += px;
    j.y.chunk[c] += py;

    vx[a].chunk[c] = ax - ma * px;
    vy[a].chunk[c] = ay - ma * py;
    w[a].chunk[c] = aw - ia * (rax * py - ray * px + pz);
    vx[b].chunk[c] = bx + mb * px;
    vy[b].chunk[c] = by + mb * py;
    w[b].chunk[c] = bw + ib * (rbx * py - rby * px + pz);
  }
}

// b2ContactSolver::SolveVelocityConstraints for one contact of each lane: friction of the first
// point, then of the second, then both normal impulses. F is a vector of lanes, or a float where
// continuous collision solves a single body. `two`: the contact has a second point.
template <class F, class M>
inline void solve_contact_terms(const ContactTerms<F>& t, M two, ContactImpulses<F>& impulses,
                                F& vx, F& vy, F& w) {
  const F zero = {};
  const F tx = t.ny, ty = -t.nx;
  const F a1 = impulses.normal1, a2 = impulses.normal2;
  {
    const F dx = vx - w * t.r1y, dy = vy + w * t.r1x;
    const F vt = dx * tx + dy * ty;
    const F before = impulses.tangent1, limit = t.friction * a1;
    const F after = clamp(before - t.tangent_mass1 * vt, -limit, limit);
    impulses.tangent1 = after;
    const F lambda = after - before;
    const F px = lambda * tx, py = lambda * ty;
    vx = vx + t.m * px;
    vy = vy + t.m * py;
    w = w + t.i * (t.r1x * py - t.r1y * px);
  }
  const bool any_two = any(two);
  if (any_two) {
    const F dx = vx - w * t.r2y, dy = vy + w * t.r2x;
    const F vt = dx * tx + dy * ty;
    const F before = impulses.tangent2, limit = t.friction * a2;
    const F after = clamp(before - t.tangent_mass2 * vt, -limit, limit);
    impulses.tangent2 = select(two, after, before);
    const F lambda = after - before;
    const F px = lambda * tx, py = lambda * ty;
    vx = select(two, vx + t.m * px, vx);
    vy = select(two, vy + t.m * py, vy);
    w = select(two, w + t.i * (t.r2x * py - t.r2y * px), w);
  }

  const F d1x = vx - w * t.r1y, d1y = vy + w * t.r1x;
  const F vn1 = d1x * t.nx + d1y * t.ny;
  // One point: its accumulated impulse stays positive.
  F n1 = maximum(a1 - t.normal_mass1 * vn1, zero);
  F d1 = n1 - a1, px = d1 * t.nx, py = d1 * t.ny, turn = t.r1x * py - t.r1y * px;
  if (any_two) {
    // Two points: the first of four cases that solves the complementarity problem; in none of them,
    // the impulses stay.
    const F d2x = vx - w * t.r2y, d2y = vy + w * t.r2x;
    const F vn2 = d2x * t.nx + d2y * t.ny;
    const F b1 = vn1 - (t.k11 * a1 + t.k12 * a2), b2 = vn2 - (t.k12 * a1 + t.k22 * a2);
    const F both1 = -(t.inverse11 * b1 + t.inverse12 * b2);
    const F both2 = -(t.inverse21 * b1 + t.inverse22 * b2);
    const F only1 = -(t.normal_mass1 * b1), only2 = -(t.normal_mass2 * b2);
    const M case1 = both(at_least(both1, zero), at_least(both2, zero));
    const M case2 = both(at_least(only1, zero), at_least(t.k12 * only1 + b2, zero));
    const M case3 = both(at_least(only2, zero), at_least(t.k12 * only2 + b1, zero));
    const M case4 = both(at_least(b1, zero), at_least(b2, zero));
    F m1 = select(case4, zero, a1), m2 = select(case4, zero, a2);
    m1 = select(case3, zero, m1);
    m2 = select(case3, only2, m2);
    m1 = select(case2, only1, m1);
    m2 = select(case2, zero, m2);
    m1 = select(case1, both1, m1);
    m2 = select(case1, both2, m2);
    n1 = select(two, m1, n1);
    impulses.normal2 = select(two, m2, a2);
    d1 = m1 - a1;
    const F d2 = m2 - a2;
    const F p1x = d1 * t.nx, p1y = d1 * t.ny, p2x = d2 * t.nx, p2y = d2 * t.ny;
    px = select(two, p1x + p2x, px);
    py = select(two, p1y + p2y, py);
    turn = select(two, (t.r1x * p1y - t.r1y * p1x) + (t.r2x * p2y - t.r2y * p2x), turn);
  }
  impulses.normal1 = n1;
  vx = vx + t.m * px;
  vy = vy + t.m * py;
  w = w + t.i * turn;
}

// One contact slot of one body, in every lane of a chunk that uses it.
inline void VelocitySolver::solve_contact(const Pass& pass) {
  const int body = pass.body, c = pass.chunk;
  const Vector x = vx[body].chunk[c], y = vy[body].chunk[c], turn = w[body].chunk[c];
  Vector new_x = x, new_y = y, new_turn = turn;
  solve_contact_terms(pass.rows->terms[c], pass.two, pass.rows->impulses[c], new_x, new_y,
                      new_turn);
  vx[body].chunk[c] = select(pass.one, new_x, x);
  vy[body].chunk[c] = select(pass.one, new_y, y);
  w[body].chunk[c] = select(pass.one, new_turn, turn);
}

// The contacts of one body must be solved in their order. Those of different bodies, and chunks,
// have nothing in common: in turn, they hide each other's latencies. So the passes of a body are
// spread evenly among the others. Returns the number of passes.
inline int VelocitySolver::find_passes(Pass* passes, int chunks) {
  int count = 0;
  for (int b : kIslandBodies)
    for (int c = 0; c < chunks; ++c) {
      int slots = 0;
      while (slots < kMaxTouching && any(used(b, slots, c))) ++slots;
      for (int k = 0; k < slots; ++k) {
        ContactRows& rows = contacts[b][k];
        const Mask one = used(b, k, c);
        const float place = (float(k) + 0.5f) / float(slots);
        int at = count++;
        for (; at > 0 && passes[at - 1].place > place; --at) passes[at] = passes[at - 1];
        passes[at] = {&rows, b, c, place, one, both(one, rows.two.chunk(c))};
      }
    }
  return count;
}

template <int kUsedChunks>
inline void VelocitySolver::iterate(const Pass* passes, int pass_count) {
  bool limits[kJoints][kUsedChunks];
  for (int j = 0; j < kJoints; ++j)
    for (int c = 0; c < kUsedChunks; ++c)
      limits[j][c] = any(either(joints[j].lower.chunk(c), joints[j].upper.chunk(c)));
  for (int iteration = 0; iteration < kVelocityIterations; ++iteration) {
    for (int joint : kIslandJoints) solve_joint<kUsedChunks>(joint, limits[joint]);
    for (int i = 0; i < pass_count; ++i) solve_contact(passes[i]);
  }
}

inline void VelocitySolver::solve(int lanes) {
  for (int b = 0; b < kBodies; ++b)
    for (int l = lanes; l < kLanes; ++l) contact_count[b].lane[l] = 0.0f;
  Pass passes[kBodies * kChunks * kMaxTouching];
  const int chunks = (lanes + kWidth - 1) / kWidth;
  const int pass_count = find_passes(passes, chunks);
  static_assert(kChunks == 4, "one branch for each number of chunks in use");
  if (chunks == 1) iterate<1>(passes, pass_count);
  else if (chunks == 2) iterate<2>(passes, pass_count);
  else if (chunks == 3) iterate<3>(passes, pass_count);
  else iterate<4>(passes, pass_count);
}

}  // namespace ENGINE::walker
