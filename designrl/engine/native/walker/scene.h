// What stands in the walker's world, as far as its physics need to know: box2d/ is compiled for
// this table, and uses nothing else of the task.
#pragma once

#include <stdint.h>

#include "common/isa.h"

namespace ENGINE::walker {

// --- Bodies and joints, in the order in which Gymnasium creates them ---
enum BodyIndex { kHull, kTop1, kBottom1, kTop2, kBottom2, kBodies };
enum JointIndex { kHip1, kKnee1, kHip2, kKnee2, kJoints };
constexpr int kJointA[kJoints] = {kHull, kTop1, kHull, kTop2};
constexpr int kJointB[kJoints] = {kTop1, kBottom1, kTop2, kBottom2};
// b2World::Solve collects an island depth first from the newest body. With all five bodies joined
// and always awake, bodies (with their contacts) and joints come out in this order at every step.
constexpr int kIslandBodies[kBodies] = {kBottom2, kTop2, kHull, kTop1, kBottom1};
constexpr int kIslandJoints[kJoints] = {kKnee2, kHip2, kHip1, kKnee1};

// --- What Gymnasium's bipedal_walker.py hands to b2World::Step, and its world ---
constexpr float kTimeStep = float(1.0 / 50);  // s
constexpr int kVelocityIterations = 180;
constexpr int kPositionIterations = 60;
constexpr float kGravity = -10.0f;            // m/s²
constexpr float kTerrainFriction = 2.5f;

// --- Capacities; beyond them an episode is reported as failed, never simulated differently ---
constexpr int kMaxVertices = 5;        // of a polygon: the hull's; legs and terrain have four
constexpr int kMaxTerrain = 384;       // pieces of terrain: 199 edges and the obstacles
constexpr int kMaxNodes = 1024;        // of the dynamic tree
constexpr int kColumns = 96;           // of the terrain's index, 1 m each; the last has no end
constexpr int kMaxContacts = 256;      // pairs of overlapping boxes
constexpr int kMaxTouching = 24;       // touching contacts of one body

// Gymnasium's ContactDetector, a b2ContactListener: a leg's flag is cleared by the end of any of
// its contacts, even while another one lasts.
struct ContactListener {
  bool fallen;
  bool ground_contact[kBodies];

  void begin_contact(int body) {
    if (body == kHull) fallen = true;
    ground_contact[body] = true;
  }
  void end_contact(int body) { ground_contact[body] = false; }
};

}  // namespace ENGINE::walker
