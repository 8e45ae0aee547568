//! 2x2 maximum with stride 2: `max_pool2d.comp`.

use crate::Result;
use crate::gpu::{Gpu, Recorder};
use crate::net::device::{DeviceTensor, groups, windows};
use crate::{push_block, shaders};

push_block! {
    /// Push constants of `max_pool2d.comp`.
    pub struct Push for shaders::max_pool2d { begin: u32, count: u32, height: u32, width: u32, c4: u32 }
}

/// Records `y = max_pool2d(x)`.
pub fn record(gpu: &Gpu, rec: &mut Recorder, x: &DeviceTensor, y: &DeviceTensor) -> Result<()> {
    let s = x.shape;
    assert_eq!((y.shape.n, y.shape.h, y.shape.w, y.shape.c), (s.n, s.h / 2, s.w / 2, s.c));
    let kernel = gpu.kernel::<shaders::max_pool2d::Shader>(&Default::default())?;
    for (begin, count) in windows(gpu.info(), y.shape.texels()) {
        let push = Push { begin: begin as u32, count: count as u32, height: s.h, width: s.w, c4: s.c.texels() };
        let bind = shaders::max_pool2d::Bind { x: x.slice.clone(), y: y.slice.slice(begin * 16, count * 16) };
        rec.dispatch(&kernel, &bind, &push, groups(count));
    }
    Ok(())
}
