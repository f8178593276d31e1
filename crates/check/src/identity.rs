//! Addresses, types and capabilities.

use mavstack::dialect::{MavAutopilot, MavFtpErr, MavMissionResult, MavResult, MavType};
use mavstack_station::names::Named;
use mavstack_station::{Client, Failure};

use crate::evidence::Evidence;
use crate::finding::{Finding, Severity, Topic};

/// Judges the identity.
pub fn check(evidence: &Evidence) -> Vec<Finding> {
    let checks = [armed, component, no_autopilot, no_version, unserved, texts, unrestored];
    checks.iter().filter_map(|check| check(evidence)).collect()
}

/// An armed vehicle, which is not examined.
fn armed(evidence: &Evidence) -> Option<Finding> {
    let observed = match evidence.is_asked {
        true => "The vehicle was armed during the examination, which ended then.",
        false => "The vehicle is armed, so it was only listened to.",
    };
    (evidence.ended_by == Some(Failure::Armed)).then(|| {
        Finding::new(
            Topic::Identity,
            "armed",
            Severity::Warning,
            observed,
            "A heartbeat of this vehicle, or of another one on the line, says so. An armed vehicle is not examined, because it may move.",
            "Disarm the vehicle, and examine it again.",
        )
    })
}

/// The component id.
fn component(evidence: &Evidence) -> Option<Finding> {
    let component = evidence.vehicle?.component.wire();
    let heartbeat = evidence.heartbeat?;
    let is_autopilot = heartbeat.autopilot != MavAutopilot::INVALID;
    (is_autopilot && component != 1).then(|| {
        Finding::new(
            Topic::Identity,
            "component-id",
            Severity::Error,
            format!("The autopilot's heartbeats come from component {component}."),
            "The component id is not 1 (MAV_COMP_ID_AUTOPILOT1). QGroundControl and MAVSDK take component 1 for the autopilot.",
            "Use `Config::new(Address::new(system, 1), …)`. Give other components ids of their own.",
        )
    })
}

/// The heartbeat of a component.
fn no_autopilot(evidence: &Evidence) -> Option<Finding> {
    let heartbeat = evidence.heartbeat?;
    let is_none = heartbeat.autopilot == MavAutopilot::INVALID || heartbeat.r#type == MavType::GCS;
    is_none.then(|| {
        Finding::new(
            Topic::Identity,
            "no-autopilot",
            Severity::Error,
            format!(
                "The heartbeats have type {} and autopilot {}.",
                heartbeat.r#type.named(),
                heartbeat.autopilot.named()
            ),
            "The heartbeat says that this is a component or a ground station, not a vehicle.",
            "Set `Config::type` to the vehicle's type, and leave the autopilot at `GENERIC`.",
        )
    })
}

/// Whether requests are lost on the way. Some are longer than those that measure the line, and do not fit into a FIFO that holds these.
fn loses_requests(evidence: &Evidence) -> bool {
    let is_limited = evidence.chunks.as_ref().is_some_and(|chunks| chunks.limit().is_some());
    is_limited || evidence.idle.unanswered() >= 0.05
}

/// No AUTOPILOT_VERSION.
fn no_version(evidence: &Evidence) -> Option<Finding> {
    let asked =
        evidence.connected.iter().filter(|(client, _)| matches!(client, Client::QGroundControl | Client::Mavsdk));
    let mut asked = asked.peekable();
    asked.peek()?;
    (asked.all(|(_, connected)| connected.version.is_none()) && !loses_requests(evidence)).then(|| {
        Finding::new(
            Topic::Identity,
            "no-version",
            Severity::Error,
            "AUTOPILOT_VERSION was requested, and did not come.",
            "The request for message 148 is not answered, so no client knows the capabilities.",
            "The stack answers MAV_CMD_REQUEST_MESSAGE and MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: do not handle them in `Commands::command`.",
        )
    })
}

/// Whether a failure says that the vehicle does not have the service. One that is refused for another reason is served.
fn is_unserved(failure: &Failure) -> bool {
    match failure {
        Failure::Timeout { .. } => true,
        Failure::Command { result, .. } => *result == MavResult::UNSUPPORTED,
        Failure::Plan { result, .. } => *result == MavMissionResult::UNSUPPORTED,
        Failure::File { error, .. } => *error == MavFtpErr::UNKNOWNCOMMAND,
        _ => false,
    }
}

/// Capabilities that are announced and not served.
fn unserved(evidence: &Evidence) -> Option<Finding> {
    let failed: Vec<_> = evidence
        .services
        .iter()
        .filter_map(|(name, result)| Some((name, result.as_ref().err().filter(|failure| is_unserved(failure))?)))
        .map(|(name, failure)| format!("{name}: {failure}"))
        .collect();
    if failed.is_empty() || loses_requests(evidence) {
        return None;
    }
    Some(Finding::new(
        Topic::Identity,
        "capability-not-served",
        Severity::Error,
        format!("Announced, but not served: {}.", failed.join("; ")),
        "The capabilities of AUTOPILOT_VERSION promise a service that the firmware does not have.",
        "Remove the bit from `Identity::capabilities`; the stack sets those of its own services itself.",
    ))
}

/// What the stack says of the firmware.
fn texts(evidence: &Evidence) -> Option<Finding> {
    let known = [
        (
            "Clock was set back",
            "The clock that is passed as `now` wraps, as a 32-bit counter of microseconds does after 71 minutes, or was reset.",
            "Extend it to 64 bits, as the guide `start` shows.",
        ),
        (
            "Accepted mode was not reported",
            "`Modes::set_mode` returns ACCEPTED, and `Vehicle::state` does not report that mode within a second.",
            "Refuse the mode, or enter it.",
        ),
        (
            "IN_PROGRESS without a slot",
            "A hook returns IN_PROGRESS itself.",
            "Return `cx.start()` from `Commands::command`, and declare `commands: { slots: 2 }`.",
        ),
    ];
    let (text, (_, cause, remedy)) = evidence.texts.iter().find_map(|text| {
        let known = known.iter().find(|(part, ..)| text.text.contains(part))?;
        Some((&text.text, *known))
    })?;
    Some(Finding::new(
        Topic::Identity,
        "vehicle-text",
        Severity::Error,
        format!("The vehicle says: \"{text}\"."),
        cause,
        remedy,
    ))
}

/// What the examination has changed and could not restore.
fn unrestored(evidence: &Evidence) -> Option<Finding> {
    let cause = match evidence.ended_by {
        Some(_) => "The examination ended before it could restore it, and sends nothing more.",
        None => "The vehicle did not accept its old value, or did not answer.",
    };
    (!evidence.unrestored.is_empty()).then(|| {
        Finding::new(
            Topic::Identity,
            "not-restored",
            Severity::Error,
            format!("Changed by this examination, and not restored: {}.", evidence.unrestored.join("; ")),
            cause,
            "Restore it with a ground station. A reboot restores the rates of streams.",
        )
    })
}
