//! `limpid devices`: what Vulkan offers.

use super::report;
use limpid::Result;
use limpid::gpu::{DeviceInfo, DeviceOptions, Gpu, list_devices};
use limpid::kernels::check::Purpose;
use limpid::kernels::{Choice, choose};
use limpid::net::kernel::Family;
use serde_json::{Value, json};

/// List the Vulkan devices, what they can do, which one is the default, and which of the network's kernels each runs
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<u8> {
    let devices = list_devices()?;
    // Also says what to install where there is no device.
    let default = Gpu::new(&DeviceOptions::default())?.info().index;
    let kernels: Vec<_> = devices.iter().map(Kernels::new).collect();
    if args.json {
        let list = devices.iter().zip(&kernels).map(|(device, kernels)| {
            let mut value = json!(device);
            value["kernels"] = json!(kernels.names());
            value["families"] = json!(kernels.rows.iter().map(Row::json).collect::<Vec<_>>());
            value
        });
        let list: Vec<_> = list.collect();
        let report = json!({
            "command": "devices",
            "limpid": env!("CARGO_PKG_VERSION"),
            "environment": report::environment(),
            "default": default,
            "devices": list,
        });
        report::print_json(&report)?;
        return Ok(0);
    }
    for (device, kernels) in devices.iter().zip(&kernels) {
        report::print(&describe(device, kernels, device.index == default))?;
    }
    Ok(0)
}

/// A kernel family on a device.
struct Row {
    name: &'static str,
    chosen: bool,
    /// Why the device does not run it.
    not_run: Option<String>,
    /// `passed`, or the failure; none where there was no check.
    self_check: Option<String>,
}

impl Row {
    fn json(&self) -> Value {
        json!({ "name": self.name, "chosen": self.chosen, "not_run": self.not_run, "self_check": self.self_check })
    }

    fn text(&self) -> String {
        let chosen = if self.chosen { "chosen" } else { "runs too" };
        match (&self.not_run, self.self_check.as_deref()) {
            (Some(why), _) => format!("NOT RUN: {why}"),
            (None, Some("passed")) => format!("{chosen}, self-check passed"),
            (None, Some(failure)) => format!("self-check FAILED: {failure}"),
            (None, None) => chosen.to_owned(),
        }
    }
}

/// The kernel families of a device; none where limpid cannot use it.
struct Kernels {
    rows: Vec<Row>,
}

impl Kernels {
    fn new(device: &DeviceInfo) -> Self {
        if !device.unusable.is_empty() {
            return Self { rows: Vec::new() };
        }
        let options = DeviceOptions { select: Some(device.index.to_string()), ..DeviceOptions::default() };
        let choice = Gpu::new(&options).and_then(|gpu| choose(&gpu, None, Purpose::Inference));
        let row = |offer: limpid::net::kernel::Offer| match (&choice, offer.family) {
            (_, Err(why)) => Row { name: offer.name, chosen: false, not_run: Some(why), self_check: None },
            (Err(error), _) => {
                Row { name: offer.name, chosen: false, not_run: Some(error.to_string()), self_check: None }
            }
            (Ok(choice), Ok(family)) => Self::checked(choice, family),
        };
        Self { rows: Family::offers(device).into_iter().map(row).collect() }
    }

    fn checked(choice: &Choice, family: Family) -> Row {
        let check = choice.checks.iter().find(|check| check.kernels == family.name());
        let verdict = |failure: &Option<String>| failure.clone().unwrap_or_else(|| "passed".to_owned());
        let self_check = check.map(|check| verdict(&check.failure));
        Row { name: family.name(), chosen: family == choice.family, not_run: None, self_check }
    }

    /// Those that run, the chosen one first.
    fn names(&self) -> Vec<&'static str> {
        let mut runs: Vec<_> = self.rows.iter().filter(|row| row.not_run.is_none()).collect();
        runs.sort_by_key(|row| !row.chosen);
        runs.into_iter().map(|row| row.name).collect()
    }
}

fn describe(device: &DeviceInfo, kernels: &Kernels, is_default: bool) -> String {
    let mib = |bytes: u64| format!("at most {} MiB", bytes >> 20);
    let mut text = format!("{}: {}{}\n", device.index, device.name, if is_default { " (default)" } else { "" });
    let mut row = |name: &str, value: String| text += &format!("   {name:<13}{value}\n");
    row("kind", device.kind.to_owned());
    row("driver", device.driver.clone());
    row("Vulkan", device.api_version.clone());
    row("subgroup", format!("{} invocations", device.subgroup_size));
    row("memory", format!("{} MiB", device.memory_bytes >> 20));
    let shapes: Vec<String> = device.cooperative_matrices.iter().map(ToString::to_string).collect();
    row(
        "matrices",
        if shapes.is_empty() { "none".to_owned() } else { format!("f16, sums f32: {}", shapes.join(", ")) },
    );
    row("binding", mib(device.max_storage_range));
    row("allocation", mib(device.max_allocation));
    if !device.unusable.is_empty() {
        row("unusable", device.unusable.clone());
    }
    for (i, kernels) in kernels.rows.iter().enumerate() {
        row(if i == 0 { "kernels" } else { "" }, format!("{:<10}{}", kernels.name, kernels.text()));
    }
    text.trim_end().to_owned()
}
