//! The stack: all services of a vehicle behind a few calls, in fixed memory.
//!
//! The only module that knows every service. [`Stack`] shows the path of a frame. No call waits (D-3) or takes a lock (D-6), and
//! the budget bounds the work of each (D-2, SEC-2).

mod clock;
mod counters;
#[cfg(test)]
mod deadlines;
mod declare;
#[cfg(feature = "defmt")]
mod drops;
mod fanout;
#[cfg(test)]
mod hostile;
mod memory;
mod parts;
#[cfg(test)]
mod permuted;
#[cfg(feature = "storage")]
mod persistence;
mod plans;
mod receive;
mod services;
#[cfg(feature = "storage")]
mod storage;
mod transport;

pub use counters::Counter;
pub use declare::{Declaration, Declares, Persistent, credits};
pub use memory::Memory;

use self::receive::OwnFrame;
use self::services::{Services, States};
use crate::dialect::{MavProtocolCapability, MavSeverity};
use crate::frame::RxCounters;
use crate::link::{Link, LinkCounters};
#[cfg(feature = "defmt")]
use crate::log::DropLog;
use crate::message::Address;
use crate::network;
use crate::service::command::CommandMemory;
use crate::service::param::ParamMemory;
use crate::service::{ControlGate, Cx, Service, Shared, SigningGate, View};
use crate::time::Instant;
use crate::types::{
    Allowance, Component, Config, Context, CreditConfig, CreditMemory, CreditView, HookFaults, LinkConfig, LinkId,
    LinkMask, MAX_LINKS, PlanMemory, TextNumber, Values, Vehicle, VehicleAddress,
};

/// No byte was received into the free space of the decoder.
const NOT_FILLED: usize = 0;

/// The vehicle's side of MAVLink for the declaration `D`, on `LINKS` links. It derefs to the struct of the
/// [declaration](macro@crate::Stack), whose fields are services. It contains all its memory. [The crate's page](crate) shows the loop that calls it.
///
/// Received frames pass the address filter and reach the service that handles them. When a link has room, the services
/// are asked in a fixed order for one frame (D-4):
///
/// ```text
///   bytes ─▶ Decoder ─▶ Frame ─▶ signature ─▶ routing ─▶ address ─▶ Service::on_frame, on_command ─▶ state
///   bytes ◀─ Outbox ◀─ one frame ◀─ Service::send ◀─ for each turn, Service::pending ◀────────────────┘
/// ```
// In this order, the largest last: it takes less code to reach fields near the start of a `static`.
#[repr(C)]
pub struct Stack<D: Declares, const LINKS: usize> {
    shared: Shared,
    services: Services<D>,
    states: [States<D>; LINKS],
    links: [Link; LINKS],
    requests: D::Requests,
    events: D::EventLog,
    peers: D::Peers,
    parameters: D::Parameters,
    #[cfg_attr(not(feature = "storage"), allow(dead_code, reason = "there is no storage"))]
    storage: D::Storage,
    /// The drop counters that all links share, as last logged.
    #[cfg(feature = "defmt")]
    drops: DropLog,
    texts: D::Texts,
    credits: D::Credits,
    plans: D::Plans,
}

/// The stack of a declaration, on its links: `StackOf<Mavlink>` for a struct `Mavlink` with [`derive(Stack)`](macro@crate::Stack).
pub type StackOf<D> = <D as Declaration>::Stack;

/// A stack has the services of its declaration: `stack.traffic`.
impl<D: Declares, const LINKS: usize> core::ops::Deref for Stack<D, LINKS> {
    type Target = D::Services;

    fn deref(&self) -> &D::Services {
        &self.services.own
    }
}

impl<D: Declares, const LINKS: usize> core::ops::DerefMut for Stack<D, LINKS> {
    fn deref_mut(&mut self) -> &mut D::Services {
        &mut self.services.own
    }
}

/// Splits the stack at `now` of the firmware's clock into the data that services share, the services, the links and
/// their states.
macro_rules! split {
    ($stack:expr, $now:expr, $vehicle:expr) => {{
        let stack = $stack;
        let now = stack.enter($now);
        (split!(@cx stack, now, $vehicle), &mut stack.services, &mut stack.links, &mut stack.states)
    }};
    ($stack:expr, $now:expr, $vehicle:expr, storage) => {{
        let stack = $stack;
        let now = stack.enter($now);
        let cx = split!(@cx stack, now, $vehicle);
        let storage = crate::stack::parts::HasStorage::part_mut(&mut stack.storage);
        (cx, &mut stack.services, &mut stack.states, storage)
    }};
    (@cx $stack:ident, $now:expr, $vehicle:expr) => {
        Cx::<D> {
            now: $now,
            shared: &mut $stack.shared,
            peers: crate::stack::Memory::view_mut(&mut $stack.peers),
            texts: crate::stack::Memory::view_mut(&mut $stack.texts),
            requests: crate::stack::Memory::view_mut(&mut $stack.requests),
            events: crate::stack::Memory::view_mut(&mut $stack.events),
            plans: crate::types::PlanMemory::view(&mut $stack.plans),
            parameters: &mut $stack.parameters,
            credits: crate::types::CreditMemory::view(&mut $stack.credits),
            vehicle: $vehicle,
        }
    };
}
use split;

impl<D: Declares, const LINKS: usize> core::fmt::Debug for Stack<D, LINKS> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Stack").field("links", &self.links).field("peers", &self.peers).finish_non_exhaustive()
    }
}

impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// A stack that is not [started](Self::begin) yet: all zero bits, so a `static` with it is placed in `.bss`.
    pub const VACANT: Self = Self {
        shared: Shared::VACANT,
        services: Services::NEW,
        links: [const { Link::VACANT }; LINKS],
        states: [const { States::VACANT }; LINKS],
        peers: D::Peers::NEW,
        texts: D::Texts::NEW,
        credits: D::Credits::FULL,
        requests: D::Requests::NEW,
        events: D::EventLog::NEW,
        plans: D::Plans::EMPTY,
        parameters: D::Parameters::VACANT,
        storage: D::Storage::NEW,
        #[cfg(feature = "defmt")]
        drops: DropLog::NEW,
    };

    /// Returns a stack that has begun. A microcontroller's call stack is too small for it: let a `static` hold
    /// [`VACANT`](Self::VACANT) there, and [`begin`](Self::begin) it.
    pub fn new(config: Config, links: [LinkConfig; LINKS]) -> Self {
        let mut stack = Self::VACANT;
        stack.begin(config, links);
        stack
    }

    /// Returns the number of a link. In a `const`, one that the stack does not have is a compile error:
    ///
    /// ```
    /// # use mavstack::prelude::*;
    /// # struct Rover;
    /// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
    /// # impl Commands for Rover {
    /// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { MavResult::UNSUPPORTED.into() }
    /// # }
    /// #[derive(Stack)]
    /// #[stack(vehicle: Rover, links: 2)]
    /// struct Mavlink;
    ///
    /// const RADIO: LinkId = StackOf::<Mavlink>::link(0);
    /// const COMPANION: LinkId = StackOf::<Mavlink>::link(1);
    /// ```
    ///
    /// # Panics
    ///
    /// Panics if the stack does not have so many links. Calls of the stack do not panic: with a wrong number,
    /// [`poll_link`](Self::poll_link) returns [`LinkError::NoSuchLink`](crate::network::LinkError::NoSuchLink),
    /// [`receive`](Self::receive) takes nothing, which the feature `defmt` logs, and [`transmit`](Self::transmit) returns nothing.
    #[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; nothing is cut off")]
    pub const fn link(number: u8) -> LinkId {
        assert!(
            (number as usize) < LINKS,
            "the stack has no link with that number: they count from 0, and `links` in `#[stack]` says how many there are"
        );
        LinkId(number)
    }

    /// Starts the stack in place. Call it once, before all other methods. A stack that is not started calls no hook, takes
    /// no frame and sends nothing, whatever is called (H-18); [`poll_link`](Self::poll_link) returns
    /// [`LinkError::NotBegun`](crate::network::LinkError::NotBegun).
    pub fn begin(&mut self, config: Config, links: [LinkConfig; LINKS]) {
        const { assert!(LINKS > 0 && LINKS <= MAX_LINKS, "a stack has 1 to 16 links: `links: 1`") };
        const { D::CHECKED };
        const { Component::check(D::COMPONENTS) };
        const { <D::Vehicle as Vehicle>::MESSAGES.check() };
        let shared = &mut self.shared;
        shared.config = Config { budget: config.budget.at_least_a_frame(), ..config };
        shared.config.identity.capabilities |= Services::<D>::CAPABILITIES;
        for (id, (link, config)) in (0..).map(LinkId).zip(self.links.iter_mut().zip(&links)) {
            link.configure(id, *config, &shared.config);
            let mask = LinkMask::of(id);
            if config.trusts_own_system {
                shared.trusting = shared.trusting.with(mask);
            }
            if config.class.is_high_latency() {
                shared.satellites = shared.satellites.with(mask);
            } else {
                shared.normal = shared.normal.with(mask);
            }
        }
        self.services.begin(&shared.config);
        self.requests.view_mut().begin(u8::try_from(D::MESSAGE_QUEUES).unwrap_or(0));
        self.parameters.begin();
        self.take_system_id();
        self.set_credits(CreditConfig::DEFAULT);
    }

    /// Takes the system id from the parameter that is declared to be it.
    fn take_system_id(&mut self) {
        if let Some(system) = self.parameters.system_id() {
            self.set_address(self.shared.config.address.with_system(system));
        }
    }

    /// Sets what peers may spend on the high-latency links (L-17). It has no effect in a stack that neither forwards nor has the
    /// service [`HighLatency`](crate::high_latency::HighLatency): peers can cause nothing there.
    pub fn set_credits(&mut self, config: CreditConfig) {
        if let Some(credits) = self.credits.view().credits() {
            credits.config = config;
        }
    }

    /// Leaves out the other components of the firmware until the next start: none of them sends, and frames for them
    /// are handled as for an absent component. The gimbal manager of a component and its capability are left out too.
    /// Call it after [`begin`](Self::begin) and before anything else, if
    /// [`Components::OPTIONAL`](crate::Components::OPTIONAL) is true: by default it does nothing.
    pub fn leave_out_components(&mut self) {
        let shared = &mut self.shared;
        shared.is_alone = D::HAS_OPTIONAL_COMPONENTS;
        if shared.is_alone {
            let MavProtocolCapability(of_components) = Services::<D>::COMPONENT_CAPABILITIES;
            shared.config.identity.capabilities.0 &= !of_components;
        }
    }

    /// Runs the timers of silent peers and stalled transfers, and checks whether the vehicle's state has changed. It
    /// does a bounded amount of work. Call it in every pass of the loop.
    pub fn poll(&mut self, now: Instant, vehicle: &mut D::Vehicle) {
        if !self.shared.is_begun() {
            return;
        }
        let (mut cx, services, links, states) = split!(&mut *self, now, vehicle);
        let now = cx.now;
        cx.shared.has_acted = false;
        cx.shared.polled = now;
        let timeout = cx.shared.config.peer_timeout;
        cx.shared.hooks.0 = 0;
        let (peers, mut hook) = cx.peers_and_hook();
        network::poll(peers, now, timeout, |event| hook.report(event));
        services.release_stalled(now, links, states);
        cx.shared.controllers = services.operator_control.controllers();
        services.poll(&mut cx, states);
        if !D::COMPONENTS.is_empty()
            && let (Some(Link { port, .. }), Some(state)) = (links.first_mut(), states.first_mut())
        {
            services.carry_out_own(&mut cx, port, state);
        }
        Services::<D>::mark_polled(links);
        let has_streams = !<D::Stream as Service<D>>::ABOUT.turns.is_empty();
        cx.requests.end_poll(has_streams, D::Plans::CAPACITIES != [0; 3]);
        #[cfg(feature = "defmt")]
        drop(cx);
        #[cfg(feature = "defmt")]
        self.log_drops(self.shared.clock.now());
    }

    /// Takes received bytes, for interrupts and DMA, and handles the frames in them, up to the budget of one poll.
    /// Returns the number of bytes that there was room for. Call it again with the rest, or with none when
    /// [`next_deadline`] requires it.
    ///
    /// [`next_deadline`]: Self::next_deadline
    pub fn receive(&mut self, now: Instant, link: LinkId, bytes: &[u8], vehicle: &mut D::Vehicle) -> usize {
        let mut allowance = self.shared.config.budget.allowance();
        self.receive_within(now, link, bytes, vehicle, &mut allowance)
    }

    /// As [`receive`](Self::receive), up to the budget that is left in `allowance`.
    pub(crate) fn receive_within(
        &mut self,
        now: Instant,
        link: LinkId,
        bytes: &[u8],
        vehicle: &mut D::Vehicle,
        allowance: &mut Allowance,
    ) -> usize {
        let mut taken = 0usize;
        if !self.shared.is_begun() {
            return 0;
        }
        let time = self.enter(now);
        // A pass for each buffer of bytes.
        loop {
            let rest = bytes.get(taken..).unwrap_or_default();
            let Some(Link { decoder, .. }) = self.link_mut(link) else {
                event!("bytes for {}, which the stack does not have", link);
                return taken;
            };
            let len = if rest.is_empty() { 0 } else { decoder.push(rest, time) };
            taken = taken.saturating_add(len);
            // Even if nothing was pushed: the buffer may be full of bytes from an earlier call, whose budget was used
            // up.
            self.handle_received(now, link, NOT_FILLED, vehicle, allowance);
            if len == 0 || taken >= bytes.len() {
                return taken;
            }
        }
    }

    /// Returns free space in the link's own buffer, to receive bytes without a copy; then call
    /// [`received`](Self::received). It is empty while frames wait for more budget. If no bytes are pending, it has
    /// room for a frame of maximum length: see [`Decoder::spare`](crate::frame::Decoder::spare).
    pub fn receive_buffer(&mut self, link: LinkId) -> &mut [u8] {
        let is_begun = self.shared.is_begun();
        self.link_mut(link).filter(|_| is_begun).map(|link| link.decoder.spare()).unwrap_or_default()
    }

    /// Takes the first `len` bytes of [`receive_buffer`](Self::receive_buffer), which were filled. Handles the frames
    /// in them, up to the budget of one poll.
    pub fn received(&mut self, now: Instant, link: LinkId, len: usize, vehicle: &mut D::Vehicle) {
        let mut allowance = self.shared.config.budget.allowance();
        self.handle_received(now, link, len, vehicle, &mut allowance);
    }

    /// Returns the bytes to be sent next on a link, at most the rest of one frame; then call
    /// [`transmitted`](Self::transmitted). Empty if there is nothing to send.
    // Inlined, it costs 76 bytes of flash.
    #[inline(never)]
    pub fn transmit(&mut self, now: Instant, link: LinkId, vehicle: &mut D::Vehicle) -> &[u8] {
        let index = usize::from(link.0);
        let (mut cx, services, links, states) = split!(&mut *self, now, vehicle);
        let (Some(Link { port, .. }), Some(state)) = (links.get_mut(index), states.get_mut(index)) else { return &[] };
        if port.outbox.is_empty() && !cx.shared.resume(cx.now, port) {
            if !cx.shared.is_begun() {
                return &[];
            }
            services.fill(&mut cx, port, state);
        } else {
            // A frame that is sent again from its start (G-4).
            services.signing.sign(cx.now, port);
        }
        port.outbox.pending()
    }

    /// Records that the transport took the first `len` bytes of [`transmit`](Self::transmit).
    pub fn transmitted(&mut self, link: LinkId, len: usize) {
        if let Some(link) = self.link_mut(link) {
            let len = len.min(link.port.outbox.pending().len());
            link.port.outbox.advance(len);
            link.port.bucket.spend(len);
            let bytes = &mut link.port.counters.tx_bytes;
            *bytes = bytes.wrapping_add(u32::try_from(len).unwrap_or(0));
        }
    }

    /// Returns the vehicle's address.
    pub fn address(&self) -> Address {
        self.shared.config.address.get()
    }

    /// Changes the vehicle's address. Call it once, before the loop: peers that know the vehicle by its address take it for another
    /// one afterwards. A system id that is a parameter needs no call: see `system_id` of [`parameters!`](crate::parameters).
    pub fn set_address(&mut self, address: VehicleAddress) {
        self.shared.config.address = address;
        for link in &mut self.links {
            link.port.outbox.set_source(address.get());
        }
    }

    /// Sends a text to the operators: a STATUSTEXT on every normal link (T-5). Takes any text: a `&str`, or a
    /// [`&Text`](crate::Text) with formatted numbers. A text is cut off after [`MAX_TEXT_LEN`](crate::limits::MAX_TEXT_LEN)
    /// bytes. The same text is dropped if it is repeated within five seconds; a text that a hook sends about a received
    /// frame, such as a refused command, within two (C-16). A full queue evicts the least severe
    /// text; `texts` in [`#[stack]`](macro@crate::Stack) declares its length.
    pub fn text(&mut self, now: Instant, severity: MavSeverity, text: &(impl AsRef<[u8]> + ?Sized)) {
        let now = self.enter(now);
        self.texts.view_mut().push(now, self.shared.normal, severity, text.as_ref());
    }

    /// Returns the next text after the one with this number, and its number. Start with 0.
    /// The queue keeps sent texts, its own and the vehicle's, until others need their place. For a vehicle that records them in its log:
    ///
    /// ```
    /// # use mavstack::prelude::*;
    /// # use mavstack::dialect;
    /// # struct Rover;
    /// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
    /// # impl Commands for Rover {
    /// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { dialect::MavResult::UNSUPPORTED.into() }
    /// # }
    /// #[derive(Stack)]
    /// #[stack(vehicle: Rover, links: 1)]
    /// struct Mavlink;
    ///
    /// /// Called in each pass, with the number of the last text.
    /// fn record_texts(stack: &StackOf<Mavlink>, last: &mut u16, mut record: impl FnMut(u8, &[u8])) {
    ///     while let Some((number, severity, text)) = stack.text_after(*last) {
    ///         record(severity.0, text);
    ///         *last = number;
    ///     }
    /// }
    /// ```
    pub fn text_after(&self, number: u16) -> Option<(u16, MavSeverity, &[u8])> {
        let entry = self.texts.view().after(TextNumber(number))?;
        Some((entry.number.0, entry.severity, entry.text.as_bytes()))
    }

    /// Calls `work` with the context that the vehicle's hooks get, at the time `now`. Use it in a flight loop that
    /// shares code with the hooks, and in tests that call hooks. The next [`poll`](Self::poll) takes up the
    /// messages that it announces and the events that it reports.
    pub fn with_context<R>(&mut self, now: Instant, work: impl FnOnce(&mut Context<'_>) -> R) -> R {
        let now = self.enter(now);
        let Self { shared, texts, requests, events, plans, parameters, services, .. } = self;
        let own = crate::Peer { address: shared.config.address.get(), link: LinkId::NONE };
        work(&mut Context {
            now,
            normal: shared.normal,
            texts: texts.view_mut(),
            requests: requests.view_mut(),
            events: events.view_mut(),
            plans: &PlanMemory::view(plans),
            values: parameters.values(),
            can_start: services.command.slots.view().is_some_and(|long| long.can_start(own)),
        })
    }

    /// Calls `work` with the services of the declaration's struct, and with the [`Cx`] that their methods take, at the
    /// time `now`: for a service whose methods take a [`Cx`], such as
    /// [`ManagerService::point`](crate::gimbal::ManagerService::point). The next [`poll`](Self::poll) takes up the work
    /// that they leave pending.
    pub fn with_services<R>(
        &mut self,
        now: Instant,
        vehicle: &mut D::Vehicle,
        work: impl FnOnce(&mut D::Services, &mut Cx<'_, D>) -> R,
    ) -> R {
        let (mut cx, services, ..) = split!(&mut *self, now, vehicle);
        work(&mut services.own, &mut cx)
    }

    /// Returns the counters of a link's sent and dropped frames; `None` if there is no such link.
    pub fn link_counters(&self, link: LinkId) -> Option<LinkCounters> {
        self.links.get(usize::from(link.0)).map(|link| link.port.counters)
    }

    /// Returns the counters of a link's decoder; `None` if there is no such link.
    pub fn rx_counters(&self, link: LinkId) -> Option<RxCounters> {
        self.links.get(usize::from(link.0)).map(|link| link.decoder.counters())
    }

    /// Returns the number of texts that were dropped, because they were repeated or the queue was full. Wraps.
    pub fn dropped_texts(&self) -> u32 {
        self.texts.view().dropped()
    }

    /// Returns the counters of broken promises of the vehicle's hooks.
    pub fn hook_faults(&self) -> HookFaults {
        self.shared.faults
    }

    /// Returns when the stack must be polled again even if no byte is received: for a loop that sleeps. Poll it also
    /// when a byte is received, when the transport can take more of [`transmit`](Self::transmit), and after the
    /// vehicle's state has changed. It is never further away than [`max_loop_gap`](crate::Config::max_loop_gap) after the
    /// last [`poll`](Self::poll) (H-18). [`Instant::NEVER`] if the stack was not begun.
    pub fn next_deadline(&self, now: Instant) -> Instant {
        self.earliest(now, 0, LINKS, self.write_deadline())
    }

    /// Returns when storage has something to write.
    fn write_deadline(&self) -> Instant {
        #[cfg(feature = "storage")]
        return Persistent::<D>::write_deadline(&self.services.param);
        #[cfg(not(feature = "storage"))]
        return Instant::NEVER;
    }

    /// Returns when a link must be served again even if no byte is received on any: as
    /// [`next_deadline`](Self::next_deadline), without deadlines of other links and of storage. For firmware with a
    /// task for each link, and one for storage: none is woken for the work of another. [`poll`](Self::poll) the stack
    /// then, too.
    pub fn link_deadline(&self, now: Instant, link: LinkId) -> Instant {
        self.earliest(now, usize::from(link.0), 1, Instant::NEVER)
    }

    /// Returns when `count` links from `first` on must be served, or at `other` if that is earlier, by the firmware's clock.
    fn earliest(&self, now: Instant, first: usize, count: usize, other: Instant) -> Instant {
        let (shared, requests) = (&self.shared, self.requests.view());
        if !shared.is_begun() {
            return Instant::NEVER;
        }
        if shared.has_acted || requests.is_due() {
            return now;
        }
        let time = shared.clock.peek(now);
        let view = View {
            now: time,
            shared,
            peers: self.peers.view(),
            texts: self.texts.view(),
            requests,
            events: self.events.view(),
        };
        let peers = network::deadline(view.peers, shared.config.peer_timeout);
        let mut deadline = peers.min(self.services.deadline()).min(shared.poll_deadline()).min(other);
        let links = self.links.get(first..).unwrap_or_default().iter();
        let states = self.states.get(first..).unwrap_or_default();
        for (link, state) in links.zip(states).take(count) {
            let due = self.services.due(&view, &link.port, state);
            deadline = deadline.min(link.decoder.deadline()).min(due);
        }
        if deadline <= time { now } else { shared.clock.shown(deadline).max(now) }
    }

    /// Whether the stack was begun.
    pub(crate) const fn is_begun(&self) -> bool {
        self.shared.is_begun()
    }

    /// Returns the configuration.
    pub(crate) fn config(&self) -> &Config {
        &self.shared.config
    }

    fn link_mut(&mut self, link: LinkId) -> Option<&mut Link> {
        self.links.get_mut(usize::from(link.0))
    }

    /// Handles the frames in the decoder, as far as the allowance permits. `filled`: the number of bytes that were just
    /// received into its free space.
    fn handle_received(
        &mut self,
        now: Instant,
        link: LinkId,
        filled: usize,
        vehicle: &mut D::Vehicle,
        allowance: &mut Allowance,
    ) {
        let index = usize::from(link.0);
        let (mut cx, services, links, states) = split!(&mut *self, now, vehicle);
        let (Some(link_state), Some(state)) = (links.get_mut(index), states.get_mut(index)) else { return };
        if !cx.shared.is_begun() {
            return;
        }
        if filled > 0 {
            link_state.decoder.filled(filled, cx.now);
        }
        let own_frame = services.drain(&mut cx, link_state, state, allowance);
        Services::<D>::mark_others(links, link);
        if let Some(OwnFrame { seq, checksum }) = own_frame {
            // Another vehicle has our address if no link can have sent the frame, and it is not the first such frame (H-14).
            let is_echo = links.iter().any(|link| link.port.outbox.may_have_sent(seq, checksum));
            if !is_echo && links.get_mut(index).is_some_and(|link| link.port.count_stranger()) {
                receive::report_conflict(&mut cx, link);
            }
        }
    }
}
