#version 460
// Sum of two tensors: the gradient of a value that is used twice.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer a;
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer b;
layout(set = 0, binding = 2, std430) writeonly buffer Y { vec4 y[]; };  // a window

layout(push_constant) uniform Push {
    uint begin;  // first texel of the window
    uint count;
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const int at = int(begin + index);
    y[index] = imageLoad(a, at) + imageLoad(b, at);
}
