//! 3x3 convolution by Winograd's F(4x4, 3x3): a quarter of the multiplications, for CPU drivers and inference.
//!
//! Lavin and Gray, "Fast Algorithms for Convolutional Neural Networks" (2016), interpolation points 0, 1, -1, 2, -2: the
//! operand's overlapping 6x6 patches and the weights are transformed, 36 matrix products follow, and their results are
//! transformed to tiles of 4x4 pixels. A stripe of tile rows at a time, so that what lies between stays in the cache.
//!
//! The operand may come in two parts, as a concatenation has them, the first one upsampled: neither the concatenation nor
//! the upsampling is written to memory, and 11 of the 36 products vanish for what is upsampled.

use super::{Family, conv2d::Layer};
use crate::gpu::{Buffer, Footprint, Gpu, Recorder, Slice};
use crate::net::device::{DeviceTensor, Shape, groups};
use crate::{Result, push_block, shaders};

push_block! {
    /// Push constants of `winograd_weights.comp`.
    pub struct WeightsPush for shaders::winograd_weights {
        cin: u32, cout: u32, lanes: u32, in4: u32, count: u32, segment: u32, segment_padded: u32,
    }
}

push_block! {
    /// Push constants of `winograd_input.comp`.
    pub struct InputPush for shaders::winograd_input {
        height: u32, width: u32, cin4: u32, c_begin: u32, total4: u32, tiles_x: u32, tiles_y: u32, tile_row_begin: u32,
        tile_count: u32, tile_stride: u32,
    }
}

push_block! {
    /// Push constants of `winograd_multiply.comp`.
    pub struct MultiplyPush for shaders::winograd_multiply {
        in4: u32, upsampled4: u32, blocks: u32, tile_blocks: u32, tile_stride: u32,
    }
}

push_block! {
    /// Push constants of `winograd_output.comp`.
    pub struct OutputPush for shaders::winograd_output {
        height: u32, width: u32, blocks: u32, cout4: u32, tiles_x: u32, tiles_y: u32, tile_row_begin: u32, tile_count: u32,
        tile_stride: u32, window_row: u32,
    }
}

/// Products of one output tile of a channel pair: 6x6.
const POSITIONS: u64 = 36;
/// Side of an output tile, pixels.
pub const TILE: u32 = 4;
/// Tiles that a stripe should have: transformed operands of a few megabytes, which a cache holds.
const STRIPE_TILES: u32 = 256;
/// Invocations of a workgroup.
const LOCAL: u32 = 64;

/// Channels in times channels out must be at least this much times their sum: the products save as the one, the transforms
/// cost as the other. Measured on llvmpipe at 768x768: 32 to 32 channels lose a third, 57 to 57 gain nothing, 64 to 128 gain half.
const WORTH: u32 = 23;

/// Whether a convolution runs by Winograd: on CPU drivers where it is faster.
#[must_use]
pub fn fits(family: Family, layer: Layer) -> bool {
    let (cin, cout) = (layer.input.count(), layer.cout);
    matches!(family, Family::Cpu { .. }) && cin * cout >= WORTH * (cin + cout)
}

/// Bytes of the transformed weights.
#[must_use]
pub fn weights_bytes(family: Family, layer: Layer) -> u64 {
    weights_texels(family, layer) * 16
}

fn weights_texels(family: Family, layer: Layer) -> u64 {
    POSITIONS * u64::from(blocks(family, layer)) * u64::from(layer.input.texels()) * u64::from(family.lanes())
}

fn blocks(family: Family, layer: Layer) -> u32 {
    layer.cout.div_ceil(family.lanes())
}

/// Records the transformation of OIHW `weight`.
pub fn transform_weights(
    gpu: &Gpu,
    rec: &mut Recorder,
    family: Family,
    layer: Layer,
    weight: &Slice,
    out: &Slice,
) -> Result<()> {
    let (segment, segment_padded) = layer.input.segment();
    let count = weights_texels(family, layer);
    let push = WeightsPush {
        cin: layer.input.count(),
        cout: layer.cout,
        lanes: family.lanes(),
        in4: layer.input.texels(),
        count: count as u32,
        segment,
        segment_padded,
    };
    let kernel = gpu.kernel::<shaders::winograd_weights::Shader>(&Default::default())?;
    let bind = shaders::winograd_weights::Bind { weight: weight.clone(), u: out.clone() };
    rec.dispatch(&kernel, &bind, &push, groups(count));
    Ok(())
}

/// Blocks of output channels that a subgroup makes: 4 where 16 lanes promise registers enough and few of the 4 are left
/// over.
fn group(lanes: u32, blocks: u32) -> u32 {
    if lanes == 16 && blocks.next_multiple_of(4) - blocks <= 1 { 4 } else { 2 }
}

/// The tiles of a result, cut into stripes of whole tile rows.
#[derive(Clone, Copy)]
struct Stripes {
    tiles_x: u32,
    tiles_y: u32,
    /// Tile rows over all images.
    rows: u32,
    /// Tile rows of a stripe.
    each: u32,
    /// Places for tiles of a stripe, a multiple of every subgroup size.
    stride: u32,
}

impl Stripes {
    fn new(y: &Shape) -> Self {
        let (tiles_x, tiles_y) = (y.w.div_ceil(TILE), y.h.div_ceil(TILE));
        let rows = y.n * tiles_y;
        let each = (STRIPE_TILES / tiles_x).clamp(1, rows);
        Self { tiles_x, tiles_y, rows, each, stride: (each * tiles_x).next_multiple_of(16) }
    }

    /// The first row of pixels of a tile row, over all images.
    fn begin(&self, y: &Shape, tile_row: u32) -> u32 {
        tile_row / self.tiles_y * y.h + tile_row % self.tiles_y * TILE
    }

    /// The end of the rows of pixels of a tile row.
    fn end(&self, y: &Shape, tile_row: u32) -> u32 {
        let rows = (y.h - tile_row % self.tiles_y * TILE).min(TILE);
        self.begin(y, tile_row) + rows
    }
}

/// Buffers between the steps, which convolutions use one after another.
pub struct Scratch {
    operand: Buffer,
    product: Buffer,
}

fn scratch_bytes(family: Family, layer: Layer, y: &Shape) -> [u64; 2] {
    let tiles = POSITIONS * u64::from(Stripes::new(y).stride);
    let lanes = u64::from(blocks(family, layer) * family.lanes());
    [tiles * u64::from(layer.input.texels()) * 16, tiles * lanes * 4]
}

impl Scratch {
    /// Bytes of the buffers for every one of `layers` with its result's size; none where there are no layers.
    fn sizes(family: Family, layers: &[(Layer, Shape)]) -> Option<[u64; 2]> {
        let most = |i: usize| layers.iter().map(|(layer, y)| scratch_bytes(family, *layer, y)[i]).max();
        Some([most(0)?, most(1)?])
    }

    /// The memory that [`Self::new`] will take.
    #[must_use]
    pub fn footprint(family: Family, layers: &[(Layer, Shape)]) -> Footprint {
        Self::sizes(family, layers).into_iter().flatten().map(Footprint::buffer).sum()
    }

    /// Room for every one of `layers` with its result's size; none where there are no layers.
    pub fn new(gpu: &Gpu, family: Family, layers: &[(Layer, Shape)]) -> Result<Option<Self>> {
        let Some([operand, product]) = Self::sizes(family, layers) else { return Ok(None) };
        let buffer = |name, bytes| gpu.buffer(name, bytes);
        Ok(Some(Self { operand: buffer("transformed operand", operand)?, product: buffer("products", product)? }))
    }

    /// Bytes on the device.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.operand.bytes() + self.product.bytes()
    }
}

/// A part of what a convolution reads.
#[derive(Clone, Copy)]
pub struct Operand<'a> {
    /// The values.
    pub x: &'a DeviceTensor,
    /// Whether the convolution reads their nearest 2x upsampling; only the first operand may be.
    pub upsampled: bool,
}

/// Operands of one convolution.
pub struct Pass<'a> {
    /// The channels.
    pub layer: Layer,
    /// What is read, channel after channel.
    pub operands: &'a [Operand<'a>],
    /// Transformed weights.
    pub weight: &'a Slice,
    /// At least as many floats as the result has places, rounded up to 16.
    pub bias: &'a Slice,
    /// What is written.
    pub y: &'a DeviceTensor,
    /// Leaky ReLU slope of the result; 1 leaves it linear.
    pub slope: f32,
}

/// Records `y = leaky_relu(conv(operands) + bias)`.
///
/// # Panics
/// Where the operands do not make up the layer's input, or another than the first is upsampled.
pub fn record(gpu: &Gpu, rec: &mut Recorder, family: Family, scratch: &Scratch, pass: &Pass<'_>) -> Result<()> {
    let lanes = family.lanes();
    let texels: u32 = pass.operands.iter().map(|o| o.x.shape.c.texels()).sum();
    assert_eq!(texels, pass.layer.input.texels(), "the operands make up the layer's input");
    assert!(pass.operands.iter().skip(1).all(|o| !o.upsampled), "only the first operand may be upsampled");
    let blocks = blocks(family, pass.layer);
    let group = group(lanes, blocks);
    let spec = shaders::winograd_multiply::Spec { l: lanes, group };
    let multiply = gpu.kernel_with_subgroup::<shaders::winograd_multiply::Shader>(&spec, lanes)?;
    let spec = shaders::winograd_output::Spec { l: lanes, slope: pass.slope };
    let output = gpu.kernel_with_subgroup::<shaders::winograd_output::Shader>(&spec, lanes)?;

    let shape = &pass.y.shape;
    let stripes = Stripes::new(shape);
    let Stripes { tiles_x, tiles_y, stride, .. } = stripes;
    let [operand_bytes, product_bytes] = scratch_bytes(family, pass.layer, shape);
    let (v, m) = (scratch.operand.slice(0, operand_bytes), scratch.product.slice(0, product_bytes));
    let row_bytes = u64::from(shape.w) * u64::from(shape.c.texels()) * 16;
    for begin in (0..stripes.rows).step_by(stripes.each as usize) {
        let end = (begin + stripes.each).min(stripes.rows);
        let tile_count = (end - begin) * tiles_x;
        let mut c_begin = 0;
        for operand in pass.operands {
            let cin4 = operand.x.shape.c.texels();
            let push = InputPush {
                height: shape.h,
                width: shape.w,
                cin4,
                c_begin,
                total4: texels,
                tiles_x,
                tiles_y,
                tile_row_begin: begin,
                tile_count,
                tile_stride: stride,
            };
            let spec = shaders::winograd_input::Spec { upsampled: operand.upsampled };
            let kernel = gpu.kernel::<shaders::winograd_input::Shader>(&spec)?;
            let bind = shaders::winograd_input::Bind { x: operand.x.slice.clone(), v: v.clone() };
            rec.dispatch(&kernel, &bind, &push, [(tile_count * cin4).div_ceil(LOCAL), 1, 1]);
            c_begin += cin4;
        }
        let tile_blocks = tile_count.div_ceil(lanes);
        let upsampled = pass.operands.iter().find(|o| o.upsampled);
        let push = MultiplyPush {
            in4: texels,
            upsampled4: upsampled.map_or(0, |o| o.x.shape.c.texels()),
            blocks,
            tile_blocks,
            tile_stride: stride,
        };
        let bind = shaders::winograd_multiply::Bind { v: v.clone(), u: pass.weight.clone(), m: m.clone() };
        rec.dispatch(
            &multiply,
            &bind,
            &push,
            [tile_blocks.div_ceil(LOCAL / lanes), blocks.div_ceil(group), POSITIONS as u32],
        );
        // 16 rows of whole texels are a multiple of a slice's alignment.
        let window_row = stripes.begin(shape, begin) & !15;
        let window = u64::from(stripes.end(shape, end - 1) - window_row) * row_bytes;
        let push = OutputPush {
            height: shape.h,
            width: shape.w,
            blocks,
            cout4: shape.c.texels(),
            tiles_x,
            tiles_y,
            tile_row_begin: begin,
            tile_count,
            tile_stride: stride,
            window_row,
        };
        let bind = shaders::winograd_output::Bind {
            m: m.clone(),
            bias: pass.bias.clone(),
            y: pass.y.slice.slice(u64::from(window_row) * row_bytes, window),
        };
        rec.dispatch(&output, &bind, &push, [tile_count.div_ceil(4).div_ceil(LOCAL / lanes), blocks, 1]);
    }
    Ok(())
}
