// What the browser page (docs/page) calls: walkers, each stepped by a policy of its own, one after
// the other, and what a picture shows of them. Compiled for WebAssembly alone, by
// reproduce/page.py.
//
// An episode is that of common/episodes.h, so its score has the bits of every other engine's.
#include <stdlib.h>
#include <string.h>

#include "common/episodes.h"
#include "walker/walker.h"

using namespace ENGINE;
using ENGINE::walker::Walker;

namespace {

constexpr int kCorners = 4;  // of a piece of terrain, at most
constexpr int32_t kSizes[] = {Walker::kObservations, 40, 40, Walker::kActions};
constexpr int kWeights = (24 + 1) * 40 + (40 + 1) * 40 + (40 + 1) * 4;

// Read by docs/page/src/engine.js, number by number.
struct Shown {
  double score, steps, ended, fell, failed;
  double terms[Walker::kTerms];  // of the last step's reward
  double effort;                 // of the motors' full torques, summed, in the last step
  double contacts[2];            // of the lower legs
  double poses[Walker::kParts][7];
  double sizes[Walker::kParts - 1][2];  // m, width and height of the legs' parts
  double rays[walker::kRays][2];        // m, their ends; they start in the hull
};

struct Player {
  Walker::Solver solver;
  Episode<Walker> episode;
  Batch batch;
  Act network;
  uint64_t seed;
  double factor, score;
  int64_t steps;
  float weights[kWeights];
  double design[Walker::kDesign];
  Shown shown;
  int32_t piece_count;
  float terrain[walker::kMaxTerrain][1 + 2 * kCorners];  // corners, then their x and y in m

  void step() {
    Round<Walker> round;
    episode.begin_step(batch, network);
    round.add(episode.task, 0);
    round.solve(solver, true, true, [&](int) { episode.finish_step(batch); });
    show();
  }

  void show() {
    const Walker& task = episode.task;
    const Outcome<Walker>& outcome = episode.outcome();
    shown.score = episode.total();
    shown.steps = double(episode.steps());
    shown.ended = !episode.active;
    shown.fell = outcome.fell;
    shown.failed = task.failed();
    for (int i = 0; i < Walker::kTerms; ++i) shown.terms[i] = outcome.terms[i];
    shown.effort = task.effort();
    shown.contacts[0] = outcome.observation[8];
    shown.contacts[1] = outcome.observation[13];
    show_body();
    for (int i = 0; i < walker::kRays; ++i) {
      const double angle = 1.5 * i / 10.0, far = outcome.observation[14 + i] * walker::kLidarRange;
      shown.rays[i][0] = shown.poses[0][0] + sine(angle) * far;
      shown.rays[i][1] = shown.poses[0][2] - cosine(angle) * far;
    }
  }

  void show_body() {
    episode.task.poses(solver, shown.poses[0]);
    for (int i = 0; i < Walker::kParts - 1; ++i) {
      shown.sizes[i][0] = episode.task.width(i);
      shown.sizes[i][1] = episode.task.height(i);
    }
  }

  void show_terrain() {
    const walker::World& world = episode.task.world();
    piece_count = world.terrain_count;
    for (int i = 0; i < piece_count; ++i) {
      const walker::Terrain& piece = world.terrain[i];
      float* to = terrain[i];
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

// A walker that is yet to start; null if there is no memory.
PAGE_EXPORT Player* page_make() {
  const size_t bytes = (sizeof(Player) + 63) / 64 * 64;
  void* memory = aligned_alloc(64, bytes);
  return memory ? static_cast<Player*>(memset(memory, 0, bytes)) : nullptr;
}

// Where the caller puts the policy's weights, (2804,), and the scales of the body, (8,).
PAGE_EXPORT float* page_weights(Player* player) { return player->weights; }
PAGE_EXPORT double* page_design(Player* player) { return player->design; }

// Starts the episode of a seed, up to its first observation. flags: bits of walker::Flag.
PAGE_EXPORT void page_start(Player* player, uint64_t seed, uint32_t flags, int32_t max_steps) {
  Player& p = *player;
  p.seed = seed;
  p.factor = 1.0;
  p.batch = {};
  p.batch.sizes = kSizes;
  p.batch.weights = p.weights;
  p.batch.designs = p.design;
  p.batch.reward_factors = &p.factor;
  p.batch.seeds = &p.seed;
  p.batch.candidates = p.batch.rollouts = 1;
  p.batch.weight_count = kWeights;
  p.batch.layers = 3;
  p.batch.output_tanh = 1;
  p.batch.flags = flags;
  p.batch.max_steps = max_steps;
  p.batch.returns = &p.score;
  p.batch.steps = &p.steps;
  p.network = Walker::Networks::find(kSizes, 3, true);
  p.episode.start(p.batch);
  p.step();
  p.show_terrain();
}

// One step; nothing after the end of the episode.
PAGE_EXPORT void page_step(Player* player) {
  if (player->episode.active) player->step();
}

// Goes on in the body whose scales the caller has put there: Walker::change_body.
PAGE_EXPORT void page_change_body(Player* player) {
  Generator random(player->seed);
  player->episode.task.change_body(random, player->batch.flags, player->design);
  player->show_body();
}

PAGE_EXPORT const Shown* page_shown(const Player* player) { return &player->shown; }

// The course: a row of 9 numbers for each piece, how many corners it has and where these are.
PAGE_EXPORT int32_t page_terrain_count(const Player* player) { return player->piece_count; }
PAGE_EXPORT const float* page_terrain(const Player* player) { return player->terrain[0]; }
