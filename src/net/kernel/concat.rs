//! Channel concatenation: `concat.comp`.

use crate::Result;
use crate::gpu::{Gpu, Recorder};
use crate::net::device::{DeviceTensor, groups, windows};
use crate::{push_block, shaders};

push_block! {
    /// Push constants of `concat.comp`.
    pub struct Push for shaders::concat { begin: u32, count: u32, a4: u32, b4: u32, width: u32 }
}

/// Records `y = [a, b]` along the channels; `y` has two segments.
pub fn record(gpu: &Gpu, rec: &mut Recorder, a: &DeviceTensor, b: &DeviceTensor, y: &DeviceTensor) -> Result<()> {
    assert_eq!((a.shape.c.count(), b.shape.c.count()), (y.shape.c.first, y.shape.c.second));
    let kernel = gpu.kernel::<shaders::concat::Shader>(&Default::default())?;
    for (begin, count) in windows(gpu.info(), y.shape.texels()) {
        let (a4, b4, width) = (a.shape.c.texels(), b.shape.c.texels(), y.shape.w);
        let push = Push { begin: begin as u32, count: count as u32, a4, b4, width };
        let y = y.slice.slice(begin * 16, count * 16);
        let bind = shaders::concat::Bind { a: a.slice.clone(), b: b.slice.clone(), y };
        rec.dispatch(&kernel, &bind, &push, groups(count));
    }
    Ok(())
}
