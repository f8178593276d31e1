//! What was forwarded a moment ago, so that a frame which comes back is not forwarded again.
//!
//! A frame that has a place is known for its 0.8 s, whatever else comes: none is pushed out. So what keeps others out is how
//! many places are taken, and these are shared: a link takes three for each that is free, and for frames that are addressed
//! seven. Whoever floods one link finds no more than that, and what comes by the others still finds places. What finds none is
//! not forwarded, and as nobody knows it again it is handled here each time that it comes.

use crate::link::{LinkId, MAX_LINKS};
use crate::time::{Duration, Instant};
use heapless::deque::{Deque, DequeView};

/// One frame that was forwarded.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    /// Of all its bytes; 0 when it has another place by now.
    key: u32,
    from: Share,
    /// In [`steps`].
    at: u8,
}

/// Whose share a place is: that of the link that a frame came by, or that of all frames that were refused where they came in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Share(u8);

impl Share {
    /// Behind all links.
    const REFUSED: Self = Self(16);
    const COUNT: usize = MAX_LINKS + 1;

    const fn of(link: LinkId, is_accepted: bool) -> Self {
        if is_accepted { Self(link.0) } else { Self::REFUSED }
    }
}

const _: () = assert!(Share::COUNT == 17, "a share for each link, and one");

/// What is known of a frame that was not forwarded yet, or only when it was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Ticket {
    key: u32,
    from: Share,
    /// Whether it is known as one that was refused.
    pub(super) was_refused: bool,
}

impl Ticket {
    pub(super) fn is_refused(&self) -> bool {
        self.from == Share::REFUSED
    }
}

/// What the memory says of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Recall {
    /// It is to be forwarded.
    New(Ticket),
    /// It was forwarded a moment ago. `is_same_way`: it came by the same link.
    Copy { is_same_way: bool },
}

/// For how many steps a frame is known: 0.8 s, less than the second after which a sender without sequence numbers sends the
/// same heartbeat again.
const KNOWN: u8 = 98;

/// The same as a time.
#[allow(clippy::as_conversions, reason = "const: `From` cannot be called; u8 to u64")]
const PAUSE: Duration = Duration::from_micros((KNOWN as u64) << STEP);

/// A step is 2^13 µs.
const STEP: u32 = 13;

/// Since the last frame that came around for so long the lines are no loop any more.
const LOOP_OVER: Duration = Duration::from_secs(10);

/// The last frames that were forwarded. The logic works on the unsized form, so their number is compiled once.
#[derive(Clone, Debug)]
pub(super) struct Memory<S: ?Sized = DequeView<Seen>> {
    /// How many places each share has taken.
    held: [u16; Share::COUNT],
    /// When it was last asked.
    asked: Instant,
    /// When the last frame came around.
    came_around: Option<Instant>,
    /// The oldest first.
    seen: S,
}

impl<const SEEN: usize> Memory<Deque<Seen, SEEN>> {
    /// Zero bits.
    pub(super) const EMPTY: Self =
        Self { held: [0; Share::COUNT], asked: Instant::ZERO, came_around: None, seen: Deque::new() };
}

impl Memory {
    /// Looks for a frame that came by the link `from`, and was accepted there or not. What was only ever refused is new when
    /// it is accepted.
    pub(super) fn recall(&mut self, now: Instant, frame: &[u8], from: LinkId, is_accepted: bool) -> Recall {
        self.forget_old(now);
        let (key, from) = (key_of(frame), Share::of(from, is_accepted));
        match self.seen.iter().find(|seen| seen.key == key) {
            None => Recall::New(Ticket { key, from, was_refused: false }),
            Some(seen) if seen.from == Share::REFUSED && is_accepted => {
                Recall::New(Ticket { key, from, was_refused: true })
            }
            Some(seen) => Recall::Copy { is_same_way: seen.from == from },
        }
    }

    fn forget_old(&mut self, now: Instant) {
        // After a pause all are old, and the steps say no more which is.
        let is_late = now.since(self.asked) >= PAUSE;
        self.asked = now;
        let at = steps(now);
        while let Some(oldest) = self.seen.front().filter(|seen| is_late || at.wrapping_sub(seen.at) >= KNOWN) {
            if let Some(held) = self.held.get_mut(usize::from(oldest.from.0)) {
                *held = held.saturating_sub(1);
            }
            self.seen.pop_front();
        }
    }

    /// Whether there is a place for a frame that was looked for, which is not taken from others.
    pub(super) fn has_room(&self, ticket: &Ticket, is_addressed: bool) -> bool {
        let (older, newer) = self.seen.as_slices();
        let free = self.seen.storage_capacity().saturating_sub(older.len()).saturating_sub(newer.len());
        let held = self.held.get(usize::from(ticket.from.0)).map_or(usize::MAX, |&held| held.into());
        held < free.saturating_mul(if is_addressed { 7 } else { 3 })
    }

    /// Notes a frame that has a place, now.
    pub(super) fn note(&mut self, now: Instant, ticket: &Ticket) {
        let Ticket { key, from, was_refused } = *ticket;
        if was_refused {
            for seen in self.seen.iter_mut().filter(|seen| seen.key == key) {
                seen.key = 0;
            }
        }
        let seen = Seen { key, from, at: steps(now) };
        if let (Ok(()), Some(held)) = (self.seen.push_back(seen), self.held.get_mut(usize::from(from.0))) {
            *held = held.saturating_add(1);
        }
    }

    /// A frame came around: there is a loop.
    pub(super) fn on_loop(&mut self, now: Instant) {
        self.came_around = Some(now);
    }

    /// Whether frames come around.
    pub(super) fn is_looped(&self, now: Instant) -> bool {
        self.came_around.is_some_and(|at| now.since(at) < LOOP_OVER)
    }
}

/// A number for all bytes of a frame; not 0.
fn key_of(frame: &[u8]) -> u32 {
    let add = |key: u32, word: u32| (key.rotate_left(5) ^ word).wrapping_mul(0x9E37_79B9);
    let (words, rest) = frame.as_chunks();
    let key = words.iter().fold(0, |key, &word| add(key, u32::from_le_bytes(word)));
    let key = rest.iter().fold(key, |key, &byte| add(key, u32::from(byte)));
    key.max(1)
}

/// A time in [`STEP`]s. Wraps after two seconds.
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

    /// Looks for a frame, and notes it if it is new and has a place.
    fn pass(memory: &mut Memory, now: Instant, frame: &[u8], from: LinkId, is_addressed: bool) -> bool {
        match memory.recall(now, frame, from, true) {
            Recall::New(ticket) if memory.has_room(&ticket, is_addressed) => {
                memory.note(now, &ticket);
                true
            }
            _ => false,
        }
    }

    /// a frame is known for 0.8 s, also where the steps wrap, and after a pause of any length it is not.
    #[test]
    fn frames_are_known_for_a_while() {
        let known = PAUSE.as_micros();
        assert!((790_000..810_000).contains(&known));
        let wrap = 256 << STEP;
        for start in [0, 1, 5_000, wrap - 1, wrap, 7 * wrap + 99] {
            let is_known = |afters: &[u64]| {
                let mut memory = Memory::<Deque<Seen, 4>>::EMPTY;
                let memory: &mut Memory = &mut memory;
                assert!(pass(memory, Instant::from_micros(start), b"a", LINKS[0], false));
                let recall = |after| memory.recall(Instant::from_micros(start + after), b"a", LINKS[1], true);
                matches!(afters.iter().copied().map(recall).last(), Some(Recall::Copy { is_same_way: false }))
            };
            assert!(is_known(&[0, 1, known / 2, known - (1 << STEP)]), "after {start}");
            assert!(!is_known(&[known / 2, known]), "after {start}");
            for pause in [known, wrap - 1, wrap, wrap + known / 2, 10 * wrap] {
                assert!(!is_known(&[pause]), "{pause} µs after {start}");
            }
        }
    }

    /// a flood by one link finds three places of four, or seven of eight; then others still find some.
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

    /// However small it is, it takes one.
    #[test]
    fn one_place_is_a_memory() {
        let mut memory = Memory::<Deque<Seen, 1>>::EMPTY;
        let memory: &mut Memory = &mut memory;
        assert!(pass(memory, Instant::ZERO, b"a", LINKS[0], false));
        assert!(!pass(memory, Instant::from_millis(700), b"b", LINKS[1], true));
        assert!(pass(memory, Instant::from_millis(900), b"b", LINKS[1], true));
    }

    /// frames come around for ten seconds after the last one that did.
    #[test]
    fn loops_are_over_some_time() {
        let mut memory = Memory::<Deque<Seen, 1>>::EMPTY;
        let memory: &mut Memory = &mut memory;
        assert!(!memory.is_looped(Instant::ZERO));
        memory.on_loop(Instant::from_millis(5));
        assert!(memory.is_looped(Instant::from_millis(10_004)) && !memory.is_looped(Instant::from_millis(10_005)));
    }

    #[test]
    fn every_byte_counts() {
        let frame = [0xFD, 3, 0, 0, 7, 255, 190, 1, 2, 3, 4, 5, 6, 7, 8];
        for index in 0..frame.len() {
            let mut other = frame;
            other[index] ^= 0x10;
            assert_ne!(key_of(&frame), key_of(&other), "byte {index}");
        }
        assert_ne!(key_of(&frame), key_of(&frame[..14]));
    }

    /// Something that the memory is asked: so many milliseconds later, a frame of so few, by a link, as it was judged.
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
        /// against a list that forgets nothing.
        #[test]
        fn is_a_memory(steps in prop::collection::vec(step(), 0..300)) {
            let mut memory = Memory::<Deque<Seen, 12>>::EMPTY;
            let memory: &mut Memory = &mut memory;
            let mut list: Vec<(u64, Step)> = Vec::new();
            let mut now = 0;
            for step in steps {
                now += step.wait * 1_000;
                let instant = Instant::from_micros(now);
                let live: Vec<_> = list.iter().filter(|(at, _)| (now >> STEP) - (at >> STEP) < u64::from(KNOWN)).collect();
                let last = live.iter().rfind(|(_, other)| other.frame == step.frame);
                let recall = memory.recall(instant, &[step.frame], LINKS[step.from], step.is_accepted);
                let was_refused = match (last, recall) {
                    (Some((_, other)), Recall::Copy { is_same_way }) => {
                        prop_assert!(other.is_accepted || !step.is_accepted);
                        let is_same = other.is_accepted == step.is_accepted
                            && (other.from == step.from || !step.is_accepted);
                        prop_assert_eq!(is_same_way, is_same);
                        continue;
                    }
                    (Some((_, other)), Recall::New(_)) => {
                        prop_assert!(!other.is_accepted && step.is_accepted);
                        true
                    }
                    (None, recall) => {
                        prop_assert!(matches!(recall, Recall::New(_)));
                        false
                    }
                };
                let Recall::New(ticket) = recall else { unreachable!() };
                prop_assert_eq!(ticket.was_refused, was_refused);
                prop_assert_eq!(ticket.is_refused(), !step.is_accepted);
                let is_share = |other: &Step| match step.is_accepted {
                    true => other.is_accepted && other.from == step.from,
                    false => !other.is_accepted,
                };
                let held = live.iter().filter(|(_, other)| is_share(other)).count();
                let has_room = held < (12 - live.len()) * if step.is_addressed { 7 } else { 3 };
                prop_assert_eq!(memory.has_room(&ticket, step.is_addressed), has_room);
                if has_room {
                    memory.note(instant, &ticket);
                    list.push((now, step));
                }
            }
        }
    }
}
