//! Distinguishes duplicates of an executed command from new commands (C-12).

use core::num::NonZeroU64;

use crate::time::Duration;
use crate::types::{LinkId, MAX_LINKS};

/// Maximum delay of a duplicate, compared with its original (C-12, C-24).
pub(crate) const SOON: Duration = Duration::from_secs(3);

/// Maximum delay of a duplicate on a high-latency link, where 10 to 30 s are usual (L-16).
pub(crate) const LATE: Duration = Duration::from_secs(60);

/// Maximum time from one duplicate to the next on the same link (ms): MAVSDK retransmits an unanswered command after 0.5, 1.0 and
/// 1.5 s, always with confirmation 0 (C-12).
pub(super) const REPEATED_WITHIN: u16 = 1_000;

/// How often a command that is received more than once may be executed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ExecutionLimit {
    /// Every time it is received.
    None,
    Once,
    /// Once, and again for each repetition on one link with the same `confirmation`.
    OncePerPress,
}

/// Whether `sent` was signed so much later than `known` that it cannot be a duplicate of it.
pub(crate) const fn is_well_after(sent: NonZeroU64, known: NonZeroU64) -> bool {
    sent.get().saturating_sub(known.get()) >= SOON.as_micros() / 10
}

/// Counts how often a command was executed, and how often it was received on each link. A client that sends on several links
/// sends a repeated command on each of them. So a link whose count is below the number of runs still delivers duplicates.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Duplicates {
    /// How often it was executed.
    runs: u8,
    /// How often it was received, in [`COUNT_BITS`] for each link.
    received: u64,
}

/// Size of the count of each of the 16 links. Counts saturate.
const COUNT_BITS: u32 = 4;
/// The maximum of a count, and the mask of its bits.
const MAX_COUNT: u8 = 15;
const _: () = assert!(MAX_LINKS == 16 && u64::BITS == 16 * COUNT_BITS);

impl Duplicates {
    /// Never executed. All zero bits.
    pub(crate) const NONE: Self = Self { runs: 0, received: 0 };

    /// Whether the next one on `link` is a duplicate.
    pub(crate) fn lacks(&self, link: LinkId) -> bool {
        self.received(link) < self.runs
    }

    /// Records a duplicate on `link`, if one is expected there.
    pub(crate) fn note(&mut self, link: LinkId) {
        let received = self.received(link);
        self.set_received(link, self.runs.min(received.saturating_add(1)));
    }

    /// Records that the command was received on `link` and is executed.
    pub(crate) fn run(&mut self, link: LinkId) {
        self.runs = MAX_COUNT.min(self.runs.saturating_add(1));
        self.end(link);
    }

    /// Expects no more duplicates of earlier runs on `link`.
    pub(crate) fn end(&mut self, link: LinkId) {
        self.set_received(link, self.runs);
    }

    /// Returns how often the command was received on this link.
    fn received(&self, link: LinkId) -> u8 {
        let [received, ..] = self.received.wrapping_shr(shift(link)).to_le_bytes();
        received & MAX_COUNT
    }

    fn set_received(&mut self, link: LinkId, count: u8) {
        let others = self.received & !u64::from(MAX_COUNT).wrapping_shl(shift(link));
        self.received = others | u64::from(count).wrapping_shl(shift(link));
    }
}

/// Returns the place of a link's count. There are at most 16 links; the shift of one with a higher number wraps.
fn shift(link: LinkId) -> u32 {
    u32::from(link.0) << 2
}

#[cfg(test)]
mod tests {
    use super::*;

    const RADIO: LinkId = LinkId(0);
    const SATELLITE: LinkId = LinkId(15);

    #[test]
    fn each_link_delivers_a_duplicate_for_each_run() {
        let mut duplicates = Duplicates::NONE;
        assert!(!duplicates.lacks(RADIO) && !duplicates.lacks(SATELLITE));
        for _ in 0..3 {
            duplicates.run(RADIO);
            assert!(!duplicates.lacks(RADIO));
        }
        for _ in 0..3 {
            assert!(duplicates.lacks(SATELLITE) && !duplicates.lacks(RADIO));
            duplicates.note(SATELLITE);
        }
        assert!(!duplicates.lacks(SATELLITE));
        duplicates.run(SATELLITE);
        assert!(duplicates.lacks(RADIO) && !duplicates.lacks(SATELLITE));
        duplicates.end(RADIO);
        assert!(!duplicates.lacks(RADIO) && duplicates.lacks(LinkId(7)));
    }

    #[test]
    fn counts_stay_within_their_bits() {
        let mut duplicates = Duplicates::NONE;
        for _ in 0..40 {
            duplicates.run(RADIO);
        }
        duplicates.end(LinkId(1));
        duplicates.note(RADIO);
        assert!(!duplicates.lacks(RADIO) && !duplicates.lacks(LinkId(1)));
        for _ in 0..15 {
            assert!(duplicates.lacks(SATELLITE) && duplicates.lacks(LinkId(2)));
            duplicates.note(SATELLITE);
        }
        assert!(!duplicates.lacks(SATELLITE) && duplicates.lacks(LinkId(14)));
    }
}
