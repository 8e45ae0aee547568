//! Training: the loss, the optimiser, the step.

pub mod adam;
pub mod loss;
pub mod reference;
