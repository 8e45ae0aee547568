//! Leaky ReLU: `leaky_relu.comp`.

use crate::Result;
use crate::gpu::{Gpu, Recorder};
use crate::net::device::{DeviceTensor, groups, windows};
use crate::{push_block, shaders};

push_block! {
    /// Push constants of `leaky_relu.comp`.
    pub struct Push for shaders::leaky_relu { begin: u32, count: u32, slope: f32 }
}

/// Records `y = leaky_relu(x)`; `y` may be `x`.
pub fn record(gpu: &Gpu, rec: &mut Recorder, x: &DeviceTensor, y: &DeviceTensor, slope: f32) -> Result<()> {
    assert_eq!(x.shape, y.shape);
    let kernel = gpu.kernel::<shaders::leaky_relu::Shader>(&Default::default())?;
    for (begin, count) in windows(gpu.info(), y.shape.texels()) {
        let bind = shaders::leaky_relu::Bind { x: x.slice.clone(), y: y.slice.slice(begin * 16, count * 16) };
        rec.dispatch(&kernel, &bind, &Push { begin: begin as u32, count: count as u32, slope }, groups(count));
    }
    Ok(())
}
