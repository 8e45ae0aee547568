#version 460
// Gradient of kernel_filter.comp with respect to the logits: weight * (tap - result) . dy. Also keeps, for the coarser level's gradient, dy
// and the logarithm of the sum of w * exp(logit) of each pixel.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(constant_id = 0) const bool COARSE = true;
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer logit;    // [n][h][c4][w]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer fine;     // [n][h][w]
layout(set = 0, binding = 2, rgba32f) readonly uniform imageBuffer coarse;   // [n][h/2][w/2]
layout(set = 0, binding = 3, rgba32f) readonly uniform imageBuffer dy;       // [n][h][w]
layout(set = 0, binding = 4, std430) writeonly buffer Kept { vec4 kept[]; }; // [n][h][w]: dy, logarithm of the sum; a window
layout(set = 0, binding = 5, std430) writeonly buffer Dx { vec4 dx[]; };     // [n][h][c4][w], a window

layout(push_constant) uniform Push {
    uint begin;  // first row of the window, over all images
    uint rows;
    uint height;
    uint width;
};

#include "lib/kernel_filter.glsl"

void main() {
    const uint index = flat_index();
    if (index >= rows * width) return;
    const uint row = begin + index / width;
    const uint n = row / height;
    const ivec2 p = ivec2(index % width, row % height);
    const int first = int(row * LOGIT_TEXELS * width) + p.x;
    const Mean mean = weighted_mean(n, p, first);
    const vec3 g = imageLoad(dy, int(row * width) + p.x).rgb;
    for (uint t = 0; t < LOGIT_TEXELS; ++t) {
        const vec4 logits = imageLoad(logit, first + int(t) * int(width));
        vec4 slope;
        for (uint k = 0; k < 4; ++k) {
            const vec4 tap = tap_of(n, p, 4 * t + k);
            slope[k] = tap.w != 0.0 ? tap.w * exp(logits[k] - mean.largest) / mean.sum * dot(g, tap.rgb - mean.color) : 0.0;
        }
        dx[(index / width * LOGIT_TEXELS + t) * width + p.x] = slope;
    }
    kept[index] = vec4(g, mean.sum > 0.0 ? mean.largest + log(mean.sum) : 0.0);
}
