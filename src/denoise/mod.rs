//! Reconstruction: frame -> network input -> network -> frame, all on the device.

mod frame;

pub use frame::{BinsPush, Crop, FrameStats, INPUTS, InputPush, JoinPush, TRANSFER, check_weights, record_input};

use crate::gpu::{Buffer, Commands, Gpu, Slice, Timings};
use crate::net::device::{groups, windows};
use crate::net::kernel::Family;
use crate::net::parameters::Parameters;
use crate::net::plan::{Fusion, Memory, Plan};
use crate::net::weights::Weights;
use crate::{Result, push_block, shaders};

push_block! {
    /// Push constants of `network_output.comp`.
    pub struct OutputPush for shaders::network_output { begin: u32, count: u32, width: u32, padded_width: u32 }
}

/// The weights that are part of the program.
const EMBEDDED: &[u8] = include_bytes!("../../weights/seed.safetensors");

/// The weights that limpid was shipped with.
pub fn embedded_weights() -> Result<Weights> {
    Weights::from_bytes(EMBEDDED, "embedded weights", None)
}

/// A network made ready for frames of one size.
pub struct Denoiser {
    gpu: Gpu,
    size: (u32, u32),
    parameters: Parameters,
    plan: Plan,
    frame_stats: FrameStats,
    stats: Buffer,
    result: Buffer,
}

impl Denoiser {
    /// Tensors for frames of `width` x `height` pixels.
    pub fn new(gpu: &Gpu, family: Family, weights: &Weights, width: u32, height: u32) -> Result<Self> {
        let parameters = Parameters::new(gpu, family, weights, false)?;
        let padded = |size: u32| weights.architecture.padded(size as usize) as u32;
        let size = (1, padded(height), padded(width));
        let plan = Plan::new(gpu, &weights.architecture, family, size, Memory::Shared, Fusion::best(family))?;
        Ok(Self {
            gpu: gpu.clone(),
            size: (width, height),
            parameters,
            plan,
            frame_stats: FrameStats::new(gpu, width, height)?,
            stats: gpu.buffer("frame stats", 16)?,
            result: gpu.buffer("reconstruction", u64::from(width) * u64::from(height) * 16)?,
        })
    }

    /// Records the reconstruction of a frame: `radiance` (rgb, exact) and `screen` (normal x, y, depth, hit), four floats
    /// a pixel, as [`crate::render::Outputs`] has them.
    pub fn record(&self, radiance: &Slice, screen: &Slice) -> Result<Commands> {
        let mut rec = self.gpu.recorder();
        let (width, height) = self.size;
        let stats = self.stats.slice(0, 16);
        self.frame_stats.record(&mut rec, radiance, screen, &stats)?;
        let s = self.plan.input().shape;
        let crop = Crop { x: 0, y: 0, width: s.w, height: s.h, orientation: 0 };
        let input = &self.plan.input().slice;
        record_input(&self.gpu, &mut rec, [radiance, screen, &stats], self.size, crop, input)?;
        self.plan.record(&mut rec, &self.parameters)?;
        let kernel = self.gpu.kernel::<shaders::network_output::Shader>(&Default::default())?;
        for (begin, count) in windows(self.gpu.info(), u64::from(width) * u64::from(height)) {
            let push = OutputPush { begin: begin as u32, count: count as u32, width, padded_width: s.w };
            let bind = shaders::network_output::Bind {
                network: self.plan.output().slice.clone(),
                radiance: radiance.clone(),
                stats: stats.clone(),
                y: self.result.slice(begin * 16, count * 16),
            };
            rec.dispatch(&kernel, &bind, &push, groups(count));
        }
        rec.finish()
    }

    /// Reconstructs a frame; the planes r, g, b and the times.
    pub fn run(&self, radiance: &Slice, screen: &Slice) -> Result<([Vec<f32>; 3], Timings)> {
        let timings = self.record(radiance, screen)?.run()?;
        let count = u64::from(self.size.0) * u64::from(self.size.1);
        let pixels: Vec<[f32; 4]> = self.gpu.download(&self.result.slice(0, count * 16))?;
        Ok((std::array::from_fn(|c| pixels.iter().map(|p| p[c]).collect()), timings))
    }
}
