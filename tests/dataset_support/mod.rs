//! Small data sets for tests.
#![allow(dead_code)]

use limpid::denoise::Preparation;
use limpid::gpu::Gpu;
use limpid::net::architecture::Architecture;
use limpid::train::dataset::{DatasetSettings, Frames, Manifest, Writer, Written};
use std::path::Path;
use tempfile::TempDir;

/// What `seed` reads.
pub const SEED_INPUTS: fn() -> Preparation = || Preparation::of_architecture(&Architecture::seed()).unwrap();

/// A small data set.
pub fn settings(count: u32, (width, height): (u32, u32)) -> DatasetSettings {
    DatasetSettings { count, width, height, spp: 2, reference_spp: 4, seed: 7 }
}

/// Makes a data set whole; its manifest, and how many pictures were rendered.
pub fn write(gpu: &Gpu, dir: &Path, settings: &DatasetSettings) -> (Manifest, u64) {
    let mut writer = Writer::new(gpu, dir, settings).unwrap();
    match writer.run(|_, _| true).unwrap() {
        Written::Whole(manifest) => (manifest, writer.rendered()),
        Written::Stopped => panic!("nothing asked it to stop"),
    }
}

/// A new data set.
pub fn made(gpu: &Gpu, settings: &DatasetSettings) -> (TempDir, Manifest) {
    let dir = tempfile::tempdir().unwrap();
    let (manifest, _) = write(gpu, dir.path(), settings);
    (dir, manifest)
}

/// The pictures of a data set.
pub fn load(gpu: &Gpu, preparation: Preparation, dir: &Path) -> Frames {
    let manifest = Manifest::of(dir).unwrap();
    Frames::load(gpu, preparation, dir, &manifest, |_, _| true).unwrap().expect("nothing asked it to stop")
}
