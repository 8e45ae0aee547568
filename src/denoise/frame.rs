//! A frame as the network's input: exposure and depth scale, crops, and which weights expect what.

use crate::gpu::{Buffer, Footprint, Gpu, Recorder, Slice};
use crate::net::device::{groups, windows};
use crate::net::weights::Weights;
use crate::{Error, Result, push_block, shaders};
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

/// Side of the bins that a frame's exposure is made of, pixels.
pub const BIN: u32 = 16;

/// Metadata key and value of the inputs that `network_input.comp` makes.
pub const INPUTS: (&str, &str) = ("inputs", "radiance,normal_screen.xy,depth");
/// Metadata key and value of the transfer in `transfer.glsl`.
pub const TRANSFER: (&str, &str) = ("transfer", "log1p");

/// Refuses weights whose inputs or transfer differ from what this version makes.
pub fn check_weights(weights: &Weights, file: &str) -> Result<()> {
    for (key, expected) in [INPUTS, TRANSFER] {
        let found = weights.metadata.get(key).map_or("none", String::as_str);
        if found != expected {
            return Err(Error::input(format!("{file}: metadata `{key}`: expected `{expected}`, found `{found}`")));
        }
    }
    Ok(())
}

/// Buffers for the exposure and the depth scale of frames of one size.
pub struct FrameStats {
    gpu: Gpu,
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
    pub fn new(gpu: &Gpu, width: u32, height: u32) -> Result<Self> {
        let [bins, joined] = Self::sizes(width, height);
        let bins = [gpu.buffer("bins", bins)?, gpu.buffer("joined bins", joined)?];
        Ok(Self { gpu: gpu.clone(), size: (width, height), bins })
    }

    /// Rows of bins.
    #[must_use]
    pub fn bin_rows(&self) -> u32 {
        self.size.1.div_ceil(BIN)
    }

    /// The rows of the frame that these rows of bins are made of; none have more than [`BIN`].
    #[must_use]
    pub fn rows(&self, bin_rows: &Range<u32>) -> Range<u32> {
        let row = |bin_row: u32| (bin_row * BIN).min(self.size.1);
        row(bin_rows.start)..row(bin_rows.end)
    }

    /// Records (exposure, 1 / depth, 0, 0) of a frame into `out`, 16 bytes.
    pub fn record(&self, rec: &mut Recorder, radiance: &Slice, screen: &Slice, out: &Slice) -> Result<()> {
        self.record_strip(rec, radiance, screen, 0..self.bin_rows())?;
        self.record_join(rec, out)
    }

    /// Records the part of some rows of bins; `radiance` and `screen` hold their [`Self::rows`] and may hold no others. Once
    /// all are in there follows [`Self::record_join`]. How a frame is cut changes no bit.
    pub fn record_strip(
        &self,
        rec: &mut Recorder,
        radiance: &Slice,
        screen: &Slice,
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
        let kernel = self.gpu.kernel::<shaders::frame_bins::Shader>(&Default::default())?;
        let bins = self.bins[0].all();
        let bind = shaders::frame_bins::Bind { radiance: radiance.clone(), screen: screen.clone(), bins };
        rec.dispatch(&kernel, &bind, &push, groups(u64::from(push.count)));
        Ok(())
    }

    /// Records (exposure, 1 / depth, 0, 0) into `out`, 16 bytes.
    pub fn record_join(&self, rec: &mut Recorder, out: &Slice) -> Result<()> {
        let (width, height) = self.size;
        let mut count = width.div_ceil(BIN) * height.div_ceil(BIN);
        let kernel = self.gpu.kernel::<shaders::frame_join::Shader>(&Default::default())?;
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

/// Records the network's input for a crop of a frame of `size`; what lies past the frame is zero.
pub fn record_input(
    gpu: &Gpu,
    rec: &mut Recorder,
    frame: [&Slice; 3],
    size: (u32, u32),
    crop: Crop,
    out: &Slice,
) -> Result<()> {
    let [radiance, screen, stats] = frame;
    let kernel = gpu.kernel::<shaders::network_input::Shader>(&Default::default())?;
    for (begin, texels) in windows(gpu.info(), u64::from(crop.width) * u64::from(crop.height) * 2) {
        let push = InputPush {
            begin: (begin / 2) as u32,
            count: (texels / 2) as u32,
            width: size.0 as i32,
            height: size.1 as i32,
            crop_width: crop.width as i32,
            crop_height: crop.height as i32,
            x0: crop.x as i32,
            y0: crop.y as i32,
            orientation: crop.orientation,
        };
        let y = out.slice(begin * 16, texels * 16);
        let bind = shaders::network_input::Bind {
            radiance: radiance.clone(),
            screen: screen.clone(),
            stats: stats.clone(),
            y,
        };
        rec.dispatch(&kernel, &bind, &push, groups(texels / 2));
    }
    Ok(())
}
