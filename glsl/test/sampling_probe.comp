// For tests: random numbers and sampled directions as the path tracer makes them.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/random.glsl"
#include "lib/sampling.glsl"

layout(local_size_x = 64) in;

layout(set = 0, binding = 0, std430) writeonly buffer Values { vec4 values[]; };

layout(push_constant) uniform Push {
    uint count;
    uint kind;      // 0 numbers, 1 sphere, 2 hemisphere, 3 cosine, 4 cone, 5 the number of random1, 6 cones
    uint sampler_kind;
    uint per_pixel; // samples of one pixel
    uint seed;
    uint dimension;
    float nx;
    float ny;
    float nz;
    float cone;
};

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= count) return;
    uint pixel = i / per_pixel;
    uvec2 key = pixel_key(uvec2(pixel % 1024u, pixel / 1024u), seed);
    vec4 u = random4(sampler_kind, key, i % per_pixel, dimension);
    vec3 n = vec3(nx, ny, nz);
    float one_minus_cos = 0.0;
    vec4 value = u;
    switch (kind) {
    case 0u: break;
    case 1u: value = vec4(sample_sphere(u.xy), 0.0); break;
    case 2u: value = vec4(sample_hemisphere(n, u.xy), 0.0); break;
    case 3u: value = vec4(sample_cosine(n, u.xy), 0.0); break;
    case 4u:
        value.xyz = sample_cone(n, cone, u.zw, one_minus_cos);
        value.w = one_minus_cos;
        break;
    case 5u: value = vec4(random1(sampler_kind, key, i % per_pixel, dimension)); break;
    case 6u: // (radius / distance)^2 from 1 down to 2^-47, or from 0 up to 1 - 2^-23, and 1 - cos of the cone
        value.x = i % 2u == 0u ? exp2(-47.0 * u.x) : 1.0 - exp2(-23.0 * u.x);
        value.y = cone_one_minus_cos(value.x);
        break;
    default: value = vec4(0.0 / 0.0);
    }
    values[i] = value;
}
