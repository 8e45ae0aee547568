//! Weight and bias gradients of the 3x3 convolution. The input gradient is the forward kernel with transposed weights.
//!
//! Sums over pixels are split; the parts are added in a fixed order, so that equal runs give equal bits and no invocation
//! loops longer than CPU drivers allow.

use super::coop;
use crate::Result;
use crate::gpu::{Buffer, Gpu, Recorder, Slice};
use crate::net::device::{Channels, DeviceTensor, Shape, groups};
use crate::net::kernel::{Family, conv2d::Layer};
use crate::{push_block, shaders};

push_block! {
    /// Push constants of `conv2d_weight_grad.comp`.
    pub struct PortablePush for shaders::conv2d_weight_grad {
        batch: u32, height: u32, width: u32, cin4: u32, cout: u32, splits: u32, count: u32,
    }
}
push_block! {
    /// Push constants of `conv2d_weight_grad_cpu.comp`.
    pub struct CpuPush for shaders::conv2d_weight_grad_cpu {
        batch: u32, height: u32, width: u32, cin4: u32, cout: u32, co_blocks: u32, splits: u32,
    }
}
push_block! {
    /// Push constants of `weight_grad_reduce.comp`.
    pub struct ReducePush for shaders::weight_grad_reduce {
        cin: u32, cout: u32, lanes: u32, cin4: u32, co_blocks: u32, splits: u32, segment: u32, segment_padded: u32,
    }
}
push_block! {
    /// Push constants of `transpose_pixels.comp`.
    pub struct TransposePush for shaders::transpose_pixels { height: u32, width: u32, c4: u32, count: u32 }
}
push_block! {
    /// Push constants of `bias_grad.comp`.
    pub struct BiasPush for shaders::bias_grad { rows: u32, width: u32, cout4: u32, parts: u32 }
}
push_block! {
    /// Push constants of `bias_grad_reduce.comp`.
    pub struct BiasReducePush for shaders::bias_grad_reduce { cout: u32, cout4: u32, parts: u32 }
}

/// Loop iterations that one invocation may spend: llvmpipe silently ends loops after 65,535.
const MAX_ITERATIONS: u64 = 30_000;
/// Subgroups or workgroups that a dispatch should at least have, so that all processors work.
const MIN_PARALLEL: u64 = 64;
/// Bytes that the sums of a weight gradient's splits should take at most.
const PARTIAL_BYTES: u64 = 64 << 20;
/// Pixels of a strip of `conv2d_weight_grad_cpu.comp`.
const STRIP: u32 = 12;
const LOCAL: u32 = 64;

/// Buffers that the weight gradients of a network's layers use one after another.
pub struct Scratch {
    family: Family,
    partial: Buffer,
    transposed: Option<Buffer>,
}

/// How a weight gradient is split.
struct Split {
    splits: u32,
    co_blocks: u32,
}

fn split(family: Family, layer: Layer, x: &Shape) -> Split {
    let cout = layer.cout.next_multiple_of(4);
    let co_blocks = cout.div_ceil(family.lanes());
    let cin4 = u64::from(layer.input.texels());
    let (iterations, most) = match family {
        // Rows of 1 + 10 * width iterations, pixel and tap loops together.
        Family::Portable => (u64::from(x.n) * u64::from(x.h) * (1 + 10 * u64::from(x.w)), x.n * x.h),
        Family::Cpu { .. } => {
            let strips = x.w.div_ceil(STRIP) * x.n;
            (u64::from(strips) * u64::from(x.h + 1), strips)
        }
        Family::Coop(_) => {
            let tiles = coop::tiles(x);
            (u64::from(tiles) * coop::TILE_ITERATIONS, tiles)
        }
    };
    let (parallel, least) = match family {
        Family::Portable => (cin4 * u64::from(co_blocks), MIN_PARALLEL),
        Family::Cpu { .. } => (cin4.div_ceil(2) * u64::from(co_blocks / co_group(co_blocks)), MIN_PARALLEL),
        Family::Coop(matrices) => (coop::workgroups(matrices, layer), coop::MIN_WORKGROUPS),
    };
    let wanted = match family {
        // A strip each, as far as memory goes: what all channels read of a strip then stays in the cache.
        Family::Cpu { .. } => PARTIAL_BYTES / split_bytes(family, layer, co_blocks),
        Family::Portable | Family::Coop(_) => least.div_ceil(parallel),
    };
    let splits = iterations.div_ceil(MAX_ITERATIONS).max(wanted).max(least.div_ceil(parallel));
    Split { splits: splits.min(u64::from(most)) as u32, co_blocks }
}

/// Blocks of output channels that a subgroup of `conv2d_weight_grad_cpu.comp` makes.
fn co_group(co_blocks: u32) -> u32 {
    if co_blocks.is_multiple_of(2) { 2 } else { 1 }
}

/// Bytes of one split's sums.
fn split_bytes(family: Family, layer: Layer, co_blocks: u32) -> u64 {
    u64::from(co_blocks) * u64::from(layer.input.texels()) * 9 * u64::from(family.lanes()) * 16
}

fn partial_bytes(family: Family, layer: Layer, x: &Shape) -> u64 {
    let Split { splits, co_blocks } = split(family, layer, x);
    u64::from(splits) * split_bytes(family, layer, co_blocks)
}

fn transposed_bytes(layer: Layer, x: &Shape) -> u64 {
    let c = u64::from(Channels::new(layer.cout).texels()) * 4;
    u64::from(x.n) * c * u64::from(x.h) * u64::from(x.w.div_ceil(4)) * 16
}

fn bias_parts(rows: u32, width: u32) -> u32 {
    (u64::from(rows) * u64::from(width + 1)).div_ceil(MAX_ITERATIONS).max(32).min(u64::from(rows)) as u32
}

impl Scratch {
    /// Room for every one of `layers` with its operand's size.
    pub fn new(gpu: &Gpu, family: Family, layers: &[(Layer, Shape)]) -> Result<Self> {
        let most = |f: &dyn Fn(Layer, &Shape) -> u64| layers.iter().map(|(l, x)| f(*l, x)).max().unwrap_or(0);
        let bias = |l: Layer, x: &Shape| u64::from(bias_parts(x.n * x.h, x.w)) * u64::from(l.cout.div_ceil(4)) * 16;
        let partial = most(&|l, x| partial_bytes(family, l, x).max(bias(l, x)));
        let transposed = match family {
            Family::Portable | Family::Coop(_) => None,
            Family::Cpu { .. } => Some(gpu.buffer("transposed gradient", most(&transposed_bytes))?),
        };
        Ok(Self { family, partial: gpu.buffer("partial sums", partial)?, transposed })
    }
}

/// Records the gradient of the OIHW weights, `x` being the layer's operand and `dy` the gradient of its result.
pub fn weight_grad(
    gpu: &Gpu,
    rec: &mut Recorder,
    layer: Layer,
    scratch: &Scratch,
    x: &DeviceTensor,
    dy: &DeviceTensor,
    out: &Slice,
) -> Result<()> {
    let (s, family) = (x.shape, scratch.family);
    let Split { splits, co_blocks } = split(family, layer, &s);
    let (cin4, cout) = (s.c.texels(), dy.shape.c.texels() * 4);
    let partial = scratch.partial.slice(0, partial_bytes(family, layer, &s));
    match family {
        Family::Portable => {
            let count = splits * cout * cin4;
            let kernel = gpu.kernel::<shaders::conv2d_weight_grad::Shader>(&Default::default())?;
            let bind = shaders::conv2d_weight_grad::Bind {
                x: x.slice.clone(),
                dy: dy.slice.clone(),
                partial: partial.clone(),
            };
            let push = PortablePush { batch: s.n, height: s.h, width: s.w, cin4, cout, splits, count };
            rec.dispatch(&kernel, &bind, &push, groups(u64::from(count)));
        }
        Family::Cpu { lanes } => {
            let whole = scratch.transposed.as_ref().expect("made for this family");
            let dyt = whole.slice(0, transposed_bytes(layer, &s));
            transpose(gpu, rec, dy, &dyt)?;
            let group = co_group(co_blocks);
            let spec = shaders::conv2d_weight_grad_cpu::Spec { l: lanes, group };
            let kernel = gpu.kernel_with_subgroup::<shaders::conv2d_weight_grad_cpu::Shader>(&spec, lanes)?;
            let bind = shaders::conv2d_weight_grad_cpu::Bind { x: x.slice.clone(), dyt, partial: partial.clone() };
            let push = CpuPush { batch: s.n, height: s.h, width: s.w, cin4, cout, co_blocks, splits };
            let subgroups = cin4.div_ceil(2) * (co_blocks / group) * splits;
            rec.dispatch(&kernel, &bind, &push, [subgroups.div_ceil(LOCAL / lanes), 1, 1]);
        }
        Family::Coop(matrices) => coop::weight_grad(gpu, rec, matrices, (x, dy), &partial, splits)?,
    }
    let (segment, segment_padded) = layer.input.segment();
    let push = ReducePush {
        cin: layer.input.count(),
        cout: layer.cout,
        lanes: family.lanes(),
        cin4,
        co_blocks,
        splits,
        segment,
        segment_padded,
    };
    let kernel = gpu.kernel::<shaders::weight_grad_reduce::Shader>(&Default::default())?;
    let bind = shaders::weight_grad_reduce::Bind { partial_sum: partial, weight_grad: out.clone() };
    rec.dispatch(&kernel, &bind, &push, groups(u64::from(layer.cout * layer.input.count()) * 9));
    Ok(())
}

/// Records the transposition of `dy`; where the result is larger than a storage binding, image by image.
fn transpose(gpu: &Gpu, rec: &mut Recorder, dy: &DeviceTensor, out: &Slice) -> Result<()> {
    let kernel = gpu.kernel::<shaders::transpose_pixels::Shader>(&Default::default())?;
    let s = dy.shape;
    let (read, written) = (dy.slice.bytes() / u64::from(s.n), out.bytes() / u64::from(s.n));
    let aligned = read.is_multiple_of(256) && written.is_multiple_of(256);
    let at_once = if aligned { (gpu.info().max_storage_range / written).clamp(1, u64::from(s.n)) as u32 } else { s.n };
    for first in (0..s.n).step_by(at_once as usize) {
        let images = at_once.min(s.n - first);
        let range = |slice: &Slice, each: u64| slice.slice(u64::from(first) * each, u64::from(images) * each);
        let count = images * s.h * s.w.div_ceil(4) * s.c.texels();
        let push = TransposePush { height: s.h, width: s.w, c4: s.c.texels(), count };
        let bind = shaders::transpose_pixels::Bind { x: range(&dy.slice, read), y: range(out, written) };
        rec.dispatch(&kernel, &bind, &push, groups(u64::from(count)));
    }
    Ok(())
}

/// Records the gradient of the bias.
pub fn bias_grad(
    gpu: &Gpu,
    rec: &mut Recorder,
    layer: Layer,
    scratch: &Scratch,
    dy: &DeviceTensor,
    out: &Slice,
) -> Result<()> {
    let s = dy.shape;
    let (rows, cout4) = (s.n * s.h, s.c.texels());
    let parts = bias_parts(rows, s.w);
    let partial = scratch.partial.slice(0, u64::from(parts) * u64::from(cout4) * 16);
    let kernel = gpu.kernel::<shaders::bias_grad::Shader>(&Default::default())?;
    let bind = shaders::bias_grad::Bind { dy: dy.slice.clone(), partial: partial.clone() };
    rec.dispatch(&kernel, &bind, &BiasPush { rows, width: s.w, cout4, parts }, groups(u64::from(parts * cout4)));
    let kernel = gpu.kernel::<shaders::bias_grad_reduce::Shader>(&Default::default())?;
    let bind = shaders::bias_grad_reduce::Bind { partial_sum: partial, bias_grad: out.clone() };
    let push = BiasReducePush { cout: layer.cout, cout4, parts };
    rec.dispatch(&kernel, &bind, &push, groups(u64::from(cout4 * 4)));
    Ok(())
}
