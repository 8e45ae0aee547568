//! `limpid devices`: what Vulkan offers.

use super::report;
use limpid::Result;
use limpid::gpu::{DeviceInfo, DeviceOptions, Gpu, list_devices};
use limpid::net::kernel::Family;
use serde_json::json;

/// List the Vulkan devices, what they can do, and which one is the default
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
    if args.json {
        let list = devices.iter().map(|device| {
            let mut value = json!(device);
            value["kernels"] = json!(families(device));
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
    for device in &devices {
        report::print(&describe(device, device.index == default))?;
    }
    Ok(0)
}

/// The kernel families that the device runs, the chosen one first; none where limpid cannot use it.
fn families(device: &DeviceInfo) -> Vec<&'static str> {
    let mut list = if device.unusable.is_empty() { Family::all(device) } else { Vec::new() };
    list.sort_by_key(|family| *family != Family::choose(device));
    list.into_iter().map(Family::name).collect()
}

fn describe(device: &DeviceInfo, is_default: bool) -> String {
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
    let families = families(device);
    match families.split_first() {
        None => row("unusable", device.unusable.clone()),
        Some((chosen, others)) => {
            let missing: Vec<_> = Family::NAMES.into_iter().filter(|name| !families.contains(name)).collect();
            let mut text = (*chosen).to_owned();
            for (what, names) in [("also", others), ("not run here:", &missing)] {
                if !names.is_empty() {
                    text += &format!("; {what} {}", names.join(", "));
                }
            }
            row("kernels", text);
        }
    }
    text.trim_end().to_owned()
}
