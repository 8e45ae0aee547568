//! Gradients of the layers on the device.

pub mod conv2d;
pub mod coop;
pub mod elementwise;
pub mod kernel_filter;
