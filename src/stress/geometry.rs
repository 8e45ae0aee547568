//! Rays that leave surfaces, wherever and however large the scene is.

use super::support::*;
use super::transport::{furnace, furnace_exact, is_right, wrong_paths};
use super::{Case, Checks, Outcome, intersection};
use crate::Result;
use crate::gpu::Gpu;
use crate::render::{Estimator, Renderer, Sampler};
use crate::scene::{Geometry, Scene, Shape};
use glam::{DMat4, DQuat, DVec3};
use std::sync::Arc;

pub(super) const CASES: &[Case] = &[
    Case {
        number: "T21",
        name: "self hits and leaks",
        claim: "of a million rays that leave a sphere or a rectangle into the open none hits it again, and of a million in a closed room, straight, tilted or round, none escapes",
        run: self_hits_and_leaks,
    },
    Case {
        number: "T23",
        name: "far from the origin",
        claim: "no path of a furnace is wrong wherever the scene stands, up to a million times its size from the origin, at any scale",
        run: far_away,
    },
];

const COSINE: (Estimator, Sampler) = (Estimator::Cosine, Sampler::Pcg);

/// The shapes turned about the origin.
fn turned(mut shapes: Vec<Shape>, turn: DQuat) -> Vec<Shape> {
    for shape in &mut shapes {
        match &mut shape.geometry {
            Geometry::Sphere { center, .. } => *center = turn * *center,
            Geometry::Rectangle { center, half_u, half_v } | Geometry::Disk { center, half_u, half_v } => {
                (*center, *half_u, *half_v) = (turn * *center, turn * *half_u, turn * *half_v);
            }
            Geometry::Mesh(mesh) => Arc::make_mut(mesh).transform(DMat4::from_quat(turn)),
        }
    }
    shapes
}

/// No axis of the world is one of it.
fn tilt() -> DQuat {
    DQuat::from_rotation_z(0.4) * DQuat::from_rotation_x(0.3)
}

fn self_hits_and_leaks(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let plate = || vec![rectangle(DVec3::ZERO, DVec3::Z, DVec3::X, 0.5, 0.0)];
    let above = DVec3::new(0.3, 2.0, 0.4);
    for scale in [1e-6, 1.0, 1e6] {
        for (name, shapes, eye) in [
            ("sphere", vec![sphere([0.0; 3], 1.0, 0.5, 0.0)], DVec3::new(0.0, 0.0, 3.0)),
            ("far sphere", vec![sphere([0.0; 3], 0.01, 0.5, 0.0)], DVec3::new(0.0, 0.0, 3.0)),
            ("rectangle", plate(), above),
            ("tilted rectangle", turned(plate(), tilt()), tilt() * above),
        ] {
            // The surface fills the frame: as many rays leave it as there are samples.
            let narrow = if name == "far sphere" { 0.1 } else { 20.0 };
            let scene = Scene::new(look(eye, DVec3::ZERO, narrow, 256, 256), shapes);
            let mut renderer = Renderer::new(gpu, &placed(scene, scale, DVec3::ZERO), &settings(16, 4, COSINE))?;
            renderer.limit_chunk(16);
            renderer.finish()?;
            let stats = renderer.stats()?;
            let at = format!("{name}, scale {scale:e}");
            checks.count("samples that did not leave the surface", stats.samples, 16 << 16, &at);
            // A ray that leaves into the open is the last of its path. One ray a pixel and dispatch is the camera's.
            checks.count("rays that hit their own surface again", stats.rays, (16 << 16) + (1 << 16), &at);
        }
        let room = || furnace(1.0, 0.5, 1024).shapes;
        let hollow = vec![cavity(1.0, 0.5, 1.0), sphere([-0.3, 0.2, -0.4], 0.3, 0.5, 1.0)];
        for (name, turn, shapes) in [
            ("straight room", DQuat::IDENTITY, room()),
            ("tilted room", tilt(), room()),
            ("hollow sphere", DQuat::IDENTITY, hollow),
        ] {
            let shapes = turned(shapes, turn);
            let camera = look(turn * DVec3::new(0.1, 0.0, 0.9), turn * DVec3::NEG_Z, 90.0, 1024, 1024);
            let scene = placed(Scene::new(camera, shapes), scale, DVec3::ZERO);
            // One reflection: a ray that meets no emitter has escaped.
            let image = render(gpu, &scene, &settings(1, 1, COSINE))?;
            let wrong = wrong_paths(&image, furnace_exact(1.0, 0.5, 1));
            checks.none("of 1,048,576 rays that escaped", wrong, format_args!("{name}, scale {scale:e}"));
        }
    }
    Ok(checks.outcome())
}

fn far_away(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    // In units of the scene's half extent.
    for (scale, places) in [
        (1.0, &[[1e3, -2e3, 5e2], [1e4, 0.0, 0.0], [0.0, -1e5, 0.0], [1e6, 1e6, -1e6], [0.3e6, 0.7e6, 0.1e6]][..]),
        (1e-6, &[[1e3, -2e3, 5e2], [1e6, 1e6, -1e6]]),
        (1e6, &[[1e3, -2e3, 5e2], [1e6, 1e6, -1e6]]),
        (0.3, &[[1e6, 1e6, -1e6]]),
    ] {
        for place in places {
            let scene = placed(furnace(1.0, 0.5, 512), scale, DVec3::from_array(*place) * scale);
            let image = render(gpu, &scene, &settings(1, 8, COSINE))?;
            let wrong = wrong_paths(&image, furnace_exact(1.0, 0.5, 8));
            checks.none("wrong of 262,144 paths", wrong, format_args!("scale {scale:e}, at {place:?} times that"));
        }
    }
    Ok(checks.outcome())
}

/// T25: single rays, and furnaces whose cameras look along axes from the middle of the box, its walls, edges and corners.
pub(super) fn axis_parallel(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    intersection::check_box(gpu, &mut checks)?;
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    // An odd number of pixels, the outermost of which look at 45 degrees: rays along axes and diagonals.
    let size = 129u32;
    let fov = 2.0 * (f64::from(size) / f64::from(size - 1)).atan().to_degrees();
    for eye in [DVec3::ZERO, x, -y, z, x + y, -x + z, x + y + z, -x - y - z, 0.5 * x] {
        for (back, up) in [(x, y), (-x, z), (y, z), (-y, x), (z, y), (-z, y)] {
            let right = up.cross(back);
            let to_world = DMat4::from_cols(right.extend(0.0), up.extend(0.0), back.extend(0.0), eye.extend(1.0));
            let mut camera = look(eye, eye - back, fov, size, size);
            camera.to_world = to_world;
            let pixels = (0..size * size).map(|i| camera.pixel_ray(i % size, i / size).direction);
            // Rays that leave the box where they begin see nothing of it; those within a wall do. Directions that should be
            // 0 come out as 1e-17 here.
            let within = |d: DVec3| (0..3).all(|k| eye[k].abs() < 1.0 || d[k] * eye[k] < 1e-12);
            let inside: Vec<bool> = pixels.map(within).collect();
            let scene = Scene::new(camera, closed_box(0.5, 1.0));
            let image = render(gpu, &scene, &settings(1, 8, COSINE))?;
            let expected = furnace_exact(1.0, 0.5, 8);
            let values = channel(&image, "R").into_iter().zip(&inside).filter(|(_, inside)| **inside);
            let wrong = values.filter(|(v, _)| !is_right(*v, expected)).count();
            let at = format!("from {eye} to {}", -back);
            checks.none("wrong paths", wrong, &at);
            if back.dot(eye) >= 0.0 {
                checks.holds("frames without a path", inside.contains(&true), &at);
            }
        }
    }
    Ok(checks.outcome())
}
