//! What a case found: measures, each with its bar.

use serde::Serialize;
use std::fmt;

/// What became of a case.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "outcome", rename_all = "snake_case")]
pub enum Outcome {
    /// Every measure is within its bar.
    Passed {
        /// What was measured.
        measures: Vec<Measure>,
    },
    /// A measure is beyond its bar, or the case ended early.
    Failed {
        /// What was measured.
        measures: Vec<Measure>,
        /// Why it ended early, if it did.
        error: Option<String>,
    },
    /// The case does not apply here.
    NotRun {
        /// Why.
        reason: String,
    },
}

/// Which side of its bar a measure must lie on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// The bar or less.
    AtMost,
    /// The bar or more.
    AtLeast,
}

/// The worst of several comparisons of one kind: the value furthest beyond its bar, or nearest to it.
#[derive(Clone, Debug, Serialize)]
pub struct Measure {
    /// What was measured, with its unit.
    pub what: &'static str,
    /// Comparisons made.
    pub compared: u64,
    /// Of these, those beyond their bar.
    pub failed: u64,
    /// The worst value.
    pub value: f64,
    /// On which side of the bar it must be.
    pub side: Side,
    /// Its bar.
    pub bar: f64,
    /// Where it was found.
    pub at: String,
}

impl Measure {
    fn rank(&self) -> f64 {
        Self::severity(self.side, self.value, self.bar)
    }

    /// Over 1 beyond the bar; larger is worse.
    fn severity(side: Side, value: f64, bar: f64) -> f64 {
        let within = match side {
            Side::AtMost => value <= bar,
            Side::AtLeast => value >= bar,
        };
        let ratio = match side {
            Side::AtMost => value / bar,
            Side::AtLeast => bar / value,
        };
        match (within, ratio.is_finite()) {
            (true, true) => ratio.clamp(-1e300, 1.0),
            (true, false) => 1.0,
            (false, true) => ratio.abs().max(1.0) + 1.0,
            // Not a number, or a bar of 0.
            (false, false) => {
                if value.is_finite() {
                    1e300
                } else {
                    f64::INFINITY
                }
            }
        }
    }
}

impl fmt::Display for Measure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let side = match self.side {
            Side::AtMost => "at most",
            Side::AtLeast => "at least",
        };
        write!(f, "{} {} ({side} {})", self.what, short(self.value), short(self.bar))?;
        if self.failed > 0 {
            write!(f, ", {} of {} beyond, the worst {}", self.failed, self.compared, self.at)?;
        }
        Ok(())
    }
}

/// A number as people read it.
fn short(value: f64) -> String {
    match value.abs() {
        v if v == 0.0 || (1e-3..1e7).contains(&v) => {
            let text = format!("{value:.4}");
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        }
        _ => format!("{value:.2e}"),
    }
}

/// Collects the comparisons of a case. What is not a number is beyond every bar.
#[derive(Debug, Default)]
pub struct Checks {
    measures: Vec<Measure>,
}

impl Checks {
    /// `value` must be `bar` or less.
    pub fn at_most(&mut self, what: &'static str, value: f64, bar: f64, at: impl fmt::Display) {
        self.compare(what, Side::AtMost, value, bar, &at);
    }

    /// `value` must be `bar` or more.
    pub fn at_least(&mut self, what: &'static str, value: f64, bar: f64, at: impl fmt::Display) {
        self.compare(what, Side::AtLeast, value, bar, &at);
    }

    /// `wrong` must be 0.
    pub fn none(&mut self, what: &'static str, wrong: usize, at: impl fmt::Display) {
        self.at_most(what, wrong as f64, 0.0, at);
    }

    /// `count` must be `expected`: measured is their difference.
    pub fn count(&mut self, what: &'static str, count: u64, expected: u64, at: impl fmt::Display) {
        self.at_most(what, count.abs_diff(expected) as f64, 0.0, format_args!("{at}: {count}, expected {expected}"));
    }

    /// `holds` must hold: measured is how often it did not.
    pub fn holds(&mut self, what: &'static str, holds: bool, at: impl fmt::Display) {
        self.none(what, usize::from(!holds), at);
    }

    fn compare(&mut self, what: &'static str, side: Side, value: f64, bar: f64, at: &dyn fmt::Display) {
        let severity = Measure::severity(side, value, bar);
        let failed = u64::from(severity > 1.0);
        match self.measures.iter_mut().find(|m| m.what == what && m.side == side) {
            Some(m) => {
                m.compared += 1;
                m.failed += failed;
                if severity > m.rank() {
                    (m.value, m.bar, m.at) = (value, bar, at.to_string());
                }
            }
            None => self.measures.push(Measure { what, compared: 1, failed, value, side, bar, at: at.to_string() }),
        }
    }

    /// What the case found. A case that compared nothing has failed.
    #[must_use]
    pub fn outcome(self) -> Outcome {
        let mut measures = self.measures;
        // The closest to its bar first.
        measures.sort_by(|a, b| b.rank().total_cmp(&a.rank()));
        if measures.is_empty() {
            return Outcome::failed("nothing was measured");
        }
        if measures.iter().all(|m| m.failed == 0) {
            Outcome::Passed { measures }
        } else {
            Outcome::Failed { measures, error: None }
        }
    }
}

impl Outcome {
    /// Does not apply here.
    #[must_use]
    pub fn not_run(reason: impl Into<String>) -> Self {
        Self::NotRun { reason: reason.into() }
    }

    /// Ended early.
    #[must_use]
    pub fn failed(error: impl Into<String>) -> Self {
        Self::Failed { measures: Vec::new(), error: Some(error.into()) }
    }

    /// In a word.
    #[must_use]
    pub const fn verdict(&self) -> &'static str {
        match self {
            Self::Passed { .. } => "passed",
            Self::Failed { .. } => "FAILED",
            Self::NotRun { .. } => "not run",
        }
    }

    /// What was measured, or why nothing was: one line each. Of a failure, only what is beyond its bar.
    #[must_use]
    pub fn lines(&self) -> Vec<String> {
        match self {
            Self::Passed { measures } => measures.iter().map(ToString::to_string).collect(),
            Self::Failed { measures, error } => {
                let beyond = measures.iter().filter(|m| m.failed > 0).map(ToString::to_string);
                beyond.chain(error.clone()).collect()
            }
            Self::NotRun { reason } => vec![reason.clone()],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(check: impl Fn(&mut Checks)) -> Outcome {
        let mut checks = Checks::default();
        check(&mut checks);
        checks.outcome()
    }

    #[test]
    fn what_is_beyond_its_bar_fails() {
        let passes: [fn(&mut Checks); 6] = [
            |c| c.at_most("a", 1.0, 1.0, ""),
            |c| c.at_most("a", -1.0, 0.0, ""),
            |c| c.at_least("a", 1.0, 1.0, ""),
            |c| c.none("a", 0, ""),
            |c| c.count("a", 3, 3, ""),
            |c| c.holds("a", true, ""),
        ];
        for check in passes {
            assert!(matches!(outcome(check), Outcome::Passed { .. }), "{:?}", outcome(check));
        }
        let fails: [fn(&mut Checks); 9] = [
            |_| (),
            |c| c.at_most("a", 1.1, 1.0, ""),
            |c| c.at_most("a", 1e-300, 0.0, ""),
            |c| c.at_most("a", f64::NAN, 1.0, ""),
            |c| c.at_most("a", 1.0, f64::NAN, ""),
            |c| c.at_least("a", f64::NAN, 1.0, ""),
            |c| c.at_least("a", -1.0, 1.0, ""),
            |c| c.none("a", 1, ""),
            |c| c.holds("a", false, ""),
        ];
        for check in fails {
            assert!(matches!(outcome(check), Outcome::Failed { .. }), "{:?}", outcome(check));
        }
    }

    #[test]
    fn the_worst_is_kept() {
        let found = outcome(|c| {
            for (value, at) in [(1.0, "first"), (5.0, "worst"), (3.0, "last")] {
                c.at_most("error", value, 2.0, at);
            }
        });
        let Outcome::Failed { measures, .. } = &found else { panic!("{found:?}") };
        assert_eq!((measures[0].compared, measures[0].failed, measures[0].value), (3, 2, 5.0));
        assert_eq!(found.lines(), ["error 5 (at most 2), 2 of 3 beyond, the worst worst"]);
        let found = outcome(|c| {
            c.at_most("error", f64::NAN, 2.0, "nan");
            c.at_most("error", 7.0, 2.0, "seven");
        });
        let Outcome::Failed { measures, .. } = &found else { panic!("{found:?}") };
        assert!(measures[0].at == "nan" && measures[0].failed == 2);
    }
}
