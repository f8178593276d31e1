//! STATUSTEXT: short texts for the operator.
//!
//! Implements T-5 of the field's practice and the message's own chunking: a text longer than 50 bytes goes out in chunks
//! that share an id, and ends with the first chunk that has a NUL. No chunk ends within a code point, as ground stations turn
//! each into a string by itself: where one would, blanks take the place of its first bytes. Texts wait in a fixed queue; each link sends them at its
//! own pace, in the order they came. When the queue is full the least severe of the oldest goes, and is counted.

use crate::dialect::{MavSeverity, Statustext};
use crate::frame::Version;
use crate::link::{LinkMask, Outbox};
use crate::message::Text;
use crate::time::{Duration, Instant};

/// Longest text in bytes; what is beyond is cut off between code points.
pub const MAX_TEXT_LEN: usize = 120;

/// The same text again within this time is dropped, on links that it was for before.
const REPEAT_AFTER: Duration = Duration::from_secs(5);

/// A text that a link has not taken for so long gives way to any other, or a dead link would hold back all others' texts.
const GIVE_UP_AFTER: Duration = Duration::from_secs(10);

/// Bytes of text in one message.
const CHUNK: usize = 50;

/// A text that waits, or was sent a moment ago.
#[derive(Clone, Debug)]
pub(crate) struct Entry {
    text: Text<MAX_TEXT_LEN>,
    severity: MavSeverity,
    /// Order of arrival; also the id that the chunks share.
    number: u16,
    at: Instant,
    /// Links that have not sent it to its end.
    pending: LinkMask,
    /// Links that it is for.
    links: LinkMask,
}

impl Entry {
    /// Nothing to send; all zero bits.
    const SENT: Self = Self {
        text: Text::EMPTY,
        severity: MavSeverity(0),
        number: 0,
        at: Instant::ZERO,
        pending: LinkMask::NONE,
        links: LinkMask::NONE,
    };
}

/// How far a link is in the text it is sending.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TextCursor {
    number: u16,
    chunk: u8,
    /// Bytes of the text that were sent.
    sent: u8,
}

impl TextCursor {
    pub(crate) const fn new() -> Self {
        Self { number: 0, chunk: 0, sent: 0 }
    }
}

/// What a place in the queue is taken by: the higher, the sooner it goes to a new text.
const WAITS: u8 = 0;
const GIVEN_UP: u8 = 1;
const SENT: u8 = 2;

/// The queue of texts, for all links. The logic works on the unsized form, so the queue's length is compiled once.
#[derive(Clone, Debug)]
pub(crate) struct StatusTexts<E: ?Sized = [Entry]> {
    /// Number of the newest text; 0 is never one, because a chunk's id is not 0.
    newest: u16,
    dropped: u32,
    entries: E,
}

impl<const N: usize> StatusTexts<[Entry; N]> {
    pub(crate) const fn new() -> Self {
        Self { newest: 0, dropped: 0, entries: [const { Entry::SENT }; N] }
    }
}

impl StatusTexts {
    /// Texts that were dropped: repeated within five seconds, or pushed out of a full queue unsent. Wraps.
    pub(crate) const fn dropped(&self) -> u32 {
        self.dropped
    }

    /// Queues `text` for those of `links` that it was not for a moment ago.
    pub(crate) fn push(&mut self, now: Instant, links: LinkMask, severity: MavSeverity, text: &Text<MAX_TEXT_LEN>) {
        let repeated =
            |entry: &Entry| entry.text == *text && entry.severity == severity && now.since(entry.at) < REPEAT_AFTER;
        let told = self.entries.iter().filter(|entry| repeated(entry)).map(|entry| entry.links);
        let left = told.fold(links, LinkMask::without);
        if text.is_empty() || (left.is_empty() && !links.is_empty()) {
            self.dropped = self.dropped.wrapping_add(1);
            return;
        }
        let links = left;
        event!("statustext {=u8}: {}", severity.0, text);
        // Sent ones go first, the oldest of them; then those given up, then the least severe (a larger number is less severe).
        let newest = self.newest;
        let (mut place, mut highest) = (None, 0);
        for entry in &mut self.entries {
            let (state, least) = match entry.pending.is_empty() {
                true => (SENT, 0),
                false if now.since(entry.at) >= GIVE_UP_AFTER => (GIVEN_UP, entry.severity.0),
                false => (WAITS, entry.severity.0),
            };
            let [high, low] = newest.wrapping_sub(entry.number).to_be_bytes();
            let rank = u32::from_be_bytes([state, least, high, low]);
            if rank >= highest {
                (place, highest) = (Some(entry), rank);
            }
        }
        let Some(entry) = place else { return };
        let [state, least, ..] = highest.to_be_bytes();
        if state != SENT {
            self.dropped = self.dropped.wrapping_add(1);
            if state == WAITS && least < severity.0 {
                // All that wait are more severe than the new one.
                return;
            }
        }
        self.newest = if newest == u16::MAX { 1 } else { newest.wrapping_add(1) };
        entry.text = *text;
        entry.severity = severity;
        entry.number = self.newest;
        entry.at = now;
        entry.pending = links;
        entry.links = links;
    }

    /// Whether there is a text for the link of `mask`.
    pub(crate) fn is_pending(&self, link: LinkMask) -> bool {
        self.entries.iter().any(|entry| entry.pending.contains(link))
    }

    /// Sends the next chunk on a link. False when there is none.
    pub(crate) fn next(&mut self, cursor: &mut TextCursor, tx: &mut Outbox) -> bool {
        let link = LinkMask::of(tx.link());
        let newest = self.newest;
        // Numbers wrap, so the oldest is the one furthest behind the newest. One that was begun was the oldest, and still is.
        let (mut oldest, mut highest) = (None, 0);
        for entry in self.entries.iter_mut().filter(|entry| entry.pending.contains(link)) {
            let age = newest.wrapping_sub(entry.number);
            if age >= highest {
                (oldest, highest) = (Some(entry), age);
            }
        }
        let Some(entry) = oldest else { return false };
        if cursor.number != entry.number {
            *cursor = TextCursor { number: entry.number, ..TextCursor::new() };
        }
        let bytes = entry.text.as_bytes();
        let mut message = Statustext { severity: entry.severity, ..Default::default() };
        if tx.version() == Version::V1 || bytes.len() <= CHUNK {
            // v1 has no chunks: what fits, cut between code points.
            message.text = entry.text.front();
            entry.pending = entry.pending.without(link);
        } else {
            let rest = bytes.get(usize::from(cursor.sent)..).unwrap_or_default();
            let front = rest.get(..crate::message::cut(rest, CHUNK)).unwrap_or_default();
            // A chunk without a NUL promises another one, even an empty one.
            let is_last = rest.len() < CHUNK;
            let mut chunk = [0; CHUNK];
            // No more than what is left of a code point is cut off.
            if !is_last && let Some(end) = chunk.last_chunk_mut::<3>() {
                *end = [b' '; 3];
            }
            let len = crate::message::zero_extend(front, &mut chunk);
            message.text = Text::from_wire(chunk);
            message.id = entry.number;
            message.chunk_seq = cursor.chunk;
            cursor.chunk = cursor.chunk.saturating_add(1);
            cursor.sent = cursor.sent.saturating_add(u8::try_from(len).unwrap_or(0));
            if is_last {
                entry.pending = entry.pending.without(link);
                *cursor = TextCursor { number: entry.number, ..TextCursor::new() };
            }
        }
        tx.send(&message)
    }
}
