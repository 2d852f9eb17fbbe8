// Position correction: non-linear Gauss-Seidel on overlaps and joint errors, until they are small
// (SolvePositionConstraints of b2ContactSolver and b2RevoluteJoint).
#pragma once

#include "walker/box2d/constraints.h"

namespace ENGINE::walker {

// Cuts iterations short without changing their result. An iteration is a function of the state
// alone, so once a state comes back, the rest of the iterations goes round in the same cycle (often
// of length one) and only the last, partial round is left to do. Brent's way of finding cycles: the
// state is compared with one mark, which moves on after 1, 2, 4, ... iterations.
template <int kCapacity>
class CycleWatch {
 public:
  // `end`: number of iterations to do in all.
  CycleWatch(int end, int size) : end_(end), size_(size) {}

  int end() const { return end_; }

  // To be called with the state after each iteration, `done` of them so far. A state that a loop
  // starts from need not be shown.
  void watch(const float* state, int done) {
    if (last_round_) return;
    bool back = marked_ > 0;
    for (int i = 0; back && i < size_; ++i) back = state[i] == mark_[i];
    if (back) {
      end_ = done + (end_ - done) % (done - marked_);
      last_round_ = true;
    } else if (done == next_) {
      for (int i = 0; i < size_; ++i) mark_[i] = state[i];
      marked_ = done;
      next_ = 2 * done;
    }
  }

 private:
  int end_, size_;
  int marked_ = 0, next_ = 1;
  bool last_round_ = false;
  float mark_[kCapacity];
};

// One contact; returns the smallest separation of its points, m. `count` are the points of the
// manifold, also where the velocity solver used only one.
inline float correct_contact(const Contact& contact, const Body& body, Motion& motion,
                             float baumgarte) {
  const Manifold& manifold = contact.manifold;
  float smallest = 0.0f;
  for (int i = 0; i < manifold.count; ++i) {
    // b2PositionSolverManifold.
    Transform xf;
    xf.q = motion.q;
    xf.p = motion.c - mul(xf.q, body.sweep.local_center);
    Vec2 normal, point;
    float separation;
    if (manifold.face_a) {
      normal = manifold.normal;
      point = mul(xf, manifold.points[i].local);
      separation = dot(point - manifold.point, normal) - kSkin - kSkin;
    } else {
      normal = mul(xf.q, manifold.normal);
      Vec2 plane = mul(xf, manifold.point);
      point = manifold.points[i].local;
      separation = dot(point - plane, normal) - kSkin - kSkin;
      normal = -normal;
    }
    smallest = minimum(smallest, separation);
    float error =
        clamp(baumgarte * (separation + kLinearSlop), -kMaxLinearCorrection, 0.0f);
    if (error == 0.0f) continue;  // nothing to correct
    Vec2 r = point - motion.c;
    float rn = cross(r, normal);
    float k = body.inverse_mass + body.inverse_inertia * rn * rn;
    float impulse = k > 0.0f ? -error / k : 0.0f;
    Vec2 p = impulse * normal;
    motion.c = motion.c + body.inverse_mass * p;
    motion.turn_to(motion.a + body.inverse_inertia * cross(r, p));
  }
  return smallest;
}

// One joint; returns whether its error is small.
inline bool correct_joint(const Joint& joint, const Body& body_a, const Body& body_b, Motion& a,
                          Motion& b) {
  const float ma = body_a.inverse_mass, mb = body_b.inverse_mass;
  const float ia = body_a.inverse_inertia, ib = body_b.inverse_inertia;
  float angular_error = 0.0f;
  if (joint.limit != kInactive) {
    float angle = b.a - a.a - joint.reference_angle;
    float c;
    if (joint.limit == kAtLower) {
      c = angle - joint.lower;
      angular_error = -c;
      c = clamp(c + kAngularSlop, -kMaxAngularCorrection, 0.0f);
    } else {
      c = angle - joint.upper;
      angular_error = c;
      c = clamp(c - kAngularSlop, 0.0f, kMaxAngularCorrection);
    }
    if (c != 0.0f) {
      float mass = ia + ib;
      if (mass > 0.0f) mass = 1.0f / mass;
      float impulse = -mass * c;
      a.turn_to(a.a - ia * impulse);
      b.turn_to(b.a + ib * impulse);
    }
  }
  Vec2 ra = mul(a.q, joint.anchor_a - body_a.sweep.local_center);
  Vec2 rb = mul(b.q, joint.anchor_b - body_b.sweep.local_center);
  Vec2 error = b.c + rb - a.c - ra;
  float position_error = length(error);
  float k11 = ma + mb + ia * ra.y * ra.y + ib * rb.y * rb.y;
  float k12 = -ia * ra.x * ra.y - ib * rb.x * rb.y;
  float k22 = ma + mb + ia * ra.x * ra.x + ib * rb.x * rb.x;
  float det = k11 * k22 - k12 * k12;
  if (det != 0.0f) det = 1.0f / det;
  Vec2 impulse = {-(det * (k22 * error.x - k12 * error.y)),
                  -(det * (k11 * error.y - k12 * error.x))};
  a.c = a.c - ma * impulse;
  a.turn_to(a.a - ia * cross(ra, impulse));
  b.c = b.c + mb * impulse;
  b.turn_to(b.a + ib * cross(rb, impulse));
  return position_error <= kLinearSlop && angular_error <= kAngularSlop;
}

// b2Island::Solve and SolveTOI: positions after the velocities are known, limited per step.
inline void integrate(Motion& motion, float dt) {
  Vec2 translation = dt * motion.v;
  if (dot(translation, translation) > kMaxTranslation * kMaxTranslation) {
    float ratio = kMaxTranslation / length(translation);
    motion.v = ratio * motion.v;
  }
  float turn = dt * motion.w;
  if (turn * turn > kMaxRotation * kMaxRotation) {
    float ratio = kMaxRotation / absolute(turn);
    motion.w *= ratio;
  }
  motion.c = motion.c + dt * motion.v;
  motion.turn_to(motion.a + dt * motion.w);
}

}  // namespace ENGINE::walker
