//! Manual control: the sticks of a pilot on the ground, and the radio control channels that he takes over.
//!
//! Implements <https://mavlink.io/en/services/manual_control.html>, MANUAL_CONTROL and its alternative
//! RC_CHANNELS_OVERRIDE, rules J-1 to J-5. Neither is answered. What a stick does is the vehicle's: it asks for them in
//! every pass of its loop, and gets `None` when nobody steers.
//!
//! Who steers, and for how long, is drawn at [`ManualInput`].

use crate::dialect::{ManualControl, MavType, RcChannels, RcChannelsOverride};
use crate::frame::{Frame, SystemId};
use crate::link::Peer;
use crate::message::Message;
use crate::network::Peers;
use crate::time::{Duration, Instant};
use crate::vehicle::Vehicle;

/// The radio control channels that the messages know.
const CHANNELS: usize = 18;
/// The first channels, which the message had from the beginning: here a 0 releases, in the others it is what was cut off.
const FIRST_CHANNELS: usize = 8;
/// Gives a channel back.
const RELEASE: u16 = u16::MAX - 1;

/// Who may steer the vehicle by hand (J-2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ControlSource {
    /// Nobody.
    Nobody,
    /// Every component of one system: the ground station that is in control.
    System(SystemId),
    /// Every system from `first` to `last`, both included.
    Systems {
        /// The lowest id.
        first: SystemId,
        /// The highest id.
        last: SystemId,
    },
    /// Every system from which a ground station's heartbeats come on the same link: with type
    /// [`GCS`](MavType::GCS), and not [lost](crate::PeerEvent::Lost). One for whom the peer table has no room is not known.
    GroundStation,
}

impl ControlSource {
    fn allows(self, from: Peer, peers: &Peers) -> bool {
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
}

/// The positions of a pilot's sticks: a MANUAL_CONTROL. Axes are −1000 to 1000; `None` for one that the sender does not
/// have, or that was out of this range (J-1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ManualControlInput {
    /// Who steers.
    pub from: Peer,
    /// When it came.
    pub at: Instant,
    /// Forward; the pitch of a vehicle, nose down.
    pub x: Option<i16>,
    /// Right; the roll of a vehicle.
    pub y: Option<i16>,
    /// Up; the thrust of a vehicle. For one without reverse thrust many senders use 0 to 1000 only, 500 being the middle:
    /// which it is, is agreed with the ground station (QGroundControl has a setting, MAVSDK always sends 0 to 1000).
    pub z: Option<i16>,
    /// The yaw of a vehicle. By the definitions counter-clockwise; ground stations in use send clockwise as positive.
    pub r: Option<i16>,
    /// Pitch alone, of a vehicle that `x` moves forward.
    pub s: Option<i16>,
    /// Roll alone, of a vehicle that `y` moves right.
    pub t: Option<i16>,
    /// `aux1` to `aux6`: what the vehicle makes of them.
    pub aux: [Option<i16>; 6],
    /// The buttons that are pressed, the first in the lowest bit: `buttons`, and `buttons2` above them, which is 0 from
    /// who does not have it.
    pub buttons: u32,
}

/// Radio control channels in the place of received ones: the RC_CHANNELS_OVERRIDEs of the last while together (J-4).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RcOverride {
    /// (µs); 0 for a channel that is not overridden.
    channels: [u16; CHANNELS],
}

impl RcOverride {
    /// The pulse of channel `number`, 1 to 18, in µs: any number from 1 to 65533, 1000 to 2000 from a sender in his
    /// senses. `None` when the channel is not overridden: what the receiver says counts.
    pub fn channel(&self, number: u8) -> Option<u16> {
        let index = usize::from(number).checked_sub(1)?;
        self.channels.get(index).copied().filter(|&raw| raw != 0)
    }

    /// RC_CHANNELS as the vehicle takes them: each channel's override, or else what the receiver says of it in `received`
    /// (µs; none, for a vehicle without one). The signal strength is left unknown.
    ///
    /// ```
    /// use mavstack::{Instant, RcOverride};
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
            time_boot_ms: millis(now),
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

/// What became of the messages of manual control. Numbers wrap. One that is for another system is in
/// [`LinkCounters::not_ours`](crate::LinkCounters::not_ours), one on a high-latency link in
/// [`out_of_place`](crate::LinkCounters::out_of_place).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct ManualCounters {
    /// Messages that were obeyed, of both kinds.
    pub taken: u32,
    /// To every vehicle in reach: no stick is for all of them (J-1).
    pub broadcast: u32,
    /// Of senders that may not steer (J-2).
    pub not_allowed: u32,
    /// Of senders that may, while another one did.
    pub not_holder: u32,
    /// Axes in messages that were obeyed which were neither within ±1000 nor "not given" (J-1).
    pub bad_axes: u32,
}

/// The vehicle's memory for manual control, some 300 bytes. The vehicle keeps it and hands it to the stack by
/// [`Vehicle::manual_input`](crate::Vehicle::manual_input); one that does not pays nothing.
///
/// ```text
///                  to all? ──▶ may he? ──▶ does another one steer? ──▶ ManualInput ──▶ manual_control(now)
///                     │           │                   │                     │          rc_channels(now)
///                     ▼           ▼                   ▼                     ▼
///                 broadcast  not_allowed         not_holder        None from the timeout on
/// ```
///
/// One sender, which is an address on a link, steers at a time: the first that may, until neither message came from him
/// for the timeout. Who sends meanwhile is counted and not obeyed. A vehicle that took whatever came last would tremble
/// between two sticks, and a second, idle joystick could take it out of a pilot's hands.
///
/// Sticks are no sign of life of their sender: only heartbeats are (H-10). A vehicle that wants them to be looks at
/// [`ManualInput::holder`] before it believes that he is [lost](crate::PeerEvent::Lost).
///
/// Nothing that is older than the timeout comes out of it, whatever else arrives: not a stick, and not a channel, each of
/// which ages by itself (J-3). Nothing comes in over a high-latency link (J-5).
///
/// ```
/// use mavstack::{ControlSource, Instant, ManualInput, Vehicle, VehicleState};
///
/// struct Rover { manual: ManualInput, steering: i16 }
///
/// impl Vehicle for Rover {
///     fn state(&self) -> Option<VehicleState> {
///         None
///     }
///
///     fn manual_input(&mut self) -> Option<&mut ManualInput> {
///         Some(&mut self.manual)
///     }
/// }
///
/// let manual = ManualInput::new(ControlSource::GroundStation, ManualInput::TIMEOUT);
/// let mut rover = Rover { manual, steering: 0 };
/// // In every pass of the flight loop:
/// let now = Instant::from_millis(40);
/// rover.steering = match rover.manual.manual_control(now) {
///     Some(sticks) => sticks.y.unwrap_or(0),
///     // Nobody steers, or no longer: straight on, and on to the failsafe.
///     None => 0,
/// };
/// ```
#[derive(Clone, Debug)]
pub struct ManualInput {
    source: ControlSource,
    timeout: Duration,
    /// Who steers, and until when, if nothing more is heard of him.
    holder: Option<(Peer, Instant)>,
    /// And until when they are valid.
    sticks: Option<(ManualControlInput, Instant)>,
    /// As they were given (µs); 0 for those that were not.
    channels: [u16; CHANNELS],
    /// Until when they are valid.
    until: [Instant; CHANNELS],
    counters: ManualCounters,
}

impl ManualInput {
    /// A timeout for most: of ten sticks a second, the least that clients send, five are lost until it has passed.
    pub const TIMEOUT: Duration = Duration::from_millis(500);

    /// Nobody steers yet. `source` may; what he says is valid for `timeout`, and with a timeout of zero never.
    pub const fn new(source: ControlSource, timeout: Duration) -> Self {
        let counters = ManualCounters { taken: 0, broadcast: 0, not_allowed: 0, not_holder: 0, bad_axes: 0 };
        let (channels, until) = ([0; CHANNELS], [Instant::ZERO; CHANNELS]);
        Self { source, timeout, holder: None, sticks: None, channels, until, counters }
    }

    /// From now on `source` may steer. When this is a change, who steered does not any longer, until his next message if
    /// he still may.
    pub fn set_source(&mut self, source: ControlSource) {
        if self.source != source {
            self.source = source;
            self.forget();
        }
    }

    /// From now on what is said is valid for `timeout`. What was said before is for as long as it was: no stick that was
    /// stale comes back.
    pub fn set_timeout(&mut self, timeout: Duration) {
        self.timeout = timeout;
    }

    /// The sticks as they are now; `None` when nobody moves them: at first, and when the last MANUAL_CONTROL is as old as
    /// the timeout (J-3).
    pub fn manual_control(&self, now: Instant) -> Option<ManualControlInput> {
        self.sticks.filter(|&(_, until)| now < until).map(|(sticks, _)| sticks)
    }

    /// The channels that are overridden now; `None` when none is. A message leaves those alone that it ignores, so each is
    /// valid for the timeout from when it was given last (J-3, J-4).
    pub fn rc_channels(&self, now: Instant) -> Option<RcOverride> {
        let mut channels = self.channels;
        for (channel, &until) in channels.iter_mut().zip(&self.until) {
            if now >= until {
                *channel = 0;
            }
        }
        channels.iter().any(|&raw| raw != 0).then_some(RcOverride { channels })
    }

    /// Who steers: nobody else can until he was silent for the timeout.
    pub fn holder(&self, now: Instant) -> Option<Peer> {
        self.holder.filter(|&(_, until)| now < until).map(|(holder, _)| holder)
    }

    /// What became of the messages so far.
    pub const fn counters(&self) -> ManualCounters {
        self.counters
    }

    fn forget(&mut self) {
        self.holder = None;
        self.sticks = None;
        self.channels = [0; CHANNELS];
    }

    /// A MANUAL_CONTROL or RC_CHANNELS_OVERRIDE came in.
    fn on_frame(&mut self, now: Instant, from: Peer, frame: &Frame<'_>, is_broadcast: bool, peers: &Peers) {
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
            return count(&mut self.counters.taken);
        };
        count(counter);
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
                    // No pulse is 65 ms long, so the later channels' word for it is understood for all.
                    0 | RELEASE => *channel = 0,
                    _ => (*channel, *until) = (raw, valid_until),
                }
            }
        }
    }
}

/// What a MANUAL_CONTROL says (J-1). Extensions are only there with their bit, so that what a v1 sender has not, or a v2
/// sender cut off, is not given.
fn sticks(now: Instant, from: Peer, message: &ManualControl, bad_axes: &mut u32) -> ManualControlInput {
    let mut axis = |raw: i16| {
        let value = Some(raw).filter(|raw| (-1_000..=1_000).contains(raw));
        if value.is_none() && raw != i16::MAX {
            count(bad_axes);
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

/// The fields of an RC_CHANNELS_OVERRIDE, channel 1 first.
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

/// Milliseconds since boot as the wire has them: they wrap (D-1).
fn millis(now: Instant) -> u32 {
    let [a, b, c, d, ..] = now.as_millis().to_le_bytes();
    u32::from_le_bytes([a, b, c, d])
}

fn count(counter: &mut u32) {
    *counter = counter.wrapping_add(1);
}

/// Takes MANUAL_CONTROL and RC_CHANNELS_OVERRIDE, where the vehicle has a memory for them. False for other messages, and
/// where it has none.
pub(crate) fn on_frame(
    now: Instant,
    from: Peer,
    frame: &Frame<'_>,
    is_broadcast: bool,
    peers: &Peers,
    vehicle: &mut impl Vehicle,
) -> bool {
    if frame.id() != ManualControl::ID && frame.id() != RcChannelsOverride::ID {
        return false;
    }
    let Some(input) = vehicle.manual_input() else { return false };
    input.on_frame(now, from, frame, is_broadcast, peers);
    true
}
