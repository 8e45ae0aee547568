#version 460
// Winograd F(4x4, 3x3): V = B^T d B of the 6x6 patches under tiles of 4x4 results. An invocation: one tile, 4 channels.
// UPSAMPLED: the operand is the nearest 2x upsampling of x. Rows 1, 2 and 3, 4 of a patch are then equal in pairs, as are
// its columns, and V vanishes in row 2 and column 2 (interpolation point -1): these are not stored, nor read later.
#extension GL_EXT_control_flow_attributes : require

layout(constant_id = 0) const bool UPSAMPLED = false;
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer x;   // [n][h][w][cin4]; UPSAMPLED: of half the size
layout(set = 0, binding = 1, std430) writeonly buffer V { vec4 v[]; };  // [36][tile_stride][total4]

layout(push_constant) uniform Push {
    uint height;  // of the result
    uint width;
    uint cin4;    // of this operand
    uint c_begin; // its first texel among all operands'
    uint total4;  // of all operands
    uint tiles_x;
    uint tiles_y;         // of one image
    uint tile_row_begin;  // first of this stripe, over all images
    uint tile_count;      // of this stripe
    uint tile_stride;
};

vec4 transformed(int i, vec4 d[6]) {
    if (i == 0) return 4.0 * d[0] - 5.0 * d[2] + d[4];
    if (i == 1) return (d[4] - 4.0 * d[2]) + (d[3] - 4.0 * d[1]);
    if (i == 2) return (d[4] - 4.0 * d[2]) - (d[3] - 4.0 * d[1]);
    if (i == 3) return (d[4] - d[2]) + 2.0 * (d[3] - d[1]);
    if (i == 4) return (d[4] - d[2]) - 2.0 * (d[3] - d[1]);
    return 4.0 * d[1] - 5.0 * d[3] + d[5];
}

// No branch around a load: llvmpipe compiles texel loads outside control flow to plain vector code.
vec4 pixel(int py, int px, uint image_row, uint c) {
    const bool inside = px >= 0 && py >= 0 && px < int(width) && py < int(height);
    const uint row = UPSAMPLED ? image_row / 2 + uint(py) / 2 : image_row + uint(py);
    const uint at = UPSAMPLED ? row * (width / 2) + uint(px) / 2 : row * width + uint(px);
    return mix(vec4(0.0), imageLoad(x, inside ? int(at * cin4 + c) : 0), bvec4(inside));
}

void main() {
    const uint index = gl_GlobalInvocationID.x;
    const uint clamped = min(index, tile_count * cin4 - 1);
    const uint tile = clamped / cin4;
    const uint c = clamped % cin4;
    const uint tile_row = tile_row_begin + tile / tiles_x;
    const int x0 = int(tile % tiles_x) * 4 - 1;
    const int y0 = int(tile_row % tiles_y) * 4 - 1;
    const uint image_row = (tile_row / tiles_y) * height;

    vec4 t[6][6];  // [row of B^T d][column]
    [[unroll]] for (int i = 0; i < 6; ++i) {
        const bool same_column = UPSAMPLED && (i == 2 || i == 4);
        vec4 d[6];
        if (!same_column) {
            [[unroll]] for (int j = 0; j < 6; ++j) {
                const bool same_row = UPSAMPLED && (j == 2 || j == 4);
                if (same_row) d[j] = d[j - 1];
                else d[j] = pixel(y0 + j, x0 + i, image_row, c);
            }
        }
        [[unroll]] for (int k = 0; k < 6; ++k) {
            if (same_column) t[k][i] = t[k][i - 1];
            else t[k][i] = transformed(k, d);
        }
    }
    if (index < tile_count * cin4) {
        [[unroll]] for (int k = 0; k < 6; ++k) {
            [[unroll]] for (int i = 0; i < 6; ++i) {
                if (!(UPSAMPLED && (k == 2 || i == 2))) {
                    v[(uint(k * 6 + i) * tile_stride + tile) * total4 + c_begin + c] = transformed(i, t[k]);
                }
            }
        }
    }
}
