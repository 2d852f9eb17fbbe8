// Where the parts are: from the torso's pose and the joints' angles to every part's pose
// (btMultiBody::updateCacheMultiDof, updateCollisionObjectWorldTransforms).
//
// Fixed links fold away: their rotations are exact identities. A joint's own link sits at the end
// of the part before it.
#pragma once

#include "ant/bullet/body.h"
#include "common/elementary.h"

namespace ENGINE::ant {

// What one substep hands to the next, besides the contact points.
struct State {
  Vector position;                // m, of the torso's centre
  Quaternion rotation;            // btMultiBody::m_baseQuat: from the world's frame to the torso's
  Double velocity[kVelocities];   // rad/s, m/s, rad/s; of the torso in the world's frame
  Double angle[kJoints];          // rad
};

struct Kinematics {
  Quaternion joint_rotation[kJoints];  // from the parent's frame to the child's
  Vector joint_arm[kJoints];           // m, parent's centre of mass to joint, in the child's frame
  Vector origin[kLegs][kLegParts];     // m, the parts' centres of mass
  Matrix torso;                        // rotations to the world's frame: of torso and top parts,
  Matrix moving[kJoints];              // of the parts that hang on the joints

  void update(const Body<Double>& body, const State& state) {
    turn_joints(body, state);
    place_parts(body, state);
  }

  // Rotation of a leg's part to the world's frame.
  const Matrix& rotation(int leg, int part) const {
    return part == kTop ? torso : moving[2 * leg + part - 1];
  }

 private:
  // btMultibodyLink::updateCacheMultiDof: the quaternion (axis, -angle), its axis normalised.
  void turn_joints(const Body<Double>& body, const State& state) {
    for (int j = 0; j < kJoints; ++j) {
      Double s, c;
      for (int l = 0; l < kDoubles; ++l) {
        const double half = -state.angle[j][l] * 0.5;
        double sine, cosine;
        sincos(half, sine, cosine);
        s[l] = sine;
        c[l] = cosine;
      }
      const int leg = j / 2;
      const Double zero = {};
      if (j % 2 == 0) {
        joint_rotation[j] = {zero, zero, s, c};
      } else {
        s = s / sqrt(2.0);  // the axis' length
        joint_rotation[j] = {kAnkleX[leg] * s, s, zero, c};
      }
      joint_arm[j] = rotate(joint_rotation[j], body.legs[leg][j % 2].arm);
    }
  }

  void place_parts(const Body<Double>& body, const State& state) {
    const Quaternion& base = state.rotation;
    torso = matrix(inverse(base));
    for (int leg = 0; leg < kLegs; ++leg) {
      const Part<Double>* parts = body.legs[leg];
      const int hip = 2 * leg, ankle = hip + 1;
      Vector at = state.position + rotate(inverse(base), parts[kTop].arm);
      origin[leg][kTop] = at;
      const Quaternion middle = joint_rotation[hip] * base;
      at = at + rotate(inverse(middle), joint_arm[hip]);
      at = at + rotate(inverse(middle), parts[kMiddle].arm);
      origin[leg][kMiddle] = at;
      const Quaternion bottom = joint_rotation[ankle] * middle;
      at = at + rotate(inverse(bottom), joint_arm[ankle]);
      at = at + rotate(inverse(bottom), parts[kBottom].arm);
      origin[leg][kBottom] = at;
      moving[hip] = matrix(inverse(middle));
      moving[ankle] = matrix(inverse(bottom));
    }
  }
};

}  // namespace ENGINE::ant
