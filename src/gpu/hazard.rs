//! A second opinion on barriers: finds operations that touch the same bytes, at least one writing, with no barrier between.
//! CPU drivers run dispatches one after another, so a missing barrier shows only here or on a real GPU.

/// Bytes that one operation touches.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AccessRange {
    /// Which buffer.
    pub buffer: u64,
    /// First byte.
    pub begin: u64,
    /// One past the last byte.
    pub end: u64,
    /// Whether it writes.
    pub write: bool,
}

impl AccessRange {
    /// Whether the two must be ordered.
    #[must_use]
    pub fn conflicts(&self, other: &Self) -> bool {
        self.buffer == other.buffer && (self.write || other.write) && self.begin < other.end && other.begin < self.end
    }
}

/// One entry of a recorded command list.
#[derive(Clone, Debug)]
pub enum Event {
    /// Everything before happens before everything after.
    Barrier,
    /// A dispatch, fill or copy.
    Operation {
        /// Shader name, `fill` or `copy`.
        name: String,
        /// What it touches.
        accesses: Vec<AccessRange>,
    },
}

/// The first pair of operations that a barrier should have ordered, in words.
pub fn check(events: &[Event]) -> Result<(), String> {
    for (j, later) in events.iter().enumerate() {
        let Event::Operation { name, accesses } = later else { continue };
        for (i, earlier) in events[..j].iter().enumerate().rev() {
            let Event::Operation { name: before, accesses: touched } = earlier else { break };
            for a in accesses {
                if let Some(b) = touched.iter().find(|b| a.conflicts(b)) {
                    return Err(format!("{name} (operation {j}) races {before} (operation {i}): {a:?} against {b:?}"));
                }
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn operation(begin: u64, end: u64, write: bool) -> Event {
        Event::Operation { name: "test".into(), accesses: vec![AccessRange { buffer: 1, begin, end, write }] }
    }

    #[test]
    fn finds_missing_barriers() {
        assert!(check(&[operation(0, 8, true), operation(4, 12, false)]).is_err());
        assert!(check(&[operation(0, 8, false), operation(4, 12, true)]).is_err());
        assert!(check(&[operation(0, 8, true), operation(9, 12, false), operation(7, 8, true)]).is_err());
    }

    #[test]
    fn accepts_ordered_and_disjoint_work() {
        assert!(check(&[operation(0, 8, true), Event::Barrier, operation(4, 12, false)]).is_ok());
        assert!(check(&[operation(0, 8, true), operation(8, 12, true)]).is_ok());
        assert!(check(&[operation(0, 8, false), operation(0, 8, false)]).is_ok());
    }
}
