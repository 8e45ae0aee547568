#version 460
// Multiplies the gradient of the loss by the loss scale, so that gradients in f16 do not vanish.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, std430) readonly buffer LossScale { float loss_scale; uint good_steps; };
layout(set = 0, binding = 1, std430) buffer Gradient { vec4 gradient[]; };

layout(push_constant) uniform Push { uint count; };

void main() {
    const uint index = flat_index();
    if (index < count) gradient[index] *= loss_scale;
}
