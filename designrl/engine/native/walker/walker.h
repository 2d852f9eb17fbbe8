// The walker: start of an episode, a step up to and from the velocity iterations, observation and
// reward (Gymnasium's bipedal_walker.py, designrl/envs/walker.py, b2World::Step).
#pragma once

#include "walker/box2d/continuous.h"
#include "walker/lidar.h"

namespace ENGINE {

// Directions of the LIDAR rays, computed at run time by the C library, as Python does.
struct RayDirections {
  double x[kRays], y[kRays];
  RayDirections() {
    for (int i = 0; i < kRays; ++i) {
      volatile double angle = 1.5 * i / 10.0;
      x[i] = std::sin(angle) * kLidarRange;
      y[i] = std::cos(angle) * kLidarRange;
    }
  }
};

struct StepResult {
  float observation[kObservations];
  double reward;  // of Gymnasium; -100 with a fall
  bool terminated, fell;
};

class Walker {
 public:
  World world;

  // BipedalWalker.reset up to, but without, its first step. scales: (8,) of the design.
  void reset(uint64_t seed, bool hardcore, const double* scales) {
    Generator random(seed);
    world.course.generate(random, hardcore);
    const double force = Course::start_force(random);
    world.clear_contacts();
    world.tree.clear();
    if (world.course.overflow) world.overflow = true;
    for (int i = 0; i < world.course.count; ++i) {
      Terrain& piece = world.course.pieces[i];
      piece.proxy = world.tree.create(piece.box, kBodies + i);
    }
    build(scales, force);
    has_shaping_ = false;
  }

  // Motor commands of an action, BipedalWalker.step. actions: float64, as there.
  void command(const double* action) {
    for (int i = 0; i < kJoints; ++i) {
      const double a = action[i], speed = i % 2 == 0 ? kHipSpeed : kKneeSpeed;
      const double sign = a > 0.0 ? 1.0 : a < 0.0 ? -1.0 : 0.0;
      double strength = a < 0.0 ? -a : a;
      if (strength > 1.0) strength = 1.0;
      world.joints[i].motor_speed = float(speed * sign);
      world.joints[i].max_torque = float(kMotorTorque * strength);
      energy_[i] = 0.00035 * kMotorTorque * strength;
    }
    for (Body& body : world.bodies) body.wake();  // b2RevoluteJoint::SetMotorSpeed
  }

  // b2World::Step up to b2Island::Solve.
  void begin_step() {
    if (world.moved_count > 0) world.find_new_contacts();  // of the start; later there are none
    world.collide_all();
    for (int& count : touching_count_) count = 0;
    for (int i = world.contact_count - 1; i >= 0; --i) {
      const Contact& contact = world.contact(i);
      if (!contact.touching) continue;
      if (touching_count_[contact.body] == kMaxTouching) {
        world.overflow = true;
        break;
      }
      touching_[contact.body][touching_count_[contact.body]++] = world.order[i];
    }
  }

  // Orders walkers so that those with the same number of contacts on the same bodies come next to
  // each other: in one vector, they waste no lanes of the velocity solver.
  uint32_t contact_pattern() const {
    uint32_t pattern = 0;
    for (int b : kIslandBodies) {
      const int count = touching_count_[b];
      pattern = pattern << 4 | unsigned(count < 15 ? count : 15);
    }
    return pattern;
  }

  // b2Island::Solve up to the velocity iterations.
  void load(VelocitySolver& solver, int lane) {
    const float dt_ratio = world.inverse_dt_before * kTimeStep;
    for (int b = 0; b < kBodies; ++b) {
      Body& body = world.bodies[b];
      Motion& motion = motions_[b];
      body.sweep.c0 = body.sweep.c;
      body.sweep.a0 = body.sweep.a;
      motion.c = body.sweep.c;
      motion.a = body.sweep.a;
      motion.q = body.xf.q;
      body.start_angle = body.sweep.a;
      body.start_rotation = body.xf.q;
      const Vec2 gravity = {0.0f, kGravity};
      motion.v = body.velocity + kTimeStep * (gravity + body.inverse_mass * body.force);
      motion.w = body.angular_velocity;
    }
    // Box2D prepares all contacts before it warm starts the first. Without restitution they do not
    // depend on velocities, and each touches one body only, so one pass does.
    for (int b = 0; b < kBodies; ++b) {
      const Body& body = world.bodies[b];
      for (int k = 0; k < touching_count_[b]; ++k) {
        ContactConstraint constraint;
        const Contact& contact = world.contacts[touching_[b][k]];
        prepare_contact(constraint, contact, body, motions_[b], dt_ratio);
        load_contact(solver, lane, b, k, constraint, body);
        warm_start(constraint, body, motions_[b]);
      }
      solver.contact_count[b][lane] = touching_count_[b];
    }
    for (int j : kIslandJoints)
      load_joint(solver, lane, j, world.joints[j], world.bodies, motions_, dt_ratio);
    for (int b = 0; b < kBodies; ++b) {
      solver.vx[b].lane[lane] = motions_[b].v.x;
      solver.vy[b].lane[lane] = motions_[b].v.y;
      solver.w[b].lane[lane] = motions_[b].w;
    }
  }

  // b2Island::Solve after the velocity iterations: takes the impulses and velocities.
  void store(const VelocitySolver& solver, int lane) {
    for (int b = 0; b < kBodies; ++b) {
      for (int k = 0; k < touching_count_[b]; ++k)
        store_contact(solver, lane, b, k, world.contacts[touching_[b][k]]);
      motions_[b].v = {solver.vx[b].lane[lane], solver.vy[b].lane[lane]};
      motions_[b].w = solver.w[b].lane[lane];
    }
    for (int j = 0; j < kJoints; ++j) store_joint(solver, lane, j, world.joints[j]);
  }

  // The rest of b2World::Step, and of BipedalWalker.step.
  void finish_step(bool closest_hits, StepResult& result) {
    for (Motion& motion : motions_) integrate(motion, kTimeStep);
    const bool solved = correct_positions();
    for (int b = 0; b < kBodies; ++b) {
      Body& body = world.bodies[b];
      const Motion& motion = motions_[b];
      body.sweep.c = motion.c;
      body.sweep.a = motion.a;
      body.velocity = motion.v;
      body.angular_velocity = motion.w;
      body.xf.q = motion.q;
      body.xf.p = motion.c - mul(motion.q, body.sweep.local_center);
    }
    rest(solved);
    for (int b = kBodies - 1; b >= 0; --b) world.synchronize_box(b);
    world.find_new_contacts();
    solve_continuous(world);
    if (world.tree.overflow) world.overflow = true;
    world.inverse_dt_before = 1.0f / kTimeStep;
    for (Body& body : world.bodies) body.force = {0.0f, 0.0f};
    observe(closest_hits, result);
  }

 private:
  Motion motions_[kBodies];
  int touching_count_[kBodies];
  int16_t touching_[kBodies][kMaxTouching];  // slots of touching contacts, newest first
  double energy_[kJoints];
  double shaping_;
  bool has_shaping_;

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

    Body& hull = world.bodies[kHull];
    const double outline[5][2] = {{-30, 9}, {6, 9}, {34, 1}, {34, -8}, {-30, -8}};
    Vec2 points[5];
    for (int i = 0; i < 5; ++i)
      points[i] = {float(outline[i][0] / kScale), float(outline[i][1] / kScale)};
    hull.shape.set(points, 5);
    hull.friction = kHullFriction;
    hull.place({float(hull_x), float(hull_y)}, 0.0f);
    world.add_to_tree(kHull);
    hull.set_mass(kHullDensity);
    hull.force = {float(force), 0.0f};

    for (int leg = 0; leg < 2; ++leg) {
      const float tilt = float((leg == 0 ? -1 : 1) * 0.05);
      const double top = height[2 * leg], bottom = height[2 * leg + 1];
      const double y[2] = {hull_y - top / 2 - kLegDown, hull_y - top - bottom / 2 - kLegDown};
      for (int part = 0; part < 2; ++part) {
        const int index = kTop1 + 2 * leg + part;
        Body& body = world.bodies[index];
        body.shape.set_box(float(width[2 * leg + part] / 2), float(height[2 * leg + part] / 2));
        body.friction = kLegFriction;
        body.place({float(hull_x), float(y[part])}, tilt);
        world.add_to_tree(index);
        body.set_mass(kLegDensity);
      }
      const int hip = kHip1 + 2 * leg, knee = hip + 1;
      const Body &upper = world.bodies[kTop1 + 2 * leg], &lower = world.bodies[kBottom1 + 2 * leg];
      world.joints[hip].connect(hull, upper, {0.0f, float(kLegDown)}, {0.0f, float(top / 2)}, -0.8,
                                1.1);
      world.joints[knee].connect(upper, lower, {0.0f, float(-top / 2)}, {0.0f, float(bottom / 2)},
                                 -1.6, -0.1);
    }
  }

  // Position iterations of b2Island::Solve; whether the errors became small.
  //
  // A joint that a motor holds beyond its limit keeps a quarter of all steps from ever converging;
  // most of those soon go round in a cycle of positions.
  bool correct_positions() {
    CycleWatch<3 * kBodies> cycle(kPositionIterations, 3 * kBodies);
    for (int i = 0; i < cycle.end(); ++i) {
      float smallest = 0.0f;
      for (int b : kIslandBodies)
        for (int k = 0; k < touching_count_[b]; ++k)
          smallest = minimum(smallest, correct_contact(world.contacts[touching_[b][k]],
                                                       world.bodies[b], motions_[b], kBaumgarte));
      bool joints_good = true;
      for (int j : kIslandJoints) {
        const int a = kJointA[j], b = kJointB[j];
        const bool good = correct_joint(world.joints[j], world.bodies[a], world.bodies[b],
                                        motions_[a], motions_[b]);
        joints_good = joints_good && good;
      }
      if (smallest >= -3.0f * kLinearSlop && joints_good) return true;
      float state[3 * kBodies];
      for (int b = 0; b < kBodies; ++b) {
        state[b] = motions_[b].a;
        state[kBodies + 2 * b] = motions_[b].c.x;
        state[kBodies + 2 * b + 1] = motions_[b].c.y;
      }
      cycle.watch(state, i + 1);
    }
    return false;
  }

  // Sleep of b2Island::Solve: half a second without motion stops the bodies for the rest of this
  // step (the next command wakes them).
  void rest(bool solved) {
    const float linear = kLinearSleepTolerance * kLinearSleepTolerance;
    const float angular = kAngularSleepTolerance * kAngularSleepTolerance;
    float shortest = kMaxFloat;
    for (Body& body : world.bodies) {
      if (body.angular_velocity * body.angular_velocity > angular ||
          dot(body.velocity, body.velocity) > linear) {
        body.sleep_time = 0.0f;
        shortest = 0.0f;
      } else {
        body.sleep_time += kTimeStep;
        shortest = minimum(shortest, body.sleep_time);
      }
    }
    if (shortest >= kTimeToSleep && solved)
      for (Body& body : world.bodies) body.sleep();
  }

  void observe(bool closest_hits, StepResult& result) {
    static const RayDirections directions;
    const Body& hull = world.bodies[kHull];
    const double x = hull.xf.p.x, y = hull.xf.p.y;
    const Vec2 v = hull.velocity;
    const double fps = 50.0;
    float* state = result.observation;
    state[0] = hull.sweep.a;
    state[1] = float(2.0 * hull.angular_velocity / fps);
    state[2] = float(0.3 * v.x * (kViewportWidth / kScale) / fps);
    state[3] = float(0.3 * v.y * (kViewportHeight / kScale) / fps);
    for (int j = 0; j < kJoints; ++j) {
      const Body &a = world.bodies[kJointA[j]], &b = world.bodies[kJointB[j]];
      const bool knee = j % 2 == 1;
      const float angle = b.sweep.a - a.sweep.a - world.joints[j].reference_angle;
      const float speed = b.angular_velocity - a.angular_velocity;
      float* to = state + (j < kHip2 ? 4 : 9) + (knee ? 2 : 0);
      to[0] = knee ? float(double(angle) + 1.0) : angle;
      to[1] = float(double(speed) / (knee ? kKneeSpeed : kHipSpeed));
    }
    state[8] = world.ground_contact[kBottom1] ? 1.0f : 0.0f;
    state[13] = world.ground_contact[kBottom2] ? 1.0f : 0.0f;
    float end_x[kRays], end_y[kRays];
    for (int i = 0; i < kRays; ++i) {
      end_x[i] = float(x + directions.x[i]);
      end_y[i] = float(y - directions.y[i]);
    }
    RayFan fan(hull.xf.p, end_x, end_y);
    const float* fractions = fan.cast_all(world, closest_hits);
    for (int i = 0; i < kRays; ++i) state[14 + i] = fractions[i];

    const double angle = hull.sweep.a;
    double shaping = 130 * x / kScale;
    shaping -= 5.0 * (angle < 0.0 ? -angle : angle);
    double reward = has_shaping_ ? shaping - shaping_ : 0.0;
    shaping_ = shaping;
    has_shaping_ = true;
    for (double energy : energy_) reward -= energy;
    result.fell = world.fallen || x < 0.0;
    if (result.fell) reward = -100.0;
    result.reward = reward;
    result.terminated = result.fell || x > (kTerrainLength - kTerrainGrass) * kTerrainStep;
  }
};

}  // namespace ENGINE
