//! The neural network.

pub mod device;
pub mod kernel;
