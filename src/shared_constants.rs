//! Constants that shaders and host share: stated here once, passed to every shader as macros by `build.rs`.

/// The transfer `t = ln(1 + exposure * radiance)`.
pub const TRANSFER_LOG1P: u32 = 0;
/// The transfer of Open Image Denoise for radiance: a fit of a perceptually uniform curve.
pub const TRANSFER_PU: u32 = 1;

/// One over what is added to albedo before radiance is divided by it: dark surfaces stay finite.
pub const DEMODULATION: u32 = 20;

/// Name and value of each macro.
pub const SHARED: &[(&str, u32)] =
    &[("TRANSFER_LOG1P", TRANSFER_LOG1P), ("TRANSFER_PU", TRANSFER_PU), ("DEMODULATION", DEMODULATION)];
