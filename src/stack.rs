//! The stack: all services of a vehicle behind a few calls, in fixed memory.
//!
//! The only module that knows every service. The way of the frames is drawn at [`Stack`].

mod commands;
#[cfg(feature = "defmt")]
mod drops;
#[cfg(all(feature = "storage", feature = "signing"))]
mod key;
mod plans;
mod receive;
mod routing;
mod signing;
#[cfg(feature = "storage")]
mod storage;
mod streams;
mod transmit;

use embedded_io::{Read, ReadReady, Write, WriteReady};

use crate::config::{Allowance, Config, VehicleAddress};
use crate::dialect::{MavProtocolCapability, MavSeverity};
use crate::frame::RxCounters;
use crate::link::{Link, LinkClass, LinkConfig, LinkCounters, LinkError, LinkId, LinkMask, MAX_LINKS, Transport};
#[cfg(feature = "defmt")]
use crate::log::DropLog;
use crate::message::Text;
use crate::network::{self, PeerInfo, Peers};
use crate::service::command;
use crate::service::heartbeat::Credit;
use crate::service::high_latency;
use crate::service::mission::{self, Missions, NoPlans, PlanStorage, PlanType, PlansMut};
use crate::service::mode::{self, FlightMode};
use crate::service::param::Params;
use crate::service::statustext::{Entry as TextEntry, StatusTexts};
use crate::service::stream::Slot;
use crate::time::Instant;
use crate::vehicle::{Autopilot, PeerEvent, VehicleState};

/// The vehicle's side of MAVLink: `LINKS` links, plans in a memory of type `P`, a table of `PEERS` peers, a queue of `TEXTS`
/// texts, room for `STREAMS` messages that the vehicle fills. All memory is inside.
/// [The crate's page](crate) shows the loop around it.
///
/// Most firmware names the first two and calls [`new`](Self::new); [`with_capacities`](Self::with_capacities) is for one
/// that names the others too.
///
/// Received frames go through the address filter to the service they are for; when a link has room, the services are asked in
/// a fixed order for one frame (D-4):
///
/// ```text
///   receive ──▶ decoder ──▶ own address? ──▶ peers ──▶ for us? ──▶ commands, plans, the vehicle's own messages
///                                              │
///                                              └─────▶ for others? ──▶ the queues of their links
///
///   transmit ◀── HEARTBEAT, COMMAND_ACK, MISSION_ACK, PING, TIMESYNC                        at once
///            ◀── plan requests and items, parameter values, texts, messages on request    while the link has room
///            ◀── streams and forwarded frames by turns                                    while the link is idle
///            ◀── the list of all parameters                                               at 40 % of the link's rate
/// ```
#[derive(Debug)]
pub struct Stack<
    const LINKS: usize,
    P: PlanStorage = NoPlans,
    const PEERS: usize = 8,
    const TEXTS: usize = 4,
    const STREAMS: usize = 24,
> {
    core: Core,
    links: [Link; LINKS],
    slots: [[Slot; STREAMS]; LINKS],
    peers: heapless::Vec<PeerInfo, PEERS>,
    texts: StatusTexts<[TextEntry; TEXTS]>,
    missions: P::Engine,
    plans: P,
}

/// What does not depend on any capacity, and so is compiled once.
#[derive(Debug)]
struct Core {
    config: Config,
    credit: Credit,
    /// The links that everything may be sent on, all but those of high latency.
    normal: LinkMask,
    capabilities: MavProtocolCapability,
    params: Params,
    /// The vehicle's mode, as last reported in CURRENT_MODE.
    mode: u32,
    /// The state that heartbeats report, as last seen.
    state: VehicleState,
    /// Whether the vehicle had a state at the last look: not while it is in a fault.
    has_state: bool,
    /// Links on which an extra heartbeat is pending (H-16).
    extra_heartbeats: LinkMask,
    /// Something was done for which an answer may be owed that only the vehicle knows of, on whatever link, or a change is to
    /// be told: who sleeps is to look once more.
    has_acted: bool,
    /// The sequence number and the low checksum byte of the last received frame with our own address, until all links have
    /// checked whether it is an echo.
    own_frame: Option<[u8; 2]>,
    /// Links with frames of others in their queues.
    forwards: LinkMask,
    /// When the loss of all ground stations has a consequence (L-14).
    loss_due: Instant,
    /// Drop counters that all links share, as last logged.
    #[cfg(feature = "defmt")]
    drops: DropLog,
    /// Which store may write.
    #[cfg(feature = "storage")]
    turn: storage::Turn,
}

/// What a call works with beside the core and its link.
struct Context<'a, V, P: PlanStorage> {
    now: Instant,
    peers: &'a mut Peers,
    texts: &'a mut StatusTexts,
    missions: &'a mut P::Engine,
    plans: &'a mut P,
    vehicle: &'a mut V,
    /// The link's streams.
    slots: &'a mut [Slot],
}

impl<const LINKS: usize, P: PlanStorage> Stack<LINKS, P> {
    /// A stack at rest, with the default capacities.
    ///
    /// `const`, but a `static` with this as its initial value keeps a copy of all its memory, plans included, in flash. Write
    /// it into a `static` at start instead (`MaybeUninit::write`, or the crate `static_cell`), as `examples/qemu` does.
    pub const fn new(config: Config, links: [LinkConfig; LINKS]) -> Self {
        Self::with_capacities(config, links)
    }
}

impl<const LINKS: usize, P: PlanStorage, const PEERS: usize, const TEXTS: usize, const STREAMS: usize>
    Stack<LINKS, P, PEERS, TEXTS, STREAMS>
{
    /// A stack at rest, with capacities of your own. `TEXTS` and `STREAMS` may be 0: then there are none.
    #[allow(
        clippy::indexing_slicing,
        clippy::arithmetic_side_effects,
        clippy::as_conversions,
        reason = "const-evaluated; the index is below LINKS, which is at most 16"
    )]
    pub const fn with_capacities(config: Config, configs: [LinkConfig; LINKS]) -> Self {
        const { assert!(LINKS > 0 && LINKS <= MAX_LINKS, "a stack has 1 to 16 links: the first number behind `Stack`") };
        const { assert!(PEERS > 0, "a stack needs room for a peer: 8 will do for most") };
        let mut links = [const { Link::VACANT }; LINKS];
        let mut normal = LinkMask::NONE;
        let mut i = 0;
        while i < LINKS {
            links[i].configure(LinkId(i as u8), configs[i], &config);
            if !matches!(configs[i].class, LinkClass::HighLatency) {
                normal = normal.with(LinkMask::of(LinkId(i as u8)));
            }
            i += 1;
        }
        Self {
            core: Core {
                config,
                credit: Credit::new(),
                normal,
                capabilities: capabilities::<P>(),
                params: Params::new(),
                mode: 0,
                state: VehicleState::ZERO,
                has_state: false,
                extra_heartbeats: LinkMask::NONE,
                has_acted: false,
                own_frame: None,
                forwards: LinkMask::NONE,
                loss_due: Instant::NEVER,
                #[cfg(feature = "defmt")]
                drops: DropLog::NEW,
                #[cfg(feature = "storage")]
                turn: storage::Turn::FREE,
            },
            links,
            slots: [[Slot::NEW; STREAMS]; LINKS],
            peers: heapless::Vec::new(),
            texts: StatusTexts::<[TextEntry; TEXTS]>::new(),
            missions: P::ENGINE,
            plans: P::EMPTY,
        }
    }

    /// Runs the timers of silent peers and stalled transfers, and checks whether the vehicle's state has changed. Bounded; call
    /// it in every pass of the loop.
    pub fn poll<V: Autopilot>(&mut self, now: Instant, vehicle: &mut V) {
        let core = &mut self.core;
        core.has_acted = false;
        core.has_credit(now);
        network::poll(&mut self.peers, now, core.config.peer_timeout, vehicle);
        command::poll(now, vehicle);
        core.loss_due = high_latency::poll(now, &mut self.links, &self.peers, vehicle);
        core.params.poll(now, vehicle);
        #[cfg(feature = "storage")]
        {
            core.turn = storage::Turn::FREE;
            if !vehicle.may_persist() {
                core.params.rest();
            }
        }
        let state = vehicle.state();
        core.notice(state);
        if !V::MODES.is_empty() {
            mode::poll(&mut core.mode, &mut self.links, state);
        }
        if let Some((missions, mut plans)) = self.plans.parts(&mut self.missions) {
            let mut context = core.plan_context(now, &mut plans, &mut self.texts);
            let owed = missions.poll(&mut context, vehicle);
            owe(&mut self.links, owed);
        }
        #[cfg(feature = "defmt")]
        self.log_drops(now, vehicle);
    }

    /// Moves bytes between a link and its transport: a bounded read, what the frames in it ask for, a bounded write.
    ///
    /// Never blocks: it reads and writes only what the transport says is ready. The bound is
    /// [`Config::budget`](crate::Config::budget). Polled less often than every 20 ms a link has pauses: no transfer has more under
    /// way than the line takes in that time, and a frame, or a heartbeat would have to wait behind it (D-4).
    ///
    /// # Errors
    ///
    /// What the transport reported, after everything else was done; see [`LinkError`]. The link goes on.
    pub fn poll_link<V: Autopilot, U: Read + Write + ReadReady + WriteReady>(
        &mut self,
        now: Instant,
        link: LinkId,
        uart: &mut U,
        vehicle: &mut V,
    ) -> Result<(), LinkError<U::Error>> {
        let mut allowance = self.core.config.budget.allowance();
        let read = self.poll_read(now, link, uart, vehicle, &mut allowance);
        let write = self.poll_write(now, link, uart, vehicle, &mut allowance);
        read.and(write)
    }

    fn poll_read<V: Autopilot, U: Read + ReadReady>(
        &mut self,
        now: Instant,
        link: LinkId,
        uart: &mut U,
        vehicle: &mut V,
        allowance: &mut Allowance,
    ) -> Result<(), LinkError<U::Error>> {
        let mut left = length(self.core.config.budget.rx_bytes);
        let result = loop {
            let decoder = &mut self.link_mut(link).ok_or(LinkError::NoSuchLink)?.decoder;
            allowance.spend_but_for_a_frame(decoder.spare_cost());
            let spare = decoder.spare();
            let room = spare.len().min(left);
            let Some(room) = spare.get_mut(..room).filter(|room| !room.is_empty()) else { break Ok(()) };
            let read = match uart.read_ready() {
                Ok(false) => break Ok(()),
                Ok(true) => uart.read(room),
                Err(error) => Err(error),
            };
            match read {
                Ok(0) => break Err(LinkError::Closed),
                Ok(len) => {
                    left = left.saturating_sub(len);
                    self.commit(now, link, len, vehicle, allowance);
                }
                Err(error) => {
                    if let Some(link) = self.link_mut(link) {
                        let errors = &mut link.port.counters.read_errors;
                        *errors = errors.wrapping_add(1);
                    }
                    break Err(LinkError::Read(error));
                }
            }
        };
        // What waits in the decoder from before: for silence, or for more budget.
        self.commit(now, link, 0, vehicle, allowance);
        result
    }

    fn poll_write<V: Autopilot, U: Write + WriteReady>(
        &mut self,
        now: Instant,
        link: LinkId,
        uart: &mut U,
        vehicle: &mut V,
        allowance: &mut Allowance,
    ) -> Result<(), LinkError<U::Error>> {
        let mut left = length(self.core.config.budget.tx_bytes);
        let result = loop {
            let begins = self.link_mut(link).is_none_or(|link| link.port.outbox.is_empty());
            if left == 0 || (begins && !allowance.may_send()) {
                return Ok(());
            }
            // Asked first: a frame that cannot begin yet is not made yet, so that after a stall the line is told how things
            // are then. A heartbeat from before the flight loop stopped must not follow it (H-5).
            let written = match uart.write_ready() {
                Ok(is_ready) => {
                    if let Some(link) = self.link_mut(link) {
                        link.port.transport = if is_ready { Transport::Ready } else { Transport::Full };
                    }
                    if !is_ready {
                        return Ok(());
                    }
                    let pending = self.transmit(now, link, vehicle);
                    if begins {
                        allowance.send(signing::cost_of_sending(pending));
                    }
                    let pending = pending.get(..left).unwrap_or(pending);
                    if pending.is_empty() {
                        return Ok(());
                    }
                    uart.write(pending)
                }
                Err(error) => Err(error),
            };
            match written {
                Ok(0) => break Err(LinkError::Closed),
                Ok(len) => {
                    left = left.saturating_sub(len);
                    self.transmitted(link, len);
                }
                Err(error) => break Err(LinkError::Write(error)),
            }
        };
        if let Some(link) = self.link_mut(link) {
            link.port.counters.write_errors = link.port.counters.write_errors.wrapping_add(1);
        }
        result
    }

    /// Takes received bytes, for interrupts and DMA: as many as there is room for, which is returned. Handles the frames in
    /// them, up to the budget of one poll; call it again with the rest, or with none when [`next_deadline`] says so.
    ///
    /// [`next_deadline`]: Self::next_deadline
    pub fn receive<V: Autopilot>(&mut self, now: Instant, link: LinkId, bytes: &[u8], vehicle: &mut V) -> usize {
        let mut allowance = self.core.config.budget.allowance();
        let mut taken = 0usize;
        // A buffer's worth at a time; more than two turns are only needed when the bytes are more than a buffer's worth.
        loop {
            let rest = bytes.get(taken..).unwrap_or_default();
            let Some(state) = self.link_mut(link) else { return 0 };
            let len = if rest.is_empty() { 0 } else { state.decoder.push(rest, now) };
            taken = taken.saturating_add(len);
            // Also where there was no room: what fills the buffer waits for this call's budget.
            self.commit(now, link, 0, vehicle, &mut allowance);
            if len == 0 || taken >= bytes.len() {
                return taken;
            }
        }
    }

    /// Room in the link's own buffer for bytes to be received into without a copy; then call
    /// [`received`](Self::received). Empty while frames wait for more budget; where nothing waits at all, room for the longest
    /// frame: see [`Decoder::spare`](crate::Decoder::spare).
    pub fn receive_buffer(&mut self, link: LinkId) -> &mut [u8] {
        self.link_mut(link).map(|link| link.decoder.spare()).unwrap_or_default()
    }

    /// The first `len` bytes of [`receive_buffer`](Self::receive_buffer) were filled. Handles the frames in them, up to the
    /// budget of one poll.
    pub fn received<V: Autopilot>(&mut self, now: Instant, link: LinkId, len: usize, vehicle: &mut V) {
        let mut allowance = self.core.config.budget.allowance();
        self.commit(now, link, len, vehicle, &mut allowance);
    }

    /// The bytes to be sent next on a link, at most the rest of one frame; then call
    /// [`transmitted`](Self::transmitted). Empty when there is nothing to say.
    #[inline(never)]
    pub fn transmit<V: Autopilot>(&mut self, now: Instant, link: LinkId, vehicle: &mut V) -> &[u8] {
        const { streams::check::<V>(STREAMS) };
        const { FlightMode::check(V::MODES) };
        let slots = slots_of(&mut self.slots, link);
        let Some(link) = self.links.get_mut(usize::from(link.0)) else { return &[] };
        let port = &mut link.port;
        if port.outbox.is_empty() {
            let (texts, missions, plans) = (&mut self.texts, &mut self.missions, &mut self.plans);
            let peers = &mut self.peers;
            self.core.fill(&mut Context { now, peers, texts, missions, plans, vehicle, slots }, port);
        } else {
            // One that is sent again (G-4).
            signing::sign(now, port, vehicle);
        }
        port.outbox.pending()
    }

    /// The transport took the first `len` bytes of [`transmit`](Self::transmit).
    pub fn transmitted(&mut self, link: LinkId, len: usize) {
        if let Some(link) = self.link_mut(link) {
            let len = len.min(link.port.outbox.pending().len());
            link.port.outbox.advance(len);
            link.port.bucket.spend(len);
            let bytes = &mut link.port.counters.tx_bytes;
            *bytes = bytes.wrapping_add(u32::try_from(len).unwrap_or(0));
        }
    }

    /// The line of a link was opened anew: forgets what was received of an unfinished frame, and sends the frame that was
    /// cut off from its start, unless it is a heartbeat, which would be of yesterday.
    pub fn restart_link(&mut self, link: LinkId) {
        if let Some(Link { decoder, port }) = self.links.get_mut(usize::from(link.0)) {
            decoder.clear();
            port.transport = Transport::Unknown;
            port.outbox.restart();
            port.plans.restart();
            self.core.params.restart(link, &mut port.params);
        }
    }

    /// Gives the vehicle another address, for a system id that is stored. Call it once, before the loop: who knows the vehicle
    /// by its address takes it for another one then.
    pub fn set_address(&mut self, address: VehicleAddress) {
        self.core.config.address = address;
        for link in &mut self.links {
            link.port.outbox.set_source(address.get());
        }
    }

    /// Tells the operators something: a STATUSTEXT on every normal link (T-5). Takes any text: a `&str`, or a
    /// [`&Text`](crate::Text) that numbers were put into. At most [`MAX_TEXT_LEN`](crate::MAX_TEXT_LEN) bytes, the rest is cut
    /// off; the same text again within five seconds is dropped. When four wait, the least severe goes.
    pub fn send_text(&mut self, now: Instant, severity: MavSeverity, text: &(impl AsRef<[u8]> + ?Sized)) {
        self.push_text(now, severity, text.as_ref());
    }

    /// The same, formatted by `core::fmt`, which costs some kilobytes of flash:
    /// `stack.send_fmt(now, MavSeverity::INFO, format_args!("Wind {wind:.1} m/s"))`. What is beyond
    /// [`MAX_TEXT_LEN`](crate::MAX_TEXT_LEN) bytes is cut off.
    #[cfg(feature = "fmt")]
    pub fn send_fmt(&mut self, now: Instant, severity: MavSeverity, text: core::fmt::Arguments<'_>) {
        let mut built = Text::<{ crate::MAX_TEXT_LEN }>::EMPTY;
        // An error is a text that was cut off.
        let _ = core::fmt::Write::write_fmt(&mut built, text);
        self.push_text(now, severity, built.as_bytes());
    }

    /// Not inlined: the text takes 120 bytes of stack, which are to be free again in the caller.
    #[inline(never)]
    fn push_text(&mut self, now: Instant, severity: MavSeverity, text: &[u8]) {
        let texts: &mut StatusTexts = &mut self.texts;
        texts.push(now, self.core.normal, severity, &Text::from_bytes(text));
    }

    /// Returns the peers that were heard, with their link quality: at most `PEERS`.
    /// [`PeerInfo`](PeerInfo#when-the-table-is-full) says which peer is evicted when the table is full.
    pub fn peers(&self) -> &[PeerInfo] {
        &self.peers
    }

    /// What a link sent, and what it did not take; `None` for a link that there is not.
    pub fn link_counters(&self, link: LinkId) -> Option<LinkCounters> {
        self.links.get(usize::from(link.0)).map(|link| link.port.counters)
    }

    /// What a link's decoder saw and dropped; `None` for a link that there is not.
    pub fn rx_counters(&self, link: LinkId) -> Option<RxCounters> {
        self.links.get(usize::from(link.0)).map(|link| link.decoder.counters())
    }

    /// Texts that were dropped, as repeated or for want of room. Wraps.
    pub fn dropped_texts(&self) -> u32 {
        let texts: &StatusTexts = &self.texts;
        texts.dropped()
    }

    /// When the stack must run again though no byte comes: for those who sleep in between. It also must run when a byte
    /// comes, when the transport can take more of [`transmit`](Self::transmit), and after the vehicle's state changed.
    pub fn next_deadline(&self, now: Instant) -> Instant {
        let core = &self.core;
        if core.has_acted {
            return now;
        }
        let missions = P::engine(&self.missions);
        let mut deadline = network::deadline(&self.peers, core.config.peer_timeout).min(core.loss_due);
        deadline = deadline.min(missions.map_or(Instant::NEVER, Missions::deadline)).min(core.params.deadline());
        for link in &self.links {
            deadline =
                deadline.min(link.decoder.deadline()).min(core.tx_deadline(now, &link.port, &self.texts, missions));
        }
        deadline.max(now)
    }

    fn link_mut(&mut self, link: LinkId) -> Option<&mut Link> {
        self.links.get_mut(usize::from(link.0))
    }

    /// `len` bytes stand in the decoder's spare room: handles what frames there are, as far as the allowance goes.
    fn commit<V: Autopilot>(
        &mut self,
        now: Instant,
        link: LinkId,
        len: usize,
        vehicle: &mut V,
        allowance: &mut Allowance,
    ) {
        high_latency::learn_links(&self.links, vehicle);
        let slots = slots_of(&mut self.slots, link);
        let Some(state) = self.links.get_mut(usize::from(link.0)) else { return };
        if len > 0 {
            state.decoder.commit(len, now);
        }
        let (texts, missions, plans) = (&mut self.texts, &mut self.missions, &mut self.plans);
        let mut context = Context { now, peers: &mut self.peers, texts, missions, plans, vehicle, slots };
        const { V::MESSAGES.check() };
        self.core.drain(&mut context, state, V::MESSAGES, allowance);
        if let Some(own_frame) = self.core.own_frame.take()
            && is_conflict(&mut self.links, link, own_frame)
        {
            vehicle.peer(PeerEvent::AddressConflict(link));
            // Compiled out where there is no room for texts.
            if TEXTS > 0 {
                self.core.tell_conflict(now, &mut self.texts);
            }
        }
        high_latency::received(&mut self.links, vehicle);
    }
}

/// The streams of a link.
fn slots_of<const STREAMS: usize>(slots: &mut [[Slot; STREAMS]], link: LinkId) -> &mut [Slot] {
    slots.get_mut(usize::from(link.0)).map(<[Slot; STREAMS]>::as_mut_slice).unwrap_or_default()
}

/// What a stack with this plan memory can do, exactly (Q-9).
const fn capabilities<P: PlanStorage>() -> MavProtocolCapability {
    let mut capabilities = MavProtocolCapability::MAVLINK2.with(MavProtocolCapability::COMMAND_INT);
    if PlanType::Mission.is_served(&P::CAPACITIES) {
        capabilities = capabilities.with(MavProtocolCapability::MISSION_INT).with(MavProtocolCapability::MISSION_FLOAT);
    }
    if PlanType::Fence.is_served(&P::CAPACITIES) {
        capabilities = capabilities.with(MavProtocolCapability::MISSION_FENCE);
    }
    if PlanType::Rally.is_served(&P::CAPACITIES) {
        capabilities = capabilities.with(MavProtocolCapability::MISSION_RALLY);
    }
    capabilities
}

impl Core {
    /// What the engine of plans works with.
    fn plan_context<'a, 'p>(
        &self,
        now: Instant,
        plans: &'a mut PlansMut<'p>,
        texts: &'a mut StatusTexts,
    ) -> mission::Context<'a, 'p> {
        mission::Context { now, plans, texts, normal: self.normal, second_ack: self.config.second_mission_ack }
    }

    /// Schedules an extra heartbeat on each normal link when the reported state has changed (H-16).
    fn notice(&mut self, state: Option<VehicleState>) {
        self.has_state = state.is_some();
        if let Some(state) = state.filter(|state| *state != self.state) {
            self.state = state;
            self.extra_heartbeats = self.normal;
        }
    }

    fn has_credit(&mut self, now: Instant) -> bool {
        self.credit.sample(now, self.config.pulse, self.config.max_loop_gap)
    }
}

/// Whether a received frame with our own address proves that another vehicle has that address: it is not an echo of a frame
/// that any link sent recently, and not the first of its kind (H-14). Not inlined, because it is rare.
#[inline(never)]
fn is_conflict(links: &mut [Link], link: LinkId, [seq, checksum]: [u8; 2]) -> bool {
    let is_echo = links.iter().any(|link| link.port.outbox.may_have_sent(seq, checksum));
    !is_echo && links.get_mut(usize::from(link.0)).is_some_and(|link| link.port.is_conflict())
}

/// What somebody is to be told about plans, on the link where he was heard last.
fn owe(links: &mut [Link], owed: Option<(LinkId, mission::Reply)>) {
    let Some((link, reply)) = owed else { return };
    if let Some(link) = links.get_mut(usize::from(link.0)) {
        link.port.plans.owe_result(reply);
    }
}

/// Converts a number of bytes.
fn length(bytes: u32) -> usize {
    usize::try_from(bytes).unwrap_or(usize::MAX)
}

fn count(counter: &mut u32) {
    *counter = counter.wrapping_add(1);
}
