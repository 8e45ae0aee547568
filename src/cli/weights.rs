//! `limpid weights`: what a weights file holds, and conversion to and from Open Image Denoise's format.

use super::report;
use clap::{Subcommand, ValueEnum};
use limpid::denoise::{Preparation, embedded_names, embedded_weights, weights_of};
use limpid::image::file::{writable, write_bytes};
use limpid::net::tza::{self, Precision};
use limpid::net::weights::{self, Weights};
use limpid::{Error, Result};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Show or convert weights
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Convert weights of `base` to or from Open Image Denoise's TZA format, or write any as limpid does
    ///
    /// The files' endings, .tza and .safetensors, give the direction. Of .safetensors to .safetensors the tensors come in the network's
    /// order, so that equal weights and metadata are equal files, whatever program wrote them. TZA has no metadata: its weights are taken to be for HDR
    /// radiance with albedo and normals (inputs `radiance,albedo,normal`, transfer `pu`), and only such weights become TZA.
    Convert {
        /// File to read
        #[arg(value_name = "IN")]
        input: PathBuf,
        /// File to write
        #[arg(value_name = "OUT")]
        output: PathBuf,
        /// Numbers of a .tza file to write: Open Image Denoise 2 reads fp16 alone; fp32 keeps all bits
        #[arg(long, value_enum, default_value = "fp16")]
        precision: PrecisionName,
    },
    /// Print architecture, parameters, cost and metadata
    Info {
        /// `kpn`, `seed` or `base`, those shipped with limpid, or a .safetensors or .tza file [default: kpn]
        #[arg(value_name = "NAME|FILE")]
        file: Option<PathBuf>,
        /// Print one JSON object
        #[arg(long)]
        json: bool,
    },
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum PrecisionName {
    /// Half precision
    Fp16,
    /// Single precision
    Fp32,
}

/// Formats of weights files.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Format {
    Safetensors,
    Tza,
}

impl Format {
    fn of(path: &Path) -> Result<Self> {
        let ending = path.extension().map(|ending| ending.to_ascii_lowercase());
        match ending.as_ref().and_then(|ending| ending.to_str()) {
            Some("safetensors") => Ok(Self::Safetensors),
            Some("tza") => Ok(Self::Tza),
            _ => Err(Error::input(format!("{}: weights end in .safetensors or .tza", path.display()))),
        }
    }
}

/// Runs the command.
pub fn run(args: &Args) -> Result<u8> {
    match &args.what {
        What::Convert { input, output, precision } => convert(input, output, *precision)?,
        What::Info { file, json } => info(file.as_deref(), *json)?,
    }
    Ok(0)
}

fn convert(input: &Path, output: &Path, precision: PrecisionName) -> Result<()> {
    let (from, to) = (Format::of(input)?, Format::of(output)?);
    if from == to && to == Format::Tza {
        return Err(Error::input(format!("{} to {}: one must end in .safetensors", input.display(), output.display())));
    }
    let weights = load(input)?;
    writable(output)?;
    if to == Format::Safetensors {
        return weights.save(output);
    }
    let name = input.display().to_string();
    if Preparation::of_weights(&weights, &name)? != Preparation::OPEN_IMAGE_DENOISE {
        let [(_, inputs), (_, transfer)] = Preparation::OPEN_IMAGE_DENOISE.metadata();
        return Err(Error::input(format!(
            "{name}: Open Image Denoise's networks read `{inputs}` with the transfer `{transfer}`; these weights do not"
        )));
    }
    let precision = match precision {
        PrecisionName::Fp16 => Precision::Half,
        PrecisionName::Fp32 => Precision::Single,
    };
    let bytes = tza::to_bytes(&weights, precision).map_err(|e| Error::input(format!("{name}: {e}")))?;
    write_bytes(output, &bytes)
}

/// Weights of either format, or those shipped with limpid.
fn load(path: &Path) -> Result<Weights> {
    if embedded_names().any(|name| path.as_os_str() == name) {
        return weights_of(path);
    }
    match Format::of(path)? {
        Format::Safetensors => Weights::load(path),
        Format::Tza => {
            let mut weights = tza::from_bytes(&weights::read(path)?, &path.display().to_string())?;
            weights.metadata.extend(Preparation::OPEN_IMAGE_DENOISE.metadata());
            Ok(weights)
        }
    }
}

fn info(file: Option<&Path>, as_json: bool) -> Result<()> {
    let weights = file.map_or_else(embedded_weights, load)?;
    let architecture = &weights.architecture;
    let kmac = (architecture.macs_per_pixel() / 100.0).round() / 10.0;
    if as_json {
        return report::print_json(&json!({
            "file": file.map_or_else(|| "embedded".to_owned(), report::text),
            "architecture": architecture.specification(),
            "parameters": architecture.parameter_count(),
            "kmac_per_pixel": kmac,
            "receptive_field": architecture.receptive_field(),
            "metadata": weights.metadata,
        }));
    }
    report::print(&format!("architecture     {}", architecture.specification()))?;
    report::print(&format!("parameters       {}", architecture.parameter_count()))?;
    report::print(&format!("kMAC a pixel     {kmac}"))?;
    report::print(&format!("receptive field  {} pixels", architecture.receptive_field()))?;
    weights.metadata.iter().try_for_each(|(key, value)| report::print(&format!("{key:16} {value}")))
}
