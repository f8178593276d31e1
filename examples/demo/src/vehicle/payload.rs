//! A second gimbal and a second camera, on the links. The vehicle's [own](super::gimbal) need no messages.
//!
//! MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW for that gimbal becomes GIMBAL_DEVICE_SET_ATTITUDE. When a gimbal is found, the vehicle requests
//! GIMBAL_DEVICE_INFORMATION; when a camera is found, it reads its extended parameter CAM_MODE. The vehicle is no complete manager of
//! that gimbal.

use mavstack::dialect::commands::DoGimbalManagerPitchyaw;
use mavstack::dialect::{
    GimbalDeviceFlags, GimbalDeviceInformation, GimbalDeviceSetAttitude, GimbalManagerFlags, MavResult, MavSeverity,
    MavType,
};
use mavstack::network::PeerInfo;
use mavstack::{Command, Context, Fill, Frame, Instant, ParamAnswer, Peer, StackOf, Text};

use super::Quadrotor;
use super::commands::refuse;
use crate::angle::{cos, sin};
use crate::app::Mavlink;

/// The token of the request for GIMBAL_DEVICE_INFORMATION, and of the parameter CAM_MODE.
pub(super) const GIMBAL_INFORMATION: u16 = 2;
pub(super) const CAMERA_MODE: u16 = 3;

/// The gimbal and the camera, if there are any, and where the gimbal is to point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Payload {
    gimbal: Option<Peer>,
    camera: Option<Peer>,
    /// Pitch and yaw (deg).
    angles: [f32; 2],
}

impl Payload {
    pub(super) const NONE: Self = Self { gimbal: None, camera: None, angles: [0.0; 2] };

    /// Whether a gimbal is connected.
    pub(super) fn has_gimbal(&self) -> bool {
        self.gimbal.is_some()
    }
}

impl Quadrotor {
    /// Finds the gimbal and the camera of our system among the peers, and asks them about themselves.
    #[inline(never)]
    pub(crate) fn watch_payload(&mut self, now: Instant, stack: &mut StackOf<Mavlink>) {
        let system = stack.address().system;
        self.system = system.wire();
        let find = |r#type: MavType| {
            let is_it = |info: &PeerInfo| info.is_alive && info.r#type == r#type && info.peer.address.system == system;
            stack.peers(now).find(is_it).map(|info| info.peer)
        };
        let (gimbal, camera) = (find(MavType::GIMBAL), find(MavType::CAMERA));
        // What cannot be asked now is asked in the next pass.
        if gimbal != self.payload.gimbal && gimbal.is_none_or(|gimbal| stack.send_command(gimbal, GIMBAL_INFORMATION)) {
            self.payload.gimbal = gimbal;
        }
        if camera != self.payload.camera && camera.is_none_or(|camera| stack.read_ext_param(camera, CAMERA_MODE)) {
            self.payload.camera = camera;
        }
    }

    /// Handles GIMBAL_DEVICE_INFORMATION. Returns false for another message.
    #[inline(never)]
    pub(super) fn on_gimbal_information(&self, cx: &mut Context<'_>, frame: &Frame<'_>) -> bool {
        if self.payload.gimbal.is_none_or(|gimbal| gimbal.address != frame.source()) {
            return false;
        }
        let Some(model) = model(frame) else { return false };
        let mut text = Text::<50>::new("Gimbal: ");
        text.push_str(model.as_str().unwrap_or("?"));
        cx.text(MavSeverity::INFO, &text);
        true
    }

    /// Handles the value of CAM_MODE: a number in its first byte.
    #[inline(never)]
    pub(super) fn on_camera_mode(&self, cx: &mut Context<'_>, answer: ParamAnswer<'_>) {
        let ParamAnswer::ExtValue(value) = answer else { return };
        let [mode] = value.bytes();
        let mut text = Text::<50>::new("Camera: mode ");
        text.push_number(mode.into());
        cx.text(MavSeverity::INFO, &text);
    }

    /// MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW.
    #[inline(never)]
    pub(super) fn point_gimbal(&mut self, cx: &mut Context<'_>, command: &Command) -> Result<MavResult, MavResult> {
        let what: DoGimbalManagerPitchyaw = command.decode()?;
        // Angles only, with the yaw relative to the vehicle.
        let (Some(pitch @ -90.0..=45.0), Some(yaw)) = (what.pitch_angle, what.yaw_angle) else {
            return Err(MavResult::DENIED);
        };
        if GimbalManagerFlags::YAW_IN_VEHICLE_FRAME.with(what.gimbal_manager_flags)
            != GimbalManagerFlags::YAW_IN_VEHICLE_FRAME
        {
            return Err(MavResult::DENIED);
        }
        let is_it = |gimbal: &Peer| what.gimbal_device_id == Some(f32::from(gimbal.address.component.wire()));
        let Some(device) = self.payload.gimbal.filter(is_it) else {
            return Err(refuse(cx, MavResult::TEMPORARILY_REJECTED, "Gimbal refused: none is connected"));
        };
        self.payload.angles = [pitch, yaw];
        match cx.send::<GimbalDeviceSetAttitude>(device, 0) {
            true => Ok(MavResult::ACCEPTED),
            false => Err(refuse(cx, MavResult::TEMPORARILY_REJECTED, "Gimbal refused: its link is full")),
        }
    }

    /// Fills GIMBAL_DEVICE_SET_ATTITUDE: the attitude as a quaternion, first yaw, then pitch.
    #[inline(never)]
    pub(crate) fn put_gimbal_attitude(&self, out: &mut Fill<'_>) -> bool {
        let [pitch, yaw] = self.payload.angles.map(|angle| angle.to_radians() / 2.0);
        let (sp, cp, sy, cy) = (sin(pitch), cos(pitch), sin(yaw), cos(yaw));
        out.put(&GimbalDeviceSetAttitude {
            q: [cy * cp, -sy * sp, cy * sp, sy * cp],
            flags: GimbalDeviceFlags::YAW_IN_VEHICLE_FRAME
                | GimbalDeviceFlags::ROLL_LOCK
                | GimbalDeviceFlags::PITCH_LOCK,
            target_system: out.target().system.wire(),
            target_component: out.target().component.wire(),
            ..GimbalDeviceSetAttitude::UNKNOWN
        })
    }
}

/// Returns the model's name of a GIMBAL_DEVICE_INFORMATION. Not inlined, so that the message is not on the call stack of others.
#[inline(never)]
fn model(frame: &Frame<'_>) -> Option<Text<32>> {
    frame.decode::<GimbalDeviceInformation>().map(|information| information.model_name)
}
