//! Forwarding of frames from one link to others.
//!
//! Implements <https://mavlink.io/en/guide/routing.html>, rules R-1 to R-16: the vehicle connects its links. For
//! example, a ground station on the telemetry radio and a companion computer on a UART can communicate, and so can
//! systems behind them.
//!
//! [`ForwardQueues`] documents which frames are forwarded. Only forwarded frames are remembered for duplicate detection.
//! Duplicates of other frames are handled locally like any frame.

use super::memory::{Lookup, Memory, NewFrame, Seen};
use super::queue::Ring;
use super::routes::Routes;
use crate::dialect::{CommandAck, CommandCancel, CommandInt, CommandLong, HighLatency2, RadioStatus, SetupSigning};
use crate::frame::{Frame, MAX_FRAME_LEN, Version};
use crate::link::{Outbox, Port};
use crate::log::increment;
use crate::message::{Address, Message};
use crate::time::{Duration, Instant};
#[cfg(feature = "signing")]
use crate::types::Accept;
use crate::types::{LinkClass, LinkId, LinkMask};
use heapless::Deque;

/// How long a frame may wait in a queue. If its peer sends it back at once, it is still remembered.
const MAX_WAIT: Duration = Duration::from_millis(600);

/// [`MAX_WAIT`] while links form a loop: a pass through a loop of three must not take longer than a frame is remembered.
const MAX_WAIT_IN_LOOP: Duration = Duration::from_millis(150);

/// [`MAX_WAIT`] of a high-latency link, which may be busy for half a minute.
const MAX_WAIT_HIGH_LATENCY: Duration = Duration::from_secs(60);

/// RADIO of ardupilotmega, the predecessor of RADIO_STATUS.
const RADIO: u32 = 166;

counters! {
    /// Counts of the frames that one link forwarded and dropped. They wrap.
    ForwardCounters {
        /// Forwarded frames that this link has begun to send.
        count sent,
        /// Frames for this link that were dropped because its queue was full (R-14).
        drop queue_full,
        /// Frames that were dropped because they waited too long in this link's queue: 600 ms, 150 ms in a routing loop, 60
        /// s on a high-latency link.
        drop stale,
        /// MAVLink 2 frames that were not sent on this link because it sends MAVLink 1 (R-5, S-10).
        drop needs_v2,
        /// Broadcasts that were not sent on this link because their source was heard on it within the last 5 s (R-4).
        // The other side has the frame, so this is no drop. Redundant links count each heartbeat here.
        count source_heard,
        /// Frames that were not sent on this link because the link on which they were received had refused them. A
        /// high-latency link does not send them, because each frame costs money (R-13). A link that accepts their message
        /// unsigned does not send them, because its peers could execute them (R-10, `LinkConfig::with_refused_frames`).
        drop not_accepted,
        /// Frames that were not sent on this high-latency link because the credits were used up (L-17,
        /// [`Stack::set_credits`](crate::Stack::set_credits)).
        drop over_budget,
        /// Duplicates that were received on this link within 0.8 s after the original was forwarded. They are dropped
        /// (R-6).
        drop duplicates,
        /// Frames that were received on this link for a target that was heard on no link (R-2).
        drop no_route,
        /// Addressed frames that were received on this link and handled locally only, because their source had no entry in
        /// the peer table (R-4). Broadcasts are forwarded without one.
        drop no_peer_slot,
        /// Frames that were received on this link and handled locally only, because this link has taken its share of the
        /// memory for duplicate detection (R-6). Duplicates of such a frame are handled again.
        drop not_remembered,
    }
}

/// The state of forwarding on one link. Initially all bits are zero.
#[derive(Clone, Copy, Debug)]
struct Lane {
    /// The link; none if it takes no part in forwarding, and before its first transmission.
    link: LinkMask,
    class: LinkClass,
    version: Version,
    /// Refused frames of messages that this accepts unsigned are not forwarded to the link.
    #[cfg(feature = "signing")]
    withholds: Accept,
    ring: Ring,
    counters: ForwardCounters,
}

impl Lane {
    const CLOSED: Self = Self {
        link: LinkMask::NONE,
        class: LinkClass::Normal,
        version: Version::V1,
        #[cfg(feature = "signing")]
        withholds: Accept::Open,
        ring: Ring::EMPTY,
        counters: ForwardCounters::ZERO,
    };

    /// Returns whether links of this class forward such a frame at all.
    fn takes(&self, id: u32, target: Address) -> bool {
        match self.class {
            LinkClass::Normal => true,
            LinkClass::Private => !target.system.is_all() && !target.component.is_all(),
            LinkClass::HighLatency => !target.system.is_all() && is_command(id),
        }
    }

    /// Returns whether a frame that another link refused is not forwarded to this link (R-10, R-13). A frame with an
    /// invalid signature is treated like one without: the components on the link may not verify it.
    fn withholds(&self, id: u32, has_key: bool) -> bool {
        #[cfg(feature = "signing")]
        return self.withholds.accepts_unsigned(id, has_key);
        #[cfg(not(feature = "signing"))]
        {
            // Without signing no link refuses frames.
            let _ = (self, id, has_key);
            false
        }
    }
}

/// Returns whether a message belongs to the command protocol, which high-latency links forward (L-4).
fn is_command(id: u32) -> bool {
    matches!(id, CommandLong::ID | CommandInt::ID | CommandAck::ID | CommandCancel::ID)
}

/// The state of forwarding between `LINKS` links. Declared by `forwarding: { bytes: BYTES, seen: SEEN }` in
/// [`#[stack]`](macro@crate::Stack); a vehicle that does not declare it forwards nothing.
///
/// It has a queue of `BYTES` bytes for each link. For duplicate detection it has `SEEN` places of 12 bytes, one for each
/// frame that was forwarded within the last 0.8 s; no more frames than that are forwarded in this time.
///
/// [`LinkConfig::with_forwarding`](crate::LinkConfig::with_forwarding) selects the links that take part. A link takes part
/// from its first transmission on.
///
/// # Choosing `SEEN`
///
/// Take the number of frames of other systems that all links receive in a second, times 0.8. Add a third if most of
/// them are received on one link, because a link gets at most three places of four. A frame has about 40 bytes:
///
/// | links | frames a second | `SEEN` |
/// |---|---:|---:|
/// | two radios of 57,600 bit/s, fully loaded | 290 | 256 (3 KiB) |
/// | a radio, and a companion computer that sends little | | 64 |
///
/// [`not_remembered`](ForwardCounters::not_remembered) counts the frames for which there was no place.
///
/// # Example
///
/// ```
/// use mavstack::dialect::{Heartbeat, MavResult, MavType};
/// use mavstack::config::LinkClass;
/// use mavstack::frame::{Version, encode};
/// use mavstack::prelude::*;
///
/// static PULSE: Pulse = Pulse::new();
/// const CONFIG: Config = Config::new(Address::new(1, 1), &PULSE);
/// /// A telemetry radio, a companion computer, and a gimbal that receives only frames addressed to it.
/// const LINKS: [LinkConfig; 3] = [
///     LinkConfig::uart(57_600),
///     LinkConfig::uart(921_600),
///     LinkConfig::uart(115_200).with_class(LinkClass::Private),
/// ];
/// #[derive(Stack)]
/// #[stack(vehicle: Rover, links: 3, forwarding)]
/// struct Mavlink;
///
/// # struct Rover;
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { MavResult::UNSUPPORTED.into() }
/// # }
/// let (radio, companion) = (LinkId(0), LinkId(1));
/// let (mut rover, mut stack) = (Rover, StackOf::<Mavlink>::new(CONFIG, LINKS));
/// let now = Instant::from_millis(1);
/// # for link in [radio, companion] { assert!(stack.transmit(now, link, &mut rover).is_empty()); }
///
/// // The ground station's heartbeat is received on the radio, and forwarded unchanged to the companion computer.
/// let mut frame = [0; 32];
/// let heartbeat = Heartbeat { r#type: MavType::GCS, mavlink_version: 3, ..Default::default() };
/// let len = encode(&heartbeat, Version::V2, Address::new(255, 190), 0, &mut frame)?;
/// stack.receive(now, radio, &frame[..len], &mut rover);
/// assert_eq!(stack.transmit(now, companion, &mut rover), &frame[..len]);
/// # Ok::<(), mavstack::frame::EncodeError>(())
/// ```
///
/// # The path of a frame
///
/// ```text
///            SETUP_SIGNING, RADIO_STATUS,     forwarded within           addressed, and its source
///            for us only, or link not         the last 0.8 s             is not in the peer table
///            configured to forward
///   frame ──▶ local? ───────────────────────▶ duplicate? ──▶ learn ────▶ unknown? ──▶ routes ──▶ queue of each link
///               │                               │       (source, link)     │            │          │ while the link is idle,
///               ▼                               ▼                          ▼            ▼          ▼ alternating with streams
///         handled only                       dropped                 handled only    no_route   transmit
/// ```
///
/// - **Routes are learned.** The [peer table](crate::network::PeerInfo) is the route table. A broadcast is sent on all other
///   links. An addressed frame is sent on the links on which its target was heard, also if the target is a component of
///   the vehicle's own system (R-2, R-3).
/// - **Frames are not changed**, not in a single byte: sequence number, signature, flags, untrimmed zeros (R-5). A
///   frame with an unknown id is treated as a broadcast (R-9).
/// - **Never back.** A frame is not sent on the link on which it was received. A broadcast is not sent on a link on
///   which its source was heard within the last 5 s either, which is counted as
///   [`source_heard`](ForwardCounters::source_heard). An addressed frame is sent on every other link on which its
///   target was heard (R-4).
/// - **Local traffic has priority.** Queued frames are sent while the link is idle, alternating with streams, so they
///   delay an answer by at most one frame (R-14). When answers need the whole link, as in the transfer of a plan or of
///   all parameters, nothing is forwarded to it for seconds. Frames that have waited for more than 600 ms are dropped,
///   and counted as [`stale`](ForwardCounters::stale).
/// - **A full queue drops whole frames**, and counts them. Its last quarter is reserved for addressed, accepted frames.
///
/// ## Link classes
///
/// A [private](crate::config::LinkClass::Private) link gets only frames for a component that was heard there (R-12). A
/// high-latency link gets only commands for a peer there, and their answers (R-13), and only while no other link
/// reaches that peer. What peers send there is limited by the [credits](crate::Stack::set_credits) (L-17). A link reaches a peer while the peer's heartbeats are received on it, or if any of its frames was
/// received there within the last 5 s (R-7). A frame for all components of a system is for each of them: it is sent on a
/// high-latency link only if one of the components there is reached by no other link.
///
/// ## Refused frames
///
/// A link refuses a frame if its signature is invalid, or if it is not signed but must be.
///
/// - A refused frame is forwarded to links that verify it themselves. It is not forwarded to a link whose configuration
///   accepts its message unsigned, where it could be executed (R-10): an open link, a `SignedExcept` link that lists
///   the message, and any `SignedExcept` link while the vehicle has no key. It is not forwarded to a high-latency link,
///   where each frame costs money (R-13). [`not_accepted`](ForwardCounters::not_accepted) counts these frames.
/// - A refused frame suppresses no accepted frame. An attacker may send the bytes that another sender is about to send:
///   once they are accepted, they are handled and forwarded as usual, so a link may get them twice.
/// - The refused frames of all links share the places of one link. A refused frame enters a queue only if half of the
///   queue stays free, or if it is empty.
///
/// ## Routing loops and duplicates
///
/// **Routing loops are broken.** A forwarded frame is remembered for 0.8 s; during that time its duplicates are neither
/// forwarded nor handled (R-6). So the stack sends a frame at most once on each link, and a second time if it had
/// refused the frame the first time.
///
/// | topology, links of 57,600 bit/s with a delay of up to 40 ms | result |
/// |---|---|
/// | a loop of three stacks | each frame passes each link at most once in each direction |
/// | three stacks, with up to four links between them | each frame is delivered at most once per link, and twice more |
/// | longer loops | only R-4 breaks the loop, and only for broadcasts |
///
/// The first two hold for any traffic and any size of the peer table, and wherever the source was heard.
///
/// In a loop of three, frames may wait for 150 ms instead of 600 ms; otherwise a frame could be in transit for longer
/// than it is remembered. Links count as a loop for ten seconds after a duplicate was received on another link than the
/// original, if the frame is addressed, or if it is a broadcast whose source was not heard there.
///
/// **No frame is forgotten early.** A frame that finds no place in the memory is handled locally only, and counted. It
/// is not remembered, so each duplicate is handled again: twice, for example, if it is received on two links during a
/// flood. The same is true for frames that are for no other link, which are not forwarded at all. So services must
/// detect duplicates of commands that must not be executed twice: [`CommandPolicy::once`](crate::command::CommandPolicy::once).
///
/// **Links share the places.** 256 places suffice for 320 frames a second. A link may take three places for each free
/// one: 240 broadcasts a second if the other links are silent. For addressed frames it may take seven. So a flood on
/// one link leaves places for addressed frames and for the other links. Duplicates take no places: a sender that
/// repeats a frame displaces nothing.
#[derive(Clone, Debug)]
pub struct ForwardQueues<const LINKS: usize, const BYTES: usize = 512, const SEEN: usize = 256> {
    lanes: [Lane; LINKS],
    bytes: [[u8; BYTES]; LINKS],
    memory: Memory<Deque<Seen, SEEN>>,
}

impl<const LINKS: usize, const BYTES: usize, const SEEN: usize> ForwardQueues<LINKS, BYTES, SEEN> {
    /// Returns empty queues. Links with an id of `LINKS` or more take no part.
    ///
    /// `LINKS` must be 2 to 16, `BYTES` at least 286, so that each frame fits in an empty queue, and `SEEN` at least 1.
    /// Otherwise it does not compile.
    pub const fn new() -> Self {
        const {
            assert!(
                Ring::holds(BYTES, MAX_FRAME_LEN),
                "a queue must hold the longest frame: 286 bytes, as in `forwarding: {{ bytes: 512 }}`"
            );
            assert!(SEEN > 0, "forwarded frames must be remembered: `forwarding: {{ seen: 256 }}`");
            assert!(
                LINKS > 1 && LINKS <= crate::types::MAX_LINKS,
                "frames pass between 2 to 16 links: with one link, leave `forwarding` out"
            );
        }
        Self { lanes: [Lane::CLOSED; LINKS], bytes: [[0; BYTES]; LINKS], memory: Memory::<Deque<Seen, SEEN>>::EMPTY }
    }

    /// Returns the state without its sizes, on which the logic works.
    pub(crate) const fn view(&mut self) -> QueuesView<'_> {
        let Self { lanes, bytes, memory } = self;
        QueuesView { lanes, bytes: bytes.as_flattened_mut(), size: BYTES, memory }
    }

    /// Returns the counts of a link; `None` if its id is `LINKS` or more.
    pub fn counters(&self, link: LinkId) -> Option<ForwardCounters> {
        self.lanes.get(usize::from(link.0)).map(|lane| lane.counters)
    }
}

impl<const LINKS: usize, const BYTES: usize, const SEEN: usize> Default for ForwardQueues<LINKS, BYTES, SEEN> {
    fn default() -> Self {
        Self::new()
    }
}

/// A borrowed view of [`ForwardQueues`] of any size.
#[derive(Debug)]
pub(crate) struct QueuesView<'a> {
    lanes: &'a mut [Lane],
    /// The bytes of all queues, one after the other.
    bytes: &'a mut [u8],
    /// Length of each queue.
    size: usize,
    memory: &'a mut Memory,
}

/// A frame to forward.
pub(crate) struct Passed<'a> {
    pub(crate) frame: &'a Frame<'a>,
    /// The link on which it was received.
    pub(crate) from: LinkId,
    pub(crate) new: &'a NewFrame,
    /// The vehicle has a key for verifying signatures.
    pub(crate) has_key: bool,
}

/// Whether a frame is forwarded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ForwardDecision {
    /// The frame is handled locally only.
    LocalOnly,
    /// The frame is a duplicate of a forwarded frame (R-6).
    Duplicate,
    /// The frame is forwarded, if there is a link for it.
    Forward(NewFrame),
}

impl QueuesView<'_> {
    /// Examines a frame that a link received, and accepted or refused. `is_broadcast_from_peer` returns whether it is a
    /// broadcast whose source was heard on the link before, so that R-4 prevents a loop. `secret` becomes part of the key for
    /// duplicate detection.
    pub(crate) fn examine(
        &mut self,
        now: Instant,
        secret: u64,
        port: &Port,
        frame: &Frame<'_>,
        is_accepted: bool,
        is_broadcast_from_peer: impl FnOnce() -> bool,
    ) -> ForwardDecision {
        let id = frame.id();
        // HIGH_LATENCY2 of others passes from a high-latency link (L-5).
        let is_local = matches!(id, SetupSigning::ID | RadioStatus::ID | RADIO);
        if is_local || (port.config.class == LinkClass::HighLatency && id != HighLatency2::ID && !is_command(id)) {
            return ForwardDecision::LocalOnly;
        }
        match self.memory.look_up(now, secret, frame.raw(), port.id, is_accepted) {
            Lookup::New(new) => ForwardDecision::Forward(new),
            Lookup::Duplicate { is_same_share } => {
                // Otherwise its sender has sent it twice, or on two links, or a refused sender has repeated it.
                if is_accepted && !is_same_share && !is_broadcast_from_peer() {
                    self.memory.note_loop(now);
                }
                self.increment(port.id, |counters| &mut counters.duplicates);
                ForwardDecision::Duplicate
            }
        }
    }

    /// Returns the links that forward such a frame without cost: all that forward it but high-latency links.
    pub(crate) fn free_links(&self, id: u32, target: Address) -> LinkMask {
        let is_free = |lane: &&Lane| lane.class != LinkClass::HighLatency && lane.takes(id, target);
        self.lanes.iter().filter(is_free).fold(LinkMask::NONE, |links, lane| links.with(lane.link))
    }

    /// Queues a frame for the links of its routes, and returns the links that queued it. `pay` takes credits for the frame
    /// on a high-latency link, and returns whether there were enough.
    pub(crate) fn push(
        &mut self,
        now: Instant,
        passed: &Passed<'_>,
        routes: Routes,
        mut pay: impl FnMut(usize) -> bool,
    ) -> LinkMask {
        let Passed { frame, from, new, has_key } = *passed;
        let target = routes.target;
        let is_addressed = !target.system.is_all();
        let mut links = LinkMask::NONE;
        for lane in self.lanes.iter_mut() {
            let is_route = routes.to.intersects(lane.link) && lane.link != LinkMask::of(from);
            if !is_route || !lane.takes(frame.id(), target) {
                continue;
            }
            if !is_addressed && routes.seen.intersects(lane.link) {
                increment(&mut lane.counters.source_heard);
            } else if new.is_refused() && lane.withholds(frame.id(), has_key) {
                increment(&mut lane.counters.not_accepted);
            } else {
                links = links.with(lane.link);
            }
        }
        // A frame that was refused before must be remembered as accepted, or each duplicate would be handled.
        if !new.was_refused && links.is_empty() {
            return LinkMask::NONE;
        }
        if !self.memory.has_room(new, is_addressed) {
            self.increment(from, |counters| &mut counters.not_remembered);
            return LinkMask::NONE;
        }
        // A storm of broadcasts leaves room for addressed frames, and refused frames leave room for accepted ones.
        let spare = match is_addressed {
            _ if new.is_refused() => self.size / 2,
            true => 0,
            false => self.size / 4,
        };
        let mut queued = LinkMask::NONE;
        let mut rest = &mut *self.bytes;
        for lane in self.lanes.iter_mut() {
            let Some((bytes, others)) = core::mem::take(&mut rest).split_at_mut_checked(self.size) else { break };
            rest = others;
            if !links.intersects(lane.link) {
                continue;
            }
            if frame.header().version == Version::V2 && lane.version == Version::V1 {
                increment(&mut lane.counters.needs_v2);
            } else if !lane.ring.takes(self.size, frame.raw().len(), spare) {
                increment(&mut lane.counters.queue_full);
            } else if lane.class == LinkClass::HighLatency && !pay(frame.raw().len()) {
                increment(&mut lane.counters.over_budget);
            } else {
                lane.ring.push(bytes, now, frame.raw());
                queued = queued.with(lane.link);
            }
        }
        self.memory.remember(now, new);
        queued
    }

    /// Opens the queue of a link, or updates it to the link's configuration.
    pub(crate) fn open(&mut self, port: &Port) {
        let Some(lane) = self.lanes.get_mut(usize::from(port.id.0)) else { return };
        lane.link = if port.config.forwards { LinkMask::of(port.id) } else { LinkMask::NONE };
        lane.class = port.config.class;
        #[cfg(feature = "signing")]
        {
            lane.withholds = port.config.holds_refused();
        }
        lane.version = port.outbox.version();
    }

    /// Sends the next frame of the link's queue. Returns false if there is none.
    pub(crate) fn next(&mut self, now: Instant, out: &mut Outbox) -> bool {
        let link = usize::from(out.link().0);
        let Some(lane) = self.lanes.get_mut(link) else { return false };
        let bytes = self.bytes.get(link.saturating_mul(self.size)..).and_then(|bytes| bytes.get(..self.size));
        let max_wait = match lane.class {
            LinkClass::HighLatency => MAX_WAIT_HIGH_LATENCY,
            _ if self.memory.is_looped(now) => MAX_WAIT_IN_LOOP,
            _ => MAX_WAIT,
        };
        while let Some((waited, frame)) = lane.ring.pop(bytes.unwrap_or_default(), now) {
            if waited > max_wait {
                increment(&mut lane.counters.stale);
            } else if out.forward(frame) {
                increment(&mut lane.counters.sent);
                return true;
            }
        }
        false
    }

    /// Returns whether a link's queue is empty.
    pub(crate) fn is_empty(&self, link: LinkId) -> bool {
        self.lanes.get(usize::from(link.0)).is_none_or(|lane| lane.ring.is_empty())
    }

    pub(crate) fn increment(&mut self, link: LinkId, counter: impl FnOnce(&mut ForwardCounters) -> &mut u32) {
        if let Some(lane) = self.lanes.get_mut(usize::from(link.0)) {
            increment(counter(&mut lane.counters));
        }
    }
}
