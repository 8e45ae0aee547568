// Triangles: a tree of boxes over all meshes, and a watertight test.
// Included by lib/scene.glsl. Directions are unit vectors, coordinates are scene-relative (see src/render/mesh.rs).
#ifndef LIMPID_MESH_GLSL
#define LIMPID_MESH_GLSL

const bool TRIANGLES = MESH_COUNT > 0u;
// Materials of meshes stand after the primitives, with the same rows, then lights that no ray meets; a triangle's id counts on from there.
const uint MESH_FIRST = SPHERE_COUNT + RECT_COUNT;
const uint TRIANGLE_FIRST = MESH_FIRST + MESH_COUNT + DELTA_COUNT;
// After them: where the tables begin, then the boxes of the tree.
const int HEADER = CAMERA_ROWS + int(TRIANGLE_FIRST) * PRIMITIVE_ROWS;
const int HEADER_ROWS = 2;
const int TRIANGLE_ROWS = 4; // three vertices (w: least weight of each that a hit is left), normal and mesh
const int CORNER_ROWS = 4;   // three vertices' normals and u; their v

vec4 g_tables;      // first row of the triangles and of the corners, number of boxes, the octants' bits that choose their order
float g_short;      // how much short of a light a shadow ray ends
vec2 g_barycentric; // weights of the second and the third vertex at the last closest hit

void preload_tables() {
    g_tables = imageLoad(scene, HEADER);
    g_short = imageLoad(scene, HEADER + 1).x;
}

vec4 triangle_row(uint triangle, int k) { return imageLoad(scene, int(g_tables.x) + TRIANGLE_ROWS * int(triangle) + k); }
vec4 corner_row(uint triangle, int k) { return imageLoad(scene, int(g_tables.y) + CORNER_ROWS * int(triangle) + k); }

// A ray in the coordinates of the test (Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013).
struct Sheared {
    vec3 o;
    vec3 shear;   // x and y of the direction over z, and 1 / z, the axes turned so that z is the longest
    uint axis;    // which axis that is
    vec3 inverse; // of the direction, finite
};

// The axis `k` last, the others in their cyclic order.
vec3 turned(vec3 v, uint k) { return k == 0u ? v.yzx : k == 1u ? v.zxy : v; }

Sheared shear(vec3 o, vec3 d) {
    Sheared s;
    vec3 a = abs(d);
    s.o = o;
    s.axis = a.x > max(a.y, a.z) ? 0u : a.y > a.z ? 1u : 2u;
    vec3 t = turned(d, s.axis);
    s.shear = vec3(t.xy / t.z, 1.0 / t.z);
    // No infinity: 0 * inf is NaN, or whatever the compiler makes of it.
    s.inverse = 1.0 / mix(d, vec3(1e-18), lessThan(a, vec3(1e-18)));
    return s;
}

// Distance to a triangle, or -1. Neighbours see the same vertices and edges to the last bit (`precise`): no ray slips between.
float hit_triangle(Sheared s, vec3 v0, vec3 v1, vec3 v2, out vec2 weights) {
    precise vec3 a = turned(v0 - s.o, s.axis);
    precise vec3 b = turned(v1 - s.o, s.axis);
    precise vec3 c = turned(v2 - s.o, s.axis);
    precise vec2 p = a.xy - s.shear.xy * a.z;
    precise vec2 q = b.xy - s.shear.xy * b.z;
    precise vec2 r = c.xy - s.shear.xy * c.z;
    precise float u = r.x * q.y - r.y * q.x;
    precise float v = p.x * r.y - p.y * r.x;
    precise float w = q.x * p.y - q.y * p.x;
    float det = u + v + w;
    weights = vec2(v, w) / det;
    bool outside = min(u, min(v, w)) < 0.0 && max(u, max(v, w)) > 0.0;
    float t = s.shear.z * (u * a.z + v * b.z + w * c.z) / det;
    return outside || det == 0.0 ? -1.0 : t;
}

// Does the ray enter a box before `best`?
bool enters_box(Sheared s, vec3 low, vec3 high, float best) {
    vec3 a = (low - s.o) * s.inverse;
    vec3 b = (high - s.o) * s.inverse;
    vec3 near = min(a, b), far = max(a, b);
    return max(max(near.x, near.y), max(near.z, 0.0)) <= min(min(far.x, far.y), min(far.z, best));
}

// The closest triangle hit before `best`, which is set to its distance; with `any` the first that is found. `skip` and `skip_too`
// are left out: triangles are flat. Two loops within one: all lanes look for a leaf, then all test theirs, so that neither waits
// for the other at every step.
uint trace_triangles(vec3 o, vec3 d, uint skip, uint skip_too, bool any, inout float best) {
    Sheared s = shear(o, d);
    uvec3 falls = floatBitsToUint(d) >> 31u;
    int count = int(g_tables.z);
    int first = HEADER + HEADER_ROWS + 2 * count * (int(falls.x | falls.y << 1u | falls.z << 2u) & int(g_tables.w));
    int at = 0;
    uint found = NONE;
    while (at < count) {
        int leaf = -1; // 8 * the next triangle + those that come after it
        while (at < count && leaf < 0) {
            vec4 low = imageLoad(scene, first + 2 * at), high = imageLoad(scene, first + 2 * at + 1);
            bool enters = enters_box(s, low.xyz, high.xyz, best);
            int link = int(low.w); // where to go past the box, or a leaf
            leaf = enters ? -1 - link : -1;
            at = enters || link < 0 ? at + 1 : link;
        }
        bool more = leaf >= 0;
        while (more) {
            uint triangle = uint(leaf >> 3);
            vec2 weights;
            float t = hit_triangle(
                s, triangle_row(triangle, 0).xyz, triangle_row(triangle, 1).xyz, triangle_row(triangle, 2).xyz, weights);
            uint id = TRIANGLE_FIRST + triangle;
            if (t > 0.0 && t < best && id != skip && id != skip_too) {
                best = t;
                found = id;
                if (!any) g_barycentric = weights;
            }
            more = (leaf & 7) != 0;
            leaf += 7; // one more first, one less after it
        }
        if (any && found != NONE) at = count;
    }
    return found;
}

#endif
