#version 460
// Bias gradient: the sum of dy over all pixels, in parts; an invocation sums every parts-th row of one texel column.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer dy;                  // [rows][cout4][width]
layout(set = 0, binding = 1, std430) writeonly buffer Partial { vec4 partial_sum[]; };  // [part][cout4]

layout(push_constant) uniform Push {
    uint rows;   // over all images
    uint width;
    uint cout4;
    uint parts;
};

void main() {
    const uint index = flat_index();
    if (index >= parts * cout4) return;
    const uint c = index % cout4;
    vec4 sum = vec4(0.0);
    for (uint row = index / cout4; row < rows; row += parts) {
        vec4 row_sum = vec4(0.0);
        for (uint px = 0; px < width; ++px) row_sum += imageLoad(dy, int((row * cout4 + c) * width + px));
        sum += row_sum;
    }
    partial_sum[index] = sum;
}
