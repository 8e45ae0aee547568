#version 460
// 2x2 maximum, stride 2; an odd last row or column is dropped. [n][h][c4][w] in texels of 4 channels.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer x;   // [n][h][c4][w]
layout(set = 0, binding = 1, std430) writeonly buffer Y { vec4 y[]; };  // [n][h/2][c4][w/2], a window

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
    const uint out_w = width / 2;
    const uint out_h = height / 2;
    const uint ox = at % out_w;
    const uint c = (at / out_w) % c4;
    const uint row = at / (c4 * out_w);
    const uint oy = row % out_h;
    const uint n = row / out_h;
    const int base = int(((n * height + 2 * oy) * c4 + c) * width + 2 * ox);
    const int down = int(width * c4);
    const vec4 top = max(imageLoad(x, base), imageLoad(x, base + 1));
    const vec4 bottom = max(imageLoad(x, base + down), imageLoad(x, base + down + 1));
    y[index] = max(top, bottom);
}
