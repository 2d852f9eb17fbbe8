// The ten LIDAR rays (b2DynamicTree::RayCast, b2EdgeShape::RayCast, b2PolygonShape::RayCast).
#pragma once

#include "common/lanes.h"
#include "walker/box2d/world.h"
#include "walker/constants.h"

namespace ENGINE::walker {

struct Ray {
  Vec2 p1, p2;         // from and to, m
  float max_fraction;  // of the way that still counts
};

// Fraction of the ray at which it meets the terrain; negative where it does not.
inline float cast(const Terrain& terrain, const Ray& ray) {
  const float miss = -1.0f;
  Vec2 d = ray.p2 - ray.p1;
  if (terrain.is_edge) {
    float numerator = dot(terrain.normal, terrain.v1 - ray.p1);
    float denominator = dot(terrain.normal, d);
    if (denominator == 0.0f) return miss;
    float t = numerator / denominator;
    if (t < 0.0f || ray.max_fraction < t) return miss;
    Vec2 q = ray.p1 + t * d;
    Vec2 r = terrain.v2 - terrain.v1;
    float rr = dot(r, r);
    if (rr == 0.0f) return miss;
    float s = dot(q - terrain.v1, r) / rr;
    return s < 0.0f || 1.0f < s ? miss : t;
  }
  const Polygon& polygon = terrain.polygon;
  float lower = 0.0f, upper = ray.max_fraction;
  bool enters = false;
  for (int i = 0; i < polygon.count; ++i) {
    float numerator = dot(polygon.normals[i], polygon.vertices[i] - ray.p1);
    float denominator = dot(polygon.normals[i], d);
    if (denominator == 0.0f) {
      if (numerator < 0.0f) return miss;
    } else if (denominator < 0.0f && numerator < lower * denominator) {
      lower = numerator / denominator;
      enters = true;
    } else if (denominator > 0.0f && numerator < upper * denominator) {
      upper = numerator / denominator;
    }
    if (upper < lower) return miss;
  }
  return enters ? lower : miss;
}

// All rays of one walker.
//
// Box2D casts one ray after the other down the tree. Here vectors of rays are held against each
// piece of terrain that is near. Those that may meet it are then cast at it, each ray at its own
// pieces in the order in which the tree would offer them.
class RayFan {
 public:
  // end_x, end_y: (kRays,) where the rays end.
  RayFan(Vec2 origin, const float* end_x, const float* end_y) : origin_(origin) {
    for (int i = 0; i < kPadded; ++i) {
      end_x_.number[i] = end_x[i < kRays ? i : 0];
      end_y_.number[i] = end_y[i < kRays ? i : 0];
    }
    box_ = {origin, origin};
    for (int i = 0; i < kRays; ++i) {
      const Vec2 end = {end_x[i], end_y[i]};
      box_ = {minimum(box_.lower, end), maximum(box_.upper, end)};
    }
  }

  // Fractions of the rays at which they meet the terrain, (kRays,); 1 where there is none.
  //
  // closest: at the nearest hit (v3). Otherwise (v2) at the first one in the order in which the
  // tree offers its leaves. The walker's own parts are in the tree but never end a ray.
  void cast_all(const World& world, bool closest, float* fractions) {
    int16_t pieces[kRays][kMaxTerrain];  // that a ray may meet, in the tree's order
    int counts[kRays] = {};
    world.index.each(box_.lower.x, box_.upper.x, [&](int piece) {
      if (!overlap(world.index.box(piece), box_)) return;
      for (uint32_t rays = meeting(world, piece); rays; rays &= rays - 1) {
        const int i = __builtin_ctz(rays);
        int at = counts[i]++;
        const int leaf = world.terrain[piece].proxy;
        for (; at > 0; --at) {
          if (!world.tree.before(leaf, world.terrain[pieces[i][at - 1]].proxy)) break;
          pieces[i][at] = pieces[i][at - 1];
        }
        pieces[i][at] = int16_t(piece);
      }
    });
    for (int i = 0; i < kRays; ++i) {
      Ray ray = {origin_, {end_x_.number[i], end_y_.number[i]}, 1.0f};
      fractions[i] = 1.0f;
      for (int k = 0; k < counts[i]; ++k) {
        const float fraction = cast(world.terrain[pieces[i][k]], ray);
        if (fraction < 0.0f) continue;
        fractions[i] = ray.max_fraction = fraction;
        if (!closest || fraction == 0.0f) break;
      }
    }
  }

 private:
  static constexpr int kVectors = (kRays + kWidth - 1) / kWidth, kPadded = kVectors * kWidth;
  // Room for rounding, m²: rays are 5 m long, and coordinates reach 100 m, where float32 resolves
  // 8e-6 m.
  static constexpr float kSlack = 0.01f;
  union Numbers {
    Vector vector[kVectors];
    float number[kPadded];
  };
  Vec2 origin_;
  Numbers end_x_, end_y_;
  Aabb box_;  // around all rays

  // The rays, as bits, that may meet a piece: their line has vertices on both sides, and their
  // boxes overlap.
  uint32_t meeting(const World& world, int piece) const {
    const Terrain& terrain = world.terrain[piece];
    const Aabb& box = world.index.box(piece);
    const Vec2* vertices = terrain.vertices();
    const int count = terrain.vertex_count();
    uint32_t bits = 0;
    for (int v = 0; v < kVectors; ++v) {
      const Vector end_x = end_x_.vector[v], end_y = end_y_.vector[v];
      const Vector dx = end_x - origin_.x, dy = end_y - origin_.y;
      Vector low = Vector{} + kMaxFloat, high = -low;
      for (int k = 0; k < count; ++k) {
        const Vec2 to = vertices[k] - origin_;
        const Vector side = dx * to.y - dy * to.x;
        low = minimum(low, side);
        high = maximum(high, side);
      }
      const Vector slack = Vector{} + kSlack;
      const Vector x = Vector{} + origin_.x, y = Vector{} + origin_.y;
      const Mask beside = either(less(slack, low), less(high, -slack));
      const Mask left_or_right = either(less(maximum(x, end_x), Vector{} + box.lower.x),
                                        less(Vector{} + box.upper.x, minimum(x, end_x)));
      const Mask below_or_above = either(less(maximum(y, end_y), Vector{} + box.lower.y),
                                         less(Vector{} + box.upper.y, minimum(y, end_y)));
      const Mask apart = either(beside, either(left_or_right, below_or_above));
      bits |= (~lane_bits(apart) & kAllLanes) << (v * kWidth);
    }
    return bits & ((1u << kRays) - 1);
  }
};

}  // namespace ENGINE::walker
