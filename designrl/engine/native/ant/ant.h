// The ant's task: start of an episode, a step, observation and reward (designrl/envs/ant.py), in
// the arithmetic of Python's floats.
//
// The files, in the order of a step:
//   constants             numbers of the task
//   scene                 what bullet/ has to know of it: the body, the floor, the time step
//   bullet/               its physics, as many ants side by side as a vector has lanes
//     settings            numbers of Bullet
//     math3d              vectors, matrices, quaternions
//     body                masses and inertias of a design
//     kinematics          where the parts are
//     manifold, narrow_phase
//                         contact points with the floor, and which of them are kept
//     articulated         Featherstone's algorithm: forces to accelerations
//     constraints         contacts and joint limits made ready
//     constraint_solver   their impulses
//     world               a step as a whole
//   ant                   the task as a whole
//
// bullet/ follows Bullet 3 operation by operation (Erwin Coumans and others, bulletphysics.org,
// zlib licence; this is an altered version, written anew for this one body), as PyBullet's wheel
// computes it: in double precision, without fused multiply-adds, with sine and cosine of the C
// library (common/elementary.h). What has no effect here is left out: warm starting, sleeping,
// islands, split impulses, motors, the broad phase.
#pragma once

#include "ant/bullet/world.h"
#include "ant/constants.h"
#include "common/stepping.h"

namespace ENGINE::ant {

constexpr char kFlagNames[] = "";

// Python calls them one by one. Inlined, GCC would make one sincos of two calls for the same angle,
// and nobody promises that it has their bits.
__attribute__((noinline)) inline double sine_alone(double a) { return sine(a); }
__attribute__((noinline)) inline double cosine_alone(double a) { return cosine(a); }

// math.hypot, which differs from the C library's: with the rounding errors of the squares and of
// their sum (Dekker 1971), the root is corrected to the nearest number.
inline double hypotenuse(double x, double y) {
  // Of the square's rounding, exactly.
  auto square_error = [](double a, double square) {
    const double t = a * 134217729.0, high = t - (t - a), low = a - high;
    return ((high * high - square) + 2.0 * high * low) + low * low;
  };
  const double xx = x * x, yy = y * y, sum = xx + yy;
  const double more = xx > yy ? xx : yy, less = xx > yy ? yy : xx;
  const double error = ((more - sum) + less) + (square_error(x, xx) + square_error(y, yy));
  const double root = sqrt(sum), square = root * root;
  return root + (((sum - square) - square_error(root, square)) + error) / (2.0 * root);
}

// btMatrix3x3::getRotation: a quaternion x, y, z, w.
template <class F>
inline void get_rotation(const Mat3<F>& m, F* q) {
  const F e[3][3] = {{m.row[0].x, m.row[0].y, m.row[0].z},
                          {m.row[1].x, m.row[1].y, m.row[1].z},
                          {m.row[2].x, m.row[2].y, m.row[2].z}};
  const F trace = e[0][0] + e[1][1] + e[2][2];
  if (trace > F(0)) {
    const F root = F(sqrt(double(trace + F(1)))), s = F(0.5) / root;
    q[3] = root * F(0.5);
    q[0] = (e[2][1] - e[1][2]) * s;
    q[1] = (e[0][2] - e[2][0]) * s;
    q[2] = (e[1][0] - e[0][1]) * s;
  } else {
    const int i = e[0][0] < e[1][1] ? (e[1][1] < e[2][2] ? 2 : 1) : (e[0][0] < e[2][2] ? 2 : 0);
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    const F root = F(sqrt(double(e[i][i] - e[j][j] - e[k][k] + F(1)))), s = F(0.5) / root;
    q[i] = root * F(0.5);
    q[3] = (e[k][j] - e[j][k]) * s;
    q[j] = (e[j][i] + e[i][j]) * s;
    q[k] = (e[k][i] + e[i][k]) * s;
  }
}

// b3Matrix3x3::setRotation.
inline Mat3<float> turned_by(const float* q) {
  const float x = q[0], y = q[1], z = q[2], w = q[3], s = 2.0f / (x * x + y * y + z * z + w * w);
  const float xs = x * s, ys = y * s, zs = z * s;
  const float wx = w * xs, wy = w * ys, wz = w * zs, xx = x * xs, xy = x * ys, xz = x * zs;
  const float yy = y * ys, yz = y * zs, zz = z * zs;
  return {{{1.0f - (yy + zz), xy - wz, xz + wy},
           {xy + wz, 1.0f - (xx + zz), yz - wx},
           {xz - wy, yz + wx, 1.0f - (xx + yy)}}};
}

struct Euler {
  double roll, pitch, yaw;
};
// pybullet.getEulerFromQuaternion.
inline Euler euler(const double* q) {
  const double xx = q[0] * q[0], yy = q[1] * q[1], zz = q[2] * q[2], ww = q[3] * q[3];
  const double sine = -2 * (q[0] * q[2] - q[3] * q[1]);
  if (sine <= -0.99999) return {0.0, -0.5 * kPi, 2 * arc_tangent(q[0], -q[1])};
  if (sine >= 0.99999) return {0.0, 0.5 * kPi, 2 * arc_tangent(-q[0], q[1])};
  return {arc_tangent(2 * (q[1] * q[2] + q[3] * q[0]), ww - xx - yy + zz), arc_sine(sine),
          arc_tangent(2 * (q[0] * q[1] + q[3] * q[2]), ww + xx - yy - zz)};
}

struct Lanes : World {
  void solve(int) { step(); }  // a part of a vector takes as long as all of it
};

// The Task of common/episodes.h.
class Ant {
 public:
  static constexpr int kObservations = 28, kActions = kJoints, kDesign = kDimensions;
  static constexpr int kParts = 1 + kLegs * kLegParts;
  static constexpr int kLanes = kDoubles, kPutOff = 0, kHeld = kLanes;
  static constexpr double kSolvedReturn = HUGE_VAL, kSolvedBonus = 0.0;  // it is never solved
  static constexpr bool kStartSolves = false;
  enum Term { kAlive, kProgress, kElectricity, kStall, kJointLimits, kFootCollision, kTerms };
  // The paper's, and the one of the published original ant; the last input is the time.
  using Networks =
      FixedNetworks<FixedNetwork<Output::kTanh, kObservations + 1, 64, 32, kActions>,
                    FixedNetwork<Output::kLinear, kObservations + 1, 140, 40, kActions>>;
  using Solver = Lanes;

  // Ant.reset. scales: (36,) of the design.
  void reset(Generator& random, uint32_t, const double* scales) {
    for (double& angle : start_angles_) angle = random.uniform(-kStartAngle, kStartAngle);
    build(scales);
    for (bool& touches : foot_contact_) touches = false;
    failed_ = false;
  }

  // Another body within an episode: World::change_body. Rewards go on; what it moves is no progress.
  void change_body(Lanes& lanes, const double* scales) {
    build(scales);
    lanes.change_body(lane_, body_);
    store(lanes, lane_);
    float unused[kObservations];
    observe(unused);  // the distance to the target
  }

  // action: null in the round after reset, in which the ant is put into its lane.
  void begin_step(const double* action) {
    starts_ = !action;
    if (starts_) return;
    for (int j = 0; j < kJoints; ++j) {
      action_[j] = action[j];
      if (!__builtin_isfinite(action_[j])) {  // the environment refuses it
        failed_ = true;
        action_[j] = 0.0;
      }
    }
  }
  uint32_t order() const { return 0; }
  // An ant keeps the lane that it is given first: its world stays there.
  void load(Lanes& lanes, int lane) {
    if (!has_lane_) lane_ = lane;
    has_lane_ = true;
    if (starts_) return;
    for (int j = 0; j < kJoints; ++j) {
      const double a = action_[j] > -1.0 ? action_[j] : -1.0;
      lanes.torque[j][lane_] = kMotorTorque * (a < 1.0 ? a : 1.0);
    }
  }
  void store(Lanes& lanes, int) {
    if (starts_) lanes.place(lane_, body_, start_angles_);
    const int l = lane_;
    const State& state = lanes.state;
    height_ = state.position.z[l];
    torso_ = lane_of(lanes.parts.torso, l);
    shown_torso_ = lane_of(lanes.shown_torso, l);
    for (int i = 0; i < 3; ++i) velocity_[i] = state.velocity[3 + i][l];
    for (int j = 0; j < kJoints; ++j) {
      angle_[j] = state.angle[j][l];
      speed_[j] = state.velocity[6 + j][l];
    }
    for (int leg = 0; leg < kLegs; ++leg) {
      for (int k = 0; k < kLegParts; ++k) {
        x_[leg][k] = lanes.shown_origin[leg][k].x[l];
        y_[leg][k] = lanes.shown_origin[leg][k].y[l];
      }
      touches_[leg] = lanes.contacts.legs[leg][kBottom].count[l] > 0.0;
    }
  }
  void finish_step(uint32_t, Outcome<Ant>& outcome) {
    const double distance = distance_;
    observe(outcome.observation);
    // Seen one step later.
    for (int leg = 0; leg < kLegs; ++leg) foot_contact_[leg] = touches_[leg];

    double power = 0.0, effort = 0.0;
    for (int j = 0; j < kJoints; ++j) {
      power += fabs(action_[j] * speed_[j]);
      effort += action_[j] * action_[j];
    }
    const bool alive = height_ > kFallenHeight;
    double* terms = outcome.terms;
    terms[kAlive] = alive ? 1.0 : -1.0;
    terms[kProgress] = (distance - distance_) / kTimeStep;
    terms[kElectricity] = kElectricityCost * kJointSpeedScale * power / kJoints;
    terms[kStall] = kStallCost * effort / kJoints;
    terms[kJointLimits] = kJointLimitCost * joints_at_limit_;
    terms[kFootCollision] = kFootCollisionCost * 0;  // the parts pass through each other
    outcome.reward = 0.0;
    for (int t = 0; t < kTerms; ++t) outcome.reward += terms[t];
    outcome.terminated = !alive;
    outcome.fell = false;  // what a fall costs is a reward like others
  }
  bool failed() const { return failed_; }

  // Ant.body_poses, from its lane.
  void poses(const Lanes& lanes, double* to) const {
    const Kinematics& parts = lanes.parts;
    to[0] = lanes.state.position.x[lane_];
    to[1] = lanes.state.position.y[lane_];
    to[2] = lanes.state.position.z[lane_];
    get_rotation(lane_of(parts.torso, lane_), to + 3);
    for (int leg = 0; leg < kLegs; ++leg)
      for (int k = 0; k < kLegParts; ++k) {
        const Vec3<double> centre = lane_of(parts.origin[leg][k], lane_);
        write_part(centre, lane_of(parts.rotation(leg, k), lane_), body_.legs[leg][k].arm, to += 7);
      }
  }

  // What a picture shows beside the poses.
  bool touches(int leg) const { return foot_contact_[leg]; }  // its foot, the floor
  double effort() const {  // of the motors' full torques, summed
    double sum = 0.0;
    for (double a : action_) sum += fabs(a) < 1.0 ? fabs(a) : 1.0;
    return sum;
  }

  static constexpr size_t kLaneBytes = sizeof(WorldState) / kDoubles;
  void save_lane(const Lanes& lanes, char* to) const { lanes.save(lane_, to); }
  void restore_lane(Lanes& lanes, int lane, const char* from) {
    lane_ = lane;
    has_lane_ = true;
    lanes.restore(lane_, from);
  }

 private:
  Body<double> body_;
  double start_angles_[kJoints];
  double others_x_, others_y_;  // m, from the first top part to all of them, summed
  bool starts_, failed_, has_lane_;
  int lane_;
  double action_[kJoints];
  bool foot_contact_[kLegs];  // in the step before
  double distance_;           // m, to the target
  int joints_at_limit_;
  // Of the lane, after the step.
  Mat3<double> torso_, shown_torso_;
  double height_, velocity_[3], angle_[kJoints], speed_[kJoints];
  double x_[kLegs][kLegParts], y_[kLegs][kLegParts];  // m, of the parts
  bool touches_[kLegs];                               // the feet, the floor

  // b3GetLinkState: from its centre's pose, a part's frame is found in single precision.
  static void write_part(const Vec3<double>& centre, const Mat3<double>& turn,
                         const Vec3<double>& arm, double* to) {
    double rotation[4];
    float q[4];
    get_rotation(turn, rotation);
    for (int i = 0; i < 4; ++i) q[i] = float(rotation[i]);
    // The products with the identity, which is how the parts sit in their frames, tell 0 and -0.
    const Mat3<float> identity = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
    Mat3<float> turned = turned_by(q);
    const Vec3<float> arm32 = {float(arm.x), float(arm.y), float(arm.z)};
    const Vec3<float> moved = turned * (identity * Vec3<float>{-arm32.x, -arm32.y, -arm32.z});
    for (Vec3<float>& row : turned.row) row = transposed_times(identity, row);
    to[0] = moved.x + float(centre.x);
    to[1] = moved.y + float(centre.y);
    to[2] = moved.z + float(centre.z);
    get_rotation(turned, q);
    for (int i = 0; i < 4; ++i) to[3 + i] = q[i];
  }

  void build(const double* scales) {
    body_.torso = make_torso();
    double top_x = 0.0, top_y = 0.0;
    others_x_ = others_y_ = 0.0;
    for (int leg = 0; leg < kLegs; ++leg, scales += kLegDimensions) {
      double ends[kLegParts][2];
      for (int k = 0; k < kLegParts; ++k) {
        for (int i = 0; i < 2; ++i)
          ends[k][i] = kLegSigns[leg][i] * kLengths[k] * scales[2 * k + i];
        body_.legs[leg][k] = make_capsule(ends[k][0], ends[k][1], kRadius * scales[6 + k]);
      }
      const double x = ends[kTop][0] / 2, y = ends[kTop][1] / 2;
      if (leg == 0) {
        top_x = x;
        top_y = y;
      }
      others_x_ += x - top_x;
      others_y_ += y - top_y;
    }
  }

  // Ant._observe.
  void observe(float* observation) {
    double q[4];
    get_rotation(torso_, q);
    const Euler turned = euler(q);
    get_rotation(shown_torso_, q);
    const double i = q[0], j = q[1], k = q[2], w = q[3];
    double x = 4 * x_[0][kTop] + (1 - 2 * (j * j + k * k)) * others_x_ +
               2 * (i * j - k * w) * others_y_;
    double y = 4 * y_[0][kTop] + 2 * (i * j + k * w) * others_x_ +
               (1 - 2 * (i * i + k * k)) * others_y_;
    for (int leg = 0; leg < kLegs; ++leg) {
      x += 3 * x_[leg][kMiddle] + x_[leg][kBottom];
      y += 3 * y_[leg][kMiddle] + y_[leg][kBottom];
    }
    const double ahead = kTargetX - x / kLinks, aside = y / kLinks;
    distance_ = hypotenuse(ahead, aside);
    const double angle = arc_tangent(-aside, ahead) - turned.yaw;
    const double c = cosine_alone(turned.yaw), s = sine_alone(turned.yaw);
    const double vx = velocity_[0], vy = velocity_[1], vz = velocity_[2];
    double values[kObservations] = {height_ - kTorsoHeight,
                                    sine_alone(angle),
                                    cosine_alone(angle),
                                    kSpeedScale * (c * vx + s * vy),
                                    kSpeedScale * (c * vy - s * vx),
                                    kSpeedScale * vz,
                                    turned.roll,
                                    turned.pitch};
    joints_at_limit_ = 0;
    for (int n = 0; n < kJoints; ++n) {
      const double middle = (kLower[n] + kUpper[n]) / 2, scale = 2 / (kUpper[n] - kLower[n]);
      const double position = (angle_[n] - middle) * scale;
      if (!(-kJointLimit <= position && position <= kJointLimit)) ++joints_at_limit_;
      values[8 + 2 * n] = position;
      values[9 + 2 * n] = kJointSpeedScale * speed_[n];
    }
    for (int leg = 0; leg < kLegs; ++leg) values[24 + leg] = foot_contact_[leg];
    for (int n = 0; n < kObservations; ++n) {
      float value = float(values[n]);
      value = value > -kObservationLimit ? value : -kObservationLimit;
      observation[n] = value < kObservationLimit ? value : kObservationLimit;
    }
  }
};

}  // namespace ENGINE::ant
