//! A message that a service streams by itself, at an interval that a client may change on each link.
//!
//! The vehicle's own streams have a table with rows; this is for the one message of an optional service. Both answer
//! the same commands in the same way. Left out: the pause that a radio's full buffer causes.

use crate::dialect::{MavCmd, MavResult, MessageInterval};
use crate::link::Port;
use crate::message::Message;
use crate::num;
use crate::time::{Duration, Instant};
use crate::types::{Command, StreamProfile};

/// The bounds of an interval that a client sets (µs); a request beyond them is clamped.
const MIN: u32 = 20_000;
const MAX: u32 = 60_000_000;

/// The interval of a message that is off.
const OFF: u32 = u32::MAX;

/// The message, its intervals by default (µs) on links with [`StreamProfile::Radio`] and [`StreamProfile::Onboard`],
/// and another message that is sent on request only.
#[derive(Clone, Copy, Debug)]
pub struct StatusMessage {
    pub(crate) id: u32,
    pub(crate) radio: u32,
    pub(crate) onboard: u32,
    pub(crate) other: u32,
}

/// The state of the message on a link. Initially all zero bits.
#[derive(Clone, Copy, Debug)]
pub struct StatusStream {
    /// When it is due.
    at: Instant,
    /// The interval that a client has set (µs): 0 is the default.
    micros: u32,
    /// The pending requests: a set of [`Asked`].
    asked: u8,
}

/// A message that a client may request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asked {
    /// The message itself.
    Message,
    /// Its interval, by MESSAGE_INTERVAL.
    Interval,
    /// The other message.
    Other,
}

impl Asked {
    /// Returns its bit in a set. The lowest bit is sent first.
    const fn bit(self) -> u8 {
        match self {
            Self::Message => 1,
            Self::Interval => 2,
            Self::Other => 4,
        }
    }
}

impl StatusStream {
    pub(crate) const NEW: Self = Self { at: Instant::ZERO, micros: 0, asked: 0 };

    /// Returns the interval on a link (µs).
    fn interval(&self, row: StatusMessage, port: &Port) -> u32 {
        match (self.micros, port.config.streams) {
            (0, StreamProfile::Off) => OFF,
            (0, StreamProfile::Radio) => row.radio,
            (0, StreamProfile::Onboard) => row.onboard,
            (micros, _) => micros,
        }
    }

    /// Handles a command about one of the messages; `None` for all others.
    pub(crate) fn on_command(&mut self, row: StatusMessage, port: &Port, command: &Command) -> Option<MavResult> {
        let [first, second, third, _] = command.params;
        let is_request = command.id == MavCmd::REQUEST_MESSAGE;
        let mut id = num::integer::<i32>(first)?.cast_unsigned();
        let is_interval = is_request && id == MessageInterval::ID;
        if is_interval {
            id = num::integer::<i32>(second)?.cast_unsigned();
        }
        let asked = match command.id {
            MavCmd::REQUEST_MESSAGE if is_interval => Some(Asked::Interval),
            MavCmd::REQUEST_MESSAGE if id == row.other => Some(Asked::Other),
            MavCmd::REQUEST_MESSAGE => Some(Asked::Message),
            MavCmd::GET_MESSAGE_INTERVAL => Some(Asked::Interval),
            MavCmd::SET_MESSAGE_INTERVAL => None,
            _ => return None,
        };
        if id != row.id && asked != Some(Asked::Other) {
            return None;
        }
        if !command.has_response_target() || !port.outbox.takes(row.id) {
            return Some(MavResult::DENIED);
        }
        if let Some(asked) = asked {
            self.asked |= asked.bit();
            return Some(MavResult::ACCEPTED);
        }
        let micros = match num::saturated(second) {
            _ if second == -1.0 => OFF,
            _ if second == 0.0 => 0,
            micros => micros.clamp(MIN, MAX),
        };
        let is_instance_valid = third.is_nan() || third == 0.0;
        if second.is_nan() || (second < 0.0 && micros != OFF) || !is_instance_valid {
            return Some(MavResult::DENIED);
        }
        (self.at, self.micros) = (Instant::ZERO, micros);
        Some(MavResult::ACCEPTED)
    }

    /// Returns the pending request that is sent first.
    pub(crate) const fn asked(&self) -> Option<Asked> {
        match self.asked.trailing_zeros() {
            0 => Some(Asked::Message),
            1 => Some(Asked::Interval),
            2 => Some(Asked::Other),
            _ => None,
        }
    }

    /// Removes a pending request, because it is answered now, or cannot be.
    pub(crate) const fn forget(&mut self, asked: Asked) {
        self.asked &= !asked.bit();
    }

    /// Returns MESSAGE_INTERVAL. Off is −1: all bits are set.
    pub(crate) fn told(&self, row: StatusMessage, port: &Port) -> MessageInterval {
        let message_id = u16::try_from(row.id).unwrap_or(0);
        MessageInterval { interval_us: self.interval(row, port).cast_signed(), message_id }
    }

    /// Returns when the message is due in its stream. `has_listener`: see `streams_wait_for_peer`.
    pub(crate) fn due(&self, row: StatusMessage, port: &Port, has_listener: impl FnOnce() -> bool) -> Instant {
        let is_on = self.interval(row, port) != OFF && port.outbox.takes(row.id) && has_listener();
        if is_on { self.at } else { Instant::NEVER }
    }

    /// Records that it is sent now, in its stream.
    pub(crate) fn sent(&mut self, now: Instant, row: StatusMessage, port: &Port) {
        let interval = Duration::from_micros(u64::from(self.interval(row, port)));
        // The average rate is kept. Missed messages are not made up.
        self.at += interval;
        if self.at <= now {
            self.at = now + interval;
        }
    }
}
