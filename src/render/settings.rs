//! What the caller may choose.

use crate::named::named;
use crate::scene::Scene;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// How light is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Estimator {
    /// Uniform directions on the hemisphere; light only where a path hits it.
    Uniform,
    /// Cosine-weighted directions; light only where a path hits it.
    Cosine,
    /// Cosine-weighted directions and, at every hit, a sample of a light (next-event estimation).
    Nee,
}

/// Where the random numbers come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sampler {
    /// Independent numbers from a hash of (pixel, sample, dimension, seed).
    Pcg,
    /// Owen-scrambled Sobol points, padded in pairs of dimensions (Burley 2020).
    Sobol,
}

/// Settings of a render.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Settings {
    /// Samples a pixel, >= 1.
    pub spp: u32,
    /// Seed of all random numbers.
    pub seed: u32,
    /// Reflections a path may make; 0 shows only what emits.
    pub bounces: u32,
    /// How light is found.
    pub estimator: Estimator,
    /// Where the random numbers come from.
    pub sampler: Sampler,
    /// Every sample has its own camera ray, uniform in the pixel; first-hit values are averages. Otherwise all samples
    /// share the hit of the ray through the pixel's centre.
    pub aa: bool,
    /// Keep the variance of the mean (`pcg` with at least 8 samples only; absent otherwise).
    pub variance: bool,
    /// Samples alternate between two independent halves, whose difference tells the error
    /// ([`Renderer::relmse_estimate`](super::Renderer::relmse_estimate)). With `sobol` each half is a net of its own: the
    /// picture's error is that of two nets of half the samples, about 1.1 to 1.2 times that of one.
    pub halves: bool,
    /// Keep what the camera rays hit: albedo, normal, depth. The network reads them; without, a picture has only radiance.
    pub aovs: bool,
    /// From so many reflections on a path goes on with the probability of its throughput's largest part, at most 0.95, and
    /// counts for more if it does (Russian roulette). With the bounce limit or more: never.
    pub roulette: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            spp: 16,
            seed: 0,
            bounces: 8,
            estimator: Estimator::Nee,
            sampler: Sampler::Sobol,
            aa: false,
            variance: false,
            halves: false,
            aovs: true,
            roulette: u32::MAX,
        }
    }
}

impl Settings {
    /// Samples in one batch of the variance estimate; 0 where there is none.
    pub fn batch_size(&self) -> u32 {
        if self.variance && self.sampler == Sampler::Pcg { (self.spp / 8).min(64) } else { 0 }
    }

    /// The roulette that pays for a bounce limit: from 5 reflections on where there may be more than 8, else never. Up to 8 it
    /// costs more in variance than it saves in time.
    pub fn default_roulette(bounces: u32) -> u32 {
        if bounces > 8 { 5 } else { u32::MAX }
    }

    /// The reflections from which on paths may be ended by chance; none where that is no sooner than the bounce limit.
    pub fn roulette_from(&self) -> Option<u32> {
        Some(self.roulette).filter(|&from| from < self.bounces)
    }

    /// The largest bounce limit: a path must fit into the loop budget of one dispatch.
    pub const MAX_BOUNCES: u32 = 1024;

    pub(super) fn check(&self, scene: &Scene) -> Result<()> {
        if scene.camera.lens.is_some() && !self.aa {
            return Err(Error::input("the scene's camera has a lens: every sample needs its own camera ray (aa)"));
        }
        if self.spp == 0 {
            return Err(Error::input("0 samples a pixel: ask for at least 1"));
        }
        if self.bounces > Self::MAX_BOUNCES {
            return Err(Error::input(format!("{} bounces: at most {}", self.bounces, Self::MAX_BOUNCES)));
        }
        if !scene.delta_lights.is_empty() && self.estimator != Estimator::Nee {
            return Err(Error::input(format!(
                "the estimator {} meets lights by chance, and nothing meets a light without a surface: use nee",
                self.estimator.name()
            )));
        }
        self.check_variance(scene)
    }

    /// Refuses variance where squares of radiance leave the range of f32: it would come out infinite, or 0 where there is noise.
    fn check_variance(&self, scene: &Scene) -> Result<()> {
        let largest = scene.max_radiance();
        if self.batch_size() == 0 || largest == 0.0 || (1e-15..=1e15).contains(&largest) {
            return Ok(());
        }
        Err(Error::input(format!(
            "variance of a scene with radiance up to {largest:e}: its squares leave the range of f32; scale the radiance to \
             between 1e-15 and 1e15, or render without variance"
        )))
    }
}

named!(Estimator, "estimator", Uniform = "uniform", Cosine = "cosine", Nee = "nee");

named!(Sampler, "sampler", Pcg = "pcg", Sobol = "sobol");
