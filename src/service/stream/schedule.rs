//! The streams of one link: when each is due, and pending requests.
//!
//! Streams that are due are sent in sweeps through the table, each at most once per sweep. A sweep that found no more
//! room continues where it stopped. So a link that is too slow for all streams starves none: the fast ones slow down
//! first.

use core::num::{NonZeroU8, NonZeroU32, Saturating, Wrapping};

use heapless::Vec;

use super::table::{MAX_INTERVAL, Rows, Stream};
use crate::list::take_first;
use crate::time::{Duration, Instant};
use crate::types::StreamProfile;

/// The time after which a RADIO_STATUS is ignored: five seconds, in units of 1,024 µs.
const RADIO_STALE: Wrapping<u32> = Wrapping(4_883);

/// The least time between two changes of the delay, in the same units (100 ms): ExpressLRS sends 90 RADIO_STATUS a
/// second, and would otherwise switch the streams between full rate and almost none.
const RADIO_STEP: Wrapping<u32> = Wrapping(98);

/// The step (µs) of the delay that a radio with a full buffer adds to all intervals, and the maximum number of steps.
const STEP: u32 = 20_000;
const MAX_SLOWDOWN: Saturating<u8> = Saturating(100);

/// While a client transfers a file, streams have so many times their intervals, as ArduPilot's do (F-11). Those of less
/// than two seconds have at most four seconds (µs), which their units can count.
const SLOWED: u32 = 4;
const LONGEST_FINE: u32 = 4_000_000;

/// Instead of the units until a stream is due: there is none.
const NEVER: u16 = u16::MAX;

/// Pending requests for intervals on a link.
const INTERVAL_REQUESTS: usize = 4;

/// A row of the table, counted from 1: as an `Option`, it is a byte that is 0 for `None`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct RowNumber(NonZeroU8);

impl RowNumber {
    const FIRST: Self = Self(NonZeroU8::MIN);

    fn new(index: usize) -> Option<Self> {
        u8::try_from(index).ok().map(|index| Self(NonZeroU8::MIN.saturating_add(index)))
    }

    fn next(self) -> Self {
        Self(self.0.saturating_add(1))
    }

    fn index(self) -> usize {
        usize::from((Saturating(self.0.get()) - Saturating(1)).0)
    }
}

/// A pending MESSAGE_INTERVAL: for the id of a message, or for a row of another component of the firmware. No message
/// of `common` has an id like that of a row. In a firmware of several components, such ids of other dialects are
/// refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct IntervalRequest(pub(super) u16);

impl IntervalRequest {
    const FIRST_ROW: u16 = 0xFF00;

    /// Returns the request for a message; `None` if MESSAGE_INTERVAL, which has 16 bits, cannot hold its id.
    pub(super) fn of_message(id: u32) -> Option<Self> {
        u16::try_from(id).ok().map(Self)
    }

    pub(super) fn of_row(row: usize) -> Option<Self> {
        u8::try_from(row).ok().map(|row| Self(Self::FIRST_ROW | u16::from(row)))
    }

    /// Returns the row, unless it is for a message.
    pub(super) fn row(self) -> Option<usize> {
        let [page, row] = self.0.to_be_bytes();
        (page == 0xFF).then_some(usize::from(row))
    }
}

/// A requested row.
#[derive(Clone, Copy, Debug)]
pub(super) struct RequestedRow {
    pub(super) row: usize,
    /// The requested index, unless it is the row's instance.
    pub(super) index: Option<u16>,
}

/// The step of the dither at each sweep: odd, so that it takes all 256 values, and far from 0 and 256, so that
/// neighbours differ much.
const DITHER_STEP: u8 = 157;

/// The streams of a link: `S` is an array of slots, one for each row of the vehicle's table. The logic works on the
/// unsized form. Initially all zero bits.
#[derive(Debug)]
pub struct StreamLink<S: ?Sized = [Slot]> {
    /// The rows that are requested.
    requested: Rows,
    /// The row that is requested with an index that is not its instance, and the index.
    indexed: Option<RowNumber>,
    index: u16,
    interval_requests: Vec<IntervalRequest, INTERVAL_REQUESTS, u8>,
    /// The stream that the sweep sends next; `None` between sweeps.
    cursor: Option<RowNumber>,
    /// When the last sweep began.
    swept: Instant,
    /// Added before an interval is rounded to units, in 256ths of a unit. It changes with each sweep, so that the
    /// rounding errors average out (dithering).
    dither: Wrapping<u8>,
    /// When the next sweep has something to send; zero before the first. Of no use within a sweep.
    wake: Instant,
    /// The delay that a radio's full buffer adds to each interval, in [steps](STEP).
    slowdown: Saturating<u8>,
    /// When the last RADIO_STATUS was received, in [`coarse`](Instant::coarse) time. Each sweep forgets one that is too
    /// old.
    radio: Wrapping<u32>,
    pub(super) slots: S,
}

impl<const N: usize> StreamLink<[Slot; N]> {
    pub(super) const NEW: Self = Self {
        requested: Rows::NONE,
        indexed: None,
        index: 0,
        interval_requests: Vec::new(),
        cursor: None,
        swept: Instant::ZERO,
        dither: Wrapping(0),
        wake: Instant::ZERO,
        slowdown: Saturating(0),
        radio: Wrapping(0),
        slots: [Slot::NEW; N],
    };
}

impl StreamLink {
    /// Schedules each of `rows` once.
    pub(super) fn request(&mut self, rows: Rows) {
        self.requested = self.requested.with(rows);
    }

    /// Schedules a row once, with an index that is not its instance. Returns false if another such request is pending.
    pub(super) fn request_index(&mut self, row: usize, index: u16) -> bool {
        let row = RowNumber::new(row);
        let has_room = self.indexed.is_none() || (self.indexed == row && self.index == index);
        if has_room {
            self.indexed = row;
            self.index = index;
        }
        has_room
    }

    /// Takes a requested row.
    pub(super) fn take_requested(&mut self) -> Option<RequestedRow> {
        if let Some(row) = self.requested.take_first() {
            return Some(RequestedRow { row, index: None });
        }
        Some(RequestedRow { row: self.indexed.take()?.index(), index: Some(self.index) })
    }

    /// Whether a requested message is pending.
    pub(super) fn has_requested(&self) -> bool {
        !self.requested.is_empty() || self.indexed.is_some()
    }

    /// Schedules a MESSAGE_INTERVAL. Returns false if there is no room for it.
    pub(super) fn request_interval(&mut self, request: IntervalRequest) -> bool {
        self.interval_requests.contains(&request) || self.interval_requests.push(request).is_ok()
    }

    /// Takes the oldest pending MESSAGE_INTERVAL.
    pub(super) fn take_interval_request(&mut self) -> Option<IntervalRequest> {
        take_first(&mut self.interval_requests, |_| true)
    }

    /// Whether a MESSAGE_INTERVAL is pending.
    pub(super) fn has_interval_request(&self) -> bool {
        !self.interval_requests.is_empty()
    }

    /// Handles a RADIO_STATUS: `free` is the free part of the radio's transmit buffer, in percent. Ignored
    /// [soon after](RADIO_STEP) the last one that was not.
    pub(super) fn on_radio(&mut self, now: Instant, free: u8) {
        if self.radio.0 != 0 && self.radio_age(now) < RADIO_STEP {
            return;
        }
        self.forget_radio(now);
        match free {
            0..20 => self.slowdown = (self.slowdown + Saturating(3)).min(MAX_SLOWDOWN),
            20..50 => self.slowdown = (self.slowdown + Saturating(1)).min(MAX_SLOWDOWN),
            96.. => self.slowdown -= 2,
            91.. => self.slowdown -= 1,
            _ => {}
        }
        self.radio = Wrapping(now.coarse());
    }

    /// Returns the time since the last RADIO_STATUS (1,024 µs).
    fn radio_age(&self, now: Instant) -> Wrapping<u32> {
        Wrapping(now.coarse()) - self.radio
    }

    fn forget_radio(&mut self, now: Instant) {
        if self.radio_age(now) > RADIO_STALE {
            self.slowdown = Saturating(0);
        }
    }

    /// Returns the delay that a radio's full buffer adds to an interval now (µs).
    pub(super) fn slowdown(&self, now: Instant, interval: u32, least_percent: u8) -> u32 {
        let delay = if self.radio_age(now) > RADIO_STALE { 0 } else { self.delay() };
        delay.min(longest_delay(interval, least_percent))
    }

    /// Returns the delay at the beginning of the sweep (µs), as far as a stream's interval allows it.
    fn delay(&self) -> u32 {
        u32::from(self.slowdown.0).saturating_mul(STEP)
    }

    /// Returns the row of the next stream to send. It is next due one interval after it was *due* now; `is_slowed`:
    /// after [some](SLOWED) more.
    pub(super) fn next_due(
        &mut self,
        now: Instant,
        table: &[Stream],
        profile: StreamProfile,
        least_percent: u8,
        is_slowed: bool,
    ) -> Option<usize> {
        if self.cursor.is_none() {
            if now < self.wake {
                return None;
            }
            self.begin_sweep(now, table, profile);
        }
        let (row, delay) = (self.cursor?, self.delay());
        let (stream, slot) = table.get(row.index()).zip(self.slots.get_mut(row.index()))?;
        let interval = slot.interval(stream, profile)?;
        let unit = Unit::of(interval);
        let mut pause = Saturating(interval) + Saturating(delay.min(longest_delay(interval, least_percent)));
        if is_slowed {
            let longest = if unit == Unit::Fine { LONGEST_FINE } else { MAX_INTERVAL };
            pause = pause.max((Saturating(interval) * Saturating(SLOWED)).min(Saturating(longest)));
        }
        pause += unit.part(self.dither.0);
        slot.postpone(u16::try_from(unit.count(u64::from(pause.0))).unwrap_or(0));
        self.cursor = Some(row.next());
        self.refresh(table, profile);
        Some(row.index())
    }

    fn begin_sweep(&mut self, now: Instant, table: &[Stream], profile: StreamProfile) {
        let [fine, coarse] = [Unit::Fine, Unit::Coarse].map(|unit| unit.between(self.swept, now));
        // No sweep is scheduled before the first one, and after `pause`.
        let is_first = self.wake == Instant::ZERO;
        for (stream, slot) in table.iter().zip(&mut self.slots) {
            let elapsed = match Unit::of(slot.interval(stream, profile).unwrap_or(0)) {
                Unit::Fine => fine,
                Unit::Coarse => coarse,
            };
            slot.count_down(elapsed, is_first);
        }
        self.forget_radio(now);
        self.cursor = Some(RowNumber::FIRST);
        self.swept = now;
        self.dither += DITHER_STEP;
        self.refresh(table, profile);
    }

    /// Finds the stream that the sweep sends next; without one, ends the sweep, and schedules the next. Called after
    /// anything has changed.
    pub(super) fn refresh(&mut self, table: &[Stream], profile: StreamProfile) {
        let reached = self.cursor.map_or(usize::MAX, RowNumber::index);
        let (mut fine, mut coarse) = (NEVER, NEVER);
        for (row, (stream, slot)) in (0..table.len()).zip(table.iter().zip(&self.slots)) {
            let Some(interval) = slot.interval(stream, profile) else { continue };
            if slot.is_due() && row >= reached {
                self.cursor = RowNumber::new(row);
                return;
            }
            let soonest = match Unit::of(interval) {
                Unit::Fine => &mut fine,
                Unit::Coarse => &mut coarse,
            };
            *soonest = slot.ahead().min(*soonest);
        }
        self.cursor = None;
        // Each stream is sent once in a sweep, and there is one sweep at a time.
        let next_sweep = self.swept + Duration::from_micros(1);
        let due = |unit: Unit, ahead| if ahead == NEVER { Instant::NEVER } else { unit.later(self.swept, ahead) };
        self.wake = due(Unit::Fine, fine).min(due(Unit::Coarse, coarse)).max(next_sweep);
    }

    /// Pauses the streams, because no peer is alive. The next sweep begins when one is.
    pub(super) fn pause(&mut self) {
        self.cursor = None;
        self.wake = Instant::ZERO;
    }

    /// Returns when a stream is due.
    pub(super) fn deadline(&self, now: Instant, table: &[Stream], profile: StreamProfile) -> Instant {
        if self.cursor.is_some() {
            return now;
        }
        // Before the first sweep, all streams are due.
        let has_stream =
            || table.iter().zip(&self.slots).any(|(stream, slot)| slot.interval(stream, profile).is_some());
        if self.wake == Instant::ZERO && !has_stream() { Instant::NEVER } else { self.wake }
    }
}

/// Returns the longest delay (µs) that leaves a stream this percentage of its rate, whatever RADIO_STATUS says.
fn longest_delay(interval: u32, least_percent: u8) -> u32 {
    let percent = u32::from(least_percent).clamp(1, 100);
    interval.saturating_mul(100_u32.saturating_sub(percent)).checked_div(percent).unwrap_or(0)
}

/// An interval is stored as a code. Up to this code, it is the interval's whole rate (Hz). Larger codes are four digits
/// and a power of ten. So whole rates and up to four digits are exact. Others are rounded up by less than a thousandth.
const MAX_RATE: u16 = 1_000;
/// The first code with digits.
const FIRST: u32 = 1_001;
/// The smallest digits, and the number of codes of each power.
const DIGITS: u32 = 1_000;
const SPAN: u32 = 12_800;
const POWERS: [u32; 5] = [1, 10, 100, 1_000, 10_000];

/// The code of a stream that is off, and of one with its default interval.
const OFF: u16 = u16::MAX;
const DEFAULT: u16 = 0;

/// The unit in which a stream counts time, so that 16 bits hold an interval and the delay of a radio.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unit {
    /// 64 µs, for intervals of less than two seconds.
    Fine,
    /// 1,024 µs.
    Coarse,
}

impl Unit {
    /// Returns the unit of a stream with this interval (µs).
    pub(super) const fn of(interval: u32) -> Self {
        if interval < 2_000_000 { Self::Fine } else { Self::Coarse }
    }

    /// Returns a time (µs) in units, rounded down.
    pub(super) const fn count(self, micros: u64) -> u64 {
        match self {
            Self::Fine => micros >> 6,
            Self::Coarse => micros >> 10,
        }
    }

    /// Returns the units between two moments. Consecutive calls lose no unit.
    pub(super) fn between(self, from: Instant, to: Instant) -> u16 {
        let units = Saturating(self.count(to.as_micros())) - Saturating(self.count(from.as_micros()));
        u16::try_from(units.0).unwrap_or(u16::MAX)
    }

    /// Returns the moment this many units after another, which is rounded down to whole units.
    pub(super) fn later(self, from: Instant, units: u16) -> Instant {
        let units = (Saturating(self.count(from.as_micros())) + Saturating(u64::from(units))).0;
        Instant::from_micros(match self {
            Self::Fine => units << 6,
            Self::Coarse => units << 10,
        })
    }

    /// Returns this many 256ths of a unit (µs).
    pub(super) fn part(self, parts: u8) -> u32 {
        match self {
            Self::Fine => u32::from(parts) >> 2,
            Self::Coarse => u32::from(parts) << 2,
        }
    }
}

/// One stream on one link.
#[derive(Clone, Copy, Debug)]
pub struct Slot {
    /// The code of the interval.
    interval: u16,
    /// The time until it is due, in its [`Unit`], counted down with each sweep. So a pause of any length does no harm.
    left: Saturating<u16>,
}

impl Slot {
    /// The default interval, due at once. All zero bits.
    pub(super) const NEW: Self = Self { interval: DEFAULT, left: Saturating(0) };

    /// The time left when a stream is due. A stream that is late by less than this (100 ms) catches up, one message per
    /// poll. More is dropped; otherwise a burst would follow a stall.
    const DUE: Saturating<u16> = Saturating(1_563);

    /// The time left of a stream that becomes due with the next sweep.
    const FRESH: Saturating<u16> = Saturating(u16::MAX);

    /// Sets the interval of the stream (µs); 0 is its default, `None` stops it. A refresh must follow.
    pub(super) fn set_interval(&mut self, interval: Option<u32>) {
        self.interval = match interval {
            None => OFF,
            Some(0) => DEFAULT,
            Some(interval) => code_of(interval),
        };
        self.left = Self::FRESH;
    }

    /// Returns the interval (µs) of `stream`, to which this slot belongs; `None` if it is off.
    pub(super) fn interval(&self, stream: &Stream, profile: StreamProfile) -> Option<u32> {
        match self.interval {
            DEFAULT => Some(stream.default_interval(profile)).filter(|interval| *interval != 0),
            OFF => None,
            code => Some(interval_of(code)),
        }
    }

    /// Whether it is due in this sweep.
    pub(super) fn is_due(&self) -> bool {
        self.left <= Self::DUE
    }

    /// Returns the units from the last sweep until it is due.
    pub(super) fn ahead(&self) -> u16 {
        if self.left == Self::FRESH { 0 } else { (self.left - Self::DUE).0 }
    }

    /// Counts down at the beginning of a sweep. In the `first` one, every stream is due.
    pub(super) fn count_down(&mut self, elapsed: u16, is_first: bool) {
        self.left = if is_first || self.left == Self::FRESH { Self::DUE } else { self.left - Saturating(elapsed) };
    }

    /// Schedules the next message this many units after this one was due.
    pub(super) fn postpone(&mut self, units: u16) {
        self.left += units;
    }
}

/// Encodes an interval (µs) that is within the bounds.
fn code_of(interval: u32) -> u16 {
    if let Some(rate) = rate_of(interval) {
        return u16::try_from(rate).unwrap_or(MAX_RATE);
    }
    let (mut digits, mut first) = (interval, Saturating(FIRST));
    while digits >= const { DIGITS + SPAN } {
        digits = digits.div_ceil(10);
        first += SPAN;
    }
    u16::try_from((first + Saturating(digits) - Saturating(DIGITS)).0).unwrap_or(OFF)
}

/// Returns the rate (Hz) whose interval is this (µs), if it is whole.
fn rate_of(interval: u32) -> Option<u32> {
    let rate = NonZeroU32::new(1_000_000 / NonZeroU32::new(interval)?)?;
    (1_000_000 / rate == interval).then_some(rate.get())
}

/// Decodes an interval (µs).
fn interval_of(code: u16) -> u32 {
    let code = u32::from(code);
    let Some(code) = code.checked_sub(FIRST) else {
        return NonZeroU32::new(code).map_or(0, |rate| 1_000_000 / rate);
    };
    let power = usize::try_from(code / SPAN).ok().and_then(|power| POWERS.get(power)).copied().unwrap_or(0);
    ((Saturating(code % SPAN) + Saturating(DIGITS)) * Saturating(power)).0
}
