//! The arguments of `limpid train`.

use crate::cli::dataset::PictureArgs;
use crate::cli::device::{DeviceArgs, KernelArgs};
use limpid::train::data::{DataSettings, Scenes};
use limpid::train::loss::Loss;
use limpid::train::preset::Preset;
use limpid::train::run::Length;
use limpid::train::split::Split;
use limpid::{Error, Result};
use std::path::PathBuf;

/// Train a network
///
/// Preset `fresh` renders scenes of the family on the device as training goes; preset `paper` trains on the 128x128 chunks
/// of a data set as the paper does: MAE, Adam at a constant 1e-3, batches of 32, every chunk once an epoch.
///
/// Writes the weights to OUT.safetensors, one JSON line a step and an evaluation to OUT.log.jsonl, a plot of the losses to
/// OUT.svg and, every two minutes and where it is stopped, a checkpoint to OUT.checkpoint, from which `--resume` goes on to
/// the same bits.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Weights file to write
    #[arg(short, long, value_name = "OUT.safetensors", required_unless_present = "verify")]
    pub output: Option<PathBuf>,
    /// Where the examples come from: fresh scenes, or a data set as in the paper
    #[arg(long, value_name = "fresh|paper", default_value_t = Preset::Fresh)]
    pub preset: Preset,
    /// Network architecture: `seed`, `base`, `base:W,...` with 11 widths, or `kpn`
    #[arg(long, visible_alias = "arch", default_value = "seed")]
    pub architecture: String,
    /// Steps to take
    #[arg(long, conflicts_with_all = ["minutes", "epochs"])]
    pub steps: Option<u64>,
    /// Minutes to train; a `fresh` run's learning rate then follows the clock, so that two runs differ
    #[arg(long, conflicts_with = "epochs")]
    pub minutes: Option<f64>,
    /// Go on from a checkpoint, with its settings; --epochs may ask for more
    #[arg(long, value_name = "CHECKPOINT", conflicts_with_all = ["init", "steps", "minutes", "verify"])]
    pub resume: Option<PathBuf>,
    /// Begin with these weights instead of random ones
    #[arg(long, value_name = "WEIGHTS")]
    pub init: Option<PathBuf>,
    /// Seed of the initial weights, scenes, noise, crops and their order
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Largest learning rate. `fresh`: reached after 50 steps, then half a cosine down to a hundredth; `paper`: constant
    #[arg(long, default_value_t = 1e-3)]
    pub learning_rate: f64,
    /// What to minimise: `mae`, or `multiscale`, the mean of the MAE of the picture and of its reductions by 2, 4, 8 and 16
    /// [default: multiscale, `paper`: mae]
    #[arg(long)]
    pub loss: Option<Loss>,
    /// Crops a step, of the smallest size [default: 8, `paper`: 32]
    #[arg(long)]
    pub batch: Option<u32>,
    /// Sides of crops, pixels, the smallest first: a step has crops of one size, of larger ones fewer. `paper` has one side
    /// [default: 128,256,384, `paper`: 128]
    #[arg(long, value_delimiter = ',', value_name = "SIDE,...")]
    pub crop: Vec<u32>,
    /// Samples a pixel of the references (nee, sobol) [default: 128, `paper`: 256]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub reference_spp: Option<u32>,
    /// Steps between checkpoints, beside those every two minutes [default: none, `paper`: 20 epochs]
    #[arg(long, value_name = "STEPS", value_parser = clap::value_parser!(u64).range(1..))]
    pub checkpoint_every: Option<u64>,
    #[command(flatten, next_help_heading = "Preset fresh")]
    pub fresh: FreshArgs,
    #[command(flatten, next_help_heading = "Preset paper")]
    pub paper: PaperArgs,
    /// Repeat the first 20 steps of the run that made these weights and compare the losses bit for bit
    #[arg(long, value_name = "WEIGHTS", conflicts_with_all = ["steps", "minutes", "epochs"], help_heading = "Options")]
    pub verify: Option<PathBuf>,
    #[command(flatten, next_help_heading = "Options")]
    pub kernels: KernelArgs,
    #[command(flatten, next_help_heading = "Options")]
    pub device: DeviceArgs,
    /// Print one JSON object at the end
    #[arg(long, help_heading = "Options")]
    pub json: bool,
}

/// Of the preset `fresh` alone.
#[derive(Debug, clap::Args)]
pub struct FreshArgs {
    /// Scenes to train on: `spheres` (16 samples, one camera ray a pixel), or `mixed` with `rooms`, 4 to 64 samples and both
    /// kinds of camera rays [default: mixed]
    #[arg(long)]
    pub scenes: Option<Scenes>,
    /// Side of the rendered windows that crops are taken from, pixels [default: 384]
    #[arg(long)]
    pub window: Option<u32>,
    /// Windows kept at a time [default: 64]
    #[arg(long)]
    pub pool: Option<u32>,
    /// Windows rendered before the first step [default: 16]
    #[arg(long)]
    pub initial: Option<u32>,
    /// Steps between new windows [default: 3]
    #[arg(long)]
    pub refresh: Option<u32>,
    /// Steps between evaluations on held-out scenes, 0 for none [default: 250]
    #[arg(long, value_name = "STEPS")]
    pub evaluate_every: Option<u64>,
}

/// Of the preset `paper` alone.
#[derive(Debug, clap::Args)]
pub struct PaperArgs {
    /// Epochs to train [default: 20]
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub epochs: Option<u64>,
    /// Data set of `limpid dataset` [default: OUT.dataset, made where it is not there]
    #[arg(long, value_name = "DIR", conflicts_with_all = ["count", "size", "spp", "reference_spp"])]
    pub dataset: Option<PathBuf>,
    /// What is held out, a tenth: whole scenes, or chunks as in the paper, where both sides show the same scenes
    #[arg(long, value_name = "scene|chunk")]
    pub split: Option<Split>,
    #[command(flatten)]
    pub pictures: PictureArgs,
}

impl Args {
    /// Refuses flags that belong to the other preset.
    pub fn check(&self) -> Result<()> {
        let (fresh, paper) = (&self.fresh, &self.paper);
        let given = [
            (Preset::Fresh, "--scenes", fresh.scenes.is_some()),
            (Preset::Fresh, "--window", fresh.window.is_some()),
            (Preset::Fresh, "--pool", fresh.pool.is_some()),
            (Preset::Fresh, "--initial", fresh.initial.is_some()),
            (Preset::Fresh, "--refresh", fresh.refresh.is_some()),
            (Preset::Fresh, "--evaluate-every", fresh.evaluate_every.is_some()),
            (Preset::Paper, "--epochs", paper.epochs.is_some()),
            (Preset::Paper, "--dataset", paper.dataset.is_some()),
            (Preset::Paper, "--split", paper.split.is_some()),
            (Preset::Paper, paper.pictures.given().unwrap_or(""), paper.pictures.given().is_some()),
        ];
        match given.into_iter().find(|(preset, _, given)| *given && *preset != self.preset) {
            Some((preset, flag, _)) => Err(Error::input(format!("{flag} goes with --preset {preset}"))),
            None if self.preset == Preset::Paper && self.crop.len() > 1 => {
                Err(Error::input("--crop: preset paper has chunks of one side"))
            }
            None if !(self.learning_rate.is_finite() && self.learning_rate > 0.0) => {
                Err(Error::input(format!("--learning-rate {}: give a number above 0", self.learning_rate)))
            }
            None => Ok(()),
        }
    }

    /// What a `fresh` run sees.
    pub fn data(&self) -> DataSettings {
        let (fresh, defaults) = (&self.fresh, DataSettings::default());
        let (crop, larger_crops) = match &self.crop[..] {
            [] => (defaults.crop, defaults.larger_crops.clone()),
            [first, larger @ ..] => (*first, larger.to_vec()),
        };
        DataSettings {
            seed: self.seed,
            batch: self.batch.unwrap_or(defaults.batch),
            crop,
            larger_crops,
            scenes: fresh.scenes.unwrap_or(defaults.scenes),
            window: fresh.window.unwrap_or(defaults.window),
            pool: fresh.pool.unwrap_or(defaults.pool),
            initial: fresh.initial.unwrap_or(defaults.initial),
            refresh: fresh.refresh.unwrap_or(defaults.refresh),
            reference_spp: self.reference_spp.unwrap_or(defaults.reference_spp),
            ..defaults
        }
    }

    /// The length that was asked for; `epochs` gives the steps of so many, where there are epochs.
    pub fn length(&self, epochs: Option<&dyn Fn(u64) -> u64>) -> Result<Length> {
        match (self.steps, self.minutes, epochs) {
            (Some(steps), ..) => Ok(Length::Steps(steps)),
            (None, Some(minutes), _) if minutes > 0.0 && minutes.is_finite() => Ok(Length::Minutes(minutes)),
            (None, Some(minutes), _) => Err(Error::input(format!("--minutes {minutes}: give a number above 0"))),
            (None, None, Some(steps_of)) => {
                Ok(Length::Steps(steps_of(self.paper.epochs.unwrap_or(limpid::train::preset::PAPER_EPOCHS))))
            }
            (None, None, None) => Err(Error::input("give --steps N or --minutes M")),
        }
    }
}
