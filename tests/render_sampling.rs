//! Random numbers and sampled directions, taken from the device.

mod render_support;

use glam::DVec3;
use limpid::gpu::Gpu;
use limpid::shaders::sampling_probe;
use render_support::*;

limpid::push_block! {
    /// Push constants of `sampling_probe`.
    pub struct Push for limpid::shaders::sampling_probe {
        count: u32, kind: u32, sampler_kind: u32, per_pixel: u32, seed: u32, dimension: u32, nx: f32, ny: f32, nz: f32, cone: f32
    }
}

const PCG: u32 = 0;
const SOBOL: u32 = 1;
const NUMBERS: u32 = 0;
const SPHERE: u32 = 1;
const HEMISPHERE: u32 = 2;
const COSINE: u32 = 3;
const CONE: u32 = 4;
const CHOICE: u32 = 5;
const MILLION: u32 = 1_000_000;

fn probe(gpu: &Gpu, push: Push) -> Vec<[f32; 4]> {
    let kernel = gpu.kernel::<sampling_probe::Shader>(&sampling_probe::Spec {}).expect("kernel");
    let values = gpu.buffer("values", u64::from(push.count) * 16).expect("buffer");
    let mut rec = gpu.recorder();
    let bind = sampling_probe::Bind { values: values.slice(0, u64::from(push.count) * 16) };
    rec.dispatch(&kernel, &bind, &push, [push.count.div_ceil(64), 1, 1]);
    rec.finish().expect("commands").run().expect("run");
    gpu.download(&bind.values).expect("download")
}

fn push(kind: u32, sampler_kind: u32, per_pixel: u32) -> Push {
    Push { count: MILLION, kind, sampler_kind, per_pixel, seed: 7, dimension: 3, nx: 0.0, ny: 0.0, nz: 1.0, cone: 0.0 }
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
fn turn(d: DVec3, n: DVec3) -> f64 {
    let (u, v) = n.any_orthonormal_pair();
    d.dot(v).atan2(d.dot(u)) / std::f64::consts::TAU + 0.5
}

const NORMALS: [[f64; 3]; 3] = [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [-0.48, 0.6, -0.64]];

/// T16: sampled directions have the density claimed: chi^2 on 5,151 cells of equal probability (4.5 standard deviations),
/// and moments within 5 standard errors of a million samples.
#[test]
fn directions_have_their_density() {
    let gpu = device();
    for sampler in [PCG, SOBOL] {
        for n in NORMALS.map(DVec3::from_array) {
            for (kind, one_minus_cos) in
                [(SPHERE, 0.0), (HEMISPHERE, 0.0), (COSINE, 0.0), (CONE, 0.9), (CONE, 1e-3), (CONE, 1e-9)]
            {
                let normal = n.as_vec3();
                let p = Push {
                    nx: normal.x,
                    ny: normal.y,
                    nz: normal.z,
                    cone: one_minus_cos as f32,
                    ..push(kind, sampler, 1)
                };
                let values = probe(&gpu, p);
                let about = |v: &[f32; 4]| (vector(v).dot(n), turn(vector(v), n));
                // The variable that is uniform in [0, 1) for this density.
                let uniform = |v: &[f32; 4]| match kind {
                    SPHERE => 0.5 - 0.5 * about(v).0,
                    HEMISPHERE => about(v).0,
                    COSINE => about(v).0.powi(2),
                    _ => f64::from(v[3]) / one_minus_cos,
                };
                let what = format!("kind {kind} sampler {sampler} normal {n} cone {one_minus_cos}");
                let cells =
                    grid(values.iter().map(|v| (uniform(v), if one_minus_cos == 1e-9 { 0.5 } else { about(v).1 })));
                if one_minus_cos != 1e-9 {
                    assert!(chi2(&cells).abs() < 4.5, "{what}: chi2 {}", chi2(&cells));
                }
                assert!(values.iter().all(|v| (vector(v).length() - 1.0).abs() < 1e-6), "{what}: not unit");
                let mean = values.iter().map(uniform).sum::<f64>() / f64::from(MILLION);
                assert!((mean - 0.5).abs() < 5.0 * (1.0 / 12.0f64).sqrt() / 1e3, "{what}: mean {mean}");
                if kind == COSINE {
                    cosine_moments(&values, n, &what);
                }
                if kind == CONE {
                    // The direction has the cosine that is reported with it, to the roundings of the vector.
                    let worst = values.iter().map(|v| (1.0 - about(v).0 - f64::from(v[3])).abs()).fold(0.0, f64::max);
                    assert!(worst < 5e-7, "{what}: {worst}");
                }
            }
        }
    }
}

fn cosine_moments(values: &[[f32; 4]], n: DVec3, what: &str) {
    let (u, v) = n.any_orthonormal_pair();
    let moment = |f: &dyn Fn(DVec3) -> f64| mean_error(&values.iter().map(|d| f(vector(d))).collect::<Vec<_>>());
    let cases: [(&dyn Fn(DVec3) -> f64, f64); 5] = [
        (&|d| d.dot(n), 2.0 / 3.0),
        (&|d| d.dot(n).powi(2), 0.5),
        (&|d| d.dot(u).powi(2), 0.25),
        (&|d| d.dot(v).powi(2), 0.25),
        (&|d| d.dot(u) * d.dot(v), 0.0),
    ];
    for (f, expected) in cases {
        let (mean, error) = moment(f);
        assert!((mean - expected).abs() < 5.0 * error, "{what}: moment {mean} +- {error}, expected {expected}");
    }
    assert!(values.iter().all(|d| vector(d).dot(n) > -1e-6), "{what}: below the horizon");
}

/// T17: uniforms lie in [0, 1 - 2^-24], are uniform in pairs, and neighbouring pixels, samples and dimensions do not correlate.
#[test]
fn numbers_are_uniform_and_independent() {
    let gpu = device();
    for sampler in [PCG, SOBOL] {
        for per_pixel in [1, 16, MILLION] {
            let p = push(NUMBERS, sampler, per_pixel);
            let values = probe(&gpu, p);
            let largest = 1.0 - 2f32.powi(-24);
            assert!(values.iter().flatten().all(|&u| (0.0..=largest).contains(&u)));
            for (a, b) in [(0, 1), (2, 3), (0, 2), (1, 3), (0, 3), (1, 2)] {
                let z = chi2(&grid(values.iter().map(|v| (f64::from(v[a]), f64::from(v[b])))));
                // Well-spread points are more even than chance; never less.
                let even = sampler == SOBOL && per_pixel > 1 && (a, b).0 / 2 == (a, b).1 / 2;
                assert!(
                    z < 4.5 && (even || per_pixel > 1 && sampler == SOBOL || z > -4.5),
                    "{sampler} {per_pixel} {a}{b}: chi2 {z}"
                );
            }
        }
        // One sample a pixel: x neighbours, y neighbours (1024 pixels a row), other dimensions, other seeds.
        let base = push(NUMBERS, sampler, 1);
        let values = probe(&gpu, base);
        let limit = 4.0 / f64::from(MILLION).sqrt();
        let same = |other: &[[f32; 4]], lag: usize, what: &str| {
            for (a, b) in [(0, 0), (1, 1), (0, 1), (2, 3)] {
                let pairs = values.iter().skip(lag).zip(other);
                let sum: f64 = pairs.clone().map(|(x, y)| (f64::from(x[a]) - 0.5) * (f64::from(y[b]) - 0.5)).sum();
                let r = 12.0 * sum / pairs.count() as f64;
                assert!(r.abs() < limit * 1.2, "sampler {sampler} {what} {a}{b}: correlation {r}");
            }
        };
        same(&values, 1, "x neighbours");
        same(&values, 1024, "y neighbours");
        same(&probe(&gpu, Push { dimension: 4, ..base }), 0, "dimensions");
        same(&probe(&gpu, Push { seed: 8, ..base }), 0, "seeds");
        same(&probe(&gpu, Push { kind: CHOICE, ..base }), 0, "the choice of a light");
    }
}

/// T18: the first 2^k points of each pair put exactly one into every elementary interval of area 2^-k.
#[test]
fn sobol_pairs_are_nets() {
    let gpu = device();
    let per_pixel = 1024;
    for dimension in [0, 1, 9] {
        let p = Push { count: 8 * per_pixel, dimension, ..push(NUMBERS, SOBOL, per_pixel) };
        let values = probe(&gpu, p);
        for points in values.chunks(per_pixel as usize) {
            for pair in [0, 2] {
                for k in 0..=10u32 {
                    for split in 0..=k {
                        let mut seen = vec![0u32; 1 << k];
                        for v in &points[..1 << k] {
                            let x = (v[pair] * (1u32 << split) as f32) as usize;
                            let y = (v[pair + 1] * (1u32 << (k - split)) as f32) as usize;
                            seen[x << (k - split) | y] += 1;
                        }
                        assert!(seen.iter().all(|&c| c == 1), "2^{k} points, {split} splits of x, pair {pair}");
                    }
                }
            }
        }
    }
}

/// T18: the error of the integral of x*y falls with about N^-1.5 (independent points: N^-0.5).
#[test]
fn sobol_converges_faster() {
    let gpu = device();
    let rms = |sampler: u32, points: u32| {
        let values = probe(&gpu, Push { count: 1024 * points, ..push(NUMBERS, sampler, points) });
        let square = |chunk: &[[f32; 4]]| {
            let mean = chunk.iter().map(|v| f64::from(v[0]) * f64::from(v[1])).sum::<f64>() / chunk.len() as f64;
            (mean - 0.25).powi(2)
        };
        (values.chunks(points as usize).map(square).sum::<f64>() / 1024.0).sqrt()
    };
    let slope = |sampler| (rms(sampler, 1024) / rms(sampler, 16)).log2() / 6.0;
    let (pcg, sobol) = (slope(PCG), slope(SOBOL));
    println!("slopes: pcg {pcg:.2}, sobol {sobol:.2}");
    assert!((pcg + 0.5).abs() < 0.05, "{pcg}");
    assert!(sobol < -1.3, "{sobol}");
}
