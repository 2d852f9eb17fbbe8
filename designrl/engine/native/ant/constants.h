// Constants of the ant's task (RoboschoolAnt-v1 as in designrl/envs/ant.py) and of its body
// (designrl/bodies/ant.py).
#pragma once

#include "ant/scene.h"

namespace ENGINE::ant {

constexpr double kMotorTorque = 2.5 * 100.0;  // N m at action ±1
constexpr double kStartAngle = 0.1;        // rad; joints start at U(-0.1, 0.1)
constexpr double kTargetX = 1000.0;        // m
constexpr double kFallenHeight = 0.26;     // m
constexpr double kJointLimit = 0.99;       // share of a range from its middle: beyond, it is stuck
constexpr double kSpeedScale = 0.3;        // per m/s
constexpr double kJointSpeedScale = 0.1;   // per rad/s
constexpr float kObservationLimit = 5.0f;
constexpr double kElectricityCost = -2.0, kStallCost = -0.1, kJointLimitCost = -0.2,
                 kFootCollisionCost = -1.0;  // points
constexpr int kLinks = 20;                 // of Bullet, whose mean position is where the ant is

constexpr int kLegDimensions = 9;  // of a leg: dx, dy of its parts, then their radii
constexpr int kDimensions = kLegs * kLegDimensions;
constexpr double kLegSigns[kLegs][2] = {{1, 1}, {-1, 1}, {-1, -1}, {1, -1}};  // of dx and dy
constexpr double kLengths[kLegParts] = {0.2, 0.2, 0.4};  // m, |dx| = |dy| of the parts
constexpr double kRadius = 0.08;                         // m, of all parts

}  // namespace ENGINE::ant
