//! The history of events. Any hook may record one; `service::events` sends them (EVT-1, EVT-2).

use core::num::{Saturating, Wrapping};

use crate::time::Instant;

/// The maximum length of an event's arguments, in bytes: that of libevents' definitions, so that 40 bytes are not
/// stored for each event.
pub const MAX_EVENT_ARGUMENTS: usize = 25;

/// A recorded event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EventEntry {
    pub(crate) id: u32,
    pub(crate) time_boot_ms: u32,
    /// The internal level in the high four bits, the external one in the low four.
    pub(crate) log_levels: u8,
    pub(crate) arguments: [u8; MAX_EVENT_ARGUMENTS],
}

const _: () = assert!(size_of::<EventEntry>() == 36, "the memory of an event is documented");

/// The external level of critical events; more severe ones have a lower level.
const CRITICAL: u8 = 2;

impl EventEntry {
    /// An entry without an event: all zero bits.
    const NONE: Self = Self { id: 0, time_boot_ms: 0, log_levels: 0, arguments: [0; MAX_EVENT_ARGUMENTS] };

    /// Returns an event without arguments.
    pub(crate) const fn new(now: Instant, id: u32, log_levels: u8) -> Self {
        Self { id, time_boot_ms: now.time_boot_ms(), log_levels, ..Self::NONE }
    }
}

/// The sequence number of an event. It wraps: half of all numbers are after any other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EventSequence(Wrapping<u16>);

impl EventSequence {
    /// The number before that of the first event.
    pub(crate) const NONE: Self = Self::new(0);

    pub(crate) const fn new(number: u16) -> Self {
        Self(Wrapping(number))
    }

    /// Returns the number as messages carry it.
    pub(crate) const fn wire(self) -> u16 {
        self.0.0
    }

    pub(crate) fn next(self) -> Self {
        Self(self.0 + Wrapping(1))
    }

    /// Returns how many numbers it is after another one.
    pub(crate) fn since(self, earlier: Self) -> u16 {
        (self.0 - earlier.0).0
    }

    /// Whether it is after another one, and not the same.
    pub(crate) fn is_after(self, other: Self) -> bool {
        (1..=u16::MAX / 2).contains(&self.since(other))
    }
}

/// The last events, in a ring. The logic works on the unsized form, so it is compiled once for all lengths. A firmware
/// without `events` has a history of length 0, which records nothing.
#[derive(Clone, Debug)]
pub struct EventLog<E: ?Sized = [EventEntry]> {
    /// The sequence number of the newest event; that of the first event is 1.
    newest: EventSequence,
    /// Whether an event was recorded since the stack has looked.
    pub(crate) is_new: bool,
    /// The number of events in the ring.
    len: Saturating<u16>,
    /// The index of the next event.
    next: Saturating<u16>,
    entries: E,
}

impl<const N: usize> EventLog<[EventEntry; N]> {
    /// An empty history: all zero bits.
    pub(crate) const EMPTY: Self = {
        // Half of the sequence numbers are newer than any other.
        assert!(N <= 1_000, "the history of events is at most 1,000 long: `events: {{ history: 20 }}` is PX4's");
        Self {
            newest: EventSequence::NONE,
            is_new: false,
            len: Saturating(0),
            next: Saturating(0),
            entries: [EventEntry::NONE; N],
        }
    };
}

impl EventLog {
    /// Records an event; the oldest one is overwritten if the history is full.
    pub(crate) fn push(&mut self, event: &EventEntry) {
        let Some(entry) = self.entries.get_mut(usize::from(self.next.0)) else { return };
        *entry = *event;
        self.is_new = true;
        self.newest = self.newest.next();
        self.next += 1;
        if usize::from(self.next.0) >= self.entries.len() {
            self.next = Saturating(0);
        }
        if usize::from(self.len.0) < self.entries.len() {
            self.len += 1;
        }
    }

    /// Returns the sequence number of the newest event; [`NONE`](EventSequence::NONE) if there was none.
    pub(crate) const fn newest(&self) -> EventSequence {
        self.newest
    }

    /// Returns the sequence number of the oldest event in the history; that of the next event if it is empty.
    pub(crate) fn oldest(&self) -> EventSequence {
        EventSequence(self.newest.0 - Wrapping(self.len.0)).next()
    }

    /// Returns the event with this sequence number; `None` if it is not in the history.
    pub(crate) fn get(&self, sequence: EventSequence) -> Option<&EventEntry> {
        let age = self.newest.since(sequence);
        if age >= self.len.0 {
            return None;
        }
        self.newest_first().nth(usize::from(age))
    }

    /// Returns the entries from the newest event back to the start of the ring, and on from its end.
    fn newest_first(&self) -> impl Iterator<Item = &EventEntry> {
        let (newer, older) = self.entries.split_at_checked(usize::from(self.next.0)).unwrap_or_default();
        newer.iter().rev().chain(older.iter().rev())
    }

    /// Whether an event after this number is critical or more severe.
    pub(crate) fn has_urgent(&self, after: EventSequence) -> bool {
        let unsent = self.newest.since(after).min(self.len.0);
        self.newest_first().take(usize::from(unsent)).any(|event| event.log_levels & 0xF <= CRITICAL)
    }

    /// Returns the number of events that the history holds.
    pub(crate) const fn capacity(&self) -> usize {
        self.entries.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// EVT-2: the ring has the last events, each under its sequence number, also beyond the wrap of the numbers.
    #[test]
    fn history_has_the_last_events() {
        let mut log = EventLog::<[EventEntry; 3]>::EMPTY;
        let log: &mut EventLog = &mut log;
        let number = EventSequence::new;
        assert_eq!((log.newest(), log.oldest()), (number(0), number(1)));
        assert_eq!((log.get(number(0)), log.get(number(1))), (None, None));
        for id in 1..=140_000_u32 {
            log.push(&EventEntry::new(Instant::ZERO, id, 0));
            let kept = id.min(3);
            let newest = u16::try_from(id & 0xFFFF).unwrap();
            assert_eq!(log.newest(), number(newest));
            assert_eq!(log.oldest(), number(newest.wrapping_sub(u16::try_from(kept).unwrap()).wrapping_add(1)));
            for age in 0..4_u16 {
                let expected = (u32::from(age) < kept).then(|| id - u32::from(age));
                assert_eq!(log.get(number(newest.wrapping_sub(age))).map(|event| event.id), expected, "{id} {age}");
            }
            assert_eq!(log.get(number(newest.wrapping_add(1))), None);
        }
    }

    /// Without `events` nothing is recorded.
    #[test]
    fn history_of_length_0_records_nothing() {
        let mut log = EventLog::<[EventEntry; 0]>::EMPTY;
        let log: &mut EventLog = &mut log;
        log.push(&EventEntry::new(Instant::ZERO, 7, 0));
        let [none, first] = [0, 1].map(EventSequence::new);
        assert_eq!((log.newest(), log.get(none), log.get(first)), (none, None, None));
    }
}
