// The walker's task: start of an episode, a step, observation and reward (Gymnasium's
// bipedal_walker.py, designrl/envs/walker.py).
//
// The files, in the order of a step:
//   constants             numbers of the task
//   scene                 what box2d/ has to know of it: bodies, joints, capacities
//   course                the random course of an episode
//   box2d/                its physics, which know nothing of the task but the scene
//     settings            numbers of Box2D
//     math2d, shapes, body
//                         vectors, polygons and their masses, bodies and joints
//     terrain_index, tree, narrow_phase, world
//                         broad phase, contact points, the list of contacts
//     constraints         contacts and joints made ready, and loaded into vector lanes
//     velocity_solver     the 180 velocity iterations, many worlds side by side
//     position_solver     integration and the position iterations, likewise
//     continuous          impacts within a step
//     step                b2World::Step as a whole
//   lidar                 the ten rays
//   walker                the task as a whole
#pragma once

#include "common/elementary.h"
#include "common/stepping.h"
#include "walker/box2d/step.h"
#include "walker/course.h"
#include "walker/lidar.h"

namespace ENGINE::walker {

enum Flag : uint32_t {
  kHardcore = 1,     // the course with obstacles
  kClosestHits = 2,  // LIDAR v3; v2 is the paper's
};
constexpr char kFlagNames[] = "hardcore closest_hits";  // in the order of their bits

// Directions of the LIDAR rays, computed at run time, as Python does.
struct RayDirections {
  double x[kRays], y[kRays];
  RayDirections() {
    for (int i = 0; i < kRays; ++i) {
      volatile double angle = 1.5 * i / 10.0;
      x[i] = sine(angle) * kLidarRange;
      y[i] = cosine(angle) * kLidarRange;
    }
  }
};

// The Task of common/episodes.h.
class Walker {
 public:
  static constexpr int kObservations = 24, kActions = 4, kDesign = 8;
  // Enough to fill vectors with walkers in like contact with the ground, and one with those whose
  // position errors stay.
  static constexpr int kLanes = ENGINE::kLanes, kPutOff = kWidth, kHeld = kLanes + kPutOff;
  static constexpr double kSolvedReturn = 300.0, kSolvedBonus = 100.0;  // points
  static constexpr bool kStartSolves = true;  // reset ends with a step of zero action
  enum Term { kProgress, kPosture, kEnergy, kFall, kTerms };
  using Networks =
      FixedNetworks<FixedNetwork<Output::kTanh, kObservations, 40, 40, kActions>>;
  using Solver = walker::Solver;

  // BipedalWalker.reset up to, but without, its first step. scales: (8,) of the design.
  void reset(Generator& random, uint32_t flags, const double* scales) {
    world_.clear();
    add_course(world_, random, flags & kHardcore);
    build(scales, start_force(random));
    has_shaping_ = false;
  }

  // action: null in the step that reset takes, whose action is zero.
  void begin_step(const double* action) {
    command(action);
    step_.begin(world_);
  }
  uint32_t order() const { return step_.pattern(world_); }
  void load(Solver& solver, int lane) { step_.load(world_, solver, lane); }
  void store(const Solver& solver, int lane) { step_.store(world_, solver, lane); }
  void store_solved(const Solver& solver, int lane) {
    step_.store_positions(world_, solver, lane);
  }
  void finish_step(uint32_t flags, Outcome<Walker>& outcome) {
    step_.finish(world_);
    observe(flags & kClosestHits, outcome);
  }
  bool failed() const { return world_.overflow; }

 private:
  World world_;
  Step step_;
  double energy_[kJoints], effort_;
  double shaping_, x_, tilt_;  // of the step before
  bool has_shaping_;

  // Motor commands of an action, BipedalWalker.step, in float64 as there.
  void command(const double* action) {
    effort_ = 0.0;
    for (int i = 0; i < kJoints; ++i) {
      const double a = action ? action[i] : 0.0, speed = i % 2 == 0 ? kHipSpeed : kKneeSpeed;
      const double sign = a > 0.0 ? 1.0 : a < 0.0 ? -1.0 : 0.0;
      double strength = a < 0.0 ? -a : a;
      if (strength > 1.0) strength = 1.0;
      if (!(strength <= 1.0)) world_.overflow = true;  // no number
      Joint& joint = world_.joints[i];
      joint.motor_speed = float(speed * sign);
      joint.max_torque = float(kMotorTorque * strength);
      energy_[i] = 0.00035 * kMotorTorque * strength;
      effort_ += strength;
    }
    for (Body& body : world_.bodies) body.wake();  // b2RevoluteJoint::SetMotorSpeed
  }

  void build(const double* scales, double force) {
    // Dimensions in m (designrl/envs/walker.py): top and bottom of leg 1, then of leg 2.
    const double originals[8] = {8.0, 34.0, 6.4, 34.0, 8.0, 34.0, 6.4, 34.0};
    double width[4], height[4];
    for (int i = 0; i < 4; ++i) {
      width[i] = originals[2 * i] * scales[2 * i] / kScale;
      height[i] = originals[2 * i + 1] * scales[2 * i + 1] / kScale;
    }
    const double leg1 = height[0] + height[1], leg2 = height[2] + height[3];
    const double hull_x = kTerrainStep * kTerrainStartPad / 2;
    const double hull_y = kTerrainHeight + (leg2 > leg1 ? leg2 : leg1);

    Body& hull = world_.bodies[kHull];
    const double outline[5][2] = {{-30, 9}, {6, 9}, {34, 1}, {34, -8}, {-30, -8}};
    Vec2 points[5];
    for (int i = 0; i < 5; ++i)
      points[i] = {float(outline[i][0] / kScale), float(outline[i][1] / kScale)};
    hull.shape.set(points, 5);
    hull.friction = kHullFriction;
    hull.place({float(hull_x), float(hull_y)}, 0.0f);
    world_.add_to_tree(kHull);
    hull.set_mass(kHullDensity);
    hull.force = {float(force), 0.0f};

    for (int leg = 0; leg < 2; ++leg) {
      const float tilt = float((leg == 0 ? -1 : 1) * 0.05);
      const double top = height[2 * leg], bottom = height[2 * leg + 1];
      const double y[2] = {hull_y - top / 2 - kLegDown, hull_y - top - bottom / 2 - kLegDown};
      for (int part = 0; part < 2; ++part) {
        const int index = kTop1 + 2 * leg + part;
        Body& body = world_.bodies[index];
        body.shape.set_box(float(width[2 * leg + part] / 2), float(height[2 * leg + part] / 2));
        body.friction = kLegFriction;
        body.place({float(hull_x), float(y[part])}, tilt);
        world_.add_to_tree(index);
        body.set_mass(kLegDensity);
      }
      const int hip = kHip1 + 2 * leg, knee = hip + 1;
      const Body& upper = world_.bodies[kTop1 + 2 * leg];
      const Body& lower = world_.bodies[kBottom1 + 2 * leg];
      world_.joints[hip].connect(hull, upper, {0.0f, float(kLegDown)}, {0.0f, float(top / 2)}, -0.8,
                                 1.1);
      world_.joints[knee].connect(upper, lower, {0.0f, float(-top / 2)}, {0.0f, float(bottom / 2)},
                                  -1.6, -0.1);
    }
  }

  void observe(bool closest_hits, Outcome<Walker>& outcome) {
    static const RayDirections directions;
    const Body& hull = world_.bodies[kHull];
    const double x = hull.xf.p.x, y = hull.xf.p.y;
    const Vec2 v = hull.velocity;
    const double fps = 50.0;
    float* state = outcome.observation;
    state[0] = hull.sweep.a;
    state[1] = float(2.0 * hull.angular_velocity / fps);
    state[2] = float(0.3 * v.x * (kViewportWidth / kScale) / fps);
    state[3] = float(0.3 * v.y * (kViewportHeight / kScale) / fps);
    for (int j = 0; j < kJoints; ++j) {
      const Body &a = world_.bodies[kJointA[j]], &b = world_.bodies[kJointB[j]];
      const bool knee = j % 2 == 1;
      const float angle = b.sweep.a - a.sweep.a - world_.joints[j].reference_angle;
      const float speed = b.angular_velocity - a.angular_velocity;
      float* to = state + (j < kHip2 ? 4 : 9) + (knee ? 2 : 0);
      to[0] = knee ? float(double(angle) + 1.0) : angle;
      to[1] = float(double(speed) / (knee ? kKneeSpeed : kHipSpeed));
    }
    state[8] = world_.listener.ground_contact[kBottom1] ? 1.0f : 0.0f;
    state[13] = world_.listener.ground_contact[kBottom2] ? 1.0f : 0.0f;
    float end_x[kRays], end_y[kRays];
    for (int i = 0; i < kRays; ++i) {
      end_x[i] = float(x + directions.x[i]);
      end_y[i] = float(y - directions.y[i]);
    }
    RayFan(hull.xf.p, end_x, end_y).cast_all(world_, closest_hits, state + 14);

    const double angle = hull.sweep.a, tilt = angle < 0.0 ? -angle : angle;
    double shaping = 130 * x / kScale;
    shaping -= 5.0 * tilt;
    double reward = has_shaping_ ? shaping - shaping_ : 0.0;
    shaping_ = shaping;
    has_shaping_ = true;
    for (double energy : energy_) reward -= energy;
    outcome.fell = world_.listener.fallen || x < 0.0;
    if (outcome.fell) reward = -100.0;
    outcome.reward = reward;
    for (double& term : outcome.terms) term = 0.0;
    if (outcome.fell) {
      outcome.terms[kFall] = reward;
    } else {
      outcome.terms[kProgress] = 130 / kScale * (x - x_);
      outcome.terms[kPosture] = -5.0 * (tilt - tilt_);
      outcome.terms[kEnergy] = -0.00035 * kMotorTorque * effort_;
    }
    x_ = x;
    tilt_ = tilt;
    outcome.terminated = outcome.fell || x > (kTerrainLength - kTerrainGrass) * kTerrainStep;
  }
};

}  // namespace ENGINE::walker
