//! Training data: members of the scene families, rendered on the device as training goes.
//!
//! A pool holds examples: a window of a frame with its reference and noisy versions. Which
//! example, crop and orientation a step uses follows from (seed, step), so that a run can be repeated and resumed.

mod settings;

pub use settings::{DataSettings, Part, Scenes};

use crate::denoise::{Axes, Crop, Frame, FrameStats, Guides, Inputs, Preparation, Transfer, record_input};
use crate::gpu::{Buffer, Gpu, Recorder, Slice};
use crate::net::device::{DeviceTensor, groups};
use crate::net::tensor::hash;
use crate::render::{Estimator, FilmWindow, Renderer, Sampler, Settings};
use crate::scene::{Scene, family, rooms};
use crate::{Result, push_block, shaders};

push_block! {
    /// Push constants of `network_target.comp`.
    pub struct TargetPush for shaders::network_target {
        count: u32, width: i32, crop_width: i32, crop_height: i32, x0: i32, y0: i32, orientation: u32,
    }
}

/// Noisy versions of an example.
const VERSIONS: usize = 2;
/// Whole pictures that an example is a window of are this many times as large as the window, in fourths.
const PICTURE_FOURTHS: [u32; 4] = [4, 8, 12, 12];
/// Side of the small picture that exposure and depth scale come from.
const OVERVIEW: u32 = 96;

/// Purposes of random numbers.
#[derive(Clone, Copy)]
enum Stream {
    Example = 1,
    Batch = 2,
    Size = 3,
}

/// Numbers for one purpose and index: `draw(i)` for i = 0, 1, ...
fn draws(seed: u64, stream: Stream, index: u64) -> impl Fn(u64) -> u64 {
    let key = hash(hash(seed, stream as u64), index);
    move |i| hash(key, i)
}

/// A noisy picture with what its camera rays hit.
struct Version {
    radiance: Slice,
    guides: Guides,
}

struct Example {
    noisy: [Version; VERSIONS],
    reference: Slice,
    stats: Slice,
}

/// The pool of examples.
pub struct Data {
    gpu: Gpu,
    settings: DataSettings,
    part: Part,
    preparation: Preparation,
    examples: Vec<Example>,
    made: u64,
    frame_stats: FrameStats,
    _pool: Buffer,
}

fn render(gpu: &Gpu, scene: &Scene, film: Option<FilmWindow>, settings: &Settings) -> Result<Renderer> {
    let mut renderer = Renderer::new(gpu, scene, settings)?;
    renderer.set_scene_window(scene, film)?;
    renderer.finish()?;
    Ok(renderer)
}

impl Data {
    /// An empty pool for a network of this alignment, which reads frames prepared so.
    pub fn new(
        gpu: &Gpu,
        settings: &DataSettings,
        preparation: Preparation,
        alignment: u32,
        part: Part,
    ) -> Result<Self> {
        settings.check(alignment)?;
        let frame = u64::from(settings.window) * u64::from(settings.window) * 16;
        let frame = frame.next_multiple_of(256);
        let guides = match preparation.inputs {
            Inputs::NormalScreenDepth => 1,
            Inputs::AlbedoNormal => 2,
        };
        let version = 1 + guides;
        let each = frame * (1 + VERSIONS as u64 * version) + 256;
        let pool = gpu.buffer("training pool", each * u64::from(settings.pool))?;
        let example = |i: u64| {
            let part = |k: u64| pool.slice(i * each + k * frame, frame);
            let noisy = |k: usize| {
                let first = 1 + k as u64 * version;
                Version {
                    radiance: part(first),
                    guides: match preparation.inputs {
                        Inputs::NormalScreenDepth => Guides::NormalScreenDepth { screen: part(first + 1) },
                        Inputs::AlbedoNormal => Guides::AlbedoNormal {
                            albedo: part(first + 1),
                            normal_world: part(first + 2),
                            axes: Axes::default(),
                        },
                    },
                }
            };
            Example {
                noisy: std::array::from_fn(noisy),
                reference: part(0),
                stats: pool.slice((i + 1) * each - 256, 16),
            }
        };
        Ok(Self {
            gpu: gpu.clone(),
            settings: settings.clone(),
            part,
            preparation,
            examples: (0..u64::from(settings.pool)).map(example).collect(),
            made: 0,
            frame_stats: FrameStats::new(gpu, preparation.transfer, OVERVIEW, OVERVIEW)?,
            _pool: pool,
        })
    }

    /// The number of the scene of an example: held out or not, as the part says.
    #[must_use]
    pub fn scene_of(settings: &DataSettings, part: Part, example: u64) -> u64 {
        let draw = draws(settings.seed, Stream::Example, example)(0);
        let (first, last) = (*family::HELD_OUT.start(), *family::HELD_OUT.end());
        let n = match part {
            Part::Training => draw % first,
            Part::HeldOut => first + draw % (last - first + 1),
        };
        assert_eq!(family::is_held_out(n), part == Part::HeldOut);
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
        let mixed = self.settings.scenes == Scenes::Mixed;
        let (rooms, aa) = (mixed && draw(10) % 2 == 1, mixed && draw(11) % 2 == 1);
        let window = self.settings.window;
        let side = window * PICTURE_FOURTHS[(draw(1) % 4) as usize] / 4;
        let place = |i: u64| (draw(i) % u64::from(side - window + 1)) as u32;
        let film = FilmWindow { width: side, height: side, x: place(2), y: place(3) };
        let n = Self::scene_of(&self.settings, self.part, index);
        let mut scene = if rooms { rooms::rooms(n) } else { family::spheres(n) };
        let gpu = self.gpu.clone();
        let settings = |spp, (estimator, sampler), seed: u64| Settings {
            spp,
            seed: seed as u32,
            estimator,
            sampler,
            aa,
            ..Settings::default()
        };
        let best = (Estimator::Nee, Sampler::Sobol);

        (scene.camera.width, scene.camera.height) = (OVERVIEW, OVERVIEW);
        let outputs = render(&gpu, &scene, None, &settings(self.settings.spp, best, draw(4)))?.outputs()?;
        let axes = Axes::of(&scene.camera);
        let inputs = self.preparation.inputs;
        let example = &mut self.examples[(index % u64::from(self.settings.pool)) as usize];
        let mut rec = gpu.recorder();
        self.frame_stats.record(&mut rec, &outputs.radiance, &Guides::of(&outputs, inputs, axes), &example.stats)?;
        rec.finish()?.run()?;

        (scene.camera.width, scene.camera.height) = (window, window);
        // Where lights may be small, paths rarely meet them: light sampling three times of four.
        let rare = rooms && !draw(12).is_multiple_of(4);
        let found = if rare { Estimator::Nee } else { Estimator::Cosine };
        for (k, technique) in [(found, Sampler::Pcg), best].into_iter().enumerate() {
            let (seed, spp) = (draw(5 + k as u64), 4 << (draw(13 + k as u64) % 5));
            let spp = if mixed { spp } else { self.settings.spp };
            let outputs = render(&gpu, &scene, Some(film), &settings(spp, technique, seed))?.outputs()?;
            let version = &mut example.noisy[k];
            version.guides.set_axes(axes);
            let from = Guides::of(&outputs, inputs, axes);
            let mut pairs = from.planes().into_iter().zip(version.guides.planes()).collect::<Vec<_>>();
            pairs.push((&outputs.radiance, &version.radiance));
            copy(&gpu, &pairs)?;
        }
        let reference = Settings { aovs: false, ..settings(self.settings.reference_spp, best, draw(9)) };
        let mut renderer = render(&gpu, &scene, Some(film), &reference)?;
        copy(&gpu, &[(&renderer.radiance()?, &example.reference)])
    }

    /// Writes the inputs and targets of step `step` to the device tensors of a batch, of the size that the step has.
    /// [`Self::prepare`] comes before.
    pub fn load(&self, step: u64, input: &DeviceTensor, target: &DeviceTensor) -> Result<()> {
        let s = &self.settings;
        let draw = draws(s.seed, Stream::Batch, step);
        let ready = self.made.min(u64::from(s.pool));
        let (batch, side) = (input.shape.n, input.shape.w);
        let mut rec = self.gpu.recorder();
        for i in 0..u64::from(batch) {
            let number = |k: u64, below: u64| draw(i * 8 + k) % below;
            let example = &self.examples[number(0, ready) as usize];
            let noisy = &example.noisy[number(1, VERSIONS as u64) as usize];
            let place = |k| number(k, u64::from(s.window - side + 1)) as u32;
            let crop = Crop { x: place(2), y: place(3), width: side, height: side, orientation: number(4, 8) as u32 };
            let part = |t: &DeviceTensor| {
                let bytes = t.shape.bytes() / u64::from(batch);
                t.slice.slice(i * bytes, bytes)
            };
            let size = (s.window, s.window);
            let frame = Frame { radiance: &noisy.radiance, guides: &noisy.guides, stats: &example.stats, size };
            record_input(&self.gpu, &mut rec, self.preparation.transfer, &frame, crop, &part(input))?;
            let reference = (&example.reference, &example.stats, s.window);
            record_target(&self.gpu, &mut rec, self.preparation.transfer, reference, crop, part(target))?;
        }
        rec.finish()?.run()?;
        Ok(())
    }
}

/// Records the target of one crop: what the network should give for `radiance`, the reference in rows of `width` pixels.
pub(super) fn record_target(
    gpu: &Gpu,
    rec: &mut Recorder,
    transfer: Transfer,
    (radiance, stats, width): (&Slice, &Slice, u32),
    crop: Crop,
    y: Slice,
) -> Result<()> {
    let spec = shaders::network_target::Spec { transfer: transfer.id() };
    let kernel = gpu.kernel::<shaders::network_target::Shader>(&spec)?;
    let push = TargetPush {
        count: crop.width * crop.height,
        width: width as i32,
        crop_width: crop.width as i32,
        crop_height: crop.height as i32,
        x0: crop.x as i32,
        y0: crop.y as i32,
        orientation: crop.orientation,
    };
    let bind = shaders::network_target::Bind { radiance: radiance.clone(), stats: stats.clone(), y };
    rec.dispatch(&kernel, &bind, &push, groups(u64::from(push.count)));
    Ok(())
}

fn copy(gpu: &Gpu, pairs: &[(&Slice, &Slice)]) -> Result<()> {
    let mut rec = gpu.recorder();
    for (from, to) in pairs {
        rec.copy(&from.slice(0, to.bytes()), to);
    }
    rec.finish()?.run()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_of_the_parts_are_apart_and_differ() {
        let settings = DataSettings::default();
        for (part, least) in [(Part::Training, 4800), (Part::HeldOut, 3800)] {
            let scenes: Vec<u64> = (0..5000).map(|i| Data::scene_of(&settings, part, i)).collect();
            assert!(scenes.iter().all(|n| family::is_held_out(*n) == (part == Part::HeldOut)));
            let distinct: std::collections::HashSet<_> = scenes.iter().collect();
            assert!(distinct.len() > least, "{part:?}: {}", distinct.len());
        }
    }
}
