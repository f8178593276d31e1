//! Forwarding: what comes by one link and is for somebody on another.
//!
//! Implements <https://mavlink.io/en/guide/routing.html>, rules R-1 to R-16: the vehicle joins its links, so that a ground
//! station on the telemetry radio and a companion computer on a UART find each other, and who stands behind them.
//!
//! What is forwarded, and what is not, stands at [`ForwardQueues`]. Only what was forwarded is remembered: all else that is for
//! us too is handled each time that it comes.

use super::memory::{Memory, Recall, Seen, Ticket};
use super::queue::Ring;
use super::routes::Routes;
use crate::dialect::{CommandAck, CommandCancel, CommandInt, CommandLong, HighLatency2, RadioStatus, SetupSigning};
use crate::frame::{Address, Frame, MAX_FRAME_LEN, Version};
use crate::link::{LinkClass, LinkId, LinkMask, Outbox, Port};
use crate::message::Message;
#[cfg(feature = "signing")]
use crate::service::signing::Accept;
use crate::time::{Duration, Instant};
use heapless::Deque;

/// Longer than this no frame waits in a queue, so that it is still known here when it comes straight back.
const PATIENCE: Duration = Duration::from_millis(600);

/// The same where frames come around: a loop of three must not take longer than a frame is known.
const LOOP_PATIENCE: Duration = Duration::from_millis(150);

/// The same on a high-latency link, where a line is busy for half a minute.
const HIGH_LATENCY_PATIENCE: Duration = Duration::from_secs(60);

/// RADIO of ardupilotmega, the older RADIO_STATUS.
const RADIO: u32 = 166;

/// What became of frames that are for somebody else, on one link. Numbers wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct ForwardCounters {
    /// Frames of others that this link has begun to send.
    pub sent: u32,
    /// Frames that found its queue full (R-14).
    pub queue_full: u32,
    /// Frames that waited too long in its queue: 600 ms, 150 ms where frames come around, a minute on a high-latency link.
    pub stale: u32,
    /// MAVLink 2 frames for this link, which sends MAVLink 1 (R-5).
    pub needs_v2: u32,
    /// Broadcasts that were not sent on this link because their source was heard on it within the last 5 s (R-4).
    pub source_heard: u32,
    /// Frames that were not sent on this link because the link by which they came had refused them: on a high-latency link
    /// they are not paid for (R-13); a link that accepts such frames unsigned would have them executed (R-10,
    /// `LinkConfig::with_refused_frames`).
    pub not_accepted: u32,
    /// Frames that came by this link and had been forwarded a moment ago: dropped (R-6).
    pub duplicates: u32,
    /// Frames that came by this link for somebody who was heard on none (R-2).
    pub no_route: u32,
    /// Addressed frames that were received on this link and handled locally only, because their source had no entry in the
    /// peer table (R-4). Broadcasts are forwarded without one.
    pub no_peer_slot: u32,
    /// Frames that came by this link and were handled here only, because so many others of this link are to be known again that
    /// there was no place for them (R-6). One that comes a second time is handled a second time.
    pub not_remembered: u32,
}

impl ForwardCounters {
    const ZERO: Self = Self {
        sent: 0,
        queue_full: 0,
        stale: 0,
        needs_v2: 0,
        source_heard: 0,
        not_accepted: 0,
        duplicates: 0,
        no_route: 0,
        no_peer_slot: 0,
        not_remembered: 0,
    };
}

/// What is kept of one link: zero bits at first.
#[derive(Clone, Copy, Debug)]
struct Lane {
    /// The link; none while nothing is forwarded to it, as before the first time that it was asked for something to send.
    link: LinkMask,
    class: LinkClass,
    version: Version,
    /// Refused frames that this accepts unsigned are kept from it.
    #[cfg(feature = "signing")]
    holds_refused: Accept,
    /// Whether a queued frame goes before a stream.
    has_turn: bool,
    ring: Ring,
    counters: ForwardCounters,
}

impl Lane {
    const CLOSED: Self = Self {
        link: LinkMask::NONE,
        class: LinkClass::Normal,
        version: Version::V1,
        #[cfg(feature = "signing")]
        holds_refused: Accept::Open,
        has_turn: false,
        ring: Ring::EMPTY,
        counters: ForwardCounters::ZERO,
    };

    /// Whether such a frame is for links of this class at all.
    fn takes(&self, id: u32, target: Address) -> bool {
        match self.class {
            LinkClass::Normal => true,
            LinkClass::Private => target.system.0 != 0 && target.component.0 != 0,
            LinkClass::HighLatency => target.system.0 != 0 && is_command(id),
        }
    }

    /// Whether such a frame is kept from this link when another one refused it (R-10, R-13). One with a bad signature is treated
    /// as if it had none: a component behind the link may not verify it.
    fn holds_refused(&self, id: u32, has_key: bool) -> bool {
        #[cfg(feature = "signing")]
        return self.holds_refused.takes_unsigned(id, has_key);
        #[cfg(not(feature = "signing"))]
        {
            // No link refuses anything.
            let _ = (self, id, has_key);
            false
        }
    }
}

/// What a high-latency link is for (L-4).
fn is_command(id: u32) -> bool {
    matches!(id, CommandLong::ID | CommandInt::ID | CommandAck::ID | CommandCancel::ID)
}

/// The vehicle's memory for forwarding between `LINKS` links: a queue of `BYTES` bytes for each, and `SEEN` places of 8 bytes
/// for the frames of the last 0.8 s, by which those are found that come back: no more are forwarded in that time. The vehicle
/// keeps it and hands it to the stack by [`Vehicle::forwarding`](crate::Vehicle::forwarding); one that does not forwards
/// nothing, and pays nothing.
///
/// `SEEN` is the frames of others that come in a second on all links together, times 0.8, and a third more if most of them come
/// by one link, which gets no more than three places of four. A frame has about 40 bytes: two radios of 57,600 bit/s that are
/// full bring 290 a second, and need 256 places (2 KiB); a radio and a companion computer that says little, 64.
/// [`not_remembered`](ForwardCounters::not_remembered) tells when it was too few.
///
/// What the stack itself has to say goes first. So beside the transfer of a plan or of all parameters, which fills a line for
/// seconds, little is forwarded there: what has waited for 600 ms is dropped. [`ForwardCounters`] tell.
///
/// Which links take part is in their configuration, see [`LinkConfig::with_forwarding`](crate::LinkConfig::with_forwarding). A
/// link takes part as soon as it is asked for something to send.
///
/// ```
/// use mavstack::{Address, Config, ForwardQueues, Forwarding, LinkClass, LinkConfig, Pulse, Vehicle, VehicleState};
///
/// static PULSE: Pulse = Pulse::new();
/// const CONFIG: Config = Config::new(Address::new(1, 1), &PULSE);
/// /// A telemetry radio, a companion computer, a gimbal that is to hear nothing but what is for it.
/// const LINKS: [LinkConfig; 3] = [
///     LinkConfig::uart(57_600),
///     LinkConfig::uart(921_600),
///     LinkConfig::uart(115_200).with_class(LinkClass::Private),
/// ];
///
/// struct Rover { queues: ForwardQueues<3> }
///
/// impl Vehicle for Rover {
///     fn state(&self) -> Option<VehicleState> {
///         None
///     }
///
///     fn forwarding(&mut self) -> Option<Forwarding<'_>> {
///         Some(self.queues.forwarding())
///     }
/// }
///
/// # use mavstack::dialect::*;
/// # use mavstack::*;
/// # impl Commands for Rover { fn command(&mut self, _: &Command) -> Outcome { MavResult::UNSUPPORTED.into() } }
/// # impl Plans for Rover {
/// #     const MISSION_COMMANDS: &'static [CommandRule] = &[];
/// #     fn plan_changed(&mut self, _: PlanChange<'_>) {}
/// #     fn progress(&self) -> Progress {
/// #         Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
/// #     }
/// # }
/// # impl Telemetry for Rover {}
/// # impl Parameters for Rover { type Table = NoParams; }
/// let (radio, companion) = (LinkId(0), LinkId(1));
/// let mut rover = Rover { queues: ForwardQueues::new() };
/// let mut stack: Stack<3, NoPlans> = Stack::new(CONFIG, LINKS);
/// let now = Instant::from_millis(1);
/// # for link in [radio, companion] { assert!(stack.transmit(now, link, &mut rover).is_empty()); }
///
/// // The ground station's heartbeat comes by the radio, and goes on to the companion computer as it is.
/// let mut frame = [0; 32];
/// let heartbeat = Heartbeat { r#type: MavType::GCS, mavlink_version: 3, ..Default::default() };
/// let len = encode(&heartbeat, Version::V2, Address::new(255, 190), 0, &mut frame)?;
/// stack.receive(now, radio, &frame[..len], &mut rover);
/// assert_eq!(stack.transmit(now, companion, &mut rover), &frame[..len]);
/// # Ok::<(), mavstack::EncodeError>(())
/// ```
///
/// # What becomes of a frame
///
/// ```text
///             SETUP_SIGNING, RADIO_STATUS,       forwarded a               source has no place
///             to us alone, link does not forward moment ago?               in the peer table?
///   frame ──▶ stays? ──────────────────────────▶ again? ──▶ learn ───────▶ kept? ──▶ routes ──▶ a queue for each link
///               │                                  │        (source, link)   │         │              │ when the line is
///               ▼                                  ▼                         ▼         ▼              ▼ idle, in turn
///             handled here                      dropped                  handled here  no_route    transmit   with streams
/// ```
///
/// - **Routes are learned**: the [peer table](crate::PeerInfo) is the route table. A broadcast goes to every other link, a
///   frame for somebody to the links that he was heard on, one for a component of our own system likewise (R-2, R-3).
/// - **A frame stays as it is**, to the byte: number, signature, flags, untrimmed zeros (R-5). One whose id is unknown goes
///   to all (R-9).
/// - **A refused frame**, one that its link did not accept for its signature or for want of one, is forwarded to the links that
///   judge for themselves. It is not forwarded to a link whose configuration accepts its message unsigned, where it could be
///   executed (R-10): an open link, a `SignedExcept` link that lists the message, and any `SignedExcept` link while the
///   vehicle has no key. It is not forwarded by satellite, where each frame is paid for (R-13).
///   [`not_accepted`](ForwardCounters::not_accepted) counts the frames that are held back.
/// - **Never back**: a frame is not sent on the link that it came by. A broadcast is not sent on a link on which its source was
///   heard within the last 5 s either, which is counted as [`source_heard`](ForwardCounters::source_heard). An addressed
///   frame is sent on every other link on which its target was heard (R-4).
/// - **Loops end**: what was forwarded is known again for 0.8 s, and then neither forwarded nor handled a second time
///   (R-6): a stack sends a frame at most once to each link, and once more if it had refused it the first time. So in a
///   ring of three, over lines of 57,600 bit/s and up to 40 ms, each frame passes each line at most once each way,
///   whatever the traffic, however small the peer table, and wherever its source was heard. With up to four lines between
///   the three it is delivered at most as often as there are lines, and twice more. Around longer ways only R-4 ends a loop,
///   and only for broadcasts.
/// - **None is forgotten early**: the memory has `SEEN` places, and what finds none is handled here only, and counted.
///   As it is not remembered it is handled each time that it comes: twice, if during a flood it comes by two links. So
///   is what goes to no other link, and is not forwarded at all. A command that must not be carried out twice is told
///   by the service that answers it ([`CommandPolicy::once`](crate::CommandPolicy::once)), not here. 256 places are 320
///   frames a second. One link takes three places for each that is free, 240 broadcasts a second if the others are
///   silent; for addressed frames it takes seven. So a flood by one link leaves places for what is addressed, and for
///   all that comes by others. Copies take none: whoever sends a frame again keeps nobody out.
/// - **Refused is not accepted**: who is refused and sends the bytes that another is about to send suppresses nothing. When
///   they are accepted they are handled, and go wherever they would have gone without him, so that a link may get them twice.
///   The refused of all links share the places of one; in a queue they get room only if half of it stays free, or it is empty.
/// - **Local traffic goes first**: queued frames are sent while the line is idle, one of them and one stream in turn, so they
///   delay an answer by no more than one of them (R-14). Where answers fill a line, as in the transfer of a plan or of all
///   parameters, nothing else goes out: what has waited for 600 ms is dropped, and counted as stale. In a loop of three the
///   limit is 150 ms; otherwise a frame could be in transit for longer than it is remembered. Links count as a loop for ten
///   seconds after a duplicate came by another link than the original: of an addressed frame, or of a broadcast whose source
///   was not heard there.
/// - **A full queue drops whole frames**, and counts them. Its last quarter is for what is addressed and accepted.
///
/// A [private](crate::LinkClass::Private) link gets only frames for a component that was heard there (R-12). A high-latency
/// link gets only commands for a peer there, and their answers (R-13), and only while no other link reaches that peer. A link
/// reaches a peer while the peer's heartbeats are received on it, or if any of its frames was received there within the last
/// 5 s (R-7). A frame for all components of a system is sent on every link on which one of them is heard.
#[derive(Clone, Debug)]
pub struct ForwardQueues<const LINKS: usize, const BYTES: usize = 512, const SEEN: usize = 256> {
    lanes: [Lane; LINKS],
    bytes: [[u8; BYTES]; LINKS],
    memory: Memory<Deque<Seen, SEEN>>,
}

impl<const LINKS: usize, const BYTES: usize, const SEEN: usize> ForwardQueues<LINKS, BYTES, SEEN> {
    /// Nothing forwarded. Links from number `LINKS` on take no part. `BYTES` is 286 at least, so that every frame has room in
    /// an empty queue, and `SEEN` is not 0, or it does not compile.
    pub const fn new() -> Self {
        const { assert!(Ring::holds(BYTES, MAX_FRAME_LEN), "a queue must hold the longest frame: 286 bytes") };
        const { assert!(SEEN > 0, "what was forwarded must be remembered") };
        const { assert!(LINKS > 1 && LINKS <= crate::link::MAX_LINKS, "frames pass between 2 to 16 links") };
        Self { lanes: [Lane::CLOSED; LINKS], bytes: [[0; BYTES]; LINKS], memory: Memory::<Deque<Seen, SEEN>>::EMPTY }
    }

    /// What the stack works on.
    pub const fn forwarding(&mut self) -> Forwarding<'_> {
        let Self { lanes, bytes, memory } = self;
        Forwarding { lanes, bytes: bytes.as_flattened_mut(), size: BYTES, memory }
    }

    /// What became of the frames that came by a link, or were for it.
    pub fn counters(&self, link: LinkId) -> Option<ForwardCounters> {
        self.lanes.get(usize::from(link.0)).map(|lane| lane.counters)
    }
}

impl<const LINKS: usize, const BYTES: usize, const SEEN: usize> Default for ForwardQueues<LINKS, BYTES, SEEN> {
    fn default() -> Self {
        Self::new()
    }
}

/// A [`ForwardQueues`] of any size, lent to the stack.
#[derive(Debug)]
pub struct Forwarding<'a> {
    lanes: &'a mut [Lane],
    /// Of all queues, one behind the other.
    bytes: &'a mut [u8],
    /// Bytes of each queue.
    size: usize,
    memory: &'a mut Memory,
}

/// Whether a frame is to be forwarded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Passage {
    /// It is not.
    Stays,
    /// It was, a moment ago (R-6).
    Again,
    /// It is, if there is a link for it.
    Goes(Ticket),
}

impl Forwarding<'_> {
    /// Examines a frame that a link received, and accepted or refused. `is_way`: it is a broadcast whose source was heard there
    /// before, so R-4 prevents a loop.
    pub(crate) fn examine(
        &mut self,
        now: Instant,
        port: &Port,
        frame: &Frame<'_>,
        is_accepted: bool,
        is_way: impl FnOnce() -> bool,
    ) -> Passage {
        let id = frame.id();
        let stays = matches!(id, SetupSigning::ID | RadioStatus::ID | RADIO);
        if stays || (port.config.class == LinkClass::HighLatency && id != HighLatency2::ID && !is_command(id)) {
            return Passage::Stays;
        }
        match self.memory.recall(now, frame.raw(), port.id, is_accepted) {
            Recall::New(ticket) => Passage::Goes(ticket),
            Recall::Copy { is_same_way } => {
                // Else its sender has sent it twice, or by two links, or whoever is not believed has.
                if is_accepted && !is_same_way && !is_way() {
                    self.memory.on_loop(now);
                }
                self.count(port.id, |counters| &mut counters.duplicates);
                Passage::Again
            }
        }
    }

    /// Puts a frame that came by the link `from` into the queues of those that it is for, and tells which. `has_key`: whether the
    /// vehicle has a key to verify signatures with.
    pub(crate) fn pass_on(
        &mut self,
        now: Instant,
        from: LinkId,
        frame: &Frame<'_>,
        ticket: &Ticket,
        routes: Routes,
        has_key: bool,
    ) -> LinkMask {
        let target = routes.target;
        let is_addressed = target.system.0 != 0;
        let (takes, from_link) = (|lane: &Lane| lane.takes(frame.id(), target), LinkMask::of(from));
        let is_normal = |lane: &Lane| lane.class != LinkClass::HighLatency;
        // If so, no satellite message is paid for (R-7).
        let lives_elsewhere =
            self.lanes.iter().any(|lane| is_normal(lane) && routes.alive.contains(lane.link) && takes(lane));
        let mut takers = LinkMask::NONE;
        for lane in self.lanes.iter_mut() {
            let is_way =
                routes.to.contains(lane.link) && lane.link != from_link && (is_normal(lane) || !lives_elsewhere);
            if !is_way || !takes(lane) {
                continue;
            }
            if !is_addressed && routes.seen.contains(lane.link) {
                count(&mut lane.counters.source_heard);
            } else if ticket.is_refused() && lane.holds_refused(frame.id(), has_key) {
                count(&mut lane.counters.not_accepted);
            } else {
                takers = takers.with(lane.link);
            }
        }
        // What was refused before is known as accepted from now on, or it would be handled at each copy.
        if !ticket.was_refused && takers.is_empty() {
            return LinkMask::NONE;
        }
        if !self.memory.has_room(ticket, is_addressed) {
            self.count(from, |counters| &mut counters.not_remembered);
            return LinkMask::NONE;
        }
        // A storm of broadcasts leaves room for what is for somebody, and what anybody can send for what is accepted.
        let spare = match is_addressed {
            _ if ticket.is_refused() => self.size / 2,
            true => 0,
            false => self.size / 4,
        };
        let mut queued = LinkMask::NONE;
        let mut rest = &mut *self.bytes;
        for lane in self.lanes.iter_mut() {
            let Some((bytes, others)) = core::mem::take(&mut rest).split_at_mut_checked(self.size) else { break };
            rest = others;
            if !takers.contains(lane.link) {
                continue;
            }
            if frame.header().version == Version::V2 && lane.version == Version::V1 {
                count(&mut lane.counters.needs_v2);
            } else if lane.ring.push(bytes, now, frame.raw(), spare) {
                queued = queued.with(lane.link);
            } else {
                count(&mut lane.counters.queue_full);
            }
        }
        self.memory.note(now, ticket);
        queued
    }

    /// Says that a link is there, and what it takes.
    pub(crate) fn open(&mut self, port: &Port) {
        let Some(lane) = self.lanes.get_mut(usize::from(port.id.0)) else { return };
        lane.link = if port.config.forwards { LinkMask::of(port.id) } else { LinkMask::NONE };
        lane.class = port.config.class;
        #[cfg(feature = "signing")]
        {
            lane.holds_refused = port.config.holds_refused();
        }
        lane.version = port.outbox.version();
    }

    /// Whether a queued frame goes before a stream.
    pub(crate) fn has_turn(&self, link: LinkId) -> bool {
        self.lanes.get(usize::from(link.0)).is_some_and(|lane| lane.has_turn)
    }

    /// A stream was sent: a queued frame is next.
    pub(crate) fn streamed(&mut self, link: LinkId) {
        if let Some(lane) = self.lanes.get_mut(usize::from(link.0)) {
            lane.has_turn = true;
        }
    }

    /// Sends the next frame of the link's queue. False when there is none.
    pub(crate) fn next(&mut self, now: Instant, out: &mut Outbox) -> bool {
        let link = usize::from(out.link().0);
        let Some(lane) = self.lanes.get_mut(link) else { return false };
        let bytes = self.bytes.get(link.saturating_mul(self.size)..).and_then(|bytes| bytes.get(..self.size));
        let patience = match lane.class {
            LinkClass::HighLatency => HIGH_LATENCY_PATIENCE,
            _ if self.memory.is_looped(now) => LOOP_PATIENCE,
            _ => PATIENCE,
        };
        while let Some((waited, frame)) = lane.ring.pop(bytes.unwrap_or_default(), now) {
            if waited > patience {
                count(&mut lane.counters.stale);
            } else if out.forward(frame) {
                count(&mut lane.counters.sent);
                lane.has_turn = false;
                return true;
            }
        }
        false
    }

    /// Whether a link's queue is empty.
    pub(crate) fn is_empty(&self, link: LinkId) -> bool {
        self.lanes.get(usize::from(link.0)).is_none_or(|lane| lane.ring.is_empty())
    }

    #[cfg(feature = "defmt")]
    pub(crate) fn counters(&self, link: LinkId) -> Option<ForwardCounters> {
        self.lanes.get(usize::from(link.0)).map(|lane| lane.counters)
    }

    pub(crate) fn count(&mut self, link: LinkId, counter: impl FnOnce(&mut ForwardCounters) -> &mut u32) {
        if let Some(lane) = self.lanes.get_mut(usize::from(link.0)) {
            count(counter(&mut lane.counters));
        }
    }
}

fn count(counter: &mut u32) {
    *counter = counter.wrapping_add(1);
}
