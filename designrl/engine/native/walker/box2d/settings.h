// Constants of Box2D 2.3.0, of the walker's task, and the name of the instruction set.
//
// Every header of this folder is compiled three times, for SSE2, AVX2 and AVX-512, and linked
// into one library. All of it lives in a namespace named after the instruction set, so that the
// linker can never put an AVX-512 copy of a function into the baseline's code path. For the same
// reason nothing here uses containers or algorithms of the standard library.
//
// The files, in the order of a step:
//   random, terrain       the course of an episode, as Gymnasium and NumPy draw it
//   math2d, shapes, body  vectors, polygons and their masses, bodies and joints
//   tree, narrow_phase, world
//                         broad phase, contact points, the list of contacts
//   constraints           a walker's contacts and joints made ready, and loaded into vector lanes
//   simd, velocity_solver the 180 velocity iterations, many walkers side by side
//   position_solver       integration and the position iterations
//   continuous            impacts within a step
//   lidar                 the ten rays
//   walker                the step as a whole; start, observation and reward
//   policy, lanes         the network; episodes one after the other in every lane
//   batch, engine         what ctypes calls
#pragma once

#include <cmath>
#include <cstdint>

#if defined(__AVX512F__)
#define ENGINE engine_avx512
#define ENGINE_VECTOR_BYTES 64
#elif defined(__AVX2__)
#define ENGINE engine_avx2
#define ENGINE_VECTOR_BYTES 32
#else
#define ENGINE engine_sse2
#define ENGINE_VECTOR_BYTES 16
#endif

namespace ENGINE {

// --- Box2D (b2Settings.h); lengths in m, angles in rad, times in s ---
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

// --- The walker (Gymnasium's bipedal_walker.py) ---
constexpr double kScale = 30.0;               // length units per m
constexpr float kTimeStep = float(1.0 / 50);  // s
constexpr int kVelocityIterations = 180;
constexpr int kPositionIterations = 60;
constexpr float kGravity = -10.0f;            // m/s²
constexpr double kMotorTorque = 80.0;         // N m
constexpr double kHipSpeed = 4.0;             // rad/s
constexpr double kKneeSpeed = 6.0;            // rad/s
constexpr double kLegDown = -8.0 / kScale;    // m from the hull's origin to the hips
constexpr double kViewportWidth = 600.0, kViewportHeight = 400.0;  // length units
constexpr double kTerrainStep = 14.0 / kScale;                     // m
constexpr int kTerrainLength = 200;           // terrain steps
constexpr double kTerrainHeight = kViewportHeight / kScale / 4.0;  // m
constexpr int kTerrainGrass = 10, kTerrainStartPad = 20;           // terrain steps
constexpr double kInitialForce = 5.0;         // N, largest sideways push at the start
constexpr double kLidarRange = 160.0 / kScale;  // m
constexpr int kRays = 10;
constexpr int kObservations = 24, kActions = 4, kHidden = 40;
constexpr float kTerrainFriction = 2.5f, kHullFriction = 0.1f, kLegFriction = 0.2f;
constexpr float kHullDensity = 5.0f, kLegDensity = 1.0f;  // kg/m²

// --- Bodies and joints, in the order in which Gymnasium creates them ---
enum BodyIndex { kHull, kTop1, kBottom1, kTop2, kBottom2, kBodies };
enum JointIndex { kHip1, kKnee1, kHip2, kKnee2, kJoints };
constexpr int kJointA[kJoints] = {kHull, kTop1, kHull, kTop2};
constexpr int kJointB[kJoints] = {kTop1, kBottom1, kTop2, kBottom2};
// b2World::Solve collects an island depth first from the newest body. With all five bodies joined
// and always awake, bodies (with their contacts) and joints come out in this order at every step.
constexpr int kIslandBodies[kBodies] = {kBottom2, kTop2, kHull, kTop1, kBottom1};
constexpr int kIslandJoints[kJoints] = {kKnee2, kHip2, kHip1, kKnee1};

// --- Capacities; beyond them an episode is reported as failed, never simulated differently ---
constexpr int kMaxStatics = 384;       // terrain fixtures: 199 edges and the obstacles
constexpr int kMaxNodes = 1024;        // of the dynamic tree
constexpr int kMaxContacts = 256;      // pairs of overlapping boxes
constexpr int kMaxTouching = 24;       // touching contacts of one body

}  // namespace ENGINE
