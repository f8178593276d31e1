//! The data that a call of a service uses, besides the service itself and its link.

use core::num::Wrapping;

use super::Firmware;
use crate::dialect::MavSeverity;
use crate::link::Port;
use crate::message::{Address, ComponentId, SystemId};
use crate::network::{PeerInfo, Peers};
use crate::time::{Clock, Duration, Instant};
use crate::types::{
    Config, Context, Controllers, CreditMemory, CreditView, EventLog, HookFaults, LinkMask, ObservedVehicle, Payer,
    Peer, PeerEvent, PlansMut, Requests, StatusTexts, Trust, Values, Vehicle,
};

/// The data that all services share.
#[derive(Debug)]
pub struct Shared {
    pub(crate) config: Config,
    /// All links except the high-latency links.
    pub(crate) normal: LinkMask,
    /// The high-latency links.
    pub(crate) satellites: LinkMask,
    /// The links on which components of our own system are believed.
    pub(crate) trusting: LinkMask,
    /// The systems that may change the vehicle, as of the last frame or poll.
    pub(crate) controllers: Controllers,
    pub(crate) observed: ObservedVehicle,
    /// The stack's time, which is never set back. All other instants inside the stack are its.
    pub(crate) clock: Clock,
    /// How often the firmware's clock was set back. Wraps.
    pub(crate) clock_steps: u32,
    /// When the stack was last polled (H-18). Before the first time the vehicle's state is not known.
    pub(crate) polled: Instant,
    /// Work may be pending that only the vehicle knows about, on any link, so `next_deadline` returns `now`.
    pub(crate) has_acted: bool,
    /// An operation on the storage is running, so nothing else can be written.
    pub(crate) is_storage_busy: bool,
    /// The component of the firmware that answers a command to all of them; 0 is the autopilot.
    pub(crate) answerer: ComponentId,
    /// The firmware runs without its other components.
    pub(crate) is_alone: bool,
    /// Changes when the numbers of the flight logs may have changed. It wraps.
    pub(crate) log_numbering: u16,
    /// Until when a client is reading the file of a flight log.
    pub(crate) logs_read_until: Instant,
    pub(crate) faults: HookFaults,
    /// The number of resets of all parameters, 0 or 1, that go on with the next poll and are answered after the last one.
    pub(crate) pending_resets: u8,
    /// The number of hooks with a [`Context`] that were called in this poll of the stack or of a link, or by this job of storage.
    pub(crate) hooks: Wrapping<u32>,
    /// The shared turns of services that have handled a frame or a command.
    pub(crate) asked: u32,
}

/// No poll calls more hooks.
pub(crate) const MAX_HOOKS: u32 = 32;
/// What the next poll can continue leaves so many of them to the rest of the poll: a frame calls up to ten.
const RESERVED: u32 = 16;

impl Shared {
    /// All zero bits.
    pub(crate) const VACANT: Self = Self {
        config: Config::VACANT,
        normal: LinkMask::NONE,
        satellites: LinkMask::NONE,
        trusting: LinkMask::NONE,
        controllers: Controllers::NOBODY,
        observed: ObservedVehicle::new(),
        clock: Clock::NEW,
        clock_steps: 0,
        polled: Instant::ZERO,
        has_acted: false,
        is_storage_busy: false,
        answerer: ComponentId::ALL,
        is_alone: false,
        log_numbering: 0,
        logs_read_until: Instant::ZERO,
        faults: HookFaults::ZERO,
        pending_resets: 0,
        hooks: Wrapping(0),
        asked: 0,
    };

    /// Whether so many more hooks may be called in this poll.
    pub(crate) fn has_hooks(&self, count: u32) -> bool {
        (self.hooks + Wrapping(count)).0 <= MAX_HOOKS
    }

    /// Whether work that the next poll can continue may call another hook.
    pub(crate) fn may_continue(&self) -> bool {
        self.hooks.0 < MAX_HOOKS - RESERVED
    }

    /// Whether the hooks of another frame may be called in this poll. A larger [budget](crate::Config::budget) of frames has more:
    /// a hook for each frame.
    pub(crate) fn may_handle_frame(&self) -> bool {
        self.may_continue() || self.hooks.0 < self.config.budget.frames
    }

    /// Whether the other components of the firmware are left out.
    pub(crate) fn leaves_out_components<F: Firmware>(&self) -> bool {
        F::HAS_OPTIONAL_COMPONENTS && self.is_alone
    }

    /// Whether this is another component of the firmware that is not left out.
    pub(crate) fn has_component<F: Firmware>(&self, id: ComponentId) -> bool {
        F::is_component(id) && !self.leaves_out_components::<F>()
    }

    /// Whether a system that was admitted before may still change the vehicle: it is in control, or nobody is, or it is our
    /// own.
    pub(crate) fn may_change<F: Firmware>(&self, system: SystemId) -> bool {
        !F::HAS_CONTROL
            || system == self.config.address.get().system
            || self.controllers.may_change(system, Trust::Signed)
    }

    /// Whether this system takes what another one holds: it is in control, and the other is not.
    pub(crate) fn takes_precedence<F: Firmware>(&self, system: SystemId, other: SystemId) -> bool {
        F::HAS_CONTROL && self.controllers.owner() == Some(system) && other != system
    }

    /// Whether a peer is believed on its link: a component of our own system must sign, or be on a link that trusts our
    /// system; and nobody living with its address has proved itself better on another link.
    pub(crate) fn believes(&self, peers: &[PeerInfo], info: &PeerInfo) -> bool {
        let Peer { address, link } = info.peer;
        let is_ours = address.system == self.config.address.get().system;
        let is_better = |other: &PeerInfo| other.is_alive && other.peer.address == address && other.trust > info.trust;
        let is_trusted = !is_ours || info.trust == Trust::Signed || self.trusting.contains(link);
        is_trusted && !peers.iter().any(is_better)
    }

    /// Whether the stack was begun: then it has links.
    pub(crate) const fn is_begun(&self) -> bool {
        !self.normal.with(self.satellites).is_empty()
    }

    /// Whether frames of a link wait for a HEARTBEAT (H-17). Nothing waits for one that cannot come: before the first poll, and
    /// while the vehicle is in a fault.
    pub(crate) fn holds(&self, port: &Port) -> bool {
        port.is_held() && self.observed.has_state
    }

    /// Ends a link's wait for a HEARTBEAT that has not come (H-17). Unless frames still wait, makes the frame that was cut off when
    /// the link closed the next one. Returns whether there is one.
    pub(crate) fn resume(&self, now: Instant, port: &mut Port) -> bool {
        if port.is_held() {
            if self.holds(port) && now < port.bound_hold(now, self.config.max_loop_gap) {
                return false;
            }
            port.release();
        }
        port.outbox.resume()
    }

    /// Whether the vehicle has a state, and the stack was polled within `max_loop_gap`, so that the peers' timeouts and the failsafe run (H-18).
    fn is_polled(&self, now: Instant) -> bool {
        self.observed.has_state && now - self.polled <= self.config.max_loop_gap
    }

    /// Samples the pulse of the flight loop.
    pub(crate) fn sample_pulse(&mut self, now: Instant) {
        let Self { config, observed, .. } = self;
        if let Some(pulse) = config.pulse {
            observed.pulse.sample(now, pulse, config.max_loop_gap);
        }
    }

    /// Whether heartbeats may be sent, as of the last sample of the pulse (H-5, H-18).
    pub(crate) fn is_beating(&self, now: Instant) -> bool {
        self.observed.pulse.is_good(now, self.config.max_loop_gap) && self.is_polled(now)
    }

    /// Returns when the stack must be polled again at the latest, so that heartbeats may be sent (H-18).
    pub(crate) fn poll_deadline(&self) -> Instant {
        self.polled + self.config.max_loop_gap
    }

    /// Returns when a message that is due at `due` can be sent, if it must not be sent while the flight loop is stopped or the
    /// vehicle is in a fault.
    pub(crate) fn when_beating(&self, now: Instant, due: Instant) -> Instant {
        let (monitor, gap) = (&self.observed.pulse, self.config.max_loop_gap);
        match due {
            Instant::NEVER => Instant::NEVER,
            due if due > now => monitor.look_for(due, gap),
            due if self.is_beating(now) => due,
            // It waits for the flight loop or the vehicle. Only polling shows that they recovered.
            _ => now + RETRY,
        }
    }
}

/// How soon to check again whether heartbeats may be sent.
pub(crate) const RETRY: Duration = Duration::from_millis(100);

/// The data that a call of a service uses, besides the service itself and its link.
pub struct Cx<'a, F: Firmware> {
    /// By the stack's clock.
    pub(crate) now: Instant,
    pub(crate) shared: &'a mut Shared,
    pub(crate) peers: &'a mut Peers,
    pub(crate) texts: &'a mut StatusTexts,
    pub(crate) requests: &'a mut Requests,
    pub(crate) events: &'a mut EventLog,
    pub(crate) plans: PlansMut<'a>,
    pub(crate) parameters: &'a mut F::Parameters,
    pub(crate) credits: <F::Credits as CreditMemory>::View<'a>,
    pub(crate) vehicle: &'a mut F::Vehicle,
}

impl<F: Firmware> Cx<'_, F> {
    /// Returns the part that needs no vehicle.
    #[inline(always)]
    pub(crate) fn view(&self) -> View<'_> {
        View {
            now: self.now,
            shared: self.shared,
            peers: self.peers,
            texts: self.texts,
            requests: self.requests,
            events: self.events,
        }
    }

    /// Returns the time, by the stack's clock, which is never set back.
    pub const fn now(&self) -> Instant {
        self.now
    }

    /// Returns the vehicle's address.
    pub fn address(&self) -> Address {
        self.shared.config.address.get()
    }

    /// Sends a text on every normal link. Compiled out if there is no queue of texts.
    pub fn text(&mut self, severity: MavSeverity, text: &[u8]) {
        if F::HAS_TEXTS {
            self.texts.push(self.now, self.shared.normal, severity, text);
        }
    }

    /// Takes credits for a frame of `len` bytes that a peer causes on this many high-latency links (L-17). If there are not
    /// enough, takes none, says so on the normal links, and returns false.
    pub(crate) fn pay(&mut self, payer: Payer, len: usize, links: u32) -> bool {
        let Some(credits) = self.credits.credits() else { return true };
        let cost = credits.config.cost(len).saturating_mul(links);
        let is_paid = credits.take(self.now, payer, cost);
        if !is_paid && credits.may_tell(self.now) {
            self.text(MavSeverity::WARNING, b"Satellite: credits used up");
        }
        is_paid
    }

    /// Returns the vehicle, and the context for one of its hooks, which is counted.
    pub fn hook(&mut self) -> (&mut F::Vehicle, Context<'_>) {
        let (_, hook) = self.peers_and_hook();
        *hook.count += 1;
        (hook.vehicle, hook.context)
    }

    /// Returns the peer table too, for changes that the vehicle learns of. No hook is counted yet.
    pub(crate) fn peers_and_hook(&mut self) -> (&mut Peers, PeerHook<'_, F>) {
        let Self { now, shared, peers, texts, requests, events, plans, parameters, vehicle, .. } = self;
        let (now, normal, values) = (*now, shared.normal, parameters.values());
        let context = Context { now, normal, texts, requests, events, plans, values, can_start: false };
        (peers, PeerHook { vehicle, context, count: &mut shared.hooks })
    }
}

/// The hook that learns of changes of the peer table.
pub(crate) struct PeerHook<'a, F: Firmware> {
    vehicle: &'a mut F::Vehicle,
    context: Context<'a>,
    count: &'a mut Wrapping<u32>,
}

impl<F: Firmware<Vehicle: Vehicle>> PeerHook<'_, F> {
    /// Calls the hook, and counts it.
    pub(crate) fn report(&mut self, event: PeerEvent) {
        *self.count += 1;
        self.vehicle.peer(&mut self.context, event);
    }
}

/// The data that is available without the vehicle.
pub struct View<'a> {
    pub(crate) now: Instant,
    pub(crate) shared: &'a Shared,
    pub(crate) peers: &'a [PeerInfo],
    pub(crate) texts: &'a StatusTexts,
    pub(crate) requests: &'a Requests,
    pub(crate) events: &'a EventLog,
}

impl View<'_> {
    /// Returns the time, by the stack's clock.
    pub const fn now(&self) -> Instant {
        self.now
    }

    /// Returns the vehicle's address.
    pub fn address(&self) -> Address {
        self.shared.config.address.get()
    }
}
