//! Texts that say why a command is refused: a COMMAND_ACK has a result but no reason (C-4).
//!
//! Only the stack's own refusals are explained here; the vehicle explains its own. Requests for messages have no text: programs
//! send them, and ask for many messages that a vehicle does not have. COMMAND_LONG_ONLY, COMMAND_INT_ONLY and UNSUPPORTED are
//! clear without a text.

use crate::dialect::{MavCmd, MavResult, MavSeverity};
use crate::frame::SystemId;
use crate::link::{LinkClass, LinkMask, Port};
use crate::message::Text;
use crate::service::statustext::StatusTexts;
use crate::time::Instant;
use crate::vehicle::Command;

/// Returns the number of the current period of 2^20 µs (1.05 s): a link gets at most one text per period, whatever it receives.
/// Only the low 16 bits are stored, in what would be padding; they repeat after 19 hours.
fn period(now: Instant) -> u16 {
    let [_, _, low, high, ..] = now.as_micros().wrapping_shr(4).to_le_bytes();
    // 0 means that the link got no text yet.
    u16::from_le_bytes([low, high]).wrapping_add(1)
}

/// A refusal: its result, and the reason where the result does not imply one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Refusal {
    pub(crate) result: MavResult,
    pub(super) why: Why,
}

/// The reason of a refusal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Why {
    /// The result says it all.
    Result,
    /// The command was a broadcast.
    Broadcast,
    /// This parameter is out of range.
    Param(u8),
}

impl Refusal {
    /// A broadcast of a command that may only be sent to one system (C-14).
    pub(crate) const BROADCAST: Self = Self { result: MavResult::DENIED, why: Why::Broadcast };
}

impl From<MavResult> for Refusal {
    fn from(result: MavResult) -> Self {
        Self { result, why: Why::Result }
    }
}

/// Sends the reason of a refusal to the link that `command` came by. `own` is our system id.
#[inline(never)]
pub(crate) fn explain(
    now: Instant,
    own: SystemId,
    port: &mut Port,
    texts: &mut StatusTexts,
    command: &Command,
    refusal: Refusal,
) {
    let why = refusal.why;
    let reason = match (refusal.result, why) {
        _ if command.id == MavCmd::REQUEST_MESSAGE => return,
        (MavResult::DENIED, Why::Broadcast) => Reason { end: own.0, ..Reason::new("sent to 0; use system ") },
        (MavResult::DENIED, Why::Param(param)) => Reason { index: param, ..Reason::new(" out of range") },
        (MavResult::DENIED, Why::Result) => Reason::new("a parameter is out of range"),
        (MavResult::TEMPORARILY_REJECTED, _) => Reason::new("not now; try again later"),
        (MavResult::FAILED, _) => Reason::new("there is no such item"),
        (MavResult::COMMAND_UNSUPPORTED_MAV_FRAME, _) => Reason::new("frame not supported"),
        (MavResult::NOT_IN_CONTROL, _) => Reason::new("another station has control"),
        _ => return,
    };
    tell(now, port, texts, "Command ", Some(command.id.0.into()), reason);
}

/// Like [`explain`], for a mode; `mode` is its number, if it has one.
pub(crate) fn explain_mode(
    now: Instant,
    port: &mut Port,
    texts: &mut StatusTexts,
    mode: Option<u32>,
    why: &'static str,
) {
    let number = mode.and_then(|mode| i32::try_from(mode).ok());
    tell(now, port, texts, "Mode ", number, Reason::new(why));
}

/// The part of a text after the colon.
#[derive(Clone, Copy)]
struct Reason {
    /// The parameter to name first; 0 for none.
    index: u8,
    words: &'static str,
    /// The number to append; 0 for none.
    end: u8,
}

impl Reason {
    const fn new(words: &'static str) -> Self {
        Self { index: 0, words, end: 0 }
    }
}

/// Not inlined, so that the 120 bytes of stack for the text are free again in the caller.
#[inline(never)]
fn tell(
    now: Instant,
    port: &mut Port,
    texts: &mut StatusTexts,
    what: &str,
    number: Option<i32>,
    Reason { index, words, end }: Reason,
) {
    let period = period(now);
    // High-latency links carry no texts (L-4).
    if !cfg!(feature = "plan-texts") || port.config.class == LinkClass::HighLatency || period == port.refusal {
        return;
    }
    port.refusal = period;
    let mut text = Text::EMPTY;
    text.push_str(what);
    if let Some(number) = number {
        text.push_signed(number);
        text.push_str(" ");
    }
    text.push_str("refused: ");
    if index != 0 {
        text.push_str("parameter ");
        text.push_signed(index.into());
    }
    text.push_str(words);
    if end != 0 {
        text.push_signed(end.into());
    }
    texts.push(now, LinkMask::of(port.id), MavSeverity::WARNING, &text);
}

#[cfg(all(test, feature = "plan-texts"))]
mod tests {
    use super::*;
    use crate::frame::{Address, Version};
    use crate::link::{Link, LinkId, Outbox, Peer};
    use crate::service::statustext::{Entry, TextCursor};
    use crate::vehicle::CommandPosition;

    /// How many frames the refusal's text takes; one holds 50 bytes.
    fn frames(id: u16, refusal: Refusal) -> usize {
        let mut port = Link::VACANT.port;
        let mut entries = StatusTexts::<[Entry; 2]>::new();
        let (texts, now): (&mut StatusTexts, _) = (&mut entries, Instant::from_millis(5_000));
        let command = Command {
            id: MavCmd(id),
            params: [0.0; 4],
            position: CommandPosition::Long { param5: 0.0, param6: 0.0 },
            z: 0.0,
            from: Peer { address: Address::new(255, 190), link: LinkId(0) },
            class: LinkClass::Normal,
            age: None,
            is_broadcast: false,
            confirmation: 0,
        };
        explain(now, SystemId(254), &mut port, texts, &command, refusal);
        let (mut cursor, mut tx) = (TextCursor::new(), Outbox::VACANT);
        tx.configure(LinkId(0), Address::new(254, 1), Version::V2);
        let next = || {
            let is_sent = texts.next(&mut cursor, &mut tx);
            let len = tx.pending().len();
            tx.advance(len);
            is_sent.then_some(())
        };
        core::iter::from_fn(next).count()
    }

    /// C-4, T-5: each reason fits into one STATUSTEXT, which is all that a ground station without chunks and a MAVLink 1 link show,
    /// whatever the numbers of the command and of the vehicle.
    #[test]
    fn each_reason_fits_into_one_frame() {
        let mut explained = 0;
        for result in (0..=15).map(MavResult) {
            for why in [Why::Result, Why::Broadcast, Why::Param(7)] {
                let count = frames(42_424, Refusal { result, why });
                assert!(count <= 1, "{result:?} {why:?}");
                explained += count;
            }
        }
        assert!(explained >= 7, "{explained}");
    }
}
