//! A training run: data, steps, schedule, losses.

use super::adam::Adam;
use super::data::{Data, Part};
use super::dataset::Frames;
use super::evaluate::{Evaluation, Yardstick};
use super::preset::Source;
use super::split::{Chunk, Order};
use super::step::{Moments, Step};
use crate::denoise::Preparation;
use crate::gpu::Gpu;
use crate::net::architecture::Architecture;
use crate::net::kernel::Family;
use crate::net::weights::Weights;
use crate::scene::family::FAMILY_VERSION;
use crate::{Error, Result};
use serde::Serialize;
use std::time::Instant;

pub use super::state::{BLOCK, FIRST_LOSSES, Length, RUN, RunState, VERIFIED_STEPS};

/// One step's record.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct StepRecord {
    /// Its number, from 1.
    pub step: u64,
    /// Loss of its batch before it.
    pub loss: f64,
    /// Learning rate.
    pub learning_rate: f64,
    /// Device time of forward, backward and update, milliseconds.
    pub device_ms: f64,
}

/// What the next batch is made of.
enum Feed {
    /// Scenes rendered as training goes.
    Fresh(Box<Data>),
    /// The training chunks of the pictures that the yardstick holds.
    Stored { chunks: Vec<Chunk>, order: Order },
}

/// A run under way.
pub struct Run {
    /// What it is and how far it has come.
    pub state: RunState,
    gpu: Gpu,
    architecture: Architecture,
    preparation: Preparation,
    feed: Feed,
    step: Step,
    /// Made when it is first needed, but for stored pictures.
    yardstick: Option<Yardstick>,
}

impl Run {
    /// Begins a run on fresh scenes at `parameters`, or goes on where `moments` are given too.
    pub fn new(
        gpu: &Gpu,
        family: Family,
        state: RunState,
        weights: &Weights,
        moments: Option<&Moments>,
    ) -> Result<Self> {
        let Source::Fresh(settings) = &state.data else {
            return Err(Error::input("the run is one on a data set: name it with --dataset"));
        };
        let preparation = Preparation::of_architecture(&weights.architecture)?;
        let data = Data::new(gpu, settings, preparation, weights.architecture.alignment() as u32, Part::Training)?;
        let step = make_step(gpu, family, &state, weights, moments)?;
        let (gpu, architecture) = (gpu.clone(), weights.architecture.clone());
        Ok(Self { state, gpu, architecture, preparation, feed: Feed::Fresh(Box::new(data)), step, yardstick: None })
    }

    /// The same on the pictures of a data set.
    pub fn on_frames(
        gpu: &Gpu,
        family: Family,
        state: RunState,
        weights: &Weights,
        moments: Option<&Moments>,
        frames: Frames,
    ) -> Result<Self> {
        let Source::Stored(settings) = &state.data else {
            return Err(Error::input("the run is one on fresh scenes: it takes no --dataset"));
        };
        let sides = settings.sides(frames.pictures().len() as u32, frames.size())?;
        let alignment = weights.architecture.alignment() as u32;
        if settings.batch == 0 || !settings.chunk.is_multiple_of(alignment) {
            return Err(Error::input(format!(
                "batches of {} chunks of {} pixels: there must be one at least, and multiples of {alignment} pixels",
                settings.batch, settings.chunk
            )));
        }
        if sides.training.len() as u64 != settings.epoch_chunks {
            return Err(Error::input("the pictures are not those of the data set that the run is on"));
        }
        let preparation = frames.preparation();
        let step = make_step(gpu, family, &state, weights, moments)?;
        let yardstick = Some(Yardstick::stored(gpu, frames, &sides, settings, &step)?);
        let order = Order::new(settings.seed, sides.training.len());
        let feed = Feed::Stored { chunks: sides.training, order };
        let (gpu, architecture) = (gpu.clone(), weights.architecture.clone());
        Ok(Self { state, gpu, architecture, preparation, feed, step, yardstick })
    }

    /// Renders what the next step needs; `progress(done, all)` is called after each example.
    pub fn prepare(&mut self, progress: impl FnMut(u64, u64)) -> Result<()> {
        match &mut self.feed {
            Feed::Fresh(data) => data.prepare(self.state.step, progress),
            Feed::Stored { .. } => Ok(()),
        }
    }

    /// Writes the next step's batch to the device; `size` is that of its crops.
    fn load(&mut self, size: usize) -> Result<()> {
        match &mut self.feed {
            Feed::Fresh(data) => data.load(self.state.step, self.step.input_of(size), self.step.target_of(size)),
            Feed::Stored { chunks, order } => {
                let yardstick = self.yardstick.as_mut().expect("made with the run");
                let count = yardstick.batch.count() as u64;
                let places = self.state.step * count..(self.state.step + 1) * count;
                let batch: Vec<Chunk> = places.map(|place| chunks[order.at(place)]).collect();
                yardstick.batch.load(&yardstick.frames, &batch)
            }
        }
    }

    /// Takes one step.
    pub fn step(&mut self) -> Result<StepRecord> {
        let start = Instant::now();
        self.prepare(|_, _| {})?;
        let size = self.state.data.size_at(self.state.step);
        self.load(size)?;
        let learning_rate = self.state.next_learning_rate();
        let (loss, timings) = self.step.run_size(size, learning_rate)?;
        if !loss.is_finite() {
            return Err(Error::Gpu(format!(
                "the loss of step {} is {loss}; resume from the last checkpoint with a smaller --learning-rate",
                self.state.step + 1
            )));
        }
        self.state.add(loss, u64::from(self.step.input_of(size).shape.n));
        self.state.seconds += start.elapsed().as_secs_f64();
        Ok(StepRecord { step: self.state.step, loss, learning_rate, device_ms: timings.device_ms })
    }

    /// Renders what [`Self::evaluate`] looks at, where that is not there yet.
    pub fn prepare_evaluation(&mut self, progress: impl FnMut(u64, u64)) -> Result<()> {
        if let (None, Source::Fresh(s)) = (&self.yardstick, &self.state.data) {
            self.yardstick = Some(Yardstick::fresh(&self.gpu, self.preparation, s, &self.step, progress)?);
        }
        Ok(())
    }

    /// The figures on fixed chunks, which are kept in the state; no parameter changes. Where `go_on` returns false the work
    /// stops and there is no result.
    pub fn evaluate(&mut self, mut go_on: impl FnMut() -> bool) -> Result<Option<Evaluation>> {
        let start = Instant::now();
        self.prepare_evaluation(|_, _| {})?;
        let yardstick = self.yardstick.as_mut().expect("made above");
        let figures = yardstick.run(&mut self.step, &mut go_on)?;
        self.state.seconds += start.elapsed().as_secs_f64();
        let Some([training, held_out]) = figures else { return Ok(None) };
        let evaluation = Evaluation {
            step: self.state.step,
            epoch: self.state.epochs_done(),
            loss: training.loss,
            held_out_loss: held_out.loss,
            mae01: training.mae01,
            held_out_mae01: held_out.mae01,
        };
        self.state.evaluations.push(evaluation.clone());
        Ok(Some(evaluation))
    }

    /// Adam's moments.
    pub fn moments(&self) -> Result<Moments> {
        self.step.moments()
    }

    /// The weights as they are now, with what a file should say of them.
    pub fn weights(&self, device: &str, command: &str) -> Result<Weights> {
        let mut weights = self.step.weights(&self.architecture)?;
        let metadata = [
            ("family_version", FAMILY_VERSION.to_string()),
            ("command", command.to_owned()),
            ("commit", option_env!("LIMPID_COMMIT").unwrap_or("unknown").to_owned()),
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("device", device.to_owned()),
        ];
        let metadata = metadata.into_iter().chain(self.state.metadata());
        weights.metadata.extend(metadata.map(|(k, v)| (k.to_owned(), v)));
        weights.metadata.extend(self.preparation.metadata());
        Ok(weights)
    }
}

fn make_step(
    gpu: &Gpu,
    family: Family,
    state: &RunState,
    weights: &Weights,
    moments: Option<&Moments>,
) -> Result<Step> {
    let sizes: Vec<_> = state.data.sizes().into_iter().map(|(n, side)| (n, side, side)).collect();
    let adam = Adam { learning_rate: state.learning_rate, ..Adam::default() };
    let mut step = Step::with_sizes(gpu, family, weights, &sizes, adam, state.loss)?;
    if let Some(moments) = moments {
        step.set_moments(moments)?;
    }
    Ok(step)
}
