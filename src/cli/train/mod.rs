//! `limpid train`: trains a network on scenes that it renders as it goes, or on a data set.

mod args;
mod outputs;
mod source;
mod verify;

pub use args::Args;

use super::progress::{Progress, line};
use super::report;
use super::stop::{Signal, Stop};
use limpid::Result;
use limpid::gpu::Gpu;
use limpid::kernels::Choice;
use limpid::kernels::check::Purpose;
use limpid::train::preset::PAPER_CHECKPOINT_EPOCHS;
use limpid::train::run::{Run, RunState, StepRecord};
use outputs::{Log, Outputs};
use serde_json::{Value, json};
use std::time::{Duration, Instant};

const CHECKPOINT_EVERY: Duration = Duration::from_secs(120);

/// Runs the command; the result is the exit code.
pub fn run(args: &Args) -> Result<u8> {
    if args.resume.is_none() && args.verify.is_none() {
        args.check()?;
    }
    if let Some(path) = &args.verify {
        return verify::run(args, path);
    }
    let output = args.output.as_deref().expect("clap requires it");
    let outputs = Outputs::new(output)?;
    let gpu = args.device.open()?;
    let stop = Stop::install()?;
    let choice = args.kernels.choose(&gpu, Purpose::Training)?;
    let exit = |stop: &Stop| stop.requested().map_or(0, Signal::exit_code);
    let Some(mut run) = source::begin(args, &gpu, choice.family, output, &stop)? else {
        line("stopped before the first step; the same command goes on");
        return Ok(exit(&stop));
    };
    let mut log = outputs.open_log(&run.state)?;
    prepare(&mut run)?;
    train(args, &mut run, &gpu, (&outputs, &mut log), &stop)?;
    outputs.save(&run, &gpu)?;
    let state = &run.state;
    if args.json {
        print_report(&gpu, &choice, summary(state, &gpu, &outputs))?;
    } else {
        line(&format!("{} after {} steps, {:.0} s", output.display(), state.step, state.seconds));
        if let Some(e) = state.evaluations.last() {
            line(&format!(
                "after step {}: loss {:.5}, held out {:.5}; MAE01 {:.5}, held out {:.5}",
                e.step, e.loss, e.held_out_loss, e.mae01, e.held_out_mae01
            ));
        }
    }
    args.device.check(&gpu)?;
    Ok(exit(&stop))
}

/// Steps and evaluations to the end or to a signal.
fn train(args: &Args, run: &mut Run, gpu: &Gpu, (outputs, log): (&Outputs, &mut Log), stop: &Stop) -> Result<()> {
    let mut progress = Progress::new("training");
    progress.start_at(run.state.progress());
    let mut saved = Instant::now();
    let mut unsaved = false;
    loop {
        if run.state.evaluation_due()
            && stop.requested().is_none()
            && let Some(evaluation) = run.evaluate(|| stop.requested().is_none())?
        {
            log.write(&evaluation)?;
        }
        if std::mem::take(&mut unsaved) {
            outputs.save(run, gpu)?;
            saved = Instant::now();
        }
        if run.state.done() || stop.requested().is_some() {
            return Ok(());
        }
        let record = run.step()?;
        log.write(&record)?;
        show(&mut progress, &run.state, &record);
        unsaved = saved.elapsed() > CHECKPOINT_EVERY || checkpoint_due(args, &run.state);
    }
}

/// Whether a checkpoint is wanted after this step, whatever the clock says.
fn checkpoint_due(args: &Args, state: &RunState) -> bool {
    match (args.checkpoint_every, state.data.stored()) {
        (Some(every), _) => state.step.is_multiple_of(every),
        (None, Some(stored)) => {
            let part = |step| stored.epochs_done(step) / PAPER_CHECKPOINT_EPOCHS;
            part(state.step) > part(state.step - 1)
        }
        (None, None) => false,
    }
}

fn summary(state: &RunState, gpu: &Gpu, outputs: &Outputs) -> Value {
    json!({
        "preset": state.data.preset().to_string(),
        "settings": state.data,
        "length": state.length,
        "learning_rate": state.learning_rate,
        "loss": state.loss,
        "steps": state.step,
        "epochs": state.epochs_done(),
        "chunks": state.crops,
        "seconds": state.seconds,
        "losses": state.losses,
        "evaluations": state.evaluations,
        "finished": state.done(),
        "pipeline_ms": gpu.pipeline_ms(),
        "output": outputs.weights,
        "checkpoint": outputs.checkpoint,
    })
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
    if run.state.data.stored().is_some() {
        return Ok(());
    }
    let mut progress = Progress::new("rendering training windows");
    run.prepare(|done, all| progress.update(done as f64 / all as f64, all as f64, " windows"))
}

fn show(progress: &mut Progress, state: &RunState, record: &StepRecord) {
    let recent = &state.block;
    let loss = if recent.is_empty() { record.loss } else { recent.iter().sum::<f64>() / recent.len() as f64 };
    let epoch =
        state.epochs_done().map_or(String::new(), |epochs| format!("epoch {}, ", epochs + u64::from(!state.done())));
    let held_out = state.evaluations.last().map_or(String::new(), |e| format!("held out {:.5}, ", e.held_out_loss));
    progress.note(format!("{epoch}step {}, loss {loss:.5}, {held_out}", record.step));
    let done = state.progress();
    progress.update(done, state.crops as f64 / done, "chunks");
}
