//! `limpid bench skip`: what leaving out what a scene does not need gains.

use crate::cli::device::DeviceArgs;
use crate::cli::render::parse_size;
use crate::cli::report;
use limpid::Result;
use limpid::bench::skip::{Report, run as measure};
use limpid::render::{Estimator, Sampler, Settings};
use limpid::scene::{Spec, mitsuba};
use serde_json::json;

/// What skipping gains: the pipelines of a scene beside those that do more than it needs
///
/// Renders the scene with its own pipelines, with pipelines that leave in one thing that it does not need, and with all of these (the
/// generic pipeline of scenes with many shapes), in turns. Prints device times, ratios of medians, rays a second, and whether the
/// picture is the same to the bit, as it must be on one device.
#[derive(Debug, clap::Args)]
#[command(name = "skip")]
pub struct Args {
    /// `spheres`, `spheres:N`, `rooms:N` or a scene file
    #[arg(default_value = "spheres")]
    scene: String,
    /// Image size
    #[arg(long, value_name = "WxH", value_parser = parse_size, default_value = "256x256")]
    size: (u32, u32),
    /// Samples a pixel
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..))]
    spp: u32,
    /// How light is found
    #[arg(long, value_name = "uniform|cosine|nee", default_value_t = Estimator::Nee)]
    estimator: Estimator,
    /// Random numbers
    #[arg(long, value_name = "pcg|sobol", default_value_t = Sampler::Sobol)]
    sampler: Sampler,
    /// Give every sample its own camera ray
    #[arg(long)]
    aa: bool,
    /// Timed renders of each
    #[arg(long, default_value_t = 7, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    repeat: u32,
    #[command(flatten)]
    device: DeviceArgs,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<u8> {
    let options = mitsuba::Options { size: Some(args.size), ..mitsuba::Options::default() };
    let scene = args.scene.parse::<Spec>()?.load(&options)?.scene;
    let gpu = args.device.open()?;
    let settings = Settings {
        spp: args.spp,
        estimator: args.estimator,
        sampler: args.sampler,
        aa: args.aa,
        aovs: false,
        ..Settings::default()
    };
    let result = measure(&gpu, &scene, &settings, args.repeat)?;
    args.device.check(&gpu)?;
    if args.json {
        let mut map = report::header("bench skip", &gpu);
        let settings = json!({
            "scene": args.scene, "width": args.size.0, "height": args.size.1, "spp": args.spp, "aa": args.aa,
            "estimator": args.estimator.to_string(), "sampler": args.sampler.to_string(), "repeat": args.repeat,
        });
        map.insert("settings".into(), settings);
        map.insert("result".into(), json!(result));
        report::print_json(&map.into())?;
    } else {
        report::print(&table(args, gpu.info().name.as_str(), &result))?;
    }
    Ok(0)
}

fn table(args: &Args, device: &str, result: &Report) -> String {
    let (w, h) = args.size;
    let mut lines = vec![
        format!("{} {w}x{h}, {} spp, {}+{}, {device}", args.scene, args.spp, args.estimator, args.sampler),
        format!(
            "{:<14} {:>10} {:>22} {:>8} {:>12}  same bits",
            "not skipped", "ms", "shortest to longest", "ratio", "Mrays/s"
        ),
    ];
    let mut line = |name: &str, ms: &limpid::bench::Times, ratio: f64, rays: f64, same: bool| {
        let range = format!("{:.2} to {:.2}", ms.min, ms.max);
        lines.push(format!(
            "{name:<14} {:>10.2} {range:>22} {ratio:>7.2}x {:>12.1}  {}",
            ms.median,
            rays * 1e-6,
            if same { "yes" } else { "no" }
        ));
    };
    line("nothing", &result.ms, 1.0, result.rays_per_second, true);
    for row in &result.rows {
        line(&row.kept, &row.ms, row.ratio, row.rays_per_second, row.same_bits);
    }
    lines.push(format!("{:.1} % of the pixels are exact and cost one ray", 100.0 * result.exact_pixels));
    lines.join("\n")
}
