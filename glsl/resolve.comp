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
// rgb, 1 where the pixel is exact
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
};

void main() {
    uint i = pixel_begin + gl_GlobalInvocationID.x;
    if (i >= pixel_end) return;
    vec4 sum = total[i];
    float n = float(max(sample_count, 1u));
    bool exact = ANTIALIAS ? counts[i].w == 0u && sample_count > 0u : sum.w != 0.0;
    // A pixel-centre exact pixel holds its radiance itself.
    vec3 mean = exact && !ANTIALIAS ? sum.rgb : (sum.rgb + block[i].rgb) / n;
    radiance[i] = vec4(mean, exact ? 1.0 : 0.0);
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
