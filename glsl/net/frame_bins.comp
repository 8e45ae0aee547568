#version 460
// Exposure and depth of a frame, bin by bin of 16x16 pixels: log2 of the mean luminance, whether it counts, largest depth.
// The frame may come in strips of whole rows of bins.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer radiance;  // [pixel]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer screen;    // [pixel]: normal x, y, depth, hit
layout(set = 0, binding = 2, std430) writeonly buffer Bins { vec4 bins[]; };

layout(push_constant) uniform Push {
    uint width;
    uint height;
    uint first;  // bin
};

void main() {
    const uint index = flat_index();
    const uint bins_x = (width + 15) / 16;
    const uint bins_y = (height + 15) / 16;
    if (index >= bins_x * bins_y) return;
    const uint x0 = index % bins_x * 16;
    const uint y0 = index / bins_x * 16;
    float sum = 0.0;
    float count = 0.0;
    float depth = 0.0;
    for (uint i = 0; i < 256; ++i) {
        const uint x = x0 + i % 16;
        const uint y = y0 + i / 16;
        if (x >= width || y >= height) continue;
        const int at = int(y * width + x);
        const float luminance = dot(imageLoad(radiance, at).rgb, vec3(0.212671, 0.715160, 0.072169));
        if (luminance > 0.0 && luminance < 1e30) sum += luminance;
        count += 1.0;
        const float d = imageLoad(screen, at).z;
        if (d > depth && d < 1e30) depth = d;
    }
    const float mean = sum / count;
    bins[first + index] = mean > 1e-8 ? vec4(log2(mean), 1.0, depth, 0.0) : vec4(0.0, 0.0, depth, 0.0);
}
