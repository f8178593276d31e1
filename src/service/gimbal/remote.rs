//! A gimbal device that is another MAVLink component: its manager sends it setpoints and the vehicle's state, and asks
//! it for its capabilities.

use super::send;
use super::vehicle::GimbalManager;
use crate::dialect::{
    AutopilotStateForGimbalDevice, CommandLong, GimbalDeviceAttitudeStatus, GimbalDeviceInformation,
    GimbalDeviceSetAttitude, MavCmd,
};
use crate::frame::Frame;
use crate::link::Port;
use crate::message::{Address, ComponentId, Message, SystemId};
use crate::network::PeerInfo;
use crate::num;
use crate::service::{Cx, Shared};
use crate::time::{Duration, Instant};
use crate::types::{Firmware, LinkId};

/// How often the device is asked for its GIMBAL_DEVICE_INFORMATION until it answers, as PX4 does.
const ASK_PERIOD: Duration = Duration::from_secs(1);

/// When the device gets its next frames.
#[derive(Clone, Debug)]
pub(super) struct RemoteDevice {
    setpoint_at: Instant,
    state_at: Instant,
    /// When it is asked for its information: never while it is known.
    ask_at: Instant,
}

/// Returns the device's address in a system.
pub(super) const fn address<V: GimbalManager>(system: SystemId) -> Address {
    Address { system, component: ComponentId::new(V::DEVICE) }
}

/// Returns the first link on which the device is alive and believed.
pub(super) fn link<V: GimbalManager>(peers: &[PeerInfo], shared: &Shared) -> Option<LinkId> {
    let device = address::<V>(shared.config.address.get().system);
    let is_it = |info: &&PeerInfo| info.is_alive && info.peer.address == device && shared.believes(peers, info);
    peers.iter().find(is_it).map(|info| info.peer.link)
}

impl RemoteDevice {
    /// All zero bits.
    pub(super) const NEW: Self = Self { setpoint_at: Instant::ZERO, state_at: Instant::ZERO, ask_at: Instant::ZERO };

    /// Forgets a device that has timed out: it may be another one when it reappears.
    pub(super) fn poll<F: Firmware<Vehicle: GimbalManager>>(&mut self, cx: &Cx<'_, F>) {
        if self.ask_at == Instant::NEVER && link::<F::Vehicle>(cx.peers, cx.shared).is_none() {
            self.ask_at = cx.now;
        }
    }

    /// Handles a message of the device. Returns false if it is for another service.
    pub(super) fn receive<F: Firmware<Vehicle: GimbalManager>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        frame: &Frame<'_>,
    ) -> bool {
        let (vehicle, mut context) = cx.hook();
        if let Some(status) = frame.decode::<GimbalDeviceAttitudeStatus>() {
            vehicle.device_moved(&mut context, &status);
            return true;
        }
        if let Some(information) = frame.decode::<GimbalDeviceInformation>() {
            self.ask_at = Instant::NEVER;
            vehicle.device_found(&mut context, &information);
            return true;
        }
        false
    }

    /// Returns when the device gets its next frame on its link. MAVLink 1 only has the question (S-10).
    pub(super) fn due(&self, port: &Port) -> Instant {
        let is_v2 = port.outbox.takes(GimbalDeviceSetAttitude::ID);
        if is_v2 { self.ask_at.min(self.setpoint_at).min(self.state_at) } else { self.ask_at }
    }

    /// Sends the first frame that is due and that the vehicle has.
    pub(super) fn send<F: Firmware<Vehicle: GimbalManager>>(&mut self, cx: &mut Cx<'_, F>, port: &mut Port) -> bool {
        let (target_system, target_component) = (cx.address().system.wire(), F::Vehicle::DEVICE);
        let is_v2 = port.outbox.takes(GimbalDeviceSetAttitude::ID);
        if is_v2 && self.setpoint_at <= cx.now {
            self.setpoint_at = cx.now + F::Vehicle::SETPOINT_INTERVAL;
            if let Some(setpoint) = cx.vehicle.device_setpoint(cx.shared.clock.shown(cx.now)) {
                let setpoint = GimbalDeviceSetAttitude { target_system, target_component, ..setpoint };
                return send::<F, _>(port, None, &setpoint);
            }
        }
        if is_v2 && self.state_at <= cx.now {
            self.state_at = cx.now + F::Vehicle::STATE_INTERVAL;
            if let Some(state) = cx.vehicle.autopilot_state(cx.shared.clock.shown(cx.now)) {
                let time_boot_us = cx.now.as_micros();
                let state = AutopilotStateForGimbalDevice { time_boot_us, target_system, target_component, ..state };
                return send::<F, _>(port, None, &state);
            }
        }
        if self.ask_at > cx.now {
            return false;
        }
        self.ask_at = cx.now + ASK_PERIOD;
        let (command, param1) = (MavCmd::REQUEST_MESSAGE, num::f32_from_u32(GimbalDeviceInformation::ID));
        let request = CommandLong { param1, command, target_system, target_component, ..CommandLong::default() };
        send::<F, _>(port, None, &request)
    }
}
