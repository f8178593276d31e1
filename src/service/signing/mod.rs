//! Message signing: proves that a frame's sender has the key and that the frame is not replayed.
//!
//! Implements <https://mavlink.io/en/guide/message_signing.html>, rules G-1 to G-18 and SEC-5 to SEC-7.
//! [`Signing`] describes how a frame is judged.

mod gate;
#[cfg(feature = "storage")]
mod saving;
mod setup;
mod streams;
#[cfg(test)]
mod tests;
mod timestamp;
#[cfg(not(feature = "storage"))]
mod unsaved;

#[cfg(feature = "storage")]
use saving::Saving;
pub use streams::SigningStream;
#[cfg(not(feature = "storage"))]
use unsaved::Saving;

use core::num::NonZeroU64;
use core::ops::{Deref, DerefMut};

use self::streams::{NewStream, Stale};
use self::timestamp::{RunningTime, Timestamp};
use super::increment;
use crate::frame::{Frame, SigningKey};
use crate::message::SystemId;
use crate::time::{Clock, Duration, Instant};
use crate::types::{Accept, LinkSigning, SignedAt};

counters! {
    /// Counters of accepted and refused frames, on all links. They wrap.
    SigningCounters {
        /// Frames with a correct signature that are newer than those before them.
        count verified,
        /// Unsigned frames on a link that does not accept them, including those of MAVLink 1 (G-9). As long as there is
        /// no key, also signed frames on such a link, because nothing can verify them.
        drop unsigned,
        /// Frames whose signature was made with another key or for other bytes (G-10); the two cannot be distinguished.
        drop bad_signature,
        /// Frames with a correct signature that are not newer than the last one of their stream (G-6).
        drop replayed,
        /// Frames with a correct signature that would begin a stream, but are more than a minute old (G-6), or from
        /// before a restart.
        drop too_old,
        /// Frames with a correct signature and a timestamp more than [ten minutes](crate::Config::max_signing_lead)
        /// ahead of the time set by the vehicle. A text names the system. Also frames with the last 48-bit timestamp,
        /// which has no successor (G-17).
        drop too_far_ahead,
        /// Frames with a correct signature that would begin a stream, for which the table has no room (G-8).
        drop no_stream_slot,
        /// Calls of [`set_time`](Signing::set_time) that were refused because the time was too far ahead (G-14).
        drop refused_times,
        /// SETUP_SIGNING messages that were executed.
        count setups,
        /// SETUP_SIGNING messages that were accepted on their link, but not executed: a text says why (G-11).
        drop refused_setups,
    }
}

/// Signing: the key, the time, and the timestamps of each sender. Declared by `signing` in
/// [`#[stack]`](macro@crate::Stack), and reached through [`Stack::signing`](crate::Stack::signing).
/// [`LinkSigning`](crate::signing::LinkSigning) configures each link. Without a key, nothing is signed or verified.
///
/// Key and time survive a restart in a `SigningStore` (feature `storage`), or in the firmware's own storage. The
/// firmware then stores [`timestamp`](Self::timestamp) plus a minute, at least once a minute.
///
/// ```
/// use mavstack::signing::SigningKey;
/// # use mavstack::prelude::*;
/// # use mavstack::dialect;
/// # struct Rover;
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { dialect::MavResult::UNSUPPORTED.into() }
/// # }
/// #[derive(Stack)]
/// #[stack(vehicle: Rover, links: 2, signing: { streams: 16 })]
/// struct Mavlink;
///
/// fn configure(stack: &mut StackOf<Mavlink>) {
///     // At startup, unless the key is stored:
///     stack.signing_mut().set_key(Instant::ZERO, SigningKey::new([0x42; 32]), 0);
///     // On the ground, when the GNSS receiver knows the time:
///     let unix_usec = 1_750_000_000_000_000;
///     assert!(stack.signing_mut().set_time(Instant::from_millis(2_000), unix_usec, Duration::MAX));
/// }
/// ```
///
/// # How a frame is judged
///
/// A received frame is judged before any service sees it:
///
/// ```text
///   frame ──▶ signed, and there is a key? ── no ──▶ unsigned ──▶ does this link accept it? ── no ──▶ refused
///                     │ yes                                          │ yes
///                     ▼                                              ▼
///             right signature? ── yes ──▶ newer than all before it,  ── yes ──▶ served; its time is ours at least
///                     │ no                at most ten minutes ahead?
///                     │                              │ no
///                     ▼                              ▼
///               bad signature         replayed, too old, too far ahead, no place
/// ```
///
/// - **A frame that is not accepted** changes nothing: no answer, no peer, no time. It is counted by its reason. If
///   forwarding is declared, it is forwarded to the links that would not accept it unsigned either (R-10).
/// - **Time** is the same for all links. It runs with the clock, and starts at the stored time. A correct signature,
///   the vehicle ([`set_time`](Signing::set_time)) and a key's timestamp move it forward (G-6, G-14). Only another key
///   can move it back; until then no timestamp is sent twice.
/// - **The future is bounded** (G-17). Once the vehicle has set the time since the start, a frame from more than [ten
///   minutes](crate::Config::max_signing_lead) ahead of that is refused, and a text names its system. Otherwise one
///   peer with a wrong clock could shut out every peer with a right one. Stored times and a key's time set no bound,
///   because a vehicle without a clock may restart days later. The bound also does not apply while our own time is
///   further than that ahead of the time that the vehicle set. It would shut out the peers that follow our time, and
///   let in nobody else.
/// - **Streams**: a stream is identified by its sender and the sender's link id. Each frame of a known stream must be
///   newer than the one before. A new stream may begin a minute behind the time that the vehicle set, or behind our
///   time until it has set one. So a peer with a wrong clock shuts out no right one, even if it was heard first. A
///   frame from beyond the bound on the future begins a stream at most a minute behind our time. A full table evicts a
///   stream that was silent for more than a minute (G-8). So `streams` in [`#[stack]`](macro@crate::Stack) bounds how
///   many streams are accepted at a time, and a holder of the key shuts nobody out for longer than that.
/// - **The same key again** moves the time forward to the timestamp that comes with it, never back. Streams stay as
///   they are.
/// - **Another key** starts with the timestamp that comes with it, and without streams. So a new key repairs a time
///   that was moved too far ahead, even after a restart. The time that the vehicle set since the start still counts:
///   our time starts no earlier than that.
///
/// The last 48-bit timestamp, in 2104, has no successor, so it is never accepted. Once our own time has reached it,
/// links that sign send unsigned frames until another key is set: a timestamp is never sent twice.
///
/// # Limits of replay protection
///
/// Recorded signed frames can be accepted again in these cases:
///
/// - **A key that is set again.** A key that is set after another key, or after none, counts as another key, because
///   the one before was forgotten. So frames that were recorded with it are accepted again if they are at most a minute
///   older than the time that the vehicle set. Until it has set one, its new timestamp counts instead: one of a minute
///   from now leaves no window.
/// - **A restart.** Streams are forgotten, and time begins where it was last stored, up to a minute ahead of that
///   moment (G-15). So frames that were accepted since, and in the minute before, may be accepted again. By default
///   nothing is stored while the vehicle is armed: after a restart in flight, these are all frames since take-off.
///   [`set_time`](Signing::set_time), called before frames are received, narrows this to the last minute.
/// - **The first key.** Frames that were handled unverified, because there was no key, belong to no stream. Those that
///   were signed with the key that is set next may be handled again for a minute.
///
/// [`refuse_recorded`](Signing::refuse_recorded) closes these windows if our time is right. After a restart in flight
/// the stored time is not right, so there it only helps after `set_time`. It does not help against a frame that an
/// attacker withheld from the vehicle, because that is not a replay. A known stream accepts such a frame, however late,
/// until a newer one is received (see [`Signing::age`]).
///
/// # Setting the key
///
/// The firmware ([`Signing::set_key`]) or SETUP_SIGNING on a provisioning link sets the key (G-11). SETUP_SIGNING is
/// refused, with a text and a counter, if its timestamp is more than ten minutes ahead of the time set by the vehicle
/// and also ahead of our time. Until the vehicle has set the time, any timestamp is accepted.
#[derive(Clone)]
pub struct Signing<S: ?Sized = [SigningStream]> {
    key: Option<SigningKey>,
    /// Our time, unless [`last`](Self::last) is later.
    our_time: RunningTime,
    /// The last timestamp that was sent. Time never falls behind it.
    last: Timestamp,
    /// The earliest timestamp with which a new stream may begin.
    floor: Timestamp,
    /// The latest time that the vehicle set since the start.
    vehicle_time: Option<RunningTime>,
    /// How far a peer's clock may be ahead of that.
    max_lead: Duration,
    /// The latest time in signatures of peers on normal links.
    peers_time: Option<RunningTime>,
    /// The system whose clock was last found to be too far ahead, until a text says so.
    ahead: Option<SystemId>,
    /// The earliest time of the next such text.
    text_from: Instant,
    /// The stack's clock, as of the last poll: the firmware's may be set back (X-7).
    clock: Clock,
    counters: SigningCounters,
    saving: Saving,
    streams: S,
}

impl<const STREAMS: usize> Signing<[SigningStream; STREAMS]> {
    /// Returns signing without a key: nothing is signed, and nothing can be verified.
    pub const fn new() -> Self {
        const {
            assert!(
                STREAMS > 0,
                "`signing` needs room for a stream, or no sender could ever be verified: `signing: {{ streams: 16 }}`"
            );
        }
        Self {
            key: None,
            our_time: RunningTime::NEW,
            last: Timestamp::ZERO,
            floor: Timestamp::ZERO,
            vehicle_time: None,
            max_lead: Duration::ZERO,
            peers_time: None,
            ahead: None,
            text_from: Instant::ZERO,
            clock: Clock::NEW,
            counters: SigningCounters::ZERO,
            saving: Saving::NEW,
            streams: [SigningStream::NONE; STREAMS],
        }
    }
}

impl<const STREAMS: usize> Default for Signing<[SigningStream; STREAMS]> {
    fn default() -> Self {
        Self::new()
    }
}

/// The logic works on the unsized form, so the number of streams is compiled once.
impl<const STREAMS: usize> Deref for Signing<[SigningStream; STREAMS]> {
    type Target = Signing;

    fn deref(&self) -> &Signing {
        self
    }
}

impl<const STREAMS: usize> DerefMut for Signing<[SigningStream; STREAMS]> {
    fn deref_mut(&mut self) -> &mut Signing {
        self
    }
}

/// Shows neither the key nor the time.
impl<S: ?Sized> core::fmt::Debug for Signing<S> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Signing")
            .field("is_active", &self.key.is_some())
            .field("counters", &self.counters)
            .finish_non_exhaustive()
    }
}

/// The result of judging a frame's signature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// Correct and new.
    Verified(Timestamp),
    /// The frame is unsigned, or there is no key.
    Unsigned,
    /// Not signed with our key. Counted.
    Forged,
    /// Correct, but the frame is too old or too far ahead. Counted.
    Stale,
}

/// The times at one moment.
struct Times {
    ours: Timestamp,
    /// The latest time that the vehicle set.
    vehicle: Option<Timestamp>,
    max_lead: Duration,
}

impl Times {
    /// Whether a timestamp is too far ahead of the time that the vehicle set (G-17).
    fn is_beyond_bound(&self, timestamp: Timestamp) -> bool {
        self.vehicle.is_some_and(|vehicle| timestamp.since(vehicle) > self.max_lead)
    }

    /// Returns the time on which the window for new streams rests (G-17).
    fn base(&self) -> Timestamp {
        self.vehicle.unwrap_or(self.ours)
    }
}

impl Signing {
    /// Whether there is a key.
    pub const fn is_active(&self) -> bool {
        self.key.is_some()
    }

    /// Returns the counters.
    pub const fn counters(&self) -> SigningCounters {
        self.counters
    }

    /// Returns our time (10 µs since 2015-01-01 00:00 UTC, G-3), the minimum timestamp of the next signed frame. It is
    /// not the time of day: it continues from the stored time until the vehicle or a peer provides a later one.
    pub fn timestamp(&self, now: Instant) -> u64 {
        self.times(self.clock.peek(now)).ours.0
    }

    /// Returns our time and the vehicle's, by the stack's clock.
    fn times(&self, now: Instant) -> Times {
        let ours = self.unbounded_time(now).min(Timestamp::LAST);
        Times { ours, vehicle: self.vehicle_time.map(|time| time.at(now)), max_lead: self.max_lead }
    }

    /// Returns our time; a time beyond the last timestamp once that was used.
    fn unbounded_time(&self, now: Instant) -> Timestamp {
        self.last.max(self.our_time.at(now))
    }

    /// Signs with `key` from now on, and accepts frames that were signed with it (G-17).
    ///
    /// - The key that is in use: our time moves forward to `timestamp` (10 µs since 2015-01-01), never back.
    /// - Another key, also one that was in use before: our time starts at `timestamp`, or at the time that the vehicle
    ///   [set](Self::set_time) since the start if that is later; all streams are forgotten. [`Signing`] lists the
    ///   frames that can be replayed with a key that is set again; [`refuse_recorded`](Self::refuse_recorded) prevents
    ///   it.
    ///
    /// A `timestamp` of 2^48 - 1 or more counts as 0: it has no successor.
    pub fn set_key(&mut self, now: Instant, key: SigningKey, timestamp: u64) {
        self.replace_key(self.clock.peek(now), key, Timestamp(timestamp));
    }

    /// As [`set_key`](Self::set_key), by the stack's clock.
    fn replace_key(&mut self, now: Instant, key: SigningKey, timestamp: Timestamp) {
        let timestamp = if timestamp < Timestamp::LAST { timestamp } else { Timestamp::ZERO };
        let start = RunningTime::new(now, timestamp);
        if self.key.as_ref().is_some_and(|known| known.is_same(&key)) {
            self.our_time = self.our_time.max(start);
            self.saving.key_changed(false);
        } else {
            self.our_time = self.vehicle_time.map_or(start, |time| time.max(start));
            self.last = Timestamp::ZERO;
            self.floor = Timestamp::ZERO;
            self.peers_time = None;
            self.streams.fill(SigningStream::NONE);
            self.saving.key_changed(self.key.is_some());
        }
        self.key = Some(key);
        event!("signing: key set");
    }

    /// Stops signing and forgets the key. Whatever key is set next counts as [another key](Self::set_key).
    pub fn clear_key(&mut self) {
        self.saving.key_changed(self.key.is_some());
        self.key = None;
        event!("signing: off");
    }

    /// Sets the time: at `now` it is `unix_usec` µs since 1970-01-01 00:00 UTC. Moves our time forward to it (G-4),
    /// never back (G-14), and from then on [bounds](Signing) how far ahead a peer's clock may be (G-17). Returns true,
    /// without any effect, for a time earlier than one set before, and for a time before 2015, as from a clock that was
    /// never set.
    ///
    /// Returns false when our time would move by more than `max_step`, or would reach the last 48-bit timestamp. The
    /// call is then counted and has no effect (G-14).
    ///
    /// Only set a time that is known to be right. A wrong time shuts out the peers whose clocks are right:
    ///
    /// - A time in the past, for example of a clock that lost its battery. Unless our own time is later anyway, frames
    ///   of peers with right clocks are refused as [too far ahead](SigningCounters::too_far_ahead). SETUP_SIGNING with
    ///   a right timestamp is refused too. This lasts until the vehicle sets a right time, or restarts and sets no
    ///   wrong one. The right time is a step that `max_step` must allow.
    /// - A time in the future, for example from an attacker that spoofs a satellite signal. Frames of peers with right
    ///   clocks that begin a stream are refused as [too old](SigningCounters::too_old). Only a restart forgets the time
    ///   that was set. Our time then starts as stored, until there is another key.
    ///
    /// Trust a battery-backed clock that reports whether it kept running without a limit ([`Duration::MAX`]). Trust a
    /// satellite receiver by some days on the ground, and by some seconds in flight.
    pub fn set_time(&mut self, now: Instant, unix_usec: u64, max_step: Duration) -> bool {
        let now = self.clock.peek(now);
        let timestamp = Timestamp::from_unix(unix_usec);
        if timestamp.since(self.times(now).ours) > max_step || timestamp >= Timestamp::LAST {
            increment(&mut self.counters.refused_times);
            return false;
        }
        self.advance(now, timestamp);
        // A clock that was never set reports a time before 2015.
        if timestamp != Timestamp::ZERO {
            self.vehicle_time = self.vehicle_time.max(Some(RunningTime::new(now, timestamp)));
        }
        true
    }

    /// Refuses frames that were recorded before: a new stream must begin after our time, not up to a minute before it
    /// (stricter than G-6). Call this after `Stack::restore`, against frames recorded before a restart, and after
    /// [`set_key`](Self::set_key), against frames recorded with that key. It does not refuse recorded frames with
    /// timestamps later than our time, which are possible when a key is set with an early timestamp. If our time is
    /// more than [ten minutes](crate::Config::max_signing_lead) ahead of the time that the vehicle set, a new stream
    /// must begin after the latter: otherwise no peer with a right clock could begin one (G-17).
    ///
    /// After a restart in flight, our time begins where it was last stored: at take-off, by default. Then this only
    /// helps after [`set_time`](Self::set_time).
    ///
    /// The price: our time is up to a minute ahead after a restart. A peer that receives a signed frame of ours adopts
    /// our time, and is accepted from then on. A peer that does not, for example because the link does not sign, is
    /// accepted once its clock has reached our time.
    pub fn refuse_recorded(&mut self, now: Instant) {
        let times = self.times(self.clock.peek(now));
        let last_refused = if times.is_beyond_bound(times.ours) { times.base() } else { times.ours };
        self.floor = last_refused.next();
    }

    /// Returns how long ago a frame that the stack has accepted was signed (L-16): the current time minus its
    /// timestamp, or zero for a frame from the future. Returns `None` for an unsigned frame, without a key to verify
    /// it, and until the vehicle or a peer has provided the time since the start.
    ///
    /// The current time is the latest one from [`set_time`](Self::set_time), so a clock that is set back does not
    /// reduce an age. Until the vehicle has set the time, the current time is the latest timestamp that any peer sent
    /// on a normal link. The same holds when the vehicle's time is more than ten minutes behind that peer, as with a
    /// clock that was never set.
    ///
    /// It is not our own [time](Self::timestamp), which starts up to a minute ahead after a restart (G-15). A sender
    /// whose clock is behind makes its frames look older than they are; so does a peer whose clock is ahead, until the
    /// vehicle has set the time. A sender whose clock is ahead makes its frames look younger: by up to that minute if
    /// it follows our time and the vehicle's time is right. The signature alone does not bound the delay: a frame that
    /// begins a stream is at most a minute old, but a frame of a known stream can have any age (G-6).
    pub fn age(&self, now: Instant, frame: &Frame<'_>) -> Option<Duration> {
        self.age_at(self.clock.peek(now), frame)
    }

    /// As [`age`](Self::age), by the stack's clock.
    fn age_at(&self, now: Instant, frame: &Frame<'_>) -> Option<Duration> {
        let signed_at = Timestamp(self.signed_at(frame)?.get());
        let times = self.times(now);
        let peers = self.peers_time.map(|time| time.at(now));
        let time = peers.filter(|time| times.is_beyond_bound(*time)).or(times.vehicle).or(peers)?;
        Some(time.since(signed_at))
    }

    /// Returns the timestamp of a frame that the stack has accepted, if its signature was verified.
    fn signed_at(&self, frame: &Frame<'_>) -> SignedAt {
        NonZeroU64::new(frame.signature().filter(|_| self.is_active())?.timestamp)
    }

    /// Moves our time forward (G-6).
    fn advance(&mut self, now: Instant, timestamp: Timestamp) {
        self.our_time = self.our_time.max(RunningTime::new(now, timestamp));
    }

    /// Returns the timestamp of a frame that is signed now: later than the last one (G-4). `None` when none is left.
    fn next_timestamp(&self, now: Instant) -> Option<Timestamp> {
        let next = self.our_time.at(now).max(self.last.next());
        (next <= Timestamp::LAST).then_some(next)
    }

    /// Takes the [next timestamp](Self::next_timestamp).
    fn take_timestamp(&mut self, now: Instant) -> Option<u64> {
        self.last = self.next_timestamp(now)?;
        Some(self.last.0)
    }

    /// Judges a frame, and learns from one that is accepted for its signature (G-6, G-7).
    fn judge(&mut self, now: Instant, frame: &Frame<'_>) -> Verdict {
        let (Some(key), Some(signature)) = (&self.key, frame.signature()) else { return Verdict::Unsigned };
        if !frame.is_signed_with(key) {
            increment(&mut self.counters.bad_signature);
            return Verdict::Forged;
        }
        let (times, timestamp) = (self.times(now), Timestamp(signature.timestamp));
        let is_beyond_bound = times.is_beyond_bound(timestamp);
        if timestamp >= Timestamp::LAST || (is_beyond_bound && !times.is_beyond_bound(times.ours)) {
            self.ahead = Some(frame.source().system);
            increment(&mut self.counters.too_far_ahead);
            return Verdict::Stale;
        }
        let oldest = times.base().minute_earlier().max(self.floor);
        // Beyond the bound there are only peers that follow our time. Their earlier frames must not begin a stream.
        let earliest = if is_beyond_bound { times.ours.minute_earlier().max(oldest) } else { oldest };
        let new = NewStream { earliest, evict_before: oldest };
        let counter = match streams::record(&mut self.streams, frame.source(), signature.link_id, timestamp, &new) {
            Ok(()) => {
                self.advance(now, timestamp);
                increment(&mut self.counters.verified);
                return Verdict::Verified(timestamp);
            }
            Err(Stale::Replayed) => &mut self.counters.replayed,
            Err(Stale::Old) => &mut self.counters.too_old,
            Err(Stale::NoSlot) => &mut self.counters.no_stream_slot,
        };
        increment(counter);
        Verdict::Stale
    }

    /// Returns which frames a link accepts: as configured, but nothing unsigned while the stored key is lost, if the
    /// link would sign or refuse with a key (G-18).
    const fn policy(&self, link: &LinkSigning) -> Accept {
        let needs_key = link.signs() || !matches!(link.accept, Accept::Open);
        if needs_key && self.saving.is_key_lost() && !self.is_active() { Accept::Required } else { link.accept }
    }
}
