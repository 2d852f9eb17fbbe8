// What stands in the ant's world, as far as its physics need to know: bullet/ is compiled for this
// body and this floor, and uses nothing else of the task.
#pragma once

#include "common/isa.h"

namespace ENGINE::ant {

// --- The body (designrl/bodies/ant.py) ---
// A torso, and four legs of three capsules: the top one fixed to the torso, the middle one on the
// hip, the bottom one on the ankle. Everything is flat: at zero angles all frames are parallel, and
// capsules end at z = 0 of their frames. Bullet has 20 links, five a leg: top, hip, middle, ankle,
// bottom. The joints' links have no mass and no shape, and only the joints can turn.
constexpr int kLegs = 4;
enum PartIndex { kTop, kMiddle, kBottom, kLegParts };
constexpr int kShapes = 1 + kLegs * kLegParts;  // that meet the floor: the torso, the legs' parts
// Joints of leg i: the hip 2 i, the ankle 2 i + 1. Hips turn about z, ankles about (kAnkleX, 1, 0),
// which is not of length 1, and Bullet does not make it so.
constexpr int kJoints = 2 * kLegs;
constexpr double kAnkleX[kLegs] = {-1.0, 1.0, -1.0, 1.0};
constexpr int kVelocities = 6 + kJoints;  // the torso's angular and linear one, then the joints'
constexpr double kTorsoRadius = 0.25, kTorsoHeight = 0.75;  // m; the latter at the start
constexpr double kDensity = 1000.0;                         // kg/m³; the default of Bullet's loader

// The ranges of the joints. Bullet's MJCF loader turns degrees into radians in single precision.
constexpr float radians(float degrees) { return degrees * 3.14159265358979323846f / 180.0f; }
constexpr double kHip = radians(40), kStretched = radians(30), kBent = radians(100);
constexpr double kLower[kJoints] = {-kHip, kStretched, -kHip, -kBent,
                                    -kHip, -kBent,     -kHip, kStretched};
constexpr double kUpper[kJoints] = {kHip, kBent,       kHip, -kStretched,
                                    kHip, -kStretched, kHip, kBent};

// --- The world (designrl/envs/ant.py) ---
constexpr double kGravity = 9.8;                 // m/s²
constexpr double kTimeStep = 0.0165;             // s
constexpr int kSubsteps = 4;                     // of a step
constexpr double kSubstep = kTimeStep / kSubsteps;
constexpr int kIterations = 5;                   // of the constraint solver, at most
constexpr double kContactErp = 0.9;              // share of a penetration taken back in a substep
constexpr double kFriction = 0.8 * 1.5;          // of floor and body
constexpr double kRestitution = 0.5 * 0.5;       // likewise

}  // namespace ENGINE::ant
