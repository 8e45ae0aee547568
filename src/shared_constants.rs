//! Constants that shaders and host share: stated here once, passed to every shader as macros by `build.rs`.

/// Name and value of each macro.
pub const SHARED: &[(&str, u32)] = &[];
