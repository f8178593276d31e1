//! The stack: all services of a vehicle behind a few calls, in fixed memory.
//!
//! The only module that knows every service. Received frames go through the address filter to the service they are for;
//! when a link has room, the services are asked in a fixed order for one frame (D-4):
//!
//! ```text
//!   receive ──▶ decoder ──▶ own address? ──▶ peers ──▶ for us? ──▶ commands, plans, the vehicle's own messages
//!
//!   transmit ◀── HEARTBEAT, COMMAND_ACK, MISSION_ACK, messages asked for          at once
//!            ◀── plan requests and items, texts, MISSION_CURRENT                  within the link's byte rate
//!            ◀── streams                                                          while the line is idle
//! ```

mod commands;
mod plans;
#[cfg(feature = "storage")]
mod storage;
mod streams;

use core::marker::PhantomData;

use embedded_io::{Read, ReadReady, Write, WriteReady};

use crate::config::{Config, RxAllowance, VehicleAddress};
use crate::dialect::{
    CommandInt, CommandLong, Common, Heartbeat, ManualControl, MavComponent, MavProtocolCapability, MavSeverity,
};
use crate::frame::{Address, Frame, RxCounters};
use crate::link::{
    Link, LinkClass, LinkConfig, LinkCounters, LinkError, LinkId, LinkMask, MAX_LINKS, Peer, Port, Transport,
};
use crate::message::{Dialect, Message, MessageTable, Text};
use crate::network::{self, Booking, PeerInfo, Peers};
use crate::service::command;
use crate::service::heartbeat::Credit;
use crate::service::mission::{self, Caller, Missions, NoPlans, PlanStorage, PlanType, PlansMut};
use crate::service::param::{self, Params, Taken};
use crate::service::statustext::{Entry as TextEntry, MAX_TEXT_LEN, StatusTexts};
use crate::service::stream::Slot;
use crate::service::time;
use crate::time::{Duration, Instant};
use crate::vehicle::{Autopilot, Command, PeerEvent};

/// The vehicle's side of MAVLink: `LINKS` links, plans in a memory of type `P`, a table of `PEERS` peers, a queue of `TEXTS`
/// texts, room for `STREAMS` messages that the vehicle fills, the messages of dialect `D` known. All memory is inside.
/// [The crate's page](crate) shows the loop around it.
///
/// Most firmware names the first two and calls [`new`](Self::new); [`with_capacities`](Self::with_capacities) is for one
/// that names the others too.
#[derive(Debug)]
pub struct Stack<
    const LINKS: usize,
    P: PlanStorage = NoPlans,
    const PEERS: usize = 8,
    const TEXTS: usize = 4,
    const STREAMS: usize = 24,
    D = Common,
> {
    core: Core,
    links: [Link; LINKS],
    slots: [[Slot; STREAMS]; LINKS],
    peers: heapless::Vec<PeerInfo, PEERS>,
    texts: StatusTexts<[TextEntry; TEXTS]>,
    missions: P::Engine,
    plans: P,
    dialect: PhantomData<D>,
}

/// What does not depend on any capacity, and so is compiled once.
#[derive(Debug)]
struct Core {
    config: Config,
    credit: Credit,
    /// The links that everything may be sent on.
    normal: LinkMask,
    capabilities: MavProtocolCapability,
    params: Params,
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
    /// The next sequence number of each link; only for received frames.
    seqs: &'a [u8],
}

impl<const LINKS: usize, P: PlanStorage> Stack<LINKS, P> {
    /// A stack at rest, with the default capacities and dialect.
    ///
    /// `const`, but a `static` with this as its initial value keeps a copy of all its memory, plans included, in flash. Write
    /// it into a `static` at start instead (`MaybeUninit::write`, or the crate `static_cell`), as `examples/qemu` does.
    pub const fn new(config: Config, links: [LinkConfig; LINKS]) -> Self {
        Self::with_capacities(config, links)
    }
}

impl<const LINKS: usize, P: PlanStorage, const PEERS: usize, const TEXTS: usize, const STREAMS: usize, D: Dialect>
    Stack<LINKS, P, PEERS, TEXTS, STREAMS, D>
{
    /// A stack at rest, with capacities or a dialect of your own. `TEXTS` and `STREAMS` may be 0: then there are none.
    #[allow(
        clippy::indexing_slicing,
        clippy::arithmetic_side_effects,
        clippy::as_conversions,
        reason = "const-evaluated; the index is below LINKS, which is at most 16"
    )]
    pub const fn with_capacities(config: Config, configs: [LinkConfig; LINKS]) -> Self {
        const { assert!(LINKS > 0 && LINKS <= MAX_LINKS, "a stack has 1 to 16 links") };
        const { assert!(PEERS > 0, "a stack needs room for a peer") };
        let mut links = [const { Link::VACANT }; LINKS];
        let mut normal = LinkMask::NONE;
        let mut i = 0;
        while i < LINKS {
            links[i].configure(LinkId(i as u8), configs[i], &config);
            if matches!(configs[i].class, LinkClass::Normal) {
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
            },
            links,
            slots: [[Slot::NEW; STREAMS]; LINKS],
            peers: heapless::Vec::new(),
            texts: StatusTexts::<[TextEntry; TEXTS]>::new(),
            missions: P::ENGINE,
            plans: P::EMPTY,
            dialect: PhantomData,
        }
    }

    /// Runs the timers: peers that fell silent, transfers that stopped. Bounded; call it in every pass of the loop.
    pub fn poll<V: Autopilot>(&mut self, now: Instant, vehicle: &mut V) {
        let core = &mut self.core;
        core.has_credit(now);
        network::poll(&mut self.peers, now, core.config.peer_timeout, vehicle);
        command::poll(now, vehicle);
        core.params.poll(now, vehicle, core.normal);
        if let Some((missions, mut plans)) = self.plans.parts(&mut self.missions) {
            let mut context = core.plan_context(now, &mut plans, &mut self.texts);
            let owed = missions.poll(&mut context, vehicle);
            owe(&mut self.links, owed);
        }
    }

    /// Moves bytes between a link and its transport: a bounded read, what the frames in it ask for, a bounded write.
    ///
    /// Never blocks: it reads and writes only what the transport says is ready. The bound is
    /// [`Config::budget`](crate::Config::budget).
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
        let budget = self.core.config.budget;
        let read = self.poll_read(now, link, uart, vehicle, budget.rx_bytes);
        let write = self.poll_write(now, link, uart, vehicle, budget.tx_bytes);
        read.and(write)
    }

    fn poll_read<V: Autopilot, U: Read + ReadReady>(
        &mut self,
        now: Instant,
        link: LinkId,
        uart: &mut U,
        vehicle: &mut V,
        rx_bytes: u16,
    ) -> Result<(), LinkError<U::Error>> {
        let mut allowance = self.core.config.budget.rx();
        let mut left = usize::from(rx_bytes);
        let result = loop {
            let spare = self.link_mut(link).ok_or(LinkError::NoSuchLink)?.decoder.spare();
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
                    self.commit(now, link, len, vehicle, &mut allowance);
                }
                Err(error) => {
                    if let Some(link) = self.link_mut(link) {
                        let errors = &mut link.port.counters.read_errors;
                        *errors = errors.wrapping_add(1);
                    }
                    event!("rx: error on link {=u8}", link.0);
                    break Err(LinkError::Read(error));
                }
            }
        };
        // What waits in the decoder from before: for silence, or for more budget.
        self.commit(now, link, 0, vehicle, &mut allowance);
        result
    }

    fn poll_write<V: Autopilot, U: Write + WriteReady>(
        &mut self,
        now: Instant,
        link: LinkId,
        uart: &mut U,
        vehicle: &mut V,
        tx_bytes: u16,
    ) -> Result<(), LinkError<U::Error>> {
        let mut left = usize::from(tx_bytes);
        let result = loop {
            if left == 0 {
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
        event!("tx: error on link {=u8}", link.0);
        result
    }

    /// Takes received bytes, for interrupts and DMA: as many as there is room for, which is returned. Handles the frames in
    /// them, up to the budget of one poll; call it again with the rest, or with none when [`next_deadline`] says so.
    ///
    /// [`next_deadline`]: Self::next_deadline
    pub fn receive<V: Autopilot>(&mut self, now: Instant, link: LinkId, bytes: &[u8], vehicle: &mut V) -> usize {
        let mut allowance = self.core.config.budget.rx();
        let mut taken = 0usize;
        // A buffer's worth at a time; more than two turns are only needed when the bytes are more than a buffer's worth.
        while let Some(rest) = bytes.get(taken..).filter(|rest| !rest.is_empty()) {
            let Some(state) = self.link_mut(link) else { return 0 };
            let len = state.decoder.push(rest, now);
            if len == 0 {
                break;
            }
            taken = taken.saturating_add(len);
            self.commit(now, link, 0, vehicle, &mut allowance);
        }
        if bytes.is_empty() {
            self.commit(now, link, 0, vehicle, &mut allowance);
        }
        taken
    }

    /// Room in the link's own buffer for bytes to be received into without a copy; then call
    /// [`received`](Self::received). Empty while frames wait for more budget.
    pub fn receive_buffer(&mut self, link: LinkId) -> &mut [u8] {
        self.link_mut(link).map(|link| link.decoder.spare()).unwrap_or_default()
    }

    /// The first `len` bytes of [`receive_buffer`](Self::receive_buffer) were filled. Handles the frames in them, up to the
    /// budget of one poll.
    pub fn received<V: Autopilot>(&mut self, now: Instant, link: LinkId, len: usize, vehicle: &mut V) {
        let mut allowance = self.core.config.budget.rx();
        self.commit(now, link, len, vehicle, &mut allowance);
    }

    /// The bytes to be sent next on a link, at most the rest of one frame; then call
    /// [`transmitted`](Self::transmitted). Empty when there is nothing to say.
    pub fn transmit<V: Autopilot>(&mut self, now: Instant, link: LinkId, vehicle: &mut V) -> &[u8] {
        const { streams::check::<V>(STREAMS) };
        let slots = slots_of(&mut self.slots, link);
        let Some(link) = self.links.get_mut(usize::from(link.0)) else { return &[] };
        let port = &mut link.port;
        if port.outbox.is_empty() {
            let (texts, missions, plans) = (&mut self.texts, &mut self.missions, &mut self.plans);
            let peers = &mut self.peers;
            self.core.fill(&mut Context { now, peers, texts, missions, plans, vehicle, slots, seqs: &[] }, port);
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
        if let Some(link) = self.link_mut(link) {
            link.decoder.clear();
            link.port.transport = Transport::Unknown;
            link.port.outbox.restart();
            link.port.plans.restart();
            link.port.params.restart();
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

    /// Tells the operators something: a STATUSTEXT on every normal link (T-5). At most 120 bytes, the rest is cut off; the
    /// same text again within five seconds is dropped. When four wait, the least severe goes.
    pub fn send_text(&mut self, now: Instant, severity: MavSeverity, text: &str) {
        let texts: &mut StatusTexts = &mut self.texts;
        texts.push(now, self.core.normal, severity, &Text::new(text));
    }

    /// Who was heard, and how well. At most `PEERS`; see H-12 for who has to go when the table is full.
    pub fn peers(&self) -> &[PeerInfo] {
        &self.peers
    }

    /// What a link sent, and what it did not take.
    pub fn link_counters(&self, link: LinkId) -> Option<LinkCounters> {
        self.links.get(usize::from(link.0)).map(|link| link.port.counters)
    }

    /// What a link's decoder saw and dropped.
    pub fn rx_counters(&self, link: LinkId) -> Option<RxCounters> {
        self.links.get(usize::from(link.0)).map(|link| *link.decoder.counters())
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
        let missions = P::engine(&self.missions);
        let mut deadline = network::deadline(&self.peers, core.config.peer_timeout);
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
        allowance: &mut RxAllowance,
    ) {
        let mut seqs = [0; LINKS];
        for (seq, link) in seqs.iter_mut().zip(&self.links) {
            *seq = link.port.outbox.seq();
        }
        let slots = slots_of(&mut self.slots, link);
        let Some(link) = self.links.get_mut(usize::from(link.0)) else { return };
        if len > 0 {
            link.decoder.commit(len, now);
        }
        let (texts, missions, plans) = (&mut self.texts, &mut self.missions, &mut self.plans);
        let mut context = Context { now, peers: &mut self.peers, texts, missions, plans, vehicle, slots, seqs: &seqs };
        self.core.drain(&mut context, link, D::MESSAGES, allowance);
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

    fn has_credit(&mut self, now: Instant) -> bool {
        self.credit.sample(now, self.config.pulse, self.config.max_loop_gap)
    }

    /// Handles the frames that the decoder finds.
    fn drain<V: Autopilot, P: PlanStorage>(
        &mut self,
        context: &mut Context<'_, V, P>,
        link: &mut Link,
        messages: MessageTable,
        allowance: &mut RxAllowance,
    ) {
        let Link { decoder, port } = link;
        while allowance.frames > 0 {
            let is_known = |address| network::is_known(context.peers, address);
            let Some(frame) = decoder.next(context.now, messages, &mut allowance.work, is_known) else { return };
            allowance.frames = allowance.frames.saturating_sub(1);
            self.on_frame(context, port, &frame);
        }
    }

    /// A frame came in on a link.
    fn on_frame<V: Autopilot, P: PlanStorage>(
        &mut self,
        context: &mut Context<'_, V, P>,
        port: &mut Port,
        frame: &Frame<'_>,
    ) {
        let own = self.config.address.get();
        if frame.source() == own {
            count_drop(&mut port.counters.own_address, frame, "our own address");
            if port.is_conflict(frame.header().seq, context.seqs) {
                context.vehicle.peer(PeerEvent::AddressConflict(port.id));
                let mut text = Text::<MAX_TEXT_LEN>::new("Another vehicle has system id ");
                text.push_number(u32::from(own.system.0));
                context.texts.push(context.now, self.normal, MavSeverity::WARNING, &text);
            }
            return;
        }
        let Some(info) = frame.info() else {
            count_drop(&mut port.counters.unknown, frame, "an id that is not in the dialect");
            let peer = Peer { address: frame.source(), link: port.id };
            network::on_unchecked(context.peers, peer, frame.header().seq);
            return;
        };
        port.heard(frame.header().version);
        match network::on_frame(context.peers, context.now, port.id, frame, context.vehicle) {
            Booking::Kept => {}
            Booking::Evicted => count(&mut port.counters.evicted_peers),
            Booking::NoRoom => count(&mut port.counters.no_peer_slot),
        }
        // A field that was cut off, or is not there, reads as 0: for everyone (R-15).
        // MANUAL_CONTROL alone calls the system that it means otherwise (R-1).
        let offset = if info.id() == ManualControl::ID { Some(MANUAL_CONTROL_TARGET) } else { info.target_system() };
        let target_system = offset.map_or(0, |offset| frame.byte(offset));
        let target_component = info.target_component().map_or(0, |offset| frame.byte(offset));
        let is_plan = Missions::handles(frame.id());
        // Old ground stations address plans to component 190 (M-10).
        let is_our_component = target_component == 0
            || target_component == own.component.0
            || (is_plan && target_component == MavComponent::MISSIONPLANNER.0);
        if (target_system != 0 && target_system != own.system.0) || !is_our_component {
            count_drop(&mut port.counters.not_ours, frame, "for somebody else");
            return;
        }
        let from = Peer { address: frame.source(), link: port.id };
        if let Some(command) = frame.decode::<CommandLong>() {
            self.on_command(context, port, &command::from_long(&command, from));
        } else if let Some(command) = frame.decode::<CommandInt>() {
            self.on_command(context, port, &command::from_int(&command, from));
        } else if self.on_command_frame(context, port, frame, Address::new(target_system, target_component)) {
            // That was all.
        } else if port.config.class == LinkClass::HighLatency && frame.id() != Heartbeat::ID {
            count_drop(&mut port.counters.out_of_place, frame, "not for a high-latency link");
        } else if is_plan {
            if target_system == 0 {
                // A broadcast COUNT would start uploads on every vehicle in reach (M-10).
                count_drop(&mut port.counters.out_of_place, frame, "plans are not for everyone");
                return;
            }
            let mut caller = Caller { from, version: port.outbox.version(), replies: &mut port.plans };
            let Some((missions, mut plans)) = context.plans.parts(context.missions) else {
                if !caller.refuse(frame) {
                    count_drop(&mut port.counters.no_answer_slot, frame, "no room for its answer");
                }
                return;
            };
            let Context { now, texts, vehicle, .. } = context;
            let mut context = self.plan_context(*now, &mut plans, texts);
            missions.on_frame(&mut context, *vehicle, &mut caller, frame);
        } else if Params::handles(frame.id()) && context.vehicle.parameters_mut().is_some() {
            let Context { now, texts, vehicle, .. } = context;
            let mut context = param::Context { now: *now, texts, normal: self.normal };
            let mut caller = param::Caller { from, version: port.outbox.version(), replies: &mut port.params };
            match self.params.on_frame(&mut context, *vehicle, &mut caller, frame) {
                Taken::Yes => {}
                Taken::NoRoom => count_drop(&mut port.counters.no_answer_slot, frame, "no room for its answer"),
                Taken::OutOfPlace => count_drop(&mut port.counters.out_of_place, frame, "not to be set for everyone"),
            }
        } else if frame.id() != Heartbeat::ID
            && !streams::on_frame(context, port, frame)
            && !time::on_frame(context.now, port, frame, context.vehicle)
        {
            context.vehicle.message(frame, port.id);
        }
    }

    fn on_command<V: Autopilot, P: PlanStorage>(
        &mut self,
        context: &mut Context<'_, V, P>,
        port: &mut Port,
        command: &Command,
    ) {
        if port.acks.is_full() {
            event!("command {=u16} dropped: no room for its answer", command.id.0);
            count(&mut port.counters.no_answer_slot);
            return;
        }
        if let Some(answer) = command::answered(context.now, command, context.vehicle) {
            port.acks.push(command.from.address, command.id, answer);
            return;
        }
        let Context { now, texts, vehicle, .. } = context;
        let progress = context.plans.parts(context.missions).and_then(|(missions, mut plans)| {
            let mut context = self.plan_context(*now, &mut plans, texts);
            missions.on_command(&mut context, *vehicle, command)
        });
        let stored = progress.or_else(|| {
            let mut context = param::Context { now: *now, texts, normal: self.normal };
            self.params.on_command(&mut context, *vehicle, command)
        });
        let outcome = match stored.or_else(|| self.on_message_command(context, port, command)) {
            Some(result) => result.into(),
            None => command::execute(command, port.config.class, &mut port.owed, context.vehicle),
        };
        command::carried_out(context.now, command, outcome, context.vehicle);
        port.acks.push(command.from.address, command.id, outcome);
    }

    /// Puts the next frame into the link's outbound buffer, which is empty.
    fn fill<V: Autopilot, P: PlanStorage>(&mut self, context: &mut Context<'_, V, P>, port: &mut Port) {
        let now = context.now;
        port.bucket.fill(now);
        let is_normal = port.config.class == LinkClass::Normal;
        let sent = (is_normal && self.heartbeat(now, port, context.vehicle))
            || command::next(now, port, context.vehicle)
            || (is_normal
                && (port.plans.next_ack(&mut port.outbox)
                    || time::next(now, port, context.vehicle)
                    || (port.bucket.has_room() && self.transfer(context, port))
                    || self.stream(context, port)));
        if sent {
            count(&mut port.counters.tx_frames);
        }
    }

    /// The heartbeat, when it is due and the flight loop is well (H-1, H-5).
    fn heartbeat<V: Autopilot>(&mut self, now: Instant, port: &mut Port, vehicle: &mut V) -> bool {
        if !port.heartbeat.is_due(now) || !self.has_credit(now) {
            return false;
        }
        let Some(state) = vehicle.state() else {
            port.heartbeat.postpone(now.after(RETRY));
            return false;
        };
        port.heartbeat.sent(now, self.config.heartbeat_period);
        port.outbox.send(&Heartbeat {
            custom_mode: state.custom_mode,
            r#type: self.config.r#type,
            autopilot: self.config.autopilot,
            base_mode: state.base_mode,
            system_status: state.system_status,
            mavlink_version: MAVLINK_VERSION,
        })
    }

    /// What can wait for the link's byte rate.
    fn transfer<V: Autopilot, P: PlanStorage>(&mut self, context: &mut Context<'_, V, P>, port: &mut Port) -> bool {
        let capabilities = self.capabilities | param::capability::<V>();
        if port.owed.next(&self.config.identity, capabilities, &mut port.outbox) || self.answer(context, port) {
            return true;
        }
        let Context { now, texts, missions, plans, vehicle, .. } = context;
        let rate = port.config.bytes_per_second;
        let Some((missions, plans)) = plans.parts(missions) else {
            return self.params.next(*vehicle, &mut port.params, &mut port.outbox)
                || texts.next(&mut port.text, &mut port.outbox)
                || self.params.next_listed(*now, *vehicle, &mut port.params, rate, &mut port.outbox);
        };
        let progress = vehicle.progress();
        missions.next(*now, &mut port.plans, &plans, &progress, self.config.float_mission_items, &mut port.outbox)
            || self.params.next(*vehicle, &mut port.params, &mut port.outbox)
            || texts.next(&mut port.text, &mut port.outbox)
            || missions.next_progress(&plans, &progress, &mut port.outbox)
            || self.params.next_listed(*now, *vehicle, &mut port.params, rate, &mut port.outbox)
    }

    /// When something is to be sent on a link.
    fn tx_deadline(&self, now: Instant, port: &Port, texts: &StatusTexts, missions: Option<&Missions>) -> Instant {
        let is_normal = port.config.class == LinkClass::Normal;
        let heartbeat = match port.heartbeat.due() {
            _ if !is_normal => Instant::NEVER,
            due if due > now => self.credit.look_for(due, self.config.max_loop_gap),
            due if self.credit.is_good(now, self.config.max_loop_gap) => due,
            // It waits for the flight loop, of which the stack hears only when it looks.
            _ => now.after(RETRY),
        };
        match port.transport {
            // The rest of a frame waits for the next poll's budget.
            Transport::Ready if !port.outbox.is_empty() => return now,
            // It has to become ready first, of which the stack hears nothing.
            Transport::Full | Transport::Unknown if !port.outbox.is_empty() => return Instant::NEVER,
            // The same; but by the time of the next heartbeat it may be ready, though nobody is waiting for that.
            Transport::Full => return if heartbeat > now { heartbeat } else { Instant::NEVER },
            _ => {}
        }
        if !port.acks.is_empty() || (is_normal && port.plans.has_ack()) {
            return now;
        }
        let waits = is_normal
            && (!port.owed.is_empty()
                || port.streams.is_asked()
                || self.params.is_pending(&port.params, &port.outbox)
                || texts.is_pending(LinkMask::of(port.id))
                || missions.is_some_and(|missions| missions.is_pending(&port.plans, &port.outbox)));
        let transfer = if waits { now } else { Params::list_due(&port.params) };
        let transfer = if is_normal { transfer.max(port.bucket.ready_at()) } else { Instant::NEVER };
        let stream = if is_normal { port.streams.deadline(port.bucket.idle_at()) } else { Instant::NEVER };
        transfer.min(stream).min(heartbeat)
    }
}

/// How soon to look again whether heartbeats may go on.
const RETRY: Duration = Duration::from_millis(100);

/// Where MANUAL_CONTROL.target stands.
const MANUAL_CONTROL_TARGET: u8 = 10;

/// HEARTBEAT.mavlink_version: of the definitions, for both wire versions (V-5).
const MAVLINK_VERSION: u8 = 3;

/// What somebody is to be told about plans, on the link where he was heard last.
fn owe(links: &mut [Link], owed: Option<(LinkId, mission::Reply)>) {
    let Some((link, reply)) = owed else { return };
    if let Some(link) = links.get_mut(usize::from(link.0)) {
        link.port.plans.owe_result(reply);
    }
}

/// A frame is not acted on, for this reason.
fn count_drop(counter: &mut u32, frame: &Frame<'_>, reason: &'static str) {
    event!("rx: message {=u32} of {} dropped: {=str}", frame.id(), frame.source(), reason);
    count(counter);
}

fn count(counter: &mut u32) {
    *counter = counter.wrapping_add(1);
}
