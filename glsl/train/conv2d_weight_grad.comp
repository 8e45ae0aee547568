#version 460
// Weight gradient of a 3x3 convolution, core Vulkan 1.3 only: an invocation sums 9 taps x 4 input channels of one output channel.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer x;    // [n][h][cin4][w]
layout(set = 0, binding = 1, r32f) readonly uniform imageBuffer dy;      // [n][h][cout/4][w] of 4 channels
layout(set = 0, binding = 2, std430) writeonly buffer Partial { vec4 partial_sum[]; };  // [split][cout/4][cin4][9][4]

layout(push_constant) uniform Push {
    uint batch;
    uint height;
    uint width;
    uint cin4;
    uint cout;    // padded to 4
    uint splits;  // each takes every splits-th row
    uint count;   // invocations: splits * cout * cin4
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint lane = index % 4;
    const uint c4 = (index / 4) % cin4;
    const uint co4 = (index / (4 * cin4)) % (cout / 4);
    const uint split = index / (cin4 * cout);
    const uint co = co4 * 4 + lane;
    vec4 acc[9];
    for (int t = 0; t < 9; ++t) acc[t] = vec4(0.0);
    for (uint row = split; row < batch * height; row += splits) {
        const int py = int(row % height);
        for (int px = 0; px < int(width); ++px) {
            const float d = imageLoad(dy, int(((row * (cout / 4) + co4) * width + uint(px)) * 4 + lane)).x;
            for (int t = 0; t < 9; ++t) {
                const int sx = px + t % 3 - 1;
                const int sy = py + t / 3 - 1;
                if (sx < 0 || sy < 0 || sx >= int(width) || sy >= int(height)) continue;
                const int at = ((int(row) + t / 3 - 1) * int(cin4) + int(c4)) * int(width) + sx;
                acc[t] += d * imageLoad(x, at);
            }
        }
    }
    const uint at = ((split * (cout / 4) + co4) * cin4 + c4) * 36 + lane;
    for (int t = 0; t < 9; ++t) partial_sum[at + t * 4] = acc[t];
}
