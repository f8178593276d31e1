//! A firmware that runs without its other components: rules K-10, K-11, and H-1, Q-1, Q-9, R-2, R-8 for it.

use std::collections::BTreeSet;

use crate::support::*;
use mavstack::camera::Shot;
use mavstack::dialect::*;
use mavstack::ext_parameters::ExtValue;
use mavstack::gimbal::GimbalSetpoint;
use mavstack::message::ComponentId;
use mavstack::{
    Address, Camera, Command, CommandClient, CommandReply, Commands, Component, Components, Context, ExtParameters,
    GimbalDevice, GimbalManager, Message, Outcome, OutgoingCommand, Vehicle, VehicleState,
};

const GIMBAL: Address = Address::new(1, 154);
const CAMERA: Address = Address::new(1, 100);

/// An autopilot with a gimbal and a camera, which may be left out.
#[derive(Default)]
struct Copter {
    own: Vec<MavCmd>,
    other: Vec<MavCmd>,
    replies: Vec<CommandReply>,
}

#[derive(mavstack::Stack)]
#[stack(
    vehicle: Copter,
    links: 2,
    components,
    command_client: { slots: 2 },
    forwarding,
)]
struct Optional {
    gimbal_manager: mavstack::gimbal::ManagerService,
    gimbal_device: mavstack::gimbal::DeviceService,
    camera: mavstack::camera::CameraControl<[mavstack::camera::Image; 2]>,
    ext_parameters: mavstack::ext_parameters::ExtParamServer,
}

impl Vehicle for Copter {
    fn state(&self) -> Option<VehicleState> {
        TestVehicle::new().state
    }
}

impl Commands for Copter {
    fn command(&mut self, _: &mut Context<'_>, command: &Command) -> Outcome {
        self.own.push(command.id);
        MavResult::UNSUPPORTED.into()
    }
}

impl Components for Copter {
    const COMPONENTS: &'static [Component] =
        &[Component::new(GIMBAL.component, MavType::GIMBAL), Component::new(CAMERA.component, MavType::CAMERA)];
    const OPTIONAL: bool = true;

    fn component_command(&mut self, _: &mut Context<'_>, _: ComponentId, command: &Command) -> Outcome {
        self.other.push(command.id);
        MavResult::UNSUPPORTED.into()
    }
}

impl Camera for Copter {
    const COMPONENT: Option<ComponentId> = Some(CAMERA.component);
    const FLAGS: CameraCapFlags = CameraCapFlags::CAPTURE_IMAGE;

    fn camera_information(&self, _: &mut CameraInformation) {}

    fn take_image(&mut self, _: &mut Context<'_>, _: u32) -> Shot {
        Shot::Failed
    }
}

impl ExtParameters for Copter {
    const COMPONENT: Option<ComponentId> = Some(CAMERA.component);

    fn ext_param_count(&self) -> u16 {
        1
    }

    fn ext_param(&self, index: u16) -> Option<(&str, ExtValue<'_>)> {
        (index == 0).then_some(("CAM_ISO", ExtValue::U8(1)))
    }

    fn set_ext_param(&mut self, _: &mut Context<'_>, _: u16, _: ExtValue<'_>, _: mavstack::Peer) -> ParamAck {
        ParamAck::ACCEPTED
    }
}

impl GimbalManager for Copter {
    const DEVICE: u8 = GIMBAL.component.wire();

    fn manager_information(&self) -> GimbalManagerInformation {
        GimbalManagerInformation::default()
    }

    fn manager_flags(&self) -> GimbalManagerFlags {
        GimbalManagerFlags::EMPTY
    }

    fn point_gimbal(&mut self, _: &mut Context<'_>, _: &GimbalSetpoint) -> MavResult {
        MavResult::ACCEPTED
    }
}

impl GimbalDevice for Copter {
    const COMPONENT: Option<ComponentId> = Some(GIMBAL.component);
    const MANAGER: Option<ComponentId> = None;

    fn device_information(&self) -> GimbalDeviceInformation {
        GimbalDeviceInformation::UNKNOWN
    }

    fn device_status(&self) -> Option<GimbalDeviceAttitudeStatus> {
        Some(GimbalDeviceAttitudeStatus::UNKNOWN)
    }
}

impl CommandClient for Copter {
    fn command_for(&mut self, _: u16) -> Option<OutgoingCommand> {
        Some(OutgoingCommand::long(MavCmd::IMAGE_START_CAPTURE, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]))
    }

    fn command_answered(&mut self, _: &mut Context<'_>, _: u16, reply: CommandReply) {
        self.replies.push(reply);
    }
}

type Site = World<2, Optional>;

fn site(is_alone: bool) -> Site {
    let mut site = Site::of(Setup::new());
    if is_alone {
        site.stack.leave_out_components();
    }
    site.run_for(secs(1));
    site
}

/// Who has sent what on the first link: the components, and the ids of their messages.
fn heard(site: &Site) -> BTreeSet<(u8, u32)> {
    site.gcs[0].received.iter().map(|frame| (frame.header.source.component.wire(), frame.header.id)).collect()
}

/// Sends a command to a component of the vehicle's system. Returns who has answered what.
fn command(site: &mut Site, to: u8, command: MavCmd, param: f32) -> Vec<(u8, MavResult)> {
    site.gcs[0].forget();
    let params = [param, f32::NAN, f32::NAN, 0.0, 0.0, 0.0, 0.0];
    let message = CommandLong { target_component: to, ..site.gcs[0].long(command, params) };
    site.gcs[0].send(&message);
    site.run_for(millis(100));
    let acks = site.gcs[0].received.iter();
    let acks = acks.filter_map(|frame| Some((frame.header.source.component.wire(), frame.decode::<CommandAck>()?)));
    acks.map(|(from, ack)| (from, ack.result)).collect()
}

fn request<M: Message>(site: &mut Site, to: u8) -> Vec<(u8, MavResult)> {
    command(site, to, MavCmd::REQUEST_MESSAGE, M::ID as f32)
}

/// K-10, H-1: only the autopilot sends. By default all components do.
#[test]
fn left_out_components_are_silent() {
    let mut site = site(false);
    site.run_for(secs(10));
    let heard_by_default = heard(&site);
    for sent in [
        (154, Heartbeat::ID),
        (100, Heartbeat::ID),
        (154, GimbalDeviceAttitudeStatus::ID),
        (1, GimbalManagerStatus::ID),
    ] {
        assert!(heard_by_default.contains(&sent), "{sent:?}");
    }
    let mut site = self::site(true);
    site.run_for(secs(20));
    assert_eq!(heard(&site), BTreeSet::from([(1, Heartbeat::ID)]));
    assert_eq!(site.gcs[0].count_of::<Heartbeat>(), 22, "those of the autopilot");
    assert!(site.stack.next_deadline(site.now()) > site.now(), "nothing is pending");
}

/// K-10, C-3, Q-1: what is sent to a left-out component has no answer. The autopilot handles what is sent to all components, or is
/// about them, as a vehicle without them.
#[test]
fn left_out_components_have_no_commands() {
    let mut site = site(true);
    for to in [100, 154] {
        for id in [MavCmd::USER_1, MavCmd::IMAGE_START_CAPTURE, MavCmd::DO_GIMBAL_MANAGER_PITCHYAW] {
            assert_eq!(command(&mut site, to, id, 0.0), [], "{id:?} to {to}");
        }
        assert_eq!(request::<Heartbeat>(&mut site, to), []);
        assert_eq!(request::<CameraInformation>(&mut site, to), []);
    }
    for to in [0, 1] {
        for id in [MavCmd::IMAGE_START_CAPTURE, MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, MavCmd::DO_SET_ROI_NONE] {
            assert_eq!(command(&mut site, to, id, 0.0), [(1, MavResult::UNSUPPORTED)], "{id:?} to {to}");
        }
        for answer in [
            request::<CameraInformation>(&mut site, to),
            request::<GimbalManagerInformation>(&mut site, to),
            request::<GimbalDeviceAttitudeStatus>(&mut site, to),
        ] {
            assert_eq!(answer, [(1, MavResult::DENIED)], "to {to}");
        }
        let list = ParamExtRequestList { target_system: 1, target_component: to };
        site.gcs[0].forget();
        site.gcs[0].send(&list);
        site.gcs[0].send(&ParamExtRequestList { target_component: 100, ..list });
        site.run_for(secs(1));
        assert_eq!(site.gcs[0].count_of::<ParamExtValue>(), 0);
    }
    assert_eq!(site.vehicle.own.len(), 6, "{:?}", site.vehicle.own);
    assert_eq!(site.vehicle.other, []);
}

/// the vehicle has no gimbal manager then.
#[test]
fn left_out_components_take_their_capabilities_with_them() {
    let capabilities = |is_alone: bool| {
        let mut site = site(is_alone);
        assert_eq!(request::<AutopilotVersion>(&mut site, 1), [(1, MavResult::ACCEPTED)]);
        site.gcs[0].take::<AutopilotVersion>().expect("it was sent").1.capabilities
    };
    let manager = MavProtocolCapability::COMPONENT_IMPLEMENTS_GIMBAL_MANAGER;
    assert_eq!(capabilities(true).with(manager), capabilities(false));
    assert!(!capabilities(true).contains(manager));
}

/// K-11: another device may have the address of a left-out component.
#[test]
fn the_address_of_a_left_out_component_is_free() {
    let mut site = site(true);
    let camera = Heartbeat { r#type: MavType::CAMERA, autopilot: MavAutopilot::INVALID, ..Heartbeat::default() };
    site.gcs[1].send_from(CAMERA, &camera);
    site.run_for(millis(100));
    let message = CommandLong { target_component: 100, ..site.gcs[0].long(MavCmd::USER_1, [0.0; 7]) };
    site.gcs[0].send(&message);
    site.run_for(millis(100));
    assert_eq!(site.gcs[1].count_of::<CommandLong>(), 1, "it is forwarded");
    assert_eq!(site.gcs[0].count_of::<Statustext>(), 0, "no conflict is reported");
    assert!(site.stack.peers(site.now()).any(|info| info.peer.address == CAMERA && info.is_alive));
    assert!(site.stack.send_command(CAMERA, 0));
    site.run_for(millis(100));
    assert_eq!(site.gcs[1].count_of::<CommandLong>(), 2, "the vehicle's own command leaves on the link");
    assert!(site.stack.send_command(GIMBAL, 0));
    site.run_for(millis(100));
    assert_eq!(site.vehicle.replies, [CommandReply::NotSent], "no gimbal is there");
}
