#version 460
// Nearest-neighbour upsampling by 2, in texels of 4 channels.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer x;   // [n][h][c4][w]
layout(set = 0, binding = 1, std430) writeonly buffer Y { vec4 y[]; };  // [n][2h][c4][2w], a window

layout(push_constant) uniform Push {
    uint begin;  // first texel of the window
    uint count;
    uint height;  // of x
    uint width;
    uint c4;
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint at = begin + index;
    const uint ox = at % (2 * width);
    const uint c = (at / (2 * width)) % c4;
    const uint row = at / (c4 * 2 * width);
    const uint oy = row % (2 * height);
    const uint n = row / (2 * height);
    y[index] = imageLoad(x, int(((n * height + oy / 2) * c4 + c) * width + ox / 2));
}
