//! Training data: members of the scene family, rendered on the device as training goes.
//!
//! A pool holds examples: a window of a frame with its reference and four noisy versions, two of each estimator. Which
//! example, crop and orientation a step uses follows from (seed, step), so that a run can be repeated and resumed.

use crate::denoise::{Axes, Crop, Frame, FrameStats, Guides, Inputs, Preparation, record_input};
use crate::gpu::{Buffer, Gpu, Recorder, Slice};
use crate::net::device::{DeviceTensor, groups};
use crate::net::tensor::hash;
use crate::render::{Estimator, FilmWindow, Renderer, Sampler, Settings};
use crate::scene::{Scene, family};
use crate::{Error, Result, push_block, shaders};
use serde::{Deserialize, Serialize};

push_block! {
    /// Push constants of `network_target.comp`.
    pub struct TargetPush for shaders::network_target {
        count: u32, width: i32, crop_width: i32, crop_height: i32, x0: i32, y0: i32, orientation: u32,
    }
}

/// What a training run sees.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DataSettings {
    /// Seed of scenes, noise, crops and orientations.
    pub seed: u64,
    /// Crops a step.
    pub batch: u32,
    /// Side of a crop, pixels; a multiple of the network's alignment.
    pub crop: u32,
    /// Side of an example, pixels.
    pub window: u32,
    /// Examples kept at a time.
    pub pool: u32,
    /// Examples before the first step.
    pub initial: u32,
    /// Steps between new examples.
    pub refresh: u32,
    /// Samples a pixel of the noisy versions.
    pub spp: u32,
    /// Samples a pixel of the reference (`nee`, `sobol`).
    pub reference_spp: u32,
}

impl Default for DataSettings {
    fn default() -> Self {
        Self {
            seed: 0,
            batch: 4,
            crop: 128,
            window: 256,
            pool: 64,
            initial: 16,
            refresh: 3,
            spp: 16,
            reference_spp: 128,
        }
    }
}

impl DataSettings {
    fn check(&self, alignment: u32) -> Result<()> {
        let positive =
            [self.batch, self.crop, self.window, self.pool, self.initial, self.refresh, self.spp, self.reference_spp];
        if positive.contains(&0) {
            return Err(Error::input(format!("a training setting is 0: {self:?}")));
        }
        if !self.crop.is_multiple_of(alignment) || self.crop > self.window {
            return Err(Error::input(format!(
                "crops of {} pixels: they must be multiples of {alignment} and at most the window's {}",
                self.crop, self.window
            )));
        }
        Ok(())
    }

    /// Examples made before step `step` (from 0) is taken.
    #[must_use]
    pub fn examples_at(&self, step: u64) -> u64 {
        u64::from(self.initial) + step / u64::from(self.refresh)
    }
}

/// Noisy versions of an example: estimator and sampler.
const NOISE: [(Estimator, Sampler); 4] = [
    (Estimator::Cosine, Sampler::Pcg),
    (Estimator::Nee, Sampler::Sobol),
    (Estimator::Cosine, Sampler::Pcg),
    (Estimator::Nee, Sampler::Sobol),
];
/// Whole pictures that an example is a window of are this many times as large as the window, in fourths.
const PICTURE_FOURTHS: [u32; 4] = [4, 8, 12, 12];
/// Side of the small picture that exposure and depth scale come from.
const OVERVIEW: u32 = 96;

/// Purposes of random numbers.
#[derive(Clone, Copy)]
enum Stream {
    Example = 1,
    Batch = 2,
}

/// Numbers for one purpose and index: `draw(i)` for i = 0, 1, ...
fn draws(seed: u64, stream: Stream, index: u64) -> impl Fn(u64) -> u64 {
    let key = hash(hash(seed, stream as u64), index);
    move |i| hash(key, i)
}

struct Example {
    noisy: [Slice; 4],
    reference: Slice,
    guides: Guides,
    stats: Slice,
}

/// The pool and the renderers that fill it.
pub struct Data {
    gpu: Gpu,
    settings: DataSettings,
    preparation: Preparation,
    examples: Vec<Example>,
    made: u64,
    noisy: [Option<Renderer>; 2],
    reference: Option<Renderer>,
    overview: Option<Renderer>,
    frame_stats: FrameStats,
    _pool: Buffer,
}

/// Renders `scene` with `settings`, with `slot`'s renderer where it fits.
fn render<'a>(
    gpu: &Gpu,
    slot: &'a mut Option<Renderer>,
    scene: &Scene,
    film: Option<FilmWindow>,
    settings: &Settings,
) -> Result<&'a mut Renderer> {
    let fits = match slot {
        Some(renderer) => renderer.set_scene_window(scene, film).is_ok(),
        None => false,
    };
    if !fits {
        let mut fresh = Renderer::new(gpu, scene, settings)?;
        fresh.set_scene_window(scene, film)?;
        *slot = Some(fresh);
    }
    let renderer = slot.as_mut().expect("made above");
    renderer.set_seed(settings.seed);
    renderer.finish()?;
    Ok(renderer)
}

impl Data {
    /// An empty pool for a network of this alignment, which reads frames prepared so.
    pub fn new(gpu: &Gpu, settings: &DataSettings, preparation: Preparation, alignment: u32) -> Result<Self> {
        settings.check(alignment)?;
        let frame = u64::from(settings.window) * u64::from(settings.window) * 16;
        let frame = frame.next_multiple_of(256);
        let guides = match preparation.inputs {
            Inputs::NormalScreenDepth => 1,
            Inputs::AlbedoNormal => 2,
        };
        let each = frame * (5 + guides) + 256;
        let pool = gpu.buffer("training pool", each * u64::from(settings.pool))?;
        let example = |i: u64| {
            let part = |k: u64| pool.slice(i * each + k * frame, frame);
            Example {
                noisy: std::array::from_fn(|k| part(k as u64)),
                reference: part(4),
                guides: match preparation.inputs {
                    Inputs::NormalScreenDepth => Guides::NormalScreenDepth { screen: part(5) },
                    Inputs::AlbedoNormal => {
                        Guides::AlbedoNormal { albedo: part(5), normal_world: part(6), axes: Axes::default() }
                    }
                },
                stats: pool.slice(i * each + (5 + guides) * frame, 16),
            }
        };
        Ok(Self {
            gpu: gpu.clone(),
            settings: settings.clone(),
            preparation,
            examples: (0..u64::from(settings.pool)).map(example).collect(),
            made: 0,
            noisy: [None, None],
            reference: None,
            overview: None,
            frame_stats: FrameStats::new(gpu, preparation.transfer, OVERVIEW, OVERVIEW)?,
            _pool: pool,
        })
    }

    /// The family members shown so far are these, by example: never one that is held out.
    #[must_use]
    pub fn scene_of(settings: &DataSettings, example: u64) -> u64 {
        let n = draws(settings.seed, Stream::Example, example)(0) % family::HELD_OUT.start();
        assert!(!family::is_held_out(n));
        n
    }

    /// Makes the examples that step `step` needs and that are not in the pool yet; calls `progress` after each.
    pub fn prepare(&mut self, step: u64, mut progress: impl FnMut(u64, u64)) -> Result<()> {
        let wanted = self.settings.examples_at(step);
        let first = self.made.max(wanted.saturating_sub(u64::from(self.settings.pool)));
        for index in first..wanted {
            self.make(index)?;
            progress(index + 1 - first, wanted - first);
        }
        self.made = wanted;
        Ok(())
    }

    fn make(&mut self, index: u64) -> Result<()> {
        let draw = draws(self.settings.seed, Stream::Example, index);
        let window = self.settings.window;
        let side = window * PICTURE_FOURTHS[(draw(1) % 4) as usize] / 4;
        let place = |i: u64| (draw(i) % u64::from(side - window + 1)) as u32;
        let film = FilmWindow { width: side, height: side, x: place(2), y: place(3) };
        let mut scene = family::spheres(Self::scene_of(&self.settings, index));
        let gpu = self.gpu.clone();
        let settings = |spp, estimator, sampler, seed: u64| Settings {
            spp,
            seed: seed as u32,
            estimator,
            sampler,
            ..Settings::default()
        };

        (scene.camera.width, scene.camera.height) = (OVERVIEW, OVERVIEW);
        let overview = settings(self.settings.spp, Estimator::Nee, Sampler::Sobol, draw(4));
        let outputs = render(&gpu, &mut self.overview, &scene, None, &overview)?.outputs()?;
        let axes = Axes::of(&scene.camera);
        let example = &mut self.examples[(index % u64::from(self.settings.pool)) as usize];
        example.guides.set_axes(axes);
        let mut rec = gpu.recorder();
        let guides = Guides::of(&outputs, self.preparation.inputs, axes);
        self.frame_stats.record(&mut rec, &outputs.radiance, &guides, &example.stats)?;
        rec.finish()?.run()?;

        (scene.camera.width, scene.camera.height) = (window, window);
        let copy = |pairs: &[(&Slice, &Slice)]| -> Result<()> {
            let mut rec = gpu.recorder();
            for (from, to) in pairs {
                rec.copy(&from.slice(0, to.bytes()), to);
            }
            rec.finish()?.run()?;
            Ok(())
        };
        for (k, (estimator, sampler)) in NOISE.into_iter().enumerate() {
            let noisy = settings(self.settings.spp, estimator, sampler, draw(5 + k as u64));
            let outputs = render(&gpu, &mut self.noisy[k % 2], &scene, Some(film), &noisy)?.outputs()?;
            let guides = Guides::of(&outputs, self.preparation.inputs, axes);
            let mut pairs = guides.planes().into_iter().zip(example.guides.planes()).collect::<Vec<_>>();
            pairs.push((&outputs.radiance, &example.noisy[k]));
            copy(&pairs)?;
        }
        let reference = settings(self.settings.reference_spp, Estimator::Nee, Sampler::Sobol, draw(9));
        let outputs = render(&gpu, &mut self.reference, &scene, Some(film), &reference)?.outputs()?;
        copy(&[(&outputs.radiance, &example.reference)])
    }

    /// Writes the inputs and targets of step `step` to the device tensors of a batch. [`Self::prepare`] comes before.
    pub fn load(&self, step: u64, input: &DeviceTensor, target: &DeviceTensor) -> Result<()> {
        let s = &self.settings;
        let draw = draws(s.seed, Stream::Batch, step);
        let ready = self.made.min(u64::from(s.pool));
        let mut rec = self.gpu.recorder();
        for i in 0..u64::from(s.batch) {
            let number = |k: u64, below: u64| draw(i * 8 + k) % below;
            let example = &self.examples[number(0, ready) as usize];
            let noisy = &example.noisy[number(1, 4) as usize];
            let place = |k| number(k, u64::from(s.window - s.crop + 1)) as u32;
            let crop =
                Crop { x: place(2), y: place(3), width: s.crop, height: s.crop, orientation: number(4, 8) as u32 };
            let part = |t: &DeviceTensor| {
                let bytes = t.shape.bytes() / u64::from(s.batch);
                t.slice.slice(i * bytes, bytes)
            };
            let (guides, stats) = (&example.guides, &example.stats);
            let frame = Frame { radiance: noisy, guides, stats, size: (s.window, s.window) };
            record_input(&self.gpu, &mut rec, self.preparation.transfer, &frame, crop, &part(input))?;
            self.record_target(&mut rec, example, crop, part(target))?;
        }
        rec.finish()?.run()?;
        Ok(())
    }

    fn record_target(&self, rec: &mut Recorder, example: &Example, crop: Crop, y: Slice) -> Result<()> {
        let transfer = self.preparation.transfer.id();
        let kernel = self.gpu.kernel::<shaders::network_target::Shader>(&shaders::network_target::Spec { transfer })?;
        let push = TargetPush {
            count: crop.width * crop.height,
            width: self.settings.window as i32,
            crop_width: crop.width as i32,
            crop_height: crop.height as i32,
            x0: crop.x as i32,
            y0: crop.y as i32,
            orientation: crop.orientation,
        };
        let bind =
            shaders::network_target::Bind { radiance: example.reference.clone(), stats: example.stats.clone(), y };
        rec.dispatch(&kernel, &bind, &push, groups(u64::from(push.count)));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_example_is_held_out_and_all_differ() {
        let settings = DataSettings::default();
        let scenes: Vec<u64> = (0..5000).map(|i| Data::scene_of(&settings, i)).collect();
        assert!(scenes.iter().all(|n| !family::is_held_out(*n)));
        let distinct: std::collections::HashSet<_> = scenes.iter().collect();
        assert!(distinct.len() > 4800, "{}", distinct.len());
    }
}
