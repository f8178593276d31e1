//! The vehicle's hooks for its state, its peers and its messages.

use super::context::Context;
use super::control::ControlInput;
use super::link::{LinkId, Peer};
use crate::dialect::{Common, MavModeFlag, MavState};
use crate::frame::Frame;
use crate::message::{Dialect, MessageTable};

/// The vehicle's state, as HEARTBEAT reports it (H-4).
///
/// ```
/// use mavstack::VehicleState;
/// use mavstack::dialect::{MavModeFlag, MavState};
///
/// let is_armed = true;
/// let state = VehicleState::new(is_armed).with_mode(4);
/// assert_eq!((state.base_mode, state.system_status), (MavModeFlag::SAFETY_ARMED, MavState::ACTIVE));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct VehicleState {
    /// The mode flags. [`MavModeFlag::SAFETY_ARMED`] must be set exactly while the vehicle is armed. The stack adds
    /// [`MavModeFlag::CUSTOM_MODE_ENABLED`] if it declares `modes`, or if [`custom_mode`](Self::custom_mode) is not 0. A
    /// vehicle without `modes` whose mode 0 has a meaning sets it itself. Ground stations that know the flag ignore
    /// most others.
    pub base_mode: MavModeFlag,
    /// The firmware's number of the mode; 0 if it has no modes.
    pub custom_mode: u32,
    /// [`MavState::BOOT`], then [`MavState::STANDBY`], then [`MavState::ACTIVE`], or a state of failure.
    pub system_status: MavState,
}

impl VehicleState {
    /// Returns the state of a vehicle in mode 0: [`ACTIVE`](MavState::ACTIVE) if it is armed, and
    /// [`STANDBY`](MavState::STANDBY) if not.
    pub const fn new(is_armed: bool) -> Self {
        let (base_mode, system_status) = match is_armed {
            true => (MavModeFlag::SAFETY_ARMED, MavState::ACTIVE),
            false => (MavModeFlag::EMPTY, MavState::STANDBY),
        };
        Self { base_mode, custom_mode: 0, system_status }
    }

    /// Returns the same state in another mode.
    #[must_use]
    pub const fn with_mode(self, custom_mode: u32) -> Self {
        Self { custom_mode, ..self }
    }

    /// Returns the same state with another status, such as [`CRITICAL`](MavState::CRITICAL).
    #[must_use]
    pub const fn with_status(self, system_status: MavState) -> Self {
        Self { system_status, ..self }
    }

    /// Returns the same state with these mode flags added.
    #[must_use]
    pub const fn with_flags(self, flags: MavModeFlag) -> Self {
        Self { base_mode: self.base_mode.with(flags), ..self }
    }

    /// Returns whether the vehicle is armed.
    pub const fn is_armed(&self) -> bool {
        self.base_mode.contains(MavModeFlag::SAFETY_ARMED)
    }

    /// Returns HEARTBEAT.base_mode (H-4).
    pub(crate) const fn flags(&self, has_modes: bool) -> MavModeFlag {
        match has_modes || self.custom_mode != 0 {
            true => self.base_mode.with(MavModeFlag::CUSTOM_MODE_ENABLED),
            false => self.base_mode,
        }
    }

    /// No state reported yet; all bits are zero.
    pub(crate) const ZERO: Self =
        Self { base_mode: MavModeFlag::EMPTY, custom_mode: 0, system_status: MavState::UNINIT };
}

/// A change of a peer's state (H-11, H-14). [`PeerInfo`](crate::network::PeerInfo) shows the states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum PeerEvent {
    /// The first heartbeat of a peer.
    Found(Peer),
    /// A peer has timed out: no heartbeat for [`peer_timeout`](crate::Config::peer_timeout).
    Lost(Peer),
    /// A peer has reconnected: its first heartbeat after [`Lost`](Self::Lost).
    Regained(Peer),
    /// Another component on this link sends with our address. Reported once for each link.
    AddressConflict(LinkId),
}

/// The hooks that every vehicle implements.
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `Vehicle`",
    note = "a vehicle of `#[stack]` needs `impl Vehicle for {Self}`: its state, for the heartbeats"
)]
pub trait Vehicle {
    /// The messages whose frames can be checked: all of common by default. A vehicle with messages of its own names a
    /// table that has these too. Otherwise they are [unknown](crate::network::LinkCounters::unknown) and never reach
    /// [`message`](Self::message). Such a table comes from [`dialect!`](crate::dialect!), or from XML by
    /// `mavstack-dialect`. A smaller table saves flash.
    ///
    /// ```
    /// use mavstack::dialect::Common;
    /// use mavstack::message::{Dialect, MessageTable};
    /// use mavstack::{Context, Frame, LinkId, Vehicle, VehicleState};
    ///
    /// mavstack::message! {
    ///     /// Controls our winch.
    ///     pub struct WinchControl: WINCH_CONTROL = 53_000 {
    ///         /// (m/s) Negative: in.
    ///         speed: f32,
    ///         target_system: u8,
    ///         target_component: u8,
    ///     }
    /// }
    /// mavstack::dialect! {
    ///     /// All of common, and the winch's message.
    ///     struct Known: [WinchControl] + Common;
    /// }
    ///
    /// struct Rover { winch_speed: f32 }
    ///
    /// impl Vehicle for Rover {
    ///     const MESSAGES: MessageTable = Known::MESSAGES;
    ///
    ///     fn message(&mut self, _: &mut Context<'_>, frame: &Frame<'_>, _: LinkId) -> bool {
    ///         let Some(WinchControl { speed, .. }) = frame.decode() else { return false };
    ///         self.winch_speed = speed;
    ///         true
    ///     }
    /// #   fn state(&self) -> Option<VehicleState> { None }
    /// }
    /// ```
    const MESSAGES: MessageTable = Common::MESSAGES;

    /// Whether the vehicle has a model of the terrain: false by default. Without one, nothing that has an altitude
    /// above the terrain (frames 10 and 11) is accepted, whatever the rules of its commands admit, because the vehicle
    /// could only ignore the terrain (M-49):
    ///
    /// - Items of all plans are refused with `UNSUPPORTED_FRAME`.
    /// - Declared commands, and regions of interest for a [`GimbalManager`](crate::GimbalManager), get
    ///   `COMMAND_UNSUPPORTED_MAV_FRAME`.
    ///
    /// The vehicle itself checks the frame of a command that it does not declare
    /// ([`Location::frame`](crate::message::Location::frame)), and of a setpoint
    /// ([`PositionSetpoint::frame`](crate::setpoints::PositionSetpoint::frame)).
    const HAS_TERRAIN_MODEL: bool = false;

    /// Returns the vehicle's state for the next heartbeat; `None` while the vehicle is in a fault, which stops the
    /// heartbeats (H-5).
    ///
    /// The stack calls this in every [`poll`](crate::Stack::poll), so keep it cheap. A change is reported at once by an
    /// extra heartbeat on each normal link; each link sends at most one of those every 200 ms (H-16).
    fn state(&self) -> Option<VehicleState>;

    /// Called when a peer was found, has timed out, or has reconnected, on each link by itself. A ground station with two
    /// links is reported as lost when one of them fails. A failsafe that monitors the ground station asks
    /// [`Stack::has_ground_station`](crate::Stack::has_ground_station) or
    /// [`Stack::has_controller`](crate::Stack::has_controller) instead.
    fn peer(&mut self, cx: &mut Context<'_>, event: PeerEvent) {
        let _ = (cx, event);
    }

    /// Called when another sender steers, or nobody does any longer: `holder` is its address, and the link by which it steers
    /// (J-13). Only a stack with `manual_control` calls it, in [`poll`](crate::Stack::poll). A text says the same to the
    /// operators. [`ManualInput::holder`](crate::manual_control::ManualInput::holder) returns it at any time.
    fn stick_holder(&mut self, cx: &mut Context<'_>, holder: Option<Peer>) {
        let _ = (cx, holder);
    }

    /// Handles a frame with a correct checksum, addressed to us or to all, whose message the stack does not handle
    /// itself. Returns whether the vehicle handles that message. By default it returns false: a frame addressed to our
    /// system is then counted as [`unhandled`](crate::network::LinkCounters::unhandled).
    ///
    /// With the feature `signing`, only frames that their link accepts (`LinkSigning`) are passed on. Without it,
    /// signatures are not verified. Frames from a high-latency link are never passed on (L-4), nor is SETUP_SIGNING,
    /// which contains a key (G-11).
    ///
    /// A vehicle without [`Setpoints`](crate::setpoints::Setpoints) gets these here too (SET_POSITION_TARGET_LOCAL_NED,
    /// SET_POSITION_TARGET_GLOBAL_INT, SET_ATTITUDE_TARGET), and one without `manual_control` gets sticks and channels. The stack
    /// then checks neither their sender nor their age.
    fn message(&mut self, cx: &mut Context<'_>, frame: &Frame<'_>, link: LinkId) -> bool {
        let _ = (cx, frame, link);
        false
    }

    /// Called when sticks, channels or a setpoint were accepted, before the frames behind them are handled. The sender is the
    /// authorised one, and the values are valid.
    ///
    /// Use it in a vehicle that refuses a mode without current input: a client may send its first setpoint and the
    /// request for the mode in one write, and the flight loop has no pass between the two (C-17). The flight loop
    /// learns of expired input from [`Setpoints::current`](crate::setpoints::Setpoints::current) and
    /// [`ManualInput`](crate::manual_control::ManualInput), which it reads in every pass.
    fn control_input(&mut self, cx: &mut Context<'_>, input: &ControlInput) {
        let _ = (cx, input);
    }

    /// Returns whether the storage of plans, parameters and signing key may be written now. It is called before every
    /// erase and every write (SEC-12). On a microcontroller's own flash these stop the processor for milliseconds to
    /// seconds. While this is false, a durable upload is refused at its beginning (M-44), and parameters and the
    /// signing time stay pending.
    ///
    /// By default it is true while [`state`](Self::state) says that the vehicle is disarmed. In a fault, when `state` is
    /// `None`, it is false, because the vehicle may be flying. A vehicle whose storage does not stop the processor, FRAM for
    /// example, can always return true.
    fn may_persist(&self) -> bool {
        self.state().is_some_and(|state| !state.is_armed())
    }
}
