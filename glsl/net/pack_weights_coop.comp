#version 460
// Weights OIHW -> f16 in the order in which conv2d_coop reads them, forward or transposed and flipped (input gradient):
// [block][chunk][9][16 / K][wide / N] matrices of K input by N output channels, column-major. An invocation writes 8 input
// channels of one output channel.
#extension GL_EXT_shader_explicit_arithmetic_types_float16 : require
#extension GL_GOOGLE_include_directive : require
#include "lib/channels.glsl"
#include "lib/half.glsl"
#include "lib/index.glsl"

layout(constant_id = 0) const uint N = 16;
layout(constant_id = 1) const uint K = 16;
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, r32f) readonly uniform imageBuffer weight;  // [cout][cin][3][3]
layout(set = 0, binding = 1, std430) writeonly buffer Packed { uvec4 packed_weight[]; };

layout(push_constant) uniform Push {
    uint cin;
    uint cout;
    uint chunks;      // of 16 channels of the operand read
    uint wide;        // output channels of a block
    uint count;       // invocations
    uint transposed;  // 1: the operand read has the layer's output channels
    uint segment;     // of the layer's input, see channels.glsl
    uint segment_padded;
};

const uint CHUNK = 16;

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const uint part = index % (K / 8);
    const uint column = index / (K / 8) % N;
    const uint fragments = wide / N;
    const uint fragment = index / (K / 8 * N) % fragments;
    const uint matrix = index / (K / 8 * wide);
    const uint step = matrix % (CHUNK / K);
    const uint tap = matrix / (CHUNK / K) % 9;
    const uint chunk = matrix / (CHUNK / K * 9) % chunks;
    const uint block = matrix / (CHUNK / K * 9 * chunks);
    const uint out_channel = block * wide + fragment * N + column;
    vec4 v[2];
    for (uint j = 0; j < 8; ++j) {
        const uint in_channel = chunk * CHUNK + step * K + part * 8 + j;
        const uint o = transposed == 0 ? out_channel : in_channel;
        const uint i = input_channel(transposed == 0 ? in_channel : out_channel, segment, segment_padded, cin);
        const uint t = transposed == 0 ? tap : 8 - tap;
        v[j / 4][j % 4] = o < cout && i != NONE ? imageLoad(weight, int((o * cin + i) * 9 + t)).x : 0.0;
    }
    packed_weight[index] = to_halves(in_half_range(v[0]), in_half_range(v[1]));
}
