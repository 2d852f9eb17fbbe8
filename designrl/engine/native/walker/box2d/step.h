// b2World::Step, in two halves around the velocity iterations, which many worlds make side by side.
#pragma once

#include "walker/box2d/continuous.h"

namespace ENGINE::walker {

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

  // Orders worlds so that those with the same number of contacts on the same bodies, then those with
  // the same joints at their limits in the step before, come next to each other: in one vector, they
  // waste no lanes of the velocity solver.
  uint32_t pattern(const World& world) const {
    uint32_t pattern = 0;
    for (int b : kIslandBodies) {
      const int count = touching_count_[b];
      pattern = pattern << 4 | unsigned(count < 15 ? count : 15);
    }
    for (const Joint& joint : world.joints) pattern = pattern << 1 | (joint.limit != kInactive);
    return pattern;
  }

  // b2Island::Solve up to the velocity iterations.
  void load(World& world, VelocitySolver& solver, int lane) {
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
  void store(World& world, const VelocitySolver& solver, int lane) {
    for (int b = 0; b < kBodies; ++b) {
      for (int k = 0; k < touching_count_[b]; ++k)
        store_contact(solver, lane, b, k, world.contacts[touching_[b][k]]);
      motions_[b].v = {solver.vx[b].lane[lane], solver.vy[b].lane[lane]};
      motions_[b].w = solver.w[b].lane[lane];
    }
    for (int j = 0; j < kJoints; ++j) store_joint(solver, lane, j, world.joints[j]);
  }

  // The rest of b2World::Step.
  void finish(World& world) {
    for (Motion& motion : motions_) integrate(motion, kTimeStep);
    const bool solved = correct_positions(world);
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
    fall_asleep(world, solved);
    for (int b = kBodies - 1; b >= 0; --b) world.synchronize_box(b);
    world.find_new_contacts();
    solve_continuous(world);
    if (world.tree.overflow) world.overflow = true;
    world.inverse_dt_before = 1.0f / kTimeStep;
    for (Body& body : world.bodies) body.force = {0.0f, 0.0f};
  }

 private:
  Motion motions_[kBodies];
  int touching_count_[kBodies];
  int16_t touching_[kBodies][kMaxTouching];  // slots of touching contacts, newest first

  // Position iterations of b2Island::Solve; whether the errors became small.
  //
  // A joint that a motor holds beyond its limit keeps a quarter of all steps from ever converging;
  // most of those soon go round in a cycle of positions.
  bool correct_positions(World& world) {
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
