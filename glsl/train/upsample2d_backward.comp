#version 460
// Gradient of nearest-neighbour upsampling by 2: the sum of the four.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer dy;    // [n][2h][c4][2w]
layout(set = 0, binding = 1, std430) writeonly buffer Dx { vec4 dx[]; };  // [n][h][c4][w], a window

layout(push_constant) uniform Push {
    uint begin;  // first texel of the window
    uint count;
    uint height;  // of dx
    uint width;
    uint c4;
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint at = begin + index;
    const uint px = at % width;
    const uint c = (at / width) % c4;
    const uint row = at / (c4 * width);  // over all images: rows double with them
    const int base = int((2 * row * c4 + c) * 2 * width + 2 * px);
    const int down = int(2 * width * c4);
    dx[index] = (imageLoad(dy, base) + imageLoad(dy, base + 1))
        + (imageLoad(dy, base + down) + imageLoad(dy, base + down + 1));
}
