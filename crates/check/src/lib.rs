//! Examines a vehicle's board over its link, and names what is wrong with it, each with its cause and remedy: lost bytes, slow polls,
//! stalls, wrong clocks, units and addresses.
//!
//! [`examine`] has neither a clock nor a transport: it runs over anything that implements [`Drive`]. In the program
//! `mavstack-check doctor` that is a serial port or a socket, and in a test a rig of [`mavstack_station::kit`].
//!
//! ```
//! use mavstack_check::{Options, examine};
//! use mavstack_station::Drive;
//!
//! fn is_sound(board: &mut impl Drive) -> bool {
//!     let report = examine(board, &Options::default(), &mut |step| eprintln!("{step}"));
//!     for finding in report.problems() {
//!         println!("{}\n  {}\n  {}", finding.observed, finding.cause, finding.remedy);
//!     }
//!     report.problems().next().is_none()
//! }
//! ```
//!
//! # What it does to the vehicle
//!
//! It sends nothing until a heartbeat says that the vehicle is disarmed, and nothing more once one says that it is armed. An armed vehicle
//! is only listened to: if it heard the heartbeats of a ground station, their end would trigger its failsafe.
//!
//! It then sends heartbeats, requests messages, fills the line for some seconds, and connects as QGroundControl, MAVSDK and MAVProxy do.
//! It changes the least significant bit of one parameter, and the rate of one stream on its link. With [`Depth::WithPlan`] it uploads a
//! plan. Before each change it waits for a heartbeat that says that the vehicle is disarmed. It restores what it has changed, reads it
//! back, and reports what is not as before. It never arms, erases or reboots, and requests no data streams.
#![forbid(unsafe_code)]

mod changes;
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
    /// Who says that the vehicle is disarmed.
    pub permission: Permission,
}

/// Who says that the vehicle is disarmed, so that requests may be sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Permission {
    /// The vehicle, in its heartbeats: without them, nothing is sent.
    #[default]
    Heartbeat,
    /// The user: requests are sent even if no heartbeat comes. One that says "armed" still ends everything, and nothing is changed without
    /// heartbeats.
    User,
}

/// How much of a vehicle is examined.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Depth {
    /// A few seconds: what is seen while idle. Changes nothing.
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
    /// Measures while idle.
    Idle,
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
            Self::Idle => "measuring while idle",
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
/// If the transport fails, or if the vehicle is armed meanwhile, the report has what was found until then, and what was not restored.
pub fn examine(drive: &mut impl Drive, options: &Options, progress: &mut dyn FnMut(Step)) -> Report {
    judge(&evidence::gather(drive, options, progress))
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
        _ if matches!(evidence.ended_by, Some(Failure::Transport(_))) => Outcome::Failed,
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
    let has_idle = evidence.idle.time() > mavstack::Duration::ZERO;
    let has_probes = !evidence.idle.probes.is_empty();
    let times = timing::answer_times(&evidence.idle);
    add("shortest answer time while idle", times.map(|times| millis(times[0])), "ms");
    add("median answer time while idle", times.map(|times| millis(times[1])), "ms");
    add("longest answer time while idle", times.map(|times| millis(times[2])), "ms");
    add("received while idle", has_idle.then(|| evidence.idle.bytes_per_second()), "bytes/s");
    add("frames lost while idle", has_idle.then(|| evidence.idle.lost() as f64), "");
    add("frames damaged while idle", has_idle.then(|| evidence.idle.damaged.into()), "");
    add("requests unanswered while idle", has_probes.then(|| evidence.idle.unanswered() * 100.0), "%");
    let load = evidence.load.as_ref();
    let loaded = load.and_then(timing::answer_times);
    add("median answer time on a full line", loaded.map(|times| millis(times[1])), "ms");
    add("received on a full line", load.map(trace::Trace::bytes_per_second), "bytes/s");
    add("frames lost on a full line", load.map(|trace| trace.lost() as f64), "");
    add("frames damaged on a full line", load.map(|trace| trace.damaged.into()), "");
    add("requests unanswered on a full line", load.map(|trace| trace.unanswered() * 100.0), "%");
    add(
        "longest time between heartbeats while idle",
        has_idle.then(|| millis(evidence.idle.longest_heartbeat_gap())),
        "ms",
    );
    let silence = |trace: &trace::Trace| millis(trace.longest_silence().1);
    let gap = |trace: &trace::Trace| millis(trace.longest_heartbeat_gap());
    let (storing, planning) = (evidence.storing.as_ref(), evidence.planning.as_ref());
    add("longest silence while storing", storing.map(silence), "ms");
    add("longest time between heartbeats while storing", storing.map(gap), "ms");
    add("longest silence while a plan is uploaded", planning.map(silence), "ms");
    add("longest time between heartbeats while a plan is uploaded", planning.map(gap), "ms");
    add("clock rate", evidence.clock_rate, "");
    measured
}
