//! The streams of one link: their intervals, when each is due, and pending requests.
//!
//! Streams that are due are sent in sweeps through the table, each at most once per sweep. A sweep that found no more
//! room continues where it stopped. So a link that is too slow for all streams starves none: the fast ones slow down
//! first.

use heapless::Vec;

use super::{MAX_INTERVAL, Stream};
use crate::list::take_first;
use crate::time::{Duration, Instant};
use crate::types::StreamProfile;

/// The interval of a stream that is off.
const OFF: u16 = u16::MAX;

/// The encoding of an interval. Codes up to this are the interval's whole rate (Hz); larger codes are four digits and a
/// power of ten.
const MAX_RATE: u16 = 1_000;
/// The smallest digits, and the number of codes of each power.
const DIGITS: u32 = 1_000;
const SPAN: u32 = 12_800;
const POWERS: [u32; 5] = [1, 10, 100, 1_000, 10_000];

/// Streams count time in units of 64 µs, or of 1,024 µs from this interval (µs) on. An interval and the delay of a
/// radio then fit in 16 bits.
const SLOW: u32 = 2_000_000;

/// The value of [`Slot::left`] when a stream is due. A stream that is late by less than this (100 ms) catches up, one
/// message per poll. More is dropped; otherwise a burst would follow a stall.
const DUE: u16 = 1_563;

/// The value of [`Slot::left`] of a stream that becomes due with the next sweep.
const FRESH: u16 = u16::MAX;

/// Instead of the units until a stream is due: there is none.
const NONE: u16 = u16::MAX;

/// The time after which a RADIO_STATUS is ignored: five seconds, in units of 1,024 µs.
const RADIO_STALE: u32 = 4_883;

/// The least time between two changes of the delay, in the same units (100 ms): ExpressLRS sends 90 RADIO_STATUS a second, and
/// would otherwise switch the streams between full rate and almost none.
const RADIO_STEP: u32 = 98;

/// The step (µs) of the delay that a radio with a full buffer adds to all intervals, and the maximum number of steps.
const STEP: u32 = 20_000;
const MAX_SLOWDOWN: u8 = 100;

/// While a client transfers a file, streams have so many times their intervals, as ArduPilot's do (F-11); those of less than two
/// seconds have at most four seconds (µs), which their units can count.
const SLOWED: u32 = 4;
const LONGEST_FAST: u32 = 4_000_000;

/// Pending requests for intervals on a link.
const INTERVAL_REQUESTS: usize = 4;

/// One stream on one link.
#[derive(Clone, Copy, Debug)]
pub struct Slot {
    /// The code of the interval; 0 is the stream's default.
    interval: u16,
    /// The time until it is due, counted down with each sweep, so a pause of any length does no harm.
    left: u16,
}

impl Slot {
    /// The default interval, due at once. All zero bits.
    pub(super) const NEW: Self = Self { interval: 0, left: 0 };

    /// Sets the interval of the stream (µs); 0 is its default, `None` stops it. [`Streams::refresh`] takes it up.
    pub(super) fn set_interval(&mut self, interval: Option<u32>) {
        self.interval = match interval {
            None => OFF,
            Some(0) => 0,
            Some(interval) => code_of(interval),
        };
        self.left = FRESH;
    }

    /// Returns the interval (µs) of `stream`, to which this slot belongs; `None` if it is off.
    pub(super) fn interval(&self, stream: &Stream, profile: StreamProfile) -> Option<u32> {
        match self.interval {
            0 => Some(stream.default_interval(profile)).filter(|&interval| interval != 0),
            OFF => None,
            code => Some(interval_of(code)),
        }
    }
}

/// Encodes an interval (µs) that is within the bounds. Whole rates and up to four digits are exact. Others are rounded
/// up by less than a thousandth.
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

/// Decodes an interval (µs).
fn interval_of(code: u16) -> u32 {
    match u32::from(code).checked_sub(u32::from(MAX_RATE).wrapping_add(1)) {
        None => 1_000_000u32.checked_div(u32::from(code)).unwrap_or(0),
        Some(code) => {
            let power = usize::try_from(code / SPAN).ok().and_then(|power| POWERS.get(power)).copied().unwrap_or(0);
            (code % SPAN).wrapping_add(DIGITS).wrapping_mul(power)
        }
    }
}

/// Returns the shift that converts a time or an interval (µs) to a stream's units.
fn shift_of(interval: u32) -> u32 {
    if interval < SLOW { 6 } else { 10 }
}

/// Returns the number of units between two moments. Consecutive calls lose no unit.
fn units(from: Instant, to: Instant, shift: u32) -> u16 {
    let (from, to) = (from.as_micros().wrapping_shr(shift), to.as_micros().wrapping_shr(shift));
    u16::try_from(to.saturating_sub(from)).unwrap_or(u16::MAX)
}

/// The streams of a link, except their slots, whose number the vehicle determines. Initially all zero bits.
#[derive(Clone, Debug)]
pub(super) struct Streams {
    /// A bit for each stream with a pending request.
    asked: u32,
    /// The stream that was requested with an index: its number in the table plus 1, or 0; and the index.
    indexed: u8,
    index: u16,
    /// Ids of messages whose MESSAGE_INTERVAL is pending.
    interval_requests: Vec<u16, INTERVAL_REQUESTS, u8>,
    /// The number in the table of the stream that the sweep sends next, plus 1; 0 between sweeps. And when the last sweep began.
    cursor: u8,
    swept: Instant,
    /// Added before an interval is rounded to units, in 256ths of a unit. It changes with each sweep, so that the
    /// rounding errors average out (dithering).
    dither: u8,
    /// When the next sweep has something to send; zero before the first. Of no use within a sweep.
    wake: Instant,
    /// The delay that a radio's full buffer adds to each interval, in [steps](STEP), and when the last RADIO_STATUS was
    /// received, in [`coarse`](Instant::coarse) time. Each sweep forgets a status that is too old.
    slowdown: u8,
    radio: u32,
}

impl Streams {
    pub(super) const fn new() -> Self {
        Self {
            asked: 0,
            indexed: 0,
            index: 0,
            interval_requests: Vec::new(),
            cursor: 0,
            swept: Instant::ZERO,
            dither: 0,
            wake: Instant::ZERO,
            slowdown: 0,
            radio: 0,
        }
    }

    /// Schedules each of `rows` once; without any, the message of the rows `all` with this index. Returns false if there is
    /// no room for another index.
    pub(super) fn ask(&mut self, rows: u32, all: u32, index: u16) -> bool {
        if rows != 0 {
            self.asked |= rows;
            return true;
        }
        let [number, ..] = all.trailing_zeros().to_le_bytes();
        let indexed = number.wrapping_add(1);
        let has_room = self.indexed == 0 || (self.indexed == indexed && self.index == index);
        if has_room {
            self.indexed = indexed;
            self.index = index;
        }
        has_room
    }

    /// Schedules each row whose bit is set once.
    pub(super) fn ask_all(&mut self, streams: u32) {
        self.asked |= streams;
    }

    /// Takes a requested row, and its index unless that is the row's instance.
    pub(super) fn take_asked(&mut self) -> Option<(usize, Option<u16>)> {
        if self.asked != 0 {
            let number = self.asked.trailing_zeros();
            self.asked &= self.asked.wrapping_sub(1);
            return Some((usize::try_from(number).unwrap_or(0), None));
        }
        let number = core::mem::take(&mut self.indexed).checked_sub(1)?;
        Some((usize::from(number), Some(self.index)))
    }

    /// Schedules a MESSAGE_INTERVAL for message `id`. Returns false if there is no room for it.
    pub(super) fn request_interval(&mut self, id: u16) -> bool {
        self.interval_requests.contains(&id) || self.interval_requests.push(id).is_ok()
    }

    /// Takes the oldest message whose MESSAGE_INTERVAL is pending.
    pub(super) fn take_interval_request(&mut self) -> Option<u16> {
        take_first(&mut self.interval_requests, |_| true)
    }

    /// Whether a MESSAGE_INTERVAL is pending.
    pub(super) fn has_interval_request(&self) -> bool {
        !self.interval_requests.is_empty()
    }

    /// Whether a requested message is pending.
    pub(super) fn is_asked(&self) -> bool {
        self.asked != 0 || self.indexed != 0
    }

    /// Handles a RADIO_STATUS: `free` is the free part of the radio's transmit buffer, in percent. Ignored
    /// [soon after](RADIO_STEP) the last one that was not.
    pub(super) fn on_radio(&mut self, now: Instant, free: u8) {
        if self.radio != 0 && now.coarse().wrapping_sub(self.radio) < RADIO_STEP {
            return;
        }
        self.forget_radio(now);
        let slowdown = self.slowdown;
        self.slowdown = match free {
            0..20 => slowdown.saturating_add(3).min(MAX_SLOWDOWN),
            20..50 => slowdown.saturating_add(1).min(MAX_SLOWDOWN),
            96.. => slowdown.saturating_sub(2),
            91.. => slowdown.saturating_sub(1),
            _ => slowdown,
        };
        self.radio = now.coarse();
    }

    fn forget_radio(&mut self, now: Instant) {
        if now.coarse().wrapping_sub(self.radio) > RADIO_STALE {
            self.slowdown = 0;
        }
    }

    /// Returns the delay that a radio's full buffer adds to each interval now (µs).
    pub(super) fn slowdown(&self, now: Instant) -> u32 {
        let is_stale = now.coarse().wrapping_sub(self.radio) > RADIO_STALE;
        if is_stale { 0 } else { u32::from(self.slowdown).wrapping_mul(STEP) }
    }

    /// Returns the number of the next stream to send. It is next due one interval after it was *due* now; `is_slowed`: after
    /// [some](SLOWED) more.
    pub(super) fn next_due(
        &mut self,
        now: Instant,
        table: &[Stream],
        slots: &mut [Slot],
        profile: StreamProfile,
        is_slowed: bool,
    ) -> Option<usize> {
        if self.cursor == 0 {
            if now < self.wake {
                return None;
            }
            self.begin_sweep(now, table, slots, profile);
        }
        let number = usize::from(self.cursor).checked_sub(1)?;
        let (stream, slot) = table.get(number).zip(slots.get_mut(number))?;
        self.schedule(slot, slot.interval(stream, profile)?, is_slowed);
        self.cursor = self.cursor.saturating_add(1);
        self.refresh(table, slots, profile);
        Some(number)
    }

    fn begin_sweep(&mut self, now: Instant, table: &[Stream], slots: &mut [Slot], profile: StreamProfile) {
        let (fine, coarse) = (units(self.swept, now, shift_of(0)), units(self.swept, now, shift_of(SLOW)));
        for (stream, slot) in table.iter().zip(&mut *slots) {
            let elapsed = if slot.interval(stream, profile).unwrap_or(0) < SLOW { fine } else { coarse };
            slot.left = match slot.left {
                FRESH => DUE,
                // The first sweep, or the first since a [pause](Self::pause).
                _ if self.wake == Instant::ZERO => DUE,
                left => left.saturating_sub(elapsed),
            };
        }
        self.forget_radio(now);
        self.cursor = 1;
        self.swept = now;
        self.dither = self.dither.wrapping_add(157);
        self.refresh(table, slots, profile);
    }

    /// Finds the stream that the sweep sends next; without one, ends the sweep, and schedules the next. Called after anything has
    /// changed.
    pub(super) fn refresh(&mut self, table: &[Stream], slots: &[Slot], profile: StreamProfile) {
        let reached = if self.cursor == 0 { u8::MAX } else { self.cursor };
        let (mut fast, mut slow) = (NONE, NONE);
        let mut number = 0u8;
        for (stream, slot) in table.iter().zip(slots) {
            number = number.saturating_add(1);
            let Some(interval) = slot.interval(stream, profile) else { continue };
            if slot.left <= DUE && number >= reached {
                self.cursor = number;
                return;
            }
            let ahead = if slot.left == FRESH { 0 } else { slot.left.saturating_sub(DUE) };
            let soonest = if interval < SLOW { &mut fast } else { &mut slow };
            *soonest = ahead.min(*soonest);
        }
        self.cursor = 0;
        // Each stream is sent once in a sweep, and there is one sweep at a time.
        let next_sweep = self.swept + Duration::from_micros(1);
        self.wake = self.due(fast, shift_of(0)).min(self.due(slow, shift_of(SLOW))).max(next_sweep);
    }

    /// Schedules a stream that is sent now: the interval (µs) after it was due.
    fn schedule(&self, slot: &mut Slot, interval: u32, is_slowed: bool) {
        let shift = shift_of(interval);
        // The delay at the beginning of the sweep.
        let slowdown = u32::from(self.slowdown).wrapping_mul(STEP);
        let dither = u32::from(self.dither).wrapping_shl(shift).wrapping_shr(8);
        let mut pause = interval.saturating_add(slowdown);
        if is_slowed {
            let longest = if interval < SLOW { LONGEST_FAST } else { MAX_INTERVAL };
            pause = pause.max(interval.saturating_mul(SLOWED).min(longest));
        }
        let next = pause.saturating_add(dither).wrapping_shr(shift);
        slot.left = slot.left.saturating_add(u16::try_from(next).unwrap_or(0));
    }

    /// Returns when a stream is due that was this many units `ahead` of the last sweep. `shift` selects the units.
    fn due(&self, ahead: u16, shift: u32) -> Instant {
        if ahead == NONE {
            return Instant::NEVER;
        }
        let due = self.swept.as_micros().wrapping_shr(shift).saturating_add(ahead.into()).wrapping_shl(shift);
        Instant::from_micros(due)
    }

    /// Pauses the streams, because no peer is alive. The next sweep begins when one is.
    pub(super) fn pause(&mut self) {
        self.cursor = 0;
        self.wake = Instant::ZERO;
    }

    /// Returns when a stream is due.
    pub(super) fn deadline(&self, now: Instant, table: &[Stream], slots: &[Slot], profile: StreamProfile) -> Instant {
        if self.cursor != 0 {
            return now;
        }
        // Before the first sweep, all streams are due.
        let has_stream = || table.iter().zip(slots).any(|(stream, slot)| slot.interval(stream, profile).is_some());
        if self.wake == Instant::ZERO && !has_stream() { Instant::NEVER } else { self.wake }
    }
}
