#version 460
// Winograd F(4x4, 3x3): Y = A^T M A, bias and leaky ReLU (slope 1: linear), for CPU drivers. Lanes are output channels;
// an invocation: 4 tiles of one channel.
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(constant_id = 0) const uint L = 8;  // subgroup size, 8 or 16
layout(constant_id = 1) const float SLOPE = 1.0;
const uint LOCAL = 64;
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer m;   // [36][tile_stride / 4][blocks * L] of 4 tiles
layout(set = 0, binding = 1, r32f) readonly uniform imageBuffer bias;   // [cout]
layout(set = 0, binding = 2, std430) writeonly buffer Y { vec4 y[]; };  // rows of [n][h][w][cout4], a window

layout(push_constant) uniform Push {
    uint height;
    uint width;
    uint blocks;  // of L output channels
    uint cout4;
    uint tiles_x;
    uint tiles_y;         // of one image
    uint tile_row_begin;  // first of this stripe, over all images
    uint tile_count;      // of this stripe
    uint tile_stride;
    uint window_row;      // first row of the output window, over all images
};

vec4 transformed(int i, vec4 d[6]) {
    if (i == 0) return d[0] + (d[1] + d[2]) + (d[3] + d[4]);
    if (i == 1) return (d[1] - d[2]) + 2.0 * (d[3] - d[4]);
    if (i == 2) return (d[1] + d[2]) + 4.0 * (d[3] + d[4]);
    return (d[1] - d[2]) + 8.0 * (d[3] - d[4]) + d[5];
}

void main() {
    const uint lane = gl_LocalInvocationID.x % L;
    const uint index = gl_WorkGroupID.x * (LOCAL / L) + gl_LocalInvocationID.x / L;
    const uint four = min(index, (tile_count + 3) / 4 - 1);
    const uint block = gl_WorkGroupID.y;
    vec4 t[4][6];  // [row of A^T M][column]
    [[unroll]] for (int i = 0; i < 6; ++i) {
        vec4 d[6];
        [[unroll]] for (int k = 0; k < 6; ++k) {
            d[k] = imageLoad(m, int((uint(k * 6 + i) * (tile_stride / 4) + four) * (blocks * L) + block * L + lane));
        }
        [[unroll]] for (int k = 0; k < 4; ++k) t[k][i] = transformed(k, d);
    }
    const float b = imageLoad(bias, int(block * L + lane)).x;

    // A store of one float a lane runs lane by lane: regroup, so that a lane holds 4 channels of one of the 4 tiles.
    const uint quad = lane % (L / 4);
    const uint own = lane / (L / 4);
    const uint co4 = block * (L / 4) + quad;
    const uint tile = four * 4 + own;
    const uint tile_row = tile_row_begin + tile / tiles_x;
    const uint x0 = (tile % tiles_x) * 4;
    const uint y0 = (tile_row % tiles_y) * 4;
    const uint image_row = (tile_row / tiles_y) * height;
    const bool alive = index == four && tile < tile_count && co4 < cout4;
    [[unroll]] for (int k = 0; k < 4; ++k) {
        [[unroll]] for (int i = 0; i < 4; ++i) {
            vec4 a = transformed(i, t[k]) + b;
            a = mix(a * SLOPE, a, greaterThan(a, vec4(0.0)));
            vec4 regrouped = vec4(0.0);
            [[unroll]] for (int p = 0; p < 4; ++p) {
                [[unroll]] for (int q = 0; q < int(L) / 4; ++q) {
                    const vec4 other = vec4(subgroupShuffle(a[p], uint(q * 4)), subgroupShuffle(a[p], uint(q * 4 + 1)),
                        subgroupShuffle(a[p], uint(q * 4 + 2)), subgroupShuffle(a[p], uint(q * 4 + 3)));
                    regrouped = mix(regrouped, other, bvec4(own == uint(p) && quad == uint(q)));
                }
            }
            const uint px = x0 + uint(i);
            const uint py = y0 + uint(k);
            if (alive && px < width && py < height) {
                y[((image_row + py - window_row) * width + px) * cout4 + co4] = regrouped;
            }
        }
    }
}
