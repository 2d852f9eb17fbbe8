// The walker: start of an episode, one step in two halves around the velocity solver, observation
// and reward (Gymnasium's bipedal_walker.py, designrl/envs/walker.py, b2World::Step).
#pragma once

#include "continuous.h"
#include "lidar.h"

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

// Where all bodies are, to notice a position that has been there before.
struct Positions {
  float values[3 * kBodies];

  explicit Positions(const Motion* motions) {
    for (int b = 0; b < kBodies; ++b) {
      values[3 * b] = motions[b].c.x;
      values[3 * b + 1] = motions[b].c.y;
      values[3 * b + 2] = motions[b].a;
    }
  }
  bool operator==(const Motion* motions) const {
    for (int b = 0; b < kBodies; ++b)
      if (values[3 * b + 2] != motions[b].a || values[3 * b] != motions[b].c.x ||
          values[3 * b + 1] != motions[b].c.y)
        return false;
    return true;
  }
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

  // b2World::Step up to the velocity iterations, b2Island::Solve's first half.
  void begin_step(VelocitySolver& solver, int lane) {
    if (world.moved_count > 0) world.find_new_contacts();  // of the start; later there are none
    const float dt_ratio = world.inverse_dt_before * kTimeStep;
    world.collide_all();

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
    for (int b : kIslandBodies) {
      Body& body = world.bodies[b];
      int count = 0;
      for (int i = world.contact_count - 1; i >= 0; --i) {
        const Contact& contact = world.contact(i);
        if (contact.body != b || !contact.touching) continue;
        if (count == kMaxTouching) {
          world.overflow = true;
          break;
        }
        ContactConstraint constraint;
        prepare_contact(constraint, contact, body, motions_[b], dt_ratio);
        load_contact(solver, lane, b, count, constraint, body);
        touching_[b][count++] = world.order[i];
        constraints_[b][count - 1] = constraint;
      }
      solver.contact_count[b][lane] = count;
    }
    // All contacts are prepared from the same velocities before any of them is warm started;
    // without restitution they do not read velocities, so the order above does not matter.
    for (int b : kIslandBodies)
      for (int k = 0; k < solver.contact_count[b][lane]; ++k)
        warm_start(constraints_[b][k], world.bodies[b], motions_[b]);
    for (int j : kIslandJoints)
      load_joint(solver, lane, j, world.joints[j], world.bodies, motions_, dt_ratio);
    for (int b = 0; b < kBodies; ++b) {
      solver.vx[b].lane[lane] = motions_[b].v.x;
      solver.vy[b].lane[lane] = motions_[b].v.y;
      solver.w[b].lane[lane] = motions_[b].w;
    }
  }

  // The rest of b2World::Step, and of BipedalWalker.step.
  void finish_step(const VelocitySolver& solver, int lane, bool closest_hits,
                   StepResult& result) {
    for (int b = 0; b < kBodies; ++b) {
      for (int k = 0; k < solver.contact_count[b][lane]; ++k)
        store_contact(solver, lane, b, k, world.contacts[touching_[b][k]]);
      motions_[b].v = {solver.vx[b].lane[lane], solver.vy[b].lane[lane]};
      motions_[b].w = solver.w[b].lane[lane];
      integrate(motions_[b], kTimeStep);
    }
    for (int j = 0; j < kJoints; ++j) store_joint(solver, lane, j, world.joints[j]);
    const bool solved = correct_positions(solver, lane);
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
  ContactConstraint constraints_[kBodies][kMaxTouching];
  int16_t touching_[kBodies][kMaxTouching];
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
  // An iteration is a function of the bodies' positions alone. A joint that a motor holds beyond its
  // limit keeps a quarter of all steps from ever converging, and most of those soon go round in a
  // short cycle of positions. Once a position has come back, only the rest of the last round is
  // left to do (Brent's way of finding cycles).
  bool correct_positions(const VelocitySolver& solver, int lane) {
    Positions mark(motions_);
    int marked = 0, next_mark = 1, end = kPositionIterations;
    bool last_round = false;
    for (int i = 0; i < end; ++i) {
      float smallest = 0.0f;
      for (int b : kIslandBodies)
        for (int k = 0; k < solver.contact_count[b][lane]; ++k)
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
      if (last_round) continue;
      const int done = i + 1;
      if (mark == motions_) {
        end = done + (kPositionIterations - done) % (done - marked);
        last_round = true;
      } else if (done == next_mark) {
        mark = Positions(motions_);
        marked = done;
        next_mark = 2 * done;
      }
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
    for (int i = 0; i < kRays; ++i) {
      const Vec2 end = {float(x + directions.x[i]), float(y - directions.y[i])};
      state[14 + i] = cast_ray(world, hull.xf.p, end, closest_hits);
    }

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
