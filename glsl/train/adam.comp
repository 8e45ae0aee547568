#version 460
// Adam (Kingma and Ba 2015) with bias correction, in PyTorch's form: epsilon is added to the corrected root.
#extension GL_GOOGLE_include_directive : require
#include "lib/index.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer gradient;
layout(set = 0, binding = 1, std430) readonly buffer StepFactors { float step_factors[]; };  // lr / (1 - b1^t), 1 / sqrt(1 - b2^t)
layout(set = 0, binding = 2, std430) buffer Parameter { vec4 parameter[]; };
layout(set = 0, binding = 3, std430) buffer FirstMoment { vec4 first_moment[]; };
layout(set = 0, binding = 4, std430) buffer SecondMoment { vec4 second_moment[]; };
layout(set = 0, binding = 5, std430) readonly buffer Skip { uint skip[]; };  // not 0: everything stays as it is

layout(set = 0, binding = 6, rgba32f) readonly uniform imageBuffer scale;  // factor of the learning rate

layout(push_constant) uniform Push {
    uint count;
    float beta1;
    float beta2;
    float epsilon;
};

void main() {
    const uint index = flat_index();
    if (index >= count || skip[0] != 0) return;
    const vec4 g = imageLoad(gradient, int(index));
    const vec4 m = beta1 * first_moment[index] + (1.0 - beta1) * g;
    const vec4 v = beta2 * second_moment[index] + (1.0 - beta2) * g * g;
    first_moment[index] = m;
    second_moment[index] = v;
    parameter[index] -= imageLoad(scale, int(index)) * step_factors[0] * m / (sqrt(v) * step_factors[1] + epsilon);
}
