//! What one link keeps of the streams: intervals, when each is due, and what was asked for once.
//!
//! All streams that are due are sent in sweeps through the table, each at most once a sweep, and a sweep that found no more
//! room goes on where it stopped. So a line that is too slow for all starves none: the fast ones get slower first.

use heapless::Vec;

use super::{Stream, StreamProfile};
use crate::list::take_first;
use crate::time::Instant;

/// The interval of a stream that is off.
const OFF: u16 = u16::MAX;

/// How an interval is kept: up to here as the whole rate (Hz) that it is of, beyond as four digits and a power of ten.
const MAX_RATE: u16 = 1_000;
/// The least four digits, and how many numbers each power has.
const DIGITS: u32 = 1_000;
const SPAN: u32 = 12_800;
const POWERS: [u32; 5] = [1, 10, 100, 1_000, 10_000];

/// Streams count in units of 64 µs, or of 1,024 from this interval (µs) on: then it has room in 16 bits, with what a radio's
/// full buffer adds.
const SLOW: u32 = 2_000_000;

/// What [`Slot::left`] is when a stream is due. So late, 100 ms, it can be and makes up for it, a message a poll; what is beyond
/// is dropped, or a line that stalled would be followed by a burst.
const DUE: u16 = 1_563;

/// What [`Slot::left`] is when a stream becomes due with the next sweep.
const FRESH: u16 = u16::MAX;

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
    /// 0 is the stream's default.
    interval: u16,
    /// When it is due, counted down with each sweep, so that it matters not for how long there was none.
    left: u16,
}

impl Slot {
    /// The default, due at once. Zero bits.
    pub(crate) const NEW: Self = Self { interval: 0, left: 0 };

    /// The interval (µs) of `stream`, whose slot it is; `None` when it is off.
    pub(super) fn interval(&self, stream: &Stream, profile: StreamProfile) -> Option<u32> {
        match self.interval {
            0 => Some(stream.default_interval(profile)).filter(|&interval| interval != 0),
            OFF => None,
            code => Some(interval_of(code)),
        }
    }
}

/// What is kept of an interval (µs) within the bounds: all of it for each whole rate and up to four digits. Else it is rounded
/// up, by less than a thousandth.
fn code_of(interval: u32) -> u16 {
    let rate = 1_000_000u32.checked_div(interval).unwrap_or(0);
    if 1_000_000u32.checked_div(rate) == Some(interval) {
        return u16::try_from(rate).unwrap_or(MAX_RATE);
    }
    let mut code = u32::from(MAX_RATE).wrapping_add(1);
    let mut digits = interval;
    while digits >= DIGITS.wrapping_add(SPAN) {
        digits = digits.div_ceil(10);
        code = code.wrapping_add(SPAN);
    }
    u16::try_from(code.wrapping_add(digits.saturating_sub(DIGITS))).unwrap_or(OFF)
}

/// The interval (µs) that was kept.
fn interval_of(code: u16) -> u32 {
    match u32::from(code).checked_sub(u32::from(MAX_RATE).wrapping_add(1)) {
        None => 1_000_000u32.checked_div(u32::from(code)).unwrap_or(0),
        Some(code) => {
            let power = usize::try_from(code / SPAN).ok().and_then(|power| POWERS.get(power)).copied().unwrap_or(0);
            (code % SPAN).wrapping_add(DIGITS).wrapping_mul(power)
        }
    }
}

/// How far a time or an interval (µs) is shifted to count in a stream's units.
fn shift_of(interval: u32) -> u32 {
    if interval < SLOW { 6 } else { 10 }
}

/// So many units there are from one moment to another; none is lost from one call to the next.
fn units(from: Instant, to: Instant, shift: u32) -> u16 {
    let [from, to] = [from, to].map(|at| at.as_micros().wrapping_shr(shift));
    u16::try_from(to.saturating_sub(from)).unwrap_or(u16::MAX)
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
    /// Where the sweep is in the table, and 1; 0 when there is none. And when the last one began.
    cursor: u8,
    swept: Instant,
    /// What is added before an interval is rounded to units, in 256ths of one: another part with each sweep, so that on
    /// average nothing is.
    dither: u8,
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
            swept: Instant::ZERO,
            dither: 0,
            wake: Instant::ZERO,
            slowdown: 0,
            radio: 0,
        }
    }

    /// Sends a stream every `interval` µs from now on; 0 is its default, `None` stops it.
    pub(super) fn set_interval(&mut self, now: Instant, slot: &mut Slot, interval: Option<u32>) {
        slot.interval = match interval {
            None => OFF,
            Some(0) => 0,
            Some(interval) => code_of(interval),
        };
        slot.left = FRESH;
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
        take_first(&mut self.questions, |_| true)
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
        // The rest of a sweep that found no room before, and then a new one.
        for _ in 0..2 {
            if self.cursor == 0 && !self.begin_sweep(now, table, slots, profile) {
                return None;
            }
            if let Some(number) = self.sweep(table, slots, profile) {
                return Some(number);
            }
            self.cursor = 0;
        }
        None
    }

    /// False when it is too early for another sweep.
    fn begin_sweep(&mut self, now: Instant, table: &[Stream], slots: &mut [Slot], profile: StreamProfile) -> bool {
        if self.wake == Instant::ZERO {
            // Nobody listened up to here.
            slots.iter_mut().for_each(|slot| slot.left = DUE);
        } else if now < self.wake || now == self.swept {
            return false;
        } else {
            let (fine, coarse) = (units(self.swept, now, shift_of(0)), units(self.swept, now, shift_of(SLOW)));
            for (stream, slot) in table.iter().zip(slots) {
                let interval = slot.interval(stream, profile).unwrap_or(0);
                slot.left = match slot.left {
                    FRESH => DUE,
                    left => left.saturating_sub(if interval < SLOW { fine } else { coarse }),
                };
            }
        }
        self.forget_radio(now);
        self.cursor = 1;
        self.swept = now;
        self.dither = self.dither.wrapping_add(157);
        self.wake = Instant::NEVER;
        true
    }

    /// Goes on through the table to the next stream that is due.
    fn sweep(&mut self, table: &[Stream], slots: &mut [Slot], profile: StreamProfile) -> Option<usize> {
        // As it was when the sweep began.
        let slowdown = u32::from(self.slowdown).wrapping_mul(STEP);
        let from = usize::from(self.cursor.saturating_sub(1));
        let rest = (from..table.len()).zip(table.iter().zip(slots).skip(from));
        for (number, (stream, slot)) in rest {
            self.cursor = self.cursor.saturating_add(1);
            let Some(interval) = slot.interval(stream, profile) else { continue };
            let shift = shift_of(interval);
            let is_due = slot.left <= DUE;
            if is_due {
                let dither = u32::from(self.dither).wrapping_shl(shift).wrapping_shr(8);
                let next = interval.saturating_add(slowdown).saturating_add(dither).wrapping_shr(shift);
                slot.left = slot.left.saturating_add(u16::try_from(next).unwrap_or(0));
            }
            let ahead = u64::from(slot.left.saturating_sub(DUE));
            let due = self.swept.as_micros().wrapping_shr(shift).saturating_add(ahead).wrapping_shl(shift);
            self.wake = self.wake.min(Instant::from_micros(due));
            if is_due {
                return Some(number);
            }
        }
        None
    }

    /// Nobody is there to listen: the next sweep comes with whatever wakes the stack.
    pub(crate) fn pause(&mut self) {
        self.cursor = 0;
        self.wake = Instant::ZERO;
    }

    /// When a stream is to be sent on a line that is idle from `idle` on.
    pub(crate) fn deadline(&self, idle: Instant) -> Instant {
        match self.wake {
            _ if self.cursor != 0 => idle,
            Instant::ZERO => Instant::NEVER,
            wake => wake.max(idle),
        }
    }
}
