//! 3x3 convolution by Winograd's F(4x4, 3x3): a quarter of the multiplications, for CPU drivers.
//!
//! Lavin and Gray, "Fast Algorithms for Convolutional Neural Networks" (2016), interpolation points 0, 1, -1, 2, -2: the
//! operand's overlapping 6x6 patches and the weights are transformed, 36 matrix products follow, and their results are
//! transformed to tiles of 4x4 pixels.
//!
//! The operand may come in two parts, as a concatenation of an upsampled value and another: neither the concatenation nor the
//! upsampling is written to memory, and 11 of the 36 products vanish for what is upsampled.

use super::{Family, conv2d::Layer, conv2d::tile_windows};
use crate::gpu::{Gpu, Kernel, Recorder, Slice};
use crate::net::device::{Channels, DeviceTensor, groups};
use crate::{Result, push_block, shaders};

push_block! {
    /// Push constants of `winograd_weights.comp`.
    pub struct WeightsPush for shaders::winograd_weights {
        cin: u32, cout: u32, lanes: u32, in4: u32, blocks: u32, count: u32, transposed: u32, segment: u32, segment_padded: u32,
    }
}

push_block! {
    /// Push constants of `winograd.comp`.
    pub struct WinogradPush for shaders::winograd {
        height: i32, width: i32, low4: i32, x4: i32, blocks: u32, cout4: u32, tiles_x: u32, tiles_y: u32,
        tile_row_begin: u32, tile_count: u32, window_row: u32, slope: f32,
    }
}

/// Products of one output tile of a channel pair: 6x6.
const POSITIONS: u64 = 36;
/// Side of an output tile, pixels.
pub const TILE: u32 = 4;
/// Invocations of a workgroup.
const LOCAL: u32 = 64;

/// Channels in times channels out must be at least this much times their sum: the products save as the one, the transforms
/// cost as the other. Measured on llvmpipe at 768x768: 32 to 32 channels lose a third, 57 to 57 gain nothing, 64 to 128 gain half.
const WORTH: u32 = 12;

/// The deepest level of a network with Winograd convolutions. Their results depend, in their last bits, on their whole
/// aligned tile's patch: deeper, where there is little to gain, tiles of a frame would need far more overlap.
const MAX_LEVEL: usize = 1;

/// Whether a convolution at a level of a network runs by Winograd: on CPU drivers, where it is faster. The same for its
/// input gradient.
#[must_use]
pub fn fits(family: Family, layer: Layer, level: usize) -> bool {
    let (cin, cout) = (layer.input.count(), layer.cout);
    matches!(family, Family::Cpu { .. }) && level <= MAX_LEVEL && cin * cout >= WORTH * (cin + cout)
}

/// Bytes of the transformed weights, those for the input gradient where `transposed`.
#[must_use]
pub fn weights_bytes(family: Family, layer: Layer, transposed: bool) -> u64 {
    weights_texels(family, layer, transposed) * 16
}

fn weights_texels(family: Family, layer: Layer, transposed: bool) -> u64 {
    let (read, written) = layer.direction(transposed);
    POSITIONS * u64::from(blocks(family, written)) * u64::from(read.texels()) * u64::from(family.lanes())
}

/// Blocks of as many output channels as there are lanes.
fn blocks(family: Family, written: Channels) -> u32 {
    (written.texels() * 4).div_ceil(family.lanes())
}

/// Records the transformation of OIHW `weight`.
pub fn transform_weights(
    gpu: &Gpu,
    rec: &mut Recorder,
    family: Family,
    layer: Layer,
    weight: &Slice,
    out: &Slice,
    transposed: bool,
) -> Result<()> {
    let (read, written) = layer.direction(transposed);
    let (segment, segment_padded) = layer.input.segment();
    let count = weights_texels(family, layer, transposed);
    let push = WeightsPush {
        cin: layer.input.count(),
        cout: layer.cout,
        lanes: family.lanes(),
        in4: read.texels(),
        blocks: blocks(family, written),
        count: count as u32,
        transposed: u32::from(transposed),
        segment,
        segment_padded,
    };
    let kernel = gpu.kernel::<shaders::winograd_weights::Shader>(&Default::default())?;
    let bind = shaders::winograd_weights::Bind { weight: weight.clone(), u: out.clone() };
    rec.dispatch(&kernel, &bind, &push, groups(count));
    Ok(())
}

/// Blocks of output channels that a subgroup makes: 4 where they share a transformed operand and at most one is left over.
/// Every number is a pipeline of its own, which llvmpipe makes for a third of a second.
fn group(blocks: u32) -> u32 {
    if blocks >= 3 && blocks.next_multiple_of(4) - blocks <= 1 { 4 } else { 2 }
}

/// Operands of one convolution.
pub struct Pass<'a> {
    /// Of half the size: its nearest 2x upsampling gives the first channels of what is read, where there is such.
    pub low: Option<&'a DeviceTensor>,
    /// The other channels.
    pub x: &'a DeviceTensor,
    /// Transformed weights.
    pub weight: &'a Slice,
    /// At least as many floats as the result has places, rounded up to 16.
    pub bias: &'a Slice,
    /// What is written.
    pub y: &'a DeviceTensor,
    /// Leaky ReLU slope of the result; 1 leaves it linear.
    pub slope: f32,
}

/// The kernel that writes these channels.
pub fn kernel(gpu: &Gpu, family: Family, written: Channels) -> Result<Kernel<shaders::winograd::Shader>> {
    let lanes = family.lanes();
    gpu.kernel_with_subgroup(&shaders::winograd::Spec { l: lanes, group: group(blocks(family, written)) }, lanes)
}

/// Records `y = leaky_relu(conv([upsample2d(low), x]) + bias)`.
pub fn record(gpu: &Gpu, rec: &mut Recorder, family: Family, pass: &Pass<'_>) -> Result<()> {
    let kernel = kernel(gpu, family, pass.y.shape.c)?;
    let blocks = blocks(family, pass.y.shape.c);
    let group = group(blocks);
    let shape = pass.y.shape;
    let (tiles_x, tiles_y) = (shape.w.div_ceil(TILE), shape.h.div_ceil(TILE));
    for (begin, end, window_row, y) in tile_windows(gpu, pass.y, TILE) {
        let tile_count = (end - begin) * tiles_x;
        let push = WinogradPush {
            height: shape.h as i32,
            width: shape.w as i32,
            low4: pass.low.map_or(0, |low| low.shape.c.texels()) as i32,
            x4: pass.x.shape.c.texels() as i32,
            blocks,
            cout4: shape.c.texels(),
            tiles_x,
            tiles_y,
            tile_row_begin: begin,
            tile_count,
            window_row,
            slope: pass.slope,
        };
        let bind = shaders::winograd::Bind {
            low: pass.low.unwrap_or(pass.x).slice.clone(),
            x: pass.x.slice.clone(),
            weight: pass.weight.clone(),
            bias: pass.bias.clone(),
            y,
        };
        rec.dispatch(&kernel, &bind, &push, [tile_count.div_ceil(LOCAL), blocks.div_ceil(group), 1]);
    }
    Ok(())
}
