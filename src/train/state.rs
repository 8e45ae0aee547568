//! What a training run is and how far it has come.

use super::evaluate::Evaluation;
use super::loss::Loss;
use super::preset::{Preset, Source};
use super::schedule::rate;
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
    /// Architecture, as [`crate::net::architecture::Architecture::specification`] has it.
    pub architecture: String,
    /// What it sees.
    pub data: Source,
    /// Largest learning rate.
    pub learning_rate: f64,
    /// What it minimises.
    #[serde(default)]
    pub loss: Loss,
    /// Length.
    pub length: Length,
    /// sha256 of the weights the run began with; none for those of [`crate::net::weights::Weights::initial`].
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
    /// Steps between evaluations where there are no epochs; 0 for none.
    #[serde(default)]
    pub evaluate_every: u64,
    /// The evaluations so far.
    #[serde(default)]
    pub evaluations: Vec<Evaluation>,
}

/// Steps of a block of [`RunState::losses`].
pub const BLOCK: usize = 50;
/// The default of [`RunState::evaluate_every`].
pub const EVALUATE_EVERY: u64 = 250;

impl RunState {
    /// The state before the first step.
    #[must_use]
    pub fn new(
        architecture: &str,
        data: impl Into<Source>,
        learning_rate: f64,
        length: Length,
        init: Option<String>,
    ) -> Self {
        Self {
            architecture: architecture.to_owned(),
            data: data.into(),
            learning_rate,
            loss: Loss::default(),
            length,
            init,
            step: 0,
            crops: 0,
            seconds: 0.0,
            first_losses: Vec::new(),
            losses: Vec::new(),
            block: Vec::new(),
            evaluate_every: EVALUATE_EVERY,
            evaluations: Vec::new(),
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

    /// Epochs over; none where there are no epochs.
    #[must_use]
    pub fn epochs_done(&self) -> Option<u64> {
        self.data.stored().map(|s| s.epochs_done(self.step))
    }

    /// Whether the figures of an evaluation are wanted before the next step: after each epoch or every so many steps, and at
    /// the end.
    #[must_use]
    pub fn evaluation_due(&self) -> bool {
        let last = self.evaluations.last();
        if self.step == 0 || last.is_some_and(|e| e.step == self.step) {
            return false;
        }
        match self.epochs_done() {
            Some(epochs) => epochs > last.and_then(|e| e.epoch).unwrap_or(0) || self.done(),
            None => self.evaluate_every > 0 && (self.step.is_multiple_of(self.evaluate_every) || self.done()),
        }
    }

    /// The learning rate of the next step.
    #[must_use]
    pub fn next_learning_rate(&self) -> f64 {
        match self.data.preset() {
            Preset::Fresh => self.learning_rate * rate(self.step, self.progress()),
            Preset::Paper => self.learning_rate,
        }
    }

    /// What a weights file says of the run.
    pub(super) fn metadata(&self) -> Vec<(&'static str, String)> {
        let mut run = self.clone();
        run.losses.clear();
        run.block.clear();
        run.first_losses.clear();
        run.evaluations.clear();
        let losses: Vec<String> = self.losses.iter().map(|(step, loss)| format!("{step}:{loss:.5}")).collect();
        let mut list = vec![
            ("preset", self.data.preset().to_string()),
            ("steps", self.step.to_string()),
            ("seconds", format!("{:.0}", self.seconds)),
            ("losses", losses.join(" ")),
            (FIRST_LOSSES, self.first_losses.join(" ")),
            (RUN, serde_json::to_string(&run).expect("plain data has a JSON form")),
        ];
        if let Some(stored) = self.data.stored() {
            list.push(("split", stored.split.to_string()));
            list.push(("dataset", stored.dataset.clone()));
            list.push(("epochs", stored.epochs_done(self.step).to_string()));
        }
        if let Some(e) = self.evaluations.last() {
            list.extend([
                ("evaluated_at_step", e.step.to_string()),
                ("loss", format!("{:.6}", e.loss)),
                ("held_out_loss", format!("{:.6}", e.held_out_loss)),
                ("mae01", format!("{:.6}", e.mae01)),
                ("held_out_mae01", format!("{:.6}", e.held_out_mae01)),
            ]);
        }
        list
    }

    /// Takes the next step's loss and the number of its crops.
    pub(super) fn add(&mut self, loss: f64, crops: u64) {
        if self.step < VERIFIED_STEPS {
            self.first_losses.push(format!("{:016x}", loss.to_bits()));
        }
        self.step += 1;
        self.crops += crops;
        self.block.push(loss);
        if self.block.len() == BLOCK {
            self.losses.push((self.step, self.block.iter().sum::<f64>() / BLOCK as f64));
            self.block.clear();
        }
    }
}
