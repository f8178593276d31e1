//! What ground stations show, hide or refuse.

use std::collections::BTreeSet;

use mavstack::dialect::{
    MavAutopilot, MavParamType, MavProtocolCapability, MavResult, MavSysStatusSensor as Sensor, SysStatus,
};
use mavstack_station::connect::Connected;
use mavstack_station::{Client, Failure};

use crate::evidence::Evidence;
use crate::finding::{Finding, Severity, Topic};

/// Judges what the clients have learned. Timeouts are left out if the line or the times explain them.
pub fn check(evidence: &Evidence, is_explained: bool) -> Vec<Finding> {
    let of = |client| evidence.connected.iter().find(|(other, _)| *other == client).map(|(_, connected)| connected);
    let mut findings = Vec::new();
    if let Some(connected) = of(Client::QGroundControl) {
        findings.extend(no_parameters(connected).filter(|_| !is_explained));
        findings.extend(no_modes(connected).filter(|_| !is_explained));
        findings.extend(not_ready(evidence));
    }
    findings.extend(of(Client::MavProxy).and_then(integers));
    findings.extend(unanswered(evidence).filter(|_| !is_explained));
    findings.extend(plan(evidence).filter(|_| !is_explained));
    findings.extend(hidden(evidence));
    findings
}

fn no_parameters(connected: &Connected) -> Option<Finding> {
    connected.parameters.is_empty().then(|| {
        Finding::new(
            Topic::Stations,
            "no-parameters",
            Severity::Error,
            "QGroundControl stays at \"loading parameters\": it received none.",
            "The vehicle has no parameters; or `poll_link` runs too rarely, and the UART's queue overruns, which it counts.",
            "Declare at least one parameter with `parameters!`.",
        )
    })
}

/// QGroundControl knows the modes of PX4 and ArduPilot by itself.
fn no_modes(connected: &Connected) -> Option<Finding> {
    let is_known = matches!(connected.heartbeat.autopilot, MavAutopilot::PX4 | MavAutopilot::ARDUPILOTMEGA);
    (connected.modes.is_empty() && !is_known).then(|| {
        Finding::new(
            Topic::Stations,
            "no-modes",
            Severity::Warning,
            "QGroundControl shows no mode to choose.",
            "The vehicle does not answer the request for AVAILABLE_MODES.",
            "Declare `modes` in the stack, and list them in `Modes::MODES`.",
        )
    })
}

/// QGroundControl's "Not ready".
fn not_ready(evidence: &Evidence) -> Option<Finding> {
    let status = evidence.idle.frames.iter().rev().find_map(|frame| frame.decode::<SysStatus>());
    let is_set = |sensors: Sensor| sensors.contains(Sensor::PREARM_CHECK);
    let is_ready = status.is_some_and(|status| {
        is_set(status.onboard_control_sensors_present)
            && is_set(status.onboard_control_sensors_enabled)
            && is_set(status.onboard_control_sensors_health)
    });
    (!is_ready).then(|| {
        Finding::new(
            Topic::Stations,
            "not-ready",
            Severity::Note,
            "QGroundControl shows \"Not Ready\", or no readiness.",
            "SYS_STATUS is not streamed, or its pre-arm check is not present, enabled and healthy.",
            "Nothing, if the vehicle is not ready. Else set MAV_SYS_STATUS_PREARM_CHECK in all three fields.",
        )
    })
}

/// MAVProxy's integers.
fn integers(connected: &Connected) -> Option<Finding> {
    let integers = connected.parameters.iter().filter(|parameter| parameter.param_type != MavParamType::REAL32);
    let count = integers.count();
    let decodes = matches!(connected.heartbeat.autopilot, MavAutopilot::PX4 | MavAutopilot::ARDUPILOTMEGA);
    (count > 0 && !decodes).then(|| {
        Finding::new(
            Topic::Stations,
            "mavproxy-integers",
            Severity::Note,
            format!("MAVProxy shows wrong values of {count} integer parameters."),
            "MAVProxy reads integers in ArduPilot's encoding.",
            "Prefer `f32` parameters. A bit mask and the system id must be integers: `param ftp` shows them right.",
        )
    })
}

/// Whether this request was one of MAVLink FTP.
fn is_by_ftp(failure: &Failure) -> bool {
    matches!(failure, Failure::Timeout { request, .. } if request.ends_with("by FTP"))
}

/// Requests of the clients that were not answered. A refusal is an answer.
fn unanswered(evidence: &Evidence) -> Option<Finding> {
    // MAVProxy asks every vehicle for a file, and takes the list from those that do not answer.
    let mut all = evidence.connected.iter().map(|(_, connected)| connected.capabilities());
    let has_files = all.any(|capabilities| capabilities.contains(MavProtocolCapability::FTP));
    let failures = evidence.connected.iter().flat_map(|(client, connected)| {
        let timeouts = connected
            .failures
            .iter()
            .filter(|failure| matches!(failure, Failure::Timeout { .. } | Failure::Protocol(_)))
            .filter(|failure| has_files || !is_by_ftp(failure));
        timeouts.map(move |failure| format!("{client}: {failure}"))
    });
    let failures: BTreeSet<_> = failures.collect();
    let failures = Vec::from_iter(failures);
    (!failures.is_empty()).then(|| {
        Finding::new(
            Topic::Stations,
            "client-unanswered",
            Severity::Warning,
            format!("{}.", failures.join("; ")),
            "The vehicle answers neither yes nor no, so the client waits and repeats.",
            "Refuse what is unknown: with UNSUPPORTED for commands. The stack does it for all services that it has.",
        )
    })
}

/// An upload that does not end.
fn plan(evidence: &Evidence) -> Option<Finding> {
    let failure = evidence.unanswered_plan.as_ref()?;
    Some(Finding::new(
        Topic::Stations,
        "plan-unanswered",
        Severity::Error,
        format!("The upload of a mission does not end: {failure}."),
        "The vehicle does not request all items, or does not acknowledge the last one.",
        "Declare `plans` in the stack, and call `Stack::persist` if uploads are durable: they are acknowledged when they are stored.",
    ))
}

/// What clients hide, because the vehicle refuses it.
fn hidden(evidence: &Evidence) -> Option<Finding> {
    let refused = evidence.connected.iter().flat_map(|(client, connected)| {
        let is_refusal = |failure: &&Failure| {
            matches!(
                failure,
                Failure::Command { result: MavResult::UNSUPPORTED | MavResult::DENIED, .. } | Failure::File { .. }
            )
        };
        connected.failures.iter().filter(is_refusal).map(move |failure| format!("{client}: {failure}"))
    });
    let refused: BTreeSet<_> = refused.collect();
    let refused = Vec::from_iter(refused);
    (!refused.is_empty()).then(|| {
        Finding::new(
            Topic::Stations,
            "hidden",
            Severity::Note,
            format!("{}.", refused.join("; ")),
            "The client asks for a service that the vehicle does not have, and does without.",
            "Nothing, or declare the service in the stack.",
        )
    })
}
