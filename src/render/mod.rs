//! The path tracer: a scene and settings in, radiance and first-hit values on the device out.
//!
//! ```text
//! Scene ─ Features ─ pipelines      path_trace: sums per pixel, any range of samples     resolve: means
//!       └ rows (f32, recentred) ─┘
//! ```
//! A sample is a pure function of (pixel, sample, seed). Samples are summed in blocks of 64 counted from sample 0, so every
//! cut of the work into dispatches gives the same bits, and 16,384 samples lose nothing in f32.

mod checkpoint;
mod enclosure;
mod environment;
mod error_estimate;
mod features;
mod goal;
mod mesh;
mod mesh_probe;
mod output;
mod pack;
mod probe;
mod renderer;
mod settings;
mod state;

pub use features::{Features, MAX_UNROLLED, Skip};
pub use goal::{Goal, Next, Pursuit, Reached};
pub(crate) use mesh_probe::closest_triangles;
pub use output::Outputs;
pub use pack::FilmWindow;
pub use probe::loop_limit;
pub use renderer::{Progress, Renderer, Stats};
pub use settings::{Estimator, Sampler, Settings};
