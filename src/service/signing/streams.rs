//! Streams of signed frames: the last timestamp of each sender, so that no frame is accepted twice (G-5, G-6, G-8,
//! SEC-7).

use super::timestamp::Timestamp;
use crate::message::Address;

/// A stream: the signed frames that one component sends on one of its links (G-5).
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SigningStream {
    /// The sender; system 0 if the slot is free.
    source: Address,
    link_id: u8,
    /// The timestamp of the last frame.
    timestamp: Timestamp,
}

/// Why a frame with a correct signature is not accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stale {
    /// The stream already has a later timestamp.
    Replayed,
    /// The stream is unknown, and the frame is more than a minute old.
    Old,
    /// The stream is unknown, and no slot can be freed.
    NoSlot,
}

/// The timestamps that decide about an unknown stream.
pub(super) struct NewStream {
    /// The stream may begin at this timestamp or later.
    pub(super) earliest: Timestamp,
    /// No stream begins before this timestamp, which only rises. So a stream that ended before it can be evicted.
    pub(super) evict_before: Timestamp,
}

impl SigningStream {
    /// No stream.
    pub(super) const NONE: Self = Self { source: Address::new(0, 0), link_id: 0, timestamp: Timestamp::ZERO };
}

/// Records a frame with a correct signature.
///
/// A full table evicts the stream that was silent longest, if that was more than a minute: its recorded frames are too
/// old by now to begin a stream again.
pub(super) fn record(
    streams: &mut [SigningStream],
    source: Address,
    link_id: u8,
    timestamp: Timestamp,
    new: &NewStream,
) -> Result<(), Stale> {
    if let Some(stream) = streams.iter_mut().find(|stream| stream.source == source && stream.link_id == link_id) {
        if timestamp <= stream.timestamp {
            return Err(Stale::Replayed);
        }
        stream.timestamp = timestamp;
        return Ok(());
    }
    if timestamp < new.earliest {
        return Err(Stale::Old);
    }
    let slot = streams
        .iter_mut()
        .filter(|stream| stream.source.system.wire() == 0 || stream.timestamp < new.evict_before)
        .min_by_key(|stream| stream.timestamp)
        .ok_or(Stale::NoSlot)?;
    *slot = SigningStream { source, link_id, timestamp };
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::timestamp::MINUTE;
    use super::{Address, NewStream, SigningStream, Stale, Timestamp, record};
    use proptest::prelude::*;

    const LOCAL: u64 = 100 * MINUTE;

    /// Records a frame at this local time.
    fn enter(
        streams: &mut [SigningStream],
        source: Address,
        link_id: u8,
        timestamp: u64,
        local: u64,
    ) -> Result<(), Stale> {
        let oldest = Timestamp(local - MINUTE);
        let new = NewStream { earliest: oldest, evict_before: oldest };
        record(streams, source, link_id, Timestamp(timestamp), &new)
    }

    fn source(n: u8) -> Address {
        Address::new(n, 1)
    }

    #[test]
    fn timestamps_of_a_stream_rise() {
        let mut streams = [SigningStream::NONE; 2];
        assert_eq!(enter(&mut streams, source(1), 0, LOCAL, LOCAL), Ok(()));
        for stale in [LOCAL, LOCAL - 1, 0] {
            assert_eq!(enter(&mut streams, source(1), 0, stale, LOCAL), Err(Stale::Replayed));
        }
        assert_eq!(enter(&mut streams, source(1), 0, LOCAL + 1, LOCAL), Ok(()));
        // Another link id, or component, is another stream.
        assert_eq!(enter(&mut streams, source(1), 1, LOCAL, LOCAL), Ok(()));
        assert_eq!(enter(&mut streams, Address::new(1, 2), 0, LOCAL, LOCAL), Err(Stale::NoSlot));
    }

    #[test]
    fn a_new_stream_is_a_minute_old_at_most() {
        let mut streams = [SigningStream::NONE; 2];
        assert_eq!(enter(&mut streams, source(1), 0, LOCAL - MINUTE - 1, LOCAL), Err(Stale::Old));
        assert_eq!(enter(&mut streams, source(1), 0, LOCAL - MINUTE, LOCAL), Ok(()));
    }

    #[test]
    fn the_stream_that_was_silent_longest_is_evicted() {
        let mut streams = [SigningStream::NONE; 2];
        for n in [1, 2] {
            enter(&mut streams, source(n), 0, LOCAL + u64::from(n), LOCAL).unwrap();
        }
        let later = LOCAL + MINUTE + 1;
        assert_eq!(enter(&mut streams, source(3), 0, later, later), Err(Stale::NoSlot), "a minute, and no more");
        assert_eq!(enter(&mut streams, source(3), 0, later, later + 1), Ok(()), "the first is older");
        assert_eq!(enter(&mut streams, source(2), 0, LOCAL + 3, later + 1), Ok(()), "the second is still there");
        assert_eq!(enter(&mut streams, source(1), 0, LOCAL + 1, later + 1), Err(Stale::Old), "not accepted twice");
    }

    #[test]
    fn the_oldest_stream_is_evicted() {
        for order in [[1, 2, 3], [3, 1, 2], [2, 3, 1]] {
            let mut streams = [SigningStream::NONE; 3];
            for n in order {
                enter(&mut streams, source(n), 0, LOCAL + u64::from(n), LOCAL).unwrap();
            }
            let later = LOCAL + 2 * MINUTE;
            assert_eq!(enter(&mut streams, source(4), 0, later, later), Ok(()));
            for n in [2, 3] {
                assert_eq!(enter(&mut streams, source(n), 0, LOCAL + 4, later), Ok(()), "{n} is still there");
            }
            assert_eq!(enter(&mut streams, source(1), 0, LOCAL + 4, later), Err(Stale::Old));
        }
    }

    #[test]
    fn an_empty_table_accepts_nothing() {
        assert_eq!(enter(&mut [], source(1), 0, LOCAL, LOCAL), Err(Stale::NoSlot));
    }

    proptest! {
        /// G-8: for any frames in any order, and a table of any size, no frame is accepted twice, and local time never
        /// goes back.
        #[test]
        fn nothing_is_accepted_twice(
            frames in proptest::collection::vec((1u8..9, 0u8..2, 0u64..40), 1..400),
            steps in proptest::collection::vec(0u64..3, 400),
            size in 1usize..5,
        ) {
            let mut streams = std::vec![SigningStream::NONE; size];
            let mut local = LOCAL;
            let mut accepted = std::collections::BTreeSet::new();
            for ((system, link_id, at), step) in frames.into_iter().zip(steps) {
                local += step * MINUTE / 3;
                // Within a few minutes of now.
                let timestamp = LOCAL - 4 * MINUTE + at * MINUTE / 5;
                if enter(&mut streams, source(system), link_id, timestamp, local).is_ok() {
                    prop_assert!(accepted.insert((system, link_id, timestamp)), "a second time");
                    local = local.max(timestamp);
                }
            }
        }
    }
}
