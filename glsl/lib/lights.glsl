// Light that reaches a vertex: sampled directly, or met by a ray.
// Included by a shader that declares `scene` (rows of four floats, src/render/pack.rs) and the scene's specialization constants.
#ifndef LIMPID_LIGHTS_GLSL
#define LIMPID_LIGHTS_GLSL

#include "lib/sampling.glsl"
#include "lib/scene.glsl"

bool emits(uint id) {
    if (MESH_LIGHT_COUNT > 0u && id >= MESH_FIRST && id < MESH_FIRST + MESH_LIGHT_COUNT) return true;
    return id < SPHERE_LIGHT_COUNT || (id >= INWARD_FIRST && id < INWARD_FIRST + INWARD_LIGHT_COUNT)
        || (id >= SPHERE_COUNT && id < SPHERE_COUNT + RECT_LIGHT_COUNT);
}

// How the direction of a ray was chosen: what light sampling at its origin has counted of the light that it meets.
const uint ALONE = 0u;   // nothing: a camera ray, or a lobe of one direction
const uint WIDELY = 1u;  // spheres wholly, the rest by the balance heuristic
const uint GLOSSILY = 2u; // all by the balance heuristic

// Kinds of lights that no ray meets (src/scene/light.rs).
const uint POINT = 0u;
const uint DIRECTIONAL = 1u;
const uint SPOT_LINEAR = 2u;
const uint SPOT_SQUARED = 3u;
const bool DIRECTIONALS = (DELTA_KINDS & (1u << DIRECTIONAL)) != 0u;
const bool SPOTS = (DELTA_KINDS >> SPOT_LINEAR) != 0u;

// The part of a spot's intensity that goes in a direction away from it.
float spot(uint light, uint kind, vec3 away) {
    vec3 axis = row(light, NORMAL).xyz;
    vec4 fading = row(light, DUAL_U); // from an angle in parts of a turn, or its cosine, to 0 at the cutoff and 1 at the beam
    float cosine = dot(away, axis);
    float x = kind == SPOT_LINEAR ? turn_of(length(cross(away, axis)), cosine) : cosine;
    float part = clamp(fading.x + fading.y * x, 0.0, 1.0);
    return kind == SPOT_LINEAR ? part : part * part;
}

// The i-th of the lights that are sampled: spheres, rectangles and disks, meshes, those that no ray meets; the environment's map
// comes after.
uint light_at(uint i) {
    if (i < SPHERE_LIGHT_COUNT) return i;
    i -= SPHERE_LIGHT_COUNT;
    if (i < RECT_LIGHT_COUNT) return SPHERE_COUNT + i;
    i -= RECT_LIGHT_COUNT;
    return i < MESH_LIGHT_COUNT ? MESH_FIRST + i : DELTA_FIRST + i - MESH_LIGHT_COUNT;
}

// Where a light's share in the choice of lights begins: where that of what stands before it ends.
float share_begin(uint light) { return light > 0u ? row(light - 1u, RADIANCE).w : 0.0; }

// A triangle of an emitting mesh, by area: `choice` in [0, 1) against the table of its summed areas (parts of the whole, triangles).
uint choose_triangle(vec4 g, float choice) {
    int low = 0, high = int(g.y) - 1;
    while (low < high) {
        int middle = (low + high) / 2;
        bool below = choice < imageLoad(scene, int(g.x) + middle).x;
        high = below ? middle : high;
        low = below ? low : middle + 1;
    }
    return uint(imageLoad(scene, int(g.x) + low).y);
}

// Light that reaches the vertex directly from one chosen light, per unit of throughput (albedo excluded).
vec3 sample_light(Vertex v, vec2 u, float choice, uint sample_index, uint vertex, inout uint rays) {
    uint light = 0u;
    float share = 1.0;
    float within = choice; // the place of `choice` in the light's share
    if (LIGHT_COUNT > 1u) {
        float below = 0.0;
        share = 0.0;
        for (uint i = 0u; i < LIGHT_COUNT; ++i) {
            bool surrounds = MAP_SAMPLED && i + 1u == LIGHT_COUNT;
            uint id = surrounds ? NONE : light_at(i);
            float above = surrounds ? 1.0 : row(id, RADIANCE).w;
            bool chosen = choice >= below && choice < above;
            light = chosen ? id : light;
            share = chosen ? above - below : share;
            if (MESH_LIGHT_COUNT > 0u) within = chosen ? (choice - below) / (above - below) : within;
            below = above;
        }
    } else {
        light = MAP_SAMPLED ? NONE : light_at(0u);
    }
    if (light == v.id || share <= 0.0) return vec3(0.0);
    uint source = light; // what must not block
    bool mapped = MAP_SAMPLED && light == NONE;
    bool delta = DELTA_COUNT > 0u && !mapped && light >= DELTA_FIRST;
    vec4 g = vec4(0.0);
    if (!mapped) g = ONE_LIGHT ? g_light : row(light, GEOMETRY);
    vec3 wi;
    float t_light;
    float weight; // cos / (pi * pdf), with the balance heuristic where a bounce can find the light too
    float pdf_light;
    float fade = 1.0; // what of a spot's intensity goes this way
    vec3 radiance;
    if (mapped) {
        wi = sample_environment(numbers(sample_index, ENVIRONMENT_DIMENSIONS + vertex), u);
        t_light = 1e30;
        vec4 seen = environment(wi);
        radiance = seen.rgb;
        pdf_light = share * seen.w;
        float pdf_bounce = max(0.0, dot(wi, v.n)) / PI;
        weight = pdf_bounce / (pdf_light + pdf_bounce);
    } else if (delta) {
        uint kind = uint(g.w);
        vec3 q = g.xyz - v.p;
        float distance2 = dot(q, q);
        float inverse = inversesqrt(distance2);
        wi = q * inverse;
        t_light = distance2 * inverse;
        // As if this were a density: nothing else finds the light.
        pdf_light = share * distance2;
        if (DIRECTIONALS && kind == DIRECTIONAL) {
            wi = g.xyz;
            t_light = 1e30;
            pdf_light = share;
        }
        weight = max(0.0, dot(wi, v.n)) / (PI * pdf_light);
        if (SPOTS && kind >= SPOT_LINEAR) fade = spot(light, kind, -wi);
    } else if (RECT_LIGHT_COUNT + MESH_LIGHT_COUNT == 0u || (SPHERE_LIGHT_COUNT > 0u && light < SPHERE_LIGHT_COUNT)) {
        vec3 to_center = g.xyz - v.p;
        float distance2 = dot(to_center, to_center);
        float s2 = g.w * g.w / distance2;
        if (!(s2 < 1.0)) return vec3(0.0); // inside: only the back of the light is seen
        float inverse = inversesqrt(distance2);
        float cone = cone_one_minus_cos(s2);
        float omc;
        wi = sample_cone(to_center * inverse, cone, u, omc);
        float sin2 = omc * (2.0 - omc);
        t_light = distance2 * inverse * ((1.0 - omc) - sqrt(max(0.0, s2 - sin2)));
        weight = dot(wi, v.n) * 2.0 * cone / share;
        pdf_light = share / (2.0 * PI * cone);
    } else {
        vec3 q, normal;
        if (MESH_LIGHT_COUNT > 0u && light >= MESH_FIRST) {
            uint triangle = choose_triangle(g, within);
            source = TRIANGLE_FIRST + triangle;
            if (source == v.id) return vec3(0.0);
            vec2 s = sample_triangle(u);
            vec3 v0 = triangle_row(triangle, 0).xyz;
            q = v0 + s.x * (triangle_row(triangle, 1).xyz - v0) + s.y * (triangle_row(triangle, 2).xyz - v0) - v.p;
            normal = triangle_row(triangle, 3).xyz;
        } else {
            vec2 s = is_disk(light - SPHERE_COUNT) ? sample_disk(u) : 2.0 * u - 1.0;
            q = g.xyz + s.x * row(light, HALF_U).xyz + s.y * row(light, HALF_V).xyz - v.p;
            normal = row(light, NORMAL).xyz;
        }
        float distance2 = dot(q, q);
        float inverse = inversesqrt(distance2);
        wi = q * inverse;
        t_light = distance2 * inverse;
        // A mesh's other triangles meet this one at its edges.
        if (MESH_LIGHT_COUNT > 0u && source >= TRIANGLE_FIRST) t_light -= g_short;
        float facing = -dot(wi, normal);
        if (!(facing > 0.0) || !(distance2 > 0.0)) return vec3(0.0);
        pdf_light = share * distance2 / (facing * g.w);
        float pdf_bounce = max(0.0, dot(wi, v.n)) / PI;
        weight = pdf_bounce / (pdf_light + pdf_bounce);
    }
    if (!(weight > 0.0) || SPOTS && !(fade > 0.0)) return vec3(0.0);
    vec3 weights = vec3(weight);
    if (BSDFS && v.kind != DIFFUSE) {
        Response r = respond(v, wi);
        bool weighed = !delta && (v.kind == ROUGH_CONDUCTOR || mapped || light >= SPHERE_COUNT);
        weights = r.value / (pdf_light + (weighed ? r.pdf : 0.0));
        if (!(max(weights.r, max(weights.g, weights.b)) > 0.0)) return vec3(0.0);
    }
    rays += 1u;
    // From inside a sphere, the sphere itself is in the way.
    uint receiver = HOLLOW && v.back && is_sphere(v.id) ? NONE : v.id;
    if (occluded(origin_of(v, wi), wi, t_light, receiver, source)) return vec3(0.0);
    if (!mapped) radiance = ONE_LIGHT ? g_light_radiance : row(light, RADIANCE).rgb;
    if (SPOTS) radiance *= fade;
    return weights * radiance;
}

// Emission met by a ray from `o`; with light sampling only what that technique leaves to this one.
vec3 emission(Vertex v, vec3 o, vec3 d, float t, float pdf_bounce, uint chosen) {
    uint light = surface_of(v);
    if (!LIT || !v.front || v.back || !emits(light)) return vec3(0.0);
    vec4 radiance = ONE_LIGHT ? vec4(g_light_radiance, 1.0) : row(light, RADIANCE);
    float weight = 1.0;
    if (NEE && chosen != ALONE) {
        if (light < SPHERE_LIGHT_COUNT) {
            weight = 0.0;
            if (ROUGH_CONDUCTORS && chosen == GLOSSILY) {
                vec4 sphere = row(light, GEOMETRY);
                vec3 to_center = sphere.xyz - o;
                float s2 = sphere.w * sphere.w / dot(to_center, to_center);
                float share = radiance.w - share_begin(light);
                // A receiver inside the light has no light sample of it.
                float pdf_light = s2 < 1.0 ? share / (2.0 * PI * cone_one_minus_cos(s2)) : 0.0;
                weight = pdf_bounce / (pdf_bounce + pdf_light);
            }
        }
        if (RECT_LIGHT_COUNT + MESH_LIGHT_COUNT > 0u && light >= SPHERE_COUNT) {
            float pdf_light = (radiance.w - share_begin(light)) * t * t / (-dot(d, v.n) * row(light, GEOMETRY).w);
            weight = pdf_bounce / (pdf_bounce + pdf_light);
        }
    }
    return weight * radiance.rgb;
}

// What a ray meets beyond the scene, likewise.
vec3 surroundings(vec3 d, float pdf_bounce, uint chosen) {
    vec4 seen = environment(d);
    if (!MAP_SAMPLED || !NEE || chosen == ALONE) return seen.rgb;
    float share = imageLoad(scene, ENVIRONMENT_ROW + 3).w;
    return seen.rgb * (pdf_bounce / (pdf_bounce + share * seen.w));
}

#endif
