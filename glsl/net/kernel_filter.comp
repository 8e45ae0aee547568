#version 460
// The filter of a kernel-predicting network: a pixel is the mean of 5x5 noisy pixels and, where COARSE, 3x3 pixels of the coarser level,
// weighted with the softmax of its logits.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(constant_id = 0) const bool COARSE = true;
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer logit;   // [n][h][c4][w]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer fine;    // [n][h][w]
layout(set = 0, binding = 2, rgba32f) readonly uniform imageBuffer coarse;  // [n][h/2][w/2]
layout(set = 0, binding = 3, std430) writeonly buffer Y { vec4 y[]; };      // [n][h][w], a window

layout(push_constant) uniform Push {
    uint begin;  // first pixel of the window
    uint count;
    uint height;
    uint width;
};

#include "lib/kernel_filter.glsl"

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint at = begin + index;
    const uint row = at / width;
    const ivec2 p = ivec2(at % width, row % height);
    const Mean mean = weighted_mean(row / height, p, int(row * LOGIT_TEXELS * width) + p.x);
    y[index] = vec4(mean.color, mean.sum > 0.0 ? 1.0 : 0.0);
}
