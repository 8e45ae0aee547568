#version 460
// Radiance without texture, from a network's input: exposed radiance / texture, and 1 where the pixel lies inside the
// picture. Past its end all nine channels of the input are 0: a normal of that length is none.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"
#include "lib/transfer.glsl"
#include "lib/texture.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer x;   // [n][h][3][w]: r, g, b, albedo r | g, b, normal x, y | z
layout(set = 0, binding = 1, std430) writeonly buffer Y { vec4 y[]; };  // [n][h][w], a window

layout(push_constant) uniform Push {
    uint begin;  // first pixel of the window
    uint count;
    uint width;
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint at = begin + index;
    const int from = int(at / width * 3 * width + at % width);
    const vec4 first = imageLoad(x, from);
    const vec4 second = imageLoad(x, from + int(width));
    const float normal_z = imageLoad(x, from + int(2 * width)).x;
    const bool inside = any(notEqual(first, vec4(0.0))) || any(notEqual(second, vec4(0.0))) || normal_z != 0.0;
    const vec3 radiance = from_network(TRANSFER_PU, first.rgb, 1.0) / texture_of(first, second);
    y[index] = inside ? vec4(min(radiance, MAX_EXPOSED), 1.0) : vec4(0.0);
}
