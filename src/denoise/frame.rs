//! A frame as the network's input: exposure and depth scale, crops.

use super::preparation::{Inputs, Transfer};
use crate::gpu::{Buffer, Footprint, Gpu, Recorder, Slice};
use crate::net::device::{groups, windows};
use crate::render::Outputs;
use crate::scene::Camera;
use crate::{Result, push_block, shaders};
use glam::DVec4;
use std::ops::Range;

push_block! {
    /// Push constants of `frame_bins.comp`.
    pub struct BinsPush for shaders::frame_bins { width: u32, height: u32, row: u32, begin: u32, count: u32 }
}
push_block! {
    /// Push constants of `frame_join.comp`.
    pub struct JoinPush for shaders::frame_join { count: u32, last: u32 }
}
push_block! {
    /// Push constants of `network_input.comp`.
    pub struct InputPush for shaders::network_input {
        begin: u32, count: u32, width: i32, height: i32, crop_width: i32, crop_height: i32, x0: i32, y0: i32, orientation: u32,
    }
}

push_block! {
    /// Push constants of `network_input_albedo_normal.comp`.
    pub struct AlbedoNormalPush for shaders::network_input_albedo_normal {
        begin: u32, count: u32, width: i32, height: i32, crop_width: i32, crop_height: i32, x0: i32, y0: i32, orientation: u32,
        right_x: f32, right_y: f32, right_z: f32, up_x: f32, up_y: f32, up_z: f32,
    }
}

/// Side of the bins that a frame's exposure is made of, pixels; none is larger.
pub const BIN: u32 = 16;

/// A camera's axes in world space, unit length and perpendicular.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axes {
    /// To the right in the picture.
    pub right: [f32; 3],
    /// Upward in the picture.
    pub up: [f32; 3],
}

impl Axes {
    /// The axes of `camera`.
    #[must_use]
    pub fn of(camera: &Camera) -> Self {
        let axis = |v: DVec4| v.truncate().as_vec3().to_array();
        Self { right: axis(camera.to_world.x_axis), up: axis(camera.to_world.y_axis) }
    }
}

impl Default for Axes {
    /// Those of a camera that looks along -z; where a frame is not turned, none are read.
    fn default() -> Self {
        Self { right: [1.0, 0.0, 0.0], up: [0.0, 1.0, 0.0] }
    }
}

/// What a network reads of a frame beside its radiance: four floats a pixel each, as [`Outputs`] has them.
#[derive(Clone)]
pub enum Guides {
    /// For [`Inputs::NormalScreenDepth`].
    NormalScreenDepth {
        /// Screen-space normal x, y; depth; unused.
        screen: Slice,
    },
    /// For [`Inputs::AlbedoNormal`].
    AlbedoNormal {
        /// r, g, b of the albedo; unused.
        albedo: Slice,
        /// World-space normal x, y, z; unused.
        normal_world: Slice,
        /// By which normals turn with a crop.
        axes: Axes,
    },
}

impl Guides {
    /// What `inputs` need of a renderer's results.
    #[must_use]
    pub fn of(outputs: &Outputs, inputs: Inputs, axes: Axes) -> Self {
        match inputs {
            Inputs::NormalScreenDepth => Self::NormalScreenDepth { screen: outputs.screen.clone() },
            Inputs::AlbedoNormal => {
                Self::AlbedoNormal { albedo: outputs.albedo.clone(), normal_world: outputs.normal_world.clone(), axes }
            }
        }
    }

    /// Of the planes of `inputs`, radiance left out.
    ///
    /// # Panics
    /// Where there are more planes or fewer.
    #[must_use]
    pub fn of_planes(inputs: Inputs, planes: &[Slice]) -> Self {
        match (inputs, planes) {
            (Inputs::NormalScreenDepth, [screen]) => Self::NormalScreenDepth { screen: screen.clone() },
            (Inputs::AlbedoNormal, [albedo, normal_world]) => {
                Self::AlbedoNormal { albedo: albedo.clone(), normal_world: normal_world.clone(), axes: Axes::default() }
            }
            _ => panic!("{} planes beside radiance for {}", planes.len(), inputs.name()),
        }
    }

    /// All of them.
    #[must_use]
    pub fn planes(&self) -> Vec<&Slice> {
        match self {
            Self::NormalScreenDepth { screen } => vec![screen],
            Self::AlbedoNormal { albedo, normal_world, .. } => vec![albedo, normal_world],
        }
    }

    /// Sets the camera's axes, where they are needed.
    pub fn set_axes(&mut self, camera: Axes) {
        if let Self::AlbedoNormal { axes, .. } = self {
            *axes = camera;
        }
    }

    /// What they are for.
    #[must_use]
    pub const fn inputs(&self) -> Inputs {
        match self {
            Self::NormalScreenDepth { .. } => Inputs::NormalScreenDepth,
            Self::AlbedoNormal { .. } => Inputs::AlbedoNormal,
        }
    }
}

/// Buffers for the exposure and the depth scale of frames of one size.
pub struct FrameStats {
    gpu: Gpu,
    transfer: Transfer,
    size: (u32, u32),
    bins: [Buffer; 2],
}

impl FrameStats {
    /// Bytes of the buffers for frames of `width` x `height` pixels.
    fn sizes(width: u32, height: u32) -> [u64; 2] {
        let count = u64::from(width.div_ceil(BIN)) * u64::from(height.div_ceil(BIN));
        [count * 16, count.div_ceil(256) * 16]
    }

    /// The memory that [`Self::new`] will take.
    #[must_use]
    pub fn footprint(width: u32, height: u32) -> Footprint {
        Self::sizes(width, height).map(Footprint::buffer).into_iter().sum()
    }

    /// Buffers for frames of `width` x `height` pixels.
    pub fn new(gpu: &Gpu, transfer: Transfer, width: u32, height: u32) -> Result<Self> {
        let [bins, joined] = Self::sizes(width, height);
        let bins = [gpu.buffer("bins", bins)?, gpu.buffer("joined bins", joined)?];
        Ok(Self { gpu: gpu.clone(), transfer, size: (width, height), bins })
    }

    /// Rows of bins.
    #[must_use]
    pub fn bin_rows(&self) -> u32 {
        self.size.1.div_ceil(BIN)
    }

    /// The rows of the frame that these rows of bins are made of; none have more than [`BIN`].
    #[must_use]
    pub fn rows(&self, bin_rows: &Range<u32>) -> Range<u32> {
        let height = self.size.1;
        // As `bin_begin` in `frame_bins.comp`.
        let row = |bin_row: u32| match self.transfer {
            Transfer::Log1p => (bin_row * BIN).min(height),
            Transfer::Pu => bin_row * height / self.bin_rows(),
        };
        row(bin_rows.start)..row(bin_rows.end)
    }

    /// Pixels that a frame needs repaired, of what [`Self::record`] made of it.
    #[must_use]
    pub fn repaired(stats: [f32; 4]) -> u64 {
        stats[2] as u64 + ((stats[3] as u64) << 16)
    }

    /// Records (exposure, 1 / depth, repaired pixels modulo 65,536, repaired pixels over 65,536) of a frame into `out`, 16
    /// bytes; a depth of 1 where the guides have none. Repaired are pixels whose radiance is no number, infinite or
    /// negative, or whose guides are not finite. The network reads infinite radiance as the largest and the rest as 0, or as a miss has it.
    pub fn record(&self, rec: &mut Recorder, radiance: &Slice, guides: &Guides, out: &Slice) -> Result<()> {
        self.record_strip(rec, radiance, guides, 0..self.bin_rows())?;
        self.record_join(rec, out)
    }

    /// Records the part of some rows of bins; `radiance` and `guides` hold their [`Self::rows`] and may hold no others. Once
    /// all are in there follows [`Self::record_join`]. How a frame is cut changes no bit.
    pub fn record_strip(
        &self,
        rec: &mut Recorder,
        radiance: &Slice,
        guides: &Guides,
        bin_rows: Range<u32>,
    ) -> Result<()> {
        let (width, height) = self.size;
        let bins_x = width.div_ceil(BIN);
        let push = BinsPush {
            width,
            height,
            row: self.rows(&bin_rows).start,
            begin: bin_rows.start * bins_x,
            count: (bin_rows.end - bin_rows.start) * bins_x,
        };
        // Where there is one guide, it stands in the place of the second and is not read there.
        let (depth, first, second) = match guides {
            Guides::NormalScreenDepth { screen } => (true, screen, screen),
            Guides::AlbedoNormal { albedo, normal_world, .. } => (false, albedo, normal_world),
        };
        let spec = shaders::frame_bins::Spec { transfer: self.transfer.id(), depth };
        let kernel = self.gpu.kernel::<shaders::frame_bins::Shader>(&spec)?;
        let bins = self.bins[0].all();
        let [radiance, first, second] = [radiance, first, second].map(Slice::clone);
        let bind = shaders::frame_bins::Bind { radiance, first, second, bins };
        rec.dispatch(&kernel, &bind, &push, groups(u64::from(push.count)));
        Ok(())
    }

    /// Records the joined stats of all strips into `out`, 16 bytes; see [`Self::record`].
    pub fn record_join(&self, rec: &mut Recorder, out: &Slice) -> Result<()> {
        let (width, height) = self.size;
        let mut count = width.div_ceil(BIN) * height.div_ceil(BIN);
        let kernel = self
            .gpu
            .kernel::<shaders::frame_join::Shader>(&shaders::frame_join::Spec { transfer: self.transfer.id() })?;
        let mut from = 0;
        loop {
            let joined = count.div_ceil(256);
            let bins = self.bins[from].slice(0, u64::from(count) * 16);
            let to = if joined == 1 { out.clone() } else { self.bins[1 - from].slice(0, u64::from(joined) * 16) };
            let push = JoinPush { count, last: u32::from(joined == 1) };
            rec.dispatch(&kernel, &shaders::frame_join::Bind { bins, joined: to }, &push, groups(u64::from(joined)));
            if joined == 1 {
                return Ok(());
            }
            count = joined;
            from = 1 - from;
        }
    }
}

/// A part of a frame, mirrored or turned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crop {
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Columns of the result.
    pub width: u32,
    /// Rows of the result.
    pub height: u32,
    /// Bit 0 mirrors x, bit 1 mirrors y, bit 2 swaps x and y (square crops only).
    pub orientation: u32,
}

/// A frame on the device.
pub struct Frame<'a> {
    /// r, g, b and whatever, four floats a pixel.
    pub radiance: &'a Slice,
    /// The other channels.
    pub guides: &'a Guides,
    /// What [`FrameStats::record`] made.
    pub stats: &'a Slice,
    /// Pixels across and down.
    pub size: (u32, u32),
}

/// Records the network's input for a crop of a frame; what lies past the frame is zero.
pub fn record_input(
    gpu: &Gpu,
    rec: &mut Recorder,
    transfer: Transfer,
    frame: &Frame<'_>,
    crop: Crop,
    out: &Slice,
) -> Result<()> {
    match frame.guides {
        Guides::NormalScreenDepth { screen } => {
            record_normal_screen_depth(gpu, rec, transfer, (frame, screen), crop, out)
        }
        Guides::AlbedoNormal { albedo, normal_world, axes } => {
            record_albedo_normal(gpu, rec, transfer, (frame, [albedo, normal_world], axes), crop, out)
        }
    }
}

/// Ranges of texels of a crop's input of `texels` texels a pixel, each with its part: parts that fit a storage binding.
fn texel_windows(gpu: &Gpu, crop: Crop, texels: u64, out: &Slice) -> Vec<(u32, u32, Slice)> {
    windows(gpu.info(), u64::from(crop.width) * u64::from(crop.height) * texels)
        .map(|(begin, count)| (begin as u32, count as u32, out.slice(begin * 16, count * 16)))
        .collect()
}

fn record_normal_screen_depth(
    gpu: &Gpu,
    rec: &mut Recorder,
    transfer: Transfer,
    (frame, screen): (&Frame<'_>, &Slice),
    crop: Crop,
    out: &Slice,
) -> Result<()> {
    let spec = shaders::network_input::Spec { transfer: transfer.id() };
    let kernel = gpu.kernel::<shaders::network_input::Shader>(&spec)?;
    for (begin, count, y) in texel_windows(gpu, crop, 2, out) {
        let push = InputPush {
            begin,
            count,
            width: frame.size.0 as i32,
            height: frame.size.1 as i32,
            crop_width: crop.width as i32,
            crop_height: crop.height as i32,
            x0: crop.x as i32,
            y0: crop.y as i32,
            orientation: crop.orientation,
        };
        let bind = shaders::network_input::Bind {
            radiance: frame.radiance.clone(),
            screen: screen.clone(),
            stats: frame.stats.clone(),
            y,
        };
        rec.dispatch(&kernel, &bind, &push, groups(u64::from(count)));
    }
    Ok(())
}

fn record_albedo_normal(
    gpu: &Gpu,
    rec: &mut Recorder,
    transfer: Transfer,
    (frame, [albedo, normal], axes): (&Frame<'_>, [&Slice; 2], &Axes),
    crop: Crop,
    out: &Slice,
) -> Result<()> {
    let spec = shaders::network_input_albedo_normal::Spec { transfer: transfer.id() };
    let kernel = gpu.kernel::<shaders::network_input_albedo_normal::Shader>(&spec)?;
    let ([right_x, right_y, right_z], [up_x, up_y, up_z]) = (axes.right, axes.up);
    for (begin, count, y) in texel_windows(gpu, crop, 3, out) {
        let push = AlbedoNormalPush {
            begin,
            count,
            width: frame.size.0 as i32,
            height: frame.size.1 as i32,
            crop_width: crop.width as i32,
            crop_height: crop.height as i32,
            x0: crop.x as i32,
            y0: crop.y as i32,
            orientation: crop.orientation,
            right_x,
            right_y,
            right_z,
            up_x,
            up_y,
            up_z,
        };
        let bind = shaders::network_input_albedo_normal::Bind {
            radiance: frame.radiance.clone(),
            albedo: albedo.clone(),
            normal: normal.clone(),
            stats: frame.stats.clone(),
            y,
        };
        rec.dispatch(&kernel, &bind, &push, groups(u64::from(count)));
    }
    Ok(())
}
