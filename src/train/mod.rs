//! Training: the data, the loss, the optimiser, the step, the run.

pub mod adam;
pub mod backward;
pub mod checkpoint;
pub mod data;
pub mod kernel;
pub mod loss;
pub mod loss_scale;
pub mod reference;
pub mod run;
pub mod schedule;
pub mod step;
