#version 460
// The mean absolute error over 3 channels at one scale or more, and its gradient. One workgroup takes 16x16 pixels, one
// invocation 2x2 of them. Scale s has the errors' sums over squares of 2^s pixels: e at scale 0, and so on up to 4.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(constant_id = 0) const uint SCALES = 1;  // 1 to 5

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer prediction;           // [n][y][x] of 3 channels and a pad
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer target;
layout(set = 0, binding = 2, std430) writeonly buffer Gradient { vec4 gradient[]; };     // [n][y][x]
layout(set = 0, binding = 3, std430) writeonly buffer Partial { float partial_sum[]; };  // [workgroup], sums of |error|

layout(push_constant) uniform Push {
    uint batch;
    uint height;
    uint width;
    float scale;  // 1 / (3 * pixels * SCALES)
};

shared vec3 shared_sums[64];

float norm1(vec3 v) { return abs(v.x) + abs(v.y) + abs(v.z); }

void main() {
    const uvec2 tiles = (uvec2(width, height) + 15) / 16;
    const uint group = flat_index() / 64;
    if (group >= batch * tiles.x * tiles.y) return;  // the whole workgroup
    const uint n = group / (tiles.x * tiles.y);
    const uint tile = group % (tiles.x * tiles.y);
    // Along a Morton curve, so that 4, 16 and 64 invocations in a row have a square.
    const uint i = gl_LocalInvocationID.x;
    const uvec2 place = uvec2((i & 1) | (i >> 1 & 2) | (i >> 2 & 4), (i >> 1 & 1) | (i >> 2 & 2) | (i >> 3 & 4));
    const uvec2 first = uvec2(tile % tiles.x, tile / tiles.x) * 16 + place * 2;

    vec3 signs[4];
    vec3 sum = vec3(0.0);
    float error = 0.0;
    for (uint k = 0; k < 4; k++) {
        const uvec2 p = first + uvec2(k & 1, k >> 1);
        signs[k] = vec3(0.0);
        if (p.x < width && p.y < height) {
            const int texel = int((n * height + p.y) * width + p.x);
            const vec3 e = imageLoad(prediction, texel).xyz - imageLoad(target, texel).xyz;
            signs[k] = sign(e);
            sum += e;
            error += norm1(e);
        }
    }
    vec3 coarse = vec3(0.0);
    if (SCALES > 1) {
        error += norm1(sum);
        coarse += sign(sum);
    }
    for (uint s = 2; s < SCALES; s++) {
        const uint stride = 1 << (2 * (s - 2));
        const uint start = i & ~(4 * stride - 1);
        shared_sums[i] = sum;
        barrier();
        sum = shared_sums[start] + shared_sums[start + stride] + shared_sums[start + 2 * stride]
            + shared_sums[start + 3 * stride];
        barrier();
        if (i == start) error += norm1(sum);
        coarse += sign(sum);
    }
    for (uint k = 0; k < 4; k++) {
        const uvec2 p = first + uvec2(k & 1, k >> 1);
        if (p.x < width && p.y < height) {
            gradient[(n * height + p.y) * width + p.x] = vec4((signs[k] + coarse) * scale, 0.0);
        }
    }

    for (uint stride = 32; stride > 0; stride /= 2) {
        shared_sums[i].x = error;
        barrier();
        if (i < stride) error += shared_sums[i + stride].x;
        barrier();
    }
    if (i == 0) partial_sum[group] = error;
}
