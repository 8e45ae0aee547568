#version 460
// Gradient of leaky ReLU from its stored output: dx = dy where y > 0, slope * dy elsewhere.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer y;
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer dy;
layout(set = 0, binding = 2, std430) writeonly buffer Dx { vec4 dx[]; };  // a window

layout(push_constant) uniform Push {
    uint begin;  // first texel of the window
    uint count;
    float slope;
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const int at = int(begin + index);
    const vec4 d = imageLoad(dy, at);
    dx[index] = mix(d * slope, d, greaterThan(imageLoad(y, at), vec4(0.0)));
}
