#version 460
// [n][h][c4][w] in texels of 4 channels -> [n][ceil(w/4)][h][c] in texels of 4 pixels; pixels past the row's end are 0. The result
// is read down columns of pixels, channels across the lanes: both lie together.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer x;   // [n][h][c4][w]
layout(set = 0, binding = 1, std430) writeonly buffer Y { vec4 y[]; };  // [n][w4][h][c4 * 4]

layout(push_constant) uniform Push {
    uint height;
    uint width;
    uint c4;
    uint count;  // invocations: n * h * w4 * c4, four texels each
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint w4 = (width + 3) / 4;
    const uint px4 = index % w4;
    const uint c = (index / w4) % c4;
    const uint row = index / (c4 * w4);
    const uint n = row / height;
    const uint py = row % height;
    vec4 v[4];
    for (uint p = 0; p < 4; ++p) {
        const uint px = px4 * 4 + p;
        v[p] = px < width ? imageLoad(x, int((row * c4 + c) * width + px)) : vec4(0.0);
    }
    const uint at = (((n * w4 + px4) * height + py) * c4 + c) * 4;
    for (uint j = 0; j < 4; ++j) y[at + j] = vec4(v[0][j], v[1][j], v[2][j], v[3][j]);
}
