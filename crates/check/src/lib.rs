//! Examines a vehicle's board over its link: what loses bytes, polls too rarely, stalls, or sends wrong times, units and addresses.
//!
//! [`examine`] is sans-IO over [`Drive`]: a program gives it a serial port or a socket, and a test a rig of
//! [`mavstack_station::kit`]. The program is `mavstack-check doctor`.
//!
//! ```
//! use mavstack_check::{Options, examine};
//! use mavstack_station::{Drive, Failure};
//!
//! fn is_sound(board: &mut impl Drive) -> Result<bool, Failure> {
//!     let report = examine(board, &Options::default(), &mut |step| eprintln!("{step}"))?;
//!     for finding in report.problems() {
//!         println!("{}\n  {}\n  {}", finding.observed, finding.cause, finding.remedy);
//!     }
//!     Ok(report.problems().next().is_none())
//! }
//! ```
//!
//! # What it does to the vehicle
//!
//! It requests messages, fills the line for some seconds, and connects as QGroundControl, MAVSDK and MAVProxy do. It changes one
//! parameter in its last bit and restores it. It changes the rates of streams on its link and restores them. It uploads a plan only with
//! [`Depth::WithPlan`]. It never arms, erases or reboots, and an armed vehicle is only listened to.
#![forbid(unsafe_code)]

pub mod chunks;
pub mod echo;
pub mod evidence;
pub mod examiner;
mod finding;
mod identity;
mod line;
mod stations;
mod telemetry;
mod timing;
pub mod trace;

pub use finding::{Finding, Identity, Measured, Outcome, Report, Severity, Topic};

use evidence::Evidence;
use mavstack_station::names::Named;
use mavstack_station::{Drive, Failure};

/// What to examine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// The rate of the line (bytes/s), a tenth of the baud rate; `None` if it is not known.
    pub line_rate: Option<u32>,
    /// How much of the vehicle is examined.
    pub depth: Depth,
}

/// How much of a vehicle is examined.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Depth {
    /// A few seconds: what is seen in calm. Changes nothing.
    Quick,
    /// Also on a full line, while a parameter is stored, and with each client.
    #[default]
    Full,
    /// Also while a plan is uploaded. The vehicle's mission is uploaded again; if it has none, another one is uploaded and cleared.
    WithPlan,
}

/// A step of the examination, for a display of its progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Waits for a heartbeat and for an answer.
    Listening,
    /// Measures in calm.
    Calm,
    /// Asks for the intervals of streams.
    Intervals,
    /// Sends bursts of different sizes.
    Bursts,
    /// Fills the line.
    Load,
    /// Lets the vehicle store a parameter.
    Storing,
    /// Uploads a plan.
    Plan,
    /// Connects as the ground stations do.
    Clients,
}

impl std::fmt::Display for Step {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Listening => "waiting for the vehicle",
            Self::Calm => "measuring in calm",
            Self::Intervals => "asking for the rates of streams",
            Self::Bursts => "sending bursts",
            Self::Load => "filling the line",
            Self::Storing => "storing a parameter",
            Self::Plan => "uploading a plan",
            Self::Clients => "connecting as QGroundControl, MAVSDK and MAVProxy",
        })
    }
}

/// Examines a vehicle. Takes about a minute of the drive's time, or ten seconds with [`Depth::Quick`].
///
/// # Errors
///
/// [`Failure::Transport`]: the transport failed. What is wrong with the vehicle is in the report.
pub fn examine(drive: &mut impl Drive, options: &Options, progress: &mut dyn FnMut(Step)) -> Result<Report, Failure> {
    let evidence = evidence::gather(drive, options, progress)?;
    Ok(judge(&evidence))
}

/// Judges what an examination has gathered.
pub fn judge(evidence: &Evidence) -> Report {
    let mut findings = line::check(evidence);
    findings.extend(timing::check(evidence));
    findings.extend(telemetry::check(evidence));
    let is_explained =
        findings.iter().any(|finding| finding.severity == Severity::Error || finding.topic == Topic::Line);
    findings.extend(identity::check(evidence));
    findings.extend(stations::check(evidence, is_explained));
    findings.sort_by_key(|finding| finding.severity);
    let outcome = match findings.first() {
        _ if !evidence.any_byte => Outcome::Silent,
        Some(finding) if finding.severity < Severity::Note => Outcome::Findings,
        _ => Outcome::Sound,
    };
    Report {
        outcome,
        vehicle: identity_of(evidence),
        measured: measured(evidence),
        findings,
        skipped: evidence.skipped.clone(),
    }
}

fn identity_of(evidence: &Evidence) -> Option<Identity> {
    let (vehicle, heartbeat) = (evidence.vehicle?, evidence.heartbeat?);
    Some(Identity {
        system: vehicle.system.wire(),
        component: vehicle.component.wire(),
        r#type: heartbeat.r#type.named(),
        autopilot: heartbeat.autopilot.named(),
    })
}

fn measured(evidence: &Evidence) -> Vec<Measured> {
    let mut measured = Vec::new();
    let mut add = |name, value: Option<f64>, unit| measured.extend(value.map(|value| Measured { name, value, unit }));
    let millis = |duration: mavstack::Duration| duration.as_micros() as f64 / 1_000.0;
    let has_calm = !evidence.calm.probes.is_empty();
    let times = timing::answer_times(&evidence.calm);
    add("shortest answer time in calm", times.map(|times| millis(times[0])), "ms");
    add("median answer time in calm", times.map(|times| millis(times[1])), "ms");
    add("longest answer time in calm", times.map(|times| millis(times[2])), "ms");
    add("received in calm", has_calm.then(|| evidence.calm.bytes_per_second()), "bytes/s");
    add("frames lost in calm", has_calm.then(|| evidence.calm.lost() as f64), "");
    add("frames damaged in calm", has_calm.then(|| evidence.calm.damaged.into()), "");
    add("requests unanswered in calm", has_calm.then(|| evidence.calm.unanswered() * 100.0), "%");
    let load = evidence.load.as_ref();
    let loaded = load.and_then(timing::answer_times);
    add("median answer time on a full line", loaded.map(|times| millis(times[1])), "ms");
    add("received on a full line", load.map(trace::Trace::bytes_per_second), "bytes/s");
    add("requests unanswered on a full line", load.map(|trace| trace.unanswered() * 100.0), "%");
    add(
        "longest time between heartbeats in calm",
        has_calm.then(|| millis(evidence.calm.longest_heartbeat_gap())),
        "ms",
    );
    let storing = evidence.storing.as_ref().map(|trace| millis(trace.longest_silence().1));
    add("longest silence while storing", storing, "ms");
    add("clock rate", evidence.clock_rate, "");
    measured
}
