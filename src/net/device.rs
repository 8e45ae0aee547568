//! Tensors on the device: `[n][h][c4][w]`, each row a plane of texels of 4 channels after the other.
//!
//! Neighbouring pixels lie side by side, as kernels read them, and a range of rows is one range of memory.
//!
//! A tensor made by concatenation keeps two channel segments, each padded to 4, so that joining and splitting move whole
//! texels. Places that only pad hold zeros.

use crate::Result;
use crate::gpu::{DeviceInfo, Gpu, Slice};

/// The channels of a device tensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Channels {
    /// Channels of the first segment.
    pub first: u32,
    /// Channels of the second segment, 0 where there is none.
    pub second: u32,
}

impl Channels {
    /// One segment.
    #[must_use]
    pub const fn new(count: u32) -> Self {
        Self { first: count, second: 0 }
    }

    /// Channels without padding.
    #[must_use]
    pub const fn count(self) -> u32 {
        self.first + self.second
    }

    /// Texels a pixel.
    #[must_use]
    pub const fn texels(self) -> u32 {
        self.first.div_ceil(4) + self.second.div_ceil(4)
    }

    /// `(segment, segment_padded)` as `pack_weights.comp` wants them: zeros for one segment.
    #[must_use]
    pub const fn segment(self) -> (u32, u32) {
        if self.second == 0 { (0, 0) } else { (self.first, self.first.next_multiple_of(4)) }
    }

    /// Place of logical channel `c` on the device.
    #[must_use]
    pub const fn place(self, c: u32) -> u32 {
        if c < self.first { c } else { self.first.next_multiple_of(4) + c - self.first }
    }
}

/// Size of a device tensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Images.
    pub n: u32,
    /// Rows.
    pub h: u32,
    /// Columns.
    pub w: u32,
    /// Channels.
    pub c: Channels,
}

impl Shape {
    /// Texels of 16 bytes.
    #[must_use]
    pub const fn texels(&self) -> u64 {
        self.n as u64 * self.h as u64 * self.w as u64 * self.c.texels() as u64
    }

    /// Bytes.
    #[must_use]
    pub const fn bytes(&self) -> u64 {
        self.texels() * 16
    }

    /// The same pixels with other channels.
    #[must_use]
    pub const fn with_channels(self, c: Channels) -> Self {
        Self { c, ..self }
    }
}

/// A tensor on the device.
#[derive(Clone, Debug)]
pub struct DeviceTensor {
    /// Size.
    pub shape: Shape,
    /// Where it lies.
    pub slice: Slice,
}

impl DeviceTensor {
    /// A zero tensor in a buffer of its own.
    pub fn new(gpu: &Gpu, name: &str, shape: Shape) -> Result<Self> {
        Ok(Self { shape, slice: gpu.buffer(name, shape.bytes())?.slice(0, shape.bytes()) })
    }

    /// Writes NCHW data of `n * c.count() * h * w` values.
    ///
    /// # Panics
    /// Where `nchw` has another length.
    pub fn upload(&self, gpu: &Gpu, nchw: &[f32]) -> Result<()> {
        let mut texels = vec![0f32; self.shape.texels() as usize * 4];
        self.each(|logical, device| texels[device] = nchw[logical]);
        assert_eq!(nchw.len() as u64, self.logical_len());
        gpu.upload(&self.slice, &texels)
    }

    /// Reads the values back as NCHW.
    pub fn download(&self, gpu: &Gpu) -> Result<Vec<f32>> {
        let texels: Vec<f32> = gpu.download(&self.slice)?;
        let mut nchw = vec![0f32; self.logical_len() as usize];
        self.each(|logical, device| nchw[logical] = texels[device]);
        Ok(nchw)
    }

    fn logical_len(&self) -> u64 {
        let s = &self.shape;
        u64::from(s.n) * u64::from(s.h) * u64::from(s.w) * u64::from(s.c.count())
    }

    fn each(&self, mut f: impl FnMut(usize, usize)) {
        let s = &self.shape;
        let (height, width, planes) = (s.h as usize, s.w as usize, s.c.texels() as usize);
        for n in 0..s.n as usize {
            for c in 0..s.c.count() {
                let place = s.c.place(c) as usize;
                for y in 0..height {
                    let logical = ((n * s.c.count() as usize + c as usize) * height + y) * width;
                    let texel = ((n * height + y) * planes + place / 4) * width;
                    (0..width).for_each(|x| f(logical + x, (texel + x) * 4 + place % 4));
                }
            }
        }
    }
}

/// Ranges of `count` texels that each fit a storage binding and start on a slice's alignment.
pub fn windows(info: &DeviceInfo, count: u64) -> impl Iterator<Item = (u64, u64)> + use<> {
    let most = (info.max_storage_range.min(info.max_read_range()) / 16) & !15;
    (0..count.div_ceil(most)).map(move |i| (i * most, most.min(count - i * most)))
}

/// Workgroups of 64 for `count` invocations, folded into x and y as `flat_index` in the shaders undoes it.
#[must_use]
pub fn groups(count: u64) -> [u32; 3] {
    folded(count.div_ceil(64).max(1))
}

/// So many workgroups or a few more, folded into x and y.
#[must_use]
pub fn folded(groups: u64) -> [u32; 3] {
    let x = groups.min(32_768);
    [x as u32, groups.div_ceil(x) as u32, 1]
}
