// Where a moving polygon touches a piece of terrain (b2CollideEdge.cpp, b2CollidePolygon.cpp).
//
// The terrain is always shape A and the moving body shape B: Box2D orders a pair by tree node, and
// the terrain is created first. The terrain's transform is the identity, so it is left out.
#pragma once

#include "walker/box2d/shapes.h"

namespace ENGINE::walker {

// What two points of contact have in common from step to step: the features that met.
struct FeatureId {
  uint8_t index_a, index_b, type_a, type_b;
  bool operator==(const FeatureId& o) const {
    return index_a == o.index_a && index_b == o.index_b && type_a == o.type_a && type_b == o.type_b;
  }
};
enum : uint8_t { kVertex, kFace };

struct ManifoldPoint {
  Vec2 local;  // in B's frame (face of A) or A's (face of B)
  float normal_impulse, tangent_impulse;
  FeatureId id;
};

struct Manifold {
  ManifoldPoint points[2];
  Vec2 normal, point;  // of the face, in its own shape's frame
  bool face_a;         // the face belongs to A
  int count;
};

struct ClipVertex {
  Vec2 v;
  FeatureId id;
};

// b2ClipSegmentToLine (Sutherland-Hodgman): the part of a segment behind a line.
inline int clip_segment(ClipVertex out[2], const ClipVertex in[2], Vec2 normal, float offset,
                        int vertex_a) {
  int count = 0;
  float d0 = dot(normal, in[0].v) - offset, d1 = dot(normal, in[1].v) - offset;
  if (d0 <= 0.0f) out[count++] = in[0];
  if (d1 <= 0.0f) out[count++] = in[1];
  if (d0 * d1 < 0.0f) {
    float t = d0 / (d0 - d1);
    out[count].v = in[0].v + t * (in[1].v - in[0].v);
    out[count].id = {uint8_t(vertex_a), in[0].id.index_b, kVertex, kFace};
    ++count;
  }
  return count;
}

// Hysteresis in the choice of the reference face.
constexpr float kRelativeTolerance = 0.98f, kAbsoluteTolerance = 0.001f;

// b2EPCollider::Collide for an edge without neighbours. Then the range of allowed normals is a
// half circle whose limits the test for adjacency never excludes, and that test is left out.
inline void collide_edge(Manifold& manifold, const Terrain& edge, const Polygon& polygon,
                         const Transform& xf) {
  manifold.count = 0;
  const int n = polygon.count;
  const float radius = 2.0f * kSkin;
  bool front = dot(edge.normal, mul(xf, polygon.centroid) - edge.v1) >= 0.0f;
  Vec2 normal = front ? edge.normal : -edge.normal;

  Vec2 vertices[kMaxVertices], normals[kMaxVertices];
  float edge_separation = kMaxFloat;
  for (int i = 0; i < n; ++i) {
    vertices[i] = mul(xf, polygon.vertices[i]);
    float s = dot(normal, vertices[i] - edge.v1);
    if (s < edge_separation) edge_separation = s;
  }
  if (edge_separation > radius) return;

  int best = -1;
  float polygon_separation = -kMaxFloat;
  for (int i = 0; i < n; ++i) {
    normals[i] = mul(xf.q, polygon.normals[i]);
    Vec2 outward = -normals[i];
    float s1 = dot(outward, vertices[i] - edge.v1), s2 = dot(outward, vertices[i] - edge.v2);
    float s = minimum(s1, s2);
    if (s > radius) return;
    if (s > polygon_separation) {
      polygon_separation = s;
      best = i;
    }
  }

  bool face_a =
      !(polygon_separation > kRelativeTolerance * edge_separation + kAbsoluteTolerance);
  ClipVertex incident[2];
  int i1, i2;
  Vec2 v1, v2, face;
  if (face_a) {
    // The polygon's side that faces the edge most.
    int side = 0;
    float smallest = dot(normal, normals[0]);
    for (int i = 1; i < n; ++i) {
      float value = dot(normal, normals[i]);
      if (value < smallest) {
        smallest = value;
        side = i;
      }
    }
    int next = side + 1 < n ? side + 1 : 0;
    incident[0] = {vertices[side], {0, uint8_t(side), kFace, kVertex}};
    incident[1] = {vertices[next], {0, uint8_t(next), kFace, kVertex}};
    i1 = front ? 0 : 1;
    i2 = 1 - i1;
    v1 = front ? edge.v1 : edge.v2;
    v2 = front ? edge.v2 : edge.v1;
    face = normal;
  } else {
    incident[0] = {edge.v1, {0, uint8_t(best), kVertex, kFace}};
    incident[1] = {edge.v2, {0, uint8_t(best), kVertex, kFace}};
    i1 = best;
    i2 = best + 1 < n ? best + 1 : 0;
    v1 = vertices[i1];
    v2 = vertices[i2];
    face = normals[i1];
  }
  Vec2 side1 = right_normal(face), side2 = -side1;
  ClipVertex clipped1[2], clipped2[2];
  if (clip_segment(clipped1, incident, side1, dot(side1, v1), i1) < 2) return;
  if (clip_segment(clipped2, clipped1, side2, dot(side2, v2), i2) < 2) return;

  manifold.face_a = face_a;
  manifold.normal = face_a ? face : polygon.normals[i1];
  manifold.point = face_a ? v1 : polygon.vertices[i1];
  for (int i = 0; i < 2; ++i) {
    if (dot(face, clipped2[i].v - v1) > radius) continue;
    ManifoldPoint& point = manifold.points[manifold.count++];
    FeatureId id = clipped2[i].id;
    if (face_a) {
      point.local = mul_t(xf, clipped2[i].v);
      point.id = id;
    } else {
      point.local = clipped2[i].v;
      point.id = {id.index_b, id.index_a, id.type_b, id.type_a};
    }
  }
}

// A polygon where it is.
struct Placed {
  const Polygon* polygon;
  Transform xf;
};

// b2EdgeSeparation: distance of b's nearest vertex from a side of a.
inline float side_separation(const Placed& a, int side, const Placed& b) {
  Vec2 normal_world = mul(a.xf.q, a.polygon->normals[side]);
  Vec2 normal = mul_t(b.xf.q, normal_world);
  int index = 0;
  float smallest = kMaxFloat;
  for (int i = 0; i < b.polygon->count; ++i) {
    float value = dot(b.polygon->vertices[i], normal);
    if (value < smallest) {
      smallest = value;
      index = i;
    }
  }
  Vec2 v1 = mul(a.xf, a.polygon->vertices[side]), v2 = mul(b.xf, b.polygon->vertices[index]);
  return dot(v2 - v1, normal_world);
}

// b2FindMaxSeparation: hill climbing from the side of a that faces b's centroid.
inline float max_separation(int& side, const Placed& a, const Placed& b) {
  const int n = a.polygon->count;
  Vec2 d = mul_t(a.xf.q, mul(b.xf, b.polygon->centroid) - mul(a.xf, a.polygon->centroid));
  side = 0;
  float largest = -kMaxFloat;
  for (int i = 0; i < n; ++i) {
    float value = dot(a.polygon->normals[i], d);
    if (value > largest) {
      largest = value;
      side = i;
    }
  }
  int previous = side - 1 >= 0 ? side - 1 : n - 1, next = side + 1 < n ? side + 1 : 0;
  float s = side_separation(a, side, b);
  float s_previous = side_separation(a, previous, b), s_next = side_separation(a, next, b);
  bool down = s_previous > s && s_previous > s_next;
  if (!down && !(s_next > s)) return s;
  float best = down ? s_previous : s_next;
  side = down ? previous : next;
  for (;;) {
    int candidate = down ? (side - 1 >= 0 ? side - 1 : n - 1) : (side + 1 < n ? side + 1 : 0);
    s = side_separation(a, candidate, b);
    if (!(s > best)) return best;
    side = candidate;
    best = s;
  }
}

// b2CollidePolygons.
inline void collide_polygons(Manifold& manifold, const Polygon& terrain, const Polygon& polygon,
                             const Transform& xf) {
  manifold.count = 0;
  const float radius = kSkin + kSkin;
  Placed a = {&terrain, {{0.0f, 0.0f}, {0.0f, 1.0f}}}, b = {&polygon, xf};
  int side_a, side_b;
  float separation_a = max_separation(side_a, a, b);
  if (separation_a > radius) return;
  float separation_b = max_separation(side_b, b, a);
  if (separation_b > radius) return;

  bool face_a = !(separation_b > kRelativeTolerance * separation_a + kAbsoluteTolerance);
  const Placed &reference = face_a ? a : b, &other = face_a ? b : a;
  const int side = face_a ? side_a : side_b;

  // b2FindIncidentEdge: the other polygon's side that faces the reference side most.
  Vec2 towards = mul_t(other.xf.q, mul(reference.xf.q, reference.polygon->normals[side]));
  int i1 = 0;
  float smallest = kMaxFloat;
  for (int i = 0; i < other.polygon->count; ++i) {
    float value = dot(towards, other.polygon->normals[i]);
    if (value < smallest) {
      smallest = value;
      i1 = i;
    }
  }
  int i2 = i1 + 1 < other.polygon->count ? i1 + 1 : 0;
  ClipVertex incident[2] = {
      {mul(other.xf, other.polygon->vertices[i1]), {uint8_t(side), uint8_t(i1), kFace, kVertex}},
      {mul(other.xf, other.polygon->vertices[i2]), {uint8_t(side), uint8_t(i2), kFace, kVertex}}};

  int next = side + 1 < reference.polygon->count ? side + 1 : 0;
  Vec2 v1 = reference.polygon->vertices[side], v2 = reference.polygon->vertices[next];
  Vec2 local_tangent = v2 - v1;
  normalize(local_tangent);
  Vec2 local_normal = right_normal(local_tangent);
  Vec2 middle = 0.5f * (v1 + v2);
  Vec2 tangent = mul(reference.xf.q, local_tangent);
  Vec2 normal = right_normal(tangent);
  v1 = mul(reference.xf, v1);
  v2 = mul(reference.xf, v2);
  float front = dot(normal, v1);
  float offset1 = -dot(tangent, v1) + radius, offset2 = dot(tangent, v2) + radius;
  ClipVertex clipped1[2], clipped2[2];
  if (clip_segment(clipped1, incident, -tangent, offset1, side) < 2) return;
  if (clip_segment(clipped2, clipped1, tangent, offset2, next) < 2) return;

  manifold.face_a = face_a;
  manifold.normal = local_normal;
  manifold.point = middle;
  for (int i = 0; i < 2; ++i) {
    if (dot(normal, clipped2[i].v) - front > radius) continue;
    ManifoldPoint& point = manifold.points[manifold.count++];
    FeatureId id = clipped2[i].id;
    point.local = mul_t(other.xf, clipped2[i].v);
    point.id = face_a ? id : FeatureId{id.index_b, id.index_a, id.type_b, id.type_a};
  }
}

inline void collide(Manifold& manifold, const Terrain& terrain, const Polygon& polygon,
                    const Transform& xf) {
  if (terrain.is_edge) collide_edge(manifold, terrain, polygon, xf);
  else collide_polygons(manifold, terrain.polygon, polygon, xf);
}

}  // namespace ENGINE::walker
