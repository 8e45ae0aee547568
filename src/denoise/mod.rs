//! Reconstruction: frame -> network input -> network -> frame, all on the device, as a whole or in tiles.

mod budget;
mod exact;
mod frame;
mod network;
mod preparation;
mod tiled;
mod tiles;

pub use budget::{Choice, Demand, Overlapping, Task, check_core};
pub use exact::exact_pixels;
pub use frame::{
    AlbedoNormalPush, Axes, BIN, BinsPush, Crop, Frame, FrameStats, Guides, InputPush, JoinPush, record_input,
};
pub use network::{Kernels, OutputPush};
pub use preparation::{Inputs, Preparation, Transfer};
pub use tiled::{Plane, TiledDenoiser};
pub use tiles::{Rect, Tile, Tiling};

use crate::gpu::{Commands, Footprint, Gpu, Slice, Timings};
use crate::net::architecture::Architecture;
use crate::net::kernel::Family;
use crate::net::weights::Weights;
use crate::{Error, Result};
use network::Network;
use std::path::Path;

/// The weights that are part of the program, by name; the first are the default.
const EMBEDDED: [(&str, &[u8]); 3] = [
    ("kpn", include_bytes!("../../weights/kpn.safetensors")),
    ("seed", include_bytes!("../../weights/seed.safetensors")),
    ("base", include_bytes!("../../weights/base.safetensors")),
];

/// The names of the weights that limpid was shipped with, the default first.
pub fn embedded_names() -> impl Iterator<Item = &'static str> {
    EMBEDDED.iter().map(|(name, _)| *name)
}

/// The default weights.
pub fn embedded_weights() -> Result<Weights> {
    let (name, bytes) = EMBEDDED[0];
    Weights::from_bytes(bytes, name, None)
}

/// The weights that limpid was shipped with by this name, or those of the safetensors file at this path. A file that has
/// such a name is `./NAME`.
pub fn weights_of(path: &Path) -> Result<Weights> {
    match EMBEDDED.iter().find(|(name, _)| path.as_os_str() == *name) {
        Some((name, bytes)) => Weights::from_bytes(bytes, name, None),
        None => Weights::load(path),
    }
}

/// A network made ready for frames of one size that lie on the device, each reconstructed as a whole.
pub struct Denoiser {
    network: Network,
    size: (u32, u32),
}

fn pixels((width, height): (u32, u32)) -> u64 {
    u64::from(width) * u64::from(height)
}

fn padded(architecture: &Architecture, (width, height): (u32, u32)) -> (u32, u32) {
    let padded = |size: u32| architecture.padded(size as usize) as u32;
    (padded(width), padded(height))
}

impl Denoiser {
    /// The memory that [`Self::with_kernels`] will take.
    #[must_use]
    pub fn footprint(architecture: &Architecture, kernels: Kernels, size: (u32, u32)) -> Footprint {
        Network::footprint(architecture, kernels, size, padded(architecture, size), pixels(size))
    }

    /// Tensors for frames of `width` x `height` pixels, the fastest kernels. The metadata of `weights` say what their network
    /// reads.
    pub fn new(gpu: &Gpu, weights: &Weights, width: u32, height: u32) -> Result<Self> {
        Self::with_kernels(gpu, weights, Kernels::best(gpu.info()), (width, height))
    }

    /// The same with the kernels named.
    pub fn with_kernels(gpu: &Gpu, weights: &Weights, kernels: Kernels, size: (u32, u32)) -> Result<Self> {
        let network = Network::new(gpu, weights, kernels, size, padded(&weights.architecture, size), pixels(size))?;
        Ok(Self { network, size })
    }

    /// The kernels in use.
    #[must_use]
    pub fn family(&self) -> Family {
        self.network.kernels.family
    }

    /// What is done to a frame before and after the network.
    #[must_use]
    pub fn preparation(&self) -> Preparation {
        self.network.preparation
    }

    /// Records the reconstruction of a frame: `radiance` (rgb, exact), four floats a pixel, as [`crate::render::Outputs`] has
    /// it, and the guides that the weights ask for.
    pub fn record(&self, radiance: &Slice, guides: &Guides) -> Result<Commands> {
        let inputs = self.preparation().inputs;
        if guides.inputs() != inputs {
            let (given, wanted) = (guides.inputs().name(), inputs.name());
            return Err(Error::input(format!("the weights read {wanted}, but are given {given}")));
        }
        let network = &self.network;
        let mut rec = network.gpu.recorder();
        network.record_strip(&mut rec, (radiance, guides), 0..network.frame_stats.bin_rows())?;
        network.frame_stats.record_join(&mut rec, &network.stats)?;
        network.record_input(&mut rec, (radiance, guides), self.size)?;
        network.plan.record(&mut rec, &network.parameters)?;
        network.record_output(&mut rec, radiance, self.size)?;
        rec.finish()
    }

    /// Pixels of the last frame that held what no renderer should give and were repaired; see [`FrameStats::record`].
    pub fn repaired(&self) -> Result<u64> {
        self.network.repaired()
    }

    /// Reconstructs a frame; the planes r, g, b and the times.
    pub fn run(&self, radiance: &Slice, guides: &Guides) -> Result<([Vec<f32>; 3], Timings)> {
        let timings = self.record(radiance, guides)?.run()?;
        let pixels = self.network.download(pixels(self.size))?;
        Ok((std::array::from_fn(|c| pixels.iter().map(|p| p[c]).collect()), timings))
    }
}
