//! Russian roulette: the same mean for fewer rays.

mod render_support;

use limpid::image::Image;
use limpid::render::{Estimator, Renderer, Sampler, Settings};
use render_support::*;

const BOUNCES: u32 = 32;

/// Pixel means of independent renders, one a seed, over the three colours; and the rays of one.
fn means(settings: &Settings, seeds: u32) -> (Vec<f64>, u64) {
    let gpu = device();
    let mut renderer = Renderer::new(&gpu, &cornell(48), settings).expect("renderer");
    let mean = |image: &Image| {
        let sum: f64 = ["R", "G", "B"].iter().flat_map(|c| &image.channels[*c]).map(|&v| f64::from(v)).sum();
        sum / (3.0 * 48.0 * 48.0)
    };
    let means = (0..seeds)
        .map(|seed| {
            renderer.set_seed(seed + settings.seed);
            renderer.finish().expect("render");
            mean(&renderer.image().expect("image"))
        })
        .collect();
    (means, renderer.stats().expect("stats").rays)
}

#[test]
fn roulette_keeps_the_mean_and_saves_rays() {
    for (estimator, sampler) in
        [(Estimator::Nee, Sampler::Pcg), (Estimator::Nee, Sampler::Sobol), (Estimator::Cosine, Sampler::Pcg)]
    {
        let plain = Settings { spp: 64, bounces: BOUNCES, estimator, sampler, ..Settings::default() };
        let ended = Settings { roulette: 2, seed: 1000, ..plain.clone() };
        let ((a, rays), (b, fewer)) = (means(&plain, 24), means(&ended, 24));
        let ((a, ea), (b, eb)) = (mean_error(&a), mean_error(&b));
        let error = ea.hypot(eb);
        println!("{estimator}+{sampler}: {a} and {b} +- {error}; {rays} and {fewer} rays");
        assert!((a - b).abs() < SIGMAS * error, "{estimator}+{sampler}: {a} and {b} +- {error}");
        // It could see a survivor that does not count for more: its light is missing. Of NEE's, what comes after the second reflection is a seventh.
        assert!(error < 0.005 * a, "a standard error of {error} proves nothing");
        assert!(fewer * 3 < rays * 2, "{fewer} of {rays} rays");
    }
}

#[test]
fn roulette_that_never_comes_changes_nothing() {
    let gpu = device();
    let plain = Settings { spp: 4, ..Settings::default() };
    let late = Settings { roulette: plain.bounces, ..plain.clone() };
    assert_same_bits(
        &render(&gpu, &cornell(24), &plain),
        &render(&gpu, &cornell(24), &late),
        "roulette at the bounce limit",
    );
    assert_eq!(Settings::default_roulette(8), u32::MAX);
    assert_eq!(Settings::default_roulette(9), 5);
}
