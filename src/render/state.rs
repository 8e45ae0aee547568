//! The buffers of one render, and how far it is.

use super::features::Features;
use crate::gpu::{Buffer, Gpu, Recorder, Slice};
use crate::{Result, shaders};
use std::ops::Range;

/// Rows come in multiples of this where buffers are cut into windows: 16 rows of 16-byte pixels are a multiple of 256 bytes.
const WINDOW_ALIGNMENT: u32 = 16;
/// What [`State::halo`] adds to a window at most, in such multiples.
const HALOS: u32 = 2;
const VEC4_BYTES: u64 = 16;

/// What the path tracer adds up, a vec4 (or 3, for batches) a pixel, row by row from the top.
pub(super) struct State {
    pub width: u32,
    pub height: u32,
    pub total: Buffer,
    pub block: Buffer,
    pub counts: Buffer,
    pub batch: Option<Buffer>,
    /// Even samples less odd ones.
    pub difference: Option<Buffer>,
    /// First hits, where they are kept: albedo, world normal, screen values; sums where every sample has its own camera ray.
    pub aov: Option<[Buffer; 3]>,
    /// What `resolve` writes; the first hits of the shared camera ray need no resolving.
    pub radiance: Buffer,
    pub resolved: Option<[Buffer; 3]>,
    pub variance: Option<Buffer>,
    /// Set where pixels have not all the samples that were asked for; with triangles only.
    pub unfinished: Option<Buffer>,
    /// Stands in for what this render does not have.
    pub dummy: Buffer,
    /// Rows of one window: no binding exceeds the device's storage range.
    pub window_rows: u32,
}

impl State {
    pub(super) fn new(gpu: &Gpu, width: u32, height: u32, features: &Features) -> Result<Self> {
        let pixels = u64::from(width) * u64::from(height);
        let plane = |name: &str| gpu.buffer(name, pixels * VEC4_BYTES);
        let planes = |[a, b, c]: [&str; 3]| -> Result<[Buffer; 3]> { Ok([plane(a)?, plane(b)?, plane(c)?]) };
        let per_pixel = if features.variance { 3 * VEC4_BYTES } else { VEC4_BYTES };
        let fit = (gpu.info().max_storage_range / (u64::from(width) * per_pixel)).min(u64::from(u32::MAX)) as u32;
        let rows = (fit / WINDOW_ALIGNMENT).saturating_sub(HALOS) * WINDOW_ALIGNMENT;
        let window_rows = rows.max(WINDOW_ALIGNMENT);
        Ok(Self {
            width,
            height,
            total: plane("total")?,
            block: plane("block")?,
            counts: plane("counts")?,
            batch: features.variance.then(|| gpu.buffer("batch", 3 * pixels * VEC4_BYTES)).transpose()?,
            difference: features.halves.then(|| plane("difference")).transpose()?,
            aov: features.aovs.then(|| planes(["first albedo", "first normal", "first screen"])).transpose()?,
            radiance: plane("radiance")?,
            resolved: (features.aa && features.aovs).then(|| planes(["albedo", "normal", "screen"])).transpose()?,
            variance: features.variance.then(|| plane("variance")).transpose()?,
            unfinished: (features.mesh_count > 0).then(|| gpu.buffer("unfinished", 256)).transpose()?,
            dummy: gpu.buffer("dummy", 256)?,
            window_rows: window_rows.min(height),
        })
    }

    /// The part of a buffer with `size` bytes a pixel that holds the window from row `first`.
    fn window(&self, buffer: &Buffer, first: u32, size: u64) -> Slice {
        let row = u64::from(self.width) * size;
        let rows = self.window_rows.min(self.height - first);
        buffer.slice(u64::from(first) * row, u64::from(rows) * row)
    }

    /// All pixels of a buffer with a vec4 a pixel; the buffer itself may be longer.
    pub(super) fn plane(&self, buffer: &Buffer) -> Slice {
        buffer.slice(0, u64::from(self.width) * u64::from(self.height) * VEC4_BYTES)
    }

    fn window_or_dummy(&self, buffer: Option<&Buffer>, first: u32, size: u64) -> Slice {
        buffer.map_or_else(|| self.dummy.all(), |b| self.window(b, first, size))
    }

    fn aov_window(&self, i: usize, first: u32) -> Slice {
        self.window_or_dummy(self.aov.as_ref().map(|aov| &aov[i]), first, VEC4_BYTES)
    }

    pub(super) fn path_trace_bind(&self, scene: &Buffer, first: u32) -> shaders::path_trace::Bind {
        let window = |buffer: &Buffer| self.window(buffer, first, VEC4_BYTES);
        shaders::path_trace::Bind {
            scene: scene.all(),
            total: window(&self.total),
            block: window(&self.block),
            counts: window(&self.counts),
            albedo: self.aov_window(0, first),
            normal_world: self.aov_window(1, first),
            screen: self.aov_window(2, first),
            batch: self.window_or_dummy(self.batch.as_ref(), first, 3 * VEC4_BYTES),
            difference: self.window_or_dummy(self.difference.as_ref(), first, VEC4_BYTES),
            unfinished: self.unfinished.as_ref().unwrap_or(&self.dummy).all(),
        }
    }

    /// Of the rows from `first`; there is a difference.
    pub(super) fn error_estimate_bind(&self, first: u32, sums: Slice) -> shaders::error_estimate::Bind {
        shaders::error_estimate::Bind {
            radiance: self.window(&self.radiance, first, VEC4_BYTES),
            difference: self.window_or_dummy(self.difference.as_ref(), first, VEC4_BYTES),
            sums,
        }
    }

    /// The rows of the window from row `first` and of the pixels next to it.
    pub(super) fn halo(&self, first: u32) -> Range<u32> {
        first.saturating_sub(WINDOW_ALIGNMENT)..(first + self.window_rows + 1).min(self.height)
    }

    pub(super) fn resolve_bind(&self, first: u32) -> shaders::resolve::Bind {
        let window = |buffer: &Buffer| self.window(buffer, first, VEC4_BYTES);
        let (halo, row) = (self.halo(first), u64::from(self.width) * VEC4_BYTES);
        let aa = self.resolved.is_some();
        let sum = |i: usize| if aa { self.aov_window(i, first) } else { self.dummy.all() };
        let mean = |i: usize| self.window_or_dummy(self.resolved.as_ref().map(|r| &r[i]), first, VEC4_BYTES);
        shaders::resolve::Bind {
            total: window(&self.total),
            block: window(&self.block),
            counts: self.counts.slice(u64::from(halo.start) * row, u64::from(halo.end - halo.start) * row),
            albedo_sum: sum(0),
            normal_sum: sum(1),
            screen_sum: sum(2),
            batch: self.window_or_dummy(self.batch.as_ref(), first, 3 * VEC4_BYTES),
            radiance: window(&self.radiance),
            albedo: mean(0),
            normal_world: mean(1),
            screen: mean(2),
            variance: self.window_or_dummy(self.variance.as_ref(), first, VEC4_BYTES),
        }
    }

    /// Everything that samples are added to; in this order in a checkpoint.
    pub(super) fn sums(&self) -> Vec<&Buffer> {
        let mut list = vec![&self.total, &self.block, &self.counts];
        list.extend(self.batch.as_ref());
        list.extend(self.difference.as_ref());
        if self.resolved.is_some() {
            list.extend(self.aov.iter().flatten());
        }
        list
    }

    pub(super) fn record_clear(&self, rec: &mut Recorder) {
        self.sums().into_iter().for_each(|buffer| rec.fill_zero(&buffer.all()));
    }
}

/// How far a render is: rows above `row` hold samples [0, end), the others [0, begin).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Cursor {
    pub begin: u32,
    pub end: u32,
    pub row: u32,
}
