// One walker's world: bodies, joints, terrain, tree and contacts (b2World, b2ContactManager).
#pragma once

#include "body.h"
#include "narrow_phase.h"
#include "terrain.h"
#include "tree.h"

namespace ENGINE {

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

struct World {
  Body bodies[kBodies];
  Joint joints[kJoints];
  Course course;
  Tree tree;

  // Contacts live in slots; `order` lists them from the oldest to the newest. Box2D walks its lists,
  // the world's and each body's, from the newest: here they are walked from the end.
  Contact contacts[kMaxContacts];
  int16_t order[kMaxContacts], free_slots[kMaxContacts];
  int contact_count, free_count;

  int moved[8 * kBodies];  // bodies whose boxes were put into the tree anew
  int moved_count;
  float inverse_dt_before;  // 1/s; 0 before the first step
  bool overflow;            // a capacity was exceeded: the episode is void

  // What Gymnasium's ContactDetector notes.
  bool fallen;
  bool ground_contact[kBodies];

  Contact& contact(int i) { return contacts[order[i]]; }

  void clear_contacts() {
    contact_count = 0;
    free_count = kMaxContacts;
    for (int i = 0; i < kMaxContacts; ++i) free_slots[i] = int16_t(kMaxContacts - 1 - i);
    moved_count = 0;
    fallen = overflow = false;
    for (bool& touching : ground_contact) touching = false;
    inverse_dt_before = 0.0f;
  }

  // b2ContactManager::Destroy.
  void destroy_contact(int i) {
    Contact& c = contact(i);
    if (c.touching) end_contact(c);
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
    collide(c.manifold, course.pieces[c.terrain], body.shape, body.xf);
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
    if (c.touching) begin_contact(c);
    else end_contact(c);
  }

  // b2ContactManager::Collide.
  void collide_all() {
    for (int i = contact_count - 1; i >= 0; --i) {
      Contact& c = contact(i);
      if (!bodies[c.body].awake) continue;
      const Aabb& box_a = tree.nodes[course.pieces[c.terrain].proxy].box;
      const Aabb& box_b = tree.nodes[bodies[c.body].proxy].box;
      if (overlap(box_a, box_b)) update_contact(c);
      else destroy_contact(i);
    }
  }

  // b2BroadPhase::UpdatePairs with b2ContactManager::AddPair. Box2D also looks for pairs among the
  // terrain and among the body's own parts, and drops them all: filters and types forbid them.
  void find_new_contacts() {
    uint64_t pairs[kMaxContacts];
    int count = 0;
    for (int m = 0; m < moved_count; ++m) {
      int body = moved[m];
      tree.query(tree.nodes[bodies[body].proxy].box, [&](int leaf) {
        if (tree.nodes[leaf].item < kBodies) return;  // a part of the walker
        if (count == kMaxContacts) {
          overflow = true;
          return;
        }
        // In order of the terrain's node, then the body's. Insertion sort: pairs are few.
        uint64_t key = uint64_t(leaf) << 32 | uint64_t(bodies[body].proxy) << 8 | unsigned(body);
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
    Transform before;
    before.q = rotation(body.sweep.a0);
    before.p = body.sweep.c0 - mul(before.q, body.sweep.local_center);
    Aabb box = combine(body.shape.aabb(before), body.shape.aabb(body.xf));
    if (!tree.move(body.proxy, box, body.xf.p - before.p)) return;
    if (moved_count < int(sizeof moved / sizeof *moved)) moved[moved_count++] = index;
    else overflow = true;
  }

  // Makes a moving body's leaf; the terrain's leaves hold kBodies + their index.
  void add_to_tree(int index) {
    bodies[index].proxy = tree.create(bodies[index].shape.aabb(bodies[index].xf), index);
    moved[moved_count++] = index;
  }

 private:
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

  // Gymnasium's ContactDetector: a leg's flag is cleared by the end of any of its contacts, even
  // while another one lasts.
  void begin_contact(const Contact& c) {
    if (c.body == kHull) fallen = true;
    ground_contact[c.body] = true;
  }
  void end_contact(const Contact& c) { ground_contact[c.body] = false; }
};

}  // namespace ENGINE
