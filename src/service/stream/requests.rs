//! Requests for messages and intervals: commands, and the older REQUEST_DATA_STREAM.

use core::num::NonZeroU32;

use super::schedule::{IntervalRequest, StreamLink};
use super::table::{Rows, Stream, clamped};
use super::vehicle::{Telemetry, fill_row};
use crate::dialect::{
    CurrentMode, Heartbeat, HomePosition, MavCmd, MavDataStream, MavResult, MessageInterval, MissionCurrent,
    RadioStatus, RequestDataStream,
};
use crate::frame::Frame;
use crate::link::Port;
use crate::message::{ComponentId, Message};
use crate::num;
use crate::service::{Cx, Request};
use crate::time::Duration;
use crate::types::{Command, Firmware, LinkClass, PlanMemory};

/// Interval of the MISSION_CURRENT that the stack sends by itself (µs).
const MISSION_CURRENT_INTERVAL: u64 = 1_000_000;

/// CURRENT_MODE is sent with every second HEARTBEAT.
const HEARTBEATS_PER_MODE: u32 = 2;

/// The messages that the stack itself sends, at intervals that cannot be changed.
#[derive(Clone, Copy, Debug)]
struct Fixed {
    /// The interval of HEARTBEAT, which must never be stopped.
    heartbeat: Duration,
    /// Whether MISSION_CURRENT is sent.
    has_missions: bool,
    /// Whether CURRENT_MODE is sent.
    has_modes: bool,
}

impl Fixed {
    fn new<F: Firmware>(cx: &Cx<'_, F>) -> Self {
        let [missions, ..] = F::Plans::CAPACITIES;
        Self { heartbeat: cx.shared.config.heartbeat_period, has_missions: missions > 0, has_modes: F::HAS_MODES }
    }

    /// Returns the interval of a message that the stack itself sends (µs).
    fn interval(self, id: u32) -> Option<u32> {
        let micros = match id {
            Heartbeat::ID => self.heartbeat.as_micros(),
            MissionCurrent::ID if self.has_missions => MISSION_CURRENT_INTERVAL,
            CurrentMode::ID if self.has_modes => (self.heartbeat * HEARTBEATS_PER_MODE).as_micros(),
            _ => return None,
        };
        Some(clamped(micros))
    }
}

/// Handles a command about messages; `None` for all other commands, and for messages that the vehicle does not declare.
pub(super) fn handle_command<F: Firmware<Vehicle: Telemetry>>(
    cx: &mut Cx<'_, F>,
    port: &mut Port,
    link: &mut StreamLink,
    received: &Request,
) -> Option<MavResult> {
    let Request { command, is_unclaimed, .. } = received;
    let request = MessageRequest::of(command)?;
    let (table, of, fixed) = (F::Vehicle::STREAMS, owner::<F>(command.component), Fixed::new(cx));
    // A message of another service is answered by that.
    let is_known = |id| !Rows::of(table, of, id, 0).is_empty() || fixed.interval(id).is_some();
    if !is_unclaimed && !request.subject().is_some_and(is_known) {
        return None;
    }
    if port.config.class == LinkClass::HighLatency || !request.is_valid {
        return Some(MavResult::DENIED);
    }
    if command.id == MavCmd::SET_MESSAGE_INTERVAL {
        return Some(set_interval(fixed, port, link, (table, of), command));
    }
    let asks_interval = command.id == MavCmd::GET_MESSAGE_INTERVAL;
    if asks_interval || request.id == Some(MessageInterval::ID) {
        let id = if asks_interval { request.id } else { request.index.map(u32::from) };
        return Some(request_interval(link, table, of, id));
    }
    let id = request.id?;
    let first = Rows::of(table, of, id, 0).first()?;
    let Some(index) = request.index else { return Some(MavResult::DENIED) };
    // A message that cannot be filled now is refused now; otherwise the client would wait for it.
    let mut is_available = false;
    for stream in table.iter().filter(|stream| stream.is(of, id, 0)) {
        let probed = if index == 0 { stream.instance } else { index };
        is_available = is_available || fill_row(cx, &mut port.outbox, stream, probed, true);
    }
    if !is_available {
        return Some(MavResult::DENIED);
    }
    let rows = Rows::of(table, of, id, index);
    if rows.is_empty() && !link.request_index(first, index) {
        return Some(MavResult::TEMPORARILY_REJECTED);
    }
    link.request(rows);
    Some(MavResult::ACCEPTED)
}

/// The parameters that the commands about messages have in common.
#[derive(Clone, Copy, Debug)]
struct MessageRequest {
    /// Parameter 1; `None` if it is no message id.
    id: Option<u32>,
    /// Parameter 2 as an index; 0 if it is not given (C-8).
    index: Option<u16>,
    /// Whether the response target is valid.
    is_valid: bool,
}

impl MessageRequest {
    fn of(command: &Command) -> Option<Self> {
        match command.id {
            MavCmd::REQUEST_MESSAGE | MavCmd::SET_MESSAGE_INTERVAL | MavCmd::GET_MESSAGE_INTERVAL => {}
            // A predecessor of REQUEST_MESSAGE, without parameters.
            MavCmd::GET_HOME_POSITION => {
                return Some(Self { id: Some(HomePosition::ID), index: Some(0), is_valid: true });
            }
            _ => return None,
        }
        let [id, index, ..] = command.params;
        let is_valid = command.has_response_target();
        Some(Self { id: num::integer(id), index: index_of(index), is_valid })
    }

    /// Returns the id of the message that the command is about: with MESSAGE_INTERVAL, the one whose interval is asked
    /// for.
    fn subject(self) -> Option<u32> {
        if self.id == Some(MessageInterval::ID) { self.index.map(u32::from) } else { self.id }
    }
}

/// Returns a parameter that is an index; 0 if it is not given (C-8, F-15). `None` if it is no index.
fn index_of(param: f32) -> Option<u16> {
    if param.is_nan() { Some(0) } else { num::integer(param) }
}

/// Returns whose rows a request to this component is about: 0 is the autopilot, and `None` is all.
pub(super) fn owner<F: Firmware>(component: ComponentId) -> Option<ComponentId> {
    match F::COMPONENTS.is_empty() || component.wire() == 0 {
        true => None,
        false => Some(if F::is_component(component) { component } else { ComponentId::ALL }),
    }
}

/// Schedules a MESSAGE_INTERVAL.
fn request_interval(link: &mut StreamLink, table: &[Stream], of: Option<ComponentId>, id: Option<u32>) -> MavResult {
    let request = id.and_then(IntervalRequest::of_message).and_then(|request| match of {
        None => Some(request),
        Some(ComponentId::ALL) => Some(request).filter(|request| request.row().is_none()),
        // Another component is identified by a row of its own.
        Some(component) => {
            let id = u32::from(request.0);
            let row = table.iter().position(|stream| stream.id == id && stream.component == component);
            IntervalRequest::of_row(row?)
        }
    });
    match request {
        Some(request) if link.request_interval(request) => MavResult::ACCEPTED,
        Some(_) => MavResult::TEMPORARILY_REJECTED,
        None => MavResult::DENIED,
    }
}

/// Handles MAV_CMD_SET_MESSAGE_INTERVAL.
fn set_interval(
    fixed: Fixed,
    port: &Port,
    link: &mut StreamLink,
    (table, of): (&[Stream], Option<ComponentId>),
    command: &Command,
) -> MavResult {
    let [id, micros, instance, _] = command.params;
    let is_valid = micros >= 0.0 || micros == -1.0;
    // A message that can never be sent is refused: MAVLink 1 has no room for some ids (S-10).
    let id = num::integer(id).filter(|id| is_valid && port.outbox.takes(*id));
    let (Some(id), Some(instance)) = (id, index_of(instance)) else { return MavResult::DENIED };
    let is_off = micros < 0.0;
    if fixed.interval(id).is_some() && of.is_none_or(|component| component.wire() == 0) {
        // Clamped to its fixed interval. It cannot be stopped.
        return if is_off || instance != 0 { MavResult::DENIED } else { MavResult::ACCEPTED };
    }
    let interval = if micros == 0.0 { 0 } else { clamped(u64::from(num::saturated(micros))) };
    let mut result = MavResult::DENIED;
    for (stream, slot) in table.iter().zip(&mut link.slots) {
        if stream.is(of, id, instance) {
            slot.set_interval((!is_off).then_some(interval));
            result = MavResult::ACCEPTED;
        }
    }
    link.refresh(table, port.config.streams);
    result
}

/// Handles other messages about streams. Returns true if no other service needs the frame.
pub(super) fn handle_frame<F: Firmware<Vehicle: Telemetry>>(
    cx: &Cx<'_, F>,
    port: &Port,
    link: &mut StreamLink,
    of: Option<ComponentId>,
    frame: &Frame<'_>,
) -> bool {
    if let Some(status) = frame.decode::<RadioStatus>() {
        link.on_radio(cx.now, status.txbuf);
        return false;
    }
    let Some(request) = frame.decode::<RequestDataStream>() else { return false };
    // A rate of 0 is off, as in ArduPilot.
    let rate = NonZeroU32::new(u32::from(request.req_message_rate));
    let interval = match request.start_stop {
        0 => None,
        1 => rate.map(|rate| clamped(u64::from(1_000_000 / rate))),
        _ => return true,
    };
    let group = request.req_stream_id;
    for (stream, slot) in F::Vehicle::STREAMS.iter().zip(&mut link.slots) {
        let is_in_group = stream.group != MavDataStream::ALL && (group == MavDataStream::ALL || group == stream.group);
        if is_in_group && stream.is_of(of) {
            slot.set_interval(interval);
        }
    }
    link.refresh(F::Vehicle::STREAMS, port.config.streams);
    true
}

/// Sends a pending MESSAGE_INTERVAL: the current interval, including the delay that a radio's full buffer adds; of
/// several instances, the shortest.
pub(super) fn send_interval<F: Firmware<Vehicle: Telemetry>>(
    cx: &Cx<'_, F>,
    port: &mut Port,
    link: &mut StreamLink,
) -> bool {
    let (table, fixed) = (F::Vehicle::STREAMS, Fixed::new(cx));
    let Some(request) = link.take_interval_request() else { return false };
    let (message_id, of) = match request.row().and_then(|row| table.get(row)) {
        _ if F::COMPONENTS.is_empty() => (request.0, None),
        Some(stream) => (u16::try_from(stream.id).unwrap_or(0), Some(stream.component)),
        None => (request.0, Some(ComponentId::ALL)),
    };
    let id = u32::from(message_id);
    // 0: there is no such stream, or the link cannot carry it (S-10). -1 as unsigned, the longest, is off.
    let mut interval = 0u32;
    if port.outbox.takes(id) {
        if of.is_none_or(|component| component.wire() == 0) {
            interval = fixed.interval(id).unwrap_or(0);
        }
        for (stream, slot) in table.iter().zip(&link.slots).filter(|(stream, _)| stream.is(of, id, 0)) {
            let micros = slot.interval(stream, port.config.streams).unwrap_or(u32::MAX);
            let micros = micros.saturating_add(link.slowdown(cx.now, micros, port.config.least_stream_percent));
            interval = if interval == 0 { micros } else { interval.min(micros) };
        }
    }
    port.outbox.send_from::<F, _>(of, &MessageInterval { interval_us: interval.cast_signed(), message_id })
}

/// Sends the next requested message that the vehicle can fill. Returns false if it can fill none.
pub(super) fn send_requested<F: Firmware<Vehicle: Telemetry>>(
    cx: &mut Cx<'_, F>,
    port: &mut Port,
    link: &mut StreamLink,
) -> bool {
    while let Some(requested) = link.take_requested() {
        let Some(stream) = F::Vehicle::STREAMS.get(requested.row) else { continue };
        if fill_row(cx, &mut port.outbox, stream, requested.index.unwrap_or(stream.instance), false) {
            return true;
        }
    }
    false
}
