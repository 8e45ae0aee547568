#version 460
// A crop of a frame as the input of a network: r, g, b, screen normal x | screen normal y, depth, 0, 0. Zeros past the picture's end.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"
#include "lib/transfer.glsl"
#include "lib/crop.glsl"

layout(constant_id = 0) const uint TRANSFER = TRANSFER_LOG1P;
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer radiance;  // [pixel]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer screen;    // [pixel]: normal x, y, depth, hit
layout(set = 0, binding = 2, rgba32f) readonly uniform imageBuffer stats;     // exposure, 1 / depth
layout(set = 0, binding = 3, std430) writeonly buffer Y { vec4 y[]; };        // [h][2][w], a window

layout(push_constant) uniform Push {
    uint begin;   // first texel of the window
    uint count;   // texels
    int width;    // of the picture
    int height;
    int crop_width;
    int crop_height;
    int x0;       // the crop's origin in the picture
    int y0;
    uint orientation;
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const int at = int(begin + index);
    const int row = at / crop_width;
    const ivec2 p = crop_source(ivec2(at % crop_width, row / 2), ivec2(crop_width, crop_height), ivec2(x0, y0), orientation);
    if (p.x >= width || p.y >= height) {
        y[index] = vec4(0.0);
        return;
    }
    const vec4 frame = imageLoad(stats, 0);
    const vec4 s = imageLoad(screen, p.y * width + p.x);
    const vec3 color = to_network(TRANSFER, imageLoad(radiance, p.y * width + p.x).rgb, frame.x);
    vec2 n = crop_normal(s.xy, orientation);
    n = mix(vec2(0.0), clamp(n, -1.0, 1.0), greaterThanEqual(abs(n), vec2(0.0)));  // false for NaN
    const float depth = s.z > 0.0 && s.z < 1e30 ? min(s.z * frame.y, 1.0) : 1.0;
    y[index] = row % 2 == 0 ? vec4(color, n.x) : vec4(n.y, depth, 0.0, 0.0);
}
