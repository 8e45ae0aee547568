//! Rays within closed meshes.

use super::intersection::Numbers;
use super::support::*;
use super::transport::{furnace_exact, wrong_paths};
use super::{Case, Checks, Outcome};
use crate::Result;
use crate::gpu::Gpu;
use crate::net::tensor::seed_of;
use crate::render::{Estimator, Sampler, closest_triangles};
use crate::scene::{Mesh, Scene, tessellate};
use glam::DVec3;

pub(super) const CASES: &[Case] = &[Case {
    number: "T22",
    name: "watertight meshes",
    claim: "of a million rays within a closed mesh, 100,000 aimed at its vertices, 100,000 at its edges and 100,000 along axes, none escapes, and no path of a furnace of triangles is wrong at any scale or place",
    run: watertight,
}];

/// Scales and places; a power of two as the scale would change no bit.
const PLACES: [(f64, DVec3); 3] = [(1.0, DVec3::ZERO), (1e-6, DVec3::ZERO), (1e3, DVec3::new(1e6, -2e6, 5e5))];

fn watertight(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    for (name, mesh) in [
        ("icosphere of 81,920 triangles", tessellate::icosphere(6)),
        ("12,000 needles", tessellate::needle_sphere(600)),
    ] {
        for (count, (scale, shift)) in [1_000_000, 100_000, 100_000].into_iter().zip(PLACES) {
            check_rays(gpu, &mesh, count, (scale, shift), &mut checks, name)?;
        }
    }
    // Cells from 1.6e-5 to 0.07 of a side.
    let lines: Vec<f64> = (0..=40).map(|i| (f64::from(i) / 40.0).powi(3)).collect();
    let ball = sphere([0.2, -0.4, -0.3], 0.4, 0.5, 1.0);
    let camera = look(DVec3::new(0.1, 0.0, 0.9), DVec3::NEG_Z, 90.0, 256, 256);
    let furnace = Scene::new(camera, vec![mesh_of(tessellate::hollow_box(&lines), 0.5, 1.0), ball]);
    for (scale, shift) in PLACES {
        let scene = placed(furnace.clone(), scale, shift);
        let image = render(gpu, &scene, &settings(1, 8, (Estimator::Cosine, Sampler::Pcg)))?;
        let wrong = wrong_paths(&image, furnace_exact(1.0, 0.5, 8));
        checks.none("wrong of 65,536 paths", wrong, format_args!("scale {scale:e}, at {shift}"));
    }
    Ok(checks.outcome())
}

/// Rays from within a mesh that is near the unit sphere, placed.
fn check_rays(
    gpu: &Gpu,
    mesh: &Mesh,
    count: usize,
    (scale, shift): (f64, DVec3),
    checks: &mut Checks,
    name: &str,
) -> Result<()> {
    let at = format!("{name}, scale {scale:e}, at {shift}");
    let scene = Scene::new(look(DVec3::ZERO, DVec3::NEG_Z, 40.0, 1, 1), vec![mesh_of(mesh.clone(), 0.5, 0.0)]);
    let place = |p: DVec3| p * scale + shift;
    let rays: Vec<_> = rays(mesh, count, &at).into_iter().map(|ray| ray.map(place)).collect();
    let hits = closest_triangles(gpu, &placed(scene, scale, shift), &rays)?;
    let escaped = hits.iter().filter(|hit| hit.distance.is_nan() || hit.distance <= 0.0).count();
    checks.none("rays that escaped", escaped, &at);
    // Needles span 20 degrees, so their circles a little more: their middles are over cos(10.1 degrees) from the centre. 1e-5: what
    // rounding moves a hit.
    let radius = |([from, to], distance): ([DVec3; 2], f64)| {
        (from + (to - from).normalize() * distance - shift).length() / scale
    };
    let found = rays.iter().copied().zip(hits.iter().map(|hit| hit.distance)).map(radius);
    let on = |r: f64| (10.1f64.to_radians().cos() - 1e-5..=1.0 + 1e-5).contains(&r);
    checks.none("hits off the mesh", found.filter(|&r| !on(r)).count(), &at);
    let inside = |[v, w]: [f32; 2]| v >= -1e-6 && w >= -1e-6 && v + w <= 1.0 + 1e-6;
    checks.none("weights outside their triangle", hits.iter().filter(|hit| !inside(hit.weights)).count(), &at);
    Ok(())
}

/// Rays from a point within, each toward a second point: of ten one to a vertex, one to a point of an edge, one along an axis.
fn rays(mesh: &Mesh, count: usize, name: &str) -> Vec<[DVec3; 2]> {
    let mut u = Numbers::new(seed_of(name));
    let ray = |i: usize| {
        let from = u.direction() * (0.85 * u.next());
        let [a, b, _] = mesh.corners(mesh.triangles[(u.next() * mesh.triangles.len() as f64) as usize]);
        let to = match i % 10 {
            0 => a,
            1 => a.lerp(b, u.next()),
            2 => from + [DVec3::X, DVec3::Y, DVec3::NEG_Z][i / 10 % 3],
            _ => from + u.direction(),
        };
        [from, to]
    };
    (0..count).map(ray).collect()
}
