//! The vehicle's own gimbal, simulated: a component of its own, with its manager in the autopilot
//! (<https://mavlink.io/en/services/gimbal_v2.html>). It turns pitch and yaw, and keeps the roll level.

use core::f32::consts::{FRAC_PI_2, PI, TAU};

use libm::{atan2f, remainderf};
use mavstack::dialect::{
    GimbalDeviceAttitudeStatus, GimbalDeviceCapFlags, GimbalDeviceFlags, GimbalDeviceInformation,
    GimbalManagerCapFlags, GimbalManagerFlags, GimbalManagerInformation, MavFrame, MavResult,
};
use mavstack::gimbal::{GimbalSetpoint, GimbalTarget};
use mavstack::message::ComponentId;
use mavstack::{Context, GimbalDevice, GimbalManager, Instant, Item, StackOf, Text};

use super::{DT, Quadrotor};
use crate::angle::{cos, sin};
use crate::app::Mavlink;
use crate::body::Vector;

/// MAV_COMP_ID_GIMBAL.
pub(crate) const GIMBAL: ComponentId = ComponentId::new(154);

/// Limits of the pitch (rad). The yaw has none.
const PITCH: [f32; 2] = [-FRAC_PI_2, 0.5];
const CAPABILITIES: GimbalDeviceCapFlags = GimbalDeviceCapFlags::HAS_RETRACT
    .with(GimbalDeviceCapFlags::HAS_NEUTRAL)
    .with(GimbalDeviceCapFlags::HAS_PITCH_AXIS)
    .with(GimbalDeviceCapFlags::HAS_PITCH_LOCK)
    .with(GimbalDeviceCapFlags::HAS_YAW_AXIS)
    .with(GimbalDeviceCapFlags::HAS_YAW_FOLLOW)
    .with(GimbalDeviceCapFlags::HAS_YAW_LOCK);
/// The pitch when it is retracted.
const RETRACTED: f32 = 0.4;
/// How fast the gimbal turns (rad/s).
const SPEED: f32 = 2.0;
/// How long rates are followed after they were last given (s).
const RATES_LAST: f32 = 1.0;

/// Where the gimbal points.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Aim {
    /// Pitch and yaw (rad). The yaw is from north if `is_north`, and otherwise from the nose.
    Angles { pitch: f32, yaw: f32, is_north: bool },
    /// Turns at these rates (rad/s), for `left` seconds.
    Rates { pitch: f32, yaw: f32, left: f32, is_north: bool },
    /// At a place.
    Place(Vector),
    /// At the next waypoint, with these offsets of pitch and yaw (rad).
    Next([f32; 2]),
}

/// The gimbal.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gimbal {
    aim: Aim,
    is_retracted: bool,
    /// Pitch and yaw, from the nose (rad).
    angles: [f32; 2],
    /// An item of the mission that waits for the gimbal manager.
    order: Option<Item>,
    /// A mission that has pointed it has ended.
    is_released: bool,
}

/// Ahead and level.
const NEUTRAL: Aim = Aim::Angles { pitch: 0.0, yaw: 0.0, is_north: false };

impl Gimbal {
    pub(super) const NEW: Self =
        Self { aim: NEUTRAL, is_retracted: false, angles: [0.0; 2], order: None, is_released: false };

    /// Whether the yaw is kept from north.
    const fn is_north(&self) -> bool {
        match self.aim {
            Aim::Angles { is_north, .. } | Aim::Rates { is_north, .. } => is_north,
            Aim::Place(_) | Aim::Next(_) => true,
        }
    }
}

/// Returns pitch and yaw (rad) from one place to another; the yaw is from north.
fn direction(from: Vector, to: Vector) -> [f32; 2] {
    let (north, east) = (to.north - from.north, to.east - from.east);
    [atan2f(from.down - to.down, from.distance(to)), atan2f(east, north)]
}

impl Quadrotor {
    /// Turns the gimbal for one step.
    #[inline(never)]
    pub(super) fn turn_gimbal(&mut self) {
        let (here, nose) = (self.body.position, self.body.yaw());
        let next = self.mission.leg_to();
        let [pitch, yaw] = self.gimbal.angles;
        let from_nose = |[pitch, yaw]: [f32; 2]| [pitch, yaw - nose];
        let goal = match &mut self.gimbal.aim {
            Aim::Angles { pitch, yaw, is_north: false } => [*pitch, *yaw],
            Aim::Angles { pitch, yaw, is_north: true } => from_nose([*pitch, *yaw]),
            Aim::Rates { left, .. } if *left <= 0.0 => [pitch, yaw],
            Aim::Rates { pitch: up, yaw: right, left, is_north } => {
                *left -= DT;
                let turned = if *is_north { self.body.yaw_rate * DT } else { 0.0 };
                [pitch + *up * DT, yaw + *right * DT - turned]
            }
            Aim::Place(place) => from_nose(direction(here, *place)),
            Aim::Next([up, right]) => {
                let [pitch, yaw] = direction(here, next.unwrap_or(here));
                from_nose([pitch + *up, yaw + *right])
            }
        };
        let [goal_pitch, goal_yaw] = if self.gimbal.is_retracted { [RETRACTED, 0.0] } else { goal };
        let most = SPEED * DT;
        let step = |from: f32, to: f32| from + (to - from).clamp(-most, most);
        let turn = remainderf(goal_yaw - yaw, TAU).clamp(-most, most);
        self.gimbal.angles =
            [step(pitch, goal_pitch.clamp(PITCH[0], PITCH[1])), remainderf(yaw + turn, TAU).clamp(-PI, PI)];
    }

    /// Returns the attitude of the gimbal (w, x, y, z), with the yaw from the nose: first yaw, then pitch.
    pub(super) fn gimbal_attitude(&self) -> [f32; 4] {
        let [pitch, yaw] = self.gimbal.angles.map(|angle| angle / 2.0);
        let (sp, cp, sy, cy) = (sin(pitch), cos(pitch), sin(yaw), cos(yaw));
        [cy * cp, -sy * sp, cy * sp, sy * cp]
    }

    /// Keeps an item of the mission about the gimbal for [`carry_out_gimbal_item`](Self::carry_out_gimbal_item). Returns false if the
    /// one before is still waiting.
    pub(super) fn operate_gimbal(&mut self, item: &Item) -> bool {
        let is_free = self.gimbal.order.is_none();
        if is_free {
            self.gimbal.order = Some(*item);
        }
        is_free
    }

    /// Ends the mission's control of the gimbal.
    pub(super) fn release_gimbal(&mut self) {
        self.gimbal.is_released = true;
    }

    /// Executes an item of the mission through the gimbal manager. What the gimbal refuses does not stop the mission.
    // Not inlined: the flight loop has the deepest call stack.
    #[inline(never)]
    pub(crate) fn carry_out_gimbal_item(&mut self, now: Instant, stack: &mut StackOf<Mavlink>) {
        if let Some(item) = self.gimbal.order.take() {
            let _ = stack.with_services(now, self, |services, cx| services.gimbal_manager.point(cx, &item));
        }
        if core::mem::take(&mut self.gimbal.is_released) {
            let own = stack.address();
            stack.gimbal_manager.release(own);
        }
    }
}

impl GimbalManager for Quadrotor {
    const DEVICE: u8 = GIMBAL.wire();

    fn manager_information(&self) -> GimbalManagerInformation {
        GimbalManagerInformation {
            cap_flags: GimbalManagerCapFlags::HAS_RETRACT
                .with(GimbalManagerCapFlags::HAS_NEUTRAL)
                .with(GimbalManagerCapFlags::HAS_PITCH_AXIS)
                .with(GimbalManagerCapFlags::HAS_PITCH_LOCK)
                .with(GimbalManagerCapFlags::HAS_YAW_AXIS)
                .with(GimbalManagerCapFlags::HAS_YAW_FOLLOW)
                .with(GimbalManagerCapFlags::HAS_YAW_LOCK)
                .with(GimbalManagerCapFlags::CAN_POINT_LOCATION_LOCAL)
                .with(GimbalManagerCapFlags::CAN_POINT_LOCATION_GLOBAL),
            pitch_min: PITCH[0],
            pitch_max: PITCH[1],
            yaw_min: -PI,
            yaw_max: PI,
            ..GimbalManagerInformation::default()
        }
    }

    fn manager_flags(&self) -> GimbalManagerFlags {
        let level = GimbalManagerFlags::ROLL_LOCK.with(GimbalManagerFlags::PITCH_LOCK);
        match (self.gimbal.is_retracted, self.gimbal.is_north()) {
            (true, _) => GimbalManagerFlags::RETRACT.with(GimbalManagerFlags::YAW_IN_VEHICLE_FRAME),
            (_, true) => level.with(GimbalManagerFlags::YAW_LOCK).with(GimbalManagerFlags::YAW_IN_EARTH_FRAME),
            _ => level.with(GimbalManagerFlags::YAW_IN_VEHICLE_FRAME),
        }
    }

    fn point_gimbal(&mut self, _: &mut Context<'_>, setpoint: &GimbalSetpoint) -> MavResult {
        let is_north = setpoint.is_yaw_in_earth_frame();
        let [pitch, yaw] = self.gimbal.angles;
        let yaw = if is_north { yaw + self.body.yaw() } else { yaw };
        let turn = |pitch: Option<f32>, yaw: Option<f32>| Aim::Rates {
            pitch: pitch.unwrap_or(0.0),
            yaw: yaw.unwrap_or(0.0),
            left: RATES_LAST,
            is_north,
        };
        let aim = match setpoint.target {
            GimbalTarget::Retract => {
                self.gimbal.is_retracted = true;
                return MavResult::ACCEPTED;
            }
            GimbalTarget::Neutral | GimbalTarget::Released => NEUTRAL,
            GimbalTarget::Angles { angles, .. } if angles.pitch().is_some() || angles.yaw().is_some() => {
                Aim::Angles { pitch: angles.pitch().unwrap_or(pitch), yaw: angles.yaw().unwrap_or(yaw), is_north }
            }
            GimbalTarget::Angles { rates, .. } => turn(rates.pitch(), rates.yaw()),
            GimbalTarget::Attitude { q: [w, x, y, z], .. } => {
                // The pitch and the yaw of the quaternion. The pitch is an arcsine, by the arctangent.
                let sine = (2.0 * (w * y - z * x)).clamp(-1.0, 1.0);
                let pitch = atan2f(sine, libm::sqrtf(1.0 - sine * sine));
                Aim::Angles { pitch, yaw: atan2f(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)), is_north }
            }
            GimbalTarget::Manual { angles, .. } if angles.pitch().is_some() || angles.yaw().is_some() => Aim::Angles {
                pitch: angles.pitch().map_or(pitch, |share| share * FRAC_PI_2),
                yaw: angles.yaw().map_or(yaw, |share| share * PI),
                is_north,
            },
            GimbalTarget::Manual { rates, .. } => {
                turn(rates.pitch().map(|up| up * SPEED), rates.yaw().map(|right| right * SPEED))
            }
            GimbalTarget::Location { position, altitude, frame } => {
                let (north, east) = self.home.to_local(position.latitude, position.longitude);
                // On the ground, if no altitude is given.
                let frame = frame.unwrap_or(MavFrame::GLOBAL_RELATIVE_ALT);
                let height = altitude.map_or(Some(0.0), |altitude| self.home.to_height(frame, altitude));
                let Some(height) = height else { return MavResult::COMMAND_UNSUPPORTED_MAV_FRAME };
                Aim::Place(Vector { north, east, down: -height })
            }
            GimbalTarget::NextWaypoint { offsets } => {
                Aim::Next([offsets.pitch().unwrap_or(0.0), offsets.yaw().unwrap_or(0.0)])
            }
            // The positions of others are not known here.
            GimbalTarget::System(_) => return MavResult::DENIED,
        };
        (self.gimbal.aim, self.gimbal.is_retracted) = (aim, false);
        MavResult::ACCEPTED
    }
}

impl GimbalDevice for Quadrotor {
    const COMPONENT: Option<ComponentId> = Some(GIMBAL);
    const MANAGER: Option<ComponentId> = None;

    fn device_information(&self) -> GimbalDeviceInformation {
        GimbalDeviceInformation {
            vendor_name: Text::new("mavstack"),
            model_name: Text::new("Demo gimbal"),
            firmware_version: 1,
            cap_flags: CAPABILITIES.0 as u16,
            cap_flags2: CAPABILITIES,
            pitch_min: PITCH[0],
            pitch_max: PITCH[1],
            yaw_min: -PI,
            yaw_max: PI,
            ..GimbalDeviceInformation::UNKNOWN
        }
    }

    fn device_status(&self) -> Option<GimbalDeviceAttitudeStatus> {
        let level = GimbalDeviceFlags::ROLL_LOCK.with(GimbalDeviceFlags::PITCH_LOCK);
        let flags = match (self.gimbal.is_retracted, self.gimbal.is_north()) {
            (true, _) => GimbalDeviceFlags::RETRACT,
            (_, true) => level.with(GimbalDeviceFlags::YAW_LOCK),
            _ => level,
        };
        Some(GimbalDeviceAttitudeStatus {
            q: self.gimbal_attitude(),
            flags: flags.with(GimbalDeviceFlags::YAW_IN_VEHICLE_FRAME),
            delta_yaw: self.body.yaw(),
            ..GimbalDeviceAttitudeStatus::UNKNOWN
        })
    }
}
