//! Which kernels a device runs: the fastest family that its facts allow and that has passed its self-check, or the one
//! that was asked for.
//!
//! A family other than `portable` is checked at first use on rows of the case table. The verdict is kept on disk, for this
//! device, its driver and these shaders.

pub mod check;
mod run;
mod verdict;

use crate::gpu::Gpu;
use crate::net::kernel::{Family, Offer};
use crate::net::tensor::Tensor;
use crate::{Error, Result};
use check::{Purpose, Row};
use serde::Serialize;
use std::time::Instant;
use verdict::Verdict;

/// What the self-check found of a family.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SelfCheck {
    /// [`Family::name`].
    pub kernels: &'static str,
    /// Kernel, row and error of the first failure; none where all passed.
    pub failure: Option<String>,
    /// Whether an earlier process found it.
    pub remembered: bool,
    /// What it took, milliseconds.
    pub ms: f64,
}

/// The kernels to use.
#[derive(Clone, Debug)]
pub struct Choice {
    /// These.
    pub family: Family,
    /// The checks that led to them: failures, then at most one success. `portable` needs none.
    pub checks: Vec<SelfCheck>,
}

impl Choice {
    /// One line for each family that is passed over because it failed.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        let failed = self.checks.iter().filter_map(|check| Some((check.kernels, check.failure.as_ref()?)));
        let name = self.family.name();
        failed.map(|(kernels, why)| format!("the kernels `{kernels}` fail here, using `{name}`: {why}")).collect()
    }
}

/// Chooses the kernels of a device; with a name in `wanted`, those or an error.
pub fn choose(gpu: &Gpu, wanted: Option<&str>, purpose: Purpose) -> Result<Choice> {
    choose_with(gpu, wanted, purpose, |family, row| run::run(gpu, family, row))
}

/// [`choose`], with `run` computing the rows of the self-check.
pub fn choose_with(
    gpu: &Gpu,
    wanted: Option<&str>,
    purpose: Purpose,
    mut run: impl FnMut(Family, &Row) -> Result<Tensor>,
) -> Result<Choice> {
    if let Some(wanted) = wanted {
        let offers = Family::offers(gpu.info());
        let family = offers.iter().find(|o| o.name == wanted).and_then(|o| o.family.clone().ok());
        let family = family.ok_or_else(|| refusal(&gpu.info().name, wanted, &offers))?;
        let check = self_check(gpu, family, purpose, true, &mut run)?;
        if let Some(why) = check.as_ref().and_then(|check| check.failure.as_ref()) {
            return Err(Error::Gpu(format!("the kernels `{wanted}` fail on {}: {why}", gpu.info().name)));
        }
        return Ok(Choice { family, checks: check.into_iter().collect() });
    }
    let mut checks = Vec::new();
    for family in Family::candidates(gpu.info()) {
        let check = self_check(gpu, family, purpose, false, &mut run)?;
        let passed = check.as_ref().is_none_or(|check| check.failure.is_none());
        checks.extend(check);
        if passed {
            return Ok(Choice { family, checks });
        }
    }
    Ok(Choice { family: Family::Portable, checks })
}

/// What a device runs, and why not the rest.
fn refusal(device: &str, wanted: &str, offers: &[Offer]) -> Error {
    let runs: Vec<_> = offers.iter().filter(|o| o.family.is_ok()).map(|o| o.name).collect();
    let not = |o: &Offer| Some(format!("; not {}: {}", o.name, o.family.as_ref().err()?));
    let not: String = offers.iter().filter_map(not).collect();
    Error::input(format!("no kernels `{wanted}` on {device}: it runs {}{not}", runs.join(", ")))
}

/// Checks a family, or recalls what an earlier process found; a failure is not believed where `again`. None for `portable`,
/// which is what remains.
fn self_check(
    gpu: &Gpu,
    family: Family,
    purpose: Purpose,
    again: bool,
    run: &mut impl FnMut(Family, &Row) -> Result<Tensor>,
) -> Result<Option<SelfCheck>> {
    if family == Family::Portable {
        return Ok(None);
    }
    let kernels = family.name();
    let start = Instant::now();
    let done = |failure, remembered| {
        Ok(Some(SelfCheck { kernels, failure, remembered, ms: start.elapsed().as_secs_f64() * 1e3 }))
    };
    let file = gpu.cache_file(&format!("checks/{kernels}-{}", purpose.name()));
    match file.as_deref().and_then(Verdict::recall) {
        Some(Verdict::Passed) => return done(None, true),
        Some(Verdict::Failed(why)) if !again => return done(Some(why), true),
        _ => {}
    }
    let found = check::check(family, purpose, |row| run(family, row));
    let verdict = match &found {
        Ok(None) => Verdict::Passed,
        Ok(Some(why)) => Verdict::Failed(why.clone()),
        // The next process had better not try again; any other error says nothing of the kernels.
        Err(error @ Error::DeviceLost(_)) => Verdict::Failed(error.to_string()),
        Err(_) => return found.map(|_| None),
    };
    if let Some(file) = &file {
        verdict.remember(file);
    }
    done(found?, false)
}
