// Continuous collision: when a moving body first meets the terrain within a step, and the extra
// sub-step that this takes (b2Distance.cpp, b2TimeOfImpact.cpp, b2World::SolveTOI).
#pragma once

#include "walker/box2d/position_solver.h"

namespace ENGINE::walker {

// b2DistanceProxy: the vertices of a shape without its skin.
struct Hull {
  const Vec2* vertices;
  int count;

  int support(Vec2 d) const {
    int best = 0;
    float largest = dot(vertices[0], d);
    for (int i = 1; i < count; ++i) {
      float value = dot(vertices[i], d);
      if (value > largest) {
        best = i;
        largest = value;
      }
    }
    return best;
  }
};

// The simplex of the last query, from which the next one starts.
struct SimplexCache {
  float metric;
  int count;
  int index_a[3], index_b[3];
};

// The Gilbert-Johnson-Keerthi algorithm. A is terrain, at rest in the world's frame.
class Simplex {
 public:
  // b2Distance; the cores' distance in m.
  static float distance(SimplexCache& cache, const Hull& a, const Hull& b, const Transform& xf) {
    Simplex s;
    s.read(cache, a, b, xf);
    int saved_a[3], saved_b[3];
    for (int iteration = 0; iteration < 20;) {
      const int saved = s.count_;
      for (int i = 0; i < saved; ++i) {
        saved_a[i] = s.v_[i].index_a;
        saved_b[i] = s.v_[i].index_b;
      }
      if (s.count_ == 2) s.solve2();
      else if (s.count_ == 3) s.solve3();
      if (s.count_ == 3) break;
      Vec2 d = s.search_direction();
      if (dot(d, d) < kEpsilon * kEpsilon) break;
      Vertex& next = s.v_[s.count_];
      next.set(a, b, xf, a.support(-d), b.support(mul_t(xf.q, d)));
      ++iteration;
      bool duplicate = false;
      for (int i = 0; i < saved && !duplicate; ++i)
        duplicate = next.index_a == saved_a[i] && next.index_b == saved_b[i];
      if (duplicate) break;
      ++s.count_;
    }
    float result = s.witness_distance();
    s.write(cache);
    return result;
  }

 private:
  struct Vertex {
    Vec2 wa, wb, w;  // supports and their difference wb - wa
    float a;         // barycentric coordinate
    int index_a, index_b;

    void set(const Hull& hull_a, const Hull& hull_b, const Transform& xf, int ia, int ib) {
      index_a = ia;
      index_b = ib;
      wa = hull_a.vertices[ia];
      wb = mul(xf, hull_b.vertices[ib]);
      w = wb - wa;
    }
  };
  Vertex v_[4];
  int count_;

  void read(const SimplexCache& cache, const Hull& a, const Hull& b, const Transform& xf) {
    count_ = cache.count;
    for (int i = 0; i < count_; ++i) {
      v_[i].set(a, b, xf, cache.index_a[i], cache.index_b[i]);
      v_[i].a = 0.0f;
    }
    if (count_ > 1) {
      float before = cache.metric, now = metric();
      if (now < 0.5f * before || 2.0f * before < now || now < kEpsilon) count_ = 0;
    }
    if (count_ == 0) {
      v_[0].set(a, b, xf, 0, 0);
      v_[0].a = 1.0f;
      count_ = 1;
    }
  }

  void write(SimplexCache& cache) const {
    cache.metric = metric();
    cache.count = count_;
    for (int i = 0; i < count_; ++i) {
      cache.index_a[i] = v_[i].index_a;
      cache.index_b[i] = v_[i].index_b;
    }
  }

  float metric() const {
    if (count_ == 2) return length(v_[0].w - v_[1].w);
    if (count_ == 3) return cross(v_[1].w - v_[0].w, v_[2].w - v_[0].w);
    return 0.0f;
  }

  Vec2 search_direction() const {
    if (count_ == 1) return -v_[0].w;
    Vec2 e = v_[1].w - v_[0].w;
    if (cross(e, -v_[0].w) > 0.0f) return cross(1.0f, e);
    return right_normal(e);
  }

  float witness_distance() const {
    if (count_ == 1) return length(v_[0].wa - v_[0].wb);
    if (count_ == 3) return 0.0f;  // the terrain holds the body's core
    Vec2 pa = v_[0].a * v_[0].wa + v_[1].a * v_[1].wa;
    Vec2 pb = v_[0].a * v_[0].wb + v_[1].a * v_[1].wb;
    return length(pa - pb);
  }

  void keep_one(int i) {
    v_[i].a = 1.0f;
    v_[0] = v_[i];
    count_ = 1;
  }
  // Keeps vertices i and j with weights proportional to wi and wj. Box2D moves j to the place that
  // i leaves free, so that the order of (1, 3) and (2, 3) differs: (v1, v3) but (v3, v2).
  void keep_two(int i, int j, float wi, float wj) {
    float inverse = 1.0f / (wi + wj);
    v_[i].a = wi * inverse;
    v_[j].a = wj * inverse;
    if (i == 0 && j == 2) v_[1] = v_[2];
    if (i == 1 && j == 2) v_[0] = v_[2];
    count_ = 2;
  }

  void solve2() {
    Vec2 w1 = v_[0].w, w2 = v_[1].w;
    Vec2 e12 = w2 - w1;
    float d2 = -dot(w1, e12);
    if (d2 <= 0.0f) return keep_one(0);
    float d1 = dot(w2, e12);
    if (d1 <= 0.0f) return keep_one(1);
    keep_two(0, 1, d1, d2);
  }

  void solve3() {
    Vec2 w1 = v_[0].w, w2 = v_[1].w, w3 = v_[2].w;
    Vec2 e12 = w2 - w1, e13 = w3 - w1, e23 = w3 - w2;
    float d12_1 = dot(w2, e12), d12_2 = -dot(w1, e12);
    float d13_1 = dot(w3, e13), d13_2 = -dot(w1, e13);
    float d23_1 = dot(w3, e23), d23_2 = -dot(w2, e23);
    float n = cross(e12, e13);
    float d123_1 = n * cross(w2, w3), d123_2 = n * cross(w3, w1), d123_3 = n * cross(w1, w2);
    if (d12_2 <= 0.0f && d13_2 <= 0.0f) return keep_one(0);
    if (d12_1 > 0.0f && d12_2 > 0.0f && d123_3 <= 0.0f) return keep_two(0, 1, d12_1, d12_2);
    if (d13_1 > 0.0f && d13_2 > 0.0f && d123_2 <= 0.0f) return keep_two(0, 2, d13_1, d13_2);
    if (d12_1 <= 0.0f && d23_2 <= 0.0f) return keep_one(1);
    if (d13_1 <= 0.0f && d23_1 <= 0.0f) return keep_one(2);
    if (d23_1 > 0.0f && d23_2 > 0.0f && d123_1 <= 0.0f) return keep_two(1, 2, d23_1, d23_2);
    count_ = 3;
  }
};

// b2SeparationFunction: the separation along an axis that moves with one of the shapes.
class SeparationFunction {
 public:
  SeparationFunction(const SimplexCache& cache, const Hull& a, const Hull& b, const Sweep& sweep,
                     float t)
      : a_(a), b_(b), sweep_(sweep) {
    Transform xf = sweep.at(t);
    if (cache.count == 1) {
      kind_ = kPoints;
      axis_ = mul(xf, b.vertices[cache.index_b[0]]) - a.vertices[cache.index_a[0]];
      normalize(axis_);
      return;
    }
    const bool face_b = cache.index_a[0] == cache.index_a[1];
    kind_ = face_b ? kFaceB : kFaceA;
    const Vec2* vertices = face_b ? b.vertices : a.vertices;
    const int* index = face_b ? cache.index_b : cache.index_a;
    Vec2 p1 = vertices[index[0]], p2 = vertices[index[1]];
    axis_ = right_normal(p2 - p1);
    normalize(axis_);
    point_ = 0.5f * (p1 + p2);
    if (separation(cache.index_a[0], cache.index_b[0], xf) < 0.0f) axis_ = -axis_;
  }

  // The deepest pair of points at time t, and their separation.
  float find_minimum(int& index_a, int& index_b, float t) const {
    Transform xf = sweep_.at(t);
    index_a = index_b = -1;
    if (kind_ == kPoints) {
      index_a = a_.support(axis_);
      index_b = b_.support(mul_t(xf.q, -axis_));
    } else if (kind_ == kFaceA) {
      index_b = b_.support(mul_t(xf.q, -axis_));
    } else {
      index_a = a_.support(-mul(xf.q, axis_));
    }
    return separation(index_a, index_b, xf);
  }

  float evaluate(int index_a, int index_b, float t) const {
    return separation(index_a, index_b, sweep_.at(t));
  }

 private:
  enum { kPoints, kFaceA, kFaceB } kind_;
  const Hull &a_, &b_;
  const Sweep& sweep_;
  Vec2 point_, axis_;

  float separation(int index_a, int index_b, const Transform& xf) const {
    if (kind_ == kPoints) return dot(mul(xf, b_.vertices[index_b]) - a_.vertices[index_a], axis_);
    if (kind_ == kFaceA) return dot(mul(xf, b_.vertices[index_b]) - point_, axis_);
    return dot(a_.vertices[index_a] - mul(xf, point_), mul(xf.q, axis_));
  }
};

// Shapes meet when their cores are this close, within the tolerance.
constexpr float kToiTarget = (kSkin + kSkin) - 3.0f * kLinearSlop > kLinearSlop
                                 ? (kSkin + kSkin) - 3.0f * kLinearSlop
                                 : kLinearSlop;
constexpr float kToiTolerance = 0.25f * kLinearSlop;
constexpr float kToiDistance = kToiTarget + kToiTolerance;
// Room for rounding: coordinates reach 100 m, where float32 resolves 8e-6 m.
constexpr float kToiRounding = 5e-4f;  // m

// b2TimeOfImpact against terrain: the fraction of the sweep at which the shapes touch, or 1.
// Box2D reports why there is no impact (separated, overlapped, failed); all lead to 1.
inline float time_of_impact(const Hull& terrain, const Hull& body, Sweep sweep) {
  sweep.normalize();
  const float target = kToiTarget, tolerance = kToiTolerance;
  const float none = -1.0f;
  float t1 = 0.0f;
  SimplexCache cache;
  cache.count = 0;
  for (int iteration = 0; iteration < 20; ++iteration) {
    float distance = Simplex::distance(cache, terrain, body, sweep.at(t1));
    if (distance <= 0.0f) return none;                 // overlapped
    if (distance < target + tolerance) return t1;      // touching
    SeparationFunction function(cache, terrain, body, sweep, t1);
    float t2 = 1.0f;
    for (int push_back = 0; push_back < 16; ++push_back) {
      int index_a, index_b;
      float s2 = function.find_minimum(index_a, index_b, t2);
      if (s2 > target + tolerance) return none;        // separated
      if (s2 > target - tolerance) {
        t1 = t2;
        break;
      }
      float s1 = function.evaluate(index_a, index_b, t1);
      if (s1 < target - tolerance) return none;        // failed
      if (s1 <= target + tolerance) return t1;         // touching
      // The root of separation(t) - target, by bisection and secants in turn.
      float a1 = t1, a2 = t2;
      for (int root = 0; root < 50; ++root) {
        float t = root & 1 ? a1 + (target - s1) * (a2 - a1) / (s2 - s1) : 0.5f * (a1 + a2);
        float s = function.evaluate(index_a, index_b, t);
        if (absolute(s - target) < tolerance) {
          t2 = t;
          break;
        }
        if (s > target) {
          a1 = t;
          s1 = s;
        } else {
          a2 = t;
          s2 = s;
        }
      }
    }
  }
  return none;
}

// Cuts iterations short without changing their result. An iteration is a function of the state
// alone, so once a state comes back, the rest of the iterations goes round in the same cycle (often
// of length one) and only the last, partial round is left to do. Brent's way of finding cycles: the
// state is compared with one mark, which moves on after 1, 2, 4, ... iterations.
template <int kCapacity>
class CycleWatch {
 public:
  // `end`: number of iterations to do in all.
  CycleWatch(int end, int size) : end_(end), size_(size) {}

  int end() const { return end_; }

  // To be called with the state after each iteration, `done` of them so far. A state that a loop
  // starts from need not be shown.
  void watch(const float* state, int done) {
    if (last_round_) return;
    bool back = marked_ > 0;
    for (int i = 0; back && i < size_; ++i) back = state[i] == mark_[i];
    if (back) {
      end_ = done + (end_ - done) % (done - marked_);
      last_round_ = true;
    } else if (done == next_) {
      for (int i = 0; i < size_; ++i) mark_[i] = state[i];
      marked_ = done;
      next_ = 2 * done;
    }
  }

 private:
  int end_, size_;
  int marked_ = 0, next_ = 1;
  bool last_round_ = false;
  float mark_[kCapacity];
};

// The island of one continuous collision: one body and its contacts with the terrain, solved
// without joints (b2Island::SolveTOI).
inline void solve_island(Body& body, Contact** contacts, int count, float dt) {
  Place<float> at = {body.sweep.c.x, body.sweep.c.y};
  turn(at, body.sweep.a, true);
  const BodyTerms<float> own = body_terms(body);
  OverlapTerms<float> overlaps[kMaxToiContacts];
  for (int k = 0; k < count; ++k) overlaps[k] = overlap_terms(contacts[k]->manifold);
  for (int i = 0; i < kToiPositionIterations; ++i) {
    float smallest = 0.0f;
    for (int k = 0; k < count; ++k)
      correct_contact(overlaps[k], own, at, kToiBaumgarte, true, smallest);
    if (smallest >= -1.5f * kLinearSlop) break;
  }
  body.sweep.c0 = {at.x, at.y};
  body.sweep.a0 = at.a;
  const Motion motion = {{at.x, at.y}, at.a, {at.s, at.c}};
  float vx = body.velocity.x, vy = body.velocity.y, w = body.angular_velocity;

  ContactTerms<float> terms[kMaxToiContacts];
  ContactImpulses<float> impulses[kMaxToiContacts];
  bool two[kMaxToiContacts];
  for (int k = 0; k < count; ++k) {
    ContactConstraint constraint;
    prepare_contact(constraint, *contacts[k], body, motion, 0.0f);
    terms[k] = contact_terms(constraint, body);
    impulses[k] = {0.0f, 0.0f, 0.0f, 0.0f};
    two[k] = constraint.count == 2;
  }
  // One body on a few contacts: mostly at rest long before the last iteration.
  constexpr int kImpulses = sizeof(ContactImpulses<float>) / sizeof(float);
  CycleWatch<3 + kImpulses * kMaxToiContacts> cycle(kVelocityIterations, 3 + kImpulses * count);
  for (int i = 0; i < cycle.end(); ++i) {
    for (int k = 0; k < count; ++k)
      solve_contact_terms(terms[k], two[k], impulses[k], vx, vy, w);
    float state[3 + kImpulses * kMaxToiContacts];
    state[0] = vx;
    state[1] = vy;
    state[2] = w;
    for (int k = 0; k < count; ++k) {
      float* to = state + 3 + kImpulses * k;
      to[0] = impulses[k].normal1;
      to[1] = impulses[k].normal2;
      to[2] = impulses[k].tangent1;
      to[3] = impulses[k].tangent2;
    }
    cycle.watch(state, i + 1);
  }
  integrate(at, vx, vy, w, dt, true);
  body.sweep.c = {at.x, at.y};
  body.sweep.a = at.a;
  body.synchronize_transform();
  body.velocity = {vx, vy};
  body.angular_velocity = w;
}

// b2World::SolveTOI.
inline void solve_continuous(World& world) {
  for (Body& body : world.bodies) body.sweep.alpha0 = 0.0f;
  for (int i = 0; i < world.contact_count; ++i) {
    Contact& c = world.contact(i);
    c.toi_known = c.in_island = false;
    c.toi_count = 0;
    c.toi = 1.0f;
  }
  bool impact = false;
  for (;;) {
    Contact* first = nullptr;
    float alpha_first = 1.0f;
    for (int i = world.contact_count - 1; i >= 0; --i) {
      Contact& c = world.contact(i);
      if (!c.enabled || c.toi_count > kMaxSubSteps) continue;
      float alpha = 1.0f;
      if (c.toi_known) {
        alpha = c.toi;
      } else {
        Body& body = world.bodies[c.body];
        Terrain& terrain = world.terrain[c.terrain];
        if (!body.awake) continue;
        // Put both on the same interval of time.
        float alpha0 = terrain.alpha0;
        if (terrain.alpha0 < body.sweep.alpha0) {
          alpha0 = body.sweep.alpha0;
          terrain.alpha0 = alpha0;
        } else if (body.sweep.alpha0 < terrain.alpha0) {
          body.sweep.advance(alpha0);
        }
        // Far enough apart all the way: no impact, whatever the search would try.
        if (!world.sweeps[c.body].clears(terrain, kToiDistance + kToiRounding)) {
          Hull a = {terrain.vertices(), terrain.vertex_count()};
          Hull b = {body.shape.vertices, body.shape.count};
          float beta = time_of_impact(a, b, body.sweep);
          if (beta >= 0.0f) alpha = minimum(alpha0 + (1.0f - alpha0) * beta, 1.0f);
        }
        c.toi = alpha;
        c.toi_known = true;
      }
      if (alpha < alpha_first) {
        first = &c;
        alpha_first = alpha;
      }
    }
    if (!first || 1.0f - 10.0f * kEpsilon < alpha_first) break;
    impact = true;

    Body& body = world.bodies[first->body];
    Terrain& terrain = world.terrain[first->terrain];
    const Sweep body_before = body.sweep;
    const float terrain_before = terrain.alpha0;
    body.advance(alpha_first);
    terrain.alpha0 = alpha_first;
    world.update_contact(*first);
    first->toi_known = false;
    ++first->toi_count;
    if (!first->touching) {
      first->enabled = false;
      body.sweep = body_before;
      terrain.alpha0 = terrain_before;
      body.synchronize_transform();
      continue;
    }
    body.wake();
    Contact* island[kMaxToiContacts];
    int count = 0;
    island[count++] = first;
    first->in_island = true;
    for (int i = world.contact_count - 1; i >= 0; --i) {
      Contact& c = world.contact(i);
      if (c.body != first->body || c.in_island) continue;
      if (count == kMaxToiContacts) break;
      Terrain& other = world.terrain[c.terrain];
      const float before = other.alpha0;
      other.alpha0 = alpha_first;
      world.update_contact(c);
      if (!c.touching) {
        other.alpha0 = before;
        continue;
      }
      c.in_island = true;
      island[count++] = &c;
    }
    solve_island(body, island, count, (1.0f - alpha_first) * kTimeStep);
    world.synchronize_box(first->body);
    for (int i = 0; i < world.contact_count; ++i) {
      Contact& c = world.contact(i);
      if (c.body == first->body) c.toi_known = c.in_island = false;
    }
    world.find_new_contacts();
  }
  if (!impact) return;
  for (int i = 0; i < world.contact_count; ++i)
    world.terrain[world.contact(i).terrain].alpha0 = 0.0f;
}

}  // namespace ENGINE::walker
