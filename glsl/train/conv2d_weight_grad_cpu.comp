#version 460
// Weight gradient of a 3x3 convolution, for CPU drivers: dw[co][ci][t] = sum over pixels of dy[co] * x[ci] at tap t.
// Lanes are output channels; a subgroup holds one or two blocks of them x 8 input channels x 9 taps and walks down strips of 12
// pixels. x comes 16 pixels a row across the lanes and is broadcast by constant shuffles, once for both blocks; dy comes
// transposed, 4 pixels a texel.
// Each split sums its own strips; the partial sums are added in a fixed order afterwards. All channels of a strip come one after
// another, so that its pixels are read from the cache.
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(constant_id = 0) const uint L = 8;     // subgroup size, 8 or 16
layout(constant_id = 1) const uint GROUP = 1; // blocks of L output channels that a subgroup makes, 1 or 2
const uint LOCAL = 64;
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer x;    // [n][h][cin4][w]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer dyt;  // [n][ceil(w/4)][h][cout] of 4 pixels
layout(set = 0, binding = 2, std430) writeonly buffer Partial { vec4 partial_sum[]; };  // [split][cout/L][cin4][9][L]

layout(push_constant) uniform Push {
    uint batch;
    uint height;
    uint width;
    uint cin4;
    uint cout;       // padded to 4
    uint co_blocks;  // a multiple of GROUP
    uint splits;
};

const int OUT = 12;
const int ROW = 16;
const int LOADS = ROW / int(L);

void main() {
    const uint lane = gl_LocalInvocationID.x % L;
    const uint index = gl_WorkGroupID.x * (LOCAL / L) + gl_LocalInvocationID.x / L;
    const uint pairs = (cin4 + 1) / 2;
    const uint co_groups = co_blocks / GROUP;
    const uint total = pairs * co_groups * splits;
    const uint clamped = min(index, total - 1);
    const uint c4 = clamped % pairs * 2;  // and the next, where there is one
    const uint split = clamped / (pairs * co_groups);
    const bool both = c4 + 1 < cin4;
    const uint co_block = clamped / pairs % co_groups * GROUP;
    const uint co = co_block * L + lane;
    const uint w4 = (width + 3) / 4;
    const uint strips_x = (width + OUT - 1) / OUT;
    const uint strips = strips_x * batch;

    float acc[2][2][36];  // [input texel][block][tap, channel]
    [[unroll]] for (int i = 0; i < 144; ++i) acc[i / 72][i / 36 % 2][i % 36] = 0.0;

    for (uint strip = split; strip < strips; strip += splits) {
        const uint n = strip / strips_x;
        const int x0 = int(strip % strips_x) * OUT;
        int base[LOADS];
        bool inside[LOADS];
        vec4 r[2][3][LOADS];
        const int next = both ? int(width) : 0;
        [[unroll]] for (int k = 0; k < LOADS; ++k) {
            const int px = x0 - 1 + k * int(L) + int(lane);
            inside[k] = px >= 0 && px < int(width);
            base[k] = inside[k] ? int((n * height * cin4 + c4) * width) + px : 0;
            [[unroll]] for (int c = 0; c < 2; ++c) {
                r[c][0][k] = vec4(0.0);
                r[c][1][k] = mix(vec4(0.0), imageLoad(x, base[k] + c * next), bvec4(inside[k]));
            }
        }
        int dy_at[2];
        [[unroll]] for (int b = 0; b < int(GROUP); ++b) {
            const uint channel = co + b * L;
            dy_at[b] = int((n * w4 + x0 / 4) * height * cout + (channel < cout ? channel : 0));
        }
        for (uint row = 0; row < height; ++row) {
            const bool below = row + 1 < height;
            [[unroll]] for (int k = 0; k < LOADS; ++k) {
                const bool ok = inside[k] && below;
                const int at = ok ? base[k] + int((row + 1) * width * cin4) : 0;
                [[unroll]] for (int c = 0; c < 2; ++c) r[c][2][k] = mix(vec4(0.0), imageLoad(x, at + c * next), bvec4(ok));
            }
            float d[2][OUT];
            [[unroll]] for (int b = 0; b < int(GROUP); ++b) {
                [[unroll]] for (int j = 0; j < OUT / 4; ++j) {
                    const bool ok = co + b * L < cout && uint(x0 / 4 + j) < w4;
                    const vec4 four = mix(vec4(0.0), imageLoad(dyt, ok ? dy_at[b] + j * int(height * cout) : 0), bvec4(ok));
                    [[unroll]] for (int p = 0; p < 4; ++p) d[b][j * 4 + p] = four[p];
                }
                dy_at[b] += int(cout);
            }
            // Three accumulators a block and three neighbouring pixels at a time: few enough to stay in registers.
            [[unroll]] for (int k = 0; k < 6; ++k) {
                const int c = k / 3;
                const int ky = k % 3;
                [[unroll]] for (int ci = 0; ci < 4; ++ci) {
                    [[unroll]] for (int p = 0; p < OUT; ++p) {
                        [[unroll]] for (int kx = 0; kx < 3; ++kx) {
                            const int q = p + kx;
                            const float v = subgroupShuffle(r[c][ky][q / int(L)][ci], uint(q % int(L)));
                            [[unroll]] for (int b = 0; b < int(GROUP); ++b) acc[c][b][(ky * 3 + kx) * 4 + ci] += d[b][p] * v;
                        }
                    }
                }
            }
            [[unroll]] for (int k = 0; k < LOADS; ++k) {
                [[unroll]] for (int c = 0; c < 2; ++c) {
                    r[c][0][k] = r[c][1][k];
                    r[c][1][k] = r[c][2][k];
                }
            }
        }
    }

    [[unroll]] for (int c = 0; c < 2; ++c) {
        if (index < total && (c == 0 || both)) {
            [[unroll]] for (int b = 0; b < int(GROUP); ++b) {
                const uint at = ((split * co_blocks + co_block + b) * cin4 + c4 + c) * 9 * L + lane;
                [[unroll]] for (int t = 0; t < 9; ++t) {
                    const int k = t * 4;
                    partial_sum[at + t * L] = vec4(acc[c][b][k], acc[c][b][k + 1], acc[c][b][k + 2], acc[c][b][k + 3]);
                }
            }
        }
    }
}
