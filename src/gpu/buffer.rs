//! Device buffers, ranges of them, and the way of data to and from the host.

use super::TexelFormat;
use super::device::{Gpu, Shared, lock, vk_error};
use crate::{Error, Result};
use ash::vk;
use bytemuck::Pod;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

/// Offsets of slices are multiples of this: Vulkan's upper bound for storage and texel buffer alignments.
pub const ALIGNMENT: u64 = 256;
const STAGING_BYTES: u64 = 16 << 20;

/// Raw buffer and its memory.
struct Memory {
    raw: vk::Buffer,
    allocation: Allocation,
}

fn allocate(
    shared: &Shared,
    name: &str,
    bytes: u64,
    usage: vk::BufferUsageFlags,
    location: MemoryLocation,
) -> Result<Memory> {
    let device = &shared.raw;
    let too_large =
        |message: String| Error::OutOfMemory(format!("{name} needs {} MiB: {message}", bytes.div_ceil(1 << 20)));
    let most = shared.info.max_allocation;
    if bytes > most {
        return Err(too_large(format!("one allocation may have {} MiB: use a smaller image or batch", most >> 20)));
    }
    let info = vk::BufferCreateInfo::default().size(bytes).usage(usage).sharing_mode(vk::SharingMode::EXCLUSIVE);
    // SAFETY: the device is live; on failure below the buffer is destroyed and never used.
    let raw = unsafe { device.create_buffer(&info, None) }.map_err(vk_error)?;
    // SAFETY: `raw` is a live buffer of this device.
    let requirements = unsafe { device.get_buffer_memory_requirements(raw) };
    let fail = |message: String| {
        // SAFETY: nothing uses the buffer.
        unsafe { device.destroy_buffer(raw, None) };
        too_large(message)
    };
    if requirements.size > most {
        return Err(fail(format!("one allocation may have {} MiB: use a smaller image or batch", most >> 20)));
    }
    let desc = AllocationCreateDesc {
        name,
        requirements,
        location,
        linear: true,
        allocation_scheme: AllocationScheme::GpuAllocatorManaged,
    };
    let allocation = shared.allocator().allocate(&desc).map_err(|e| fail(e.to_string()))?;
    // SAFETY: memory and offset come from the allocator for these requirements.
    let bound = unsafe { device.bind_buffer_memory(raw, allocation.memory(), allocation.offset()) };
    let memory = Memory { raw, allocation };
    if let Err(e) = bound {
        memory.release(shared);
        return Err(vk_error(e));
    }
    Ok(memory)
}

impl Memory {
    fn release(self, shared: &Shared) {
        // SAFETY: the owner is being dropped; command lists that use a buffer hold its owner.
        unsafe { shared.raw.destroy_buffer(self.raw, None) };
        if let Err(e) = shared.allocator().free(self.allocation) {
            log::error!("free: {e}");
        }
    }
}

type ViewKey = (TexelFormat, u64, u64);

pub(super) struct BufferInner {
    pub(super) raw: vk::Buffer,
    pub(super) id: u64,
    pub(super) bytes: u64,
    pub(super) name: String,
    memory: Option<Memory>,
    views: Mutex<HashMap<ViewKey, vk::BufferView>>,
    shared: Arc<Shared>,
}

impl Drop for BufferInner {
    fn drop(&mut self) {
        for (_, view) in lock(&self.views).drain() {
            // SAFETY: command lists that use a view hold this buffer; none is left.
            unsafe { self.shared.raw.destroy_buffer_view(view, None) };
        }
        if let Some(memory) = self.memory.take() {
            memory.release(&self.shared);
        }
        self.shared.bytes.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

/// A device buffer, zero when made; clones share it.
#[derive(Clone)]
pub struct Buffer(pub(super) Arc<BufferInner>);

/// A range of a buffer.
#[derive(Clone)]
pub struct Slice {
    pub(super) buffer: Buffer,
    pub(super) offset: u64,
    pub(super) bytes: u64,
}

impl std::fmt::Debug for Slice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}[{}..+{}]", self.buffer.0.name, self.offset, self.bytes)
    }
}

impl Buffer {
    /// The whole buffer.
    #[must_use]
    pub fn all(&self) -> Slice {
        Slice { buffer: self.clone(), offset: 0, bytes: self.0.bytes }
    }

    /// `bytes` from `offset`, a multiple of 256.
    ///
    /// # Panics
    /// Where the range leaves the buffer or the offset is not aligned.
    #[must_use]
    pub fn slice(&self, offset: u64, bytes: u64) -> Slice {
        self.all().slice(offset, bytes)
    }

    /// Size in bytes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.0.bytes
    }
}

impl Slice {
    /// Size in bytes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// `bytes` from `offset` (a multiple of 256) of this range.
    ///
    /// # Panics
    /// Where the range leaves this one or the offset is not aligned.
    #[must_use]
    pub fn slice(&self, offset: u64, bytes: u64) -> Self {
        assert!(offset.is_multiple_of(ALIGNMENT), "{self:?}: offset {offset} is not aligned");
        assert!(bytes > 0 && offset + bytes <= self.bytes, "{self:?}: {offset}+{bytes} leaves the range");
        Self { buffer: self.buffer.clone(), offset: self.offset + offset, bytes }
    }

    /// The texel view of this range, made once.
    pub(super) fn view(&self, format: TexelFormat) -> Result<vk::BufferView> {
        let inner = &self.buffer.0;
        let mut views = lock(&inner.views);
        let key = (format, self.offset, self.bytes);
        if let Some(view) = views.get(&key) {
            return Ok(*view);
        }
        let (vk_format, texel) = match format {
            TexelFormat::Rgba32f => (vk::Format::R32G32B32A32_SFLOAT, 16),
            TexelFormat::R32f => (vk::Format::R32_SFLOAT, 4),
        };
        let texels = self.bytes / texel;
        if texels > inner.shared.info.max_texel_elements {
            return Err(Error::OutOfMemory(format!(
                "{self:?} has {texels} texels, the device allows {}",
                inner.shared.info.max_texel_elements
            )));
        }
        let info = vk::BufferViewCreateInfo::default()
            .buffer(inner.raw)
            .format(vk_format)
            .offset(self.offset)
            .range(texels * texel);
        // SAFETY: the range lies in the buffer, which has storage-texel usage and outlives the view.
        let view = unsafe { inner.shared.raw.create_buffer_view(&info, None) }.map_err(vk_error)?;
        views.insert(key, view);
        Ok(view)
    }
}

/// A host-visible buffer that uploads and downloads go through, piece by piece.
pub(super) struct Staging {
    memory: Memory,
}

impl Staging {
    fn new(shared: &Shared) -> Result<Self> {
        let usage = vk::BufferUsageFlags::TRANSFER_SRC | vk::BufferUsageFlags::TRANSFER_DST;
        Ok(Self { memory: allocate(shared, "staging", STAGING_BYTES, usage, MemoryLocation::GpuToCpu)? })
    }

    pub(super) fn destroy(self, shared: &Shared) {
        self.memory.release(shared);
    }

    fn bytes(&mut self) -> Result<&mut [u8]> {
        self.memory.allocation.mapped_slice_mut().ok_or_else(|| Error::Gpu("staging memory is not mapped".into()))
    }
}

/// What a buffer of `bytes` takes.
pub(super) fn buffer_bytes(bytes: u64) -> u64 {
    bytes.max(1).next_multiple_of(ALIGNMENT)
}

static NEXT_ID: AtomicU64 = AtomicU64::new(0);

impl Gpu {
    /// A zero-filled device buffer of `bytes` (rounded up to 256).
    pub fn buffer(&self, name: &str, bytes: u64) -> Result<Buffer> {
        let buffer = self.unset_buffer(name, bytes)?;
        let mut recorder = self.recorder();
        recorder.fill_zero(&buffer.all());
        recorder.finish()?.run()?;
        Ok(buffer)
    }

    /// The same with undefined contents, for what is written before it is read: no pass over large memory.
    pub fn unset_buffer(&self, name: &str, bytes: u64) -> Result<Buffer> {
        let bytes = buffer_bytes(bytes);
        let usage = vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::STORAGE_TEXEL_BUFFER
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST;
        let memory = allocate(&self.0, name, bytes, usage, MemoryLocation::GpuOnly)?;
        let now = self.0.bytes.fetch_add(bytes, Ordering::Relaxed) + bytes;
        self.0.peak_bytes.fetch_max(now, Ordering::Relaxed);
        Ok(Buffer(Arc::new(BufferInner {
            raw: memory.raw,
            id: NEXT_ID.fetch_add(1, Ordering::Relaxed),
            bytes,
            name: name.to_owned(),
            memory: Some(memory),
            views: Mutex::default(),
            shared: self.0.clone(),
        })))
    }

    fn with_staging<R>(&self, f: impl FnOnce(&mut Staging) -> Result<R>) -> Result<R> {
        let mut guard = lock(&self.0.staging);
        if guard.is_none() {
            *guard = Some(Staging::new(&self.0)?);
        }
        f(guard.as_mut().expect("made above"))
    }

    /// Copies `data` to the start of `dst`.
    ///
    /// # Panics
    /// Where `data` is longer than `dst`.
    pub fn upload<T: Pod>(&self, dst: &Slice, data: &[T]) -> Result<()> {
        let bytes: &[u8] = bytemuck::cast_slice(data);
        assert!(bytes.len() as u64 <= dst.bytes, "upload of {} bytes to {dst:?}", bytes.len());
        self.with_staging(|staging| {
            for (i, chunk) in bytes.chunks(STAGING_BYTES as usize).enumerate() {
                staging.bytes()?[..chunk.len()].copy_from_slice(chunk);
                let at = dst.offset + i as u64 * STAGING_BYTES;
                self.copy_now(staging.memory.raw, 0, dst.buffer.0.raw, at, chunk.len() as u64)?;
            }
            Ok(())
        })
    }

    /// Reads `src` back.
    ///
    /// # Panics
    /// Where the size of `src` is no multiple of `T`'s.
    pub fn download<T: Pod>(&self, src: &Slice) -> Result<Vec<T>> {
        assert!(src.bytes.is_multiple_of(size_of::<T>() as u64), "download of {src:?}");
        let mut out = vec![T::zeroed(); src.bytes as usize / size_of::<T>()];
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut out);
        self.with_staging(|staging| {
            for (i, chunk) in bytes.chunks_mut(STAGING_BYTES as usize).enumerate() {
                let at = src.offset + i as u64 * STAGING_BYTES;
                self.copy_now(src.buffer.0.raw, at, staging.memory.raw, 0, chunk.len() as u64)?;
                chunk.copy_from_slice(&staging.bytes()?[..chunk.len()]);
            }
            Ok(())
        })?;
        Ok(out)
    }
}
