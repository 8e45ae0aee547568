//! Compute pipelines, made on threads of their own while the caller goes on.

use super::device::{Gpu, lock, vk_error};
use super::{BindingKind, Shader, Specialization};
use crate::Result;
use ash::prelude::VkResult;
use ash::vk;
use std::marker::PhantomData;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Instant;

pub(super) type KernelKey = (&'static str, Vec<u32>, Option<u32>);

/// A pipeline with its layouts.
pub(super) struct Pipeline {
    pub(super) raw: vk::Pipeline,
    pub(super) layout: vk::PipelineLayout,
    pub(super) set_layout: vk::DescriptorSetLayout,
    module: vk::ShaderModule,
}

impl Pipeline {
    pub(super) fn destroy(&self, device: &ash::Device) {
        // SAFETY: called when the device goes; nothing is in flight.
        unsafe {
            device.destroy_pipeline(self.raw, None);
            device.destroy_pipeline_layout(self.layout, None);
            device.destroy_descriptor_set_layout(self.set_layout, None);
            device.destroy_shader_module(self.module, None);
        }
    }
}

enum State {
    Making(JoinHandle<VkResult<Pipeline>>),
    Made(VkResult<Arc<Pipeline>>),
}

/// A pipeline that is made or being made.
pub(super) struct Slot(Mutex<State>);

impl Slot {
    /// The pipeline, waited for.
    pub(super) fn get(&self) -> Result<Arc<Pipeline>> {
        let mut state = lock(&self.0);
        let made = match std::mem::replace(&mut *state, State::Made(Err(vk::Result::ERROR_UNKNOWN))) {
            State::Making(thread) => thread.join().unwrap_or(Err(vk::Result::ERROR_UNKNOWN)).map(Arc::new),
            State::Made(made) => made,
        };
        *state = State::Made(made.clone());
        made.map_err(vk_error)
    }
}

/// A shader made ready with its specialization constants; clones share it.
pub struct Kernel<S> {
    pub(super) pipeline: Arc<Slot>,
    shader: PhantomData<fn() -> S>,
}

impl<S> Clone for Kernel<S> {
    fn clone(&self) -> Self {
        Self { pipeline: self.pipeline.clone(), shader: PhantomData }
    }
}

fn push_bytes<S: Shader>() -> u32 {
    S::PUSH.iter().map(|m| m.offset as u32 + 4).max().unwrap_or(0)
}

/// How a binding is made on a device.
pub(super) fn descriptor_type(kind: BindingKind, texel_views: bool) -> vk::DescriptorType {
    match kind {
        BindingKind::TexelBuffer(_) if texel_views => vk::DescriptorType::STORAGE_TEXEL_BUFFER,
        BindingKind::TexelBuffer(_) | BindingKind::StorageBuffer => vk::DescriptorType::STORAGE_BUFFER,
    }
}

fn set_layout<S: Shader>(device: &ash::Device, texel_views: bool) -> VkResult<vk::DescriptorSetLayout> {
    let bindings: Vec<_> = S::BINDINGS
        .iter()
        .map(|b| {
            vk::DescriptorSetLayoutBinding::default()
                .binding(b.binding)
                .descriptor_type(descriptor_type(b.kind, texel_views))
                .descriptor_count(1)
                .stage_flags(vk::ShaderStageFlags::COMPUTE)
        })
        .collect();
    let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
    // SAFETY: `info` lives until the call returns.
    unsafe { device.create_descriptor_set_layout(&info, None) }
}

/// What making a pipeline takes, without the device's owner: a thread must not be the last to hold it.
#[derive(Clone)]
struct Maker {
    device: ash::Device,
    cache: vk::PipelineCache,
    texel_views: bool,
    words: Vec<u32>,
    subgroup: Option<u32>,
    spent_ns: Arc<AtomicU64>,
}

impl Maker {
    fn make<S: Shader>(&self) -> VkResult<Pipeline> {
        let start = Instant::now();
        let made = create::<S>(self);
        let elapsed = start.elapsed();
        log::debug!("pipeline {} {:?}: {:.1} ms", S::NAME, self.words, elapsed.as_secs_f64() * 1e3);
        self.spent_ns.fetch_add(elapsed.as_nanos() as u64, Ordering::Relaxed);
        made
    }
}

fn create<S: Shader>(maker: &Maker) -> VkResult<Pipeline> {
    let Maker { device, cache, texel_views, words, subgroup, .. } = maker;
    let code: Vec<u32> = bytemuck::pod_collect_to_vec(if *texel_views { S::SPIRV } else { S::SPIRV_WITHOUT_TEXELS });
    // SAFETY: `code` is a module that shaderc wrote; every `info` lives until its call returns.
    unsafe {
        let module = device.create_shader_module(&vk::ShaderModuleCreateInfo::default().code(&code), None)?;
        let set_layout = set_layout::<S>(device, *texel_views)?;
        let range = vk::PushConstantRange::default().stage_flags(vk::ShaderStageFlags::COMPUTE).size(push_bytes::<S>());
        let (sets, ranges) = ([set_layout], [range]);
        let mut info = vk::PipelineLayoutCreateInfo::default().set_layouts(&sets);
        if range.size > 0 {
            info = info.push_constant_ranges(&ranges);
        }
        let layout = device.create_pipeline_layout(&info, None)?;
        let entries: Vec<_> = (0u32..)
            .zip(S::SPEC_IDS)
            .map(|(i, id)| vk::SpecializationMapEntry { constant_id: *id, offset: i * 4, size: 4 })
            .collect();
        let special = vk::SpecializationInfo::default().map_entries(&entries).data(bytemuck::cast_slice(words));
        let mut required = vk::PipelineShaderStageRequiredSubgroupSizeCreateInfo::default();
        let mut stage = vk::PipelineShaderStageCreateInfo::default()
            .stage(vk::ShaderStageFlags::COMPUTE)
            .module(module)
            .name(c"main")
            .specialization_info(&special);
        if let Some(size) = subgroup {
            required = required.required_subgroup_size(*size);
            stage = stage.flags(vk::PipelineShaderStageCreateFlags::REQUIRE_FULL_SUBGROUPS).push_next(&mut required);
        }
        let info = vk::ComputePipelineCreateInfo::default().stage(stage).layout(layout);
        let raw = device.create_compute_pipelines(*cache, &[info], None).map_err(|(_, e)| e)?[0];
        Ok(Pipeline { raw, layout, set_layout, module })
    }
}

/// None where the system has no thread to give.
fn spawn<S: Shader>(maker: &Maker) -> Option<JoinHandle<VkResult<Pipeline>>> {
    let maker = maker.clone();
    std::thread::Builder::new().name(S::NAME.into()).spawn(move || maker.make::<S>()).ok()
}

impl Gpu {
    /// The kernel of a shader with these specialization constants; equal ones are made once. Where the driver cannot make it,
    /// the recording that uses it fails.
    pub fn kernel<S: Shader>(&self, spec: &S::Spec) -> Result<Kernel<S>> {
        self.kernel_of::<S>(spec, None)
    }

    /// The same, with full subgroups of exactly `size` invocations.
    pub fn kernel_with_subgroup<S: Shader>(&self, spec: &S::Spec, size: u32) -> Result<Kernel<S>> {
        self.kernel_of::<S>(spec, Some(size))
    }

    /// Shader and specialization constants of every kernel made or asked for so far, sorted.
    #[must_use]
    pub fn kernels(&self) -> Vec<(&'static str, Vec<u32>)> {
        let mut all: Vec<_> = lock(&self.0.kernels).keys().map(|(name, words, _)| (*name, words.clone())).collect();
        all.sort();
        all
    }

    fn kernel_of<S: Shader>(&self, spec: &S::Spec, subgroup: Option<u32>) -> Result<Kernel<S>> {
        let words = spec.words();
        let mut kernels = lock(&self.0.kernels);
        let key = (S::NAME, words.clone(), subgroup);
        if let Some(pipeline) = kernels.get(&key) {
            return Ok(Kernel { pipeline: pipeline.clone(), shader: PhantomData });
        }
        let maker = Maker {
            device: self.0.raw.clone(),
            cache: self.0.disk.pipelines,
            texel_views: self.0.info.texel_views(),
            words,
            subgroup,
            spent_ns: self.0.pipeline_ns.clone(),
        };
        // Validation reports in the thread that made the call: it stays the caller's.
        let thread = if self.0.validates() { None } else { spawn::<S>(&maker) };
        let state = thread.map_or_else(|| State::Made(maker.make::<S>().map(Arc::new)), State::Making);
        let pipeline = Arc::new(Slot(Mutex::new(state)));
        kernels.insert(key, pipeline.clone());
        Ok(Kernel { pipeline, shader: PhantomData })
    }
}
