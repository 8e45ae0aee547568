//! Progress on standard error: a bar on a terminal, a line every few seconds elsewhere.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

const LINE_INTERVAL: Duration = Duration::from_secs(5);
const STEPS: f64 = 1000.0;
const TEMPLATE: &str = "{prefix} [{bar:30}] {percent:>3} % {msg}";

/// Progress of one piece of work.
pub struct Progress {
    bar: Option<ProgressBar>,
    start: Instant,
    /// Share that was done before the start.
    first: f64,
    /// Shown before the rate.
    note: String,
    last_line: Instant,
}

impl Progress {
    /// Begins.
    pub fn new(label: &str) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::with_draw_target(Some(STEPS as u64), ProgressDrawTarget::stderr());
            let style = ProgressStyle::with_template(TEMPLATE).unwrap_or_else(|_| ProgressStyle::default_bar());
            bar.set_style(style.progress_chars("=> "));
            bar.set_prefix(label.to_owned());
            bar.enable_steady_tick(Duration::from_millis(250));
            bar
        });
        if bar.is_none() {
            line(label);
        }
        Self { bar, start: Instant::now(), first: 0.0, note: String::new(), last_line: Instant::now() }
    }

    /// Says that this share of the work is done already.
    pub fn start_at(&mut self, first: f64) {
        self.first = first;
        self.start = Instant::now();
    }

    /// Sets a text to show before the rate.
    pub fn note(&mut self, text: String) {
        self.note = text;
    }

    /// Shows that `fraction` (0 to 1) of `amount` samples, steps or whatever `unit` says is done.
    pub fn update(&mut self, fraction: f64, amount: f64, unit: &str) {
        let speed = (fraction - self.first).max(1e-12) / self.start.elapsed().as_secs_f64().max(1e-9);
        let left = duration((1.0 - fraction) / speed);
        let message = format!("{}{}{unit}/s, {left} left", self.note, scaled(speed * amount));
        if let Some(bar) = &self.bar {
            bar.set_position((fraction * STEPS) as u64);
            bar.set_message(message);
        } else if self.last_line.elapsed() >= LINE_INTERVAL {
            self.last_line = Instant::now();
            line(&format!("  {:.0} %, {message}", 100.0 * fraction));
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// One line on standard error.
pub fn line(text: &str) {
    // A closed stream is no reason to stop.
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Names what of a scene file was left out, on standard error.
pub fn left_out(list: &[String]) {
    list.iter().for_each(|what| line(&format!("left out: {what}")));
}

/// A number with three digits and the prefix of its unit.
fn scaled(value: f64) -> String {
    let (value, prefix) = match value {
        1e9.. => (value * 1e-9, "G"),
        1e6.. => (value * 1e-6, "M"),
        1e3.. => (value * 1e-3, "k"),
        _ => (value, ""),
    };
    let digits = if value >= 100.0 { 0 } else { 1 };
    format!("{value:.digits$} {prefix}")
}

/// Seconds in words.
pub fn duration(seconds: f64) -> String {
    let s = seconds.clamp(0.0, 1e9).round() as u64;
    match s {
        0..60 => format!("{s} s"),
        60..3600 => format!("{} min {:02} s", s / 60, s % 60),
        _ => format!("{} h {:02} min", s / 3600, s / 60 % 60),
    }
}

#[cfg(test)]
mod tests {
    use super::{duration, scaled};

    #[test]
    fn rates_read_well() {
        assert_eq!(format!("{}steps/s", scaled(0.54)), "0.5 steps/s");
        assert_eq!(format!("{}samples/s", scaled(9_130_000.0)), "9.1 Msamples/s");
    }

    #[test]
    fn durations_read_well() {
        assert_eq!(duration(f64::NAN.max(0.4)), "0 s");
        assert_eq!(duration(59.6), "1 min 00 s");
        assert_eq!(duration(3725.0), "1 h 02 min");
        assert_eq!(duration(f64::INFINITY), "277777 h 46 min");
    }
}
