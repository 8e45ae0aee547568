#version 460
// A crop of a frame as the input of a network: r, g, b, albedo r | g, b, normal x, y | z, 0, 0, 0. The normal's components go
// from [-1, 1] to [0, 1]. Zeros past the picture's end.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"
#include "lib/transfer.glsl"
#include "lib/crop.glsl"

layout(constant_id = 0) const uint TRANSFER = TRANSFER_PU;
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer radiance;  // [pixel]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer albedo;    // [pixel]
layout(set = 0, binding = 2, rgba32f) readonly uniform imageBuffer normal;    // [pixel], world space
layout(set = 0, binding = 3, rgba32f) readonly uniform imageBuffer stats;     // exposure
layout(set = 0, binding = 4, std430) writeonly buffer Y { vec4 y[]; };        // [h][3][w], a window

layout(push_constant) uniform Push {
    uint begin;     // first texel of the window
    uint count;     // texels
    int width;      // of the picture
    int height;
    int crop_width;
    int crop_height;
    int x0;         // the crop's origin in the picture
    int y0;
    uint orientation;
    float right_x;  // the camera's axes in world space; only read where the crop is turned
    float right_y;
    float right_z;
    float up_x;
    float up_y;
    float up_z;
};

// `v` within [low, high], 0 where it is no number.
vec3 sane(vec3 v, float low, float high) {
    return mix(vec3(0.0), clamp(v, low, high), greaterThanEqual(abs(v), vec3(0.0)));  // false for NaN
}

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const int at = int(begin + index);
    const int row = at / crop_width;
    const ivec2 p = crop_source(ivec2(at % crop_width, row / 3), ivec2(crop_width, crop_height), ivec2(x0, y0), orientation);
    if (p.x >= width || p.y >= height) {
        y[index] = vec4(0.0);
        return;
    }
    const int from = p.y * width + p.x;
    const vec3 color = to_network(TRANSFER, imageLoad(radiance, from).rgb, imageLoad(stats, 0).x);
    const vec3 a = sane(imageLoad(albedo, from).rgb, 0.0, 1.0);
    vec3 n = sane(imageLoad(normal, from).xyz, -1.0, 1.0);
    if (orientation != 0u) {
        n = crop_normal_world(n, vec3(right_x, right_y, right_z), vec3(up_x, up_y, up_z), orientation);
        n = clamp(n, -1.0, 1.0);  // rounding, and normals of more than unit length
    }
    n = 0.5 * n + 0.5;
    const int part = row % 3;
    y[index] = part == 0 ? vec4(color, a.r) : part == 1 ? vec4(a.gb, n.xy) : vec4(n.z, 0.0, 0.0, 0.0);
}
