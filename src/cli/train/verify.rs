//! `limpid train --verify`: the first steps of a recorded run once more.

use super::source::{Beginning, initial_weights};
use super::{Args, prepare, print_report};
use crate::cli::stop::Stop;
use limpid::kernels::check::Purpose;
use limpid::net::weights::Weights;
use limpid::train::run::{FIRST_LOSSES, RUN, RunState, VERIFIED_STEPS};
use limpid::{Error, Result};
use serde_json::json;
use std::path::Path;

/// Runs it; the result is the exit code.
pub fn run(args: &Args, path: &Path) -> Result<u8> {
    let recorded = Weights::load(path)?;
    let missing =
        |key: &str| Error::input(format!("{}: no metadata `{key}`: not made by `limpid train`", path.display()));
    let run = recorded.metadata.get(RUN).ok_or_else(|| missing(RUN))?;
    let mut state: RunState =
        serde_json::from_str(run).map_err(|e| Error::input(format!("{}: metadata `{RUN}`: {e}", path.display())))?;
    let losses = recorded.metadata.get(FIRST_LOSSES).ok_or_else(|| missing(FIRST_LOSSES))?;
    let losses: Vec<&str> = losses.split_whitespace().take(VERIFIED_STEPS as usize).collect();
    (state.step, state.seconds) = (0, 0.0);
    let (weights, init) = initial_weights(args, &recorded.architecture, state.data.seed())?;
    if init != state.init {
        return Err(Error::input(format!(
            "{}: the run began with {}; name that file with --init",
            path.display(),
            state.init.as_deref().map_or("random weights".into(), |sum| format!("the weights of sha256 {sum}"))
        )));
    }
    let gpu = args.device.open()?;
    let stop = Stop::install()?;
    let choice = args.kernels.choose(&gpu, Purpose::Training)?;
    let folder = args.paper.dataset.clone().unwrap_or_else(|| path.with_extension("dataset"));
    let beginning = Beginning { state, weights, moments: None };
    let Some(mut run) = beginning.start(&gpu, choice.family, &folder, &stop)? else {
        return Ok(stop.requested().map_or(0, crate::cli::stop::Signal::exit_code));
    };
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
