//! `limpid dataset`: noisy pictures with their targets, for `limpid train --preset paper`.

use super::device::DeviceArgs;
use super::progress::{Progress, duration};
use super::render::parse_size;
use super::report;
use super::stop::Stop;
use limpid::Result;
use limpid::gpu::Gpu;
use limpid::train::dataset::{DatasetSettings, Manifest, NOISY_VERSIONS, Writer, Written};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Write a data set: noisy pictures of random scenes, and what a network shall make of them
///
/// DIR gets two noisy EXR files a scene (`cosine` and `pcg`, all channels) and the target that they share (`nee` and `sobol`),
/// and last manifest.json. Scenes that are held out are never in it. Repeated, the command makes what is missing.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder to write to
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    #[command(flatten)]
    pictures: PictureArgs,
    /// Samples a pixel of the targets [default: 256, which have less error than 16,384 of `cosine`]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    reference_spp: Option<u32>,
    /// Seed of the choice of scenes and of all noise
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    device: DeviceArgs,
    /// Print one JSON object at the end
    #[arg(long)]
    json: bool,
}

/// The flags that say what a data set holds.
#[derive(Clone, Debug, clap::Args)]
pub struct PictureArgs {
    /// Scenes of the data set [default: 100]
    #[arg(long, value_name = "SCENES")]
    pub count: Option<u32>,
    /// Size of its pictures [default: 768x768]
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<(u32, u32)>,
    /// Samples a pixel of its noisy pictures [default: 16]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub spp: Option<u32>,
}

impl PictureArgs {
    /// The settings of a data set.
    pub fn settings(&self, reference_spp: Option<u32>, seed: u64) -> DatasetSettings {
        let defaults = DatasetSettings::default();
        let (width, height) = self.size.unwrap_or((defaults.width, defaults.height));
        DatasetSettings {
            count: self.count.unwrap_or(defaults.count),
            width,
            height,
            spp: self.spp.unwrap_or(defaults.spp),
            reference_spp: reference_spp.unwrap_or(defaults.reference_spp),
            seed,
        }
    }

    /// The first flag that was given.
    pub fn given(&self) -> Option<&'static str> {
        let flags = [("--count", self.count.is_some()), ("--size", self.size.is_some()), ("--spp", self.spp.is_some())];
        flags.into_iter().find_map(|(name, given)| given.then_some(name))
    }
}

/// Makes what is missing of a data set, with progress; none where a signal came first.
pub fn make(gpu: &Gpu, dir: &Path, settings: &DatasetSettings, stop: &Stop) -> Result<Option<(Manifest, u64)>> {
    let mut writer = Writer::new(gpu, dir, settings)?;
    let label =
        format!("data set {}: {} scenes of {}x{}", dir.display(), settings.count, settings.width, settings.height);
    let mut progress = Progress::new(&label);
    let samples = Writer::all_spp(settings) as f64 * f64::from(settings.width) * f64::from(settings.height);
    let written = writer.run(|share, kept| {
        if kept {
            progress.start_at(share);
        }
        progress.update(share, samples, "samples");
        stop.requested().is_none()
    })?;
    Ok(match written {
        Written::Whole(manifest) => Some((manifest, writer.rendered())),
        Written::Stopped => None,
    })
}

/// Runs the command.
pub fn run(args: &Args) -> Result<u8> {
    let start = Instant::now();
    let stop = Stop::install()?;
    let settings = args.pictures.settings(args.reference_spp, args.seed);
    settings.check()?;
    let gpu = args.device.open()?;
    let Some((manifest, rendered)) = make(&gpu, &args.output, &settings, &stop)? else {
        super::progress::line("stopped; the same command goes on");
        return Ok(stop.requested().map_or(0, super::stop::Signal::exit_code));
    };
    args.device.check(&gpu)?;
    let (noisy, seconds) = (settings.count * NOISY_VERSIONS, start.elapsed().as_secs_f64());
    if args.json {
        let mut map = report::header("dataset", &gpu);
        let results = json!({
            "settings": settings, "scenes": manifest.scenes, "noisy_pictures": noisy, "targets": settings.count,
            "rendered": rendered, "kept": manifest.files.len() as u64 - rendered, "seconds": seconds,
            "fingerprint": manifest.fingerprint(), "output": report::text(&args.output),
        });
        if let serde_json::Value::Object(results) = results {
            map.extend(results);
        }
        report::print_json(&map.into())?;
    } else {
        let (files, dir) = (manifest.files.len(), args.output.display());
        report::print(&format!(
            "{dir}: {noisy} noisy pictures with {} targets, {rendered} of {files} files rendered in {}",
            settings.count,
            duration(seconds)
        ))?;
    }
    Ok(0)
}
