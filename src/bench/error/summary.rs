//! Figures over the runs of an error benchmark.

use super::{Outcome, Run, Technique};
use serde::Serialize;

/// A mean error is told only where it is at least this many times the reference's own noise.
pub const FLOOR_FACTOR: f64 = 10.0;
/// Seconds of device time at which techniques are compared.
pub const EQUAL_TIMES: [f64; 3] = [0.1, 1.0, 10.0];

/// All runs of one technique at one number of samples.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Point {
    /// Samples a pixel.
    pub spp: u32,
    /// Runs.
    pub runs: usize,
    /// Mean relMSE; none where it is within [`FLOOR_FACTOR`] of the reference's noise.
    pub relmse: Option<f64>,
    /// Half the width of the mean's 95 % confidence interval; none with one run.
    pub confidence: Option<f64>,
    /// Median device time, milliseconds.
    pub device_ms: f64,
    /// Median time by the clock, milliseconds.
    pub wall_ms: f64,
    /// Rays a second of device time.
    pub rays_per_second: f64,
    /// relMSE x seconds of device time: smaller is better.
    pub error_seconds: Option<f64>,
}

/// One technique, reconstructed or not.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Line {
    /// The technique.
    #[serde(flatten)]
    pub technique: Technique,
    /// Whether the pictures are reconstructed.
    pub reconstructed: bool,
    /// By samples.
    pub points: Vec<Point>,
    /// By what power of the samples relMSE goes (least squares over logarithms); none with one point.
    pub slope: Option<f64>,
    /// relMSE after each of [`EQUAL_TIMES`], on the straight line between the logarithms of the two points beside it; none outside the points.
    pub equal_time: [Option<f64>; EQUAL_TIMES.len()],
}

/// Everything.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// The reference's own noise, as relMSE.
    pub reference_noise: f64,
    /// By technique.
    pub lines: Vec<Line>,
}

/// Mean and half-width of its 95 % confidence interval (Student's t).
fn mean(values: &[f64]) -> (f64, Option<f64>) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let deviation = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
    let confidence = (values.len() > 1).then(|| student_975(n - 1.0) * (deviation / (n - 1.0) / n).sqrt());
    (mean, confidence)
}

/// The 97.5 % quantile of Student's t: exact for one and two degrees of freedom, else Cornish and Fisher's expansion, which
/// errs by less than 1 %.
fn student_975(freedom: f64) -> f64 {
    const Z: f64 = 1.959_963_984_540_054;
    match freedom as u32 {
        0 | 1 => 12.706_204_736_432_1,
        2 => 4.302_652_729_911_27,
        _ => {
            let z2 = Z * Z;
            let terms = [
                (z2 + 1.0) / 4.0,
                ((5.0 * z2 + 16.0) * z2 + 3.0) / 96.0,
                (((3.0 * z2 + 19.0) * z2 + 17.0) * z2 - 15.0) / 384.0,
                ((((79.0 * z2 + 776.0) * z2 + 1482.0) * z2 - 1920.0) * z2 - 945.0) / 92160.0,
            ];
            let powers = (1..).map(|k| freedom.powi(k));
            Z + Z * terms.into_iter().zip(powers).map(|(term, power)| term / power).sum::<f64>()
        }
    }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn point(spp: u32, runs: &[(&Run, Outcome)], noise: f64) -> Point {
    let (error, confidence) = mean(&runs.iter().map(|(_, outcome)| outcome.relmse).collect::<Vec<_>>());
    let relmse = (error >= FLOOR_FACTOR * noise).then_some(error);
    let device_ms = median(runs.iter().map(|(_, outcome)| outcome.device_ms));
    Point {
        spp,
        runs: runs.len(),
        relmse,
        confidence: confidence.filter(|_| relmse.is_some()),
        device_ms,
        wall_ms: median(runs.iter().map(|(_, outcome)| outcome.wall_ms)),
        rays_per_second: median(runs.iter().map(|(run, _)| run.rays as f64 / (run.noisy.device_ms * 1e-3))),
        error_seconds: relmse.map(|error| error * device_ms * 1e-3),
    }
}

/// The exponent of the power law nearest to the points in logarithms; none for less than two.
fn slope(points: &[(f64, f64)]) -> Option<f64> {
    let n = points.len() as f64;
    let logs = || points.iter().map(|(x, y)| (x.ln(), y.ln()));
    let (x, y) = logs().fold((0.0, 0.0), |(a, b), (x, y)| (a + x / n, b + y / n));
    let spread: f64 = logs().map(|(px, _)| (px - x).powi(2)).sum();
    (points.len() > 1 && spread > 0.0).then(|| logs().map(|(px, py)| (px - x) * (py - y)).sum::<f64>() / spread)
}

/// The value at `x`, on the straight line between the logarithms of the points on both sides.
fn interpolated(points: &[(f64, f64)], x: f64) -> Option<f64> {
    points.windows(2).find_map(|pair| {
        let [(x0, y0), (x1, y1)] = [pair[0], pair[1]];
        let share = (x / x0).ln() / (x1 / x0).ln();
        (x0 <= x && x <= x1 && x0 < x1).then(|| (y0.ln() * (1.0 - share) + y1.ln() * share).exp())
    })
}

/// The figures of what was run so far; `noise` is that of the reference, as relMSE.
#[must_use]
pub fn summarize(runs: &[Run], noise: f64) -> Summary {
    let mut lines = Vec::new();
    for reconstructed in [false, true] {
        for technique in Technique::all() {
            let outcome = |run: &Run| if reconstructed { run.reconstructed } else { Some(run.noisy) };
            let of: Vec<(&Run, Outcome)> = runs
                .iter()
                .filter(|run| run.key.technique == technique)
                .filter_map(|run| outcome(run).map(|outcome| (run, outcome)))
                .collect();
            let mut samples: Vec<u32> = of.iter().map(|(run, _)| run.key.spp).collect();
            samples.sort_unstable();
            samples.dedup();
            let at = |spp: &u32| of.iter().filter(|(run, _)| run.key.spp == *spp).copied().collect::<Vec<_>>();
            let points: Vec<Point> = samples.iter().map(|spp| point(*spp, &at(spp), noise)).collect();
            if points.is_empty() {
                continue;
            }
            let along = |x: fn(&Point) -> f64| -> Vec<(f64, f64)> {
                points.iter().filter_map(|p| p.relmse.map(|error| (x(p), error))).collect()
            };
            let by_time = along(|p| p.device_ms * 1e-3);
            lines.push(Line {
                technique,
                reconstructed,
                slope: slope(&along(|p| f64::from(p.spp))),
                equal_time: EQUAL_TIMES.map(|seconds| interpolated(&by_time, seconds)),
                points,
            });
        }
    }
    Summary { reference_noise: noise, lines }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::error::Key;

    /// From tables of the distribution.
    #[test]
    fn quantiles_of_students_t() {
        for (freedom, expected) in [
            (1.0, 12.7062),
            (2.0, 4.30265),
            (3.0, 3.18245),
            (4.0, 2.77645),
            (9.0, 2.26216),
            (15.0, 2.13145),
            (30.0, 2.04227),
        ] {
            let found = student_975(freedom);
            assert!((found / expected - 1.0).abs() < 0.01, "{freedom}: {found}");
        }
    }

    fn run(spp: u32, seed: u32, relmse: f64, device_ms: f64) -> Run {
        let key = Key { technique: super::super::REFERENCE, spp, seed };
        Run { key, rays: 1000, noisy: Outcome { relmse, device_ms, wall_ms: 2.0 * device_ms }, reconstructed: None }
    }

    /// relMSE = 1 / spp, a second for ten samples.
    #[test]
    fn figures_of_a_power_law() {
        let runs: Vec<Run> = [4, 16, 64]
            .into_iter()
            .flat_map(|spp| [0.5, 1.0, 1.5].map(|f| run(spp, 0, f / f64::from(spp), f64::from(spp) * 100.0)))
            .collect();
        let summary = summarize(&runs, 1.0 / 640.0);
        let [line] = &summary.lines[..] else { panic!("one technique, none reconstructed") };
        assert!((line.slope.unwrap() + 1.0).abs() < 1e-12);
        // 0.1 s is one sample: before the first point. 1 s is ten, 10 s are a hundred: past the last point.
        assert_eq!([line.equal_time[0], line.equal_time[2]], [None, None]);
        assert!((line.equal_time[1].unwrap() - 0.1).abs() < 1e-12);
        let p = &line.points[0];
        assert_eq!((p.spp, p.runs, p.device_ms, p.wall_ms), (4, 3, 400.0, 800.0));
        assert!((p.relmse.unwrap() - 0.25).abs() < 1e-12);
        // Deviation 0.125, t of two degrees of freedom.
        assert!((p.confidence.unwrap() - 4.302_652_7 * 0.125 / 3f64.sqrt()).abs() < 1e-7);
        assert!((p.error_seconds.unwrap() - 0.1).abs() < 1e-12);
        assert!((p.rays_per_second - 2500.0).abs() < 1e-9);
    }

    #[test]
    fn errors_near_the_references_noise_are_not_told() {
        let runs = [run(4, 0, 0.1, 1.0), run(16, 0, 0.0099, 4.0), run(4, 1, 0.1, 1.0)];
        let summary = summarize(&runs, 0.001);
        let line = &summary.lines[0];
        assert_eq!((line.points[0].relmse, line.points[0].confidence), (Some(0.1), Some(0.0)));
        assert_eq!((line.points[1].relmse, line.points[1].confidence), (None, None));
        assert_eq!((line.points[1].error_seconds, line.slope, line.equal_time), (None, None, [None; 3]));
    }
}
