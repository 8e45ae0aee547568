//! Training runs repeat and resume to the same bits; checkpoints survive or say what is wrong.

mod common;

use common::compare::{require, same_bits};
use common::gpu;
use limpid::gpu::Gpu;
use limpid::net::architecture::Architecture;
use limpid::net::kernel::Family;
use limpid::net::weights::Weights;
use limpid::train::checkpoint;
use limpid::train::data::{DataSettings, Scenes};
use limpid::train::preset::Source;
use limpid::train::run::{FIRST_LOSSES, Length, RUN, Run, RunState};

fn state(seed: u64) -> RunState {
    let data = DataSettings {
        seed,
        batch: 2,
        crop: 32,
        window: 40,
        pool: 2,
        initial: 1,
        refresh: 2,
        spp: 2,
        reference_spp: 4,
        larger_crops: vec![],
        scenes: Scenes::Spheres,
    };
    RunState::new("seed", data, 1e-3, Length::Steps(8), None)
}

fn begin(gpu: &Gpu, seed: u64) -> Run {
    Run::new(gpu, Family::choose(gpu.info()), state(seed), &Weights::glorot(&Architecture::seed(), seed), None).unwrap()
}

fn losses(run: &mut Run, steps: usize) -> Vec<f64> {
    (0..steps).map(|_| run.step().unwrap().loss).collect()
}

fn parameters(run: &Run) -> Vec<f32> {
    run.weights("test", "test").unwrap().parameters
}

#[test]
fn a_seed_gives_the_same_bits_and_another_seed_others() {
    let gpu = gpu();
    let (mut a, mut b, mut c) = (begin(&gpu, 1), begin(&gpu, 1), begin(&gpu, 2));
    let (la, lb, lc) = (losses(&mut a, 5), losses(&mut b, 5), losses(&mut c, 5));
    assert_eq!(la, lb);
    assert_ne!(la, lc);
    require("parameters", same_bits(&parameters(&a), &parameters(&b)));
    assert!(same_bits(&parameters(&a), &parameters(&c)).is_err());
}

#[test]
fn a_resumed_run_is_the_uninterrupted_one() {
    let gpu = gpu();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run.checkpoint");
    let mut whole = begin(&gpu, 3);
    let expected = losses(&mut whole, 8);
    // Seven steps have replaced every example of the pool: resuming must render the right ones again.
    let mut first = begin(&gpu, 3);
    let mut actual = losses(&mut first, 7);
    checkpoint::save(&path, &first.state, &first.weights("", "").unwrap(), &first.moments().unwrap()).unwrap();
    drop(first);
    let (state, parameters_then, moments) = checkpoint::load(&path).unwrap();
    let mut weights = Weights::glorot(&Architecture::seed(), 0);
    weights.parameters = parameters_then;
    let mut second = Run::new(&gpu, Family::choose(gpu.info()), state, &weights, Some(&moments)).unwrap();
    actual.extend(losses(&mut second, 1));
    assert_eq!(actual, expected);
    assert!(second.state.done() && whole.state.done());
    require("parameters", same_bits(&parameters(&second), &parameters(&whole)));
    let (a, b) = (second.moments().unwrap(), whole.moments().unwrap());
    require("mean", same_bits(&a.mean, &b.mean));
    require("mean square", same_bits(&a.mean_square, &b.mean_square));
}

#[test]
fn weights_say_how_they_were_made() {
    let gpu = gpu();
    let mut run = begin(&gpu, 4);
    let recorded = losses(&mut run, 2);
    let weights = run.weights("device", "limpid train").unwrap();
    let bits: Vec<String> = recorded.iter().map(|loss| format!("{:016x}", loss.to_bits())).collect();
    assert_eq!(weights.metadata[FIRST_LOSSES], bits.join(" "));
    let again: RunState = serde_json::from_str(&weights.metadata[RUN]).unwrap();
    assert_eq!((again.data, again.length), (run.state.data.clone(), run.state.length));
    limpid::denoise::Preparation::of_weights(&weights, "made by training").unwrap();
}

#[test]
fn damaged_checkpoints_are_refused_by_name() {
    let gpu = gpu();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run.checkpoint");
    let run = begin(&gpu, 5);
    checkpoint::save(&path, &run.state, &run.weights("", "").unwrap(), &run.moments().unwrap()).unwrap();
    let whole = std::fs::read(&path).unwrap();
    for length in [0, 7, 100, whole.len() / 2, whole.len() - 1] {
        std::fs::write(&path, &whole[..length]).unwrap();
        let message = checkpoint::load(&path).unwrap_err().to_string();
        assert!(message.contains("run.checkpoint"), "{length}: {message}");
    }
    std::fs::write(&path, Weights::glorot(&Architecture::seed(), 1).to_bytes()).unwrap();
    assert!(checkpoint::load(&path).unwrap_err().to_string().contains("no state"));
}

#[test]
fn settings_that_do_not_fit_are_refused() {
    let gpu = gpu();
    let weights = Weights::glorot(&Architecture::seed(), 1);
    for (change, word) in [
        ((|d: &mut DataSettings| d.batch = 0) as fn(&mut DataSettings), "is 0"),
        (|d| d.crop = 48, "multiples of 32"),
        (|d| d.crop = 64, "at most the window"),
    ] {
        let mut state = state(1);
        let Source::Fresh(data) = &mut state.data else { panic!("{:?}", state.data) };
        change(data);
        let message =
            Run::new(&gpu, Family::choose(gpu.info()), state, &weights, None).err().expect("refused").to_string();
        assert!(message.contains(word), "{message}");
    }
}
