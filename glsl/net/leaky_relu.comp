#version 460
// Leaky ReLU: y = x where x > 0, slope * x elsewhere. Texels of 4 channels.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer x;
layout(set = 0, binding = 1, std430) writeonly buffer Y { vec4 y[]; };  // a window

layout(push_constant) uniform Push {
    uint begin;  // first texel of the window
    uint count;
    float slope;
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const vec4 v = imageLoad(x, int(begin + index));
    y[index] = mix(v * slope, v, greaterThan(v, vec4(0.0)));
}
