// Polygons and edges: hull, normals, centroid, mass and boxes (b2PolygonShape, b2EdgeShape).
#pragma once

#include "walker/box2d/math2d.h"
#include "walker/scene.h"

namespace ENGINE::walker {

struct Polygon {
  int count;
  Vec2 vertices[kMaxVertices], normals[kMaxVertices];
  Vec2 centroid;

  // b2PolygonShape::SetAsBox.
  void set_box(float hx, float hy) {
    count = 4;
    vertices[0] = {-hx, -hy};
    vertices[1] = {hx, -hy};
    vertices[2] = {hx, hy};
    vertices[3] = {-hx, hy};
    normals[0] = {0.0f, -1.0f};
    normals[1] = {1.0f, 0.0f};
    normals[2] = {0.0f, 1.0f};
    normals[3] = {-1.0f, 0.0f};
    centroid = {0.0f, 0.0f};
  }

  // b2PolygonShape::Set: gift wrapping from the rightmost point; drops points inside an edge.
  void set(const Vec2* points, int n) {
    int first = 0;
    for (int i = 1; i < n; ++i)
      if (points[i].x > points[first].x ||
          (points[i].x == points[first].x && points[i].y < points[first].y))
        first = i;
    count = 0;
    int at = first;
    do {
      vertices[count++] = points[at];
      int next = 0;
      for (int j = 1; j < n; ++j) {
        if (next == at) {
          next = j;
          continue;
        }
        Vec2 r = points[next] - points[at], v = points[j] - points[at];
        float side = cross(r, v);
        if (side < 0.0f || (side == 0.0f && dot(v, v) > dot(r, r))) next = j;
      }
      at = next;
    } while (at != first);
    for (int i = 0; i < count; ++i) {
      normals[i] = right_normal(vertices[i + 1 < count ? i + 1 : 0] - vertices[i]);
      normalize(normals[i]);
    }
    compute_centroid();
  }

  Aabb aabb(const Transform& xf) const {
    Vec2 lower = mul(xf, vertices[0]), upper = lower;
    for (int i = 1; i < count; ++i) {
      Vec2 v = mul(xf, vertices[i]);
      lower = minimum(lower, v);
      upper = maximum(upper, v);
    }
    Vec2 skin = {kSkin, kSkin};
    return {lower - skin, upper + skin};
  }

  struct Mass {
    float mass;     // kg
    Vec2 center;    // m
    float inertia;  // kg m², about the body's origin
  };

  // b2PolygonShape::ComputeMass: sums over triangles around the vertices' mean.
  Mass mass(float density) const {
    Vec2 s = {0.0f, 0.0f};
    for (int i = 0; i < count; ++i) s = s + vertices[i];
    s = (1.0f / count) * s;
    const float third = 1.0f / 3.0f;
    Vec2 center = {0.0f, 0.0f};
    float area = 0.0f, inertia = 0.0f;
    for (int i = 0; i < count; ++i) {
      Vec2 e1 = vertices[i] - s, e2 = vertices[i + 1 < count ? i + 1 : 0] - s;
      float d = cross(e1, e2);
      float triangle = 0.5f * d;
      area += triangle;
      center = center + (triangle * third) * (e1 + e2);
      float x2 = e1.x * e1.x + e2.x * e1.x + e2.x * e2.x;
      float y2 = e1.y * e1.y + e2.y * e1.y + e2.y * e2.y;
      inertia += (0.25f * third * d) * (x2 + y2);
    }
    Mass result;
    result.mass = density * area;
    center = (1.0f / area) * center;
    result.center = center + s;
    result.inertia = density * inertia;
    result.inertia += result.mass * (dot(result.center, result.center) - dot(center, center));
    return result;
  }

 private:
  void compute_centroid() {
    Vec2 c = {0.0f, 0.0f};
    float area = 0.0f;
    const float third = 1.0f / 3.0f;
    for (int i = 0; i < count; ++i) {
      Vec2 p2 = vertices[i], p3 = vertices[i + 1 < count ? i + 1 : 0];
      float triangle = 0.5f * cross(p2, p3);
      area += triangle;
      c = c + (triangle * third) * (p2 + p3);
    }
    centroid = (1.0f / area) * c;
  }
};

// A piece of terrain, at rest in the world's frame: an edge or a polygon. Box2D gives it the
// identity transform, whose products leave every coordinate as it is.
struct Terrain {
  bool is_edge;
  int proxy;      // leaf of the tree
  float alpha0;   // of its sweep: bodies that do not move still take part in b2Sweep::Advance
  Vec2 v1, v2;    // edge: ends
  Vec2 normal;    // edge: to the right of v1 -> v2, unit length
  Polygon polygon;
  Aabb box;       // with the skin

  void set_edge(Vec2 a, Vec2 b) {
    is_edge = true;
    v1 = a;
    v2 = b;
    Vec2 e = v2 - v1;
    normalize(e);
    normal = right_normal(e);
    const Vec2 skin = {kSkin, kSkin};
    box = {minimum(v1, v2) - skin, maximum(v1, v2) + skin};
  }
  void set_rectangle(const Vec2* corners) {
    is_edge = false;
    polygon.set(corners, 4);
    box = polygon.aabb({{0.0f, 0.0f}, {0.0f, 1.0f}});
  }
  int vertex_count() const { return is_edge ? 2 : polygon.count; }
  const Vec2* vertices() const { return is_edge ? &v1 : polygon.vertices; }
};

}  // namespace ENGINE::walker
