//! The neural network: tensors, layers, architectures and weights.
//!
//! A layer is one shader and one file here that holds its `reference`: the definition in f64, which every device kernel
//! is tested against. An [architecture](architecture::Architecture) is a short list of named layers.

pub mod architecture;
pub mod base;
pub mod device;
pub mod kernel;
pub mod layer;
pub mod parameters;
pub mod plan;
pub mod reference;
pub mod tensor;
pub mod tza;
pub mod weights;
