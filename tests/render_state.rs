//! Scenes that share a renderer, checkpoints, loops, exact pixels, counts of rays; tests/stress.rs has more.

mod render_support;

use glam::DVec3;
use limpid::Error;
use limpid::image::Image;
use limpid::render::{Estimator, Renderer, Settings};
use limpid::scene::Scene;
use render_support::*;

#[test]
fn scenes_share_a_renderer() {
    let gpu = device();
    let member = |n| {
        let mut scene = limpid::scene::family::spheres(n);
        (scene.camera.width, scene.camera.height) = (64, 64);
        scene
    };
    let mut renderer = Renderer::new(&gpu, &member(1), &Settings::default()).expect("renderer");
    renderer.finish().expect("render");
    for n in [2, 3] {
        renderer.set_scene(&member(n)).expect("family scenes have the same features");
        renderer.finish().expect("render");
        let shared = renderer.image().expect("image");
        assert_same_bits(&shared, &render(&gpu, &member(n), &Settings::default()), "own renderer");
    }
    let error = renderer.set_scene(&cornell(32)).expect_err("another size");
    assert!(matches!(error, Error::Input(_)), "{error}");
}

#[test]
fn foreign_or_damaged_checkpoints_are_refused() {
    let gpu = device();
    let settings = Settings { spp: 4, ..Settings::default() };
    let mut renderer = Renderer::new(&gpu, &cornell(16), &settings).expect("renderer");
    renderer.advance().expect("advance");
    let bytes = renderer.checkpoint_bytes().expect("bytes");
    renderer.restore_bytes(&bytes).expect("its own");
    let mut flipped = bytes.clone();
    flipped[200] ^= 1;
    for (bad, what) in
        [(&bytes[..10], "short"), (&bytes[..bytes.len() - 1], "cut"), (&flipped[..], "flipped"), (&[][..], "empty")]
    {
        assert!(matches!(renderer.restore_bytes(bad), Err(Error::Input(_))), "{what}");
    }
    renderer.set_seed(9);
    assert!(matches!(renderer.restore_bytes(&bytes), Err(Error::Input(_))), "another seed");
}

/// The loop over many primitives and the unrolled tests give one answer: 17 spheres against 16, one of them hidden away.
#[test]
fn loops_and_registers_agree() {
    let gpu = device();
    let scene = |count: usize| {
        let mut shapes: Vec<_> = (0..count)
            .map(|i| {
                sphere(
                    [(i as f64 * 0.37).sin(), (i as f64 * 0.73).cos() * 0.8, (i as f64).sin() * 0.5],
                    0.1,
                    0.6,
                    f64::from(i < 2) * 3.0,
                )
            })
            .collect();
        shapes.push(rectangle(DVec3::NEG_Y, DVec3::Z * 2.0, DVec3::X * 2.0, 0.5, 0.0));
        if count == 17 {
            shapes[16] = shapes[15].clone();
        }
        Scene::new(look(DVec3::new(0.0, 0.0, 4.0), DVec3::ZERO, 40.0, 64, 64), shapes)
    };
    let a = render(&gpu, &scene(16), &Settings { spp: 64, ..Settings::default() });
    let b = render(&gpu, &scene(17), &Settings { spp: 64, ..Settings::default() });
    for i in 0..a.channels["R"].len() {
        assert_eq!(a.channels["Z"][i], b.channels["Z"][i]);
    }
    let mean = |image: &Image| surface(image, "R").iter().sum::<f64>();
    assert!((mean(&a) / mean(&b) - 1.0).abs() < 1e-3, "{} {}", mean(&a), mean(&b));
}

/// Exact pixels: the light and the empty space around the box take one ray and hold their radiance.
#[test]
fn exact_pixels_cost_one_ray() {
    let gpu = device();
    let mut renderer =
        Renderer::new(&gpu, &cornell(64), &Settings { spp: 128, ..Settings::default() }).expect("renderer");
    renderer.limit_chunk(8);
    renderer.finish().expect("render");
    let outputs = renderer.outputs().expect("outputs");
    let radiance: Vec<[f32; 4]> = gpu.download(&outputs.radiance).expect("download");
    let albedo: Vec<[f32; 4]> = gpu.download(&outputs.albedo).expect("download");
    let mut rough = 0;
    for (r, a) in radiance.iter().zip(&albedo) {
        assert_eq!(r[3] == 1.0, a[0] == 0.0);
        assert!(r[3] == 0.0 || r[..3] == [0.0; 3] || r[..3] == [12.0; 3]);
        rough += u64::from(r[3] == 0.0);
    }
    let stats = renderer.stats().expect("stats");
    assert_eq!(stats.samples, rough * 128);
    assert!(rough > 3000 && rough < 4096 - 50);
}

/// A dark room of nothing but exact pixels: rays = pixels.
#[test]
fn rays_are_counted() {
    let gpu = device();
    let camera = look(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO, 40.0, 40, 24);
    let light = Scene::new(camera.clone(), vec![sphere([0.0; 3], 0.5, 0.0, 1.0)]);
    let rays = |scene: &Scene, settings: Settings| {
        let mut renderer = Renderer::new(&gpu, scene, &settings).expect("renderer");
        renderer.finish().expect("render");
        renderer.stats().expect("stats").rays
    };
    assert_eq!(rays(&light, Settings { spp: 512, ..Settings::default() }), 40 * 24);
    // In a closed cavity without light no path ends early: one camera ray a dispatch and `bounces` rays a sample.
    let room = Scene::new(look(DVec3::ZERO, DVec3::X, 40.0, 40, 24), vec![cavity(1.0, 0.5, 0.0)]);
    let settings = Settings { spp: 64, bounces: 5, estimator: Estimator::Cosine, ..Settings::default() };
    assert_eq!(rays(&room, settings.clone()), 40 * 24 * (1 + 64 * 5));
    assert_eq!(rays(&room, Settings { aa: true, ..settings }), 40 * 24 * 64 * 6);
}
