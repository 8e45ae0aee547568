#version 460
// Channel concatenation. NHWC in texels of 4 channels: each operand keeps its own padding to 4.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer a;   // [pixel][a4]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer b;   // [pixel][b4]
layout(set = 0, binding = 2, std430) writeonly buffer Y { vec4 y[]; };  // [pixel][a4 + b4], a window

layout(push_constant) uniform Push {
    uint begin;  // first texel of the window
    uint count;
    uint a4;
    uint b4;
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint at = begin + index;
    const uint c = at % (a4 + b4);
    const uint pixel = at / (a4 + b4);
    if (c < a4) {
        y[index] = imageLoad(a, int(pixel * a4 + c));
    } else {
        y[index] = imageLoad(b, int(pixel * b4 + c - a4));
    }
}
