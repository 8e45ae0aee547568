//! Weight gradients by cooperative matrices: `conv2d_weight_grad_coop.comp`.

use crate::Result;
use crate::gpu::{Gpu, MatrixShape, Recorder, Slice};
use crate::net::device::{DeviceTensor, Shape};
use crate::net::kernel::{conv2d::Layer, coop::Matrices};
use crate::{push_block, shaders};

push_block! {
    /// Push constants of `conv2d_weight_grad_coop.comp`.
    pub struct Push for shaders::conv2d_weight_grad_coop {
        height: u32, width: u32, cin4: u32, cout4: u32, tiles_x: u32, tiles_y: u32, tiles: u32, splits: u32,
    }
}

/// Pixels of a tile.
const TILE: (u32, u32) = (16, 8);
/// Loop iterations that an invocation spends on a tile at most: staging with the smallest workgroup of 32, and the columns.
pub(super) const TILE_ITERATIONS: u64 = 64;
/// Workgroups that a dispatch should at least have: a few waves of a large GPU.
pub(super) const MIN_WORKGROUPS: u64 = 512;

/// Tiles of all images.
pub(super) fn tiles(x: &Shape) -> u32 {
    x.w.div_ceil(TILE.0) * x.h.div_ceil(TILE.1) * x.n
}

fn blocks(MatrixShape { m, n, .. }: MatrixShape, cin4: u32, cout4: u32) -> (u32, u32) {
    ((cout4 * 4).div_ceil(2 * m), (cin4 * 4).div_ceil(2 * n))
}

/// Workgroups of one split.
pub(super) fn workgroups(matrices: Matrices, layer: Layer) -> u64 {
    let (co, ci) = blocks(matrices.shape, layer.input.texels(), layer.cout.div_ceil(4));
    u64::from(co) * u64::from(ci)
}

/// Records the partial sums of the weight gradient, `x` being the layer's operand and `dy` the gradient of its result.
pub(super) fn weight_grad(
    gpu: &Gpu,
    rec: &mut Recorder,
    matrices: Matrices,
    (x, dy): (&DeviceTensor, &DeviceTensor),
    partial: &Slice,
    splits: u32,
) -> Result<()> {
    let MatrixShape { m, n, k } = matrices.shape;
    let s = x.shape;
    let (cin4, cout4) = (s.c.texels(), dy.shape.c.texels());
    let spec = shaders::conv2d_weight_grad_coop::Spec { m, n, k, local: matrices.local() };
    let kernel = gpu.kernel_with_subgroup::<shaders::conv2d_weight_grad_coop::Shader>(&spec, matrices.subgroup)?;
    let push = Push {
        height: s.h,
        width: s.w,
        cin4,
        cout4,
        tiles_x: s.w.div_ceil(TILE.0),
        tiles_y: s.h.div_ceil(TILE.1),
        tiles: tiles(&s),
        splits,
    };
    let bind =
        shaders::conv2d_weight_grad_coop::Bind { x: x.slice.clone(), dy: dy.slice.clone(), partial: partial.clone() };
    let (co, ci) = blocks(matrices.shape, cin4, cout4);
    rec.dispatch(&kernel, &bind, &push, [co, ci, splits]);
    Ok(())
}
