//! Training: the loss, the optimiser, the step.

pub mod adam;
pub mod backward;
pub mod kernel;
pub mod loss;
pub mod reference;
pub mod step;
