//! The gimbal device, and the manager of one on a link: rules GIM-9 to GIM-11.

use crate::support::*;
use mavstack::config::{LinkClass, StreamProfile, TxVersion, VehicleAddress};
use mavstack::dialect::*;
use mavstack::gimbal::{Axes, DeviceCounters, DeviceSetpoint, GimbalSetpoint, GimbalTarget};
use mavstack::message::ComponentId;
use mavstack::{
    Address, Command, Commands, Component, Components, Config, Context, Duration, GimbalDevice, GimbalManager, Instant,
    LinkConfig, LinkId, Message, Outcome, Text, Vehicle, VehicleState,
};

const GIMBAL: Address = Address::new(1, 154);
const NAN: f32 = f32::NAN;

/// The firmware of a gimbal; `ID` is 0, and 1 for a gimbal that is attached to the autopilot.
struct Gimbal<const ID: u8> {
    status: Option<GimbalDeviceAttitudeStatus>,
    setpoints: Vec<DeviceSetpoint>,
}

impl<const ID: u8> Default for Gimbal<ID> {
    fn default() -> Self {
        Self { status: Some(status()), setpoints: Vec::new() }
    }
}

fn status() -> GimbalDeviceAttitudeStatus {
    GimbalDeviceAttitudeStatus {
        q: [1.0, 0.0, 0.0, 0.0],
        angular_velocity_y: 0.5,
        flags: GimbalDeviceFlags::YAW_IN_VEHICLE_FRAME,
        failure_flags: GimbalDeviceErrorFlags::AT_PITCH_LIMIT,
        ..GimbalDeviceAttitudeStatus::UNKNOWN
    }
}

impl<const ID: u8> Vehicle for Gimbal<ID> {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(false))
    }
}

impl<const ID: u8> Commands for Gimbal<ID> {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}

impl<const ID: u8> GimbalDevice for Gimbal<ID> {
    const ID: u8 = ID;
    const MANAGER: Option<ComponentId> = if ID == 0 { Some(ComponentId::new(1)) } else { None };

    fn device_information(&self) -> GimbalDeviceInformation {
        GimbalDeviceInformation { model_name: Text::new("Two axes"), cap_flags: 7, ..GimbalDeviceInformation::UNKNOWN }
    }

    fn device_status(&self) -> Option<GimbalDeviceAttitudeStatus> {
        self.status
    }

    fn set_device_attitude(&mut self, _: &mut Context<'_>, setpoint: &DeviceSetpoint) {
        self.setpoints.push(*setpoint);
    }
}

#[derive(mavstack::Stack)]
#[stack(vehicle: Gimbal<0>, links: 3)]
struct Device {
    gimbal_device: mavstack::gimbal::DeviceService,
}
#[derive(mavstack::Stack)]
#[stack(vehicle: Gimbal<1>, links: 3)]
struct Attached {
    gimbal_device: mavstack::gimbal::DeviceService,
}

type Far = World<3, Device>;

fn setup(address: Address, links: [LinkConfig; 3]) -> Setup<3> {
    let setup = Setup::new();
    let config = Config { address: VehicleAddress::new(address).expect("an address"), ..setup.config };
    Setup { config, links, ..setup }
}

fn links() -> [LinkConfig; 3] {
    let uart = LinkConfig::uart(57_600).with_own_system(true).with_streams(StreamProfile::Onboard);
    [uart, uart.with_class(LinkClass::HighLatency), uart.with_version(TxVersion::V1)]
}

fn send<D: mavstack::__private::Declares, M: Message>(world: &mut World<3, D>, link: u8, from: Address, message: &M) {
    let frame = world.gcs[usize::from(link)].frame_from(from, message);
    assert_eq!(world.stack.receive(world.clock.now(), LinkId(link), &frame, &mut world.vehicle), frame.len());
}

fn autopilot() -> Heartbeat {
    Heartbeat { r#type: MavType::QUADROTOR, autopilot: MavAutopilot::PX4, ..Gcs::heartbeat() }
}

fn heartbeat_of_gimbal() -> Heartbeat {
    Heartbeat { r#type: MavType::GIMBAL, ..Gcs::heartbeat() }
}

fn set_attitude() -> GimbalDeviceSetAttitude {
    GimbalDeviceSetAttitude { target_system: 1, target_component: 154, ..GimbalDeviceSetAttitude::UNKNOWN }
}

/// GIM-10, L-2, S-10: the status is sent ten times a second on each normal link that carries MAVLink 2, without a target. It names a
/// missing manager.
#[test]
fn status_is_streamed() {
    let mut world = Far::of(setup(GIMBAL, links()));
    world.run_for(millis(10_050));
    let counts = [0, 1, 2].map(|link: usize| world.gcs[link].count_of::<GimbalDeviceAttitudeStatus>());
    assert_eq!(counts, [101, 0, 0]);
    let expected = |status: &GimbalDeviceAttitudeStatus, failure_flags| {
        let time_boot_ms = status.time_boot_ms;
        GimbalDeviceAttitudeStatus { time_boot_ms, failure_flags, delta_yaw: NAN, ..self::status() }
    };
    let sent =
        |status: &GimbalDeviceAttitudeStatus| (status.q, status.flags, status.failure_flags, status.gimbal_device_id);
    let alone = GimbalDeviceErrorFlags::AT_PITCH_LIMIT.with(GimbalDeviceErrorFlags::NO_MANAGER);
    let (_, told) = world.gcs[0].take::<GimbalDeviceAttitudeStatus>().unwrap();
    assert_eq!(sent(&told), sent(&expected(&told, alone)));
    assert_eq!((told.target_system, told.target_component, told.gimbal_device_id), (0, 0, 0));

    send(&mut world, 0, Address::new(1, 1), &autopilot());
    world.run_for(secs(1));
    let (_, told) = *world.gcs[0].all::<GimbalDeviceAttitudeStatus>().last().unwrap();
    assert_eq!(sent(&told), sent(&expected(&told, GimbalDeviceErrorFlags::AT_PITCH_LIMIT)), "the manager is alive");
    world.run_for(secs(6));
    let (_, told) = *world.gcs[0].all::<GimbalDeviceAttitudeStatus>().last().unwrap();
    assert_eq!(told.failure_flags, alone, "it is lost");

    world.vehicle.status = None;
    world.gcs[0].forget();
    world.run_for(secs(1));
    assert_eq!(world.gcs[0].count_of::<GimbalDeviceAttitudeStatus>(), 0, "it is not known");
    let ask = [GimbalDeviceAttitudeStatus::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    for result in [MavResult::DENIED, MavResult::ACCEPTED] {
        let message = CommandLong { target_component: 154, ..world.gcs[0].long(MavCmd::REQUEST_MESSAGE, ask) };
        send(&mut world, 0, STATION, &message);
        assert_eq!(world.expect::<CommandAck>(0, millis(20)).result, result);
        world.vehicle.status = Some(status());
    }
}

/// GIM-10, Q-4: the interval is set on a link, and does not fill it.
#[test]
fn interval_of_the_status_is_set() {
    let mut world = Far::of(setup(GIMBAL, links()));
    for (micros, expected) in [(1_000.0, 50), (500_000.0, 2), (0.0, 10), (-1.0, 0)] {
        let params = [GimbalDeviceAttitudeStatus::ID as f32, micros, 0.0, 0.0, 0.0, 0.0, 0.0];
        let message = CommandLong { target_component: 0, ..world.gcs[0].long(MavCmd::SET_MESSAGE_INTERVAL, params) };
        send(&mut world, 0, STATION, &message);
        assert_eq!(world.expect::<CommandAck>(0, millis(20)).result, MavResult::ACCEPTED);
        world.gcs[0].forget();
        world.run_for(secs(1));
        let count = world.gcs[0].count_of::<GimbalDeviceAttitudeStatus>();
        assert!(count.abs_diff(expected) <= 1, "{micros} µs: {count}");
    }
}

/// GIM-10: the information is sent on request, also to one for every component of every system.
#[test]
fn information_is_sent_on_request() {
    let mut world = Far::of(setup(GIMBAL, links()));
    let ask = [GimbalDeviceInformation::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    for (target_system, target_component) in [(1, 154), (1, 0), (0, 0)] {
        let message = world.gcs[0].long(MavCmd::REQUEST_MESSAGE, ask);
        send(&mut world, 0, Address::new(1, 1), &CommandLong { target_system, target_component, ..message });
        let information: GimbalDeviceInformation = world.expect(0, millis(100));
        let name = information.model_name.as_str();
        assert_eq!((name, information.cap_flags, information.gimbal_device_id), (Some("Two axes"), 7, 0));
        assert_eq!(world.expect::<CommandAck>(0, millis(20)).result, MavResult::ACCEPTED);
    }
    let message = CommandLong { target_component: 154, ..world.gcs[2].long(MavCmd::REQUEST_MESSAGE, ask) };
    send(&mut world, 2, STATION, &message);
    assert_eq!(world.expect::<CommandAck>(2, millis(20)).result, MavResult::DENIED, "MAVLink 1");
}

/// GIM-10: a gimbal that is attached to the autopilot is named by its number, in the autopilot's messages. It follows no
/// frames, because its manager is in the same firmware.
#[test]
fn attached_gimbal_has_a_number() {
    let mut world = World::<3, Attached>::of(setup(VEHICLE, links()));
    let ask = [GimbalDeviceInformation::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let message = world.gcs[0].long(MavCmd::REQUEST_MESSAGE, ask);
    send(&mut world, 0, STATION, &message);
    assert_eq!(world.expect::<GimbalDeviceInformation>(0, millis(100)).gimbal_device_id, 1);
    let status: GimbalDeviceAttitudeStatus = world.expect(0, millis(200));
    assert_eq!((status.gimbal_device_id, status.failure_flags), (1, GimbalDeviceErrorFlags::AT_PITCH_LIMIT));
    for from in [STATION, Address::new(1, 191), Address::new(1, 154)] {
        send(&mut world, 0, from, &GimbalDeviceSetAttitude { target_component: 1, ..set_attitude() });
    }
    assert!(world.vehicle.setpoints.is_empty());
    assert_eq!(world.stack.gimbal_device.counters().not_manager, 3);
}

/// GIM-11: only the manager's setpoints are followed, and only valid ones.
#[test]
fn device_follows_its_manager() {
    let mut world = Far::of(setup(GIMBAL, links()));
    let manager = Address::new(1, 1);
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let flags = GimbalDeviceFlags::PITCH_LOCK.with(GimbalDeviceFlags::YAW_LOCK);
    let down = GimbalDeviceSetAttitude { q: [half, 0.0, -half, 0.0], flags, ..set_attitude() };
    for from in [STATION, Address::new(1, 191), Address::new(2, 1), Address::new(1, 0)] {
        send(&mut world, 0, from, &down);
    }
    send(&mut world, 0, manager, &GimbalDeviceSetAttitude { target_system: 0, ..down });
    send(&mut world, 0, manager, &GimbalDeviceSetAttitude { target_component: 171, ..down });
    assert!(world.vehicle.setpoints.is_empty());

    send(&mut world, 0, manager, &down);
    // PX4 does not know the component yet.
    let rates =
        GimbalDeviceSetAttitude { q: [NAN; 4], angular_velocity_z: -0.5, target_component: 0, ..set_attitude() };
    send(&mut world, 0, manager, &rates);
    for bad in [
        GimbalDeviceSetAttitude { q: [0.0; 4], ..down },
        GimbalDeviceSetAttitude { q: [NAN, 1.0, 0.0, 0.0], ..down },
        GimbalDeviceSetAttitude { angular_velocity_x: f32::INFINITY, ..down },
        GimbalDeviceSetAttitude { flags: GimbalDeviceFlags(96), ..down },
    ] {
        send(&mut world, 0, manager, &bad);
    }
    let [first, second] = world.vehicle.setpoints[..] else { panic!("{:?}", world.vehicle.setpoints) };
    assert_eq!(
        first,
        DeviceSetpoint { flags, attitude: Some([half, 0.0, -half, 0.0]), rates: Axes::new(None, None, None) }
    );
    let flags = GimbalDeviceFlags::EMPTY;
    assert_eq!(second, DeviceSetpoint { flags, attitude: None, rates: Axes::new(None, None, Some(-0.5)) });
    assert!(first.is_yaw_in_earth_frame() && !second.is_yaw_in_earth_frame());
    let expected = counted(|counters: &mut DeviceCounters| {
        (counters.taken, counters.not_manager, counters.invalid) = (2, 5, 4);
    });
    assert_eq!(world.stack.gimbal_device.counters(), expected);
}

/// An autopilot with a gimbal that is a component of its own, and its manager.
#[derive(Default)]
struct Both {
    pitch: Option<f32>,
}

plain_vehicle!(Both);

impl Components for Both {
    const COMPONENTS: &'static [Component] = &[Component::new(GIMBAL.component, MavType::GIMBAL)];
}

impl GimbalManager for Both {
    const DEVICE: u8 = 154;

    fn manager_information(&self) -> GimbalManagerInformation {
        GimbalManagerInformation::default()
    }

    fn manager_flags(&self) -> GimbalManagerFlags {
        GimbalManagerFlags::EMPTY
    }

    fn point_gimbal(&mut self, _: &mut Context<'_>, setpoint: &GimbalSetpoint) -> MavResult {
        let GimbalTarget::Angles { angles, .. } = setpoint.target else { return MavResult::DENIED };
        self.pitch = angles.pitch();
        MavResult::ACCEPTED
    }
}

impl GimbalDevice for Both {
    const COMPONENT: Option<ComponentId> = Some(GIMBAL.component);
    const MANAGER: Option<ComponentId> = None;

    fn device_information(&self) -> GimbalDeviceInformation {
        GimbalDeviceInformation::default()
    }

    fn device_status(&self) -> Option<GimbalDeviceAttitudeStatus> {
        Some(status())
    }
}

#[derive(mavstack::Stack)]
#[stack(vehicle: Both, links: 3, components)]
struct Whole {
    gimbal_manager: mavstack::gimbal::ManagerService,
    gimbal_device: mavstack::gimbal::DeviceService,
}

/// GIM-10, GIM-4, K-10: manager and device in one firmware. The device's messages and answers come from its own component, the manager's
/// from the autopilot. A setpoint moves the gimbal, and leaves on no link.
#[test]
fn manager_and_device_in_one_firmware() {
    let mut world = World::<3, Whole>::of(setup(
        VEHICLE,
        [LinkConfig::uart(115_200).with_own_system(true).with_streams(StreamProfile::Onboard); 3],
    ));
    let ask = |id: u32| [id as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    for (id, target_component, sender) in [
        (GimbalDeviceInformation::ID, 154, GIMBAL),
        (GimbalDeviceInformation::ID, 0, GIMBAL),
        (GimbalDeviceAttitudeStatus::ID, 154, GIMBAL),
        (GimbalManagerInformation::ID, 1, VEHICLE),
        (GimbalManagerInformation::ID, 0, VEHICLE),
    ] {
        world.gcs[0].forget();
        let message = CommandLong { target_component, ..world.gcs[0].long(MavCmd::REQUEST_MESSAGE, ask(id)) };
        send(&mut world, 0, STATION, &message);
        world.run_for(millis(50));
        let from = |id: u32| {
            let frame = world.gcs[0].received.iter().find(|frame| frame.header.id == id);
            frame.map(|frame| frame.header.source)
        };
        assert_eq!((from(id), from(CommandAck::ID)), (Some(sender), Some(sender)), "{id} of {target_component}");
        let (_, ack) = world.gcs[0].take::<CommandAck>().unwrap();
        assert_eq!(ack.result, MavResult::ACCEPTED);
    }
    // The other component has no such message.
    for (id, target_component) in [(GimbalDeviceInformation::ID, 1), (GimbalManagerInformation::ID, 154)] {
        let message = CommandLong { target_component, ..world.gcs[0].long(MavCmd::REQUEST_MESSAGE, ask(id)) };
        send(&mut world, 0, STATION, &message);
        assert_ne!(world.expect::<CommandAck>(0, millis(50)).result, MavResult::ACCEPTED);
    }
    world.gcs.iter_mut().for_each(Gcs::forget);
    for (id, params) in [
        (MavCmd::DO_GIMBAL_MANAGER_CONFIGURE, [255.0, 190.0, -1.0, -1.0, 0.0, 0.0, 154.0]),
        (MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, [-45.0, NAN, NAN, NAN, 0.0, 0.0, 154.0]),
    ] {
        let message = world.gcs[0].long(id, params);
        send(&mut world, 0, STATION, &message);
        assert_eq!(world.expect::<CommandAck>(0, millis(50)).result, MavResult::ACCEPTED);
    }
    assert_eq!(world.vehicle.pitch, Some((-45.0_f32).to_radians()));
    // The autopilot's address is ours, so nobody else is the manager.
    send(&mut world, 0, STATION, &set_attitude());
    world.run_for(secs(1));
    assert_eq!(world.stack.gimbal_device.counters().not_manager, 1);
    for gcs in &world.gcs {
        assert_eq!(gcs.count_of::<GimbalDeviceSetAttitude>(), 0);
        let statuses = gcs.received.iter().filter(|frame| frame.header.id == GimbalDeviceAttitudeStatus::ID);
        let sources: Vec<_> = statuses.map(|frame| frame.header.source).collect();
        assert!(sources.len() >= 9 && sources.iter().all(|source| *source == GIMBAL), "{sources:?}");
    }
}

/// An autopilot with a gimbal on a link.
struct Autopilot {
    setpoint: Option<GimbalDeviceSetAttitude>,
    moved: u32,
    found: Vec<GimbalDeviceInformation>,
}

impl Default for Autopilot {
    fn default() -> Self {
        let setpoint = GimbalDeviceSetAttitude { q: [1.0, 0.0, 0.0, 0.0], ..GimbalDeviceSetAttitude::UNKNOWN };
        Self { setpoint: Some(setpoint), moved: 0, found: Vec::new() }
    }
}

plain_vehicle!(Autopilot);

impl GimbalManager for Autopilot {
    const DEVICE: u8 = 154;
    const IS_REMOTE: bool = true;
    const STATE_INTERVAL: Duration = Duration::from_millis(100);

    fn manager_information(&self) -> GimbalManagerInformation {
        GimbalManagerInformation::default()
    }

    fn manager_flags(&self) -> GimbalManagerFlags {
        GimbalManagerFlags::EMPTY
    }

    fn point_gimbal(&mut self, _: &mut Context<'_>, _: &GimbalSetpoint) -> MavResult {
        MavResult::ACCEPTED
    }

    fn device_setpoint(&mut self, _: Instant) -> Option<GimbalDeviceSetAttitude> {
        self.setpoint
    }

    fn autopilot_state(&mut self, _: Instant) -> Option<AutopilotStateForGimbalDevice> {
        Some(AutopilotStateForGimbalDevice { vx: 7.0, ..AutopilotStateForGimbalDevice::UNKNOWN })
    }

    fn device_moved(&mut self, _: &mut Context<'_>, _: &GimbalDeviceAttitudeStatus) {
        self.moved += 1;
    }

    fn device_found(&mut self, _: &mut Context<'_>, information: &GimbalDeviceInformation) {
        self.found.push(*information);
    }
}

#[derive(mavstack::Stack)]
#[stack(vehicle: Autopilot, links: 3)]
struct Managing {
    gimbal_manager: mavstack::gimbal::ManagerService,
}

type Near = World<3, Managing>;

/// What each link got: setpoints, states, questions.
fn sent(world: &Near) -> [[usize; 3]; 3] {
    [0, 1, 2].map(|link: usize| {
        let gcs = &world.gcs[link];
        let counts = (gcs.count_of::<GimbalDeviceSetAttitude>(), gcs.count_of::<AutopilotStateForGimbalDevice>());
        [counts.0, counts.1, gcs.count_of::<CommandLong>()]
    })
}

/// Runs for a second, and returns what each link got in it.
fn second(world: &mut Near) -> [[usize; 3]; 3] {
    world.gcs.iter_mut().for_each(Gcs::forget);
    world.run_for(secs(1));
    sent(world)
}

/// GIM-9: a gimbal device on a link is asked every second until it has answered. It gets its setpoints and the vehicle's state while it is
/// alive, on the first of its links.
#[test]
fn remote_device_is_driven_while_it_is_alive() {
    let uart = LinkConfig::uart(115_200).with_own_system(true).with_streams(StreamProfile::Off);
    let mut world = Near::of(setup(VEHICLE, [uart; 3]));
    send(&mut world, 0, STATION, &Gcs::heartbeat());
    assert_eq!(second(&mut world), [[0; 3]; 3], "there is none");
    send(&mut world, 1, GIMBAL, &heartbeat_of_gimbal());
    send(&mut world, 2, GIMBAL, &heartbeat_of_gimbal());
    let [none, [setpoints, states, asked], other] = second(&mut world);
    assert_eq!((none, other), ([0; 3], [0; 3]));
    assert!(
        (19..=21).contains(&setpoints) && (9..=11).contains(&states) && (1..=2).contains(&asked),
        "{setpoints} {states} {asked}"
    );
    let (_, setpoint) = world.gcs[1].take::<GimbalDeviceSetAttitude>().unwrap();
    assert_eq!((setpoint.q, setpoint.target_system, setpoint.target_component), ([1.0, 0.0, 0.0, 0.0], 1, 154));
    let (at, state) = world.gcs[1].take::<AutopilotStateForGimbalDevice>().unwrap();
    assert_eq!((state.vx, state.target_system, state.target_component), (7.0, 1, 154));
    assert!(at.as_micros().abs_diff(state.time_boot_us) < 10_000);
    let (_, question) = world.gcs[1].take::<CommandLong>().unwrap();
    let asked = (question.command, question.param1, question.target_system, question.target_component);
    assert_eq!(asked, (MavCmd::REQUEST_MESSAGE, GimbalDeviceInformation::ID as f32, 1, 154));

    // The first answer is lost. It is not asked again after the second.
    assert_eq!(second(&mut world)[1][2], 1);
    let information = GimbalDeviceInformation { cap_flags: 5, ..GimbalDeviceInformation::UNKNOWN };
    // Not of somebody else.
    send(&mut world, 1, Address::new(1, 171), &information);
    send(&mut world, 1, Address::new(2, 154), &information);
    assert!(world.vehicle.found.is_empty());
    send(&mut world, 1, GIMBAL, &information);
    assert_eq!(world.vehicle.found.iter().map(|information| information.cap_flags).collect::<Vec<_>>(), [5]);
    send(&mut world, 1, GIMBAL, &heartbeat_of_gimbal());
    assert_eq!(second(&mut world)[1][2], 0);

    world.vehicle.setpoint = None;
    assert_eq!(second(&mut world)[1][0], 0, "there is nothing to do");
    // It is silent: after five seconds it is lost, and gets nothing.
    world.run_for(secs(5));
    assert_eq!(second(&mut world), [[0; 3]; 3]);
    // It is back on another link: it is asked again, once at least.
    send(&mut world, 2, GIMBAL, &heartbeat_of_gimbal());
    let [first, old, new] = second(&mut world);
    assert_eq!((first, old), ([0; 3], [0; 3]));
    assert!(new[1] >= 9 && new[2] >= 1, "{new:?}");
}

/// GIM-9: the status of the device reaches the vehicle, and that of another component does not.
#[test]
fn status_of_a_remote_device_is_followed() {
    let mut world = Near::of(setup(VEHICLE, [LinkConfig::uart(115_200).with_own_system(true); 3]));
    for from in [GIMBAL, Address::new(1, 171), Address::new(2, 154), STATION] {
        send(&mut world, 1, from, &status());
    }
    assert_eq!(world.vehicle.moved, 1);
}

/// X-1, GIM-9: the gimbal is on a private wire. A radio that sends HEARTBEATs and attitudes in its name moved it 10 times of 10, and now
/// never does; the wire does 10 times of 10.
#[test]
fn attitude_of_a_gimbal_on_a_private_wire() {
    let radio = LinkConfig::uart(57_600).with_streams(StreamProfile::Off);
    let mut world = Near::of(setup(VEHICLE, [radio, radio.with_class(LinkClass::Private), radio]));
    for (link, moved) in [(0, 0), (1, 10), (0, 10)] {
        for _ in 0..10 {
            send(&mut world, link, GIMBAL, &heartbeat_of_gimbal());
            send(&mut world, link, GIMBAL, &status());
            world.run_for(millis(100));
        }
        assert_eq!(world.vehicle.moved, moved, "link {link}");
    }
    // Setpoints go to the wire only.
    let [[radio, ..], [wire, ..], [other, ..]] = second(&mut world);
    assert!(radio == 0 && other == 0 && wire > 0, "{radio} {wire} {other}");
}

/// GIM-9, S-10, L-2: nothing is sent to a device that is heard by MAVLink 1 only, except the question, and nothing on a high-latency link.
#[test]
fn remote_device_needs_a_link_that_can() {
    let uart = LinkConfig::uart(115_200).with_own_system(true).with_streams(StreamProfile::Off);
    let links = [uart.with_class(LinkClass::HighLatency), uart.with_version(TxVersion::V1), uart];
    let mut world = Near::of(setup(VEHICLE, links));
    send(&mut world, 0, GIMBAL, &heartbeat_of_gimbal());
    assert_eq!(second(&mut world), [[0; 3]; 3]);
    send(&mut world, 1, GIMBAL, &heartbeat_of_gimbal());
    let [expensive, [setpoints, states, questions], other] = second(&mut world);
    assert_eq!((expensive, other, setpoints, states), ([0; 3], [0; 3], 0, 0));
    assert!(questions >= 1);
}
