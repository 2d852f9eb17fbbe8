// b2World::Step, in two halves around the iterations, which many worlds make side by side.
#pragma once

#include "walker/box2d/continuous.h"

namespace ENGINE::walker {

// What many worlds make side by side, one in each lane.
struct Solver {
  VelocitySolver velocities;
  PositionSolver positions;

  // For the first `lanes` lanes.
  void solve(int lanes) {
    velocities.solve(lanes);
    positions.solve(velocities, lanes);
  }
  bool solved(int lane) const { return positions.solved(lane); }
  // Of the worlds that were not solved yet.
  void put_off(int lane, int place) { positions.move(lane, kLanes + place); }
  void solve_rest(int count) { positions.solve_rest(count); }
};

// A step of one world; to be called with the same world all along.
class Step {
 public:
  // b2World::Step up to b2Island::Solve.
  void begin(World& world) {
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

  // Orders worlds so that those with the same number of contacts on the same bodies, then those
  // with the same joints at their limits in the step before, come next to each other: in one
  // vector, they waste no lanes of the velocity solver.
  uint32_t pattern(const World& world) const {
    uint32_t pattern = 0;
    for (int b : kIslandBodies) {
      // Up and down in turn, so that neighbours differ in one count only.
      const unsigned count = touching_count_[b] < 15 ? unsigned(touching_count_[b]) : 15;
      pattern = pattern << 4 | (pattern & 1 ? 15 - count : count);
    }
    for (const Joint& joint : world.joints)
      pattern = pattern << 1 | ((joint.limit != kInactive) ^ (pattern & 1));
    return pattern;
  }

  // b2Island::Solve up to the velocity iterations.
  void load(World& world, Solver& solver, int lane) {
    VelocitySolver& velocities = solver.velocities;
    solver.positions.begin_load(lane);
    Motion motions[kBodies];
    const float dt_ratio = world.inverse_dt_before * kTimeStep;
    for (int b = 0; b < kBodies; ++b) {
      Body& body = world.bodies[b];
      Motion& motion = motions[b];
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
        prepare_contact(constraint, contact, body, motions[b], dt_ratio);
        load_contact(velocities, lane, b, k, constraint, body);
        solver.positions.load_contact(lane, b, k, contact.manifold);
        warm_start(constraint, body, motions[b]);
      }
      velocities.contact_count[b].lane[lane] = float(touching_count_[b]);
    }
    IslandTerms<float> terms;
    for (int j : kIslandJoints) {
      Joint& joint = world.joints[j];
      load_joint(velocities, lane, j, joint, world.bodies, motions, dt_ratio);
      terms.joints[j] = joint_terms(joint, world.bodies[kJointA[j]], world.bodies[kJointB[j]]);
    }
    for (int b = 0; b < kBodies; ++b) {
      const Motion& motion = motions[b];
      velocities.vx[b].lane[lane] = motion.v.x;
      velocities.vy[b].lane[lane] = motion.v.y;
      velocities.w[b].lane[lane] = motion.w;
      terms.places[b] = {motion.c.x, motion.c.y, motion.a, motion.q.s, motion.q.c};
      terms.bodies[b] = body_terms(world.bodies[b]);
    }
    solver.positions.load(lane, terms);
  }

  // b2Island::Solve after the velocity iterations: takes the impulses and velocities.
  void store(World& world, const Solver& solver, int lane) {
    const VelocitySolver& velocities = solver.velocities;
    for (int b = 0; b < kBodies; ++b) {
      for (int k = 0; k < touching_count_[b]; ++k)
        store_contact(velocities, lane, b, k, world.contacts[touching_[b][k]]);
      Body& body = world.bodies[b];
      body.velocity = {velocities.vx[b].lane[lane], velocities.vy[b].lane[lane]};
      body.angular_velocity = velocities.w[b].lane[lane];
    }
    for (int j = 0; j < kJoints; ++j) store_joint(velocities, lane, j, world.joints[j]);
  }
  // After the position iterations; of a world that was put off, from kLanes + its place.
  void store_positions(World& world, const Solver& solver, int lane) {
    for (int b = 0; b < kBodies; ++b) {
      Body& body = world.bodies[b];
      const Place<float> at = solver.positions.place(lane, b);
      body.sweep.c = {at.x, at.y};
      body.sweep.a = at.a;
      body.xf.q = {at.s, at.c};
      body.xf.p = body.sweep.c - mul(body.xf.q, body.sweep.local_center);
    }
    solved_ = solver.positions.solved(lane);
  }

  // The rest of b2World::Step.
  void finish(World& world) {
    fall_asleep(world, solved_);
    for (int b = kBodies - 1; b >= 0; --b) world.synchronize_box(b);
    world.find_new_contacts();
    solve_continuous(world);
    if (world.tree.overflow) world.overflow = true;
    world.inverse_dt_before = 1.0f / kTimeStep;
    for (Body& body : world.bodies) body.force = {0.0f, 0.0f};
  }

 private:
  bool solved_;  // the position errors of this step became small
  int touching_count_[kBodies];
  int16_t touching_[kBodies][kMaxTouching];  // slots of touching contacts, newest first

  // Sleep of b2Island::Solve: half a second without motion stops the bodies for the rest of this
  // step (the next command wakes them).
  static void fall_asleep(World& world, bool solved) {
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
};

}  // namespace ENGINE::walker
