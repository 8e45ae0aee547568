//! One frame of `limpid render`: trace, reconstruct, write; stop and go on where asked.

use super::files::Files;
use super::progress::{Progress, duration, line};
use super::reconstruct::{Reconstruction, repaired_line};
use super::render::Args;
use super::report;
use super::stop::{Signal, Stop};
use limpid::denoise::{Axes, Guides};
use limpid::gpu::Gpu;
use limpid::image::{Image, exr, file};
use limpid::render::{Features, Goal, Next, Pursuit, Reached, Renderer, Settings};
use limpid::scene::Scene;
use limpid::{Error, Result};
use serde_json::{Value, json};
use std::time::{Duration, Instant};

/// How often a long render saves its state; never more than a twentieth of the time goes into it.
const CHECKPOINT_INTERVAL: Duration = Duration::from_secs(60);
const CHECKPOINT_SHARE: u32 = 20;
/// Attribute of the relMSE that a render with `--until` was estimated to have.
const RELMSE_ESTIMATE: &str = "relmseEstimate";

/// What is to be rendered.
pub struct Frame {
    /// Frame of the animation, where there is one.
    pub number: Option<u32>,
    /// Version of the scene's random family; none for other scenes.
    pub family_version: Option<u32>,
    /// The scene.
    pub scene: Scene,
    /// How.
    pub settings: Settings,
    /// When it is done, beside the samples of the settings.
    pub goal: Goal,
    /// What of the scene file was left out.
    pub left_out: Vec<String>,
}

/// How tracing ended.
struct Traced {
    /// None where a signal came first.
    reached: Option<Reached>,
    /// The last estimate, where the goal asks for one.
    relmse: Option<f64>,
}

/// The last checkpoint of a render that goes on: when, and what it took.
struct Save {
    last: Instant,
    cost: Duration,
}

/// What all frames have cost together.
#[derive(Default)]
pub struct Totals {
    /// Closest-hit and shadow queries.
    pub rays: u64,
    /// Of these, those traced by this run: a checkpoint brings its own.
    pub rays_here: u64,
    /// Samples traced.
    pub samples: u64,
    /// Non-finite samples dropped.
    pub invalid: u64,
    /// Pixels that the reconstruction repaired.
    pub repaired: u64,
    /// Device time of the path tracer.
    pub render_device_ms: f64,
    /// The same by the clock, pipelines included.
    pub render_wall_ms: f64,
    /// Device time of the network.
    pub reconstruct_device_ms: f64,
    /// The same by the clock, pipelines and allocation included.
    pub reconstruct_wall_ms: f64,
    /// When the first frame was begun on the device.
    pub first: Option<Instant>,
    /// Encoding and writing files.
    pub write_ms: f64,
    /// What was left out, as of the last frame.
    pub skipped: Vec<String>,
    /// One object a frame.
    pub frames: Vec<Value>,
    /// Files written.
    pub outputs: Vec<String>,
}

impl Totals {
    /// By device time; 0 where nothing was traced.
    pub fn rays_per_second(&self) -> f64 {
        if self.render_device_ms > 0.0 { self.rays_here as f64 / (self.render_device_ms * 1e-3) } else { 0.0 }
    }
}

/// The device with what one frame leaves to the next.
pub struct Work<'a> {
    /// The device.
    pub gpu: Gpu,
    /// The network, with --denoise.
    pub network: Option<Reconstruction>,
    /// Costs so far.
    pub totals: Totals,
    args: &'a Args,
    stop: &'a Stop,
    renderer: Option<Renderer>,
}

impl<'a> Work<'a> {
    /// Nothing rendered so far.
    pub fn new(args: &'a Args, gpu: Gpu, network: Option<Reconstruction>, stop: &'a Stop) -> Self {
        Self { gpu, network, totals: Totals::default(), args, stop, renderer: None }
    }

    /// Renders and writes a frame; false where a signal ended it early.
    pub fn frame(&mut self, frame: &Frame, files: &Files) -> Result<bool> {
        files.writable(self.args.denoise)?;
        let resume = self.args.resume && files.checkpoint.exists();
        if self.args.resume && !resume && self.is_done(frame, files) {
            line(&format!("{} is finished: kept", files.exr.display()));
            self.totals.frames.push(json!({ "frame": frame.number, "kept": report::text(&files.exr) }));
            return Ok(true);
        }
        if let Some(network) = &mut self.network {
            // What does not fit shows before hours of rendering.
            network.choose(&self.gpu, (frame.scene.camera.width, frame.scene.camera.height), true)?;
        }
        let start = Instant::now();
        let label = self.label(frame);
        let mut progress = Progress::new(&label);
        let mut renderer = self.renderer(frame)?;
        if resume {
            renderer.restore(&files.checkpoint)?;
            progress.start_at(f64::from(renderer.samples_done()) / f64::from(frame.settings.spp));
        }
        let resumed = (renderer.samples_done(), renderer.stats()?.rays);
        self.totals.first.get_or_insert_with(Instant::now);
        let traced = self.trace(&mut renderer, frame.goal, files, &mut progress)?;
        let finished = traced.reached.is_some();
        drop(progress);
        if !finished {
            write_checkpoint(&renderer, files)?;
        }
        let mut image = renderer.image()?;
        self.describe(frame, &traced, &mut image);
        self.totals.render_wall_ms += start.elapsed().as_secs_f64() * 1e3;
        self.totals.skipped = renderer.stats()?.skipped;
        if finished {
            self.reconstruct(&mut renderer, &mut image)?;
        }
        let write = Instant::now();
        let outputs = files.write(&image, self.args.exposure)?;
        if finished && files.checkpoint.exists() {
            std::fs::remove_file(&files.checkpoint).map_err(|e| Error::io(&files.checkpoint, e))?;
        }
        self.totals.write_ms += write.elapsed().as_secs_f64() * 1e3;
        self.totals.outputs.extend(outputs.iter().map(|path| report::text(path)));
        if !finished {
            self.totals.outputs.push(report::text(&files.checkpoint));
        }
        self.count(&renderer, frame, &image, resumed, &traced)?;
        self.renderer = Some(renderer);
        Ok(finished)
    }

    fn label(&self, frame: &Frame) -> String {
        let (s, camera) = (&frame.settings, &frame.scene.camera);
        let number = frame.number.map_or(String::new(), |t| format!(" frame {t}"));
        format!(
            "render {}{number} {}x{}, {}, {}+{}",
            self.args.scene,
            camera.width,
            camera.height,
            self.args.goal_in_words(s.spp),
            s.estimator,
            s.sampler
        )
    }

    /// The last frame's renderer where it serves this one too.
    fn renderer(&mut self, frame: &Frame) -> Result<Renderer> {
        let size = (frame.scene.camera.width, frame.scene.camera.height);
        let features = Features::new(&frame.scene, &frame.settings);
        match self.renderer.take() {
            Some(mut renderer) if renderer.size() == size && *renderer.features() == features => {
                renderer.set_scene(&frame.scene)?;
                renderer.set_seed(frame.settings.seed);
                Ok(renderer)
            }
            _ => Renderer::new(&self.gpu, &frame.scene, &frame.settings),
        }
    }

    /// Traces until the goal is reached or a signal comes.
    fn trace(&self, renderer: &mut Renderer, goal: Goal, files: &Files, progress: &mut Progress) -> Result<Traced> {
        let (start, mut pursuit) = (Instant::now(), Pursuit::from(goal));
        let mut save = Save { last: Instant::now(), cost: Duration::ZERO };
        let (width, height) = renderer.size();
        let pixels = f64::from(width) * f64::from(height);
        let mut begun = false;
        loop {
            let samples = match pursuit.next(renderer, start.elapsed())? {
                Next::Done(reached) => return Ok(Traced { reached: Some(reached), relmse: pursuit.relmse }),
                Next::Samples(samples) => samples,
            };
            if let Some(relmse) = pursuit.relmse {
                progress.note(format!("{} spp, relMSE {relmse:.2e}, ", renderer.samples_done()));
            }
            let show = |fraction: f64| match pursuit.share(start.elapsed()) {
                // What is shown as done of the goal is so many samples.
                Some(share) => progress.update(share, pixels * f64::from(samples) * fraction / share, "samples"),
                None => progress.update(fraction, pixels * f64::from(samples), "samples"),
            };
            // Whatever comes, a run does some of it.
            if (begun && self.stop.requested().is_some())
                || !self.trace_to(renderer, samples, files, &mut save, show)?
            {
                return Ok(Traced { reached: None, relmse: pursuit.relmse });
            }
            begun = true;
        }
    }

    /// Traces to a number of samples; false where a signal came before.
    fn trace_to(
        &self,
        renderer: &mut Renderer,
        samples: u32,
        files: &Files,
        save: &mut Save,
        mut show: impl FnMut(f64),
    ) -> Result<bool> {
        loop {
            let step = renderer.advance_to(samples)?;
            if step.done() {
                return Ok(true);
            }
            show(step.fraction);
            if self.stop.requested().is_some() {
                return Ok(false);
            }
            if save.last.elapsed() >= CHECKPOINT_INTERVAL.max(CHECKPOINT_SHARE * save.cost) {
                let begin = Instant::now();
                write_checkpoint(renderer, files)?;
                *save = Save { last: Instant::now(), cost: begin.elapsed() };
            }
        }
    }

    /// What the renderer does not know.
    fn describe(&self, frame: &Frame, traced: &Traced, image: &mut Image) {
        let mut set = |name: &str, value: String| image.attributes.insert(name.to_owned(), value);
        if let Some(relmse) = traced.relmse {
            set(RELMSE_ESTIMATE, relmse.to_string());
        }
        set("scene", self.args.scene.clone());
        set("limpid", env!("CARGO_PKG_VERSION").to_owned());
        if let Some(version) = frame.family_version {
            set("familyVersion", version.to_string());
        }
        if let Some(t) = frame.number {
            set("frame", t.to_string());
        }
    }

    fn reconstruct(&mut self, renderer: &mut Renderer, image: &mut Image) -> Result<()> {
        let Some(network) = &mut self.network else { return Ok(()) };
        let start = Instant::now();
        let mut progress = Progress::new(&format!("reconstruct {}x{}", image.width, image.height));
        let pixels = image.pixel_count() as f64;
        let outputs = renderer.outputs()?;
        let guides = Guides::of(&outputs, network.inputs(), Axes::default());
        let resident = Some((&outputs.radiance, &guides));
        match network.run(&self.gpu, resident, image, |done| progress.update(done, pixels, "pixels"))? {
            Some(timings) => self.totals.reconstruct_device_ms += timings.device_ms,
            None => self.totals.skipped.push("the reconstruction: no pixel is noisy".into()),
        }
        self.totals.repaired += network.repaired();
        drop(progress);
        self.totals.reconstruct_wall_ms += start.elapsed().as_secs_f64() * 1e3;
        Ok(())
    }

    fn count(
        &mut self,
        renderer: &Renderer,
        frame: &Frame,
        image: &Image,
        resumed: (u32, u64),
        traced: &Traced,
    ) -> Result<()> {
        let stats = renderer.stats()?;
        let totals = &mut self.totals;
        totals.rays += stats.rays;
        totals.rays_here += stats.rays - resumed.1;
        totals.samples += stats.samples;
        totals.invalid += stats.invalid;
        totals.render_device_ms += stats.device_ms;
        totals.frames.push(json!({
            "frame": frame.number,
            "seed": frame.settings.seed,
            "scene_hash": image.attributes.get("sceneHash"),
            "spp_done": renderer.samples_done(),
            "spp_resumed": resumed.0,
            "reached": traced.reached.map(Reached::name),
            "relmse_estimate": traced.relmse,
            "render_device_ms": report::ms(stats.device_ms),
            "dispatches": stats.dispatches,
            "longest_dispatch_ms": report::ms(stats.longest_dispatch_ms),
            "rays": stats.rays,
        }));
        Ok(())
    }

    /// Whether the file on disk is what this render would make.
    fn is_done(&self, frame: &Frame, files: &Files) -> bool {
        let Ok(image) = exr::read(&files.exr) else { return false };
        let s = &frame.settings;
        let estimate = image.attributes.get(RELMSE_ESTIMATE).and_then(|text| text.parse::<f64>().ok());
        let enough = match frame.goal.relmse {
            Some(limit) => estimate.is_some_and(|estimate| estimate <= limit),
            None => image.attributes.get("spp") == Some(&s.spp.to_string()),
        };
        let wanted = [
            ("seed", s.seed.to_string()),
            ("bounces", s.bounces.to_string()),
            ("estimator", s.estimator.to_string()),
            ("sampler", s.sampler.to_string()),
            ("aa", s.aa.to_string()),
            ("sceneHash", frame.scene.hash()),
            ("device", self.gpu.info().name.clone()),
            ("driver", self.gpu.info().driver.clone()),
        ];
        let weights = self.network.as_ref().map(Reconstruction::sha256);
        enough
            && estimate.is_some() == s.halves
            && wanted.iter().all(|(name, value)| image.attributes.get(*name) == Some(value))
            && image.attributes.get("weights").map(String::as_str) == weights
            && image.has_rgb("variance") == (s.batch_size() > 0)
            && image.has_rgb("albedo") == s.aovs
            && image.attributes.get("roulette") == s.roulette_from().map(|from| from.to_string()).as_ref()
    }

    /// For people: what was done and how fast.
    pub fn summary(&self, last: &Frame, signal: Option<Signal>, wall_ms: f64) -> Result<()> {
        let totals = &self.totals;
        let seconds = totals.render_device_ms * 1e-3;
        if seconds > 0.0 {
            report::print(&format!(
                "{}: {seconds:.3} s on {}, {:.1} Mrays/s",
                self.label(last),
                self.gpu.info().name,
                totals.rays_per_second() * 1e-6
            ))?;
        }
        if totals.reconstruct_device_ms > 0.0 {
            report::print(&format!("reconstruct: {:.3} s", totals.reconstruct_device_ms * 1e-3))?;
        }
        if let Some(caution) = self.network.as_ref().and_then(Reconstruction::caution) {
            report::print(&caution)?;
        }
        if totals.invalid > 0 {
            report::print(&format!("{} samples were not finite and were dropped", totals.invalid))?;
        }
        if totals.repaired > 0 {
            report::print(&repaired_line(totals.repaired))?;
        }
        if !totals.outputs.is_empty() {
            report::print(&format!("wrote {} in {}", totals.outputs.join(", "), duration(wall_ms * 1e-3)))?;
        }
        if let Some(signal) = signal {
            line(&format!("ended by {}; the same command with --resume goes on", signal.name()));
        }
        Ok(())
    }
}

fn write_checkpoint(renderer: &Renderer, files: &Files) -> Result<()> {
    let bytes = renderer.checkpoint_bytes()?;
    file::write_atomically(&files.checkpoint, |out| {
        out.write_all(&bytes).map_err(|error| Error::io(&files.checkpoint, error))
    })
}
