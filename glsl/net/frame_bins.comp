#version 460
// Exposure and depth of a frame, bin by bin of 16x16 pixels: log2 of the mean luminance, whether it counts, largest depth.
// The frame may come in strips that hold whole rows of bins.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer radiance;  // [pixel]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer screen;    // [pixel]: normal x, y, depth, hit
layout(set = 0, binding = 2, std430) writeonly buffer Bins { vec4 bins[]; };

layout(push_constant) uniform Push {
    uint width;   // of the frame
    uint height;
    uint row;     // of the frame, first in the strip
    uint begin;   // first bin
    uint count;   // bins
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint bin = begin + index;
    const uint bins_x = (width + 15) / 16;
    const uint x0 = bin % bins_x * 16;
    const uint y0 = bin / bins_x * 16;
    float sum = 0.0;
    float pixels = 0.0;
    float depth = 0.0;
    for (uint i = 0; i < 256; ++i) {
        const uint x = x0 + i % 16;
        const uint y = y0 + i / 16;
        if (x >= width || y >= height) continue;
        const int at = int((y - row) * width + x);
        const float luminance = dot(imageLoad(radiance, at).rgb, vec3(0.212671, 0.715160, 0.072169));
        if (luminance > 0.0 && luminance < 1e30) sum += luminance;
        pixels += 1.0;
        const float d = imageLoad(screen, at).z;
        if (d > depth && d < 1e30) depth = d;
    }
    const float mean = sum / pixels;
    bins[bin] = mean > 1e-8 ? vec4(log2(mean), 1.0, depth, 0.0) : vec4(0.0, 0.0, depth, 0.0);
}
