// Transfer `log1p`: t = ln(1 + exposure * radiance), and back. Not a number, negative and infinite radiance become finite.
const float MAX_EXPOSED = 1e30;

vec3 to_network(vec3 radiance, float exposure) {
    vec3 x = exposure * radiance;
    x = mix(vec3(0.0), min(x, MAX_EXPOSED), greaterThan(x, vec3(0.0)));  // false for NaN
    // ln(1 + x) cancels for small x.
    return mix(log(1.0 + x), x - 0.5 * x * x, lessThan(x, vec3(1e-3)));
}

vec3 from_network(vec3 t, float exposure) {
    t = mix(vec3(0.0), min(t, 69.0), greaterThan(t, vec3(0.0)));
    return mix(exp(t) - 1.0, t + 0.5 * t * t, lessThan(t, vec3(1e-3))) / exposure;
}
