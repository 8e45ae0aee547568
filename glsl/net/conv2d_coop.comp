#version 460
// 3x3 convolution, stride 1, zero padding 1, bias and leaky ReLU (slope 1: linear), by cooperative matrices: operands in f16,
// sums in f32. Tensors are [n][h][c4][w] in f32 texels of 4 channels.
// An implicit matrix product: rows are M pixels side by side, columns are output channels, the inner dimension is input
// channels by taps. A workgroup of four subgroups stages a patch of 16 input channels in shared memory, and the nine taps
// read it in place, each from a shifted first pixel. A subgroup makes ROWS rows of M pixels by WIDE output channels.
#extension GL_EXT_control_flow_attributes : require
#extension GL_EXT_shader_explicit_arithmetic_types_float16 : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_cooperative_matrix : require
#extension GL_KHR_memory_scope_semantics : require
#extension GL_KHR_shader_subgroup_basic : require
#pragma use_vulkan_memory_model
#include "lib/half.glsl"

layout(constant_id = 0) const uint M = 16;
layout(constant_id = 1) const uint N = 16;
layout(constant_id = 2) const uint K = 16;
layout(constant_id = 3) const uint LOCAL = 128;    // four subgroups
layout(constant_id = 4) const uint WIDE = 32;      // output channels of a subgroup
layout(constant_id = 5) const uint ACROSS = 2;     // subgroups side by side along the output channels
layout(constant_id = 6) const float SLOPE = 1.0;
layout(local_size_x_id = 3) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer x;           // [n][h][cin4][w]
layout(set = 0, binding = 1, std430) readonly buffer Weight { uvec4 weight[]; };  // see pack_weights_coop
layout(set = 0, binding = 2, r32f) readonly uniform imageBuffer bias;           // [cout]
layout(set = 0, binding = 3, std430) writeonly buffer Y { vec4 y[]; };          // rows of [n][h][cout4][w], a window

layout(push_constant) uniform Push {
    uint height;
    uint width;
    uint cin4;
    uint cout4;
    uint blocks;           // of WIDE output channels
    uint tiles_y;          // of one image
    uint tile_row_begin;   // first of this dispatch, over all images
    uint window_row;       // first row of the output window, over all images
};

const uint CHUNK = 16;                      // input channels staged at a time
const uint ROWS = 4;
const uint TILE_ROWS = ROWS * 4 / ACROSS;
const uint PATCH_WIDTH = M + 2;
const uint PATCH_HEIGHT = TILE_ROWS + 2;
const uint PIXEL = 3;                       // 16 bytes each of a staged pixel: two hold the chunk, the third only skews
const uint PIECES = PATCH_WIDTH * PATCH_HEIGHT * 2;  // of 8 channels
const uint LOADS = (PIECES + LOCAL - 1) / LOCAL;
const uint STEPS = CHUNK / K;
const uint FRAGMENTS = WIDE / N;
const uint MATRIX = K * N / 8;              // 16 bytes each of one matrix of weights
const uint RESULT_PIXEL = N / 4 + 1;        // texels of a pixel of results; the last only skews
const uint RESULT = M * RESULT_PIXEL;
const int OUTSIDE = -1;

shared uvec4 patch_x[PATCH_WIDTH * PATCH_HEIGHT * PIXEL];
shared vec4 result[4 * RESULT];

int pixel_at[LOADS];      // first texel of the pixel of a piece that an invocation stages
vec4 fetched[LOADS * 2];  // on its way from memory while the matrices of the chunk before are multiplied

vec4 texel(int at, uint c4) {
    const bool inside = at != OUTSIDE && c4 < cin4;
    return mix(vec4(0.0), imageLoad(x, inside ? at + int(c4 * width) : 0), bvec4(inside));
}

// Pieces in the order in which they lie in memory: pixels of a row side by side, then the two parts of the chunk, then rows.
uint piece_of(uint i) { return i * LOCAL + gl_LocalInvocationIndex; }
uint piece_part(uint piece) { return piece / PATCH_WIDTH % 2; }
uvec2 piece_pixel(uint piece) { return uvec2(piece % PATCH_WIDTH, piece / (PATCH_WIDTH * 2)); }

void fetch(uint chunk) {
    [[unroll]] for (uint i = 0; i < LOADS; ++i) {
        const uint c4 = chunk * (CHUNK / 4) + piece_part(piece_of(i)) * 2;
        fetched[i * 2] = texel(pixel_at[i], c4);
        fetched[i * 2 + 1] = texel(pixel_at[i], c4 + 1);
    }
}

void stage() {
    [[unroll]] for (uint i = 0; i < LOADS; ++i) {
        const uint piece = piece_of(i);
        if (piece < PIECES) {
            const uvec2 pixel = piece_pixel(piece);
            patch_x[(pixel.y * PATCH_WIDTH + pixel.x) * PIXEL + piece_part(piece)] =
                to_halves(in_half_range(fetched[i * 2]), in_half_range(fetched[i * 2 + 1]));
        }
    }
}

void subgroup_fence() {
    controlBarrier(gl_ScopeSubgroup, gl_ScopeSubgroup, gl_StorageSemanticsShared, gl_SemanticsAcquireRelease);
}

void main() {
    const uint tile_row = tile_row_begin + gl_WorkGroupID.z;
    const int x0 = int(gl_WorkGroupID.y * M);
    const int y0 = int(tile_row % tiles_y * TILE_ROWS);
    const uint image_row = tile_row / tiles_y * height;
    const uint block = gl_WorkGroupID.x * ACROSS + gl_SubgroupID % ACROSS;
    const uint own_row = gl_SubgroupID / ACROSS * ROWS;

    [[unroll]] for (uint i = 0; i < LOADS; ++i) {
        const uvec2 pixel = piece_pixel(piece_of(i));
        const int px = x0 - 1 + int(pixel.x);
        const int py = y0 - 1 + int(pixel.y);
        const bool inside = px >= 0 && py >= 0 && px < int(width) && py < int(height);
        pixel_at[i] = inside ? int((image_row + uint(py)) * cin4 * width) + px : OUTSIDE;
    }
    coopmat<float, gl_ScopeSubgroup, M, N, gl_MatrixUseAccumulator> acc[ROWS][FRAGMENTS];
    [[unroll]] for (uint r = 0; r < ROWS; ++r) {
        [[unroll]] for (uint f = 0; f < FRAGMENTS; ++f) {
            acc[r][f] = coopmat<float, gl_ScopeSubgroup, M, N, gl_MatrixUseAccumulator>(0.0);
        }
    }

    const uint chunks = (cin4 + CHUNK / 4 - 1) / (CHUNK / 4);
    fetch(0);
    for (uint chunk = 0; chunk < chunks; ++chunk) {
        barrier();
        stage();
        barrier();
        if (chunk + 1 < chunks) fetch(chunk + 1);
        if (block < blocks) {
            const uint weight_at = (block * chunks + chunk) * 9 * STEPS * FRAGMENTS * MATRIX;
            for (uint kx = 0; kx < 3; ++kx) {
                [[unroll]] for (uint s = 0; s < STEPS; ++s) {
                    coopmat<float16_t, gl_ScopeSubgroup, M, K, gl_MatrixUseA> a[ROWS + 2];
                    [[unroll]] for (uint r = 0; r < ROWS + 2; ++r) {
                        const uint at = ((own_row + r) * PATCH_WIDTH + kx) * PIXEL + s * (K / 8);
                        coopMatLoad(a[r], patch_x, at, PIXEL, gl_CooperativeMatrixLayoutRowMajor);
                    }
                    [[unroll]] for (uint ky = 0; ky < 3; ++ky) {
                        [[unroll]] for (uint f = 0; f < FRAGMENTS; ++f) {
                            coopmat<float16_t, gl_ScopeSubgroup, K, N, gl_MatrixUseB> b;
                            const uint at = weight_at + (((ky * 3 + kx) * STEPS + s) * FRAGMENTS + f) * MATRIX;
                            coopMatLoad(b, weight, at, K / 8, gl_CooperativeMatrixLayoutColumnMajor);
                            [[unroll]] for (uint r = 0; r < ROWS; ++r) {
                                acc[r][f] = coopMatMulAdd(a[r + ky], b, acc[r][f]);
                            }
                        }
                    }
                }
            }
        }
    }

    // Through shared memory, so that an invocation has whole texels to store.
    const uint result_at = gl_SubgroupID * RESULT;
    [[unroll]] for (uint r = 0; r < ROWS; ++r) {
        const uint py = uint(y0) + own_row + r;
        [[unroll]] for (uint f = 0; f < FRAGMENTS; ++f) {
            subgroup_fence();
            coopMatStore(acc[r][f], result, result_at, RESULT_PIXEL, gl_CooperativeMatrixLayoutRowMajor);
            subgroup_fence();
            for (uint i = gl_SubgroupInvocationID; i < M * N / 4; i += LOCAL / 4) {
                const uint px = uint(x0) + i % M;
                const uint co4 = (block * WIDE + f * N) / 4 + i / M;
                if (px < width && py < height && co4 < cout4) {
                    vec4 v = result[result_at + i % M * RESULT_PIXEL + i / M];
                    [[unroll]] for (int j = 0; j < 4; ++j) v[j] += imageLoad(bias, int(co4 * 4) + j).x;
                    y[((image_row + py - window_row) * cout4 + co4) * width + px] = mix(v * SLOPE, v, greaterThan(v, vec4(0.0)));
                }
            }
        }
    }
}
