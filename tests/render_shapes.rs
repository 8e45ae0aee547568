//! Disks: their light by closed form, their outline, and beside other shapes. Rectangles: their outline.

mod render_support;

use glam::{DQuat, DVec3};
use limpid::render::{Estimator, Sampler, Settings};
use limpid::scene::{Geometry, Scene, Shape};
use render_support::*;

const ALL: [(Estimator, Sampler); 4] = [
    (Estimator::Uniform, Sampler::Pcg),
    (Estimator::Cosine, Sampler::Sobol),
    (Estimator::Nee, Sampler::Pcg),
    (Estimator::Nee, Sampler::Sobol),
];

/// A false alarm once in 150,000 for a normal variable.
const SIGMAS: f64 = 4.5;

/// A disk of radius a at distance 1, seen from under its centre by a patch parallel to it, has the form factor a²/(1 + a²).
#[test]
fn disk_light_on_a_patch() {
    let gpu = device();
    for a in [0.1f64, 0.5, 2.0] {
        let expected = 0.5 * 3.0 * a * a / (1.0 + a * a);
        for tilt in [0.0f64, 0.4] {
            let turn = DQuat::from_rotation_z(tilt) * DQuat::from_rotation_x(tilt);
            let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| turn * axis);
            let patch = rectangle(DVec3::ZERO, z * 1e-3, x * 1e-3, 0.5, 0.0);
            let light = disk(y, x * a, z * a, 0.0, 3.0);
            let camera = look(turn * DVec3::new(2e-4, 1e-3, 1e-4), DVec3::ZERO, 10.0, 24, 24);
            let scene = Scene::new(camera, vec![patch, light]);
            for (estimator, sampler) in ALL {
                let settings = Settings { spp: 256, bounces: 1, estimator, sampler, ..Settings::default() };
                let values = surface(&render(&gpu, &scene, &settings), "R");
                assert_eq!(values.len(), 24 * 24);
                let (mean, error) = mean_error(&values);
                assert!(error < 0.05 * expected);
                // 5e-4: rays start 2e-5 of the scene off the patch, which is no point.
                let allowed = SIGMAS * error + 5e-4 * expected;
                assert!(
                    (mean - expected).abs() < allowed,
                    "{estimator} {sampler} {a} {tilt}: {mean} +- {error}, expected {expected}"
                );
            }
        }
    }
}

/// Seen from afar an emitting ellipse covers pi/4 of the rectangle around it.
#[test]
fn disks_are_round() {
    let gpu = device();
    let share = |geometry: fn(DVec3, DVec3, DVec3, f64, f64) -> Shape| {
        // No rational slope: its edge would pass all pixels at the same few distances.
        let turn = DQuat::from_rotation_z(0.3);
        let shape = geometry(DVec3::ZERO, turn * DVec3::X * 1.25, turn * DVec3::Y * 0.8, 0.0, 1.0);
        let scene = Scene::new(look(DVec3::new(0.0, 0.0, 50.0), DVec3::ZERO, 4.0, 512, 512), vec![shape]);
        let image = render(&gpu, &scene, &Settings { spp: 1, ..Settings::default() });
        image.channels["R"].iter().filter(|&&v| v == 1.0).count() as f64
    };
    let ratio = share(disk) / share(rectangle);
    // Of the outlines, 1000 pixels long, each pixel's place is random: a standard deviation of about sqrt(1000 / 12) pixels.
    let pixels = 4.0 * 1.25 * 0.8 / (50.0 * 4f64.to_radians()).powi(2) * 512.0 * 512.0;
    assert!((ratio - std::f64::consts::FRAC_PI_4).abs() < 6.0 * (1000f64 / 12.0).sqrt() / pixels, "{ratio}");
}

/// Free rectangles are hit where they are, whatever the size of the scene; those that touch are 2e-6 of it wider, here 3.2 pixels.
#[test]
fn free_rectangles_are_no_wider_than_they_are() {
    let gpu = device();
    let far = sphere([0.0, 0.0, -1999.0], 1.0, 0.0, 0.0);
    let square = |x| rectangle(DVec3::new(x, 0.0, 0.0), DVec3::X * 0.02, DVec3::Y * 0.02, 0.0, 1.0);
    let field = 2.0 * 0.08f64.atan().to_degrees();
    let lit = |squares: &[Shape]| {
        let camera = look(DVec3::new(0.0, 0.0, 1.0), DVec3::ZERO, field, 256, 256);
        let scene = Scene::new(camera, [std::slice::from_ref(&far), squares].concat());
        let image = render(&gpu, &scene, &Settings { spp: 1, ..Settings::default() });
        image.channels["R"].iter().filter(|&&v| v == 1.0).count()
    };
    assert_eq!(lit(&[square(0.0)]), 64 * 64);
    assert_eq!(lit(&[square(-0.05), square(0.05)]), 2 * 64 * 64, "apart");
    let touching = lit(&[square(-0.02), square(0.02)]);
    assert!(((128 + 5) * (64 + 5)..=(128 + 7) * (64 + 7)).contains(&touching), "{touching} pixels");
}

/// Disks and rectangles, lights among both, in any order: the order of the buffers, not of the scene, decides every bit.
#[test]
fn disks_beside_rectangles() {
    let gpu = device();
    let mut scene = cornell(48);
    scene.shapes.retain(|shape| matches!(shape.geometry, Geometry::Rectangle { .. }));
    let disks = [
        disk(DVec3::new(0.0, 0.99, 0.0), DVec3::X * 0.4, DVec3::Z * 0.4, 0.2, 5.0),
        disk(DVec3::new(0.3, -0.5, 0.2), DVec3::Z * 0.5, DVec3::X * 0.5, 0.6, 0.0),
    ];
    let light = rectangle(DVec3::new(-0.6, 0.9, 0.0), DVec3::X * 0.2, DVec3::Z * 0.2, 0.0, 4.0);
    let walls = scene.shapes.clone();
    let orders =
        [[walls.clone(), disks.to_vec(), vec![light.clone()]].concat(), [vec![light], disks.to_vec(), walls].concat()];
    let settings =
        |estimator, seed| Settings { spp: 64, seed, estimator, sampler: Sampler::Pcg, ..Settings::default() };
    let images = orders.map(|shapes| {
        scene.shapes = shapes;
        render(&gpu, &scene, &settings(Estimator::Nee, 0))
    });
    assert_same_bits(&images[0], &images[1], "orders of the scene");
    let means = |estimator| {
        let mean = |seed| mean_error(&surface(&render(&gpu, &scene, &settings(estimator, seed)), "G")).0;
        mean_error(&(1..=16).map(mean).collect::<Vec<_>>())
    };
    let ((nee, nee_error), (cosine, cosine_error)) = (means(Estimator::Nee), means(Estimator::Cosine));
    let error = nee_error.hypot(cosine_error);
    assert!(error < 0.005 * nee, "standard error {error} of {nee} proves nothing");
    assert!((nee - cosine).abs() < SIGMAS * error, "{nee} +- {nee_error}, {cosine} +- {cosine_error}");
}
