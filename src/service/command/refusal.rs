//! Texts that explain why a command is refused: a COMMAND_ACK has a result but no reason (C-4).
//!
//! Only the stack's own refusals are explained here; the vehicle explains its own. Requests for messages have no text: programs
//! send them, and ask for many messages that a vehicle does not have (C-16). COMMAND_LONG_ONLY, COMMAND_INT_ONLY and UNSUPPORTED are
//! clear without a text.

use super::super::{Cx, Request};
use super::CommandLink;
use crate::dialect::{MavCmd, MavResult, MavSeverity};
use crate::link::Port;
use crate::message::{SystemId, Text};
use crate::time::Instant;
use crate::types::{Firmware, LinkClass, LinkMask, ModeFault, ONE_FRAME, Refusal, StatusTexts, Why};

/// Returns the number of the current period of 2^20 µs (1.05 s): a link gets at most one text per period, whatever it receives.
/// Only the low 16 bits are stored, in what would be padding; they repeat after 19 hours.
fn period(now: Instant) -> u16 {
    let [_, _, low, high, ..] = now.as_micros().wrapping_shr(4).to_le_bytes();
    // 0 means that no text was sent on the link yet.
    u16::from_le_bytes([low, high]).wrapping_add(1)
}

/// Explains a refusal by a text on the link on which `command` was received.
pub(super) fn explain<F: Firmware>(
    cx: &mut Cx<'_, F>,
    port: &Port,
    link: &mut CommandLink,
    request: &Request,
    refusal: Refusal,
) {
    // SET_MODE is no command: only the answer has the number 11 (C-16, C-32).
    let is_set_mode = F::HAS_MODES && request.set_mode.is_some();
    let (what, number) = match is_set_mode {
        true => ("SET_MODE ", None),
        false => ("Command ", Some(request.command.id.0.into())),
    };
    let reason = match refusal.why {
        // Compiled only for a vehicle with modes.
        Why::Mode(number, fault) if F::HAS_MODES => return explain_mode(cx.now, port, link, cx.texts, number, fault),
        _ => reason(cx.shared.config.address.get().system, request.command.id, refusal),
    };
    if let Some(reason) = reason {
        push(cx.now, port, link, cx.texts, what, number, reason);
    }
}

/// Returns the reason for a refusal. `own` is our system id.
fn reason(own: SystemId, command: MavCmd, Refusal { result, why }: Refusal) -> Option<Reason> {
    Some(match (result, why) {
        _ if command == MavCmd::REQUEST_MESSAGE => return None,
        (MavResult::DENIED, Why::Broadcast) => Reason { suffix: own.wire(), ..Reason::new("sent to 0; use system ") },
        (MavResult::DENIED, Why::Param(param)) => Reason { index: param, ..Reason::new(" out of range") },
        (MavResult::DENIED, Why::NoStorage) => Reason::new("there is no storage"),
        (MavResult::NOT_IN_CONTROL, _) | (_, Why::Taken) => Reason::new("another station has control"),
        (MavResult::DENIED, _) => Reason::new("a parameter is out of range"),
        (MavResult::TEMPORARILY_REJECTED, _) => Reason::new("not now; try again later"),
        (MavResult::FAILED, _) => Reason::new("there is no such item"),
        (MavResult::COMMAND_UNSUPPORTED_MAV_FRAME, _) => Reason::new("frame not supported"),
        _ => return None,
    })
}

/// Explains why a mode is refused. A negative `number` is not named.
fn explain_mode(
    now: Instant,
    port: &Port,
    link: &mut CommandLink,
    texts: &mut StatusTexts,
    number: i32,
    fault: ModeFault,
) {
    let reason = match fault {
        ModeFault::NotCustom => "set CUSTOM_MODE_ENABLED",
        ModeFault::NotSelectable => "not selectable",
        ModeFault::Unknown => "not in AVAILABLE_MODES",
    };
    push(now, port, link, texts, "Mode ", Some(number).filter(|&number| number >= 0), Reason::new(reason));
}

/// The part of a text after the colon.
#[derive(Clone, Copy)]
struct Reason {
    /// The parameter to name first; 0 for none.
    index: u8,
    reason: &'static str,
    /// The number to append; 0 for none.
    suffix: u8,
}

impl Reason {
    const fn new(reason: &'static str) -> Self {
        Self { index: 0, reason, suffix: 0 }
    }
}

/// Queues the text.
fn push(
    now: Instant,
    port: &Port,
    link: &mut CommandLink,
    texts: &mut StatusTexts,
    what: &str,
    number: Option<i32>,
    Reason { index, reason, suffix }: Reason,
) {
    let period = period(now);
    // High-latency links carry no texts (L-4).
    if !cfg!(feature = "plan-texts") || port.config.class == LinkClass::HighLatency || period == link.refusal {
        return;
    }
    link.refusal = period;
    let mut text = Text::<ONE_FRAME>::EMPTY;
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
    text.push_str(reason);
    if suffix != 0 {
        text.push_signed(suffix.into());
    }
    texts.push(now, LinkMask::of(port.id), MavSeverity::WARNING, text.as_bytes());
}

#[cfg(all(test, feature = "plan-texts"))]
mod tests {
    use super::*;
    use crate::frame::Version;
    use crate::link::{Link, Outbox};
    use crate::message::Address;
    use crate::service::command::Acks;
    use crate::service::statustext::TextCursor;
    use crate::types::{LinkId, TextEntry};

    /// Returns the number of frames of the refusal's text; one frame holds 50 bytes.
    fn frames(id: Option<u16>, refusal: Refusal) -> usize {
        let port = Link::VACANT.port;
        let mut link = CommandLink { acks: Acks::new(), refusal: 0 };
        let mut entries = StatusTexts::<[TextEntry; 2]>::new();
        let (texts, now): (&mut StatusTexts, _) = (&mut entries, Instant::from_millis(5_000));
        let (what, id) = match id {
            Some(id) => ("Command ", id),
            None => ("SET_MODE ", MavCmd::DO_SET_MODE.0),
        };
        if let Some(reason) = reason(SystemId::new(254), MavCmd(id), refusal) {
            push(now, &port, &mut link, texts, what, (what == "Command ").then_some(id.into()), reason);
        }
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

    /// C-4, T-5: each reason fits into one STATUSTEXT, whatever the numbers of the command and of the vehicle. MAVLink 1 and ground
    /// stations without support for chunks show no more.
    #[test]
    fn each_reason_fits_into_one_frame() {
        let mut explained = 0;
        for result in (0..=15).map(MavResult) {
            for why in [Why::Result, Why::Broadcast, Why::Param(7), Why::NoStorage, Why::Taken] {
                for id in [Some(42_424), None] {
                    let count = frames(id, Refusal { result, why });
                    assert!(count <= 1, "{result:?} {why:?}");
                    explained += count;
                }
            }
        }
        assert!(explained >= 7, "{explained}");
    }
}
