// 8 channels in 16 bytes as f16, the form in which matrices are loaded; needs GL_EXT_shader_explicit_arithmetic_types_float16.
const float MAX_HALF = 65504.0;

// Into the range of f16; NaN stays NaN.
vec4 in_half_range(vec4 v) {
    v = mix(v, vec4(MAX_HALF), greaterThan(v, vec4(MAX_HALF)));
    return mix(v, vec4(-MAX_HALF), lessThan(v, vec4(-MAX_HALF)));
}

uvec4 to_halves(vec4 a, vec4 b) {
    const f16vec4 p = f16vec4(a);
    const f16vec4 q = f16vec4(b);
    return uvec4(packFloat2x16(p.xy), packFloat2x16(p.zw), packFloat2x16(q.xy), packFloat2x16(q.zw));
}
