//! The data set on disk: members of the scene family, each with noisy versions and a target that these share, as EXR files.
//!
//! `spheres-N.noisy-K.exr` is what `limpid render` makes of scene N with the paper's settings (`cosine`, `pcg`), the
//! network's other channels included; `spheres-N.target.exr` is the radiance that the network shall make of it.
//! `manifest.json` says what is there; it is written last.

mod frames;
mod write;

pub use frames::{Frames, Picture};
pub use write::{Writer, Written};

use crate::image::check_size;
use crate::image::file::write_bytes;
use crate::net::tensor::{hash, seed_of};
use crate::render::{Estimator, Sampler, Settings};
use crate::scene::Scene;
use crate::scene::family::{self, FAMILY_VERSION};
use crate::{Error, Result};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};

/// The manifest's name.
pub const MANIFEST: &str = "manifest.json";
/// The version of the form of data sets.
const FORMAT: u32 = 1;
/// Noisy versions of a scene, which share its target.
pub const NOISY_VERSIONS: u32 = 2;
/// What a noisy version is rendered with.
const NOISY: (Estimator, Sampler) = (Estimator::Cosine, Sampler::Pcg);
/// What a target is rendered with.
const TARGET: (Estimator, Sampler) = (Estimator::Nee, Sampler::Sobol);

/// What decides every picture of a data set.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DatasetSettings {
    /// Scenes; each has [`NOISY_VERSIONS`] noisy pictures.
    pub count: u32,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Samples a pixel of the noisy pictures (`cosine`, `pcg`).
    pub spp: u32,
    /// Samples a pixel of the targets (`nee`, `sobol`).
    pub reference_spp: u32,
    /// Seed of scene numbers and noise.
    pub seed: u64,
}

impl Default for DatasetSettings {
    /// The paper's: 200 pictures of 768x768. 256 samples of `nee`+`sobol` have less error than its 16,384 of `cosine`.
    fn default() -> Self {
        Self { count: 100, width: 768, height: 768, spp: 16, reference_spp: 256, seed: 0 }
    }
}

/// A picture of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Noisy version `k`.
    Noisy(u32),
    /// The target.
    Target,
}

impl Part {
    /// All pictures of a scene.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..NOISY_VERSIONS).map(Self::Noisy).chain([Self::Target])
    }

    /// The file of scene `n`'s picture.
    #[must_use]
    pub fn file(self, n: u64) -> String {
        match self {
            Self::Noisy(k) => format!("spheres-{n:05}.noisy-{k}.exr"),
            Self::Target => format!("spheres-{n:05}.target.exr"),
        }
    }
}

impl DatasetSettings {
    /// Refuses what cannot be rendered.
    pub fn check(&self) -> Result<()> {
        check_size(self.width, self.height)?;
        if self.count == 0 || u64::from(self.count) > *family::HELD_OUT.start() {
            return Err(Error::input(format!(
                "{} scenes: a data set has 1 to {} of them",
                self.count,
                family::HELD_OUT.start()
            )));
        }
        if self.spp == 0 || self.reference_spp == 0 {
            return Err(Error::input("0 samples a pixel: ask for at least 1"));
        }
        Ok(())
    }

    /// The numbers of its scenes: distinct, none held out.
    #[must_use]
    pub fn scenes(&self) -> Vec<u64> {
        let key = hash(self.seed, seed_of("data set"));
        let mut seen = HashSet::new();
        let numbers = (0..).map(|i| hash(key, i) % family::HELD_OUT.start()).filter(|n| seen.insert(*n));
        numbers.take(self.count as usize).collect()
    }

    /// Scene `n` at the size of the pictures.
    fn scene(&self, n: u64) -> Scene {
        self.sized(family::spheres(n))
    }

    fn sized(&self, mut scene: Scene) -> Scene {
        (scene.camera.width, scene.camera.height) = (self.width, self.height);
        scene
    }

    /// How a picture of scene `n` is rendered.
    fn render_settings(&self, n: u64, part: Part) -> Settings {
        let (spp, (estimator, sampler), stream) = match part {
            Part::Noisy(k) => (self.spp, NOISY, u64::from(k)),
            Part::Target => (self.reference_spp, TARGET, u64::from(NOISY_VERSIONS)),
        };
        let seed = hash(hash(self.seed, n), stream) as u32;
        Settings { spp, seed, estimator, sampler, ..Settings::default() }
    }
}

/// What is in a data set's folder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Manifest {
    /// Version of the form.
    #[serde(rename = "limpid_dataset")]
    format: u32,
    /// Version of the scene family.
    family_version: u32,
    /// What decides the pictures.
    pub settings: DatasetSettings,
    /// The scenes' numbers.
    pub scenes: Vec<u64>,
    /// sha256 of every file.
    pub files: BTreeMap<String, String>,
}

impl Manifest {
    fn new(settings: &DatasetSettings) -> Self {
        Self {
            format: FORMAT,
            family_version: FAMILY_VERSION,
            settings: settings.clone(),
            scenes: settings.scenes(),
            files: BTreeMap::new(),
        }
    }

    /// Reads the manifest of a folder; none where there is none.
    pub fn read(dir: &Path) -> Result<Option<Self>> {
        let path = dir.join(MANIFEST);
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(Error::io(&path, e)),
        };
        let bad = |what: String| {
            Error::input(format!("{}: no data set of limpid ({what}); name another folder", path.display()))
        };
        let manifest: Self = serde_json::from_slice(&bytes).map_err(|e| bad(e.to_string()))?;
        if manifest.format != FORMAT {
            return Err(bad(format!("form {}, this limpid knows {FORMAT}", manifest.format)));
        }
        manifest.settings.check().map_err(|e| bad(e.to_string()))?;
        if manifest.family_version == FAMILY_VERSION && manifest.scenes != manifest.settings.scenes() {
            return Err(bad("its scenes do not follow from its settings".into()));
        }
        Ok(Some(manifest))
    }

    /// The same for a folder that must be a whole data set.
    pub fn of(dir: &Path) -> Result<Self> {
        let missing = || {
            Error::input(format!(
                "{}: no data set: there is no {MANIFEST}; make one with `limpid dataset -o {0}`, or finish one so",
                dir.display()
            ))
        };
        Self::read(dir)?.ok_or_else(missing)
    }

    /// What tells this data set from any other: the sha256 of all that the manifest says.
    #[must_use]
    pub fn fingerprint(&self) -> String {
        hex(&Sha256::digest(self.text().as_bytes()))
    }

    /// Why this is not the data set of `settings`, if so.
    fn differs(&self, settings: &DatasetSettings) -> Option<String> {
        if self.family_version != FAMILY_VERSION {
            return Some(format!("family version {}, asked for {FAMILY_VERSION}", self.family_version));
        }
        let (a, b) = (serde_json::to_value(&self.settings).ok()?, serde_json::to_value(settings).ok()?);
        let (a, b) = (a.as_object()?, b.as_object()?);
        let mut differing = a.iter().filter(|(name, value)| b.get(*name) != Some(value));
        differing.next().map(|(name, value)| format!("{name} {value}, asked for {}", b[name]))
    }

    fn text(&self) -> String {
        serde_json::to_string_pretty(self).expect("plain data has a JSON form") + "\n"
    }

    fn write(&self, dir: &Path) -> Result<()> {
        write_bytes(dir.join(MANIFEST), self.text().as_bytes())
    }

    /// The files of scene `n`, each compared with its sha256.
    fn checked_files(&self, dir: &Path, n: u64) -> Result<Vec<PathBuf>> {
        let check = |part: Part| {
            let (name, path) = (part.file(n), dir.join(part.file(n)));
            match file_hash(&path)? {
                Some(sum) if self.files.get(&name) == Some(&sum) => Ok(path),
                found => Err(Error::input(format!(
                    "{}: {}; `limpid dataset -o {}` with the settings in {MANIFEST} mends it",
                    path.display(),
                    if found.is_some() { "not the file that was written (its sha256 differs)" } else { "is missing" },
                    dir.display()
                ))),
            }
        };
        Part::all().collect::<Vec<_>>().into_par_iter().map(check).collect()
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

/// The sha256 of a file; none where there is none.
fn file_hash(path: &Path) -> Result<Option<String>> {
    match std::fs::read(path) {
        Ok(bytes) => Ok(Some(hex(&Sha256::digest(&bytes)))),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(e) => Err(Error::io(path, e)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_are_distinct_and_none_is_held_out() {
        let scenes = |count, seed| DatasetSettings { count, seed, ..DatasetSettings::default() }.scenes();
        let all = scenes(5000, 3);
        assert!(all.iter().all(|n| !family::is_held_out(*n)));
        assert_eq!(all.iter().collect::<HashSet<_>>().len(), 5000);
        assert_eq!(scenes(7, 3), all[..7]);
        assert_ne!(scenes(7, 4), all[..7]);
    }

    #[test]
    fn noise_and_targets_have_seeds_of_their_own() {
        let settings = DatasetSettings::default();
        let seeds: HashSet<u32> = settings
            .scenes()
            .into_iter()
            .flat_map(|n| Part::all().map(move |part| (n, part)))
            .map(|(n, part)| settings.render_settings(n, part).seed)
            .collect();
        assert_eq!(seeds.len(), 300);
    }
}
