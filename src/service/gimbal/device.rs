//! The gimbal device: reports its attitude and failures, and follows its manager's setpoints: rules GIM-10 and GIM-11.

use super::super::stream::has_listener;
use super::super::{About, Cx, Handled, Received, Request, Service, ShowCounters, Turn, Verdict, View, increment};
use super::send;
use super::setpoint::{Axes, attitude};
use super::status_stream::{Asked, StatusMessage, StatusStream};
use crate::dialect::{
    GimbalDeviceAttitudeStatus, GimbalDeviceErrorFlags, GimbalDeviceFlags, GimbalDeviceInformation,
    GimbalDeviceSetAttitude, MavResult,
};
use crate::frame::Frame;
use crate::link::Port;
use crate::message::{Address, ComponentId, Message};
use crate::time::Instant;
use crate::types::{Context, Firmware};

/// GIMBAL_DEVICE_ATTITUDE_STATUS: ten times a second, as the guide advises, and once a second on a radio, as PX4 does.
const STATUS: StatusMessage = StatusMessage {
    id: GimbalDeviceAttitudeStatus::ID,
    radio: 1_000_000,
    onboard: 100_000,
    other: GimbalDeviceInformation::ID,
};

counters! {
    /// Counters of the gimbal device. They wrap.
    DeviceCounters {
        /// Setpoints that reached [`GimbalDevice::set_device_attitude`].
        count taken,
        /// Setpoints that were dropped because they were not from the manager, or were sent to every vehicle.
        drop not_manager,
        /// Setpoints that were dropped because a rate was infinite, the quaternion was not normalised, or the flags
        /// named two frames.
        drop invalid,
    }
}

/// A setpoint of the manager: see [`GimbalDevice::set_device_attitude`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct DeviceSetpoint {
    /// Which axes are locked to the earth, the frame of the yaw, and [`RETRACT`](GimbalDeviceFlags::RETRACT), which
    /// takes precedence over [`NEUTRAL`](GimbalDeviceFlags::NEUTRAL), which takes precedence over all else.
    pub flags: GimbalDeviceFlags,
    /// The attitude (w, x, y, z). Its length is 0.99 to 1.01. `None`: only rates.
    pub attitude: Option<[f32; 4]>,
    /// Rates (rad/s). Without a rate, an axis follows the attitude.
    pub rates: Axes,
}

impl DeviceSetpoint {
    /// Returns whether the yaw and its rate are relative to north, and not to the front of the vehicle. A manager that
    /// names neither frame means the earth exactly if it locks the yaw.
    pub const fn is_yaw_in_earth_frame(&self) -> bool {
        let flags = self.flags;
        flags.contains(GimbalDeviceFlags::YAW_IN_EARTH_FRAME)
            || (flags.contains(GimbalDeviceFlags::YAW_LOCK) && !flags.contains(GimbalDeviceFlags::YAW_IN_VEHICLE_FRAME))
    }
}

/// A gimbal device, for a firmware that has [`DeviceService`] in the struct of its [stack](macro@crate::Stack): the
/// firmware of a gimbal, or of an autopilot that has one.
///
/// | | [`COMPONENT`](Self::COMPONENT) | [`ID`](Self::ID) | [`MANAGER`](Self::MANAGER) |
/// |---|---|---|---|
/// | the firmware is a gimbal, with the address 1/154 | `None` | 0 | the autopilot, component 1 |
/// | an autopilot with a gimbal that is a component of its own | `Some(ComponentId::new(154))` | 0 | `None` |
/// | an autopilot with a gimbal that is not, such as two servos | `None` | 1 to 6 | `None` |
///
/// If the manager is in the same firmware, its [`point_gimbal`](crate::GimbalManager::point_gimbal) moves the gimbal,
/// and no frame is sent for it.
///
/// ```
/// use mavstack::dialect::{GimbalDeviceAttitudeStatus, GimbalDeviceFlags, GimbalDeviceInformation};
/// use mavstack::gimbal::DeviceSetpoint;
/// use mavstack::{Context, GimbalDevice, Instant, Text};
///
/// /// The firmware of a gimbal.
/// struct Gimbal { goal: [f32; 4], attitude: [f32; 4] }
///
/// impl GimbalDevice for Gimbal {
///     fn device_information(&self) -> GimbalDeviceInformation {
///         GimbalDeviceInformation { model_name: Text::new("Two axes"), ..GimbalDeviceInformation::UNKNOWN }
///     }
///
///     fn device_status(&self) -> Option<GimbalDeviceAttitudeStatus> {
///         Some(GimbalDeviceAttitudeStatus {
///             q: self.attitude,
///             flags: GimbalDeviceFlags::PITCH_LOCK.with(GimbalDeviceFlags::YAW_IN_VEHICLE_FRAME),
///             ..GimbalDeviceAttitudeStatus::UNKNOWN
///         })
///     }
///
///     fn set_device_attitude(&mut self, _: &mut Context<'_>, setpoint: &DeviceSetpoint) {
///         if let Some(attitude) = setpoint.attitude {
///             self.goal = attitude;
///         }
///     }
/// }
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `GimbalDevice`",
    note = "`DeviceService` in the struct of a stack needs `impl GimbalDevice for {Self}`: write it, or leave the field out"
)]
pub trait GimbalDevice {
    /// The component that the gimbal is, besides the one of [`Config`](crate::Config); `None` if it is that one, or
    /// none at all.
    const COMPONENT: Option<ComponentId> = None;

    /// The `gimbal_device_id` of its messages: 1 to 6 for a gimbal that is attached to the autopilot and no component
    /// of its own; otherwise 0.
    const ID: u8 = 0;

    /// The component of our system whose setpoints it follows; `None` if its manager is in this firmware.
    const MANAGER: Option<ComponentId> = Some(ComponentId::new(1));

    /// Returns names, capabilities and limits, for GIMBAL_DEVICE_INFORMATION. The stack sets time and id.
    fn device_information(&self) -> GimbalDeviceInformation;

    /// Returns attitude, flags and failures, for GIMBAL_DEVICE_ATTITUDE_STATUS; `None` if they are not known yet:
    /// nothing is sent then. The flags name the frame of the yaw. The stack sets time, target and id, and adds
    /// [`NO_MANAGER`](GimbalDeviceErrorFlags::NO_MANAGER) while the [`MANAGER`](Self::MANAGER) is not alive.
    fn device_status(&self) -> Option<GimbalDeviceAttitudeStatus>;

    /// Follows a setpoint of the manager. Its numbers are finite. Its status shows the limits that it has reached.
    fn set_device_attitude(&mut self, cx: &mut Context<'_>, setpoint: &DeviceSetpoint) {
        let _ = (cx, setpoint);
    }
}

/// The gimbal device: `gimbal_device: DeviceService` in the struct of a [stack](macro@crate::Stack). [`GimbalDevice`]
/// has its hooks.
///
/// GIMBAL_DEVICE_ATTITUDE_STATUS is sent ten times a second by default, or once on a link with
/// [`StreamProfile::Radio`](crate::config::StreamProfile::Radio), on every normal link that carries MAVLink 2; a client
/// may set another interval, from 20 ms. GIMBAL_DEVICE_INFORMATION is sent on request. GIMBAL_DEVICE_SET_ATTITUDE is
/// followed only if it comes from the manager and is addressed to our system.
#[derive(Clone, Debug)]
pub struct DeviceService {
    counters: DeviceCounters,
}

/// A message that the gimbal device sends.
#[derive(Clone, Copy, Debug)]
pub enum DeviceReply {
    /// A message that a client has requested: the status, its interval, or GIMBAL_DEVICE_INFORMATION.
    Asked(Asked),
    /// GIMBAL_DEVICE_ATTITUDE_STATUS, in its stream.
    Stream,
}

impl DeviceService {
    /// Returns the counters.
    pub const fn counters(&self) -> DeviceCounters {
        self.counters
    }
}

/// Returns the setpoint in a message; `None` if it is invalid.
fn read(frame: &Frame<'_>) -> Option<DeviceSetpoint> {
    let message = frame.decode::<GimbalDeviceSetAttitude>()?;
    let both_frames = GimbalDeviceFlags::YAW_IN_VEHICLE_FRAME.with(GimbalDeviceFlags::YAW_IN_EARTH_FRAME);
    let rates = [message.angular_velocity_x, message.angular_velocity_y, message.angular_velocity_z];
    if message.flags.contains(both_frames) || rates.iter().any(|rate| rate.is_infinite()) {
        return None;
    }
    Some(DeviceSetpoint { flags: message.flags, attitude: attitude(message.q).ok()?, rates: Axes(rates) })
}

impl<F: Firmware<Vehicle: GimbalDevice>> Service<F> for DeviceService {
    const CHECK: () = {
        let id = F::Vehicle::ID;
        assert!(id <= 6, "`GimbalDevice::ID` is 0, or 1 to 6 for a gimbal that is no component of its own");
        assert!(
            id == 0 || F::Vehicle::COMPONENT.is_none(),
            "a gimbal that is a component of its own has the `GimbalDevice::ID` 0"
        );
        if let Some(own) = F::Vehicle::COMPONENT {
            let mut components = F::COMPONENTS;
            let mut is_declared = false;
            while let [component, rest @ ..] = components {
                is_declared |= component.id.wire() == own.wire();
                components = rest;
            }
            assert!(
                is_declared,
                "`GimbalDevice::COMPONENT` is no component of the firmware: name it in `Components::COMPONENTS`"
            );
        }
    };
    const NEW: Self = Self { counters: DeviceCounters::ZERO };
    const ABOUT: About = About::of(F::Vehicle::COMPONENT).in_turns(&[Turn::GimbalDevice, Turn::GimbalAttitude]);
    type Link = StatusStream;
    const VACANT: StatusStream = StatusStream::NEW;
    type Reply = DeviceReply;

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, _: &mut StatusStream, received: &Received<'_>) -> Handled {
        let Received { frame, from, target, .. } = received;
        if frame.id() != GimbalDeviceSetAttitude::ID {
            return Handled::No;
        }
        let system = cx.address().system;
        let manager = F::Vehicle::MANAGER.map(|component| Address { system, component });
        // Anyone may claim to be the manager (X-1).
        let is_manager = manager == Some(from.address) && received.counts;
        if target.system != system || !is_manager {
            increment(&mut self.counters.not_manager);
        } else if let Some(setpoint) = read(frame) {
            increment(&mut self.counters.taken);
            cx.shared.has_acted = true;
            let (vehicle, mut context) = cx.hook();
            vehicle.set_device_attitude(&mut context, &setpoint);
        } else {
            increment(&mut self.counters.invalid);
        }
        Handled::Yes
    }

    fn on_command(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut StatusStream,
        request: &Request,
    ) -> Option<Verdict> {
        let result = link.on_command(STATUS, port, &request.command)?;
        // A status that is not known yet is refused now; otherwise the client would wait for it (Q-1).
        if link.asked() == Some(Asked::Message) && cx.vehicle.device_status().is_none() {
            link.forget(Asked::Message);
            return Some(Verdict::done(MavResult::DENIED));
        }
        Some(Verdict::done(result))
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &StatusStream, turn: Turn) -> Option<(Instant, DeviceReply)> {
        match turn {
            Turn::GimbalDevice => link.asked().map(|asked| (view.now, DeviceReply::Asked(asked))),
            _ => {
                let at = link.due(STATUS, port, || has_listener(view.shared, view.peers, port));
                Some((at, DeviceReply::Stream))
            }
        }
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut StatusStream, reply: DeviceReply) -> bool {
        let mut requested = match reply {
            DeviceReply::Asked(asked) => Some(asked),
            DeviceReply::Stream => {
                link.sent(cx.now, STATUS, port);
                return send_status::<F>(cx, port);
            }
        };
        // The vehicle may not know its status any more: then the next requested message is sent.
        while let Some(asked) = requested {
            link.forget(asked);
            let is_sent = match asked {
                Asked::Message => send_status::<F>(cx, port),
                Asked::Interval => send::<F, _>(port, F::Vehicle::COMPONENT, &link.told(STATUS, port)),
                Asked::Other => send_information::<F>(cx, port),
            };
            if is_sent {
                return true;
            }
            requested = link.asked();
        }
        false
    }

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.counters);
    }
}

fn send_information<F: Firmware<Vehicle: GimbalDevice>>(cx: &Cx<'_, F>, port: &mut Port) -> bool {
    let mut information = cx.vehicle.device_information();
    information.time_boot_ms = cx.now.time_boot_ms();
    information.gimbal_device_id = F::Vehicle::ID;
    send::<F, _>(port, F::Vehicle::COMPONENT, &information)
}

fn send_status<F: Firmware<Vehicle: GimbalDevice>>(cx: &Cx<'_, F>, port: &mut Port) -> bool {
    let Some(mut status) = cx.vehicle.device_status() else { return false };
    let own = cx.address();
    let is_alone = F::Vehicle::MANAGER.is_some_and(|component| {
        let manager = Address { component, ..own };
        !cx.peers.iter().any(|info| info.is_alive && info.peer.address == manager)
    });
    if is_alone {
        status.failure_flags = status.failure_flags.with(GimbalDeviceErrorFlags::NO_MANAGER);
    }
    status.time_boot_ms = cx.now.time_boot_ms();
    status.gimbal_device_id = F::Vehicle::ID;
    status.target_system = 0;
    status.target_component = 0;
    send::<F, _>(port, F::Vehicle::COMPONENT, &status)
}
