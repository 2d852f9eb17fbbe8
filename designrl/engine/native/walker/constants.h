// Constants of the walker's task (Gymnasium's bipedal_walker.py).
#pragma once

#include "common/isa.h"

namespace ENGINE::walker {

constexpr double kScale = 30.0;               // length units per m
constexpr double kMotorTorque = 80.0;         // N m
constexpr double kHipSpeed = 4.0;             // rad/s
constexpr double kKneeSpeed = 6.0;            // rad/s
constexpr double kLegDown = -8.0 / kScale;    // m from the hull's origin to the hips
constexpr double kViewportWidth = 600.0, kViewportHeight = 400.0;  // length units
constexpr float kStartTilts[2] = {-0.05f, 0.05f};  // rad, of the legs
constexpr double kTerrainStep = 14.0 / kScale;                     // m
constexpr int kTerrainLength = 200;           // terrain steps
constexpr double kTerrainHeight = kViewportHeight / kScale / 4.0;  // m
constexpr int kTerrainGrass = 10, kTerrainStartPad = 20;           // terrain steps
constexpr double kInitialForce = 5.0;         // N, largest sideways push at the start
constexpr double kLidarRange = 160.0 / kScale;  // m
constexpr int kRays = 10;
constexpr float kHullFriction = 0.1f, kLegFriction = 0.2f;
constexpr float kHullDensity = 5.0f, kLegDensity = 1.0f;  // kg/m²

}  // namespace ENGINE::walker
