// The contact points of a part with the floor, and their cache (btPersistentManifold). Points of
// different lanes have nothing in common: this is code for one lane at a time.
#pragma once

#include "ant/bullet/kinematics.h"

namespace ENGINE::ant {

struct Manifold {
  Vector local[kMaxPoints];       // m, on the part, in its frame
  Double floor_x[kMaxPoints], floor_y[kMaxPoints];  // m, on the floor
  Double count;                   // points in use
};

struct Pose {
  Mat3<double> rotation;
  Vec3<double> origin;

  // m, in the world's frame (btTransform::operator()).
  Vec3<double> operator()(const Vec3<double>& local) const { return rotation * local + origin; }
  Vec3<double> inverse(const Vec3<double>& world) const {
    return transposed_times(rotation, world - origin);
  }
};

// A lane of a manifold, with its part's pose and contact breaking threshold.
class Points {
 public:
  Points(Manifold& manifold, int lane, const Pose& pose, double breaking)
      : m_(manifold), lane_(lane), pose_(pose), breaking_(breaking) {}

  int count() const { return int(m_.count[lane_]); }

  // btPersistentManifold::refreshContactPoints: drops the points that have come apart.
  void refresh() {
    for (int i = count() - 1; i >= 0; --i) {
      const Vec3<double> at = pose_(local(i));
      const double distance = at.z;
      if (!(distance <= breaking_)) {
        remove(i);
        continue;
      }
      const double x = m_.floor_x[i][lane_] - at.x, y = m_.floor_y[i][lane_] - at.y;
      const double z = 0.0 - (at.z - distance);
      if (x * x + y * y + z * z > breaking_ * breaking_) remove(i);
    }
  }

  // btManifoldResult::addContactPoint: a point on the part's surface, in the world's frame. It
  // takes the place of a cached one that is near, or of one that can be done without.
  void add(const Vec3<double>& at) {
    const Vec3<double> local_at = pose_.inverse(at);
    int place = find_near(local_at);
    if (place < 0) {
      if (count() == kMaxPoints) {
        place = find_superfluous(local_at, at.z);
      } else {
        place = count();
        m_.count[lane_] += 1.0;
      }
    }
    set_lane(m_.local[place], lane_, local_at);
    m_.floor_x[place][lane_] = at.x;
    m_.floor_y[place][lane_] = at.y;
  }

 private:
  Manifold& m_;
  const int lane_;
  const Pose& pose_;
  const double breaking_;

  Vec3<double> local(int i) const { return lane_of(m_.local[i], lane_); }

  // The last point takes the place of the removed one.
  void remove(int i) {
    const int last = count() - 1;
    set_lane(m_.local[i], lane_, local(last));
    m_.floor_x[i][lane_] = m_.floor_x[last][lane_];
    m_.floor_y[i][lane_] = m_.floor_y[last][lane_];
    m_.count[lane_] -= 1.0;
  }

  // btPersistentManifold::getCacheEntry; -1: no point is near.
  int find_near(const Vec3<double>& at) const {
    double nearest = breaking_ * breaking_;
    int found = -1;
    for (int i = 0; i < count(); ++i) {
      const Vec3<double> away = local(i) - at;
      const double squared = dot(away, away);
      if (squared < nearest) {
        nearest = squared;
        found = i;
      }
    }
    return found;
  }

  // btPersistentManifold::sortCachedPoints: never the deepest point; of the others, the one without
  // which the rest and the new one span the largest area. Bullet takes the depths from the last
  // refresh, which for a capsule was just before. (The torso's was a substep ago, but it never gets
  // here: it has contacts in the four substeps before the episode ends, at most.)
  int find_superfluous(const Vec3<double>& at, double depth) const {
    Vec3<double> points[kMaxPoints];
    int deepest = -1;
    for (int i = 0; i < kMaxPoints; ++i) {
      points[i] = local(i);
      const double other = pose_(points[i]).z;
      if (other < depth) {
        deepest = i;
        depth = other;
      }
    }
    // Without point i: the diagonals from `at` to one corner, and between the two others.
    constexpr int kFrom[kMaxPoints] = {1, 0, 0, 0};
    constexpr int kAcross[kMaxPoints][2] = {{3, 2}, {3, 2}, {3, 1}, {2, 1}};
    int found = 0;
    double largest = -1.0;
    for (int i = 0; i < kMaxPoints; ++i) {
      double area = 0.0;
      if (i != deepest) {
        const Vec3<double> a = at - points[kFrom[i]];
        const Vec3<double> b = points[kAcross[i][0]] - points[kAcross[i][1]];
        const Vec3<double> c = {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z,
                                a.x * b.y - a.y * b.x};
        area = dot(c, c);
      }
      if (area > largest) {  // the first of the largest (btVector4::closestAxis4)
        found = i;
        largest = area;
      }
    }
    return found;
  }
};

}  // namespace ENGINE::ant
