//! A thin lens against closed forms.

mod render_support;

use glam::DVec3;
use limpid::render::{Renderer, Sampler, Settings};
use limpid::scene::{Lens, Scene, mitsuba};
use render_support::*;

const SIZE: u32 = 64;
const SPP: u32 = 256;
const DEPTH: f64 = 2.0;

/// A camera at the origin that looks along -z; of a plane at [`DEPTH`] the half x > 0 glows.
fn edge(lens: Option<Lens>) -> Scene {
    let glow = rectangle(DVec3::new(50.0, 0.0, -DEPTH), DVec3::X * 50.0, DVec3::Y * 50.0, 0.0, 1.0);
    let mut camera = look(DVec3::ZERO, DVec3::NEG_Z, 40.0, SIZE, SIZE);
    camera.lens = lens;
    Scene::new(camera, vec![glow])
}

/// Part of the unit disk with x > t.
fn segment(t: f64) -> f64 {
    let t = t.clamp(-1.0, 1.0);
    0.5 - (t * (1.0 - t * t).sqrt() + t.asin()) / std::f64::consts::PI
}

/// Blur of an edge: a point of the plane is hit from the part of the lens that sees it, a circular segment.
#[test]
fn an_edge_is_blurred_by_the_lens() {
    let gpu = device();
    for (aperture_radius, focus_distance) in [(0.1, 1.0), (0.2, 5.0), (0.05, 0.5)] {
        let scene = edge(Some(Lens { aperture_radius, focus_distance }));
        for sampler in Sampler::ALL {
            let settings = Settings { spp: SPP, bounces: 0, aa: true, sampler, ..Settings::default() };
            let image = render(&gpu, &scene, &settings);
            let half_width = scene.camera.half_extent().0;
            let mut blurred = 0;
            for x in 0..SIZE {
                let column = (0..SIZE).map(|y| f64::from(image.channels["R"][(y * SIZE + x) as usize]));
                let measured = column.sum::<f64>() / f64::from(SIZE);
                // Where the ray through the lens' centre meets the plane, averaged over the pixel's width.
                let place = |i: u32| {
                    (2.0 * (f64::from(x) + (f64::from(i) + 0.5) / 32.0) / f64::from(SIZE) - 1.0) * half_width * DEPTH
                };
                let blur = aperture_radius * (1.0 - DEPTH / focus_distance).abs();
                let expected = (0..32).map(|i| segment(-place(i) / blur)).sum::<f64>() / 32.0;
                blurred += u32::from((0.05..0.95).contains(&expected));
                // Of independent samples; nets are no worse. 1e-3: 32 places stand for the pixel's width.
                let error = (expected * (1.0 - expected) / f64::from(SIZE * SPP)).sqrt();
                assert!(
                    (measured - expected).abs() <= SIGMAS * error + 1e-3,
                    "{aperture_radius} {focus_distance} {sampler}, column {x}: {measured}, expected {expected} +- {error}"
                );
            }
            assert!(blurred > 5, "hardly a blur: {blurred} columns");
        }
    }
}

#[test]
fn what_is_in_focus_is_sharp() {
    let gpu = device();
    let settings = Settings { spp: 16, bounces: 0, aa: true, ..Settings::default() };
    let lens = Some(Lens { aperture_radius: 0.2, focus_distance: DEPTH });
    let image = render(&gpu, &edge(lens), &settings);
    let pinhole = render(&gpu, &edge(None), &settings);
    assert_eq!(image.channels["R"], pinhole.channels["R"]);
    // A lens that is tiny beside what a pixel sees.
    let tiny = Some(Lens { aperture_radius: 1e-5, focus_distance: 1.0 });
    assert_eq!(render(&gpu, &edge(tiny), &settings).channels["R"], pinhole.channels["R"]);
}

#[test]
fn lenses_are_read_written_and_checked() {
    let lens = Lens { aperture_radius: 0.25, focus_distance: 3.5 };
    let scene = edge(Some(lens));
    let text = mitsuba::write(&scene).unwrap();
    let loaded = mitsuba::load_str(&text, "lens.xml", &mitsuba::Options::default()).expect("load");
    assert_eq!(loaded.scene.camera, scene.camera);
    assert_ne!(scene.hash(), edge(None).hash());
    for (bad, what) in [("value=\"0.25\"", "value=\"0\""), ("value=\"3.5\"", "value=\"-1\"")] {
        let error =
            mitsuba::load_str(&text.replace(bad, what), "lens.xml", &mitsuba::Options::default()).expect_err(what);
        assert!(error.to_string().contains("lens.xml:") && error.to_string().contains("must be positive"), "{error}");
    }
    let without = text.replace("name=\"focus_distance\"", "name=\"focal\"");
    let error = mitsuba::load_str(&without, "lens.xml", &mitsuba::Options::default()).expect_err("no distance");
    assert!(error.to_string().contains("focus_distance"), "{error}");
    let gpu = device();
    let error = Renderer::new(&gpu, &scene, &Settings::default()).err().expect("one camera ray a pixel").to_string();
    assert!(error.contains("lens"), "{error}");
}
