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
  static constexpr int kParts = kBodies;
  using Networks =
      FixedNetworks<FixedNetwork<Output::kTanh, kObservations, 40, 40, kActions>>;
  using Solver = walker::Solver;

  // BipedalWalker.reset up to, but without, its first step. scales: (8,) of the design.
  void reset(Generator& random, uint32_t flags, const double* scales) {
    world_.clear();
    add_course(world_, random, flags & kHardcore);
    set_sizes(scales);
    Place at[kBodies];
    start_places(at);
    build(at);
    world_.bodies[kHull].force = {float(start_force(random)), 0.0f};
    has_shaping_ = false;
  }

  // Another body within an episode, on the same course. random, flags: as at its reset.
  //
  // A new world, in which the walker stands where it did: every part keeps its angle and its speed
  // of turning, the hull its velocity, and the whole its height above the ground. Rewards go on.
  void change_body(Generator& random, uint32_t flags, const double* scales) {
    Place at[kBodies];
    float turning[kBodies];
    for (int b = 0; b < kBodies; ++b) {
      at[b] = {world_.bodies[b].xf.p, world_.bodies[b].sweep.a};
      turning[b] = world_.bodies[b].angular_velocity;
    }
    const Vec2 velocity = world_.bodies[kHull].velocity;
    const float height = height_above_ground();
    set_sizes(scales);
    const Vec2 hip = at[kHull].position + mul(rotation(at[kHull].angle), {0.0f, float(kLegDown)});
    for (int part = 0; part < kBodies - 1; ++part) {
      const Vec2 from = part % 2 ? at[part].position + 0.5f * along(part - 1, at[part].angle) : hip;
      at[kTop1 + part].position = from + 0.5f * along(part, at[kTop1 + part].angle);
    }
    build(at);  // in the old world, to see how high it stands
    const Vec2 lift = {0.0f, height - height_above_ground()};
    for (Place& place : at) place.position = place.position + lift;

    world_.clear();
    add_course(world_, random, flags & kHardcore);
    build(at);
    for (int leg = 0; leg < 2; ++leg) {
      world_.joints[kHip1 + 2 * leg].reference_angle = kStartTilts[leg];
      world_.joints[kKnee1 + 2 * leg].reference_angle = 0.0f;
    }
    for (int b = 0; b < kBodies; ++b) world_.bodies[b].angular_velocity = turning[b];
    const Body& hull = world_.bodies[kHull];
    const Vec2 hip_velocity = velocity + cross(turning[kHull], hip + lift - hull.sweep.c);
    world_.bodies[kHull].velocity = velocity;
    for (int part = 0; part < kBodies - 1; ++part) {
      const Vec2 half = 0.5f * along(part, at[kTop1 + part].angle);
      const Vec2 from = part % 2 ? world_.bodies[part].velocity +
                                       cross(turning[part], 0.5f * along(part - 1, at[part].angle))
                                 : hip_velocity;
      world_.bodies[kTop1 + part].velocity = from + cross(turning[kTop1 + part], half);
    }
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

  // WalkerBody.poses. Box2D's y is z there.
  void poses(const Solver&, double* to) const {
    for (int b = 0; b < kBodies; ++b, to += 7) {
      const Body& body = world_.bodies[b];
      const double angle = body.sweep.a, up = b == kHull ? 0.0 : height_[b - kTop1] / 2;
      to[0] = body.xf.p.x - sine(angle) * up;
      to[2] = body.xf.p.y + cosine(angle) * up;
      to[4] = -sine(angle / 2);
      to[6] = cosine(angle / 2);
      to[1] = to[3] = to[5] = 0.0;
    }
  }

  // What a picture shows beside the poses.
  const World& world() const { return world_; }
  double width(int part) const { return width_[part]; }    // m
  double height(int part) const { return height_[part]; }  // m
  double effort() const { return effort_; }  // of the motors' full torques, summed

  static constexpr size_t kLaneBytes = 0;
  void save_lane(const Solver&, char*) const {}
  void restore_lane(Solver&, int, const char*) {}

 private:
  World world_;
  Step step_;
  double width_[kBodies - 1], height_[kBodies - 1];  // m, of the legs' parts
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

  // Dimensions of the legs' parts in m (designrl/envs/walker.py): top and bottom of leg 1, then of
  // leg 2. scales: (8,) of the design.
  void set_sizes(const double* scales) {
    const double originals[8] = {8.0, 34.0, 6.4, 34.0, 8.0, 34.0, 6.4, 34.0};
    for (int i = 0; i < kBodies - 1; ++i) {
      width_[i] = originals[2 * i] * scales[2 * i] / kScale;
      height_[i] = originals[2 * i + 1] * scales[2 * i + 1] / kScale;
    }
  }

  struct Place {
    Vec2 position;
    float angle;
  };

  // Where reset puts the bodies.
  void start_places(Place* at) const {
    const double leg1 = height_[0] + height_[1], leg2 = height_[2] + height_[3];
    const double hull_x = kTerrainStep * kTerrainStartPad / 2;
    const double hull_y = kTerrainHeight + (leg2 > leg1 ? leg2 : leg1);
    at[kHull] = {{float(hull_x), float(hull_y)}, 0.0f};
    for (int leg = 0; leg < 2; ++leg) {
      const double top = height_[2 * leg], bottom = height_[2 * leg + 1];
      const double y[2] = {hull_y - top / 2 - kLegDown, hull_y - top - bottom / 2 - kLegDown};
      for (int part = 0; part < 2; ++part)
        at[kTop1 + 2 * leg + part] = {{float(hull_x), float(y[part])}, kStartTilts[leg]};
    }
  }

  void build(const Place* at) {
    Body& hull = world_.bodies[kHull];
    const double outline[5][2] = {{-30, 9}, {6, 9}, {34, 1}, {34, -8}, {-30, -8}};
    Vec2 points[5];
    for (int i = 0; i < 5; ++i)
      points[i] = {float(outline[i][0] / kScale), float(outline[i][1] / kScale)};
    hull.shape.set(points, 5);
    hull.friction = kHullFriction;
    hull.place(at[kHull].position, at[kHull].angle);
    world_.add_to_tree(kHull);
    hull.set_mass(kHullDensity);

    for (int leg = 0; leg < 2; ++leg) {
      for (int part = 2 * leg; part < 2 * leg + 2; ++part) {
        const int index = kTop1 + part;
        Body& body = world_.bodies[index];
        body.shape.set_box(float(width_[part] / 2), float(height_[part] / 2));
        body.friction = kLegFriction;
        body.place(at[index].position, at[index].angle);
        world_.add_to_tree(index);
        body.set_mass(kLegDensity);
      }
      const int hip = kHip1 + 2 * leg, knee = hip + 1;
      const double top = height_[2 * leg], bottom = height_[2 * leg + 1];
      const Body& upper = world_.bodies[kTop1 + 2 * leg];
      const Body& lower = world_.bodies[kBottom1 + 2 * leg];
      world_.joints[hip].connect(hull, upper, {0.0f, float(kLegDown)}, {0.0f, float(top / 2)}, -0.8,
                                 1.1);
      world_.joints[knee].connect(upper, lower, {0.0f, float(-top / 2)}, {0.0f, float(bottom / 2)},
                                  -1.6, -0.1);
    }
  }

  // From a part's joint with the one above to its other end, m.
  Vec2 along(int part, float angle) const {
    return mul(rotation(angle), Vec2{0.0f, float(-height_[part])});
  }

  // m, of the ground under a place; far below where there is none.
  float ground_height(float x) const {
    float highest = -1e9f;
    world_.index.each(x, x, [&](int i) {
      const Terrain& piece = world_.terrain[i];
      float y = piece.box.upper.y - kSkin;
      if (piece.is_edge) {
        if (!(piece.v1.x <= x && x <= piece.v2.x)) return;
        y = piece.v1.y + (piece.v2.y - piece.v1.y) * (x - piece.v1.x) / (piece.v2.x - piece.v1.x);
      } else if (!(piece.box.lower.x + kSkin <= x && x <= piece.box.upper.x - kSkin)) {
        return;
      }
      highest = maximum(highest, y);
    });
    return highest;
  }

  // m, from the ground up to the lowest point of the body, looked at every tenth of its edges.
  float height_above_ground() const {
    float lowest = 1e9f;
    for (const Body& body : world_.bodies) {
      const Vec2 middle = mul(body.xf, body.sweep.local_center);
      for (int i = 0; i < body.shape.count; ++i) {
        const Vec2 from = mul(body.xf, body.shape.vertices[i]);
        const Vec2 to = mul(body.xf, body.shape.vertices[(i + 1) % body.shape.count]);
        for (int k = 0; k < 10; ++k) {
          Vec2 point = from + (0.1f * float(k)) * (to - from);
          // A wall that a foot leans against is not the ground under it.
          const float inwards = clamp(middle.x - point.x, -0.03f, 0.03f);
          lowest = minimum(lowest, point.y - ground_height(point.x + inwards));
        }
      }
    }
    return lowest;
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
