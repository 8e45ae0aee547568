// How many iterations may one shader run? Some drivers leave a loop silently after a fixed number.
#version 460
layout(local_size_x = 8) in;

layout(set = 0, binding = 0, std430) writeonly buffer Trips { uvec2 trips[]; };

layout(push_constant) uniform Push {
    uint wanted;
    uint random_seed;
};

void main() {
    uint done = 0u;
    uint x = random_seed + gl_GlobalInvocationID.x;
    while (done < wanted) {
        x = x * 1664525u + 1013904223u;
        done += 1u + (x == 0xffffffffu && x < done ? 1u : 0u); // the count depends on data: no closed form
    }
    trips[gl_GlobalInvocationID.x] = uvec2(done, x);
}
