//! Numerical stress: what must hold on every device, so that a driver can be qualified. `limpid stress` runs the cases, and
//! tests/stress.rs runs each as a test under the validation layer.
//!
//! T1 to T37 are about rendering, N1 and on about the network. A case measures and compares with a bar that is derived where
//! it stands; what cannot be run says why.

mod accumulation;
mod geometry;
mod intersection;
mod lights;
mod meshes;
mod network;
mod outcome;
mod platform;
mod sampling;
mod scenes;
pub mod support;
mod symmetry;
mod transport;
mod welch;

pub use outcome::{Checks, Measure, Outcome, Side};
pub use welch::estimators_agree;

use crate::Result;
use crate::gpu::Gpu;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// One case.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// `T1`, `N1` and so on.
    pub number: &'static str,
    /// A few words.
    pub name: &'static str,
    /// What must hold.
    pub claim: &'static str,
    run: fn(&Gpu) -> Result<Outcome>,
}

impl Case {
    /// Runs it. An error of the renderer or the device is a failure, and so is a panic: what a driver gets wrong may break
    /// what the case takes for granted, and the other cases shall still run.
    #[must_use]
    pub fn run(&self, gpu: &Gpu) -> Outcome {
        outcome_of(|| (self.run)(gpu))
    }
}

fn outcome_of(run: impl FnOnce() -> Result<Outcome>) -> Outcome {
    match catch_unwind(AssertUnwindSafe(run)) {
        Ok(outcome) => outcome.unwrap_or_else(|error| Outcome::failed(error.to_string())),
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
            Outcome::failed(format!("panicked: {}", text.unwrap_or("no message")))
        }
    }
}

/// All cases, by number.
#[must_use]
pub fn cases() -> Vec<Case> {
    let mut cases: Vec<Case> = [
        transport::CASES,
        lights::CASES,
        symmetry::CASES,
        sampling::CASES,
        intersection::CASES,
        geometry::CASES,
        meshes::CASES,
        scenes::CASES,
        accumulation::CASES,
        platform::CASES,
        network::CASES,
    ]
    .concat();
    cases.sort_by_key(|case| {
        let (kind, number) = case.number.split_at(1);
        (kind == "N", number.parse::<u32>().unwrap_or(u32::MAX))
    });
    cases
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_and_panics_are_failures() {
        let end = std::hint::black_box(3);
        for (outcome, cause) in [
            (outcome_of(|| Err(crate::Error::input("bad"))), "bad"),
            (outcome_of(|| panic!("worse")), "panicked: worse"),
            (outcome_of(|| panic!("at {end}")), "panicked: at 3"),
        ] {
            assert_eq!((outcome.verdict(), outcome.lines()), ("FAILED", vec![cause.to_owned()]));
        }
    }
}
