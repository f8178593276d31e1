//! The queue of texts for the operators. Any service may add one; `service::statustext` sends them.

use super::link::LinkMask;
use crate::dialect::MavSeverity;
use crate::message::{Text, front};
use crate::time::{Duration, Instant};

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

/// A text that is pending, or was sent recently.
#[derive(Clone, Debug)]
pub struct TextEntry {
    pub(crate) text: Text<MAX_TEXT_LEN>,
    pub(crate) severity: MavSeverity,
    /// Counts texts in order of arrival. It is also the id that the chunks share.
    pub(crate) number: u16,
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
        number: 0,
        at: Instant::ZERO,
        pending: LinkMask::NONE,
        links: LinkMask::NONE,
    };
}

/// The state of an entry: a new text evicts an entry with the highest state.
const PENDING: u8 = 0;
const GIVEN_UP: u8 = 1;
const SENT: u8 = 2;

/// The queue of texts, for all links. The logic works on the unsized form, so the queue's length is compiled once.
#[derive(Clone, Debug)]
pub struct StatusTexts<E: ?Sized = [TextEntry]> {
    /// The number of the newest text. 0 is not used, because the id of a chunk is not 0.
    pub(crate) newest: u16,
    /// Whether a received frame is being handled.
    pub(crate) is_answering: bool,
    dropped: u32,
    pub(crate) entries: E,
}

impl<const N: usize> StatusTexts<[TextEntry; N]> {
    pub(crate) const fn new() -> Self {
        Self { newest: 0, is_answering: false, dropped: 0, entries: [const { TextEntry::SENT }; N] }
    }
}

impl StatusTexts {
    /// Returns the number of texts that were dropped: repeated too soon, or evicted unsent from a full
    /// queue. Wraps.
    pub(crate) const fn dropped(&self) -> u32 {
        self.dropped
    }

    /// Queues `text`, as much of it as a [`Text`] has room for, for those of `links` that did not get it recently. It takes bytes,
    /// because vehicles send texts deep down, where a text would take 120 bytes of stack.
    pub(crate) fn push(&mut self, now: Instant, links: LinkMask, severity: MavSeverity, text: &[u8]) {
        let text = front(text, MAX_TEXT_LEN);
        let repeat_after = if self.is_answering { ANSWER_AFTER } else { REPEAT_AFTER };
        let repeated = |entry: &TextEntry| {
            entry.text.as_bytes() == text && entry.severity == severity && now - entry.at < repeat_after
        };
        let sent = self.entries.iter().filter(|entry| repeated(entry)).map(|entry| entry.links);
        let left = sent.fold(links, LinkMask::without);
        if text.is_empty() || (left.is_empty() && !links.is_empty()) {
            self.dropped = self.dropped.wrapping_add(1);
            return;
        }
        let links = left;
        #[cfg(feature = "defmt")]
        event!("statustext {=u8}: {}", severity.0, Text::<MAX_TEXT_LEN>::from_bytes(text));
        // Evicts sent texts first, the oldest of them; then given-up ones; then the least severe. A larger number is
        // less severe.
        let newest = self.newest;
        let (mut place, mut highest) = (None, 0);
        for entry in &mut self.entries {
            let (state, least) = match entry.pending.is_empty() {
                true => (SENT, 0),
                false if now - entry.at >= GIVE_UP_AFTER => (GIVEN_UP, entry.severity.0),
                false => (PENDING, entry.severity.0),
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
            if state == PENDING && least < severity.0 {
                // All pending texts are more severe than the new one.
                return;
            }
        }
        self.newest = if newest == u16::MAX { 1 } else { newest.wrapping_add(1) };
        entry.text.set(text);
        entry.severity = severity;
        entry.number = self.newest;
        entry.at = now;
        entry.pending = links;
        entry.links = links;
    }

    /// Returns the oldest text behind the one with this number, sent or not. 0 is before all.
    pub(crate) fn after(&self, number: u16) -> Option<&TextEntry> {
        let behind = |entry: &&TextEntry| {
            entry.number != 0 && (number == 0 || entry.number.wrapping_sub(number).cast_signed() > 0)
        };
        let newest = self.newest;
        self.entries.iter().filter(behind).max_by_key(|entry| newest.wrapping_sub(entry.number))
    }

    /// Whether a text is pending on the link of this mask.
    pub(crate) fn is_pending(&self, link: LinkMask) -> bool {
        self.entries.iter().any(|entry| entry.pending.contains(link))
    }
}
