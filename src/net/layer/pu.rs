//! The transfer `pu` in f64, as `glsl/lib/transfer.glsl` has it for exposed radiance.

const SLOPE: f64 = 1.41283765e+03;
const POWER_SCALE: f64 = 1.64593172;
const POWER: f64 = 4.31384981e-01;
const POWER_OFFSET: f64 = -2.94139609e-03;
const LOG_SCALE: f64 = 1.92653254e-01;
const LOG_SHIFT: f64 = 6.26026094e-03;
const LOG_OFFSET: f64 = 9.98620152e-01;
const LINEAR_END: f64 = 1.57945760e-06;
const POWER_END: f64 = 3.22087631e-02;
const LINEAR_END_T: f64 = 2.23151711e-03;
const POWER_END_T: f64 = 3.70974749e-01;
const AT_65504: f64 = 3.13511904;

/// `pu` of exposed radiance.
pub fn forward(x: f64) -> f64 {
    let t = if x <= LINEAR_END {
        SLOPE * x.max(0.0)
    } else if x <= POWER_END {
        POWER_SCALE * x.powf(POWER) + POWER_OFFSET
    } else {
        LOG_SCALE * (x + LOG_SHIFT).ln() + LOG_OFFSET
    };
    t / AT_65504
}

/// The derivative of [`forward`], that of the darker side where two parts meet.
pub fn derivative(x: f64) -> f64 {
    let slope = if x <= LINEAR_END {
        SLOPE
    } else if x <= POWER_END {
        POWER_SCALE * POWER * x.powf(POWER - 1.0)
    } else {
        LOG_SCALE / (x + LOG_SHIFT)
    };
    slope / AT_65504
}

/// Exposed radiance of `t`.
pub fn inverse(t: f64) -> f64 {
    let t = t.max(0.0) * AT_65504;
    if t <= LINEAR_END_T {
        t / SLOPE
    } else if t <= POWER_END_T {
        ((t - POWER_OFFSET) / POWER_SCALE).powf(1.0 / POWER)
    } else {
        ((t.min(LOG_OFFSET + 69.0 * LOG_SCALE) - LOG_OFFSET) / LOG_SCALE).exp() - LOG_SHIFT
    }
}
