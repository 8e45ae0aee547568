//! The filter of a kernel-predicting network: `kernel_filter.comp`.

use crate::Result;
use crate::gpu::{Gpu, Recorder};
use crate::net::device::{DeviceTensor, groups, windows};
use crate::net::layer::kernel_filter;
use crate::{push_block, shaders};

push_block! {
    /// Push constants of `kernel_filter.comp`.
    pub struct Push for shaders::kernel_filter { begin: u32, count: u32, height: u32, width: u32 }
}

/// What a filter reads.
#[derive(Clone, Copy)]
pub struct Operands<'a> {
    /// Logits.
    pub logits: &'a DeviceTensor,
    /// Noisy pixels.
    pub fine: &'a DeviceTensor,
    /// The coarser level, but at the coarsest.
    pub coarse: Option<&'a DeviceTensor>,
}

impl Operands<'_> {
    /// # Panics
    /// Where sizes or channels do not fit.
    pub fn check(&self) {
        let s = self.fine.shape;
        let l = self.logits.shape;
        assert_eq!((l.n, l.h, l.w), (s.n, s.h, s.w));
        assert_eq!(l.c.count() as usize, kernel_filter::logits(self.coarse.is_some()));
        if let Some(coarse) = self.coarse {
            assert_eq!((coarse.shape.n, coarse.shape.h * 2, coarse.shape.w * 2), (s.n, s.h, s.w));
        }
    }
}

/// Records the filtered pixels `y`.
pub fn record(gpu: &Gpu, rec: &mut Recorder, x: Operands<'_>, y: &DeviceTensor) -> Result<()> {
    x.check();
    let s = y.shape;
    let spec = shaders::kernel_filter::Spec { coarse: x.coarse.is_some() };
    let kernel = gpu.kernel::<shaders::kernel_filter::Shader>(&spec)?;
    for (begin, count) in windows(gpu.info(), s.texels()) {
        let push = Push { begin: begin as u32, count: count as u32, height: s.h, width: s.w };
        let bind = shaders::kernel_filter::Bind {
            logit: x.logits.slice.clone(),
            fine: x.fine.slice.clone(),
            // Not read where there is none.
            coarse: x.coarse.unwrap_or(x.fine).slice.clone(),
            y: y.slice.slice(begin * 16, count * 16),
        };
        rec.dispatch(&kernel, &bind, &push, groups(count));
    }
    Ok(())
}
