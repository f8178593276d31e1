//! The high-latency link: HIGH_LATENCY2 over a satellite, where every byte costs.
//!
//! Implements <https://mavlink.io/en/services/high_latency.html>, rules L-1 to L-25. On a link of class
//! [`HighLatency`](crate::LinkClass::HighLatency) there are no heartbeats; commands and their answers travel, and one short
//! message that says all that matters, while it is on. What else anybody wants to send there, the link's outbox refuses.
//!
//! How it goes on and off, and what becomes of orders that come late, stands at [`HighLatency`].

mod order;
mod sample;
mod window;

pub use sample::HighLatencySample;

use self::order::{ORDERS, Order};
use self::window::Window;
use crate::config::Config;
use crate::dialect::{HighLatency2, MavCmd, MavResult, MavType};
use crate::link::{Link, LinkClass, LinkMask, Port};
use crate::message::Message;
use crate::network::Peers;
use crate::num;
use crate::service::command::SignedAt;
use crate::time::{Duration, Instant};
use crate::vehicle::{Command, Vehicle};

/// A shorter period counts as this.
const MIN_PERIOD: Duration = Duration::from_secs(1);

/// What is paid for: so many bytes, begun ones in full (Iridium's short burst data).
const CREDIT: u32 = 50;

/// How the 32 bits of a `custom_mode` become the 16 of HIGH_LATENCY2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HighLatencyMode {
    /// The lower half: for mode numbers up to 65535. Ground stations take it for the whole number, unless the autopilot
    /// calls itself PX4.
    Low16,
    /// The upper half, `main | sub << 8` of PX4's `main << 16 | sub << 24`: ground stations put it back where the autopilot
    /// calls itself PX4.
    High16,
}

/// What a [`HighLatency`] is to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct HighLatencyConfig {
    /// From one message to the next on a link: a minute. Less than a second counts as that.
    pub period: Duration,
    /// Whether one message is sent after the start, as soon as there was a [sample](HighLatency::sample), so that the ground
    /// learns that the link is there (L-14). False at first.
    pub announce_once: bool,
    /// After how long without a living ground station on any normal link, where there was one before, it goes on by itself;
    /// `None`, as at first, for never. When a ground station is heard again it goes off, if nobody commanded it on
    /// meanwhile; a STOP puts it off until the next loss. It never makes a message come sooner than a period after the last,
    /// however often the ground station comes and goes. A loss is noticed after
    /// [`peer_timeout`](crate::Config::peer_timeout), which this adds to.
    pub on_link_loss_after: Option<Duration>,
    /// [`Low16`](HighLatencyMode::Low16) at first.
    pub custom_mode: HighLatencyMode,
}

impl HighLatencyConfig {
    /// A message a minute, only when commanded.
    pub const DEFAULT: Self = Self {
        period: Duration::from_secs(60),
        announce_once: false,
        on_link_loss_after: None,
        custom_mode: HighLatencyMode::Low16,
    };

    fn period(&self) -> Duration {
        self.period.max(MIN_PERIOD)
    }
}

impl Default for HighLatencyConfig {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// What went out over the high-latency links. Numbers wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct HighLatencyCounters {
    /// HIGH_LATENCY2 that were sent.
    pub reports: u32,
    /// Frames of all kinds: these, and answers to commands.
    pub messages: u32,
    /// Bytes in them, headers and checksums included.
    pub bytes: u32,
    /// What they cost, if each is sent by itself: one for every 50 bytes that were begun. HIGH_LATENCY2 has 50 bytes in
    /// MAVLink 1, which is one credit, and 51 to 54 in MAVLink 2, which is two.
    pub credits: u32,
}

/// Whether messages go out, and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Off,
    /// By command, or because the vehicle wants it.
    Commanded,
    /// Because no ground station is left.
    LinkLost,
}

/// What is known of the ground stations on normal links.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ground {
    /// None was heard, or what follows from its loss is done.
    Unknown,
    Heard,
    LostSince(Instant),
}

/// The vehicle's memory for its high-latency links, some 520 bytes. The vehicle keeps it and hands it to the stack by
/// [`Vehicle::high_latency`](crate::Vehicle::high_latency); one that does not pays nothing, and its high-latency links carry
/// commands only.
///
/// ```
/// use mavstack::dialect::{MavCmd, MavResult};
/// use mavstack::*;
///
/// const TELEM: LinkId = LinkId(0);
/// const SATELLITE: LinkId = LinkId(1);
/// const LINKS: [LinkConfig; 2] = [
///     LinkConfig::uart(57_600),
///     // In MAVLink 1, in which the message is just within one credit.
///     LinkConfig::uart(19_200).with_class(LinkClass::HighLatency).with_version(TxVersion::V1),
/// ];
///
/// struct Copter { satellite: HighLatency, altitude: f32, is_armed: bool }
///
/// impl Vehicle for Copter {
///     fn state(&self) -> Option<VehicleState> {
/// #       None
///         // …
///     }
///
///     fn high_latency(&mut self) -> Option<&mut HighLatency> {
///         Some(&mut self.satellite)
///     }
/// }
///
/// impl Commands for Copter {
///     fn command(&mut self, command: &Command) -> Outcome {
///         match command.id {
///             // Who knows how old it is (L-16).
///             MavCmd::COMPONENT_ARM_DISARM if command.class == LinkClass::HighLatency => MavResult::DENIED.into(),
///             MavCmd::COMPONENT_ARM_DISARM => { self.is_armed = true; MavResult::ACCEPTED.into() }
///             _ => MavResult::UNSUPPORTED.into(),
///         }
///     }
/// }
///
/// const CONFIG: HighLatencyConfig = HighLatencyConfig {
///     announce_once: true,
///     on_link_loss_after: Some(Duration::from_secs(10)),
///     ..HighLatencyConfig::DEFAULT
/// };
/// let mut copter = Copter { satellite: HighLatency::new(CONFIG), altitude: 488.2, is_armed: false };
///
/// // Some ten times a second, by the flight loop:
/// let now = Instant::from_millis(100);
/// copter.satellite.sample(now, &HighLatencySample {
///     altitude: copter.altitude,
///     wind_from_deg: 270.0,
///     windspeed: 4.5,
///     ..HighLatencySample::UNKNOWN
/// });
/// if copter.satellite.counters().credits > 1_000 {
///     // That was the contract for this month.
///     copter.satellite.stop();
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
/// START and STOP are MAV_CMD_CONTROL_HIGH_LATENCY, over any link, and hold for all high-latency links; the one that comes
/// last counts. Both kinds of links run at once, for a ground station that hands over from one to the other (L-15). START
/// sends a message at once, also while it is on. After that a message follows a period after the one before left: a modem that is
/// busy gets it as soon as it is not, made of what is known then, and the next one a period later. What came between two
/// messages is in the second: means, and the worst (L-21). Who moves the bytes himself asks
/// [`Stack::transmit`](crate::Stack::transmit) for them only when the modem takes some.
///
/// A message says that the vehicle is alive, to ground stations as a heartbeat does. So none goes out while heartbeats do
/// not: when the flight loop does not tick, and in a fault (H-5).
///
/// What comes by a normal link is said now, and counts, but for copies within three seconds of what another link brought and
/// repetitions with a higher confirmation (C-12). A satellite brings commands late, and so after others that were given later.
/// One that was overtaken changes nothing, or a START from before a STOP would go on costing money, and a STOP from before a
/// START leave nobody in touch. By satellite that is:
///
/// - **A copy** of what the same sender was obeyed in within the last minute, as often as that was; and its repetition with a
///   higher confirmation, on a link that brought it and nothing to the opposite effect since.
/// - **What its sender would say by radio**: within a minute after he said the opposite by a normal link, over which he is alive.
/// - **What is older by its signature**, up to a quarter of an hour, than what he said last. One that is newer than the opposite
///   counts, whatever else it looks like. Here two timestamps of one sender are compared, so no clock of ours matters; his
///   have to be of one clock for both links, or he is refused here until that time is over.
///
/// The answer is ACCEPTED where things are as it wants them, which for START is on as commanded, else TEMPORARILY_REJECTED:
/// who means it says it again. That is all that can be known. Without signatures, a START that was not seen before and comes
/// after the STOP of somebody whose heartbeats are not heard counts, and so does one that was held back for more than a
/// minute: its sender sees the messages come, and says STOP again. The last START and STOP of two stations are remembered,
/// those of others in the place of the oldest.
///
/// Who speaks over such a link is heard, and never alive or lost ([`PeerInfo::is_alive`](crate::PeerInfo::is_alive)): no
/// heartbeats are expected there, and those that come say nothing, or a failsafe would take a satellite's silence for a
/// ground station's end (L-3). When somebody last commanded, [`PeerInfo::last_heard`](crate::PeerInfo::last_heard) says.
///
/// Other commands over a satellite come 10 to 30 seconds late too, at times minutes, and in any order. They bear no time of
/// their own but that of a signature. [`Command::class`] and [`Command::age`] are for the vehicle that refuses to arm for such
/// a command, or to take off (L-16).
#[derive(Clone, Debug)]
pub struct HighLatency {
    config: HighLatencyConfig,
    state: State,
    ground: Ground,
    orders: [Option<Order>; ORDERS],
    /// The high-latency links; none until the stack has told.
    links: LinkMask,
    /// From when on every link is to send its next message, once that has changed.
    next: Option<Instant>,
    /// Links on which one message is to be sent though it is off.
    announcing: LinkMask,
    has_announced: bool,
    /// When the last message was made.
    sent: Instant,
    last: HighLatencySample,
    sampled: Option<Instant>,
    /// What came since the last message, and what came before that, for the links that have not told it yet.
    open: Window,
    closed: Window,
    /// The links that have told what is closed.
    told: LinkMask,
    counters: HighLatencyCounters,
}

impl HighLatency {
    /// Off, with nothing known yet.
    pub const fn new(config: HighLatencyConfig) -> Self {
        Self {
            config,
            state: State::Off,
            ground: Ground::Unknown,
            orders: [None; ORDERS],
            links: LinkMask::NONE,
            next: None,
            announcing: LinkMask::NONE,
            has_announced: false,
            sent: Instant::ZERO,
            last: HighLatencySample::UNKNOWN,
            sampled: None,
            open: Window::new(Instant::ZERO),
            closed: Window::new(Instant::ZERO),
            told: LinkMask::NONE,
            counters: HighLatencyCounters { reports: 0, messages: 0, bytes: 0, credits: 0 },
        }
    }

    /// How the vehicle is now. To be called by the flight loop, in every pass or a few times a second: the mean of all of
    /// them is told, or the worst, and of the rest the last. The message's timestamp is that of the last one, so old news
    /// look old.
    pub fn sample(&mut self, now: Instant, sample: &HighLatencySample) {
        // What was before it went on is of no interest, but for the last while.
        let waits = self.is_on() || !self.announcing.is_empty();
        if !waits && now.since(self.open.begun) >= self.config.period() {
            self.open = Window::new(now);
        }
        self.open.add(sample);
        self.last = *sample;
        self.sampled = Some(now);
    }

    /// Begins to send, as START does: for the vehicle's own failsafe. The first message goes out at once, or, when it is on
    /// already, one more.
    pub fn start(&mut self) {
        event!("high latency: on");
        self.state = State::Commanded;
        self.next = Some(Instant::ZERO);
    }

    /// Stops, as STOP does.
    pub fn stop(&mut self) {
        event!("high latency: off");
        self.state = State::Off;
        self.announcing = LinkMask::NONE;
    }

    /// Whether messages go out.
    pub fn is_on(&self) -> bool {
        self.state != State::Off
    }

    /// Whether it went on by itself, for want of ground stations on normal links.
    pub fn is_on_by_itself(&self) -> bool {
        self.state == State::LinkLost
    }

    /// Takes another configuration. What is on stays on, the next message comes when it was to come, and the new period
    /// follows it.
    pub const fn set_config(&mut self, config: HighLatencyConfig) {
        self.config = config;
    }

    /// What it cost so far.
    pub fn counters(&self) -> HighLatencyCounters {
        self.counters
    }

    /// MAV_CMD_CONTROL_HIGH_LATENCY (L-10 to L-13).
    fn control(&mut self, now: Instant, command: &Command, signed_at: SignedAt, peers: &Peers) -> MavResult {
        if self.links.is_empty() {
            return MavResult::UNSUPPORTED;
        }
        let [enable, ..] = command.params;
        let starts = match num::integer(enable) {
            Some(1) => true,
            Some(0) => false,
            _ => return MavResult::DENIED,
        };
        if self.obeys(now, command, signed_at, starts, peers) {
            if starts {
                self.start();
            } else {
                self.stop();
            }
        }
        // What is on by itself goes off by itself: that is not what START wants.
        let wanted = if starts { State::Commanded } else { State::Off };
        if self.state == wanted { MavResult::ACCEPTED } else { MavResult::TEMPORARILY_REJECTED }
    }

    /// A ground station is alive on a normal link, or none is.
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
            && now.since(since) >= after
        {
            self.ground = Ground::Unknown;
            if self.state == State::Off {
                event!("high latency: on, no ground station is left");
                self.state = State::LinkLost;
                let is_first = self.counters.reports == 0;
                self.next = Some(if is_first { Instant::ZERO } else { self.sent.after(self.config.period()) });
            }
        }
    }

    /// When the ground station has been lost for so long that it goes on by itself.
    fn deadline(&self) -> Instant {
        match (self.ground, self.config.on_link_loss_after) {
            (Ground::LostSince(since), Some(after)) => since.after(after),
            _ => Instant::NEVER,
        }
    }

    /// The message for a link, as of now.
    fn report(&mut self, now: Instant, link: LinkMask, config: &Config, custom_mode: u32) -> HighLatency2 {
        // A link that has told what was closed wants news; the others are told the same.
        if self.told.contains(link) || self.told.is_empty() {
            self.closed = core::mem::replace(&mut self.open, Window::new(now));
            self.told = LinkMask::NONE;
        }
        self.told = self.told.with(link);
        self.announcing = self.announcing.without(link);
        self.sent = now;
        let [b0, b1, b2, b3] = custom_mode.to_le_bytes();
        let custom_mode = match self.config.custom_mode {
            HighLatencyMode::Low16 => [b0, b1],
            HighLatencyMode::High16 => [b2, b3],
        };
        let mut message = HighLatency2 {
            timestamp: millis(self.sampled.unwrap_or(now)),
            r#type: config.r#type,
            autopilot: config.autopilot,
            custom_mode: u16::from_le_bytes(custom_mode),
            ..Default::default()
        };
        self.closed.summary(&self.last).tell(&mut message);
        message
    }
}

/// The lower 32 bits of the milliseconds since boot.
fn millis(at: Instant) -> u32 {
    u32::try_from(at.as_millis() & u64::from(u32::MAX)).unwrap_or(0)
}

/// Runs the timers, and tells when it is to be called again though nothing else happens.
pub(crate) fn poll(now: Instant, links: &mut [Link], peers: &Peers, vehicle: &mut impl Vehicle) -> Instant {
    let Some(satellite) = vehicle.high_latency() else { return Instant::NEVER };
    learn(satellite, links);
    if satellite.config.announce_once && !satellite.has_announced && satellite.sampled.is_some() {
        satellite.has_announced = true;
        satellite.announcing = satellite.links;
        satellite.next = Some(Instant::ZERO);
    }
    let links_of_satellite = satellite.links;
    let is_ground = |info: &&crate::network::PeerInfo| info.r#type == MavType::GCS && info.is_alive;
    let is_normal = |info: &crate::network::PeerInfo| !links_of_satellite.contains(LinkMask::of(info.peer.link));
    satellite.watch(now, peers.iter().filter(is_ground).any(is_normal));
    schedule(links, satellite);
    satellite.deadline()
}

/// Something was received on a link: what it changed is for all of them.
pub(crate) fn received(links: &mut [Link], vehicle: &mut impl Vehicle) {
    if let Some(satellite) = vehicle.high_latency() {
        schedule(links, satellite);
    }
}

/// Tells which links there are, before a command may ask.
pub(crate) fn learn_links(links: &[Link], vehicle: &mut impl Vehicle) {
    if let Some(satellite) = vehicle.high_latency() {
        learn(satellite, links);
    }
}

#[inline(never)]
fn learn(satellite: &mut HighLatency, links: &[Link]) {
    if satellite.links.is_empty() {
        let links = links.iter().filter(|link| is_satellite(&link.port));
        satellite.links = links.fold(LinkMask::NONE, |links, link| links.with(LinkMask::of(link.port.id)));
    }
}

fn is_satellite(port: &Port) -> bool {
    port.config.class == LinkClass::HighLatency
}

#[inline(never)]
fn schedule(links: &mut [Link], satellite: &mut HighLatency) {
    let Some(next) = satellite.next.take() else { return };
    links.iter_mut().filter(|link| is_satellite(&link.port)).for_each(|link| link.port.heartbeat.postpone(next));
}

/// A command about the high-latency links; `None` for all others, and for a vehicle that has no memory for them.
#[inline(never)]
pub(crate) fn on_command(
    now: Instant,
    port: &mut Port,
    peers: &Peers,
    vehicle: &mut impl Vehicle,
    command: &Command,
    signed_at: SignedAt,
) -> Option<MavResult> {
    let satellite = vehicle.high_latency()?;
    let [id, ..] = command.params;
    match command.id {
        MavCmd::CONTROL_HIGH_LATENCY => Some(satellite.control(now, command, signed_at, peers)),
        // Only there, and only while it is on (L-2).
        MavCmd::REQUEST_MESSAGE if num::unsigned(id) == Some(HighLatency2::ID) => {
            let may_ask = is_satellite(port) && satellite.is_on() && command.has_response_target();
            if may_ask {
                port.heartbeat.postpone(now);
            }
            Some(if may_ask { MavResult::ACCEPTED } else { MavResult::DENIED })
        }
        _ => None,
    }
}

/// Sends the message that is due on a high-latency link, which is ready for it. False when none is to go out.
pub(crate) fn next(now: Instant, config: &Config, port: &mut Port, vehicle: &mut impl Vehicle) -> bool {
    let state = vehicle.state();
    let Some(satellite) = vehicle.high_latency() else { return false };
    let link = LinkMask::of(port.id);
    if !satellite.is_on() && !satellite.announcing.contains(link) {
        port.heartbeat.postpone(Instant::NEVER);
        return false;
    }
    let Some(state) = state else {
        port.heartbeat.postpone(now.after(RETRY));
        return false;
    };
    let message = satellite.report(now, link, config, state.custom_mode);
    let next = if satellite.is_on() { now.after(satellite.config.period()) } else { Instant::NEVER };
    port.heartbeat.postpone(next);
    let sent = port.outbox.send(&message);
    satellite.counters.reports = satellite.counters.reports.wrapping_add(u32::from(sent));
    sent
}

/// How soon to look again whether the vehicle is well.
const RETRY: Duration = Duration::from_millis(100);

/// A frame is about to leave on a high-latency link.
pub(crate) fn count(port: &Port, vehicle: &mut impl Vehicle) {
    if is_satellite(port)
        && let Some(satellite) = vehicle.high_latency()
    {
        let len = u32::try_from(port.outbox.pending().len()).unwrap_or(0);
        let counters = &mut satellite.counters;
        counters.messages = counters.messages.wrapping_add(1);
        counters.bytes = counters.bytes.wrapping_add(len);
        counters.credits = counters.credits.wrapping_add(len.div_ceil(CREDIT));
    }
}
