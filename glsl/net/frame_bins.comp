#version 460
// Exposure and depth of a frame, bin by bin: log2 of the mean luminance, whether it counts, largest depth, and how many pixels
// hold what must be repaired: radiance that is no number, infinite or negative, or guides that are not finite. Bins have 16x16
// pixels, those at the right and lower end fewer; for `pu` the frame is shared out evenly among as many bins.
// The frame may come in strips that hold whole rows of bins.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"
#include "lib/valid.glsl"

layout(constant_id = 0) const uint TRANSFER = TRANSFER_LOG1P;
layout(constant_id = 1) const bool DEPTH = true;  // the first guide is `screen`, and there is no second
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer radiance;  // [pixel]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer first;     // [pixel]: normal x, y, depth, hit; or albedo
layout(set = 0, binding = 2, rgba32f) readonly uniform imageBuffer second;    // [pixel]: world normal
layout(set = 0, binding = 3, std430) writeonly buffer Bins { vec4 bins[]; };

layout(push_constant) uniform Push {
    uint width;   // of the frame
    uint height;
    uint row;     // of the frame, first in the strip
    uint begin;   // first bin
    uint count;   // bins
};

// Pixels begin.. of a bin along one side.
uint bin_begin(uint bin, uint bins, uint size) {
    return TRANSFER == TRANSFER_PU ? bin * size / bins : min(bin * 16, size);
}

float luminance_of(vec3 radiance) {
    if (TRANSFER == TRANSFER_PU) radiance = mix(vec3(0.0), radiance, greaterThan(radiance, vec3(0.0)));
    const float luminance = dot(radiance, vec3(0.212671, 0.715160, 0.072169));
    return luminance > 0.0 && luminance < 1e30 ? luminance : 0.0;
}

void main() {
    const uint index = flat_index();
    const uint bins_x = (width + 15) / 16;
    const uint bins_y = (height + 15) / 16;
    if (index >= count) return;
    const uint bin = begin + index;
    const uint x0 = bin_begin(bin % bins_x, bins_x, width);
    const uint y0 = bin_begin(bin / bins_x, bins_y, height);
    const uint x1 = bin_begin(bin % bins_x + 1, bins_x, width);
    const uint y1 = bin_begin(bin / bins_x + 1, bins_y, height);
    float sum = 0.0;
    float depth = 0.0;
    uint repairs = 0u;
    for (uint i = 0; i < 256; ++i) {
        const uint x = x0 + i % 16;
        const uint y = y0 + i / 16;
        if (x >= x1 || y >= y1) continue;
        const int at = int((y - row) * width + x);
        const vec3 color = imageLoad(radiance, at).rgb;
        const vec3 guide = imageLoad(first, at).xyz;
        sum += luminance_of(color);
        if (DEPTH && guide.z > depth && guide.z < 1e30) depth = guide.z;
        const bool repaired = invalid_radiance(color) || not_finite(guide) || (!DEPTH && not_finite(imageLoad(second, at).xyz));
        repairs += repaired ? 1u : 0u;
    }
    const float mean = sum / float((x1 - x0) * (y1 - y0));
    bins[bin] = mean > 1e-8 ? vec4(log2(mean), 1.0, depth, repairs) : vec4(0.0, 0.0, depth, repairs);
}
