//! The loss scale and the ends of f16's range, for the kernels that multiply f16.

mod common;

use common::compare::{close, require, same_bits};
use common::networks::{tiny, weights};
use common::{goldens, gpu, precision};
use limpid::gpu::Gpu;
use limpid::net::architecture::Architecture;
use limpid::net::device::{Channels, DeviceTensor, Shape};
use limpid::net::kernel::{Family, conv2d};
use limpid::net::weights::Weights;
use limpid::train::adam::Adam;
use limpid::train::checkpoint;
use limpid::train::data::DataSettings;
use limpid::train::kernel::conv2d as conv_grad;
use limpid::train::loss::Loss;
use limpid::train::loss_scale::{GROWTH_INTERVAL, State};
use limpid::train::run::{Length, RunState};
use limpid::train::step::{Moments, Step};

const LARGEST: f32 = 16_777_216.0;

/// The device's family with f16, where there is one.
fn half_family(gpu: &Gpu) -> Option<Family> {
    precision::families(gpu.info()).into_iter().find(|f| matches!(f, Family::Coop(_)))
}

/// A step of a network whose weights are the goldens' times `factor`, on one batch.
fn step(gpu: &Gpu, family: Family, factor: f32) -> Step {
    let architecture = tiny();
    let mut weights = weights(&architecture);
    weights.parameters.iter_mut().for_each(|p| *p *= factor);
    let step = Step::new(gpu, family, &weights, (2, 8, 8), Adam::default(), Loss::Mae).unwrap();
    step.input().upload(gpu, &goldens::drawn([2, 4, 8, 8], "mixed/input").data).unwrap();
    step.target().upload(gpu, &goldens::drawn([2, 3, 8, 8], "mixed/target").data).unwrap();
    step
}

fn set_scale(step: &mut Step, scale: f32, good_steps: u32) {
    let moments = step.moments().unwrap();
    step.set_moments(&Moments { loss_scale: Some(State { scale, good_steps }), ..moments }).unwrap();
}

/// A scale whose gradients leave f16's range: nothing but the scale changes, until it is small enough.
#[test]
fn a_step_with_an_infinite_gradient_is_skipped() {
    let gpu = gpu();
    let Some(family) = half_family(&gpu) else { return };
    let mut step = step(&gpu, family, 8.0);
    set_scale(&mut step, LARGEST, 5);
    let mut skipped = 0;
    loop {
        let (before, parameters) = (step.moments().unwrap(), step.parameters.get().unwrap());
        let scale = before.loss_scale.unwrap().scale;
        let (loss, _) = step.run(1e-3).unwrap();
        assert!(loss.is_finite());
        let (after, finite) = (step.moments().unwrap(), step.gradient().unwrap().iter().all(|g| g.is_finite()));
        if finite {
            assert_eq!(after.loss_scale, Some(State { scale, good_steps: 1 }));
            assert!(after.mean.iter().all(|m| m.is_finite()) && after.mean != before.mean);
            assert!(step.parameters.get().unwrap() != parameters);
            break;
        }
        skipped += 1;
        assert_eq!(after.loss_scale, Some(State { scale: scale / 2.0, good_steps: 0 }));
        assert!(after.mean == before.mean && after.mean_square == before.mean_square);
        require("parameters of a skipped step", same_bits(&step.parameters.get().unwrap(), &parameters));
    }
    assert!(skipped > 0, "no gradient was infinite: the test shows nothing");
}

/// The gradient does not depend on the scale, but for the roundings of f16 that it moves.
#[test]
fn the_scale_grows_after_good_steps_and_leaves_the_gradient() {
    let gpu = gpu();
    let Some(family) = half_family(&gpu) else { return };
    let mut gradients = Vec::new();
    for (scale, good_steps, next) in [
        (1024.0, 0, State { scale: 1024.0, good_steps: 1 }),
        (2048.0, GROWTH_INTERVAL - 2, State { scale: 2048.0, good_steps: GROWTH_INTERVAL - 1 }),
        (2048.0, GROWTH_INTERVAL - 1, State { scale: 4096.0, good_steps: 0 }),
        (LARGEST, GROWTH_INTERVAL - 1, State { scale: LARGEST, good_steps: 0 }),
    ] {
        let mut step = step(&gpu, family, 0.25);
        assert_eq!(step.moments().unwrap().loss_scale, Some(State::default()));
        set_scale(&mut step, scale, good_steps);
        step.run(1e-3).unwrap();
        assert_eq!(step.moments().unwrap().loss_scale, Some(next));
        gradients.push(step.gradient().unwrap());
    }
    // These scales leave every gradient a normal number of f16 or next to nothing: the roundings are the same.
    let largest = gradients[0].iter().fold(0f32, |a, g| a.max(g.abs()));
    for gradient in &gradients[1..] {
        require("gradient", close(gradient, &gradients[0], f64::from(largest) * 1e-3, 0.0));
    }
}

/// Kernels in f32 have no loss scale.
#[test]
fn f32_has_no_loss_scale() {
    let gpu = gpu();
    for family in precision::f32_families(gpu.info()) {
        assert_eq!(step(&gpu, family, 1.0).moments().unwrap().loss_scale, None);
    }
}

/// Activations beyond f16 are clamped and NaN stays; a gradient beyond f16 must not hide: its weight gradient is infinite.
#[test]
fn operands_beyond_the_range_of_f16() {
    let gpu = gpu();
    let Some(family) = half_family(&gpu) else { return };
    let shape = Shape { n: 1, h: 1, w: 4, c: Channels::new(1) };
    let layer = conv2d::Layer { input: shape.c, cout: 1 };
    let tensor = |name: &str, values: &[f32]| {
        let tensor = DeviceTensor::new(&gpu, name, shape).unwrap();
        tensor.upload(&gpu, values).unwrap();
        tensor
    };
    let x = tensor("x", &[1e6, -f32::INFINITY, 65_504.0, f32::NAN]);
    let y = tensor("y", &[0.0; 4]);
    let (weight, bias) = (gpu.buffer("weight", 256).unwrap(), gpu.buffer("bias", 256).unwrap());
    // The middle tap alone.
    gpu.upload(&weight.all(), &[0.0f32, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0]).unwrap();
    let packed = gpu.buffer("packed", layer.packed_bytes(family, false)).unwrap().all();
    let mut rec = gpu.recorder();
    conv2d::pack(&gpu, &mut rec, family, layer, &weight.all(), &packed, false).unwrap();
    let pass = conv2d::Pass { x: &x, weight: &packed, bias: &bias.all(), y: &y, slope: 1.0 };
    conv2d::record(&gpu, &mut rec, family, &pass).unwrap();
    rec.finish().unwrap().run().unwrap();
    let values = y.download(&gpu).unwrap();
    // The third pixel's taps reach the NaN, 0 times which is NaN too.
    assert_eq!(values[..2], [32_752.0, -32_752.0]);
    assert!(values[3].is_nan(), "{values:?}");

    for (value, finite) in [(65_504.0, true), (1e6, false), (f32::NAN, false)] {
        let (x, dy) = (tensor("x", &[1.0; 4]), tensor("dy", &[0.0, value, 0.0, 0.0]));
        let scratch = conv_grad::Scratch::new(&gpu, family, &[(layer, shape)]).unwrap();
        let dw = gpu.buffer("dw", 256).unwrap();
        let mut rec = gpu.recorder();
        conv_grad::weight_grad(&gpu, &mut rec, layer, &scratch, &x, &dy, &dw.all()).unwrap();
        rec.finish().unwrap().run().unwrap();
        let values: Vec<f32> = gpu.download(&dw.all()).unwrap();
        assert_eq!(values[..9].iter().all(|v| v.is_finite()), finite, "{value}: {values:?}");
    }
}

/// A checkpoint keeps the loss scale, or that there is none, and refuses one that no run comes to.
#[test]
fn checkpoints_keep_the_loss_scale() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run.checkpoint");
    let weights = Weights::glorot(&Architecture::seed(), 1);
    let zeros = vec![0.0; weights.parameters.len()];
    let run = RunState::new("seed", DataSettings::default(), 1e-3, Length::Steps(8), None);
    let scales = [(8192.0, true), (LARGEST, true), (1000.0, false), (0.5, false), (2.0 * LARGEST, false)];
    let states = scales.map(|(scale, valid)| (Some(State { scale, good_steps: 7 }), valid));
    for (loss_scale, valid) in [(None, true)].into_iter().chain(states) {
        let moments = Moments { step: 0, mean: zeros.clone(), mean_square: zeros.clone(), loss_scale };
        checkpoint::save(&path, &run, &weights, &moments).unwrap();
        match checkpoint::load(&path) {
            Ok((_, _, read)) => assert!(valid && read == moments, "{loss_scale:?}: {:?}", read.loss_scale),
            Err(e) => assert!(!valid && e.to_string().contains("power of two"), "{loss_scale:?}: {e}"),
        }
    }
}
