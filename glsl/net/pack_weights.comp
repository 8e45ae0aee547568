#version 460
// Weights OIHW -> [out/L][in4][9][L] texels of 4 input channels, forward or transposed and flipped (input gradient).
#extension GL_GOOGLE_include_directive : require
#include "lib/channels.glsl"
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, r32f) readonly uniform imageBuffer weight;      // [cout][cin][3][3]
layout(set = 0, binding = 1, std430) writeonly buffer Packed { vec4 packed_weight[]; };

layout(push_constant) uniform Push {
    uint cin;
    uint cout;
    uint lanes;       // L
    uint in4;         // texels a pixel of the operand read
    uint count;       // texels written
    uint transposed;  // 1: the operand read has the layer's output channels
    uint segment;     // of the layer's input, see channels.glsl
    uint segment_padded;
};

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint lane = index % lanes;
    const uint tap = (index / lanes) % 9;
    const uint c4 = (index / (lanes * 9)) % in4;
    const uint out_channel = index / (lanes * 9 * in4) * lanes + lane;
    vec4 v = vec4(0.0);
    for (uint j = 0; j < 4; ++j) {
        const uint in_channel = c4 * 4 + j;
        const uint o = transposed == 0 ? out_channel : in_channel;
        const uint i = input_channel(transposed == 0 ? in_channel : out_channel, segment, segment_padded, cin);
        const uint t = transposed == 0 ? tap : 8 - tap;
        if (o < cout && i != NONE) v[j] = imageLoad(weight, int((o * cin + i) * 9 + t)).x;
    }
    packed_weight[index] = v;
}
