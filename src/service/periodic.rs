//! A message that a service streams by itself, at an interval that a client may change on each link.
//!
//! The vehicle's own streams have a table with rows; this is for the one message of an optional service. Both answer the
//! same commands in the same way. Left out: the pause that a radio's full buffer causes.

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

/// The message and its interval by default (µs), on each link whose profile has streams.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Row {
    pub(crate) id: u32,
    pub(crate) micros: u32,
}

/// The state of the message on a link. Initially all zero bits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Periodic {
    /// When it is due.
    at: Instant,
    /// The interval that a client has set (µs): 0 is the default.
    micros: u32,
    /// It is to be sent once, at once.
    is_asked: bool,
    /// MESSAGE_INTERVAL is to be sent.
    is_interval_asked: bool,
}

impl Periodic {
    pub(crate) const NEW: Self = Self { at: Instant::ZERO, micros: 0, is_asked: false, is_interval_asked: false };

    /// Returns the interval on a link (µs).
    fn interval(&self, row: Row, port: &Port) -> u32 {
        match (self.micros, port.config.streams) {
            (0, StreamProfile::Off) => OFF,
            (0, _) => row.micros,
            (micros, _) => micros,
        }
    }

    /// Handles a command about this message; `None` for all others.
    #[inline(never)]
    pub(crate) fn on_command(&mut self, row: Row, port: &Port, command: &Command) -> Option<MavResult> {
        let [id, second, instance, _] = command.params.map(|param| num::integer::<i32>(param).unwrap_or(-2));
        let own = row.id.cast_signed();
        let is_default = |param: f32| param.is_nan() || param == 0.0;
        let is_sendable = command.has_response_target() && port.outbox.takes(row.id);
        let asked = match command.id {
            MavCmd::REQUEST_MESSAGE if id == own => &mut self.is_asked,
            MavCmd::REQUEST_MESSAGE if id == MessageInterval::ID.cast_signed() && second == own => {
                &mut self.is_interval_asked
            }
            MavCmd::GET_MESSAGE_INTERVAL if id == own => &mut self.is_interval_asked,
            MavCmd::SET_MESSAGE_INTERVAL if id == own => {
                let [_, micros, third, _] = command.params;
                let is_valid = (micros >= 0.0 || micros == -1.0) && (instance == 0 || is_default(third));
                if !is_valid || !is_sendable {
                    return Some(MavResult::DENIED);
                }
                self.micros = match num::saturated(micros) {
                    _ if micros < 0.0 => OFF,
                    0 if micros == 0.0 => 0,
                    micros => micros.clamp(MIN, MAX),
                };
                self.at = Instant::ZERO;
                return Some(MavResult::ACCEPTED);
            }
            _ => return None,
        };
        *asked = is_sendable;
        Some(if is_sendable { MavResult::ACCEPTED } else { MavResult::DENIED })
    }

    /// Whether the message was asked for.
    pub(crate) const fn is_asked(&self) -> bool {
        self.is_asked
    }

    /// Whether MESSAGE_INTERVAL was asked for.
    pub(crate) const fn is_interval_asked(&self) -> bool {
        self.is_interval_asked
    }

    /// Returns whether the message was asked for, and forgets it.
    pub(crate) fn take_asked(&mut self) -> bool {
        core::mem::take(&mut self.is_asked)
    }

    /// Returns the MESSAGE_INTERVAL that was asked for, and forgets it.
    #[inline(never)]
    pub(crate) fn take_interval(&mut self, row: Row, port: &Port) -> Option<MessageInterval> {
        // Off is -1, all bits of which are set.
        let interval_us = self.interval(row, port).cast_signed();
        let message_id = u16::try_from(row.id).ok()?;
        core::mem::take(&mut self.is_interval_asked).then_some(MessageInterval { interval_us, message_id })
    }

    /// Returns when the message is due in its stream. `has_listener`: see `streams_wait_for_peer`.
    pub(crate) fn due(&self, row: Row, port: &Port, has_listener: bool) -> Instant {
        let is_on = has_listener && self.interval(row, port) != OFF && port.outbox.takes(row.id);
        if is_on { self.at } else { Instant::NEVER }
    }

    /// Records that it is sent now, in its stream.
    #[inline(never)]
    pub(crate) fn sent(&mut self, now: Instant, row: Row, port: &Port) {
        let interval = Duration::from_micros(u64::from(self.interval(row, port)));
        // The average rate is kept, and what was missed is not made up.
        self.at = self.at.after(interval);
        if self.at <= now {
            self.at = now.after(interval);
        }
    }
}
