// Counter-based random numbers: a value is a pure function of (pixel, seed, sample, dimension), so any range of samples,
// tile or chunk gives the same bits. Uniforms lie in [0, 1): the upper 24 bits, never 1.0.
#ifndef LIMPID_RANDOM_GLSL
#define LIMPID_RANDOM_GLSL

// Jarzynski and Olano, "Hash Functions for GPU Rendering", JCGT 9(3), 2020.
uvec4 pcg4d(uvec4 v) {
    v = v * 1664525u + 1013904223u;
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    v ^= v >> 16u;
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    return v;
}

vec2 to_unit(uvec2 x) { return vec2(x >> 8u) * 5.9604644775390625e-8; }
vec4 to_unit(uvec4 x) { return vec4(x >> 8u) * 5.9604644775390625e-8; }

// A hash in which each bit depends on itself and lower bits only: Owen scrambling of the bit-reversed value
// (Laine and Karras 2011; constants by Vegdahl; use as in Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4), 2020).
uint laine_karras(uint x, uint seed) {
    x ^= x * 0x3d20adeau;
    x += seed;
    x *= (seed >> 16u) | 1u;
    x ^= x * 0x05526c56u;
    x ^= x * 0x53a22864u;
    return x;
}

// Multiplication by Pascal's matrix modulo 2: the second Sobol dimension, bit-reversed, without a loop.
uint pascal(uint v) {
    v ^= (v & 0xaaaaaaaau) >> 1u;
    v ^= (v & 0xccccccccu) >> 2u;
    v ^= (v & 0xf0f0f0f0u) >> 4u;
    v ^= (v & 0xff00ff00u) >> 8u;
    return v ^ (v >> 16u);
}

// One padded dimension pair: point `shuffled index` of the Owen-scrambled (0,2)-sequence. `reversed` is the sample's index, bits reversed.
uvec2 owen_sobol(uint reversed, uvec3 seed) {
    uint index = bitfieldReverse(laine_karras(reversed, seed.x));
    return uvec2(bitfieldReverse(laine_karras(index, seed.y)), bitfieldReverse(laine_karras(pascal(index), seed.z)));
}

const uint SAMPLER_PCG = 0u;
const uint SAMPLER_SOBOL = 1u;

// The stream of one pixel.
uvec2 pixel_key(uvec2 pixel, uint seed) { return pcg4d(uvec4(pixel, seed, 0x6c696d70u)).xy; }

// Four numbers of one sample at one dimension: two well-stratified pairs.
vec4 random4(uint sampler_kind, uvec2 key, uint sample_index, uint dimension) {
    if (sampler_kind == SAMPLER_PCG) return to_unit(pcg4d(uvec4(key, sample_index, dimension)));
    uvec4 a = pcg4d(uvec4(key, dimension, 0x736f626fu));
    uvec3 b = (a.wxy ^ (a.zwx >> 15u)) * 0x7feb352du;
    uint reversed = bitfieldReverse(sample_index);
    return to_unit(uvec4(owen_sobol(reversed, a.xyz), owen_sobol(reversed, b ^ (b >> 16u))));
}

// One more number of the same sample and dimension, for choosing a light.
float random1(uint sampler_kind, uvec2 key, uint sample_index, uint dimension) {
    if (sampler_kind == SAMPLER_PCG) return to_unit(pcg4d(uvec4(key.yx, sample_index, dimension ^ 0x80000000u)).xy).x;
    uvec4 a = pcg4d(uvec4(key.yx, dimension, 0x6c696768u));
    return to_unit(owen_sobol(bitfieldReverse(sample_index), a.xyz)).x;
}

#endif
