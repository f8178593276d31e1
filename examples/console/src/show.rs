//! One line of a terminal that changes in place, below what is printed; where there is no terminal, lines.

use std::fmt::Display;
use std::io::Write as _;
use std::sync::{Arc, Mutex, PoisonError};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use mavstack_demo::Status;

use crate::line::Line;

/// ms between lines when nothing happens, where there is no terminal.
const PERIOD: u32 = 10_000;

/// The standard output, for whoever prints: each clone prints to the same.
#[derive(Clone, Debug)]
pub struct Console {
    bar: ProgressBar,
    shown: Arc<Mutex<Shown>>,
}

#[derive(Debug, Default)]
struct Shown {
    last: Option<Status>,
    /// The last one for which a line was printed.
    printed: Option<Status>,
}

impl Console {
    /// The status stays in the last line if standard output is a terminal.
    pub fn new() -> Self {
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stdout());
        // It is cut where the terminal ends.
        bar.set_style(ProgressStyle::with_template("{wide_msg}").unwrap_or_else(|_| ProgressStyle::default_spinner()));
        Self { bar, shown: Arc::default() }
    }

    /// Whether standard output is a terminal.
    pub fn is_terminal(&self) -> bool {
        !self.bar.is_hidden()
    }

    /// Prints a line.
    pub fn print(&self, line: impl Display) {
        self.bar.suspend(|| {
            // Nobody reads it any more: no reason to stop the vehicle.
            let _ = writeln!(std::io::stdout(), "{line}");
        });
    }

    /// Prints a line of what went wrong.
    pub fn complain(&self, line: impl Display) {
        self.bar.suspend(|| {
            let _ = writeln!(std::io::stderr(), "{line}");
        });
    }

    /// Shows the status: to be called about once a second. Without a terminal a line is printed when there are news, and now
    /// and then.
    pub fn show(&self, now: Status) {
        let mut shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        let line = |before| Line { now: &now, before };
        if self.is_terminal() {
            self.bar.set_message(line(shown.last.as_ref()).to_string());
        } else if shown.printed.as_ref().is_none_or(|printed| is_news(&now, printed)) {
            self.print(format_args!("{:.1} s: {}", f64::from(now.time) / 1_000.0, line(shown.last.as_ref())));
            shown.printed = Some(now.clone());
        }
        shown.last = Some(now);
    }

    /// Takes the status away.
    pub fn end(&self) {
        self.bar.finish_and_clear();
    }
}

impl Default for Console {
    fn default() -> Self {
        Self::new()
    }
}

/// Whether a line is worth it.
fn is_news(now: &Status, printed: &Status) -> bool {
    now.is_armed != printed.is_armed
        || now.mode != printed.mode
        || now.mission != printed.mission
        || now.peers != printed.peers
        // Also after a restart, when time began anew.
        || now.time.abs_diff(printed.time) >= PERIOD
}
