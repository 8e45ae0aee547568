//! The network, ready to reconstruct pictures.

use super::device::KernelArgs;
use limpid::Result;
use limpid::denoise::{Denoiser, check_weights, embedded_weights};
use limpid::gpu::{Gpu, Slice, Timings};
use limpid::image::Image;
use limpid::kernels::Choice;
use limpid::kernels::check::Purpose;
use limpid::net::kernel::Family;
use limpid::net::weights::Weights;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::path::Path;

/// Weights, and the network made for the size of the last picture.
pub struct Reconstruction {
    name: String,
    weights: Weights,
    sha256: String,
    choice: Option<Choice>,
    denoiser: Option<((u32, u32), Denoiser)>,
}

impl Reconstruction {
    /// Loads the weights of a file, or those that limpid was shipped with.
    pub fn load(file: Option<&Path>) -> Result<Self> {
        let name = file.map_or_else(|| "embedded".to_owned(), |file| file.display().to_string());
        let weights = file.map_or_else(embedded_weights, Weights::load)?;
        check_weights(&weights, &name)?;
        let sha256 = Sha256::digest(weights.to_bytes()).iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Self { name, weights, sha256, choice: None, denoiser: None })
    }

    /// The SHA-256 of the weights as limpid writes them to a file.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// Name, architecture and hash of the weights.
    pub fn describe(&self) -> Value {
        json!({ "file": self.name, "architecture": self.weights.architecture.name(), "sha256": self.sha256 })
    }

    /// The kernels in use; none where no picture was reconstructed.
    pub fn kernels(&self) -> Option<&Choice> {
        self.choice.as_ref().filter(|_| self.denoiser.is_some())
    }

    /// Chooses the kernels.
    pub fn choose(&mut self, gpu: &Gpu, kernels: &KernelArgs) -> Result<()> {
        self.choice = Some(kernels.choose(gpu, Purpose::Inference)?);
        Ok(())
    }

    /// Moves the channels `R,G,B` to `noisy` and puts their reconstruction in their place. `radiance` and `screen` are
    /// the same picture on the device. Nothing runs where nothing is noisy: then the result has no times.
    pub fn run(&mut self, gpu: &Gpu, frame: [&Slice; 2], image: &mut Image) -> Result<Option<Timings>> {
        let noisy = image.rgb("")?.map(<[f32]>::to_vec);
        image.set_rgb("noisy", noisy);
        image.attributes.insert("weights".into(), self.sha256.clone());
        if exact_pixels(image)?.iter().all(|&exact| exact) {
            return Ok(None);
        }
        let size = (image.width, image.height);
        let family = self.choice.as_ref().map_or_else(|| Family::choose(gpu.info()), |choice| choice.family);
        let denoiser = match self.denoiser.take() {
            Some((made_for, denoiser)) if made_for == size => denoiser,
            // The old one's memory is free by now.
            _ => Denoiser::new(gpu, family, &self.weights, size.0, size.1)?,
        };
        let (_, denoiser) = self.denoiser.insert((size, denoiser));
        let (planes, timings) = denoiser.run(frame[0], frame[1])?;
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
