// NumPy's random generator as Gymnasium seeds it: Generator(PCG64(SeedSequence(seed))).
#pragma once

#include <math.h>
#include <stdint.h>

#include "common/isa.h"
#include "common/ziggurat.h"

namespace ENGINE {

// SeedSequence (NumPy's bit_generator.pyx): hashes a seed's 32-bit words into a pool of four and
// draws the generator's state from it.
struct SeedSequence {
  static constexpr int kPool = 4;
  uint32_t pool[kPool];

  explicit SeedSequence(uint64_t seed) {
    uint32_t words[2] = {uint32_t(seed), uint32_t(seed >> 32)};
    int count = words[1] ? 2 : 1;
    uint32_t hash = 0x43b0d7e5u;
    for (int i = 0; i < kPool; ++i) pool[i] = hashed(i < count ? words[i] : 0u, hash);
    for (int from = 0; from < kPool; ++from)
      for (int to = 0; to < kPool; ++to)
        if (from != to) pool[to] = mixed(pool[to], hashed(pool[from], hash));
    hash_ = hash;
  }
  // SeedSequence(seed, spawn_key=(spawn_key,)): the key follows the seed, filled up to the pool.
  SeedSequence(uint64_t seed, uint32_t spawn_key) : SeedSequence(seed) {
    for (uint32_t& to : pool) to = mixed(to, hashed(spawn_key, hash_));
  }

  void generate(uint64_t* out, int count) const {
    uint32_t hash = 0x8b51f9ddu;
    for (int i = 0; i < 2 * count; ++i) {
      uint32_t value = pool[i % kPool] ^ hash;
      hash *= 0x58f38dedu;
      value *= hash;
      value ^= value >> 16;
      if (i % 2 == 0) out[i / 2] = value;
      else out[i / 2] |= uint64_t(value) << 32;
    }
  }

 private:
  uint32_t hash_;

  static uint32_t hashed(uint32_t value, uint32_t& hash) {
    value ^= hash;
    hash *= 0x931e8875u;
    value *= hash;
    return value ^ (value >> 16);
  }
  static uint32_t mixed(uint32_t x, uint32_t y) {
    uint32_t value = 0xca01f9ddu * x - 0x4973f715u * y;
    return value ^ (value >> 16);
  }
};

// PCG64 (XSL-RR 128/64, O'Neill 2014) with the distributions of NumPy's Generator.
class Generator {
 public:
  explicit Generator(uint64_t seed) : Generator(SeedSequence(seed)) {}
  explicit Generator(const SeedSequence& seed) {
    uint64_t words[4];
    seed.generate(words, 4);
    Word start = (Word(words[0]) << 64) | words[1];
    Word stream = (Word(words[2]) << 64) | words[3];
    increment_ = (stream << 1) | 1;
    state_ = 0;
    advance();
    state_ += start;
    advance();
  }
  Generator() : Generator(0) {}

  double random() { return double(next64() >> 11) * (1.0 / 9007199254740992.0); }

  double uniform(double low, double high) { return low + (high - low) * random(); }

  double standard_normal() {
    for (;;) {
      uint64_t bits = next64();
      const int layer = int(bits & 0xff);
      const bool negative = bits >> 8 & 1;
      bits = bits >> 9 & 0x000fffffffffffff;
      double x = double(bits) * kZigguratWidth[layer];
      if (negative) x = -x;
      if (bits < kZigguratInside[layer]) return x;  // 99 of 100 times
      if (layer == 0) {
        for (;;) {
          // log1p and exp are the C library's, whichever it is: their last bit is compared, or
          // rounded away, and changes one draw in some 10¹².
          const double beyond = -kZigguratInverseEdge * log1p(-random());
          const double y = -log1p(-random());
          if (y + y > beyond * beyond)
            return bits >> 8 & 1 ? -(kZigguratEdge + beyond) : kZigguratEdge + beyond;
        }
      }
      const double above = kZigguratCurve[layer - 1] - kZigguratCurve[layer];
      if (above * random() + kZigguratCurve[layer] < exp(-0.5 * x * x)) return x;
    }
  }

  // Integer in [low, high): Lemire's method on 32-bit draws. Two of them come from one 64-bit draw;
  // the second half waits, also across calls of random() and uniform(). A range of one value
  // draws nothing.
  int64_t integers(int64_t low, int64_t high) {
    uint32_t range = uint32_t(high - low);
    if (range == 1) return low;
    uint64_t product = uint64_t(next32()) * range;
    if (uint32_t(product) < range) {
      uint32_t threshold = (0u - range) % range;
      while (uint32_t(product) < threshold) product = uint64_t(next32()) * range;
    }
    return low + int64_t(product >> 32);
  }

 private:
  using Word = unsigned __int128;

  void advance() {
    const Word multiplier = (Word(2549297995355413924ull) << 64) | 4865540595714422341ull;
    state_ = state_ * multiplier + increment_;
  }
  uint64_t next64() {
    advance();
    uint64_t high = uint64_t(state_ >> 64), value = high ^ uint64_t(state_);
    unsigned turn = unsigned(high >> 58);
    return (value >> turn) | (value << ((64 - turn) & 63));
  }
  uint32_t next32() {
    if (has_half_) {
      has_half_ = false;
      return half_;
    }
    uint64_t value = next64();
    has_half_ = true;
    half_ = uint32_t(value >> 32);
    return uint32_t(value);
  }

  Word state_, increment_;
  bool has_half_ = false;
  uint32_t half_ = 0;
};

}  // namespace ENGINE
