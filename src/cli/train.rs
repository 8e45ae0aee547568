//! `limpid train`: trains a network on scenes that it renders as it goes.

use super::device::{DeviceArgs, KernelArgs};
use super::progress::{Progress, line};
use super::report;
use super::stop::Stop;
use limpid::denoise::Preparation;
use limpid::gpu::Gpu;
use limpid::image::file::writable;
use limpid::kernels::Choice;
use limpid::kernels::check::Purpose;
use limpid::net::architecture::Architecture;
use limpid::net::kernel::Family;
use limpid::net::weights::Weights;
use limpid::train::checkpoint;
use limpid::train::data::{DataSettings, Scenes};
use limpid::train::run::{FIRST_LOSSES, Length, RUN, Run, RunState, StepRecord, VERIFIED_STEPS};
use limpid::{Error, Result};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Train a network on scenes of the family, rendered on the device as training goes.
///
/// Writes the weights to OUT.safetensors, one JSON line a step to OUT.log.jsonl and, every two minutes and where it is
/// stopped, a checkpoint to OUT.checkpoint, from which `--resume` goes on to the same bits.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Weights file to write.
    #[arg(short, long, value_name = "OUT.safetensors", required_unless_present = "verify")]
    output: Option<PathBuf>,
    /// Network architecture: `seed`, `base`, or `base:W,...` with 11 widths.
    #[arg(long, visible_alias = "arch", default_value = "seed")]
    architecture: String,
    /// Steps to take.
    #[arg(long, conflicts_with = "minutes")]
    steps: Option<u64>,
    /// Minutes to train; the learning rate then follows the clock, so that two runs differ.
    #[arg(long)]
    minutes: Option<f64>,
    /// Go on from a checkpoint, with its settings.
    #[arg(long, value_name = "CHECKPOINT", conflicts_with_all = ["init", "steps", "minutes", "verify"])]
    resume: Option<PathBuf>,
    /// Begin with these weights instead of random ones.
    #[arg(long, value_name = "WEIGHTS")]
    init: Option<PathBuf>,
    /// Seed of the initial weights, scenes, noise and crops.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Largest learning rate: reached after 50 steps, then half a cosine down to a hundredth.
    #[arg(long, default_value_t = 1e-3)]
    learning_rate: f64,
    /// Crops a step, of the smallest size.
    #[arg(long, default_value_t = DataSettings::default().batch)]
    batch: u32,
    /// Sides of crops, pixels, the smallest first: a step has crops of one size, of larger ones fewer.
    #[arg(long, value_delimiter = ',', default_value = "128,256,384", value_name = "SIDE,...")]
    crop: Vec<u32>,
    /// Scenes to train on: `spheres` (16 samples, one camera ray a pixel), or `mixed` with `rooms`, 4 to 64 samples and
    /// both kinds of camera rays.
    #[arg(long, default_value = "mixed")]
    scenes: Scenes,
    /// Side of the rendered windows that crops are taken from, pixels.
    #[arg(long, default_value_t = DataSettings::default().window)]
    window: u32,
    /// Windows kept at a time.
    #[arg(long, default_value_t = DataSettings::default().pool)]
    pool: u32,
    /// Windows rendered before the first step.
    #[arg(long, default_value_t = DataSettings::default().initial)]
    initial: u32,
    /// Steps between new windows.
    #[arg(long, default_value_t = DataSettings::default().refresh)]
    refresh: u32,
    /// Samples a pixel of the references (nee, sobol).
    #[arg(long, default_value_t = DataSettings::default().reference_spp)]
    reference_spp: u32,
    /// Repeat the first 20 steps of the run that made these weights and compare the losses bit for bit.
    #[arg(long, value_name = "WEIGHTS", conflicts_with_all = ["steps", "minutes"])]
    verify: Option<PathBuf>,
    #[command(flatten)]
    kernels: KernelArgs,
    #[command(flatten)]
    device: DeviceArgs,
    /// Print one JSON object at the end.
    #[arg(long)]
    json: bool,
}

const CHECKPOINT_EVERY: Duration = Duration::from_secs(120);

impl Args {
    fn data(&self) -> DataSettings {
        DataSettings {
            seed: self.seed,
            batch: self.batch,
            crop: self.crop[0],
            larger_crops: self.crop[1..].to_vec(),
            scenes: self.scenes,
            window: self.window,
            pool: self.pool,
            initial: self.initial,
            refresh: self.refresh,
            reference_spp: self.reference_spp,
            ..DataSettings::default()
        }
    }

    fn length(&self) -> Result<Length> {
        match (self.steps, self.minutes) {
            (Some(steps), _) => Ok(Length::Steps(steps)),
            (None, Some(minutes)) if minutes > 0.0 && minutes.is_finite() => Ok(Length::Minutes(minutes)),
            (None, Some(minutes)) => Err(Error::input(format!("--minutes {minutes}: give a number above 0"))),
            (None, None) => Err(Error::input("give --steps N or --minutes M")),
        }
    }
}

/// Runs the command; the result is the exit code.
pub fn run(args: &Args) -> Result<u8> {
    if let Some(path) = &args.verify {
        return verify(args, path);
    }
    let output = args.output.as_deref().expect("clap requires it");
    let checkpoint_path = output.with_extension("checkpoint");
    let log_path = output.with_extension("log.jsonl");
    for path in [output, &checkpoint_path, &log_path] {
        writable(path)?;
    }
    let gpu = args.device.open()?;
    let choice = args.kernels.choose(&gpu, Purpose::Training)?;
    let mut run = begin(args, &gpu, choice.family)?;
    let stop = Stop::install()?;
    let mut log = open_log(&log_path, run.state.step)?;
    let command = command_line();
    prepare(&mut run)?;
    let mut progress = Progress::new("training");
    progress.start_at(run.state.progress());
    let mut saved = Instant::now();
    while !run.state.done() && stop.requested().is_none() {
        let record = run.step()?;
        let line = serde_json::to_string(&record).map_err(|e| Error::input(e.to_string()))?;
        writeln!(log, "{line}").map_err(|e| Error::io(&log_path, e))?;
        show(&mut progress, &run.state, &record);
        if saved.elapsed() > CHECKPOINT_EVERY {
            save(&run, &gpu, &checkpoint_path, output, &command)?;
            saved = Instant::now();
        }
    }
    drop(progress);
    save(&run, &gpu, &checkpoint_path, output, &command)?;
    let state = &run.state;
    if args.json {
        let results = json!({
            "settings": state.data,
            "length": state.length,
            "learning_rate": state.learning_rate,
            "steps": state.step,
            "chunks": state.crops,
            "seconds": state.seconds,
            "losses": state.losses,
            "finished": state.done(),
            "pipeline_ms": gpu.pipeline_ms(),
            "output": output,
            "checkpoint": checkpoint_path,
        });
        print_report(&gpu, &choice, results)?;
    } else {
        line(&format!("{} after {} steps, {:.0} s", output.display(), state.step, state.seconds));
    }
    args.device.check(&gpu)?;
    Ok(stop.requested().map_or(0, super::stop::Signal::exit_code))
}

/// What every command reports, and the results.
fn print_report(gpu: &Gpu, choice: &Choice, results: Value) -> Result<()> {
    let mut map = report::header("train", gpu);
    report::kernels(&mut map, Some(choice));
    if let Value::Object(results) = results {
        map.extend(results);
    }
    report::print_json(&map.into())
}

fn prepare(run: &mut Run) -> Result<()> {
    let mut progress = Progress::new("rendering training windows");
    run.prepare(|done, all| progress.update(done as f64 / all as f64, all as f64, " windows"))
}

fn show(progress: &mut Progress, state: &RunState, record: &StepRecord) {
    let recent = &state.block;
    let loss = if recent.is_empty() { record.loss } else { recent.iter().sum::<f64>() / recent.len() as f64 };
    progress.note(format!("step {}, loss {loss:.5}, ", record.step));
    let done = state.progress();
    progress.update(done, state.crops as f64 / done, " chunks");
}

fn begin(args: &Args, gpu: &Gpu, family: Family) -> Result<Run> {
    if let Some(path) = &args.resume {
        let (state, parameters, moments) = checkpoint::load(path)?;
        let mut weights = Weights::glorot(&Architecture::named(&state.architecture)?, 0);
        weights.parameters = parameters;
        return Run::new(gpu, family, state, &weights, Some(&moments));
    }
    let architecture = Architecture::named(&args.architecture)?;
    let (weights, init) = initial_weights(args, &architecture, args.seed)?;
    let state =
        RunState::new(&weights.architecture.specification(), args.data(), args.learning_rate, args.length()?, init);
    Run::new(gpu, family, state, &weights, None)
}

/// The weights that a run begins with, a file's with the file's widths, and the sha256 of that file.
fn initial_weights(args: &Args, architecture: &Architecture, seed: u64) -> Result<(Weights, Option<String>)> {
    match &args.init {
        None => Ok((Weights::glorot(architecture, seed), None)),
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

fn save(run: &Run, gpu: &Gpu, checkpoint_path: &Path, output: &Path, command: &str) -> Result<()> {
    let weights = run.weights(&format!("{} ({})", gpu.info().name, gpu.info().driver), command)?;
    checkpoint::save(checkpoint_path, &run.state, &weights, &run.moments()?)?;
    weights.save(output)
}

/// A fresh log, or the one of a resumed run cut back to the steps that its checkpoint has.
fn open_log(path: &Path, steps: u64) -> Result<File> {
    let kept = if steps > 0 { std::fs::read_to_string(path).unwrap_or_default() } else { String::new() };
    let mut file = File::create(path).map_err(|e| Error::io(path, e))?;
    for line in kept.lines().take(steps as usize) {
        writeln!(file, "{line}").map_err(|e| Error::io(path, e))?;
    }
    Ok(file)
}

/// The arguments that can be typed again, without paths' directories.
fn command_line() -> String {
    let words = std::env::args().skip(1).map(|word| {
        let path = Path::new(&word);
        path.is_absolute().then(|| path.file_name().map(|n| n.to_string_lossy().into_owned())).flatten().unwrap_or(word)
    });
    std::iter::once("limpid".to_owned()).chain(words).collect::<Vec<_>>().join(" ")
}

fn verify(args: &Args, path: &Path) -> Result<u8> {
    let recorded = Weights::load(path)?;
    let missing =
        |key: &str| Error::input(format!("{}: no metadata `{key}`: not made by `limpid train`", path.display()));
    let run = recorded.metadata.get(RUN).ok_or_else(|| missing(RUN))?;
    let mut state: RunState =
        serde_json::from_str(run).map_err(|e| Error::input(format!("{}: metadata `{RUN}`: {e}", path.display())))?;
    let losses = recorded.metadata.get(FIRST_LOSSES).ok_or_else(|| missing(FIRST_LOSSES))?;
    let losses: Vec<&str> = losses.split_whitespace().take(VERIFIED_STEPS as usize).collect();
    (state.step, state.seconds) = (0, 0.0);
    let (weights, init) = initial_weights(args, &recorded.architecture, state.data.seed)?;
    if init != state.init {
        return Err(Error::input(format!(
            "{}: the run began with {}; name that file with --init",
            path.display(),
            state.init.as_deref().map_or("random weights".into(), |sum| format!("the weights of sha256 {sum}"))
        )));
    }
    let gpu = args.device.open()?;
    let choice = args.kernels.choose(&gpu, Purpose::Training)?;
    let mut run = Run::new(&gpu, choice.family, state, &weights, None)?;
    prepare(&mut run)?;
    let mut differing = Vec::new();
    for expected in &losses {
        let record = run.step()?;
        let same = format!("{:016x}", record.loss.to_bits()) == **expected;
        let was = u64::from_str_radix(expected, 16).map_or(f64::NAN, f64::from_bits);
        eprintln!(
            "step {}: loss {:e}, recorded {was:e}{}",
            record.step,
            record.loss,
            if same { "" } else { "  DIFFERS" }
        );
        if !same {
            differing.push(record.step);
        }
    }
    let device = recorded.metadata.get("device").map_or("unknown", String::as_str);
    if args.json {
        let results = json!({ "steps": losses.len(), "differing": differing, "recorded_on": device });
        print_report(&gpu, &choice, results)?;
    }
    if losses.is_empty() || !differing.is_empty() {
        return Err(Error::Gpu(format!(
            "{} of {} losses differ from the run recorded on {device}",
            differing.len(),
            losses.len()
        )));
    }
    args.device.check(&gpu)?;
    Ok(0)
}
