//! Runs the kernels in dispatches that respect the device's limits of time and of loops.

use super::features::Features;
use super::pack::{FIRST_RADIANCE, FilmWindow, pack};
use super::probe::{WANTED, loop_limit};
use super::settings::Settings;
use super::state::{Cursor, State};
use crate::gpu::{Buffer, Gpu, Kernel};
use crate::scene::Scene;
use crate::{Error, Result, shaders};

crate::push_block! {
    /// Push constants of `path_trace`.
    pub struct TracePush for crate::shaders::path_trace {
        width: u32, height: u32, window_row: u32, row_begin: u32, row_end: u32,
        sample_begin: u32, sample_end: u32, seed: u32, batch_size: u32, write_aov: u32, loop_rounds: u32
    }
}
crate::push_block! {
    /// Push constants of `resolve`.
    pub struct ResolvePush for crate::shaders::resolve {
        pixel_begin: u32, pixel_end: u32, sample_count: u32, batch_count: u32, width: u32, halo: u32, counts_rows: u32
    }
}

/// Samples of one dispatch at most; more gain nothing.
const MAX_CHUNK: u32 = 64;
/// Pixels of a work group: lavapipe fills its vectors, of up to 16 lanes, along x alone.
const GROUP_COLUMNS: u32 = 16;
const GROUP_ROWS: u32 = 4;
/// A dispatch has a multiple of so many rows.
const BAND: u32 = 8;
/// A dispatch should take about this long, well under the watchdogs of desktop drivers.
const TARGET_SECONDS: f64 = 0.25;

/// How far a render is after one more dispatch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Samples that every pixel has.
    pub samples_done: u32,
    /// Share of all the work that is done, 0 to 1.
    pub fraction: f64,
    /// Device time of this dispatch.
    pub device_ms: f64,
}

impl Progress {
    /// Nothing is left to do.
    pub fn done(&self) -> bool {
        self.fraction >= 1.0
    }
}

/// What a render has cost so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stats {
    /// Closest-hit and shadow queries traced, counted on the device.
    pub rays: u64,
    /// Samples traced (a pixel found exact takes none where the first hit is shared).
    pub samples: u64,
    /// Samples dropped because they were not finite or negative.
    pub invalid: u64,
    /// Device time of all dispatches since the last restart.
    pub device_ms: f64,
    /// Creation of this renderer's pipelines.
    pub pipeline_ms: f64,
    /// The longest dispatch.
    pub longest_dispatch_ms: f64,
    /// Dispatches of the path tracer.
    pub dispatches: u32,
    /// What the pipelines do without.
    pub skipped: Vec<String>,
}

/// Pipelines and buffers for one size and one set of [`Features`]; any scene with the same can be set.
pub struct Renderer {
    pub(super) gpu: Gpu,
    pub(super) features: Features,
    pub(super) settings: Settings,
    pub(super) state: State,
    pub(super) cursor: Cursor,
    pub(super) rows: Vec<[f32; 4]>,
    pub(super) scene_hash: String,
    scene: Buffer,
    trace: Kernel<shaders::path_trace::Shader>,
    resolve: Kernel<shaders::resolve::Shader>,
    max_chunk: u32,
    clear_first: bool,
    pub(super) resolved: bool,
    /// Pixel samples a second, measured as the render goes.
    rate: f64,
    stats: Stats,
}

impl Renderer {
    /// Checks the scene, creates pipelines and buffers, uploads.
    pub fn new(gpu: &Gpu, scene: &Scene, settings: &Settings) -> Result<Self> {
        Self::with_features(gpu, scene, settings, Features::new(scene, settings))
    }

    /// The same with pipelines for `features`: those of the scene, or more ([`Features::with`]).
    pub fn with_features(gpu: &Gpu, scene: &Scene, settings: &Settings, features: Features) -> Result<Self> {
        settings.check(scene)?;
        let rows = pack(scene, None)?;
        let before = gpu.pipeline_ms();
        let rounds = loop_limit(gpu)?;
        let trace = gpu.kernel::<shaders::path_trace::Shader>(&features.path_trace_spec(rounds < WANTED))?;
        let spec = shaders::resolve::Spec { antialias: features.aa, variance: features.variance, aovs: features.aovs };
        let resolve = gpu.kernel::<shaders::resolve::Shader>(&spec)?;
        let limit = rounds / 2;
        let pipeline_ms = gpu.pipeline_ms() - before;
        let per_path = features.iterations_per_path();
        if per_path > limit {
            return Err(Error::input(format!(
                "{} bounces in a scene of {} shapes need {per_path} loop iterations a path, and {} allows {limit}: lower the bounces",
                features.bounces,
                features.sphere_count + features.rect_count,
                gpu.info().name
            )));
        }
        let buffer = gpu.buffer("scene", std::mem::size_of_val(rows.as_slice()) as u64)?;
        gpu.upload(&buffer.all(), &rows)?;
        Ok(Self {
            state: State::new(gpu, scene.camera.width, scene.camera.height, &features)?,
            gpu: gpu.clone(),
            settings: settings.clone(),
            cursor: Cursor::default(),
            rows,
            scene_hash: scene.hash(),
            scene: buffer,
            trace,
            resolve,
            max_chunk: (limit / per_path).clamp(1, MAX_CHUNK),
            clear_first: true,
            resolved: false,
            rate: if gpu.info().is_cpu { 4e6 } else { 1e8 } / if features.mesh_steps > 0 { 32.0 } else { 1.0 },
            stats: Stats { pipeline_ms, skipped: features.skipped(), ..Stats::default() },
            features,
        })
    }

    /// Sets another scene of the same size and features and starts over; only uploads.
    pub fn set_scene(&mut self, scene: &Scene) -> Result<()> {
        self.set_scene_window(scene, None)
    }

    /// The same, showing a part of a larger picture.
    pub fn set_scene_window(&mut self, scene: &Scene, window: Option<FilmWindow>) -> Result<()> {
        self.settings.check(scene)?;
        let rows = pack(scene, window)?;
        let features = Features::new(scene, &self.settings);
        if features != self.features
            || (scene.camera.width, scene.camera.height) != (self.state.width, self.state.height)
        {
            return Err(Error::input(
                "this scene differs from the renderer's in size or features: make a new renderer",
            ));
        }
        if rows.len() != self.rows.len() {
            // Trees of as many triangles may differ in size.
            self.scene = self.gpu.buffer("scene", std::mem::size_of_val(rows.as_slice()) as u64)?;
        }
        self.gpu.upload(&self.scene.all(), &rows)?;
        self.rows = rows;
        self.scene_hash = scene.hash();
        self.restart();
        Ok(())
    }

    /// Sets the seed and starts over.
    pub fn set_seed(&mut self, seed: u32) {
        self.settings.seed = seed;
        self.restart();
    }

    /// Starts over: no samples, zero device time.
    pub fn restart(&mut self) {
        self.cursor = Cursor::default();
        self.clear_first = true;
        self.resolved = false;
        self.stats.device_ms = 0.0;
        self.stats.dispatches = 0;
        self.stats.longest_dispatch_ms = 0.0;
    }

    /// At most this many samples in one dispatch (1 to 64). No choice changes a bit of the image.
    pub fn limit_chunk(&mut self, samples: u32) {
        self.max_chunk = self.max_chunk.min(samples.max(1));
    }

    /// Makes the red of the first shape's radiance what no scene may have, to see what becomes of it.
    pub(crate) fn spoil_light(&mut self, value: f32) -> Result<()> {
        let mut rows = self.rows.clone();
        rows[FIRST_RADIANCE][0] = value;
        self.gpu.upload(&self.scene.slice(0, std::mem::size_of_val(rows.as_slice()) as u64), &rows)
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// What the pipelines were specialised for.
    pub fn features(&self) -> &Features {
        &self.features
    }

    /// Width and height in pixels.
    pub fn size(&self) -> (u32, u32) {
        (self.state.width, self.state.height)
    }

    /// Samples that every pixel has.
    pub fn samples_done(&self) -> u32 {
        self.cursor.begin
    }

    /// One dispatch: a band of rows, a range of samples. Does nothing when all is done.
    pub fn advance(&mut self) -> Result<Progress> {
        self.advance_to(self.settings.spp)
    }

    /// The same where every pixel is to have `samples` samples, at most those of the settings. What a dispatch has begun,
    /// the next ones finish in all rows, beyond `samples` if need be.
    pub fn advance_to(&mut self, samples: u32) -> Result<Progress> {
        let goal = samples.min(self.settings.spp).max(self.cursor.end);
        if self.cursor.begin >= goal {
            return Ok(self.progress(0.0, goal));
        }
        let (height, width) = (self.state.height, self.state.width);
        let affordable = (self.rate * TARGET_SECONDS).max(1.0);
        if self.cursor.row == 0 {
            let chunk = (affordable / f64::from(width * BAND.min(height))) as u32;
            let chunk = chunk.clamp(1, self.max_chunk).min(goal - self.cursor.begin);
            self.cursor.end = self.cursor.begin + chunk;
        }
        let samples = self.cursor.end - self.cursor.begin;
        let rows = (affordable / (f64::from(width) * f64::from(samples))).min(f64::from(height)) as u32;
        let rows = (rows / BAND * BAND).max(BAND);
        let window = self.cursor.row / self.state.window_rows * self.state.window_rows;
        let row_end = (self.cursor.row + rows).min(window + self.state.window_rows).min(height);
        let ms = self.dispatch(window, self.cursor.row..row_end, self.cursor.begin..self.cursor.end)?;
        let paths = f64::from(row_end - self.cursor.row) * f64::from(width) * f64::from(samples);
        // Slower counts at once, faster by half: a band of sky or of exact pixels says little about the next.
        self.rate = (paths / (ms * 1e-3).max(1e-6)).min(1.5 * self.rate);
        self.stats.dispatches += 1;
        self.stats.longest_dispatch_ms = self.stats.longest_dispatch_ms.max(ms);
        self.cursor.row = row_end;
        if row_end == height {
            self.cursor = Cursor { begin: self.cursor.end, end: self.cursor.end, row: 0 };
        }
        self.resolved = false;
        Ok(self.progress(ms, goal))
    }

    fn dispatch(&mut self, window: u32, rows: std::ops::Range<u32>, samples: std::ops::Range<u32>) -> Result<f64> {
        let push = TracePush {
            width: self.state.width,
            height: self.state.height,
            window_row: window,
            row_begin: rows.start,
            row_end: rows.end,
            sample_begin: samples.start,
            sample_end: samples.end,
            seed: self.settings.seed,
            batch_size: self.settings.batch_size(),
            write_aov: u32::from(samples.start == 0),
            loop_rounds: 2,
        };
        let mut total_ms = 0.0;
        // Every run gives each pixel another sample at least.
        for _ in 0..=MAX_CHUNK {
            let mut rec = self.gpu.recorder();
            if self.clear_first {
                self.state.record_clear(&mut rec);
            }
            self.state.unfinished.iter().for_each(|buffer| rec.fill_zero(&buffer.all()));
            let groups = [push.width.div_ceil(GROUP_COLUMNS), (rows.end - rows.start).div_ceil(GROUP_ROWS), 1];
            rec.dispatch(&self.trace, &self.state.path_trace_bind(&self.scene, window), &push, groups);
            let ms = rec.finish()?.run()?.device_ms;
            self.clear_first = false;
            self.stats.device_ms += ms;
            total_ms += ms;
            if !self.unfinished()? {
                return Ok(total_ms);
            }
            self.max_chunk = (self.max_chunk / 2).max(1);
        }
        Err(Error::Gpu(format!("{} ends the path tracer's loops before one path is traced", self.gpu.info().name)))
    }

    /// Did the driver cut loops short, so that pixels lack samples?
    fn unfinished(&self) -> Result<bool> {
        let Some(buffer) = &self.state.unfinished else { return Ok(false) };
        Ok(self.gpu.download::<u32>(&buffer.slice(0, 4))?[0] != 0)
    }

    fn progress(&self, device_ms: f64, goal: u32) -> Progress {
        let Cursor { begin, end, row } = self.cursor;
        let partial = f64::from(end - begin) * f64::from(row) / f64::from(self.state.height);
        Progress { samples_done: begin, fraction: (f64::from(begin) + partial) / f64::from(goal), device_ms }
    }

    /// Runs to the last sample.
    pub fn finish(&mut self) -> Result<()> {
        while !self.advance()?.done() {}
        Ok(())
    }

    /// Brings the first hits back after their buffers were lost (a restored checkpoint has only sums).
    pub(super) fn restore_first_hits(&mut self) -> Result<()> {
        self.clear_first = false;
        self.resolved = false;
        if self.features.aa {
            return Ok(());
        }
        for window in (0..self.state.height).step_by(self.state.window_rows as usize) {
            let end = (window + self.state.window_rows).min(self.state.height);
            self.dispatch(window, window..end, 0..0)?;
        }
        Ok(())
    }

    /// Turns the sums into means, where that has not been done since the last dispatch.
    pub(super) fn resolve(&mut self) -> Result<()> {
        if self.resolved {
            return Ok(());
        }
        let mut rec = self.gpu.recorder();
        if self.clear_first {
            self.state.record_clear(&mut rec);
            self.clear_first = false;
        }
        let Cursor { begin, end, row } = self.cursor;
        for window in (0..self.state.height).step_by(self.state.window_rows as usize) {
            let last = (window + self.state.window_rows).min(self.state.height);
            let bind = self.state.resolve_bind(window);
            let halo = self.state.halo(window);
            let cut = row.clamp(window, last);
            for (rows, sample_count) in [(window..cut, end), (cut..last, begin)] {
                if rows.is_empty() {
                    continue;
                }
                let batch_count = sample_count.checked_div(self.settings.batch_size()).unwrap_or(0);
                let push = ResolvePush {
                    pixel_begin: (rows.start - window) * self.state.width,
                    pixel_end: (rows.end - window) * self.state.width,
                    sample_count,
                    batch_count,
                    width: self.state.width,
                    halo: (window - halo.start) * self.state.width,
                    counts_rows: halo.end - halo.start,
                };
                let groups = (push.pixel_end - push.pixel_begin).div_ceil(256);
                rec.dispatch(&self.resolve, &bind, &push, [groups, 1, 1]);
            }
        }
        self.stats.device_ms += rec.finish()?.run()?.device_ms;
        self.resolved = true;
        Ok(())
    }

    /// What the render has cost; sums the device's counters.
    pub fn stats(&self) -> Result<Stats> {
        let mut stats = self.stats.clone();
        if !self.clear_first {
            for c in self.gpu.download::<[u32; 4]>(&self.state.plane(&self.state.counts))? {
                stats.rays += u64::from(c[0]);
                stats.samples += u64::from(c[1]);
                stats.invalid += u64::from(c[2]);
            }
        }
        Ok(stats)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::DeviceOptions;
    use crate::render::Sampler;
    use crate::scene::family;

    fn gpu() -> Gpu {
        Gpu::new(&DeviceOptions { validation: true, ..DeviceOptions::default() }).expect("a Vulkan device")
    }

    fn scene() -> Scene {
        let mut scene = family::canonical();
        (scene.camera.width, scene.camera.height) = (37, 61);
        scene
    }

    /// Where a driver ends a run's loops early the pixels go on in further runs: the same bits as one sample at a time.
    #[test]
    fn loops_that_are_cut_short_change_no_bit() {
        let gpu = gpu();
        let mut scene = scene();
        (scene.camera.width, scene.camera.height) = (13, 11);
        let mesh = std::sync::Arc::new(crate::scene::tessellate::icosphere(4));
        scene.shapes[6].geometry = crate::scene::Geometry::Mesh(mesh);
        for aa in [false, true] {
            let settings = Settings { spp: 512, aa, ..Settings::default() };
            let mut single = Renderer::new(&gpu, &scene, &settings).expect("renderer");
            let mut cut = Renderer::new(&gpu, &scene, &settings).expect("renderer");
            single.limit_chunk(4);
            (cut.max_chunk, cut.rate) = (512, 1e9);
            single.finish().expect("render");
            cut.finish().expect("render");
            // A device without such a limit does it in one run.
            assert_eq!(cut.max_chunk < 512, loop_limit(&gpu).expect("probe") < 100_000, "{}", cut.max_chunk);
            assert_eq!(single.image().expect("image"), cut.image().expect("image"), "aa {aa}");
            let (a, b) = (single.stats().expect("stats"), cut.stats().expect("stats"));
            assert_eq!((a.samples, a.invalid), (b.samples, b.invalid));
        }
        assert_eq!(gpu.drain_validation(), Vec::<String>::new());
    }

    /// Images larger than a device's storage range are cut into windows of rows: the same bits.
    #[test]
    fn windows_change_no_bit() {
        let gpu = gpu();
        for aa in [false, true] {
            let settings = Settings { spp: 20, aa, variance: true, sampler: Sampler::Pcg, ..Settings::default() };
            let mut whole = Renderer::new(&gpu, &scene(), &settings).expect("renderer");
            let mut cut = Renderer::new(&gpu, &scene(), &settings).expect("renderer");
            assert_eq!(whole.state.window_rows, 61);
            // 16 rows of 37 pixels are 9,472 bytes, a multiple of 256.
            cut.state.window_rows = 16;
            whole.finish().expect("render");
            cut.finish().expect("render");
            assert!(cut.stats.dispatches >= 4);
            assert_eq!(whole.image().expect("image"), cut.image().expect("image"));
            // With which pixels are exact.
            let [whole, cut] = [&mut whole, &mut cut].map(|renderer| renderer.radiance().expect("radiance"));
            let pixels = |slice| gpu.download::<[f32; 4]>(slice).expect("download");
            assert_eq!(pixels(&whole), pixels(&cut));
            assert_eq!(pixels(&whole).iter().any(|pixel| pixel[3] == 0.5), aa);
        }
        assert_eq!(gpu.drain_validation(), Vec::<String>::new());
    }
}
