//! What takes how long on the device, and what the device can do at most.

pub mod error;
pub mod network;
pub mod skip;

use crate::gpu::{Commands, Gpu};
use crate::{Result, push_block, shaders};
use serde::Serialize;

push_block! {
    /// Push constants of `peak.comp`.
    pub struct PeakPush for shaders::peak { passes: u32, factor: f32, addend: f32 }
}

/// Device milliseconds of equal runs.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Times {
    /// The middle one.
    pub median: f64,
    /// The shortest.
    pub min: f64,
    /// The longest.
    pub max: f64,
}

impl Times {
    /// Of at least one run.
    ///
    /// # Panics
    /// Where there is none.
    #[must_use]
    pub fn of(mut ms: Vec<f64>) -> Self {
        ms.sort_by(f64::total_cmp);
        Self { median: ms[ms.len() / 2], min: ms[0], max: ms[ms.len() - 1] }
    }
}

/// The first run of what was timed, with the driver's compilation, milliseconds on the host.
pub type WarmUp = f64;

/// What the device can do at most, GFLOP/s: multiplications and additions on registers.
pub fn peak(gpu: &Gpu) -> Result<f64> {
    const INVOCATIONS: u32 = 64 * 512;
    const PASSES: u32 = 512;
    let sum = gpu.buffer("sum", u64::from(INVOCATIONS) * 16)?;
    let mut rec = gpu.recorder();
    let kernel = gpu.kernel::<shaders::peak::Shader>(&Default::default())?;
    let push = PeakPush { passes: PASSES, factor: 0.999, addend: 0.001 };
    rec.dispatch(&kernel, &shaders::peak::Bind { sum: sum.all() }, &push, [INVOCATIONS / 64, 1, 1]);
    let mut commands = rec.finish()?;
    let (times, _) = repeat(&mut commands, 5)?;
    Ok(f64::from(INVOCATIONS) * f64::from(PASSES) * 384.0 / times.min * 1e-6)
}

fn repeat(commands: &mut Commands, runs: u32) -> Result<(Times, WarmUp)> {
    let warm_up = commands.run()?.wall_ms;
    let ms = (0..runs).map(|_| Ok(commands.run()?.device_ms)).collect::<Result<_>>()?;
    Ok((Times::of(ms), warm_up))
}
