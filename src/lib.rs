//! limpid: path tracing, reconstruction and training in hand-written Vulkan compute shaders.
#![deny(unsafe_code)]
#![warn(missing_docs)]

pub mod bench;
mod chart;
pub mod denoise;
pub mod error;
pub mod gpu;
pub mod image;
pub mod kernels;
pub mod metrics;
mod named;
pub mod net;
pub mod render;
pub mod scene;
pub mod shaders;
pub mod shared_constants;
pub mod stress;
pub mod train;

pub use error::{Error, Result};
