#version 460
// Channel concatenation. [n][h][c4][w] in texels of 4 channels: each operand keeps its own padding to 4.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer a;   // [row][a4][w]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer b;   // [row][b4][w]
layout(set = 0, binding = 2, std430) writeonly buffer Y { vec4 y[]; };  // [row][a4 + b4][w], a window

layout(push_constant) uniform Push {
    uint begin;  // first texel of the window
    uint count;
    uint a4;
    uint b4;
    uint width;
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint at = begin + index;
    const uint px = at % width;
    const uint c = (at / width) % (a4 + b4);
    const uint row = at / (width * (a4 + b4));
    if (c < a4) {
        y[index] = imageLoad(a, int((row * a4 + c) * width + px));
    } else {
        y[index] = imageLoad(b, int((row * b4 + c - a4) * width + px));
    }
}
