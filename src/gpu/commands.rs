//! Recording dispatches, fills and copies into command lists that can be run many times.

use super::buffer::Slice;
use super::device::{Gpu, lock, vk_error};
use super::hazard::{AccessRange, Event};
use super::kernel::{Kernel, Pipeline, Slot, descriptor_type};
use super::{Access, Binding, BindingKind, Bindings, PushBlock, Shader};
use crate::{Error, Result};
use ash::vk;
use std::sync::Arc;
use std::time::Instant;

struct Dispatch {
    name: &'static str,
    pipeline: Arc<Slot>,
    bindings: &'static [Binding],
    slices: Vec<Slice>,
    push: Vec<u8>,
    groups: [u32; 3],
}

enum Operation {
    Dispatch(Dispatch),
    Fill(Slice),
    Copy(Slice, Slice),
}

impl Operation {
    fn name(&self) -> &'static str {
        match self {
            Self::Dispatch(d) => d.name,
            Self::Fill(_) => "fill",
            Self::Copy(..) => "copy",
        }
    }

    fn accesses(&self) -> Vec<AccessRange> {
        let range = |slice: &Slice, write| AccessRange {
            buffer: slice.buffer.0.id,
            begin: slice.offset,
            end: slice.offset + slice.bytes,
            write,
        };
        match self {
            Self::Dispatch(d) => {
                d.bindings.iter().zip(&d.slices).map(|(b, slice)| range(slice, b.access != Access::Read)).collect()
            }
            Self::Fill(dst) => vec![range(dst, true)],
            Self::Copy(src, dst) => vec![range(src, false), range(dst, true)],
        }
    }
}

/// Collects operations; barriers between them are derived from what each reads and writes.
pub struct Recorder {
    gpu: Gpu,
    operations: Vec<Operation>,
    per_dispatch: bool,
}

/// Times of one run.
#[derive(Clone, Debug, Default)]
pub struct Timings {
    /// From the first operation's start to the last one's end, milliseconds on the device.
    pub device_ms: f64,
    /// From submission to the return of the wait, milliseconds on the host.
    pub wall_ms: f64,
    /// When it was submitted; none where nothing ran.
    pub submitted: Option<Instant>,
    /// Shader name and milliseconds of each operation; empty unless [`Recorder::time_each`] was called.
    pub operations: Vec<(&'static str, f64)>,
}

/// A recorded command list.
pub struct Commands {
    gpu: Gpu,
    operations: Vec<Operation>,
    events: Vec<Event>,
    per_dispatch: bool,
    pool: vk::CommandPool,
    buffer: vk::CommandBuffer,
    descriptors: vk::DescriptorPool,
    queries: vk::QueryPool,
    query_count: u32,
    fence: vk::Fence,
}

impl Gpu {
    /// An empty recorder.
    #[must_use]
    pub fn recorder(&self) -> Recorder {
        Recorder { gpu: self.clone(), operations: Vec::new(), per_dispatch: false }
    }

    /// One copy between raw buffers, waited for.
    pub(super) fn copy_now(
        &self,
        src: vk::Buffer,
        src_at: u64,
        dst: vk::Buffer,
        dst_at: u64,
        bytes: u64,
    ) -> Result<()> {
        let mut commands = Commands::empty(self, 0, 0)?;
        let device = &self.0.raw;
        let region = vk::BufferCopy { src_offset: src_at, dst_offset: dst_at, size: bytes };
        // SAFETY: the caller keeps both buffers alive and the ranges inside them.
        unsafe {
            commands.begin()?;
            device.cmd_copy_buffer(commands.buffer, src, dst, &[region]);
            commands.end()?;
        }
        commands.run()?;
        Ok(())
    }
}

impl Recorder {
    /// Times every operation on its own (slows short ones down on GPUs).
    pub fn time_each(&mut self) {
        self.per_dispatch = true;
    }

    /// Operations so far.
    #[must_use]
    pub fn len(&self) -> usize {
        self.operations.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.operations.is_empty()
    }

    /// Adds a dispatch of `groups` workgroups.
    ///
    /// # Panics
    /// Where a storage binding is larger than the device allows: callers split their work before.
    pub fn dispatch<S: Shader, P: PushBlock<Shader = S>>(
        &mut self,
        kernel: &Kernel<S>,
        bind: &S::Bind,
        push: &P,
        groups: [u32; 3],
    ) {
        let slices: Vec<Slice> = bind.slices().into_iter().cloned().collect();
        let limit = self.gpu.0.info.max_storage_range;
        for (b, slice) in S::BINDINGS.iter().zip(&slices) {
            let fits = b.kind != BindingKind::StorageBuffer || slice.bytes <= limit;
            assert!(fits, "{}: {} binds {slice:?}, the device's limit is {limit} bytes", S::NAME, b.name);
        }
        let max = self.gpu.0.info.max_groups;
        assert!(groups.iter().all(|g| *g > 0 && *g <= max), "{}: {groups:?} workgroups", S::NAME);
        self.operations.push(Operation::Dispatch(Dispatch {
            name: S::NAME,
            pipeline: kernel.pipeline.clone(),
            bindings: S::BINDINGS,
            slices,
            push: bytemuck::bytes_of(push).to_vec(),
            groups,
        }));
    }

    /// Sets a range to zero.
    pub fn fill_zero(&mut self, dst: &Slice) {
        self.operations.push(Operation::Fill(dst.clone()));
    }

    /// Copies the whole of `src` to the start of `dst`.
    ///
    /// # Panics
    /// Where `dst` is smaller.
    pub fn copy(&mut self, src: &Slice, dst: &Slice) {
        assert!(dst.bytes >= src.bytes, "copy of {src:?} to {dst:?}");
        self.operations.push(Operation::Copy(src.clone(), dst.clone()));
    }

    /// Puts a barrier wherever an operation touches what an earlier one wrote, or writes what an earlier one touched.
    fn events(&self) -> Vec<Event> {
        let mut events = Vec::new();
        let mut pending: Vec<AccessRange> = Vec::new();
        for operation in &self.operations {
            let accesses = operation.accesses();
            if accesses.iter().any(|a| pending.iter().any(|p| a.conflicts(p))) {
                events.push(Event::Barrier);
                pending.clear();
            }
            pending.extend(accesses.iter().cloned());
            events.push(Event::Operation { name: operation.name().into(), accesses });
        }
        events
    }

    /// Writes the descriptor sets and the command buffer.
    pub fn finish(self) -> Result<Commands> {
        let count = self.operations.len() as u32;
        let queries = if self.per_dispatch { count + 1 } else { 2 };
        let mut commands = Commands::empty(&self.gpu, count, queries)?;
        commands.events = self.events();
        commands.operations = self.operations;
        commands.per_dispatch = self.per_dispatch;
        // SAFETY: the operations, and with them every buffer and pipeline, live as long as the command buffer.
        unsafe { commands.record()? };
        Ok(commands)
    }
}

impl Commands {
    fn empty(gpu: &Gpu, dispatches: u32, query_count: u32) -> Result<Self> {
        let device = &gpu.0.raw;
        let mut this = Self {
            gpu: gpu.clone(),
            operations: Vec::new(),
            events: Vec::new(),
            per_dispatch: false,
            pool: vk::CommandPool::null(),
            buffer: vk::CommandBuffer::null(),
            descriptors: vk::DescriptorPool::null(),
            queries: vk::QueryPool::null(),
            query_count,
            fence: vk::Fence::null(),
        };
        // SAFETY: plain creation; on failure `this` drops what exists (destroying a null handle is allowed).
        unsafe {
            let info = vk::CommandPoolCreateInfo::default().queue_family_index(gpu.0.queue_family);
            this.pool = device.create_command_pool(&info, None).map_err(vk_error)?;
            let info = vk::CommandBufferAllocateInfo::default().command_pool(this.pool).command_buffer_count(1);
            this.buffer = device.allocate_command_buffers(&info).map_err(vk_error)?[0];
            if dispatches > 0 {
                let size = |ty| vk::DescriptorPoolSize { ty, descriptor_count: dispatches * 16 };
                let sizes = [size(vk::DescriptorType::STORAGE_BUFFER), size(vk::DescriptorType::STORAGE_TEXEL_BUFFER)];
                let info = vk::DescriptorPoolCreateInfo::default().max_sets(dispatches).pool_sizes(&sizes);
                this.descriptors = device.create_descriptor_pool(&info, None).map_err(vk_error)?;
            }
            if query_count > 0 {
                let info =
                    vk::QueryPoolCreateInfo::default().query_type(vk::QueryType::TIMESTAMP).query_count(query_count);
                this.queries = device.create_query_pool(&info, None).map_err(vk_error)?;
            }
            this.fence = device.create_fence(&vk::FenceCreateInfo::default(), None).map_err(vk_error)?;
        }
        Ok(this)
    }

    unsafe fn begin(&mut self) -> Result<()> {
        let device = &self.gpu.0.raw;
        // SAFETY: the buffer is in its initial state.
        unsafe {
            device.begin_command_buffer(self.buffer, &vk::CommandBufferBeginInfo::default()).map_err(vk_error)?;
            self.barrier();
        }
        Ok(())
    }

    unsafe fn end(&mut self) -> Result<()> {
        // SAFETY: recording is under way.
        unsafe {
            let barrier = [vk::MemoryBarrier2::default()
                .src_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
                .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
                .dst_stage_mask(vk::PipelineStageFlags2::HOST)
                .dst_access_mask(vk::AccessFlags2::HOST_READ)];
            let info = vk::DependencyInfo::default().memory_barriers(&barrier);
            self.gpu.0.raw.cmd_pipeline_barrier2(self.buffer, &info);
            self.gpu.0.raw.end_command_buffer(self.buffer).map_err(vk_error)
        }
    }

    unsafe fn barrier(&self) {
        let stages = vk::PipelineStageFlags2::COMPUTE_SHADER | vk::PipelineStageFlags2::ALL_TRANSFER;
        let barrier = [vk::MemoryBarrier2::default()
            .src_stage_mask(stages)
            .src_access_mask(vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE)
            .dst_stage_mask(stages)
            .dst_access_mask(vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE)];
        let info = vk::DependencyInfo::default().memory_barriers(&barrier);
        // SAFETY: recording is under way.
        unsafe { self.gpu.0.raw.cmd_pipeline_barrier2(self.buffer, &info) };
    }

    unsafe fn record(&mut self) -> Result<()> {
        let device = self.gpu.0.raw.clone();
        // SAFETY: see `finish`.
        unsafe {
            self.begin()?;
            device.cmd_reset_query_pool(self.buffer, self.queries, 0, self.query_count);
            let top = vk::PipelineStageFlags2::ALL_COMMANDS;
            device.cmd_write_timestamp2(self.buffer, top, self.queries, 0);
            let mut operations = self.operations.iter();
            let mut query = 1;
            for event in &self.events {
                match event {
                    Event::Barrier => self.barrier(),
                    Event::Operation { .. } => {
                        self.record_operation(operations.next().expect("one event an operation"))?;
                        if self.per_dispatch {
                            device.cmd_write_timestamp2(self.buffer, top, self.queries, query);
                            query += 1;
                        }
                    }
                }
            }
            if !self.per_dispatch {
                device.cmd_write_timestamp2(self.buffer, top, self.queries, 1);
            }
            self.end()
        }
    }

    unsafe fn record_operation(&self, operation: &Operation) -> Result<()> {
        let device = &self.gpu.0.raw;
        // SAFETY: handles are alive (held by the operation), ranges were checked when the slices were made.
        unsafe {
            match operation {
                Operation::Fill(dst) => {
                    device.cmd_fill_buffer(self.buffer, dst.buffer.0.raw, dst.offset, dst.bytes.next_multiple_of(4), 0)
                }
                Operation::Copy(src, dst) => {
                    let region = vk::BufferCopy { src_offset: src.offset, dst_offset: dst.offset, size: src.bytes };
                    device.cmd_copy_buffer(self.buffer, src.buffer.0.raw, dst.buffer.0.raw, &[region]);
                }
                Operation::Dispatch(d) => {
                    let pipeline = d.pipeline.get()?;
                    let set = self.descriptor_set(d, &pipeline)?;
                    let bind = vk::PipelineBindPoint::COMPUTE;
                    device.cmd_bind_pipeline(self.buffer, bind, pipeline.raw);
                    device.cmd_bind_descriptor_sets(self.buffer, bind, pipeline.layout, 0, &[set], &[]);
                    if !d.push.is_empty() {
                        let stage = vk::ShaderStageFlags::COMPUTE;
                        device.cmd_push_constants(self.buffer, pipeline.layout, stage, 0, &d.push);
                    }
                    device.cmd_dispatch(self.buffer, d.groups[0], d.groups[1], d.groups[2]);
                }
            }
        }
        Ok(())
    }

    unsafe fn descriptor_set(&self, d: &Dispatch, pipeline: &Pipeline) -> Result<vk::DescriptorSet> {
        let device = &self.gpu.0.raw;
        let layouts = [pipeline.set_layout];
        let info = vk::DescriptorSetAllocateInfo::default().descriptor_pool(self.descriptors).set_layouts(&layouts);
        // SAFETY: the pool has room for one set a dispatch.
        let set = unsafe { device.allocate_descriptor_sets(&info) }.map_err(vk_error)?[0];
        let mut buffers = Vec::with_capacity(d.slices.len());
        let mut views = Vec::with_capacity(d.slices.len());
        let info = &self.gpu.0.info;
        for (b, slice) in d.bindings.iter().zip(&d.slices) {
            if !info.texel_views() && slice.bytes > info.max_storage_range {
                let most = info.max_storage_range;
                return Err(Error::OutOfMemory(format!("{slice:?}: {} may read {most} bytes at once", info.name)));
            }
            buffers.push([vk::DescriptorBufferInfo {
                buffer: slice.buffer.0.raw,
                offset: slice.offset,
                range: slice.bytes,
            }]);
            views.push([match b.kind {
                BindingKind::TexelBuffer(format) if info.texel_views() => slice.view(format)?,
                BindingKind::TexelBuffer(_) | BindingKind::StorageBuffer => vk::BufferView::null(),
            }]);
        }
        let writes: Vec<_> = (d.bindings.iter().zip(&buffers).zip(&views))
            .map(|((b, buffer), view)| {
                let ty = descriptor_type(b.kind, info.texel_views());
                let write = vk::WriteDescriptorSet::default().dst_set(set).dst_binding(b.binding).descriptor_type(ty);
                match ty {
                    vk::DescriptorType::STORAGE_BUFFER => write.buffer_info(buffer),
                    _ => write.texel_buffer_view(view),
                }
            })
            .collect();
        // SAFETY: the set is unused so far; buffers and views live as long as this command list.
        unsafe { device.update_descriptor_sets(&writes, &[]) };
        Ok(set)
    }

    /// What was recorded, for [`super::hazard::check`].
    #[must_use]
    pub fn events(&self) -> &[Event] {
        &self.events
    }

    /// Submits the list and waits for its end.
    pub fn run(&mut self) -> Result<Timings> {
        let device = &self.gpu.0.raw;
        let start = Instant::now();
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(self.buffer)];
        let submit = [vk::SubmitInfo2::default().command_buffer_infos(&buffers)];
        // SAFETY: the command buffer is recorded and not in flight (`&mut self`, and every run is waited for).
        unsafe {
            device.queue_submit2(*lock(&self.gpu.0.queue), &submit, self.fence).map_err(vk_error)?;
            device.wait_for_fences(&[self.fence], true, u64::MAX).map_err(vk_error)?;
            device.reset_fences(&[self.fence]).map_err(vk_error)?;
        }
        let wall_ms = start.elapsed().as_secs_f64() * 1e3;
        if self.query_count == 0 {
            return Ok(Timings { wall_ms, submitted: Some(start), ..Timings::default() });
        }
        let mut ticks = vec![0u64; self.query_count as usize];
        // SAFETY: the run has ended, so all queries are available.
        unsafe {
            device
                .get_query_pool_results(
                    self.queries,
                    0,
                    &mut ticks,
                    vk::QueryResultFlags::TYPE_64 | vk::QueryResultFlags::WAIT,
                )
                .map_err(vk_error)?;
        }
        let ms = |a: u64, b: u64| b.saturating_sub(a) as f64 * f64::from(self.gpu.0.info.timestamp_period_ns) * 1e-6;
        let operations = if self.per_dispatch {
            self.operations.iter().zip(ticks.windows(2)).map(|(o, t)| (o.name(), ms(t[0], t[1]))).collect()
        } else {
            Vec::new()
        };
        let device_ms = ms(ticks[0], ticks[ticks.len() - 1]);
        Ok(Timings { device_ms, wall_ms, submitted: Some(start), operations })
    }
}

impl Drop for Commands {
    fn drop(&mut self) {
        let device = &self.gpu.0.raw;
        // SAFETY: every run was waited for; a lost device has nothing in flight.
        unsafe {
            device.destroy_fence(self.fence, None);
            device.destroy_query_pool(self.queries, None);
            device.destroy_descriptor_pool(self.descriptors, None);
            device.destroy_command_pool(self.pool, None);
        }
    }
}
