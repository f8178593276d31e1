//! The high-latency link: HIGH_LATENCY2 over a satellite, where every byte costs money.
//!
//! Implements <https://mavlink.io/en/services/high_latency.html>, rules L-1 to L-25. A link of class
//! [`HighLatency`](crate::config::LinkClass::HighLatency) has no heartbeats. It carries commands and their answers.
//! While the service is on, it also carries a short message with the vehicle's state. The link's outbox refuses
//! everything else.
//!
//! [`HighLatency`] describes how the service is started and stopped, and how late commands are handled.

mod order;
mod sample;
mod window;

pub use sample::HighLatencySample;

use self::order::{Action, Decision, Orders};
use self::window::Window;
use super::{About, Cx, RETRY, Request, Service, StackEvent, Turn, Verdict, View, increment};
use crate::dialect::{HighLatency2, MavCmd, MavResult};
use crate::link::Port;
use crate::message::Message;
use crate::network::PeerInfo;
use crate::num;
use crate::time::{Clock, Duration, Instant};
use crate::types::{Config, CreditConfig, Firmware, LinkMask, Payer, Vehicle};

/// The minimum period.
const MIN_PERIOD: Duration = Duration::from_secs(1);

/// The minimum time between two messages that START forces (L-17).
const FORCED_PERIOD: Duration = Duration::from_secs(10);

/// The length of HIGH_LATENCY2 in MAVLink 2, without a signature.
const MESSAGE_LEN: usize = 54;

/// How the 32 bits of a `custom_mode` are reduced to the 16 bits of HIGH_LATENCY2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HighLatencyMode {
    /// The lower half: for mode numbers up to 65535. Ground stations take it for the whole number, except for the
    /// autopilot PX4.
    Low16,
    /// The upper half, `main | sub << 8` of PX4's `main << 16 | sub << 24`. Ground stations restore it for the
    /// autopilot PX4.
    High16,
}

/// The configuration of [`HighLatency`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct HighLatencyConfig {
    /// The time between messages on a link: a minute by default. Less than a second counts as a second.
    pub period: Duration,
    /// Whether one message is sent after the start, as soon as there was a [sample](HighLatency::sample), so that the
    /// ground learns that the link exists (L-14). False by default.
    pub announce_once: bool,
    /// The time without a living ground station on any normal link after which the service starts automatically, if
    /// there was one before. `None`, the default, means never. A loss is noticed after
    /// [`peer_timeout`](crate::Config::peer_timeout), to which this time is added.
    ///
    /// When a ground station is heard again, the service stops automatically, unless START was received meanwhile. STOP
    /// stops it until the next loss. Messages are never sent sooner than a period after the last, however often the
    /// ground station disappears and returns.
    pub on_link_loss_after: Option<Duration>,
    /// How `custom_mode` is sent: [`Low16`](HighLatencyMode::Low16) by default.
    pub custom_mode: HighLatencyMode,
}

impl HighLatencyConfig {
    /// The default: a message a minute, only when commanded.
    pub const DEFAULT: Self = Self {
        period: Duration::from_secs(60),
        announce_once: false,
        on_link_loss_after: None,
        custom_mode: HighLatencyMode::Low16,
    };

    /// All zero bits.
    const fn vacant(self) -> Self {
        Self { period: Duration::ZERO, ..self }
    }

    fn period(&self) -> Duration {
        self.period.max(MIN_PERIOD)
    }
}

impl Default for HighLatencyConfig {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Counters of the frames that were sent on the high-latency links. They wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct HighLatencyCounters {
    /// HIGH_LATENCY2 messages.
    pub reports: u32,
    /// All frames: HIGH_LATENCY2, and answers to commands.
    pub messages: u32,
    /// Bytes in them, headers and checksums included.
    pub bytes: u32,
    /// Their cost if each is sent separately: one credit for each 50 bytes, rounded up, as in
    /// [`Stack::set_credits`](crate::Stack::set_credits). HIGH_LATENCY2 has 50 bytes in MAVLink 1, which is one credit, and 51 to
    /// 54 in MAVLink 2, which is two.
    pub credits: u32,
    /// The executed START that forced no message, because the credits were used up (L-17).
    pub refused: u32,
}

/// Whether messages are sent, and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Off,
    /// On by command, or by the vehicle's own call.
    Commanded,
    /// Started automatically, because no ground station is left.
    LinkLost,
}

/// The state of the ground stations on normal links.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ground {
    /// None was heard, or their loss was handled.
    Unknown,
    Heard,
    LostSince(Instant),
}

/// The high-latency service: `high_latency: HighLatency` in the struct of a [stack](macro@crate::Stack). Without it,
/// high-latency links carry only commands, and MAV_CMD_CONTROL_HIGH_LATENCY reaches
/// [`Commands::command`](crate::Commands::command) (L-12).
///
/// ```
/// use mavstack::dialect::{MavCmd, MavResult};
/// use mavstack::config::{LinkClass, TxVersion};
/// use mavstack::high_latency::{HighLatencyConfig, HighLatencySample};
/// use mavstack::prelude::*;
///
/// const LINKS: [LinkConfig; 2] = [
///     LinkConfig::uart(57_600),
///     // In MAVLink 1 the message costs one credit, in MAVLink 2 two.
///     LinkConfig::uart(19_200).with_class(LinkClass::HighLatency).with_version(TxVersion::V1),
/// ];
/// const CONFIG: HighLatencyConfig = HighLatencyConfig {
///     announce_once: true,
///     on_link_loss_after: Some(Duration::from_secs(10)),
///     ..HighLatencyConfig::DEFAULT
/// };
///
/// #[derive(Stack)]
/// #[stack(vehicle: Copter, links: 2)]
/// struct Mavlink {
///     high_latency: mavstack::high_latency::HighLatency,
/// }
///
/// struct Copter { altitude: f32, is_armed: bool }
///
/// impl Commands for Copter {
///     fn command(&mut self, _: &mut Context<'_>, command: &Command) -> Outcome {
///         match command.id {
///             // Its age is unknown (L-16).
///             MavCmd::COMPONENT_ARM_DISARM if command.class == LinkClass::HighLatency => MavResult::DENIED.into(),
///             MavCmd::COMPONENT_ARM_DISARM => { self.is_armed = true; MavResult::ACCEPTED.into() }
///             _ => MavResult::UNSUPPORTED.into(),
///         }
///     }
/// }
/// # impl Vehicle for Copter { fn state(&self) -> Option<VehicleState> { None } }
///
/// /// Called about ten times a second by the flight loop.
/// fn report(stack: &mut StackOf<Mavlink>, now: Instant, copter: &Copter) {
///     stack.high_latency.sample(now, &HighLatencySample {
///         altitude: copter.altitude,
///         wind_from_deg: 270.0,
///         windspeed: 4.5,
///         ..HighLatencySample::UNKNOWN
///     });
///     if stack.high_latency.counters().credits > 1_000 {
///         // The credits of this month are used up.
///         stack.high_latency.stop();
///     }
/// }
/// ```
///
/// # When it is on
///
/// ```text
///             START, HighLatency::start
///        ┌─────────────────────────────────────────▶ on, as commanded ◀──────────────┐
///       off ◀───────── STOP, HighLatency::stop ──────────┘                           │ START
///        │ ▲                                                                         │
///        │ └─ a ground station is heard on a normal link again, STOP ── on by itself ┘
///        └────── no ground station on any normal link (an option) ──────────▲
/// ```
///
/// START and STOP are MAV_CMD_CONTROL_HIGH_LATENCY, received on any link. They apply to all high-latency links, and the
/// latest one counts. Both kinds of links run at the same time, so that a ground station can hand over from one to the
/// other (L-15).
///
/// START sends a message at once, even while the service is on, but not within ten seconds after the last one that a START has forced: then later. It takes
/// [credits](crate::Stack::set_credits) for it, as for two of a message's 50 bytes, on each high-latency link. Without credits
/// it turns the service on, and messages are sent on schedule (L-17). Sent to all systems it is DENIED. Each later message is sent one period after the
/// previous one was. A busy modem gets it as soon as it is ready, with the state of that moment, and the next one a
/// period later. Samples between two messages are summarised in the second one: means and extremes (L-21). A firmware
/// that moves the bytes itself calls [`Stack::transmit`](crate::Stack::transmit) only when the modem accepts some.
///
/// Ground stations take a message for a sign of life, like a heartbeat. So none is sent while heartbeats are not: when
/// the flight loop does not tick, and in a fault (H-5).
///
/// # Late commands
///
/// A command from a normal link is current and counts, except for duplicates within three seconds of a delivery by
/// another link, and retransmissions with a higher confirmation (C-12). A satellite delivers commands late, and so
/// after commands that were sent later. A superseded command has no effect. Otherwise a START from before a STOP would
/// keep costing money, and a STOP from before a START would cut off the last contact. These commands from a satellite
/// have no effect:
///
/// - **A duplicate** of a command of the same sender that was executed within the last minute. Each execution has at
///   most one duplicate on each other link. A retransmission with a higher confirmation is a duplicate too, on a link
///   that has delivered the command and has not delivered the opposite one since.
/// - **A command that its sender would send by radio**: within a minute after the sender gave the opposite command on a
///   normal link on which it is alive.
/// - **A command that is older by its signature** than the sender's last one, if that was received within the last
///   quarter of an hour. A command that is newer than the opposite one always counts. This compares two timestamps of
///   one sender, so our clock does not matter. The sender must use one clock for both links; otherwise it is refused
///   here until this time is over.
///
/// The answer is ACCEPTED if the service is in the requested state, which for START means on by command, else
/// TEMPORARILY_REJECTED. The sender repeats a command that it still wants.
///
/// More cannot be known. Without signatures, two kinds of late START count: one that was not seen before and follows
/// the STOP of a sender whose heartbeats are not heard, and one that was delayed for more than a minute. Their sender
/// sees the messages, and sends STOP again. The last START and STOP of two stations are remembered; a new station
/// replaces the oldest.
///
/// A peer on such a link is heard, but never alive or timed out
/// ([`PeerInfo::is_alive`](crate::network::PeerInfo::is_alive)). No heartbeats are expected there, and received ones do
/// not count; otherwise a failsafe would take a satellite's silence for the loss of a ground station (L-3).
/// [`PeerInfo::last_heard`](crate::network::PeerInfo::last_heard) is the time of the last command.
///
/// Other commands from a satellite are also 10 to 30 seconds late, at times minutes, and in any order. They carry no
/// time except that of a signature. A vehicle that refuses to arm or to take off on such a command checks
/// [`Command::class`](crate::Command::class) and [`Command::age`](crate::Command::age) (L-16).
#[derive(Clone, Debug)]
pub struct HighLatency {
    config: HighLatencyConfig,
    state: State,
    ground: Ground,
    orders: Orders,
    /// When every link sends its next message.
    next: Instant,
    /// The links that have not adopted [`next`](Self::next) yet.
    rescheduled: LinkMask,
    /// Links on which one message is pending although the service is off.
    announcing: LinkMask,
    has_announced: bool,
    /// When the last message was made.
    sent: Instant,
    last: HighLatencySample,
    sampled: Option<Instant>,
    /// The stack's clock, as of the last poll.
    clock: Clock,
    /// The samples since the last message.
    open: Window,
    /// The samples before it, for the links that have not sent them yet.
    closed: Window,
    /// The links that have sent the closed window.
    reported: LinkMask,
    /// Ten seconds after the last message that START forces, or will force.
    forced_until: Instant,
    counters: HighLatencyCounters,
}

impl HighLatency {
    /// Adds a sample of the vehicle's state. Call it in every pass of the flight loop, or a few times a second. The
    /// message contains the mean or the extreme of some fields, and the last value of the others. Its timestamp is that
    /// of the last sample, so out-of-date content is recognisable.
    pub fn sample(&mut self, now: Instant, sample: &HighLatencySample) {
        let now = self.clock.peek(now);
        // Samples from before the service was on are discarded, except those of the last period.
        let is_message_pending = self.is_on() || !self.announcing.is_empty();
        if !is_message_pending && now - self.open.begun >= self.config.period() {
            self.open = Window::new(now);
        }
        self.open.add(sample);
        self.last = *sample;
        self.sampled = Some(now);
    }

    /// Starts sending, as START does: for the vehicle's own failsafe. The first message is sent at once; if the service
    /// is on already, an additional one.
    pub fn start(&mut self) {
        event!("high latency: on");
        self.state = State::Commanded;
        self.schedule(Instant::ZERO);
    }

    /// Stops sending, as STOP does.
    pub fn stop(&mut self) {
        event!("high latency: off");
        self.state = State::Off;
        self.announcing = LinkMask::NONE;
    }

    /// Whether the service is on.
    pub fn is_on(&self) -> bool {
        self.state != State::Off
    }

    /// Whether the service started automatically, because no ground station was left on normal links.
    pub fn is_on_by_itself(&self) -> bool {
        self.state == State::LinkLost
    }

    /// Changes the configuration. The service stays on or off, the next message is sent when it was due, and the new
    /// period begins after it.
    pub const fn set_config(&mut self, config: HighLatencyConfig) {
        self.config = config;
    }

    /// Returns the counters.
    pub fn counters(&self) -> HighLatencyCounters {
        self.counters
    }

    /// Schedules the next message of every link at `at`.
    fn schedule(&mut self, at: Instant) {
        self.next = at;
        self.rescheduled = LinkMask::ALL;
    }

    /// Returns when a link sends its next message.
    fn due_on(&self, port: &Port, due: Instant) -> Instant {
        if self.rescheduled.contains(port.id) { self.next } else { due }
    }

    /// Adopts the service's time of the next message on a link.
    fn adopt_next(&mut self, port: &Port, due: &mut Instant) {
        *due = self.due_on(port, *due);
        self.rescheduled = self.rescheduled.without(LinkMask::of(port.id));
    }

    /// Executes START: turns the service on, and forces a message if there are credits for it (L-17).
    fn start_for_peer<F: Firmware>(&mut self, cx: &mut Cx<'_, F>, payer: Payer) {
        event!("high latency: on");
        let was_on = self.is_on();
        self.state = State::Commanded;
        let (now, soon) = (cx.now, cx.now + FORCED_PERIOD);
        let is_pending = self.rescheduled.intersects(cx.shared.satellites) && self.next <= soon;
        let comes_anyway = now < self.forced_until && self.config.period() <= FORCED_PERIOD;
        if was_on && (is_pending || comes_anyway) {
            return;
        }
        if cx.pay(payer, MESSAGE_LEN, cx.shared.satellites.len()) {
            let at = now.max(self.forced_until.min(soon));
            self.forced_until = at + FORCED_PERIOD;
            return self.schedule(at);
        }
        increment(&mut self.counters.refused);
        if !was_on {
            self.schedule(self.sent + self.config.period());
        }
    }

    /// Executes MAV_CMD_CONTROL_HIGH_LATENCY (L-10 to L-13).
    fn control<F: Firmware>(&mut self, cx: &mut Cx<'_, F>, request: &Request) -> MavResult {
        if cx.shared.satellites.is_empty() {
            return MavResult::UNSUPPORTED;
        }
        let [enable, ..] = request.command.params;
        let action = match num::integer(enable) {
            Some(1) => Action::Start,
            Some(0) => Action::Stop,
            _ => return MavResult::DENIED,
        };
        if self.orders.decide(cx.now, action, request, cx.peers) == Decision::Execute {
            match action {
                Action::Start => self.start_for_peer(cx, request.payer),
                Action::Stop => self.stop(),
            }
        }
        // Started automatically, the service also stops automatically; START must keep it on.
        let wanted = match action {
            Action::Start => State::Commanded,
            Action::Stop => State::Off,
        };
        if self.state == wanted { MavResult::ACCEPTED } else { MavResult::TEMPORARILY_REJECTED }
    }

    /// Monitors the ground stations. `is_heard`: one is alive on a normal link.
    fn watch(&mut self, now: Instant, is_heard: bool) {
        let Some(after) = self.config.on_link_loss_after else { return };
        if is_heard {
            self.ground = Ground::Heard;
            if self.state == State::LinkLost {
                self.stop();
            }
            return;
        }
        if self.ground == Ground::Heard {
            self.ground = Ground::LostSince(now);
        }
        if let Ground::LostSince(since) = self.ground
            && now - since >= after
        {
            self.ground = Ground::Unknown;
            if self.state == State::Off {
                event!("high latency: on, no ground station is left");
                self.state = State::LinkLost;
                let is_first = self.counters.reports == 0;
                self.schedule(if is_first { Instant::ZERO } else { self.sent + self.config.period() });
            }
        }
    }

    /// Returns when the ground stations have been lost for so long that the service starts automatically.
    fn loss_deadline(&self) -> Instant {
        match (self.ground, self.config.on_link_loss_after) {
            (Ground::LostSince(since), Some(after)) => since + after,
            _ => Instant::NEVER,
        }
    }

    /// Returns the message for a link now.
    fn report(&mut self, now: Instant, link: LinkMask, config: &Config, custom_mode: u32) -> HighLatency2 {
        // A link that has sent the closed window gets a new one; the other links get the same content.
        if self.reported.intersects(link) || self.reported.is_empty() {
            self.closed = core::mem::replace(&mut self.open, Window::new(now));
            self.reported = LinkMask::NONE;
        }
        self.reported = self.reported.with(link);
        self.announcing = self.announcing.without(link);
        self.sent = now;
        let [b0, b1, b2, b3] = custom_mode.to_le_bytes();
        let custom_mode = match self.config.custom_mode {
            HighLatencyMode::Low16 => [b0, b1],
            HighLatencyMode::High16 => [b2, b3],
        };
        let mut message = HighLatency2 {
            timestamp: self.sampled.unwrap_or(now).time_boot_ms(),
            r#type: config.r#type,
            autopilot: config.autopilot,
            custom_mode: u16::from_le_bytes(custom_mode),
            ..Default::default()
        };
        self.closed.summary(&self.last).write_to(&mut message);
        message
    }
}

impl<F: Firmware<Vehicle: Vehicle>> Service<F> for HighLatency {
    const NEW: Self = Self {
        config: HighLatencyConfig::DEFAULT.vacant(),
        state: State::Off,
        ground: Ground::Unknown,
        orders: Orders::NEW,
        next: Instant::ZERO,
        rescheduled: LinkMask::NONE,
        announcing: LinkMask::NONE,
        has_announced: false,
        sent: Instant::ZERO,
        last: HighLatencySample::VACANT,
        sampled: None,
        clock: Clock::NEW,
        open: Window::VACANT,
        closed: Window::VACANT,
        reported: LinkMask::NONE,
        forced_until: Instant::ZERO,
        counters: HighLatencyCounters { reports: 0, messages: 0, bytes: 0, credits: 0, refused: 0 },
    };
    /// When the next message is sent.
    type Link = Instant;
    const VACANT: Instant = Instant::ZERO;
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::HighLatency]);
    type Reply = ();

    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut Instant>) {
        self.clock = cx.shared.clock;
        if self.config.announce_once && !self.has_announced && self.sampled.is_some() {
            self.has_announced = true;
            self.announcing = cx.shared.satellites;
            self.schedule(Instant::ZERO);
        }
        // No peer is alive on a high-latency link.
        self.watch(cx.now, cx.peers.iter().any(PeerInfo::is_living_station));
    }

    fn deadline(&self) -> Instant {
        self.loss_deadline()
    }

    fn on_command(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut Instant,
        request: &Request,
    ) -> Option<Verdict> {
        let command = &request.command;
        let [id, ..] = command.params;
        match command.id {
            MavCmd::CONTROL_HIGH_LATENCY => Some(Verdict::accepted(self.control(cx, request))),
            // Only on a high-latency link, and only while the service is on (L-2).
            MavCmd::REQUEST_MESSAGE if num::integer(id) == Some(HighLatency2::ID) => {
                let is_class = port.config.class.is_high_latency();
                let is_accepted = is_class && self.is_on() && command.has_response_target();
                if is_accepted {
                    self.adopt_next(port, link);
                    *link = cx.now;
                }
                Some(Verdict::accepted(if is_accepted { MavResult::ACCEPTED } else { MavResult::DENIED }))
            }
            _ => None,
        }
    }

    #[inline(always)]
    fn pending(&self, _: &View<'_>, port: &Port, link: &Instant, _: Turn) -> Option<(Instant, ())> {
        let is_sent = self.is_on() || self.announcing.contains(port.id);
        is_sent.then(|| (self.due_on(port, *link), ()))
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut Instant, (): ()) -> bool {
        let now = cx.now;
        self.adopt_next(port, link);
        let Some(state) = cx.vehicle.state() else {
            *link = now + RETRY;
            return false;
        };
        *link = if self.is_on() { now + self.config.period() } else { Instant::NEVER };
        let message = self.report(now, LinkMask::of(port.id), &cx.shared.config, state.custom_mode);
        let sent = port.outbox.send(&message);
        if sent {
            increment(&mut self.counters.reports);
        }
        sent
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        match event {
            StackEvent::Begun(_) => {
                self.config = HighLatencyConfig::DEFAULT;
                self.last = HighLatencySample::UNKNOWN;
                self.open = Window::new(Instant::ZERO);
            }
            // Counts the cost of a frame on a high-latency link.
            StackEvent::Sent(port, _) if port.config.class.is_high_latency() => {
                let len = port.outbox.pending().len();
                let counters = &mut self.counters;
                increment(&mut counters.messages);
                counters.bytes = counters.bytes.wrapping_add(u32::try_from(len).unwrap_or(0));
                counters.credits = counters.credits.wrapping_add(CreditConfig::DEFAULT.cost(len));
            }
            _ => {}
        }
    }
}
