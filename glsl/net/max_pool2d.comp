#version 460
// 2x2 maximum, stride 2; an odd last row or column is dropped. NHWC in texels of 4 channels.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer x;   // [n][h][w][c4]
layout(set = 0, binding = 1, std430) writeonly buffer Y { vec4 y[]; };  // [n][h/2][w/2][c4], a window

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
    const uint c = at % c4;
    const uint ox = (at / c4) % out_w;
    const uint row = at / (c4 * out_w);
    const uint oy = row % out_h;
    const uint n = row / out_h;
    const int base = int(((n * height + 2 * oy) * width + 2 * ox) * c4 + c);
    const int down = int(width * c4);
    const vec4 top = max(imageLoad(x, base), imageLoad(x, base + int(c4)));
    const vec4 bottom = max(imageLoad(x, base + down), imageLoad(x, base + down + int(c4)));
    y[index] = max(top, bottom);
}
