//! Training: the data, the loss, the optimiser, the step, the run.

pub mod adam;
pub mod backward;
pub mod batch;
pub mod checkpoint;
pub mod data;
pub mod dataset;
pub mod evaluate;
pub mod kernel;
pub mod loss;
pub mod loss_scale;
pub mod plot;
pub mod preset;
pub mod reference;
pub mod run;
pub mod schedule;
pub mod split;
pub mod state;
pub mod step;
