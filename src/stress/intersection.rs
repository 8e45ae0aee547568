//! Rays against single primitives, as the path tracer intersects them, beside f64.

use super::{Case, Checks, Outcome};
use crate::gpu::Gpu;
use crate::net::tensor::{seed_of, uniform};
use crate::{Result, push_block, shaders};
use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};

push_block! {
    /// Push constants of `intersect_probe`.
    pub struct Push for crate::shaders::intersect_probe { count: u32, kind: u32 }
}

pub(super) const CASES: &[Case] = &[
    Case {
        number: "T20",
        name: "rays and spheres",
        claim: "distances to spheres are those of f64 to 1.5e-7 (rms) and 1.5e-6 (largest) of the distance, without a miss up to 1e4 radii; only rays that graze within 4 roundings are decided otherwise",
        run: spheres,
    },
    Case {
        number: "T25",
        name: "axes, wall planes, corners",
        claim: "rays with zeros of both signs, in wall planes, along edges and into corners hit a box where f64 does, and leave no path of a furnace wrong",
        run: super::geometry::axis_parallel,
    },
];

/// A ray and a primitive; see the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
struct Query {
    origin: [f32; 4],
    direction: [f32; 4],
    primitive: [[f32; 4]; 4],
}

const SPHERE: u32 = 0;
const ALIGNED: u32 = 1;
const RECTANGLE: u32 = 2;

fn probe(gpu: &Gpu, kind: u32, queries: &[Query]) -> Result<Vec<[f32; 4]>> {
    let count = queries.len() as u64;
    let (from, to) = (gpu.buffer("queries", count * 96)?, gpu.buffer("hits", count * 16)?);
    gpu.upload(&from.all(), queries)?;
    let kernel = gpu.kernel::<shaders::intersect_probe::Shader>(&shaders::intersect_probe::Spec {})?;
    let bind = shaders::intersect_probe::Bind { queries: from.slice(0, count * 96), hits: to.slice(0, count * 16) };
    let mut rec = gpu.recorder();
    rec.dispatch(&kernel, &bind, &Push { count: count as u32, kind }, [count.div_ceil(64) as u32, 1, 1]);
    rec.finish()?.run()?;
    gpu.download(&bind.hits)
}

fn vec4(v: Vec3, w: f32) -> [f32; 4] {
    [v.x, v.y, v.z, w]
}

fn f64s(v: [f32; 4]) -> DVec3 {
    DVec3::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2]))
}

/// Numbers in [0, 1) of a stream.
pub(super) struct Numbers(u64, u64);

impl Numbers {
    pub(super) fn new(seed: u64) -> Self {
        Self(seed, 0)
    }

    pub(super) fn next(&mut self) -> f64 {
        self.1 += 1;
        uniform(self.0, self.1)
    }

    pub(super) fn direction(&mut self) -> DVec3 {
        let z = 1.0 - 2.0 * self.next();
        let (sin, cos) = (std::f64::consts::TAU * self.next()).sin_cos();
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * cos, r * sin, z)
    }
}

/// What f64 says of a ray and a sphere: the passing distance of the ray's line, and the near and far distances.
struct Exact {
    passing: f64,
    near: f64,
    far: f64,
}

impl Exact {
    fn new(query: &Query) -> Self {
        let (o, d, c) = (f64s(query.origin), f64s(query.direction), f64s(query.primitive[0]));
        let r = f64::from(query.primitive[0][3]);
        let f = o - c;
        let (a, b) = (d.dot(d), -f.dot(d));
        let nearest = f + b / a * d;
        let root = ((r * r - nearest.dot(nearest)) / a).sqrt();
        Self { passing: nearest.length(), near: b / a - root, far: b / a + root }
    }
}

const RAYS: usize = 1 << 16;

/// Rays from `distance` radii off a sphere's centre. `passing` gives how far from the centre they pass, in radii, for a number.
fn queries(name: &str, radius: f64, distance: f64, passing: impl Fn(f64) -> f64) -> Vec<Query> {
    let mut u = Numbers::new(seed_of(name));
    let query = |_| {
        let center = radius * u.direction();
        let away = u.direction();
        let side = away.cross(u.direction()).normalize();
        let b = passing(u.next()).min(distance);
        // From the origin the centre lies along -away; the line passes it at b radii.
        let sine = b / distance;
        let direction = -away * (1.0 - sine * sine).max(0.0).sqrt() + side * sine;
        // A shadow ray that ends before, within or behind the sphere.
        let length = radius * (distance - 2.0 + 4.0 * u.next()).max(0.0);
        Query {
            origin: vec4((center + radius * distance * away).as_vec3(), 0.0),
            direction: vec4(direction.as_vec3().normalize(), length as f32),
            primitive: [vec4(center.as_vec3(), radius as f32), [0.0; 4], [0.0; 4], [0.0; 4]],
        }
    };
    (0..RAYS).map(query).collect()
}

fn spheres(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    for radius in [1e-3, 0.25, 1.0, 100.0] {
        for distance in [0.01, 0.5, 0.99, 1.01, 2.0, 10.0, 1e2, 1e3, 1e4] {
            let at = format!("radius {radius}, {distance} radii away");
            // Uniform in a disc a little larger than the sphere.
            let rays = queries(&at, radius, distance, |u| 1.1 * u.sqrt());
            check_distances(&mut checks, &rays, &probe(gpu, SPHERE, &rays)?, distance, &at);
            if distance > 1.0 {
                // Within 40 roundings of the distance from the silhouette.
                let width = 40.0 * f64::from(f32::EPSILON) * distance;
                let rays = queries(&format!("{at}, grazing"), radius, distance, |u| 1.0 + width * (2.0 * u - 1.0));
                check_silhouette(&mut checks, &rays, &probe(gpu, SPHERE, &rays)?, distance, &at);
            }
        }
    }
    Ok(checks.outcome())
}

/// Distances where the ray passes within 0.9 radii: there an error across the ray is at most doubled along it.
fn check_distances(checks: &mut Checks, rays: &[Query], hits: &[[f32; 4]], distance: f64, at: &str) {
    let reach = distance.max(1.0);
    let (mut squares, mut largest, mut count) = (0.0, 0.0f64, 0.0);
    let (mut missed, mut shadows) = (0, 0);
    for (ray, hit) in rays.iter().zip(hits) {
        let (exact, r) = (Exact::new(ray), f64::from(ray.primitive[0][3]));
        if exact.passing > 0.9 * r {
            continue;
        }
        let outside = distance > 1.0;
        let expected = if outside { exact.near } else { exact.far };
        let found = f64::from(if outside { hit[0] } else { hit[1] });
        missed += usize::from(found.is_nan() || found <= 0.0);
        let error = (found - expected).abs() / r;
        (squares, largest, count) = (squares + error * error, largest.max(error), count + 1.0);
        let length = f64::from(ray.direction[3]);
        // A shadow ray that ends within the bar of the surface may be decided either way.
        let decided = (length - expected).abs() > 1.5e-6 * reach * r;
        // From outside both tests see the near side, from inside only one sees any.
        let tests = if outside { &hit[2..] } else { &hit[3..] };
        shadows += tests.iter().filter(|&&blocked| decided && (blocked > 0.0) != (expected < length)).count();
        missed += usize::from(outside && hit[1].to_bits() != hit[0].to_bits());
    }
    checks.at_least("rays that hit", count, 0.5 * RAYS as f64, at);
    checks.none("hits that were missed", missed, at);
    checks.none("shadow rays decided wrongly", shadows, at);
    checks.at_most("rms error of the distance, of the reach", (squares / count).sqrt() / reach, 1.5e-7, at);
    checks.at_most("largest error of the distance, of the reach", largest / reach, 1.5e-6, at);
}

fn check_silhouette(checks: &mut Checks, rays: &[Query], hits: &[[f32; 4]], distance: f64, at: &str) {
    let (mut wrong, mut decided) = (0, [0.0f64; 2]);
    for (ray, hit) in rays.iter().zip(hits) {
        let (exact, r) = (Exact::new(ray), f64::from(ray.primitive[0][3]));
        let margin = 4.0 * 2f64.powi(-24) * distance * r;
        if (exact.passing - r).abs() > margin {
            let inside = exact.passing < r;
            decided[usize::from(inside)] += 1.0;
            wrong += usize::from(inside != (hit[0] > 0.0));
        }
    }
    checks.at_least("grazing rays that must miss, and must hit", decided[0].min(decided[1]), 0.1 * RAYS as f64, at);
    checks.none("silhouettes decided wrongly", wrong, at);
}

/// Rays from a grid in the box [-1, 1]^3, its walls, edges and corners included, in directions with zeros of both signs.
pub(super) fn check_box(gpu: &Gpu, checks: &mut Checks) -> Result<()> {
    let grid = [-1.0f32, -0.75, 0.0, 0.5, 1.0];
    let parts = [-1.0f32, -0.0, 0.0, 1.0];
    let cube = |v: &[f32]| -> Vec<Vec3> {
        let (v, n) = (v.to_vec(), v.len());
        (0..n * n * n).map(|i| Vec3::new(v[i % n], v[i / n % n], v[i / n / n])).collect()
    };
    let directions: Vec<Vec3> = cube(&parts).into_iter().filter(|d| d.length() > 0.0).map(Vec3::normalize).collect();
    let rays: Vec<(Vec3, Vec3)> = cube(&grid).iter().flat_map(|o| directions.iter().map(move |d| (*o, *d))).collect();
    for kind in [ALIGNED, RECTANGLE] {
        let queries: Vec<Query> = rays.iter().flat_map(|(o, d)| walls(kind, *o, *d)).collect();
        let hits = probe(gpu, kind, &queries)?;
        for ((o, d), hits) in rays.iter().zip(hits.chunks(6)) {
            // As the tracer picks the closest: what is not a number is no hit.
            let found = hits.iter().map(|h| h[0]).filter(|t| *t > 0.0).fold(f32::INFINITY, f32::min);
            // Out of the box through the first wall that the ray approaches; a ray that begins there may go either way.
            let exit = (0..3).filter(|&k| d[k] != 0.0).map(|k| (1.0f32.copysign(d[k]) - o[k]) / d[k]);
            let expected = exit.fold(f32::INFINITY, f32::min);
            if expected > 0.0 {
                // 3 ULP: a division (2.5) and a difference.
                let off = f64::from((found - expected).abs() / (expected * f32::EPSILON));
                let at = format_args!("kind {kind}, from {o} to {d}: {found}, expected {expected}");
                checks.at_most("distance in a box, ULP", off, 4.0, at);
            }
        }
    }
    Ok(())
}

/// The six walls, made as the path tracer's are: the test is a few roundings wider than the wall.
fn walls(kind: u32, o: Vec3, d: Vec3) -> [Query; 6] {
    const WIDER: f32 = 1.0 + 2e-6;
    std::array::from_fn(|i| {
        let (axis, side) = (i % 3, if i < 3 { 1.0 } else { -1.0 });
        let unit = |k: usize| Vec3::from_array(std::array::from_fn(|j| f32::from(u8::from(j == k % 3))));
        let (normal, u, v) = (unit(axis), unit(axis + 1), unit(axis + 2));
        let primitive = if kind == ALIGNED {
            [vec4(normal * side, axis as f32), vec4((u + v) * WIDER, 0.0), [0.0; 4], [0.0; 4]]
        } else {
            [vec4(normal * side, 0.0), vec4(-normal * side, 0.0), vec4(u, WIDER), vec4(v, WIDER)]
        };
        Query { origin: vec4(o, 0.0), direction: vec4(d, 0.0), primitive }
    })
}
