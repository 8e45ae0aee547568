//! Light transport against a closed form and an independent renderer; tests/stress.rs has more.

mod render_support;

use glam::DVec3;
use limpid::image::Image;
use limpid::render::{Estimator, Sampler, Settings};
use limpid::scene::Scene;
use render_support::*;

/// A rectangle light: a uniform ceiling over a black floor patch has the form factor of parallel facing squares, seen
/// from a point under its centre: F = 4 * (2/(2 pi)) * (a/sqrt(1+a^2)) * atan(a/sqrt(1+a^2)) for half side a at distance 1.
#[test]
fn rectangle_light_on_a_patch() {
    let gpu = device();
    for a in [0.1f64, 0.5, 2.0] {
        let q = a / (1.0 + a * a).sqrt();
        let exact = 4.0 / std::f64::consts::PI * q * q.atan();
        for tilt in [0.0f64, 0.4] {
            // The whole scene may be turned: axis-aligned and general rectangles take different paths.
            let turn = glam::DQuat::from_rotation_z(tilt) * glam::DQuat::from_rotation_x(tilt);
            let patch = rectangle(DVec3::ZERO, turn * DVec3::Z * 1e-3, turn * DVec3::X * 1e-3, 0.5, 0.0);
            let light = rectangle(turn * DVec3::Y, turn * DVec3::X * a, turn * DVec3::Z * a, 0.0, 3.0);
            let camera = look(turn * DVec3::new(2e-4, 1e-3, 1e-4), DVec3::ZERO, 10.0, 24, 24);
            let scene = Scene::new(camera, vec![patch, light]);
            for choice in techniques() {
                let image = render(&gpu, &scene, &settings(256, 1, choice));
                let values = surface(&image, "R");
                assert_eq!(values.len(), 24 * 24);
                let (mean, error) = mean_error(&values);
                let expected = 0.5 * 3.0 * exact;
                assert!(error < 0.05 * expected);
                let allowed = SIGMAS * error + 5e-4 * expected;
                assert!(
                    (mean - expected).abs() < allowed,
                    "{choice:?} {a} {tilt}: {mean} +- {error}, expected {expected}"
                );
            }
        }
    }
}

fn assert_mean(image: &Image, surface_only: bool, expected: [f64; 3], tolerance: f64) {
    for (channel, expected) in ["R", "G", "B"].into_iter().zip(expected) {
        let values = if surface_only {
            surface(image, channel)
        } else {
            image.channels[channel].iter().map(|&v| f64::from(v)).collect()
        };
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        println!("{channel}: {mean:.5}, Mitsuba {expected}, {:+.3} %", 100.0 * (mean / expected - 1.0));
        assert!((mean / expected - 1.0).abs() < tolerance, "{channel}: {mean}, Mitsuba 3 gives {expected}");
    }
}

const MITSUBA_AA: [f64; 3] = [0.41577, 0.39049, 0.33921];
const MITSUBA_CENTRE: [f64; 3] = [0.22729, 0.19965, 0.14370];

/// With a camera ray per sample the mean over the frame does not depend on its size.
#[test]
fn cornell_agrees_with_mitsuba() {
    let gpu = device();
    let aa = Settings { aa: true, spp: 256, ..Settings::default() };
    assert_mean(&render(&gpu, &cornell(128), &aa), false, MITSUBA_AA, 0.0015);
    let centre = Settings { spp: 8, ..Settings::default() };
    assert_mean(&render(&gpu, &cornell(768), &centre), true, MITSUBA_CENTRE, 0.0015);
    let cosine = Settings { spp: 16, estimator: Estimator::Cosine, sampler: Sampler::Pcg, ..Settings::default() };
    assert_mean(&render(&gpu, &cornell(768), &cosine), true, MITSUBA_CENTRE, 0.005);
}

/// T8 over the whole frame, minutes long: `cargo test --release --test render_transport -- --ignored`.
#[test]
#[ignore = "takes minutes"]
fn estimators_agree_at_full_size() {
    let outcome = limpid::stress::estimators_agree(&device(), 768, 32).expect("renders");
    assert_eq!(outcome.verdict(), "passed", "{:?}", outcome.lines());
}
