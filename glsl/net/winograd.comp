#version 460
// 3x3 convolution by Winograd's F(4x4, 3x3), bias and leaky ReLU (slope 1: linear), for CPU drivers. Lanes are tiles of 4x4
// results while the operand's 6x6 patches are transformed (V = B^T d B), and output channels while they are multiplied by the
// transformed weights: V is broadcast by shuffles with constant lanes. A row of the 6x6 positions at a time, so that the sums
// stay in the nearest cache, and nothing but the result goes to memory: llvmpipe stores lane by lane, a float costs as
// much as fifty products. No branch around a load: outside control flow it compiles texel loads to plain vector code.
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(constant_id = 0) const uint L = 8;                // subgroup size, 8 or 16
layout(constant_id = 1) const uint GROUP = 4;            // blocks of L output channels that a subgroup makes, at most 4
const uint LOCAL = 64;
layout(local_size_x = 64) in;

// The operand's channels are those of `low`, 2x upsampled (nearest), then those of `x`, as in a concatenation.
layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer low;     // [n][h/2][low4][w/2]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer x;       // [n][h][x4][w]
layout(set = 0, binding = 2, rgba32f) readonly uniform imageBuffer weight;  // [36][blocks][low4 + x4][L]
layout(set = 0, binding = 3, r32f) readonly uniform imageBuffer bias;       // [cout]
layout(set = 0, binding = 4, std430) writeonly buffer Y { vec4 y[]; };      // rows of [n][h][cout4][w], a window

layout(push_constant) uniform Push {
    int height;  // of the result
    int width;
    int low4;  // 0: there is no `low`
    int x4;
    uint blocks;  // of L output channels
    uint cout4;
    uint tiles_x;
    uint tiles_y;         // of one image
    uint tile_row_begin;  // first of this dispatch, over all images
    uint tile_count;      // of this dispatch
    uint window_row;      // first row of the output window, over all images
    float slope;
};

float acc[4][6][16];        // [block][position in the row][tile]
float result[4][4][4][16];  // [block][row][column][tile]

// Where this lane's tile lies.
int tx;
int ty;
int image_row;  // first row of its image, over all images

// The product of a row of V, 4 channels, and the weights.
void multiply(vec4 v[6], int row, int c, bool upsampled) {
    [[unroll]] for (int p = 0; p < 6; ++p) {
        if (upsampled && p == 2) continue;  // V vanishes
        vec4 w[4];
        [[unroll]] for (int b = 0; b < int(GROUP); ++b) {
            const int block = min(int(gl_WorkGroupID.y * GROUP) + b, int(blocks) - 1);
            const int at = ((row * 6 + p) * int(blocks) + block) * (low4 + x4) + c;
            w[b] = imageLoad(weight, at * int(L) + int(gl_SubgroupInvocationID));
        }
        [[unroll]] for (int i = 0; i < int(L); ++i) {
            vec4 s;
            [[unroll]] for (int j = 0; j < 4; ++j) s[j] = subgroupShuffle(v[p][j], uint(i));
            [[unroll]] for (int b = 0; b < int(GROUP); ++b) {
                acc[b][p][i] += w[b].x * s.x + w[b].y * s.y + w[b].z * s.z + w[b].w * s.w;
            }
        }
    }
}

// Adds what a row of positions gets from `x`.
void add_plain(int row) {
    const bool outer = row == 0 || row == 5;
    const int row_of[4] = {row == 0 ? 0 : 1, row == 5 ? 3 : 2, row == 0 ? 4 : row == 5 ? 5 : 3, 4};
    const float f0 = outer || row == 2 ? 4.0 : row == 1 ? -4.0 : row == 3 ? -2.0 : 2.0;
    const float f1 = outer ? -5.0 : row < 3 ? -4.0 : -1.0;
    const float f2 = outer || row == 1 ? 1.0 : row == 2 ? -1.0 : row == 3 ? 2.0 : -2.0;
    const float f3 = outer ? 0.0 : 1.0;
    int at[4][6];
    [[unroll]] for (int j = 0; j < 4; ++j) {
        const int py = 4 * ty - 1 + row_of[j];
        [[unroll]] for (int q = 0; q < 6; ++q) {
            const int px = 4 * tx - 1 + q;
            const bool inside = px >= 0 && py >= 0 && px < width && py < height;
            at[j][q] = inside ? (image_row + py) * x4 * width + px : -1;
        }
    }
    for (int c = 0; c < x4; ++c) {
        vec4 t[6];
        [[unroll]] for (int q = 0; q < 6; ++q) {
            vec4 d[4];
            [[unroll]] for (int j = 0; j < 4; ++j) {
                const vec4 loaded = imageLoad(x, max(at[j][q], 0) + c * width);
                d[j] = mix(vec4(0.0), loaded, bvec4(at[j][q] >= 0));
            }
            t[q] = (f0 * d[0] + f1 * d[1]) + (f2 * d[2] + f3 * d[3]);
        }
        vec4 v[6];
        v[0] = 4.0 * t[0] - 5.0 * t[2] + t[4];
        v[1] = (t[4] - 4.0 * t[2]) + (t[3] - 4.0 * t[1]);
        v[2] = (t[4] - 4.0 * t[2]) - (t[3] - 4.0 * t[1]);
        v[3] = (t[4] - t[2]) + 2.0 * (t[3] - t[1]);
        v[4] = (t[4] - t[2]) - 2.0 * (t[3] - t[1]);
        v[5] = 4.0 * t[1] - 5.0 * t[3] + t[5];
        multiply(v, row, low4 + c, false);
    }
}

// The same from the upsampled `low`. Rows 1, 2 and 3, 4 of a patch are then equal, as are its columns: it is made
// of 4x4 texels, and V vanishes in row 2 and column 2 (interpolation point -1).
void add_upsampled(int row) {
    const bool outer = row == 0 || row == 5;
    const float f0 = outer ? 4.0 : row == 1 ? -8.0 : row == 3 ? -3.0 : 1.0;
    const float f1 = outer ? -5.0 : row == 1 ? 2.0 : row == 3 ? 3.0 : -1.0;
    const float f2 = outer ? 1.0 : 0.0;
    int at[3][4];
    [[unroll]] for (int j = 0; j < 3; ++j) {
        const int py = 2 * ty - 1 + j + (row == 0 ? 0 : 1);
        [[unroll]] for (int q = 0; q < 4; ++q) {
            const int px = 2 * tx - 1 + q;
            const bool inside = px >= 0 && py >= 0 && px < width / 2 && py < height / 2;
            at[j][q] = inside ? (image_row / 2 + py) * low4 * (width / 2) + px : -1;
        }
    }
    const int count = row == 2 ? 0 : low4;
    for (int c = 0; c < count; ++c) {
        vec4 t[4];
        [[unroll]] for (int q = 0; q < 4; ++q) {
            vec4 d[3];
            [[unroll]] for (int j = 0; j < 3; ++j) {
                const vec4 loaded = imageLoad(low, max(at[j][q], 0) + c * (width / 2));
                d[j] = mix(vec4(0.0), loaded, bvec4(at[j][q] >= 0));
            }
            t[q] = f0 * d[0] + f1 * d[1] + f2 * d[2];
        }
        vec4 v[6];
        v[0] = 4.0 * t[0] - 5.0 * t[1] + t[2];
        v[1] = 2.0 * (t[2] - 4.0 * t[1]);
        v[2] = vec4(0.0);
        v[3] = 3.0 * (t[2] - t[1]);
        v[4] = t[1] - t[2];
        v[5] = 4.0 * t[1] - 5.0 * t[2] + t[3];
        multiply(v, row, c, true);
    }
}

// Y += A^T M A, what a row of positions adds to the tiles.
void add_result(int row) {
    const float a0 = row == 5 ? 0.0 : 1.0;
    const float a1 = row == 1 ? 1.0 : row == 2 ? -1.0 : row == 3 ? 2.0 : row == 4 ? -2.0 : 0.0;
    const float a2 = a1 * a1;
    const float a3 = row == 5 ? 1.0 : a1 * a2;
    [[unroll]] for (int b = 0; b < int(GROUP); ++b) {
        [[unroll]] for (int i = 0; i < int(L); ++i) {
            const float sum1 = acc[b][1][i] + acc[b][2][i];
            const float difference1 = acc[b][1][i] - acc[b][2][i];
            const float sum2 = acc[b][3][i] + acc[b][4][i];
            const float difference2 = acc[b][3][i] - acc[b][4][i];
            const vec4 m = vec4(acc[b][0][i] + sum1 + sum2, difference1 + 2.0 * difference2, sum1 + 4.0 * sum2,
                difference1 + 8.0 * difference2 + acc[b][5][i]);
            [[unroll]] for (int s = 0; s < 4; ++s) {
                result[b][0][s][i] += a0 * m[s];
                result[b][1][s][i] += a1 * m[s];
                result[b][2][s][i] += a2 * m[s];
                result[b][3][s][i] += a3 * m[s];
            }
        }
    }
}

void main() {
    const uint lane = gl_SubgroupInvocationID;
    const uint index = gl_WorkGroupID.x * (LOCAL / L) + gl_LocalInvocationID.x / L;
    const uint tile = min(index * L + lane, tile_count - 1);
    const uint tile_row = tile_row_begin + tile / tiles_x;
    tx = int(tile % tiles_x);
    ty = int(tile_row % tiles_y);
    image_row = int(tile_row / tiles_y) * height;

    [[unroll]] for (int b = 0; b < int(GROUP); ++b) {
        [[unroll]] for (int k = 0; k < 16; ++k) {
            [[unroll]] for (int i = 0; i < int(L); ++i) result[b][k / 4][k % 4][i] = 0.0;
        }
    }
    for (int row = 0; row < 6; ++row) {
        [[unroll]] for (int b = 0; b < int(GROUP); ++b) {
            [[unroll]] for (int p = 0; p < 6; ++p) {
                [[unroll]] for (int i = 0; i < int(L); ++i) acc[b][p][i] = 0.0;
            }
        }
        add_upsampled(row);
        add_plain(row);
        add_result(row);
    }

    // A store of one float a lane runs lane by lane: regroup, so that a lane holds 4 channels of one of 4 tiles.
    const uint quad = lane % (L / 4);
    const uint own = lane / (L / 4);
    for (uint r = 0; r < 4; ++r) {
        [[unroll]] for (int b = 0; b < int(GROUP); ++b) {
            const uint block = gl_WorkGroupID.y * GROUP + b;
            const float block_bias = imageLoad(bias, int(min(block, blocks - 1) * L + lane)).x;
            const uint co4 = block * (L / 4) + quad;
            [[unroll]] for (int i = 0; i < int(L); i += 4) {
                const uint stored = index * L + i + own;
                const uint stored_row = tile_row_begin + stored / tiles_x;
                const uint px = stored % tiles_x * 4;
                const uint py = stored_row % tiles_y * 4 + r;
                const uint at = ((stored_row / tiles_y * height + py - window_row) * cout4 + co4) * width + px;
                const bool alive = stored < tile_count && co4 < cout4 && py < height;
                [[unroll]] for (int s = 0; s < 4; ++s) {
                    vec4 v = vec4(0.0);
                    [[unroll]] for (int p = 0; p < 4; ++p) {
                        float a = result[b][0][s][i + p] + block_bias;
                        a = a > 0.0 ? a : a * slope;
                        [[unroll]] for (int j = 0; j < 4; ++j) {
                            const float other = subgroupShuffle(a, quad * 4 + j);
                            v[j] = own == uint(p) ? other : v[j];
                        }
                    }
                    if (alive && px + s < width) y[at + s] = v;
                    // The next row comes down, so that the code of the stores stands once.
                    [[unroll]] for (int p = 0; p < 4; ++p) {
                        [[unroll]] for (int k = 0; k < 3; ++k) result[b][k][s][i + p] = result[b][k + 1][s][i + p];
                    }
                }
            }
        }
    }
}
