//! Error over time: what every estimator and sampler makes of its samples, as it is and reconstructed, against a reference in
//! two halves.

mod plot;
mod summary;

pub use plot::svg;
pub use summary::{EQUAL_TIMES, FLOOR_FACTOR, Line, Point, Summary, summarize};

use crate::denoise::{Axes, Denoiser, Guides};
use crate::gpu::Gpu;
use crate::image::Image;
use crate::metrics::relmse;
use crate::net::weights::Weights;
use crate::render::{Estimator, Renderer, Sampler, Settings};
use crate::scene::Scene;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// A way to render.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Technique {
    /// How light is found.
    pub estimator: Estimator,
    /// Where the random numbers come from.
    pub sampler: Sampler,
}

impl Technique {
    /// All of them.
    pub fn all() -> impl Iterator<Item = Self> {
        Estimator::ALL.into_iter().flat_map(|estimator| Sampler::ALL.map(|sampler| Self { estimator, sampler }))
    }
}

impl std::fmt::Display for Technique {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}+{}", self.estimator, self.sampler)
    }
}

/// The technique of references.
pub const REFERENCE: Technique = Technique { estimator: Estimator::Nee, sampler: Sampler::Sobol };
/// Seeds of the two halves of a reference; runs have their numbers, from 0.
pub const REFERENCE_SEEDS: [u32; 2] = [u32::MAX, u32::MAX - 1];

/// Which run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Key {
    /// The technique.
    #[serde(flatten)]
    pub technique: Technique,
    /// Samples a pixel.
    pub spp: u32,
    /// Seed of all random numbers.
    pub seed: u32,
}

/// What a picture erred and cost.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// Mean product of the relative differences to the two halves of the reference.
    pub relmse: f64,
    /// Device time, milliseconds; of the reconstructed picture both parts.
    pub device_ms: f64,
    /// Time by the clock, milliseconds.
    pub wall_ms: f64,
}

/// A run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// Which.
    #[serde(flatten)]
    pub key: Key,
    /// Closest-hit and shadow queries traced.
    pub rays: u64,
    /// The picture as it is.
    pub noisy: Outcome,
    /// The same reconstructed.
    pub reconstructed: Option<Outcome>,
}

/// The device with what runs share.
pub struct ErrorBench {
    gpu: Gpu,
    scene: Scene,
    aa: bool,
    bounces: u32,
    halves: [Image; 2],
    denoiser: Option<Denoiser>,
    renderer: Option<(Technique, u32, Renderer)>,
}

/// Renders half a reference; `go_on` is told the share done and may end it: then there is none.
pub fn reference_half(
    gpu: &Gpu,
    scene: &Scene,
    settings: &Settings,
    mut go_on: impl FnMut(f64) -> bool,
) -> Result<Option<Image>> {
    let mut renderer = Renderer::new(gpu, scene, settings)?;
    loop {
        let progress = renderer.advance()?;
        if progress.done() {
            return renderer.image().map(Some);
        }
        if !go_on(progress.fraction) {
            return Ok(None);
        }
    }
}

impl ErrorBench {
    /// Pictures of `scene` against `halves`; with weights they are reconstructed too.
    pub fn new(
        gpu: &Gpu,
        scene: &Scene,
        settings: &Settings,
        halves: [Image; 2],
        weights: Option<&Weights>,
    ) -> Result<Self> {
        let size = (scene.camera.width, scene.camera.height);
        if let Some(half) = halves.iter().find(|half| (half.width, half.height) != size) {
            return Err(Error::input(format!(
                "the reference has {}x{} pixels, the scene {}x{}",
                half.width, half.height, size.0, size.1
            )));
        }
        let denoiser = weights.map(|weights| Denoiser::new(gpu, weights, size.0, size.1)).transpose()?;
        Ok(Self {
            gpu: gpu.clone(),
            scene: scene.clone(),
            aa: settings.aa,
            bounces: settings.bounces,
            halves,
            denoiser,
            renderer: None,
        })
    }

    /// Takes a run. The first of a technique and number of samples is preceded by one that is not counted: the driver compiles
    /// in a pipeline's first dispatch.
    pub fn run(&mut self, key: Key) -> Result<Run> {
        let mut renderer = self.renderer(key)?;
        renderer.set_seed(key.seed);
        let start = Instant::now();
        renderer.finish()?;
        let radiance = renderer.radiance()?;
        let wall_ms = start.elapsed().as_secs_f64() * 1e3;
        let stats = renderer.stats()?;
        let rgb = |planes: [&[f32]; 3]| -> Result<f64> {
            Ok(relmse(planes, [self.halves[0].rgb("")?, self.halves[1].rgb("")?]))
        };
        let image = renderer.image()?;
        let noisy = Outcome { relmse: rgb(image.rgb("")?)?, device_ms: stats.device_ms, wall_ms };
        let mut reconstructed = None;
        if let Some(denoiser) = &self.denoiser {
            let guides = Guides::of(&renderer.outputs()?, denoiser.preparation().inputs, Axes::default());
            let start = Instant::now();
            let (planes, timings) = denoiser.run(&radiance, &guides)?;
            let wall_ms = wall_ms + start.elapsed().as_secs_f64() * 1e3;
            let [r, g, b] = &planes;
            let device_ms = stats.device_ms + timings.device_ms;
            reconstructed = Some(Outcome { relmse: rgb([r, g, b])?, device_ms, wall_ms });
        }
        self.renderer = Some((key.technique, key.spp, renderer));
        Ok(Run { key, rays: stats.rays, noisy, reconstructed })
    }

    /// The last run's renderer where it serves this one too.
    fn renderer(&mut self, key: Key) -> Result<Renderer> {
        if let Some((technique, spp, renderer)) = self.renderer.take()
            && (technique, spp) == (key.technique, key.spp)
        {
            return Ok(renderer);
        }
        let Technique { estimator, sampler } = key.technique;
        let settings = |spp| Settings {
            spp,
            estimator,
            sampler,
            aa: self.aa,
            bounces: self.bounces,
            seed: key.seed,
            // Only the network reads them.
            aovs: self.denoiser.is_some(),
            ..Settings::default()
        };
        let mut warm_up = Renderer::new(&self.gpu, &self.scene, &settings(1))?;
        warm_up.finish()?;
        warm_up.radiance()?;
        if let Some(denoiser) = &self.denoiser {
            let outputs = warm_up.outputs()?;
            let guides = Guides::of(&outputs, denoiser.preparation().inputs, Axes::default());
            denoiser.run(&outputs.radiance, &guides)?;
        }
        Renderer::new(&self.gpu, &self.scene, &settings(key.spp))
    }
}
