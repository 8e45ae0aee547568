#version 460
// Weight gradient of a 3x3 convolution by cooperative matrices: dw[co][ci][t] = sum over pixels of dy[co] * x[ci] at tap t,
// operands in f16, sums in f32. A matrix product for each tap: rows are output channels, columns input channels, the inner
// dimension is pixels side by side. A workgroup of four subgroups makes 2M x 2N channels, a subgroup M x N of them for all
// taps. Tiles of pixels of both operands are staged in shared memory; a staged row of x serves three taps in each of three
// rows of dy. Each split sums its own tiles; the partial sums are added in a fixed order afterwards.
// A gradient above the range of f16 becomes infinite, so that it is noticed; activations are clamped, as in conv2d_coop.
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
layout(constant_id = 3) const uint LOCAL = 128;  // four subgroups
layout(local_size_x_id = 3) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer x;   // [n][h][cin4][w]
layout(set = 0, binding = 1, rgba32f) readonly uniform imageBuffer dy;  // [n][h][cout4][w]
layout(set = 0, binding = 2, std430) writeonly buffer Partial { vec4 partial_sum[]; };  // [split][cout4][cin4][9][4]

layout(push_constant) uniform Push {
    uint height;
    uint width;
    uint cin4;
    uint cout4;
    uint tiles_x;
    uint tiles_y;  // of one image
    uint tiles;    // of all images
    uint splits;
};

const uint TILE_WIDTH = 16;
const uint TILE_HEIGHT = 8;
const uint PATCH_WIDTH = TILE_WIDTH + 2;
const uint PATCH_HEIGHT = TILE_HEIGHT + 2;
// 16 bytes each of a staged pixel; the last only skews.
const uint X_PARTS = 2 * N / 8;
const uint DY_PARTS = 2 * M / 8;
const uint X_PIXEL = X_PARTS + 1;
const uint DY_PIXEL = DY_PARTS + 1;
const uint RESULT = M * N / 4;  // texels of one matrix of results

shared uvec4 staged_x[PATCH_WIDTH * PATCH_HEIGHT * X_PIXEL];
shared uvec4 staged_dy[TILE_WIDTH * TILE_HEIGHT * DY_PIXEL];
shared vec4 result[4 * RESULT];

// First texel of a pixel, -1 outside of the image.
int pixel_at(int px, int py, uint image_row, uint texels) {
    const bool inside = px >= 0 && py >= 0 && px < int(width) && py < int(height);
    return inside ? int((image_row + uint(py)) * texels * width) + px : -1;
}

void stage_x(int x0, int y0, uint image_row, uint c4_begin) {
    for (uint i = gl_LocalInvocationIndex; i < PATCH_WIDTH * PATCH_HEIGHT * X_PARTS; i += LOCAL) {
        const uvec2 pixel = uvec2(i % PATCH_WIDTH, i / (PATCH_WIDTH * X_PARTS));
        const uint part = i / PATCH_WIDTH % X_PARTS;
        const uint c4 = c4_begin + part * 2;
        const int at = pixel_at(x0 - 1 + int(pixel.x), y0 - 1 + int(pixel.y), image_row, cin4);
        vec4 v[2];
        [[unroll]] for (uint j = 0; j < 2; ++j) {
            const bool inside = at >= 0 && c4 + j < cin4;
            v[j] = mix(vec4(0.0), in_half_range(imageLoad(x, inside ? at + int((c4 + j) * width) : 0)), bvec4(inside));
        }
        staged_x[(pixel.y * PATCH_WIDTH + pixel.x) * X_PIXEL + part] = to_halves(v[0], v[1]);
    }
}

void stage_dy(int x0, int y0, uint image_row, uint c4_begin) {
    for (uint i = gl_LocalInvocationIndex; i < TILE_WIDTH * TILE_HEIGHT * DY_PARTS; i += LOCAL) {
        const uvec2 pixel = uvec2(i % TILE_WIDTH, i / (TILE_WIDTH * DY_PARTS));
        const uint part = i / TILE_WIDTH % DY_PARTS;
        const uint c4 = c4_begin + part * 2;
        const int at = pixel_at(x0 + int(pixel.x), y0 + int(pixel.y), image_row, cout4);
        vec4 v[2];
        [[unroll]] for (uint j = 0; j < 2; ++j) {
            const bool inside = at >= 0 && c4 + j < cout4;
            v[j] = mix(vec4(0.0), imageLoad(dy, inside ? at + int((c4 + j) * width) : 0), bvec4(inside));
        }
        staged_dy[(pixel.y * TILE_WIDTH + pixel.x) * DY_PIXEL + part] = to_halves(v[0], v[1]);
    }
}

void subgroup_fence() {
    controlBarrier(gl_ScopeSubgroup, gl_ScopeSubgroup, gl_StorageSemanticsShared, gl_SemanticsAcquireRelease);
}

void main() {
    const uint split = gl_WorkGroupID.z;
    const uint co4_begin = gl_WorkGroupID.x * (2 * M / 4);
    const uint ci4_begin = gl_WorkGroupID.y * (2 * N / 4);
    const uint own_co = gl_SubgroupID % 2;
    const uint own_ci = gl_SubgroupID / 2;

    coopmat<float, gl_ScopeSubgroup, M, N, gl_MatrixUseAccumulator> acc[9];
    [[unroll]] for (uint t = 0; t < 9; ++t) {
        acc[t] = coopmat<float, gl_ScopeSubgroup, M, N, gl_MatrixUseAccumulator>(0.0);
    }
    for (uint tile = split; tile < tiles; tile += splits) {
        const int x0 = int(tile % tiles_x * TILE_WIDTH);
        const int y0 = int(tile / tiles_x % tiles_y * TILE_HEIGHT);
        const uint image_row = tile / (tiles_x * tiles_y) * height;
        barrier();
        stage_x(x0, y0, image_row, ci4_begin);
        stage_dy(x0, y0, image_row, co4_begin);
        barrier();
        for (uint column = 0; column < TILE_WIDTH; column += K) {
            coopmat<float16_t, gl_ScopeSubgroup, M, K, gl_MatrixUseA> a[3];  // the last three rows of dy, row r in r % 3
            [[unroll]] for (uint r = 0; r < PATCH_HEIGHT; ++r) {
                if (r < TILE_HEIGHT) {
                    const uint at = (r * TILE_WIDTH + column) * DY_PIXEL + own_co * (M / 8);
                    coopMatLoad(a[r % 3], staged_dy, at, DY_PIXEL, gl_CooperativeMatrixLayoutColumnMajor);
                }
                [[unroll]] for (uint kx = 0; kx < 3; ++kx) {
                    coopmat<float16_t, gl_ScopeSubgroup, K, N, gl_MatrixUseB> b;
                    const uint at = (r * PATCH_WIDTH + column + kx) * X_PIXEL + own_ci * (N / 8);
                    coopMatLoad(b, staged_x, at, X_PIXEL, gl_CooperativeMatrixLayoutRowMajor);
                    [[unroll]] for (uint ky = 0; ky < 3; ++ky) {
                        if (r >= ky && r - ky < TILE_HEIGHT) {
                            acc[ky * 3 + kx] = coopMatMulAdd(a[(r - ky) % 3], b, acc[ky * 3 + kx]);
                        }
                    }
                }
            }
        }
    }

    const uint result_at = gl_SubgroupID * RESULT;
    [[unroll]] for (uint t = 0; t < 9; ++t) {
        subgroup_fence();
        coopMatStore(acc[t], result, result_at, N / 4, gl_CooperativeMatrixLayoutRowMajor);
        subgroup_fence();
        for (uint i = gl_SubgroupInvocationID; i < RESULT; i += LOCAL / 4) {
            const uint co = co4_begin * 4 + own_co * M + i / (N / 4);
            const uint c4 = ci4_begin + own_ci * (N / 4) + i % (N / 4);
            if (co < cout4 * 4 && c4 < cin4) {
                partial_sum[(((split * cout4 + co / 4) * cin4 + c4) * 9 + t) * 4 + co % 4] = result[result_at + i];
            }
        }
    }
}
