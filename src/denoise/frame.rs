//! A frame as the network's input: exposure and depth scale, crops.

use super::preparation::{Inputs, Transfer};
use crate::gpu::{Buffer, Gpu, Recorder, Slice};
use crate::net::device::{groups, window_texels};
use crate::render::Outputs;
use crate::scene::Camera;
use crate::{Result, push_block, shaders};
use glam::DVec4;

push_block! {
    /// Push constants of `frame_bins.comp`.
    pub struct BinsPush for shaders::frame_bins { width: u32, height: u32 }
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
    /// Buffers for frames of `width` x `height` pixels.
    pub fn new(gpu: &Gpu, transfer: Transfer, width: u32, height: u32) -> Result<Self> {
        let count = u64::from(width.div_ceil(16)) * u64::from(height.div_ceil(16));
        let bins = [gpu.buffer("bins", count * 16)?, gpu.buffer("joined bins", count.div_ceil(256) * 16)?];
        Ok(Self { gpu: gpu.clone(), transfer, size: (width, height), bins })
    }

    /// Records (exposure, 1 / depth, 0, 0) of a frame into `out`, 16 bytes; a depth of 1 where the guides have none.
    pub fn record(&self, rec: &mut Recorder, radiance: &Slice, guides: &Guides, out: &Slice) -> Result<()> {
        let (width, height) = self.size;
        let mut count = width.div_ceil(16) * height.div_ceil(16);
        // Where there is no depth, the radiance stands in its place and is not read there.
        let (depth, screen) = match guides {
            Guides::NormalScreenDepth { screen } => (true, screen),
            Guides::AlbedoNormal { .. } => (false, radiance),
        };
        let transfer = self.transfer.id();
        let kernel = self.gpu.kernel::<shaders::frame_bins::Shader>(&shaders::frame_bins::Spec { transfer, depth })?;
        let bins = self.bins[0].slice(0, u64::from(count) * 16);
        let bind = shaders::frame_bins::Bind { radiance: radiance.clone(), screen: screen.clone(), bins };
        rec.dispatch(&kernel, &bind, &BinsPush { width, height }, groups(u64::from(count)));
        let kernel = self.gpu.kernel::<shaders::frame_join::Shader>(&shaders::frame_join::Spec { transfer })?;
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

/// Ranges of pixels of a crop, each with its part of an input of `texels` texels a pixel: parts that fit a storage binding.
fn pixel_windows(gpu: &Gpu, crop: Crop, texels: u64, out: &Slice) -> Vec<(u32, u32, Slice)> {
    let pixels = u64::from(crop.width) * u64::from(crop.height);
    // Multiples of 16 pixels begin on a slice's alignment.
    let most = (window_texels(gpu.info()) / texels) & !15;
    let window = |begin: u64| {
        let count = most.min(pixels - begin);
        (begin as u32, count as u32, out.slice(begin * texels * 16, count * texels * 16))
    };
    (0..pixels.div_ceil(most)).map(|i| window(i * most)).collect()
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
    for (begin, count, y) in pixel_windows(gpu, crop, 2, out) {
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
    for (begin, count, y) in pixel_windows(gpu, crop, 3, out) {
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
