#version 460
// A crop of a reference frame in the space of the network's output.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"
#include "lib/transfer.glsl"
#include "lib/crop.glsl"

layout(constant_id = 0) const uint TRANSFER = TRANSFER_LOG1P;
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer radiance;  // [pixel]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer stats;     // exposure, 1 / depth
layout(set = 0, binding = 2, std430) writeonly buffer Y { vec4 y[]; };        // [h][w], 3 channels and a pad

layout(push_constant) uniform Push {
    uint count;   // pixels
    int width;    // of the picture
    int crop_width;
    int crop_height;
    int x0;       // the crop's origin in the picture
    int y0;
    uint orientation;
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const int at = int(index);
    const ivec2 p = crop_source(ivec2(at % crop_width, at / crop_width), ivec2(crop_width, crop_height), ivec2(x0, y0), orientation);
    y[index] = vec4(to_network(TRANSFER, imageLoad(radiance, p.y * width + p.x).rgb, imageLoad(stats, 0).x), 0.0);
}
