// The scene in registers, closest hits and shadow tests.
// Included by a shader that declares `scene` (rows of four floats, src/render/pack.rs) and the scene's specialization constants.
#ifndef LIMPID_SCENE_GLSL
#define LIMPID_SCENE_GLSL

#include "lib/bsdf.glsl"
#include "lib/environment.glsl"
#include "lib/intersect.glsl"
#include "lib/sampling.glsl"

const uint NONE = 0xffffffffu;
const int CAMERA_ROWS = 8; // four of the camera, four of the environment
const int PRIMITIVE_ROWS = 16;

vec4 row(uint id, int k) { return imageLoad(scene, CAMERA_ROWS + int(id) * PRIMITIVE_ROWS + k); }

// Rows of a primitive.
const int GEOMETRY = 0; // centre, radius (rectangle: area)
const int ALBEDO = 1;   // w: 1 for an inward sphere
const int RADIANCE = 2; // w: upper end of the light's share in the choice of lights
const int NORMAL = 3;   // rectangles only from here; w: 0 any orientation, 1, 2, 3 across x, y, z
const int DUAL_U = 4;
const int DUAL_V = 5;
const int HALF_U = 6;   // w: limit to which a hit is pulled inside
const int HALF_V = 7;
const int EXTENT = 8;   // across an axis: half extents, enlarged
const int INNER = 9;    // across an axis: half extents to which a hit is pulled inside
const int TEXTURE = 10; // w: 0 none, 1 checkerboard with this second reflectance, 2 bitmap with this row of its matrix
const int TEXTURE_UV = 11; // checkerboard: repeats and offset; bitmap: the other row
const int MATERIAL = 12;   // kind, roughness, index of refraction, 1 where both sides reflect
const int MATERIAL_A = 13; // conductor: eta; dielectric: reflectance; plastic: coating's reflectance, internal reflection
const int MATERIAL_B = 14; // conductor: k; dielectric: transmittance; plastic: share of the coating in the choice, 1 if nonlinear
const int BITMAP = 15;     // first texel, width, height, wrap + 4 * nearest

#include "lib/mesh.glsl"

const uint SPHERES = SPHERE_COUNT > 0u ? SPHERE_COUNT : 1u;
const uint RECTS = RECT_COUNT > 0u ? RECT_COUNT : 1u;
vec4 g_sphere[SPHERES];
vec3 g_sphere_albedo[SPHERES];
vec3 g_center[RECTS];
vec3 g_extent[RECTS];
vec3 g_inner[RECTS];
vec3 g_normal[RECTS];
vec3 g_rect_albedo[RECTS];
vec4 g_light;
vec3 g_light_radiance;
vec3 g_right;
vec3 g_up;
vec3 g_forward;
vec3 g_right_unit;
vec3 g_up_unit;
float g_offset; // how far a ray starts off its surface
vec2 g_lens; // radius of the aperture, depth of what is in focus
float g_depth_scale; // from the scene's units here to those of the world

uint rect_axis(uint i) { return PRELOAD ? (RECT_AXES >> (2u * i)) & 3u : uint(row(SPHERE_COUNT + i, NORMAL).w); }
bool is_disk(uint i) { return i >= DISK_FIRST && i < DISK_FIRST + DISK_COUNT; }
bool rect_blocks(uint i) { return !PRELOAD || ((RECT_BLOCKERS >> i) & 1u) != 0u; }

// Loads of the same address by all invocations are cheap here, before the loop, and dear inside.
void preload() {
    if (ONE_LIGHT) {
        g_light = row(ONE_LIGHT_ID, GEOMETRY);
        g_light_radiance = row(ONE_LIGHT_ID, RADIANCE).rgb;
    }
    g_right = imageLoad(scene, 1).xyz;
    g_up = imageLoad(scene, 2).xyz;
    g_forward = imageLoad(scene, 3).xyz;
    g_right_unit = normalize(g_right);
    g_up_unit = normalize(g_up);
    g_depth_scale = imageLoad(scene, 1).w;
    g_lens = vec2(imageLoad(scene, 2).w, imageLoad(scene, 3).w);
    if (TRIANGLES) preload_tables();
    if (!PRELOAD) return;
    [[unroll]] for (uint i = 0u; i < SPHERE_COUNT; ++i) {
        g_sphere[i] = row(i, GEOMETRY);
        g_sphere_albedo[i] = row(i, ALBEDO).rgb;
    }
    [[unroll]] for (uint i = 0u; i < RECT_COUNT; ++i) {
        g_center[i] = row(SPHERE_COUNT + i, GEOMETRY).xyz;
        g_extent[i] = row(SPHERE_COUNT + i, EXTENT).xyz;
        g_inner[i] = row(SPHERE_COUNT + i, INNER).xyz;
        g_normal[i] = row(SPHERE_COUNT + i, NORMAL).xyz;
        g_rect_albedo[i] = row(SPHERE_COUNT + i, ALBEDO).rgb;
    }
}

vec4 sphere_at(uint i) { return PRELOAD ? g_sphere[i] : row(i, GEOMETRY); }

float hit_rect_at(uint i, vec3 o, vec3 d, vec3 reciprocal) {
    uint id = SPHERE_COUNT + i;
    uint axis = rect_axis(i);
    vec3 center = PRELOAD ? g_center[i] : row(id, GEOMETRY).xyz;
    if (axis != 0u) return hit_aligned(o, d, reciprocal, axis - 1u, center, PRELOAD ? g_extent[i] : row(id, EXTENT).xyz);
    vec3 normal = row(id, NORMAL).xyz;
    if (is_disk(i)) return hit_disk(o, d, center, normal, row(id, DUAL_U).xyz, row(id, DUAL_V).xyz);
    return hit_rectangle(o, d, center, normal, row(id, DUAL_U), row(id, DUAL_V));
}

// A point on a surface, moved off it along the normal, and what the path needs there.
struct Vertex {
    vec3 p;
    vec3 n;
    vec3 albedo;
    uint id;
    bool front;   // seen from a side that scatters
    // With other materials than diffuse ones:
    bool back;    // that side is the back
    uint kind;
    float roughness;
    float ior;
    vec3 base;    // plastic: reflectance under the coating
    vec3 wo;
    // With triangles:
    uint surface; // the primitive, or the mesh, whose material it has
    vec3 through; // of vertex normals: from the origin of rays on the normal's side to that on the other
};

uint surface_of(Vertex v) { return TRIANGLES ? v.surface : v.id; }

// Where a ray from the vertex starts. Interpolated normals may send one to the other side of its triangle, as in Mitsuba.
vec3 origin_of(Vertex v, vec3 d) { return MESH_SMOOTH && dot(d, v.through) > 0.0 ? v.p + v.through : v.p; }

// Do hits of triangles need more than their vertices?
const bool CORNERS = MESH_SMOOTH || CHECKERS || BITMAPS;
// Outward spheres whose inside is lit as well.
const bool HOLLOW = TWO_SIDED || DIELECTRICS;

// Of spheres apart that a ray meets from outside, the one whose middle on the ray is nearest comes first: only its distance
// needs a root.
const bool ORDERED = SPHERES_APART && !CAMERA_INSIDE && !HOLLOW;

bool is_sphere(uint id) { return SPHERE_COUNT > 0u && id < SPHERE_COUNT; }

#include "lib/box.glsl"

// Closest hit; `skip` is the convex primitive that the ray leaves.
uint closest_hit(vec3 o, vec3 d, uint skip, inout float best) {
    uint id = NONE;
    if (ORDERED) {
        vec2 nearest = vec2(1e30, 0.0);
        [[unroll]] for (uint i = 0u; i < INWARD_FIRST; ++i) {
            vec2 roots = sphere_roots(o, d, sphere_at(i));
            bool outside = roots.x > 0.0 && roots.x * roots.x > roots.y;
            bool closer = outside && roots.y > 0.0 && roots.x < nearest.x && i != skip;
            nearest = closer ? roots : nearest;
            id = closer ? i : id;
        }
        float t = nearest.x - sqrt(nearest.y);
        bool hit = t > 0.0 && t < best;
        best = hit ? t : best;
        id = hit ? id : NONE;
    }
    [[unroll]] for (uint i = ORDERED ? INWARD_FIRST : 0u; i < SPHERE_COUNT; ++i) {
        bool inward = i >= INWARD_FIRST;
        float t = hit_sphere(o, d, sphere_at(i), inward || CAMERA_INSIDE || HOLLOW);
        bool closer = t > 0.0 && t < best && (inward || i != skip);
        best = closer ? t : best;
        id = closer ? i : id;
    }
    vec3 reciprocal = 1.0 / d;
    [[unroll]] for (uint i = 0u; i < RECT_COUNT; ++i) {
        if (is_side(i)) continue;
        float t = hit_rect_at(i, o, d, reciprocal);
        bool closer = t > 0.0 && t < best && SPHERE_COUNT + i != skip;
        best = closer ? t : best;
        id = closer ? SPHERE_COUNT + i : id;
    }
    if (BOXED) leave_box(o, d, reciprocal, skip, best, id);
    if (TRIANGLES) {
        uint triangle = trace_triangles(o, d, skip, NONE, false, best);
        id = triangle != NONE ? triangle : id;
    }
    return id;
}

// Is anything between a surface and a light? Neither the receiver nor the light blocks: both are convex.
bool occluded(vec3 o, vec3 d, float t_max, uint receiver, uint light) {
    bool blocked = false;
    [[unroll]] for (uint i = 0u; i < SPHERE_COUNT; ++i) {
        if (LIGHT_COUNT == 1u && SPHERE_LIGHT_COUNT == 1u && i == 0u) continue;
        bool inward = i >= INWARD_FIRST;
        bool hit = blocks_sphere(o, d, t_max, sphere_at(i), inward || HOLLOW);
        blocked = blocked || (hit && i != light && (inward || i != receiver));
    }
    vec3 reciprocal = 1.0 / d;
    [[unroll]] for (uint i = 0u; i < RECT_COUNT; ++i) {
        if (!rect_blocks(i)) continue;
        float t = hit_rect_at(i, o, d, reciprocal);
        blocked = blocked || (t > 0.0 && t < t_max && SPHERE_COUNT + i != light && SPHERE_COUNT + i != receiver);
    }
    if (TRIANGLES && !blocked) blocked = trace_triangles(o, d, receiver, light, true, t_max) != NONE;
    return blocked;
}

// The angle of a direction, as part of a turn.
float turn(vec2 s) {
    float part = atan(s.y, s.x) / (2.0 * PI);
    return part < 0.0 ? part + 1.0 : part;
}

// A texel's place along one side of a picture of `size` texels.
int wrapped(int i, int size, uint wrap) {
    if (wrap == 2u) return clamp(i, 0, size - 1);
    int period = wrap == 1u ? 2 * size : size;
    i = i < 0 ? i + period : i;
    i = i >= period ? i - period : i;
    return i < size ? i : period - 1 - i;
}

// A picture's colour; what is repeated is taken back to the first period before f32 runs out of digits.
vec3 bitmap(uint id, vec2 uv) {
    vec4 place = row(id, BITMAP);
    uint flags = uint(place.w), wrap = flags & 3u;
    if (wrap == 0u) uv = fract(uv);
    else if (wrap == 1u) uv = 2.0 * fract(0.5 * uv);
    else uv = clamp(uv, vec2(0.0), vec2(1.0));
    bool nearest = flags >= 4u;
    vec2 at = uv * place.yz - (nearest ? 0.0 : 0.5);
    vec2 corner = floor(at), f = at - corner;
    int width = int(place.y), height = int(place.z);
    int x0 = wrapped(int(corner.x), width, wrap), y0 = int(place.x) + width * wrapped(int(corner.y), height, wrap);
    vec3 first = imageLoad(scene, y0 + x0).rgb;
    if (nearest) return first;
    int x1 = wrapped(int(corner.x) + 1, width, wrap), y1 = int(place.x) + width * wrapped(int(corner.y) + 1, height, wrap);
    vec3 above = mix(first, imageLoad(scene, y0 + x1).rgb, f.x);
    vec3 below = mix(imageLoad(scene, y1 + x0).rgb, imageLoad(scene, y1 + x1).rgb, f.x);
    return mix(above, below, f.y);
}

// The reflectance at (u, v) of a surface that may have a texture (src/scene/material.rs).
vec3 textured_uv(uint id, vec2 uv, vec3 albedo) {
    vec4 second = row(id, TEXTURE);
    vec4 map = row(id, TEXTURE_UV);
    if (BITMAPS && second.w == 2.0) return bitmap(id, vec2(dot(second.xy, uv) + second.z, dot(map.xy, uv) + map.z));
    bvec2 upper = greaterThan(fract(uv * map.xy + map.zw), vec2(0.5));
    return second.w == 0.0 || upper.x == upper.y ? albedo : second.rgb;
}

// The same at a point of a primitive.
vec3 textured(uint id, bool rect, vec3 p, vec3 albedo) {
    vec3 f = p - row(id, GEOMETRY).xyz;
    vec2 uv;
    if (rect) {
        vec2 s = vec2(dot(f, row(id, DUAL_U).xyz), dot(f, row(id, DUAL_V).xyz));
        uv = is_disk(id - SPHERE_COUNT) ? vec2(length(s), turn(s)) : 0.5 + 0.5 * s;
    } else {
        vec3 n = normalize(f);
        uv = vec2(turn(n.xy), acos(clamp(n.z, -1.0, 1.0)) / PI);
    }
    return textured_uv(id, uv, albedo);
}

// Reads the material, and turns the normal where the back scatters too. `surface` has the material's rows.
void set_material(inout Vertex v, vec3 d, uint surface) {
    v.front = dot(d, v.n) < 0.0;
    if (!BSDFS && !TWO_SIDED) return;
    vec4 material = row(surface, MATERIAL);
    v.kind = uint(material.x);
    v.roughness = material.y;
    v.ior = material.z;
    v.wo = -d;
    v.back = !v.front && (material.w != 0.0 || v.kind == DIELECTRIC);
    if (v.back) {
        v.front = true;
        v.n = -v.n;
    }
    // Lobes of different colours: they bring them in as they are chosen.
    if (PLASTICS && v.kind == PLASTIC) v.base = v.albedo;
    if (PLASTICS && v.kind == PLASTIC || DIELECTRICS && v.kind == DIELECTRIC) v.albedo = vec3(1.0);
}

// The coating of a plastic.
Coating coating(Vertex v) {
    vec4 a = row(surface_of(v), MATERIAL_A), b = row(surface_of(v), MATERIAL_B);
    return Coating(v.ior, a.w, b.x, b.y != 0.0, a.rgb);
}

// What a vertex sends toward the camera of the light from `wi`, its albedo excluded; see lib/bsdf.glsl.
Response respond(Vertex v, vec3 wi) {
    float cosine = max(0.0, dot(wi, v.n));
    Response r = Response(vec3(cosine / PI), cosine / PI);
    if (ROUGH_CONDUCTORS && v.kind == ROUGH_CONDUCTOR) {
        uint surface = surface_of(v);
        r = respond_rough(v.n, v.wo, wi, v.roughness, row(surface, MATERIAL_A).rgb, row(surface, MATERIAL_B).rgb);
    } else if (PLASTICS && v.kind == PLASTIC) {
        Coating c = coating(v);
        float reflected;
        r.pdf *= 1.0 - specular_probability(c, dot(v.wo, v.n), reflected);
        r.value *= through_coating(c, v.base, reflected, cosine);
    }
    return r;
}

// Does light sampling find any light that the vertex scatters?
bool scatters_widely(Vertex v) { return !BSDFS || v.kind == DIFFUSE || v.kind >= ROUGH_CONDUCTOR && v.kind != DIELECTRIC; }

// What the picture of first hits shows as the surface's colour.
vec3 shown_albedo(Vertex v) {
    if (PLASTICS && v.kind == PLASTIC) return v.base;
    return v.albedo;
}

// A hit on a triangle, a little inside its edges, with the interpolated normal where the mesh has one.
Vertex make_triangle_vertex(vec3 d, uint id, float offset) {
    uint triangle = id - TRIANGLE_FIRST;
    vec4 v0 = triangle_row(triangle, 0), v1 = triangle_row(triangle, 1), v2 = triangle_row(triangle, 2);
    vec4 flat_normal = triangle_row(triangle, 3);
    vec3 weights = vec3(1.0 - g_barycentric.x - g_barycentric.y, g_barycentric);
    vec3 inside = max(weights, vec3(v0.w, v1.w, v2.w));
    inside *= 1.0 / (inside.x + inside.y + inside.z);
    Vertex v;
    v.id = id;
    v.surface = MESH_FIRST + uint(flat_normal.w);
    v.back = false;
    v.kind = DIFFUSE;
    v.p = inside.x * v0.xyz + inside.y * v1.xyz + inside.z * v2.xyz;
    v.n = flat_normal.xyz;
    v.albedo = row(v.surface, ALBEDO).rgb;
    if (CORNERS) {
        vec4 c0 = corner_row(triangle, 0), c1 = corner_row(triangle, 1), c2 = corner_row(triangle, 2);
        if (MESH_SMOOTH) {
            vec3 n = weights.x * c0.xyz + weights.y * c1.xyz + weights.z * c2.xyz;
            v.n = dot(n, n) > 0.0 ? normalize(n) : v.n;
        }
        if (CHECKERS || BITMAPS) {
            vec3 heights = corner_row(triangle, 3).xyz;
            vec2 uv = vec2(dot(weights, vec3(c0.w, c1.w, c2.w)), dot(weights, heights));
            v.albedo = textured_uv(v.surface, uv, v.albedo);
        }
    }
    set_material(v, d, v.surface);
    vec3 off = dot(v.n, flat_normal.xyz) < 0.0 ? -offset * flat_normal.xyz : offset * flat_normal.xyz;
    v.p += off;
    v.through = -2.0 * off;
    return v;
}

// A hit of a rectangle or disk of any orientation, pulled back into its plane and off its edge.
vec3 pulled_inside(uint id, vec3 p, vec3 center) {
    vec4 half_u = row(id, HALF_U);
    vec4 half_v = row(id, HALF_V);
    vec3 f = p - center;
    float a = dot(f, row(id, DUAL_U).xyz);
    float b = dot(f, row(id, DUAL_V).xyz);
    if (is_disk(id - SPHERE_COUNT)) {
        float inside = min(1.0, half_u.w * inversesqrt(max(a * a + b * b, 1e-30)));
        a *= inside;
        b *= inside;
    } else {
        a = clamp(a, -half_u.w, half_u.w);
        b = clamp(b, -half_v.w, half_v.w);
    }
    return center + a * half_u.xyz + b * half_v.xyz;
}

// The hit, pulled back onto its surface: a ray's far end is less exact than the surface is.
Vertex make_vertex(vec3 p, vec3 d, uint id, float offset) {
    if (TRIANGLES && id >= TRIANGLE_FIRST) return make_triangle_vertex(d, id, offset);
    Vertex v;
    v.id = id;
    v.back = false;
    v.kind = DIFFUSE;
    v.surface = id;
    v.through = vec3(0.0);
    bool rect = RECT_COUNT > 0u && (SPHERE_COUNT == 0u || id >= SPHERE_COUNT);
    if (SPHERE_COUNT > 0u && !rect) {
        vec4 s = sphere_at(0u);
        v.albedo = g_sphere_albedo[0];
        if (PRELOAD) {
            [[unroll]] for (uint i = 1u; i < SPHERE_COUNT; ++i) {
                s = id == i ? g_sphere[i] : s;
                v.albedo = id == i ? g_sphere_albedo[i] : v.albedo;
            }
        } else {
            s = row(id, GEOMETRY);
            v.albedo = row(id, ALBEDO).rgb;
        }
        v.n = normalize(p - s.xyz);
        v.p = s.xyz + s.w * v.n;
        if (INWARD_FIRST < SPHERE_COUNT) v.n = id >= INWARD_FIRST ? -v.n : v.n;
    } else if (only_sides()) {
        v = box_vertex(v, p);
    } else if (ALIGNED) {
        vec3 center = g_center[0], inner = g_inner[0];
        v.n = g_normal[0];
        v.albedo = g_rect_albedo[0];
        [[unroll]] for (uint i = 1u; i < RECT_COUNT; ++i) {
            bool mine = id == SPHERE_COUNT + i;
            center = mine ? g_center[i] : center;
            inner = mine ? g_inner[i] : inner;
            v.n = mine ? g_normal[i] : v.n;
            v.albedo = mine ? g_rect_albedo[i] : v.albedo;
        }
        v.p = clamp(p, center - inner, center + inner);
    } else {
        vec3 center = row(id, GEOMETRY).xyz;
        vec4 normal = row(id, NORMAL);
        v.n = normal.xyz;
        v.albedo = row(id, ALBEDO).rgb;
        if (normal.w != 0.0) {
            vec3 inner = row(id, INNER).xyz;
            v.p = clamp(p, center - inner, center + inner);
        } else {
            v.p = pulled_inside(id, p, center);
        }
    }
    if (CHECKERS || BITMAPS) v.albedo = textured(id, rect, v.p, v.albedo);
    set_material(v, d, id);
    v.p += offset * v.n;
    return v;
}

#endif
