#version 460
// Joins up to 256 bins into one; the last round gives exposure, 1 / depth and the number of repaired pixels in two parts.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"
#include "lib/transfer.glsl"

layout(constant_id = 0) const uint TRANSFER = TRANSFER_LOG1P;
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer bins;
layout(set = 0, binding = 1, std430) writeonly buffer Joined { vec4 joined[]; };

layout(push_constant) uniform Push {
    uint count;  // bins read
    uint last;   // 1: write (exposure, 1 / largest depth, repaired pixels mod 65536, over 65536)
};

void main() {
    const uint index = flat_index();
    if (index * 256 >= count) return;
    vec4 all = vec4(0.0);
    uint repairs = 0u;
    for (uint i = index * 256; i < min(count, index * 256 + 256); ++i) {
        const vec4 bin = imageLoad(bins, int(i));
        all.xy += bin.xy;
        all.z = max(all.z, bin.z);
        repairs += uint(bin.w);
    }
    if (last == 0u) {
        // Two rounds join 65,536 bins of 256 pixels: 2^24, the last whole number before f32 has gaps.
        joined[index] = vec4(all.xyz, repairs);
    } else {
        const float exposure = all.y > 0.0 ? transfer_key(TRANSFER) / exp2(all.x / all.y) : 1.0;
        joined[0] = vec4(exposure, all.z > 0.0 ? 1.0 / all.z : 1.0, repairs & 0xffffu, repairs >> 16u);
    }
}
