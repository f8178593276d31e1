//! Manual control: the sticks of a pilot on the ground, and the radio control channels that a receiver or a peer sends.
//!
//! Implements <https://mavlink.io/en/services/manual_control.html>: MANUAL_CONTROL, its alternative
//! RC_CHANNELS_OVERRIDE (rules J-1 to J-5), and RADIO_RC_CHANNELS of a receiver for radio control (J-10 to J-13). None
//! of them is answered. The vehicle decides the effect of a stick: it reads the input in every pass of its loop, and
//! gets `None` when no sender is steering.
//!
//! [`ManualInput`] shows which sender steers, and for how long.
//!
//! Left out: MANUAL_INPUT_STATUS, which is still under development. [`ManualInput::holder`], [`Vehicle::stick_holder`]
//! and a text report the steering sender.
//!
//! [`Vehicle::stick_holder`]: crate::Vehicle::stick_holder

mod channels;
mod receiver;

use channels::{ChannelValue, OVERRIDES, of_override, of_radio};
use receiver::{RadioHeader, Receiver, ReceiverFrame};

use super::holder::{ControlSource, Holder};
use super::{Cx, Handled, Received, Service, ShowCounters, StackEvent, SticksGate, increment};
use crate::dialect::{ManualControl, MavSeverity, RadioRcChannels, RcChannelsOverride};
use crate::frame::Frame;
use crate::link::Port;
use crate::message::{Message, Text};
use crate::network::Peers;
use crate::time::{Duration, Instant};
use crate::types::{CHANNELS, ControlInput, Firmware, MAX_TEXT_LEN, ManualControlInput, Peer, RcOverride, Vehicle};

/// The maximum number of receivers.
const RECEIVERS: usize = 2;

counters! {
    /// Counters of the messages of manual control. They wrap. Messages for other systems are counted in
    /// [`LinkCounters::not_ours`](crate::network::LinkCounters::not_ours), those on a high-latency link in
    /// [`out_of_place`](crate::network::LinkCounters::out_of_place).
    ManualCounters {
        /// Accepted messages of all kinds.
        count taken,
        /// Dropped because they were addressed to every vehicle (J-1).
        drop broadcast,
        /// Dropped because the sender may not steer (J-2). Only a receiver may send RADIO_RC_CHANNELS.
        drop not_allowed,
        /// Dropped because another sender was steering, or because a receiver sends RADIO_RC_CHANNELS besides (J-12).
        drop not_holder,
        /// Axes in accepted messages that were neither within ±1000 nor "not given" (J-1), and channels of
        /// RADIO_RC_CHANNELS that were not within ±4096 (J-12).
        drop bad_axes,
    }
}

/// Manual control: declared by `manual_control` in [`#[stack]`](macro@crate::Stack), and read through
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
/// One sender, which is an address on a link, steers at a time: the *holder*. It holds the sticks until no message was
/// received from it for the timeout. Messages of other senders are counted and ignored meanwhile. If the last message
/// always won, the vehicle would jitter between two sticks, and an idle second joystick could take control from a
/// pilot.
///
/// There are two kinds of authorised senders:
///
/// | rank | sender | set by |
/// |---|---|---|
/// | first | the pilot's receiver for radio control, such as ExpressLRS or mLRS in MAVLink mode (J-10) | [`set_receivers`](Self::set_receivers) |
/// | second | a ground station's joystick, or a companion computer (J-2) | [`set_source`](Self::set_source) |
///
/// Among senders of the second rank, the first one holds the sticks until it stops. A receiver takes them from a sender
/// of lower rank once it has sent for 500 ms without a gap of that length (J-11). Nothing takes them from a receiver
/// while it is alive, [operator control](crate::operator_control) included. Its own frames show that it is alive: it
/// sends no heartbeats. RADIO_RC_CHANNELS says when the receiver has lost its transmitter. Then the sticks are free at
/// once (J-12).
///
/// A change of the holder is reported by [`Vehicle::stick_holder`] and in a text (J-13).
///
/// [`Vehicle::control_input`] gets each accepted message at once. A vehicle that enters a mode only with current input
/// decides by it, because a request for the mode may follow in the same read (C-17).
///
/// Manual control does not show that a ground station is alive: only heartbeats do (H-10). To count it too, check
/// [`ManualInput::holder`] besides [`Stack::has_controller`](crate::Stack::has_controller).
///
/// Input that is older than the timeout is never returned, neither a stick nor a channel; each channel has its own
/// timeout (J-3). Input from a high-latency link is not accepted (J-5).
///
/// ```
/// use mavstack::manual_control::ControlSource;
/// # use mavstack::prelude::*;
/// # use mavstack::dialect;
/// # struct Rover;
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { dialect::MavResult::UNSUPPORTED.into() }
/// # }
/// #[derive(mavstack::Stack)]
/// #[stack(vehicle: Rover, links: 2, manual_control)]
/// struct Mavlink;
///
/// /// Called once, before the loop: until then no one may steer.
/// fn configure(stack: &mut StackOf<Mavlink>) {
///     let input = stack.manual_input_mut();
///     // ExpressLRS in MAVLink mode, on the second UART. While it is silent, any ground station may steer.
///     input.set_receivers(&[Peer { address: Address::new(255, 68), link: LinkId(1) }]);
///     input.set_source(ControlSource::GroundStation);
/// }
///
/// /// Called in every pass of the flight loop.
/// fn steering(stack: &StackOf<Mavlink>, now: Instant) -> Option<i16> {
///     let input = stack.manual_input();
///     if let Some(sticks) = input.manual_control(now) {
///         return sticks.y;
///     }
///     // `None`: nobody steers, or no longer. Start the failsafe.
///     let pulse = input.rc_channels(now)?.channel(1)?;
///     Some(pulse.clamp(1_000, 2_000).cast_signed() * 2 - 3_000)
/// }
/// ```
#[derive(Clone, Debug)]
pub struct ManualInput {
    /// The first has the highest rank.
    receivers: [Receiver; RECEIVERS],
    holder: Holder,
    /// The holder that was reported last.
    reported: Option<Peer>,
    /// The sticks, and until when they are valid.
    sticks: ManualControlInput,
    sticks_until: Instant,
    /// The channels as received (µs); 0 for those that are not overridden.
    channels: [u16; CHANNELS],
    /// Until when each channel is valid.
    channels_until: [Instant; CHANNELS],
    counters: ManualCounters,
    /// How far the stack's clock is ahead of the firmware's (X-7). All instants here are the firmware's.
    lead: Duration,
}

impl ManualInput {
    /// The default timeout. At ten messages a second, the lowest rate that clients use, it passes after five lost
    /// messages.
    pub const TIMEOUT: Duration = Duration::from_millis(500);

    /// Sets the senders that may steer besides the receivers. A change ends the turn of the steering sender, unless it
    /// is a receiver; it may begin again with its next message if it is still authorised. Until the first call only
    /// receivers may steer.
    pub fn set_source(&mut self, source: ControlSource) {
        if self.holder.source != source {
            self.holder.source = source;
            if !self.is_held_by_receiver() {
                self.release();
            }
        }
    }

    /// Sets the receivers for radio control, the one with the highest rank first: at most two; more are ignored. Each
    /// is an address on a link (J-10). It needs no heartbeats, and is not a ground station. A change ends the turn of
    /// the steering sender. Until the first call there is no receiver.
    ///
    /// | receiver | address |
    /// |---|---|
    /// | ExpressLRS | 255/68; the system id is a setting of the receiver |
    /// | mLRS that sends RC_CHANNELS_OVERRIDE | 255/68 |
    /// | mLRS that sends RADIO_RC_CHANNELS | 51/68; the system id is a setting, 51 to 55 |
    ///
    /// A receiver's MANUAL_CONTROL, RC_CHANNELS_OVERRIDE and RADIO_RC_CHANNELS are accepted. The last two may be
    /// addressed to all: mLRS does so unless the autopilot is ArduPilot. Channels of RC_CHANNELS_OVERRIDE are ignored
    /// while the same receiver also sends RADIO_RC_CHANNELS (J-12).
    ///
    /// ```
    /// # use mavstack::manual_control::ManualInput;
    /// use mavstack::{Address, LinkId, Peer};
    ///
    /// /// mLRS on the second link, whichever of its messages it is set to.
    /// const MLRS: [Peer; 2] = [
    ///     Peer { address: Address::new(51, 68), link: LinkId(1) },
    ///     Peer { address: Address::new(255, 68), link: LinkId(1) },
    /// ];
    ///
    /// fn configure(input: &mut ManualInput) {
    ///     input.set_receivers(&MLRS);
    /// }
    /// ```
    pub fn set_receivers(&mut self, receivers: &[Peer]) {
        let mut new = [Receiver::VACANT; RECEIVERS];
        for (receiver, &peer) in new.iter_mut().zip(receivers) {
            receiver.peer = peer;
        }
        if new.iter().zip(&self.receivers).any(|(new, old)| new.peer != old.peer) {
            self.receivers = new;
            self.release();
        }
    }

    /// Returns whether a sender is one of the receivers.
    pub fn is_receiver(&self, peer: Peer) -> bool {
        self.rank(peer) < RECEIVERS
    }

    /// Returns the rank of a sender: 0 is the highest. It is the position of a receiver; all other senders have the
    /// lowest.
    fn rank(&self, peer: Peer) -> usize {
        let mut receivers = self.receivers.iter();
        let rank = receivers.position(|receiver| receiver.peer == peer && !peer.address.system.is_all());
        rank.unwrap_or(RECEIVERS)
    }

    /// Sets how long input is valid, [`TIMEOUT`](Self::TIMEOUT) by default. It applies to later messages: input that
    /// has expired does not become valid again.
    pub fn set_timeout(&mut self, timeout: Duration) {
        self.holder.timeout = timeout;
    }

    /// Returns the sticks now; `None` without current input: initially, and once the last MANUAL_CONTROL is as old as
    /// the timeout (J-3).
    pub fn manual_control(&self, now: Instant) -> Option<ManualControlInput> {
        (now < self.sticks_until).then_some(self.sticks)
    }

    /// Returns the channels that are overridden now; `None` if none is. A message may leave channels unchanged, so each
    /// is valid for the timeout since it was last given (J-3, J-4).
    pub fn rc_channels(&self, now: Instant) -> Option<RcOverride> {
        let mut channels = self.channels;
        for (channel, &until) in channels.iter_mut().zip(&self.channels_until) {
            if now >= until {
                *channel = 0;
            }
        }
        channels.iter().any(|&raw| raw != 0).then_some(RcOverride { channels })
    }

    /// Returns the senders that may steer besides the receivers, as last set.
    pub const fn source(&self) -> ControlSource {
        self.holder.source
    }

    /// Returns the steering sender: its address, and the link by which it steers (J-13). Nobody of the same or a lower
    /// rank can steer until it was silent for the timeout. [`is_receiver`](Self::is_receiver) says whether it is the
    /// pilot's receiver.
    pub fn holder(&self, now: Instant) -> Option<Peer> {
        self.holder.sender(now)
    }

    /// Returns the counters.
    pub const fn counters(&self) -> ManualCounters {
        self.counters
    }

    /// Ends the turn of the steering sender.
    fn release(&mut self) {
        self.holder.release();
        self.sticks_until = Instant::ZERO;
        self.channels = [0; CHANNELS];
    }

    /// Whether a receiver steers, or was the last one to do so.
    fn is_held_by_receiver(&self) -> bool {
        self.holder.last_sender().is_some_and(|sender| self.is_receiver(sender))
    }

    /// Handles one of the messages. Returns whether it is input that is accepted.
    fn receive(&mut self, now: Instant, received: &Received<'_>, peers: &Peers) -> bool {
        let Received { frame, from, target, .. } = *received;
        let holder = self.holder.sender(now);
        let rank = self.rank(from);
        // mLRS addresses its channels to all.
        if target.system.is_all() && (rank == RECEIVERS || frame.id() == ManualControl::ID) {
            increment(&mut self.counters.broadcast);
            return false;
        }
        let radio = RadioHeader::of(frame);
        let receiver = self.receivers.get_mut(rank);
        match receiver.map(|receiver| receiver.on_frame(now, self.holder.timeout, frame.id(), radio)) {
            None if radio.is_some() || !self.holder.source.allows(from, peers) => {
                increment(&mut self.counters.not_allowed);
                return false;
            }
            Some(ReceiverFrame::Outdated) => {
                increment(&mut self.counters.taken);
                return false;
            }
            Some(ReceiverFrame::Failsafe) => {
                increment(&mut self.counters.taken);
                if holder == Some(from) {
                    self.release();
                }
                return false;
            }
            Some(ReceiverFrame::Redundant) => {
                increment(&mut self.counters.not_holder);
                return false;
            }
            None | Some(ReceiverFrame::Input) => {}
        }
        if let Some(holder) = holder
            && holder != from
        {
            let has_returned = self.receivers.get(rank).is_some_and(|receiver| receiver.has_returned(now));
            if rank >= self.rank(holder) || !has_returned {
                increment(&mut self.counters.not_holder);
                return false;
            }
        }
        if holder != Some(from) {
            self.release();
        }
        self.holder.hold(now, from);
        self.take(now, from, frame, radio);
        increment(&mut self.counters.taken);
        true
    }

    /// Takes the sticks or the channels of an accepted message.
    fn take(&mut self, now: Instant, from: Peer, frame: &Frame<'_>, radio: Option<RadioHeader>) {
        let valid_until = self.holder.until();
        if let Some(message) = frame.decode::<ManualControl>() {
            self.sticks = sticks(now, from, &message, &mut self.counters.bad_axes);
            self.sticks_until = valid_until;
            return;
        }
        let count = radio.map_or(OVERRIDES, |radio| radio.count);
        for (index, (channel, until)) in (0..count).zip(self.channels.iter_mut().zip(&mut self.channels_until)) {
            match if radio.is_some() { of_radio(frame, index) } else { of_override(frame, index) } {
                ChannelValue::Pulse(pulse) => {
                    *channel = pulse;
                    *until = valid_until;
                }
                ChannelValue::Released => *channel = 0,
                ChannelValue::NotGiven => {}
                ChannelValue::Invalid => increment(&mut self.counters.bad_axes),
            }
        }
    }
}

/// Reports that another sender steers, or nobody (J-13).
fn report<F: Firmware<Vehicle: Vehicle>>(cx: &mut Cx<'_, F>, holder: Option<Peer>) {
    let (vehicle, mut context) = cx.hook();
    vehicle.stick_holder(&mut context, holder);
    if !F::HAS_TEXTS {
        return;
    }
    let Some(Peer { address, link }) = holder else { return cx.text(MavSeverity::WARNING, b"Sticks lost") };
    let mut text = Text::<MAX_TEXT_LEN>::EMPTY;
    text.push_str("Sticks: system ");
    text.push_number(address.system.wire().into());
    text.push_str(" component ");
    text.push_number(address.component.wire().into());
    text.push_str(", link ");
    text.push_number(link.0.into());
    cx.text(MavSeverity::NOTICE, text.as_bytes());
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

impl<F: Firmware<Vehicle: Vehicle>> Service<F> for ManualInput {
    const NEW: Self = Self {
        receivers: [Receiver::VACANT; RECEIVERS],
        holder: Holder::NEW,
        reported: None,
        sticks: ManualControlInput::VACANT,
        sticks_until: Instant::ZERO,
        channels: [0; CHANNELS],
        channels_until: [Instant::ZERO; CHANNELS],
        counters: ManualCounters::ZERO,
        lead: Duration::ZERO,
    };
    type Link = ();
    const VACANT: () = ();
    type Reply = ();

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.counters);
    }

    /// Reports a change of the holder.
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut ()>) {
        let holder = self.holder(cx.shared.clock.shown(cx.now));
        if holder.is_none() {
            self.holder.release();
        }
        if holder != self.reported {
            self.reported = holder;
            report(cx, holder);
        }
    }

    fn deadline(&self) -> Instant {
        let sender = self.holder.last_sender();
        if sender != self.reported {
            Instant::ZERO
        } else if sender.is_some() {
            self.holder.until() + self.lead
        } else {
            Instant::NEVER
        }
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, (): &mut (), received: &Received<'_>) -> Handled {
        let frame = received.frame;
        if !matches!(frame.id(), ManualControl::ID | RcChannelsOverride::ID | RadioRcChannels::ID) {
            return Handled::No;
        }
        let now = cx.shared.clock.shown(cx.now);
        if self.receive(now, received, cx.peers) {
            let input = match frame.id() {
                ManualControl::ID => self.manual_control(now).map(ControlInput::Sticks),
                _ => self.rc_channels(now).map(ControlInput::Channels),
            };
            if let Some(input) = input {
                let (vehicle, mut context) = cx.hook();
                vehicle.control_input(&mut context, &input);
            }
        }
        Handled::Yes
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        match event {
            StackEvent::Begun(_) => self.holder.timeout = Self::TIMEOUT,
            // A receiver's rank is above operator control (J-11).
            StackEvent::NewOwner { own, owner } => {
                let is_allowed = |sender: Peer| [own, owner].contains(&sender.address.system);
                if !self.holder.last_sender().is_none_or(is_allowed) && !self.is_held_by_receiver() {
                    self.release();
                }
            }
            StackEvent::ClockSetBack(lead) => {
                self.lead = lead;
                self.release();
                self.receivers.iter_mut().for_each(Receiver::forget);
            }
            _ => {}
        }
    }
}

impl SticksGate for ManualInput {
    fn is_receiver(&self, from: Peer) -> bool {
        self.is_receiver(from)
    }
}
