#version 460
// Gradient of modulate.comp with respect to the filtered radiance.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"
#include "lib/transfer.glsl"
#include "lib/texture.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer x;      // [n][h][w]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer input_; // [n][h][3][w], the network's input
layout(set = 0, binding = 2, rgba32f) readonly uniform imageBuffer dy;     // [n][h][w]
layout(set = 0, binding = 3, std430) writeonly buffer Dx { vec4 dx[]; };   // [n][h][w], a window

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
    const vec3 factor = texture_of(imageLoad(input_, from), imageLoad(input_, from + int(width)));
    dx[index] = vec4(imageLoad(dy, int(at)).rgb * factor * pu_derivative(imageLoad(x, int(at)).rgb * factor), 0.0);
}
