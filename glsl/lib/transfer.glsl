// Transfers of radiance to the network's space, and back. Not a number, negative and infinite radiance become finite.
const float MAX_EXPOSED = 1e30;
const float MAX_FLOAT = 3.402823e38;

// `log1p`: t = ln(1 + x) of exposed radiance x. ln(1 + x) and exp(t) - 1 cancel for small arguments; below this, four terms
// of their series are exact to f32.
const float SMALL = 1.0 / 64.0;

vec3 log1p_forward(vec3 x) {
    vec3 series = x * (1.0 - x * (0.5 - x * (1.0 / 3.0 - 0.25 * x)));
    return mix(log(1.0 + x), series, lessThan(x, vec3(SMALL)));
}

vec3 log1p_inverse(vec3 t) {
    t = min(t, 69.0);
    vec3 series = t * (1.0 + t * (0.5 + t * (1.0 / 6.0 + t * (1.0 / 24.0))));
    return mix(exp(t) - 1.0, series, lessThan(t, vec3(SMALL)));
}

// `pu`: Open Image Denoise's fit of the perceptually uniform curve of Aydin et al. 2008: linear, a power, a logarithm, divided by
// its value at 65504.
const float PU_SLOPE = 1.41283765e+03;
const float PU_POWER_SCALE = 1.64593172;
const float PU_POWER = 4.31384981e-01;
const float PU_POWER_OFFSET = -2.94139609e-03;
const float PU_LOG_SCALE = 1.92653254e-01;
const float PU_LOG_SHIFT = 6.26026094e-03;
const float PU_LOG_OFFSET = 9.98620152e-01;
const float PU_LINEAR_END = 1.57945760e-06;      // exposed radiance up to which it is linear
const float PU_LINEAR_END_T = 2.23151711e-03;    // the curve there
const float PU_POWER_END = 3.22087631e-02;       // up to which it is a power
const float PU_POWER_END_T = 3.70974749e-01;
const float PU_AT_65504 = 3.13511904;

vec3 pu_forward(vec3 x) {
    const vec3 power = PU_POWER_SCALE * pow(x, vec3(PU_POWER)) + PU_POWER_OFFSET;
    const vec3 logarithm = PU_LOG_SCALE * log(x + PU_LOG_SHIFT) + PU_LOG_OFFSET;
    const vec3 t = mix(logarithm, power, lessThanEqual(x, vec3(PU_POWER_END)));
    return mix(t, PU_SLOPE * x, lessThanEqual(x, vec3(PU_LINEAR_END))) / PU_AT_65504;
}

// Its slope, that of the darker side where two parts meet.
vec3 pu_derivative(vec3 x) {
    const vec3 power = PU_POWER_SCALE * PU_POWER * pow(max(x, vec3(PU_LINEAR_END)), vec3(PU_POWER - 1.0));
    const vec3 logarithm = PU_LOG_SCALE / (x + PU_LOG_SHIFT);
    const vec3 slope = mix(logarithm, power, lessThanEqual(x, vec3(PU_POWER_END)));
    return mix(slope, vec3(PU_SLOPE), lessThanEqual(x, vec3(PU_LINEAR_END))) / PU_AT_65504;
}

vec3 pu_inverse(vec3 t) {
    t = min(t * PU_AT_65504, PU_LOG_OFFSET + 69.0 * PU_LOG_SCALE);
    const vec3 power = pow((t - PU_POWER_OFFSET) / PU_POWER_SCALE, vec3(1.0 / PU_POWER));
    const vec3 logarithm = exp((t - PU_LOG_OFFSET) / PU_LOG_SCALE) - PU_LOG_SHIFT;
    const vec3 x = mix(logarithm, power, lessThanEqual(t, vec3(PU_POWER_END_T)));
    return mix(x, t / PU_SLOPE, lessThanEqual(t, vec3(PU_LINEAR_END_T)));
}

vec3 to_network(uint transfer, vec3 radiance, float exposure) {
    vec3 x = exposure * radiance;
    x = mix(vec3(0.0), min(x, MAX_EXPOSED), greaterThan(x, vec3(0.0)));  // false for NaN
    switch (transfer) {
        case TRANSFER_LOG1P: return log1p_forward(x);
        case TRANSFER_PU: return pu_forward(x);
        default: return vec3(0.0 / 0.0);
    }
}

vec3 from_network(uint transfer, vec3 t, float exposure) {
    t = mix(vec3(0.0), t, greaterThan(t, vec3(0.0)));
    switch (transfer) {
        case TRANSFER_LOG1P: return min(log1p_inverse(t) / exposure, MAX_FLOAT);
        case TRANSFER_PU: return min(pu_inverse(t) / exposure, MAX_FLOAT);
        default: return vec3(0.0 / 0.0);
    }
}

// Where a transfer wants the geometric mean of a frame's luminance.
float transfer_key(uint transfer) {
    switch (transfer) {
        case TRANSFER_LOG1P: return 0.5;
        case TRANSFER_PU: return 0.18;
        default: return 0.0 / 0.0;
    }
}
