// Numbers of Bullet 3, as PyBullet 3.2.7 contains it, in double precision. Those written as floats
// are floats in its source.
#pragma once

#include "common/isa.h"

namespace ENGINE::ant {

constexpr double kPi = 3.14159265358979323846;
constexpr double kEpsilon = 2.2204460492503131e-16;  // SIMD_EPSILON

// btMultiBody
constexpr double kDamping = 0.04f;       // m_linearDamping, m_angularDamping
constexpr double kMaxVelocity = 100.0;   // m_maxCoordinateVelocity
constexpr double kMaxTurn = 0.5 * 1.5707963267948966;  // rad per substep, ANGULAR_MOTION_THRESHOLD

// Collision
constexpr double kMargin = 0.04;         // m, CONVEX_DISTANCE_MARGIN
constexpr double kBreakingShare = 0.02;  // gContactBreakingThreshold, of a shape's motion disc
constexpr int kMaxPoints = 4;            // of a manifold, MANIFOLD_CACHE_SIZE

// btMultiBodyConstraintSolver and btContactSolverInfo
constexpr double kSlop = 1e-5;  // m added to a contact's distance, m_linearSlop; set by PyBullet
constexpr double kLimitErp = 0.2;           // m_erp, of joint limits
constexpr double kShallow = -0.04f;         // rad, m_splitImpulsePenetrationThreshold
constexpr double kMaxLimitImpulse = 100.0;  // btMultiBodyConstraint::m_maxAppliedImpulse
constexpr double kMaxNormalImpulse = 1e10f;
constexpr double kResidual = 1e-7;  // m_leastSquaresResidualThreshold; set by PyBullet

}  // namespace ENGINE::ant
