//! Light transport against closed forms.

use super::support::*;
use super::{Case, Checks, Outcome, welch};
use crate::Result;
use crate::gpu::Gpu;
use crate::image::Image;
use crate::render::{Estimator, Renderer, Sampler, Settings};
use crate::scene::{DeltaKind, DeltaLight, Scene};
use glam::DVec3;
use std::f64::consts::PI;

pub(super) const CASES: &[Case] = &[
    Case {
        number: "T1",
        name: "furnace",
        claim: "in a closed scene where all emits and reflects alike every path of `cosine` sums to L(1-a^(B+1))/(1-a), at 13 scales from 1e-6 to 1e6; the other estimators do in the mean",
        run: furnace_case,
    },
    Case {
        number: "T2",
        name: "concentric spheres",
        claim: "a black emitter in the middle of a grey cavity lights the wall by the closed form, after 1, 2, 4 and 8 reflections",
        run: concentric_spheres,
    },
    Case {
        number: "T3",
        name: "point light in a sphere",
        claim: "a point light in the middle of a grey sphere lights it by the closed form",
        run: point_in_a_sphere,
    },
    Case {
        number: "T6",
        name: "faces of a cube",
        claim: "a ceiling that emits evenly lights floor and wall of a black cube by the view factors 0.199825 and 0.200044",
        run: cube_faces,
    },
    Case {
        number: "T7",
        name: "reflections add light",
        claim: "no light gives 0, no reflection only what emits, more reflections more light by a falling amount",
        run: reflections_add_light,
    },
    Case {
        number: "T8",
        name: "estimators agree",
        claim: "means of 8x8 blocks agree between estimators and samplers by Welch's test, which sees 1 % too much light",
        run: |gpu| welch::estimators_agree(gpu, 96, 32),
    },
];

/// What every path of it returns.
pub(super) fn furnace_exact(radiance: f64, albedo: f64, bounces: i32) -> f64 {
    radiance * (1.0 - albedo.powi(bounces + 1)) / (1.0 - albedo)
}

/// Box and five spheres, everything emits `radiance` and reflects `albedo`, the camera inside.
pub(super) fn furnace(radiance: f64, albedo: f64, size: u32) -> Scene {
    let mut shapes = closed_box(albedo, radiance);
    for (c, r) in [
        ([-0.5, -0.65, -0.3], 0.35),
        ([0.45, -0.7, 0.2], 0.3),
        ([0.5, 0.1, -0.5], 0.25),
        ([-0.45, 0.1, 0.2], 0.2),
        ([0.1, 0.55, 0.1], 0.2),
    ] {
        shapes.push(sphere(c, r, albedo, radiance));
    }
    Scene::new(look(DVec3::new(0.1, 0.0, 0.9), DVec3::new(0.0, 0.0, -1.0), 90.0, size, size), shapes)
}

/// Every path of the cosine estimator returns the same sum, so a single wrong path shows in its pixel.
/// 1e-5: eight f32 additions and multiplications, 16 roundings of 6e-8.
pub(super) fn is_right(value: f64, expected: f64) -> bool {
    (value / expected - 1.0).abs() <= 1e-5
}

/// Pixels, of a path each, that are not right.
pub(super) fn wrong_paths(image: &Image, expected: f64) -> usize {
    channel(image, "R").into_iter().filter(|&v| !is_right(v, expected)).count()
}

fn furnace_case(gpu: &Gpu) -> Result<Outcome> {
    const WRONG: &str = "wrong of 262,144 paths";
    let mut checks = Checks::default();
    let expected = furnace_exact(1.0, 0.5, 8);
    for sampler in [Sampler::Pcg, Sampler::Sobol] {
        for aa in [false, true] {
            // One sample: a pixel is a path.
            let s = Settings { aa, ..settings(1, 8, (Estimator::Cosine, sampler)) };
            let image = render(gpu, &furnace(1.0, 0.5, 512), &s)?;
            checks.none(WRONG, wrong_paths(&image, expected), format_args!("{sampler}, aa {aa}"));
        }
    }
    for power in -6..=6 {
        let scene = placed(furnace(1.0, 0.5, 512), 10f64.powi(power), DVec3::ZERO);
        let image = render(gpu, &scene, &settings(1, 8, (Estimator::Cosine, Sampler::Pcg)))?;
        checks.none(WRONG, wrong_paths(&image, expected), format_args!("scale 1e{power}"));
    }
    furnace_in_a_sphere(gpu, &mut checks)?;
    for choice in techniques().filter(|(e, _)| *e != Estimator::Cosine) {
        for aa in [false, true] {
            let s = Settings { aa, ..settings(32, 8, choice) };
            let values = channel(&render(gpu, &furnace(1.0, 0.5, 96), &s)?, "G");
            check_mean(&mut checks, &values, expected, (0.0, 2e-3), &format_args!("{choice:?}, aa {aa}"));
        }
    }
    Ok(checks.outcome())
}

fn furnace_in_a_sphere(gpu: &Gpu, checks: &mut Checks) -> Result<()> {
    let shapes = vec![cavity(1.0, 0.7, 2.0), sphere([0.3, 0.1, 0.0], 0.25, 0.7, 2.0)];
    let scene = Scene::new(look(DVec3::new(-0.5, 0.0, 0.2), DVec3::X, 80.0, 256, 256), shapes);
    for bounces in [0, 1, 8] {
        let image = render(gpu, &scene, &settings(1, bounces, (Estimator::Cosine, Sampler::Pcg)))?;
        let wrong = wrong_paths(&image, furnace_exact(2.0, 0.7, bounces as i32));
        checks.none("wrong of 65,536 paths in a sphere", wrong, format_args!("{bounces} reflections"));
    }
    Ok(())
}

/// A black emitter of radius 0.3 in a cavity of radius 1, albedo 0.8, radiance 5.
fn concentric_spheres(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let shapes = vec![cavity(1.0, 0.8, 0.0), sphere([0.0; 3], 0.3, 0.0, 5.0)];
    let scene = Scene::new(look(DVec3::new(0.7, 0.0, 0.0), DVec3::new(0.6, 0.5, 1.0), 70.0, 96, 96), shapes);
    for choice in techniques() {
        for (bounces, expected) in [(1, 0.36000), (2, 0.62208), (4, 0.95177), (8, 1.21911)] {
            let values = surface(&render(gpu, &scene, &settings(64, bounces, choice))?, "R");
            let at = format!("{choice:?}, {bounces} reflections");
            checks.at_least("pixels", values.len() as f64, 4000.0, &at);
            // 1e-4: rays start 2e-5 off the wall, which brings them closer to the emitter: (1 - 2e-5)^-2 a bounce.
            check_mean(&mut checks, &values, expected, (1e-4, 0.01), &at);
        }
    }
    Ok(checks.outcome())
}

/// One face of the black cube [-0.5, 0.5]^3 reflects, and the camera before the face opposite sees just that face. The film is
/// parallel to it, so samples are uniform on the face and their mean is the face's.
/// Every path of a pixel meets the same light at each of its hits, so each pixel is a test.
fn point_in_a_sphere(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    for scale in [1e-6, 1.0, 1e6] {
        let camera = look(DVec3::new(0.3, 0.1, 0.0), DVec3::X, 80.0, 32, 32);
        let mut scene = Scene::new(camera, vec![cavity(1.0, 0.5, 0.0)]);
        let kind = DeltaKind::Point { position: DVec3::ZERO };
        scene.delta_lights.push(DeltaLight { name: "bulb".into(), intensity: DVec3::splat(PI), kind });
        let scene = placed(scene, scale, DVec3::ZERO);
        for bounces in [1, 2, 4, 8] {
            let exact = 1.0 - 0.5f64.powi(bounces);
            for choice in techniques().filter(|(estimator, _)| *estimator == Estimator::Nee) {
                let image = render(gpu, &scene, &settings(4, bounces as u32, choice))?;
                let off = channel(&image, "G").into_iter().map(|v| (v / exact - 1.0).abs()).fold(0.0, f64::max);
                // Rays start 2e-5 of the scene off the wall, nearer to the light by as much: 4e-5.
                checks.at_most(
                    "relative error",
                    off,
                    5e-5,
                    format_args!("{choice:?}, {bounces} bounces, scale {scale:e}"),
                );
            }
        }
    }
    Ok(checks.outcome())
}

fn cube_faces(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    const FLOOR: usize = 3;
    const CEILING: usize = 2;
    // The camera is 0.99 off the face, so inside the cube.
    let (distance, radiance, albedo) = (0.99, 3.0, 0.8);
    let fov = 2.0 * (0.5f64 / distance).atan().to_degrees();
    for (face, from, factor) in
        [(FLOOR, DVec3::new(0.0, distance - 0.5, 0.0), 0.199_825), (0, DVec3::new(0.5 - distance, 0.0, 0.0), 0.200_044)]
    {
        let mut shapes = closed_box(0.0, 0.0);
        shapes[CEILING].radiance = DVec3::splat(radiance);
        shapes[face].albedo = DVec3::splat(albedo);
        let scene = placed(Scene::new(look(from * 2.0, from * 2.0 - from, fov, 32, 32), shapes), 0.5, DVec3::ZERO);
        for choice in techniques() {
            let at = format!("{choice:?}, face {face}");
            let spp = if choice.0 == Estimator::Nee { 64 } else { 256 };
            let mut renderer = Renderer::new(gpu, &scene, &Settings { aa: true, ..settings(spp, 1, choice) })?;
            // The face is not lit evenly: how much the mean is off shows between seeds, not between pixels.
            let mean = |seed| {
                renderer.set_seed(seed);
                renderer.finish()?;
                let image = renderer.image()?;
                let seen = image.channels["albedo.R"].iter().filter(|&&a| f64::from(a) > 0.999 * albedo).count();
                checks.count("pixels of other faces", seen as u64, 32 * 32, &at);
                Ok(mean_error(&channel(&image, "R")).0)
            };
            let means = (0..24).map(mean).collect::<Result<Vec<f64>>>()?;
            // 2e-4: rays start 2e-5 of the half side off the face, and the camera's rays round to 1e-7 of the side; factors are
            // given to 2.5e-6.
            check_mean(&mut checks, &means, albedo * radiance * factor, (2e-4, 2e-3), &at);
        }
    }
    Ok(checks.outcome())
}

fn reflections_add_light(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let mut dark = cornell(32);
    dark.shapes.iter_mut().for_each(|s| s.radiance = DVec3::ZERO);
    for choice in techniques() {
        let image = render(gpu, &dark, &settings(4, 8, choice))?;
        let lit = image.channels["R"].iter().filter(|&&v| v != 0.0).count();
        checks.none("pixels lit without a light", lit, format_args!("{choice:?}"));
        let image = render(gpu, &cornell(32), &settings(4, 0, choice))?;
        let other = image.channels["R"].iter().filter(|&&v| v != 0.0 && v != 12.0).count();
        checks.none("pixels lit without a reflection", other, format_args!("{choice:?}"));
        checks.holds(
            "frames in which the light is not seen",
            image.channels["R"].contains(&12.0),
            format_args!("{choice:?}"),
        );
    }
    let mean = |bounces| {
        let image = render(gpu, &cornell(64), &settings(64, bounces, (Estimator::Nee, Sampler::Sobol)))?;
        Ok(mean_error(&channel(&image, "R")).0)
    };
    let means = [0, 1, 2, 3, 4, 8].into_iter().map(mean).collect::<Result<Vec<f64>>>()?;
    let at = format!("{means:?}");
    for pair in means.windows(2) {
        checks.holds("reflections that take light away", pair[1] > pair[0], &at);
    }
    // From the second on each adds at most the largest albedo times the last; 1.05 for noise.
    for t in means[1..5].windows(3) {
        checks.at_most("what a reflection adds over the one before", (t[2] - t[1]) / (t[1] - t[0]), 0.725 * 1.05, &at);
    }
    Ok(checks.outcome())
}
