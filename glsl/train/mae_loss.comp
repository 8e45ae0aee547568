#version 460
// Mean absolute error over 3 channels and its gradient; each invocation sums the errors of every invocations-th texel.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer prediction;         // [pixel] of 3 channels and a pad
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer target;
layout(set = 0, binding = 2, std430) writeonly buffer Gradient { vec4 gradient[]; };   // [pixel]
layout(set = 0, binding = 3, std430) writeonly buffer Partial { float partial_sum[]; };  // [invocation], sums of |error|

layout(push_constant) uniform Push {
    uint pixels;
    uint invocations;
    float scale;  // 1 / (3 * pixels)
};

void main() {
    const uint index = flat_index();
    if (index >= invocations) return;
    float sum = 0.0;
    for (uint p = index; p < pixels; p += invocations) {
        const vec3 e = imageLoad(prediction, int(p)).xyz - imageLoad(target, int(p)).xyz;
        sum += abs(e.x) + abs(e.y) + abs(e.z);
        gradient[p] = vec4(sign(e) * scale, 0.0);
    }
    partial_sum[index] = sum;
}
