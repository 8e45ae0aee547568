//! What is kept on disk from one process to the next: compiled pipelines, and files of other modules for the same device.
//!
//! A file that is missing, damaged or foreign counts as none, and one that cannot be written is left out: nothing here fails
//! for a disk. Files appear whole, by renaming, so processes can share them.

use super::device::{DeviceInfo, hexadecimal};
use crate::image::file::write_atomically;
use crate::{Error, Result};
use ash::vk;
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// First bytes of a file of pipelines, before the SHA-256 of the driver's data.
const MAGIC: &[u8; 16] = b"limpid pipelines";
const HASH_BYTES: usize = 32;
/// More than any driver makes of limpid's kernels.
const MAX_BYTES: u64 = 256 << 20;

/// Where a device's files are, and its pipelines.
pub(super) struct Disk {
    folder: Option<PathBuf>,
    key: String,
    pub(super) pipelines: vk::PipelineCache,
    /// Bytes of the driver's data when it was made.
    begun_with: usize,
}

/// What the driver's data must begin with; drivers have crashed on those of others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Header {
    vendor: u32,
    device: u32,
    uuid: [u8; vk::UUID_SIZE],
}

impl Header {
    /// Length of itself, version 1, vendor, device, UUID: 32 bytes, little-endian.
    fn fits(&self, data: &[u8]) -> bool {
        let word = |i: usize| data.get(i * 4..i * 4 + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let length = word(0).unwrap_or(0) as usize;
        (32..=data.len()).contains(&length)
            && word(1) == Some(vk::PipelineCacheHeaderVersion::ONE.as_raw() as u32)
            && (word(2), word(3)) == (Some(self.vendor), Some(self.device))
            && data[16..32] == self.uuid
    }
}

/// The driver's data in a file; none where anything about it is wrong.
fn load(path: &Path, header: &Header) -> Option<Vec<u8>> {
    if std::fs::metadata(path).ok()?.len() > MAX_BYTES {
        return None;
    }
    let file = std::fs::read(path).ok()?;
    let (magic, rest) = file.split_at_checked(MAGIC.len())?;
    let (hash, data) = rest.split_at_checked(HASH_BYTES)?;
    let whole = magic == MAGIC && Sha256::digest(data)[..] == *hash && header.fits(data);
    if !whole {
        log::warn!("{}: damaged or foreign, ignored", path.display());
    }
    whole.then(|| data.to_vec())
}

fn store(path: &Path, data: &[u8]) -> Result<()> {
    let folder = path.parent().unwrap_or(path);
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
    write_atomically(path, |out| {
        let parts = [&MAGIC[..], &Sha256::digest(data), data];
        parts.into_iter().try_for_each(|part| out.write_all(part)).map_err(|e| Error::io(path, e))
    })
}

/// A name for all that a driver's code and the results of a check depend on.
fn key(info: &DeviceInfo, header: &Header) -> String {
    let text = format!(
        "limpid {} shaders {:x} device {} {} driver {} {} {} cache {header:?} subgroup {} environment {:?}",
        env!("CARGO_PKG_VERSION"),
        crate::shaders::HASH,
        info.name,
        info.device_uuid,
        info.driver,
        info.driver_uuid,
        info.driver_version,
        info.subgroup_size,
        std::env::var_os("LP_NATIVE_VECTOR_WIDTH"),
    );
    hexadecimal(&Sha256::digest(text)[..16])
}

impl Disk {
    pub(super) fn new(
        instance: &ash::Instance,
        physical: vk::PhysicalDevice,
        device: &ash::Device,
        info: &DeviceInfo,
        folder: Option<PathBuf>,
    ) -> Self {
        // SAFETY: `physical` came from this instance.
        let p = unsafe { instance.get_physical_device_properties(physical) };
        let header = Header { vendor: p.vendor_id, device: p.device_id, uuid: p.pipeline_cache_uuid };
        let mut this = Self { folder, key: key(info, &header), pipelines: vk::PipelineCache::null(), begun_with: 0 };
        let data = this.file("pipelines").and_then(|path| load(&path, &header)).unwrap_or_default();
        let create = |data: &[u8]| {
            let info = vk::PipelineCacheCreateInfo::default().initial_data(data);
            // SAFETY: `data` is none, or what this driver wrote, and lives until the call returns.
            unsafe { device.create_pipeline_cache(&info, None) }
        };
        this.pipelines = create(&data).or_else(|_| create(&[])).unwrap_or_default();
        this.begun_with = this.data(device).map_or(0, |data| data.len());
        this
    }

    /// A file of this device; none where nothing is kept.
    pub(super) fn file(&self, name: &str) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(name).join(&self.key))
    }

    fn data(&self, device: &ash::Device) -> Option<Vec<u8>> {
        if self.pipelines == vk::PipelineCache::null() {
            return None;
        }
        // SAFETY: the cache is live.
        unsafe { device.get_pipeline_cache_data(self.pipelines) }.ok()
    }

    /// Keeps what has been added, and gives the cache back.
    pub(super) fn close(&self, device: &ash::Device) {
        let grown = self.data(device).filter(|data| data.len() > self.begun_with);
        if let (Some(path), Some(data)) = (self.file("pipelines"), grown)
            && let Err(error) = store(&path, &data)
        {
            log::info!("pipelines are not kept: {error}");
        }
        // SAFETY: called when the device goes; nothing is in flight.
        unsafe { device.destroy_pipeline_cache(self.pipelines, None) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: Header = Header { vendor: 0x10de, device: 0x2330, uuid: *b"0123456789abcdef" };

    fn data() -> Vec<u8> {
        let words = [32, 1, HEADER.vendor, HEADER.device].map(u32::to_le_bytes).concat();
        [&words[..], &HEADER.uuid, b"pipelines"].concat()
    }

    #[test]
    fn only_whole_files_of_this_driver_are_loaded() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new folder/pipelines");
        assert_eq!(load(&path, &HEADER), None);
        store(&path, &data()).unwrap();
        assert_eq!(load(&path, &HEADER), Some(data()));
        for other in
            [Header { vendor: 1, ..HEADER }, Header { device: 1, ..HEADER }, Header { uuid: [0; 16], ..HEADER }]
        {
            assert_eq!(load(&path, &other), None, "{other:?}");
        }
        let file = std::fs::read(&path).unwrap();
        for length in 0..file.len() {
            std::fs::write(&path, &file[..length]).unwrap();
            assert_eq!(load(&path, &HEADER), None, "cut to {length} bytes");
        }
        for i in 0..file.len() {
            let mut damaged = file.clone();
            damaged[i] ^= 0x10;
            std::fs::write(&path, damaged).unwrap();
            assert_eq!(load(&path, &HEADER), None, "byte {i}");
        }
    }

    #[test]
    fn a_header_is_checked_field_by_field() {
        assert!(HEADER.fits(&data()));
        for (word, value) in [(0, 31u32), (0, 42), (0, u32::MAX), (1, 2), (2, 0), (3, 0)] {
            let mut wrong = data();
            wrong[word * 4..][..4].copy_from_slice(&value.to_le_bytes());
            assert!(!HEADER.fits(&wrong), "word {word} is {value}");
        }
        assert!(!HEADER.fits(&data()[..31]) && !HEADER.fits(&[]));
    }
}
