//! `limpid render`: a scene in, pictures out.

use super::device::{DeviceArgs, KernelArgs};
use super::files::{Files, parse_exposure};
use super::frame::{Frame, Work};
use super::reconstruct::Reconstruction;
use super::report;
use super::stop::{Signal, Stop};
use super::tile::TileArgs;
use limpid::image::check_size;
use limpid::render::{Estimator, Goal, Sampler, Settings};
use limpid::scene::{Loaded, Spec, mitsuba};
use limpid::{Error, Result};
use serde_json::json;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Samples a pixel at most where an error or a time ends the render.
const MOST_SAMPLES: u32 = 1 << 20;

/// Path-trace a scene and, with --denoise, reconstruct the picture
///
/// Writes OUT.exr (radiance and first-hit channels), OUT.png and, with --denoise, OUT.compare.png (noisy and reconstructed
/// side by side). In OUT.exr R, G, B hold the reconstruction where there is one, and noisy.R/G/B the noisy radiance.
///
/// SIGINT and SIGTERM end a render after the dispatch in flight: it writes the picture so far and OUT.exr.checkpoint, with
/// which --resume goes on to the same bits. Renders of over a minute keep such a checkpoint as they go.
#[derive(Debug, clap::Args)]
#[command(allow_negative_numbers = true)]
pub struct Args {
    /// `spheres` (the canonical frame), `spheres:N` (scene N of the random family) or a Mitsuba 3 XML or glTF file
    #[arg(default_value = "spheres")]
    pub scene: String,
    /// EXR file to write [default: the scene's name in the current directory]
    #[arg(short, long, value_name = "OUT.exr")]
    pub output: Option<PathBuf>,
    /// Samples a pixel [default: the scene file's, else 16; with --until or --time 1048576]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub spp: Option<u32>,
    /// Go on until the estimated relMSE of the noisy picture is at most this; --spp is the most samples then
    ///
    /// Samples alternate between two independent halves, whose difference tells the error; with `sobol` that costs about a
    /// sixth more samples for the same error than one set of points would.
    #[arg(long, value_name = "RELMSE", value_parser = parse_relmse)]
    pub until: Option<f64>,
    /// Render for so long, e.g. 10s, 500ms, 2m; --spp is the most samples then
    #[arg(long, value_name = "TIME", value_parser = parse_time, conflicts_with = "resume")]
    pub time: Option<Duration>,
    /// Image size [default: the scene file's, else 768x768]
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<(u32, u32)>,
    /// Seed of all random numbers; frame t of an animation uses seed + t
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u32,
    /// Reflections that a path may make [default: the scene file's, else 8]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(..=i64::from(Settings::MAX_BOUNCES)))]
    pub bounces: Option<u32>,
    /// Reflections after which a path may be ended by chance (Russian roulette); never where it is the bounce limit or more
    /// [default: 5 where --bounces is above 8, else never]
    #[arg(long, value_name = "N")]
    pub roulette: Option<u32>,
    /// How light is found: by chance (uniform or cosine-weighted directions) or by sampling the lights at every hit
    #[arg(long, value_name = "uniform|cosine|nee", default_value_t = Estimator::Nee)]
    pub estimator: Estimator,
    /// Random numbers: independent, or Owen-scrambled Sobol points
    #[arg(long, value_name = "pcg|sobol", default_value_t = Sampler::Sobol)]
    pub sampler: Sampler,
    /// Give every sample its own camera ray, uniform in the pixel; otherwise all share the ray through its centre
    #[arg(long)]
    pub aa: bool,
    /// Add the variance of the mean, variance.R/G/B (needs --sampler pcg and at least 8 samples)
    #[arg(long)]
    pub variance: bool,
    /// Write the radiance alone, without the first hits' albedo, normal and depth
    #[arg(long, conflicts_with = "denoise")]
    pub no_aovs: bool,
    /// Frames of the animation of `spheres:N`: A..B without B, A..=B with it; writes OUT.0007.exr and so on
    #[arg(long, value_name = "A..B", value_parser = parse_frames)]
    pub frames: Option<Range<u32>>,
    /// Reconstruct the picture with the autoencoder
    #[arg(long)]
    pub denoise: bool,
    /// Weights: `kpn`, `seed` or `base`, those shipped with limpid, or a safetensors file [default: kpn]
    #[arg(long, value_name = "NAME|FILE", requires = "denoise")]
    pub weights: Option<PathBuf>,
    #[command(flatten)]
    pub tiles: TileArgs,
    /// Brightness of the PNG files only, in EV
    #[arg(long, value_name = "EV", default_value = "0", value_parser = parse_exposure)]
    pub exposure: f32,
    /// Leave out what of a scene file is not supported and name it, instead of refusing the file
    #[arg(long)]
    pub lenient: bool,
    /// Go on from the checkpoint of an interrupted render; finished frames are kept
    #[arg(long)]
    pub resume: bool,
    #[command(flatten)]
    pub kernels: KernelArgs,
    #[command(flatten)]
    pub device: DeviceArgs,
    /// Print one JSON object: device, settings, times, rays, what was skipped
    #[arg(long)]
    pub json: bool,
}

/// Reads `WIDTHxHEIGHT`.
pub fn parse_size(text: &str) -> std::result::Result<(u32, u32), String> {
    let number = |side: &str| {
        let digits = !side.is_empty() && side.bytes().all(|byte| byte.is_ascii_digit());
        // What does not fit u32 is too large all the same.
        digits.then(|| side.parse::<u32>().unwrap_or(u32::MAX))
    };
    let sides = text.split_once('x').and_then(|(w, h)| Some((number(w)?, number(h)?)));
    let (width, height) = sides.ok_or("write WIDTHxHEIGHT, e.g. 768x768")?;
    check_size(width, height).map_err(|error| error.to_string())?;
    Ok((width, height))
}

/// Reads an error above 0.
fn parse_relmse(text: &str) -> std::result::Result<f64, String> {
    let value = text.parse().ok().filter(|value: &f64| *value > 0.0 && value.is_finite());
    value.ok_or_else(|| "write a number above 0, e.g. 0.01".to_owned())
}

/// Reads a number with `ms`, `s` or `m`.
fn parse_time(text: &str) -> std::result::Result<Duration, String> {
    let units = [("ms", 1e-3), ("s", 1.0), ("m", 60.0)];
    let seconds =
        units.into_iter().find_map(|(unit, seconds)| Some(text.strip_suffix(unit)?.parse::<f64>().ok()? * seconds));
    let time = seconds.filter(|s| *s > 0.0).and_then(|s| Duration::try_from_secs_f64(s).ok());
    time.ok_or_else(|| "write a time above 0 with its unit, e.g. 10s, 500ms or 2m".to_owned())
}

/// Reads `A..B` or `A..=B`.
fn parse_frames(text: &str) -> std::result::Result<Range<u32>, String> {
    let form = "write A..B (without B) or A..=B, e.g. 0..240";
    let (a, b) = text.split_once("..").ok_or(form)?;
    let number = |t: &str| t.parse::<u32>().ok().filter(|_| t.bytes().all(|byte| byte.is_ascii_digit())).ok_or(form);
    let begin = number(a)?;
    let end = match b.strip_prefix('=') {
        Some(last) => number(last)?.checked_add(1).ok_or(form)?,
        None => number(b)?,
    };
    if begin >= end {
        return Err(format!("{begin} to {end} holds no frame; {form}"));
    }
    Ok(begin..end)
}

impl Args {
    /// The output named, or one after the scene.
    fn files(&self, spec: &Spec) -> Result<Files> {
        let name = match (&self.output, spec) {
            (Some(path), _) => path.clone(),
            (None, Spec::Canonical) => "spheres.exr".into(),
            (None, Spec::Family(n)) => format!("spheres-{n}.exr").into(),
            (None, Spec::Rooms(n)) => format!("rooms-{n}.exr").into(),
            (None, Spec::File(path)) => Path::new(path.file_stem().unwrap_or("scene".as_ref())).with_extension("exr"),
        };
        Files::new(&name)
    }

    /// The scene of a frame; flags go before what its file states.
    fn load(&self, spec: &Spec, frame: Option<u32>) -> Result<Frame> {
        let options = mitsuba::Options { size: self.size, lenient: self.lenient, ..mitsuba::Options::default() };
        let Loaded { scene, spp, bounces, left_out } = match frame {
            Some(t) => spec.load_frame(t, &options)?,
            None => spec.load(&options)?,
        };
        super::progress::left_out(&left_out);
        let defaults = Settings::default();
        let goal = Goal { relmse: self.until, time: self.time };
        // The samples that a file states are no limit where another goal is set.
        let spp = if goal == Goal::default() { spp.unwrap_or(defaults.spp) } else { MOST_SAMPLES };
        let bounces = self.bounces.or(bounces).unwrap_or(defaults.bounces);
        let settings = Settings {
            spp: self.spp.unwrap_or(spp),
            seed: self.seed.wrapping_add(frame.unwrap_or(0)),
            bounces,
            roulette: self.roulette.unwrap_or_else(|| Settings::default_roulette(bounces)),
            estimator: self.estimator,
            sampler: self.sampler,
            // A lens is sampled: no two samples share a camera ray.
            aa: self.aa || scene.camera.lens.is_some(),
            variance: self.variance,
            halves: self.until.is_some(),
            aovs: !self.no_aovs,
        };
        Ok(Frame { number: frame, family_version: spec.family_version(), scene, settings, goal, left_out })
    }

    /// When the render is done, for people.
    pub fn goal_in_words(&self, spp: u32) -> String {
        let until = self.until.map(|relmse| format!("until relMSE {relmse}"));
        let time = self.time.map(|time| format!("for {} s", time.as_secs_f64()));
        let goals: Vec<String> = until.into_iter().chain(time).collect();
        if goals.is_empty() { format!("{spp} spp") } else { goals.join(" or ") }
    }
}

/// Runs the command.
pub fn run(args: &Args) -> Result<u8> {
    let start = Instant::now();
    let stop = Stop::install()?;
    if args.variance && args.sampler != Sampler::Pcg {
        return Err(Error::input("--variance needs independent samples: add --sampler pcg"));
    }
    if args.tiles.any() && !args.denoise {
        return Err(Error::input("--tile and --max-memory are about the reconstruction: add --denoise"));
    }
    if args.kernels.kernels.is_some() && !args.denoise {
        return Err(Error::input("--kernels chooses the network's kernels: add --denoise"));
    }
    let spec: Spec = args.scene.parse()?;
    let files = args.files(&spec)?;
    let numbers: Vec<Option<u32>> = match &args.frames {
        None => vec![None],
        Some(range) => range.clone().map(Some).collect(),
    };
    // Whatever is wrong with the input shows before a device is opened.
    let first = args.load(&spec, numbers[0])?;
    frame_files(&files, numbers[0])?.writable(args.denoise)?;
    let load = || Reconstruction::load(args.weights.as_deref(), args.tiles.cut());
    let mut network = args.denoise.then(load).transpose()?;
    let gpu = args.device.open()?;
    if let Some(network) = &mut network {
        network.choose_kernels(&gpu, &args.kernels)?;
    }
    let mut work = Work::new(args, gpu, network, &stop);
    let mut frame = first;
    for (i, &number) in numbers.iter().enumerate() {
        if i > 0 {
            frame = args.load(&spec, number)?;
        }
        let finished = work.frame(&frame, &frame_files(&files, number)?)?;
        args.device.check(&work.gpu)?;
        let left = !finished || i + 1 < numbers.len();
        if let Some(signal) = stop.requested().filter(|_| left) {
            report(args, &work, &frame, Some(signal), start)?;
            return Ok(signal.exit_code());
        }
    }
    report(args, &work, &frame, None, start)?;
    Ok(0)
}

fn frame_files(files: &Files, number: Option<u32>) -> Result<Files> {
    number.map_or_else(|| Ok(files.clone()), |t| files.frame(t))
}

fn report(args: &Args, work: &Work, last: &Frame, signal: Option<Signal>, start: Instant) -> Result<()> {
    let totals = &work.totals;
    let wall_ms = start.elapsed().as_secs_f64() * 1e3;
    if !args.json {
        return work.summary(last, signal, wall_ms);
    }
    let s = &last.settings;
    let mut map = report::header("render", &work.gpu);
    let settings = json!({
        "width": last.scene.camera.width, "height": last.scene.camera.height, "spp": s.spp, "seed": args.seed,
        "bounces": s.bounces, "estimator": s.estimator.to_string(), "sampler": s.sampler.to_string(), "aa": s.aa,
        "variance": s.variance, "aovs": s.aovs, "roulette": s.roulette_from(), "until": args.until,
        "time_s": args.time.map(|time| time.as_secs_f64()), "denoise": args.denoise, "exposure_ev": args.exposure,
        "tile": args.tiles.tile, "overlap": args.tiles.overlap, "blend": args.tiles.blend, "max_memory_mib": args.tiles.max_memory,
        "weights": work.network.as_ref().map(Reconstruction::describe),
    });
    map.insert("scene".into(), json!(args.scene));
    map.insert("settings".into(), settings);
    let times = json!({
        "start": totals.first.map(|first| report::ms(first.saturating_duration_since(start).as_secs_f64() * 1e3)),
        "pipelines": report::ms(work.gpu.pipeline_ms()),
        "render_device": report::ms(totals.render_device_ms),
        "render_wall": report::ms(totals.render_wall_ms),
        "reconstruct_device": report::ms(totals.reconstruct_device_ms),
        "reconstruct_wall": report::ms(totals.reconstruct_wall_ms),
        "write": report::ms(totals.write_ms),
        "wall": report::ms(wall_ms),
    });
    map.insert("ms".into(), times);
    map.insert("rays".into(), json!(totals.rays));
    map.insert("rays_per_second".into(), json!(totals.rays_per_second()));
    map.insert("samples".into(), json!(totals.samples));
    map.insert("invalid_samples".into(), json!(totals.invalid));
    map.insert("repaired_pixels".into(), json!(work.network.as_ref().map(|_| totals.repaired)));
    map.insert("skipped".into(), json!(totals.skipped));
    map.insert("left_out".into(), json!(last.left_out));
    report::kernels(&mut map, work.network.as_ref().and_then(Reconstruction::kernels));
    map.insert("tiling".into(), json!(work.network.as_ref().and_then(Reconstruction::tiling)));
    map.insert("frames".into(), json!(totals.frames));
    map.insert("outputs".into(), json!(totals.outputs));
    map.insert("interrupted".into(), json!(signal.map(Signal::name)));
    report::print_json(&map.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes() {
        assert_eq!(parse_size("33x47"), Ok((33, 47)));
        for bad in
            ["", "33", "33x", "x47", "33X47", "-3x4", "+3x4", "3x4x5", "0x5", "5x0", "99999999999x1", "16384x16385"]
        {
            assert!(parse_size(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn goals() {
        assert_eq!(parse_time("10s"), Ok(Duration::from_secs(10)));
        assert_eq!(parse_time("500ms"), Ok(Duration::from_millis(500)));
        assert_eq!(parse_time("1.5m"), Ok(Duration::from_secs(90)));
        for bad in ["", "10", "s", "0s", "-1s", "nans", "infs", "1h", "1e300m"] {
            assert!(parse_time(bad).is_err(), "{bad}");
        }
        assert_eq!(parse_relmse("0.01"), Ok(0.01));
        for bad in ["", "0", "-1", "nan", "inf", "1%"] {
            assert!(parse_relmse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn frames() {
        assert_eq!(parse_frames("0..240"), Ok(0..240));
        assert_eq!(parse_frames("7..=7"), Ok(7..8));
        for bad in ["", "7", "..", "7..", "..7", "7..7", "8..7", "+1..3", "-1..3", "1..x", "0..=4294967295"] {
            assert!(parse_frames(bad).is_err(), "{bad}");
        }
    }
}
