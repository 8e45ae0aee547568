//! The network, ready to reconstruct pictures.

use super::device::KernelArgs;
use super::tile::Cut;
use limpid::denoise::{
    Choice, Denoiser, Guides, Inputs, Kernels, Plane, Preparation, Task, TiledDenoiser, embedded_weights, exact_pixels,
    weights_of,
};
use limpid::gpu::{Gpu, Slice, Timings};
use limpid::image::Image;
use limpid::kernels;
use limpid::kernels::check::Purpose;
use limpid::net::plan::Plan;
use limpid::net::weights::Weights;
use limpid::{Error, Result};
use serde_json::{Value, json};
use std::path::Path;

/// Weights, and the network made for the size of the last picture.
pub struct Reconstruction {
    name: String,
    weights: Weights,
    inputs: Inputs,
    sha256: String,
    cut: Cut,
    kernels: Option<kernels::Choice>,
    choice: Option<Choice>,
    repaired: u64,
    /// Tiles of the last picture in which nothing was noisy.
    skipped: u32,
    made: Option<(Choice, Made)>,
}

enum Made {
    /// For frames on the device.
    Whole(Box<Denoiser>),
    /// For frames in host memory, be it as one tile.
    Tiled(Box<TiledDenoiser>),
}

impl Reconstruction {
    /// Loads the weights of a file, or those that limpid was shipped with.
    pub fn load(file: Option<&Path>, cut: Cut) -> Result<Self> {
        let name = file.map_or_else(|| "embedded".to_owned(), |file| file.display().to_string());
        let weights = file.map_or_else(embedded_weights, weights_of)?;
        let inputs = Preparation::of_weights(&weights, &name)?.inputs;
        let sha256 = weights.sha256();
        Ok(Self {
            name,
            weights,
            inputs,
            sha256,
            cut,
            kernels: None,
            choice: None,
            repaired: 0,
            skipped: 0,
            made: None,
        })
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

    /// Pixels of the last picture whose radiance or guides were no numbers, infinite, or negative radiance.
    pub fn repaired(&self) -> u64 {
        self.repaired
    }

    /// The kernels in use; none where no picture was reconstructed.
    pub fn kernels(&self) -> Option<&kernels::Choice> {
        self.kernels.as_ref().filter(|_| self.choice.is_some())
    }

    /// Chooses the kernels, and lets the driver begin to make them.
    pub fn choose_kernels(&mut self, gpu: &Gpu, kernels: &KernelArgs) -> Result<()> {
        self.kernels = Some(kernels.choose(gpu, Purpose::Inference)?);
        let Kernels { family, fusion } = self.chosen(gpu);
        Plan::request_kernels(gpu, &self.weights.architecture, family, fusion)
    }

    fn chosen(&self, gpu: &Gpu) -> Kernels {
        self.kernels.as_ref().map_or_else(|| Kernels::best(gpu.info()), |kernels| Kernels::of(kernels.family))
    }

    /// How the last picture was cut; none before the first.
    pub fn tiling(&self) -> Option<Value> {
        let Choice { tiling, bytes } = self.choice?;
        let (window, core) = (tiling.window(), tiling.core());
        Some(json!({
            "tiles": tiling.count(), "core": [core.0, core.1], "window": [window.0, window.1], "overlap": tiling.overlap(),
            "exact_overlap": tiling.exact_overlap(), "blend": tiling.blend(), "exact": tiling.is_exact(),
            "device_bytes": bytes, "skipped": self.skipped,
        }))
    }

    /// A line about the last picture where it is not what the whole frame gives.
    pub fn caution(&self) -> Option<String> {
        let tiling = self.choice?.tiling;
        (!tiling.is_exact()).then(|| {
            let blended = if tiling.blend() { " blended" } else { "" };
            let (overlap, exact) = (tiling.overlap(), tiling.exact_overlap());
            format!(
                "approximate: {} tiles with{blended} overlaps of {overlap} pixels; exact from {exact}, not blended",
                tiling.count()
            )
        })
    }

    /// Decides how pictures of this size are cut, without allocating anything; an error where nothing fits.
    pub fn choose(&mut self, gpu: &Gpu, size: (u32, u32), resident: bool) -> Result<Choice> {
        let kernels = self.chosen(gpu);
        let (info, architecture) = (gpu.info(), &self.weights.architecture);
        let task = Task { info, architecture, inputs: self.inputs, kernels, size, resident };
        let choice = self.cut.choose(&task)?;
        self.choice = Some(choice);
        Ok(choice)
    }

    /// Moves the channels `R,G,B` to `noisy` and puts their reconstruction in their place. `resident` are radiance and the
    /// guides for [`Self::inputs`] of the same picture where the device holds them. Nothing runs where nothing is noisy: then the result has no
    /// times. `progress` is told the share of the work that is done.
    pub fn run(
        &mut self,
        gpu: &Gpu,
        resident: Option<(&Slice, &Guides)>,
        image: &mut Image,
        progress: impl FnMut(f64),
    ) -> Result<Option<Timings>> {
        image.move_rgb("", "noisy")?;
        image.attributes.insert("weights".into(), self.sha256.clone());
        let unlit = image.attributes.get("bounces").is_some_and(|bounces| bounces == "0");
        let (exact, noisy) = (exact_pixels(image, "noisy")?, image.rgb("noisy")?);
        let usable = |i: usize| noisy.iter().all(|plane| plane[i].is_finite() && plane[i] >= 0.0);
        let exact = |i: usize| usable(i) && (unlit || exact[i]);
        if (0..image.pixel_count()).all(exact) {
            let noisy = noisy.map(<[f32]>::to_vec);
            image.set_rgb("", noisy);
            (self.repaired, self.skipped) = (0, 0);
            return Ok(None);
        }
        let inputs = self.inputs;
        let choice = self.choose(gpu, (image.width, image.height), resident.is_some())?;
        let (planes, timings, repaired, skipped) = match (self.make(gpu, choice, resident.is_some())?, resident) {
            (Made::Whole(denoiser), Some((radiance, guides))) => {
                let (planes, timings) = denoiser.run(radiance, guides)?;
                (planes, timings, denoiser.repaired()?, 0)
            }
            (Made::Tiled(denoiser), _) => {
                let planes = planes(image, inputs, &exact)?;
                let planes: Vec<Plane> = planes.iter().map(|plane| &**plane as Plane).collect();
                let (planes, timings) = denoiser.run(&planes, progress)?;
                (planes, timings, denoiser.repaired()?, denoiser.skipped())
            }
            (Made::Whole(_), None) => unreachable!("made for frames on the device"),
        };
        image.set_rgb("", planes);
        image.attributes.insert("repairedPixels".into(), repaired.to_string());
        (self.repaired, self.skipped) = (repaired, skipped);
        Ok(Some(timings))
    }

    /// The network for a tiling, made anew where the last picture's was another.
    fn make(&mut self, gpu: &Gpu, choice: Choice, resident: bool) -> Result<&mut Made> {
        let made = match self.made.take() {
            Some((made_for, made)) if made_for == choice => made,
            // The old one's memory is free by now.
            _ => {
                let (kernels, tiling) = (self.chosen(gpu), choice.tiling);
                let made = if resident && tiling.count() == 1 {
                    Denoiser::with_kernels(gpu, &self.weights, kernels, tiling.size()).map(|d| Made::Whole(Box::new(d)))
                } else {
                    TiledDenoiser::new(gpu, &self.weights, kernels, tiling).map(|d| Made::Tiled(Box::new(d)))
                };
                made.map_err(|error| match error {
                    Error::OutOfMemory(cause) => {
                        Error::OutOfMemory(format!("{cause}; a lower --max-memory takes smaller tiles"))
                    }
                    other => other,
                })?
            }
        };
        Ok(&mut self.made.insert((choice, made)).1)
    }

    /// Frees the device's memory.
    pub fn release(&mut self) {
        self.made = None;
    }
}

/// A plane that owns what it reads.
type OwnedPlane<'a> = Box<dyn Fn(usize) -> [f32; 4] + 'a>;

/// The planes of `inputs`, their radiance from the noisy channels.
fn planes<'a>(image: &'a Image, inputs: Inputs, exact: &'a dyn Fn(usize) -> bool) -> Result<Vec<OwnedPlane<'a>>> {
    let [r, g, b] = image.rgb("noisy")?;
    let radiance = move |i: usize| [r[i], g[i], b[i], f32::from(u8::from(exact(i)))];
    let mut planes: Vec<OwnedPlane<'a>> = vec![Box::new(radiance)];
    for (_, [x, y, z]) in &inputs.planes()[1..] {
        let (x, y, z) = (image.channel(x)?, image.channel(y)?, image.channel(z)?);
        planes.push(Box::new(move |i| [x[i], y[i], z[i], 0.0]));
    }
    Ok(planes)
}

/// For people: what was repaired.
pub fn repaired_line(pixels: u64) -> String {
    format!("{pixels} pixels were not finite or negative and were repaired")
}
