// For tests: the transfer of radiance to the network's space and back.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/transfer.glsl"

layout(constant_id = 0) const uint TRANSFER = TRANSFER_LOG1P;
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, std430) readonly buffer Radiance { float radiance[]; };
layout(set = 0, binding = 1, std430) writeonly buffer There { float there[]; };
layout(set = 0, binding = 2, std430) writeonly buffer Back { float back[]; };

layout(push_constant) uniform Push {
    uint count;
    float exposure;
};

void main() {
    const uint i = gl_GlobalInvocationID.x;
    if (i >= count) return;
    const vec3 t = to_network(TRANSFER, vec3(radiance[i]), exposure);
    there[i] = t.y;
    back[i] = from_network(TRANSFER, t, exposure).y;
}
