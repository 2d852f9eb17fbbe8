// A moving body and a joint: state and mass (b2Body, b2RevoluteJoint).
#pragma once

#include "walker/box2d/shapes.h"

namespace ENGINE::walker {

struct Body {
  Polygon shape;
  float friction;
  float inverse_mass, inverse_inertia;  // 1/kg, 1/(kg m²)
  float radius;                         // m, of the vertices around the centre of mass
  int proxy;                            // leaf of the tree
  Transform xf;
  Sweep sweep;
  Vec2 velocity;           // of the centre of mass, m/s
  float angular_velocity;  // rad/s
  Vec2 force;              // N, for one step
  bool awake;
  float sleep_time;  // s
  float start_angle;  // of the step, and its rotation
  Rot start_rotation;

  // Rotation by an angle; that of the step's start is at hand.
  Rot turn_at(float angle) const {
    return angle == start_angle ? start_rotation : rotation(angle);
  }

  void place(Vec2 position, float angle) {
    xf.p = position;
    xf.q = rotation(angle);
    sweep = {{0.0f, 0.0f}, position, position, angle, angle, 0.0f};
    velocity = force = {0.0f, 0.0f};
    angular_velocity = 0.0f;
    awake = true;
    sleep_time = 0.0f;
  }

  // b2Body::ResetMassData for a body of one fixture.
  void set_mass(float density) {
    Polygon::Mass data = shape.mass(density);
    Vec2 center = data.mass * data.center;
    inverse_mass = 1.0f / data.mass;
    center = inverse_mass * center;
    float inertia = data.inertia - data.mass * dot(center, center);
    inverse_inertia = 1.0f / inertia;
    sweep.local_center = center;
    sweep.c0 = sweep.c = mul(xf, center);
    float radius2 = 0.0f;
    for (int i = 0; i < shape.count; ++i) {
      const Vec2 arm = shape.vertices[i] - center;
      radius2 = maximum(radius2, dot(arm, arm));
    }
    radius = sqrtf(radius2);
  }

  void wake() {
    if (!awake) {
      awake = true;
      sleep_time = 0.0f;
    }
  }
  void sleep() {
    awake = false;
    sleep_time = 0.0f;
    velocity = force = {0.0f, 0.0f};
    angular_velocity = 0.0f;
  }

  void synchronize_transform() {
    xf.q = rotation(sweep.a);
    xf.p = sweep.c - mul(xf.q, sweep.local_center);
  }
  // b2Body::Advance: to the given fraction of the step.
  void advance(float alpha) {
    sweep.advance(alpha);
    sweep.c = sweep.c0;
    sweep.a = sweep.a0;
    synchronize_transform();
  }
};

enum LimitState : int { kInactive, kAtLower, kAtUpper };

struct Joint {
  Vec2 anchor_a, anchor_b;         // m, in the bodies' frames
  float reference_angle;           // rad, of B relative to A
  float lower, upper;              // rad
  float motor_speed, max_torque;   // rad/s, N m
  float impulse_x, impulse_y, impulse_z, motor_impulse;  // N s, N s, N m s, N m s
  LimitState limit;

  void connect(const Body& a, const Body& b, Vec2 at_a, Vec2 at_b, double low, double high) {
    anchor_a = at_a;
    anchor_b = at_b;
    // box2d-py: a definition with both bodies measures the angle from where they start.
    reference_angle = float(double(b.sweep.a) - double(a.sweep.a));
    lower = float(low);
    upper = float(high);
    motor_speed = max_torque = 0.0f;
    impulse_x = impulse_y = impulse_z = motor_impulse = 0.0f;
    limit = kInactive;
  }
};

}  // namespace ENGINE::walker
