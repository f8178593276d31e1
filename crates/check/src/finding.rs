//! What an examination finds, and its report.

use serde::Serialize;

/// How much a finding matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// The vehicle does not work with a ground station, or not reliably.
    Error,
    /// It works, and will fail in some conditions or with some clients.
    Warning,
    /// Worth knowing. It does not change the program's exit code.
    Note,
}

/// The part of the examination that a finding comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Topic {
    /// Bytes and frames that are lost or damaged.
    Line,
    /// Answer times, heartbeats, stalls, clocks.
    Timing,
    /// Addresses, types, capabilities.
    Identity,
    /// The values and the rates of streamed messages.
    Telemetry,
    /// What ground stations show, hide or refuse.
    Stations,
}

/// Something that is wrong, with its cause and its remedy.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Its stable name, such as `poll-slow`.
    pub id: &'static str,
    /// The part of the examination.
    pub topic: Topic,
    /// How much it matters.
    pub severity: Severity,
    /// What was observed, with figures.
    pub observed: String,
    /// The likely cause.
    pub cause: &'static str,
    /// What to do.
    pub remedy: &'static str,
}

impl Finding {
    /// Creates a finding.
    pub(crate) fn new(
        topic: Topic,
        id: &'static str,
        severity: Severity,
        observed: impl Into<String>,
        cause: &'static str,
        remedy: &'static str,
    ) -> Self {
        Self { id, topic, severity, observed: observed.into(), cause, remedy }
    }
}

/// A value that was measured.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Measured {
    /// What was measured.
    pub name: &'static str,
    /// The value.
    pub value: f64,
    /// Its unit.
    pub unit: &'static str,
}

/// The vehicle that was examined.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Identity {
    /// Its system id.
    pub system: u8,
    /// Its component id.
    pub component: u8,
    /// `MAV_TYPE`.
    pub r#type: String,
    /// `MAV_AUTOPILOT`.
    pub autopilot: String,
}

/// How an examination ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// Nothing was found, except notes.
    Sound,
    /// There are findings.
    Findings,
    /// Nothing was received, not one byte.
    Silent,
    /// The transport failed before the end.
    Failed,
}

/// The result of an examination.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// How it ended.
    pub outcome: Outcome,
    /// The vehicle, if its heartbeat was received.
    pub vehicle: Option<Identity>,
    /// What was measured.
    pub measured: Vec<Measured>,
    /// What was found, the most severe first.
    pub findings: Vec<Finding>,
    /// What was not examined, and why.
    pub skipped: Vec<String>,
}

impl Report {
    /// Returns the finding of this name.
    pub fn finding(&self, id: &str) -> Option<&Finding> {
        self.findings.iter().find(|finding| finding.id == id)
    }

    /// Returns the findings that are more than notes.
    pub fn problems(&self) -> impl Iterator<Item = &Finding> {
        self.findings.iter().filter(|finding| finding.severity < Severity::Note)
    }
}
