//! Operator control: rule O-5, and C-5, J-2 and J-6 for senders that are not in control.

use crate::support::*;
use mavstack::config::{LinkClass, StreamProfile, TxVersion};
use mavstack::dialect::*;
use mavstack::manual_control::ControlSource;
use mavstack::message::SystemId;
use mavstack::operator_control::{OperatorControl, OperatorCounters};
use mavstack::{Address, LinkConfig, LinkId, Message, Peer, Stack};
use proptest::prelude::*;

mavstack::message! {
    struct ControlStatus: CONTROL_STATUS = 512 {
        flags: u8,
        gcs_main: u8,
        gcs_secondary: [u8; 10],
    }
}

#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: 3,
    plans: { mission: 4 },
    parameters: Tuning,
    streams,
    commands: { slots: 3 },
    manual_control,
    operator_control,
)]
struct Controlled {
    setpoints: mavstack::setpoints::Setpoints,
}

type Shared = World<3, Controlled>;

const REQUEST_OPERATOR_CONTROL: MavCmd = MavCmd(32_100);
const NOBODY: Option<SystemId> = None;
const FIRST: Option<SystemId> = Some(SystemId::new(255));
const SECOND: Option<SystemId> = Some(SystemId::new(254));
const ALL: ControlSource = ControlSource::Systems { first: SystemId::new(1), last: SystemId::new(255) };
/// The companion computer on board.
const COMPANION: Address = Address::new(1, 191);
/// It has no ground station's heartbeats.
const SILENT: Address = Address::new(77, 190);

/// Two ground stations that are alive, on the first link and on the second. The third link carries MAVLink 1.
fn world() -> Shared {
    let uart = LinkConfig::uart(921_600).with_streams(StreamProfile::Off).with_own_system(true);
    let mut world = Shared::of(Setup { links: [uart, uart, uart.with_version(TxVersion::V1)], ..Setup::new() });
    world.gcs.iter_mut().for_each(|gcs| gcs.takes_unknown = true);
    world.stack.manual_input_mut().set_source(ALL);
    world.stack.setpoints.set_source(ALL);
    beat(&mut world);
    world.run_for(millis(100));
    world
}

fn beat(world: &mut Shared) {
    send(world, 0, STATION, &Gcs::heartbeat());
    send(world, 1, OTHER_STATION, &Gcs::heartbeat());
}

/// Receives `message` now.
fn send<M: Message>(world: &mut Shared, link: u8, from: Address, message: &M) {
    let frame = world.gcs[usize::from(link)].frame_from(from, message);
    assert_eq!(world.stack.receive(world.clock.now(), LinkId(link), &frame, &mut world.vehicle), frame.len());
}

/// Receives a command, and returns its result.
fn command(world: &mut Shared, link: u8, from: Address, command: MavCmd, params: [f32; 4]) -> MavResult {
    let [param1, param2, param3, param4] = params;
    let (target_system, target_component) = (1, 1);
    let message =
        CommandLong { param1, param2, param3, param4, command, target_system, target_component, ..Default::default() };
    send(world, link, from, &message);
    world.run_for(millis(20));
    let acks = world.gcs[usize::from(link)].all::<CommandAck>();
    let (_, ack) = acks.last().expect("an answer");
    let to = Address::new(ack.target_system, ack.target_component);
    assert_eq!((ack.command, to), (command, from), "the answer");
    ack.result
}

/// The link of a sender.
fn link_of(from: Address) -> u8 {
    u8::from(from == OTHER_STATION)
}

fn request(world: &mut Shared, from: Address, allow: f32) -> MavResult {
    command(world, link_of(from), from, REQUEST_OPERATOR_CONTROL, [1.0, allow, 10.0, f32::from(from.system.wire())])
}

fn release(world: &mut Shared, from: Address) -> MavResult {
    command(world, link_of(from), from, REQUEST_OPERATOR_CONTROL, [0.0; 4])
}

/// Sends a command that the vehicle carries out. Returns its result, and whether a hook was called.
fn land(world: &mut Shared, from: Address) -> (MavResult, bool) {
    let calls = world.vehicle.calls.len();
    let result = command(world, link_of(from), from, MavCmd::NAV_LAND, [0.0; 4]);
    (result, world.vehicle.calls.len() > calls)
}

fn owner(world: &Shared) -> Option<SystemId> {
    world.stack.operator(world.now())
}

fn counters(world: &Shared) -> OperatorCounters {
    world.stack.operator_control().counters()
}

fn stick(x: i16) -> ManualControl {
    ManualControl { target: 1, x, z: 500, ..ManualControl::default() }
}

fn setpoint() -> SetPositionTargetLocalNed {
    SetPositionTargetLocalNed { target_system: 1, target_component: 1, ..Default::default() }
}

/// The sender of the current sticks, and of the current setpoint.
fn steering(world: &Shared) -> [Option<SystemId>; 2] {
    let sticks = world.stack.manual_input().manual_control(world.now()).map(|sticks| sticks.from);
    let setpoint = world.stack.setpoints.current(world.now()).map(|setpoint| setpoint.from);
    [sticks, setpoint].map(|from| from.map(|from| from.address.system))
}

/// O-5: the definition of the message, by name and types of its fields.
#[test]
fn control_status_is_the_one_of_development() {
    assert_eq!((ControlStatus::ID, ControlStatus::CRC_EXTRA, ControlStatus::MAX_LEN), (512, 21, 12));
}

/// O-5: CONTROL_STATUS is sent every second and at once after a change, on every normal link that carries MAVLink 2 (S-10, L-2).
#[test]
fn control_status_is_sent() {
    let uart = LinkConfig::uart(57_600).with_streams(StreamProfile::Off);
    let links = [uart, uart.with_class(LinkClass::HighLatency), uart.with_version(TxVersion::V1)];
    let mut world = Shared::of(Setup { links, ..Setup::new() });
    world.gcs.iter_mut().for_each(|gcs| gcs.takes_unknown = true);
    world.run_for(millis(10_500));
    let statuses = world.gcs[0].all::<ControlStatus>();
    assert_eq!(statuses.len(), 11);
    // Nobody is in control, so a request is granted.
    let expected = ControlStatus { flags: 3, gcs_main: 0, gcs_secondary: [0; 10] };
    assert!(statuses.iter().all(|(_, status)| *status == expected), "{statuses:?}");
    assert_eq!([1, 2].map(|link: usize| world.gcs[link].count_of::<ControlStatus>()), [0, 0]);

    world.stack.operator_control_mut().set_secondaries(&[7, 9].map(SystemId::new));
    send(&mut world, 0, STATION, &Gcs::heartbeat());
    for (allow, flags) in [(0.0, 1), (1.0, 3), (f32::NAN, 1)] {
        world.gcs[0].forget();
        assert_eq!(request(&mut world, STATION, allow), MavResult::ACCEPTED);
        world.run_for(millis(50));
        let expected = ControlStatus { flags, gcs_main: 255, gcs_secondary: [7, 9, 0, 0, 0, 0, 0, 0, 0, 0] };
        let statuses = world.gcs[0].all::<ControlStatus>();
        assert_eq!(statuses.last().map(|(_, status)| *status), Some(expected), "at once");
    }
}

/// O-5, Q-9: the capability is reported.
#[test]
fn capability_is_reported() {
    let mut world = world();
    command(&mut world, 0, STATION, MavCmd::REQUEST_MESSAGE, [AutopilotVersion::ID as f32, 0.0, 0.0, 0.0]);
    let capabilities = world.expect::<AutopilotVersion>(0, millis(100)).capabilities;
    assert!(capabilities.contains(MavProtocolCapability::COMPONENT_ACCEPTS_GCS_CONTROL));
}

/// O-5, C-5: while nobody is in control everyone is. Then only the owner, a secondary station and our own system give commands.
/// A refused command calls no hook.
#[test]
fn only_the_owner_gives_commands() {
    let mut world = world();
    let accepted = (MavResult::ACCEPTED, true);
    for from in [STATION, OTHER_STATION, COMPANION, SILENT] {
        assert_eq!(land(&mut world, from), accepted);
    }
    assert_eq!(request(&mut world, STATION, 0.0), MavResult::ACCEPTED);
    assert_eq!(owner(&world), FIRST);
    let refused = (MavResult::NOT_IN_CONTROL, false);
    for (from, expected) in [(STATION, accepted), (OTHER_STATION, refused), (COMPANION, accepted), (SILENT, refused)] {
        assert_eq!(land(&mut world, from), expected, "{from:?}");
    }
    // Another component of the owner's system.
    assert_eq!(land(&mut world, Address::new(255, 25)), accepted);
    assert_eq!(counters(&world).commands, 2);
    world.stack.operator_control_mut().set_secondaries(&[SystemId::new(254)]);
    assert_eq!(land(&mut world, OTHER_STATION), accepted);
    assert_eq!(land(&mut world, SILENT), refused);
    assert_eq!(release(&mut world, STATION), MavResult::ACCEPTED);
    assert_eq!((owner(&world), land(&mut world, SILENT)), (NOBODY, accepted));
}

/// O-5, J-2, J-6: sticks and setpoints of others are dropped and counted, also those of secondary stations.
#[test]
fn only_the_owner_steers() {
    let mut world = world();
    world.stack.operator_control_mut().set_secondaries(&[SystemId::new(254)]);
    request(&mut world, STATION, 0.0);
    for from in [OTHER_STATION, SILENT] {
        send(&mut world, link_of(from), from, &stick(100));
        let channels = RcChannelsOverride { target_system: 1, chan1_raw: 1_500, ..Default::default() };
        send(&mut world, link_of(from), from, &channels);
        send(&mut world, link_of(from), from, &setpoint());
        send(&mut world, link_of(from), from, &SetPositionTargetGlobalInt { target_system: 1, ..Default::default() });
        let type_mask = AttitudeTargetTypemask::ATTITUDE_IGNORE;
        send(&mut world, link_of(from), from, &SetAttitudeTarget { target_system: 1, type_mask, ..Default::default() });
    }
    assert_eq!((steering(&world), counters(&world).messages), ([None; 2], 10));
    assert_eq!(world.stack.manual_input().rc_channels(world.now()), None);
    send(&mut world, 0, STATION, &stick(100));
    send(&mut world, 0, COMPANION, &setpoint());
    assert_eq!(steering(&world), [FIRST, Some(SystemId::new(1))]);
}

/// O-5: the sticks and setpoints of the station before end at once when another one takes over; those of our own system go on,
/// and those of the new owner too.
#[test]
fn takeover_ends_the_input_of_others() {
    let mut world = world();
    send(&mut world, 0, STATION, &stick(100));
    send(&mut world, 0, STATION, &setpoint());
    assert_eq!(request(&mut world, STATION, 1.0), MavResult::ACCEPTED);
    assert_eq!(steering(&world), [FIRST; 2]);
    assert_eq!(request(&mut world, OTHER_STATION, 1.0), MavResult::ACCEPTED);
    assert_eq!(steering(&world), [None; 2]);
    send(&mut world, 0, COMPANION, &setpoint());
    send(&mut world, 1, OTHER_STATION, &stick(100));
    assert_eq!(request(&mut world, STATION, 1.0), MavResult::ACCEPTED);
    assert_eq!(steering(&world), [None, Some(SystemId::new(1))]);
}

/// O-5: without consent a request fails. The owner is told of it, three times, or until it has answered.
#[test]
fn takeover_needs_consent() {
    let mut world = world();
    request(&mut world, STATION, 0.0);
    assert_eq!(request(&mut world, OTHER_STATION, 1.0), MavResult::FAILED);
    assert_eq!((owner(&world), counters(&world).refused), (FIRST, 1));
    let mut last = None;
    for confirmation in 0..3 {
        beat(&mut world);
        let notice = world.expect::<CommandLong>(0, millis(3_100));
        let at = world.now();
        assert!(last.is_none_or(|last| at - last >= millis(2_900)), "at most every 3 s");
        last = Some(at);
        let expected = CommandLong {
            param1: 1.0,
            param2: 1.0,
            param3: 10.0,
            param4: 254.0,
            command: REQUEST_OPERATOR_CONTROL,
            target_system: 255,
            target_component: 190,
            confirmation,
            ..Default::default()
        };
        assert_eq!(notice, expected);
    }
    beat(&mut world);
    world.expect_no::<CommandLong>(0, secs(4));
    beat(&mut world);
    assert_eq!(request(&mut world, OTHER_STATION, 0.0), MavResult::FAILED);
    world.expect::<CommandLong>(0, millis(200));
    let command = REQUEST_OPERATOR_CONTROL;
    send(&mut world, 1, OTHER_STATION, &CommandAck { command, ..Default::default() });
    beat(&mut world);
    world.expect::<CommandLong>(0, millis(3_100));
    send(&mut world, 0, STATION, &CommandAck { command, ..Default::default() });
    world.expect_no::<CommandLong>(0, secs(4));
    assert_eq!(world.gcs[1].count_of::<CommandLong>(), 0, "nobody else is told");
    // The owner consents: it allows a takeover, or releases control.
    beat(&mut world);
    assert_eq!(request(&mut world, STATION, 1.0), MavResult::ACCEPTED);
    assert_eq!(request(&mut world, OTHER_STATION, 0.0), MavResult::ACCEPTED);
    assert_eq!(owner(&world), SECOND);
    assert_eq!(request(&mut world, STATION, 0.0), MavResult::FAILED, "the new owner does not allow it");
    assert_eq!(release(&mut world, STATION), MavResult::FAILED, "not its own");
    assert_eq!(release(&mut world, OTHER_STATION), MavResult::ACCEPTED);
    assert_eq!(request(&mut world, STATION, 0.0), MavResult::ACCEPTED);
    assert_eq!(owner(&world), FIRST);
}

/// Sends the count, or an item of `items`, from a station.
fn part(world: &mut Shared, from: Address, items: &[MissionItemInt], seq: Option<usize>) {
    match seq {
        None => {
            let count = items.len() as u16;
            let count = MissionCount { count, target_system: 1, target_component: 1, ..MissionCount::default() };
            send(world, link_of(from), from, &count);
        }
        Some(seq) => {
            let item = MissionItemInt { target_system: 1, target_component: 1, ..items[seq] };
            send(world, link_of(from), from, &item);
        }
    }
    world.run_for(millis(50));
}

/// The results of the plan transfers of a station since the last call.
fn results(world: &mut Shared, from: Address) -> Vec<MavMissionResult> {
    let gcs = &mut world.gcs[usize::from(link_of(from))];
    let results = gcs.all::<MissionAck>().into_iter().map(|(_, ack)| ack.r#type).collect();
    gcs.forget();
    results
}

/// a takeover ends the former owner's upload, also one whose last item comes after it. Before, the plan went live.
#[test]
fn takeover_ends_an_upload() {
    let mut world = world();
    let items = plan(2, 0);
    request(&mut world, STATION, 1.0);
    part(&mut world, STATION, &items, None);
    part(&mut world, STATION, &items, Some(0));
    results(&mut world, STATION);
    assert_eq!(request(&mut world, OTHER_STATION, 0.0), MavResult::ACCEPTED);
    world.run_for(millis(50));
    assert_eq!(results(&mut world, STATION), [MavMissionResult::OPERATION_CANCELLED]);
    part(&mut world, STATION, &items, Some(1));
    assert_eq!(results(&mut world, STATION), [MavMissionResult::DENIED]);
    assert_eq!(world.vehicle.plan_changes(), []);
    results(&mut world, OTHER_STATION);
    for seq in [None, Some(0), Some(1)] {
        part(&mut world, OTHER_STATION, &items, seq);
    }
    assert_eq!(results(&mut world, OTHER_STATION), [MavMissionResult::ACCEPTED]);
}

/// a station that is not in control cannot occupy the staging area. Before, it had 15 of 15 of the owner's uploads refused.
#[test]
fn only_the_owner_changes_plans() {
    let mut world = world();
    request(&mut world, STATION, 0.0);
    let mut accepted = 0;
    for round in 0..15 {
        beat(&mut world);
        results(&mut world, OTHER_STATION);
        part(&mut world, OTHER_STATION, &plan(2, 7), None);
        assert_eq!(results(&mut world, OTHER_STATION), [MavMissionResult::DENIED]);
        results(&mut world, STATION);
        for seq in [None, Some(0), Some(1)] {
            part(&mut world, STATION, &plan(2, round), seq);
        }
        accepted += usize::from(results(&mut world, STATION) == [MavMissionResult::ACCEPTED]);
    }
    assert_eq!(accepted, 15);
    let clear = MissionClearAll { target_system: 1, target_component: 1, ..MissionClearAll::default() };
    send(&mut world, 1, OTHER_STATION, &clear);
    world.run_for(millis(50));
    assert_eq!(results(&mut world, OTHER_STATION), [MavMissionResult::DENIED]);
    assert_eq!(world.vehicle.plan_changes().len(), 15);
}

/// the system in control takes the staging area from an upload of another one that began before.
#[test]
fn owner_takes_the_staging_area() {
    let mut world = world();
    let items = plan(2, 0);
    part(&mut world, COMPANION, &items, None);
    part(&mut world, COMPANION, &items, Some(0));
    request(&mut world, STATION, 0.0);
    results(&mut world, STATION);
    for seq in [None, Some(0), Some(1)] {
        part(&mut world, STATION, &items, seq);
    }
    let results = results(&mut world, STATION);
    assert!(results.contains(&MavMissionResult::OPERATION_CANCELLED), "to the companion: {results:?}");
    assert!(results.contains(&MavMissionResult::ACCEPTED), "{results:?}");
}

/// requests in a row notify the owner at most every 3 s. Before, it had 3,998 notices in 4 s.
#[test]
fn notices_are_rare() {
    let mut world = world();
    request(&mut world, STATION, 0.0);
    world.gcs[0].forget();
    let begin = world.now();
    while world.now() - begin < secs(4) {
        request(&mut world, OTHER_STATION, 0.0);
        world.gcs[1].forget();
    }
    let notices = world.gcs[0].count_of::<CommandLong>();
    assert!((1..=2).contains(&notices), "{notices}");
}

/// the owner is notified of each system that requests control, also beside four that request it 100 times a second. Before, it was
/// notified of the last one only, which was that of a request in 100.
#[test]
fn requesters_have_their_turn() {
    let mut world = world();
    request(&mut world, STATION, 0.0);
    world.gcs[0].forget();
    let ask = |world: &mut Shared, system: u8| {
        let message = world.gcs[1].long(REQUEST_OPERATOR_CONTROL, [1.0, 0.0, 10.0, f32::from(system), 0.0, 0.0, 0.0]);
        send(world, 1, Address::new(system, 190), &message);
    };
    for ms in 0..20_000 {
        if ms % 1_000 == 0 {
            beat(&mut world);
            for system in [60, 120, 180, 240] {
                send(&mut world, 1, Address::new(system, 190), &Gcs::heartbeat());
            }
        }
        if ms % 1_000 == 300 {
            ask(&mut world, 254);
        }
        if ms % 10 == 5 {
            [60, 120, 180, 240].into_iter().for_each(|system| ask(&mut world, system));
        }
        world.run_for(millis(1));
        world.gcs[1].forget();
    }
    let notices = world.gcs[0].all::<CommandLong>();
    assert!(notices.iter().any(|(_, notice)| notice.param4 == 254.0), "{notices:?}");
    assert!(notices.len() <= 7, "{}", notices.len());
}

/// O-5: control is released when the owner's heartbeats stop, unless the firmware keeps it.
#[test]
fn lost_owner_releases_control() {
    for releases in [true, false] {
        let mut world = world();
        world.stack.operator_control_mut().set_release_on_loss(releases);
        request(&mut world, STATION, 0.0);
        for _ in 0..4 {
            send(&mut world, 1, OTHER_STATION, &Gcs::heartbeat());
            world.run_for(secs(1));
        }
        assert_eq!(owner(&world), FIRST);
        send(&mut world, 1, OTHER_STATION, &Gcs::heartbeat());
        world.run_for(secs(1));
        assert_eq!(owner(&world), if releases { NOBODY } else { FIRST });
        let result = request(&mut world, OTHER_STATION, 0.0);
        assert_eq!(result, if releases { MavResult::ACCEPTED } else { MavResult::FAILED });
        world.stack.operator_control_mut().release();
        assert_eq!(owner(&world), NOBODY);
    }
}

/// C-16: a refused request has its reason: a wrong parameter, or that another station has control.
#[cfg(feature = "plan-texts")]
#[test]
fn refused_requests_are_explained() {
    let mut world = world();
    request(&mut world, STATION, 0.0);
    for (params, result, text) in [
        ([1.0, 0.0, 10.0, 254.0], MavResult::FAILED, "Command 32100 refused: another station has control"),
        ([1.0, 2.0, 10.0, 254.0], MavResult::DENIED, "Command 32100 refused: a parameter is out of range"),
        ([0.0, 0.0, 0.0, 254.0], MavResult::FAILED, "Command 32100 refused: another station has control"),
    ] {
        world.run_for(secs(2));
        world.gcs[1].forget();
        beat(&mut world);
        assert_eq!(command(&mut world, 1, OTHER_STATION, REQUEST_OPERATOR_CONTROL, params), result);
        world.run_for(millis(50));
        let texts = world.gcs[1].all::<Statustext>();
        let texts: Vec<_> = texts.iter().map(|(_, text)| text.text.as_str().unwrap()).collect();
        assert_eq!(texts, [text]);
    }
}

/// O-5: requests that mean nothing are denied. A station that is not alive would lose control at once, so its request fails.
#[test]
fn invalid_requests_are_refused() {
    let mut world = world();
    let nan = f32::NAN;
    for (from, params, result) in [
        (STATION, [2.0, 0.0, 10.0, 0.0], MavResult::DENIED),
        (STATION, [nan, 0.0, 10.0, 0.0], MavResult::DENIED),
        (STATION, [0.5, 0.0, 10.0, 0.0], MavResult::DENIED),
        (STATION, [1.0, 2.0, 10.0, 0.0], MavResult::DENIED),
        (STATION, [1.0, 0.0, 10.0, 254.0], MavResult::DENIED),
        (COMPANION, [1.0, 0.0, 10.0, 0.0], MavResult::DENIED),
        (SILENT, [1.0, 0.0, 10.0, 0.0], MavResult::FAILED),
        (STATION, [0.0, 0.0, 0.0, 0.0], MavResult::ACCEPTED),
        (STATION, [1.0, 0.0, nan, nan], MavResult::ACCEPTED),
    ] {
        assert_eq!(owner(&world), NOBODY);
        assert_eq!(command(&mut world, 0, from, REQUEST_OPERATOR_CONTROL, params), result, "{params:?}");
    }
    world.stack.operator_control_mut().release();
    let to_all = CommandLong { param1: 1.0, command: REQUEST_OPERATOR_CONTROL, ..Default::default() };
    send(&mut world, 0, STATION, &to_all);
    world.run_for(millis(20));
    let (_, ack) = *world.gcs[0].all::<CommandAck>().last().unwrap();
    assert_eq!((ack.result, owner(&world)), (MavResult::DENIED, NOBODY));
    // Without release on loss a station without heartbeats may be in control.
    world.stack.operator_control_mut().set_release_on_loss(false);
    assert_eq!(request(&mut world, SILENT, 0.0), MavResult::ACCEPTED);
}

/// O-5: everyone may ask for information.
#[test]
fn information_is_for_all() {
    let mut world = world();
    request(&mut world, STATION, 0.0);
    let attitude = Attitude::ID as f32;
    for (command_id, params) in [
        (MavCmd::REQUEST_MESSAGE, [attitude, 0.0, 0.0, 0.0]),
        (MavCmd::GET_MESSAGE_INTERVAL, [attitude, 0.0, 0.0, 0.0]),
        (MavCmd::SET_MESSAGE_INTERVAL, [attitude, 1e6, 0.0, 0.0]),
        (MavCmd::REQUEST_AUTOPILOT_CAPABILITIES, [1.0, 0.0, 0.0, 0.0]),
        (MavCmd::REQUEST_PROTOCOL_VERSION, [1.0, 0.0, 0.0, 0.0]),
    ] {
        assert_eq!(command(&mut world, 1, OTHER_STATION, command_id, params), MavResult::ACCEPTED, "{command_id:?}");
    }
    assert_eq!(counters(&world).commands, 0);
}

/// Three ground stations, a secondary one first; the companion computer; and a sender without heartbeats.
const SENDERS: [Address; 5] = [Address::new(253, 190), OTHER_STATION, STATION, COMPANION, SILENT];

#[derive(Clone, Copy, Debug)]
enum Action {
    Beat,
    Request {
        allow: bool,
    },
    Release,
    /// The message with this number.
    Control(usize),
}

/// An action of a sender, and how long after the one before (ms).
#[derive(Clone, Copy, Debug)]
struct Event {
    wait: u64,
    sender: usize,
    action: Action,
}

/// The frames that control the vehicle: commands, then messages that are equivalent to one, then sticks and setpoints.
fn controls(world: &mut Shared, from: Address) -> Vec<Vec<u8>> {
    let (target_system, target_component) = (1, 1);
    let long = |command| CommandLong { command, param1: 1.0, target_system, target_component, ..Default::default() };
    let gcs = &mut world.gcs[0];
    let base_mode = MavModeFlag::CUSTOM_MODE_ENABLED;
    let type_mask = AttitudeTargetTypemask::ATTITUDE_IGNORE;
    vec![
        gcs.frame_from(from, &long(MavCmd::NAV_LAND)),
        gcs.frame_from(from, &long(MavCmd::COMPONENT_ARM_DISARM)),
        gcs.frame_from(from, &CommandLong { target_system: 0, ..long(MavCmd::COMPONENT_ARM_DISARM) }),
        gcs.frame_from(
            from,
            &CommandLong { param2: 1_500.0, param3: 1.0, param4: 1.0, ..long(MavCmd::DO_REPEAT_SERVO) },
        ),
        gcs.frame_from(from, &long(MavCmd::MISSION_START)),
        gcs.frame_from(from, &long(MavCmd::DO_SET_MISSION_CURRENT)),
        gcs.frame_from(from, &long(MavCmd(42_424))),
        gcs.frame_from(
            from,
            &CommandInt { command: MavCmd::DO_REPOSITION, target_system, target_component, ..Default::default() },
        ),
        gcs.frame_from(from, &SetMode { custom_mode: 1, target_system, base_mode }),
        gcs.frame_from(from, &CommandCancel { command: MavCmd::NAV_LAND, target_system, target_component }),
        gcs.frame_from(from, &MissionSetCurrent { seq: 0, target_system, target_component }),
        gcs.frame_from(from, &stick(100)),
        gcs.frame_from(from, &RcChannelsOverride { target_system, chan1_raw: 1_500, ..Default::default() }),
        gcs.frame_from(from, &setpoint()),
        gcs.frame_from(from, &SetPositionTargetGlobalInt { target_system, target_component, ..Default::default() }),
        gcs.frame_from(from, &SetAttitudeTarget { target_system, type_mask, ..Default::default() }),
    ]
}

// SET_MODE is no command, because the vehicle has no modes.
const COMMANDS: usize = 8;
const CANCEL: usize = 9;
const LIKE_COMMANDS: usize = 11;
const CONTROLS: usize = 16;

fn event() -> impl Strategy<Value = Event> {
    let wait = prop_oneof![4 => 0..300u64, 1 => 1_000..3_001u64];
    let action = prop_oneof![
        4 => Just(Action::Beat),
        2 => any::<bool>().prop_map(|allow| Action::Request { allow }),
        1 => Just(Action::Release),
        8 => (0..CONTROLS).prop_map(Action::Control),
    ];
    (wait, 0..SENDERS.len(), action).prop_map(|(wait, sender, action)| Event { wait, sender, action })
}

/// The reference model of who is in control.
#[derive(Default)]
struct Model {
    now: u64,
    owner: Option<usize>,
    allows: bool,
    keeps: bool,
    /// When each sender has sent its last heartbeat (ms).
    beats: [Option<u64>; SENDERS.len()],
    counters: OperatorCounters,
}

impl Model {
    fn is_alive(&self, sender: usize) -> bool {
        self.beats[sender].is_some_and(|at| self.now - at < 5_000)
    }

    fn wait(&mut self, millis: u64) {
        self.now += millis;
        if self.owner.is_some_and(|owner| !self.keeps && !self.is_alive(owner)) {
            (self.owner, self.allows) = (None, false);
        }
    }

    fn may(&self, sender: usize, control: usize) -> bool {
        let is_secondary = sender == 0 && control < LIKE_COMMANDS;
        self.owner.is_none_or(|owner| owner == sender) || SENDERS[sender] == COMPANION || is_secondary
    }

    fn on(&mut self, sender: usize, action: Action) {
        match action {
            Action::Beat => self.beats[sender] = Some(self.now),
            _ if SENDERS[sender] == COMPANION && !matches!(action, Action::Control(_)) => {}
            Action::Request { allow } => {
                let is_free = self.allows || self.owner.is_none_or(|owner| owner == sender);
                if is_free && (self.keeps || self.is_alive(sender)) {
                    (self.owner, self.allows) = (Some(sender), allow);
                    self.counters.granted += 1;
                } else {
                    self.counters.refused += 1;
                }
            }
            Action::Release if self.owner == Some(sender) => (self.owner, self.allows) = (None, false),
            Action::Release => {}
            Action::Control(control) => {
                let refused = u32::from(!self.may(sender, control));
                *if control < COMMANDS { &mut self.counters.commands } else { &mut self.counters.messages } += refused;
            }
        }
    }
}

fn run(keeps: bool, events: &[Event]) -> Result<(), TestCaseError> {
    let mut frames = World::<3, Controlled>::of(Setup::new());
    let setup = Setup::<3>::new();
    let mut stack: Box<Stack<Controlled, 3>> = Box::new(Stack::VACANT);
    stack.begin(setup.config, [LinkConfig::unlimited().with_own_system(true); 3]);
    let mut vehicle = TestVehicle::new();
    vehicle.cancels = true;
    vehicle.long.insert(MavCmd::NAV_LAND.0);
    vehicle.outcomes.remove(&MavCmd::NAV_LAND.0);
    stack.manual_input_mut().set_source(ALL);
    stack.setpoints.set_source(ALL);
    let control: &mut OperatorControl = stack.operator_control_mut();
    control.set_secondaries(&[SENDERS[0].system]);
    control.set_release_on_loss(!keeps);
    let mut model = Model { keeps, ..Model::default() };
    for &Event { wait, sender, action } in events {
        model.wait(wait);
        let (now, from) = (mavstack::Instant::from_millis(model.now), SENDERS[sender]);
        stack.poll(now, &mut vehicle);
        let link = LinkId(0);
        // Answers are taken, so that there is room for more.
        loop {
            let len = stack.transmit(now, link, &mut vehicle).len();
            if len == 0 {
                break;
            }
            stack.transmitted(link, len);
        }
        let params = |action, allow| CommandLong {
            param1: action,
            param2: allow,
            command: REQUEST_OPERATOR_CONTROL,
            target_system: 1,
            target_component: 1,
            ..Default::default()
        };
        let frame = match action {
            Action::Beat if from == COMPANION || from == SILENT => {
                continue;
            }
            Action::Beat => frames.gcs[0].frame_from(from, &Gcs::heartbeat()),
            Action::Request { allow } => frames.gcs[0].frame_from(from, &params(1.0, f32::from(u8::from(allow)))),
            Action::Release => frames.gcs[0].frame_from(from, &params(0.0, 0.0)),
            Action::Control(control) => controls(&mut frames, from).swap_remove(control),
        };
        vehicle.calls.clear();
        prop_assert_eq!(stack.receive(now, link, &frame, &mut vehicle), frame.len());
        let is_refused = matches!(action, Action::Control(control) if !model.may(sender, control));
        model.on(sender, action);
        vehicle.calls.retain(|call| !matches!(call, Call::Peer(_)));
        if is_refused || !matches!(action, Action::Control(_)) {
            prop_assert!(vehicle.calls.is_empty(), "{:?}", vehicle.calls);
        }
        let control = stack.operator_control();
        prop_assert_eq!(stack.operator(now), model.owner.map(|owner| SENDERS[owner].system));
        prop_assert_eq!(stack.allows_takeover(now), model.allows || model.owner.is_none());
        prop_assert_eq!(control.counters(), model.counters);
        // Nobody else steers, neither now nor with what it has sent before.
        let sticks = stack.manual_input().manual_control(now).map(|sticks| sticks.from);
        let channels = stack.manual_input().rc_channels(now).and(stack.manual_input().holder(now));
        let setpoint = stack.setpoints.current(now).map(|setpoint| setpoint.from);
        for Peer { address, .. } in [sticks, channels, setpoint].into_iter().flatten() {
            let sender = SENDERS.iter().position(|sender| *sender == address).unwrap();
            prop_assert!(model.may(sender, CONTROLS - 1), "{address:?} steers");
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(cases(200))]

    /// O-5, C-5, J-2, J-6: whatever a system that is not in control sends, no hook that controls the vehicle is called, and
    /// neither its sticks nor its setpoints are seen.
    #[test]
    fn only_those_in_control_reach_the_vehicle(keeps in any::<bool>(), events in prop::collection::vec(event(), 1..80)) {
        run(keeps, &events)?;
    }
}

/// The property test would prove nothing if the frames reached no hook.
#[test]
fn each_control_reaches_the_vehicle_from_its_owner() {
    let mut reaches = Vec::new();
    for control in 0..CONTROLS {
        let mut world = world();
        world.vehicle.cancels = true;
        world.vehicle.outcomes.remove(&MavCmd::NAV_LAND.0);
        world.vehicle.long.insert(MavCmd::NAV_LAND.0);
        request(&mut world, STATION, 0.0);
        if control == CANCEL {
            // There must be something to cancel.
            land(&mut world, STATION);
        }
        let calls = world.vehicle.calls.len();
        let frame = controls(&mut world, STATION).swap_remove(control);
        world.stack.receive(world.clock.now(), LinkId(0), &frame, &mut world.vehicle);
        let channels = world.stack.manual_input().rc_channels(world.now()).is_some();
        if world.vehicle.calls.len() > calls || steering(&world) != [None; 2] || channels {
            reaches.push(control);
        }
    }
    // Without a mission there is none to start, and no item to set.
    let without = [4, 5, 10];
    assert_eq!(reaches, (0..CONTROLS).filter(|control| !without.contains(control)).collect::<Vec<_>>());
}
