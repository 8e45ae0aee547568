//! Random numbers and sampled directions, taken from the device.

use super::support::mean_error;
use super::{Case, Checks, Outcome};
use crate::gpu::Gpu;
use crate::shaders::sampling_probe;
use crate::{Result, push_block};
use glam::DVec3;

push_block! {
    /// Push constants of `sampling_probe`.
    pub struct Push for crate::shaders::sampling_probe {
        count: u32, kind: u32, sampler_kind: u32, per_pixel: u32, seed: u32, dimension: u32, nx: f32, ny: f32, nz: f32, cone: f32
    }
}

pub(super) const CASES: &[Case] = &[
    Case {
        number: "T16",
        name: "densities of directions",
        claim: "directions on sphere, hemisphere, cosine lobe and cones have the density claimed: chi^2 on 5,151 cells, and moments",
        run: directions_have_their_density,
    },
    Case {
        number: "T17",
        name: "uniform numbers",
        claim: "numbers lie in [0, 1 - 2^-24], are even in pairs, and pixels, dimensions and seeds do not correlate",
        run: numbers_are_uniform_and_independent,
    },
    Case {
        number: "T18",
        name: "Sobol nets",
        claim: "the first 2^k points of a pair put one into every dyadic interval of area 2^-k, and integrate faster than chance",
        run: sobol_points,
    },
];

const PCG: u32 = 0;
const SOBOL: u32 = 1;
const NUMBERS: u32 = 0;
const SPHERE: u32 = 1;
const HEMISPHERE: u32 = 2;
const COSINE: u32 = 3;
const CONE: u32 = 4;
const CHOICE: u32 = 5;
const CONES: u32 = 6;
const MILLION: u32 = 1_000_000;
/// Standard deviations that a statistic of a million samples may be off.
const DEVIATIONS: f64 = 5.0;

fn probe(gpu: &Gpu, push: Push) -> Result<Vec<[f32; 4]>> {
    let kernel = gpu.kernel::<sampling_probe::Shader>(&sampling_probe::Spec {})?;
    let values = gpu.buffer("values", u64::from(push.count) * 16)?;
    let mut rec = gpu.recorder();
    let bind = sampling_probe::Bind { values: values.slice(0, u64::from(push.count) * 16) };
    rec.dispatch(&kernel, &bind, &push, [push.count.div_ceil(64), 1, 1]);
    rec.finish()?.run()?;
    gpu.download(&bind.values)
}

fn push(kind: u32, sampler_kind: u32, per_pixel: u32) -> Push {
    Push { count: MILLION, kind, sampler_kind, per_pixel, seed: 7, dimension: 3, nx: 0.0, ny: 0.0, nz: 1.0, cone: 0.0 }
}

/// Squares of radius over distance from 1e-14 to 1, and 1 - cos of the cone that the device finds for each.
pub(super) fn cones(gpu: &Gpu) -> Result<Vec<[f32; 2]>> {
    let values = probe(gpu, Push { count: 1 << 16, ..push(CONES, PCG, 1) })?;
    Ok(values.into_iter().map(|v| [v[0], v[1]]).filter(|v| v[0] > 0.0).collect())
}

/// chi^2 over cells of equal probability, in standard deviations from its mean (nearly normal with so many cells).
fn chi2(cells: &[u32]) -> f64 {
    let n: f64 = cells.iter().map(|&c| f64::from(c)).sum();
    let expected = n / cells.len() as f64;
    let freedom = cells.len() as f64 - 1.0;
    let sum: f64 = cells.iter().map(|&c| (f64::from(c) - expected).powi(2) / expected).sum();
    (sum - freedom) / (2.0 * freedom).sqrt()
}

const ROWS: usize = 51;
const COLUMNS: usize = 101;

/// Counts of (a, b) in [0,1]^2.
fn grid(pairs: impl Iterator<Item = (f64, f64)>) -> Vec<u32> {
    let mut cells = vec![0; ROWS * COLUMNS];
    for (a, b) in pairs {
        let row = ((a * ROWS as f64) as usize).min(ROWS - 1);
        let column = ((b * COLUMNS as f64) as usize).min(COLUMNS - 1);
        cells[row * COLUMNS + column] += 1;
    }
    cells
}

fn vector(v: &[f32; 4]) -> DVec3 {
    DVec3::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2]))
}

/// Turn about the normal, 0 to 1.
fn turn(d: DVec3, (u, v): (DVec3, DVec3)) -> f64 {
    d.dot(v).atan2(d.dot(u)) / std::f64::consts::TAU + 0.5
}

const NORMALS: [[f64; 3]; 3] = [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [-0.48, 0.6, -0.64]];

fn directions_have_their_density(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    for sampler in [PCG, SOBOL] {
        for n in NORMALS.map(DVec3::from_array) {
            for (kind, cone) in
                [(SPHERE, 0.0), (HEMISPHERE, 0.0), (COSINE, 0.0), (CONE, 0.9), (CONE, 1e-3), (CONE, 1e-9)]
            {
                let (x, y, z) = n.as_vec3().into();
                let values = probe(gpu, Push { nx: x, ny: y, nz: z, cone: cone as f32, ..push(kind, sampler, 1) })?;
                let at = format!("kind {kind}, sampler {sampler}, normal {n}, cone {cone}");
                check_density(&mut checks, &values, n, (kind, cone), &at);
            }
        }
    }
    Ok(checks.outcome())
}

fn check_density(checks: &mut Checks, values: &[[f32; 4]], n: DVec3, (kind, cone): (u32, f64), at: &str) {
    let axes = n.any_orthonormal_pair();
    let cosine = |v: &[f32; 4]| vector(v).dot(n);
    // The variable that is uniform in [0, 1) for this density.
    let uniform = |v: &[f32; 4]| match kind {
        SPHERE => 0.5 - 0.5 * cosine(v),
        HEMISPHERE => cosine(v),
        COSINE => cosine(v).powi(2),
        _ => f64::from(v[3]) / cone,
    };
    // In the narrowest cone the turn is lost in the roundings of the vector.
    if cone != 1e-9 {
        let cells = grid(values.iter().map(|v| (uniform(v), turn(vector(v), axes))));
        checks.at_most("chi^2 of directions, sigmas", chi2(&cells).abs(), 4.5, at);
    }
    let longest = values.iter().map(|v| (vector(v).length() - 1.0).abs()).fold(0.0, f64::max);
    checks.at_most("length of a direction, off 1", longest, 1e-6, at);
    let mean = values.iter().map(uniform).sum::<f64>() / f64::from(MILLION);
    let sigma = (1.0 / 12.0f64).sqrt() / f64::from(MILLION).sqrt();
    checks.at_most("mean of the uniform variable, sigmas", (mean - 0.5).abs() / sigma, DEVIATIONS, at);
    if kind == COSINE {
        cosine_moments(checks, values, n, at);
    }
    if kind == CONE {
        // The direction has the cosine that is reported with it, to the roundings of the vector.
        let worst = values.iter().map(|v| (1.0 - cosine(v) - f64::from(v[3])).abs()).fold(0.0, f64::max);
        checks.at_most("cosine and the one reported", worst, 5e-7, at);
    }
}

fn cosine_moments(checks: &mut Checks, values: &[[f32; 4]], n: DVec3, at: &str) {
    let (u, v) = n.any_orthonormal_pair();
    let cases: [(&dyn Fn(DVec3) -> f64, f64); 5] = [
        (&|d| d.dot(n), 2.0 / 3.0),
        (&|d| d.dot(n).powi(2), 0.5),
        (&|d| d.dot(u).powi(2), 0.25),
        (&|d| d.dot(v).powi(2), 0.25),
        (&|d| d.dot(u) * d.dot(v), 0.0),
    ];
    for (f, expected) in cases {
        let (mean, error) = mean_error(&values.iter().map(|d| f(vector(d))).collect::<Vec<_>>());
        checks.at_most("moment of the cosine lobe, sigmas", (mean - expected).abs() / error, DEVIATIONS, at);
    }
    let lowest = values.iter().map(|d| -vector(d).dot(n)).fold(f64::MIN, f64::max);
    checks.at_most("depth below the horizon", lowest, 1e-6, at);
}

fn numbers_are_uniform_and_independent(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    for sampler in [PCG, SOBOL] {
        for per_pixel in [1, 16, MILLION] {
            let values = probe(gpu, push(NUMBERS, sampler, per_pixel))?;
            let at = format!("sampler {sampler}, {per_pixel} samples a pixel");
            let largest = 1.0 - 2f32.powi(-24);
            let outside = values.iter().flatten().filter(|u| !(0.0..=largest).contains(*u)).count();
            checks.none("numbers outside [0, 1 - 2^-24]", outside, &at);
            for (a, b) in [(0, 1), (2, 3), (0, 2), (1, 3), (0, 3), (1, 2)] {
                let z = chi2(&grid(values.iter().map(|v| (f64::from(v[a]), f64::from(v[b])))));
                checks.at_most("chi^2 of pairs, sigmas", z, 4.5, format_args!("{at}, {a}{b}"));
                // Well-spread points are more even than chance; never independent ones.
                if per_pixel == 1 || sampler == PCG {
                    checks.at_least("chi^2 of independent pairs, sigmas", z, -4.5, format_args!("{at}, {a}{b}"));
                }
            }
        }
        check_correlations(&mut checks, gpu, sampler)?;
    }
    Ok(checks.outcome())
}

/// One sample a pixel: x neighbours, y neighbours (1024 pixels a row), other dimensions, other seeds.
fn check_correlations(checks: &mut Checks, gpu: &Gpu, sampler: u32) -> Result<()> {
    let base = push(NUMBERS, sampler, 1);
    let values = probe(gpu, base)?;
    let mut same = |other: &[[f32; 4]], lag: usize, what: &str| {
        for (a, b) in [(0, 0), (1, 1), (0, 1), (2, 3)] {
            let pairs = values.iter().skip(lag).zip(other);
            let sum: f64 = pairs.clone().map(|(x, y)| (f64::from(x[a]) - 0.5) * (f64::from(y[b]) - 0.5)).sum();
            let r = 12.0 * sum / pairs.count() as f64 * f64::from(MILLION).sqrt();
            // 4 for one pair; there are 40, so 1.2 times as much.
            checks.at_most("correlation, sigmas", r.abs(), 4.8, format_args!("sampler {sampler}, {what}, {a}{b}"));
        }
    };
    same(&values, 1, "x neighbours");
    same(&values, 1024, "y neighbours");
    same(&probe(gpu, Push { dimension: 4, ..base })?, 0, "dimensions");
    same(&probe(gpu, Push { seed: 8, ..base })?, 0, "seeds");
    same(&probe(gpu, Push { kind: CHOICE, ..base })?, 0, "the choice of a light");
    Ok(())
}

fn sobol_points(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let per_pixel = 1024;
    for dimension in [0, 1, 9] {
        let values = probe(gpu, Push { count: 8 * per_pixel, dimension, ..push(NUMBERS, SOBOL, per_pixel) })?;
        for points in values.chunks(per_pixel as usize) {
            for pair in [0, 2] {
                check_net(&mut checks, points, pair, dimension);
            }
        }
    }
    // The error of the integral of x*y falls with about N^-1.5 (independent points: N^-0.5).
    let rms = |sampler: u32, points: u32| {
        let values = probe(gpu, Push { count: 1024 * points, ..push(NUMBERS, sampler, points) })?;
        let square = |chunk: &[[f32; 4]]| {
            let mean = chunk.iter().map(|v| f64::from(v[0]) * f64::from(v[1])).sum::<f64>() / chunk.len() as f64;
            (mean - 0.25).powi(2)
        };
        Ok((values.chunks(points as usize).map(square).sum::<f64>() / 1024.0).sqrt())
    };
    let slope = |sampler| -> Result<f64> { Ok((rms(sampler, 1024)? / rms(sampler, 16)?).log2() / 6.0) };
    checks.at_most("slope of pcg, off -0.5", (slope(PCG)? + 0.5).abs(), 0.05, "16 to 1024 points");
    checks.at_most("slope of sobol", slope(SOBOL)?, -1.3, "16 to 1024 points");
    Ok(checks.outcome())
}

/// Every elementary interval of area 2^-k has one of the first 2^k points.
fn check_net(checks: &mut Checks, points: &[[f32; 4]], pair: usize, dimension: u32) {
    for k in 0..=10u32 {
        for split in 0..=k {
            let mut seen = vec![0u32; 1 << k];
            for v in &points[..1 << k] {
                let x = (v[pair] * (1u32 << split) as f32) as usize;
                let y = (v[pair + 1] * (1u32 << (k - split)) as f32) as usize;
                seen[x << (k - split) | y] += 1;
            }
            let wrong = seen.iter().filter(|&&c| c != 1).count();
            let at = format_args!("dimension {dimension}, 2^{k} points, {split} splits of x, pair {pair}");
            checks.none("intervals without just one point", wrong, at);
        }
    }
}
