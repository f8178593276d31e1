//! Gimbals, by Gimbal Protocol v2: [`Identify`], [`Configure`] and [`Point`].
//!
//! | | QGroundControl | MAVSDK | MAVProxy, pymavlink |
//! |---|---|---|---|
//! | looks for the manager at | every component that sends heartbeats, 6 times | all components at once | the autopilot |
//! | takes control as | primary, by its address; secondary stays | primary and secondary, by its address | primary, as the sender: a script's choice |
//! | points by | MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW | GIMBAL_MANAGER_SET_ATTITUDE, which has no answer | as QGroundControl |
//! | yaw | from the nose, which is said | from the nose, which is not said | from the nose, which is not said |
//!
//! Sources: QGroundControl's `GimbalController.cc`, MAVSDK's `gimbal_impl.cpp` and `gimbal_protocol_v2.cpp`, MAVProxy's
//! `mavproxy_camera`.

use crate::command::Send;
use crate::streams::Request;
use crate::{Client, Dialogue, Failure, Io, Received};
use mavstack::Address;
use mavstack::dialect::{GimbalManagerFlags, GimbalManagerInformation, GimbalManagerSetAttitude, MavCmd};

/// How often a component is asked whether it manages a gimbal.
const TRIES: u32 = 6;

/// A gimbal manager.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Manager {
    /// Its address.
    pub address: Address,
    /// Its gimbal, and what that can do.
    pub information: GimbalManagerInformation,
}

/// Finds the gimbal manager of the vehicle. Ends with it.
#[derive(Debug, Default)]
pub struct Identify {
    candidates: Option<Vec<Address>>,
    current: usize,
    tries: u32,
    request: Option<Request<GimbalManagerInformation>>,
    /// The manager, whichever component it is.
    found: Option<Manager>,
}

impl Identify {
    /// Asks the components that the client asks.
    pub fn new() -> Self {
        Self::default()
    }

    /// Asks this component.
    pub fn at(manager: Address) -> Self {
        Self { candidates: Some(vec![manager]), ..Self::default() }
    }
}

/// Returns the components that a client asks, the autopilot first.
fn candidates(io: &Io<'_>) -> Vec<Address> {
    let target = io.target();
    match io.client() {
        Client::QGroundControl => {
            let others = io.seen().components().map(|component| component.address);
            let others = others.filter(|other| other.system == target.system && *other != target);
            std::iter::once(target).chain(others).collect()
        }
        Client::Mavsdk => vec![Address::new(target.system.wire(), 0)],
        Client::MavProxy | Client::Pymavlink => vec![target],
    }
}

impl Dialogue for Identify {
    type Output = Manager;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Manager, Failure>> {
        if let Some(manager) = self.found {
            return Some(Ok(manager));
        }
        let candidates = self.candidates.get_or_insert_with(|| candidates(io));
        let address = candidates[self.current];
        let failure = match self.request.get_or_insert_with(|| Request::new().of(address)).poll(io)? {
            Ok(information) => return Some(Ok(Manager { address, information })),
            Err(failure) => failure,
        };
        self.request = None;
        self.tries += 1;
        let is_timeout = matches!(failure, Failure::Timeout { .. });
        if is_timeout && io.client() == Client::QGroundControl && self.tries < TRIES {
            return None;
        }
        (self.current, self.tries) = (self.current + 1, 0);
        (self.current == candidates.len()).then_some(Err(failure))
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        let Some(request) = &mut self.request else { return };
        if let Some(information) = frame.decode::<GimbalManagerInformation>()
            && frame.source().system == io.target().system
        {
            self.found = Some(Manager { address: frame.source(), information });
        }
        request.receive(io, frame);
    }
}

/// What a station wants with the control of a gimbal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Claim {
    /// To be in primary control.
    Take,
    /// To be it no longer.
    Release,
}

/// Takes or releases control of a gimbal by MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE.
#[derive(Debug)]
pub struct Configure {
    manager: Manager,
    claim: Claim,
    command: Option<Send>,
}

impl Configure {
    /// Takes or releases control.
    pub fn new(manager: Manager, claim: Claim) -> Self {
        Self { manager, claim, command: None }
    }

    fn command(&self, io: &Io<'_>) -> Send {
        /// Leaves the control as it is.
        const UNCHANGED: f32 = -1.0;
        /// Ends the control if it is the sender's.
        const RELEASED: f32 = -3.0;
        /// The sender, whatever its address is.
        const SENDER: f32 = -2.0;
        let own = match io.client() {
            Client::QGroundControl | Client::Mavsdk => {
                [f32::from(io.address().system.wire()), f32::from(io.address().component.wire())]
            }
            Client::MavProxy | Client::Pymavlink => [SENDER; 2],
        };
        let primary = if self.claim == Claim::Take { own } else { [RELEASED; 2] };
        let secondary = if io.client() == Client::Mavsdk { primary } else { [UNCHANGED; 2] };
        let device = f32::from(self.manager.information.gimbal_device_id);
        let params = [primary[0], primary[1], secondary[0], secondary[1], f32::NAN, f32::NAN, device];
        Send::new(MavCmd::DO_GIMBAL_MANAGER_CONFIGURE, &params).to(self.manager.address)
    }
}

impl Dialogue for Configure {
    type Output = ();

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<(), Failure>> {
        if self.command.is_none() {
            self.command = Some(self.command(io));
        }
        Some(self.command.as_mut()?.poll(io)?.map(drop))
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let Some(command) = &mut self.command {
            command.receive(io, frame);
        }
    }
}

/// Points a gimbal. With MAVSDK it ends at once: its message has no answer.
#[derive(Debug)]
pub struct Point {
    manager: Manager,
    /// Pitch and yaw (deg).
    angles: [f32; 2],
    command: Option<Send>,
}

impl Point {
    /// Points at a pitch, up from the horizon, and a yaw, to the right of the nose (deg).
    pub fn new(manager: Manager, pitch: f32, yaw: f32) -> Self {
        Self { manager, angles: [pitch, yaw], command: None }
    }

    fn message(&self) -> GimbalManagerSetAttitude {
        let [pitch, yaw] = self.angles.map(|degrees| degrees.to_radians() / 2.0);
        let (sp, cp, sy, cy) = (pitch.sin(), pitch.cos(), yaw.sin(), yaw.cos());
        GimbalManagerSetAttitude {
            flags: GimbalManagerFlags::ROLL_LOCK.with(GimbalManagerFlags::PITCH_LOCK),
            q: [cy * cp, -sy * sp, cy * sp, sy * cp],
            target_system: self.manager.address.system.wire(),
            target_component: self.manager.address.component.wire(),
            gimbal_device_id: self.manager.information.gimbal_device_id,
            ..GimbalManagerSetAttitude::UNKNOWN
        }
    }

    fn command(&self, client: Client) -> Send {
        let level = GimbalManagerFlags::ROLL_LOCK.with(GimbalManagerFlags::PITCH_LOCK);
        let flags = match client {
            Client::QGroundControl => level.with(GimbalManagerFlags::YAW_IN_VEHICLE_FRAME),
            _ => GimbalManagerFlags::EMPTY,
        };
        let device = f32::from(self.manager.information.gimbal_device_id);
        let [pitch, yaw] = self.angles;
        let params = [pitch, yaw, f32::NAN, f32::NAN, flags.0 as f32, 0.0, device];
        Send::new(MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, &params).to(self.manager.address)
    }
}

impl Dialogue for Point {
    type Output = ();

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<(), Failure>> {
        if io.client() == Client::Mavsdk {
            io.send(&self.message());
            return Some(Ok(()));
        }
        if self.command.is_none() {
            self.command = Some(self.command(io.client()));
        }
        Some(self.command.as_mut()?.poll(io)?.map(drop))
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let Some(command) = &mut self.command {
            command.receive(io, frame);
        }
    }
}
