// Which terrain is near, by x: for less, what the tree's queries and rays would find of it.
//
// A query of the tree finds every leaf whose box overlaps, and a ray every one that it hits: a hit
// lies 0.1 m inside the boxes of all nodes above it, so that no rounding keeps a ray from one. Only
// the order comes from the tree.
#pragma once

#include "walker/box2d/math2d.h"
#include "walker/scene.h"

namespace ENGINE::walker {

class TerrainIndex {
 public:
  void clear() { count_ = 0; }

  // box: of the next piece, as the tree has it.
  void add(const Aabb& box) {
    boxes_[count_] = box;
    int at = count_++;
    for (; at > 0 && boxes_[by_left_end_[at - 1]].lower.x > box.lower.x; --at)
      by_left_end_[at] = by_left_end_[at - 1];
    by_left_end_[at] = int16_t(count_ - 1);
  }

  // To be called when all pieces are there.
  void finish() {
    int first = 0;
    for (int column = 0; column < kColumns; ++column) {
      while (first < count_ && boxes_[by_left_end_[first]].upper.x < float(column)) ++first;
      first_[column] = int16_t(first);
    }
  }

  const Aabb& box(int piece) const { return boxes_[piece]; }

  // Calls visit(piece) for every piece whose box reaches into [low, high], m.
  template <class Visit>
  void each(float low, float high, Visit visit) const {
    const int last = kColumns - 1;
    const int column = low < 0.0f ? 0 : low < float(last) ? int(low) : last;
    for (int i = first_[column]; i < count_; ++i) {
      const int piece = by_left_end_[i];
      if (boxes_[piece].lower.x > high) break;
      if (boxes_[piece].upper.x >= low) visit(piece);
    }
  }

 private:
  int count_;
  Aabb boxes_[kMaxTerrain];
  int16_t by_left_end_[kMaxTerrain];  // pieces
  int16_t first_[kColumns];           // of by_left_end_ that is not wholly left of a column
};

}  // namespace ENGINE::walker
