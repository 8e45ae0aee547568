//! 3x3 convolution by cooperative matrices, operands in f16 and sums in f32: `conv2d_coop.comp`, `pack_weights_coop.comp`.

use super::conv2d::{Layer, Pass, tile_windows};
use crate::Result;
use crate::gpu::{DeviceInfo, Gpu, MatrixShape, Recorder, Slice};
use crate::net::device::groups;
use crate::{push_block, shaders};

push_block! {
    /// Push constants of `conv2d_coop.comp`.
    pub struct Push for shaders::conv2d_coop {
        height: u32, width: u32, cin4: u32, cout4: u32, blocks: u32, tiles_y: u32, tile_row_begin: u32, window_row: u32,
    }
}

push_block! {
    /// Push constants of `pack_weights_coop.comp`.
    pub struct PackPush for shaders::pack_weights_coop {
        cin: u32, cout: u32, chunks: u32, wide: u32, count: u32, transposed: u32, segment: u32, segment_padded: u32,
    }
}

/// Input channels that `conv2d_coop.comp` stages at a time.
const CHUNK: u32 = 16;
/// Subgroups of a workgroup.
pub const SUBGROUPS: u32 = 4;
/// Rows of pixels that a subgroup of `conv2d_coop.comp` makes.
const ROWS: u32 = 4;
/// Shared memory that any of the family's kernels needs at most, bytes.
const SHARED_BYTES: u32 = 32 << 10;

/// The matrices that the kernels are made of, and the subgroups that make them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Matrices {
    /// Size of one product.
    pub shape: MatrixShape,
    /// Invocations of a subgroup.
    pub subgroup: u32,
}

impl Matrices {
    /// The largest of the device's matrices that the kernels can use; none where there is no such.
    ///
    /// On llvmpipe (Mesa 26.2) only subgroups of 8: with 16, which 512-bit vectors give, its compiler crashes.
    #[must_use]
    pub fn of(info: &DeviceInfo) -> Option<Self> {
        let fits = |s: &&MatrixShape| [8, 16].contains(&s.m) && [8, 16].contains(&s.n) && [8, 16].contains(&s.k);
        let shape = info.cooperative_matrices.iter().filter(fits).max_by_key(|s| s.m * s.n * s.k)?;
        if info.is_cpu && info.subgroup_size != 8 {
            return None;
        }
        let room = info.max_shared_bytes >= SHARED_BYTES && info.max_invocations >= SUBGROUPS * info.subgroup_size;
        room.then_some(Self { shape: *shape, subgroup: info.subgroup_size })
    }

    /// Invocations of a workgroup.
    #[must_use]
    pub const fn local(self) -> u32 {
        SUBGROUPS * self.subgroup
    }
}

/// How the output channels are cut.
struct Blocks {
    /// Channels of a block, which one subgroup makes.
    wide: u32,
    count: u32,
    /// Subgroups of a workgroup that lie side by side along the channels; the others lie along the rows of pixels.
    across: u32,
}

fn blocks(layer: Layer, transposed: bool) -> Blocks {
    of_texels(layer.direction(transposed).1.texels())
}

fn of_texels(texels: u32) -> Blocks {
    let wide = if texels <= 4 { 16 } else { 32 };
    let count = (texels * 4).div_ceil(wide);
    Blocks { wide, count, across: if count.is_multiple_of(2) { 2 } else { 1 } }
}

fn chunks(texels: u32) -> u32 {
    (texels * 4).div_ceil(CHUNK)
}

/// Bytes of the packed weights.
#[must_use]
pub fn packed_bytes(layer: Layer, transposed: bool) -> u64 {
    let Blocks { wide, count, .. } = blocks(layer, transposed);
    let chunks = chunks(layer.direction(transposed).0.texels());
    u64::from(count) * u64::from(wide) * u64::from(chunks) * 9 * u64::from(CHUNK) * 2
}

/// Records the packing of OIHW `weight` into `packed`.
pub fn pack(
    gpu: &Gpu,
    rec: &mut Recorder,
    matrices: Matrices,
    layer: Layer,
    weight: &Slice,
    packed: &Slice,
    transposed: bool,
) -> Result<()> {
    let (segment, segment_padded) = layer.input.segment();
    let count = packed_bytes(layer, transposed) / 16;
    let push = PackPush {
        cin: layer.input.count(),
        cout: layer.cout,
        chunks: chunks(layer.direction(transposed).0.texels()),
        wide: blocks(layer, transposed).wide,
        count: count as u32,
        transposed: u32::from(transposed),
        segment,
        segment_padded,
    };
    let spec = shaders::pack_weights_coop::Spec { n: matrices.shape.n, k: matrices.shape.k };
    let kernel = gpu.kernel::<shaders::pack_weights_coop::Shader>(&spec)?;
    let bind = shaders::pack_weights_coop::Bind { weight: weight.clone(), packed: packed.clone() };
    rec.dispatch(&kernel, &bind, &push, groups(count));
    Ok(())
}

/// Records `y = leaky_relu(conv(x) + bias)`.
pub fn record(gpu: &Gpu, rec: &mut Recorder, matrices: Matrices, pass: &Pass<'_>) -> Result<()> {
    let shape = pass.y.shape;
    let cout4 = shape.c.texels();
    let Blocks { wide, count, across } = of_texels(cout4);
    let MatrixShape { m, n, k } = matrices.shape;
    let spec = shaders::conv2d_coop::Spec { m, n, k, local: matrices.local(), wide, across, slope: pass.slope };
    let kernel = gpu.kernel_with_subgroup::<shaders::conv2d_coop::Shader>(&spec, matrices.subgroup)?;
    let tile_rows = ROWS * SUBGROUPS / across;
    let tiles_y = shape.h.div_ceil(tile_rows);
    for (begin, end, window_row, y) in tile_windows(gpu, pass.y, tile_rows) {
        let push = Push {
            height: shape.h,
            width: shape.w,
            cin4: pass.x.shape.c.texels(),
            cout4,
            blocks: count,
            tiles_y,
            tile_row_begin: begin,
            window_row,
        };
        let bind = shaders::conv2d_coop::Bind {
            x: pass.x.slice.clone(),
            weight: pass.weight.clone(),
            bias: pass.bias.clone(),
            y,
        };
        rec.dispatch(&kernel, &bind, &push, [count.div_ceil(across), shape.w.div_ceil(m), end - begin]);
    }
    Ok(())
}
