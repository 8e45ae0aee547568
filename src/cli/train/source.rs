//! How a run begins: its weights, its data, its length.

use super::Args;
use crate::cli::dataset;
use crate::cli::progress::Progress;
use crate::cli::stop::Stop;
use limpid::denoise::Preparation;
use limpid::gpu::Gpu;
use limpid::net::architecture::Architecture;
use limpid::net::kernel::Family;
use limpid::net::weights::Weights;
use limpid::train::checkpoint;
use limpid::train::dataset::{Frames, Manifest};
use limpid::train::preset::{PAPER_BATCH, PAPER_CHUNK, Preset, Source, StoredSettings};
use limpid::train::run::{Length, Run, RunState};
use limpid::train::step::Moments;
use limpid::{Error, Result};
use sha2::{Digest, Sha256};
use std::path::Path;

/// What a run begins with.
pub struct Beginning {
    /// What it is.
    pub state: RunState,
    /// Its weights.
    pub weights: Weights,
    /// Its moments, where it goes on.
    pub moments: Option<Moments>,
}

/// Begins a run or goes on from a checkpoint; none where a signal came before all was there.
pub fn begin(args: &Args, gpu: &Gpu, family: Family, output: &Path, stop: &Stop) -> Result<Option<Run>> {
    let folder = args.paper.dataset.clone().unwrap_or_else(|| output.with_extension("dataset"));
    if let Some(path) = &args.resume {
        return resume(args, path)?.start(gpu, family, &folder, stop);
    }
    let architecture = Architecture::named(&args.architecture)?;
    let (weights, init) = initial_weights(args, &architecture, args.seed)?;
    let (source, length): (Source, Length) = match args.preset {
        Preset::Fresh => (args.data().into(), args.length(None)?),
        Preset::Paper => {
            let Some(manifest) = manifest(args, gpu, &folder, stop)? else { return Ok(None) };
            let split = args.paper.split.unwrap_or_default();
            let (batch, chunk) = (args.batch.unwrap_or(PAPER_BATCH), *args.crop.first().unwrap_or(&PAPER_CHUNK));
            let settings = StoredSettings::new(args.seed, batch, chunk, split, &manifest)?;
            let length = args.length(Some(&|epochs| settings.steps_of(epochs)))?;
            (Source::Stored(settings), length)
        }
    };
    let mut state = RunState::new(&weights.architecture.specification(), source, args.learning_rate, length, init);
    state.loss = args.loss.unwrap_or(args.preset.loss());
    state.evaluate_every = args.fresh.evaluate_every.unwrap_or(state.evaluate_every);
    Beginning { state, weights, moments: None }.start(gpu, family, &folder, stop)
}

/// The state of a checkpoint, with as many epochs as are asked for.
fn resume(args: &Args, path: &Path) -> Result<Beginning> {
    let (mut state, parameters, moments) = checkpoint::load(path)?;
    let mut weights = Weights::glorot(&Architecture::named(&state.architecture)?, 0);
    weights.parameters = parameters;
    if let Some(epochs) = args.paper.epochs {
        let Some(stored) = state.data.stored() else {
            return Err(Error::input(format!(
                "{}: is of preset {}, which has no epochs",
                path.display(),
                Preset::Fresh
            )));
        };
        state.length = Length::Steps(stored.steps_of(epochs));
    }
    Ok(Beginning { state, weights, moments: Some(moments) })
}

impl Beginning {
    /// Makes the run; `folder` is its data set, if it has one. None where a signal came first.
    pub fn start(self, gpu: &Gpu, family: Family, folder: &Path, stop: &Stop) -> Result<Option<Run>> {
        let Self { state, weights, moments } = self;
        let Some(stored) = state.data.stored() else {
            return Run::new(gpu, family, state, &weights, moments.as_ref()).map(Some);
        };
        let manifest = Manifest::of(folder)?;
        if manifest.fingerprint() != stored.dataset {
            return Err(Error::input(format!(
                "{}: is not the data set that the run began with; name that one with --dataset",
                folder.display()
            )));
        }
        let preparation = Preparation::of_architecture(&weights.architecture)?;
        let mut progress = Progress::new(&format!("reading {}", folder.display()));
        let frames = Frames::load(gpu, preparation, folder, &manifest, |done, all| {
            progress.update(done as f64 / all as f64, all as f64, " scenes");
            stop.requested().is_none()
        })?;
        drop(progress);
        let Some(frames) = frames else { return Ok(None) };
        Run::on_frames(gpu, family, state, &weights, moments.as_ref(), frames).map(Some)
    }
}

/// The data set that was named, or the one beside the output, made where it is not there; none where a signal came first.
fn manifest(args: &Args, gpu: &Gpu, folder: &Path, stop: &Stop) -> Result<Option<Manifest>> {
    if args.paper.dataset.is_some() {
        return Manifest::of(folder).map(Some);
    }
    let settings = args.paper.pictures.settings(args.reference_spp, args.seed);
    Ok(dataset::make(gpu, folder, &settings, stop)?.map(|(manifest, _)| manifest))
}

/// The weights that a run begins with, a file's with the file's widths, and the sha256 of that file.
pub fn initial_weights(args: &Args, architecture: &Architecture, seed: u64) -> Result<(Weights, Option<String>)> {
    match &args.init {
        None => Ok((Weights::initial(architecture, seed), None)),
        Some(path) => {
            let weights = Weights::load(path)?;
            let (file, name) = (path.display(), weights.architecture.name());
            if name != architecture.name() {
                return Err(Error::input(format!(
                    "{file}: architecture: expected {}, found `{name}`",
                    architecture.name()
                )));
            }
            if Preparation::of_weights(&weights, &file.to_string())? != Preparation::of_architecture(architecture)? {
                return Err(Error::input(format!("{file}: `{name}` is trained with other inputs or another transfer")));
            }
            let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
            let sum: String = Sha256::digest(&bytes).iter().map(|b| format!("{b:02x}")).collect();
            Ok((weights, Some(sum)))
        }
    }
}
