// Test only: rays against the triangles of a packed scene that has nothing else.
#version 460
#extension GL_GOOGLE_include_directive : require

layout(local_size_x = 64) in;
layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer scene;
layout(set = 0, binding = 1, std430) readonly buffer Rays { vec4 rays[]; }; // origin and direction, w unused
layout(set = 0, binding = 2, std430) writeonly buffer Hits { vec4 hits[]; }; // distance (-1: none), triangle, weights of its 2nd and 3rd vertex
layout(push_constant) uniform Push { uint count; };

const uint NONE = 0xffffffffu;
const uint SPHERE_COUNT = 0u, RECT_COUNT = 0u, MESH_COUNT = 1u, DELTA_COUNT = 0u;
const int CAMERA_ROWS = 8, PRIMITIVE_ROWS = 16;

#include "lib/mesh.glsl"

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= count) return;
    preload_tables();
    float best = 1e30;
    uint id = trace_triangles(rays[2u * i].xyz, rays[2u * i + 1u].xyz, NONE, NONE, false, best);
    hits[i] = id == NONE ? vec4(-1.0) : vec4(best, float(id - TRIANGLE_FIRST), g_barycentric);
}
