#version 460
// 3x3 convolution, stride 1, zero padding 1, bias and leaky ReLU (slope 1: linear), for CPU drivers.
// Tensors are [n][h][c4][w] in texels of 4 channels. Lanes are output channels; a subgroup makes a tile of 6x4 pixels of L channels:
// the 8x6 patch of inputs lies across the lanes (one pixel a lane and register) and is broadcast by shuffles with constant
// lanes. No branch around a load: llvmpipe compiles texel loads outside control flow to plain vector code.
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(constant_id = 0) const uint L = 8;             // subgroup size, 8 or 16
const uint LOCAL = 64;
layout(constant_id = 1) const float SLOPE = 1.0;
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer x;       // [n][h][cin4][w]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer weight;  // [cout/L][cin4][9][L] of 4 input channels
layout(set = 0, binding = 2, r32f) readonly uniform imageBuffer bias;       // [cout]
layout(set = 0, binding = 3, std430) writeonly buffer Y { vec4 y[]; };      // rows of [n][h][cout4][w], a window

layout(push_constant) uniform Push {
    uint height;
    uint width;
    uint cin4;
    uint cout4;
    uint tiles_x;
    uint tiles_y;          // of one image
    uint tile_row_begin;   // first of this dispatch, over all images
    uint tile_count;       // of this dispatch
    uint window_row;       // first row of the output window, over all images
};

const int TW = 6;  // tile, pixels
const int TH = 4;
const int PW = TW + 2;
const int PATCH = PW * (TH + 2);
const int LOADS = PATCH / int(L);

void main() {
    const uint lane = gl_SubgroupInvocationID;
    const uint index = gl_WorkGroupID.x * (LOCAL / L) + gl_LocalInvocationID.x / L;
    const uint tile = min(index, tile_count - 1);
    const uint co_block = gl_WorkGroupID.y;
    const uint tile_row = tile_row_begin + tile / tiles_x;
    const int x0 = int(tile % tiles_x) * TW;
    const int y0 = int(tile_row % tiles_y) * TH;
    const uint image_row = (tile_row / tiles_y) * height;

    int base[LOADS];
    bool inside[LOADS];
    [[unroll]] for (int k = 0; k < LOADS; ++k) {
        const int p = k * int(L) + int(lane);
        const int px = x0 - 1 + p % PW;
        const int py = y0 - 1 + p / PW;
        inside[k] = px >= 0 && py >= 0 && px < int(width) && py < int(height);
        base[k] = inside[k] ? int((image_row + uint(py)) * cin4 * width) + px : 0;
    }

    const uint co = co_block * L + lane;
    const float b = imageLoad(bias, int(co)).x;
    float acc[TW * TH];
    [[unroll]] for (int i = 0; i < TW * TH; ++i) acc[i] = b;

    int w_at = int(co_block * cin4 * 9 * L + lane);
    for (int c = 0; c < int(cin4); ++c) {
        vec4 r[LOADS];
        [[unroll]] for (int k = 0; k < LOADS; ++k) {
            r[k] = mix(vec4(0.0), imageLoad(x, base[k] + c * int(width)), bvec4(inside[k]));
        }
        vec4 w[9];
        [[unroll]] for (int t = 0; t < 9; ++t) w[t] = imageLoad(weight, w_at + t * int(L));
        // A row's sums, three weights and a few pixels at a time: few enough to stay in 16 registers.
        [[unroll]] for (int row = 0; row < TH; ++row) {
            [[unroll]] for (int ci = 0; ci < 4; ++ci) {
                [[unroll]] for (int ky = 0; ky < 3; ++ky) {
                    [[unroll]] for (int column = 0; column < TW; ++column) {
                        [[unroll]] for (int kx = 0; kx < 3; ++kx) {
                            const int q = (row + ky) * PW + column + kx;
                            const float v = subgroupShuffle(r[q / int(L)][ci], uint(q % int(L)));
                            acc[row * TW + column] += w[ky * 3 + kx][ci] * v;
                        }
                    }
                }
            }
        }
        w_at += 9 * int(L);
    }

    // A store of one float a lane runs lane by lane: regroup, so that a lane holds 4 channels of one of 4 pixels.
    const uint quad = lane % (L / 4);
    const uint own = lane / (L / 4);
    const uint co4 = co_block * (L / 4) + quad;
    const bool alive = index < tile_count && co4 < cout4;
    [[unroll]] for (int i = 0; i < TW * TH; i += 4) {
        vec4 v = vec4(0.0);
        [[unroll]] for (int p = 0; p < 4; ++p) {
            const float a = acc[i + p] > 0.0 ? acc[i + p] : acc[i + p] * SLOPE;
            [[unroll]] for (int j = 0; j < 4; ++j) {
                const float other = subgroupShuffle(a, quad * 4 + j);
                v[j] = own == uint(p) ? other : v[j];
            }
        }
        const uint px = uint(x0) + uint(i + int(own)) % uint(TW);
        const uint py = uint(y0) + uint(i + int(own)) / uint(TW);
        if (alive && px < width && py < height) {
            y[((image_row + py - window_row) * cout4 + co4) * width + px] = v;
        }
    }
}
