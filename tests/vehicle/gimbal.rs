//! The gimbal manager: rules GIM-1 to GIM-6 and GIM-8. `gimbal_control` has the vehicle's own items, takeovers and single links,
//! `gimbal_device` the device behind it and the device's own side.

use crate::support::*;
use mavstack::config::{LinkClass, StreamProfile, TxVersion};
use mavstack::dialect::*;
use mavstack::gimbal::{Axes, GimbalControl, GimbalSetpoint, GimbalTarget, ManagerCounters};
use mavstack::message::{LatLon, SystemId};
use mavstack::{
    Address, Command, Commands, Context, GimbalManager, LinkConfig, LinkId, Message, Outcome, Vehicle, VehicleState,
};
use std::f32::consts::PI;

/// A vehicle with a gimbal without MAVLink.
pub struct Carrier {
    pub test: TestVehicle,
    pub pointed: Vec<GimbalSetpoint>,
    pub changes: Vec<GimbalControl>,
    pub verdict: MavResult,
    pub flags: GimbalManagerFlags,
}

impl Default for Carrier {
    fn default() -> Self {
        Self {
            test: TestVehicle::new(),
            pointed: Vec::new(),
            changes: Vec::new(),
            verdict: MavResult::ACCEPTED,
            flags: GimbalManagerFlags::PITCH_LOCK,
        }
    }
}

impl Vehicle for Carrier {
    fn state(&self) -> Option<VehicleState> {
        self.test.state()
    }
}

impl Commands for Carrier {
    fn command(&mut self, cx: &mut Context<'_>, command: &Command) -> Outcome {
        self.test.command(cx, command)
    }
}

impl GimbalManager for Carrier {
    const DEVICE: u8 = 1;

    fn manager_information(&self) -> GimbalManagerInformation {
        GimbalManagerInformation {
            cap_flags: GimbalManagerCapFlags::HAS_PITCH_AXIS,
            pitch_min: -1.5,
            pitch_max: 0.5,
            // What the stack sets itself.
            time_boot_ms: 99,
            gimbal_device_id: 99,
            ..GimbalManagerInformation::default()
        }
    }

    fn manager_flags(&self) -> GimbalManagerFlags {
        self.flags
    }

    fn point_gimbal(&mut self, _: &mut Context<'_>, setpoint: &GimbalSetpoint) -> MavResult {
        self.pointed.push(*setpoint);
        self.verdict
    }

    fn gimbal_control_changed(&mut self, _: &mut Context<'_>, control: &GimbalControl) {
        self.changes.push(*control);
    }
}

#[derive(mavstack::Stack)]
#[stack(vehicle: Carrier, links: 3, operator_control)]
pub struct Managed {
    pub gimbal_manager: mavstack::gimbal::ManagerService,
}

pub type Carried = World<3, Managed>;

/// Two normal links without streams by default, and one that carries MAVLink 1.
pub fn world() -> Carried {
    let uart = LinkConfig::uart(921_600).with_own_system(true).with_streams(StreamProfile::Off);
    let mut world = Carried::of(Setup { links: [uart, uart, uart.with_version(TxVersion::V1)], ..Setup::new() });
    world.gcs.iter_mut().for_each(|gcs| gcs.takes_unknown = true);
    world.run_for(millis(20));
    world
}

/// Receives `message` now.
pub fn send<M: Message>(world: &mut Carried, link: u8, from: Address, message: &M) {
    let frame = world.gcs[usize::from(link)].frame_from(from, message);
    assert_eq!(world.stack.receive(world.clock.now(), LinkId(link), &frame, &mut world.vehicle), frame.len());
}

/// Sends a command, and returns its result.
pub fn command(world: &mut Carried, from: Address, command: MavCmd, params: [f32; 7]) -> MavResult {
    let message = world.gcs[0].long(command, params);
    send(world, 0, from, &message);
    answer(world, from, command)
}

/// Sends a COMMAND_INT, and returns its result.
fn command_int(world: &mut Carried, from: Address, message: &CommandInt) -> MavResult {
    let message = CommandInt { target_system: 1, target_component: 1, ..*message };
    send(world, 0, from, &message);
    answer(world, from, message.command)
}

fn answer(world: &mut Carried, from: Address, command: MavCmd) -> MavResult {
    world.run_for(millis(20));
    let acks = world.gcs[0].all::<CommandAck>();
    let (_, ack) = acks.last().expect("an answer");
    assert_eq!(
        (ack.command, ack.target_system, ack.target_component),
        (command, from.system.wire(), from.component.wire())
    );
    ack.result
}

/// Sends MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE.
pub fn configure(world: &mut Carried, from: Address, [a, b, c, d]: [i16; 4]) -> MavResult {
    let [a, b, c, d] = [a, b, c, d].map(f32::from);
    command(world, from, MavCmd::DO_GIMBAL_MANAGER_CONFIGURE, [a, b, c, d, 0.0, 0.0, 0.0])
}

/// Gives a sender primary control.
pub fn take(world: &mut Carried, from: Address) {
    let (system, component) = (i16::from(from.system.wire()), i16::from(from.component.wire()));
    assert_eq!(configure(world, from, [system, component, -1, -1]), MavResult::ACCEPTED);
}

pub fn control(world: &Carried) -> [Option<Address>; 2] {
    let GimbalControl { primary, secondary } = world.stack.gimbal_manager.control();
    [primary, secondary]
}

fn counters(world: &Carried) -> ManagerCounters {
    world.stack.gimbal_manager.counters()
}

/// The target of the last setpoint that the vehicle got, and the number of all.
pub fn last(world: &Carried) -> (usize, Option<GimbalTarget>) {
    (world.vehicle.pointed.len(), world.vehicle.pointed.last().map(|setpoint| setpoint.target))
}

pub fn axes([roll, pitch, yaw]: [Option<f32>; 3]) -> Axes {
    Axes::new(roll, pitch, yaw)
}

pub fn angles(angles: [Option<f32>; 3], rates: [Option<f32>; 3]) -> GimbalTarget {
    GimbalTarget::Angles { angles: axes(angles), rates: axes(rates) }
}

pub fn next_waypoint(offsets: [Option<f32>; 3]) -> GimbalTarget {
    GimbalTarget::NextWaypoint { offsets: axes(offsets) }
}

pub const NAN: f32 = f32::NAN;
pub const PITCH_YAW: MavCmd = MavCmd::DO_GIMBAL_MANAGER_PITCHYAW;
pub const DOWN: [f32; 7] = [-90.0, NAN, NAN, NAN, 0.0, 0.0, 0.0];

pub fn pitch_yaw(pitch: f32) -> GimbalManagerSetPitchyaw {
    GimbalManagerSetPitchyaw { pitch, target_system: 1, target_component: 1, ..GimbalManagerSetPitchyaw::UNKNOWN }
}

/// GIM-1: the information is sent on request, also to one for every component, on the link of the request; a link that
/// cannot carry it refuses (Q-1, S-10).
#[test]
fn information_is_sent_on_request() {
    let mut world = world();
    let id = GimbalManagerInformation::ID as f32;
    for component in [1, 0] {
        let mut message = world.gcs[1].long(MavCmd::REQUEST_MESSAGE, [id, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        message.target_component = component;
        send(&mut world, 1, STATION, &message);
        world.run_for(millis(20));
        let (_, information) = world.gcs[1].take::<GimbalManagerInformation>().expect("it is sent");
        let expected = GimbalManagerInformation {
            time_boot_ms: information.time_boot_ms,
            gimbal_device_id: 1,
            ..world.vehicle.manager_information()
        };
        assert_eq!(information, expected);
        assert!((1..1_000).contains(&information.time_boot_ms));
        assert_eq!(world.gcs[1].take::<CommandAck>().expect("an answer").1.result, MavResult::ACCEPTED);
    }
    assert_eq!(world.gcs[0].count_of::<GimbalManagerInformation>(), 0, "not on another link");

    let message = world.gcs[2].long(MavCmd::REQUEST_MESSAGE, [id, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    send(&mut world, 2, STATION, &message);
    assert_eq!(world.expect::<CommandAck>(2, millis(20)).result, MavResult::DENIED);
}

/// GIM-1, Q-9: the capability says that there is a manager.
#[test]
fn capability_is_set() {
    let mut world = world();
    command(&mut world, STATION, MavCmd::REQUEST_MESSAGE, [AutopilotVersion::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let version: AutopilotVersion = world.expect(0, millis(20));
    assert!(version.capabilities.contains(MavProtocolCapability::COMPONENT_IMPLEMENTS_GIMBAL_MANAGER));
}

/// GIM-2, L-2, S-10: the status is sent five times a second on normal links that carry MAVLink 2.
#[test]
fn status_is_streamed() {
    let uart = LinkConfig::uart(57_600).with_own_system(true).with_streams(StreamProfile::Onboard);
    let links = [uart, uart.with_class(LinkClass::HighLatency), uart.with_version(TxVersion::V1)];
    let mut world = Carried::of(Setup { links, ..Setup::new() });
    world.run_for(millis(10_050));
    let counts = [0, 1, 2].map(|link: usize| world.gcs[link].count_of::<GimbalManagerStatus>());
    assert_eq!(counts, [51, 0, 0]);
    let (_, status) = world.gcs[0].take::<GimbalManagerStatus>().unwrap();
    let flags = GimbalManagerFlags::PITCH_LOCK;
    let expected =
        GimbalManagerStatus { flags, gimbal_device_id: 1, time_boot_ms: status.time_boot_ms, ..Default::default() };
    assert_eq!(status, expected, "nobody is in control");
}

/// GIM-2, Q-3 to Q-6: a client sets the interval on its link, asks for it, and asks for one status.
#[test]
fn interval_of_the_status_is_set_on_a_link() {
    let mut world = world();
    let id = GimbalManagerStatus::ID as f32;
    let count = |world: &mut Carried| {
        world.gcs[0].forget();
        world.run_for(millis(10_000));
        assert_eq!(world.gcs[1].count_of::<GimbalManagerStatus>(), 0, "its profile has no streams");
        world.gcs[0].count_of::<GimbalManagerStatus>()
    };
    assert_eq!(count(&mut world), 0);
    for (micros, expected, interval) in
        [(0.0, 0, -1), (100_000.0, 100, 100_000), (3.0, 500, 20_000), (1e9, 1, 60_000_000), (-1.0, 0, -1)]
    {
        let set = [id, micros, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(command(&mut world, STATION, MavCmd::SET_MESSAGE_INTERVAL, set), MavResult::ACCEPTED);
        let counted = count(&mut world);
        assert!(counted.abs_diff(expected) <= 1, "{micros} µs: {counted}");
        for (asks, params) in
            [(MavCmd::GET_MESSAGE_INTERVAL, [id, 0.0]), (MavCmd::REQUEST_MESSAGE, [MessageInterval::ID as f32, id])]
        {
            let [first, second] = params;
            assert_eq!(
                command(&mut world, STATION, asks, [first, second, 0.0, 0.0, 0.0, 0.0, 0.0]),
                MavResult::ACCEPTED
            );
            let told: MessageInterval = world.expect(0, millis(20));
            assert_eq!((u32::from(told.message_id), told.interval_us), (GimbalManagerStatus::ID, interval));
        }
    }
    for params in [[id, -2.0, 0.0], [id, NAN, 0.0], [id, 5.0, 3.0]] {
        let [a, b, c] = params;
        let set = [a, b, c, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(command(&mut world, STATION, MavCmd::SET_MESSAGE_INTERVAL, set), MavResult::DENIED, "{params:?}");
    }
    world.gcs[0].forget();
    let ask = [id, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(command(&mut world, STATION, MavCmd::REQUEST_MESSAGE, ask), MavResult::ACCEPTED);
    assert_eq!(world.gcs[0].count_of::<GimbalManagerStatus>(), 1);
}

/// GIM-3, GIM-2: control is taken, handed over, and released by anyone; each change is reported once on each link. -2 is the
/// sender.
#[test]
fn control_is_taken_and_released() {
    let mut world = world();
    let [first, second] = [STATION, OTHER_STATION].map(Some);
    assert_eq!(control(&world), [None, None]);
    for (from, params, expected) in [
        (STATION, [255, 190, -1, -1], [first, None]),
        // MAVSDK takes both.
        (OTHER_STATION, [254, 190, 254, 190], [second, second]),
        (STATION, [-3, -3, -3, -3], [second, second]),
        (OTHER_STATION, [-3, -3, -3, -3], [None, None]),
        (OTHER_STATION, [-2, -2, -2, -2], [second, second]),
        // For itself; and for somebody else.
        (STATION, [-2, -2, 254, 190], [first, second]),
        (STATION, [1, 1, 255, 190], [Some(VEHICLE), first]),
        (STATION, [-1, -1, -3, -3], [Some(VEHICLE), None]),
        (OTHER_STATION, [0, 0, 0, 0], [None, None]),
        (OTHER_STATION, [-1, -1, -1, -1], [None, None]),
    ] {
        let before = control(&world);
        world.gcs.iter_mut().for_each(Gcs::forget);
        assert_eq!(configure(&mut world, from, params), MavResult::ACCEPTED, "{params:?}");
        assert_eq!(control(&world), expected, "{params:?}");
        for link in [0, 1] {
            let statuses = world.gcs[link].all::<GimbalManagerStatus>();
            let pairs = statuses.iter().map(|(_, status)| {
                let GimbalManagerStatus { primary_control_sysid: a, primary_control_compid: b, .. } = *status;
                let GimbalManagerStatus { secondary_control_sysid: c, secondary_control_compid: d, .. } = *status;
                [Address::new(a, b), Address::new(c, d)].map(|it| Some(it).filter(|it| it.system.wire() != 0))
            });
            let told: Vec<_> = pairs.collect();
            assert_eq!(told, if before == expected { vec![] } else { vec![expected] }, "{params:?}");
        }
    }
    assert_eq!(world.vehicle.changes.len(), 8, "the vehicle learns of each change");
}

/// GIM-3, GIM-6, C-9: what names nobody is DENIED, and changes nothing.
#[test]
fn invalid_control_is_denied() {
    let mut world = world();
    take(&mut world, STATION);
    let before = control(&world);
    let odd: [[f32; 7]; 7] = [
        [-4.0, -4.0, -1.0, -1.0, 0.0, 0.0, 0.0],
        [255.0, -1.0, -1.0, -1.0, 0.0, 0.0, 0.0],
        [255.0, 0.0, -1.0, -1.0, 0.0, 0.0, 0.0],
        [256.0, 190.0, -1.0, -1.0, 0.0, 0.0, 0.0],
        [254.5, 190.0, -1.0, -1.0, 0.0, 0.0, 0.0],
        [254.0, 190.0, -1.0, -3.0, 0.0, 0.0, 0.0],
        [f32::INFINITY, 190.0, -1.0, -1.0, 0.0, 0.0, 0.0],
    ];
    for params in odd {
        let result = command(&mut world, OTHER_STATION, MavCmd::DO_GIMBAL_MANAGER_CONFIGURE, params);
        assert_eq!(result, MavResult::DENIED, "{params:?}");
        assert_eq!(control(&world), before);
    }
    // Another gimbal device is the vehicle's own business, which has none here.
    for device in [2.0, 154.0] {
        let params = [254.0, 190.0, -1.0, -1.0, 0.0, 0.0, device];
        let result = command(&mut world, OTHER_STATION, MavCmd::DO_GIMBAL_MANAGER_CONFIGURE, params);
        assert_eq!((result, control(&world)), (MavResult::UNSUPPORTED, before));
    }
    // NaN leaves it as it is (C-8), and NaN and 1 are this device.
    for params in [[NAN, NAN, NAN, NAN, NAN, NAN, NAN], [255.0, 190.0, NAN, NAN, 0.0, 0.0, 1.0]] {
        let result = command(&mut world, STATION, MavCmd::DO_GIMBAL_MANAGER_CONFIGURE, params);
        assert_eq!((result, control(&world)), (MavResult::ACCEPTED, before));
    }
}

/// GIM-4: only who is in control points; commands of others are DENIED with a text, and their messages dropped and counted.
#[test]
fn only_who_is_in_control_points() {
    let mut world = world();
    for from in [STATION, VEHICLE] {
        if from != VEHICLE {
            assert_eq!(command(&mut world, from, PITCH_YAW, DOWN), MavResult::DENIED, "nobody is in control");
        }
        send(&mut world, 0, from, &pitch_yaw(1.0));
    }
    take(&mut world, STATION);
    configure(&mut world, STATION, [-1, -1, 254, 190]);
    let third = Address::new(1, 191);
    assert_eq!(command(&mut world, third, PITCH_YAW, DOWN), MavResult::DENIED);
    assert_eq!(command(&mut world, third, MavCmd::DO_SET_ROI_NONE, [0.0; 7]), MavResult::DENIED);
    for message in [pitch_yaw(0.5), GimbalManagerSetPitchyaw { gimbal_device_id: 2, ..pitch_yaw(0.5) }] {
        send(&mut world, 0, third, &message);
        // Another component of the same system.
        send(&mut world, 0, Address::new(255, 1), &message);
    }
    assert!(world.vehicle.pointed.is_empty());
    assert_eq!(world.gcs[0].all::<Statustext>()[0].1.text.as_str(), Some("Gimbal: not in control, take control first"));

    assert_eq!(command(&mut world, STATION, PITCH_YAW, DOWN), MavResult::ACCEPTED);
    assert_eq!(command(&mut world, OTHER_STATION, PITCH_YAW, DOWN), MavResult::ACCEPTED);
    send(&mut world, 1, OTHER_STATION, &pitch_yaw(0.5));
    let by: Vec<_> = world.vehicle.pointed.iter().map(|setpoint| (setpoint.from, setpoint.is_secondary)).collect();
    assert_eq!(by, [(STATION, false), (OTHER_STATION, true), (OTHER_STATION, true)]);

    // To every vehicle; and to another gimbal.
    send(&mut world, 0, STATION, &GimbalManagerSetPitchyaw { target_system: 0, ..pitch_yaw(0.5) });
    send(&mut world, 0, STATION, &GimbalManagerSetPitchyaw { gimbal_device_id: 154, ..pitch_yaw(0.5) });
    let expected = counted(|counters: &mut ManagerCounters| {
        (counters.taken, counters.refused, counters.not_in_control) = (3, 3, 3);
        (counters.broadcast, counters.other_device) = (1, 3);
    });
    assert_eq!(counters(&world), expected);
}

/// GIM-4: a command of a client without gimbal control takes it while nobody has it, if the vehicle carries it out.
#[test]
fn regions_of_interest_and_mounts_take_free_control() {
    for (id, params) in [
        (MavCmd::DO_SET_ROI_NONE, [NAN; 7]),
        (MavCmd::DO_SET_ROI_LOCATION, [NAN, NAN, NAN, NAN, 47.0, 8.0, 500.0]),
        (MavCmd::DO_SET_ROI_WPNEXT_OFFSET, [0.0; 7]),
        (MavCmd::DO_SET_ROI_SYSID, [7.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        (MavCmd::DO_SET_ROI, [3.0, 0.0, 0.0, 0.0, 47.0, 8.0, 500.0]),
        (MavCmd::DO_MOUNT_CONTROL, [-45.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0]),
        (MavCmd::DO_MOUNT_CONFIGURE, [2.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]),
    ] {
        let mut world = world();
        world.vehicle.verdict = MavResult::FAILED;
        if id != MavCmd::DO_MOUNT_CONFIGURE {
            assert_eq!(command(&mut world, STATION, id, params), MavResult::FAILED);
            assert_eq!(control(&world), [None, None], "it takes none");
        }
        world.vehicle.verdict = MavResult::ACCEPTED;
        assert_eq!(command(&mut world, STATION, id, params), MavResult::ACCEPTED, "{id:?}");
        assert_eq!(control(&world), [Some(STATION), None], "{id:?}");
        let pointed = world.vehicle.pointed.len();
        assert_eq!(command(&mut world, OTHER_STATION, id, params), MavResult::DENIED, "{id:?}");
        assert_eq!((world.vehicle.pointed.len(), control(&world)), (pointed, [Some(STATION), None]));
        // Lost answers: the same command again has the same answer (C-11).
        assert_eq!(command(&mut world, STATION, id, params), MavResult::ACCEPTED, "{id:?}");
    }
}

/// GIM-5: MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW in both forms, as QGroundControl and MAVSDK send it.
#[test]
fn pitch_and_yaw_are_given_in_radians() {
    let mut world = world();
    take(&mut world, STATION);
    let flags = GimbalManagerFlags::PITCH_LOCK.with(GimbalManagerFlags::YAW_LOCK);
    let bits = flags.0 as f32;
    assert_eq!(command(&mut world, STATION, PITCH_YAW, [-90.0, 180.0, NAN, NAN, bits, 0.0, 1.0]), MavResult::ACCEPTED);
    let setpoint = *world.vehicle.pointed.last().unwrap();
    let target = angles([None, Some(-PI / 2.0), Some(PI)], [None; 3]);
    assert_eq!((setpoint.target, setpoint.flags, setpoint.is_secondary), (target, flags, false));
    assert!(setpoint.is_yaw_in_earth_frame(), "a locked yaw is relative to north");

    // MAVSDK sends rates as COMMAND_INT, with the flags in x.
    let rates = CommandInt {
        command: PITCH_YAW,
        param1: NAN,
        param2: NAN,
        param3: 18.0,
        param4: -36.0,
        x: GimbalManagerFlags::PITCH_LOCK.0.cast_signed(),
        ..CommandInt::default()
    };
    assert_eq!(command_int(&mut world, STATION, &rates), MavResult::ACCEPTED);
    let setpoint = *world.vehicle.pointed.last().unwrap();
    let rates = [None, Some(18.0_f32.to_radians()), Some((-36.0_f32).to_radians())];
    assert_eq!(setpoint.target, angles([None; 3], rates));
    assert_eq!(setpoint.flags, GimbalManagerFlags::PITCH_LOCK);
    assert!(!setpoint.is_yaw_in_earth_frame());

    let count = world.vehicle.pointed.len();
    for params in [
        [-181.0, 0.0, NAN, NAN, 0.0, 0.0, 0.0],
        [0.0, 180.5, NAN, NAN, 0.0, 0.0, 0.0],
        [0.0, f32::INFINITY, NAN, NAN, 0.0, 0.0, 0.0],
        [0.0, 0.0, f32::NEG_INFINITY, NAN, 0.0, 0.0, 0.0],
        [0.0, 0.0, NAN, NAN, 0.5, 0.0, 0.0],
        [0.0, 0.0, NAN, NAN, 1024.0, 0.0, 0.0],
        [0.0, 0.0, NAN, NAN, -1.0, 0.0, 0.0],
        // The yaw in both frames.
        [0.0, 0.0, NAN, NAN, 96.0, 0.0, 0.0],
    ] {
        assert_eq!(command(&mut world, STATION, PITCH_YAW, params), MavResult::DENIED, "{params:?}");
    }
    assert_eq!(world.vehicle.pointed.len(), count);
    // RETRACT takes precedence over NEUTRAL, and that over all else.
    for (bits, expected) in [(3.0, GimbalTarget::Retract), (2.0, GimbalTarget::Neutral)] {
        command(&mut world, STATION, PITCH_YAW, [10.0, 20.0, NAN, NAN, bits, 0.0, 0.0]);
        assert_eq!(last(&world).1, Some(expected));
    }
}

/// GIM-5: the messages of those in control. MAVSDK streams attitudes, QGroundControl rates, and some sticks.
#[test]
fn messages_point() {
    let mut world = world();
    take(&mut world, STATION);
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let attitude = GimbalManagerSetAttitude {
        q: [half, 0.0, -half, 0.0],
        target_system: 1,
        target_component: 1,
        ..GimbalManagerSetAttitude::UNKNOWN
    };
    send(&mut world, 0, STATION, &attitude);
    let q = [half, 0.0, -half, 0.0];
    assert_eq!(last(&world), (1, Some(GimbalTarget::Attitude { q, rates: axes([None; 3]) })));
    // Rates alone.
    let rates =
        GimbalManagerSetAttitude { q: [NAN; 4], angular_velocity_y: 0.5, angular_velocity_z: -0.25, ..attitude };
    send(&mut world, 0, STATION, &rates);
    let rates = [None, Some(0.5), Some(-0.25)];
    assert_eq!(last(&world), (2, Some(angles([None; 3], rates))));
    send(&mut world, 0, STATION, &GimbalManagerSetPitchyaw { yaw_rate: 0.1, ..pitch_yaw(0.25) });
    let (pitch, rates) = ([None, Some(0.25), None], [None, None, Some(0.1)]);
    assert_eq!(last(&world), (3, Some(angles(pitch, rates))));
    let manual = GimbalManagerSetManualControl {
        pitch_rate: -1.0,
        yaw_rate: 0.5,
        target_system: 1,
        target_component: 1,
        ..GimbalManagerSetManualControl::UNKNOWN
    };
    send(&mut world, 0, STATION, &manual);
    let by_hand = GimbalTarget::Manual { angles: axes([None; 3]), rates: axes([None, Some(-1.0), Some(0.5)]) };
    assert_eq!(last(&world), (4, Some(by_hand)));

    for q in [[1.0, NAN, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0], [f32::INFINITY, 0.0, 0.0, 0.0], [0.0; 4]] {
        send(&mut world, 0, STATION, &GimbalManagerSetAttitude { q, ..attitude });
    }
    send(&mut world, 0, STATION, &GimbalManagerSetAttitude { angular_velocity_x: f32::INFINITY, ..attitude });
    send(&mut world, 0, STATION, &pitch_yaw(f32::INFINITY));
    send(&mut world, 0, STATION, &GimbalManagerSetManualControl { pitch: 1.5, ..manual });
    send(&mut world, 0, STATION, &GimbalManagerSetPitchyaw { flags: GimbalManagerFlags(96), ..pitch_yaw(0.0) });
    assert_eq!((last(&world).0, counters(&world).invalid), (4, 8));
    send(&mut world, 0, STATION, &GimbalManagerSetPitchyaw { flags: GimbalManagerFlags(1), ..pitch_yaw(0.0) });
    assert_eq!(last(&world), (5, Some(GimbalTarget::Retract)));
}

pub fn place(latitude: i32, longitude: i32, altitude: f32, frame: Option<MavFrame>) -> Option<GimbalTarget> {
    let position = LatLon { latitude, longitude };
    Some(GimbalTarget::Location { position, altitude: Some(altitude), frame })
}

/// GIM-5, C-6, C-7: regions of interest, in both forms.
#[test]
fn regions_of_interest() {
    let mut world = world();
    let location = [0.0, 0.0, 0.0, 0.0, 47.5, 8.25, 500.0];
    assert_eq!(command(&mut world, STATION, MavCmd::DO_SET_ROI_LOCATION, location), MavResult::ACCEPTED);
    assert_eq!(last(&world).1, place(475_000_000, 82_500_000, 500.0, None));
    let mut int = CommandInt {
        command: MavCmd::DO_SET_ROI_LOCATION,
        frame: MavFrame::GLOBAL_RELATIVE_ALT_INT,
        x: 475_000_001,
        y: -82_500_001,
        z: 20.0,
        ..CommandInt::default()
    };
    assert_eq!(command_int(&mut world, STATION, &int), MavResult::ACCEPTED);
    assert_eq!(last(&world).1, place(475_000_001, -82_500_001, 20.0, Some(MavFrame::GLOBAL_RELATIVE_ALT)));
    let count = world.vehicle.pointed.len();
    int.frame = MavFrame::LOCAL_NED;
    assert_eq!(command_int(&mut world, STATION, &int), MavResult::COMMAND_UNSUPPORTED_MAV_FRAME);
    // Without a model of the terrain, the altitude cannot be honoured (M-49).
    for frame in [MavFrame::GLOBAL_TERRAIN_ALT, MavFrame::GLOBAL_TERRAIN_ALT_INT] {
        int.frame = frame;
        assert_eq!(command_int(&mut world, STATION, &int), MavResult::COMMAND_UNSUPPORTED_MAV_FRAME);
        let roi = CommandInt { command: MavCmd::DO_SET_ROI, param1: 3.0, ..int };
        assert_eq!(command_int(&mut world, STATION, &roi), MavResult::COMMAND_UNSUPPORTED_MAV_FRAME);
    }
    (int.frame, int.x) = (MavFrame::GLOBAL, i32::MAX);
    assert_eq!(command_int(&mut world, STATION, &int), MavResult::DENIED, "no latitude");
    for params in [
        [0.0, 0.0, 0.0, 0.0, 91.0, 8.0, 500.0],
        [0.0, 0.0, 0.0, 0.0, NAN, 8.0, 500.0],
        [0.0, 0.0, 0.0, 0.0, 47.0, 8.0, f32::INFINITY],
    ] {
        assert_eq!(command(&mut world, STATION, MavCmd::DO_SET_ROI_LOCATION, params), MavResult::DENIED);
    }
    // Another gimbal device is left to the vehicle (GIM-6).
    let other = [154.0, 0.0, 0.0, 0.0, 47.0, 8.0, 0.0];
    assert_eq!(command(&mut world, STATION, MavCmd::DO_SET_ROI_LOCATION, other), MavResult::UNSUPPORTED);
    for system in [0.0, 256.0, NAN, 1.5] {
        let params = [system, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(command(&mut world, STATION, MavCmd::DO_SET_ROI_SYSID, params), MavResult::DENIED);
    }
    assert_eq!(world.vehicle.pointed.len(), count);

    let offset = next_waypoint([Some(10.0_f32.to_radians()), Some(-PI / 2.0), None]);
    for (id, params, expected) in [
        (MavCmd::DO_SET_ROI_NONE, [0.0; 7], GimbalTarget::Released),
        (MavCmd::DO_SET_ROI_SYSID, [7.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0], GimbalTarget::System(SystemId::new(7))),
        (MavCmd::DO_SET_ROI_WPNEXT_OFFSET, [1.0, 0.0, 0.0, 0.0, -90.0, 10.0, NAN], offset),
        (MavCmd::DO_SET_ROI, [0.0; 7], GimbalTarget::Released),
        (MavCmd::DO_SET_ROI, [1.0; 7], next_waypoint([None; 3])),
    ] {
        assert_eq!(command(&mut world, STATION, id, params), MavResult::ACCEPTED, "{id:?}");
        assert_eq!(last(&world).1, Some(expected), "{id:?}");
    }
    for mode in [2.0, 4.0, 5.0, NAN] {
        let params = [mode, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(command(&mut world, STATION, MavCmd::DO_SET_ROI, params), MavResult::DENIED, "{mode}");
    }
}

/// GIM-8: the older protocol, as MAVProxy sends it and PX4 reads it.
#[test]
fn older_protocol() {
    let mut world = world();
    let degrees = PI / 180.0;
    let pointing = angles([Some(5.0 * degrees), Some(-30.0 * degrees), Some(-90.0 * degrees)], [None; 3]);
    let control = MavCmd::DO_MOUNT_CONTROL;
    for (params, expected) in [
        ([0.0; 7], Some(GimbalTarget::Retract)),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], Some(GimbalTarget::Neutral)),
        ([-30.0, 5.0, 270.0, 0.0, 0.0, 0.0, 2.0], Some(pointing)),
        // MAVProxy scales the location; others do not.
        ([0.0, 0.0, 0.0, 20.0, 473_977_408.0, 85_455_936.0, 4.0], place(473_977_408, 85_455_936, 20.0, None)),
        ([0.0, 0.0, 0.0, 20.0, 47.5, -8.25, 4.0], place(475_000_000, -82_500_000, 20.0, None)),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 7.0], Some(next_waypoint([None; 3]))),
    ] {
        assert_eq!(command(&mut world, STATION, control, params), MavResult::ACCEPTED, "{params:?}");
        assert_eq!(last(&world).1, expected, "{params:?}");
    }
    let setpoint = world.vehicle.pointed[2];
    assert_eq!(setpoint.flags, GimbalManagerFlags(4 | 8 | 32), "roll and pitch are level");
    // In a COMMAND_INT, whole degrees or a scaled location, in any frame (M-75).
    for frame in [0, 2, 3, 10].map(MavFrame) {
        for (x, y, expected) in [
            (473_977_418, -85_455_939, place(473_977_418, -85_455_939, 20.0, None)),
            (47, -8, place(470_000_000, -80_000_000, 20.0, None)),
        ] {
            let int = CommandInt { command: control, frame, param4: 20.0, x, y, z: 4.0, ..CommandInt::default() };
            assert_eq!(command_int(&mut world, STATION, &int), MavResult::ACCEPTED);
            assert_eq!(last(&world).1, expected, "{frame:?}");
        }
    }
    // The pilot on the ground steers.
    assert_eq!(command(&mut world, STATION, control, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0]), MavResult::ACCEPTED);
    let setpoint = *world.vehicle.pointed.last().unwrap();
    let nothing = angles([None; 3], [None; 3]);
    assert_eq!((setpoint.flags, setpoint.target), (GimbalManagerFlags::RC_EXCLUSIVE, nothing));
    for mode in [5.0, 6.0, 9.0, NAN] {
        let result = command(&mut world, STATION, control, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, mode]);
        assert_eq!(result, MavResult::DENIED, "{mode}");
    }
    let count = world.vehicle.pointed.len();
    for (mode, result, pointed) in [
        (2.0, MavResult::ACCEPTED, None),
        (4.0, MavResult::ACCEPTED, None),
        (7.0, MavResult::DENIED, None),
        (1.0, MavResult::ACCEPTED, Some(GimbalTarget::Neutral)),
        (0.0, MavResult::ACCEPTED, Some(GimbalTarget::Retract)),
    ] {
        let params = [mode, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0];
        assert_eq!(command(&mut world, STATION, MavCmd::DO_MOUNT_CONFIGURE, params), result, "{mode}");
        assert_eq!(last(&world).1, pointed.or(Some(nothing)), "{mode}");
    }
    assert_eq!(world.vehicle.pointed.len(), count + 2);
}
