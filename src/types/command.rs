//! A command and its outcome.

use core::num::NonZeroU64;

use super::link::{LinkClass, Peer};
use super::sender::Trust;
use crate::dialect::{MavCmd, MavFrame, MavResult};
use crate::message::ComponentId;
use crate::time::Duration;

/// A received command, from COMMAND_LONG or COMMAND_INT.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Command {
    /// The number of the command.
    pub id: MavCmd,
    /// Parameters 1 to 4. Where a command does not use one, NaN and 0 both mean "default" (C-8).
    pub params: [f32; 4],
    /// Parameters 5 and 6, in the message's form.
    pub position: CommandPosition,
    /// Parameter 7: the altitude (m) of a command with a location.
    pub z: f32,
    /// The sender, and the link.
    pub from: Peer,
    /// What proves the sender.
    pub trust: Trust,
    /// The class of the link. A command from a [`HighLatency`](LinkClass::HighLatency) link may be old, and superseded
    /// by a later one (L-16). A vehicle may refuse to arm or to take off for such a command.
    pub class: LinkClass,
    /// The age of the command when it was received, by its signature: the current time minus its timestamp. The current
    /// time is the latest one from `Signing::set_time`, or else the latest timestamp of any peer; see `Signing::age`.
    /// There is no other source: MAVLink's commands carry no timestamp.
    ///
    /// `None` if neither time is known since the start, if the command is not signed, and without the feature
    /// `signing`. The age is only as accurate as both clocks. A sender whose clock is behind makes its commands look
    /// older than they are; one whose clock is ahead makes them look younger.
    pub age: Option<Duration>,
    /// The component to which it is addressed: the autopilot, another one of the firmware, or 0, which is all.
    pub component: ComponentId,
    /// Whether the command is addressed to every system (C-1). A vehicle may refuse to arm or to take off on a
    /// broadcast. The stack itself denies broadcasts that would reset, erase or restart, such as PREFLIGHT_STORAGE and
    /// PREFLIGHT_REBOOT_SHUTDOWN (C-14).
    pub is_broadcast: bool,
    /// 0 in the first transmission, incremented in each retransmission. COMMAND_INT does not have it, and many clients
    /// never increment it (C-10).
    pub confirmation: u8,
}

impl Command {
    /// Whether parameter 7 is a valid response target, as in the commands that ask for a message: 0 default, 1 the
    /// requester, 2 broadcast, NaN not used (C-8, Q-3).
    // Out of line: it has several callers.
    #[inline(never)]
    pub(crate) fn has_response_target(&self) -> bool {
        self.z.is_nan() || matches!(crate::num::integer(self.z), Some(0..=2))
    }
}

/// Parameters 5 and 6 of a command.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CommandPosition {
    /// From COMMAND_LONG: floats, in degrees if the command has a location (C-6).
    Long {
        /// Parameter 5: latitude (deg) in a command with a location; NaN means "not given".
        param5: f32,
        /// Parameter 6: longitude (deg) in a command with a location; NaN means "not given".
        param6: f32,
    },
    /// From COMMAND_INT: deg·1e7 in `frame` if the command has a location (C-7).
    Int {
        /// The frame of the position. It has no meaning for a command without a location.
        frame: MavFrame,
        /// Parameter 5: latitude (deg·1e7) in a global frame, m·1e4 in a local one; `i32::MAX` means "not given".
        x: i32,
        /// Parameter 6: longitude (deg·1e7) in a global frame, m·1e4 in a local one; `i32::MAX` means "not given".
        y: i32,
    },
}

impl CommandPosition {
    /// Returns latitude and longitude in deg·1e7, for a command with a location. Each is `None` if it is not given (NaN
    /// or `i32::MAX`) or out of the integer's range. Floats are scaled exactly, without rounding to another float in
    /// between.
    pub fn lat_lon(&self) -> (Option<i32>, Option<i32>) {
        match *self {
            Self::Long { param5, param6 } => (crate::num::scale_1e7(param5), crate::num::scale_1e7(param6)),
            Self::Int { x, y, .. } => (Some(x).filter(|&x| x != i32::MAX), Some(y).filter(|&y| y != i32::MAX)),
        }
    }

    /// Returns parameters 5 and 6 of a command without a location; NaN for one that is not given (C-7). They are plain numbers in
    /// every frame (M-75).
    pub fn params(&self) -> (f32, f32) {
        match *self {
            Self::Long { param5, param6 } => (param5, param6),
            Self::Int { x, y, .. } => (crate::num::from_i32(x), crate::num::from_i32(y)),
        }
    }
}

/// The outcome of a command, sent in its COMMAND_ACK.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use = "the sender waits for the answer: return it from `Commands::command`"]
pub struct Outcome {
    /// The result, chosen as [`MavResult`] describes (C-4).
    pub result: MavResult,
    /// COMMAND_ACK.result_param2: further information about the result. Each command defines its meaning.
    pub result_param2: i32,
}

impl From<MavResult> for Outcome {
    fn from(result: MavResult) -> Self {
        Self { result, result_param2: 0 }
    }
}

/// The answer to a command.
#[derive(Clone, Copy, Debug)]
pub struct CommandAnswer {
    pub(crate) command: MavCmd,
    pub(crate) outcome: Outcome,
    /// COMMAND_ACK.progress (%); 255 is unknown.
    pub(crate) progress: u8,
}

/// The origin of a command, and its age.
#[derive(Clone, Copy)]
pub(crate) struct Origin {
    pub(crate) from: Peer,
    pub(crate) trust: Trust,
    pub(crate) class: LinkClass,
    pub(crate) age: Option<Duration>,
}

/// The time at which a command was signed (10 µs), by its sender's clock. It can only be compared with other commands
/// of that sender. `None` if no signature verifies it.
pub(crate) type SignedAt = Option<NonZeroU64>;

/// A refusal: its result, and the reason where the result does not imply one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal {
    pub(crate) result: MavResult,
    pub(crate) reason: RefusalReason,
}

/// The reason of a refusal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RefusalReason {
    /// The result is the reason.
    Result,
    /// The command was a broadcast.
    Broadcast,
    /// This parameter is out of range.
    Param(u8),
    /// There is no storage.
    NoStorage,
    /// Another station has the control that the command asks for.
    Taken,
    /// The mode cannot be entered. The text names it by this number; a negative one is not known.
    Mode(i32, ModeFault),
}

/// Why a mode cannot be entered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModeFault {
    /// The command does not say that it has the number of a custom mode.
    NotCustom,
    /// It cannot be selected.
    NotSelectable,
    /// The vehicle does not have it.
    Unknown,
}

impl Refusal {
    /// A broadcast of a command that may only be sent to one system (C-14).
    pub(crate) const BROADCAST: Self = Self::denied(RefusalReason::Broadcast);

    /// DENIED, for this reason.
    pub(crate) const fn denied(reason: RefusalReason) -> Self {
        Self { result: MavResult::DENIED, reason }
    }
}

impl From<MavResult> for Refusal {
    fn from(result: MavResult) -> Self {
        Self { result, reason: RefusalReason::Result }
    }
}
