//! PING and TIMESYNC: how long a frame takes, and how two clocks compare.
//!
//! Implements <https://mavlink.io/en/services/ping.html> and <https://mavlink.io/en/services/timesync.html>, rules T-1 and
//! T-2. Both are questions that come back to who asked; what is neither a question nor the answer to one of ours is
//! dropped, or two components would answer each other for ever. Not over a high-latency link (T-3).

use core::ops::{Deref, DerefMut};

pub use super::clock::ClockFilter;
pub use super::wall_clock::WallClock;
use crate::dialect::{Ping, Timesync};
use crate::frame::{Address, Frame};
use crate::link::{LinkId, Outbox, Peer, Port};
use crate::time::Instant;
use crate::vehicle::Vehicle;

/// Questions that can wait on one link.
const SLOTS: usize = 2;

/// The vehicle's memory for the time service on `LINKS` links: see [`TimeSync`].
pub type TimeSlots<const LINKS: usize> = TimeSync<[TimeSlot; LINKS]>;

/// What a [`TimeSync`] keeps for one link.
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TimeSlot {
    questions: [Question; SLOTS],
    /// Whether a question of our own is to be sent.
    asks: bool,
    /// TIMESYNC.ts1 of the last one sent (ns); 0 for none.
    asked: i64,
}

/// Somebody's question.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Question {
    kind: Kind,
    from: Address,
    seq: u32,
    /// His clock: PING.time_usec, or TIMESYNC.ts1.
    time: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum Kind {
    None,
    Ping,
    Timesync,
}

impl TimeSlot {
    /// All zero bits.
    const EMPTY: Self = Self {
        questions: [Question { kind: Kind::None, from: Address::new(0, 0), seq: 0, time: 0 }; SLOTS],
        asks: false,
        asked: 0,
    };
}

/// How another clock compares with ours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TimeSample {
    /// Whose clock.
    pub from: Peer,
    /// When the answer came, by our clock.
    pub at: Instant,
    /// What his clock is ahead of ours (ns), if the question took as long as the answer; wrong by half of
    /// [`round_trip_ns`](Self::round_trip_ns) at most.
    pub offset_ns: i64,
    /// From the question to the answer (ns): the shorter, the better the sample.
    pub round_trip_ns: i64,
}

/// The vehicle's memory for PING and TIMESYNC. The vehicle keeps it and hands it to the stack by
/// [`Vehicle::time_sync`](crate::Vehicle::time_sync); one that does not pays nothing.
///
/// Each link has room for two questions; another one that comes meanwhile is dropped and counted
/// ([`LinkCounters::no_answer_slot`](crate::LinkCounters::no_answer_slot)).
///
/// ```
/// use mavstack::{LinkId, TimeSlots, TimeSync, Vehicle, VehicleState};
///
/// struct Rover { time: TimeSlots<2> }
///
/// impl Vehicle for Rover {
///     fn state(&self) -> Option<VehicleState> {
///         None
///     }
///
///     fn time_sync(&mut self) -> Option<&mut TimeSync> {
///         Some(&mut self.time)
///     }
/// }
///
/// let mut rover = Rover { time: TimeSlots::new() };
/// // Now and then, by the flight loop:
/// rover.time.ask(LinkId(1));
/// if let Some(sample) = rover.time.take_sample() {
///     let _ = (sample.offset_ns, sample.round_trip_ns);
/// }
/// ```
#[derive(Clone, Debug)]
pub struct TimeSync<S: ?Sized = [TimeSlot]> {
    sample: Option<TimeSample>,
    links: S,
}

impl<const LINKS: usize> TimeSync<[TimeSlot; LINKS]> {
    /// Nothing asked. Links from number `LINKS` on are not served.
    pub const fn new() -> Self {
        const { assert!(LINKS > 0, "time memory needs a link: TimeSlots<1>, or leave `time_sync` out") };
        Self { sample: None, links: [TimeSlot::EMPTY; LINKS] }
    }
}

impl<const LINKS: usize> Default for TimeSync<[TimeSlot; LINKS]> {
    fn default() -> Self {
        Self::new()
    }
}

/// The logic works on the unsized form, so the number of links is compiled once.
impl<const LINKS: usize> Deref for TimeSync<[TimeSlot; LINKS]> {
    type Target = TimeSync;

    fn deref(&self) -> &TimeSync {
        self
    }
}

impl<const LINKS: usize> DerefMut for TimeSync<[TimeSlot; LINKS]> {
    fn deref_mut(&mut self) -> &mut TimeSync {
        self
    }
}

/// What became of a frame.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Taken {
    /// It is none of ours.
    No,
    Yes,
    /// It found no room.
    NoRoom,
}

impl TimeSync {
    /// Sends a TIMESYNC on `link` to whoever answers, which is nobody on a high-latency link (T-2, T-3).
    pub fn ask(&mut self, link: LinkId) {
        if let Some(slot) = self.links.get_mut(usize::from(link.0)) {
            slot.asks = true;
        }
    }

    /// The newest answer to a question of ours, once. A [`ClockFilter`](crate::ClockFilter) makes a clock of many.
    #[must_use = "the sample is taken out"]
    pub fn take_sample(&mut self) -> Option<TimeSample> {
        self.sample.take()
    }

    fn on_frame(&mut self, now: Instant, link: LinkId, frame: &Frame<'_>) -> Taken {
        let from = frame.source();
        let question = if let Some(ping) = frame.decode::<Ping>() {
            // One with a target is an answer (T-1).
            let is_question = ping.target_system == 0 && ping.target_component == 0;
            is_question.then_some(Question { kind: Kind::Ping, from, seq: ping.seq, time: ping.time_usec })
        } else if let Some(sync) = frame.decode::<Timesync>() {
            if sync.tc1 != 0 {
                self.on_answer(now, Peer { address: from, link }, &sync);
            }
            let time = sync.ts1.cast_unsigned();
            (sync.tc1 == 0).then_some(Question { kind: Kind::Timesync, from, seq: 0, time })
        } else {
            return Taken::No;
        };
        let Some(question) = question else { return Taken::Yes };
        let slot = self.links.get_mut(usize::from(link.0));
        let place = slot.and_then(|slot| slot.questions.iter_mut().find(|place| place.kind == Kind::None));
        let Some(place) = place else { return Taken::NoRoom };
        *place = question;
        Taken::Yes
    }

    /// Somebody's answer: to us, when it bears the time that we asked at (T-2).
    fn on_answer(&mut self, now: Instant, from: Peer, sync: &Timesync) {
        let asked = self.links.get(usize::from(from.link.0)).map_or(0, |slot| slot.asked);
        if asked == 0 || sync.ts1 != asked {
            return;
        }
        let round_trip_ns = nanos(now).wrapping_sub(asked);
        self.sample = Some(TimeSample {
            from,
            at: now,
            offset_ns: sync.tc1.wrapping_sub(asked.wrapping_add(round_trip_ns / 2)),
            round_trip_ns,
        });
    }

    fn next(&mut self, now: Instant, tx: &mut Outbox) -> bool {
        let Some(slot) = self.links.get_mut(usize::from(tx.link().0)) else { return false };
        if let Some(question) = slot.questions.iter_mut().find(|question| question.kind != Kind::None) {
            let Question { kind, from, seq, time } = *question;
            question.kind = Kind::None;
            let (target_system, target_component) = (from.system.0, from.component.0);
            return match kind {
                Kind::Ping => tx.send(&Ping { time_usec: time, seq, target_system, target_component }),
                _ => tx.send(&Timesync { tc1: nanos(now), ts1: time.cast_signed(), target_system, target_component }),
            };
        }
        if !core::mem::take(&mut slot.asks) {
            return false;
        }
        slot.asked = nanos(now);
        tx.send(&Timesync { tc1: 0, ts1: slot.asked, target_system: 0, target_component: 0 })
    }
}

/// Nanoseconds since boot, which last 292 years; never 0, which would make an answer a question.
fn nanos(now: Instant) -> i64 {
    now.as_micros().wrapping_mul(1_000).cast_signed().max(1)
}

/// Takes PING and TIMESYNC, where the vehicle has a memory for them. False for other messages, and where it has none.
#[inline(never)]
pub(crate) fn on_frame(now: Instant, port: &mut Port, frame: &Frame<'_>, vehicle: &mut impl Vehicle) -> bool {
    let Some(time) = vehicle.time_sync() else { return false };
    let taken = time.on_frame(now, port.id, frame);
    if taken == Taken::NoRoom {
        port.counters.no_answer_slot = port.counters.no_answer_slot.wrapping_add(1);
    }
    taken != Taken::No
}

/// Sends an answer, or a question of the vehicle's own: at once, since it measures time. False when there is none.
pub(crate) fn next(now: Instant, port: &mut Port, vehicle: &mut impl Vehicle) -> bool {
    vehicle.time_sync().is_some_and(|time| time.next(now, &mut port.outbox))
}
