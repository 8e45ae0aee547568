//! `limpid bench`: device times of the network beside what the device can do; error over time and skipped
//! features of the path tracer.

mod error;
mod skip;

use crate::cli::device::{DeviceArgs, KernelArgs};
use crate::cli::render::parse_size;
use crate::cli::report;
use clap::{Subcommand, ValueEnum};
use limpid::bench::network::{Bench, Row, Values};
use limpid::bench::peak;
use limpid::denoise::weights_of;
use limpid::gpu::Gpu;
use limpid::kernels::Choice;
use limpid::kernels::check::Purpose;
use limpid::net::architecture::Architecture;
use limpid::net::plan::Fusion;
use limpid::net::tensor::Tensor;
use limpid::net::weights::Weights;
use limpid::{Error, Result};
use safetensors::tensor::{Dtype, TensorView};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Time the network on the device: by layer, whole, or a training step; or the path tracer: error over time, skipped features
///
/// Of the network it prints device milliseconds (median, shortest and longest run after a warm-up), GFLOP/s in operations of the direct
/// convolution (two a multiply-accumulate, whatever a kernel saves of them), the least bytes to move, and the share of
/// the device's peak: multiplications and additions on registers, measured in the same run. A kernel that saves
/// operations may exceed the peak. The warm-up (the driver's compilation included) and the creation of pipelines stand
/// apart.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Every layer of the network
    Layers(NetArgs),
    /// The whole network
    Net(NetArgs),
    /// A training step, whole and by kernel
    Train(TrainArgs),
    Error(error::Args),
    Skip(skip::Args),
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum PlanName {
    /// The fastest for the device
    Fused,
    /// A kernel a layer
    Unfused,
}

#[derive(Debug, clap::Args)]
struct NetArgs {
    /// Image size, rounded up to the network's alignment
    #[arg(long, value_name = "WxH", value_parser = parse_size, default_value = "768x768")]
    size: (u32, u32),
    /// How the layers are made into kernels
    #[arg(long, value_enum, default_value = "fused")]
    plan: PlanName,
    /// For `net`: also write the network's input and output, NCHW, so that others can be compared on them
    #[arg(long, value_name = "FILE.safetensors")]
    values: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, clap::Args)]
struct TrainArgs {
    /// Crops a step
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..))]
    batch: u32,
    /// Side of a crop, pixels, rounded up to the network's alignment
    #[arg(long, default_value_t = 128, value_parser = clap::value_parser!(u32).range(1..=16384))]
    crop: u32,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, clap::Args)]
struct Common {
    /// Network architecture
    #[arg(long, default_value = "seed", conflicts_with = "weights")]
    arch: String,
    /// Weights instead of random ones: `kpn`, `seed` or `base`, those shipped with limpid, or a safetensors file
    #[arg(long, value_name = "NAME|FILE")]
    weights: Option<PathBuf>,
    /// Timed runs
    #[arg(long, default_value_t = 7, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    repeat: u32,
    #[command(flatten)]
    kernels: KernelArgs,
    #[command(flatten)]
    device: DeviceArgs,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl Common {
    fn weights(&self) -> Result<Weights> {
        match &self.weights {
            Some(path) => weights_of(path),
            None => Ok(Weights::glorot(&Architecture::named(&self.arch)?, 0)),
        }
    }
}

/// Runs the command.
pub fn run(args: &Args) -> Result<u8> {
    match &args.what {
        What::Layers(net) => time_net(net, true),
        What::Net(net) => time_net(net, false),
        What::Train(train) => time_train(train),
        What::Error(args) => error::run(args),
        What::Skip(args) => skip::run(args),
    }
}

fn time_net(args: &NetArgs, by_layer: bool) -> Result<u8> {
    let (gpu, weights) = (args.common.device.open()?, args.common.weights()?);
    let architecture = &weights.architecture;
    let choice = args.common.kernels.choose(&gpu, Purpose::Inference)?;
    let family = choice.family;
    let fusion = match args.plan {
        PlanName::Fused => Fusion::best(family),
        PlanName::Unfused => Fusion::Layers,
    };
    let padded = |side: u32| architecture.padded(side as usize) as u32;
    let (w, h) = (padded(args.size.0), padded(args.size.1));
    let bench = Bench { gpu: &gpu, family, weights: &weights, runs: args.common.repeat };
    let (rows, warm_up) = if by_layer {
        bench.layers((h, w), fusion)?
    } else {
        let (row, warm_up, values) = bench.net((h, w), fusion)?;
        if let Some(path) = &args.values {
            write_values(path, &values)?;
        }
        (vec![row], warm_up)
    };
    let plan = args.plan.to_possible_value().map_or_else(String::new, |v| v.get_name().to_owned());
    let settings = json!({ "architecture": architecture.name(), "width": w, "height": h, "plan": plan });
    finish(
        if by_layer { "bench layers" } else { "bench net" },
        (&gpu, &choice),
        &args.common,
        &settings,
        &rows,
        warm_up,
    )
}

fn write_values(path: &Path, values: &Values) -> Result<()> {
    let bytes = |t: &Tensor| -> Vec<u8> { t.data.iter().flat_map(|v| v.to_le_bytes()).collect() };
    let (input, output) = (bytes(&values.input), bytes(&values.output));
    let view = |t: &Tensor, data| TensorView::new(Dtype::F32, t.shape.to_vec(), data);
    let error = |e: safetensors::SafeTensorError| Error::input(format!("{}: {e}", path.display()));
    let tensors = [
        ("input", view(&values.input, &input).map_err(error)?),
        ("output", view(&values.output, &output).map_err(error)?),
    ];
    let file = safetensors::serialize(tensors, None).map_err(error)?;
    limpid::image::file::write_atomically(path, |out| {
        out.write_all(&file).map_err(|e| Error::io(path.display().to_string(), e))
    })
}

fn time_train(args: &TrainArgs) -> Result<u8> {
    let (gpu, weights) = (args.common.device.open()?, args.common.weights()?);
    let architecture = &weights.architecture;
    let crop = architecture.padded(args.crop as usize) as u32;
    let choice = args.common.kernels.choose(&gpu, Purpose::Training)?;
    let bench = Bench { gpu: &gpu, family: choice.family, weights: &weights, runs: args.common.repeat };
    let (rows, warm_up) = bench.train((args.batch, crop))?;
    let settings = json!({ "architecture": architecture.name(), "batch": args.batch, "crop": crop });
    finish("bench train", (&gpu, &choice), &args.common, &settings, &rows, warm_up)
}

fn finish(
    command: &str,
    (gpu, choice): (&Gpu, &Choice),
    common: &Common,
    settings: &Value,
    rows: &[Row],
    warm_up: f64,
) -> Result<u8> {
    let peak = peak(gpu)?;
    common.device.check(gpu)?;
    let kernels = choice.family.name();
    if common.json {
        let row = |row: &Row| {
            let mut value = json!(row);
            value["gflops"] = json!(row.gflops());
            value["of_peak"] = json!(row.gflops() / peak);
            value
        };
        let mut map = report::header(command, gpu);
        report::kernels(&mut map, Some(choice));
        map.insert("settings".into(), settings.clone());
        map.insert("repeat".into(), common.repeat.into());
        map.insert("peak_gflops".into(), peak.into());
        map.insert("ms".into(), json!({ "pipelines": report::ms(gpu.pipeline_ms()), "warm_up": report::ms(warm_up) }));
        map.insert("rows".into(), rows.iter().map(row).collect());
        report::print_json(&map.into())?;
        return Ok(0);
    }
    report::print(&format!("{}, kernels `{kernels}`, {settings}", gpu.info().name))?;
    report::print(&format!(
        "{:24}{:>10}{:>10}{:>10}{:>10}{:>9}{:>8}",
        "", "ms", "min", "max", "GFLOP/s", "of peak", "MiB"
    ))?;
    for row in rows {
        let mut text = format!("{:24}{:10.3}{:10.3}{:10.3}", row.name, row.ms.median, row.ms.min, row.ms.max);
        if row.operations > 0.0 {
            text += &format!("{:10.1}{:8.0}%", row.gflops(), 100.0 * row.gflops() / peak);
        } else {
            text += &format!("{:19}", "");
        }
        if row.bytes > 0.0 {
            text += &format!("{:8.1}", row.bytes / f64::from(1 << 20));
        }
        if row.kernels.len() > 1 || row.kernels.first().is_some_and(|k| *k != row.name) {
            text += &format!("  {}", row.kernels.join(", "));
        }
        report::print(text.trim_end())?;
    }
    if command == "bench layers" {
        let sum: f64 = rows.iter().map(|row| row.ms.median).sum();
        report::print(&format!("{:24}{sum:10.3}", "sum"))?;
    }
    report::print(&format!(
        "peak {peak:.1} GFLOP/s; warm-up {warm_up:.0} ms, pipelines {:.0} ms, of {} runs",
        gpu.pipeline_ms(),
        common.repeat
    ))?;
    Ok(0)
}
