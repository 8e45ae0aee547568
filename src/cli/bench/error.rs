//! `limpid bench error`: what every way to render makes of its time.

use crate::cli::device::DeviceArgs;
use crate::cli::progress::{Progress, line};
use crate::cli::render::parse_size;
use crate::cli::report;
use crate::cli::stop::{Signal, Stop};
use limpid::bench::error::{
    EQUAL_TIMES, ErrorBench, FLOOR_FACTOR, Key, Line, REFERENCE, REFERENCE_SEEDS, Run, Summary, Technique,
    reference_half, summarize, svg,
};
use limpid::denoise::{Preparation, embedded_weights, weights_of};
use limpid::gpu::Gpu;
use limpid::image::file::write_bytes;
use limpid::image::{Image, exr};
use limpid::metrics::reference_noise;
use limpid::net::weights::Weights;
use limpid::render::Settings;
use limpid::scene::{Scene, Spec, mitsuba};
use limpid::{Error, Result};
use serde_json::{Map, Value, json};
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Error over time: every estimator and sampler, as it is and reconstructed
///
/// Renders the scene with each number of samples and each of so many seeds, and compares with a reference in two halves
/// (nee+sobol). Prints the mean relMSE with its 95 % confidence interval, median times, rays a second, relMSE x seconds, by
/// what power of the samples relMSE falls, and relMSE after equal times. Times are device times after a warm-up, of a
/// reconstructed picture those of both parts. An error under ten times the reference's own noise is not told.
///
/// DIR keeps the reference, one JSON line a run (runs.jsonl), summary.json and the plot error.svg. The same command goes on where it was
/// stopped; more --runs or --spp add to what is there.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// `spheres`, `spheres:N`, `rooms:N` or a Mitsuba 3 XML or glTF file
    #[arg(default_value = "spheres")]
    scene: String,
    /// Folder of the results
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Image size
    #[arg(long, value_name = "WxH", value_parser = parse_size, default_value = "256x256")]
    size: (u32, u32),
    /// Numbers of samples a pixel
    #[arg(long, value_name = "N,...", value_delimiter = ',', default_value = "4,16,64,256,1024", value_parser = clap::value_parser!(u32).range(1..))]
    spp: Vec<u32>,
    /// Seeds of each
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    runs: u32,
    /// Only these, e.g. nee+sobol,cosine+pcg [default: all]
    #[arg(long, value_name = "ESTIMATOR+SAMPLER,...", value_delimiter = ',', value_parser = parse_technique)]
    only: Vec<Technique>,
    /// Samples a pixel of each half of the reference
    #[arg(long, value_name = "N", default_value_t = 8192, value_parser = clap::value_parser!(u32).range(1..))]
    reference_spp: u32,
    /// Give every sample its own camera ray; otherwise all share the ray through the pixel's centre
    #[arg(long)]
    aa: bool,
    /// Weights that reconstruct: `kpn`, `seed` or `base`, or a safetensors file [default: kpn]
    #[arg(long, value_name = "NAME|FILE")]
    weights: Option<PathBuf>,
    /// Reconstruct nothing
    #[arg(long, conflicts_with = "weights")]
    no_denoise: bool,
    #[command(flatten)]
    device: DeviceArgs,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

fn parse_technique(text: &str) -> std::result::Result<Technique, String> {
    let known = || Technique::all().map(|technique| technique.to_string()).collect::<Vec<_>>().join(", ");
    Technique::all().find(|technique| technique.to_string() == text).ok_or_else(|| format!("one of {}", known()))
}

/// What the folder holds.
struct Folder<'a>(&'a Path);

impl Folder<'_> {
    fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// Makes the folder, or sees that it holds results of the same settings.
    fn open(&self, settings: &Map<String, Value>) -> Result<()> {
        std::fs::create_dir_all(self.0).map_err(|e| Error::io(self.0, e))?;
        let path = self.file("settings.json");
        let Ok(text) = std::fs::read_to_string(&path) else {
            let text = format!("{:#}\n", Value::Object(settings.clone()));
            return write_bytes(&path, text.as_bytes());
        };
        let found: Value = serde_json::from_str(&text)
            .map_err(|e| Error::input(format!("{}: not JSON ({e}): choose another folder", path.display())))?;
        match settings.iter().find(|(key, value)| found.get(key) != Some(value)) {
            None => Ok(()),
            Some((key, value)) => Err(Error::input(format!(
                "{} holds results of other settings (`{key}` was {}, now {value}): choose another folder",
                self.0.display(),
                found.get(key).unwrap_or(&Value::Null)
            ))),
        }
    }

    /// The runs so far; a line that was cut off is dropped.
    fn runs(&self) -> Result<Vec<Run>> {
        let path = self.file("runs.jsonl");
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(e) => return Err(Error::io(path, e)),
        };
        let whole = text.rfind('\n').map_or("", |end| &text[..=end]);
        if whole.len() < text.len() {
            write_bytes(&path, whole.as_bytes())?;
        }
        let parse = |(i, line): (usize, &str)| {
            serde_json::from_str(line).map_err(|e| {
                Error::input(format!("{}, line {}: not a run ({e}): remove the line", path.display(), i + 1))
            })
        };
        whole.lines().enumerate().map(parse).collect()
    }

    fn appended(&self) -> Result<File> {
        let path = self.file("runs.jsonl");
        OpenOptions::new().append(true).create(true).open(&path).map_err(|e| Error::io(path, e))
    }

    /// Half `i` of the reference, rendered where it is not there; none where a signal came before its end.
    fn half(&self, i: usize, gpu: &Gpu, scene: &Scene, args: &Args, stop: &Stop) -> Result<Option<Image>> {
        let path = self.file(&format!("reference{}.exr", i + 1));
        if path.exists() {
            return exr::read(&path).map(Some);
        }
        let settings = Settings {
            spp: args.reference_spp,
            seed: REFERENCE_SEEDS[i],
            estimator: REFERENCE.estimator,
            sampler: REFERENCE.sampler,
            aa: args.aa,
            ..Settings::default()
        };
        let mut progress = Progress::new(&format!("reference {} of 2, {} spp", i + 1, args.reference_spp));
        let samples = f64::from(args.size.0) * f64::from(args.size.1) * f64::from(args.reference_spp);
        let half = reference_half(gpu, scene, &settings, |done| {
            progress.update(done, samples, "samples");
            stop.requested().is_none()
        })?;
        if let Some(half) = &half {
            exr::write(half, &path)?;
        }
        Ok(half)
    }
}

/// Runs the command.
pub fn run(args: &Args) -> Result<u8> {
    let spec: Spec = args.scene.parse()?;
    let scene = spec.load(&mitsuba::Options { size: Some(args.size), ..mitsuba::Options::default() })?.scene;
    let weights = match (&args.weights, args.no_denoise) {
        (_, true) => None,
        (Some(path), _) => Some(weights_of(path)?),
        (None, _) => Some(embedded_weights()?),
    };
    if let Some(weights) = &weights {
        let name = args.weights.as_deref().map_or_else(|| "seed".to_owned(), |path| path.display().to_string());
        Preparation::of_weights(weights, &name)?;
    }
    let stop = Stop::install()?;
    let gpu = args.device.open()?;
    let settings = settings(args, &scene, &gpu, weights.as_ref());
    let folder = Folder(&args.output);
    folder.open(&settings)?;
    let mut halves = Vec::new();
    for i in 0..2 {
        match folder.half(i, &gpu, &scene, args, &stop)? {
            Some(half) => halves.push(half),
            None => return Ok(stop.requested().map_or(0, Signal::exit_code)),
        }
    }
    let halves = <[Image; 2]>::try_from(halves).expect("two");
    let noise = reference_noise([&halves[0], &halves[1]])?.relmse;
    let render = Settings { aa: args.aa, ..Settings::default() };
    let mut bench = ErrorBench::new(&gpu, &scene, &render, halves, weights.as_ref())?;
    let runs = measure(args, &folder, &mut bench, &stop)?;
    args.device.check(&gpu)?;
    let summary = summarize(&runs, noise);
    let title = format!("{}, {}x{}, {}", args.scene, args.size.0, args.size.1, gpu.info().name);
    write_bytes(folder.file("error.svg"), svg(&summary, &title)?.as_bytes())?;
    let mut map = report::header("bench error", &gpu);
    map.insert("settings".into(), settings.into());
    map.insert("equal_time_seconds".into(), json!(EQUAL_TIMES));
    map.insert("summary".into(), json!(summary));
    let map = Value::from(map);
    write_bytes(folder.file("summary.json"), format!("{map:#}\n").as_bytes())?;
    if args.json {
        report::print_json(&map)?
    } else {
        print(&title, &summary)?
    }
    Ok(stop.requested().map_or(0, Signal::exit_code))
}

/// What a folder's results have in common.
fn settings(args: &Args, scene: &Scene, gpu: &Gpu, weights: Option<&Weights>) -> Map<String, Value> {
    let sha256 = weights.map(Weights::sha256);
    let settings = json!({
        "scene": args.scene, "scene_hash": scene.hash(), "width": args.size.0, "height": args.size.1, "aa": args.aa,
        "bounces": Settings::default().bounces, "reference_spp": args.reference_spp, "weights": sha256,
        "device": gpu.info().name, "driver": gpu.info().driver,
    });
    let Value::Object(settings) = settings else { unreachable!("an object") };
    settings
}

/// All runs of the folder, once those that are asked for are among them or a signal came.
fn measure(args: &Args, folder: &Folder, bench: &mut ErrorBench, stop: &Stop) -> Result<Vec<Run>> {
    let mut runs = folder.runs()?;
    let mut file = folder.appended()?;
    let techniques: Vec<Technique> = if args.only.is_empty() { Technique::all().collect() } else { args.only.clone() };
    let mut keys = Vec::new();
    for (technique, spp) in techniques.iter().flat_map(|technique| args.spp.iter().map(move |spp| (*technique, *spp))) {
        keys.extend((0..args.runs).map(|seed| Key { technique, spp, seed }));
    }
    keys.retain(|key| runs.iter().all(|run| run.key != *key));
    let total: f64 = keys.iter().map(|key| f64::from(key.spp)).sum();
    let mut progress = Progress::new(&format!("{} runs", keys.len()));
    let mut done = 0.0;
    for key in keys {
        if stop.requested().is_some() {
            line("stopped; the same command goes on");
            break;
        }
        let run = bench.run(key)?;
        let text = serde_json::to_string(&run).expect("plain data has a JSON form") + "\n";
        file.write_all(text.as_bytes()).map_err(|e| Error::io(folder.file("runs.jsonl"), e))?;
        runs.push(run);
        done += f64::from(key.spp);
        progress.update(done / total, total, "spp");
    }
    Ok(runs)
}

fn print(title: &str, summary: &Summary) -> Result<()> {
    report::print(&format!(
        "{title}; noise of the reference: relMSE {:.2e}, errors under {FLOOR_FACTOR} times that are not told",
        summary.reference_noise
    ))?;
    report::print(&format!(
        "{:26}{:>6}{:>6}{:>11}{:>10}{:>12}{:>12}{:>10}{:>12}",
        "", "spp", "runs", "relMSE", "+-95%", "device ms", "wall ms", "Mrays/s", "relMSE x s"
    ))?;
    let name = |line: &Line| format!("{}{}", line.technique, if line.reconstructed { " reconstructed" } else { "" });
    let number = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.3e}"));
    for line in &summary.lines {
        for p in &line.points {
            let interval = p.confidence.zip(p.relmse).map_or("-".to_owned(), |(c, e)| format!("{:.1}%", 100.0 * c / e));
            report::print(&format!(
                "{:26}{:6}{:6}{:>11}{:>10}{:12.1}{:12.1}{:10.1}{:>12}",
                name(line),
                p.spp,
                p.runs,
                number(p.relmse),
                interval,
                p.device_ms,
                p.wall_ms,
                p.rays_per_second * 1e-6,
                number(p.error_seconds)
            ))?;
        }
    }
    let times: String = EQUAL_TIMES.iter().map(|seconds| format!("{:>12}", format!("{seconds} s"))).collect();
    report::print(&format!("{:26}{:>8}{times}", "relMSE after equal times", "slope"))?;
    for line in &summary.lines {
        let slope = line.slope.map_or("-".to_owned(), |slope| format!("{slope:.2}"));
        let errors: String = line.equal_time.iter().map(|error| format!("{:>12}", number(*error))).collect();
        report::print(&format!("{:26}{slope:>8}{errors}", name(line)))?;
    }
    Ok(())
}
