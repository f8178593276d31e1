//! Setpoints: where to fly, how fast, or in which attitude, from a companion computer or a ground station.
//!
//! Implements <https://mavlink.io/en/services/offboard_control.html>: SET_POSITION_TARGET_LOCAL_NED,
//! SET_POSITION_TARGET_GLOBAL_INT and SET_ATTITUDE_TARGET, rules J-6 to J-8. None of them is answered. The vehicle
//! decides which setpoints it follows: it reads the setpoint in every pass of its loop, and gets `None` when there is
//! no current one.
//!
//! Left out: the echoes POSITION_TARGET_LOCAL_NED, POSITION_TARGET_GLOBAL_INT and ATTITUDE_TARGET, which the vehicle
//! sends as streams, because only it knows its targets; and setpoints for single actuators.
//!
//! [`Setpoints`] shows which sender is followed, and for how long.

use super::holder::{ControlSource, Holder};
use super::{Cx, Handled, Received, Service, ShowCounters, StackEvent, increment};
use crate::dialect::{
    AttitudeTargetTypemask, MavFrame, PositionTargetTypemask, SetAttitudeTarget, SetPositionTargetGlobalInt,
    SetPositionTargetLocalNed,
};
use crate::frame::Frame;
use crate::link::Port;
use crate::message::Message;
use crate::network::Peers;
use crate::time::{Duration, Instant};
use crate::types::{
    AttitudeSetpoint, ControlInput, Firmware, Peer, Place, PositionSetpoint, Setpoint, Target, Vehicle,
};

counters! {
    /// Counters of setpoints. They wrap. Messages for other systems are counted in
    /// [`LinkCounters::not_ours`](crate::network::LinkCounters::not_ours), those on a high-latency link in
    /// [`out_of_place`](crate::network::LinkCounters::out_of_place).
    SetpointCounters {
        /// Accepted setpoints.
        count taken,
        /// Dropped because they were addressed to every vehicle (J-6).
        drop broadcast,
        /// Dropped because the sender is not authorised (J-6).
        drop not_allowed,
        /// Dropped because another sender's setpoint had not expired (J-6).
        drop not_owner,
        /// Dropped because a given field was NaN or infinite (J-8).
        drop not_finite,
        /// Dropped because a quaternion was not normalised, or because a latitude, longitude or thrust was out of range
        /// (J-8).
        drop out_of_range,
    }
}

/// Setpoints: `setpoints: Setpoints` in the struct of a [stack](macro@crate::Stack). A vehicle without it gets the
/// messages in [`Vehicle::message`](crate::Vehicle::message), without any check of their sender or their age.
///
/// ```text
///        to all? ──▶ authorised? ──▶ does another one own them? ──▶ finite, in range? ──▶ current(now)
///           │             │                    │                            │                  │
///           ▼             ▼                    ▼                            ▼                  ▼
///       broadcast    not_allowed           not_owner             not_finite, out_of_range  None from the
///                                                                                          timeout on
///
///                      a valid setpoint of an authorised sender
///        no owner ─────────────────────────────────────────────▶ owned by the sender ─┐
///           ▲                                                       │            ▲    │ its next valid setpoint
///           └───────────────────────────────────────────────────────┘            └────┘
///              the last setpoint is as old as the timeout, or another source is set
/// ```
///
/// One sender, which is an address on a link, owns the setpoints at a time: the first authorised one, until its last
/// valid setpoint has expired. Setpoints of others are counted and ignored meanwhile. If the last message always won,
/// two senders would pull the vehicle to and fro.
///
/// A setpoint that is refused does not prolong the one before it. A sender that sends only such setpoints is lost after
/// the timeout.
///
/// [`Vehicle::control_input`](crate::Vehicle::control_input) gets each accepted setpoint at once. A vehicle that enters
/// a mode only with a current setpoint decides by it, because a request for the mode may follow in the same read
/// (C-17).
///
/// Setpoints from a high-latency link are not accepted (J-6): they would arrive too old.
///
/// A vehicle that flies setpoints says so in its [capabilities](crate::config::Identity::capabilities), such as
/// [`SET_POSITION_TARGET_LOCAL_NED`](crate::dialect::MavProtocolCapability::SET_POSITION_TARGET_LOCAL_NED).
///
/// ```
/// use mavstack::manual_control::ControlSource;
/// use mavstack::setpoints::{Place, PositionSetpoint, Setpoint, Target};
/// # use mavstack::prelude::*;
/// # use mavstack::{dialect, message};
/// # struct Rover;
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { dialect::MavResult::UNSUPPORTED.into() }
/// # }
/// #[derive(mavstack::Stack)]
/// #[stack(vehicle: Rover, links: 1)]
/// struct Mavlink {
///     setpoints: mavstack::setpoints::Setpoints,
/// }
///
/// /// Called once, before the loop: until then no sender is authorised. The companion computer is a component of our system.
/// fn configure(stack: &mut StackOf<Mavlink>) {
///     stack.setpoints.set_source(ControlSource::System(message::SystemId::new(1)));
/// }
///
/// /// Called in every pass of the flight loop, in the mode that flies setpoints. Returns the velocity to the north and to the east.
/// fn velocity(stack: &StackOf<Mavlink>, now: Instant) -> Option<[f32; 2]> {
///     match stack.setpoints.current(now)?.target {
///         Target::Position(PositionSetpoint {
///             frame: dialect::MavFrame::LOCAL_NED,
///             place: Place::Local([None, None, _]),
///             velocity: [Some(north), Some(east), _],
///             ..
///         }) => Some([north, east]),
///         // This rover cannot follow it. Like an expired setpoint, it ends the mode.
///         _ => None,
///     }
/// }
/// ```
#[derive(Clone, Debug)]
pub struct Setpoints {
    /// The owner of the last setpoint. All instants here are the firmware's.
    holder: Holder,
    /// When the last setpoint was received.
    at: Instant,
    setpoint: RawSetpoint,
    counters: SetpointCounters,
}

/// A setpoint as received.
#[derive(Clone, Copy, Debug)]
struct RawSetpoint {
    time_boot_ms: u32,
    /// The bits of the message's numbers in its order. For a position: position, velocity, acceleration, yaw, yaw rate.
    /// For an attitude: quaternion, rates, thrust, thrust in the body frame. Latitude and longitude are integers.
    numbers: [u32; NUMBERS],
    /// The numbers that are given, the first in the lowest bit.
    given: u16,
    kind: SetpointKind,
    frame: MavFrame,
    is_force: bool,
}

const NUMBERS: usize = 11;

/// The given numbers of an attitude.
const QUATERNION: u16 = 0b000_0000_1111;
const RATES: u16 = 0b000_0111_0000;
const THRUST: u16 = 0b000_1000_0000;
const THRUST_BODY: u16 = 0b111_0000_0000;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SetpointKind {
    Local,
    Global,
    Attitude,
}

/// Why a setpoint is refused. Each has a counter in [`SetpointCounters`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SetpointFault {
    Broadcast,
    NotAllowed,
    NotOwner,
    NotFinite,
    OutOfRange,
}

/// The square of a quaternion's length: normalised within 1 %.
const NORMALISED: core::ops::RangeInclusive<f32> = 0.99 * 0.99..=1.01 * 1.01;
/// 90° in 1e-7 degrees.
const RIGHT_ANGLE: u32 = 900_000_000;

impl RawSetpoint {
    /// All zero bits.
    const VACANT: Self = Self {
        time_boot_ms: 0,
        numbers: [0; NUMBERS],
        given: 0,
        kind: SetpointKind::Local,
        frame: MavFrame(0),
        is_force: false,
    };

    /// Reads one of the three messages; `None` for another one.
    fn read(frame: &Frame<'_>) -> Option<Self> {
        if let Some(m) = frame.decode::<SetPositionTargetLocalNed>() {
            let position = [m.x.to_bits(), m.y.to_bits(), m.z.to_bits()];
            let motion = [m.vx, m.vy, m.vz, m.afx, m.afy, m.afz, m.yaw, m.yaw_rate];
            let (time_boot_ms, frame, kind) = (m.time_boot_ms, m.coordinate_frame, SetpointKind::Local);
            let setpoint = Self { time_boot_ms, frame, kind, ..Self::VACANT };
            return Some(setpoint.with_position(m.type_mask, position, motion));
        }
        if let Some(m) = frame.decode::<SetPositionTargetGlobalInt>() {
            let position = [m.lat_int.cast_unsigned(), m.lon_int.cast_unsigned(), m.alt.to_bits()];
            let motion = [m.vx, m.vy, m.vz, m.afx, m.afy, m.afz, m.yaw, m.yaw_rate];
            let (time_boot_ms, frame, kind) = (m.time_boot_ms, m.coordinate_frame, SetpointKind::Global);
            let setpoint = Self { time_boot_ms, frame, kind, ..Self::VACANT };
            return Some(setpoint.with_position(m.type_mask, position, motion));
        }
        let m = frame.decode::<SetAttitudeTarget>()?;
        // A set bit of the mask means "ignore": each of the three lowest bits ignores a rate.
        let mut given = (!u16::from(m.type_mask.0) << RATES.trailing_zeros()) & RATES;
        if !m.type_mask.contains(AttitudeTargetTypemask::ATTITUDE_IGNORE) {
            given |= QUATERNION;
        }
        if m.type_mask.contains(AttitudeTargetTypemask::THRUST_BODY_SET) {
            given |= THRUST_BODY;
        } else if !m.type_mask.contains(AttitudeTargetTypemask::THROTTLE_IGNORE) {
            given |= THRUST;
        }
        let ([q0, q1, q2, q3], [b0, b1, b2]) = (m.q, m.thrust_body);
        let numbers = [q0, q1, q2, q3, m.body_roll_rate, m.body_pitch_rate, m.body_yaw_rate, m.thrust, b0, b1, b2];
        let (time_boot_ms, numbers) = (m.time_boot_ms, numbers.map(f32::to_bits));
        Some(Self { time_boot_ms, numbers, given, kind: SetpointKind::Attitude, ..Self::VACANT })
    }

    /// Adds the numbers of a position. `motion` is velocity, acceleration, yaw and yaw rate.
    fn with_position(self, mask: PositionTargetTypemask, position: [u32; 3], motion: [f32; 8]) -> Self {
        let [x, y, z] = position;
        let [vx, vy, vz, ax, ay, az, yaw, yaw_rate] = motion.map(f32::to_bits);
        // A set bit of the mask means "ignore". Bits 0 to 8 are for position, velocity and acceleration. Bit 9 says
        // that the acceleration is a force. Bits 10 and 11 are for yaw and yaw rate, which are numbers 9 and 10.
        let ignored = (mask.0 & 0x1FF) | ((mask.0 >> 1) & 0x600);
        let is_force = mask.contains(PositionTargetTypemask::FORCE_SET);
        let numbers = [x, y, z, vx, vy, vz, ax, ay, az, yaw, yaw_rate];
        Self { numbers, given: !ignored, is_force, ..self }
    }

    /// Returns the bits of the number at this index of the message; `None` if the message ignores it.
    fn given_bits(&self, index: usize) -> Option<u32> {
        let bit = 1u16.unbounded_shl(u32::try_from(index).ok()?);
        let is_given = self.given & bit != 0;
        self.numbers.get(index).copied().filter(|_| is_given)
    }

    /// Checks the given numbers: integers and floats are in range, floats are finite, and a quaternion is normalised.
    ///
    /// # Errors
    ///
    /// The fault of the first number that fails (J-8).
    fn check(&self) -> Result<(), SetpointFault> {
        let mut square_of_length = 0.0;
        for index in 0..NUMBERS {
            let Some(bits) = self.given_bits(index) else { continue };
            let (number, integer) = (f32::from_bits(bits), bits.cast_signed());
            let is_in_range = match (self.kind, index) {
                // Latitude and longitude are integers.
                (SetpointKind::Global, 0) => integer.unsigned_abs() <= RIGHT_ANGLE,
                (SetpointKind::Global, 1) => integer.unsigned_abs() <= 2 * RIGHT_ANGLE,
                _ if !number.is_finite() => return Err(SetpointFault::NotFinite),
                // The quaternion's length is complete with its last number.
                (SetpointKind::Attitude, 0..4) => {
                    square_of_length += number * number;
                    index < 3 || NORMALISED.contains(&square_of_length)
                }
                // Thrust, and thrust in the body frame.
                (SetpointKind::Attitude, 7..) => (-1.0..=1.0).contains(&number),
                _ => true,
            };
            if !is_in_range {
                return Err(SetpointFault::OutOfRange);
            }
        }
        Ok(())
    }

    /// Returns the setpoint for the vehicle. Numbers that are not given are `None`.
    fn target(&self) -> Target {
        let numbers = core::array::from_fn(|index| self.given_bits(index).map(f32::from_bits));
        if self.kind == SetpointKind::Attitude {
            let [w, x, y, z, roll_rate, pitch_rate, yaw_rate, thrust, thrust_x, thrust_y, thrust_z] = numbers;
            return Target::Attitude(AttitudeSetpoint {
                attitude: all_given([w, x, y, z]),
                rates: [roll_rate, pitch_rate, yaw_rate],
                thrust,
                thrust_body: all_given([thrust_x, thrust_y, thrust_z]),
            });
        }
        let [x, y, z, vx, vy, vz, ax, ay, az, yaw, yaw_rate] = numbers;
        let place = if self.kind == SetpointKind::Global {
            // Latitude and longitude are integers, in the place of x and y.
            let latitude = self.given_bits(0).map(u32::cast_signed);
            let longitude = self.given_bits(1).map(u32::cast_signed);
            Place::Global { latitude, longitude, altitude: z }
        } else {
            Place::Local([x, y, z])
        };
        Target::Position(PositionSetpoint {
            frame: self.frame,
            place,
            velocity: [vx, vy, vz],
            acceleration: [ax, ay, az],
            is_force: self.is_force,
            yaw,
            yaw_rate,
        })
    }
}

/// Returns the numbers if all are given; `None` if one is not.
fn all_given<const N: usize>(numbers: [Option<f32>; N]) -> Option<[f32; N]> {
    let are_given = numbers.iter().all(Option::is_some);
    are_given.then(|| numbers.map(Option::unwrap_or_default))
}

impl Setpoints {
    /// The default timeout: PX4 needs two setpoints a second too.
    pub const TIMEOUT: Duration = Duration::from_millis(500);

    /// Sets which sender is authorised. A change ends the ownership of the present sender; it may begin again with its
    /// next setpoint if it is still authorised. Until the first call no sender is authorised.
    pub fn set_source(&mut self, source: ControlSource) {
        if self.holder.source != source {
            self.holder.source = source;
            self.holder.release();
        }
    }

    /// Sets how long a setpoint is valid, [`TIMEOUT`](Self::TIMEOUT) by default. It applies to later setpoints: one
    /// that has expired does not become valid again.
    pub fn set_timeout(&mut self, timeout: Duration) {
        self.holder.timeout = timeout;
    }

    /// Returns the last setpoint; `None` without a current one: initially, and once it is as old as the timeout (J-7).
    pub fn current(&self, now: Instant) -> Option<Setpoint> {
        let setpoint = &self.setpoint;
        let from = self.holder.sender(now)?;
        Some(Setpoint { from, at: self.at, time_boot_ms: setpoint.time_boot_ms, target: setpoint.target() })
    }

    /// Returns the sender of the current setpoint. No other sender is followed until it has expired.
    pub fn owner(&self, now: Instant) -> Option<Peer> {
        self.holder.sender(now)
    }

    /// Returns which sender is authorised, as last set.
    pub const fn source(&self) -> ControlSource {
        self.holder.source
    }

    /// Returns the counters.
    pub const fn counters(&self) -> SetpointCounters {
        self.counters
    }

    /// Checks whether the sender's setpoint may replace the present one.
    ///
    /// # Errors
    ///
    /// The first reason against it: the setpoint is for every vehicle, the sender is not authorised, or another sender
    /// owns the setpoints.
    fn check_sender(&self, now: Instant, from: Peer, is_broadcast: bool, peers: &Peers) -> Result<(), SetpointFault> {
        if is_broadcast {
            Err(SetpointFault::Broadcast)
        } else if !self.holder.source.allows(from, peers) {
            Err(SetpointFault::NotAllowed)
        } else if self.owner(now).is_some_and(|owner| owner != from) {
            Err(SetpointFault::NotOwner)
        } else {
            Ok(())
        }
    }

    /// Handles one of the three messages, and counts it. Returns whether its setpoint is the current one from now on.
    fn receive(&mut self, now: Instant, received: &Received<'_>, peers: &Peers) -> bool {
        let Received { frame, from, target, .. } = *received;
        let Some(setpoint) = RawSetpoint::read(frame) else { return false };
        let checked = self.check_sender(now, from, target.system.is_all(), peers).and_then(|()| setpoint.check());
        if checked.is_ok() {
            self.holder.hold(now, from);
            self.at = now;
            self.setpoint = setpoint;
        }
        let counters = &mut self.counters;
        increment(match checked {
            Ok(()) => &mut counters.taken,
            Err(SetpointFault::Broadcast) => &mut counters.broadcast,
            Err(SetpointFault::NotAllowed) => &mut counters.not_allowed,
            Err(SetpointFault::NotOwner) => &mut counters.not_owner,
            Err(SetpointFault::NotFinite) => &mut counters.not_finite,
            Err(SetpointFault::OutOfRange) => &mut counters.out_of_range,
        });
        checked.is_ok()
    }
}

impl<F: Firmware<Vehicle: Vehicle>> Service<F> for Setpoints {
    const NEW: Self = Self {
        holder: Holder::NEW,
        at: Instant::ZERO,
        setpoint: RawSetpoint::VACANT,
        counters: SetpointCounters::ZERO,
    };
    type Link = ();
    const VACANT: () = ();
    type Reply = ();

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.counters);
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, (): &mut (), received: &Received<'_>) -> Handled {
        match received.frame.id() {
            SetPositionTargetLocalNed::ID | SetPositionTargetGlobalInt::ID | SetAttitudeTarget::ID => {
                let now = cx.shared.clock.shown(cx.now);
                let is_accepted = self.receive(now, received, cx.peers);
                if is_accepted && let Some(setpoint) = self.current(now) {
                    let (vehicle, mut context) = cx.hook();
                    vehicle.control_input(&mut context, &ControlInput::Setpoint(setpoint));
                }
                Handled::Yes
            }
            _ => Handled::No,
        }
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        match event {
            StackEvent::Begun(_) => self.holder.timeout = Self::TIMEOUT,
            StackEvent::NewOwner { own, owner } => {
                // A sender of a system that is no longer in control loses the setpoints.
                let may_continue = |sender: Peer| [own, owner].contains(&sender.address.system);
                if let Some(sender) = self.holder.last_sender()
                    && !may_continue(sender)
                {
                    self.holder.release();
                }
            }
            StackEvent::ClockSetBack(_) => self.holder.release(),
            _ => {}
        }
    }
}
