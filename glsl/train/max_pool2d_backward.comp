#version 460
// Gradient of the 2x2 maximum: to the first largest of the four, in row-major order.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer x;     // [n][h][c4][w]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer dy;    // [n][h/2][c4][w/2]
layout(set = 0, binding = 2, std430) writeonly buffer Dx { vec4 dx[]; };  // [n][h][c4][w], a window

layout(push_constant) uniform Push {
    uint begin;  // first texel of the window
    uint count;
    uint height;  // of x
    uint width;
    uint c4;
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint at = begin + index;
    const uint px = at % width;
    const uint c = (at / width) % c4;
    const uint row = at / (c4 * width);
    const uint py = row % height;
    const uint n = row / height;
    const uint oy = py / 2;
    const uint ox = px / 2;
    if (oy >= height / 2 || ox >= width / 2) {
        dx[index] = vec4(0.0);  // dropped by the odd size
        return;
    }
    const uint mine = (py % 2) * 2 + px % 2;
    vec4 best = vec4(0.0);
    uvec4 winner = uvec4(0);
    for (uint k = 0; k < 4; ++k) {
        const vec4 v = imageLoad(x, int(((n * height + 2 * oy + k / 2) * c4 + c) * width + 2 * ox + k % 2));
        for (uint j = 0; j < 4; ++j) {
            if (k == 0 || v[j] > best[j]) {
                best[j] = v[j];
                winner[j] = k;
            }
        }
    }
    const vec4 d = imageLoad(dy, int(((n * (height / 2) + oy) * c4 + c) * (width / 2) + ox));
    dx[index] = mix(vec4(0.0), d, equal(winner, uvec4(mine)));
}
