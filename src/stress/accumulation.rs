//! Sums over many samples, their variance, their noise, and what is not a number.

use super::support::*;
use super::{Case, Checks, Outcome};
use crate::bench::error::{FLOOR_FACTOR, Key, Outcome as RunOutcome, REFERENCE, Run, summarize};
use crate::gpu::Gpu;
use crate::image::Image;
use crate::metrics::{mean_reference, reference_noise, relmse};
use crate::render::{Estimator, Renderer, Sampler, Settings};
use crate::scene::Scene;
use crate::{Error, Result};
use glam::DVec3;

pub(super) const CASES: &[Case] = &[
    Case {
        number: "T19",
        name: "convergence",
        claim: "from 16 to 256 samples relMSE falls with power -1.00 +- 0.05 of independent samples, and at least -1.1 of Sobol points",
        run: convergence,
    },
    Case {
        number: "T26",
        name: "magnitudes",
        claim: "radiance of 1e-30 to 1e30 gives the picture of radiance 1 times that; where squares overflow or vanish, variance is refused",
        run: magnitudes,
    },
    Case {
        number: "T27",
        name: "samples that are no number",
        claim: "NaN, infinite and negative samples are dropped and counted one by one, the picture stays finite, and the count is in its metadata",
        run: not_a_number,
    },
    Case {
        number: "T29",
        name: "many equal samples",
        claim: "16,384 and 1,048,576 equal samples have their value as mean, to 1e-6, in any chunks",
        run: many_samples,
    },
    Case {
        number: "T30",
        name: "heavy tail",
        claim: "16,384 samples of 1e-3 among which are rare ones of 1e4 have the mean of f64, to 1e-6",
        run: heavy_tail,
    },
    Case {
        number: "T31",
        name: "variance of the mean",
        claim: "over pairs of seeds the squared difference over the sum of the variances is 1",
        run: variance_of_the_mean,
    },
    Case {
        number: "T32",
        name: "noise of references",
        claim: "the noise that two halves tell of a reference is what it has, and errors under 10 times that are not told",
        run: noise_of_references,
    },
];

/// Mean over pixels and channels of the variance between seeds, each over the squared mean and 0.01: relMSE without a reference.
fn between_seeds(gpu: &Gpu, settings: &Settings, seeds: u32) -> Result<f64> {
    let mut renderer = Renderer::new(gpu, &cornell(64), settings)?;
    let mut sums: Vec<(f64, f64)> = Vec::new();
    for seed in 0..seeds {
        renderer.set_seed(seed);
        renderer.finish()?;
        let image = renderer.image()?;
        let values: Vec<f64> = ["R", "G", "B"].iter().flat_map(|name| channel(&image, name)).collect();
        sums.resize(values.len(), (0.0, 0.0));
        sums.iter_mut().zip(values).for_each(|(s, v)| *s = (s.0 + v, s.1 + v * v));
    }
    let n = f64::from(seeds);
    let term = |(sum, square): &(f64, f64)| {
        let mean = sum / n;
        (square / n - mean * mean) * n / (n - 1.0) / (mean * mean + 0.01)
    };
    Ok(sums.iter().map(term).sum::<f64>() / sums.len() as f64)
}

fn convergence(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    // Without indirect light samples cost a quarter, and are no less independent. 24 seeds of 4,096 pixels: the variance of a
    // variance is 2/23 of its square, so an error of under 1 % over the pixels, and of 0.005 in the slope.
    let slope = |sampler| -> Result<f64> {
        let error = |spp| between_seeds(gpu, &settings(spp, 2, (Estimator::Nee, sampler)), 24);
        Ok((error(256)? / error(16)?).log2() / 4.0)
    };
    checks.at_most("slope of pcg, off -1", (slope(Sampler::Pcg)? + 1.0).abs(), 0.05, "16 to 256 samples");
    checks.at_most("slope of sobol", slope(Sampler::Sobol)?, -1.1, "16 to 256 samples");
    Ok(checks.outcome())
}

fn lit(mut scene: Scene, factor: f64) -> Scene {
    scene.shapes.iter_mut().for_each(|shape| shape.radiance *= factor);
    scene
}

fn magnitudes(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let base = lit(cornell(32), 1.0 / 12.0);
    for choice in [(Estimator::Nee, Sampler::Sobol), (Estimator::Cosine, Sampler::Pcg)] {
        let settings = settings(128, 8, choice);
        let expected = render(gpu, &base, &settings)?;
        for magnitude in [1e-30, 1e-20, 1e-6, 1e6, 1e20, 1e30] {
            let image = render(gpu, &lit(base.clone(), magnitude), &settings)?;
            // Each sample is a product of some 20 factors, each rounded to 6e-8, the sums alike.
            let pairs = channel(&image, "R").into_iter().zip(channel(&expected, "R"));
            let off =
                pairs.map(|(v, e)| if e == 0.0 { v } else { (v / magnitude / e - 1.0).abs() }).fold(0.0, f64::max);
            checks.at_most(
                "difference to the picture of radiance 1",
                off,
                1e-5,
                format_args!("{choice:?}, {magnitude:e}"),
            );
        }
    }
    for magnitude in [1e-30, 1e-14, 1e14, 1e30] {
        let scene = lit(base.clone(), magnitude);
        let settings = Settings { variance: true, ..settings(64, 8, (Estimator::Nee, Sampler::Pcg)) };
        let at = format!("{magnitude:e}");
        match render(gpu, &scene, &settings) {
            Ok(image) => {
                let noisy = |i: &usize| image.channels["albedo.R"][*i] > 0.0 && image.channels["R"][*i] > 0.0;
                let zero =
                    (0..image.pixel_count()).filter(noisy).filter(|&i| image.channels["variance.R"][i] == 0.0).count();
                checks.none("noisy pixels without variance", zero, &at);
                checks.holds("variances that cannot be told", (1e-15..=1e15).contains(&magnitude), &at);
            }
            Err(Error::Input(_)) => checks.holds("variances refused", !(1e-15..=1e15).contains(&magnitude), &at),
            Err(other) => return Err(other),
        }
    }
    Ok(checks.outcome())
}

const BAD: [f32; 4] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0];

fn not_a_number(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let mut check = |scene: &Scene, settings: &Settings, value: f32, expected: u64, at: String| -> Result<()> {
        let mut renderer = Renderer::new(gpu, scene, settings)?;
        renderer.spoil_light(value)?;
        renderer.finish()?;
        let image = renderer.image()?;
        checks.count("bad samples not counted, or good ones counted", renderer.stats()?.invalid, expected, &at);
        let bad = image.channels.values().flatten().filter(|v| !v.is_finite()).count();
        checks.none("values that are not finite", bad + negative(&image), &at);
        checks.holds(
            "metadata that tell another count",
            image.attributes["invalidSamples"] == expected.to_string(),
            &at,
        );
        Ok(())
    };
    for value in BAD {
        // A wall that shines on itself: every sample is bad, from its first hit on.
        let room = Scene::new(look(DVec3::ZERO, DVec3::X, 60.0, 24, 16), vec![cavity(1.0, 0.5, 1.0)]);
        for aa in [false, true] {
            let s = Settings { aa, ..settings(20, 3, (Estimator::Cosine, Sampler::Sobol)) };
            check(&room, &s, value, 24 * 16 * 20, format!("{value} everywhere, aa {aa}"))?;
        }
        // One sample a pixel by light sampling: bad are those that are lit where the light is as it should be, and the
        // pixels that show it.
        let s = settings(1, 1, (Estimator::Nee, Sampler::Pcg));
        let lit = render(gpu, &cornell(96), &s)?.channels["R"].iter().filter(|v| **v > 0.0).count();
        check(&cornell(96), &s, value, lit as u64, format!("{value} of a light"))?;
    }
    Ok(checks.outcome())
}

fn negative(image: &Image) -> usize {
    image.channels["R"].iter().filter(|v| **v < 0.0).count()
}

/// Radiance and albedo have no short binary form, so that the sums round.
fn many_samples(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let (radiance, albedo) = (0.7, 0.37);
    let shapes = vec![cavity(1.0, albedo, radiance), sphere([0.3, 0.1, 0.0], 0.25, albedo, radiance)];
    let room = |size| Scene::new(look(DVec3::new(-0.5, 0.0, 0.2), DVec3::X, 80.0, size, size), shapes.clone());
    for (spp, size, bounces, chunk) in [(16_384, 16, 8, 64), (16_384, 16, 2, 7), (1 << 20, 8, 1, 64)] {
        let choice = (Estimator::Cosine, Sampler::Sobol);
        // What one sample gives in f32: its own roundings are not the sum's.
        let one = channel(&render(gpu, &room(size), &settings(1, bounces, choice))?, "R");
        let mut renderer = Renderer::new(gpu, &room(size), &settings(spp, bounces, choice))?;
        renderer.limit_chunk(chunk);
        renderer.finish()?;
        let many = channel(&renderer.image()?, "R");
        let off = many.iter().zip(one).map(|(m, o)| (m / o - 1.0).abs()).fold(0.0, f64::max);
        checks.at_most(
            "error of the mean",
            off,
            1e-6,
            format_args!("{spp} samples, {bounces} reflections, chunks of {chunk}"),
        );
    }
    // And a frame with light and shadow against the mean of another renderer (Mitsuba 3); 0.15 % as everywhere.
    let settings = Settings { spp: 16_384, aa: true, ..Settings::default() };
    let image = render(gpu, &cornell(16), &settings)?;
    let mean = mean_error(&channel(&image, "G")).0;
    checks.at_most("canonical frame, off 0.39049", (mean / 0.39049 - 1.0).abs(), 0.0015, "16,384 samples");
    Ok(checks.outcome())
}

/// A dim room with a small bright rectangle, seen by chance: a sample is one of two values. How often it is the bright one is
/// counted exactly by the same paths in a room that is dark but for the rectangle.
fn heavy_tail(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let (spp, dim, bright, albedo) = (16_384u32, 1e-3f32, 1e4f32, 0.5f32);
    let scene = |dim: f32, bright: f32| {
        let mut shapes = closed_box(f64::from(albedo), f64::from(dim));
        let half = 0.05;
        shapes.push(rectangle(DVec3::new(0.1, 0.95, 0.1), DVec3::X * half, DVec3::Z * half, 0.0, f64::from(bright)));
        // Down to the floor: the camera does not see the rectangle.
        Scene::new(look(DVec3::new(0.0, 0.5, 0.0), DVec3::NEG_Y, 60.0, 16, 16), shapes)
    };
    for sampler in Sampler::ALL {
        let settings = settings(spp, 1, (Estimator::Cosine, sampler));
        // Half of a whole number of at most 2^14, so exact.
        let hits = channel(&render(gpu, &scene(0.0, 1.0), &settings)?, "R");
        let image = channel(&render(gpu, &scene(dim, bright), &settings)?, "R");
        let (n, dim, bright, albedo) = (f64::from(spp), f64::from(dim), f64::from(bright), f64::from(albedo));
        let (mut off, mut most, mut least) = (0.0f64, 0.0f64, f64::MAX);
        for (hits, value) in hits.into_iter().zip(image) {
            let bright_samples = hits / albedo * n;
            let mean = dim + albedo * (dim * (n - bright_samples) + bright * bright_samples) / n;
            off = off.max((value / mean - 1.0).abs());
            (most, least) = (most.max(bright_samples), least.min(bright_samples));
        }
        checks.at_most("error of the mean", off, 1e-6, format_args!("{sampler}"));
        checks.at_least("rare samples of a pixel", least, 1.0, format_args!("{sampler}"));
        checks.at_most("rare samples of a pixel ", most, 100.0, format_args!("{sampler}"));
    }
    Ok(checks.outcome())
}

fn variance_of_the_mean(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let settings = Settings { spp: 256, variance: true, sampler: Sampler::Pcg, ..Settings::default() };
    let mut renderer = Renderer::new(gpu, &cornell(64), &settings)?;
    let mut run = |seed| {
        renderer.set_seed(seed);
        renderer.finish()?;
        renderer.image()
    };
    // Over the pixels of a pair of seeds; they are independent, so the pairs tell how far their mean may be off.
    let pair = |i: u32| {
        let (a, b) = (run(2 * i)?, run(2 * i + 1)?);
        let sum = |image: &Image| channel(image, "variance.R").iter().sum::<f64>();
        let squares: f64 = channel(&a, "R").iter().zip(channel(&b, "R")).map(|(a, b)| (a - b).powi(2)).sum();
        Ok(squares / (sum(&a) + sum(&b)))
    };
    let ratios = (0..10).map(pair).collect::<Result<Vec<f64>>>()?;
    // 1e-3: a ratio of two sums of 4,000 terms is off by about one in 4,000.
    check_mean(&mut checks, &ratios, 1.0, (1e-3, 0.015), &"squared differences over variances, 10 pairs of seeds");
    let few = render(gpu, &cornell(16), &Settings { spp: 7, ..settings.clone() })?;
    let sobol = render(gpu, &cornell(16), &Settings { sampler: Sampler::Sobol, ..settings })?;
    for (image, at) in [(few, "7 samples"), (sobol, "sobol")] {
        checks.holds("variances that cannot be known", !image.channels.contains_key("variance.R"), at);
    }
    Ok(checks.outcome())
}

fn noise_of_references(gpu: &Gpu) -> Result<Outcome> {
    let mut checks = Checks::default();
    let image = |spp, seed| {
        let settings = Settings { seed, aa: true, ..settings(spp, 4, (REFERENCE.estimator, REFERENCE.sampler)) };
        render(gpu, &cornell(48), &settings)
    };
    let (mut told, mut true_noise) = (0.0, 0.0);
    let truth = image(4096, 1000)?;
    for seed in 0..8 {
        let halves = [image(32, 2 * seed)?, image(32, 2 * seed + 1)?];
        told += reference_noise([&halves[0], &halves[1]])?.relmse / 8.0;
        true_noise += relmse(mean_reference([&halves[0], &halves[1]])?.rgb("")?, [truth.rgb("")?; 2]) / 8.0;
    }
    // 8 pairs of 2,300 pixels with heavy tails: two such sums agree to some per cent; the truth's own noise is 1 % of it.
    checks.at_most("noise told over noise had, off 1", (told / true_noise - 1.0).abs(), 0.15, "2 x 32 samples");
    let run = |relmse: f64| Run {
        key: Key { technique: REFERENCE, spp: 16, seed: 0 },
        rays: 1,
        noisy: RunOutcome { relmse, device_ms: 1.0, wall_ms: 1.0 },
        reconstructed: None,
    };
    let told_of = |error: f64| summarize(&[run(error)], told).lines[0].points[0].relmse;
    let limit = FLOOR_FACTOR * told;
    checks.holds("errors told within the noise", told_of(0.99 * limit).is_none(), "0.99 of the limit");
    checks.holds("errors kept back beyond the noise", told_of(1.01 * limit).is_some(), "1.01 of the limit");
    checks.at_least("times the noise that an error must be", FLOOR_FACTOR, 10.0, "the limit");
    Ok(checks.outcome())
}
