//! Renders that end at an error or after a time.

mod render_support;

use limpid::gpu::Gpu;
use limpid::image::Image;
use limpid::metrics::relmse;
use limpid::render::{Goal, Next, Pursuit, Reached, Renderer, Sampler, Settings};
use limpid::scene::{Scene, family, rooms};
use render_support::*;
use std::time::{Duration, Instant};

const SIZE: u32 = 96;
/// No scene is there after the first samples.
const GOAL: f64 = 0.01;

/// Sixteen held-out scenes of both families, lit so that the mean radiance is 0.5: relMSE is about relative errors then.
fn scenes(gpu: &Gpu) -> Vec<Scene> {
    (0..8)
        .flat_map(|i| [family::spheres(90_000 + i), rooms::rooms(90_000 + i)])
        .map(|mut scene| {
            (scene.camera.width, scene.camera.height) = (SIZE, SIZE);
            let image = render(gpu, &scene, &Settings { spp: 16, ..Settings::default() });
            let mean = image.channels["G"].iter().map(|&v| f64::from(v)).sum::<f64>() / f64::from(SIZE * SIZE);
            scene.shapes.iter_mut().for_each(|shape| shape.radiance *= 0.5 / mean);
            scene
        })
        .collect()
}

fn pursue(renderer: &mut Renderer, goal: Goal) -> (Reached, Option<f64>) {
    let (start, mut pursuit) = (Instant::now(), Pursuit::from(goal));
    loop {
        match pursuit.next(renderer, start.elapsed()).expect("next") {
            Next::Done(reached) => return (reached, pursuit.relmse),
            Next::Samples(samples) => while !renderer.advance_to(samples).expect("advance").done() {},
        }
    }
}

fn true_relmse(image: &Image, halves: &[Image; 2]) -> f64 {
    let [a, b] = halves;
    relmse(image.rgb("").expect("rgb"), [a.rgb("").expect("rgb"), b.rgb("").expect("rgb")])
}

/// The true relMSE at the stop lies within 0.6 to 1.2 of the goal: over 16 scenes, both samplers, both kinds of camera rays.
#[test]
fn the_true_error_at_the_stop_is_near_the_goal() {
    let gpu = device();
    let (mut least, mut most) = (f64::INFINITY, 0.0f64);
    for (i, scene) in scenes(&gpu).into_iter().enumerate() {
        let aa = i / 2 % 2 == 1;
        let reference = |seed| render(&gpu, &scene, &Settings { spp: 512, seed, aa, ..Settings::default() });
        let halves = [reference(u32::MAX), reference(u32::MAX - 1)];
        for sampler in Sampler::ALL {
            let settings = Settings { spp: 1 << 20, sampler, aa, halves: true, ..Settings::default() };
            let mut renderer = Renderer::new(&gpu, &scene, &settings).expect("renderer");
            let (reached, estimate) = pursue(&mut renderer, Goal { relmse: Some(GOAL), time: None });
            assert_eq!(reached, Reached::Error);
            let error = true_relmse(&renderer.image().expect("image"), &halves) / GOAL;
            let (spp, estimate) = (renderer.samples_done(), estimate.expect("an estimate") / GOAL);
            println!("scene {i} {sampler}: {spp} spp, {error:.3} of the goal, estimated {estimate:.3}");
            (least, most) = (least.min(error), most.max(error));
        }
    }
    assert!(least >= 0.6 && most <= 1.2, "{least} to {most} of the goal");
}

/// The estimate is the one of its definition, and only where the halves are equal.
#[test]
fn the_estimate_is_that_of_its_definition() {
    let gpu = device();
    let settings = Settings { spp: 7, sampler: Sampler::Pcg, halves: true, ..Settings::default() };
    let mut renderer = Renderer::new(&gpu, &cornell(40), &settings).expect("renderer");
    assert_eq!(renderer.relmse_estimate().expect("estimate"), None, "no samples");
    // Of independent samples the even ones are those of a render that drops the odd ones: sums of one render less another's.
    let sums = |spp: u32| {
        let image = render(&gpu, &cornell(40), &Settings { spp, halves: false, ..settings.clone() });
        ["R", "G", "B"].map(|c| image.channels[c].iter().map(|&v| f64::from(v) * f64::from(spp)).collect::<Vec<f64>>())
    };
    let albedo = render(&gpu, &cornell(40), &Settings { spp: 1, ..Settings::default() });
    let exact: Vec<bool> =
        (0..1600).map(|i| ["R", "G", "B"].iter().all(|c| albedo.channels[&format!("albedo.{c}")][i] == 0.0)).collect();
    let up_to: Vec<_> = (0..=4).map(|n| if n == 0 { [(); 3].map(|()| vec![0.0; 1600]) } else { sums(n) }).collect();
    let mut expected = 0.0;
    for i in (0..1600usize).filter(|&i| !exact[i]) {
        for c in [0, 1, 2] {
            let sample = |n: usize| up_to[n + 1][c][i] - up_to[n][c][i];
            let error = (sample(0) - sample(1) + sample(2) - sample(3)) / 4.0;
            let (x, y) = (i % 40, i / 40);
            let near: Vec<f64> = (y.saturating_sub(1)..=(y + 1).min(39))
                .flat_map(|v| (x.saturating_sub(1)..=(x + 1).min(39)).map(move |u| v * 40 + u))
                .filter(|&j| !exact[j])
                .map(|j| up_to[4][c][j] / 4.0)
                .collect();
            let mean = near.iter().sum::<f64>() / near.len() as f64;
            expected += error * error / (mean * mean + 0.01) / 3.0 / 1600.0;
        }
    }
    while !renderer.advance_to(4).expect("advance").done() {}
    let estimate = renderer.relmse_estimate().expect("estimate").expect("equal halves");
    // Sums of up to 16 terms in f32, and samples as differences of means rounded to f32.
    assert!((estimate / expected - 1.0).abs() < 1e-4, "{estimate}, by definition {expected}");
    while !renderer.advance_to(5).expect("advance").done() {}
    assert_eq!(renderer.relmse_estimate().expect("estimate"), None, "an odd number of samples");
    let mut whole = Renderer::new(&gpu, &cornell(8), &Settings::default()).expect("renderer");
    assert!(matches!(whole.relmse_estimate(), Err(limpid::Error::Input(_))), "no halves");
}

/// Independent samples are the same whether their halves are told apart or not; nets are not, but estimate the same.
#[test]
fn halves_change_no_independent_sample() {
    let gpu = device();
    for aa in [false, true] {
        let plain = Settings { spp: 70, sampler: Sampler::Pcg, aa, ..Settings::default() };
        let halves = Settings { halves: true, ..plain.clone() };
        assert_same_bits(&render(&gpu, &cornell(32), &plain), &render(&gpu, &cornell(32), &halves), "pcg");
    }
    let nets = Settings { spp: 64, halves: true, ..Settings::default() };
    let image = render(&gpu, &cornell(32), &nets);
    let other = render(&gpu, &cornell(32), &Settings { halves: false, ..nets.clone() });
    assert!(image.channels["R"] != other.channels["R"]);
    // Whatever the cut into dispatches, and through a checkpoint.
    let mut renderer = Renderer::new(&gpu, &cornell(32), &nets).expect("renderer");
    renderer.limit_chunk(7);
    renderer.advance().expect("advance");
    let bytes = renderer.checkpoint_bytes().expect("checkpoint");
    let mut renderer = Renderer::new(&gpu, &cornell(32), &nets).expect("renderer");
    renderer.restore_bytes(&bytes).expect("restore");
    renderer.finish().expect("render");
    assert_same_bits(&image, &renderer.image().expect("image"), "resumed");
    let mut straight = Renderer::new(&gpu, &cornell(32), &nets).expect("renderer");
    straight.finish().expect("render");
    let estimates =
        [&mut renderer, &mut straight].map(|r| r.relmse_estimate().expect("estimate").expect("equal halves"));
    assert_eq!(estimates[0], estimates[1]);
}

/// By a clock of its own: samples take 10 ms, from the 50th on 40 ms.
#[test]
fn a_render_that_gets_slower_ends_in_time() {
    let gpu = device();
    let mut renderer =
        Renderer::new(&gpu, &cornell(8), &Settings { spp: 100_000, ..Settings::default() }).expect("renderer");
    let limit = Duration::from_millis(4000);
    let mut pursuit = Pursuit::from(Goal { relmse: None, time: Some(limit) });
    let clock = |done: u32| Duration::from_millis(u64::from(10 * done.min(50) + 40 * done.saturating_sub(50)));
    while let Next::Samples(samples) = {
        let elapsed = clock(renderer.samples_done());
        pursuit.next(&mut renderer, elapsed).expect("next")
    } {
        while !renderer.advance_to(samples).expect("advance").done() {}
    }
    let elapsed = clock(renderer.samples_done());
    assert!(elapsed <= limit && elapsed + Duration::from_millis(40) > limit, "{elapsed:?}");
}

/// By a clock of its own: a sample takes 30 ms.
#[test]
fn a_render_for_a_time_ends_with_whole_samples_within_it() {
    let gpu = device();
    for (limit_ms, expected) in [(1u64, 2), (100, 3), (1000, 33), (9000, 300)] {
        let settings = Settings { spp: 100_000, ..Settings::default() };
        let mut renderer = Renderer::new(&gpu, &cornell(8), &settings).expect("renderer");
        let mut pursuit = Pursuit::from(Goal { relmse: None, time: Some(Duration::from_millis(limit_ms)) });
        let clock = |renderer: &Renderer| Duration::from_millis(30 * u64::from(renderer.samples_done()));
        while let Next::Samples(samples) = {
            let elapsed = clock(&renderer);
            pursuit.next(&mut renderer, elapsed).expect("next")
        } {
            while !renderer.advance_to(samples).expect("advance").done() {}
        }
        assert_eq!(renderer.samples_done(), expected, "{limit_ms} ms");
    }
}
