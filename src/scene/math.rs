//! Angles that come out the same on every machine: only IEEE-exact operations, no libm.

/// Sine and cosine of an angle in degrees. Multiples of 90 give exactly 0, 1 or -1; elsewhere the error is below 1e-15
/// for angles up to some turns. The same bits on every platform, so that a scene drawn from a number never changes.
pub fn sin_cos_degrees(degrees: f64) -> (f64, f64) {
    let quarter = (degrees / 90.0).round();
    let x = (degrees - quarter * 90.0) * (std::f64::consts::PI / 180.0);
    let x2 = x * x;
    // Taylor series in Horner form: |x| <= pi/4, so the first term left out is below 1e-18.
    let (mut sin, mut cos) = (1.0, 1.0);
    for k in (1..=9).rev() {
        let k = 2.0 * k as f64;
        sin = 1.0 - x2 / (k * (k + 1.0)) * sin;
        cos = 1.0 - x2 / (k * (k - 1.0)) * cos;
    }
    sin *= x;
    match quarter.rem_euclid(4.0) as u8 {
        0 => (sin, cos),
        1 => (cos, 0.0 - sin),
        2 => (0.0 - sin, 0.0 - cos),
        _ => (0.0 - cos, sin),
    }
}

/// `v` with a negative zero made positive, so that equal scenes have equal bits.
pub fn positive_zero(v: f64) -> f64 {
    v + 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_and_cosine_are_those_of_libm() {
        for i in -2000..2000 {
            let degrees = i as f64 * 0.37;
            let (s, c) = sin_cos_degrees(degrees);
            let (es, ec) = degrees.to_radians().sin_cos();
            // to_radians rounds an angle of up to 13 rad to 1e-15; the rest is two roundings of values up to 1.
            assert!((s - es).abs() < 3e-15 && (c - ec).abs() < 3e-15, "{degrees}: {s} {es} {c} {ec}");
        }
    }

    #[test]
    fn quarter_turns_are_exact() {
        let expected = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)];
        for turn in -8..8i32 {
            assert_eq!(sin_cos_degrees(90.0 * turn as f64), expected[turn.rem_euclid(4) as usize]);
        }
    }
}
