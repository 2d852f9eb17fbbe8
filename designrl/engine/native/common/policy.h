// The policy networks (designrl/policy.py): float32, sums over the inputs in order. A task's own
// networks have their sizes compiled in; one function takes any sizes, and gives the same bits.
//
// Weights are stored layer by layer: the matrix (inputs, outputs) row by row, then the bias.
#pragma once

#include "common/lanes.h"

namespace ENGINE {

// tanh(x) = x P(x²) / Q(x²) on [-9, 9]; coefficients of falling powers.
inline float tanh32(float x) {
  x = minimum(maximum(x, -9.0f), 9.0f);
  const float s = x * x;
  float p = 1.3354668482179477e-08f * s;
  p = (p + 2.0609088096534833e-05f) * s;
  p = (p + 0.003495588432997465f) * s;
  p = (p + 0.13381025195121765f) * s;
  p = p + 1.0f;
  float q = 7.776561119499092e-07f * s;
  q = (q + 0.00032856353209353983f) * s;
  q = (q + 0.025876984000205994f) * s;
  q = (q + 0.4671434164047241f) * s;
  q = q + 1.0f;
  return minimum(maximum((x * p) / q, -1.0f), 1.0f);
}

// One action. noise: added to the last layer's sums, or null.
using Act = void (*)(const float* weights, const float* input, const float* noise, float* action);

enum class Output { kLinear, kTanh };  // activation of the last layer; the others have tanh

// A network of these sizes: inputs, each layer's outputs.
template <Output kOutput, int kIn, int kOut, int... kMore>
struct FixedNetwork {
  static bool is(const int32_t* sizes, int layers, bool output_tanh) {
    constexpr int kLayers = 1 + sizeof...(kMore), expected[] = {kIn, kOut, kMore...};
    bool equal = layers == kLayers && output_tanh == (kOutput == Output::kTanh);
    for (int i = 0; equal && i <= kLayers; ++i) equal = sizes[i] == expected[i];
    return equal;
  }

  static void act(const float* weights, const float* __restrict in, const float* noise,
                  float* __restrict action) {
    // In blocks that stay in registers: an array of numbers is kept in memory.
    constexpr int kBytes = kOut % 8 == 0 && ENGINE_VECTOR_BYTES > 16 ? 32 : 16;
    typedef float Block __attribute__((vector_size(kBytes), aligned(4), may_alias));
    constexpr int kBlocks = kOut * 4 / kBytes;
    static_assert(kBlocks * kBytes == kOut * 4);
    Block sums[kBlocks];
    const Block* row = reinterpret_cast<const Block*>(weights);
    for (int b = 0; b < kBlocks; ++b) sums[b] = in[0] * row[b];
    for (int i = 1; i < kIn; ++i)
      for (int b = 0; b < kBlocks; ++b) sums[b] += in[i] * row[i * kBlocks + b];
    float sum[kOut];
    __builtin_memcpy(sum, sums, sizeof sum);
    const float* bias = weights + kIn * kOut;
    if constexpr (sizeof...(kMore) == 0) {
      for (int o = 0; o < kOut; ++o) sum[o] += bias[o];
      if (noise)
        for (int o = 0; o < kOut; ++o) sum[o] += noise[o];
      for (int o = 0; o < kOut; ++o)
        action[o] = kOutput == Output::kTanh ? tanh32(sum[o]) : sum[o];
    } else {
      float hidden[kOut];
      for (int o = 0; o < kOut; ++o) hidden[o] = tanh32(sum[o] + bias[o]);
      FixedNetwork<kOutput, kOut, kMore...>::act(bias + kOut, hidden, noise, action);
    }
  }
};

// The networks of a task that have their sizes compiled in.
template <class... Networks>
struct FixedNetworks {
  // The one of these sizes, or null.
  static Act find(const int32_t* sizes, int layers, bool output_tanh) {
    Act found = nullptr;
    ((Networks::is(sizes, layers, output_tanh) ? void(found = Networks::act) : void()), ...);
    return found;
  }
};

constexpr int kWidest = 256;  // values in a layer

// sizes: of the inputs, of each layer's outputs. noise: added to the last layer's sums, or null.
// output_tanh: whether the last layer has tanh too. The caller sees to it that no size is above
// kWidest.
inline void act(const float* weights, const int32_t* sizes, int layers, bool output_tanh,
                const float* input, const float* noise, float* action) {
  float values[2][kWidest];
  for (int layer = 0; layer < layers; ++layer) {
    const int ins = sizes[layer], outs = sizes[layer + 1];
    const bool last = layer == layers - 1;
    const float* in = layer ? values[layer % 2] : input;
    float* __restrict out = last ? action : values[(layer + 1) % 2];
    for (int o = 0; o < outs; ++o) out[o] = in[0] * weights[o];
    for (int i = 1; i < ins; ++i)
      for (int o = 0; o < outs; ++o) out[o] += in[i] * weights[i * outs + o];
    weights += ins * outs;
    for (int o = 0; o < outs; ++o) out[o] += weights[o];
    weights += outs;
    if (last && noise)
      for (int o = 0; o < outs; ++o) out[o] += noise[o];
    if (!last || output_tanh)
      for (int o = 0; o < outs; ++o) out[o] = tanh32(out[o]);
  }
}

}  // namespace ENGINE
