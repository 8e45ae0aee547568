//! The network, ready to reconstruct pictures.

use limpid::Result;
use limpid::denoise::{Denoiser, Guides, Inputs, Preparation, embedded_weights};
use limpid::gpu::{Gpu, Slice, Timings};
use limpid::image::Image;
use limpid::net::weights::Weights;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::path::Path;

/// Weights, and the network made for the size of the last picture.
pub struct Reconstruction {
    name: String,
    weights: Weights,
    inputs: Inputs,
    sha256: String,
    denoiser: Option<((u32, u32), Denoiser)>,
}

impl Reconstruction {
    /// Loads the weights of a file, or those that limpid was shipped with.
    pub fn load(file: Option<&Path>) -> Result<Self> {
        let name = file.map_or_else(|| "embedded".to_owned(), |file| file.display().to_string());
        let weights = file.map_or_else(embedded_weights, Weights::load)?;
        let inputs = Preparation::of_weights(&weights, &name)?.inputs;
        let sha256 = Sha256::digest(weights.to_bytes()).iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Self { name, weights, inputs, sha256, denoiser: None })
    }

    /// What the network reads of a frame.
    pub fn inputs(&self) -> Inputs {
        self.inputs
    }

    /// The SHA-256 of the weights as limpid writes them to a file.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// Name, architecture and hash of the weights.
    pub fn describe(&self) -> Value {
        json!({ "file": self.name, "architecture": self.weights.architecture.name(), "sha256": self.sha256 })
    }

    /// The kernels in use; none before the first picture.
    pub fn kernels(&self) -> Option<&'static str> {
        self.denoiser.as_ref().map(|(_, denoiser)| denoiser.family().name())
    }

    /// Moves the channels `R,G,B` to `noisy` and puts their reconstruction in their place. `frame` is the
    /// same picture on the device: radiance, and the guides for [`Self::inputs`]. Nothing runs where nothing is noisy: then the result has no times.
    pub fn run(&mut self, gpu: &Gpu, frame: (&Slice, &Guides), image: &mut Image) -> Result<Option<Timings>> {
        let noisy = image.rgb("")?.map(<[f32]>::to_vec);
        image.set_rgb("noisy", noisy);
        image.attributes.insert("weights".into(), self.sha256.clone());
        if exact_pixels(image)?.iter().all(|&exact| exact) {
            return Ok(None);
        }
        let size = (image.width, image.height);
        let denoiser = match self.denoiser.take() {
            Some((made_for, denoiser)) if made_for == size => denoiser,
            // The old one's memory is free by now.
            _ => Denoiser::new(gpu, &self.weights, size.0, size.1)?,
        };
        let (_, denoiser) = self.denoiser.insert((size, denoiser));
        let (planes, timings) = denoiser.run(frame.0, frame.1)?;
        image.set_rgb("", planes);
        Ok(Some(timings))
    }
}

/// The pixels that are exact: their first hit reflects nothing, or reflections were not asked for.
pub fn exact_pixels(image: &Image) -> Result<Vec<bool>> {
    let [r, g, b] = image.rgb("albedo")?;
    let unlit = image.attributes.get("bounces").is_some_and(|bounces| bounces == "0");
    Ok((0..r.len()).map(|i| unlit || (r[i] == 0.0 && g[i] == 0.0 && b[i] == 0.0)).collect())
}
