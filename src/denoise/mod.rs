//! Reconstruction: frame -> network input -> network -> frame, all on the device, as a whole or in tiles.

mod budget;
mod frame;
mod network;
mod tiled;
mod tiles;

pub use budget::{Choice, Demand, Task, check_core};
pub use frame::{BIN, BinsPush, Crop, FrameStats, INPUTS, InputPush, JoinPush, TRANSFER, check_weights, record_input};
pub use network::{Kernels, OutputPush};
pub use tiled::{PLANES, Plane, TiledDenoiser};
pub use tiles::{Rect, Tile, Tiling};

use crate::Result;
use crate::gpu::{Commands, Footprint, Gpu, Slice, Timings};
use crate::net::architecture::Architecture;
use crate::net::kernel::Family;
use crate::net::weights::Weights;
use network::Network;

/// The weights that are part of the program.
const EMBEDDED: &[u8] = include_bytes!("../../weights/seed.safetensors");

/// The weights that limpid was shipped with.
pub fn embedded_weights() -> Result<Weights> {
    Weights::from_bytes(EMBEDDED, "embedded weights", None)
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

    /// Tensors for frames of `width` x `height` pixels, the fastest kernels.
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

    /// Records the reconstruction of a frame: `radiance` (rgb, exact) and `screen` (normal x, y, depth, hit), four floats
    /// a pixel, as [`crate::render::Outputs`] has them.
    pub fn record(&self, radiance: &Slice, screen: &Slice) -> Result<Commands> {
        let network = &self.network;
        let mut rec = network.gpu.recorder();
        let planes = [radiance.clone(), screen.clone()];
        network.record_strip(&mut rec, &planes, 0..network.frame_stats.bin_rows())?;
        network.frame_stats.record_join(&mut rec, &network.stats)?;
        network.record_input(&mut rec, &planes, self.size)?;
        network.plan.record(&mut rec, &network.parameters)?;
        network.record_output(&mut rec, &planes, self.size)?;
        rec.finish()
    }

    /// Reconstructs a frame; the planes r, g, b and the times.
    pub fn run(&self, radiance: &Slice, screen: &Slice) -> Result<([Vec<f32>; 3], Timings)> {
        let timings = self.record(radiance, screen)?.run()?;
        let pixels = self.network.download(pixels(self.size))?;
        Ok((std::array::from_fn(|c| pixels.iter().map(|p| p[c]).collect()), timings))
    }
}
