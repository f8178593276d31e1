//! Setpoints: where to fly, how fast, or in which attitude, from a companion computer or a ground station.
//!
//! Implements <https://mavlink.io/en/services/offboard_control.html>: SET_POSITION_TARGET_LOCAL_NED,
//! SET_POSITION_TARGET_GLOBAL_INT and SET_ATTITUDE_TARGET, rules J-6 to J-8. None of them is answered. The vehicle decides
//! what it flies: it reads the setpoint in every pass of its loop, and gets `None` when there is no current one.
//!
//! Left out: the echoes POSITION_TARGET_LOCAL_NED, POSITION_TARGET_GLOBAL_INT and ATTITUDE_TARGET, which the vehicle sends as
//! streams, because only it knows what it flies; and setpoints for single actuators.
//!
//! [`Setpoints`] shows which sender is followed, and for how long.

use super::manual_control::ControlSource;
use super::{Cx, Handled, Received, Service, ShowCounters, StackEvent, increment};
use crate::dialect::{
    AttitudeTargetTypemask, MavFrame, PositionTargetTypemask, SetAttitudeTarget, SetPositionTargetGlobalInt,
    SetPositionTargetLocalNed,
};
use crate::frame::Frame;
use crate::link::Port;
use crate::message::{Address, Message};
use crate::network::Peers;
use crate::time::{Duration, Instant};
use crate::types::{
    AttitudeSetpoint, ControlInput, Firmware, LinkId, Peer, Place, PositionSetpoint, Setpoint, Target, Vehicle,
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
        /// Dropped because a quaternion was not normalised, or because a latitude, longitude or thrust was out of range (J-8).
        drop out_of_range,
    }
}

/// Setpoints: `setpoints: Setpoints` in the struct of a [stack](macro@crate::Stack). A vehicle without it gets the messages in
/// [`Vehicle::message`](crate::Vehicle::message), without any check of their sender or their age.
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
/// One sender, which is an address on a link, owns the setpoints at a time: the first authorised one, until its last valid
/// setpoint has expired. Setpoints of others are counted and ignored meanwhile. If the last message always won, two
/// senders would pull the vehicle to and fro.
///
/// A setpoint that is refused does not prolong the one before it. A sender that sends only such setpoints is lost after the
/// timeout.
///
/// [`Vehicle::control_input`](crate::Vehicle::control_input) gets each accepted setpoint at once. A vehicle that enters a mode
/// only with a current setpoint decides by it, because a request for the mode may follow in the same read (C-17).
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
///         // Not what this rover drives. Like an expired setpoint, it ends the mode.
///         _ => None,
///     }
/// }
/// ```
#[derive(Clone, Debug)]
pub struct Setpoints {
    source: ControlSource,
    timeout: Duration,
    /// The sender of the last setpoint.
    from: Peer,
    /// When it was received, and until when it is valid.
    at: Instant,
    until: Instant,
    numbers: Numbers,
    counters: SetpointCounters,
}

/// The numbers of a setpoint, as received.
#[derive(Clone, Copy, Debug)]
struct Numbers {
    time_boot_ms: u32,
    /// The bits of the message's numbers in its order. For a position: position, velocity, acceleration, yaw, yaw rate. For an
    /// attitude: quaternion, rates, thrust, thrust in the body frame. Latitude and longitude are integers.
    bits: [u32; 11],
    /// Which of them are given, the first in the lowest bit.
    given: u16,
    kind: Kind,
    frame: MavFrame,
    is_force: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Local,
    Global,
    Attitude,
}

/// Why a setpoint is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    NotFinite,
    OutOfRange,
}

/// The square of a quaternion's length: normalised within 1 %.
const NORMALISED: core::ops::RangeInclusive<f32> = 0.99 * 0.99..=1.01 * 1.01;
/// 90° in 1e-7 degrees.
const RIGHT_ANGLE: u32 = 900_000_000;

impl Numbers {
    /// All zero bits.
    const VACANT: Self =
        Self { time_boot_ms: 0, bits: [0; 11], given: 0, kind: Kind::Local, frame: MavFrame(0), is_force: false };

    /// Reads one of the three messages; `None` for another one.
    fn of(frame: &Frame<'_>) -> Option<Self> {
        if let Some(m) = frame.decode::<SetPositionTargetLocalNed>() {
            let place = [m.x.to_bits(), m.y.to_bits(), m.z.to_bits()];
            let motion = [m.vx, m.vy, m.vz, m.afx, m.afy, m.afz, m.yaw, m.yaw_rate];
            return Some(Self::position(m.time_boot_ms, Kind::Local, m.coordinate_frame, m.type_mask, place, motion));
        }
        if let Some(m) = frame.decode::<SetPositionTargetGlobalInt>() {
            let place = [m.lat_int.cast_unsigned(), m.lon_int.cast_unsigned(), m.alt.to_bits()];
            let motion = [m.vx, m.vy, m.vz, m.afx, m.afy, m.afz, m.yaw, m.yaw_rate];
            return Some(Self::position(m.time_boot_ms, Kind::Global, m.coordinate_frame, m.type_mask, place, motion));
        }
        let m = frame.decode::<SetAttitudeTarget>()?;
        let has = |ignored| !m.type_mask.contains(ignored);
        let is_body = m.type_mask.contains(AttitudeTargetTypemask::THRUST_BODY_SET);
        let mut given = (!u16::from(m.type_mask.0) & 7) << 4;
        if has(AttitudeTargetTypemask::ATTITUDE_IGNORE) {
            given |= 0xF;
        }
        if is_body {
            given |= 0x700;
        } else if has(AttitudeTargetTypemask::THROTTLE_IGNORE) {
            given |= 0x80;
        }
        let ([q0, q1, q2, q3], [b0, b1, b2]) = (m.q, m.thrust_body);
        let bits = [q0, q1, q2, q3, m.body_roll_rate, m.body_pitch_rate, m.body_yaw_rate, m.thrust, b0, b1, b2];
        let bits = bits.map(f32::to_bits);
        Some(Self { time_boot_ms: m.time_boot_ms, bits, given, kind: Kind::Attitude, ..Self::VACANT })
    }

    fn position(
        time_boot_ms: u32,
        kind: Kind,
        frame: MavFrame,
        mask: PositionTargetTypemask,
        [x, y, z]: [u32; 3],
        motion: [f32; 8],
    ) -> Self {
        let [a, b, c, d, e, f, g, h] = motion.map(f32::to_bits);
        // Bit 9 says that the acceleration is a force; those above it are of yaw and yaw rate.
        let ignored = (mask.0 & 0x1FF) | ((mask.0 >> 1) & 0x600);
        let is_force = mask.contains(PositionTargetTypemask::FORCE_SET);
        Self { time_boot_ms, bits: [x, y, z, a, b, c, d, e, f, g, h], given: !ignored & 0x7FF, kind, frame, is_force }
    }

    /// Checks what is given (J-8).
    fn check(&self) -> Result<(), Fault> {
        let mut given = self.given;
        let mut square = 0.0;
        for (place, bits) in (0..11_u8).zip(self.bits) {
            let is_given = given & 1 != 0;
            given >>= 1;
            let number = f32::from_bits(bits);
            let is_in_range = match (self.kind, place) {
                _ if !is_given => continue,
                (Kind::Global, 0) => bits.cast_signed().unsigned_abs() <= RIGHT_ANGLE,
                (Kind::Global, 1) => bits.cast_signed().unsigned_abs() <= 2 * RIGHT_ANGLE,
                _ if !number.is_finite() => return Err(Fault::NotFinite),
                (Kind::Attitude, 0..4) => {
                    square += number * number;
                    place < 3 || NORMALISED.contains(&square)
                }
                (Kind::Attitude, 7..) => (-1.0..=1.0).contains(&number),
                _ => true,
            };
            if !is_in_range {
                return Err(Fault::OutOfRange);
            }
        }
        Ok(())
    }

    fn target(&self) -> Target {
        let mut given = self.given;
        let numbers = self.bits.map(|bits| {
            let is_given = given & 1 != 0;
            given >>= 1;
            is_given.then_some(bits)
        });
        let real = |number: Option<u32>| number.map(f32::from_bits);
        let reals = |numbers: [Option<u32>; 3]| numbers.map(real);
        let [a, b, c, d, e, f, g, h, i, j, k] = numbers;
        let place = match self.kind {
            Kind::Attitude => {
                let attitude = [a, b, c, d].map(real);
                return Target::Attitude(AttitudeSetpoint {
                    attitude: if let [Some(w), Some(x), Some(y), Some(z)] = attitude {
                        Some([w, x, y, z])
                    } else {
                        None
                    },
                    rates: reals([e, f, g]),
                    thrust: real(h),
                    thrust_body: if let [Some(x), Some(y), Some(z)] = reals([i, j, k]) {
                        Some([x, y, z])
                    } else {
                        None
                    },
                });
            }
            Kind::Local => Place::Local(reals([a, b, c])),
            Kind::Global => {
                let degrees = |number: Option<u32>| number.map(u32::cast_signed);
                Place::Global { latitude: degrees(a), longitude: degrees(b), altitude: real(c) }
            }
        };
        Target::Position(PositionSetpoint {
            frame: self.frame,
            place,
            velocity: reals([d, e, f]),
            acceleration: reals([g, h, i]),
            is_force: self.is_force,
            yaw: real(j),
            yaw_rate: real(k),
        })
    }
}

impl Setpoints {
    /// The default timeout: PX4 needs two setpoints a second too.
    pub const TIMEOUT: Duration = Duration::from_millis(500);

    /// Sets which sender is authorised. A change ends the ownership of the present sender; it may begin again with its next
    /// setpoint if it is still authorised. Until the first call no sender is authorised.
    pub fn set_source(&mut self, source: ControlSource) {
        if self.source != source {
            self.source = source;
            self.until = Instant::ZERO;
        }
    }

    /// Sets how long a setpoint is valid, [`TIMEOUT`](Self::TIMEOUT) by default. It applies to later setpoints: one that has
    /// expired does not become valid again.
    pub fn set_timeout(&mut self, timeout: Duration) {
        self.timeout = timeout;
    }

    /// Returns the last setpoint; `None` without a current one: initially, and once it is as old as the timeout (J-7).
    pub fn current(&self, now: Instant) -> Option<Setpoint> {
        let Self { from, at, numbers, .. } = self;
        let is_current = self.owner(now).is_some();
        is_current.then(|| Setpoint {
            from: *from,
            at: *at,
            time_boot_ms: numbers.time_boot_ms,
            target: numbers.target(),
        })
    }

    /// Returns the sender of the current setpoint. No other sender is followed until it has expired.
    pub fn owner(&self, now: Instant) -> Option<Peer> {
        (now < self.until).then_some(self.from)
    }

    /// Returns which sender is authorised, as last set.
    pub const fn source(&self) -> ControlSource {
        self.source
    }

    /// Returns the counters.
    pub const fn counters(&self) -> SetpointCounters {
        self.counters
    }

    /// Handles one of the three messages. Returns whether it is accepted.
    fn receive(&mut self, now: Instant, from: Peer, frame: &Frame<'_>, is_broadcast: bool, peers: &Peers) -> bool {
        let owner = self.owner(now);
        let counters = &mut self.counters;
        let counter = if is_broadcast {
            &mut counters.broadcast
        } else if !self.source.allows(from, peers) {
            &mut counters.not_allowed
        } else if owner.is_some_and(|owner| owner != from) {
            &mut counters.not_owner
        } else if let Some(numbers) = Numbers::of(frame) {
            match numbers.check() {
                Err(Fault::NotFinite) => &mut counters.not_finite,
                Err(Fault::OutOfRange) => &mut counters.out_of_range,
                Ok(()) => {
                    (self.from, self.at, self.until) = (from, now, now + self.timeout);
                    self.numbers = numbers;
                    increment(&mut counters.taken);
                    return true;
                }
            }
        } else {
            return false;
        };
        increment(counter);
        false
    }
}

impl<F: Firmware<Vehicle: Vehicle>> Service<F> for Setpoints {
    const NEW: Self = Self {
        source: ControlSource::Nobody,
        timeout: Duration::ZERO,
        from: Peer { address: Address::new(0, 0), link: LinkId(0) },
        at: Instant::ZERO,
        until: Instant::ZERO,
        numbers: Numbers::VACANT,
        counters: SetpointCounters::ZERO,
    };
    type Link = ();
    const VACANT: () = ();
    type Reply = ();

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.counters);
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, (): &mut (), received: &Received<'_>) -> Handled {
        let Received { frame, from, target, .. } = received;
        match frame.id() {
            SetPositionTargetLocalNed::ID | SetPositionTargetGlobalInt::ID | SetAttitudeTarget::ID => {
                let now = cx.shared.clock.shown(cx.now);
                if self.receive(now, *from, frame, target.system.is_all(), cx.peers)
                    && let Some(setpoint) = self.current(now)
                {
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
            StackEvent::Begun(_) => self.timeout = Self::TIMEOUT,
            StackEvent::NewOwner { own, owner } if ![own, owner].contains(&self.from.address.system) => {
                self.until = Instant::ZERO
            }
            // All instants here are the firmware's.
            StackEvent::ClockSetBack(_) => self.until = Instant::ZERO,
            _ => {}
        }
    }
}
