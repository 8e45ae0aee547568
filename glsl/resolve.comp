// From sums to means: radiance, first-hit values averaged over the samples, variance of the mean.
#version 460
layout(local_size_x = 256) in;

layout(constant_id = 0) const bool ANTIALIAS = false;
layout(constant_id = 1) const bool VARIANCE = false;
layout(constant_id = 2) const bool AOVS = true;

layout(set = 0, binding = 0, std430) readonly buffer Total { vec4 total[]; };
layout(set = 0, binding = 1, std430) readonly buffer Block { vec4 block[]; };
layout(set = 0, binding = 2, std430) readonly buffer Counts { uvec4 counts[]; };
layout(set = 0, binding = 3, std430) readonly buffer AlbedoSum { vec4 albedo_sum[]; };
layout(set = 0, binding = 4, std430) readonly buffer NormalSum { vec4 normal_sum[]; };
layout(set = 0, binding = 5, std430) readonly buffer ScreenSum { vec4 screen_sum[]; };
layout(set = 0, binding = 6, std430) readonly buffer Batch { vec4 batch[]; };
// rgb; 1 where the pixel is exact, 1/2 where it is black and a neighbour is not exact
layout(set = 0, binding = 7, std430) writeonly buffer Radiance { vec4 radiance[]; };
layout(set = 0, binding = 8, std430) writeonly buffer Albedo { vec4 albedo[]; };
layout(set = 0, binding = 9, std430) writeonly buffer NormalWorld { vec4 normal_world[]; };
layout(set = 0, binding = 10, std430) writeonly buffer Screen { vec4 screen[]; };
layout(set = 0, binding = 11, std430) writeonly buffer Variance { vec4 variance[]; };

layout(push_constant) uniform Push {
    uint pixel_begin;
    uint pixel_end;
    uint sample_count;
    uint batch_count;
    uint width;
    uint halo;        // pixels of `counts` before those of the other buffers
    uint counts_rows; // of `counts`
};

// Whether one of 3x3 pixels is not exact. Where every sample has a camera ray of its own, those of a black pixel may all miss a
// surface that covers a little of it; its neighbours see that.
bool inexact_around(uint i) {
    uint x = (halo + i) % width, y = (halo + i) / width;
    for (uint v = max(y, 1u) - 1u; v <= min(y + 1u, counts_rows - 1u); ++v) {
        for (uint u = max(x, 1u) - 1u; u <= min(x + 1u, width - 1u); ++u) {
            if (counts[v * width + u].w != 0u) return true;
        }
    }
    return false;
}

void main() {
    uint i = pixel_begin + gl_GlobalInvocationID.x;
    if (i >= pixel_end) return;
    vec4 sum = total[i];
    float n = float(max(sample_count, 1u));
    bool exact = ANTIALIAS ? counts[halo + i].w == 0u && sample_count > 0u : sum.w != 0.0;
    // A pixel-centre exact pixel holds its radiance itself.
    vec3 mean = exact && !ANTIALIAS ? sum.rgb : (sum.rgb + block[i].rgb) / n;
    float certain = ANTIALIAS && mean == vec3(0.0) && inexact_around(i) ? 0.5 : 1.0;
    radiance[i] = vec4(mean, exact ? certain : 0.0);
    if (ANTIALIAS && AOVS) {
        vec4 s = screen_sum[i];
        albedo[i] = vec4(albedo_sum[i].rgb / n, 0.0);
        normal_world[i] = vec4(normal_sum[i].xyz / n, 0.0);
        screen[i] = vec4(s.xy / n, s.w > 0.0 ? s.z / s.w : 0.0, s.w / n);
    }
    if (VARIANCE) {
        float batches = float(batch_count);
        variance[i] = batch_count > 1u ? vec4(batch[3u * i + 2u].rgb / (batches * (batches - 1.0)), 0.0) : vec4(0.0);
    }
}
