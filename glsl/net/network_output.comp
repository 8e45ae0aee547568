#version 460
// The network's output as radiance; a pixel that the renderer gave exactly keeps its value, if that is a number at all.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"
#include "lib/transfer.glsl"
#include "lib/valid.glsl"

layout(constant_id = 0) const uint TRANSFER = TRANSFER_LOG1P;
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer network;   // [padded h][padded w], 3 channels
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer radiance;  // [pixel]: rgb, 1 where exact
layout(set = 0, binding = 2, rgba32f) readonly uniform imageBuffer stats;     // exposure, 1 / depth
layout(set = 0, binding = 3, std430) writeonly buffer Y { vec4 y[]; };        // [pixel], a window

layout(push_constant) uniform Push {
    uint begin;  // first pixel of the window
    uint count;
    uint width;
    uint padded_width;
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint at = begin + index;
    const vec4 noisy = imageLoad(radiance, int(at));
    const vec3 t = imageLoad(network, int((at / width) * padded_width + at % width)).rgb;
    const bool exact = noisy.a > 0.5 && !invalid_radiance(noisy.rgb);
    y[index] = exact ? noisy : vec4(from_network(TRANSFER, t, imageLoad(stats, 0).x), 0.0);
}
