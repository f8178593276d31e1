//! Requests for messages and intervals: commands, and the older REQUEST_DATA_STREAM.

use super::schedule::{Slot, Streams};
use super::{Fill, Stream, Telemetry, clamped, part, rows};
use crate::dialect::{
    CurrentMode, Heartbeat, HomePosition, MavCmd, MavDataStream, MavResult, MessageInterval, MissionCurrent,
    RadioStatus, RequestDataStream,
};
use crate::frame::Frame;
use crate::link::{Outbox, Port};
use crate::message::{ComponentId, Message};
use crate::num;
use crate::service::Request;
use crate::time::{Duration, Instant};
use crate::types::{Command, Firmware, LinkClass, StreamProfile};

/// Interval of the MISSION_CURRENT that the stack sends by itself (µs).
const MISSION_CURRENT_INTERVAL: u32 = 1_000_000;

/// CURRENT_MODE is sent with every second HEARTBEAT.
const HEARTBEATS_PER_MODE: u64 = 2;

/// The messages that the stack itself sends, at intervals that cannot be changed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fixed {
    /// The interval of HEARTBEAT, which must never be stopped.
    pub(super) heartbeat: Duration,
    /// Whether MISSION_CURRENT is sent.
    pub(super) has_missions: bool,
    /// Whether CURRENT_MODE is sent.
    pub(super) has_modes: bool,
}

impl Fixed {
    fn interval(self, id: u32) -> Option<u32> {
        match id {
            Heartbeat::ID => Some(clamped(self.heartbeat.as_micros())),
            MissionCurrent::ID if self.has_missions => Some(MISSION_CURRENT_INTERVAL),
            CurrentMode::ID if self.has_modes => {
                Some(clamped(self.heartbeat.as_micros().saturating_mul(HEARTBEATS_PER_MODE)))
            }
            _ => None,
        }
    }
}

/// Handles a command about messages; `None` for all other commands, and for messages that the vehicle does not declare.
pub(super) fn handle_command<F: Firmware<Vehicle: Telemetry>>(
    now: Instant,
    fixed: Fixed,
    port: &mut Port,
    streams: &mut Streams,
    slots: &mut [Slot],
    vehicle: &mut F::Vehicle,
    Request { command, is_unclaimed, .. }: &Request,
) -> Option<MavResult> {
    let request = Asked::of(command)?;
    let (table, of) = (F::Vehicle::STREAMS, part::<F>(command.component));
    // A message of another service is answered by that.
    let is_known = |id| rows(table, of, id, 0) != 0 || fixed.interval(id).is_some();
    if !is_unclaimed && !request.subject().is_some_and(is_known) {
        return None;
    }
    if port.config.class == LinkClass::HighLatency || !request.is_valid {
        return Some(MavResult::DENIED);
    }
    let is_interval = matches!(command.id, MavCmd::SET_MESSAGE_INTERVAL | MavCmd::GET_MESSAGE_INTERVAL);
    if is_interval || request.id == Some(MessageInterval::ID) {
        return Some(on_interval(fixed, port, streams, (table, of, slots), command, request));
    }
    let id = request.id?;
    let all = rows(table, of, id, 0);
    if all == 0 {
        return None;
    }
    let Some(index) = request.index else { return Some(MavResult::DENIED) };
    // A message that cannot be filled now is refused now; otherwise the client would wait for it.
    for stream in table.iter().filter(|stream| stream.id == id && stream.is_of(of)) {
        let probed = if index == 0 { stream.instance } else { index };
        let vehicle = &mut *vehicle;
        if port.outbox.as_component::<F>(Some(stream.component), |outbox| {
            fill(vehicle, &mut Fill::new(now, id, probed, outbox, true))
        }) {
            let is_pending = streams.ask(rows(table, of, id, index), all, index);
            return Some(if is_pending { MavResult::ACCEPTED } else { MavResult::TEMPORARILY_REJECTED });
        }
    }
    Some(MavResult::DENIED)
}

/// The parameters that the commands about messages have in common.
#[derive(Clone, Copy, Debug)]
struct Asked {
    /// Parameter 1; `None` if it is no message id.
    id: Option<u32>,
    /// Parameter 2 as an index; 0 if it is not given (C-8).
    index: Option<u16>,
    /// Whether the response target is valid.
    is_valid: bool,
}

impl Asked {
    /// Returns the id of the message that the command is about: with MESSAGE_INTERVAL, the one whose interval is asked for.
    fn subject(self) -> Option<u32> {
        if self.id == Some(MessageInterval::ID) { self.index.map(u32::from) } else { self.id }
    }

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
}

/// Returns a parameter that is an index; 0 if it is not given (C-8, F-15). `None` if it is no index.
fn index_of(param: f32) -> Option<u16> {
    if param.is_nan() { Some(0) } else { num::integer(param) }
}

/// Handles a command about intervals. Not generic, so that it is compiled once.
fn on_interval(
    fixed: Fixed,
    port: &Port,
    streams: &mut Streams,
    (table, of, slots): (&[Stream], Option<ComponentId>, &mut [Slot]),
    command: &Command,
    request: Asked,
) -> MavResult {
    if command.id != MavCmd::SET_MESSAGE_INTERVAL {
        let id = if command.id == MavCmd::REQUEST_MESSAGE {
            request.index
        } else {
            request.id.and_then(|id| u16::try_from(id).ok())
        };
        let id = match of {
            // Another component is known by a row of its own.
            Some(component) if component != ComponentId::ALL => id.and_then(|id| row_of(table, component, id)),
            // MESSAGE_INTERVAL has 16 bits for the id.
            _ => id.filter(|id| of.is_none() || *id < ROWS),
        };
        return match id {
            Some(id) if streams.request_interval(id) => MavResult::ACCEPTED,
            Some(_) => MavResult::TEMPORARILY_REJECTED,
            None => MavResult::DENIED,
        };
    }
    let [_, micros, instance, _] = command.params;
    let is_valid = micros >= 0.0 || micros == -1.0;
    // A message that can never be sent is refused: MAVLink 1 has no room for some ids (S-10).
    let id = request.id.filter(|&id| is_valid && port.outbox.takes(id));
    let (Some(id), Some(instance)) = (id, index_of(instance)) else { return MavResult::DENIED };
    let is_off = micros < 0.0;
    if fixed.interval(id).is_some() && of.is_none_or(|component| component.wire() == 0) {
        // Clamped to its fixed interval. It cannot be stopped.
        return if is_off || instance != 0 { MavResult::DENIED } else { MavResult::ACCEPTED };
    }
    let interval = if micros == 0.0 { 0 } else { clamped(u64::from(num::saturated(micros))) };
    let mut rows = rows(table, of, id, instance);
    let result = if rows == 0 { MavResult::DENIED } else { MavResult::ACCEPTED };
    for slot in &mut *slots {
        if rows & 1 != 0 {
            slot.set_interval((!is_off).then_some(interval));
        }
        rows = rows.wrapping_shr(1);
    }
    streams.refresh(table, slots, port.config.streams);
    result
}

/// Handles other messages about streams. Returns true if no other service needs the frame.
pub(super) fn handle_frame(
    now: Instant,
    profile: StreamProfile,
    streams: &mut Streams,
    table: &[Stream],
    of: Option<ComponentId>,
    slots: &mut [Slot],
    frame: &Frame<'_>,
) -> bool {
    if let Some(status) = frame.decode::<RadioStatus>() {
        streams.on_radio(now, status.txbuf);
        return false;
    }
    let Some(request) = frame.decode::<RequestDataStream>() else { return false };
    // A rate of 0 is off, as in ArduPilot.
    let micros = match request.start_stop {
        0 => None,
        1 => 1_000_000u32.checked_div(u32::from(request.req_message_rate)),
        _ => return true,
    };
    let interval = micros.map(|micros| clamped(u64::from(micros)));
    let group = request.req_stream_id;
    for (stream, slot) in table.iter().zip(&mut *slots) {
        if stream.group != MavDataStream::ALL
            && stream.is_of(of)
            && (group == MavDataStream::ALL || group == stream.group)
        {
            slot.set_interval(interval);
        }
    }
    streams.refresh(table, slots, profile);
    true
}

/// Sends a pending MESSAGE_INTERVAL: the current interval, including the delay that a radio's full buffer adds; of several
/// instances, the shortest.
pub(super) fn send_interval<F: Firmware>(
    now: Instant,
    fixed: Fixed,
    port: &mut Port,
    streams: &mut Streams,
    table: &[Stream],
    slots: &[Slot],
) -> bool {
    let Port { outbox, config, .. } = port;
    let Some(mut message_id) = streams.take_interval_request() else { return false };
    let mut of = None;
    if !F::COMPONENTS.is_empty() {
        of = Some(ComponentId::ALL);
        if let Some(row) = message_id.checked_sub(ROWS).and_then(|row| table.get(usize::from(row))) {
            (message_id, of) = (u16::try_from(row.id).unwrap_or(0), Some(row.component));
        }
    }
    let id = u32::from(message_id);
    // 0: there is no such stream, or the link cannot carry it (S-10). -1 as unsigned, the longest, is off.
    let mut interval = 0u32;
    if outbox.takes(id) {
        if of.is_none_or(|component| component.wire() == 0) {
            interval = fixed.interval(id).unwrap_or(0);
        }
        for (stream, slot) in table.iter().zip(slots) {
            if stream.id == id && stream.is_of(of) {
                let micros = slot.interval(stream, config.streams).unwrap_or(u32::MAX);
                let micros = micros.saturating_add(streams.slowdown(now));
                interval = if interval == 0 { micros } else { interval.min(micros) };
            }
        }
    }
    outbox.send_from::<F, _>(of, &MessageInterval { interval_us: interval.cast_signed(), message_id })
}

/// From here on, a pending MESSAGE_INTERVAL is not for a message id, but for the row of another component of the firmware. No message of
/// common has such an id; the intervals of others are not told in a firmware of several components.
const ROWS: u16 = 0xFF00;

/// Returns the pending MESSAGE_INTERVAL of another component; `None` if it does not stream the message.
fn row_of(table: &[Stream], component: ComponentId, id: u16) -> Option<u16> {
    let row = table.iter().position(|stream| stream.id == u32::from(id) && stream.component == component)?;
    Some(ROWS.saturating_add(u16::try_from(row).ok()?))
}

/// Sends the next requested message that the vehicle can fill. Returns false if it can fill none.
pub(super) fn send_asked<F: Firmware<Vehicle: Telemetry>>(
    now: Instant,
    streams: &mut Streams,
    outbox: &mut Outbox,
    vehicle: &mut F::Vehicle,
) -> bool {
    while let Some((number, index)) = streams.take_asked() {
        let Some(stream) = F::Vehicle::STREAMS.get(number) else { continue };
        let index = index.unwrap_or(stream.instance);
        let vehicle = &mut *vehicle;
        if outbox.as_component::<F>(Some(stream.component), |outbox| {
            fill(vehicle, &mut Fill::new(now, stream.id, index, outbox, false))
        }) {
            return true;
        }
    }
    false
}

/// Asks the vehicle for a message.
pub(crate) fn fill<V: Telemetry>(vehicle: &mut V, out: &mut Fill<'_>) -> bool {
    vehicle.fill(out.id, out)
}
