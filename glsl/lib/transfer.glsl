// Transfer `log1p`: t = ln(1 + exposure * radiance), and back. Not a number, negative and infinite radiance become finite.
const float MAX_EXPOSED = 1e30;
// ln(1 + x) and exp(t) - 1 cancel for small arguments; below this, four terms of their series are exact to f32.
const float SMALL = 1.0 / 64.0;

vec3 to_network(vec3 radiance, float exposure) {
    vec3 x = exposure * radiance;
    x = mix(vec3(0.0), min(x, MAX_EXPOSED), greaterThan(x, vec3(0.0)));  // false for NaN
    vec3 series = x * (1.0 - x * (0.5 - x * (1.0 / 3.0 - 0.25 * x)));
    return mix(log(1.0 + x), series, lessThan(x, vec3(SMALL)));
}

vec3 from_network(vec3 t, float exposure) {
    t = mix(vec3(0.0), min(t, 69.0), greaterThan(t, vec3(0.0)));
    vec3 series = t * (1.0 + t * (0.5 + t * (1.0 / 6.0 + t * (1.0 / 24.0))));
    return mix(exp(t) - 1.0, series, lessThan(t, vec3(SMALL))) / exposure;
}
