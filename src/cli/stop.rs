//! SIGINT and SIGTERM: asked to stop, a command ends in order; asked twice, it ends at once.

use limpid::{Error, Result};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether the user wants the command to end.
pub struct Stop([(i32, Arc<AtomicBool>); 2]);

impl Stop {
    /// Catches the signals from now on.
    pub fn install() -> Result<Self> {
        let signals = [SIGINT, SIGTERM].map(|signal| (signal, Arc::new(AtomicBool::new(false))));
        for (signal, asked) in &signals {
            // In this order: the first signal finds the flag unset and sets it, the second one ends the process.
            flag::register_conditional_shutdown(*signal, 128 + *signal, Arc::clone(asked))
                .and_then(|_| flag::register(*signal, Arc::clone(asked)))
                .map_err(|error| Error::io(format!("signal {signal}"), error))?;
        }
        Ok(Self(signals))
    }

    /// The signal that came, if any.
    pub fn requested(&self) -> Option<Signal> {
        self.0.iter().find(|(_, asked)| asked.load(Ordering::Relaxed)).map(|(signal, _)| Signal(*signal))
    }
}

/// A caught signal.
#[derive(Clone, Copy, Debug)]
pub struct Signal(i32);

impl Signal {
    /// Its name.
    pub fn name(self) -> &'static str {
        if self.0 == SIGINT { "SIGINT" } else { "SIGTERM" }
    }

    /// The exit code of a process that ended for it: 130 or 143.
    pub fn exit_code(self) -> u8 {
        (128 + self.0) as u8
    }
}
