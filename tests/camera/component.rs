//! A camera that is a component of the firmware with its own id, as ground stations expect it. Rules CAM-9, K-10, K-11.

use crate::shooter::{FLAGS, image};
use crate::support::*;
use mavstack::camera::Shot;
use mavstack::config::StreamProfile;
use mavstack::dialect::*;
use mavstack::ext_parameters::ExtValue;
use mavstack::message::ComponentId;
use mavstack::{
    Address, Camera, Command, CommandClient, CommandReply, Commands, Component, Components, Context, ExtParameters,
    LinkConfig, LinkId, Message, Outcome, OutgoingCommand, Recipient, Text, Vehicle, VehicleState,
};

const ID: ComponentId = ComponentId::new(100);

/// An autopilot whose camera is component 100.
#[derive(Default)]
struct Copter {
    iso: u8,
    own: Vec<MavCmd>,
    other: Vec<MavCmd>,
    replies: Vec<CommandReply>,
}

#[derive(mavstack::Stack)]
#[stack(
    vehicle: Copter,
    links: 2,
    components,
    command_client: { slots: 1 },
)]
struct Flying {
    camera: mavstack::camera::CameraControl<[mavstack::camera::Image; 2]>,
    ext_parameters: mavstack::ext_parameters::ExtParamServer,
}

impl Vehicle for Copter {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(false))
    }
}

impl Commands for Copter {
    fn command(&mut self, _: &mut Context<'_>, command: &Command) -> Outcome {
        self.own.push(command.id);
        MavResult::UNSUPPORTED.into()
    }
}

impl Components for Copter {
    const COMPONENTS: &'static [Component] = &[Component::new(ID, MavType::CAMERA)];

    fn component_command(&mut self, _: &mut Context<'_>, _: ComponentId, command: &Command) -> Outcome {
        self.other.push(command.id);
        MavResult::UNSUPPORTED.into()
    }
}

impl Camera for Copter {
    const COMPONENT: Option<ComponentId> = Some(ID);
    const FLAGS: CameraCapFlags = FLAGS;
    const VIDEO_STREAMS: u8 = 1;

    fn camera_information(&self, _: &mut CameraInformation) {}

    fn take_image(&mut self, cx: &mut Context<'_>, index: u32) -> Shot {
        Shot::Taken(image(cx.now(), index))
    }
}

impl ExtParameters for Copter {
    const COMPONENT: Option<ComponentId> = Some(ID);

    fn ext_param_count(&self) -> u16 {
        1
    }

    fn ext_param(&self, index: u16) -> Option<(&str, ExtValue<'_>)> {
        (index == 0).then_some(("CAM_ISO", ExtValue::U8(self.iso)))
    }

    fn set_ext_param(&mut self, _: &mut Context<'_>, _: u16, value: ExtValue<'_>, _: mavstack::Peer) -> ParamAck {
        if let ExtValue::U8(iso) = value {
            self.iso = iso;
        }
        ParamAck::ACCEPTED
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

type Site = World<2, Flying>;

fn site() -> Site {
    let uart = LinkConfig::uart(921_600).with_own_system(true).with_streams(StreamProfile::Off);
    Site::of(Setup { links: [uart; 2], ..Setup::new() })
}

/// Sends a command to a component. Returns the answer, and the component that has answered.
fn command(site: &mut Site, to: u8, command: MavCmd, params: [f32; 3]) -> (CommandAck, u8) {
    let [a, b, c] = params;
    let message = CommandLong { target_component: to, ..site.gcs[0].long(command, [a, b, c, 0.0, 0.0, 0.0, 0.0]) };
    let before = site.gcs[0].count_of::<CommandAck>();
    site.gcs[0].send(&message);
    assert!(site.run_until(millis(50), |site| site.gcs[0].count_of::<CommandAck>() > before), "no answer");
    let is_ack = |frame: &&Received| frame.header.id == CommandAck::ID;
    let frame = site.gcs[0].received.iter().rfind(is_ack).expect("an answer");
    (frame.decode().expect("it is one"), frame.header.source.component.wire())
}

/// The components that have sent an `M` on the first link.
fn senders<M: Message>(site: &Site) -> Vec<u8> {
    let frames = site.gcs[0].received.iter().filter(|frame| frame.header.id == M::ID);
    frames.map(|frame| frame.header.source.component.wire()).collect()
}

/// CAM-9, K-10: the camera has heartbeats, answers and messages of its own, without a camera id. 0 and its own id name it.
#[test]
fn camera_is_a_component() {
    let mut site = site();
    site.run_for(secs(1));
    assert!(senders::<Heartbeat>(&site).contains(&100));
    for (to, name) in [(100, 0.0), (100, 100.0), (0, f32::NAN)] {
        let (ack, by) = command(&mut site, to, MavCmd::IMAGE_START_CAPTURE, [name, 0.0, 1.0]);
        assert_eq!((ack.result, ack.result_param2, by), (MavResult::ACCEPTED, 0, 100), "to {to}");
        site.run_for(millis(20));
    }
    let (ack, _) = command(&mut site, 100, MavCmd::IMAGE_START_CAPTURE, [1.0, 0.0, 1.0]);
    assert_eq!(ack.result, MavResult::DENIED, "a camera of the autopilot");
    assert_eq!(senders::<CameraImageCaptured>(&site), [100; 3]);
    assert!(site.gcs[0].all::<CameraImageCaptured>().iter().all(|(_, image)| image.camera_id == 0));
    for id in [CameraInformation::ID, CameraSettings::ID, CameraCaptureStatus::ID, VideoStreamInformation::ID] {
        let (ack, by) = command(&mut site, 100, MavCmd::REQUEST_MESSAGE, [id as f32, f32::NAN, 0.0]);
        assert_eq!((ack.result, by), (MavResult::ACCEPTED, 100), "{id}");
        site.run_for(millis(20));
        let frame = site.gcs[0].received.iter().rfind(|frame| frame.header.id == id).expect("the message");
        assert_eq!(frame.header.source, Address::new(1, 100));
    }
    assert_eq!(site.gcs[0].all::<CameraInformation>()[0].1.camera_device_id, 0);
    // S-16: its frames are numbered by themselves.
    let own = site.gcs[0].received.iter().filter(|frame| frame.header.source.component == ID);
    let seqs: Vec<_> = own.map(|frame| frame.header.seq).collect();
    assert!(seqs.windows(2).all(|pair| pair[1] == pair[0].wrapping_add(1)), "{seqs:?}");
}

/// a request for a message that a component does not have is DENIED, as by the autopilot, and so is its interval. UNSUPPORTED
/// would say that the command is unknown.
#[test]
fn what_a_component_does_not_have_is_denied() {
    let mut site = site();
    for id in [Attitude::ID, AutopilotVersion::ID, ParamValue::ID, 9_999, 16_777_216] {
        for command_id in [MavCmd::REQUEST_MESSAGE, MavCmd::SET_MESSAGE_INTERVAL, MavCmd::GET_MESSAGE_INTERVAL] {
            let (ack, by) = command(&mut site, 100, command_id, [id as f32, 100_000.0, 0.0]);
            assert_eq!((ack.result, by), (MavResult::DENIED, 100), "{command_id:?} {id}");
        }
    }
    let (ack, by) = command(&mut site, 100, MavCmd::CAMERA_TRACK_POINT, [0.5; 3]);
    assert_eq!((ack.result, by), (MavResult::UNSUPPORTED, 100), "an unknown command");
}

/// CAM-9, R-1: commands to the autopilot reach the vehicle, and those that the camera does not have reach its component.
#[test]
fn commands_are_told_apart() {
    let mut site = site();
    let (ack, by) = command(&mut site, 1, MavCmd::IMAGE_START_CAPTURE, [0.0, 0.0, 1.0]);
    assert_eq!((ack.result, by), (MavResult::UNSUPPORTED, 1));
    let (ack, by) = command(&mut site, 100, MavCmd::CAMERA_TRACK_POINT, [0.5; 3]);
    assert_eq!((ack.result, by), (MavResult::UNSUPPORTED, 100));
    assert_eq!(site.vehicle.own, [MavCmd::IMAGE_START_CAPTURE]);
    assert_eq!(site.vehicle.other, [MavCmd::CAMERA_TRACK_POINT]);
    assert_eq!(site.stack.camera.image_count(), 0);
}

/// P-40 to P-42, K-10: the camera's parameters are those of its component.
#[test]
fn parameters_belong_to_the_component() {
    let mut site = site();
    for (target_component, expected) in [(1, 0), (100, 100)] {
        let (param_id, param_type) = (Text::new("CAM_ISO"), MavParamExtType::UINT8);
        let param_value = Text::from_wire([target_component; 128]);
        let set = ParamExtSet { target_system: 1, target_component, param_id, param_value, param_type };
        site.gcs[0].send(&set);
        site.gcs[0].send(&ParamExtRequestList { target_system: 1, target_component });
        site.gcs[0].send(&ParamExtRequestRead { param_index: 0, target_system: 1, target_component, param_id });
        site.run_for(millis(100));
        assert_eq!(site.vehicle.iso, expected);
    }
    assert_eq!((senders::<ParamExtAck>(&site), senders::<ParamExtValue>(&site)), (vec![100], vec![100; 2]));
}

/// K-11, CAM-4: the firmware's own client commands its camera inside the firmware.
#[test]
fn firmware_commands_its_camera() {
    let mut site = site();
    assert!(site.stack.send_command(Recipient::Type(MavType::CAMERA), 1));
    site.run_for(millis(50));
    assert_eq!(site.vehicle.replies, [CommandReply::Done { result: MavResult::ACCEPTED, result_param2: 0 }]);
    assert_eq!((site.stack.camera.image_count(), senders::<CommandLong>(&site)), (1, vec![]));
    assert_eq!(site.stack.link_counters(LinkId(0)).unwrap().unhandled, 0);
}
