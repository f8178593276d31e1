//! A gimbal on one of the links: the vehicle passes on where it is to point.
//!
//! MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW of a ground station becomes GIMBAL_DEVICE_SET_ATTITUDE to the gimbal device
//! (<https://mavlink.io/en/services/gimbal_v2.html>). The vehicle is no complete gimbal manager.

use libm::{cosf, sinf};
use mavstack::dialect::commands::DoGimbalManagerPitchyaw;
use mavstack::dialect::rules;
use mavstack::dialect::{GimbalDeviceFlags, GimbalDeviceSetAttitude, MavResult, MavType};
use mavstack::message::ParamRule;
use mavstack::network::PeerInfo;
use mavstack::{Command, CommandRule, Context, Fill, Peer};

use super::Quadrotor;
use super::commands::refuse;

/// Angles only, of the only gimbal; yaw relative to the vehicle.
pub(super) const PITCHYAW: CommandRule = rules::DO_GIMBAL_MANAGER_PITCHYAW.with_params(&[
    ParamRule::range(1, -90.0, 45.0),
    ParamRule::range(2, -180.0, 180.0),
    ParamRule::bits(5, GimbalDeviceFlags::YAW_IN_VEHICLE_FRAME.0 as u32),
    ParamRule::integers(7, 0, 1).or_nan(),
]);

/// The gimbal, if there is one, and where it is to point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gimbal {
    device: Option<Peer>,
    /// Pitch and yaw (deg).
    angles: [f32; 2],
}

impl Gimbal {
    pub(super) const NONE: Self = Self { device: None, angles: [0.0; 2] };
}

impl Quadrotor {
    /// Finds the gimbal of our system among the peers.
    pub(crate) fn watch_gimbal(&mut self, system: u8, peers: &[PeerInfo]) {
        let is_ours =
            |info: &&PeerInfo| info.is_alive && info.r#type == MavType::GIMBAL && info.peer.address.system.0 == system;
        self.gimbal.device = peers.iter().find(is_ours).map(|info| info.peer);
    }

    /// MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW.
    #[inline(never)]
    pub(super) fn point_gimbal(&mut self, cx: &mut Context<'_>, command: &Command) -> Result<MavResult, MavResult> {
        let what: DoGimbalManagerPitchyaw = command.decode()?;
        let (Some(pitch), Some(yaw)) = (what.pitch_angle, what.yaw_angle) else { return Err(MavResult::DENIED) };
        let Some(device) = self.gimbal.device else {
            return Err(refuse(cx, MavResult::TEMPORARILY_REJECTED, "Gimbal refused: none is connected"));
        };
        self.gimbal.angles = [pitch, yaw];
        match cx.send::<GimbalDeviceSetAttitude>(device, 0) {
            true => Ok(MavResult::ACCEPTED),
            false => Err(refuse(cx, MavResult::TEMPORARILY_REJECTED, "Gimbal refused: its link is full")),
        }
    }

    /// Fills GIMBAL_DEVICE_SET_ATTITUDE: the attitude as a quaternion, first yaw, then pitch.
    #[inline(never)]
    pub(crate) fn put_gimbal_attitude(&self, out: &mut Fill<'_>) -> bool {
        let [pitch, yaw] = self.gimbal.angles.map(|angle| angle.to_radians() / 2.0);
        let (sp, cp, sy, cy) = (sinf(pitch), cosf(pitch), sinf(yaw), cosf(yaw));
        out.put(&GimbalDeviceSetAttitude {
            q: [cy * cp, -sy * sp, cy * sp, sy * cp],
            flags: GimbalDeviceFlags::YAW_IN_VEHICLE_FRAME
                | GimbalDeviceFlags::ROLL_LOCK
                | GimbalDeviceFlags::PITCH_LOCK,
            target_system: out.target().system.0,
            target_component: out.target().component.0,
            ..GimbalDeviceSetAttitude::UNKNOWN
        })
    }
}
