//! What one link keeps of the streams: intervals, when each is due, and what was asked for once.
//!
//! All streams that are due are sent in sweeps through the table, each at most once a sweep, and a sweep that found no more
//! room goes on where it stopped. So a line that is too slow for all starves none: the fast ones get slower first.

use heapless::Vec;

use super::{MAX_INTERVAL, Stream, StreamProfile};
use crate::time::{Duration, Instant};

/// The interval of a stream that is off.
const OFF: u32 = u32::MAX;

/// A stream makes up for so much of being late (µs), a message a poll; what is beyond is dropped, or a line that stalled
/// would be followed by a burst.
const CATCH_UP: u32 = 100_000;

/// Further ahead than this (µs) no stream is due: what looks so is long past.
const HORIZON: u32 = MAX_INTERVAL + 4_000_000;

/// A RADIO_STATUS says nothing any more after this time: five seconds, in units of 1,024 µs.
const RADIO_STALE: u32 = 4_883;

/// What a radio with a full buffer adds to the intervals is counted in steps of this (µs), and so many of them at most.
const STEP: u32 = 20_000;
const MAX_SLOWDOWN: u8 = 100;

/// Questions about intervals that one link can owe the answers of.
const QUESTIONS: usize = 4;

/// One stream on one link.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Slot {
    /// µs; 0 is the stream's default.
    interval: u32,
    /// The low half of the time (µs); compared by difference, so it may wrap.
    due: u32,
}

impl Slot {
    /// The default, due at once. Zero bits.
    pub(crate) const NEW: Self = Self { interval: 0, due: 0 };

    /// The interval (µs) of `stream`, whose slot it is; `None` when it is off.
    pub(super) fn interval(&self, stream: &Stream, profile: StreamProfile) -> Option<u32> {
        match self.interval {
            0 => Some(stream.default_interval(profile)).filter(|&interval| interval != 0),
            OFF => None,
            interval => Some(interval),
        }
    }

    /// How late it is (µs); `None` when it is not due yet.
    fn late(&self, time: u32) -> Option<u32> {
        let ahead = self.due.wrapping_sub(time);
        (ahead == 0 || ahead > HORIZON).then_some(time.wrapping_sub(self.due))
    }
}

/// The streams of a link, but for their slots, of which there are as many as the stack has room for. Initially zero bits.
#[derive(Clone, Debug)]
pub(crate) struct Streams {
    /// A bit for each stream that was asked for once.
    asked: u32,
    /// The one that was asked for with an index: its number in the table and 1, or 0; and the index.
    indexed: u8,
    index: u16,
    /// Ids of messages whose interval was asked for.
    questions: Vec<u16, QUESTIONS, u8>,
    /// Where the sweep is in the table, and when it began.
    cursor: u8,
    is_sweeping: bool,
    swept: Instant,
    /// When the next sweep has something to send; zero before the first one.
    wake: Instant,
    /// What a radio's full buffer adds to each interval, in [steps](STEP), and when it last said something, in
    /// [`ticks`](Instant::ticks). With each sweep what is too old is forgotten.
    slowdown: u8,
    radio: u32,
}

impl Streams {
    pub(crate) const fn new() -> Self {
        Self {
            asked: 0,
            indexed: 0,
            index: 0,
            questions: Vec::new(),
            cursor: 0,
            is_sweeping: false,
            swept: Instant::ZERO,
            wake: Instant::ZERO,
            slowdown: 0,
            radio: 0,
        }
    }

    /// Sends a stream every `interval` µs from now on; 0 is its default, `None` stops it.
    pub(super) fn set_interval(&mut self, now: Instant, slot: &mut Slot, interval: Option<u32>) {
        slot.interval = interval.unwrap_or(OFF);
        slot.due = low_half(now);
        self.wake = now;
    }

    /// Owes stream `number` once. False when there is no room to remember another index.
    pub(crate) fn ask(&mut self, number: u8, index: u16) -> bool {
        if index == 0 {
            self.asked |= 1u32.wrapping_shl(u32::from(number));
            return true;
        }
        let indexed = number.saturating_add(1);
        let has_room = self.indexed == 0 || (self.indexed == indexed && self.index == index);
        if has_room {
            self.indexed = indexed;
            self.index = index;
        }
        has_room
    }

    /// A stream that was asked for, and its index; it is owed no longer.
    pub(crate) fn take_asked(&mut self) -> Option<(usize, u16)> {
        if self.asked != 0 {
            let number = self.asked.trailing_zeros();
            self.asked &= self.asked.wrapping_sub(1);
            return Some((usize::try_from(number).unwrap_or(0), 0));
        }
        let number = core::mem::take(&mut self.indexed).checked_sub(1)?;
        Some((usize::from(number), self.index))
    }

    /// Owes the answer to what the interval of message `id` is. False when there is no room for it.
    pub(super) fn question(&mut self, id: u16) -> bool {
        self.questions.contains(&id) || self.questions.push(id).is_ok()
    }

    /// A message whose interval is to be told; it is owed no longer.
    pub(super) fn take_question(&mut self) -> Option<u16> {
        // The oldest.
        let id = self.questions.first().copied()?;
        self.questions.retain(|&other| other != id);
        Some(id)
    }

    /// Whether an answer is owed.
    pub(crate) fn is_asked(&self) -> bool {
        self.asked != 0 || self.indexed != 0 || !self.questions.is_empty()
    }

    /// A radio told how much of its transmit buffer is free, in percent.
    pub(super) fn on_radio(&mut self, now: Instant, free: u8) {
        self.forget_radio(now);
        let slowdown = self.slowdown;
        self.slowdown = match free {
            0..20 => slowdown.saturating_add(3).min(MAX_SLOWDOWN),
            20..50 => slowdown.saturating_add(1).min(MAX_SLOWDOWN),
            96.. => slowdown.saturating_sub(2),
            91.. => slowdown.saturating_sub(1),
            _ => slowdown,
        };
        self.radio = now.ticks();
    }

    fn forget_radio(&mut self, now: Instant) {
        if now.ticks().wrapping_sub(self.radio) > RADIO_STALE {
            self.slowdown = 0;
        }
    }

    /// What a radio's full buffer adds to each interval now (µs).
    pub(super) fn slowdown(&self, now: Instant) -> u32 {
        let is_stale = now.ticks().wrapping_sub(self.radio) > RADIO_STALE;
        if is_stale { 0 } else { u32::from(self.slowdown).wrapping_mul(STEP) }
    }

    /// The number of the next stream that is to be sent, which then is due an interval after it was *due* now.
    pub(crate) fn next_due(
        &mut self,
        now: Instant,
        table: &[Stream],
        slots: &mut [Slot],
        profile: StreamProfile,
    ) -> Option<usize> {
        if now.since(self.swept).as_micros() > u64::from(HORIZON) {
            // The line took nothing for so long that what was due then may look as if it were still to come.
            self.pause();
        }
        // The rest of a sweep that found no room before, and then a new one.
        for _ in 0..2 {
            if !self.is_sweeping && !self.begin_sweep(now, slots) {
                return None;
            }
            if let Some(number) = self.sweep(now, table, slots, profile) {
                return Some(number);
            }
            self.is_sweeping = false;
        }
        None
    }

    /// False when it is too early for another sweep.
    fn begin_sweep(&mut self, now: Instant, slots: &mut [Slot]) -> bool {
        if self.wake == Instant::ZERO {
            // Nobody listened up to here.
            slots.iter_mut().for_each(|slot| slot.due = low_half(now));
        } else if now < self.wake || now == self.swept {
            return false;
        }
        self.forget_radio(now);
        self.is_sweeping = true;
        self.cursor = 0;
        self.swept = now;
        self.wake = Instant::NEVER;
        true
    }

    /// Goes on through the table to the next stream that is due.
    fn sweep(&mut self, now: Instant, table: &[Stream], slots: &mut [Slot], profile: StreamProfile) -> Option<usize> {
        let time = low_half(now);
        // As it was when the sweep began.
        let slowdown = u32::from(self.slowdown).wrapping_mul(STEP);
        let rest = table.iter().zip(slots).enumerate().skip(usize::from(self.cursor));
        for (number, (stream, slot)) in rest {
            self.cursor = self.cursor.saturating_add(1);
            let Some(interval) = slot.interval(stream, profile) else { continue };
            let late = slot.late(time);
            if let Some(late) = late {
                let next = time.wrapping_sub(late.min(CATCH_UP));
                slot.due = next.wrapping_add(interval.saturating_add(slowdown));
            }
            let ahead = if slot.late(time).is_some() { 0 } else { slot.due.wrapping_sub(time) };
            self.wake = self.wake.min(now.after(Duration::from_micros(u64::from(ahead))));
            if late.is_some() {
                return Some(number);
            }
        }
        None
    }

    /// Nobody is there to listen: the next sweep comes with whatever wakes the stack.
    pub(crate) fn pause(&mut self) {
        self.is_sweeping = false;
        self.wake = Instant::ZERO;
    }

    /// When a stream is to be sent on a line that is idle from `idle` on.
    pub(crate) fn deadline(&self, idle: Instant) -> Instant {
        match self.wake {
            _ if self.is_sweeping => idle,
            Instant::ZERO => Instant::NEVER,
            wake => wake.max(idle),
        }
    }
}

/// The low 32 bits of the time (µs).
fn low_half(now: Instant) -> u32 {
    let [a, b, c, d, ..] = now.as_micros().to_le_bytes();
    u32::from_le_bytes([a, b, c, d])
}
