//! The command line: one file a command, and what they share.

mod bench;
mod compare;
mod dataset;
mod denoise;
mod device;
mod devices;
mod files;
mod frame;
mod progress;
mod reconstruct;
mod render;
mod report;
mod scene;
mod stop;
mod stress;
mod tile;
mod train;
mod weights;

use clap::{Parser, Subcommand};
use limpid::Result;

/// Path tracing, reconstruction and training on any Vulkan 1.3 device
///
/// limpid path-traces an image and reconstructs it with a denoising autoencoder. Both run as Vulkan compute shaders: headless,
/// on any Vulkan 1.3 device, the CPU driver lavapipe included; the same device trains the autoencoder.
///
/// Errors are one line on standard error; the exit code is 2 for bad arguments or input and 1 for anything else. limpid
/// does not log unless RUST_LOG says so (e.g. RUST_LOG=info).
#[derive(Debug, Parser)]
#[command(name = "limpid", version, arg_required_else_help = true)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Render(Box<render::Args>),
    Denoise(denoise::Args),
    Compare(compare::Args),
    Scene(scene::Args),
    Dataset(dataset::Args),
    Train(Box<train::Args>),
    Bench(bench::Args),
    Stress(stress::Args),
    Weights(weights::Args),
    Devices(devices::Args),
}

/// Runs the command; the result is the exit code.
pub fn run(cli: &Cli) -> Result<u8> {
    match &cli.command {
        Command::Render(args) => render::run(args),
        Command::Denoise(args) => denoise::run(args),
        Command::Compare(args) => compare::run(args),
        Command::Scene(args) => scene::run(args),
        Command::Dataset(args) => dataset::run(args),
        Command::Train(args) => train::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Stress(args) => stress::run(args),
        Command::Weights(args) => weights::run(args),
        Command::Devices(args) => devices::run(args),
    }
}

/// The message of a refused command line as one line, without the usage.
pub fn one_line(message: &str) -> String {
    let mut line = String::new();
    for part in message.lines().map(str::trim).filter(|part| !part.is_empty() && !part.starts_with("Usage:")) {
        let part = part.strip_prefix("error: ").unwrap_or(part);
        if !line.is_empty() {
            line += if line.ends_with(':') { " " } else { "; " };
        }
        line += part.strip_suffix('.').unwrap_or(part);
    }
    line.replace("For more information", "for more information")
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn arguments_are_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn refusals_fit_one_line() {
        let text = "error: unexpected argument '--sp' found\n\n  tip: a similar argument exists: '--spp'\n\nUsage: limpid render\n\nFor more information, try '--help'.\n";
        assert_eq!(
            one_line(text),
            "unexpected argument '--sp' found; tip: a similar argument exists: '--spp'; for more information, try '--help'"
        );
        assert_eq!(one_line("error: not provided:\n  <REF.exr>\n"), "not provided: <REF.exr>");
    }
}
