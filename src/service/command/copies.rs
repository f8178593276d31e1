//! Tells duplicates of a command that was carried out from new commands (C-12).

use core::num::NonZeroU64;

use crate::link::{LinkId, MAX_LINKS};
use crate::time::Duration;

/// So much later than its original, and no more, a copy is looked for on other links (C-12, C-24).
pub(crate) const SOON: Duration = Duration::from_secs(3);

/// So much later than its original, and no more, a copy is looked for that came by a high-latency link: 10 to 30 s are usual
/// there (L-16).
pub(crate) const LATE: Duration = Duration::from_secs(60);

/// Maximum time from one duplicate to the next on the same link (ms): MAVSDK retransmits an unanswered command after 0.5, 1.0 and
/// 1.5 s, always with confirmation 0 (C-12).
pub(super) const REPEATED_WITHIN: u16 = 1_000;

/// How often a command that is received more than once may be carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Once {
    /// Every time.
    No,
    /// Once.
    Yes,
    /// Once, and again for each repetition on one link with the same `confirmation`.
    PerPress,
}

/// When a command was signed (10 µs), by its sender's clock: to be compared with others of his only. `None` when that is not
/// verified.
pub(crate) type SignedAt = Option<NonZeroU64>;

/// Whether `sent` was signed so much later than `known` that it is no copy of it.
pub(crate) const fn is_well_after(sent: NonZeroU64, known: NonZeroU64) -> bool {
    sent.get().saturating_sub(known.get()) >= SOON.as_micros() / 10
}

/// How often a command was carried out, and how often it came by each link. What is given twice comes twice on each link, so
/// a link that is behind brings copies.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Copies {
    runs: u8,
    /// [`COUNT_BITS`] for each link.
    came: u64,
}

/// A count for each of 16 links; who gives it more often in a row is not told apart.
const COUNT_BITS: u32 = 4;
const MOST: u8 = 15;
const _: () = assert!(MAX_LINKS == 16 && u64::BITS == 16 * COUNT_BITS);

fn shift(link: LinkId) -> u32 {
    u32::from(link.0 & MOST).wrapping_mul(COUNT_BITS)
}

impl Copies {
    /// It was never carried out. All zero bits.
    pub(crate) const NONE: Self = Self { runs: 0, came: 0 };

    fn came(&self, link: LinkId) -> u8 {
        let [came, ..] = self.came.wrapping_shr(shift(link)).to_le_bytes();
        came & MOST
    }

    /// Whether the next one that comes by `link` is a copy.
    pub(crate) fn lacks(&self, link: LinkId) -> bool {
        self.came(link) < self.runs
    }

    /// A copy came by `link`, if it lacks one.
    pub(crate) fn count(&mut self, link: LinkId) {
        if self.lacks(link) {
            self.came = self.came.wrapping_add(1u64.wrapping_shl(shift(link)));
        }
    }

    /// It came by `link` and is carried out.
    pub(crate) fn run(&mut self, link: LinkId) {
        self.runs = self.runs.saturating_add(1).min(MOST);
        self.end(link);
    }

    /// What comes by `link` from now on is no copy of what was before.
    pub(crate) fn end(&mut self, link: LinkId) {
        let others = self.came & !u64::from(MOST).wrapping_shl(shift(link));
        self.came = others | u64::from(self.runs).wrapping_shl(shift(link));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RADIO: LinkId = LinkId(0);
    const SATELLITE: LinkId = LinkId(15);

    #[test]
    fn each_link_brings_as_many_copies_as_there_were_runs() {
        let mut copies = Copies::NONE;
        assert!(!copies.lacks(RADIO) && !copies.lacks(SATELLITE));
        for _ in 0..3 {
            copies.run(RADIO);
            assert!(!copies.lacks(RADIO));
        }
        for _ in 0..3 {
            assert!(copies.lacks(SATELLITE) && !copies.lacks(RADIO));
            copies.count(SATELLITE);
        }
        assert!(!copies.lacks(SATELLITE));
        copies.run(SATELLITE);
        assert!(copies.lacks(RADIO) && !copies.lacks(SATELLITE));
        copies.end(RADIO);
        assert!(!copies.lacks(RADIO) && copies.lacks(LinkId(7)));
    }

    #[test]
    fn counts_stay_within_their_bits() {
        let mut copies = Copies::NONE;
        for _ in 0..40 {
            copies.run(RADIO);
        }
        copies.end(LinkId(1));
        copies.count(RADIO);
        assert!(!copies.lacks(RADIO) && !copies.lacks(LinkId(1)));
        for _ in 0..15 {
            assert!(copies.lacks(SATELLITE) && copies.lacks(LinkId(2)));
            copies.count(SATELLITE);
        }
        assert!(!copies.lacks(SATELLITE) && copies.lacks(LinkId(14)));
    }
}
