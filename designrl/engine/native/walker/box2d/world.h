// A world: bodies, joints, terrain, tree and contacts (b2World, b2ContactManager).
#pragma once

#include "walker/box2d/body.h"
#include "walker/box2d/narrow_phase.h"
#include "walker/box2d/terrain_index.h"
#include "walker/box2d/tree.h"

namespace ENGINE::walker {

// A moving body and a piece of terrain whose fattened boxes overlap (b2Contact).
struct Contact {
  Manifold manifold;
  int body, terrain;
  float friction;
  bool enabled, touching;
  bool in_island, toi_known;
  int toi_count;
  float toi;
};

// A moving body's polygon at both ends of its sweep, in the world's frame.
struct SweptPolygon {
  Four ends[kMaxVertices];  // of the vertices' ways: both x, both y
  int count;
  Vec2 origin;  // of the body at the start, m
  Aabb box;     // of both ends, with the skin
  float sag;    // m, how far a vertex may leave the line between its ends as the body turns

  void set(const Body& body) {
    const Sweep& sweep = body.sweep;
    const Rot q0 = body.turn_at(sweep.a0), q1 = body.xf.q;
    origin = sweep.c0 - mul(q0, sweep.local_center);
    const Four along_x = {q0.c, q1.c, q0.s, q1.s}, along_y = {-q0.s, -q1.s, q0.c, q1.c};
    const Four origins = {origin.x, body.xf.p.x, origin.y, body.xf.p.y};
    count = body.shape.count;
    Four low, high;
    for (int i = 0; i < count; ++i) {
      const Vec2 v = body.shape.vertices[i];
      ends[i] = (v.x * along_x + v.y * along_y) + origins;
      low = i ? minimum(low, ends[i]) : ends[i];
      high = i ? maximum(high, ends[i]) : ends[i];
    }
    box = {{minimum(low[0], low[1]) - kSkin, minimum(low[2], low[3]) - kSkin},
           {maximum(high[0], high[1]) + kSkin, maximum(high[2], high[3]) + kSkin}};
    // A chord of an arc of angle d and radius r lies within r d² / 8 of it.
    const float turn = sweep.a - sweep.a0;
    sag = body.radius * turn * turn * 0.125f;
  }

  // Whether the body stays farther than `gap` from a piece of terrain through the whole sweep: some
  // line has all of one on one side and all of the other on the other. A false says nothing.
  bool clears(const Terrain& terrain, float gap) const {
    gap += sag;
    // The boxes, without their skins.
    const Aabb& other = terrain.box;
    const float reach = gap - 2.0f * kSkin;
    if (other.lower.x - box.upper.x > reach || box.lower.x - other.upper.x > reach ||
        other.lower.y - box.upper.y > reach || box.lower.y - other.upper.y > reach)
      return true;
    float low, high;
    if (terrain.is_edge) {
      distances(terrain.normal, terrain.v1, low, high);
      return low > gap || high < -gap;
    }
    const Polygon& polygon = terrain.polygon;
    for (int side = 0; side < polygon.count; ++side) {
      distances(polygon.normals[side], polygon.vertices[side], low, high);
      if (low > gap) return true;
    }
    return false;
  }

 private:
  // The least and the most that the ends lie in front of a line, m.
  void distances(Vec2 normal, Vec2 on_line, float& least, float& most) const {
    const Four nx_ny = {normal.x, normal.x, normal.y, normal.y};
    const Four start = {on_line.x, on_line.x, on_line.y, on_line.y};
    Four low, high;
    for (int i = 0; i < count; ++i) {
      const Four products = nx_ny * (ends[i] - start);
      const Four sums = products + shuffle<2, 3, 0, 1>(products, products);
      low = i ? minimum(low, sums) : sums;
      high = i ? maximum(high, sums) : sums;
    }
    least = minimum(low[0], low[1]);
    most = maximum(high[0], high[1]);
  }
};

struct World {
  // Arrays of vectors come before single numbers and stay aligned to 8 bytes: with a count between
  // them, vectors straddle cache lines, which costs 0.5 % of a step.
  Body bodies[kBodies];
  SweptPolygon sweeps[kBodies];  // of the step so far
  Joint joints[kJoints];
  Terrain terrain[kMaxTerrain];  // in order of creation
  TerrainIndex index;
  Tree tree;

  // Contacts live in slots; `order` lists them from the oldest to the newest. Box2D walks its
  // lists, the world's and each body's, from the newest: here they are walked from the end.
  Contact contacts[kMaxContacts];
  int16_t order[kMaxContacts], free_slots[kMaxContacts];
  int contact_count, free_count;
  int terrain_count;

  int moved[8 * kBodies];  // bodies whose boxes were put into the tree anew
  int moved_count;
  float inverse_dt_before;  // 1/s; 0 before the first step
  bool overflow;            // a capacity was exceeded, or an action is no number: void

  ContactListener listener;

  Contact& contact(int i) { return contacts[order[i]]; }

  // An empty world; its bodies and joints are placed anew.
  void clear() {
    terrain_count = 0;
    index.clear();
    tree.clear();
    contact_count = 0;
    free_count = kMaxContacts;
    for (int i = 0; i < kMaxContacts; ++i) free_slots[i] = int16_t(kMaxContacts - 1 - i);
    moved_count = 0;
    listener = {};
    overflow = false;
    inverse_dt_before = 0.0f;
  }

  // Terrain comes before the bodies (see narrow_phase.h), and index.finish() between them.
  void add_edge(Vec2 a, Vec2 b) {
    if (!has_room()) return;
    terrain[terrain_count].set_edge(a, b);
    add_to_tree(terrain[terrain_count]);
  }
  void add_rectangle(const Vec2* corners) {
    if (!has_room()) return;
    terrain[terrain_count].set_rectangle(corners);
    add_to_tree(terrain[terrain_count]);
  }

  // b2ContactManager::Destroy.
  void destroy_contact(int i) {
    Contact& c = contact(i);
    if (c.touching) listener.end_contact(c.body);
    if (c.manifold.count > 0) bodies[c.body].wake();
    free_slots[free_count++] = order[i];
    --contact_count;
    for (int j = i; j < contact_count; ++j) order[j] = order[j + 1];
  }

  // b2Contact::Update: a new manifold that inherits the impulses of the points it shares with the
  // old one.
  void update_contact(Contact& c) {
    const Manifold old = c.manifold;
    Body& body = bodies[c.body];
    c.enabled = true;
    bool was_touching = c.touching;
    collide(c.manifold, terrain[c.terrain], body.shape, body.xf);
    c.touching = c.manifold.count > 0;
    for (int i = 0; i < c.manifold.count; ++i) {
      ManifoldPoint& point = c.manifold.points[i];
      point.normal_impulse = point.tangent_impulse = 0.0f;
      for (int j = 0; j < old.count; ++j) {
        if (!(old.points[j].id == point.id)) continue;
        point.normal_impulse = old.points[j].normal_impulse;
        point.tangent_impulse = old.points[j].tangent_impulse;
        break;
      }
    }
    if (c.touching == was_touching) return;
    body.wake();
    if (c.touching) listener.begin_contact(c.body);
    else listener.end_contact(c.body);
  }

  // b2ContactManager::Collide.
  void collide_all() {
    for (int i = contact_count - 1; i >= 0; --i) {
      Contact& c = contact(i);
      if (!bodies[c.body].awake) continue;
      const Aabb& box_a = index.box(c.terrain);
      const Aabb& box_b = tree.nodes[bodies[c.body].proxy].box;
      if (overlap(box_a, box_b)) update_contact(c);
      else destroy_contact(i);
    }
  }

  // b2BroadPhase::UpdatePairs with b2ContactManager::AddPair. Box2D also looks for pairs among the
  // terrain and among the moving bodies, and drops them all: filters and types forbid them.
  void find_new_contacts() {
    uint64_t pairs[kMaxContacts];
    int count = 0;
    for (int m = 0; m < moved_count; ++m) {
      int body = moved[m];
      const Aabb box = tree.nodes[bodies[body].proxy].box;
      index.each(box.lower.x, box.upper.x, [&](int piece) {
        if (!overlap(index.box(piece), box)) return;
        if (count == kMaxContacts) {
          overflow = true;
          return;
        }
        // In order of the terrain's node, then the body's. Insertion sort: pairs are few.
        const uint64_t leaf = uint64_t(terrain[piece].proxy);
        uint64_t key = leaf << 32 | uint64_t(bodies[body].proxy) << 8 | unsigned(body);
        int at = count++;
        for (; at > 0 && pairs[at - 1] > key; --at) pairs[at] = pairs[at - 1];
        pairs[at] = key;
      });
    }
    moved_count = 0;
    for (int i = 0; i < count; ++i) {
      if (i > 0 && pairs[i] == pairs[i - 1]) continue;
      add_contact(int(pairs[i] & 0xff), tree.nodes[pairs[i] >> 32].item - kBodies);
    }
  }

  // b2Body::SynchronizeFixtures: moves the box in the tree to cover the step's motion.
  void synchronize_box(int index) {
    Body& body = bodies[index];
    sweeps[index].set(body);
    const SweptPolygon& sweep = sweeps[index];
    if (!tree.move(body.proxy, sweep.box, body.xf.p - sweep.origin)) return;
    if (moved_count < int(sizeof moved / sizeof *moved)) moved[moved_count++] = index;
    else overflow = true;
  }

  // Makes a moving body's leaf; the terrain's leaves hold kBodies + their index.
  void add_to_tree(int index) {
    bodies[index].proxy = tree.create(bodies[index].shape.aabb(bodies[index].xf), index);
    moved[moved_count++] = index;
  }

 private:
  bool has_room() {
    if (terrain_count == kMaxTerrain) overflow = true;
    return terrain_count < kMaxTerrain;
  }
  void add_to_tree(Terrain& piece) {
    piece.alpha0 = 0.0f;
    piece.proxy = tree.create(piece.box, kBodies + terrain_count++);
    index.add(tree.nodes[piece.proxy].box);
  }

  void add_contact(int body, int terrain) {
    for (int i = 0; i < contact_count; ++i)
      if (contact(i).body == body && contact(i).terrain == terrain) return;
    if (free_count == 0) {
      overflow = true;
      return;
    }
    int slot = free_slots[--free_count];
    order[contact_count++] = int16_t(slot);
    Contact& c = contacts[slot];
    c = Contact();
    c.body = body;
    c.terrain = terrain;
    c.enabled = true;
    c.friction = sqrtf(kTerrainFriction * bodies[body].friction);
    bodies[body].wake();
  }
};

}  // namespace ENGINE::walker
