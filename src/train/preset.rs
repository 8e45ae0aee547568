//! Ways to train: the paper's experiment, and the product's own.

use super::data::DataSettings;
use super::dataset::{Manifest, NOISY_VERSIONS};
use super::loss::Loss;
use super::split::{Sides, Split, chunks};
use crate::Result;
use crate::named::named;
use serde::{Deserialize, Serialize};

/// Where the examples come from, and what goes with it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Preset {
    /// New scenes, rendered as training goes; a learning rate that rises and falls.
    #[default]
    Fresh,
    /// The paper's: the chunks of a data set, epoch after epoch, at a constant learning rate.
    Paper,
}

/// Chunks a step of the paper's preset; the paper gives none.
pub const PAPER_BATCH: u32 = 32;
/// Side of its chunks, pixels.
pub const PAPER_CHUNK: u32 = 128;
/// Epochs of the paper's preset where none are asked for.
pub const PAPER_EPOCHS: u64 = 20;
/// Epochs between the paper's checkpoints.
pub const PAPER_CHECKPOINT_EPOCHS: u64 = 20;

named!(Preset, "preset", Fresh = "fresh", Paper = "paper");

impl Preset {
    /// What it minimises unless another loss is asked for.
    #[must_use]
    pub const fn loss(self) -> Loss {
        match self {
            Self::Fresh => Loss::Multiscale,
            Self::Paper => Loss::Mae,
        }
    }
}

/// What a run on a data set sees.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoredSettings {
    /// Seed of the split and of the order of the chunks.
    pub seed: u64,
    /// Chunks a step.
    pub batch: u32,
    /// Side of a chunk, pixels; a multiple of the network's alignment.
    pub chunk: u32,
    /// What is held out.
    pub split: Split,
    /// The data set's [`super::dataset::Manifest::fingerprint`].
    pub dataset: String,
    /// Chunks of an epoch.
    pub epoch_chunks: u64,
}

impl StoredSettings {
    /// For the data set of `manifest`.
    pub fn new(seed: u64, batch: u32, chunk: u32, split: Split, manifest: &Manifest) -> Result<Self> {
        let (dataset, s) = (manifest.fingerprint(), &manifest.settings);
        let mut settings = Self { seed, batch, chunk, split, dataset, epoch_chunks: 0 };
        settings.epoch_chunks = settings.sides(s.count, (s.width, s.height))?.training.len() as u64;
        Ok(settings)
    }

    /// Training and held-out chunks of `scenes` scenes in pictures of a size.
    pub fn sides(&self, scenes: u32, size: (u32, u32)) -> Result<Sides> {
        self.split.divide(&chunks(scenes, NOISY_VERSIONS, size, self.chunk)?, scenes, self.seed)
    }

    /// Whole epochs that are over after `step` steps. An epoch may end in the middle of a step's batch.
    #[must_use]
    pub fn epochs_done(&self, step: u64) -> u64 {
        step * u64::from(self.batch) / self.epoch_chunks.max(1)
    }

    /// Steps after which this many epochs are over.
    #[must_use]
    pub fn steps_of(&self, epochs: u64) -> u64 {
        (epochs * self.epoch_chunks).div_ceil(u64::from(self.batch.max(1)))
    }
}

/// What a training run sees.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Source {
    /// A data set.
    Stored(StoredSettings),
    /// Scenes rendered as training goes.
    Fresh(DataSettings),
}

impl From<DataSettings> for Source {
    fn from(settings: DataSettings) -> Self {
        Self::Fresh(settings)
    }
}

impl Source {
    /// The preset that it belongs to.
    #[must_use]
    pub fn preset(&self) -> Preset {
        match self {
            Self::Stored(_) => Preset::Paper,
            Self::Fresh(_) => Preset::Fresh,
        }
    }

    /// The seed of all random numbers.
    #[must_use]
    pub fn seed(&self) -> u64 {
        match self {
            Self::Stored(s) => s.seed,
            Self::Fresh(s) => s.seed,
        }
    }

    /// Crops a step and their side, by size.
    #[must_use]
    pub fn sizes(&self) -> Vec<(u32, u32)> {
        match self {
            Self::Stored(s) => vec![(s.batch, s.chunk)],
            Self::Fresh(s) => s.sizes(),
        }
    }

    /// Which of [`Self::sizes`] step `step` (from 0) has.
    #[must_use]
    pub fn size_at(&self, step: u64) -> usize {
        match self {
            Self::Stored(_) => 0,
            Self::Fresh(s) => s.size_at(step),
        }
    }

    /// The data set's settings, where there is one.
    #[must_use]
    pub fn stored(&self) -> Option<&StoredSettings> {
        match self {
            Self::Stored(s) => Some(s),
            Self::Fresh(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn epochs_and_steps_agree() {
        let settings = |batch, epoch_chunks| StoredSettings {
            seed: 0,
            batch,
            chunk: 32,
            split: Split::Scene,
            dataset: String::new(),
            epoch_chunks,
        };
        for (batch, chunks) in [(32, 6480), (1, 7), (7, 7), (8, 3), (5, 12)] {
            let s = settings(batch, chunks);
            for epoch in 0..9 {
                let steps = s.steps_of(epoch);
                assert_eq!(s.epochs_done(steps).max(epoch), s.epochs_done(steps), "{batch} {chunks} {epoch}");
                assert!(steps == 0 || s.epochs_done(steps - 1) < epoch, "{batch} {chunks} {epoch}");
            }
        }
        assert_eq!(settings(32, 6480).steps_of(20), 4050);
    }

    /// Checkpoints and weights from before there were presets.
    #[test]
    fn settings_of_old_files_are_fresh_ones() {
        let old = r#"{"seed":3,"batch":4,"crop":128,"window":256,"pool":64,"initial":16,"refresh":3,"spp":16,"reference_spp":128}"#;
        let source: Source = serde_json::from_str(old).expect("readable");
        assert_eq!(source.preset(), Preset::Fresh);
        assert_eq!((source.seed(), source.sizes()), (3, vec![(4, 128)]));
    }
}
