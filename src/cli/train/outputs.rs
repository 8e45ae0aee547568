//! What a training run leaves beside its weights: log, plot, checkpoint.

use limpid::gpu::Gpu;
use limpid::image::file::{writable, write_bytes};
use limpid::train::checkpoint;
use limpid::train::plot;
use limpid::train::run::{Run, RunState};
use limpid::{Error, Result};
use serde::Serialize;
use serde_json::Value;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The files.
pub struct Outputs {
    /// OUT.safetensors.
    pub weights: PathBuf,
    /// OUT.checkpoint.
    pub checkpoint: PathBuf,
    plot: PathBuf,
    log: PathBuf,
    command: String,
}

impl Outputs {
    /// Beside the weights; all of them must be writable.
    pub fn new(weights: &Path) -> Result<Self> {
        let beside = |extension| weights.with_extension(extension);
        let (checkpoint, plot, log) = (beside("checkpoint"), beside("svg"), beside("log.jsonl"));
        [weights, &checkpoint, &plot, &log].into_iter().try_for_each(writable)?;
        Ok(Self { weights: weights.to_owned(), checkpoint, plot, log, command: command_line() })
    }

    /// Writes the checkpoint, then the weights and the plot, each whole or not at all.
    pub fn save(&self, run: &Run, gpu: &Gpu) -> Result<()> {
        let weights = run.weights(&format!("{} ({})", gpu.info().name, gpu.info().driver), &self.command)?;
        checkpoint::save(&self.checkpoint, &run.state, &weights, &run.moments()?)?;
        weights.save(&self.weights)?;
        let picture = plot::svg(&run.state)?;
        write_bytes(&self.plot, picture.as_bytes())
    }

    /// A fresh log, or the one of a resumed run cut back to what its state has.
    pub fn open_log(&self, state: &RunState) -> Result<Log> {
        let kept = if state.step > 0 { std::fs::read_to_string(&self.log).unwrap_or_default() } else { String::new() };
        let mut log =
            Log { file: File::create(&self.log).map_err(|e| Error::io(&self.log, e))?, path: self.log.clone() };
        let lines: String =
            kept.lines().take_while(|line| known(line, state)).map(|line| format!("{line}\n")).collect();
        log.append(&lines)?;
        Ok(log)
    }
}

/// Whether a line of a log is whole and tells of what has led to this state.
fn known(line: &str, state: &RunState) -> bool {
    let Ok(line) = serde_json::from_str::<Value>(line) else { return false };
    let last = match line.get("held_out_loss") {
        Some(_) => state.evaluations.last().map_or(0, |e| e.step),
        None => state.step,
    };
    line.get("step").and_then(Value::as_u64).is_some_and(|step| step <= last)
}

/// One JSON object a line.
pub struct Log {
    file: File,
    path: PathBuf,
}

impl Log {
    /// Adds a line.
    pub fn write(&mut self, record: &impl Serialize) -> Result<()> {
        let line = serde_json::to_string(record).map_err(|e| Error::input(e.to_string()))?;
        self.append(&(line + "\n"))
    }

    fn append(&mut self, text: &str) -> Result<()> {
        self.file.write_all(text.as_bytes()).map_err(|e| Error::io(&self.path, e))
    }
}

/// The arguments that can be typed again, without paths' directories.
fn command_line() -> String {
    let words = std::env::args().skip(1).map(|word| {
        let path = Path::new(&word);
        path.is_absolute().then(|| path.file_name().map(|n| n.to_string_lossy().into_owned())).flatten().unwrap_or(word)
    });
    std::iter::once("limpid".to_owned()).chain(words).collect::<Vec<_>>().join(" ")
}
