// Integration and position correction: non-linear Gauss-Seidel on overlaps and joint errors, until
// they are small (SolvePositionConstraints of b2ContactSolver and b2RevoluteJoint).
//
// Like the velocity solver it runs on many worlds, one in each lane. Most steps need one iteration
// or two, and nearly all others go on to the last: two are made for all worlds, and those that need
// more wait until they fill a vector of their own. In the functions below, F is a vector of lanes,
// or a float where continuous collision corrects a single body.
#pragma once

#include "common/sincos.h"
#include "walker/box2d/constraints.h"

namespace ENGINE::walker {

// Where a body is.
template <class F>
struct Place {
  F x, y;     // centre of mass, m
  F a, s, c;  // angle, its sine and cosine
};

// What else the corrections need of a body,
template <class F>
struct BodyTerms {
  F m, i;                // inverse mass and inertia
  F center_x, center_y;  // m, centre of mass in its frame
};

// of a joint,
template <class F>
struct JointTerms {
  F ax, ay, bx, by;  // m, centres of mass to the anchors, in the bodies' frames
  F reference, lower, upper;
  F at_lower, at_upper;  // 1: the joint is at this limit
};

// and of a contact (b2ContactPositionConstraint).
template <class F>
struct OverlapTerms {
  F nx, ny, px, py;  // normal and a point of the face, in its own shape's frame
  F x[2], y[2];      // the points, in the other shape's frame
  F face_a;          // 1: the face is the terrain's
  F count;           // of the points, also where the velocity solver used only one; 0: no contact
};

inline OverlapTerms<float> overlap_terms(const Manifold& m) {
  const Vec2 p = m.points[0].local, q = m.points[1].local;
  return {m.normal.x, m.normal.y, m.point.x,       m.point.y,
          {p.x, q.x}, {p.y, q.y}, float(m.face_a), float(m.count)};
}
inline BodyTerms<float> body_terms(const Body& body) {
  const Vec2 center = body.sweep.local_center;
  return {body.inverse_mass, body.inverse_inertia, center.x, center.y};
}

inline JointTerms<float> joint_terms(const Joint& joint, const Body& body_a, const Body& body_b) {
  const Vec2 a = joint.anchor_a - body_a.sweep.local_center;
  const Vec2 b = joint.anchor_b - body_b.sweep.local_center;
  const float at_lower = joint.limit == kAtLower, at_upper = joint.limit == kAtUpper;
  return {a.x, a.y, b.x, b.y, joint.reference_angle, joint.lower, joint.upper, at_lower, at_upper};
}

// Moves or turns a body in these lanes only.
template <class F, class M>
inline void move(Place<F>& at, F x, F y, M lanes) {
  at.x = select(lanes, x, at.x);
  at.y = select(lanes, y, at.y);
}
inline void turn(Place<float>& at, float angle, bool) {
  at.a = angle;
  sincos(angle, at.s, at.c);
}
inline void turn(Place<Vector>& at, Vector angle, Mask lanes) {
  at.a = select(lanes, angle, at.a);
  sincos(lanes, at.a, at.s, at.c);
}

// b2Island::Solve and SolveTOI: positions after the velocities are known, limited per step.
template <class F, class M>
inline void integrate(Place<F>& at, F& vx, F& vy, F& w, float dt, M lanes) {
  const F zero = {}, dx = dt * vx, dy = dt * vy, squared = dx * dx + dy * dy;
  const M far = less(zero + kMaxTranslation * kMaxTranslation, squared);
  if (any(far)) {
    const F ratio = kMaxTranslation / square_root(squared);
    vx = select(far, ratio * vx, vx);
    vy = select(far, ratio * vy, vy);
  }
  const F angle = dt * w;
  const M fast = less(zero + kMaxRotation * kMaxRotation, angle * angle);
  if (any(fast)) w = select(fast, kMaxRotation / maximum(angle, -angle) * w, w);
  move(at, at.x + dt * vx, at.y + dt * vy, lanes);
  turn(at, at.a + dt * w, lanes);
}

// One contact; `smallest` goes down to the smallest separation of its points, m.
template <class F, class M>
inline void correct_contact(const OverlapTerms<F>& contact, const BodyTerms<F>& body, Place<F>& at,
                            float baumgarte, M lanes, F& smallest) {
  const F zero = {};
  const M face_a = less(zero, contact.face_a);
  for (int k = 0; k < 2; ++k) {
    const M used = both(lanes, less(zero + float(k), contact.count));
    if (!any(used)) return;
    // b2PositionSolverManifold. The body's origin; then the point that moves with the body, of the
    // contact or of the face, in the world's frame.
    const F origin_x = at.x - (at.c * body.center_x - at.s * body.center_y);
    const F origin_y = at.y - (at.s * body.center_x + at.c * body.center_y);
    const F local_x = select(face_a, contact.x[k], contact.px);
    const F local_y = select(face_a, contact.y[k], contact.py);
    const F moving_x = (at.c * local_x - at.s * local_y) + origin_x;
    const F moving_y = (at.s * local_x + at.c * local_y) + origin_y;
    const F point_x = select(face_a, moving_x, contact.x[k]);
    const F point_y = select(face_a, moving_y, contact.y[k]);
    const F plane_x = select(face_a, contact.px, moving_x);
    const F plane_y = select(face_a, contact.py, moving_y);
    F nx = select(face_a, contact.nx, at.c * contact.nx - at.s * contact.ny);
    F ny = select(face_a, contact.ny, at.s * contact.nx + at.c * contact.ny);
    const F separation = (point_x - plane_x) * nx + (point_y - plane_y) * ny - kSkin - kSkin;
    nx = select(face_a, nx, -nx);
    ny = select(face_a, ny, -ny);
    smallest = select(used, minimum(smallest, separation), smallest);

    const F error =
        clamp(baumgarte * (separation + kLinearSlop), zero - kMaxLinearCorrection, zero);
    const M corrected = both(used, less(error, zero));
    if (!any(corrected)) continue;
    const F rx = point_x - at.x, ry = point_y - at.y;
    const F rn = rx * ny - ry * nx;
    const F impulse = -error / (body.m + body.i * rn * rn);
    const F x = impulse * nx, y = impulse * ny;
    move(at, at.x + body.m * x, at.y + body.m * y, corrected);
    turn(at, at.a + body.i * (rx * y - ry * x), corrected);
  }
}

// One joint; the lanes in which its errors are small.
inline Mask correct_joint(const JointTerms<Vector>& joint, const BodyTerms<Vector>& body_a,
                          const BodyTerms<Vector>& body_b, Place<Vector>& a, Place<Vector>& b,
                          Mask lanes) {
  const Vector zero = {}, one = zero + 1.0f;
  const Vector ma = body_a.m, mb = body_b.m, ia = body_a.i, ib = body_b.i;
  const Mask lower = less(zero, joint.at_lower), upper = less(zero, joint.at_upper);
  Vector angular_error = zero;
  if (any(either(lower, upper))) {
    const Vector angle = b.a - a.a - joint.reference;
    const Vector below = angle - joint.lower, above = angle - joint.upper;
    angular_error = select(lower, -below, select(upper, above, zero));
    const Vector most = zero + kMaxAngularCorrection;
    const Vector c = select(lower, clamp(below + kAngularSlop, -most, zero),
                            select(upper, clamp(above - kAngularSlop, zero, most), zero));
    const Mask turned = both(lanes, either(less(c, zero), less(zero, c)));
    if (any(turned)) {
      const Vector impulse = -(one / (ia + ib)) * c;
      turn(a, a.a - ia * impulse, turned);
      turn(b, b.a + ib * impulse, turned);
    }
  }
  const Vector rax = a.c * joint.ax - a.s * joint.ay, ray = a.s * joint.ax + a.c * joint.ay;
  const Vector rbx = b.c * joint.bx - b.s * joint.by, rby = b.s * joint.bx + b.c * joint.by;
  const Vector ex = b.x + rbx - a.x - rax, ey = b.y + rby - a.y - ray;
  const Vector position_error = square_root(ex * ex + ey * ey);
  const Vector k11 = ma + mb + ia * ray * ray + ib * rby * rby;
  const Vector k12 = -ia * rax * ray - ib * rbx * rby;
  const Vector k22 = ma + mb + ia * rax * rax + ib * rbx * rbx;
  Vector det = k11 * k22 - k12 * k12;
  det = select(either(less(det, zero), less(zero, det)), one / det, det);
  const Vector x = -(det * (k22 * ex - k12 * ey)), y = -(det * (k11 * ey - k12 * ex));
  move(a, a.x - ma * x, a.y - ma * y, lanes);
  turn(a, a.a - ia * (rax * y - ray * x), lanes);
  move(b, b.x + mb * x, b.y + mb * y, lanes);
  turn(b, b.a + ib * (rbx * y - rby * x), lanes);
  return both(at_least(zero + kLinearSlop, position_error),
              at_least(zero + kAngularSlop, angular_error));
}

// What they need of a world beside its contacts.
template <class F>
struct IslandTerms {
  Place<F> places[kBodies];
  BodyTerms<F> bodies[kBodies];
  JointTerms<F> joints[kJoints];
};

// As many worlds as there are lanes in a vector.
struct PositionChunk {
  IslandTerms<Vector> terms;
  OverlapTerms<Vector> contacts[kBodies][kMaxTouching];
  int32_t contact_count[kBodies];  // of the lane that has most
  Mask open;                       // lanes whose errors are not small yet

  void add_contact(int lane, int body, int slot, const OverlapTerms<float>& contact) {
    OverlapTerms<Vector>& to = contacts[body][slot];
    if (slot == contact_count[body]) {
      ++contact_count[body];
      to.count = Vector{};
    }
    scatter(&to, lane, contact);
  }

  // Takes a world over from another chunk.
  void take(int lane, const PositionChunk& from, int from_lane) {
    scatter(&terms, lane, gather(&from.terms, from_lane));
    for (int b = 0; b < kBodies; ++b)
      for (int k = 0; k < from.contact_count[b]; ++k) {
        const OverlapTerms<float> contact = gather(&from.contacts[b][k], from_lane);
        if (contact.count == 0.0f) break;
        add_contact(lane, b, k, contact);
      }
  }

  // At most so many iterations; where the errors are small, a world stays as it is.
  void correct(int iterations) {
    for (int i = 0; i < iterations && any(open); ++i) {
      Vector smallest = {};
      for (int b : kIslandBodies)
        for (int k = 0; k < contact_count[b]; ++k)
          correct_contact(contacts[b][k], terms.bodies[b], terms.places[b], kBaumgarte, open,
                          smallest);
      Mask good = at_least(smallest, Vector{} + -3.0f * kLinearSlop);
      for (int j : kIslandJoints) {
        const int a = kJointA[j], b = kJointB[j];
        good = both(good, correct_joint(terms.joints[j], terms.bodies[a], terms.bodies[b],
                                        terms.places[a], terms.places[b], open));
      }
      open = but_not(open, good);
    }
  }

  void clear() {
    for (int& count : contact_count) count = 0;
  }
};

class PositionSolver {
 public:
  // Puts a world into a lane, in the order of the lanes; first its contacts, those of a body in
  // their order.
  void begin_load(int lane) {
    if (lane % kWidth == 0) chunk(lane).clear();
  }
  void load(int lane, const IslandTerms<float>& terms) {
    scatter(&chunk(lane).terms, lane % kWidth, terms);
  }
  void load_contact(int lane, int body, int slot, const Manifold& manifold) {
    chunk(lane).add_contact(lane % kWidth, body, slot, overlap_terms(manifold));
  }

  // b2Island::Solve after the velocity iterations, for the first `lanes` lanes: some of the
  // position iterations.
  void solve(VelocitySolver& velocities, int lanes) {
    for (int first = 0; first < lanes; first += kWidth) {
      const int c = first / kWidth;
      PositionChunk& chunk = chunks_[c];
      chunk.open = first_lanes(lanes - first);
      for (int b = 0; b < kBodies; ++b)
        integrate(chunk.terms.places[b], velocities.vx[b].chunk[c], velocities.vy[b].chunk[c],
                  velocities.w[b].chunk[c], kTimeStep, chunk.open);
      chunk.correct(kFirstIterations);
    }
  }
  // The other iterations of the first `count` lanes from kLanes on.
  void solve_rest(int count) {
    PositionChunk& rest = chunk(kLanes);
    rest.open = first_lanes(count);
    rest.correct(kPositionIterations - kFirstIterations);
    rest.clear();
  }
  // Moves a world to a lane from kLanes on.
  void move(int from, int to) { chunk(to).take(to % kWidth, chunk(from), from % kWidth); }

  // Where a world's bodies are, and whether its errors became small.
  Place<float> place(int lane, int body) const {
    return gather(&chunks_[lane / kWidth].terms.places[body], lane % kWidth);
  }
  bool solved(int lane) const {
    return !(lane_bits(chunks_[lane / kWidth].open) >> lane % kWidth & 1);
  }

 private:
  static constexpr int kFirstIterations = 2;
  PositionChunk chunks_[kChunks + 1];  // the last one for worlds that need more iterations

  PositionChunk& chunk(int lane) { return chunks_[lane / kWidth]; }
};

}  // namespace ENGINE::walker
