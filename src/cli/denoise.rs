//! `limpid denoise`: reconstruct a picture that limpid rendered.

use super::device::{DeviceArgs, KernelArgs};
use super::files::{Files, parse_exposure};
use super::progress::Progress;
use super::reconstruct::{Reconstruction, repaired_line};
use super::report;
use super::tile::TileArgs;
use limpid::denoise::Inputs;
use limpid::gpu::{Gpu, Timings};
use limpid::image::{Image, exr};
use limpid::{Error, Result};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Reconstruct a picture that limpid rendered
///
/// IN.exr gives the noisy radiance (noisy.R/G/B, or R, G, B where these are absent), albedo.R/G/B and what else the weights'
/// network reads: Nscreen.X/Y and Z, or N.X/Y/Z. OUT.exr has the same channels, with the reconstruction in R, G, B; beside it go OUT.png and OUT.compare.png (noisy, reconstructed).
/// The result equals that of `limpid render --denoise` bit for bit.
///
/// A frame that does not fit the device is reconstructed in tiles, with the same bits. `--tile 128 --overlap 0` cuts it into chunks of 128 x 128
/// pixels that know nothing of each other, and shows the seams that come of it; `--overlap K --blend` interpolates between overlapping tiles.
/// Both are approximate, and for comparison; without --overlap tiles are exact.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Picture to reconstruct
    #[arg(value_name = "IN.exr")]
    input: PathBuf,
    /// EXR file to write
    #[arg(short, long, value_name = "OUT.exr")]
    output: PathBuf,
    /// Weights: `kpn`, `seed` or `base`, those shipped with limpid, or a safetensors file [default: kpn]
    #[arg(long, value_name = "NAME|FILE")]
    weights: Option<PathBuf>,
    /// Brightness of the PNG files only, in EV
    #[arg(long, value_name = "EV", default_value = "0", allow_negative_numbers = true, value_parser = parse_exposure)]
    exposure: f32,
    #[command(flatten)]
    tiles: TileArgs,
    #[command(flatten)]
    kernels: KernelArgs,
    #[command(flatten)]
    device: DeviceArgs,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<u8> {
    let start = Instant::now();
    let files = Files::new(&args.output)?;
    let mut network = Reconstruction::load(args.weights.as_deref(), args.tiles.cut())?;
    files.writable(true)?;
    let gpu = args.device.open()?;
    network.choose_kernels(&gpu, &args.kernels)?;
    let mut image = read(&args.input, network.inputs())?;
    network.choose(&gpu, (image.width, image.height), false)?;
    let mut progress = Progress::new(&format!("reconstruct {}x{}", image.width, image.height));
    let pixels = image.pixel_count() as f64;
    let timings = network.run(&gpu, None, &mut image, |done| progress.update(done, pixels, "pixels"))?;
    drop(progress);
    network.release();
    args.device.check(&gpu)?;
    let outputs = files.write(&image, args.exposure)?;
    report(args, &gpu, &network, (&image, timings.as_ref()), &outputs, start)
}

/// The picture, its noisy radiance in `R,G,B`, with all that `inputs` need. Which pixels are exact is seen from the albedo.
fn read(path: &Path, inputs: Inputs) -> Result<Image> {
    let mut image = exr::read(path)?;
    if image.has_rgb("noisy") {
        image.move_rgb("noisy", "")?;
    }
    let guides = inputs.planes()[1..].iter().flat_map(|(_, channels)| *channels).filter(|c| !c.starts_with("albedo."));
    let wanted = ["R", "G", "B", "albedo.R", "albedo.G", "albedo.B"].into_iter().chain(guides);
    let missing: Vec<_> = wanted.filter(|name| !image.channels.contains_key(*name)).collect();
    if !missing.is_empty() {
        return Err(Error::input(format!(
            "{}: it has no {}; give an EXR that `limpid render` wrote",
            path.display(),
            missing.join(", ")
        )));
    }
    Ok(image)
}

fn report(
    args: &Args,
    gpu: &Gpu,
    network: &Reconstruction,
    (image, timings): (&Image, Option<&Timings>),
    outputs: &[PathBuf],
    start: Instant,
) -> Result<u8> {
    let outputs: Vec<_> = outputs.iter().map(|path| report::text(path)).collect();
    let device_ms = timings.map_or(0.0, |timings| timings.device_ms);
    let skipped: &[&str] = if timings.is_none() { &["the reconstruction: no pixel is noisy"] } else { &[] };
    if !args.json {
        for text in skipped {
            report::print(&format!("skipped {text}"))?;
        }
        if let Some(caution) = network.caution() {
            report::print(&caution)?;
        }
        if network.repaired() > 0 {
            report::print(&repaired_line(network.repaired()))?;
        }
        report::print(&format!("reconstructed in {:.3} s on {}", device_ms * 1e-3, gpu.info().name))?;
        report::print(&format!("wrote {}", outputs.join(", ")))?;
        return Ok(0);
    }
    let mut map = report::header("denoise", gpu);
    map.insert("input".into(), json!(report::text(&args.input)));
    map.insert("outputs".into(), json!(outputs));
    map.insert("skipped".into(), json!(skipped));
    report::kernels(&mut map, network.kernels());
    map.insert("tiling".into(), json!(network.tiling()));
    map.insert("repaired_pixels".into(), network.repaired().into());
    let settings = json!({
        "width": image.width, "height": image.height, "weights": network.describe(), "exposure_ev": args.exposure,
        "tile": args.tiles.tile, "overlap": args.tiles.overlap, "blend": args.tiles.blend, "max_memory_mib": args.tiles.max_memory,
    });
    map.insert("settings".into(), settings);
    let times = json!({
        "start": report::start_ms(start, timings),
        "pipelines": report::ms(gpu.pipeline_ms()),
        "reconstruct_device": report::ms(device_ms),
        "wall": report::ms(start.elapsed().as_secs_f64() * 1e3),
    });
    map.insert("ms".into(), times);
    report::print_json(&map.into())?;
    Ok(0)
}
