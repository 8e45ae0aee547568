#version 460
// Winograd: M = U V, a matrix product for each of the 36 positions, for CPU drivers. Lanes are output channels; a subgroup
// makes L tiles by GROUP blocks of L channels. V lies across the lanes, a tile a lane, and is broadcast by constant shuffles.
// Texel loads cost as much as the arithmetic: the more blocks share V, the better.
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(constant_id = 0) const uint L = 8;  // subgroup size, 8 or 16
layout(constant_id = 1) const uint GROUP = 2;
const uint LOCAL = 64;
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer v;   // [36][tile_stride][in4]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer u;   // [36][blocks][in4][L]
layout(set = 0, binding = 2, std430) writeonly buffer M { vec4 m[]; };  // [36][tile_stride / 4][blocks * L] of 4 tiles

layout(push_constant) uniform Push {
    uint in4;
    uint upsampled4;   // texels of the first operand, where that is upsampled: winograd_input.comp
    uint blocks;       // of L output channels
    uint tile_blocks;  // of L tiles
    uint tile_stride;
};

void main() {
    const uint lane = gl_LocalInvocationID.x % L;
    const uint index = gl_WorkGroupID.x * (LOCAL / L) + gl_LocalInvocationID.x / L;
    const uint tile = min(index, tile_blocks - 1) * L;
    const uint block = gl_WorkGroupID.y * GROUP;
    const uint position = gl_WorkGroupID.z;
    const bool vanishes = position / 6 == 2 || position % 6 == 2;

    float acc[4][16];
    int u_at[4];
    [[unroll]] for (int b = 0; b < int(GROUP); ++b) {
        u_at[b] = int((position * blocks + min(block + b, blocks - 1)) * in4 * L + lane);
        [[unroll]] for (int i = 0; i < int(L); ++i) acc[b][i] = 0.0;
    }
    const int v_at = int((position * tile_stride + tile + lane) * in4);
    for (int c = vanishes ? int(upsampled4) : 0; c < int(in4); ++c) {
        const vec4 r = imageLoad(v, v_at + c);
        vec4 w[4];
        [[unroll]] for (int b = 0; b < int(GROUP); ++b) w[b] = imageLoad(u, u_at[b] + c * int(L));
        [[unroll]] for (int i = 0; i < int(L); ++i) {
            vec4 s;
            [[unroll]] for (int ci = 0; ci < 4; ++ci) s[ci] = subgroupShuffle(r[ci], uint(i));
            // Four products before the accumulator, which is rarely in a register.
            [[unroll]] for (int b = 0; b < int(GROUP); ++b) {
                acc[b][i] += w[b].x * s.x + w[b].y * s.y + w[b].z * s.z + w[b].w * s.w;
            }
        }
    }
    if (index < tile_blocks) {
        const uint row = (position * tile_stride + tile) / 4;
        [[unroll]] for (int b = 0; b < int(GROUP); ++b) {
            if (block + b < blocks) {
                [[unroll]] for (int i = 0; i < int(L); i += 4) {
                    m[(row + i / 4) * (blocks * L) + (block + b) * L + lane] =
                        vec4(acc[b][i], acc[b][i + 1], acc[b][i + 2], acc[b][i + 3]);
                }
            }
        }
    }
}
