#version 460
// Gradient of kernel_filter.comp with respect to the coarser level: of each of its pixels, the sum of weight * dy over the 6x6 pixels that read it.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"
#include "lib/kernel_taps.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer logit;   // [n][h][9][w]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer kept;    // [n][h][w], of kernel_filter_backward.comp
layout(set = 0, binding = 2, rgba32f) readonly uniform imageBuffer coarse;  // [n][h/2][w/2]: w is 1 inside the picture
layout(set = 0, binding = 3, std430) writeonly buffer Dx { vec4 dx[]; };    // [n][h/2][w/2], a window

layout(push_constant) uniform Push {
    uint begin;  // first pixel of the window
    uint count;
    uint height;  // of the coarser level
    uint width;
};

const uint LOGIT_TEXELS = (ALL_TAPS + 3) / 4;

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint at = begin + index;
    const uint row = at / width;
    const ivec2 c = ivec2(at % width, row % height);
    const uint n = row / height;
    const ivec2 size = 2 * ivec2(width, height);
    vec3 sum = vec3(0.0);
    if (imageLoad(coarse, int(at)).w != 0.0) {
        for (int i = 0; i < 36; ++i) {
            const ivec2 p = 2 * c - 2 + ivec2(i % 6, i / 6);
            if (any(lessThan(p, ivec2(0))) || any(greaterThanEqual(p, size))) continue;
            const ivec2 step = c - p / 2 + 1;  // 0 to 2
            const int tap = int(FINE_TAPS) + step.y * 3 + step.x;
            const int pixel_row = int(n) * size.y + p.y;
            const vec4 k = imageLoad(kept, pixel_row * size.x + p.x);
            const float l = imageLoad(logit, (pixel_row * int(LOGIT_TEXELS) + tap / 4) * size.x + p.x)[tap % 4];
            sum += spline(p, step - 1) * exp(l - k.w) * k.rgb;
        }
    }
    dx[index] = vec4(sum, 0.0);
}
