//! Gradients of the filter of a kernel-predicting network and of what follows it.

use crate::Result;
use crate::gpu::{Gpu, Recorder, Slice};
use crate::net::device::{DeviceTensor, groups, windows};
use crate::net::kernel::kernel_filter::Operands;
use crate::{push_block, shaders};

push_block! {
    /// Push constants of `modulate_backward.comp`.
    pub struct ModulatePush for shaders::modulate_backward { begin: u32, count: u32, width: u32 }
}
push_block! {
    /// Push constants of `kernel_filter_backward.comp`.
    pub struct LogitsPush for shaders::kernel_filter_backward { begin: u32, rows: u32, height: u32, width: u32 }
}
push_block! {
    /// Push constants of `kernel_filter_backward_coarse.comp`.
    pub struct CoarsePush for shaders::kernel_filter_backward_coarse { begin: u32, count: u32, height: u32, width: u32 }
}

/// Rows of a tensor that a slice may begin with: so many have a multiple of 256 bytes.
const ROW_STEP: u64 = 16;

/// Records the gradient of modulation with respect to the filtered radiance `x`.
pub fn modulate(
    gpu: &Gpu,
    rec: &mut Recorder,
    (x, input): (&DeviceTensor, &DeviceTensor),
    dy: &DeviceTensor,
    dx: &DeviceTensor,
) -> Result<()> {
    let s = dx.shape;
    assert_eq!((x.shape, dy.shape.texels(), input.shape.texels()), (s, s.texels(), 3 * s.texels()));
    let kernel = gpu.kernel::<shaders::modulate_backward::Shader>(&Default::default())?;
    for (begin, count) in windows(gpu.info(), s.texels()) {
        let push = ModulatePush { begin: begin as u32, count: count as u32, width: s.w };
        let [x, input_, dy] = [x, input, dy].map(|t| t.slice.clone());
        let bind = shaders::modulate_backward::Bind { x, input_, dy, dx: dx.slice.slice(begin * 16, count * 16) };
        rec.dispatch(&kernel, &bind, &push, groups(count));
    }
    Ok(())
}

/// Records the gradient with respect to the logits; `kept`, 16 bytes a pixel, is what [`coarse`] needs of it.
pub fn logits(
    gpu: &Gpu,
    rec: &mut Recorder,
    x: Operands<'_>,
    dy: &DeviceTensor,
    kept: &Slice,
    dx: &DeviceTensor,
) -> Result<()> {
    x.check();
    let s = dx.shape;
    assert_eq!(x.logits.shape, s);
    let spec = shaders::kernel_filter_backward::Spec { coarse: x.coarse.is_some() };
    let kernel = gpu.kernel::<shaders::kernel_filter_backward::Shader>(&spec)?;
    let (row, rows) = (u64::from(s.w) * u64::from(s.c.texels()) * 16, u64::from(s.n) * u64::from(s.h));
    let most = (gpu.info().max_storage_range / row / ROW_STEP * ROW_STEP).max(ROW_STEP);
    for begin in (0..rows).step_by(most as usize) {
        let count = most.min(rows - begin);
        let push = LogitsPush { begin: begin as u32, rows: count as u32, height: s.h, width: s.w };
        let pixels = u64::from(s.w) * 16;
        let bind = shaders::kernel_filter_backward::Bind {
            logit: x.logits.slice.clone(),
            fine: x.fine.slice.clone(),
            coarse: x.coarse.unwrap_or(x.fine).slice.clone(),
            dy: dy.slice.clone(),
            kept: kept.slice(begin * pixels, count * pixels),
            dx: dx.slice.slice(begin * row, count * row),
        };
        rec.dispatch(&kernel, &bind, &push, groups(count * u64::from(s.w)));
    }
    Ok(())
}

/// Records the gradient with respect to the coarser level, after [`logits`].
pub fn coarse(
    gpu: &Gpu,
    rec: &mut Recorder,
    logits: &DeviceTensor,
    coarse: &DeviceTensor,
    kept: &Slice,
    dx: &DeviceTensor,
) -> Result<()> {
    let s = dx.shape;
    assert_eq!((coarse.shape, logits.shape.h, logits.shape.w), (s, 2 * s.h, 2 * s.w));
    let kernel = gpu.kernel::<shaders::kernel_filter_backward_coarse::Shader>(&Default::default())?;
    for (begin, count) in windows(gpu.info(), s.texels()) {
        let push = CoarsePush { begin: begin as u32, count: count as u32, height: s.h, width: s.w };
        let bind = shaders::kernel_filter_backward_coarse::Bind {
            logit: logits.slice.clone(),
            kept: kept.clone(),
            coarse: coarse.slice.clone(),
            dx: dx.slice.slice(begin * 16, count * 16),
        };
        rec.dispatch(&kernel, &bind, &push, groups(count));
    }
    Ok(())
}
