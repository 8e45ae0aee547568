// Light that reaches a vertex: sampled directly, or met by a ray.
// Included by a shader that declares `scene` (rows of four floats, src/render/pack.rs) and the scene's specialization constants.
#ifndef LIMPID_LIGHTS_GLSL
#define LIMPID_LIGHTS_GLSL

#include "lib/sampling.glsl"
#include "lib/scene.glsl"

bool emits(uint id) {
    return id < SPHERE_LIGHT_COUNT || (id >= INWARD_FIRST && id < INWARD_FIRST + INWARD_LIGHT_COUNT)
        || (id >= SPHERE_COUNT && id < SPHERE_COUNT + RECT_LIGHT_COUNT);
}

// Light that reaches the vertex directly from one chosen light, per unit of throughput (albedo excluded).
vec3 sample_light(Vertex v, vec2 u, float choice, inout uint rays) {
    uint light = 0u;
    float share = 1.0;
    if (LIGHT_COUNT > 1u) {
        float below = 0.0;
        share = 0.0;
        for (uint i = 0u; i < LIGHT_COUNT; ++i) {
            uint id = i < SPHERE_LIGHT_COUNT ? i : SPHERE_COUNT + i - SPHERE_LIGHT_COUNT;
            float above = row(id, RADIANCE).w;
            bool chosen = choice >= below && choice < above;
            light = chosen ? id : light;
            share = chosen ? above - below : share;
            below = above;
        }
    } else if (SPHERE_LIGHT_COUNT == 0u) {
        light = SPHERE_COUNT;
    }
    if (light == v.id || share <= 0.0) return vec3(0.0);
    vec4 g = ONE_LIGHT ? g_light : row(light, GEOMETRY);
    vec3 wi;
    float t_light;
    float weight; // cos / (pi * pdf), with the balance heuristic where a bounce can find the light too
    if (RECT_LIGHT_COUNT == 0u || (SPHERE_LIGHT_COUNT > 0u && light < SPHERE_LIGHT_COUNT)) {
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
    } else {
        vec2 s = is_disk(light - SPHERE_COUNT) ? sample_disk(u) : 2.0 * u - 1.0;
        vec3 q = g.xyz + s.x * row(light, HALF_U).xyz + s.y * row(light, HALF_V).xyz - v.p;
        float distance2 = dot(q, q);
        float inverse = inversesqrt(distance2);
        wi = q * inverse;
        t_light = distance2 * inverse;
        float facing = -dot(wi, row(light, NORMAL).xyz);
        if (!(facing > 0.0) || !(distance2 > 0.0)) return vec3(0.0);
        float pdf_light = share * distance2 / (facing * g.w);
        float pdf_bounce = max(0.0, dot(wi, v.n)) / PI;
        weight = pdf_bounce / (pdf_light + pdf_bounce);
    }
    if (!(weight > 0.0)) return vec3(0.0);
    rays += 1u;
    if (occluded(v.p, wi, t_light, v.id, light)) return vec3(0.0);
    return weight * (ONE_LIGHT ? g_light_radiance : row(light, RADIANCE).rgb);
}

// Emission met by a ray; with light sampling only what that technique leaves to this one.
vec3 emission(Vertex v, vec3 d, float t, float pdf_bounce, bool camera) {
    if (!LIT || !v.front || !emits(v.id)) return vec3(0.0);
    vec4 radiance = ONE_LIGHT ? vec4(g_light_radiance, 1.0) : row(v.id, RADIANCE);
    float weight = 1.0;
    if (NEE && !camera) {
        if (v.id < SPHERE_LIGHT_COUNT) weight = 0.0;
        if (RECT_LIGHT_COUNT > 0u && v.id >= SPHERE_COUNT) {
            uint i = v.id - SPHERE_COUNT;
            float below = 0.0;
            if (i > 0u) below = row(v.id - 1u, RADIANCE).w;
            else if (SPHERE_LIGHT_COUNT > 0u) below = row(SPHERE_LIGHT_COUNT - 1u, RADIANCE).w;
            float pdf_light = (radiance.w - below) * t * t / (-dot(d, v.n) * row(v.id, GEOMETRY).w);
            weight = pdf_bounce / (pdf_bounce + pdf_light);
        }
    }
    return weight * radiance.rgb;
}

#endif
