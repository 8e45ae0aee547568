// How surfaces scatter light (src/scene/material.rs). All directions point away from the surface: `wo` toward the camera, `wi`
// toward the light; both lie on the side of the normal `n` unless a dielectric transmits.
// Included by lib/scene.glsl.
#ifndef LIMPID_BSDF_GLSL
#define LIMPID_BSDF_GLSL

#include "lib/sampling.glsl"

// Kinds as in a primitive's material row; MATERIALS has the bit of each kind but the first that the scene has.
const uint DIFFUSE = 0u;
const uint CONDUCTOR = 1u;
const uint ROUGH_CONDUCTOR = 2u;
const uint DIELECTRIC = 3u;
const uint PLASTIC = 4u;
const bool BSDFS = MATERIALS != 0u;

const bool CONDUCTORS = (MATERIALS & (1u << CONDUCTOR)) != 0u;
const bool ROUGH_CONDUCTORS = (MATERIALS & (1u << ROUGH_CONDUCTOR)) != 0u;
const bool DIELECTRICS = (MATERIALS & (1u << DIELECTRIC)) != 0u;
const bool PLASTICS = (MATERIALS & (1u << PLASTIC)) != 0u;

// Unpolarised Fresnel reflectance at a dielectric; `eta` is the index of refraction beyond over that before the surface.
// `cos_t` is 0 where reflection is total.
float fresnel_dielectric(float cos_i, float eta, out float cos_t) {
    cos_t = sqrt(max(0.0, 1.0 - (1.0 - cos_i * cos_i) / (eta * eta)));
    if (eta == 1.0) return 0.0;
    float s = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
    float p = (cos_t - eta * cos_i) / (cos_t + eta * cos_i);
    return 0.5 * (s * s + p * p);
}

// The same at a conductor of the index eta + i k (K. D. Moeller, "Optics", 1988).
vec3 fresnel_conductor(float cos_i, vec3 eta, vec3 k) {
    float cos2 = cos_i * cos_i, sin2 = 1.0 - cos2;
    vec3 difference = eta * eta - k * k - sin2;
    vec3 sum = sqrt(max(vec3(0.0), difference * difference + 4.0 * k * k * eta * eta));
    vec3 cross_term = 2.0 * cos_i * sqrt(max(vec3(0.0), 0.5 * (sum + difference)));
    vec3 s = (sum + cos2 - cross_term) / (sum + cos2 + cross_term);
    vec3 p = s * (sum * cos2 + sin2 * sin2 - cross_term * sin2) / (sum * cos2 + sin2 * sin2 + cross_term * sin2);
    return 0.5 * (s + p);
}

// Smith's masking of the GGX distribution for a direction at this cosine from the normal.
float ggx_masking(float cosine, float alpha) {
    float tan2 = max(0.0, 1.0 - cosine * cosine) / (cosine * cosine);
    return 2.0 / (1.0 + sqrt(1.0 + alpha * alpha * tan2));
}

// Density of microfacet normals; the sine is taken from the cross product, exact where the normals nearly agree.
float ggx_density(vec3 m, vec3 n, float alpha) {
    vec3 sine = cross(m, n);
    float cosine = dot(m, n);
    float s = dot(sine, sine) / (alpha * alpha) + cosine * cosine;
    return 1.0 / (PI * alpha * alpha * s * s);
}

// A microfacet normal as seen from `wo` (Dupuy and Benyoub, "Sampling Visible GGX Normals with Spherical Caps", HPG 2023).
vec3 sample_ggx_visible(vec3 n, vec3 wo, float alpha, vec2 u) {
    vec3 tangent, bitangent;
    make_basis(n, tangent, bitangent);
    vec3 stretched = normalize(vec3(alpha * dot(wo, tangent), alpha * dot(wo, bitangent), dot(wo, n)));
    float z = (1.0 - u.x) * (1.0 + stretched.z) - stretched.z;
    float r = sqrt(clamp(1.0 - z * z, 0.0, 1.0));
    float phi = 2.0 * PI * u.y;
    vec3 h = vec3(r * cos(phi), r * sin(phi), z) + stretched;
    return normalize(alpha * h.x * tangent + alpha * h.y * bitangent + max(h.z, 1e-12) * n);
}

// What a surface sends toward `wo` of the light from a direction: bsdf times cosine, without the vertex' albedo, and the density
// with which a bounce takes that direction. Lobes of a single direction count for nothing here.
struct Response {
    vec3 value;
    float pdf;
};

Response respond_rough(vec3 n, vec3 wo, vec3 wi, float alpha, vec3 eta, vec3 k) {
    vec3 m = normalize(wo + wi);
    float cos_o = dot(wo, n), cos_i = dot(wi, n), cos_m = dot(wo, m);
    if (!(cos_o > 0.0) || !(cos_i > 0.0) || !(cos_m > 0.0)) return Response(vec3(0.0), 0.0);
    float pdf = ggx_density(m, n, alpha) * ggx_masking(cos_o, alpha) / (4.0 * cos_o);
    return Response(pdf * ggx_masking(cos_i, alpha) * fresnel_conductor(cos_m, eta, k), pdf);
}

// The coating of a plastic: rows of the material.
struct Coating {
    float eta;
    float internal; // part of the diffuse light that the coating reflects back onto the base
    float share;    // weight of the specular lobe in the choice of lobes
    bool nonlinear;
    vec3 specular;
};

// Probability of the specular lobe, and what it reflects.
float specular_probability(Coating c, float cos_o, out float reflected) {
    float cos_t;
    reflected = fresnel_dielectric(cos_o, c.eta, cos_t);
    float specular = reflected * c.share, diffuse = (1.0 - reflected) * (1.0 - c.share);
    return specular / (specular + diffuse);
}

// What of the base's light leaves toward `wo` when it came in at the cosine `cos_i`: a factor of its Lambertian reflection.
vec3 through_coating(Coating c, vec3 base, float reflected, float cos_i) {
    float cos_t;
    float entering = 1.0 - fresnel_dielectric(cos_i, c.eta, cos_t);
    vec3 repeated = 1.0 - (c.nonlinear ? base * c.internal : vec3(c.internal));
    return base / repeated * ((1.0 - reflected) * entering / (c.eta * c.eta));
}

#endif
