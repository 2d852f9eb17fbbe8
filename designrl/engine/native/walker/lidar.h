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

// All rays of one walker, in vectors.
//
// Box2D casts one ray after the other. Here they go down the tree together: a node is opened if any
// ray passes its tests, and each ray meets its own leaves in the order in which it would alone.
class RayFan {
 public:
  // end_x, end_y: (kRays,) where the rays end.
  RayFan(Vec2 origin, const float* end_x, const float* end_y) : origin_(origin) {
    for (int i = 0; i < kPadded; ++i) {
      end_x_.number[i] = end_x[i < kRays ? i : 0];
      end_y_.number[i] = end_y[i < kRays ? i : 0];
      fraction_[i] = max_fraction_[i] = 1.0f;
    }
    const Vector one = Vector{} + 1.0f;
    for (int v = 0; v < kVectors; ++v) {
      // Unit normal of each ray, a quarter turn to the left of its direction; rays are 5 m long.
      const Vector dx = end_x_.vector[v] - origin.x, dy = end_y_.vector[v] - origin.y;
      const Vector inverse = one / square_root(dx * dx + dy * dy);
      const Vector x = -(dy * inverse), y = dx * inverse;
      normal_x_[v] = x;
      normal_y_[v] = y;
      absolute_x_[v] = maximum(x, -x);
      absolute_y_[v] = maximum(y, -y);
      const Vector start_x = Vector{} + origin.x, start_y = Vector{} + origin.y;
      const Vector tx = origin.x + dx, ty = origin.y + dy;
      low_x_.vector[v] = minimum(start_x, tx);
      low_y_.vector[v] = minimum(start_y, ty);
      high_x_.vector[v] = maximum(start_x, tx);
      high_y_.vector[v] = maximum(start_y, ty);
    }
  }

  // Fractions of the rays at which they meet the terrain, (kRays,); 1 where there is none.
  //
  // closest: at the nearest hit (v3). Otherwise (v2) at the first one in the order in which the
  // tree offers its leaves. The walker's own parts are in the tree but never end a ray.
  const float* cast_all(const World& world, bool closest) {
    const Tree& tree = world.tree;
    // Nodes yet to visit, with the rays that passed their parents' tests above the node's index.
    uint64_t stack[kMaxNodes];
    int count = 0;
    uint32_t open = (1u << kRays) - 1;  // rays that have not ended
    int index = tree.root;
    uint32_t rays = open;
    for (;;) {
      const Tree::Node& node = tree.nodes[index];
      rays &= passing(node.box);
      if (rays && !node.is_leaf()) {
        stack[count++] = uint64_t(rays) << 32 | uint32_t(node.child1);
        index = node.child2;
        continue;
      }
      if (rays && node.item >= kBodies) {
        const Terrain& terrain = world.terrain[node.item - kBodies];
        for (; rays; rays &= rays - 1) {
          const int i = __builtin_ctz(rays);
          const float fraction =
              cast(terrain, {origin_, {end_x_.number[i], end_y_.number[i]}, max_fraction_[i]});
          if (fraction < 0.0f) continue;
          fraction_[i] = fraction;
          if (!closest || fraction == 0.0f) open &= ~(1u << i);
          else shorten(i, fraction);
        }
      }
      do {
        if (count == 0) return fraction_;
        --count;
        index = int(uint32_t(stack[count]));
        rays = uint32_t(stack[count] >> 32) & open;
      } while (!rays);
    }
  }

 private:
  static constexpr int kVectors = (kRays + kWidth - 1) / kWidth, kPadded = kVectors * kWidth;
  union Numbers {
    Vector vector[kVectors];
    float number[kPadded];
  };
  Vec2 origin_;
  Numbers end_x_, end_y_;
  Vector normal_x_[kVectors], normal_y_[kVectors], absolute_x_[kVectors], absolute_y_[kVectors];
  Numbers low_x_, low_y_, high_x_, high_y_;  // box around what is left of a ray
  float fraction_[kPadded], max_fraction_[kPadded];

  void shorten(int i, float fraction) {
    max_fraction_[i] = fraction;
    const Vec2 end = {end_x_.number[i], end_y_.number[i]};
    const Vec2 t = origin_ + fraction * (end - origin_);
    const Vec2 lower = minimum(origin_, t), upper = maximum(origin_, t);
    low_x_.number[i] = lower.x;
    low_y_.number[i] = lower.y;
    high_x_.number[i] = upper.x;
    high_y_.number[i] = upper.y;
  }

  // The rays, as bits, that b2DynamicTree::RayCast would let into a node: those whose box overlaps
  // the node's and whose line is no separating axis (Gino van den Bergen, p. 80).
  uint32_t passing(const Aabb& box) const {
    const Vec2 center = 0.5f * (box.lower + box.upper);
    const Vec2 extent = 0.5f * (box.upper - box.lower);
    const Vec2 d = origin_ - center;
    const Vector zero = {};
    uint32_t bits = 0;
    for (int v = 0; v < kVectors; ++v) {
      const Vector along = normal_x_[v] * d.x + normal_y_[v] * d.y;
      const Vector distance = maximum(along, -along);
      const Vector reach = absolute_x_[v] * extent.x + absolute_y_[v] * extent.y;
      const Vector low_x = zero + box.lower.x, high_x = zero + box.upper.x;
      const Vector low_y = zero + box.lower.y, high_y = zero + box.upper.y;
      const Mask left_or_right =
          either(less(high_x, low_x_.vector[v]), less(high_x_.vector[v], low_x));
      const Mask below_or_above =
          either(less(high_y, low_y_.vector[v]), less(high_y_.vector[v], low_y));
      const Mask apart = either(either(left_or_right, below_or_above), less(reach, distance));
      bits |= (~lane_bits(apart) & kAllLanes) << (v * kWidth);
    }
    return bits;
  }
};

}  // namespace ENGINE::walker
