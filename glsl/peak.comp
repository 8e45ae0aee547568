#version 460
// How many multiplications and additions the device can do, on registers, hardly one waiting for another: 384 a pass of the
// loop, unrolled since CPU drivers spend as much again on every pass.
#extension GL_EXT_control_flow_attributes : require

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, std430) writeonly buffer Sum { vec4 sum[]; };

layout(push_constant) uniform Push {
    uint passes;  // below 65,535: llvmpipe silently ends loops there
    float factor;
    float addend;
};

const int CHAINS = 3;
const int REPEATS = 16;

void main() {
    vec4 a[CHAINS];
    [[unroll]] for (int i = 0; i < CHAINS; ++i) a[i] = vec4(i) + float(gl_LocalInvocationID.x);
    for (uint pass = 0; pass < passes; ++pass) {
        [[unroll]] for (int r = 0; r < REPEATS; ++r) {
            [[unroll]] for (int i = 0; i < CHAINS; ++i) a[i] = a[i] * factor + addend;
        }
    }
    vec4 total = vec4(0.0);
    [[unroll]] for (int i = 0; i < CHAINS; ++i) total += a[i];
    sum[gl_GlobalInvocationID.x] = total;
}
