// What the browser page (docs/page) calls: walkers and ants, each stepped by a policy of its own,
// one after the other, and what a picture shows of them. Compiled for WebAssembly alone, by
// reproduce/page.py.
//
// An episode is that of common/episodes.h, so its score has the bits of every other engine's.
#include <stdlib.h>
#include <string.h>

#include "ant/ant.h"
#include "common/episodes.h"
#include "walker/walker.h"

using namespace ENGINE;
using ENGINE::ant::Ant;
using ENGINE::walker::Walker;

namespace {

constexpr int kCorners = 4;  // of a piece of terrain, at most
constexpr int32_t kWalkerSizes[] = {Walker::kObservations, 40, 40, Walker::kActions};
constexpr int32_t kAntSizes[] = {Ant::kObservations + 1, 64, 32, Ant::kActions};
constexpr int kLayers = 3;

constexpr int weight_count(const int32_t* sizes) {
  int count = 0;
  for (int i = 0; i < kLayers; ++i) count += (sizes[i] + 1) * sizes[i + 1];
  return count;
}

// Read by docs/page/src/engine.js, number by number.
template <class Task>
struct ShownOfBoth {
  double score, steps, ended, fell, failed;
  double effort;               // of the motors' full torques, summed, in the last step
  double terms[Task::kTerms];  // of the last step's reward
  double poses[Task::kParts][7];
};
template <class Task>
struct Shown;
template <>
struct Shown<Walker> : ShownOfBoth<Walker> {
  double contacts[2];             // of the lower legs
  double rays[walker::kRays][2];  // m, their ends; they start in the hull
};
template <>
struct Shown<Ant> : ShownOfBoth<Ant> {
  double contacts[ant::kLegs];  // of the feet
};

// Of either task. What the caller writes and reads is at these addresses.
struct Player {
  float* weights;         // of the policy
  double *stds, *design;  // of the policy's noise, if it has any; scales of the body
  const double* shown;
  const float* terrain;
  int32_t piece_count;
  void (*start)(Player&, uint64_t seed, uint32_t flags, int32_t max_steps);
  void (*step)(Player&);
  void (*change_body)(Player&);
};

template <class Task>
class PlayerOf : Player {
  static constexpr bool kWalks = Task::kStartSolves;  // and the other is the ant
  static constexpr const int32_t* kSizes = kWalks ? kWalkerSizes : kAntSizes;
  static constexpr int kWeights = weight_count(kSizes);

 public:
  // Null if there is no memory.
  static Player* make() {
    void* memory = aligned_alloc(64, (sizeof(PlayerOf) + 63) / 64 * 64);
    if (!memory) return nullptr;
    PlayerOf* made = static_cast<PlayerOf*>(memset(memory, 0, sizeof(PlayerOf)));
    made->weights = made->weights_;
    made->stds = made->stds_;
    made->design = made->design_;
    made->shown = &made->shown_.score;
    made->start = [](Player& player, uint64_t seed, uint32_t flags, int32_t max_steps) {
      static_cast<PlayerOf&>(player).begin(seed, flags, max_steps);
    };
    made->step = [](Player& player) {
      PlayerOf& one = static_cast<PlayerOf&>(player);
      if (one.episode_.active) one.play();
    };
    made->change_body = [](Player& player) { static_cast<PlayerOf&>(player).rebuild(); };
    return made;
  }

 private:
  typename Task::Solver solver_;
  Episode<Task> episode_;
  Batch batch_;
  Act network_;
  uint64_t seed_;
  double factor_, score_;
  int64_t steps_;
  float weights_[kWeights];
  double stds_[Task::kActions], design_[Task::kDesign];
  Shown<Task> shown_;
  float terrain_[kWalks ? walker::kMaxTerrain : 1][1 + 2 * kCorners];

  void begin(uint64_t seed, uint32_t flags, int32_t max_steps) {
    seed_ = seed;
    factor_ = 1.0;
    batch_ = {};
    batch_.sizes = kSizes;
    batch_.weights = weights_;
    batch_.designs = design_;
    batch_.reward_factors = &factor_;
    batch_.seeds = &seed_;
    batch_.candidates = batch_.rollouts = 1;
    batch_.weight_count = kWeights;
    batch_.layers = kLayers;
    batch_.output_tanh = 1;
    batch_.flags = flags;
    batch_.max_steps = max_steps;
    batch_.returns = &score_;
    batch_.steps = &steps_;
    if (!kWalks) {
      batch_.noise_stds = stds_;
      batch_.time_scale = 1000.0;
    }
    network_ = Task::Networks::find(kSizes, kLayers, true);
    episode_.start(batch_);
    play();
    if constexpr (kWalks) show_terrain();
  }

  void rebuild() {
    if constexpr (kWalks) {
      Generator random(seed_);
      episode_.task.change_body(random, batch_.flags, design_);
    } else {
      episode_.task.change_body(solver_, design_);
    }
    episode_.task.poses(solver_, shown_.poses[0]);
  }

  void play() {
    Round<Task> round;
    episode_.begin_step(batch_, network_);
    round.add(episode_.task, 0);
    round.solve(solver_, Task::kStartSolves || episode_.steps() >= 0, true,
                [&](int) { episode_.finish_step(batch_); });
    show();
  }

  void show() {
    const Task& task = episode_.task;
    const Outcome<Task>& outcome = episode_.outcome();
    shown_.score = episode_.total();
    shown_.steps = double(episode_.steps());
    shown_.ended = !episode_.active;
    shown_.fell = kWalks ? outcome.fell : outcome.terminated;
    shown_.failed = task.failed();
    shown_.effort = task.effort();
    for (int i = 0; i < Task::kTerms; ++i) shown_.terms[i] = outcome.terms[i];
    task.poses(solver_, shown_.poses[0]);
    if constexpr (kWalks) {
      shown_.contacts[0] = outcome.observation[8];
      shown_.contacts[1] = outcome.observation[13];
      for (int i = 0; i < walker::kRays; ++i) {
        const double angle = 1.5 * i / 10.0;
        const double far = outcome.observation[14 + i] * walker::kLidarRange;
        shown_.rays[i][0] = shown_.poses[0][0] + sine(angle) * far;
        shown_.rays[i][1] = shown_.poses[0][2] - cosine(angle) * far;
      }
    } else {
      for (int leg = 0; leg < ant::kLegs; ++leg) shown_.contacts[leg] = task.touches(leg);
    }
  }

  void show_terrain() {
    const walker::World& world = episode_.task.world();
    terrain = terrain_[0];
    piece_count = world.terrain_count;
    for (int i = 0; i < piece_count; ++i) {
      const walker::Terrain& piece = world.terrain[i];
      float* to = terrain_[i];
      *to++ = float(piece.vertex_count());
      for (int k = 0; k < piece.vertex_count(); ++k) {
        *to++ = piece.vertices()[k].x;
        *to++ = piece.vertices()[k].y;
      }
    }
  }
};

}  // namespace

#define PAGE_EXPORT extern "C" __attribute__((visibility("default")))

// One that is yet to start, or null: PlayerOf::make.
PAGE_EXPORT Player* page_make_walker() { return PlayerOf<Walker>::make(); }
PAGE_EXPORT Player* page_make_ant() { return PlayerOf<Ant>::make(); }

// Where the caller puts the policy, float32, the stds of its noise and the scales of the body.
PAGE_EXPORT float* page_weights(Player* player) { return player->weights; }
PAGE_EXPORT double* page_stds(Player* player) { return player->stds; }
PAGE_EXPORT double* page_design(Player* player) { return player->design; }

// Starts the episode of a seed, up to its first observation. flags: bits of walker::Flag.
PAGE_EXPORT void page_start(Player* player, uint64_t seed, uint32_t flags, int32_t max_steps) {
  player->start(*player, seed, flags, max_steps);
}

// One step; nothing after the end of the episode.
PAGE_EXPORT void page_step(Player* player) { player->step(*player); }

// Goes on in the body whose scales the caller has put there: the tasks' change_body.
PAGE_EXPORT void page_change_body(Player* player) { player->change_body(*player); }

PAGE_EXPORT const double* page_shown(const Player* player) { return player->shown; }

// The course: a row of 9 numbers for each piece, how many corners it has and where these are.
PAGE_EXPORT int32_t page_terrain_count(const Player* player) { return player->piece_count; }
PAGE_EXPORT const float* page_terrain(const Player* player) { return player->terrain; }
