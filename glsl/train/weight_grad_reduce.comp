#version 460
// Adds the partial sums of a weight gradient in the order of the splits: [split][cout/L][cin4][9][L] x 4 -> OIHW.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, r32f) readonly uniform imageBuffer partial_sum;
layout(set = 0, binding = 1, std430) writeonly buffer WeightGrad { float weight_grad[]; };  // [cout][cin][3][3]

layout(push_constant) uniform Push {
    uint cin;
    uint cout;
    uint lanes;
    uint cin4;
    uint co_blocks;
    uint splits;
    uint segment;         // see pack_weights
    uint segment_padded;
};

void main() {
    const uint index = flat_index();
    if (index >= cout * cin * 9) return;
    const uint t = index % 9;
    const uint ci = (index / 9) % cin;
    const uint co = index / (9 * cin);
    const uint device = ci < segment ? ci : ci - segment + segment_padded;
    const uint texel = (((co / lanes) * cin4 + device / 4) * 9 + t) * lanes + co % lanes;
    const uint stride = co_blocks * cin4 * 9 * lanes * 4;
    float sum = 0.0;
    for (uint s = 0; s < splits; ++s) sum += imageLoad(partial_sum, int(s * stride + texel * 4 + device % 4)).x;
    weight_grad[index] = sum;
}
