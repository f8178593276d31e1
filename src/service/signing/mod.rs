//! Message signing: proves that a frame's sender has the key and that the frame is not replayed.
//!
//! Implements <https://mavlink.io/en/guide/message_signing.html>, rules G-1 to G-18. [`Signing`] describes how a frame is judged.

mod policy;
#[cfg(feature = "storage")]
mod saving;
mod setup;
mod streams;
#[cfg(test)]
mod tests;

pub use policy::{Accept, LinkSigning};
#[cfg(feature = "storage")]
use saving::Saving;
use setup::hint;
pub(crate) use setup::{Answer, next, on_frame};
pub use streams::SigningStream;

use core::num::{NonZeroU32, NonZeroU64};
use core::ops::{Deref, DerefMut};

use crate::dialect::SetupSigning;
use crate::frame::{Frame, Header, MAX_TIMESTAMP, SigningKey, Version, signature_cost};
use crate::link::{LinkClass, LinkConfig, Port};
use crate::message::Message;
use crate::num;
use crate::service::command::SignedAt;
use crate::time::{Duration, Instant};
use crate::vehicle::Vehicle;
use streams::{MINUTE, Stale};

/// Unix time of timestamp 0 (s): the beginning of 2015 (G-3).
const EPOCH: u64 = 1_420_070_400;

/// How far a peer's clock may be ahead of the time set by the vehicle (10 µs): a day, to tolerate badly set clocks (G-17).
const DAY: u64 = 24 * 60 * MINUTE;

/// What was accepted and refused, on all links. The counters wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct SigningCounters {
    /// Frames with a right signature that are newer than those before them.
    pub verified: u32,
    /// Unsigned frames on a link that does not accept them, those of MAVLink 1 among them (G-9); and there, as long as there is
    /// no key, signed ones, which nothing verifies.
    pub unsigned: u32,
    /// Frames whose signature was not made with our key, or not of these bytes (G-10); these two cannot be told apart.
    pub bad_signature: u32,
    /// Frames with a right signature, but not newer than the last one of their stream (G-6).
    pub replayed: u32,
    /// Frames with a right signature that would begin a stream, but are more than a minute old (G-6), or from before a restart.
    pub too_old: u32,
    /// Frames with a right signature and a timestamp more than a day ahead of the time set by the vehicle, and frames with the
    /// last 48-bit timestamp, which has no successor (G-17).
    pub too_far_ahead: u32,
    /// Frames with a right signature that would begin a stream, for which the table has no place (G-8).
    pub no_stream_slot: u32,
    /// Times of [`set_time`](Signing::set_time) that were too far ahead (G-14).
    pub refused_times: u32,
    /// SETUP_SIGNING that was carried out.
    pub setups: u32,
    /// SETUP_SIGNING that was accepted on its link, and not carried out: a text says why (G-11).
    pub refused_setups: u32,
}

/// The vehicle's memory for signing with a table of `STREAMS` streams: see [`Signing`].
pub type SigningMemory<const STREAMS: usize = 16> = Signing<[SigningStream; STREAMS]>;

/// The vehicle's memory for signing: the key, the time, and who was heard when. The vehicle keeps it and hands it to the stack
/// by [`Vehicle::signing`](crate::Vehicle::signing); what a link does stands in its [`LinkSigning`]. It takes no part as long as
/// there is no key.
///
/// Key and time survive a restart in a `SigningStore` (feature `storage`), or in what the firmware has for it:
/// [`timestamp`](Self::timestamp) at least once a minute, a minute ahead.
///
/// ```
/// use mavstack::{Duration, Instant, Signing, SigningKey, SigningMemory, Vehicle, VehicleState};
///
/// struct Rover { signing: SigningMemory }
///
/// impl Vehicle for Rover {
///     fn state(&self) -> Option<VehicleState> {
///         None
///     }
///
///     fn signing(&mut self) -> Option<&mut Signing> {
///         Some(&mut self.signing)
///     }
/// }
///
/// let mut rover = Rover { signing: SigningMemory::new() };
/// // At start, unless it is stored:
/// rover.signing.set_key(Instant::ZERO, SigningKey::new([0x42; 32]), 0);
/// // When the satellite receiver knows the time, on the ground:
/// let unix_usec = 1_750_000_000_000_000;
/// assert!(rover.signing.set_time(Instant::from_millis(2_000), unix_usec, Duration::MAX));
/// ```
///
/// # How a frame is judged
///
/// A received frame is judged before any service sees it:
///
/// ```text
///   frame ──▶ signed, and there is a key? ── no ──▶ unsigned ──▶ may it be, on this link? ── no ──▶ refused
///                     │ yes                                          │ yes
///                     ▼                                              ▼
///             right signature? ── yes ──▶ newer than all before it,  ── yes ──▶ served; its time is ours at least
///                     │ no                no more than a day ahead?
///                     │                              │ no
///                     ▼                              ▼
///               bad signature         replayed, too old, too far ahead, no place
/// ```
///
/// - **What is not accepted** changes nothing: no answer, no peer, no time. It is counted by its reason. Where frames are
///   forwarded, it is forwarded to the links that would not accept it unsigned either (R-10).
/// - **Time** is one for all links. It runs with the clock, and starts where storage says. A right signature, the vehicle
///   ([`set_time`](Signing::set_time)) and a key's timestamp move it forward (G-6, G-14). Only another key can move it back; until
///   then no timestamp is sent twice.
/// - **A bound on the future** (G-17): once the vehicle has told the time since the start, a frame from more than a day ahead of
///   that is refused, or one peer with a wrong clock would shut out every peer with a right one. Stored times and a key's time
///   bound nothing: a vehicle without a clock wakes days late. Nor does the bound apply while our own time is more than a day
///   ahead of what the vehicle told. It would shut out the peers that follow our time, and let in nobody else.
/// - **Streams**: a stream is known by its sender and by the sender's number of the link. Each frame of a known stream has to be
///   newer than the one before; a new stream may begin a minute behind our time. When the table is full, a stream that was
///   silent for more than a minute is evicted (G-8). So `STREAMS` bounds how many streams are heard at a time, and a key holder
///   shuts nobody out for longer than that.
/// - **The same key again** moves the time forward to the timestamp that comes with it, never back. Streams stay as they are.
/// - **Another key** starts with the timestamp that comes with it, and with no streams, so that a new key heals a time that was
///   moved too far ahead, also after a restart. The time that the vehicle told since the start still counts: our time starts no
///   earlier than that.
///
/// The last 48-bit timestamp, in 2104, has no successor, so it is never accepted. Once our own time has reached it, links that
/// sign send unsigned frames until another key is set: a timestamp is never sent twice.
///
/// # What can be replayed
///
/// Recorded signed frames can be accepted again in these cases:
///
/// - **A key that returns.** What is set after another key, or after none, counts as another key: the one before was forgotten.
///   So frames that were recorded with it are accepted once more, if they are no more than a minute older than the timestamp
///   that it returns with, or than the time that the vehicle told. A timestamp of a minute from now leaves no window.
/// - **A restart.** Streams are forgotten, and time begins where it was last stored, up to a minute ahead of that moment (G-15).
///   So frames that were accepted since may be accepted again, and those of the minute before. By default nothing is stored while
///   the vehicle is armed: after a restart in flight, that is everything since take-off. [`set_time`](Signing::set_time), called
///   before frames are received, narrows this to the last minute.
/// - **The first key.** Frames that were served unverified because there was no key are in no stream. Those signed with the key
///   that is set next may be served again for a minute.
///
/// [`refuse_recorded`](Signing::refuse_recorded) closes these windows, if our time is right. After a restart in flight the stored
/// time is not: there it only helps after `set_time`. It cannot help with a frame that an attacker kept from the vehicle, which is
/// no replay. A known stream accepts it until a newer frame comes, however late it is
/// (see [`Signing::age`]).
///
/// # Setting the key
///
/// The key is set by the firmware ([`Signing::set_key`]) or by SETUP_SIGNING on a provisioning link (G-11). SETUP_SIGNING is
/// refused, with a text and a counter, when its timestamp is more than a day ahead of the time set by the vehicle and also ahead
/// of our time. Until the vehicle has set the time there is nothing to compare it with.
#[derive(Clone)]
pub struct Signing<S: ?Sized = [SigningStream]> {
    key: Option<SigningKey>,
    /// Our time, less the clock.
    boot: i64,
    /// The last timestamp that was sent; time never falls behind it.
    last: u64,
    /// Before this no new stream begins.
    floor: u64,
    /// The latest time that the vehicle set since the start, less the clock.
    told: Option<i64>,
    /// The latest timestamp in signatures of peers on normal links, less the clock.
    heard: Option<i64>,
    counters: SigningCounters,
    #[cfg(feature = "storage")]
    saving: Saving,
    streams: S,
}

impl<const STREAMS: usize> Signing<[SigningStream; STREAMS]> {
    /// No key: nothing is signed, and nothing can be verified.
    pub const fn new() -> Self {
        const { assert!(STREAMS > 0, "signing memory needs room for a stream, or nobody could ever be verified") };
        Self {
            key: None,
            boot: 0,
            last: 0,
            floor: 0,
            told: None,
            heard: None,
            counters: SigningCounters {
                verified: 0,
                unsigned: 0,
                bad_signature: 0,
                replayed: 0,
                too_old: 0,
                too_far_ahead: 0,
                no_stream_slot: 0,
                refused_times: 0,
                setups: 0,
                refused_setups: 0,
            },
            #[cfg(feature = "storage")]
            saving: Saving::new(),
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

/// Without the key, and without the time, which tells nothing.
impl<S: ?Sized> core::fmt::Debug for Signing<S> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Signing")
            .field("is_active", &self.key.is_some())
            .field("counters", &self.counters)
            .finish_non_exhaustive()
    }
}

/// What a frame's signature says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// Right, and new.
    Verified,
    /// Nothing: it has none, or there is no key.
    Unsigned,
    /// Not signed with our key. Counted.
    Forged,
    /// Right, but the frame is too old or too far ahead. Counted.
    Stale,
}

impl Signing {
    /// Whether there is a key.
    pub const fn is_active(&self) -> bool {
        self.key.is_some()
    }

    /// What was accepted and refused.
    pub const fn counters(&self) -> SigningCounters {
        self.counters
    }

    /// Returns our time (10 µs since 2015-01-01 00:00 UTC, G-3), the minimum timestamp of the next signed frame. It is not the
    /// time of day: unless the vehicle or a peer knew that, it continued from the stored time.
    #[inline(never)]
    pub fn timestamp(&self, now: Instant) -> u64 {
        self.time(now).min(MAX_TIMESTAMP)
    }

    /// Like [`timestamp`](Self::timestamp), but beyond the last timestamp once that was used.
    fn time(&self, now: Instant) -> u64 {
        self.last.max(at(now, self.boot))
    }

    /// Signs with `key` from now on, and accepts what was signed with it (G-17).
    ///
    /// - The key that is in use: our time moves forward to `timestamp` (10 µs since 2015-01-01), never back.
    /// - Another key, also one that was in use before: our time starts at `timestamp`, or at the time that the vehicle
    ///   [set](Self::set_time) since the start if that is later; all streams are forgotten. [`Signing`] lists what can be
    ///   replayed with a key that is set again; [`refuse_recorded`](Self::refuse_recorded) prevents it.
    ///
    /// A `timestamp` of 2^48 - 1 or more counts as 0: it has no successor.
    pub fn set_key(&mut self, now: Instant, key: SigningKey, timestamp: u64) {
        let start = offset(now, if timestamp < MAX_TIMESTAMP { timestamp } else { 0 });
        if self.key.as_ref().is_some_and(|known| known.is_same(&key)) {
            self.boot = self.boot.max(start);
        } else {
            self.boot = self.told.map_or(start, |told| told.max(start));
            (self.last, self.floor, self.heard) = (0, 0, None);
            self.streams.fill(SigningStream::NONE);
        }
        self.key = Some(key);
        self.is_to_be_stored();
        event!("signing: key set");
    }

    /// Stops signing and forgets the key. Whatever key is set next counts as [another key](Self::set_key).
    pub fn clear_key(&mut self) {
        self.key = None;
        self.is_to_be_stored();
        event!("signing: off");
    }

    /// Sets the time: at `now` it is `unix_usec` µs since 1970-01-01 00:00 UTC. Moves our time forward to it (G-4), never back
    /// (G-14), and from then on [bounds](Signing) how far ahead a peer's clock may be (G-17). Returns true, without any effect,
    /// for a time earlier than one set before, and for a time before 2015, as from a clock that was never set.
    ///
    /// Returns false when our time would move by more than `max_step`, or would reach the last 48-bit timestamp. The
    /// call is then counted and has no effect (G-14).
    ///
    /// Only tell a time that is known to be right. A wrong one shuts out the peers whose clocks are right:
    ///
    /// - A time far behind, as from a clock that lost its battery. Unless our own time is later anyway, frames of peers with
    ///   right clocks are refused as [too far ahead](SigningCounters::too_far_ahead). SETUP_SIGNING with a right timestamp is
    ///   refused too. This lasts until the vehicle tells a right time, or restarts and tells no wrong one. The right time is a
    ///   step that `max_step` has to allow.
    /// - A time far ahead, as from an attacker that fakes a satellite signal. Frames of peers with right clocks that begin a
    ///   stream are refused as [too old](SigningCounters::too_old). Only a restart forgets what was told; our time then starts
    ///   as stored, until there is another key.
    ///
    /// A battery-backed clock that reports whether it kept running may be believed whatever it says ([`Duration::MAX`]). Believe
    /// a satellite receiver by some days on the ground, and by some seconds in flight.
    pub fn set_time(&mut self, now: Instant, unix_usec: u64, max_step: Duration) -> bool {
        let timestamp = unix_usec.saturating_sub(EPOCH.saturating_mul(1_000_000));
        let timestamp = num::quotient(timestamp, TEN);
        let step = timestamp.saturating_sub(self.timestamp(now));
        if step > num::quotient(max_step.as_micros(), TEN) || timestamp >= MAX_TIMESTAMP {
            count(&mut self.counters.refused_times);
            event!("signing: time refused");
            return false;
        }
        self.advance(now, timestamp);
        // A clock that was never set tells a time before 2015.
        if timestamp != 0 {
            self.told = self.told.max(Some(offset(now, timestamp)));
        }
        true
    }

    /// Refuses frames that were recorded before: a new stream must begin after our time, not up to a minute before it (stricter
    /// than G-6). Call this after `Stack::restore_signing`, against frames recorded before a restart, and after
    /// [`set_key`](Self::set_key), against frames recorded with that key. It does not refuse recorded frames with timestamps
    /// later than our time, which are possible when a key is set with an early timestamp.
    ///
    /// After a restart in flight, our time begins where it was last stored: at take-off, by default. Then this only helps after
    /// [`set_time`](Self::set_time).
    ///
    /// The price: our time is up to a minute ahead after a restart. A peer that hears a signed frame of ours follows it, and is
    /// heard from there on. One that does not, as where the link does not sign, is heard when its clock gets there.
    pub fn refuse_recorded(&mut self, now: Instant) {
        self.floor = self.timestamp(now).saturating_add(1);
    }

    /// Returns how long ago a frame that the stack has accepted was signed (L-16): the current time minus its timestamp, or zero
    /// for a frame from the future. Returns `None` for an unsigned frame, without a key to verify it, and until the vehicle or a
    /// peer has provided the time since the start.
    ///
    /// The current time is the latest one from [`set_time`](Self::set_time), so a clock that is set back does not reduce an
    /// age. Until the vehicle has set the time, the current time is the latest timestamp that any peer sent on a normal link.
    /// The same holds when the vehicle's time is more than a day behind that peer, as with a clock that was never set.
    ///
    /// It is not our own [time](Self::timestamp), which starts up to a minute ahead after a restart (G-15). A sender whose clock
    /// is behind makes its frames look older than they are; so does a peer whose clock is ahead, until the vehicle has set the
    /// time. A sender whose clock is ahead makes its frames look younger: by up to that minute if it follows our time and the
    /// vehicle's time is right. The signature alone does not bound the delay: a frame that begins a stream is at most a minute
    /// old, but a frame of a known stream can have any age (G-6).
    pub fn age(&self, now: Instant, frame: &Frame<'_>) -> Option<Duration> {
        let signed_at = self.signed_at(frame)?.get();
        let heard = self.heard.map(|heard| at(now, heard));
        let is_beyond = |heard: &u64| self.bound(now).is_some_and(|bound| *heard > bound);
        let told = self.told.map(|told| at(now, told));
        let time = heard.filter(is_beyond).or(told).or(heard)?;
        Some(Duration::from_micros(time.saturating_sub(signed_at).saturating_mul(10)))
    }

    /// The timestamp of a frame that the stack has accepted, if its signature was verified.
    fn signed_at(&self, frame: &Frame<'_>) -> SignedAt {
        NonZeroU64::new(frame.signature().filter(|_| self.is_active())?.timestamp)
    }

    /// Returns the latest timestamp that is accepted, once the vehicle has set the time (G-17).
    fn bound(&self, now: Instant) -> Option<u64> {
        Some(at(now, self.told?).saturating_add(DAY))
    }

    /// Whether SETUP_SIGNING may have this timestamp.
    fn takes_setup(&self, now: Instant, timestamp: u64) -> bool {
        let is_near = timestamp <= self.timestamp(now) || self.bound(now).is_none_or(|bound| timestamp <= bound);
        timestamp < MAX_TIMESTAMP && is_near
    }

    /// Whether a peer's clock is so far ahead that it must not move ours (G-17).
    fn is_too_far_ahead(&self, now: Instant, timestamp: u64) -> bool {
        let is_beyond = |bound: u64| timestamp > bound && self.timestamp(now) <= bound;
        timestamp >= MAX_TIMESTAMP || self.bound(now).is_some_and(is_beyond)
    }

    /// Moves the time forward (G-6).
    #[inline(never)]
    fn advance(&mut self, now: Instant, timestamp: u64) {
        self.boot = self.boot.max(offset(now, timestamp));
    }

    /// Whether there is a timestamp left to sign with.
    fn has_stamp(&self, now: Instant) -> bool {
        self.last < MAX_TIMESTAMP && self.time(now) <= MAX_TIMESTAMP
    }

    /// Returns the timestamp of a frame that is signed now: at least one more than the last one (G-4). `None` when none is
    /// left.
    fn stamp(&mut self, now: Instant) -> Option<u64> {
        if !self.has_stamp(now) {
            return None;
        }
        self.last = self.time(now).max(self.last.saturating_add(1));
        Some(self.last)
    }

    /// Judges a frame, and learns from one that is accepted for its signature (G-6, G-7).
    fn judge(&mut self, now: Instant, frame: &Frame<'_>) -> Verdict {
        let (Some(key), Some(signature)) = (&self.key, frame.signature()) else { return Verdict::Unsigned };
        if !frame.is_signed_with(key) {
            self.refuse(|counters| &mut counters.bad_signature);
            return Verdict::Forged;
        }
        let timestamp = signature.timestamp;
        if self.is_too_far_ahead(now, timestamp) {
            return self.refuse(|counters| &mut counters.too_far_ahead);
        }
        let oldest = self.timestamp(now).saturating_sub(MINUTE).max(self.floor);
        match streams::enter(&mut self.streams, frame.source(), signature.link_id, timestamp, oldest) {
            Ok(()) => {
                self.advance(now, timestamp);
                count(&mut self.counters.verified);
                Verdict::Verified
            }
            Err(Stale::Replayed) => self.refuse(|counters| &mut counters.replayed),
            Err(Stale::Old) => self.refuse(|counters| &mut counters.too_old),
            Err(Stale::NoRoom) => self.refuse(|counters| &mut counters.no_stream_slot),
        }
    }

    fn refuse(&mut self, counter: fn(&mut SigningCounters) -> &mut u32) -> Verdict {
        count(counter(&mut self.counters));
        Verdict::Stale
    }

    /// Whether a frame is accepted on a link.
    fn admits(&mut self, now: Instant, port: &mut Port, frame: &Frame<'_>) -> bool {
        let LinkConfig { class, signing: link, .. } = &port.config;
        match self.judge(now, frame) {
            Verdict::Verified => {
                // What comes by satellite may tell the time of minutes ago.
                if *class != LinkClass::HighLatency {
                    let told = frame.signature().map(|signature| offset(now, signature.timestamp));
                    self.heard = self.heard.max(told);
                }
                true
            }
            Verdict::Stale => false,
            Verdict::Forged => {
                hint(now, port, Answer::WrongKey);
                false
            }
            Verdict::Unsigned => {
                let is_first_key = link.provisioning && !self.is_active() && frame.id() == SetupSigning::ID;
                let is_taken = is_first_key || self.accept(link).takes_unsigned(frame.id(), self.is_active());
                if !is_taken {
                    self.refuse(|counters| &mut counters.unsigned);
                    #[cfg(feature = "storage")]
                    if self.is_lost() && !self.is_active() {
                        hint(now, port, Answer::LostKey);
                    }
                }
                is_taken
            }
        }
    }

    /// Whether a peer may cause another key to be stored (C-15).
    fn bears_key(&self, now: Instant) -> bool {
        #[cfg(feature = "storage")]
        return self.saving.keys.has(now, 1);
        #[cfg(not(feature = "storage"))]
        {
            let _ = (self, now);
            true
        }
    }

    /// Counts a key that a peer causes to be stored.
    fn wear_key(&mut self, now: Instant) {
        #[cfg(feature = "storage")]
        self.saving.keys.spend(now, 1);
        #[cfg(not(feature = "storage"))]
        let _ = (self, now);
    }

    /// Returns what a link accepts: as configured, but nothing unsigned while the stored key is lost, if the link would sign or
    /// refuse with a key (G-18).
    const fn accept(&self, link: &LinkSigning) -> Accept {
        #[cfg(feature = "storage")]
        if self.is_lost() && !self.is_active() && (link.signs() || !matches!(link.accept, Accept::Open)) {
            return Accept::Required;
        }
        #[cfg(not(feature = "storage"))]
        let _ = self;
        link.accept
    }

    #[cfg_attr(not(feature = "storage"), allow(clippy::unused_self, reason = "nothing is stored"))]
    const fn is_to_be_stored(&mut self) {
        #[cfg(feature = "storage")]
        {
            (self.saving.is_new, self.saving.next, self.saving.is_lost) = (true, None, false);
        }
    }
}

/// Whether a frame is accepted on its link: asked once for each frame, before anything is learned from it or done about it.
pub(crate) fn admits(now: Instant, port: &mut Port, frame: &Frame<'_>, vehicle: &mut impl Vehicle) -> bool {
    match vehicle.signing() {
        Some(signing) => signing.admits(now, port, frame),
        None => {
            let is_open = matches!(port.config.signing.accept, Accept::Open);
            if !is_open {
                count(&mut port.counters.out_of_place);
            }
            is_open
        }
    }
}

/// Whether an accepted frame is its sender's: what came as an exception, or to set the first key, can be anybody's.
pub(crate) fn knows_sender(port: &Port, frame: &Frame<'_>, vehicle: &mut impl Vehicle) -> bool {
    let link = &port.config.signing;
    let (has_key, accept) = match vehicle.signing() {
        Some(signing) => (signing.is_active(), signing.accept(link)),
        None => (false, link.accept),
    };
    match accept {
        Accept::Open => true,
        Accept::SignedExcept(_) => !has_key || frame.header().is_signed(),
        Accept::Required => has_key && frame.header().is_signed(),
    }
}

/// How long ago an accepted frame was signed; `None` when nothing verifies that.
pub(crate) fn age(now: Instant, frame: &Frame<'_>, vehicle: &mut impl Vehicle) -> Option<Duration> {
    vehicle.signing()?.age(now, frame)
}

/// When an accepted frame was signed, by its sender's clock; `None` when nothing verifies that.
pub(crate) fn signed_at(frame: &Frame<'_>, vehicle: &mut impl Vehicle) -> SignedAt {
    vehicle.signing()?.signed_at(frame)
}

/// Whether what an unsigned frame says is believed on this link.
pub(crate) fn believes_unsigned(port: &Port, id: u32, vehicle: &mut impl Vehicle) -> bool {
    let link = &port.config.signing;
    match vehicle.signing() {
        Some(signing) => signing.accept(link).takes_unsigned(id, signing.is_active()),
        None => matches!(link.accept, Accept::Open),
    }
}

/// Whether a frame with an unknown id is a frame, for its signature is right (SEC-5). Not whether it is accepted. What the look
/// costs is taken from `work`.
pub(crate) fn vouches_for(raw: &[u8], key: Option<&SigningKey>, work: &mut u32) -> bool {
    key.is_some_and(|key| {
        *work = work.saturating_sub(signature_cost(raw.len()));
        key.has_signed(raw)
    })
}

/// What [`admits`] does for a frame, as work.
pub(crate) fn cost(frame: &Frame<'_>, vehicle: &mut impl Vehicle) -> u32 {
    let is_judged = frame.header().is_signed() && key_of(vehicle).is_some();
    if is_judged { signature_cost(frame.raw().len()) } else { 0 }
}

/// The key that [`vouches_for`] needs.
pub(crate) fn key_of(vehicle: &mut impl Vehicle) -> Option<&SigningKey> {
    vehicle.signing()?.key.as_ref()
}

/// Selects signing for the next frame, if the link signs and there is a key and a timestamp. The frame is then MAVLink 2
/// (V-3).
pub(crate) fn prepare(now: Instant, port: &mut Port, vehicle: &mut impl Vehicle) {
    let Some(signing) = vehicle.signing() else { return };
    let signs = signing.is_active() && port.config.signing.signs() && signing.has_stamp(now);
    port.outbox.set_signs(signs);
    if signs {
        port.outbox.set_version(Version::V2);
    }
}

/// Signs the frame that is about to be sent, if it needs a signature: a new frame, or one that is restarted (G-4). Without a
/// key or a timestamp it is not sent.
pub(crate) fn sign(now: Instant, port: &mut Port, vehicle: &mut impl Vehicle) {
    let Some(signing) = vehicle.signing() else { return };
    if port.outbox.needs_signature() {
        let timestamp = signing.stamp(now);
        port.outbox.sign(signing.key.as_ref().zip(timestamp));
    }
}

/// What [`sign`] did for a frame, as work. Counts those of others too, which were signed elsewhere.
pub(crate) fn cost_of_sending(frame: &[u8]) -> u32 {
    let is_signed = Header::parse(frame).is_some_and(|header| header.is_signed());
    if is_signed { signature_cost(frame.len()) } else { 0 }
}

/// Microseconds of a unit of a timestamp.
const TEN: NonZeroU32 = NonZeroU32::MIN.saturating_add(9);

/// Units of 10 µs since boot.
const fn ticks(now: Instant) -> u64 {
    num::quotient(now.as_micros(), TEN)
}

/// Returns a timestamp less the clock; timestamps beyond the last one are treated alike.
fn offset(now: Instant, timestamp: u64) -> i64 {
    let timestamp = timestamp.min(MAX_TIMESTAMP.saturating_add(1));
    timestamp.cast_signed().saturating_sub(ticks(now).cast_signed())
}

/// Returns the time that has this [`offset`].
const fn at(now: Instant, offset: i64) -> u64 {
    ticks(now).saturating_add_signed(offset)
}

fn count(counter: &mut u32) {
    *counter = counter.wrapping_add(1);
}
