//! `limpid stress`: does a device compute what it must?

use super::device::DeviceArgs;
use super::progress::Progress;
use super::report;
use super::stop::{Signal, Stop};
use limpid::gpu::{Gpu, list_devices};
use limpid::stress::{Case, Outcome, cases};
use limpid::{Error, Result};
use serde_json::{Value, json};
use std::time::Instant;

/// Put a device to the numerical test: does it render and reconstruct what it must?
///
/// T1 to T37 are about rendering (closed forms, symmetries, random numbers, intersections, sums), N1 and on about the network. Each
/// measures and compares with its bar; what cannot run here says why. The exit code is 1 where a case failed.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Only these, e.g. T1,T20 [default: all]
    #[arg(long, value_name = "NUMBER,...", value_delimiter = ',')]
    only: Vec<String>,
    /// Every usable Vulkan device, one after another
    #[arg(long, conflicts_with = "device")]
    all_devices: bool,
    #[command(flatten)]
    device: DeviceArgs,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// A case on a device.
struct Run {
    outcome: Outcome,
    seconds: f64,
}

/// What a device made of the cases; fewer than there are where a signal came.
struct Column {
    gpu: Gpu,
    runs: Vec<Run>,
}

impl Column {
    fn count(&self, verdict: &str) -> usize {
        self.runs.iter().filter(|run| run.outcome.verdict() == verdict).count()
    }
}

/// Runs the command.
pub fn run(args: &Args) -> Result<u8> {
    let stop = Stop::install()?;
    let chosen = choose(&args.only)?;
    let mut columns = Vec::new();
    for device in devices(args)? {
        let mut column = Column { gpu: device.open()?, runs: Vec::new() };
        let mut progress = Progress::new(&format!("{} cases on {}", chosen.len(), column.gpu.info().name));
        for (i, case) in chosen.iter().enumerate() {
            if stop.requested().is_some() {
                break;
            }
            progress.note(format!("{} {}, ", case.number, case.name));
            progress.update(i as f64 / chosen.len() as f64, chosen.len() as f64, "cases");
            let start = Instant::now();
            let outcome = case.run(&column.gpu);
            column.runs.push(Run { outcome, seconds: start.elapsed().as_secs_f64() });
        }
        device.check(&column.gpu)?;
        columns.push(column);
        if stop.requested().is_some() {
            break;
        }
    }
    if args.json {
        report::print_json(&object(&chosen, &columns, stop.requested()))?;
    } else {
        print(&chosen, &columns)?;
    }
    let failed = columns.iter().any(|column| column.count("FAILED") > 0);
    Ok(stop.requested().map_or(u8::from(failed), Signal::exit_code))
}

fn choose(only: &[String]) -> Result<Vec<Case>> {
    let all = cases();
    for number in only {
        if !all.iter().any(|case| case.number.eq_ignore_ascii_case(number)) {
            let known: Vec<_> = all.iter().map(|case| case.number).collect();
            return Err(Error::input(format!("no case `{number}`: one of {}", known.join(", "))));
        }
    }
    let wanted = |case: &Case| only.is_empty() || only.iter().any(|number| case.number.eq_ignore_ascii_case(number));
    Ok(all.into_iter().filter(wanted).collect())
}

fn devices(args: &Args) -> Result<Vec<DeviceArgs>> {
    if !args.all_devices {
        return Ok(vec![args.device.clone()]);
    }
    let usable = list_devices()?.into_iter().filter(|device| device.unusable.is_empty());
    let list: Vec<_> =
        usable.map(|device| DeviceArgs { device: Some(device.index.to_string()), ..args.device.clone() }).collect();
    // Says what to install where there is none.
    Ok(if list.is_empty() { vec![args.device.clone()] } else { list })
}

fn object(chosen: &[Case], columns: &[Column], signal: Option<Signal>) -> Value {
    let column = |column: &Column| {
        let row = |(case, run): (&Case, &Run)| {
            let mut row = json!({
                "number": case.number, "name": case.name, "claim": case.claim, "ms": report::ms(run.seconds * 1e3),
            });
            if let (Value::Object(row), Value::Object(outcome)) = (&mut row, json!(run.outcome)) {
                row.extend(outcome);
            }
            row
        };
        let mut map = report::header("stress", &column.gpu);
        map.remove("command");
        for (key, verdict) in [("passed", "passed"), ("failed", "FAILED"), ("not_run", "not run")] {
            map.insert(key.into(), column.count(verdict).into());
        }
        map.insert("cases".into(), chosen.iter().zip(&column.runs).map(row).collect());
        Value::from(map)
    };
    json!({
        "command": "stress",
        "limpid": env!("CARGO_PKG_VERSION"),
        "interrupted": signal.map(Signal::name),
        "devices": columns.iter().map(column).collect::<Vec<_>>(),
    })
}

fn print(chosen: &[Case], columns: &[Column]) -> Result<()> {
    let name = chosen.iter().map(|case| case.name.len()).max().unwrap_or(0);
    for (i, column) in columns.iter().enumerate() {
        let info = column.gpu.info();
        report::print(&format!("{}: {} ({})", letter(i), info.name, info.driver))?;
    }
    let heads: String = (0..columns.len()).map(|i| format!("  {:<16}", letter(i))).collect();
    report::print(&format!("{:5}{:name$}{}", "", "", heads.trim_end()))?;
    for (row, case) in chosen.iter().enumerate() {
        let mut text = format!("{:5}{:name$}", case.number, case.name);
        for column in columns {
            let cell = column.runs.get(row);
            text += &cell.map_or_else(
                || format!("  {:<16}", "-"),
                |run| format!("  {:<8}{:>6.1} s", run.outcome.verdict(), run.seconds),
            );
        }
        report::print(text.trim_end())?;
        for (i, column) in columns.iter().enumerate() {
            let Some(run) = column.runs.get(row) else { continue };
            let lines = run.outcome.lines();
            // Of what passed, one line is enough; the rest is in the JSON object.
            let shown = if run.outcome.verdict() == "passed" {
                lines.len().min(usize::from(columns.len() == 1))
            } else {
                lines.len()
            };
            for line in &lines[..shown] {
                let which = if columns.len() == 1 { String::new() } else { format!("{}: ", letter(i)) };
                report::print(&format!("       {which}{line}"))?;
            }
        }
    }
    for (i, column) in columns.iter().enumerate() {
        let [passed, failed, not_run] = ["passed", "FAILED", "not run"].map(|verdict| column.count(verdict));
        let left = chosen.len() - column.runs.len();
        let left = if left > 0 { format!(", {left} left when a signal came") } else { String::new() };
        report::print(&format!("{}: {passed} passed, {failed} failed, {not_run} not run{left}", letter(i)))?;
    }
    Ok(())
}

/// The name of a column.
fn letter(column: usize) -> String {
    char::from_digit(column as u32 + 10, 36).map_or_else(|| column.to_string(), |c| c.to_ascii_uppercase().to_string())
}
