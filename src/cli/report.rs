//! What commands print on standard output: words for people, one JSON object for programs.

use limpid::gpu::{Gpu, environment_settings};
use limpid::{Error, Result};
use serde_json::{Map, Value, json};
use std::io::{ErrorKind, Write};
use std::path::Path;

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

/// A path as text.
pub fn text(path: &Path) -> String {
    path.display().to_string()
}

/// Milliseconds without false precision.
pub fn ms(value: f64) -> Value {
    json!((value * 1e3).round() / 1e3)
}
