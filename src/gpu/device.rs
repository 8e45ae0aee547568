//! The device, its queue and its memory.

use super::instance::{Instance, no_device};
use super::matrix::{self, MatrixShape};
use crate::{Error, Result};
use ash::{khr, vk};
use gpu_allocator::vulkan::{Allocator, AllocatorCreateDesc};
use std::collections::HashMap;
use std::mem::ManuallyDrop;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Buffers up to this size share blocks of it; larger ones have memory of their own, so that no more than a few blocks are
/// reserved beyond what buffers take.
const BLOCK_BYTES: u64 = 16 << 20;

/// Which device to use, and how.
#[derive(Clone, Debug)]
pub struct DeviceOptions {
    /// Index in [`list_devices`] or a part of the name; by default the most capable device.
    pub select: Option<String>,
    /// Turn on the Khronos validation layer; its messages are kept for [`Gpu::drain_validation`].
    pub validation: bool,
    /// Folder for what is kept from one process to the next; none to keep nothing.
    pub cache: Option<PathBuf>,
}

impl Default for DeviceOptions {
    /// The most capable device, no validation, limpid's folder in the user's cache directory.
    fn default() -> Self {
        Self { select: None, validation: false, cache: super::environment::cache_folder() }
    }
}

/// What a device is and can do.
#[derive(Clone, Debug, serde::Serialize)]
pub struct DeviceInfo {
    /// Position in the list of devices.
    pub index: usize,
    /// Device name.
    pub name: String,
    /// Driver name and version text.
    pub driver: String,
    /// Vulkan version, e.g. `1.3.230`.
    pub api_version: String,
    /// `discrete`, `integrated`, `virtual`, `cpu` or `other`.
    pub kind: &'static str,
    /// Whether the driver runs on the CPU.
    pub is_cpu: bool,
    /// Invocations in a subgroup.
    pub subgroup_size: u32,
    /// Whether compute shaders may shuffle within a subgroup.
    pub subgroup_shuffle: bool,
    /// Shapes of cooperative matrices of f16 with sums in f32; empty where the device has none.
    pub cooperative_matrices: Vec<MatrixShape>,
    /// Whether the driver is known to make cooperative matrices without hardware for them.
    pub emulates_matrices: bool,
    /// Memory that the invocations of a workgroup share, bytes.
    pub max_shared_bytes: u32,
    /// Largest storage-buffer binding, bytes.
    pub max_storage_range: u64,
    /// Largest texel-buffer view, texels.
    pub max_texel_elements: u64,
    /// Largest single allocation, bytes.
    pub max_allocation: u64,
    /// Memory of the device: its largest heap that is its own, bytes.
    pub memory_bytes: u64,
    /// Largest number of workgroups in x.
    pub max_groups: u32,
    /// Largest number of invocations in a workgroup.
    pub max_invocations: u32,
    /// Nanoseconds a timestamp tick.
    pub timestamp_period_ns: f32,
    /// Identity of the device, hexadecimal.
    pub device_uuid: String,
    /// Identity of the driver's build, hexadecimal.
    pub driver_uuid: String,
    /// The driver's version as its vendor counts.
    pub driver_version: u32,
    /// Why limpid cannot use the device; empty where it can.
    pub unusable: String,
}

impl DeviceInfo {
    /// Whether a texel view reaches as far as a storage binding. Elsewhere shaders read through storage buffers.
    #[must_use]
    pub fn texel_views(&self) -> bool {
        self.max_texel_elements * 16 >= self.max_storage_range
    }

    /// The most bytes that a shader may read through one binding.
    #[must_use]
    pub fn max_read_range(&self) -> u64 {
        if self.texel_views() { self.max_texel_elements * 16 } else { self.max_storage_range }
    }
}

pub(super) struct Shared {
    pub(super) info: DeviceInfo,
    pub(super) raw: ash::Device,
    pub(super) queue: Mutex<vk::Queue>,
    pub(super) queue_family: u32,
    pub(super) disk: super::disk::Disk,
    allocator: ManuallyDrop<Mutex<Allocator>>,
    /// Pipelines by shader name and specialization words, so that equal kernels are made once.
    pub(super) kernels: Mutex<HashMap<super::kernel::KernelKey, Arc<super::kernel::Slot>>>,
    pub(super) bytes: AtomicU64,
    pub(super) peak_bytes: AtomicU64,
    pub(super) pipeline_ns: Arc<AtomicU64>,
    pub(super) staging: Mutex<Option<super::buffer::Staging>>,
    // Dropped last: the instance outlives the device.
    instance: Instance,
}

/// A Vulkan device; clones share it.
#[derive(Clone)]
pub struct Gpu(pub(super) Arc<Shared>);

/// Turns a Vulkan result into words.
pub(super) fn vk_error(result: vk::Result) -> Error {
    match result {
        vk::Result::ERROR_DEVICE_LOST => {
            Error::DeviceLost("a dispatch took longer than the system allows, or the driver failed".into())
        }
        vk::Result::ERROR_OUT_OF_DEVICE_MEMORY | vk::Result::ERROR_OUT_OF_HOST_MEMORY => {
            Error::OutOfMemory(format!("{result:?}; use a smaller image or batch"))
        }
        other => Error::Gpu(format!("Vulkan: {other:?}")),
    }
}

/// Locks, ignoring the poison of another thread's panic: the data are caches and counters.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn compute_family(instance: &ash::Instance, device: vk::PhysicalDevice) -> Option<u32> {
    // SAFETY: `device` came from this instance.
    let families = unsafe { instance.get_physical_device_queue_family_properties(device) };
    let fits =
        |f: &vk::QueueFamilyProperties| f.queue_flags.contains(vk::QueueFlags::COMPUTE) && f.timestamp_valid_bits > 0;
    families.iter().position(fits).map(|i| i as u32)
}

fn memory_bytes(instance: &ash::Instance, device: vk::PhysicalDevice) -> u64 {
    // SAFETY: `device` came from this instance.
    let memory = unsafe { instance.get_physical_device_memory_properties(device) };
    let own = |heap: &&vk::MemoryHeap| heap.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL);
    memory.memory_heaps_as_slice().iter().filter(own).map(|heap| heap.size).max().unwrap_or(0)
}

pub(super) fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn describe(instance: &Instance, device: vk::PhysicalDevice, index: usize) -> DeviceInfo {
    let cooperative_matrices = matrix::shapes(instance, device);
    let instance = &instance.raw;
    let mut v11 = vk::PhysicalDeviceVulkan11Properties::default();
    let mut v12 = vk::PhysicalDeviceVulkan12Properties::default();
    let mut v13 = vk::PhysicalDeviceVulkan13Properties::default();
    let mut all = vk::PhysicalDeviceProperties2::default().push_next(&mut v11).push_next(&mut v12).push_next(&mut v13);
    // SAFETY: `device` came from this instance; the chain lives until the call returns.
    unsafe { instance.get_physical_device_properties2(device, &mut all) };
    let p = all.properties;
    let text = |s: Option<&std::ffi::CStr>| s.map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let kind = match p.device_type {
        vk::PhysicalDeviceType::DISCRETE_GPU => "discrete",
        vk::PhysicalDeviceType::INTEGRATED_GPU => "integrated",
        vk::PhysicalDeviceType::VIRTUAL_GPU => "virtual",
        vk::PhysicalDeviceType::CPU => "cpu",
        _ => "other",
    };
    let (major, minor) = (vk::api_version_major(p.api_version), vk::api_version_minor(p.api_version));
    let mut unusable = String::new();
    if (major, minor) < (1, 3) {
        unusable = format!("it has Vulkan {major}.{minor}, limpid needs 1.3");
    } else if compute_family(instance, device).is_none() {
        unusable = "it has no compute queue with timestamps".into();
    }
    let driver = format!("{} {}", text(v12.driver_name_as_c_str().ok()), text(v12.driver_info_as_c_str().ok()));
    DeviceInfo {
        index,
        name: text(p.device_name_as_c_str().ok()),
        driver,
        api_version: format!("{major}.{minor}.{}", vk::api_version_patch(p.api_version)),
        kind,
        is_cpu: kind == "cpu",
        subgroup_size: v11.subgroup_size,
        subgroup_shuffle: v11.subgroup_supported_operations.contains(vk::SubgroupFeatureFlags::SHUFFLE)
            && v11.subgroup_supported_stages.contains(vk::ShaderStageFlags::COMPUTE),
        emulates_matrices: matrix::emulated(&cooperative_matrices, v12.driver_id, &v13),
        cooperative_matrices,
        max_shared_bytes: p.limits.max_compute_shared_memory_size,
        max_storage_range: u64::from(p.limits.max_storage_buffer_range),
        max_texel_elements: u64::from(p.limits.max_texel_buffer_elements),
        max_allocation: v11.max_memory_allocation_size,
        memory_bytes: memory_bytes(instance, device),
        max_groups: p.limits.max_compute_work_group_count[0],
        max_invocations: p.limits.max_compute_work_group_invocations,
        timestamp_period_ns: p.limits.timestamp_period,
        device_uuid: hexadecimal(&v11.device_uuid),
        driver_uuid: hexadecimal(&v11.driver_uuid),
        driver_version: p.driver_version,
        unusable,
    }
}

fn enumerate(instance: &Instance) -> Result<Vec<(vk::PhysicalDevice, DeviceInfo)>> {
    // SAFETY: plain query on a live instance.
    let devices = unsafe { instance.raw.enumerate_physical_devices() }.map_err(vk_error)?;
    Ok(devices.into_iter().enumerate().map(|(i, d)| (d, describe(instance, d, i))).collect())
}

/// All Vulkan devices, usable or not.
pub fn list_devices() -> Result<Vec<DeviceInfo>> {
    super::environment::prepare();
    Ok(enumerate(&Instance::new(false)?)?.into_iter().map(|(_, info)| info).collect())
}

fn pick(
    devices: Vec<(vk::PhysicalDevice, DeviceInfo)>,
    select: Option<&str>,
) -> Result<(vk::PhysicalDevice, DeviceInfo)> {
    let names: Vec<_> = devices.iter().map(|(_, d)| format!("{}: {}", d.index, d.name)).collect();
    let rank = |d: &DeviceInfo| match d.kind {
        "discrete" => 0,
        "integrated" => 1,
        "virtual" => 2,
        "cpu" => 3,
        _ => 4,
    };
    let chosen = match select {
        None => devices.into_iter().filter(|(_, d)| d.unusable.is_empty()).min_by_key(|(_, d)| rank(d)),
        Some(wanted) => {
            let by_index = wanted.parse::<usize>().ok();
            let matches = |d: &DeviceInfo| {
                by_index.map_or_else(|| d.name.to_lowercase().contains(&wanted.to_lowercase()), |i| i == d.index)
            };
            let found = devices.into_iter().find(|(_, d)| matches(d)).ok_or_else(|| {
                Error::input(format!("no Vulkan device matches `{wanted}`; there is: {}", names.join(", ")))
            })?;
            if !found.1.unusable.is_empty() {
                return Err(Error::input(format!("device {} cannot be used: {}", found.1.name, found.1.unusable)));
            }
            Some(found)
        }
    };
    chosen.ok_or_else(no_device)
}

fn create_device(
    instance: &ash::Instance,
    physical: vk::PhysicalDevice,
    family: u32,
    matrices: bool,
) -> Result<ash::Device> {
    let priorities = [1.0];
    let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&priorities)];
    // All of these are mandatory in Vulkan 1.3, but for f16.
    let mut v12 = vk::PhysicalDeviceVulkan12Features::default()
        .host_query_reset(true)
        .vulkan_memory_model(true)
        .shader_float16(matrices);
    let mut v13 = vk::PhysicalDeviceVulkan13Features::default()
        .synchronization2(true)
        .maintenance4(true)
        .subgroup_size_control(true)
        .compute_full_subgroups(true);
    let mut cooperative = vk::PhysicalDeviceCooperativeMatrixFeaturesKHR::default().cooperative_matrix(true);
    let extensions = [khr::cooperative_matrix::NAME.as_ptr()];
    let mut info = vk::DeviceCreateInfo::default().queue_create_infos(&queues).push_next(&mut v12).push_next(&mut v13);
    if matrices {
        info = info.enabled_extension_names(&extensions).push_next(&mut cooperative);
    }
    // SAFETY: `physical` came from this instance; `info` lives until the call returns.
    unsafe { instance.create_device(physical, &info, None) }.map_err(vk_error)
}

impl Gpu {
    /// Opens a device.
    pub fn new(options: &DeviceOptions) -> Result<Self> {
        super::environment::prepare();
        let instance = Instance::new(options.validation)?;
        let (physical, info) = pick(enumerate(&instance)?, options.select.as_deref())?;
        let queue_family = compute_family(&instance.raw, physical).ok_or_else(no_device)?;
        let raw = create_device(&instance.raw, physical, queue_family, !info.cooperative_matrices.is_empty())?;
        let allocator = Allocator::new(&AllocatorCreateDesc {
            instance: instance.raw.clone(),
            device: raw.clone(),
            physical_device: physical,
            debug_settings: gpu_allocator::AllocatorDebugSettings::default(),
            buffer_device_address: false,
            allocation_sizes: gpu_allocator::AllocationSizes::new(BLOCK_BYTES, BLOCK_BYTES),
        })
        .map_err(|e| Error::Gpu(format!("memory allocator: {e}")))?;
        let disk = super::disk::Disk::new(&instance.raw, physical, &raw, &info, options.cache.clone());
        // SAFETY: the family was requested with one queue.
        let queue = unsafe { raw.get_device_queue(queue_family, 0) };
        log::info!("device {} ({})", info.name, info.driver);
        Ok(Self(Arc::new(Shared {
            info,
            raw,
            queue: Mutex::new(queue),
            queue_family,
            disk,
            allocator: ManuallyDrop::new(Mutex::new(allocator)),
            kernels: Mutex::default(),
            bytes: AtomicU64::new(0),
            peak_bytes: AtomicU64::new(0),
            pipeline_ns: Arc::default(),
            staging: Mutex::new(None),
            instance,
        })))
    }

    /// What the device is and can do.
    #[must_use]
    pub fn info(&self) -> &DeviceInfo {
        &self.0.info
    }

    /// The validation messages caused by the calling thread since it last asked.
    #[must_use]
    pub fn drain_validation(&self) -> Vec<String> {
        self.0.instance.messages.drain()
    }

    /// A file for what is kept from one process to the next and holds for this device, its driver and these shaders only;
    /// none where nothing is kept.
    #[must_use]
    pub fn cache_file(&self, name: &str) -> Option<PathBuf> {
        self.0.disk.file(name)
    }

    /// Largest sum of buffer sizes so far, bytes.
    #[must_use]
    pub fn peak_bytes(&self) -> u64 {
        self.0.peak_bytes.load(Ordering::Relaxed)
    }

    /// Device memory reserved at the moment, for transfers too, bytes.
    #[must_use]
    pub fn reserved_bytes(&self) -> u64 {
        self.0.allocator().capacity()
    }

    /// Time spent creating the pipelines asked for so far, milliseconds, summed over threads; waits for them.
    #[must_use]
    pub fn pipeline_ms(&self) -> f64 {
        for slot in lock(&self.0.kernels).values() {
            // A failure shows where the pipeline is used.
            let _ = slot.get();
        }
        self.0.pipeline_ns.load(Ordering::Relaxed) as f64 * 1e-6
    }
}

impl Shared {
    pub(super) fn validates(&self) -> bool {
        self.instance.validates()
    }

    pub(super) fn allocator(&self) -> MutexGuard<'_, Allocator> {
        lock(&self.allocator)
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        // SAFETY: every buffer, kernel and command list holds this `Shared`, so all are gone but the caches below, which go
        // first; then the allocator's memory, then the device.
        unsafe {
            let _ = self.raw.device_wait_idle();
            if let Some(staging) = lock(&self.staging).take() {
                staging.destroy(self);
            }
            for (_, slot) in lock(&self.kernels).drain() {
                if let Ok(pipeline) = slot.get() {
                    pipeline.destroy(&self.raw);
                }
            }
            self.disk.close(&self.raw);
            ManuallyDrop::drop(&mut self.allocator);
            self.raw.destroy_device(None);
        }
    }
}
