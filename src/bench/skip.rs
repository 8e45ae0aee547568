//! What skipping gains: the path tracer's pipelines for a scene beside pipelines that do more than it needs.

use super::Times;
use crate::Result;
use crate::gpu::Gpu;
use crate::image::Image;
use crate::metrics::different_values;
use crate::render::{Features, Renderer, Settings, Skip};
use crate::scene::Scene;
use serde::Serialize;

/// Pipelines that do more than the scene needs.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// What they do not skip: a name of [`Skip`], or `generic` for all of them.
    pub kept: String,
    /// Device milliseconds of a render.
    pub ms: Times,
    /// Their median relative to that of the scene's own pipelines.
    pub ratio: f64,
    /// Rays a second, by the median.
    pub rays_per_second: f64,
    /// The picture is the same, bit for bit.
    pub same_bits: bool,
}

/// All of them beside the scene's own.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Device milliseconds of a render by the scene's own pipelines.
    pub ms: Times,
    /// Rays a second, by the median.
    pub rays_per_second: f64,
    /// Share of the pixels that are exact and cost one ray.
    pub exact_pixels: f64,
    /// One a skipped feature, then all together.
    pub rows: Vec<Row>,
}

struct Candidate {
    kept: String,
    renderer: Renderer,
    image: Image,
    rays: u64,
    ms: Vec<f64>,
}

impl Candidate {
    /// Its first render is not timed: the driver compiles then.
    fn new(gpu: &Gpu, scene: &Scene, settings: &Settings, (kept, features): (String, Features)) -> Result<Self> {
        let mut renderer = Renderer::with_features(gpu, scene, settings, features)?;
        renderer.finish()?;
        let (image, rays) = (renderer.image()?, renderer.stats()?.rays);
        Ok(Self { kept, renderer, image, rays, ms: Vec::new() })
    }

    fn time(&mut self) -> Result<()> {
        self.renderer.restart();
        self.renderer.finish()?;
        self.ms.push(self.renderer.stats()?.device_ms);
        Ok(())
    }

    fn rays_per_second(&self, ms: Times) -> f64 {
        self.rays as f64 / (ms.median * 1e-3)
    }
}

/// Times them in turns, so that what else the machine does meets all alike.
pub fn run(gpu: &Gpu, scene: &Scene, settings: &Settings, runs: u32) -> Result<Report> {
    let features = Features::new(scene, settings);
    let mut all = vec![("specialised".to_owned(), features.clone())];
    all.extend(features.skips().map(|skip: Skip| (skip.name().to_owned(), features.clone().with(skip))));
    all.push(("generic".to_owned(), features.generic()));
    let make = |named| Candidate::new(gpu, scene, settings, named);
    let mut candidates = all.into_iter().map(make).collect::<Result<Vec<_>>>()?;
    for _ in 0..runs {
        candidates.iter_mut().try_for_each(Candidate::time)?;
    }
    let mut own = candidates.remove(0);
    let exact: Vec<[f32; 4]> = gpu.download(&own.renderer.radiance()?)?;
    let ms = Times::of(std::mem::take(&mut own.ms));
    let rows = candidates.into_iter().map(|mut candidate| {
        let times = Times::of(std::mem::take(&mut candidate.ms));
        Row {
            ratio: times.median / ms.median,
            rays_per_second: candidate.rays_per_second(times),
            same_bits: same_radiance(&own.image, &candidate.image),
            kept: candidate.kept,
            ms: times,
        }
    });
    Ok(Report {
        rows: rows.collect(),
        rays_per_second: own.rays_per_second(ms),
        exact_pixels: exact.iter().filter(|pixel| pixel[3] != 0.0).count() as f64 / exact.len() as f64,
        ms,
    })
}

fn same_radiance(a: &Image, b: &Image) -> bool {
    ["R", "G", "B"].iter().all(|name| different_values(&a.channels[*name], &b.channels[*name]) == 0)
}
