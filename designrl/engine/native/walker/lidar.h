// The ten LIDAR rays (b2DynamicTree::RayCast, b2EdgeShape::RayCast, b2PolygonShape::RayCast).
#pragma once

#include "common/lanes.h"
#include "walker/box2d/world.h"
#include "walker/constants.h"

namespace ENGINE::walker {

// Fraction of a ray at which it meets the terrain, at most max_fraction; -1 where it does not. F: a
// number, or a vector of rays from the same point. dx, dy: from there to the ray's end, m.
template <class F>
inline F cast(const Terrain& terrain, Vec2 origin, F dx, F dy, F max_fraction) {
  const F zero = {}, one = zero + 1.0f;
  if (terrain.is_edge) {
    const Vec2 n = terrain.normal, from = terrain.v1, r = terrain.v2 - terrain.v1;
    const float rr = dot(r, r);
    if (rr == 0.0f) return -one;
    const F denominator = n.x * dx + n.y * dy;
    const F t = dot(n, from - origin) / denominator;
    const F x = origin.x + t * dx, y = origin.y + t * dy;
    const F along = (x - from.x) * r.x + (y - from.y) * r.y;  // over rr, in the range of 0 to 1
    // A ray along the edge has no numbers here, or infinite ones: not in these ranges.
    const auto on_ray = both(at_least(t, zero), at_least(max_fraction, t));
    return select(both(on_ray, both(at_least(along, zero), at_least(zero + rr, along))), t, -one);
  }
  const Polygon& polygon = terrain.polygon;
  F lower = zero, upper = max_fraction;
  auto enters = less(zero, zero), misses = enters;
  for (int i = 0; i < polygon.count; ++i) {
    const Vec2 n = polygon.normals[i];
    const F numerator = zero + dot(n, polygon.vertices[i] - origin);
    const F denominator = n.x * dx + n.y * dy;
    const F t = numerator / denominator;
    const auto in = less(denominator, zero), out = less(zero, denominator);
    misses = either(misses, but_not(less(numerator, zero), either(in, out)));
    const auto later = both(in, less(numerator, lower * denominator));
    const auto sooner = both(out, less(numerator, upper * denominator));
    lower = select(later, t, lower);
    upper = select(sooner, t, upper);
    enters = either(enters, later);
    misses = either(misses, less(upper, lower));
  }
  return select(but_not(enters, misses), lower, -one);
}

// All rays of one walker.
//
// Box2D casts one ray after the other down the tree. Here all rays are cast at each piece of
// terrain that is near; what of several hits counts is left to the tree's order.
class RayFan {
 public:
  // end_x, end_y: (kRays,) where the rays end.
  RayFan(Vec2 origin, const float* end_x, const float* end_y) : origin_(origin) {
    box_ = {origin, origin};
    for (int i = 0; i < kPadded; ++i) {
      const Vec2 end = {end_x[i < kRays ? i : 0], end_y[i < kRays ? i : 0]};
      dx_.number[i] = end.x - origin.x;
      dy_.number[i] = end.y - origin.y;
      box_ = {minimum(box_.lower, end), maximum(box_.upper, end)};
    }
  }

  // Fractions of the rays at which they meet the terrain, (kRays,); 1 where there is none.
  //
  // closest: at the nearest hit (v3). Otherwise (v2) at the first one in the order in which the
  // tree offers its leaves. The walker's own parts are in the tree but never end a ray.
  void cast_all(const World& world, bool closest, float* fractions) {
    int16_t pieces[kRays][kMaxTerrain];  // that a ray meets, in the tree's order; v2: the first one
    int counts[kRays] = {};
    for (int i = 0; i < kRays; ++i) fractions[i] = 1.0f;
    world.index.each(box_.lower.x, box_.upper.x, [&](int piece) {
      if (!overlap(world.index.box(piece), box_)) return;
      Numbers hits;
      int asked = -1;  // for the ray before, of the same other piece
      bool before = false;
      for (uint32_t rays = meeting(world.terrain[piece], hits); rays; rays &= rays - 1) {
        const int i = __builtin_ctz(rays);
        int at = counts[i];
        const int leaf = world.terrain[piece].proxy;
        for (; at > 0; --at) {
          const int other = pieces[i][at - 1];
          if (other != asked) before = world.tree.before(leaf, world.terrain[other].proxy);
          asked = other;
          if (!before) break;
          pieces[i][at] = pieces[i][at - 1];
        }
        if (!closest && at > 0) continue;
        pieces[i][at] = int16_t(piece);
        counts[i] = closest ? counts[i] + 1 : 1;
        if (at == 0) fractions[i] = hits.number[i];
      }
    });
    if (!closest) return;
    // Each hit makes the ray shorter for those after it.
    for (int i = 0; i < kRays; ++i)
      for (int k = 1; k < counts[i] && fractions[i] > 0.0f; ++k) {
        const float fraction = cast(world.terrain[pieces[i][k]], origin_, dx_.number[i],
                                    dy_.number[i], fractions[i]);
        if (fraction >= 0.0f) fractions[i] = fraction;
      }
  }

 private:
  static constexpr int kVectors = (kRays + kWidth - 1) / kWidth, kPadded = kVectors * kWidth;
  union Numbers {
    Vector vector[kVectors];
    float number[kPadded];
  };
  Vec2 origin_;
  Numbers dx_, dy_;  // from there to the rays' ends
  Aabb box_;         // around all rays

  // The rays, as bits, that meet a piece, and where.
  uint32_t meeting(const Terrain& terrain, Numbers& fractions) const {
    uint32_t bits = 0;
    for (int v = 0; v < kVectors; ++v) {
      const Vector all = Vector{} + 1.0f;
      const Vector hits = cast(terrain, origin_, dx_.vector[v], dy_.vector[v], all);
      fractions.vector[v] = hits;
      bits |= lane_bits(at_least(hits, Vector{})) << (v * kWidth);
    }
    return bits & ((1u << kRays) - 1);
  }
};

}  // namespace ENGINE::walker
