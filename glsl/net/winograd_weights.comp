#version 460
// Winograd F(4x4, 3x3): U = G g G^T of OIHW weights, [36][out/L][in4][L] texels of 4 input channels.
#extension GL_GOOGLE_include_directive : require
#include "lib/channels.glsl"
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, r32f) readonly uniform imageBuffer weight;  // [cout][cin][3][3]
layout(set = 0, binding = 1, std430) writeonly buffer U { vec4 u[]; };

layout(push_constant) uniform Push {
    uint cin;
    uint cout;
    uint lanes;    // L
    uint in4;      // texels a pixel of the operand read
    uint blocks;   // of L output channels
    uint count;    // texels written
    uint transposed;  // 1: for the input gradient, the operand read has the layer's output channels
    uint segment;  // of the layer's input, see channels.glsl
    uint segment_padded;
};

// Row `i` of G times a column.
float transformed(uint i, float g0, float g1, float g2) {
    if (i == 0) return g0 / 4.0;
    if (i == 1) return (g0 + g1 + g2) / -6.0;
    if (i == 2) return (g0 - g1 + g2) / -6.0;
    if (i == 3) return (g0 + 2.0 * g1 + 4.0 * g2) / 24.0;
    if (i == 4) return (g0 - 2.0 * g1 + 4.0 * g2) / 24.0;
    return g2;
}

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint lane = index % lanes;
    const uint c4 = (index / lanes) % in4;
    const uint out_channel = (index / (lanes * in4)) % blocks * lanes + lane;
    const uint position = index / (lanes * in4 * blocks);
    vec4 v = vec4(0.0);
    for (uint j = 0; j < 4; ++j) {
        const uint in_channel = c4 * 4 + j;
        const uint o = transposed == 0 ? out_channel : in_channel;
        const uint i = input_channel(transposed == 0 ? in_channel : out_channel, segment, segment_padded, cin);
        if (o >= cout || i == NONE) continue;
        const int at = int((o * cin + i) * 9);
        float g[9];
        for (int t = 0; t < 9; ++t) g[t] = imageLoad(weight, at + (transposed == 0 ? t : 8 - t)).x;
        float row[3];
        for (int x = 0; x < 3; ++x) row[x] = transformed(position / 6, g[x], g[3 + x], g[6 + x]);
        v[j] = transformed(position % 6, row[0], row[1], row[2]);
    }
    u[index] = v;
}
