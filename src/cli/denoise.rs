//! `limpid denoise`: reconstruct a picture that limpid rendered.

use super::device::DeviceArgs;
use super::files::{Files, parse_exposure};
use super::progress::Progress;
use super::reconstruct::{Reconstruction, exact_pixels};
use super::report;
use limpid::denoise::{Axes, Guides, Inputs};
use limpid::gpu::{Gpu, Slice, Timings};
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
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Picture to reconstruct
    #[arg(value_name = "IN.exr")]
    input: PathBuf,
    /// EXR file to write
    #[arg(short, long, value_name = "OUT.exr")]
    output: PathBuf,
    /// Weights, a safetensors file [default: those shipped with limpid]
    #[arg(long, value_name = "FILE")]
    weights: Option<PathBuf>,
    /// Brightness of the PNG files only, in EV
    #[arg(long, value_name = "EV", default_value = "0", allow_negative_numbers = true, value_parser = parse_exposure)]
    exposure: f32,
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
    let mut network = Reconstruction::load(args.weights.as_deref())?;
    let mut image = read(&args.input, network.inputs())?;
    files.writable(true)?;
    let gpu = args.device.open()?;
    let (radiance, guides) = upload(&gpu, &image, network.inputs())?;
    let progress = Progress::new(&format!("reconstruct {}x{}", image.width, image.height));
    let timings = network.run(&gpu, (&radiance, &guides), &mut image)?;
    drop(progress);
    args.device.check(&gpu)?;
    let outputs = files.write(&image, args.exposure)?;
    report(args, &gpu, &network, (&image, timings.as_ref()), &outputs, start)
}

/// The channels of `inputs` beside radiance and albedo, in the order of the buffer that holds them.
fn guide_channels(inputs: Inputs) -> [&'static str; 3] {
    match inputs {
        Inputs::NormalScreenDepth => ["Nscreen.X", "Nscreen.Y", "Z"],
        Inputs::AlbedoNormal => ["N.X", "N.Y", "N.Z"],
    }
}

/// The picture, its noisy radiance in `R,G,B`, with all that `inputs` need. Which pixels are exact is seen from the albedo.
fn read(path: &Path, inputs: Inputs) -> Result<Image> {
    let mut image = exr::read(path)?;
    if image.has_rgb("noisy") {
        let noisy = image.rgb("noisy")?.map(<[f32]>::to_vec);
        image.set_rgb("", noisy);
    }
    let wanted = ["R", "G", "B", "albedo.R", "albedo.G", "albedo.B"].into_iter().chain(guide_channels(inputs));
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

/// Radiance (rgb, exact) and the guides as the renderer has them.
fn upload(gpu: &Gpu, image: &Image, inputs: Inputs) -> Result<(Slice, Guides)> {
    let exact = exact_pixels(image)?;
    let make = |name: &str, planes: [&[f32]; 3], fourth: &dyn Fn(usize) -> f32| {
        let pixel = |i: usize| [planes[0][i], planes[1][i], planes[2][i], fourth(i)];
        let pixels: Vec<[f32; 4]> = (0..image.pixel_count()).map(pixel).collect();
        let buffer = gpu.buffer(name, size_of_val(&pixels[..]) as u64)?;
        gpu.upload(&buffer.all(), &pixels)?;
        Ok::<_, Error>(buffer.all())
    };
    let [x, y, z] = guide_channels(inputs);
    let last = make("guides", [image.channel(x)?, image.channel(y)?, image.channel(z)?], &|_| 0.0)?;
    let guides = match inputs {
        Inputs::NormalScreenDepth => Guides::NormalScreenDepth { screen: last },
        Inputs::AlbedoNormal => {
            let albedo = make("albedo", image.rgb("albedo")?, &|_| 0.0)?;
            Guides::AlbedoNormal { albedo, normal_world: last, axes: Axes::default() }
        }
    };
    let radiance = make("radiance", image.rgb("")?, &|i| f32::from(u8::from(exact[i])))?;
    Ok((radiance, guides))
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
        report::print(&format!("reconstructed in {:.3} s on {}", device_ms * 1e-3, gpu.info().name))?;
        report::print(&format!("wrote {}", outputs.join(", ")))?;
        return Ok(0);
    }
    let mut map = report::header("denoise", gpu);
    map.insert("input".into(), json!(report::text(&args.input)));
    map.insert("outputs".into(), json!(outputs));
    map.insert("skipped".into(), json!(skipped));
    map.insert("kernels".into(), json!(network.kernels()));
    let settings = json!({
        "width": image.width, "height": image.height, "weights": network.describe(), "exposure_ev": args.exposure,
    });
    map.insert("settings".into(), settings);
    let times = json!({
        "pipelines": report::ms(gpu.pipeline_ms()),
        "reconstruct_device": report::ms(device_ms),
        "wall": report::ms(start.elapsed().as_secs_f64() * 1e3),
    });
    map.insert("ms".into(), times);
    report::print_json(&map.into())?;
    Ok(0)
}
