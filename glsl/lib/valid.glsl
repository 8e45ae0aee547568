// What is no usable number: by comparisons of bits, which no compiler folds away.
#ifndef LIMPID_VALID_GLSL
#define LIMPID_VALID_GLSL

// A component is NaN or infinite.
bool not_finite(vec3 x) {
    return any(greaterThanEqual(floatBitsToUint(x) & 0x7fffffffu, uvec3(0x7f800000u)));
}

// A component is NaN, infinite or negative; -0 is not.
bool invalid_radiance(vec3 x) {
    const uvec3 bits = floatBitsToUint(x);
    return any(greaterThanEqual(mix(bits, uvec3(0u), equal(bits, uvec3(0x80000000u))), uvec3(0x7f800000u)));
}

#endif
