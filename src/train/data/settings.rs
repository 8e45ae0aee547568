//! What a training run sees: scenes, noise, crop sizes.

use super::{Stream, draws};
use crate::named::named;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// Which scenes a training run sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scenes {
    /// `spheres:N` alone, one camera ray a pixel, a fixed number of samples.
    #[default]
    Spheres,
    /// `spheres:N` and `rooms:N`, one camera ray a pixel or one a sample, 4 to 64 samples a pixel.
    Mixed,
}

named!(Scenes, "scenes", Spheres = "spheres", Mixed = "mixed");

/// Whether scenes are for training or held out from it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// N below [`HELD_OUT`](crate::scene::family::HELD_OUT).
    Training,
    /// N of [`HELD_OUT`](crate::scene::family::HELD_OUT).
    HeldOut,
}

/// What a training run sees.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DataSettings {
    /// Seed of scenes, noise, crops and orientations.
    pub seed: u64,
    /// Crops a step, of the smallest size.
    pub batch: u32,
    /// Side of the smallest crops, pixels; a multiple of the network's alignment.
    pub crop: u32,
    /// Sides of the other crops; a step has crops of one size, of each as often, and of larger ones fewer.
    #[serde(default)]
    pub larger_crops: Vec<u32>,
    /// Side of an example, pixels.
    pub window: u32,
    /// Examples kept at a time.
    pub pool: u32,
    /// Examples before the first step.
    pub initial: u32,
    /// Steps between new examples.
    pub refresh: u32,
    /// Samples a pixel of the noisy versions, where they are fixed.
    pub spp: u32,
    /// Samples a pixel of the reference (`nee`, `sobol`).
    pub reference_spp: u32,
    /// Which scenes.
    #[serde(default)]
    pub scenes: Scenes,
}

impl Default for DataSettings {
    fn default() -> Self {
        Self {
            seed: 0,
            batch: 8,
            crop: 128,
            larger_crops: vec![256, 384],
            window: 384,
            pool: 64,
            initial: 16,
            refresh: 3,
            spp: 16,
            reference_spp: 128,
            scenes: Scenes::Mixed,
        }
    }
}

impl DataSettings {
    pub(super) fn check(&self, alignment: u32) -> Result<()> {
        let positive =
            [self.batch, self.crop, self.window, self.pool, self.initial, self.refresh, self.spp, self.reference_spp];
        if positive.contains(&0) {
            return Err(Error::input(format!("a training setting is 0: {self:?}")));
        }
        for crop in std::iter::once(&self.crop).chain(&self.larger_crops) {
            if *crop < self.crop || !crop.is_multiple_of(alignment) || *crop > self.window {
                return Err(Error::input(format!(
                    "crops of {crop} pixels: they must be multiples of {alignment}, the smallest first, and at most the \
                     window's {}",
                    self.window
                )));
            }
        }
        Ok(())
    }

    /// Crops a step and their side, by size: about as many pixels each.
    #[must_use]
    pub fn sizes(&self) -> Vec<(u32, u32)> {
        let crops = |side: u32| {
            let pixels = u64::from(self.batch) * u64::from(self.crop) * u64::from(self.crop);
            let each = u64::from(side) * u64::from(side);
            (((pixels + each / 2) / each).max(1) as u32, side)
        };
        std::iter::once(self.crop).chain(self.larger_crops.iter().copied()).map(crops).collect()
    }

    /// Which of [`Self::sizes`] step `step` (from 0) has.
    #[must_use]
    pub fn size_at(&self, step: u64) -> usize {
        (draws(self.seed, Stream::Size, step)(0) % (1 + self.larger_crops.len() as u64)) as usize
    }

    /// Crops in the first `steps` steps.
    #[must_use]
    pub fn crops_in(&self, steps: u64) -> u64 {
        let sizes = self.sizes();
        (0..steps).map(|step| u64::from(sizes[self.size_at(step)].0)).sum()
    }

    /// Examples made before step `step` (from 0) is taken.
    #[must_use]
    pub fn examples_at(&self, step: u64) -> u64 {
        u64::from(self.initial) + step / u64::from(self.refresh)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_have_every_size_with_about_as_many_pixels() {
        let settings = DataSettings::default();
        assert_eq!(settings.sizes(), [(8, 128), (2, 256), (1, 384)]);
        let mut steps = [0; 3];
        (0..3000).for_each(|step| steps[settings.size_at(step)] += 1);
        // Binomial with p = 1/3: sigma 26.
        assert!(steps.iter().all(|n| (900..1100).contains(n)), "{steps:?}");
        assert_eq!(settings.crops_in(3000), 8 * steps[0] + 2 * steps[1] + steps[2]);
        let one = DataSettings { larger_crops: vec![], ..settings };
        assert_eq!((one.sizes(), one.size_at(7), one.crops_in(10)), (vec![(8, 128)], 0, 80));
    }
}
