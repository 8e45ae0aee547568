//! How many loop iterations one shader run may make.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use crate::gpu::Gpu;
use crate::{Result, shaders};

crate::push_block! {
    /// Push constants of `loop_probe`.
    pub struct Push for crate::shaders::loop_probe { wanted: u32, random_seed: u32 }
}

/// Iterations that the probe asks for.
pub(super) const WANTED: u32 = 100_000;

static KNOWN: Mutex<Option<HashMap<String, u32>>> = Mutex::new(None);

/// Iterations that a shader on this device makes of the 100,000 asked for: 100,000, or where the driver silently stops.
/// Measured once a device and process.
pub fn loop_limit(gpu: &Gpu) -> Result<u32> {
    let info = gpu.info();
    let name = format!("{} {}", info.name, info.driver);
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    let known = known.get_or_insert_default();
    if let Some(&limit) = known.get(&name) {
        return Ok(limit);
    }
    let limit = measure(gpu)?;
    known.insert(name, limit);
    Ok(limit)
}

fn measure(gpu: &Gpu) -> Result<u32> {
    let kernel = gpu.kernel::<shaders::loop_probe::Shader>(&shaders::loop_probe::Spec {})?;
    let trips = gpu.buffer("loop probe", 256)?;
    let mut rec = gpu.recorder();
    let push = Push { wanted: WANTED, random_seed: 1 };
    rec.dispatch(&kernel, &shaders::loop_probe::Bind { trips: trips.all() }, &push, [1, 1, 1]);
    rec.finish()?.run()?;
    let counts: Vec<[u32; 2]> = gpu.download(&trips.slice(0, 64))?;
    Ok(counts.iter().map(|c| c[0]).min().unwrap_or(0))
}
