//! The gimbal manager: decides which component may point the gimbal, and passes its setpoints to the vehicle: rules
//! GIM-1 to GIM-4, GIM-6, GIM-7, GIM-9 and GIM-12.

use super::super::stream::has_listener;
use super::super::{
    About, Cx, Handled, Received, Request, Service, ShowCounters, StackEvent, Turn, Verdict, View, increment,
};
use super::command::{GimbalCommand, is_about_gimbal};
use super::remote::{self, RemoteDevice};
use super::send;
use super::setpoint::{GimbalSetpoint, RawSetpoint, SetpointKind};
use super::status_stream::{Asked, StatusMessage, StatusStream};
use super::vehicle::{GimbalControl, GimbalManager};
use crate::dialect::{
    GimbalManagerInformation, GimbalManagerStatus, MavCmd, MavProtocolCapability, MavResult, MavSeverity,
};
use crate::link::Port;
use crate::message::{Address, Item, Message};
use crate::num;
use crate::time::Instant;
use crate::types::{Component, Firmware, Vehicle};
use core::num::Wrapping;

/// GIMBAL_MANAGER_STATUS: five times a second, as its definition advises, and every two seconds on a radio, as PX4 does.
const STATUS: StatusMessage = StatusMessage {
    id: GimbalManagerStatus::ID,
    radio: 2_000_000,
    onboard: 200_000,
    other: GimbalManagerInformation::ID,
};

/// The component in control, if none is.
const NOBODY: Address = Address::new(0, 0);

counters! {
    /// Counters of the gimbal manager. They wrap.
    ManagerCounters {
        /// Commands and messages that reached [`GimbalManager::point_gimbal`].
        count taken,
        /// Commands that were DENIED because their sender was not in control (GIM-4).
        drop refused,
        /// Messages that were dropped because their sender was not in control (GIM-4).
        drop not_in_control,
        /// Messages that were dropped because they were sent to every vehicle.
        drop broadcast,
        /// Messages that were dropped because they were for another gimbal device.
        drop other_device,
        /// Messages that were dropped because a number was infinite or out of range, a quaternion was not normalised,
        /// or the flags named two frames.
        drop invalid,
    }
}

/// The gimbal manager: `gimbal_manager: ManagerService` in the struct of a [stack](macro@crate::Stack).
/// [`GimbalManager`] has its hooks.
///
/// A component takes control by MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, which is never refused: senders are expected to
/// look at GIMBAL_MANAGER_STATUS first, and to ask their pilot. Its parameters are pairs of a system and a component:
///
/// | both numbers | control |
/// |---|---|
/// | a system and a component | is given to it |
/// | 0 | is taken from the component that has it |
/// | −1 | is unchanged |
/// | −2 | is given to the autopilot |
/// | −3 | is taken from the sender, if it has it |
///
/// Then these point (GIM-4):
///
/// | message or command | from components in control | from others |
/// |---|---|---|
/// | MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW | yes | DENIED |
/// | MAV_CMD_DO_SET_ROI\_\*, MAV_CMD_DO_SET_ROI, MAV_CMD_DO_MOUNT_\* | yes | takes primary control if nobody has it; otherwise DENIED |
/// | GIMBAL_MANAGER_SET_ATTITUDE, \_SET_PITCHYAW, \_SET_MANUAL_CONTROL | yes | dropped and counted |
///
/// The clients of the second row do not know gimbal control: QGroundControl sets a region of interest, and MAVProxy
/// points by the older protocol, without it.
///
/// The vehicle itself [points](Self::point) for an item of its mission. That takes primary control, so that ground
/// stations see it; [`release`](Self::release) ends it.
///
/// With `operator_control`, control ends when another system takes over the vehicle, except that of the vehicle's own
/// system.
///
/// GIMBAL_MANAGER_STATUS is sent five times a second, or every two seconds on a link with
/// [`StreamProfile::Radio`](crate::config::StreamProfile::Radio), and at once after a change, on every normal link that
/// carries MAVLink 2.
#[derive(Clone, Debug)]
pub struct ManagerService {
    primary: Address,
    secondary: Address,
    /// The changes of control, to report each of them once on each link.
    changes: Wrapping<u8>,
    /// Those that were reported to the vehicle.
    reported: Wrapping<u8>,
    device: RemoteDevice,
    counters: ManagerCounters,
}

/// The state of the service on a link.
#[derive(Clone, Copy, Debug)]
pub struct ManagerLink {
    status: StatusStream,
    /// The changes of control that were reported.
    reported: Wrapping<u8>,
}

/// A message that the gimbal manager sends.
#[derive(Clone, Copy, Debug)]
pub enum ManagerReply {
    /// A message that a client has requested: the status, its interval, or GIMBAL_MANAGER_INFORMATION.
    Asked(Asked),
    /// GIMBAL_MANAGER_STATUS, after a change of control.
    Change,
    /// GIMBAL_MANAGER_STATUS, in its stream.
    Stream,
    /// To a remote device: a setpoint, the vehicle's state, or a question.
    ForDevice,
}

impl ManagerService {
    /// Returns the components in control.
    pub fn control(&self) -> GimbalControl {
        let in_control = |address| if address == NOBODY { None } else { Some(address) };
        GimbalControl { primary: in_control(self.primary), secondary: in_control(self.secondary) }
    }

    /// Returns the counters.
    pub const fn counters(&self) -> ManagerCounters {
        self.counters
    }

    /// Gives control. The next poll reports it to the vehicle.
    fn assign(&mut self, primary: Address, secondary: Address) {
        if (self.primary, self.secondary) != (primary, secondary) {
            self.primary = primary;
            self.secondary = secondary;
            event!("gimbal control: {}", primary);
            self.changes += 1;
        }
    }

    /// Points the gimbal for the vehicle itself: carries out an item of its mission, or one that it makes. These are
    /// the commands that peers may send too: MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW and _CONFIGURE, MAV_CMD_DO_SET_ROI_*
    /// and MAV_CMD_DO_MOUNT_*.
    ///
    /// An accepted item that points takes primary control from the component that has it, as PX4's missions do; see
    /// [`release`](Self::release). A vehicle that does not want to take it looks at [`control`](Self::control) first.
    ///
    /// Returns the result of [`GimbalManager::point_gimbal`]. DENIED: a parameter is out of range, or the stack was not
    /// begun. UNSUPPORTED: the item is about no gimbal.
    ///
    /// ```
    /// # use mavstack::dialect::*;
    /// # use mavstack::prelude::*;
    /// # use mavstack::gimbal;
    /// # struct Rover;
    /// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
    /// # impl Commands for Rover {
    /// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { MavResult::UNSUPPORTED.into() }
    /// # }
    /// # impl GimbalManager for Rover {
    /// #     const DEVICE: u8 = 1;
    /// #     fn manager_information(&self) -> GimbalManagerInformation { Default::default() }
    /// #     fn manager_flags(&self) -> GimbalManagerFlags { GimbalManagerFlags::EMPTY }
    /// #     fn point_gimbal(&mut self, _: &mut Context<'_>, _: &gimbal::GimbalSetpoint) -> MavResult { MavResult::ACCEPTED }
    /// # }
    /// # #[derive(Stack)]
    /// # #[stack(vehicle: Rover, links: 1)]
    /// # struct Mavlink { gimbal: gimbal::ManagerService }
    /// /// Called when an item of the mission becomes current. Returns whether the mission continues at once.
    /// fn begin_item(stack: &mut StackOf<Mavlink>, now: Instant, item: &Item, rover: &mut Rover) -> bool {
    ///     // A refusal by the gimbal does not stop the mission.
    ///     stack.with_services(now, rover, |services, cx| services.gimbal.point(cx, item)) != MavResult::UNSUPPORTED
    /// }
    ///
    /// fn end_of_mission(stack: &mut StackOf<Mavlink>, now: Instant, rover: &mut Rover) {
    ///     stack.with_services(now, rover, |services, cx| services.gimbal.release(cx.address()));
    /// }
    /// ```
    pub fn point<F: Firmware<Vehicle: GimbalManager + Vehicle>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        item: &Item,
    ) -> MavResult {
        if !is_about_gimbal(item.command) {
            return MavResult::UNSUPPORTED;
        }
        if !cx.shared.is_begun() {
            return MavResult::DENIED;
        }
        let own = cx.address();
        self.execute(cx, own, &GimbalCommand::of_item(item)).unwrap_or_else(|refusal| refusal)
    }

    /// Ends the control of a component, if it has it. With the vehicle's own [address](Cx::address), its own control:
    /// at the end of a mission that pointed the gimbal, so that ground stations need not ask their pilot before they
    /// take it.
    pub fn release(&mut self, from: Address) {
        let [primary, secondary] =
            [self.primary, self.secondary].map(|owner| if owner == from { NOBODY } else { owner });
        self.assign(primary, secondary);
    }

    /// Whether a component may point. A frame may have the address of nobody as its source.
    fn may_point(&self, from: Address) -> bool {
        from != NOBODY && (from == self.primary || from == self.secondary)
    }

    /// Executes a command about a gimbal, or an item of the vehicle's mission.
    ///
    /// # Errors
    ///
    /// DENIED or COMMAND_UNSUPPORTED_MAV_FRAME if the command is refused before the hook is called.
    fn execute<F: Firmware<Vehicle: GimbalManager + Vehicle>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        from: Address,
        command: &GimbalCommand,
    ) -> Result<MavResult, MavResult> {
        let is_ours = command.is_for_device(F::Vehicle::DEVICE);
        if command.id == MavCmd::DO_GIMBAL_MANAGER_CONFIGURE {
            let [system, component, secondary_system, secondary_component] = command.params;
            let primary = configured([system, component], self.primary, from);
            let secondary = configured([secondary_system, secondary_component], self.secondary, from);
            let (Some(primary), Some(secondary), true) = (primary, secondary, is_ours) else {
                return Err(MavResult::DENIED);
            };
            self.assign(primary, secondary);
            return Ok(MavResult::ACCEPTED);
        }
        // The vehicle may always point. Clients that know no gimbal control get it while nobody has it.
        let is_free = self.primary == NOBODY && from != NOBODY;
        let takes_control = from == cx.address() || (command.id != MavCmd::DO_GIMBAL_MANAGER_PITCHYAW && is_free);
        if !takes_control && !self.may_point(from) {
            increment(&mut self.counters.refused);
            if cfg!(feature = "plan-texts") {
                cx.text(MavSeverity::WARNING, b"Gimbal: not in control, take control first");
            }
            // Not NOT_IN_CONTROL, which MAVSDK takes for no answer. PX4 answers the same.
            return Ok(MavResult::DENIED);
        }
        let mut setpoint = RawSetpoint::NONE;
        command.read(&mut setpoint, F::Vehicle::HAS_TERRAIN_MODEL)?;
        let is_primary = takes_control || from == self.primary;
        let result = match setpoint.kind {
            _ if !is_ours => return Err(MavResult::DENIED),
            SetpointKind::None => MavResult::ACCEPTED,
            _ => self.point_vehicle(cx, from, is_primary, &setpoint).ok_or(MavResult::DENIED)?,
        };
        if takes_control && result == MavResult::ACCEPTED {
            self.assign(from, self.secondary);
        }
        Ok(result)
    }

    /// Passes a setpoint to the vehicle, and returns its result; `None` if the setpoint is invalid.
    fn point_vehicle<F: Firmware<Vehicle: GimbalManager>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        from: Address,
        is_primary: bool,
        raw: &RawSetpoint,
    ) -> Option<MavResult> {
        let setpoint = GimbalSetpoint { from, is_secondary: !is_primary, flags: raw.flags, target: raw.check()? };
        increment(&mut self.counters.taken);
        cx.shared.has_acted = true;
        let (vehicle, mut context) = cx.hook();
        Some(vehicle.point_gimbal(&mut context, &setpoint))
    }

    fn send_status<F: Firmware<Vehicle: GimbalManager>>(&self, cx: &Cx<'_, F>, port: &mut Port) -> bool {
        let status = GimbalManagerStatus {
            time_boot_ms: cx.now.time_boot_ms(),
            flags: cx.vehicle.manager_flags(),
            gimbal_device_id: F::Vehicle::DEVICE,
            primary_control_sysid: self.primary.system.wire(),
            primary_control_compid: self.primary.component.wire(),
            secondary_control_sysid: self.secondary.system.wire(),
            secondary_control_compid: self.secondary.component.wire(),
        };
        send::<F, _>(port, None, &status)
    }
}

/// Returns the component in control after a pair of MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, system and component; `None`
/// if the pair is invalid.
fn configured(pair: [f32; 2], owner: Address, from: Address) -> Option<Address> {
    // NaN leaves it as it is (C-8), and -9 is invalid.
    let [system, component] =
        pair.map(|param| if param.is_nan() { -1 } else { num::integer::<i32>(param).unwrap_or(-9) });
    match (system, component) {
        (-1, -1) => Some(owner),
        // An item of the mission is of the autopilot.
        (-2, -2) => Some(from),
        (-3, -3) => Some(if owner == from { NOBODY } else { owner }),
        (0, 0..=255) => Some(NOBODY),
        // A component 0 would be every one of its system.
        (1..=255, 1..=255) => Some(Address::new(u8::try_from(system).ok()?, u8::try_from(component).ok()?)),
        _ => None,
    }
}

impl<F: Firmware<Vehicle: GimbalManager + Vehicle>> Service<F> for ManagerService {
    const CHECK: () = {
        let device = F::Vehicle::DEVICE;
        assert!(device != 0, "`GimbalManager::DEVICE` is 1 to 6, or the component id of the gimbal device");
        assert!(!F::Vehicle::IS_REMOTE || device > 6, "a remote gimbal device has a component id above 6");
    };
    const NEW: Self = Self {
        primary: NOBODY,
        secondary: NOBODY,
        changes: Wrapping(0),
        reported: Wrapping(0),
        device: RemoteDevice::NEW,
        counters: ManagerCounters::ZERO,
    };
    /// Without its device the manager has nothing to manage.
    const ABOUT: About = About {
        turns: &[Turn::Gimbal, Turn::GimbalStatus],
        capabilities: MavProtocolCapability::COMPONENT_IMPLEMENTS_GIMBAL_MANAGER,
        is_of_components: Component::is_one(F::COMPONENTS, F::Vehicle::DEVICE),
        ..About::AUTOPILOT
    };
    type Link = ManagerLink;
    const VACANT: ManagerLink = ManagerLink { status: StatusStream::NEW, reported: Wrapping(0) };
    type Reply = ManagerReply;

    /// Reports a change of control to the vehicle.
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut ManagerLink>) {
        if self.reported != self.changes {
            self.reported = self.changes;
            let control = self.control();
            let (vehicle, mut context) = cx.hook();
            vehicle.gimbal_control_changed(&mut context, &control);
        }
        if F::Vehicle::IS_REMOTE {
            self.device.poll(cx);
        }
    }

    fn deadline(&self) -> Instant {
        if self.reported == self.changes { Instant::NEVER } else { Instant::ZERO }
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, _: &mut ManagerLink, received: &Received<'_>) -> Handled {
        let from = received.from.address;
        let mut setpoint = RawSetpoint::NONE;
        let Some(device) = setpoint.read_message(received.frame) else {
            let is_of_device = F::Vehicle::IS_REMOTE && from == remote::address::<F::Vehicle>(cx.address().system);
            // Anyone may claim to be the device (X-1).
            let is_handled = is_of_device && received.counts && self.device.receive(cx, received.frame);
            return if is_handled { Handled::Yes } else { Handled::No };
        };
        if received.target.system.is_all() {
            increment(&mut self.counters.broadcast);
        } else if device != 0 && device != F::Vehicle::DEVICE {
            increment(&mut self.counters.other_device);
        } else if !self.may_point(from) {
            increment(&mut self.counters.not_in_control);
        } else if self.point_vehicle(cx, from, from == self.primary, &setpoint).is_none() {
            increment(&mut self.counters.invalid);
        }
        Handled::Yes
    }

    fn on_command(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut ManagerLink,
        request: &Request,
    ) -> Option<Verdict> {
        if !is_about_gimbal(request.command.id) {
            return link.status.on_command(STATUS, port, &request.command).map(Verdict::done);
        }
        let command = GimbalCommand::of_command(&request.command);
        if !command.is_for_device(F::Vehicle::DEVICE) {
            // The vehicle may have another gimbal.
            return None;
        }
        Some(match self.execute(cx, request.command.from.address, &command) {
            Ok(result) => Verdict::done(result),
            Err(result) => Verdict::Refused(result.into()),
        })
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &ManagerLink, turn: Turn) -> Option<(Instant, ManagerReply)> {
        let has_listener = || has_listener(view.shared, view.peers, port);
        if turn == Turn::GimbalStatus {
            return Some((link.status.due(STATUS, port, has_listener), ManagerReply::Stream));
        }
        if let Some(asked) = link.status.asked() {
            return Some((view.now, ManagerReply::Asked(asked)));
        }
        if link.reported != self.changes && port.outbox.takes(STATUS.id) && has_listener() {
            return Some((view.now, ManagerReply::Change));
        }
        let is_on_link = || remote::link::<F::Vehicle>(view.peers, view.shared) == Some(port.id);
        (F::Vehicle::IS_REMOTE && is_on_link()).then(|| (self.device.due(port), ManagerReply::ForDevice))
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut ManagerLink, reply: ManagerReply) -> bool {
        match reply {
            ManagerReply::Asked(Asked::Other) => {
                link.status.forget(Asked::Other);
                return send_information::<F>(cx, port);
            }
            ManagerReply::Asked(Asked::Interval) => {
                link.status.forget(Asked::Interval);
                return send::<F, _>(port, None, &link.status.told(STATUS, port));
            }
            ManagerReply::ForDevice => return F::Vehicle::IS_REMOTE && self.device.send(cx, port),
            ManagerReply::Stream => {
                link.status.sent(cx.now, STATUS, port);
            }
            ManagerReply::Asked(Asked::Message) | ManagerReply::Change => {}
        }
        link.reported = self.changes;
        link.status.forget(Asked::Message);
        self.send_status(cx, port)
    }

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.counters);
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        if let StackEvent::NewOwner { own, owner } = event {
            let [primary, secondary] = [self.primary, self.secondary]
                .map(|address| if [own, owner].contains(&address.system) { address } else { NOBODY });
            self.assign(primary, secondary);
        }
    }
}

fn send_information<F: Firmware<Vehicle: GimbalManager>>(cx: &Cx<'_, F>, port: &mut Port) -> bool {
    let information = GimbalManagerInformation {
        time_boot_ms: cx.now.time_boot_ms(),
        gimbal_device_id: F::Vehicle::DEVICE,
        ..cx.vehicle.manager_information()
    };
    send::<F, _>(port, None, &information)
}
