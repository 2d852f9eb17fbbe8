// The ten LIDAR rays (b2DynamicTree::RayCast, b2EdgeShape::RayCast, b2PolygonShape::RayCast).
#pragma once

#include "world.h"

namespace ENGINE {

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

// Distance of the terrain along a ray, as a fraction of the ray; 1 where there is none.
//
// closest: the nearest hit (v3). Otherwise (v2) the first hit in the order in which Box2D's tree
// offers its leaves. The walker's own parts are in the tree but never end a ray.
inline float cast_ray(const World& world, Vec2 p1, Vec2 p2, bool closest) {
  const Tree& tree = world.tree;
  Vec2 r = p2 - p1;
  normalize(r);
  const Vec2 v = cross(1.0f, r);
  const Vec2 abs_v = {absolute(v.x), absolute(v.y)};
  Ray ray = {p1, p2, 1.0f};
  Vec2 t = p1 + ray.max_fraction * (p2 - p1);
  Aabb box = {minimum(p1, t), maximum(p1, t)};
  float result = 1.0f;
  int stack[kMaxNodes], count = 0;
  stack[count++] = tree.root;
  while (count > 0) {
    const Tree::Node& node = tree.nodes[stack[--count]];
    if (!overlap(node.box, box)) continue;
    // The segment's normal as a separating axis (Gino van den Bergen, p. 80).
    Vec2 center = 0.5f * (node.box.lower + node.box.upper);
    Vec2 extent = 0.5f * (node.box.upper - node.box.lower);
    if (absolute(dot(v, p1 - center)) - dot(abs_v, extent) > 0.0f) continue;
    if (!node.is_leaf()) {
      stack[count++] = node.child1;
      stack[count++] = node.child2;
      continue;
    }
    if (node.item < kBodies) continue;
    float fraction = cast(world.course.pieces[node.item - kBodies], ray);
    if (fraction < 0.0f) continue;
    result = fraction;
    if (!closest || fraction == 0.0f) return result;
    ray.max_fraction = fraction;
    t = p1 + fraction * (p2 - p1);
    box = {minimum(p1, t), maximum(p1, t)};
  }
  return result;
}

}  // namespace ENGINE
