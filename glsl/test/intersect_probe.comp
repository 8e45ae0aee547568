// For tests: rays against primitives as the path tracer intersects them.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/intersect.glsl"

layout(local_size_x = 64) in;

// A ray, its length for shadow tests, and a primitive: a sphere, a rectangle across an axis (centre, axis | extent), or any
// rectangle (centre | normal | dual u | dual v).
struct Query {
    vec4 origin;
    vec4 direction; // w: length
    vec4 primitive[4];
};

layout(set = 0, binding = 0, std430) readonly buffer Queries { Query queries[]; };
layout(set = 0, binding = 1, std430) writeonly buffer Hits { vec4 hits[]; };

layout(push_constant) uniform Push {
    uint count;
    uint kind; // 0 sphere, 1 rectangle across an axis, 2 any rectangle
};

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= count) return;
    vec3 o = queries[i].origin.xyz;
    vec4 d = queries[i].direction;
    vec4 a = queries[i].primitive[0];
    vec4 b = queries[i].primitive[1];
    switch (kind) {
    case 0u: // the near side, either side, and whether they block
        hits[i] = vec4(hit_sphere(o, d.xyz, a, false), hit_sphere(o, d.xyz, a, true),
                       float(blocks_sphere(o, d.xyz, d.w, a, false)), float(blocks_sphere(o, d.xyz, d.w, a, true)));
        break;
    case 1u: hits[i] = vec4(hit_aligned(o, d.xyz, 1.0 / d.xyz, uint(a.w), a.xyz, b.xyz)); break;
    case 2u:
        hits[i] = vec4(hit_rectangle(o, d.xyz, a.xyz, b.xyz, queries[i].primitive[2], queries[i].primitive[3]));
        break;
    default: hits[i] = vec4(0.0 / 0.0);
    }
}
