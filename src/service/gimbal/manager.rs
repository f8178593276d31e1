//! The gimbal manager: who points the gimbal, and what reaches the vehicle of it: rules GIM-1 to GIM-4, GIM-6, GIM-7, GIM-9 and GIM-12.

use super::super::stream::has_listener;
use super::super::{
    About, Cx, Handled, Received, Request, Service, ShowCounters, StackEvent, Turn, Verdict, View, increment,
};
use super::send;
use super::setpoint::{GimbalSetpoint, Order, Raw};
use super::status_stream::{Asked, StatusMessage, StatusStream};
use super::vehicle::{GimbalControl, GimbalManager};
use crate::dialect::{
    AutopilotStateForGimbalDevice, CommandLong, GimbalDeviceAttitudeStatus, GimbalDeviceInformation,
    GimbalDeviceSetAttitude, GimbalManagerInformation, GimbalManagerStatus, MavCmd, MavProtocolCapability, MavResult,
    MavSeverity,
};
use crate::frame::Frame;
use crate::link::Port;
use crate::message::{Address, ComponentId, Item, Message, SystemId};
use crate::network::PeerInfo;
use crate::num;
use crate::time::{Duration, Instant};
use crate::types::{Component, Context, Firmware, LinkId, Vehicle};

/// GIMBAL_MANAGER_STATUS: five times a second, as its definition advises, and every two seconds on a radio, as PX4 does.
const STATUS: StatusMessage = StatusMessage {
    id: GimbalManagerStatus::ID,
    radio: 2_000_000,
    onboard: 200_000,
    other: GimbalManagerInformation::ID,
};

/// How often a device is asked for its GIMBAL_DEVICE_INFORMATION until it answers, as PX4 does.
const ASK_PERIOD: Duration = Duration::from_secs(1);

/// A component, or nobody: its address as one number, because it is compared often.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Who(u16);

const NOBODY: Who = Who(0);

impl Who {
    pub(crate) const fn new(address: Address) -> Self {
        Self(u16::from_le_bytes([address.component.wire(), address.system.wire()]))
    }

    const fn address(self) -> Address {
        let [component, system] = self.0.to_le_bytes();
        Address::new(system, component)
    }

    fn get(self) -> Option<Address> {
        if self == NOBODY { None } else { Some(self.address()) }
    }
}

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
        /// Messages that were dropped because a number was infinite or out of range, a quaternion was not normalised, or the flags
        /// named two frames.
        drop invalid,
    }
}

/// The gimbal manager: `gimbal_manager: ManagerService` in the struct of a [stack](macro@crate::Stack). [`GimbalManager`] has its
/// hooks.
///
/// A component takes control by MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, which is never refused: senders are expected to look at
/// GIMBAL_MANAGER_STATUS first, and to ask their pilot. Its parameters are pairs of a system and a component:
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
/// | what | from those in control | from others |
/// |---|---|---|
/// | MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW | yes | DENIED |
/// | MAV_CMD_DO_SET_ROI\_\*, MAV_CMD_DO_SET_ROI, MAV_CMD_DO_MOUNT_\* | yes | takes primary control if nobody has it; otherwise DENIED |
/// | GIMBAL_MANAGER_SET_ATTITUDE, \_SET_PITCHYAW, \_SET_MANUAL_CONTROL | yes | dropped and counted |
///
/// The clients of the second row do not know gimbal control: QGroundControl sets a region of interest, and MAVProxy points by the
/// older protocol, without it.
///
/// The vehicle itself [points](Self::point) for an item of its mission. That takes primary control, so that ground stations see it;
/// [`release`](Self::release) ends it.
///
/// With `operator_control`, control ends when another system takes over the vehicle, except that of the vehicle's own system.
///
/// GIMBAL_MANAGER_STATUS is sent five times a second, or every two seconds on a link with
/// [`StreamProfile::Radio`](crate::config::StreamProfile::Radio), and at once after a change, on every normal link that carries MAVLink 2.
#[derive(Clone, Debug)]
pub struct ManagerService {
    primary: Who,
    secondary: Who,
    /// The number of changes of control, to report each of them once on each link, and those that the vehicle was told. They wrap.
    changes: u8,
    told: u8,
    /// A remote device has sent its information since it appeared.
    is_known: bool,
    /// When a remote device gets its next setpoint, the vehicle's state, and a question.
    setpoint_at: Instant,
    state_at: Instant,
    ask_at: Instant,
    counters: ManagerCounters,
}

/// The state of the service on a link.
#[derive(Clone, Copy, Debug)]
pub struct ManagerLink {
    status: StatusStream,
    /// The changes that it has reported.
    changes: u8,
}

/// What the gimbal manager sends.
#[derive(Clone, Copy, Debug)]
pub enum ManagerReply {
    /// What a client has asked for: the status, its interval, or GIMBAL_MANAGER_INFORMATION.
    Asked(Asked),
    /// GIMBAL_MANAGER_STATUS, after a change of control.
    Change,
    /// GIMBAL_MANAGER_STATUS, in its stream.
    Stream,
    /// To a remote device: a setpoint, the vehicle's state, or a question.
    ForDevice,
}

/// Whether an order is for our device: 0 and NaN are every device.
fn is_for<F: Firmware<Vehicle: GimbalManager>>(order: &Order) -> bool {
    let device = order.device();
    device.is_nan() || device == 0.0 || device == f32::from(F::Vehicle::DEVICE)
}

impl ManagerService {
    /// Returns who is in control.
    pub fn control(&self) -> GimbalControl {
        GimbalControl { primary: self.primary.get(), secondary: self.secondary.get() }
    }

    /// Returns the counters.
    pub const fn counters(&self) -> ManagerCounters {
        self.counters
    }

    /// Sets who is in control. The next poll tells the vehicle.
    fn assign(&mut self, primary: Who, secondary: Who) {
        if (self.primary, self.secondary) != (primary, secondary) {
            (self.primary, self.secondary) = (primary, secondary);
            event!("gimbal control: {}", primary.address());
            self.changes = self.changes.wrapping_add(1);
        }
    }

    /// Points the gimbal for the vehicle itself: carries out an item of its mission, or one that it makes. These are the commands that
    /// peers may send too: MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW and _CONFIGURE, MAV_CMD_DO_SET_ROI_* and MAV_CMD_DO_MOUNT_*.
    ///
    /// An accepted item that points takes primary control from the component that has it, as PX4's missions do; see
    /// [`release`](Self::release). A vehicle that does not want to take it looks at [`control`](Self::control) first.
    ///
    /// Returns the result of [`GimbalManager::point_gimbal`]. DENIED: a parameter is out of range, or the stack was not begun.
    /// UNSUPPORTED: the item is about no gimbal.
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
    /// /// Called when an item of the mission becomes current. Returns whether the mission goes on at once.
    /// fn begin_item(stack: &mut StackOf<Mavlink>, now: Instant, item: &Item, rover: &mut Rover) -> bool {
    ///     // What the gimbal refuses does not stop the mission.
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
        let order = Order::of_item(item);
        if !order.is_about_gimbal() {
            return MavResult::UNSUPPORTED;
        }
        if !cx.shared.is_begun() {
            return MavResult::DENIED;
        }
        let own = Who::new(cx.address());
        self.carry_out(cx, own, &order).unwrap_or_else(|refusal| refusal)
    }

    /// Ends the control of a component, if it has it. With the vehicle's own [address](Cx::address), its own control: at the end of a
    /// mission that pointed the gimbal, so that ground stations need not ask their pilot before they take it.
    pub fn release(&mut self, from: Address) {
        let from = Who::new(from);
        let [primary, secondary] = [self.primary, self.secondary].map(|has| if has == from { NOBODY } else { has });
        self.assign(primary, secondary);
    }

    /// Whether a component may point. A frame may have the address of nobody as its source.
    fn may_point(&self, from: Who) -> bool {
        from != NOBODY && (from == self.primary || from == self.secondary)
    }

    /// Returns who has control after a pair of MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE; `None` if it is invalid.
    fn configured(pair: [f32; 2], has: Who, from: Who) -> Option<Who> {
        // NaN leaves it as it is (C-8), and -9 is invalid.
        let [system, component] =
            pair.map(|param| if param.is_nan() { -1 } else { num::integer::<i32>(param).unwrap_or(-9) });
        match (system, component) {
            (-1, -1) => Some(has),
            // An item of the mission is of the autopilot.
            (-2, -2) => Some(from),
            (-3, -3) => Some(if has == from { NOBODY } else { has }),
            (0, 0..=255) => Some(NOBODY),
            // A component 0 would be every one of its system.
            (1..=255, 1..=255) => {
                let ([system, ..], [component, ..]) = (system.to_le_bytes(), component.to_le_bytes());
                Some(Who::new(Address::new(system, component)))
            }
            _ => None,
        }
    }

    /// Carries out a command about a gimbal, or an item of the vehicle's mission.
    ///
    /// # Errors
    ///
    /// The result of what the vehicle was not asked for: a parameter is out of range, or the frame is not supported.
    pub(crate) fn carry_out<F: Firmware<Vehicle: GimbalManager + Vehicle>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        from: Who,
        order: &Order,
    ) -> Result<MavResult, MavResult> {
        let own = Who::new(cx.shared.config.address.get());
        let is_ours = is_for::<F>(order);
        if order.id == MavCmd::DO_GIMBAL_MANAGER_CONFIGURE {
            let [primary, secondary] = order.pairs();
            let primary = Self::configured(primary, self.primary, from);
            let secondary = Self::configured(secondary, self.secondary, from);
            let (Some(primary), Some(secondary), true) = (primary, secondary, is_ours) else {
                return Err(MavResult::DENIED);
            };
            self.assign(primary, secondary);
            return Ok(MavResult::ACCEPTED);
        }
        // The vehicle may always point. Clients that know no gimbal control get it while nobody has it.
        let is_free = self.primary == NOBODY && from != NOBODY;
        let takes = from == own || (order.id != MavCmd::DO_GIMBAL_MANAGER_PITCHYAW && is_free);
        if !takes && !self.may_point(from) {
            increment(&mut self.counters.refused);
            if cfg!(feature = "plan-texts") {
                cx.text(MavSeverity::WARNING, b"Gimbal: not in control, take control first");
            }
            // Not NOT_IN_CONTROL, which MAVSDK takes for no answer. PX4 answers the same.
            return Ok(MavResult::DENIED);
        }
        let mut raw = Raw::NEW;
        order.read(&mut raw, F::Vehicle::HAS_TERRAIN_MODEL)?;
        let result = if is_ours { self.set_point(cx, from, takes || from == self.primary, &raw) } else { None };
        let result = result.ok_or(MavResult::DENIED)?;
        if takes && result == MavResult::ACCEPTED {
            self.assign(from, self.secondary);
        }
        Ok(result)
    }

    /// Has the vehicle point, unless the order only takes control; `None` if the setpoint is invalid.
    fn set_point<F: Firmware<Vehicle: GimbalManager>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        from: Who,
        is_primary: bool,
        raw: &Raw,
    ) -> Option<MavResult> {
        if raw.only_takes() {
            return Some(MavResult::ACCEPTED);
        }
        let setpoint =
            GimbalSetpoint { from: from.address(), is_secondary: !is_primary, flags: raw.flags, target: raw.target()? };
        increment(&mut self.counters.taken);
        cx.shared.has_acted = true;
        let (vehicle, mut context) = cx.hook();
        Some(vehicle.point_gimbal(&mut context, &setpoint))
    }

    /// Handles a setpoint in a message. Returns false if it is none.
    fn on_message<F: Firmware<Vehicle: GimbalManager>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        frame: &Frame<'_>,
        from: Who,
        is_broadcast: bool,
    ) -> bool {
        let mut raw = Raw::NEW;
        let Some(device) = raw.read_message(frame) else { return false };
        let counter = if is_broadcast {
            &mut self.counters.broadcast
        } else if device != 0 && device != F::Vehicle::DEVICE {
            &mut self.counters.other_device
        } else if !self.may_point(from) {
            &mut self.counters.not_in_control
        } else if self.set_point(cx, from, from == self.primary, &raw).is_none() {
            &mut self.counters.invalid
        } else {
            return true;
        };
        increment(counter);
        true
    }

    /// Handles a message of a remote device.
    fn on_device<F: Firmware<Vehicle: GimbalManager>>(&mut self, cx: &mut Cx<'_, F>, frame: &Frame<'_>) -> bool {
        let (vehicle, mut context) = cx.hook();
        if let Some(status) = &frame.decode::<GimbalDeviceAttitudeStatus>() {
            vehicle.device_moved(&mut context, status);
            return true;
        }
        let found = frame.id() == GimbalDeviceInformation::ID;
        if found {
            self.is_known = true;
            tell_found::<F>(vehicle, &mut context, frame);
        }
        found
    }

    /// Returns when a remote device gets its next setpoint, the vehicle's state, and a question. MAVLink 1 has neither of the first
    /// two (S-10).
    fn device_times(&self, port: &Port) -> [Instant; 3] {
        let is_v2 = port.outbox.takes(STATUS.id);
        let [setpoint_at, state_at] = if is_v2 { [self.setpoint_at, self.state_at] } else { [Instant::NEVER; 2] };
        [setpoint_at, state_at, if self.is_known { Instant::NEVER } else { self.ask_at }]
    }

    /// Sends the first thing that is due to a remote device, and that the vehicle has.
    fn send_to_device<F: Firmware<Vehicle: GimbalManager>>(&mut self, cx: &mut Cx<'_, F>, port: &mut Port) -> bool {
        let (target_system, target_component) = (cx.shared.config.address.get().system.wire(), F::Vehicle::DEVICE);
        let [setpoint_at, state_at, ask_at] = self.device_times(port);
        if setpoint_at <= cx.now {
            self.setpoint_at = cx.now + F::Vehicle::SETPOINT_INTERVAL;
            if let Some(setpoint) = cx.vehicle.device_setpoint(cx.shared.clock.shown(cx.now)) {
                let setpoint = GimbalDeviceSetAttitude { target_system, target_component, ..setpoint };
                return send::<F, _>(port, None, &setpoint);
            }
        }
        if state_at <= cx.now {
            self.state_at = cx.now + F::Vehicle::STATE_INTERVAL;
            if let Some(state) = cx.vehicle.autopilot_state(cx.shared.clock.shown(cx.now)) {
                let time_boot_us = cx.now.as_micros();
                let state = AutopilotStateForGimbalDevice { time_boot_us, target_system, target_component, ..state };
                return send::<F, _>(port, None, &state);
            }
        }
        if ask_at > cx.now {
            return false;
        }
        self.ask_at = cx.now + ASK_PERIOD;
        let param1 = num::f32_from_u32(GimbalDeviceInformation::ID);
        let command = MavCmd::REQUEST_MESSAGE;
        send::<F, _>(
            port,
            None,
            &CommandLong { param1, command, target_system, target_component, ..CommandLong::default() },
        )
    }
}

fn tell_found<F: Firmware<Vehicle: GimbalManager>>(
    vehicle: &mut F::Vehicle,
    context: &mut Context<'_>,
    frame: &Frame<'_>,
) {
    if let Some(information) = &frame.decode::<GimbalDeviceInformation>() {
        vehicle.device_found(context, information);
    }
}

/// Whether the remote device is alive, and this link is the first on which it was heard.
fn is_on<F: Firmware<Vehicle: GimbalManager>>(peers: &[PeerInfo], system: SystemId, link: LinkId) -> bool {
    living::<F>(peers, system) == Some(link)
}

/// Returns the first link on which the remote device is alive.
fn living<F: Firmware<Vehicle: GimbalManager>>(peers: &[PeerInfo], system: SystemId) -> Option<LinkId> {
    let address = Address { system, component: ComponentId::new(F::Vehicle::DEVICE) };
    peers.iter().find(|info| info.is_alive && info.peer.address == address).map(|info| info.peer.link)
}

/// Whether a command points or configures a gimbal.
const fn is_about_gimbal(command: MavCmd) -> bool {
    matches!(
        command,
        MavCmd::DO_GIMBAL_MANAGER_PITCHYAW
            | MavCmd::DO_GIMBAL_MANAGER_CONFIGURE
            | MavCmd::DO_SET_ROI_LOCATION
            | MavCmd::DO_SET_ROI_WPNEXT_OFFSET
            | MavCmd::DO_SET_ROI_NONE
            | MavCmd::DO_SET_ROI_SYSID
            | MavCmd::DO_SET_ROI
            | MavCmd::DO_MOUNT_CONFIGURE
            | MavCmd::DO_MOUNT_CONTROL
    )
}

impl Order {
    /// Whether it is about a gimbal.
    pub(crate) const fn is_about_gimbal(&self) -> bool {
        is_about_gimbal(self.id)
    }
}

impl ManagerLink {
    /// Whether a change of control was not reported yet, on a link that can.
    fn owes(&self, changes: u8, port: &Port) -> bool {
        self.changes != changes && port.outbox.takes(STATUS.id)
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
        changes: 0,
        told: 0,
        is_known: false,
        setpoint_at: Instant::ZERO,
        state_at: Instant::ZERO,
        ask_at: Instant::ZERO,
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
    const VACANT: ManagerLink = ManagerLink { status: StatusStream::NEW, changes: 0 };
    type Reply = ManagerReply;

    /// Tells the vehicle of a change. A device that has timed out may be another one when it reappears.
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut ManagerLink>) {
        if self.told != self.changes {
            self.told = self.changes;
            let control = self.control();
            let (vehicle, mut context) = cx.hook();
            vehicle.gimbal_control_changed(&mut context, &control);
        }
        if F::Vehicle::IS_REMOTE && self.is_known {
            self.is_known = living::<F>(cx.peers, cx.shared.config.address.get().system).is_some();
        }
    }

    fn deadline(&self) -> Instant {
        if self.told == self.changes { Instant::NEVER } else { Instant::ZERO }
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, _: &mut ManagerLink, received: &Received<'_>) -> Handled {
        let Received { frame, from, target, .. } = received;
        let own = cx.shared.config.address.get().system;
        let device = Address { system: own, component: ComponentId::new(F::Vehicle::DEVICE) };
        let is_of_device = F::Vehicle::IS_REMOTE && from.address == device;
        let is_handled = self.on_message(cx, frame, Who::new(from.address), target.system.is_all())
            || is_of_device && self.on_device(cx, frame);
        if is_handled { Handled::Yes } else { Handled::No }
    }

    fn on_command(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut ManagerLink,
        request: &Request,
    ) -> Option<Verdict> {
        let command = &request.command;
        if !is_about_gimbal(command.id) {
            return link.status.on_command(STATUS, port, command).map(Verdict::done);
        }
        let order = Order::of_command(command);
        if !is_for::<F>(&order) {
            // The vehicle may have another gimbal.
            return None;
        }
        Some(match self.carry_out(cx, Who::new(command.from.address), &order) {
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
        if link.owes(self.changes, port) && has_listener() {
            return Some((view.now, ManagerReply::Change));
        }
        if F::Vehicle::IS_REMOTE && is_on::<F>(view.peers, view.shared.config.address.get().system, port.id) {
            let [setpoint_at, state_at, ask_at] = self.device_times(port);
            return Some((setpoint_at.min(state_at).min(ask_at), ManagerReply::ForDevice));
        }
        None
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
            ManagerReply::ForDevice => return F::Vehicle::IS_REMOTE && self.send_to_device(cx, port),
            ManagerReply::Stream => {
                link.status.sent(cx.now, STATUS, port);
                port.facts.own_was_last = true;
            }
            ManagerReply::Asked(Asked::Message) | ManagerReply::Change => {}
        }
        link.changes = self.changes;
        link.status.forget(Asked::Message);
        self.send_status(cx, port)
    }

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.counters);
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        // What others have sent ends.
        if let StackEvent::NewOwner { own, owner } = event {
            let keep = |who: Who| if [own, owner].contains(&who.address().system) { who } else { NOBODY };
            self.assign(keep(self.primary), keep(self.secondary));
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

impl ManagerService {
    fn send_status<F: Firmware<Vehicle: GimbalManager>>(&self, cx: &Cx<'_, F>, port: &mut Port) -> bool {
        let [primary, secondary] = [self.primary, self.secondary].map(Who::address);
        let status = GimbalManagerStatus {
            time_boot_ms: cx.now.time_boot_ms(),
            flags: cx.vehicle.manager_flags(),
            gimbal_device_id: F::Vehicle::DEVICE,
            primary_control_sysid: primary.system.wire(),
            primary_control_compid: primary.component.wire(),
            secondary_control_sysid: secondary.system.wire(),
            secondary_control_compid: secondary.component.wire(),
        };
        send::<F, _>(port, None, &status)
    }
}
