//! Training on a data set: chunks as inference reads them, runs that repeat and resume, figures that are what they say.

mod common;
mod dataset_support;

use common::compare::{require, same_bits};
use common::gpu;
use dataset_support::{SEED_INPUTS, load, made, settings};
use limpid::denoise::{Crop, Denoiser, Frame, FrameStats, Guides, Kernels, Preparation, record_input};
use limpid::gpu::{Gpu, Slice};
use limpid::image::{Image, exr};
use limpid::metrics;
use limpid::net::architecture::Architecture;
use limpid::net::device::{Channels, DeviceTensor, Shape};
use limpid::net::kernel::Family;
use limpid::net::plan::Fusion;
use limpid::net::weights::Weights;
use limpid::train::batch::Batch;
use limpid::train::checkpoint;
use limpid::train::dataset::Part;
use limpid::train::preset::{Source, StoredSettings};
use limpid::train::run::{Length, Run, RunState};
use limpid::train::split::{Chunk, Split, chunks};
use std::path::Path;

/// Input and target tensors for a batch of square chunks.
fn tensors(gpu: &Gpu, preparation: Preparation, n: u32, side: u32) -> [DeviceTensor; 3] {
    let tensor = |channels: u32| {
        DeviceTensor::new(gpu, "tensor", Shape { n, h: side, w: side, c: Channels::new(channels) }).unwrap()
    };
    [tensor(preparation.inputs.channels() as u32), tensor(3), tensor(3)]
}

/// The planes of a picture file on the device, four floats a pixel.
fn planes(gpu: &Gpu, image: &Image, names: &[[&str; 3]]) -> Vec<Slice> {
    let plane = |[x, y, z]: &[&str; 3]| {
        let [x, y, z] = [x, y, z].map(|name| &image.channels[*name]);
        let texels: Vec<[f32; 4]> = (0..x.len()).map(|i| [x[i], y[i], z[i], 0.0]).collect();
        let buffer = gpu.buffer("plane", texels.len() as u64 * 16).unwrap();
        gpu.upload(&buffer.all(), &texels).unwrap();
        buffer.slice(0, texels.len() as u64 * 16)
    };
    names.iter().map(plane).collect()
}

/// The input that inference makes of a whole picture, its radiance replaced by `radiance` once exposure and depth scale are
/// known; NCHW.
fn whole_input(gpu: &Gpu, preparation: Preparation, image: &Image, radiance: &Image) -> Vec<f32> {
    let names: Vec<[&str; 3]> = preparation.inputs.planes().iter().map(|(_, names)| *names).collect();
    let of_file = planes(gpu, image, &names);
    let guides = Guides::of_planes(preparation.inputs, &of_file[1..]);
    let (width, height) = (image.width, image.height);
    let frame_stats = FrameStats::new(gpu, preparation.transfer, width, height).unwrap();
    let stats = gpu.buffer("stats", 16).unwrap().slice(0, 16);
    let c = Channels::new(preparation.inputs.channels() as u32);
    let input = DeviceTensor::new(gpu, "input", Shape { n: 1, h: height, w: width, c }).unwrap();
    let mut rec = gpu.recorder();
    frame_stats.record(&mut rec, &of_file[0], &guides, &stats).unwrap();
    let radiance = &planes(gpu, radiance, &[["R", "G", "B"]])[0];
    let frame = Frame { radiance, guides: &guides, stats: &stats, size: (width, height) };
    let crop = Crop { x: 0, y: 0, width, height, orientation: 0 };
    record_input(gpu, &mut rec, preparation.transfer, &frame, crop, &input.slice).unwrap();
    rec.finish().unwrap().run().unwrap();
    input.download(gpu).unwrap()
}

#[test]
fn a_loaded_chunk_is_what_inference_reads_of_the_same_pixels() {
    let gpu = gpu();
    let (width, height, side) = (96, 64, 32);
    let (dir, manifest) = made(&gpu, &settings(2, (width, height)));
    for preparation in [SEED_INPUTS(), Preparation::OPEN_IMAGE_DENOISE] {
        let frames = load(&gpu, preparation, dir.path());
        let all = chunks(2, 2, (width, height), side).unwrap();
        // Not in their order, and one twice.
        let batch: Vec<Chunk> = [17, 0, 5, 23, 0, 10].map(|i| all[i]).to_vec();
        let [input, target, output] = tensors(&gpu, preparation, batch.len() as u32, side);
        let mut loader = Batch::new(&gpu, preparation, (&input, &target, &output)).unwrap();
        loader.load(&frames, &batch).unwrap();
        let (inputs, targets) = (input.download(&gpu).unwrap(), target.download(&gpu).unwrap());
        let channels = preparation.inputs.channels();
        let area = (side * side) as usize;
        for (i, chunk) in batch.iter().enumerate() {
            let n = manifest.scenes[chunk.picture as usize];
            let read = |part: Part| exr::read(dir.path().join(part.file(n))).unwrap();
            let noisy = read(Part::Noisy(chunk.noisy));
            let cut = |whole: &[f32], channels: usize| -> Vec<f32> {
                let pixel = |c: usize, y: u32, x: u32| {
                    whole[(c * height as usize + (chunk.y + y) as usize) * width as usize + (chunk.x + x) as usize]
                };
                (0..channels)
                    .flat_map(|c| (0..side).flat_map(move |y| (0..side).map(move |x| (c, y, x))))
                    .map(|(c, y, x)| pixel(c, y, x))
                    .collect()
            };
            let expected = cut(&whole_input(&gpu, preparation, &noisy, &noisy), channels);
            require("input", same_bits(&inputs[i * channels * area..][..channels * area], &expected));
            let expected = cut(&whole_input(&gpu, preparation, &noisy, &read(Part::Target)), 3);
            require("target", same_bits(&targets[i * 3 * area..][..3 * area], &expected));
        }
    }
}

fn begin(gpu: &Gpu, dir: &Path, stored: StoredSettings, length: Length) -> Run {
    let weights = Weights::glorot(&Architecture::seed(), 1);
    let state = RunState::new("seed", Source::Stored(stored), 1e-3, length, None);
    let frames = load(gpu, SEED_INPUTS(), dir);
    Run::on_frames(gpu, Family::choose(gpu.info()), state, &weights, None, frames).unwrap()
}

/// Evaluates where it is due.
fn evaluate(run: &mut Run) {
    if run.state.evaluation_due() {
        run.evaluate(|| true).unwrap().expect("nothing asked it to stop");
    }
}

#[test]
fn a_resumed_run_is_the_uninterrupted_one_and_evaluations_change_nothing() {
    let gpu = gpu();
    let (dir, manifest) = made(&gpu, &settings(3, (64, 32)));
    // Eight chunks to train on, by threes: epochs end within steps.
    let stored = StoredSettings::new(5, 3, 32, Split::Scene, &manifest).unwrap();
    assert_eq!((stored.epoch_chunks, stored.steps_of(2)), (8, 6));
    let length = Length::Steps(stored.steps_of(2));
    let mut whole = begin(&gpu, dir.path(), stored.clone(), length);
    let mut expected = Vec::new();
    while !whole.state.done() {
        expected.push(whole.step().unwrap());
    }
    assert!(expected.iter().all(|record| record.learning_rate == 1e-3));

    let path = dir.path().join("run.checkpoint");
    let mut first = begin(&gpu, dir.path(), stored, length);
    let mut losses = Vec::new();
    while first.state.step < 4 {
        evaluate(&mut first);
        losses.push(first.step().unwrap().loss);
    }
    checkpoint::save(&path, &first.state, &first.weights("", "").unwrap(), &first.moments().unwrap()).unwrap();
    drop(first);
    let (state, parameters, moments) = checkpoint::load(&path).unwrap();
    let weights = Weights { parameters, ..Weights::glorot(&Architecture::seed(), 0) };
    let frames = load(&gpu, SEED_INPUTS(), dir.path());
    let mut second = Run::on_frames(&gpu, Family::choose(gpu.info()), state, &weights, Some(&moments), frames).unwrap();
    while !second.state.done() {
        evaluate(&mut second);
        losses.push(second.step().unwrap().loss);
    }
    evaluate(&mut second);
    assert_eq!(losses, expected.iter().map(|record| record.loss).collect::<Vec<_>>());
    let parameters = |run: &Run| run.weights("", "").unwrap().parameters;
    require("parameters", same_bits(&parameters(&second), &parameters(&whole)));
    let (a, b) = (second.moments().unwrap(), whole.moments().unwrap());
    require("mean", same_bits(&a.mean, &b.mean));
    require("mean square", same_bits(&a.mean_square, &b.mean_square));

    // Epochs end in the steps 3 and 6; evaluated once each, and the same without the interruption.
    let evaluations = &second.state.evaluations;
    let places: Vec<_> = evaluations.iter().map(|e| (e.step, e.epoch)).collect();
    assert_eq!(places, [(3, Some(1)), (6, Some(2))]);
    let last = whole.evaluate(|| true).unwrap().expect("nothing asked it to stop");
    assert_eq!(Some(&last), evaluations.last());
    assert_ne!(last.loss, last.held_out_loss);
    assert!(evaluations[1].loss != evaluations[0].loss);
    assert_eq!(whole.evaluate(|| false).unwrap(), None);
    let metadata = second.weights("device", "limpid train").unwrap().metadata;
    for (key, value) in
        [("preset", "paper"), ("split", "scene"), ("epochs", "2"), ("steps", "6"), ("evaluated_at_step", "6")]
    {
        assert_eq!(metadata[key], value);
    }
    for (key, value) in [
        ("loss", last.loss),
        ("held_out_loss", last.held_out_loss),
        ("mae01", last.mae01),
        ("held_out_mae01", last.held_out_mae01),
    ] {
        assert_eq!(metadata[key], format!("{value:.6}"));
    }
}

/// With one chunk on each side there is nothing to average: the loss is the next step's, MAE01 that of the reconstruction.
#[test]
fn evaluations_are_the_figures_of_loss_and_reconstruction() {
    let gpu = gpu();
    let (dir, manifest) = made(&gpu, &settings(1, (64, 64)));
    let stored = StoredSettings::new(0, 1, 64, Split::Chunk, &manifest).unwrap();
    let sides = stored.sides(1, (64, 64)).unwrap();
    let mut run = begin(&gpu, dir.path(), stored, Length::Steps(5));
    // The first steps move the network away from where it is black.
    for _ in 0..4 {
        run.step().unwrap();
    }
    let evaluation = run.evaluate(|| true).unwrap().expect("nothing asked it to stop");
    let weights = run.weights("", "").unwrap();
    let loss = run.step().unwrap().loss;
    // The device adds the three channels of a pixel in f32.
    assert!((loss - evaluation.loss).abs() <= 3.0 * 2f64.powi(-24) * loss, "{loss} {evaluation:?}");

    let n = manifest.scenes[0];
    let target = exr::read(dir.path().join(Part::Target.file(n))).unwrap();
    let family = Family::choose(gpu.info());
    let kernels = Kernels { family, fusion: Fusion::training(family) };
    let denoiser = Denoiser::with_kernels(&gpu, &weights, kernels, (64, 64)).unwrap();
    for (side, mae01) in [(sides.training, evaluation.mae01), (sides.held_out, evaluation.held_out_mae01)] {
        let image = exr::read(dir.path().join(Part::Noisy(side[0].noisy).file(n))).unwrap();
        let screen = &planes(&gpu, &image, &[["Nscreen.X", "Nscreen.Y", "Z"]])[0];
        let radiance = gpu.buffer("radiance", 64 * 64 * 16).unwrap().slice(0, 64 * 64 * 16);
        let albedo = image.rgb("albedo").unwrap();
        let [r, g, b] = image.rgb("").unwrap();
        let exact = |i: usize| f32::from(u8::from(albedo.iter().all(|plane| plane[i] == 0.0)));
        let texels: Vec<[f32; 4]> = (0..r.len()).map(|i| [r[i], g[i], b[i], exact(i)]).collect();
        assert!(texels.iter().any(|t| t[3] == 1.0) && texels.iter().any(|t| t[3] == 0.0));
        gpu.upload(&radiance, &texels).unwrap();
        let guides = Guides::NormalScreenDepth { screen: screen.clone() };
        let (planes, _) = denoiser.run(&radiance, &guides).unwrap();
        let planes = planes.each_ref().map(Vec::as_slice);
        let expected = metrics::evaluate(planes, target.rgb("").unwrap(), 64, 64, None).unwrap().all.mae01;
        assert!((mae01 - expected).abs() <= 1e-12 * expected, "{mae01}, inference {expected}");
    }
}

/// Batches that the chunks do not fill show some chunk twice, which must not count twice.
#[test]
fn evaluations_do_not_depend_on_the_size_of_batches() {
    let gpu = gpu();
    let (dir, manifest) = made(&gpu, &settings(3, (64, 32)));
    let figures = |batch| {
        let stored = StoredSettings::new(5, batch, 32, Split::Scene, &manifest).unwrap();
        assert_eq!(stored.sides(3, (64, 32)).unwrap().held_out.len(), 4);
        let mut run = begin(&gpu, dir.path(), stored, Length::Steps(1));
        let e = run.evaluate(|| true).unwrap().expect("nothing asked it to stop");
        [e.loss, e.held_out_loss, e.mae01, e.held_out_mae01]
    };
    // Sums of f64 in another order.
    for (a, b) in figures(4).into_iter().zip(figures(3)) {
        assert!((a - b).abs() <= 1e-12 * a, "{a} {b}");
    }
}

#[test]
fn settings_that_do_not_fit_are_refused() {
    let gpu = gpu();
    let (dir, manifest) = made(&gpu, &settings(2, (48, 48)));
    let error = |batch, chunk, split| {
        let stored = match StoredSettings::new(0, batch, chunk, split, &manifest) {
            Ok(stored) => stored,
            Err(error) => return error.to_string(),
        };
        let state = RunState::new("seed", Source::Stored(stored), 1e-3, Length::Steps(1), None);
        let frames = load(&gpu, SEED_INPUTS(), dir.path());
        let weights = Weights::glorot(&Architecture::seed(), 1);
        Run::on_frames(&gpu, Family::choose(gpu.info()), state, &weights, None, frames)
            .err()
            .expect("refused")
            .to_string()
    };
    assert!(error(1, 32, Split::Scene).contains("no whole number of chunks"));
    assert!(error(1, 0, Split::Scene).contains("no whole number of chunks"));
    assert!(error(1, 16, Split::Scene).contains("multiples of 32"));
    assert!(error(0, 48, Split::Scene).contains("multiples of 32"));
    let (_, one) = made(&gpu, &settings(1, (32, 32)));
    assert!(StoredSettings::new(0, 1, 32, Split::Scene, &one).unwrap_err().to_string().contains("at least two scenes"));
    // A run on one data set does not take another's pictures.
    let (other, larger) = made(&gpu, &settings(2, (32, 32)));
    let stored = StoredSettings { epoch_chunks: 8, ..StoredSettings::new(0, 1, 32, Split::Scene, &larger).unwrap() };
    let state = RunState::new("seed", Source::Stored(stored), 1e-3, Length::Steps(1), None);
    let weights = Weights::glorot(&Architecture::seed(), 1);
    let frames = load(&gpu, SEED_INPUTS(), other.path());
    let refused =
        Run::on_frames(&gpu, Family::choose(gpu.info()), state, &weights, None, frames).err().expect("refused");
    assert!(refused.to_string().contains("not those of the data set"));
}
