#version 460
// 3x3 convolution, stride 1, zero padding 1, bias and leaky ReLU (slope 1: linear), core Vulkan 1.3 only.
// Tensors are [n][h][c4][w] in texels of 4 channels. An invocation makes 4 output channels of one pixel.
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(constant_id = 0) const float SLOPE = 1.0;
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer x;       // [n][h][cin4][w]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer weight;  // [cout4][cin4][9][4] of 4 input channels
layout(set = 0, binding = 2, r32f) readonly uniform imageBuffer bias;       // [cout]
layout(set = 0, binding = 3, std430) writeonly buffer Y { vec4 y[]; };      // rows of [n][h][cout4][w], a window

layout(push_constant) uniform Push {
    uint height;
    uint width;
    uint cin4;
    uint cout4;
    uint row_begin;  // first row of this dispatch and of the window, over all images
    uint count;      // invocations of this dispatch
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint px = index % width;
    const uint co4 = (index / width) % cout4;
    const uint row = row_begin + index / (cout4 * width);
    const int py = int(row % height);
    const uint image_row = row - uint(py);

    vec4 acc;
    [[unroll]] for (int j = 0; j < 4; ++j) acc[j] = imageLoad(bias, int(co4 * 4) + j).x;
    const int w_at = int(co4 * cin4 * 36);
    for (int t = 0; t < 9; ++t) {
        const int sx = int(px) + t % 3 - 1;
        const int sy = py + t / 3 - 1;
        if (sx < 0 || sy < 0 || sx >= int(width) || sy >= int(height)) continue;
        const int base = int((image_row + uint(sy)) * cin4 * width) + sx;
        for (int c = 0; c < int(cin4); ++c) {
            const vec4 v = imageLoad(x, base + c * int(width));
            const int at = w_at + (c * 9 + t) * 4;
            [[unroll]] for (int j = 0; j < 4; ++j) acc[j] += dot(imageLoad(weight, at + j), v);
        }
    }
    y[index] = mix(acc * SLOPE, acc, greaterThan(acc, vec4(0.0)));
}
