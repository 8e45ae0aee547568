//! How good a network in training is: the loss and MAE01 on fixed chunks, some shown in training, some held out.

use super::batch::Batch;
use super::data::{DataSettings, Scenes};
use super::dataset::{DatasetSettings, Frames};
use super::preset::StoredSettings;
use super::split::{Chunk, Sides, chunks, permutation};
use super::step::Step;
use crate::denoise::Preparation;
use crate::gpu::Gpu;
use crate::net::tensor::{hash, seed_of};
use crate::scene::{Scene, family, rooms};
use crate::{Error, Result};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;

/// Training chunks that are looked at; held-out ones are looked at all.
const TRAINING_SAMPLE: usize = 256;
/// Scenes of each kind and side where nothing is stored.
const FRESH_SCENES: usize = 8;

/// Figures on chunks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figures {
    /// The loss that training minimises.
    pub loss: f64,
    /// Mean absolute difference of linear radiance clamped to [0, 1], exact pixels kept, as inference keeps them.
    pub mae01: f64,
}

/// The figures after some step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Steps done.
    pub step: u64,
    /// Epochs over; none where there are no epochs.
    pub epoch: Option<u64>,
    /// Loss on a fixed sample of training chunks.
    pub loss: f64,
    /// Loss on the held-out chunks.
    pub held_out_loss: f64,
    /// MAE01 on the sample of training chunks.
    pub mae01: f64,
    /// MAE01 on the held-out chunks.
    pub held_out_mae01: f64,
}

/// The chunks that are looked at, and the way to the device.
pub struct Yardstick {
    pub(super) frames: Frames,
    pub(super) batch: Batch,
    /// Chunks for training, all or a sample.
    training: Vec<Chunk>,
    held_out: Vec<Chunk>,
}

impl Yardstick {
    /// For the sides of a data set.
    pub fn stored(gpu: &Gpu, frames: Frames, sides: &Sides, settings: &StoredSettings, step: &Step) -> Result<Self> {
        let sample = permutation(hash(settings.seed, seed_of("training sample")), sides.training.len());
        let sample = sample.into_iter().take(TRAINING_SAMPLE.min(sides.held_out.len()));
        let mut training: Vec<Chunk> = sample.map(|i| sides.training[i as usize]).collect();
        training.sort_unstable();
        Self::new(gpu, frames, (training, sides.held_out.clone()), step)
    }

    /// For a run without a data set: renders scenes of its kinds that training may show, and as many that are held out.
    pub fn fresh(
        gpu: &Gpu,
        preparation: Preparation,
        data: &DataSettings,
        step: &Step,
        progress: impl FnMut(u64, u64),
    ) -> Result<Self> {
        let crop = step.input().shape.w;
        let (seed, spp, reference_spp) = (data.seed, data.spp, data.reference_spp);
        let settings = DatasetSettings { count: 1, width: 2 * crop, height: 2 * crop, spp, reference_spp, seed };
        let kinds: &[fn(u64) -> Scene] = match data.scenes {
            Scenes::Spheres => &[family::spheres],
            Scenes::Mixed => &[family::spheres, rooms::rooms],
        };
        let numbers = [shown_scenes(seed), held_out_scenes(seed)];
        let scenes: Vec<(u64, Scene)> =
            numbers.iter().flat_map(|side| kinds.iter().flat_map(|kind| side.iter().map(|n| (*n, kind(*n))))).collect();
        let frames = Frames::render(gpu, preparation, &settings, &scenes, progress)?;
        // One of the four chunks of each noisy picture: more scenes say more than more of a scene.
        let all = chunks(scenes.len() as u32, super::dataset::NOISY_VERSIONS, frames.size(), crop)?;
        let chosen = all.chunks(4).enumerate().map(|(i, four)| four[(hash(seed, i as u64) % 4) as usize]);
        let (training, held_out) = chosen.partition(|c| (c.picture as usize) < scenes.len() / 2);
        Self::new(gpu, frames, (training, held_out), step)
    }

    fn new(gpu: &Gpu, frames: Frames, (training, held_out): (Vec<Chunk>, Vec<Chunk>), step: &Step) -> Result<Self> {
        let batch = Batch::new(gpu, frames.preparation(), (step.input(), step.target(), step.plan().output()))?;
        Ok(Self { frames, batch, training, held_out })
    }

    /// The figures of both sides, training first. Where `go_on` returns false the work stops and there is no result.
    pub fn run(&mut self, step: &mut Step, go_on: &mut dyn FnMut() -> bool) -> Result<Option<[Figures; 2]>> {
        let Self { frames, batch, training, held_out } = self;
        let mut figures = |chunks: &[Chunk]| measure((frames, chunks), batch, step, go_on);
        let Some(training) = figures(training)? else { return Ok(None) };
        Ok(figures(held_out)?.map(|held_out| [training, held_out]))
    }
}

/// The figures of a network on chunks of pictures; see [`Yardstick::run`].
fn measure(
    (frames, chunks): (&Frames, &[Chunk]),
    batch: &mut Batch,
    step: &mut Step,
    go_on: &mut dyn FnMut() -> bool,
) -> Result<Option<Figures>> {
    let (mut loss, mut mae01) = (0.0, 0.0);
    let pixels = step.input().shape.h as usize * step.input().shape.w as usize;
    for group in chunks.chunks(batch.count()) {
        if !go_on() {
            return Ok(None);
        }
        // The last group is filled up; what is filled in does not count.
        let filled: Vec<Chunk> = group.iter().copied().cycle().take(batch.count()).collect();
        batch.load(frames, &filled)?;
        loss += step.forward(group.len() as u32)?.0 * group.len() as f64;
        let count = group.len() * pixels;
        let reconstruction = batch.reconstruction()?;
        let reference: Vec<[f32; 4]> =
            batch.targets(frames, group).into_iter().map(|[r, g, b]| [r, g, b, 0.0]).collect();
        mae01 += sum(&reconstruction[..count], &reference, |v| f64::from(v.clamp(0.0, 1.0)));
    }
    let values = (3 * pixels * chunks.len()) as f64;
    let figures = Figures { loss: loss / chunks.len() as f64, mae01: mae01 / values };
    if !(figures.loss.is_finite() && figures.mae01.is_finite()) {
        return Err(Error::Gpu(format!(
            "the network's output is not finite after {} steps; resume from the last checkpoint with a smaller --learning-rate",
            step.steps_done()
        )));
    }
    Ok(Some(figures))
}

/// The sum of the absolute differences of three channels, in an order that no number of threads changes.
fn sum(a: &[[f32; 4]], b: &[[f32; 4]], value: impl Fn(f32) -> f64 + Sync) -> f64 {
    const PART: usize = 4096;
    let pixel = |(a, b): (&[f32; 4], &[f32; 4])| (0..3).map(|c| (value(a[c]) - value(b[c])).abs()).sum::<f64>();
    let parts: Vec<f64> =
        a.par_chunks(PART).zip(b.par_chunks(PART)).map(|(a, b)| a.iter().zip(b).map(pixel).sum::<f64>()).collect();
    parts.iter().sum()
}

/// Numbers of a few scenes that training may show.
fn shown_scenes(seed: u64) -> Vec<u64> {
    numbers(hash(seed, seed_of("shown scenes")), 0..*family::HELD_OUT.start())
}

/// Numbers of a few scenes that no training shows.
fn held_out_scenes(seed: u64) -> Vec<u64> {
    numbers(hash(seed, seed_of("held-out scenes")), *family::HELD_OUT.start()..family::HELD_OUT.end() + 1)
}

/// Distinct numbers of a range.
fn numbers(key: u64, range: std::ops::Range<u64>) -> Vec<u64> {
    let mut seen = HashSet::new();
    let all = (0..).map(|i| range.start + hash(key, i) % (range.end - range.start)).filter(|n| seen.insert(*n));
    all.take(FRESH_SCENES).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_are_distinct_and_of_their_side() {
        for seed in 0..100 {
            let (shown, held_out) = (shown_scenes(seed), held_out_scenes(seed));
            assert!(shown.iter().all(|n| !family::is_held_out(*n)), "{shown:?}");
            assert!(held_out.iter().all(|n| family::is_held_out(*n)), "{held_out:?}");
            for scenes in [shown, held_out] {
                assert_eq!(scenes.iter().collect::<HashSet<_>>().len(), FRESH_SCENES);
            }
        }
    }

    #[test]
    fn sums_are_over_three_channels() {
        let a = vec![[1.0, -2.0, 3.0, f32::NAN]; 5000];
        let b = vec![[0.0, 1.0, 3.5, 7.0]; 5000];
        assert_eq!(sum(&a, &b, f64::from), 5000.0 * 4.5);
        assert_eq!(sum(&a, &b, |v| f64::from(v.clamp(0.0, 1.0))), 5000.0 * 2.0);
    }
}
