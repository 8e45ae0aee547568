#version 460
// 2x2 mean, stride 2, of the pixels that lie inside the picture: where w is 1.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer x;   // [n][h][w]
layout(set = 0, binding = 1, std430) writeonly buffer Y { vec4 y[]; };  // [n][h/2][w/2], a window

layout(push_constant) uniform Push {
    uint begin;  // first pixel of the window
    uint count;
    uint width;  // of y
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint at = begin + index;
    const int from = int(at / width * 4 * width + 2 * (at % width));
    const int down = int(2 * width);
    const vec4 sum = (imageLoad(x, from) + imageLoad(x, from + 1)) + (imageLoad(x, from + down) + imageLoad(x, from + down + 1));
    y[index] = vec4(sum.rgb / max(sum.w, 1.0), min(sum.w, 1.0));
}
