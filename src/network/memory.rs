//! Duplicate detection: remembers the frames that were forwarded within the last 0.8 s, so that a frame that returns is
//! not forwarded again.
//!
//! A remembered frame is never evicted: it keeps its place for 0.8 s. So a flood could take all places, and they are
//! shared instead. A link may take three places for each free one, and seven for addressed frames. A flood on one link
//! then leaves places for the other links.
//!
//! A frame without a place is not forwarded. It is not remembered either, so each of its duplicates is handled locally.
//!
//! A frame is recognised by a keyed hash of 64 bits and by its last two bytes. Without the key, nobody can make a frame
//! that is taken for a duplicate of another one.

use core::num::Saturating;

use super::hash::{Hash, Key};
use crate::time::{Duration, Instant};
use crate::types::{LinkId, MAX_LINKS};
use heapless::deque::{Deque, DequeView};

/// A forwarded frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    mark: Mark,
    from: Share,
    /// When it was forwarded, in [`steps`].
    at: u8,
}

/// What a frame is recognised by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Mark {
    /// Of all its bytes.
    hash: Hash,
    /// Its last two bytes: its checksum, or the end of its signature.
    end: [u8; 2],
}

impl Mark {
    /// Of a frame that was remembered again in another place.
    const REPLACED: Self = Self { hash: Hash::ZERO, end: [0; 2] };

    fn of(frame: &[u8], key: Key) -> Self {
        Self { hash: key.hash(frame), end: frame.last_chunk().copied().unwrap_or_default() }
    }
}

/// The share to which a place belongs: there is one for each link, and one for the refused frames of all links.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Share(u8);

impl Share {
    /// The share after those of all links.
    const REFUSED: Self = Self(16);
    const COUNT: usize = MAX_LINKS + 1;

    const fn of(link: LinkId, is_accepted: bool) -> Self {
        if is_accepted { Self(link.0) } else { Self::REFUSED }
    }
}

const _: () = assert!(Share::COUNT == 17, "one share for each link, and one for refused frames");

/// A frame that is not a duplicate, or only of a refused frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NewFrame {
    mark: Mark,
    from: Share,
    /// Whether it is remembered as a refused frame.
    pub(super) was_refused: bool,
}

impl NewFrame {
    pub(super) fn is_refused(&self) -> bool {
        self.from == Share::REFUSED
    }
}

/// The result of looking up a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Lookup {
    /// It may be forwarded.
    New(NewFrame),
    /// It was forwarded within the last 0.8 s. `is_same_share`: the original was received on the same link, or both
    /// were refused.
    Duplicate { is_same_share: bool },
}

/// How long a frame is remembered, in steps: 0.8 s. It is less than 1 s, because a sender without sequence numbers
/// sends the same heartbeat again after 1 s.
const REMEMBERED_STEPS: u8 = 98;

/// How long a frame is remembered.
#[allow(clippy::as_conversions, reason = "const: `From` cannot be called; u8 to u64")]
const REMEMBERED: Duration = Duration::from_micros((REMEMBERED_STEPS as u64) << STEP);

/// A step is 2^13 µs.
const STEP: u32 = 13;

/// How long links count as a routing loop after the last frame that returned.
const LOOP_TIMEOUT: Duration = Duration::from_secs(10);

/// The frames that were forwarded last. The logic works on the unsized type, so it is compiled once for all capacities.
#[derive(Clone, Debug)]
pub(super) struct Memory<S: ?Sized = DequeView<Seen>> {
    /// It is renewed while no frame is remembered.
    key: Key,
    /// The number of places that each share has taken.
    held: [Saturating<u16>; Share::COUNT],
    /// When the last frame was looked up.
    last_lookup: Instant,
    /// When the last frame returned through a loop.
    last_loop: Option<Instant>,
    /// The oldest frame is first.
    seen: S,
}

impl<const SEEN: usize> Memory<Deque<Seen, SEEN>> {
    /// An empty memory: all zero bits.
    pub(super) const EMPTY: Self = Self {
        key: Key::ZERO,
        held: [Saturating(0); Share::COUNT],
        last_lookup: Instant::ZERO,
        last_loop: None,
        seen: Deque::new(),
    };
}

impl Memory {
    /// Looks up a frame that was received on link `from`, and accepted there or not. A frame that is accepted is new if
    /// it was only refused before. `secret` becomes part of the key.
    pub(super) fn look_up(
        &mut self,
        now: Instant,
        secret: u64,
        frame: &[u8],
        from: LinkId,
        is_accepted: bool,
    ) -> Lookup {
        self.forget_old(now);
        if self.seen.is_empty() {
            self.key = self.key.renewed(secret, now.as_micros());
        }
        let (mark, from) = (Mark::of(frame, self.key), Share::of(from, is_accepted));
        match self.seen.iter().find(|seen| seen.mark == mark) {
            None => Lookup::New(NewFrame { mark, from, was_refused: false }),
            Some(seen) if seen.from == Share::REFUSED && is_accepted => {
                Lookup::New(NewFrame { mark, from, was_refused: true })
            }
            Some(seen) => Lookup::Duplicate { is_same_share: seen.from == from },
        }
    }

    fn forget_old(&mut self, now: Instant) {
        // After a pause all frames are old, and the steps, which wrap, no longer show it.
        let is_late = now - self.last_lookup >= REMEMBERED;
        self.last_lookup = now;
        let at = steps(now);
        let is_old = |seen: &Seen| is_late || at.wrapping_sub(seen.at) >= REMEMBERED_STEPS;
        while let Some(oldest) = self.seen.front().filter(|seen| is_old(seen)) {
            if let Some(held) = self.held.get_mut(usize::from(oldest.from.0)) {
                *held -= 1;
            }
            self.seen.pop_front();
        }
    }

    /// Returns whether there is a place within the frame's share.
    pub(super) fn has_room(&self, frame: &NewFrame, is_addressed: bool) -> bool {
        let (older, newer) = self.seen.as_slices();
        let free = self.seen.storage_capacity().saturating_sub(older.len()).saturating_sub(newer.len());
        let held = self.held.get(usize::from(frame.from.0)).map_or(usize::MAX, |held| held.0.into());
        held < free.saturating_mul(if is_addressed { 7 } else { 3 })
    }

    /// Remembers a frame for which there is a place.
    pub(super) fn remember(&mut self, now: Instant, frame: &NewFrame) {
        let NewFrame { mark, from, was_refused } = *frame;
        if was_refused {
            for seen in self.seen.iter_mut().filter(|seen| seen.mark == mark) {
                seen.mark = Mark::REPLACED;
            }
        }
        let seen = Seen { mark, from, at: steps(now) };
        if let (Ok(()), Some(held)) = (self.seen.push_back(seen), self.held.get_mut(usize::from(from.0))) {
            *held += 1;
        }
    }

    /// Records that a frame returned through a routing loop.
    pub(super) fn note_loop(&mut self, now: Instant) {
        self.last_loop = Some(now);
    }

    /// Returns whether the links form a routing loop.
    pub(super) fn is_looped(&self, now: Instant) -> bool {
        self.last_loop.is_some_and(|at| now - at < LOOP_TIMEOUT)
    }
}

/// Returns a time in [`STEP`]s. It wraps after two seconds.
#[allow(clippy::as_conversions, reason = "the low bits are meant")]
const fn steps(now: Instant) -> u8 {
    (now.as_micros() >> STEP) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    const LINKS: [LinkId; 3] = [LinkId(0), LinkId(1), LinkId(2)];

    /// Looks up an accepted frame, and remembers it if it is new and has a place. Returns whether it did.
    fn pass(memory: &mut Memory, now: Instant, frame: &[u8], from: LinkId, is_addressed: bool) -> bool {
        match memory.look_up(now, 0, frame, from, true) {
            Lookup::New(frame) if memory.has_room(&frame, is_addressed) => {
                memory.remember(now, &frame);
                true
            }
            _ => false,
        }
    }

    /// a frame is remembered for 0.8 s, also when the steps wrap, and is forgotten after a longer pause of any
    /// length.
    #[test]
    fn frames_are_remembered_for_800_ms() {
        let remembered = REMEMBERED.as_micros();
        assert!((790_000..810_000).contains(&remembered));
        let wrap = 256 << STEP;
        for start in [0, 1, 5_000, wrap - 1, wrap, 7 * wrap + 99] {
            let is_duplicate = |afters: &[u64]| {
                let mut memory = Memory::<Deque<Seen, 4>>::EMPTY;
                let memory: &mut Memory = &mut memory;
                assert!(pass(memory, Instant::from_micros(start), b"a", LINKS[0], false));
                let look_up = |after| memory.look_up(Instant::from_micros(start + after), 0, b"a", LINKS[1], true);
                matches!(afters.iter().copied().map(look_up).last(), Some(Lookup::Duplicate { is_same_share: false }))
            };
            assert!(is_duplicate(&[0, 1, remembered / 2, remembered - (1 << STEP)]), "after {start}");
            assert!(!is_duplicate(&[remembered / 2, remembered]), "after {start}");
            for pause in [remembered, wrap - 1, wrap, wrap + remembered / 2, 10 * wrap] {
                assert!(!is_duplicate(&[pause]), "{pause} µs after {start}");
            }
        }
    }

    /// a flood on one link takes three of four places, seven of eight for addressed frames. The other links still
    /// find places.
    #[test]
    fn places_are_shared() {
        let mut memory = Memory::<Deque<Seen, 256>>::EMPTY;
        let memory: &mut Memory = &mut memory;
        let mut flood = |from: usize, is_addressed: bool| {
            let frame = |n: usize| [from as u8, u8::from(is_addressed), n as u8, (n >> 8) as u8];
            (0..300).filter(|&n| pass(memory, Instant::ZERO, &frame(n), LINKS[from], is_addressed)).count()
        };
        assert_eq!([flood(0, false), flood(0, true)], [192, 32]);
        assert_eq!([flood(1, false), flood(1, true)], [24, 4]);
        assert_eq!([flood(2, false), flood(2, true)], [3, 1]);
    }

    /// A memory with a single place remembers one frame.
    #[test]
    fn a_single_place_suffices() {
        let mut memory = Memory::<Deque<Seen, 1>>::EMPTY;
        let memory: &mut Memory = &mut memory;
        assert!(pass(memory, Instant::ZERO, b"a", LINKS[0], false));
        assert!(!pass(memory, Instant::from_millis(700), b"b", LINKS[1], true));
        assert!(pass(memory, Instant::from_millis(900), b"b", LINKS[1], true));
    }

    /// links count as a loop for ten seconds after the last frame that returned.
    #[test]
    fn loops_time_out() {
        let mut memory = Memory::<Deque<Seen, 1>>::EMPTY;
        let memory: &mut Memory = &mut memory;
        assert!(!memory.is_looped(Instant::ZERO));
        memory.note_loop(Instant::from_millis(5));
        assert!(memory.is_looped(Instant::from_millis(10_004)) && !memory.is_looped(Instant::from_millis(10_005)));
    }

    /// A frame that is looked up `wait` milliseconds after the one before.
    #[derive(Clone, Copy, Debug)]
    struct Step {
        wait: u64,
        frame: u8,
        from: usize,
        is_accepted: bool,
        is_addressed: bool,
    }

    fn step() -> impl Strategy<Value = Step> {
        let wait = prop_oneof![20 => 0..60_u64, 1 => 500..3_000_u64];
        (wait, 0..20_u8, 0..3_usize, any::<bool>(), any::<bool>()).prop_map(
            |(wait, frame, from, is_accepted, is_addressed)| Step { wait, frame, from, is_accepted, is_addressed },
        )
    }

    proptest! {
        /// agrees with a list that never forgets.
        #[test]
        fn agrees_with_a_list(steps in prop::collection::vec(step(), 0..300)) {
            let mut memory = Memory::<Deque<Seen, 12>>::EMPTY;
            let memory: &mut Memory = &mut memory;
            let mut list: Vec<(u64, Step)> = Vec::new();
            let mut now = 0;
            for step in steps {
                now += step.wait * 1_000;
                let instant = Instant::from_micros(now);
                let age = |at: u64| (now >> STEP) - (at >> STEP);
                let live: Vec<_> = list.iter().filter(|(at, _)| age(*at) < u64::from(REMEMBERED_STEPS)).collect();
                let last = live.iter().rfind(|(_, other)| other.frame == step.frame);
                let lookup = memory.look_up(instant, 0, &[step.frame], LINKS[step.from], step.is_accepted);
                let was_refused = match (last, lookup) {
                    (Some((_, other)), Lookup::Duplicate { is_same_share }) => {
                        prop_assert!(other.is_accepted || !step.is_accepted);
                        let is_same = other.is_accepted == step.is_accepted
                            && (other.from == step.from || !step.is_accepted);
                        prop_assert_eq!(is_same_share, is_same);
                        continue;
                    }
                    (Some((_, other)), Lookup::New(_)) => {
                        prop_assert!(!other.is_accepted && step.is_accepted);
                        true
                    }
                    (None, lookup) => {
                        prop_assert!(matches!(lookup, Lookup::New(_)));
                        false
                    }
                };
                let Lookup::New(frame) = lookup else { unreachable!() };
                prop_assert_eq!(frame.was_refused, was_refused);
                prop_assert_eq!(frame.is_refused(), !step.is_accepted);
                let is_share = |other: &Step| match step.is_accepted {
                    true => other.is_accepted && other.from == step.from,
                    false => !other.is_accepted,
                };
                let held = live.iter().filter(|(_, other)| is_share(other)).count();
                let has_room = held < (12 - live.len()) * if step.is_addressed { 7 } else { 3 };
                prop_assert_eq!(memory.has_room(&frame, step.is_addressed), has_room);
                if has_room {
                    memory.remember(instant, &frame);
                    list.push((now, step));
                }
            }
        }
    }
}
