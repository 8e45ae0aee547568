//! When a render is done: at a number of samples, at an error, after a time.

use super::renderer::Renderer;
use crate::Result;
use std::time::Duration;

/// Samples before the first estimate: two a half.
const FIRST_SAMPLES: u32 = 4;
/// Samples that tell how long one takes.
const FIRST_TIMED_SAMPLES: u32 = 2;
/// Samples between two looks at the clock at most.
const MOST_SAMPLES_AT_A_TIME: u32 = 64;

/// What ends a render, beside the samples of its settings; the first that is reached.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Goal {
    /// The estimated relMSE is at most this; needs [`Settings::halves`](super::Settings::halves).
    pub relmse: Option<f64>,
    /// It has taken this long by the clock.
    pub time: Option<Duration>,
}

/// What ended a render.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reached {
    /// All samples of the settings.
    Samples,
    /// The error.
    Error,
    /// The time.
    Time,
}

impl Reached {
    /// The name of what was reached.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Samples => "samples",
            Self::Error => "error",
            Self::Time => "time",
        }
    }
}

/// A goal and how far the render is from it.
#[derive(Clone, Debug, Default)]
pub struct Pursuit {
    goal: Goal,
    /// The last estimate of the relMSE.
    pub relmse: Option<f64>,
    /// Samples and time at the last look.
    last: (u32, Duration),
}

/// What to do next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Every pixel should have so many samples.
    Samples(u32),
    /// Nothing.
    Done(Reached),
}

impl From<Goal> for Pursuit {
    fn from(goal: Goal) -> Self {
        Self { goal, ..Self::default() }
    }
}

impl Pursuit {
    /// What comes next, asked when every pixel has the same number of samples; `elapsed` is the time since the first sample.
    pub fn next(&mut self, renderer: &mut Renderer, elapsed: Duration) -> Result<Next> {
        let (done, most) = (renderer.samples_done(), renderer.settings().spp);
        if self.goal.relmse.is_some() {
            self.relmse = renderer.relmse_estimate()?;
        }
        let reached = |limit: f64| self.relmse.is_some_and(|error| error <= limit);
        if self.goal.relmse.is_some_and(reached) {
            return Ok(Next::Done(Reached::Error));
        }
        if done >= most {
            return Ok(Next::Done(Reached::Samples));
        }
        let wanted = self.goal.relmse.map_or(most, |limit| samples_for(limit, self.relmse, done));
        let Some(time) = self.goal.time else { return Ok(Next::Samples(wanted.min(most))) };
        let affordable = self.samples_within(time, done, elapsed);
        self.last = (done, elapsed);
        // Halves stay equal: an odd sample would leave no estimate.
        let affordable = if self.goal.relmse.is_some() { affordable / 2 * 2 } else { affordable };
        if done > 0 && affordable == 0 {
            return Ok(Next::Done(Reached::Time));
        }
        Ok(Next::Samples(wanted.min(done + affordable.max(1)).min(most)))
    }

    /// The part of the way to the goal that is behind, 0 to 1; none where the samples alone end the render.
    #[must_use]
    pub fn share(&self, elapsed: Duration) -> Option<f64> {
        let error = self.goal.relmse.map(|limit| self.relmse.map_or(0.0, |error| limit / error));
        let time = self.goal.time.map(|time| elapsed.as_secs_f64() / time.as_secs_f64());
        let share = error.into_iter().chain(time).reduce(f64::max)?;
        Some(share.clamp(1e-3, 1.0))
    }

    /// Samples that fit into what is left of `time`, by the speed since the last look: half of them where they are many,
    /// because the speed is not constant.
    fn samples_within(&self, time: Duration, done: u32, elapsed: Duration) -> u32 {
        let (before, then) = self.last;
        if done <= before {
            return FIRST_TIMED_SAMPLES;
        }
        let each = (elapsed.saturating_sub(then)).as_secs_f64() / f64::from(done - before);
        let fit = time.saturating_sub(elapsed).as_secs_f64() / each.max(1e-9);
        let fit = fit.min(f64::from(2 * MOST_SAMPLES_AT_A_TIME)) as u32;
        if fit > 4 { fit / 2 } else { fit }
    }
}

/// Samples after which the error may be `limit`: it falls at least as 1/samples, so that fewer would do; at most twice those
/// that there are, because an estimate of few samples is rough, and a sixteenth more at least, because among many estimates
/// one is low by luck. Even, for two halves.
fn samples_for(limit: f64, estimate: Option<f64>, done: u32) -> u32 {
    let Some(error) = estimate else { return FIRST_SAMPLES.max(done.next_multiple_of(2)) };
    let wanted = (f64::from(done) * error / limit).ceil().min(2.0 * f64::from(done)) as u32;
    wanted.max(done + done / 16).max(done + 2).next_multiple_of(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_approach_the_error_from_above() {
        assert_eq!(samples_for(0.01, None, 0), 4);
        assert_eq!(samples_for(0.01, Some(0.1), 4), 8, "no more than twice");
        assert_eq!(samples_for(0.01, Some(0.015), 16), 24);
        assert_eq!(samples_for(0.01, Some(0.0101), 16), 18, "even, and at least two more");
        assert_eq!(samples_for(0.01, Some(f64::INFINITY), 8), 16);
        assert_eq!(samples_for(0.01, Some(0.0101), 1600), 1700, "a sixteenth more");
    }
}
