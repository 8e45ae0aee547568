//! How much device memory something will need, known before any of it is allocated.

use super::DeviceInfo;
use super::buffer::buffer_bytes;
use std::iter::Sum;

/// Drivers round allocations up to their pages.
const PAGE: u64 = 1 << 16;

/// Device memory that buffers will need.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Footprint {
    /// Bytes of all buffers, as [`super::Gpu::peak_bytes`] counts them.
    pub bytes: u64,
    /// Bytes of the largest buffer.
    pub largest_buffer: u64,
    /// Bytes of the largest range that a shader reads as texels of 16 bytes.
    pub largest_view: u64,
}

impl Footprint {
    /// One buffer of `bytes`, read as a whole.
    #[must_use]
    pub fn buffer(bytes: u64) -> Self {
        Self::arena(bytes, bytes)
    }

    /// One buffer of `bytes`, of which at most `largest_view` bytes are read at once.
    #[must_use]
    pub fn arena(bytes: u64, largest_view: u64) -> Self {
        let bytes = buffer_bytes(bytes);
        Self { bytes, largest_buffer: bytes, largest_view }
    }

    /// Whether the device's limits allow it; not whether there is as much memory.
    #[must_use]
    pub fn within_limits(&self, info: &DeviceInfo) -> bool {
        self.largest_buffer.next_multiple_of(PAGE) <= info.max_allocation && self.largest_view <= info.max_read_range()
    }
}

impl Sum for Footprint {
    fn sum<I: Iterator<Item = Self>>(parts: I) -> Self {
        parts.fold(Self::default(), |a, b| Self {
            bytes: a.bytes + b.bytes,
            largest_buffer: a.largest_buffer.max(b.largest_buffer),
            largest_view: a.largest_view.max(b.largest_view),
        })
    }
}
