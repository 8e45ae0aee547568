//! Radiance without texture, its pyramid, and back: `demodulate.comp`, `masked_pool2d.comp`, `modulate.comp`.

use crate::Result;
use crate::gpu::{Gpu, Recorder};
use crate::net::device::{DeviceTensor, groups, windows};
use crate::{push_block, shaders};

push_block! {
    /// Push constants of `demodulate.comp`.
    pub struct DemodulatePush for shaders::demodulate { begin: u32, count: u32, width: u32 }
}
push_block! {
    /// Push constants of `masked_pool2d.comp`.
    pub struct PoolPush for shaders::masked_pool2d { begin: u32, count: u32, width: u32 }
}
push_block! {
    /// Push constants of `modulate.comp`.
    pub struct ModulatePush for shaders::modulate { begin: u32, count: u32, width: u32 }
}

/// Records `y`, 4 channels, from a network's input `x`, 9 channels.
pub fn record(gpu: &Gpu, rec: &mut Recorder, x: &DeviceTensor, y: &DeviceTensor) -> Result<()> {
    let s = y.shape;
    assert_eq!((x.shape.n, x.shape.h, x.shape.w, x.shape.c.texels()), (s.n, s.h, s.w, 3));
    let kernel = gpu.kernel::<shaders::demodulate::Shader>(&Default::default())?;
    for (begin, count) in windows(gpu.info(), s.texels()) {
        let push = DemodulatePush { begin: begin as u32, count: count as u32, width: s.w };
        let bind = shaders::demodulate::Bind { x: x.slice.clone(), y: y.slice.slice(begin * 16, count * 16) };
        rec.dispatch(&kernel, &bind, &push, groups(count));
    }
    Ok(())
}

/// Records the 2x2 mean of what is inside the picture.
pub fn record_pool(gpu: &Gpu, rec: &mut Recorder, x: &DeviceTensor, y: &DeviceTensor) -> Result<()> {
    let s = y.shape;
    assert_eq!((x.shape.n, x.shape.h, x.shape.w, x.shape.c), (s.n, s.h * 2, s.w * 2, s.c));
    let kernel = gpu.kernel::<shaders::masked_pool2d::Shader>(&Default::default())?;
    for (begin, count) in windows(gpu.info(), s.texels()) {
        let push = PoolPush { begin: begin as u32, count: count as u32, width: s.w };
        let bind = shaders::masked_pool2d::Bind { x: x.slice.clone(), y: y.slice.slice(begin * 16, count * 16) };
        rec.dispatch(&kernel, &bind, &push, groups(count));
    }
    Ok(())
}

/// Records `y`, 3 channels, from filtered radiance `x`, 4 channels, and the network's input.
pub fn record_modulate(
    gpu: &Gpu,
    rec: &mut Recorder,
    x: &DeviceTensor,
    input: &DeviceTensor,
    y: &DeviceTensor,
) -> Result<()> {
    let s = y.shape;
    assert_eq!((x.shape.texels(), input.shape.texels()), (s.texels(), 3 * s.texels()));
    let kernel = gpu.kernel::<shaders::modulate::Shader>(&Default::default())?;
    for (begin, count) in windows(gpu.info(), s.texels()) {
        let push = ModulatePush { begin: begin as u32, count: count as u32, width: s.w };
        let y = y.slice.slice(begin * 16, count * 16);
        let bind = shaders::modulate::Bind { x: x.slice.clone(), input_: input.slice.clone(), y };
        rec.dispatch(&kernel, &bind, &push, groups(count));
    }
    Ok(())
}
