// The dynamic tree of fattened boxes (b2DynamicTree): its shape, down to the numbering of its
// nodes, decides the order in which contacts are made and which fixture a v2 ray meets first. It is
// kept for this order; what is near is found through terrain_index.h.
#pragma once

#include "walker/box2d/math2d.h"
#include "walker/scene.h"

namespace ENGINE::walker {

constexpr int kNone = -1;

struct Tree {
  struct alignas(32) Node {  // within a cache line
    Aabb box;
    int16_t parent;  // or the next free node
    int16_t child1, child2;
    int16_t height;  // 0 for a leaf
    int16_t item;    // leaf: what the owner put there
    bool is_leaf() const { return child1 == kNone; }
  };

  Node nodes[kMaxNodes];
  int root, free_node, used;
  bool overflow;

  void clear() {
    root = free_node = kNone;
    used = 0;
    overflow = false;
  }

  int create(const Aabb& box, int item) {
    int leaf = allocate();
    Vec2 margin = {kAabbMargin, kAabbMargin};
    nodes[leaf].box = {box.lower - margin, box.upper + margin};
    nodes[leaf].item = item;
    insert(leaf);
    return leaf;
  }

  // A leaf whose box has left its fattened one is put in again, stretched along its motion.
  // Returns whether that happened (b2DynamicTree::MoveProxy).
  bool move(int leaf, const Aabb& box, Vec2 displacement) {
    if (contains(nodes[leaf].box, box)) return false;
    remove(leaf);
    Vec2 margin = {kAabbMargin, kAabbMargin};
    Aabb fat = {box.lower - margin, box.upper + margin};
    Vec2 d = kAabbPrediction * displacement;
    if (d.x < 0.0f) fat.lower.x += d.x;
    else fat.upper.x += d.x;
    if (d.y < 0.0f) fat.lower.y += d.y;
    else fat.upper.y += d.y;
    nodes[leaf].box = fat;
    insert(leaf);
    return true;
  }

  // Whether a query or a ray, which go down to child 2 first, come to leaf a before leaf b.
  bool before(int a, int b) const {
    int above_a = nodes[a].parent, above_b = nodes[b].parent;
    while (above_a != above_b) {
      // The higher one may be an ancestor of both already. Which one that is cannot be predicted:
      // without a branch.
      const bool climbs_a = nodes[above_a].height < nodes[above_b].height;
      const int next = nodes[climbs_a ? above_a : above_b].parent;
      a = climbs_a ? above_a : a;
      above_a = climbs_a ? next : above_a;
      above_b = climbs_a ? above_b : next;
    }
    return nodes[above_a].child2 == a;
  }

 private:
  // Nodes are numbered upward while the free list is empty, then reused last in, first out.
  int allocate() {
    int id = free_node;
    if (id != kNone) {
      free_node = nodes[id].parent;
    } else if (used < kMaxNodes) {
      id = used++;
    } else {
      overflow = true;
      id = used - 1;
    }
    Node& node = nodes[id];
    node.parent = node.child1 = node.child2 = kNone;
    node.height = 0;
    node.item = kNone;
    return id;
  }
  void release(int id) {
    nodes[id].parent = free_node;
    nodes[id].height = -1;
    free_node = id;
  }

  void replace_child(int parent, int old_child, int new_child) {
    if (parent == kNone) root = new_child;
    else if (nodes[parent].child1 == old_child) nodes[parent].child1 = new_child;
    else nodes[parent].child2 = new_child;
  }

  // Cost of putting a box below a child: the growth of its perimeter.
  float descent_cost(const Node& child, Four box, float inherited) const {
    const Four own = to_vector(child.box);
    float grown = perimeter(combine(box, own));
    if (child.is_leaf()) return grown + inherited;
    return (grown - perimeter(own)) + inherited;
  }

  // b2DynamicTree::InsertLeaf: walks down by the surface area heuristic.
  void insert(int leaf) {
    if (root == kNone) {
      root = leaf;
      nodes[leaf].parent = kNone;
      return;
    }
    const Four box = to_vector(nodes[leaf].box);
    int sibling = root;
    while (!nodes[sibling].is_leaf()) {
      const Node& node = nodes[sibling];
      const Four own = to_vector(node.box);
      float area = perimeter(own);
      float combined = perimeter(combine(own, box));
      float cost = 2.0f * combined;
      float inherited = 2.0f * (combined - area);
      float cost1 = descent_cost(nodes[node.child1], box, inherited);
      float cost2 = descent_cost(nodes[node.child2], box, inherited);
      if (cost < cost1 && cost < cost2) break;
      sibling = cost1 < cost2 ? node.child1 : node.child2;
    }
    int old_parent = nodes[sibling].parent;
    int parent = allocate();
    nodes[parent].parent = old_parent;
    nodes[parent].box = to_box(combine(box, to_vector(nodes[sibling].box)));
    nodes[parent].height = nodes[sibling].height + 1;
    replace_child(old_parent, sibling, parent);
    nodes[parent].child1 = sibling;
    nodes[parent].child2 = leaf;
    nodes[sibling].parent = parent;
    nodes[leaf].parent = parent;
    refit(parent);
  }

  void remove(int leaf) {
    if (leaf == root) {
      root = kNone;
      return;
    }
    int parent = nodes[leaf].parent, grandparent = nodes[parent].parent;
    int sibling = nodes[parent].child1 == leaf ? nodes[parent].child2 : nodes[parent].child1;
    replace_child(grandparent, parent, sibling);
    nodes[sibling].parent = grandparent;
    release(parent);
    refit(grandparent);
  }

  // Balances and updates all nodes from here to the root.
  void refit(int index) {
    while (index != kNone) {
      index = balance(index);
      join(index);
      index = nodes[index].parent;
    }
  }
  void join(int index) {
    Node& node = nodes[index];
    const Node &a = nodes[node.child1], &b = nodes[node.child2];
    node.height = 1 + (a.height > b.height ? a.height : b.height);
    node.box = to_box(combine(to_vector(a.box), to_vector(b.box)));
  }

  // b2DynamicTree::Balance: a rotation where the children's heights differ by more than one.
  int balance(int index) {
    Node& node = nodes[index];
    if (node.is_leaf() || node.height < 2) return index;
    int difference = nodes[node.child2].height - nodes[node.child1].height;
    if (difference > 1) return rotate(index, node.child2, node.child2);
    if (difference < -1) return rotate(index, node.child1, node.child1);
    return index;
  }

  // Lifts a child over its parent: the taller grandchild stays with it, the shorter one takes the
  // child's place below the old parent. `slot` is the parent's field that holds the child.
  int rotate(int index, int child, int16_t& slot) {
    int first = nodes[child].child1, second = nodes[child].child2;
    bool keep_first = nodes[first].height > nodes[second].height;
    int kept = keep_first ? first : second, moved = keep_first ? second : first;
    nodes[child].child1 = index;
    nodes[child].parent = nodes[index].parent;
    nodes[index].parent = child;
    replace_child(nodes[child].parent, index, child);
    nodes[child].child2 = kept;
    slot = moved;
    nodes[moved].parent = index;
    join(index);
    join(child);
    return child;
  }
};

}  // namespace ENGINE::walker
