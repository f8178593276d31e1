//! The report for people.

use std::fmt;

use mavstack_check::{Finding, Report, Severity};

/// The columns of the text.
const WIDTH: usize = 100;

/// Whether the text has colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Colours {
    /// ANSI colours, for a terminal.
    On,
    /// None.
    Off,
}

impl Colours {
    /// Returns the codes that begin and end a severity.
    fn of(self, severity: Severity) -> [&'static str; 2] {
        match (self, severity) {
            (Self::Off, _) => ["", ""],
            (Self::On, Severity::Error) => ["\x1b[1;31m", "\x1b[0m"],
            (Self::On, Severity::Warning) => ["\x1b[1;33m", "\x1b[0m"],
            (Self::On, Severity::Note) => ["\x1b[1;36m", "\x1b[0m"],
        }
    }
}

/// A report as text.
pub struct Document<'a> {
    /// The report.
    pub report: &'a Report,
    /// Whether it has colours.
    pub colours: Colours,
}

impl fmt::Display for Document<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let report = self.report;
        if let Some(vehicle) = &report.vehicle {
            let (system, component) = (vehicle.system, vehicle.component);
            writeln!(
                f,
                "System {system}, component {component}: {}, autopilot {}\n",
                vehicle.r#type, vehicle.autopilot
            )?;
        }
        for finding in &report.findings {
            self.finding(f, finding)?;
        }
        if !report.measured.is_empty() {
            writeln!(f, "Measured")?;
            let width = report.measured.iter().map(|measured| measured.name.len()).max().unwrap_or(0);
            for measured in &report.measured {
                let decimals = match measured.unit {
                    // A count or a ratio.
                    "" if measured.value.fract() == 0.0 => 0,
                    "" => 4,
                    _ => usize::from(measured.value < 100.0),
                };
                let line = format!("  {:width$}  {:>8.decimals$} {}", measured.name, measured.value, measured.unit);
                writeln!(f, "{}", line.trim_end())?;
            }
            writeln!(f)?;
        }
        for skipped in &report.skipped {
            writeln!(f, "Not examined: {skipped}.")?;
        }
        writeln!(f, "{}", summary(report))
    }
}

impl Document<'_> {
    fn finding(&self, f: &mut fmt::Formatter<'_>, finding: &Finding) -> fmt::Result {
        let [begin, end] = self.colours.of(finding.severity);
        let severity = match finding.severity {
            Severity::Error => "error",
            Severity::Warning => "warning",
            Severity::Note => "note",
        };
        writeln!(f, "{begin}{severity}{end} {}", finding.id)?;
        for line in wrap(&finding.observed, WIDTH - 2) {
            writeln!(f, "  {line}")?;
        }
        for (title, text) in [("Cause:", finding.cause), ("Remedy:", finding.remedy)] {
            for (index, line) in wrap(text, WIDTH - 10).into_iter().enumerate() {
                let title = if index == 0 { title } else { "" };
                writeln!(f, "  {title:7} {line}")?;
            }
        }
        writeln!(f)
    }
}

/// Returns the last line: what was found, in numbers.
fn summary(report: &Report) -> String {
    let count = |severity| report.findings.iter().filter(|finding| finding.severity == severity).count();
    let plural = |count, word: &str| match count {
        1 => format!("1 {word}"),
        count => format!("{count} {word}s"),
    };
    let [errors, warnings, notes] = [Severity::Error, Severity::Warning, Severity::Note].map(count);
    match errors + warnings {
        0 => format!("Nothing wrong was found; {}.", plural(notes, "note")),
        _ => format!("{}, {}, {}.", plural(errors, "error"), plural(warnings, "warning"), plural(notes, "note")),
    }
}

/// Breaks a text into lines of at most `width` characters, at spaces.
fn wrap(text: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let is_full = lines
            .last()
            .is_some_and(|line| !line.is_empty() && line.chars().count() + 1 + word.chars().count() > width);
        if is_full {
            lines.push(String::new());
        }
        if let Some(line) = lines.last_mut() {
            if !line.is_empty() {
                line.push(' ');
            }
            line.push_str(word);
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavstack_check::{Outcome, Topic};

    fn report() -> Report {
        let finding = Finding {
            id: "poll-slow",
            topic: Topic::Timing,
            severity: Severity::Error,
            observed: "Answers are late.".into(),
            cause: "It polls rarely.",
            remedy: "Poll.",
        };
        Report {
            outcome: Outcome::Findings,
            vehicle: None,
            measured: Vec::new(),
            findings: vec![finding],
            skipped: Vec::new(),
        }
    }

    #[test]
    fn colours_are_only_for_terminals() {
        let text = |colours| Document { report: &report(), colours }.to_string();
        let plain = "error poll-slow\n  Answers are late.\n  Cause:  It polls rarely.\n  Remedy: Poll.\n\n1 error, 0 warnings, 0 notes.\n";
        assert_eq!(text(Colours::Off), plain);
        assert!(text(Colours::On).contains("\x1b[1;31merror\x1b[0m poll-slow"));
    }

    #[test]
    fn lines_break_at_spaces() {
        assert_eq!(wrap("one two three", 7), ["one two", "three"]);
        assert_eq!(wrap("incomprehensible", 7), ["incomprehensible"]);
    }
}
