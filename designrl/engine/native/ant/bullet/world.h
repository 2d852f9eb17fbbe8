// btMultiBodyDynamicsWorld::stepSimulation of as many ants as there are lanes, each alone on its
// floor.
#pragma once

#include <string.h>

#include "ant/bullet/constraint_solver.h"

namespace ENGINE::ant {

// What a step leaves to the next one: vectors, nothing else.
struct WorldState {
  Body<Double> body;
  State state;
  Double torque[kJoints];  // N m, of the coming step
  Kinematics parts;
  Contacts contacts;
  // What getLinkStates shows: the parts as they were before the last substep.
  Vector shown_origin[kLegs][kLegParts];
  Matrix shown_torso;

  // One lane's numbers.
  void save(int l, char* to) const {
    const Double* vectors = reinterpret_cast<const Double*>(this);
    for (size_t i = 0; i < sizeof *this / sizeof *vectors; ++i) {
      const double number = vectors[i][l];
      memcpy(to + i * sizeof number, &number, sizeof number);
    }
  }
  void restore(int l, const char* from) {
    Double* vectors = reinterpret_cast<Double*>(this);
    for (size_t i = 0; i < sizeof *this / sizeof *vectors; ++i) {
      double number;
      memcpy(&number, from + i * sizeof number, sizeof number);
      vectors[i][l] = number;
    }
  }
};

struct World : WorldState {
  // Puts an ant into a lane: level and at rest, with joints at these angles, (kJoints,) rad.
  void place(int l, const Body<double>& one, const double* angles) {
    set_lane(body, l, one);
    set_lane(state.position, l, {0.0, 0.0, kTorsoHeight});
    state.rotation.x[l] = state.rotation.y[l] = state.rotation.z[l] = 0.0;
    state.rotation.w[l] = 1.0;
    for (Double& v : state.velocity) v[l] = 0.0;
    for (int j = 0; j < kJoints; ++j) {
      state.angle[j][l] = angles[j];
      torque[j][l] = 0.0;
    }
    contacts.clear(l);
    place_parts(l);
  }

  // Another body for a lane's ant: its joints keep their angles and speeds, the torso its velocity,
  // and the whole its height above the floor.
  void change_body(int l, const Body<double>& one) {
    const double height = lowest(l);
    set_lane(body, l, one);
    parts.update(body, state);
    state.position.z[l] += height - lowest(l);
    contacts.clear(l);
    place_parts(l);
  }

  void step() {
    for (int i = 0; i < kSubsteps; ++i) {
      if (i == kSubsteps - 1) {
        for (int leg = 0; leg < kLegs; ++leg)
          for (int k = 0; k < kLegParts; ++k) shown_origin[leg][k] = parts.origin[leg][k];
        shown_torso = parts.torso;
      }
      contacts.update(body, state, parts);
      articulated_.accelerate(body, parts, torque, state);
      solver_.solve(body, parts, contacts, articulated_, state);
      integrate();
      parts.update(body, state);
    }
  }

 private:
  Articulated articulated_;
  ConstraintSolver solver_;

  void place_parts(int l) {
    parts.update(body, state);  // of the other lanes, too: it finds there what it has found before
    for (int leg = 0; leg < kLegs; ++leg)
      for (int k = 0; k < kLegParts; ++k)
        set_lane(shown_origin[leg][k], l, lane_of(parts.origin[leg][k], l));
    for (int i = 0; i < 3; ++i) set_lane(shown_torso.row[i], l, lane_of(parts.torso.row[i], l));
  }

  // m, of an ant's lowest point.
  double lowest(int l) const {
    double found = state.position.z[l] - body.torso.radius[l];
    for (int leg = 0; leg < kLegs; ++leg)
      for (int k = 0; k < kLegParts; ++k) {
        const Part<Double>& part = body.legs[leg][k];
        const Vec3<double> half = lane_of(parts.rotation(leg, k), l) * lane_of(part.arm, l);
        const double z = parts.origin[leg][k].z[l] - fabs(half.z) - part.radius[l];
        found = z < found ? z : found;
      }
    return found;
  }

  // btMultiBody::stepPositionsMultiDof.
  void integrate() {
    constexpr double h = kSubstep;
    const Double* v = state.velocity;
    state.position.x = state.position.x + h * v[3];
    state.position.y = state.position.y + h * v[4];
    state.position.z = state.position.z + h * v[5];

    const Vector turn = {v[0], v[1], v[2]};
    Double speed = square_root(dot(turn, turn)), sine, cosine;
    speed = select(less(splat(kMaxTurn), speed * h), splat(kMaxTurn / h), speed);
    for (int l = 0; l < kDoubles; ++l) {
      sine[l] = ENGINE::sine(0.5 * speed[l] * h);
      cosine[l] = ENGINE::cosine(speed[l] * h * 0.5);
    }
    // sin(speed h / 2) / speed, near 0 by its Taylor series.
    const Double share = select(less(speed, splat(0.001)),
                                0.5 * h - ((h * h * h) * 0.020833333333) * speed * speed,
                                sine / speed);
    const Quaternion by = {-(turn.x * share), -(turn.y * share), -(turn.z * share), cosine};
    const Quaternion q = state.rotation * by;
    const Double inverse_length = 1.0 / square_root(length_squared(q));
    state.rotation = {q.x * inverse_length, q.y * inverse_length, q.z * inverse_length,
                      q.w * inverse_length};
    for (int j = 0; j < kJoints; ++j) state.angle[j] = state.angle[j] + h * v[6 + j];
  }
};

}  // namespace ENGINE::ant
