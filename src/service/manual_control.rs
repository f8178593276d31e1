//! Manual control: the sticks of a pilot on the ground, and the radio control channels that a peer overrides.
//!
//! Implements <https://mavlink.io/en/services/manual_control.html>, MANUAL_CONTROL and its alternative
//! RC_CHANNELS_OVERRIDE, rules J-1 to J-5. Neither message is answered. The vehicle decides what a stick does: it reads
//! the input in every pass of its loop, and gets `None` when no one is steering.
//!
//! [`ManualInput`] shows which sender steers, and for how long.

use super::{Cx, Handled, Received, Service, increment};
use crate::dialect::{ManualControl, MavType, RcChannels, RcChannelsOverride};
use crate::frame::Frame;
use crate::link::Port;
use crate::message::{Message, SystemId};
use crate::network::{PeerInfo, Peers};
use crate::time::{Duration, Instant};
use crate::types::{CHANNELS, Config, ControlInput, Firmware, ManualControlInput, Peer, RcOverride, Vehicle};

/// The channels of the original message. Here a 0 releases the channel; in the others a 0 means that the field was cut
/// off.
const FIRST_CHANNELS: usize = 8;
/// The value that releases a channel.
const RELEASE: u16 = u16::MAX - 1;

/// Who may steer the vehicle, by hand (J-2) or by setpoints (J-6).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ControlSource {
    /// Nobody.
    Nobody,
    /// Every component of one system: the ground station in control.
    System(SystemId),
    /// Every system from `first` to `last`, both included.
    Systems {
        /// The lowest id.
        first: SystemId,
        /// The highest id.
        last: SystemId,
    },
    /// Every system that sends a ground station's heartbeats on the same link: type [`GCS`](MavType::GCS), and not
    /// [timed out](crate::PeerEvent::Lost). A sender without an entry in the peer table is not known.
    GroundStation,
}

impl ControlSource {
    /// Whether it allows this sender.
    pub(crate) fn allows(self, from: Peer, peers: &Peers) -> bool {
        let system = from.address.system;
        match self {
            Self::Nobody => false,
            Self::System(only) => system == only,
            Self::Systems { first, last } => first <= system && system <= last,
            Self::GroundStation => peers.iter().any(|info| {
                info.peer.address.system == system
                    && info.peer.link == from.link
                    && info.r#type == MavType::GCS
                    && info.is_alive
            }),
        }
    }

    /// Whether a ground station that may steer is alive, on any link.
    pub(crate) fn is_alive(self, peers: &[PeerInfo]) -> bool {
        let systems = match self {
            Self::Nobody => return false,
            Self::System(only) => only..=only,
            Self::Systems { first, last } => first..=last,
            Self::GroundStation => SystemId(0)..=SystemId(u8::MAX),
        };
        peers.iter().any(|info| info.is_living_station() && systems.contains(&info.peer.address.system))
    }
}

impl RcOverride {
    /// Returns the pulse of channel `number`, 1 to 18, in µs. Any number from 1 to 65533 is possible; a sane sender
    /// uses 1000 to 2000. `None` if the channel is not overridden: the receiver's value applies.
    pub fn channel(&self, number: u8) -> Option<u16> {
        let index = usize::from(number).checked_sub(1)?;
        self.channels.get(index).copied().filter(|&raw| raw != 0)
    }

    /// Returns RC_CHANNELS as the vehicle uses them: each channel's override, or else the receiver's value in
    /// `received` (µs; empty for a vehicle without a receiver). The signal strength is unknown.
    ///
    /// ```
    /// use mavstack::Instant;
    /// use mavstack::manual_control::RcOverride;
    ///
    /// let nothing = RcOverride::default();
    /// let message = nothing.to_message(Instant::from_millis(7), &[1500, 1100]);
    /// assert_eq!((message.time_boot_ms, message.chancount), (7, 2));
    /// assert_eq!((message.chan1_raw, message.chan2_raw, message.chan3_raw), (1500, 1100, u16::MAX));
    /// ```
    pub fn to_message(&self, now: Instant, received: &[u16]) -> RcChannels {
        let mut channels = [u16::MAX; CHANNELS];
        let mut chancount = 0;
        for ((number, channel), index) in (1..=u8::MAX).zip(&mut channels).zip(0..CHANNELS) {
            let Some(raw) = self.channel(number).or_else(|| received.get(index).copied()) else { continue };
            *channel = raw;
            chancount = number;
        }
        let [c1, c2, c3, c4, c5, c6, c7, c8, c9, c10, c11, c12, c13, c14, c15, c16, c17, c18] = channels;
        RcChannels {
            time_boot_ms: now.time_boot_ms(),
            chan1_raw: c1,
            chan2_raw: c2,
            chan3_raw: c3,
            chan4_raw: c4,
            chan5_raw: c5,
            chan6_raw: c6,
            chan7_raw: c7,
            chan8_raw: c8,
            chan9_raw: c9,
            chan10_raw: c10,
            chan11_raw: c11,
            chan12_raw: c12,
            chan13_raw: c13,
            chan14_raw: c14,
            chan15_raw: c15,
            chan16_raw: c16,
            chan17_raw: c17,
            chan18_raw: c18,
            chancount,
            rssi: u8::MAX,
        }
    }
}

counters! {
    /// Counters of the messages of manual control. They wrap. Messages for other systems are counted in
    /// [`LinkCounters::not_ours`](crate::network::LinkCounters::not_ours), those on a high-latency link in
    /// [`out_of_place`](crate::network::LinkCounters::out_of_place).
    ManualCounters {
        /// Accepted messages of both kinds.
        count taken,
        /// Dropped because they were addressed to every vehicle (J-1).
        drop broadcast,
        /// Dropped because the sender may not steer (J-2).
        drop not_allowed,
        /// Dropped because another sender was steering.
        drop not_holder,
        /// Axes in accepted messages that were neither within ±1000 nor "not given" (J-1).
        drop bad_axes,
    }
}

/// Manual control: declared by `manual_control` in [`stack!`](crate::stack), and read through
/// [`Stack::manual_input`](crate::Stack::manual_input). A vehicle without it gets both messages in
/// [`Vehicle::message`](crate::Vehicle::message).
///
/// ```text
///                  to all? ──▶ authorised? ──▶ does another one steer? ──▶ ManualInput ──▶ manual_control(now)
///                     │           │                       │                     │          rc_channels(now)
///                     ▼           ▼                       ▼                     ▼
///                 broadcast  not_allowed             not_holder        None from the timeout on
/// ```
///
/// One sender, which is an address on a link, steers at a time: the first authorised one, until neither message was
/// received from it for the timeout. Messages of other senders are counted and ignored meanwhile. If the last message
/// always won, the vehicle would jitter between two sticks, and an idle second joystick could take control from a
/// pilot.
///
/// [`Vehicle::control_input`](crate::Vehicle::control_input) gets each accepted message at once. A vehicle that enters a mode
/// only with current input decides by it, because a request for the mode may follow in the same read (C-17).
///
/// Manual control does not show that its sender is alive: only heartbeats do (H-10). To count it too, check
/// [`ManualInput::holder`] besides [`Stack::has_controller`](crate::Stack::has_controller).
///
/// Input that is older than the timeout is never returned, neither a stick nor a channel; each channel has its own
/// timeout (J-3). Input from a high-latency link is not accepted (J-5).
///
/// ```
/// use mavstack::manual_control::ControlSource;
/// # use mavstack::*;
/// # struct Rover;
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { dialect::MavResult::UNSUPPORTED.into() }
/// # }
/// mavstack::stack! {
///     struct Mavlink for Rover { links: 1, manual_control }
/// }
///
/// /// Called once, before the loop: until then no one may steer.
/// fn configure(stack: &mut Mavlink) {
///     stack.manual_input_mut().set_source(ControlSource::GroundStation);
/// }
///
/// /// Called in every pass of the flight loop.
/// fn steering(stack: &Mavlink, now: Instant) -> i16 {
///     match stack.manual_input().manual_control(now) {
///         Some(sticks) => sticks.y.unwrap_or(0),
///         // Nobody steers, or no longer: fly straight on, and start the failsafe.
///         None => 0,
///     }
/// }
/// ```
#[derive(Clone, Debug)]
pub struct ManualInput {
    source: ControlSource,
    timeout: Duration,
    /// The steering sender, and when its turn ends if it sends nothing more.
    holder: Option<(Peer, Instant)>,
    /// The sticks, and until when they are valid.
    sticks: Option<(ManualControlInput, Instant)>,
    /// The channels as received (µs); 0 for those that are not overridden.
    channels: [u16; CHANNELS],
    /// Until when each channel is valid.
    until: [Instant; CHANNELS],
    counters: ManualCounters,
}

impl ManualInput {
    /// The default timeout. At ten messages a second, the lowest rate that clients use, it passes after five lost
    /// messages.
    pub const TIMEOUT: Duration = Duration::from_millis(500);

    /// Returns the state in which no one is steering. `source` may; its input is valid for `timeout`, and with a timeout of
    /// zero never.
    const fn new(source: ControlSource, timeout: Duration) -> Self {
        let (channels, until) = ([0; CHANNELS], [Instant::ZERO; CHANNELS]);
        Self { source, timeout, holder: None, sticks: None, channels, until, counters: ManualCounters::ZERO }
    }

    /// Sets who may steer. A change ends the turn of the steering sender; it may begin again with its next message if
    /// it is still authorised. Until the first call no one may steer.
    pub fn set_source(&mut self, source: ControlSource) {
        if self.source != source {
            self.source = source;
            self.forget();
        }
    }

    /// Sets how long input is valid, [`TIMEOUT`](Self::TIMEOUT) by default. It applies to later messages: input that
    /// has expired does not become valid again.
    pub fn set_timeout(&mut self, timeout: Duration) {
        self.timeout = timeout;
    }

    /// Returns the sticks now; `None` without current input: initially, and once the last MANUAL_CONTROL is as old as
    /// the timeout (J-3).
    pub fn manual_control(&self, now: Instant) -> Option<ManualControlInput> {
        self.sticks.filter(|&(_, until)| now < until).map(|(sticks, _)| sticks)
    }

    /// Returns the channels that are overridden now; `None` if none is. A message may leave channels unchanged, so each
    /// is valid for the timeout since it was last given (J-3, J-4).
    pub fn rc_channels(&self, now: Instant) -> Option<RcOverride> {
        let mut channels = self.channels;
        for (channel, &until) in channels.iter_mut().zip(&self.until) {
            if now >= until {
                *channel = 0;
            }
        }
        channels.iter().any(|&raw| raw != 0).then_some(RcOverride { channels })
    }

    /// Returns who may steer, as last set.
    pub const fn source(&self) -> ControlSource {
        self.source
    }

    /// Returns the steering sender. Nobody else can steer until it was silent for the timeout.
    pub fn holder(&self, now: Instant) -> Option<Peer> {
        self.holder.filter(|&(_, until)| now < until).map(|(holder, _)| holder)
    }

    /// Returns the counters.
    pub const fn counters(&self) -> ManualCounters {
        self.counters
    }

    fn forget(&mut self) {
        self.holder = None;
        self.sticks = None;
        self.channels = [0; CHANNELS];
    }

    /// Handles a MANUAL_CONTROL or RC_CHANNELS_OVERRIDE. Returns whether it is accepted.
    #[inline(never)]
    fn receive(&mut self, now: Instant, from: Peer, frame: &Frame<'_>, is_broadcast: bool, peers: &Peers) -> bool {
        let holder = self.holder(now);
        let counters = &mut self.counters;
        let counter = if is_broadcast {
            &mut counters.broadcast
        } else if !self.source.allows(from, peers) {
            &mut counters.not_allowed
        } else if holder.is_some_and(|holder| holder != from) {
            &mut counters.not_holder
        } else {
            if holder.is_none() {
                self.forget();
            }
            self.holder = Some((from, now.after(self.timeout)));
            self.take(now, from, frame);
            increment(&mut self.counters.taken);
            return true;
        };
        increment(counter);
        false
    }

    /// Returns what an accepted message with this id has set.
    fn input(&self, now: Instant, id: u32) -> Option<ControlInput> {
        match id {
            ManualControl::ID => self.manual_control(now).map(ControlInput::Sticks),
            _ => self.rc_channels(now).map(ControlInput::Channels),
        }
    }

    fn take(&mut self, now: Instant, from: Peer, frame: &Frame<'_>) {
        let valid_until = now.after(self.timeout);
        if let Some(message) = frame.decode::<ManualControl>() {
            self.sticks = Some((sticks(now, from, &message, &mut self.counters.bad_axes), valid_until));
        } else if let Some(message) = frame.decode::<RcChannelsOverride>() {
            let held = self.channels.iter_mut().zip(&mut self.until);
            for (index, (raw, (channel, until))) in (0..CHANNELS).zip(raw_channels(&message).into_iter().zip(held)) {
                match raw {
                    u16::MAX => {}
                    0 if index >= FIRST_CHANNELS => {}
                    // The later channels' value for "release" works for all: no pulse is 65 ms long.
                    0 | RELEASE => *channel = 0,
                    _ => (*channel, *until) = (raw, valid_until),
                }
            }
        }
    }
}

/// Returns the sticks in a MANUAL_CONTROL (J-1). An extension is present only with its bit. A field that a v1 sender
/// does not have, or that a v2 sender cut off, is thus not given.
fn sticks(now: Instant, from: Peer, message: &ManualControl, bad_axes: &mut u32) -> ManualControlInput {
    let mut axis = |raw: i16| {
        let value = Some(raw).filter(|raw| (-1_000..=1_000).contains(raw));
        if value.is_none() && raw != i16::MAX {
            increment(bad_axes);
        }
        value
    };
    let [x, y, z, r] = [message.x, message.y, message.z, message.r].map(&mut axis);
    let mut bits = message.enabled_extensions;
    let ManualControl { s, t, aux1, aux2, aux3, aux4, aux5, aux6, .. } = *message;
    let [s, t, aux @ ..] = [s, t, aux1, aux2, aux3, aux4, aux5, aux6].map(|raw| {
        let is_there = bits & 1 != 0;
        bits >>= 1;
        if is_there { axis(raw) } else { None }
    });
    let buttons = u32::from(message.buttons) | (u32::from(message.buttons2) << 16);
    ManualControlInput { from, at: now, x, y, z, r, s, t, aux, buttons }
}

/// Returns the channels of an RC_CHANNELS_OVERRIDE, channel 1 first.
const fn raw_channels(message: &RcChannelsOverride) -> [u16; CHANNELS] {
    [
        message.chan1_raw,
        message.chan2_raw,
        message.chan3_raw,
        message.chan4_raw,
        message.chan5_raw,
        message.chan6_raw,
        message.chan7_raw,
        message.chan8_raw,
        message.chan9_raw,
        message.chan10_raw,
        message.chan11_raw,
        message.chan12_raw,
        message.chan13_raw,
        message.chan14_raw,
        message.chan15_raw,
        message.chan16_raw,
        message.chan17_raw,
        message.chan18_raw,
    ]
}

impl<F: Firmware<Vehicle: Vehicle>> Service<F> for ManualInput {
    /// `Some` of zeros is all zero bits, which `None` is not. These sticks have expired since [`Instant::ZERO`].
    const NEW: Self = Self {
        sticks: Some((ManualControlInput::VACANT, Instant::ZERO)),
        ..Self::new(ControlSource::Nobody, Duration::ZERO)
    };
    type Link = ();
    const VACANT: () = ();

    fn begin(&mut self, _: &Config) {
        self.timeout = Self::TIMEOUT;
    }

    #[cfg(feature = "defmt")]
    fn drops(&self) -> u32 {
        self.counters.drops()
    }

    #[cfg(feature = "defmt")]
    fn log_drops(&self) {
        event!("{}", self.counters);
    }

    fn on_owner(&mut self, own: SystemId, owner: SystemId) {
        if self.holder.is_some_and(|(holder, _)| ![own, owner].contains(&holder.address.system)) {
            self.forget();
        }
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, (): &mut (), received: &Received<'_>) -> Handled {
        let Received { frame, from, target, .. } = received;
        if frame.id() != ManualControl::ID && frame.id() != RcChannelsOverride::ID {
            return Handled::No;
        }
        if self.receive(cx.now, *from, frame, target.system.0 == 0, cx.peers)
            && let Some(input) = self.input(cx.now, frame.id())
        {
            let (vehicle, mut context) = cx.hook();
            vehicle.control_input(&mut context, &input);
        }
        Handled::Yes
    }
}
