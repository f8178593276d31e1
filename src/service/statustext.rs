//! STATUSTEXT: short texts for the operator.
//!
//! Implements T-5 and the chunking of STATUSTEXT. A text longer than 50 bytes is sent in chunks that share an id. The
//! first chunk that contains a NUL is the last. No chunk ends within a code point, because ground stations convert each
//! chunk to a string separately; blanks take the place of a code point's first bytes at the end of a chunk.
//!
//! Texts wait in a queue of fixed size. Each link sends them at its own pace, in order of arrival, but those of severity
//! CRITICAL and higher first. A text that a link has begun is sent to its end. A full queue evicts the least severe
//! text, the oldest of those first, and counts it.

use super::{About, Cx, Service, Turn, View};
use crate::dialect::Statustext;
use crate::frame::Version;
use crate::link::{Outbox, Port};
use crate::message::{Text, front, zero_extend};
use crate::time::Instant;
use crate::types::{Firmware, LinkMask, ONE_FRAME, StatusTexts, TextKind, TextNumber};
use core::num::Saturating;

/// A link's position in the text that it sends.
#[derive(Clone, Copy, Debug)]
pub struct TextCursor {
    number: TextNumber,
    chunk: Saturating<u8>,
    /// The number of bytes that were sent.
    sent: Saturating<u8>,
}

/// Sends the queued texts.
#[derive(Debug)]
pub struct Texts;

impl<F: Firmware> Service<F> for Texts {
    const NEW: Self = Self;
    type Link = TextCursor;
    const VACANT: TextCursor = TextCursor::at(TextNumber::NONE);
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::UrgentText, Turn::Text]);
    type Reply = TextKind;

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, _: &TextCursor, turn: Turn) -> Option<(Instant, TextKind)> {
        let kind = if turn == Turn::UrgentText { TextKind::Urgent } else { TextKind::Any };
        (F::HAS_TEXTS && view.texts.is_pending(LinkMask::of(port.id), kind)).then_some((view.now, kind))
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut TextCursor, kind: TextKind) -> bool {
        cx.texts.next(link, &mut port.outbox, kind)
    }
}

impl TextCursor {
    /// Returns the beginning of a text.
    pub(crate) const fn at(number: TextNumber) -> Self {
        Self { number, chunk: Saturating(0), sent: Saturating(0) }
    }
}

impl StatusTexts {
    /// Sends the next chunk on a link. Returns false if no text is pending.
    pub(crate) fn next(&mut self, cursor: &mut TextCursor, tx: &mut Outbox, kind: TextKind) -> bool {
        let link = LinkMask::of(tx.link());
        let begun = (cursor.chunk.0 > 0).then_some(cursor.number);
        let Some(entry) = self.next_pending(link, begun, kind) else { return false };
        if cursor.number != entry.number {
            *cursor = TextCursor::at(entry.number);
        }
        let bytes = entry.text.as_bytes();
        // MAVLink 1 has no chunks: send the part that fits, cut between code points.
        let is_whole = tx.version() == Version::V1 || bytes.len() <= ONE_FRAME;
        let sent = if is_whole { 0 } else { cursor.sent.0 };
        let rest = bytes.get(usize::from(sent)..).unwrap_or_default();
        let front = front(rest, ONE_FRAME);
        // A chunk without a NUL announces another one, so the last chunk may be empty.
        let is_last = is_whole || rest.len() < ONE_FRAME;
        let mut chunk = [0; ONE_FRAME];
        // At most 3 bytes of a code point are cut off.
        if !is_last && let Some(end) = chunk.last_chunk_mut::<3>() {
            *end = [b' '; 3];
        }
        let len = zero_extend(front, &mut chunk);
        let (id, chunk_seq) = if is_whole { (0, 0) } else { (entry.number.0, cursor.chunk.0) };
        let message = Statustext { severity: entry.severity, text: Text::from_wire(chunk), id, chunk_seq };
        cursor.chunk += 1;
        cursor.sent += u8::try_from(len).unwrap_or(0);
        if is_last {
            entry.pending = entry.pending.without(link);
            *cursor = TextCursor::at(entry.number);
        }
        tx.send(&message)
    }
}
