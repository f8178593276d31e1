//! Message signing: who speaks, and that he speaks now.
//!
//! Implements <https://mavlink.io/en/guide/message_signing.html>, rules G-1 to G-16. How a frame is judged stands at [`Signing`].

mod policy;
mod setup;
mod streams;
#[cfg(test)]
mod tests;

pub use policy::{Accept, LinkSigning};
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

/// So far ahead of the time that the vehicle has told may be what comes with a key (10 µs): a day, for clocks that are badly set.
const SETUP_STEP: u64 = 24 * 60 * MINUTE;

/// So far ahead the timestamp is stored (10 µs): what a restart skips at most (G-15).
#[cfg(feature = "storage")]
const RESERVATION: u64 = MINUTE;

/// So long before it is reached the next one is stored (10 µs): longer than writing takes.
#[cfg(feature = "storage")]
const AHEAD: u64 = 500_000;

/// After storage failed it is left alone for so long.
#[cfg(feature = "storage")]
const RETRY: Duration = Duration::from_secs(10);

/// What was accepted and refused, on all links. Numbers wrap.
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
///             right signature? ── yes ──▶ newer than all before it? ── yes ──▶ served; its time is ours at least
///                     │ no                           │ no
///                     ▼                              ▼
///               bad signature                replayed, too old, no place
/// ```
///
/// - **What is not accepted** changes nothing: no answer, no peer, no time. It is counted by its reason. Where frames are
///   forwarded, it is forwarded to links that are not open (R-10).
/// - **Time** is one for all links and all keys: it runs with the clock, never goes back, and is never used twice. It starts
///   where storage says, and is moved forward by the vehicle, who may know the time of day, by peers whose signatures are right
///   (G-6, G-14), and by who sets a key. Neither another key nor none moves it back: only a new memory does, with storage that
///   was erased.
/// - **Streams**: a stream is known by who sends it and by his own number for the link. Of a known one each frame has to be
///   newer than the one before, a new one may begin a minute behind our time. When the table is full, one that was silent for
///   more than a minute gives way (G-8): so `STREAMS` bounds who can be heard at a time, and a key holder can lock nobody
///   out for longer than that.
/// - **Another key** finds time and streams as they were, and so does one that comes back: what was accepted with it is not
///   accepted again.
///
/// What is left to who records frames, for a minute each time, unless the vehicle [refuses it](Signing::refuse_recorded):
///
/// - After a restart streams are known no more, and time begins up to a minute ahead of where it was (G-15). What was accepted
///   in the last minute before may be accepted a second time, as in other implementations.
/// - What was served unverified because there was no key is in no stream. If it was signed with the key that is set next, and is
///   not a minute old, it may be served a second time.
///
/// And without that remedy: a frame that was kept from the vehicle is no replay. When it comes late it is accepted, by a known
/// stream until that goes on, however late it is (see [`Signing::age`]).
///
/// The secret is set by the firmware ([`Signing::set_key`]) or by SETUP_SIGNING, on a link that is made for it (G-11). With it
/// comes a timestamp, and time moves forward to that. One that is far ahead by mistake would lock everybody out whose clock is
/// right, and cannot be taken back. So when the vehicle has told the time since the start ([`Signing::set_time`]), SETUP_SIGNING
/// with one that is more than a day ahead of that, and of ours, is refused, told by a text and counted; else there is nothing to
/// compare it with, and it is accepted as G-11 says.
#[derive(Clone)]
pub struct Signing<S: ?Sized = [SigningStream]> {
    key: Option<SigningKey>,
    /// The timestamp at boot; with the clock it makes the time.
    boot: u64,
    /// The last one that was sent; time does not fall behind it.
    last: u64,
    /// Before this no new stream begins.
    floor: u64,
    /// What the vehicle itself told last as the time, less the clock then; `None` when it has not.
    told: Option<u64>,
    /// The latest that peers on normal links told by their signatures, less the clock then.
    heard: Option<u64>,
    counters: SigningCounters,
    #[cfg(feature = "storage")]
    saving: Saving,
    streams: S,
}

/// Where the storing stands.
#[cfg(feature = "storage")]
#[derive(Clone, Copy, Debug)]
struct Saving {
    /// The timestamp that is stored: none beyond it is in use, if storage keeps up.
    reserved: u64,
    /// The one that is being stored.
    next: Option<u64>,
    /// Counts what is to be stored.
    job: u32,
    /// Whether the key is not stored yet.
    is_new: bool,
    /// Not before this moment.
    rests_until: Instant,
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
                no_stream_slot: 0,
                refused_times: 0,
                setups: 0,
                refused_setups: 0,
            },
            #[cfg(feature = "storage")]
            saving: Saving { reserved: 0, next: None, job: 0, is_new: false, rests_until: Instant::ZERO },
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
    /// Wrong, or of a frame that is too old. Counted.
    Bad,
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

    /// Our time (10 µs since 2015-01-01 00:00 UTC, G-3): what the next signed frame bears at least. It is no time of day: without
    /// somebody who knew that, it began where it was last.
    #[inline(never)]
    pub fn timestamp(&self, now: Instant) -> u64 {
        self.last.max(self.boot.saturating_add(ticks(now))).min(MAX_TIMESTAMP)
    }

    /// Signs with `key` from now on, and accepts what was signed with it; the time is moved forward to `timestamp` (10 µs since
    /// 2015-01-01), if it is not there yet (G-11). Streams go on where they were under the key before (G-8), so who signs with an
    /// earlier time than then is not heard until he is there again.
    pub fn set_key(&mut self, now: Instant, key: SigningKey, timestamp: u64) {
        self.key = Some(key);
        self.advance(now, timestamp);
        self.is_to_be_stored();
        event!("signing: key set");
    }

    /// Signs no longer, and forgets the key. Time goes on, and streams are remembered: the key may come back.
    pub fn clear_key(&mut self) {
        self.key = None;
        self.is_to_be_stored();
        event!("signing: off");
    }

    /// It is `unix_usec` µs after the beginning of 1970 in UTC at `now`: moves the time forward to that (G-4), never back. False,
    /// and counted, when that would be by more than `max_step`; nothing happens then (G-14). A time before 2015, as a clock has
    /// that was never set, is no time: true, and nothing happens.
    ///
    /// Whoever can pretend a time far ahead, as with a satellite receiver, can make the vehicle refuse everybody whose clock
    /// is right. So a clock of the vehicle's own may be believed whatever it says ([`Duration::MAX`]), a satellite receiver on the
    /// ground by some days, in flight by some seconds.
    pub fn set_time(&mut self, now: Instant, unix_usec: u64, max_step: Duration) -> bool {
        let timestamp = unix_usec.saturating_sub(EPOCH.saturating_mul(1_000_000));
        let timestamp = num::quotient(timestamp, TEN);
        let step = timestamp.saturating_sub(self.timestamp(now));
        if step > num::quotient(max_step.as_micros(), TEN) || timestamp > MAX_TIMESTAMP {
            count(&mut self.counters.refused_times);
            event!("signing: time refused");
            return false;
        }
        self.advance(now, timestamp);
        // A clock that was never set tells a time before 2015.
        if timestamp != 0 {
            self.told = Some(timestamp.saturating_sub(ticks(now)));
        }
        true
    }

    /// Refuses what was recorded before: a stream that is not known begins at our time or later, not a minute before (stricter
    /// than G-6). To be called behind `Stack::restore_signing`, for what was recorded before a restart, and behind
    /// [`set_key`](Self::set_key), for what was signed with that key while there was none.
    ///
    /// The price: our time is up to a minute ahead then. Who hears a signed frame of ours follows it, and is heard from there
    /// on; who does not, as where the link does not sign, is heard when his clock gets there.
    pub fn refuse_recorded(&mut self, now: Instant) {
        self.floor = self.timestamp(now).saturating_add(1);
    }

    /// How long ago a frame that the stack has accepted was signed (L-16): what time it is, less its timestamp. What time it
    /// is says the vehicle's last [`set_time`](Self::set_time); before that, the peer whose signed frames by other than
    /// high-latency links are furthest ahead. `None` when neither told it since the start, and when the frame has no signature
    /// or there is no key to verify it with. Zero for a frame from later than now.
    ///
    /// It is not our own [time](Self::timestamp), which never goes back and begins up to a minute ahead after a restart
    /// (G-15). A sender's clock that is late makes his frames older than they are, and so does, as long as the vehicle has told
    /// nothing, a peer's that is ahead. One that is ahead makes them younger: by up to that minute where the sender follows
    /// our time, as many do, when the vehicle has told a right one. A signature says nothing of how long a frame was on its way otherwise: one that begins
    /// a stream is a minute old at most, one of a stream that is known has any age (G-6).
    pub fn age(&self, now: Instant, frame: &Frame<'_>) -> Option<Duration> {
        let signed_at = self.signed_at(frame)?.get();
        let time = self.told.or(self.heard)?.saturating_add(ticks(now));
        Some(Duration::from_micros(time.saturating_sub(signed_at).saturating_mul(10)))
    }

    /// The timestamp of a frame that the stack has accepted, if its signature was verified.
    fn signed_at(&self, frame: &Frame<'_>) -> SignedAt {
        NonZeroU64::new(frame.signature().filter(|_| self.is_active())?.timestamp)
    }

    /// Whether somebody may set a key with this timestamp.
    fn takes_setup(&self, now: Instant, timestamp: u64) -> bool {
        let is_near = |told: u64| timestamp <= told.saturating_add(ticks(now)).saturating_add(SETUP_STEP);
        timestamp <= MAX_TIMESTAMP && (timestamp <= self.timestamp(now) || self.told.is_none_or(is_near))
    }

    /// Moves the time forward (G-6).
    #[inline(never)]
    fn advance(&mut self, now: Instant, timestamp: u64) {
        self.boot = self.boot.max(timestamp.min(MAX_TIMESTAMP).saturating_sub(ticks(now)));
    }

    /// The timestamp of a frame that is signed now: one more than the last one at least (G-4).
    fn stamp(&mut self, now: Instant) -> u64 {
        self.last = self.timestamp(now).max(self.last.saturating_add(1)).min(MAX_TIMESTAMP);
        self.last
    }

    /// Judges a frame, and learns from one that is accepted for its signature (G-6, G-7).
    fn judge(&mut self, now: Instant, frame: &Frame<'_>) -> Verdict {
        let (Some(key), Some(signature)) = (&self.key, frame.signature()) else { return Verdict::Unsigned };
        if !frame.is_signed_with(key) {
            return self.refuse(frame, |counters| &mut counters.bad_signature, "bad signature");
        }
        let timestamp = signature.timestamp;
        let oldest = self.timestamp(now).saturating_sub(MINUTE).max(self.floor);
        match streams::enter(&mut self.streams, frame.source(), signature.link_id, timestamp, oldest) {
            Ok(()) => {
                self.advance(now, timestamp);
                count(&mut self.counters.verified);
                Verdict::Verified
            }
            Err(Stale::Replayed) => self.refuse(frame, |counters| &mut counters.replayed, "replayed"),
            Err(Stale::Old) => self.refuse(frame, |counters| &mut counters.too_old, "too old"),
            Err(Stale::NoRoom) => {
                self.refuse(frame, |counters| &mut counters.no_stream_slot, "no place for its stream")
            }
        }
    }

    fn refuse(
        &mut self,
        frame: &Frame<'_>,
        counter: fn(&mut SigningCounters) -> &mut u32,
        reason: &'static str,
    ) -> Verdict {
        event!("rx: message {=u32} of {} dropped: {=str}", frame.id(), frame.source(), reason);
        count(counter(&mut self.counters));
        Verdict::Bad
    }

    /// Whether a frame is accepted on a link that does as `config` says.
    fn admits(&mut self, now: Instant, config: &LinkConfig, frame: &Frame<'_>) -> bool {
        let link = &config.signing;
        match self.judge(now, frame) {
            Verdict::Verified => {
                // What comes by satellite may tell the time of minutes ago.
                if config.class != LinkClass::HighLatency {
                    let told = frame.signature().map(|signature| signature.timestamp.saturating_sub(ticks(now)));
                    self.heard = self.heard.max(told);
                }
                true
            }
            Verdict::Bad => false,
            Verdict::Unsigned => {
                let is_first_key = link.provisioning && !self.is_active() && frame.id() == SetupSigning::ID;
                let is_taken = is_first_key || link.accept.takes_unsigned(frame.id(), self.is_active());
                if !is_taken {
                    self.refuse(frame, |counters| &mut counters.unsigned, "unsigned");
                }
                is_taken
            }
        }
    }

    #[cfg_attr(not(feature = "storage"), allow(clippy::unused_self, reason = "nothing is stored"))]
    const fn is_to_be_stored(&mut self) {
        #[cfg(feature = "storage")]
        {
            (self.saving.is_new, self.saving.next) = (true, None);
        }
    }
}

/// What the store asks (G-13, G-15).
#[cfg(feature = "storage")]
impl Signing {
    /// What was stored: time begins there, unless it is beyond already.
    pub(crate) fn restore(&mut self, now: Instant, key: Option<SigningKey>, timestamp: u64) {
        self.key = key;
        self.advance(now, timestamp);
        (self.saving.is_new, self.saving.next, self.saving.reserved) = (false, None, timestamp);
    }

    /// What is to be stored by now: a number for it. The same number, the same content.
    pub(crate) fn unsaved(&mut self, now: Instant) -> Option<u32> {
        if now < self.saving.rests_until {
            return None;
        }
        let time = self.timestamp(now);
        if self.saving.next.is_none() {
            // Also without a key, once there was one: it may come back, and time must not have gone back.
            let keeps_time = self.is_active() || self.saving.reserved != 0;
            let is_due = keeps_time && time.saturating_add(AHEAD) >= self.saving.reserved;
            if !is_due && !self.saving.is_new {
                return None;
            }
            self.saving.next = Some(time.saturating_add(RESERVATION));
            self.saving.is_new = false;
            self.saving.job = self.saving.job.wrapping_add(1);
        }
        Some(self.saving.job)
    }

    /// The content of the job: the key, and the timestamp to begin with.
    pub(crate) fn content(&self) -> (Option<&SigningKey>, u64) {
        (self.key.as_ref(), self.saving.next.unwrap_or(0))
    }

    /// It is stored.
    pub(crate) const fn saved(&mut self) {
        if let Some(timestamp) = self.saving.next.take() {
            self.saving.reserved = timestamp;
        }
    }

    /// It is not, and is tried again later.
    pub(crate) fn not_saved(&mut self, now: Instant) {
        (self.saving.is_new, self.saving.next) = (true, None);
        self.saving.rests_until = now.after(RETRY);
    }
}

/// Whether a frame is accepted on its link: asked once for each frame, before anything is learned from it or done about it.
pub(crate) fn admits(now: Instant, port: &mut Port, frame: &Frame<'_>, vehicle: &mut impl Vehicle) -> bool {
    match vehicle.signing() {
        Some(signing) => signing.admits(now, &port.config, frame),
        None => {
            let is_open = matches!(port.config.signing.accept, Accept::Open);
            if !is_open {
                event!("rx: message {=u32} of {} dropped: no memory for signing", frame.id(), frame.source());
                count(&mut port.counters.out_of_place);
            }
            is_open
        }
    }
}

/// Whether an accepted frame is its sender's: what came as an exception, or to set the first key, can be anybody's.
pub(crate) fn knows_sender(port: &Port, frame: &Frame<'_>, vehicle: &mut impl Vehicle) -> bool {
    let has_key = vehicle.signing().is_some_and(|signing| signing.is_active());
    match port.config.signing.accept {
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
    let accept = port.config.signing.accept;
    match vehicle.signing() {
        Some(signing) => accept.takes_unsigned(id, signing.is_active()),
        None => matches!(accept, Accept::Open),
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

/// Has what is sent next signed, if the link signs and there is a key. Then it is MAVLink 2 (V-3).
pub(crate) fn prepare(port: &mut Port, vehicle: &mut impl Vehicle) {
    let Some(signing) = vehicle.signing() else { return };
    let signs = signing.is_active() && port.config.signing.signs();
    port.outbox.set_signs(signs);
    if signs {
        port.outbox.set_version(Version::V2);
    }
}

/// Signs the frame that is about to leave, if it needs it: a new one, or one that is sent from its start again (G-4). Without
/// a key it does not leave.
pub(crate) fn sign(now: Instant, port: &mut Port, vehicle: &mut impl Vehicle) {
    let Some(signing) = vehicle.signing() else { return };
    if port.outbox.needs_signature() {
        let timestamp = signing.stamp(now);
        port.outbox.sign(signing.key.as_ref(), timestamp);
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

fn count(counter: &mut u32) {
    *counter = counter.wrapping_add(1);
}
