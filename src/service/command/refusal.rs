//! Texts that explain why a command is refused: a COMMAND_ACK has a result but no reason (C-4).
//!
//! Only the stack's own refusals are explained here; the vehicle explains its own. Requests for messages have no text: programs
//! send them, and ask for many messages that a vehicle does not have (C-16). COMMAND_LONG_ONLY, COMMAND_INT_ONLY and UNSUPPORTED are
//! clear without a text.

use core::num::Wrapping;

use super::acks::CommandLink;
use crate::dialect::{MavCmd, MavResult, MavSeverity};
use crate::link::Port;
use crate::message::{SystemId, Text};
use crate::service::{Cx, Request};
use crate::time::Instant;
use crate::types::{Firmware, LinkClass, LinkMask, ModeFault, ONE_FRAME, Refusal, RefusalReason};

/// Returns the number of the current period of 2^20 µs (1.05 s): a link gets at most one text per period, whatever it
/// receives. Only the low 16 bits are stored, in place of padding; they repeat after 19 hours.
fn period(now: Instant) -> u16 {
    let [_, _, low, high, ..] = (now.as_micros() >> 4).to_le_bytes();
    // 0 means that no text was sent on the link yet.
    (Wrapping(u16::from_le_bytes([low, high])) + Wrapping(1)).0
}

/// Explains a refusal by a text on the link on which `command` was received.
// Its text is not on the stack below the hooks.
#[inline(never)]
pub(super) fn explain<F: Firmware>(
    cx: &mut Cx<'_, F>,
    port: &Port,
    link: &mut CommandLink,
    request: &Request,
    refusal: Refusal,
) {
    let period = period(cx.now);
    // High-latency links carry no texts (L-4).
    if !cfg!(feature = "plan-texts") || port.config.class == LinkClass::HighLatency || period == link.explained_in {
        return;
    }
    let subject = match refusal.reason {
        // Compiled only for a vehicle with modes.
        RefusalReason::Mode(number, fault) if F::HAS_MODES => Subject::Mode(number, fault),
        // SET_MODE is no command: only the answer has the number 11 (C-16, C-32).
        _ if F::HAS_MODES && request.set_mode.is_some() => Subject::SetMode,
        _ => Subject::Command(request.command.id),
    };
    let mut text = Text::<ONE_FRAME>::EMPTY;
    if write(&mut text, cx.shared.config.address.get().system, subject, refusal) {
        link.explained_in = period;
        cx.texts.push(cx.now, LinkMask::of(port.id), MavSeverity::WARNING, text.as_bytes());
    }
}

/// The command that is refused.
#[derive(Clone, Copy)]
enum Subject {
    Command(MavCmd),
    SetMode,
    /// A mode with this number; a negative one is not named.
    Mode(i32, ModeFault),
}

/// Writes the text for a refusal; returns false if it has none. `own` is our system id.
fn write(text: &mut Text<ONE_FRAME>, own: SystemId, subject: Subject, Refusal { result, reason }: Refusal) -> bool {
    let (what, number) = match subject {
        Subject::Command(MavCmd::REQUEST_MESSAGE) => return false,
        Subject::Command(command) => ("Command ", Some(command.0.into())),
        Subject::SetMode => ("SET_MODE ", None),
        Subject::Mode(number, _) => ("Mode ", Some(number).filter(|number| *number >= 0)),
    };
    text.push_str(what);
    if let Some(number) = number {
        text.push_signed(number);
        text.push_str(" ");
    }
    text.push_str("refused: ");
    let mode_fault = if let Subject::Mode(_, fault) = subject { Some(fault) } else { None };
    let explanation = match (mode_fault, result, reason) {
        (Some(ModeFault::NotCustom), ..) => "set CUSTOM_MODE_ENABLED",
        (Some(ModeFault::NotSelectable), ..) => "not selectable",
        (Some(ModeFault::Unknown), ..) => "not in AVAILABLE_MODES",
        (_, MavResult::DENIED, RefusalReason::Broadcast) => {
            text.push_str("sent to 0; use system ");
            text.push_signed(own.wire().into());
            ""
        }
        (_, MavResult::DENIED, RefusalReason::Param(index)) => {
            text.push_str("parameter ");
            text.push_signed(index.into());
            " out of range"
        }
        (_, MavResult::DENIED, RefusalReason::NoStorage) => "there is no storage",
        (_, MavResult::NOT_IN_CONTROL, _) | (_, _, RefusalReason::Taken) => "another station has control",
        (_, MavResult::DENIED, _) => "a parameter is out of range",
        (_, MavResult::TEMPORARILY_REJECTED, _) => "not now; try again later",
        (_, MavResult::FAILED, _) => "there is no such item",
        (_, MavResult::COMMAND_UNSUPPORTED_MAV_FRAME, _) => "frame not supported",
        _ => return false,
    };
    text.push_str(explanation);
    true
}

#[cfg(all(test, feature = "plan-texts"))]
mod tests {
    use super::*;
    use crate::frame::Version;
    use crate::link::Outbox;
    use crate::message::Address;
    use crate::service::statustext::TextCursor;
    use crate::types::{LinkId, StatusTexts, TextEntry, TextKind, TextNumber};

    /// Returns the number of frames of the refusal's text; one frame holds 50 bytes.
    fn frames(id: Option<u16>, refusal: Refusal) -> usize {
        let mut entries = StatusTexts::<[TextEntry; 2]>::new();
        let (texts, now): (&mut StatusTexts, _) = (&mut entries, Instant::from_millis(5_000));
        let subject = id.map_or(Subject::SetMode, |id| Subject::Command(MavCmd(id)));
        let mut text = Text::EMPTY;
        if write(&mut text, SystemId::new(254), subject, refusal) {
            texts.push(now, LinkMask::of(LinkId(0)), MavSeverity::WARNING, text.as_bytes());
        }
        let (mut cursor, mut tx) = (TextCursor::at(TextNumber::NONE), Outbox::VACANT);
        tx.configure(LinkId(0), Address::new(254, 1), Version::V2);
        let next = || {
            let is_sent = texts.next(&mut cursor, &mut tx, TextKind::Any);
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
            for reason in [
                RefusalReason::Result,
                RefusalReason::Broadcast,
                RefusalReason::Param(7),
                RefusalReason::NoStorage,
                RefusalReason::Taken,
            ] {
                for id in [Some(42_424), None] {
                    let count = frames(id, Refusal { result, reason });
                    assert!(count <= 1, "{result:?} {reason:?}");
                    explained += count;
                }
            }
        }
        assert!(explained >= 7, "{explained}");
    }
}
