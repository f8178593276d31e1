//! Shows the status in the last line of a terminal, below the printed lines. Without a terminal it prints the status now and
//! then.

use std::fmt::Display;
use std::io::Write as _;
use std::sync::{Arc, Mutex, PoisonError};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use mavstack_demo::Status;

use crate::line::Line;

/// Interval between status lines without a terminal when nothing changes (ms).
const PERIOD: u32 = 10_000;

/// Standard output with a status line. All clones share it.
#[derive(Clone, Debug)]
pub struct Console {
    bar: ProgressBar,
    shown: Arc<Mutex<Shown>>,
}

#[derive(Debug, Default)]
struct Shown {
    last: Option<Status>,
    /// The last status that was printed as a line.
    printed: Option<Status>,
}

impl Console {
    /// Uses the last line for the status if standard output is a terminal.
    pub fn new() -> Self {
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stdout());
        // Truncated to the width of the terminal.
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
            // A closed pipe is no reason to stop the vehicle.
            let _ = writeln!(std::io::stdout(), "{line}");
        });
    }

    /// Prints a line to standard error.
    pub fn print_error(&self, line: impl Display) {
        self.bar.suspend(|| {
            let _ = writeln!(std::io::stderr(), "{line}");
        });
    }

    /// Shows the status. Call it about once a second. Without a terminal it prints a line when the state has changed, and every
    /// 10 s otherwise.
    pub fn show(&self, now: Status) {
        let mut shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        let line = |before| Line { now: &now, before };
        if self.is_terminal() {
            self.bar.set_message(line(shown.last.as_ref()).to_string());
        } else if shown.printed.as_ref().is_none_or(|printed| needs_line(&now, printed)) {
            self.print(format_args!("{:.1} s: {}", f64::from(now.time) / 1_000.0, line(shown.last.as_ref())));
            shown.printed = Some(now.clone());
        }
        shown.last = Some(now);
    }

    /// Removes the status line.
    pub fn end(&self) {
        self.bar.finish_and_clear();
    }
}

impl Default for Console {
    fn default() -> Self {
        Self::new()
    }
}

/// Whether to print a new line without a terminal.
fn needs_line(now: &Status, printed: &Status) -> bool {
    now.is_armed != printed.is_armed
        || now.mode != printed.mode
        || now.mission != printed.mission
        || now.peers != printed.peers
        // Also true after a reboot, when time starts at 0 again.
        || now.time.abs_diff(printed.time) >= PERIOD
}
