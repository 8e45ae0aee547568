#version 460
// Adds the parts of a bias gradient in order; channels above cout, which only pad, get 0.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, r32f) readonly uniform imageBuffer partial_sum;               // [part][cout4 * 4]
layout(set = 0, binding = 1, std430) writeonly buffer BiasGrad { float bias_grad[]; };    // [cout4 * 4]

layout(push_constant) uniform Push {
    uint cout;
    uint cout4;
    uint parts;
};

void main() {
    const uint index = flat_index();
    if (index >= cout4 * 4) return;
    float sum = 0.0;
    for (uint s = 0; s < parts; ++s) sum += imageLoad(partial_sum, int(s * cout4 * 4 + index)).x;
    bias_grad[index] = index < cout ? sum : 0.0;
}
