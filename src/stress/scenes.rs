//! Scenes at the edge of what makes sense, and the first hits of a plain one.

use super::support::*;
use super::{Case, Checks, Outcome};
use crate::gpu::Gpu;
use crate::render::{Estimator, Renderer, Sampler, Settings};
use crate::scene::{Geometry, Scene, family};
use crate::{Error, Result};
use glam::DVec3;

pub(super) const CASES: &[Case] = &[
    Case {
        number: "T24",
        name: "degenerate scenes",
        claim: "scenes without sense are refused; those at its edge (nested, touching, coincident, camera in anything, white rooms, one pixel, needle views) render finite, white rooms by the closed form",
        run: degenerate,
    },
    Case {
        number: "T28",
        name: "first hits",
        claim: "depth, normals and albedo of first hits are those of f64",
        run: first_hits,
    },
];

fn floor() -> crate::scene::Shape {
    rectangle(DVec3::NEG_Y, DVec3::Z * 2.0, DVec3::X * 2.0, 0.5, 0.0)
}

fn degenerate(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    strange_scenes(gpu, &mut checks)?;
    white_rooms(gpu, &mut checks)?;
    refusals(gpu, &mut checks);
    for (width, height, fov) in
        [(1, 1, 40.0), (1, 37, 40.0), (37, 1, 40.0), (33, 65, 40.0), (24, 24, 1e-6), (24, 24, 179.999_999)]
    {
        let mut scene = cornell(1);
        (scene.camera.width, scene.camera.height, scene.camera.fov_x_degrees) = (width, height, fov);
        let image = render(gpu, &scene, &Settings { spp: 2, ..Settings::default() })?;
        let at = format!("{width}x{height}, {fov} degrees");
        checks.count("pixels that are not there", image.channels["R"].len() as u64, u64::from(width * height), &at);
        checks.none("pixels that are negative", negative(&image.channels["R"]), &at);
    }
    Ok(checks.outcome())
}

fn negative(plane: &[f32]) -> usize {
    plane.iter().filter(|v| v.is_nan() || **v < 0.0).count()
}

fn strange_scenes(gpu: &Gpu, checks: &mut Checks) -> Result<()> {
    let camera = look(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO, 40.0, 24, 24);
    let many: Vec<_> = (0..40)
        .map(|i| {
            sphere([f64::from(i % 8) * 0.3 - 1.0, f64::from(i / 8) * 0.3 - 0.7, 0.0], 0.12, 0.5, f64::from(i % 7 == 0))
        })
        .collect();
    let nested = (1..6).map(|i| sphere([0.0; 3], 0.15 * f64::from(i), 0.5, f64::from(i == 3))).collect::<Vec<_>>();
    let scenes = [
        ("empty", vec![]),
        ("only a light", vec![sphere([0.0; 3], 0.5, 0.0, 1.0)]),
        ("camera in a light", vec![sphere([0.0, 0.0, 3.0], 1.0, 0.5, 1.0), floor()]),
        ("camera in a sphere", vec![sphere([0.0, 0.0, 3.0], 1.0, 0.5, 0.0), sphere([0.0; 3], 0.5, 0.0, 1.0), floor()]),
        ("camera on a sphere", vec![sphere([0.0, 0.0, 2.0], 1.0, 0.5, 1.0), floor()]),
        ("camera in a wall", vec![rectangle(DVec3::Z * 3.0, DVec3::X, DVec3::Y, 0.5, 1.0), floor()]),
        ("coincident", vec![sphere([0.0; 3], 0.5, 0.5, 1.0), sphere([0.0; 3], 0.5, 0.5, 0.0), floor()]),
        ("coincident walls", vec![floor(), floor(), sphere([0.0; 3], 0.5, 0.0, 1.0)]),
        ("nested", nested),
        ("touching", vec![sphere([-0.5, 0.0, 0.0], 0.5, 0.5, 0.0), sphere([0.5, 0.0, 0.0], 0.5, 0.5, 1.0), floor()]),
        ("light touches floor", vec![sphere([0.0, -0.5, 0.0], 0.5, 0.0, 1.0), floor()]),
        ("light through floor", vec![sphere([0.0, -1.0, 0.0], 0.5, 0.0, 1.0), floor()]),
        (
            "light behind the back",
            vec![sphere([0.0; 3], 0.5, 0.5, 0.0), rectangle(DVec3::Z, DVec3::Y, DVec3::X, 0.0, 1.0)],
        ),
        ("more than fit into registers", many.into_iter().chain([floor()]).collect()),
        ("white", vec![sphere([0.0; 3], 0.5, 1.0, 1.0), floor()]),
    ];
    for (name, shapes) in scenes {
        let scene = Scene::new(camera.clone(), shapes);
        for estimator in Estimator::ALL {
            for aa in [false, true] {
                let image = render(gpu, &scene, &Settings { spp: 4, estimator, aa, ..Settings::default() })?;
                checks.none(
                    "pixels that are negative",
                    negative(&image.channels["R"]),
                    format_args!("{name}, {estimator}"),
                );
            }
        }
    }
    Ok(())
}

/// Nothing is absorbed in a closed white furnace: L(B+1), and no overflow with the bounces.
fn white_rooms(gpu: &Gpu, checks: &mut Checks) -> Result<()> {
    for bounces in [0, 8, 64] {
        let scene = super::transport::furnace(1.0, 1.0, 64);
        let image = render(gpu, &scene, &settings(1, bounces, (Estimator::Cosine, Sampler::Pcg)))?;
        let expected = f64::from(bounces + 1);
        // Additions of whole numbers, each times throughputs that are 1 exactly: no rounding at all.
        let wrong = channel(&image, "R").into_iter().filter(|v| *v != expected).count();
        checks.none("wrong paths in a white room", wrong, format_args!("{bounces} reflections"));
    }
    Ok(())
}

fn refusals(gpu: &Gpu, checks: &mut Checks) {
    let mut refused = |name: &str, change: &dyn Fn(&mut Scene, &mut Settings)| {
        let (mut scene, mut settings) = (cornell(8), Settings::default());
        change(&mut scene, &mut settings);
        let refused = matches!(Renderer::new(gpu, &scene, &settings), Err(Error::Input(_)));
        checks.holds("scenes or settings accepted without sense", refused, name);
    };
    let radius = |value: f64| {
        move |scene: &mut Scene, _: &mut Settings| {
            if let Some(Geometry::Sphere { radius, .. }) =
                scene.shapes.iter_mut().map(|s| &mut s.geometry).find(|g| matches!(g, Geometry::Sphere { .. }))
            {
                *radius = value;
            }
        }
    };
    for value in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300] {
        refused(&format!("radius {value}"), &radius(value));
    }
    for value in [f64::NAN, f64::INFINITY, -0.1, 1.000_001] {
        refused(&format!("albedo {value}"), &|scene, _| scene.shapes[0].albedo.y = value);
    }
    for value in [f64::NAN, f64::INFINITY, -1e-300, 1e31] {
        refused(&format!("radiance {value}"), &|scene, _| scene.shapes[0].radiance.z = value);
    }
    for value in [0.0, 180.0, -1.0, f64::NAN] {
        refused(&format!("field of view {value}"), &|scene, _| scene.camera.fov_x_degrees = value);
    }
    for value in [f64::NAN, f64::INFINITY] {
        refused(&format!("camera at {value}"), &|scene, _| scene.camera.to_world.w_axis.x = value);
    }
    refused("no area", &|scene, _| scene.shapes.push(rectangle(DVec3::ZERO, DVec3::ZERO, DVec3::X, 0.5, 0.0)));
    refused("no pixels", &|scene, _| scene.camera.width = 0);
    refused("no samples", &|_, settings| settings.spp = 0);
    refused("a million bounces", &|_, settings| settings.bounces = 1 << 20);
}

fn first_hits(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let mut scene = family::spheres(5);
    (scene.camera.width, scene.camera.height) = (61, 43);
    let image = render(gpu, &scene, &Settings { spp: 1, ..Settings::default() })?;
    let axes = scene.camera.to_world;
    let mut hits = 0.0;
    for i in 0..61 * 43usize {
        let (x, y) = (i as u32 % 61, i as u32 / 61);
        let ray = scene.camera.pixel_ray(x, y);
        let plane = |name: &str| f64::from(image.channels[name][i]);
        let at = format!("pixel {x}, {y}");
        let Some((t, normal, shape, clearance)) = first_hit(&scene, ray.origin, ray.direction) else {
            checks.holds("misses with a value", plane("Z") == 0.0 && plane("R") == 0.0, &at);
            continue;
        };
        if clearance < 1e-4 {
            continue; // so close to an edge that roundings decide
        }
        hits += 1.0;
        // The error of a hit grows with 1/cos of its angle.
        let slope = 1e-6 / normal.dot(ray.direction).abs().max(1e-3);
        checks.at_most(
            "error of the depth, of 4e-6 over the cosine",
            (plane("Z") - t).abs() / (4.0 * slope * t),
            1.0,
            &at,
        );
        let n = DVec3::new(plane("N.X"), plane("N.Y"), plane("N.Z"));
        checks.at_most(
            "error of the normal, of 2e-5 over the cosine",
            (n - normal).length() / (20.0 * slope),
            1.0,
            &at,
        );
        checks.at_most("length of the normal, off 1", (n.length() - 1.0).abs(), 3e-7, &at);
        checks.at_most("normal along the ray", n.dot(ray.direction), 0.0, &at);
        let screen = (n.dot(axes.x_axis.truncate()), n.dot(axes.y_axis.truncate()));
        let off = (plane("Nscreen.X") - screen.0).abs().max((plane("Nscreen.Y") - screen.1).abs());
        checks.at_most("screen normal and world normal", off, 1e-6, &at);
        let albedo = |(k, name): (usize, &str)| image.channels[name][i] == scene.shapes[shape].albedo[k] as f32;
        let same = ["albedo.R", "albedo.G", "albedo.B"].into_iter().enumerate().all(albedo);
        checks.holds("albedos that are not the surface's", same, &at);
    }
    checks.at_least("hits", hits, 2000.0, "the frame");
    Ok(checks.outcome())
}

/// Distance, normal, shape, and how far (relative) the ray passes from any silhouette.
fn first_hit(scene: &Scene, o: DVec3, d: DVec3) -> Option<(f64, DVec3, usize, f64)> {
    let mut best: Option<(f64, DVec3, usize)> = None;
    let mut clearance = f64::INFINITY;
    for (i, shape) in scene.shapes.iter().enumerate() {
        let hit = match shape.geometry {
            Geometry::Sphere { center, radius, .. } => {
                let f = o - center;
                let b = -f.dot(d);
                let nearest = (f + b * d).length();
                clearance = clearance.min((nearest - radius).abs());
                (nearest < radius).then(|| {
                    let t = b - (radius * radius - nearest * nearest).sqrt();
                    (t, (o + t * d - center) / radius)
                })
            }
            Geometry::Rectangle { center, half_u, half_v } | Geometry::Disk { center, half_u, half_v } => {
                let normal = half_u.cross(half_v).normalize();
                let t = (center - o).dot(normal) / d.dot(normal);
                let q = o + t * d - center;
                let (a, b) = (q.dot(half_u) / half_u.length_squared(), q.dot(half_v) / half_v.length_squared());
                let round = matches!(shape.geometry, Geometry::Disk { .. });
                let edge = if round { a.hypot(b) } else { a.abs().max(b.abs()) };
                clearance = clearance.min((edge - 1.0).abs());
                (t > 0.0 && edge < 1.0).then_some((t, normal))
            }
            // The scenes of this case have none.
            Geometry::Mesh(_) => None,
        };
        if let Some((t, n)) = hit.filter(|(t, _)| *t > 0.0 && best.is_none_or(|(b, ..)| *t < b)) {
            best = Some((t, n, i));
        }
    }
    best.map(|(t, n, i)| (t, n, i, clearance))
}
