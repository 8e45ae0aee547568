#version 460
// 3x3 convolution to at most 4 channels, stride 1, zero padding 1, bias and leaky ReLU (slope 1: linear), for CPU drivers.
// Lanes are tiles of 4x4 pixels: with output channels as lanes most of them would idle. The weights, which conv2d_cpu.comp reads
// too, are broadcast by shuffles with constant lanes. No branch around a load, as there.
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(constant_id = 0) const uint L = 8;     // subgroup size, 8 or 16
layout(constant_id = 1) const uint COUT = 3;  // 1 to 4
layout(constant_id = 2) const float SLOPE = 1.0;
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer x;       // [n][h][cin4][w]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer weight;  // [cin4][9][L] of 4 input channels
layout(set = 0, binding = 2, r32f) readonly uniform imageBuffer bias;       // [cout]
layout(set = 0, binding = 3, std430) writeonly buffer Y { vec4 y[]; };      // rows of [n][h][w], a window

layout(push_constant) uniform Push {
    int height;
    int width;
    int cin4;
    uint tiles_x;
    uint tiles_y;         // of one image
    uint tile_row_begin;  // first of this dispatch, over all images
    uint tile_count;      // of this dispatch
    uint window_row;      // first row of the output window, over all images
};

const int TAPS = int(L) / 4;  // whose weights a load brings

void main() {
    const int lane = int(gl_SubgroupInvocationID);
    const uint tile = min(gl_GlobalInvocationID.x, tile_count - 1);
    const uint tile_row = tile_row_begin + tile / tiles_x;
    const int x0 = int(tile % tiles_x) * 4;
    const int y0 = int(tile_row % tiles_y) * 4;
    const int image_row = int(tile_row / tiles_y) * height;

    int at[6][6];
    [[unroll]] for (int r = 0; r < 6; ++r) {
        [[unroll]] for (int q = 0; q < 6; ++q) {
            const int px = x0 - 1 + q;
            const int py = y0 - 1 + r;
            const bool inside = px >= 0 && py >= 0 && px < width && py < height;
            at[r][q] = inside ? (image_row + py) * cin4 * width + px : -1;
        }
    }
    float acc[4][4][4];  // [row][column][channel]
    [[unroll]] for (int o = 0; o < 4; ++o) {
        const float b = o < int(COUT) ? imageLoad(bias, o).x : 0.0;
        [[unroll]] for (int i = 0; i < 16; ++i) acc[i / 4][i % 4][o] = b;
    }
    for (int c = 0; c < cin4; ++c) {
        vec4 taps[5];
        [[unroll]] for (int k = 0; k < (9 + TAPS - 1) / TAPS; ++k) {
            const int tap = min(k * TAPS + lane / 4, 8);
            taps[k] = imageLoad(weight, (c * 9 + tap) * int(L) + lane % 4);
        }
        [[unroll]] for (int r = 0; r < 6; ++r) {
            vec4 d[6];
            [[unroll]] for (int q = 0; q < 6; ++q) {
                d[q] = mix(vec4(0.0), imageLoad(x, max(at[r][q], 0) + c * width), bvec4(at[r][q] >= 0));
            }
            [[unroll]] for (int ky = 0; ky < 3; ++ky) {
                const int row = r - ky;
                if (row < 0 || row > 3) continue;
                [[unroll]] for (int o = 0; o < int(COUT); ++o) {
                    [[unroll]] for (int kx = 0; kx < 3; ++kx) {
                        const int tap = ky * 3 + kx;
                        vec4 w;
                        [[unroll]] for (int j = 0; j < 4; ++j) {
                            w[j] = subgroupShuffle(taps[tap / TAPS][j], uint(tap % TAPS * 4 + o));
                        }
                        [[unroll]] for (int column = 0; column < 4; ++column) {
                            const vec4 v = d[column + kx];
                            acc[row][column][o] += (w.x * v.x + w.y * v.y) + (w.z * v.z + w.w * v.w);
                        }
                    }
                }
            }
        }
    }
    [[unroll]] for (int r = 0; r < 4; ++r) {
        [[unroll]] for (int q = 0; q < 4; ++q) {
            vec4 v = vec4(acc[r][q][0], acc[r][q][1], acc[r][q][2], acc[r][q][3]);
            v = mix(v * SLOPE, v, greaterThan(v, vec4(0.0)));
            if (gl_GlobalInvocationID.x < tile_count && x0 + q < width && y0 + r < height) {
                y[(image_row + y0 + r - int(window_row)) * width + x0 + q] = v;
            }
        }
    }
}
