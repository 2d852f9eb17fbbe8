// Constants of Box2D 2.3.0 (b2Settings.h); lengths in m, angles in rad, times in s.
#pragma once

#include "common/isa.h"

namespace ENGINE::walker {

constexpr float kEpsilon = 1.1920928955078125e-7f;  // FLT_EPSILON
constexpr float kMaxFloat = 3.402823466e+38f;       // FLT_MAX
constexpr float kPi = 3.14159265359f;
constexpr float kLinearSlop = 0.005f;                  // m of overlap that is left alone
constexpr float kAngularSlop = 2.0f / 180.0f * kPi;    // rad beyond a joint limit left alone
constexpr float kSkin = 2.0f * kLinearSlop;            // m, skin around every polygon and edge
constexpr float kAabbMargin = 0.1f;                    // m, fattening of boxes in the tree
constexpr float kAabbPrediction = 2.0f;                // steps of motion that a moved box spans
constexpr float kMaxLinearCorrection = 0.2f;           // m per position iteration
constexpr float kMaxAngularCorrection = 8.0f / 180.0f * kPi;  // rad per position iteration
constexpr float kMaxTranslation = 2.0f;                // m per step
constexpr float kMaxRotation = 0.5f * kPi;             // rad per step
constexpr float kBaumgarte = 0.2f;                     // share of overlap removed per iteration
constexpr float kToiBaumgarte = 0.75f;                 // the same in continuous collision
constexpr float kTimeToSleep = 0.5f;                   // s of rest before bodies sleep
constexpr float kLinearSleepTolerance = 0.01f;         // m/s
constexpr float kAngularSleepTolerance = 2.0f / 180.0f * kPi;  // rad/s
constexpr int kMaxSubSteps = 8;        // continuous collisions of one contact in one step
constexpr int kMaxToiContacts = 32;    // contacts in one continuous collision
constexpr int kToiPositionIterations = 20;
constexpr float kMaxConditionNumber = 1000.0f;  // of a two-point contact (b2ContactSolver)

}  // namespace ENGINE::walker
