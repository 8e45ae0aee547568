//! A network with its parameters and tensors, and what goes before and after it.

use super::frame::{Crop, Frame, FrameStats, Guides, record_input};
use super::preparation::Preparation;
use crate::gpu::{Buffer, DeviceInfo, Footprint, Gpu, Recorder, Slice};
use crate::net::architecture::Architecture;
use crate::net::device::{groups, windows};
use crate::net::kernel::Family;
use crate::net::parameters::Parameters;
use crate::net::plan::{Fusion, Memory, Plan, TileRules};
use crate::net::weights::Weights;
use crate::{Result, push_block, shaders};
use std::ops::Range;

push_block! {
    /// Push constants of `network_output.comp`.
    pub struct OutputPush for shaders::network_output { begin: u32, count: u32, width: u32, padded_width: u32 }
}

/// Bytes of a pixel on the device, in each of a frame's planes.
pub(super) const PIXEL_BYTES: u64 = 16;

/// What a network is run by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kernels {
    /// The set of kernels.
    pub family: Family,
    /// Which of them.
    pub fusion: Fusion,
}

impl Kernels {
    /// The fastest on a device.
    #[must_use]
    pub fn best(info: &DeviceInfo) -> Self {
        Self::of(Family::choose(info))
    }

    /// The fastest of a family.
    #[must_use]
    pub fn of(family: Family) -> Self {
        Self { family, fusion: Fusion::best(family) }
    }

    /// How frames may be cut into tiles.
    #[must_use]
    pub fn tile_rules(self, architecture: &Architecture) -> TileRules {
        TileRules::new(architecture, self.family, self.fusion)
    }
}

/// Everything but the frame itself.
pub(super) struct Network {
    pub gpu: Gpu,
    pub kernels: Kernels,
    pub preparation: Preparation,
    pub parameters: Parameters,
    pub plan: Plan,
    pub frame_stats: FrameStats,
    /// What [`FrameStats::record`] makes of the frame.
    pub stats: Slice,
    result: Buffer,
}

impl Network {
    /// The memory that [`Self::new`] will take.
    pub fn footprint(
        architecture: &Architecture,
        kernels: Kernels,
        frame: (u32, u32),
        input: (u32, u32),
        result_pixels: u64,
    ) -> Footprint {
        let parts = [
            Parameters::footprint(architecture, kernels.family),
            Plan::footprint(architecture, kernels.family, (1, input.1, input.0), kernels.fusion),
            FrameStats::footprint(frame.0, frame.1),
            Footprint::buffer(PIXEL_BYTES),
            // Written in windows, never read by a shader.
            Footprint::arena(result_pixels * PIXEL_BYTES, 0),
        ];
        parts.into_iter().sum()
    }

    /// For inputs of `input` pixels (width, height, padded) from frames of `frame` pixels.
    pub fn new(
        gpu: &Gpu,
        weights: &Weights,
        kernels: Kernels,
        frame: (u32, u32),
        input: (u32, u32),
        result_pixels: u64,
    ) -> Result<Self> {
        let Kernels { family, fusion } = kernels;
        let preparation = Preparation::of_weights(weights, "weights")?;
        let size = (1, input.1, input.0);
        Ok(Self {
            gpu: gpu.clone(),
            kernels,
            preparation,
            parameters: Parameters::new(gpu, family, weights, false)?,
            plan: Plan::new(gpu, &weights.architecture, family, size, Memory::Shared, fusion)?,
            frame_stats: FrameStats::new(gpu, preparation.transfer, frame.0, frame.1)?,
            stats: gpu.buffer("frame stats", PIXEL_BYTES)?.slice(0, PIXEL_BYTES),
            result: gpu.buffer("reconstruction", result_pixels * PIXEL_BYTES)?,
        })
    }

    /// Records the part that some rows of bins have in exposure and depth scale; radiance and guides hold the rows of these.
    pub fn record_strip(
        &self,
        rec: &mut Recorder,
        (radiance, guides): (&Slice, &Guides),
        bin_rows: Range<u32>,
    ) -> Result<()> {
        self.frame_stats.record_strip(rec, radiance, guides, bin_rows)
    }

    /// Records the input from planes of `size` pixels, at most as many as the input has; what lies past them is zero.
    pub fn record_input(
        &self,
        rec: &mut Recorder,
        (radiance, guides): (&Slice, &Guides),
        size: (u32, u32),
    ) -> Result<()> {
        let s = self.plan.input().shape;
        let crop = Crop { x: 0, y: 0, width: s.w, height: s.h, orientation: 0 };
        let frame = Frame { radiance, guides, stats: &self.stats, size };
        record_input(&self.gpu, rec, self.preparation.transfer, &frame, crop, &self.plan.input().slice)
    }

    /// Records the result for the same pixels.
    pub fn record_output(&self, rec: &mut Recorder, radiance: &Slice, (width, height): (u32, u32)) -> Result<()> {
        let spec = shaders::network_output::Spec { transfer: self.preparation.transfer.id() };
        let kernel = self.gpu.kernel::<shaders::network_output::Shader>(&spec)?;
        let padded_width = self.plan.output().shape.w;
        for (begin, count) in windows(self.gpu.info(), u64::from(width) * u64::from(height)) {
            let push = OutputPush { begin: begin as u32, count: count as u32, width, padded_width };
            let bind = shaders::network_output::Bind {
                network: self.plan.output().slice.clone(),
                radiance: radiance.clone(),
                stats: self.stats.clone(),
                y: self.result.slice(begin * PIXEL_BYTES, count * PIXEL_BYTES),
            };
            rec.dispatch(&kernel, &bind, &push, groups(count));
        }
        Ok(())
    }

    /// Pixels of the last frame that were repaired.
    pub fn repaired(&self) -> Result<u64> {
        let stats: Vec<[f32; 4]> = self.gpu.download(&self.stats)?;
        Ok(FrameStats::repaired(stats[0]))
    }

    /// The result's first `count` pixels.
    pub fn download(&self, count: u64) -> Result<Vec<[f32; 4]>> {
        self.gpu.download(&self.result.slice(0, count * PIXEL_BYTES))
    }
}
