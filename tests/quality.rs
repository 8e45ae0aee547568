//! The weights that are part of the binary do their work on a frame that training never saw.

mod common;

use common::gpu;
use limpid::denoise::{Axes, Denoiser, Guides, embedded_weights};
use limpid::metrics;
use limpid::render::{Estimator, Renderer, Sampler, Settings};
use limpid::scene::family;

/// A held-out frame of 192x192 pixels: its reconstruction has at most a tenth of the noisy frame's relMSE, no pixel is
/// negative or not finite, and exact pixels keep their bits. (The figures on full frames are a benchmark's, not a test's.)
#[test]
fn embedded_weights_reconstruct_a_frame_that_training_never_saw() {
    let gpu = gpu();
    let weights = embedded_weights().unwrap();
    let mut scene = family::spheres(*family::HELD_OUT.start());
    let (w, h) = (192, 192);
    (scene.camera.width, scene.camera.height) = (w, h);
    let settings = Settings { estimator: Estimator::Cosine, sampler: Sampler::Pcg, seed: 1, ..Settings::default() };
    let mut noisy = Renderer::new(&gpu, &scene, &settings).unwrap();
    noisy.finish().unwrap();
    let outputs = noisy.outputs().unwrap();
    let denoiser = Denoiser::new(&gpu, &weights, w, h).unwrap();
    let guides = Guides::of(&outputs, denoiser.preparation().inputs, Axes::default());
    let (planes, _) = denoiser.run(&outputs.radiance, &guides).unwrap();
    let image = noisy.image().unwrap();
    let mut reference = Renderer::new(&gpu, &scene, &Settings { spp: 256, seed: 2, ..Settings::default() }).unwrap();
    reference.finish().unwrap();
    let reference = reference.image().unwrap();

    assert!(planes.iter().flatten().all(|v| v.is_finite() && *v >= 0.0));
    let radiance: Vec<[f32; 4]> = gpu.download(&outputs.radiance.slice(0, u64::from(w * h) * 16)).unwrap();
    let mut exact = 0;
    for (i, pixel) in radiance.iter().enumerate().filter(|(_, p)| p[3] > 0.5) {
        exact += 1;
        assert!((0..3).all(|c| planes[c][i].to_bits() == pixel[c].to_bits()), "pixel {i}");
    }
    assert!(exact > 100, "the frame has a light and a background: {exact}");

    let mut reconstructed = image.clone();
    reconstructed.set_rgb("", planes);
    let before = metrics::compare(&image, &reference).unwrap().all;
    let after = metrics::compare(&reconstructed, &reference).unwrap().all;
    println!("relMSE {:.5} -> {:.5}, MAE01 {:.5} -> {:.5}", before.relmse, after.relmse, before.mae01, after.mae01);
    assert!(after.relmse < before.relmse / 10.0, "relMSE {} -> {}", before.relmse, after.relmse);
}
