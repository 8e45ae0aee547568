#version 460
// Joins up to 256 bins into one; the last round gives exposure and 1 / depth.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"
#include "lib/transfer.glsl"

layout(constant_id = 0) const uint TRANSFER = TRANSFER_LOG1P;
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer bins;
layout(set = 0, binding = 1, std430) writeonly buffer Joined { vec4 joined[]; };

layout(push_constant) uniform Push {
    uint count;  // bins read
    uint last;   // 1: write (exposure, 1 / largest depth, 0, 0)
};

void main() {
    const uint index = flat_index();
    if (index * 256 >= count) return;
    vec4 all = vec4(0.0);
    for (uint i = index * 256; i < min(count, index * 256 + 256); ++i) {
        const vec4 bin = imageLoad(bins, int(i));
        all.xy += bin.xy;
        all.z = max(all.z, bin.z);
    }
    if (last == 0u) {
        joined[index] = all;
    } else {
        const float exposure = all.y > 0.0 ? transfer_key(TRANSFER) / exp2(all.x / all.y) : 1.0;
        joined[0] = vec4(exposure, all.z > 0.0 ? 1.0 / all.z : 1.0, 0.0, 0.0);
    }
}
