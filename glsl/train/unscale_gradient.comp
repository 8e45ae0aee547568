#version 460
// Divides the gradients of all parameters by the loss scale, a power of two up to 2^126, and sets `skip` where one is not finite.
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_memory_scope_semantics : require
#pragma use_vulkan_memory_model
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, std430) readonly buffer LossScale { float loss_scale; uint good_steps; };
layout(set = 0, binding = 1, std430) buffer Gradient { vec4 gradient[]; };
layout(set = 0, binding = 2, std430) buffer Skip { uint skip[]; };

layout(push_constant) uniform Push { uint count; };

void main() {
    const uint index = flat_index();
    if (index >= count) return;
    const vec4 g = gradient[index];
    // The bits: isnan and isinf may be compiled away.
    const uvec4 exponent = floatBitsToUint(g) & 0x7f800000u;
    if (any(equal(exponent, uvec4(0x7f800000u)))) atomicOr(skip[0], 1, gl_ScopeQueueFamily, 0, 0);
    // The inverse of a power of two, exactly: a division may be a few bits off.
    gradient[index] = g * uintBitsToFloat(0x7f000000u - floatBitsToUint(loss_scale));
}
