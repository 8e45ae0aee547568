//! A training run: data, steps, schedule, losses.

use super::adam::Adam;
use super::data::{Data, DataSettings, Part};
use super::schedule::rate;
use super::step::{Moments, Step};
use crate::denoise::Preparation;
use crate::gpu::Gpu;
use crate::net::architecture::Architecture;
use crate::net::kernel::Family;
use crate::net::weights::Weights;
use crate::scene::family::FAMILY_VERSION;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// How long a run goes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Length {
    /// This many steps: the schedule, and so every bit, follows from the settings.
    Steps(u64),
    /// This long: the schedule follows the clock.
    Minutes(f64),
}

/// Losses of the first steps that a weights file keeps for `--verify`.
pub const VERIFIED_STEPS: u64 = 20;
/// Metadata key of the settings that `--verify` repeats.
pub const RUN: &str = "run";
/// Metadata key of the first losses, f64 bits in hexadecimal.
pub const FIRST_LOSSES: &str = "first_losses";

/// Everything that a run is, but for its parameters and moments.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunState {
    /// Architecture, as [`Architecture::specification`] has it.
    pub architecture: String,
    /// Data.
    pub data: DataSettings,
    /// Largest learning rate.
    pub learning_rate: f64,
    /// Length.
    pub length: Length,
    /// sha256 of the weights the run began with; none for Glorot-uniform ones.
    pub init: Option<String>,
    /// Steps done.
    pub step: u64,
    /// Crops seen.
    #[serde(default)]
    pub crops: u64,
    /// Seconds spent so far, those before a resume included.
    pub seconds: f64,
    /// f64 bits of the first losses.
    pub first_losses: Vec<String>,
    /// Step and mean loss of each full block of steps, for the record.
    pub losses: Vec<(u64, f64)>,
    /// Losses of the block begun.
    pub block: Vec<f64>,
}

/// Steps of a block of [`RunState::losses`].
pub const BLOCK: usize = 50;

impl RunState {
    /// The state before the first step.
    #[must_use]
    pub fn new(
        architecture: &str,
        data: DataSettings,
        learning_rate: f64,
        length: Length,
        init: Option<String>,
    ) -> Self {
        Self {
            architecture: architecture.to_owned(),
            data,
            learning_rate,
            length,
            init,
            step: 0,
            crops: 0,
            seconds: 0.0,
            first_losses: Vec::new(),
            losses: Vec::new(),
            block: Vec::new(),
        }
    }

    /// The share of the run that is done.
    #[must_use]
    pub fn progress(&self) -> f64 {
        match self.length {
            Length::Steps(steps) => self.step as f64 / steps.max(1) as f64,
            Length::Minutes(minutes) => self.seconds / (60.0 * minutes),
        }
    }

    /// Whether the run is over.
    #[must_use]
    pub fn done(&self) -> bool {
        match self.length {
            Length::Steps(steps) => self.step >= steps,
            Length::Minutes(minutes) => self.seconds >= 60.0 * minutes,
        }
    }

    fn add(&mut self, loss: f64) {
        if self.step < VERIFIED_STEPS {
            self.first_losses.push(format!("{:016x}", loss.to_bits()));
        }
        self.step += 1;
        self.block.push(loss);
        if self.block.len() == BLOCK {
            self.losses.push((self.step, self.block.iter().sum::<f64>() / BLOCK as f64));
            self.block.clear();
        }
    }
}

/// One step's record.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct StepRecord {
    /// Its number, from 1.
    pub step: u64,
    /// Mean absolute error of its batch before it, in the space of the network's output.
    pub loss: f64,
    /// Learning rate.
    pub learning_rate: f64,
    /// Device time of forward, backward and update, milliseconds.
    pub device_ms: f64,
}

/// A run under way.
pub struct Run {
    /// What it is and how far it has come.
    pub state: RunState,
    architecture: Architecture,
    preparation: Preparation,
    data: Data,
    step: Step,
}

impl Run {
    /// Begins a run at `parameters`, or goes on where `moments` are given too.
    pub fn new(
        gpu: &Gpu,
        family: Family,
        state: RunState,
        weights: &Weights,
        moments: Option<&Moments>,
    ) -> Result<Self> {
        let s = &state.data;
        let sizes: Vec<_> = s.sizes().into_iter().map(|(n, side)| (n, side, side)).collect();
        let adam = Adam { learning_rate: state.learning_rate, ..Adam::default() };
        let preparation = Preparation::of_architecture(&weights.architecture)?;
        let data = Data::new(gpu, s, preparation, weights.architecture.alignment() as u32, Part::Training)?;
        let mut step = Step::with_sizes(gpu, family, weights, &sizes, adam)?;
        if let Some(moments) = moments {
            step.set_moments(moments)?;
        }
        Ok(Self { state, architecture: weights.architecture.clone(), preparation, data, step })
    }

    /// Renders what the next step needs; `progress(done, all)` is called after each example.
    pub fn prepare(&mut self, progress: impl FnMut(u64, u64)) -> Result<()> {
        self.data.prepare(self.state.step, progress)
    }

    /// Takes one step.
    pub fn step(&mut self) -> Result<StepRecord> {
        let start = std::time::Instant::now();
        self.prepare(|_, _| {})?;
        let size = self.state.data.size_at(self.state.step);
        self.data.load(self.state.step, self.step.input_of(size), self.step.target_of(size))?;
        let learning_rate = self.state.learning_rate * rate(self.state.step, self.state.progress());
        let (loss, timings) = self.step.run_size(size, learning_rate)?;
        if !loss.is_finite() {
            return Err(Error::Gpu(format!(
                "the loss of step {} is {loss}; resume from the last checkpoint with a smaller --learning-rate",
                self.state.step + 1
            )));
        }
        self.state.add(loss);
        self.state.crops += u64::from(self.step.input_of(size).shape.n);
        self.state.seconds += start.elapsed().as_secs_f64();
        Ok(StepRecord { step: self.state.step, loss, learning_rate, device_ms: timings.device_ms })
    }

    /// Adam's moments.
    pub fn moments(&self) -> Result<Moments> {
        self.step.moments()
    }

    /// The weights as they are now, with what a file should say of them.
    pub fn weights(&self, device: &str, command: &str) -> Result<Weights> {
        let mut weights = self.step.weights(&self.architecture)?;
        let state = &self.state;
        let losses: Vec<String> = state.losses.iter().map(|(step, loss)| format!("{step}:{loss:.5}")).collect();
        let mut run = state.clone();
        run.losses.clear();
        run.block.clear();
        run.first_losses.clear();
        let run = serde_json::to_string(&run).map_err(|e| Error::input(format!("run settings: {e}")))?;
        let metadata = [
            ("family_version", FAMILY_VERSION.to_string()),
            ("command", command.to_owned()),
            ("commit", option_env!("LIMPID_COMMIT").unwrap_or("unknown").to_owned()),
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("device", device.to_owned()),
            ("steps", state.step.to_string()),
            ("seconds", format!("{:.0}", state.seconds)),
            ("losses", losses.join(" ")),
            (FIRST_LOSSES, state.first_losses.join(" ")),
            (RUN, run),
        ];
        weights.metadata.extend(metadata.map(|(k, v)| (k.to_owned(), v)));
        weights.metadata.extend(self.preparation.metadata());
        Ok(weights)
    }
}
