//! The learning rate: a linear rise over the first steps, which do not depend on the run's length, then half a cosine.

/// Steps of the rise.
pub const WARM_UP: u64 = 50;
/// The last step's rate, relative to the largest.
const FLOOR: f64 = 0.01;

/// The rate of step `step` (from 0) relative to the largest; `progress` is the share of the run that is done, 0 to 1.
#[must_use]
pub fn rate(step: u64, progress: f64) -> f64 {
    if step < WARM_UP {
        return (step + 1) as f64 / WARM_UP as f64;
    }
    let cosine = 0.5 * (1.0 + (std::f64::consts::PI * progress.clamp(0.0, 1.0)).cos());
    FLOOR + (1.0 - FLOOR) * cosine
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rises_then_falls_to_the_floor() {
        assert_eq!(rate(0, 0.0), 0.02);
        assert_eq!(rate(WARM_UP - 1, 0.5), 1.0);
        assert_eq!(rate(WARM_UP, 0.0), 1.0);
        assert!((rate(1000, 0.5) - 0.505).abs() < 1e-12);
        assert!((rate(1000, 2.0) - FLOOR).abs() < 1e-12);
    }
}
