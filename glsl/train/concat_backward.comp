#version 460
// Gradient of one operand of a concatenation: its texels of dy.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer dy;    // [row][total4][w]
layout(set = 0, binding = 1, std430) writeonly buffer Dx { vec4 dx[]; };  // [row][part4][w], a window

layout(push_constant) uniform Push {
    uint begin;  // first texel of the window
    uint count;
    uint total4;
    uint first4;  // where the operand starts in a row
    uint part4;
    uint width;
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint at = begin + index;
    const uint row = at / (part4 * width);
    dx[index] = imageLoad(dy, int((row * total4 + first4) * width + at % (part4 * width)));
}
