//! SIGINT and SIGTERM: asked to stop, a command ends in order; asked twice, it ends at once.

use limpid::{Error, Result};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Whether the user wants the command to end.
pub struct Stop {
    asked: Arc<AtomicBool>,
    signal: Arc<AtomicUsize>,
}

impl Stop {
    /// Catches the signals from now on.
    pub fn install() -> Result<Self> {
        let stop = Self { asked: Arc::default(), signal: Arc::default() };
        for signal in [SIGINT, SIGTERM] {
            // In this order: the first signal finds the flag unset and sets it, the second one ends the process.
            flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(&stop.asked))
                .and_then(|_| flag::register_usize(signal, Arc::clone(&stop.signal), signal as usize))
                .and_then(|_| flag::register(signal, Arc::clone(&stop.asked)))
                .map_err(|error| Error::io(format!("signal {signal}"), error))?;
        }
        Ok(stop)
    }

    /// The signal that came, if any.
    pub fn requested(&self) -> Option<Signal> {
        self.asked.load(Ordering::Relaxed).then(|| Signal(self.signal.load(Ordering::Relaxed) as i32))
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
