//! The queue of texts for the operators. Any service may add one; `service::statustext` sends them.

use super::link::LinkMask;
use crate::dialect::MavSeverity;
use crate::message::{Text, front};
use crate::time::{Duration, Instant};
use core::num::Wrapping;

/// The maximum length of a text in bytes. A longer text is cut off between code points.
pub const MAX_TEXT_LEN: usize = 120;

/// The length of a text that one STATUSTEXT holds, in bytes: older ground stations show no more (T-5). The stack's own texts about
/// refusals are no longer.
pub(crate) const ONE_FRAME: usize = 50;

/// The same text is dropped if it is repeated within this time, on links that it was for before.
const REPEAT_AFTER: Duration = Duration::from_secs(5);

/// The same for a text about a received frame: the same refusal again is the answer to another press of a button (C-16).
const ANSWER_AFTER: Duration = Duration::from_secs(2);

/// After this time, a text that a link has not sent may be evicted by any other text. Otherwise a dead link would block
/// the texts of all links.
const GIVE_UP_AFTER: Duration = Duration::from_secs(10);

/// The number of a text, in order of arrival. It wraps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TextNumber(pub(crate) u16);

impl TextNumber {
    /// Before all texts: no text has it, because the id of a chunk is not 0.
    pub(crate) const NONE: Self = Self(0);

    /// Returns the number of the next text.
    fn next(self) -> Self {
        Self(self.0.checked_add(1).unwrap_or(1))
    }

    /// Returns the number of texts after this one, up to and including `newest`.
    const fn age(self, newest: Self) -> u16 {
        newest.0.wrapping_sub(self.0)
    }
}

/// A text that is pending, or was sent recently.
#[derive(Clone, Debug)]
pub struct TextEntry {
    pub(crate) text: Text<MAX_TEXT_LEN>,
    pub(crate) severity: MavSeverity,
    /// It is also the id that the chunks share.
    pub(crate) number: TextNumber,
    pub(crate) at: Instant,
    /// Links that have not sent all of it.
    pub(crate) pending: LinkMask,
    /// The links that it is for.
    pub(crate) links: LinkMask,
}

impl TextEntry {
    /// An entry with nothing to send: all zero bits.
    const SENT: Self = Self {
        text: Text::EMPTY,
        severity: MavSeverity(0),
        number: TextNumber::NONE,
        at: Instant::ZERO,
        pending: LinkMask::NONE,
        links: LinkMask::NONE,
    };

    /// Returns a number that is the highest for the entry that a new text evicts: a sent one, otherwise one that is given up, of
    /// those the least severe, and of those the oldest. A larger severity is less severe. For an answer to a frame, a critical text is
    /// given up later, but not never: a link that takes no bytes would keep its place.
    fn eviction_rank(&self, now: Instant, newest: TextNumber, is_answering: bool) -> u32 {
        let patience = if is_answering && self.severity.is_critical() { 6 } else { 1 };
        let is_given_up = now - self.at >= GIVE_UP_AFTER * patience;
        let (state, severity) = if self.pending.is_empty() {
            (SENT, 0)
        } else if is_given_up {
            (GIVEN_UP, self.severity.0)
        } else {
            (PENDING, self.severity.0)
        };
        let [high, low] = self.number.age(newest).to_be_bytes();
        u32::from_be_bytes([state, severity, high, low])
    }
}

/// Which texts a turn sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextKind {
    /// Those of severity CRITICAL and higher.
    Urgent,
    /// All.
    Any,
}

impl TextKind {
    fn has(self, severity: MavSeverity) -> bool {
        self == Self::Any || severity.is_critical()
    }
}

impl MavSeverity {
    /// Whether it is CRITICAL or higher.
    const fn is_critical(self) -> bool {
        self.0 <= Self::CRITICAL.0
    }
}

/// The state of an entry, in the order of eviction: the last is evicted first.
const PENDING: u8 = 0;
const GIVEN_UP: u8 = 1;
const SENT: u8 = 2;

/// The queue of texts, for all links. The logic works on the unsized form, so the queue's length is compiled once.
#[derive(Clone, Debug)]
pub struct StatusTexts<E: ?Sized = [TextEntry]> {
    pub(crate) newest: TextNumber,
    /// Whether a received frame is being handled.
    pub(crate) is_answering: bool,
    /// Whether a text was queued since the stack has looked.
    pub(crate) is_new: bool,
    dropped: Wrapping<u32>,
    pub(crate) entries: E,
}

impl<const N: usize> StatusTexts<[TextEntry; N]> {
    pub(crate) const fn new() -> Self {
        Self {
            newest: TextNumber::NONE,
            is_answering: false,
            is_new: false,
            dropped: Wrapping(0),
            entries: [const { TextEntry::SENT }; N],
        }
    }
}

impl StatusTexts {
    /// Returns the number of texts that were dropped: repeated too soon, or evicted unsent from a full
    /// queue. Wraps.
    pub(crate) const fn dropped(&self) -> u32 {
        self.dropped.0
    }

    /// Queues `text`, as much of it as a [`Text`] has room for, for those of `links` that did not get it recently. It takes bytes,
    /// because vehicles send texts deep down, where a text would take 120 bytes of stack.
    pub(crate) fn push(&mut self, now: Instant, links: LinkMask, severity: MavSeverity, text: &[u8]) {
        let text = front(text, MAX_TEXT_LEN);
        let repeat_after = if self.is_answering { ANSWER_AFTER } else { REPEAT_AFTER };
        let mut left = links;
        for entry in &self.entries {
            if entry.text.as_bytes() == text && entry.severity == severity && now - entry.at < repeat_after {
                left = left.without(entry.links);
            }
        }
        if text.is_empty() || (left.is_empty() && !links.is_empty()) {
            self.dropped += 1;
            return;
        }
        #[cfg(feature = "defmt")]
        event!("statustext {=u8}: {}", severity.0, Text::<MAX_TEXT_LEN>::from_bytes(text));
        self.is_new = true;
        let (newest, is_answering) = (self.newest, self.is_answering);
        let (mut evicted, mut highest) = (None, 0);
        for entry in &mut self.entries {
            let rank = entry.eviction_rank(now, newest, is_answering);
            if rank >= highest {
                highest = rank;
                evicted = Some(entry);
            }
        }
        let Some(entry) = evicted else { return };
        let [state, evicted_severity, ..] = highest.to_be_bytes();
        if state != SENT {
            self.dropped += 1;
            let is_kept = is_answering && MavSeverity(evicted_severity).is_critical();
            if state == PENDING && (is_kept || evicted_severity < severity.0) {
                // All pending texts are more severe than the new one, or critical ones that no answer evicts.
                return;
            }
        }
        self.newest = newest.next();
        entry.text.set(text);
        entry.severity = severity;
        entry.number = self.newest;
        entry.at = now;
        entry.pending = left;
        entry.links = left;
    }

    /// Returns the oldest text after the one with this number, sent or not.
    pub(crate) fn after(&self, number: TextNumber) -> Option<&TextEntry> {
        let is_later = |entry: &&TextEntry| {
            let distance = number.age(entry.number).cast_signed();
            entry.number != TextNumber::NONE && (number == TextNumber::NONE || distance > 0)
        };
        self.entries.iter().filter(is_later).max_by_key(|entry| entry.number.age(self.newest))
    }

    /// Returns the text that is next on the link of this mask: the one that it has begun, or the oldest one of this kind.
    pub(crate) fn next_pending(
        &mut self,
        link: LinkMask,
        begun: Option<TextNumber>,
        kind: TextKind,
    ) -> Option<&mut TextEntry> {
        let newest = self.newest;
        let (mut oldest, mut highest) = (None, 0);
        for entry in self.entries.iter_mut().filter(|entry| entry.pending.intersects(link)) {
            let age = match begun == Some(entry.number) {
                true => u16::MAX,
                false if kind.has(entry.severity) => entry.number.age(newest),
                false => continue,
            };
            if age >= highest {
                highest = age;
                oldest = Some(entry);
            }
        }
        oldest
    }

    /// Whether a text of this kind is pending on the link of this mask.
    pub(crate) fn is_pending(&self, link: LinkMask, kind: TextKind) -> bool {
        self.entries.iter().any(|entry| entry.pending.intersects(link) && kind.has(entry.severity))
    }
}
