// The random course (BipedalWalker._generate_terrain and _generate_clouds of Gymnasium).
#pragma once

#include "common/random.h"
#include "walker/box2d/world.h"
#include "walker/constants.h"

namespace ENGINE::walker {

// Corners (x1, y1), (x2, y1), (x2, y2), (x1, y2), in this order.
inline void add_obstacle(World& world, double x1, double y1, double x2, double y2) {
  const Vec2 corners[4] = {{float(x1), float(y1)},
                           {float(x2), float(y1)},
                           {float(x2), float(y2)},
                           {float(x1), float(y2)}};
  world.add_rectangle(corners);
}

// Adds a random course to a world without terrain: obstacles as they are drawn, then the ground.
// Coordinates are computed in float64, as Python does, and rounded to float32 by Box2D.
inline void add_course(World& world, Generator& random, bool hardcore) {
  enum { kGrass, kStump, kStairs, kPit, kStates };
  double xs[kTerrainLength], ys[kTerrainLength];
  int64_t state = kGrass, counter = kTerrainStartPad;
  bool first = false;  // the first terrain step of a new state
  double velocity = 0.0, y = kTerrainHeight, original_y = 0.0;
  int64_t stair_steps = 0, stair_width = 0, stair_height = 0;
  const double step = kTerrainStep;

  for (int i = 0; i < kTerrainLength; ++i) {
    double x = i * step;
    xs[i] = x;
    if (state == kGrass && !first) {
      double gap = kTerrainHeight - y;
      double sign = gap > 0.0 ? 1.0 : gap < 0.0 ? -1.0 : 0.0;
      velocity = 0.8 * velocity + 0.01 * sign;
      if (i > kTerrainStartPad) velocity += random.uniform(-1.0, 1.0) / kScale;
      y += velocity;
    } else if (state == kPit && first) {
      counter = random.integers(3, 5);
      double bottom = y - 4 * step;
      add_obstacle(world, x, y, x + step, bottom);
      add_obstacle(world, x + step * counter, y, x + step + step * counter, bottom);
      counter += 2;
      original_y = y;
    } else if (state == kPit) {
      y = original_y;
      if (counter > 1) y -= 4 * step;
    } else if (state == kStump && first) {
      counter = random.integers(1, 3);
      add_obstacle(world, x, y, x + counter * step, y + counter * step);
    } else if (state == kStairs && first) {
      stair_height = random.random() > 0.5 ? 1 : -1;
      stair_width = random.integers(4, 5);
      stair_steps = random.integers(3, 5);
      original_y = y;
      for (int64_t s = 0; s < stair_steps; ++s)
        add_obstacle(world, x + (s * stair_width) * step, y + (s * stair_height) * step,
                     x + ((1 + s) * stair_width) * step, y + (-1 + s * stair_height) * step);
      counter = stair_steps * stair_width;
    } else if (state == kStairs) {
      int64_t s = stair_steps * stair_width - counter - stair_height;
      double n = double(s) / double(stair_width);
      y = original_y + (n * stair_height) * step;
    }
    first = false;
    ys[i] = y;
    if (--counter == 0) {
      counter = random.integers(kTerrainGrass / 2, kTerrainGrass);
      state = state == kGrass && hardcore ? random.integers(1, kStates) : int64_t(kGrass);
      first = true;
    }
  }
  for (int i = 0; i + 1 < kTerrainLength; ++i)
    world.add_edge({float(xs[i]), float(ys[i])}, {float(xs[i + 1]), float(ys[i + 1])});
  world.index.finish();
}

// The force that pushes the hull at the start, N; drawn after the clouds, which only use it up.
inline double start_force(Generator& random) {
  const int clouds = kTerrainLength / 20, draws_per_cloud = 1 + 2 * 5;
  for (int i = 0; i < clouds * draws_per_cloud; ++i) random.random();
  return random.uniform(-kInitialForce, kInitialForce);
}

}  // namespace ENGINE::walker
