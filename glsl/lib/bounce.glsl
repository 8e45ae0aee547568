// How a path goes on from a vertex.
// Included by a shader that declares `scene` (rows of four floats, src/render/pack.rs) and the scene's specialization constants.
#ifndef LIMPID_BOUNCE_GLSL
#define LIMPID_BOUNCE_GLSL

#include "lib/lights.glsl"
#include "lib/scene.glsl"

// A new direction at the vertex; `weight` is cos / (pi * pdf).
vec3 sample_direction(Vertex v, vec2 u, out float weight, out float pdf) {
    weight = 1.0;
    if (ESTIMATOR == ESTIMATOR_UNIFORM) {
        vec3 d = sample_hemisphere(v.n, u);
        weight = 2.0 * dot(d, v.n);
        pdf = 0.5 / PI;
        return d;
    }
    vec3 d = sample_cosine(v.n, u);
    pdf = dot(d, v.n) / PI;
    return d;
}

struct Bounce {
    vec3 d;
    vec3 o;
    vec3 weight;   // bsdf * cos / pdf, the vertex' albedo excluded
    float pdf;
    uint chosen;   // see lib/lights.glsl
    uint skip;     // what the ray cannot hit
    float squeeze; // of radiance by refraction
};

Bounce sample_bounce(Vertex v, vec2 u) {
    Bounce b;
    b.o = v.p;
    b.skip = v.id;
    b.chosen = WIDELY;
    b.squeeze = 1.0;
    float cos_o = dot(v.wo, v.n);
    bool inside = v.back; // goes on behind the surface's own front
    if (CONDUCTORS && v.kind == CONDUCTOR) {
        b.d = 2.0 * cos_o * v.n - v.wo;
        b.weight = fresnel_conductor(cos_o, row(surface_of(v), MATERIAL_A).rgb, row(surface_of(v), MATERIAL_B).rgb);
        b.chosen = ALONE;
    } else if (ROUGH_CONDUCTORS && v.kind == ROUGH_CONDUCTOR) {
        vec3 m = sample_ggx_visible(v.n, v.wo, v.roughness, u);
        b.d = normalize(2.0 * dot(v.wo, m) * m - v.wo);
        Response r = respond(v, b.d);
        b.pdf = r.pdf;
        b.weight = r.pdf > 0.0 ? r.value / r.pdf : vec3(0.0);
        b.chosen = GLOSSILY;
    } else if (DIELECTRICS && v.kind == DIELECTRIC) {
        float eta = v.back ? 1.0 / v.ior : v.ior;
        float cos_t;
        bool reflects = u.x < fresnel_dielectric(cos_o, eta, cos_t);
        b.d = reflects ? 2.0 * cos_o * v.n - v.wo : (cos_o / eta - cos_t) * v.n - v.wo / eta;
        b.d = normalize(b.d);
        b.squeeze = reflects ? 1.0 : 1.0 / (eta * eta);
        b.weight = row(surface_of(v), reflects ? MATERIAL_A : MATERIAL_B).rgb * b.squeeze;
        if (!reflects) {
            // From the other side of the surface, as far off it.
            b.o = v.p - 2.0 * g_offset * v.n;
            inside = !inside;
        }
        b.chosen = ALONE;
    } else if (PLASTICS && v.kind == PLASTIC) {
        Coating c = coating(v);
        float reflected;
        float specular = specular_probability(c, cos_o, reflected);
        if (u.x < specular) {
            b.d = 2.0 * cos_o * v.n - v.wo;
            b.weight = c.specular * (reflected / specular);
            b.chosen = ALONE;
        } else {
            float weight;
            b.d = sample_direction(v, vec2((u.x - specular) / (1.0 - specular), u.y), weight, b.pdf);
            b.pdf *= 1.0 - specular;
            b.weight = through_coating(c, v.base, reflected, dot(b.d, v.n)) * (weight / (1.0 - specular));
        }
    } else {
        float weight;
        b.d = sample_direction(v, u, weight, b.pdf);
        b.weight = vec3(weight);
    }
    // The inside of a sphere sees the sphere itself.
    if (HOLLOW && inside && is_sphere(v.id)) b.skip = NONE;
    if (MESH_SMOOTH) b.o = origin_of(v, b.d);
    return b;
}

#endif
