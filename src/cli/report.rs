//! What commands print on standard output: words for people, one JSON object for programs.

use limpid::gpu::{Gpu, Timings, environment_settings};
use limpid::kernels::Choice;
use limpid::{Error, Result};
use serde_json::{Map, Value, json};
use std::io::{ErrorKind, Write};
use std::path::Path;
use std::time::Instant;

/// Prints on standard output; a reader who has gone away is no error.
pub fn print(text: &str) -> Result<()> {
    match writeln!(std::io::stdout().lock(), "{text}") {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(Error::io("standard output", error)),
        _ => Ok(()),
    }
}

/// Prints one JSON object.
pub fn print_json(value: &Value) -> Result<()> {
    print(&format!("{value:#}"))
}

/// What every report says: the command, versions, the device and its environment, peak bytes of buffers and of the process.
pub fn header(command: &str, gpu: &Gpu) -> Map<String, Value> {
    let mut map = Map::new();
    map.insert("command".into(), command.into());
    map.insert("limpid".into(), env!("CARGO_PKG_VERSION").into());
    map.insert("device".into(), json!(gpu.info()));
    map.insert("environment".into(), environment());
    map.insert("peak_device_bytes".into(), gpu.peak_bytes().into());
    map.insert("peak_process_bytes".into(), peak_process_bytes().into());
    map
}

/// The most memory that this process has had resident; none where the system does not tell.
fn peak_process_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.split_whitespace().next()?.parse::<u64>().ok().map(|kib| kib << 10)
}

/// The driver's environment switches.
pub fn environment() -> Value {
    Value::Object(environment_settings().into_iter().map(|(name, value)| (name.to_owned(), value.into())).collect())
}

/// The kernels that a command uses, and the checks that led to them.
pub fn kernels(map: &mut Map<String, Value>, choice: Option<&Choice>) {
    map.insert("kernels".into(), json!(choice.map(|choice| choice.family.name())));
    map.insert("self_checks".into(), json!(choice.map_or(&[][..], |choice| &choice.checks)));
}

/// From the start of a command to the submission of its first frame.
pub fn start_ms(start: Instant, first: Option<&Timings>) -> Option<Value> {
    let submitted = first?.submitted?;
    Some(ms(submitted.saturating_duration_since(start).as_secs_f64() * 1e3))
}

/// A path as text.
pub fn text(path: &Path) -> String {
    path.display().to_string()
}

/// Milliseconds without false precision.
pub fn ms(value: f64) -> Value {
    json!((value * 1e3).round() / 1e3)
}
