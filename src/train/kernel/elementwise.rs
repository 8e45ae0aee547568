//! Gradients that move or mask texels: leaky ReLU, max-pool, upsample, concat, and the sum of two gradients.

use crate::Result;
use crate::gpu::{Gpu, Recorder, Slice};
use crate::net::device::{DeviceTensor, groups, windows};
use crate::{push_block, shaders};

push_block! {
    /// Push constants of `leaky_relu_backward.comp`.
    pub struct LeakyReluPush for shaders::leaky_relu_backward { begin: u32, count: u32, slope: f32 }
}
push_block! {
    /// Push constants of `max_pool2d_backward.comp`.
    pub struct MaxPoolPush for shaders::max_pool2d_backward { begin: u32, count: u32, height: u32, width: u32, c4: u32 }
}
push_block! {
    /// Push constants of `upsample2d_backward.comp`.
    pub struct UpsamplePush for shaders::upsample2d_backward { begin: u32, count: u32, height: u32, width: u32, c4: u32 }
}
push_block! {
    /// Push constants of `concat_backward.comp`.
    pub struct ConcatPush for shaders::concat_backward { begin: u32, count: u32, total4: u32, first4: u32, part4: u32, width: u32 }
}
push_block! {
    /// Push constants of `add.comp`.
    pub struct AddPush for shaders::add { begin: u32, count: u32 }
}

/// Runs `f(begin, count, window)` for the windows of `y`.
fn each_window(gpu: &Gpu, y: &DeviceTensor, mut f: impl FnMut(u32, u32, Slice)) {
    for (begin, count) in windows(gpu.info(), y.shape.texels()) {
        f(begin as u32, count as u32, y.slice.slice(begin * 16, count * 16));
    }
}

/// Records the gradient of leaky ReLU from its stored output `y`; `dx` may be `dy`.
pub fn leaky_relu(
    gpu: &Gpu,
    rec: &mut Recorder,
    y: &DeviceTensor,
    dy: &DeviceTensor,
    dx: &DeviceTensor,
    slope: f32,
) -> Result<()> {
    assert_eq!((y.shape, y.shape), (dy.shape, dx.shape));
    let kernel = gpu.kernel::<shaders::leaky_relu_backward::Shader>(&Default::default())?;
    each_window(gpu, dx, |begin, count, dx| {
        let bind = shaders::leaky_relu_backward::Bind { y: y.slice.clone(), dy: dy.slice.clone(), dx };
        rec.dispatch(&kernel, &bind, &LeakyReluPush { begin, count, slope }, groups(u64::from(count)));
    });
    Ok(())
}

/// Records the gradient of the 2x2 maximum of `x`.
pub fn max_pool2d(gpu: &Gpu, rec: &mut Recorder, x: &DeviceTensor, dy: &DeviceTensor, dx: &DeviceTensor) -> Result<()> {
    assert_eq!(x.shape, dx.shape);
    let kernel = gpu.kernel::<shaders::max_pool2d_backward::Shader>(&Default::default())?;
    let s = x.shape;
    each_window(gpu, dx, |begin, count, dx| {
        let push = MaxPoolPush { begin, count, height: s.h, width: s.w, c4: s.c.texels() };
        let bind = shaders::max_pool2d_backward::Bind { x: x.slice.clone(), dy: dy.slice.clone(), dx };
        rec.dispatch(&kernel, &bind, &push, groups(u64::from(count)));
    });
    Ok(())
}

/// Records the gradient of upsampling.
pub fn upsample2d(gpu: &Gpu, rec: &mut Recorder, dy: &DeviceTensor, dx: &DeviceTensor) -> Result<()> {
    let s = dx.shape;
    assert_eq!((dy.shape.h, dy.shape.w, dy.shape.c), (s.h * 2, s.w * 2, s.c));
    let kernel = gpu.kernel::<shaders::upsample2d_backward::Shader>(&Default::default())?;
    each_window(gpu, dx, |begin, count, dx| {
        let push = UpsamplePush { begin, count, height: s.h, width: s.w, c4: s.c.texels() };
        let bind = shaders::upsample2d_backward::Bind { dy: dy.slice.clone(), dx };
        rec.dispatch(&kernel, &bind, &push, groups(u64::from(count)));
    });
    Ok(())
}

/// Records the gradient of the first (`second` false) or second operand of a concatenation.
pub fn concat(gpu: &Gpu, rec: &mut Recorder, dy: &DeviceTensor, dx: &DeviceTensor, second: bool) -> Result<()> {
    let kernel = gpu.kernel::<shaders::concat_backward::Shader>(&Default::default())?;
    let (total4, part4) = (dy.shape.c.texels(), dx.shape.c.texels());
    let first4 = if second { total4 - part4 } else { 0 };
    each_window(gpu, dx, |begin, count, dx| {
        let bind = shaders::concat_backward::Bind { dy: dy.slice.clone(), dx };
        let push = ConcatPush { begin, count, total4, first4, part4, width: dy.shape.w };
        rec.dispatch(&kernel, &bind, &push, groups(u64::from(count)));
    });
    Ok(())
}

/// Records `y = a + b`; `y` may be either.
pub fn add(gpu: &Gpu, rec: &mut Recorder, a: &DeviceTensor, b: &DeviceTensor, y: &DeviceTensor) -> Result<()> {
    assert_eq!((a.shape, b.shape), (y.shape, y.shape));
    let kernel = gpu.kernel::<shaders::add::Shader>(&Default::default())?;
    each_window(gpu, y, |begin, count, y| {
        let bind = shaders::add::Bind { a: a.slice.clone(), b: b.slice.clone(), y };
        rec.dispatch(&kernel, &bind, &AddPush { begin, count }, groups(u64::from(count)));
    });
    Ok(())
}
