//! The command protocol: rules C-1 to C-13, Q-1 to, V-4, V-6, V-8, L-4.

use crate::support::*;
use mavstack::__private::Declares;
use mavstack::command::CommandPosition;
use mavstack::config::{Identity, LinkClass, TxVersion};
use mavstack::dialect::*;
use mavstack::frame::Version;
use mavstack::{Address, LinkConfig, LinkId, Message, Outcome, Peer, plan_memory};
use proptest::prelude::*;

const LINK: LinkId = LinkId(0);

/// Returns the COMMAND_ACKs that the ground station of `link` received.
fn acks<const N: usize>(world: &World<N>, link: usize) -> Vec<CommandAck> {
    world.gcs[link].all::<CommandAck>().into_iter().map(|(_, ack)| ack).collect()
}

fn ack(command: MavCmd, result: MavResult, to: Address) -> CommandAck {
    CommandAck {
        command,
        result,
        progress: 255,
        result_param2: 0,
        target_system: to.system.wire(),
        target_component: to.component.wire(),
    }
}

/// C-3: every retransmission of a command is carried out and answered once, on its own link, to its own sender, in the same
/// pass of the loop.
#[test]
fn every_retransmission_gets_one_ack() {
    let mut world = World::new(Setup::<2>::new());
    let outcome = Outcome { result: MavResult::TEMPORARILY_REJECTED, result_param2: -77 };
    world.vehicle.outcomes.insert(MavCmd::NAV_LAND.0, outcome);
    let land = world.gcs[0].long(MavCmd::NAV_LAND, [0.0; 7]);
    for copy in 1..=20 {
        world.gcs[0].send(&land);
        world.gcs[1].send_from(OTHER_STATION, &land);
        world.run_for(millis(2));
        assert_eq!(acks(&world, 0).len(), copy);
    }
    world.run_for(secs(5));
    for (link, to) in [(0, STATION), (1, OTHER_STATION)] {
        let expected = CommandAck { result_param2: -77, ..ack(MavCmd::NAV_LAND, outcome.result, to) };
        assert_eq!(acks(&world, link), [expected; 20]);
    }
    let from: Vec<Peer> = world.vehicle.commands().iter().map(|command| command.from).collect();
    assert_eq!(from.len(), 40);
    assert!(from.contains(&Peer { address: OTHER_STATION, link: LinkId(1) }));
}

/// C-1, C-6, C-7: the vehicle gets a command as it was sent, in both forms. Positions are exact in deg·1e7, and "not given"
/// stays "not given".
#[test]
fn vehicle_gets_the_command_as_sent() {
    let mut world = World::new(Setup::<1>::new());
    let params = [1.5, f32::NAN, -3.0, 4.0, 47.397_742, f32::NAN, 488.25];
    let long = CommandLong { confirmation: 3, ..world.gcs[0].long(MavCmd::NAV_TAKEOFF, params) };
    world.gcs[0].send(&long);
    let int = CommandInt {
        target_system: 1,
        target_component: 1,
        command: MavCmd::NAV_LAND,
        frame: MavFrame::GLOBAL_RELATIVE_ALT,
        param4: 90.0,
        x: -473_977_418,
        y: i32::MAX,
        z: f32::NAN,
        ..CommandInt::default()
    };
    world.gcs[0].send(&int);
    world.run_for(millis(5));
    let commands = world.vehicle.commands();
    assert_eq!(commands[0].params.map(f32::to_bits), [1.5, f32::NAN, -3.0, 4.0].map(f32::to_bits));
    assert_eq!((commands[0].id, commands[0].z, commands[0].confirmation), (MavCmd::NAV_TAKEOFF, 488.25, 3));
    // 47.397742 is 47.3977432... as a float.
    assert_eq!(commands[0].position.lat_lon(), (Some(473_977_432), None));
    assert_eq!((commands[1].id, commands[1].confirmation), (MavCmd::NAV_LAND, 0));
    assert!(commands[1].z.is_nan());
    let position = CommandPosition::Int { frame: MavFrame::GLOBAL_RELATIVE_ALT, x: -473_977_418, y: i32::MAX };
    assert_eq!(commands[1].position, position);
    assert_eq!(position.lat_lon(), (Some(-473_977_418), None));
}

/// C-2, R-1: a command for another system, or for another component of ours, is not answered.
#[test]
fn commands_for_others_are_not_answered() {
    let mut world = World::new(Setup::<1>::new());
    let others = [(2, 1), (2, 0), (1, 2), (1, 190), (0, 154), (255, 190)];
    for (target_system, target_component) in others {
        let land = world.gcs[0].long(MavCmd::NAV_LAND, [0.0; 7]);
        world.gcs[0].send(&CommandLong { target_system, target_component, ..land });
        let int = CommandInt { command: MavCmd::NAV_LAND, target_system, target_component, ..CommandInt::default() };
        world.gcs[0].send(&int);
    }
    world.run_for(secs(1));
    assert_eq!(world.vehicle.commands(), []);
    assert_eq!(acks(&world, 0), []);
    assert_eq!(world.stack.link_counters(LINK).unwrap().not_ours, 12);
}

/// C-1, R-1, R-15: component 0 means every component and system 0 every system; the vehicle sees that it was a broadcast. A
/// target whose bytes were removed as trailing zeros is a broadcast too.
#[test]
fn broadcasts_are_carried_out_and_marked() {
    let mut world = World::new(Setup::<1>::new());
    let land = world.gcs[0].long(MavCmd::NAV_LAND, [0.0; 7]);
    for (target_system, target_component) in [(1, 0), (0, 1), (0, 0)] {
        world.gcs[0].send(&CommandLong { target_system, target_component, ..land });
    }
    world.run_for(millis(5));
    let broadcast: Vec<bool> = world.vehicle.commands().iter().map(|command| command.is_broadcast).collect();
    assert_eq!(broadcast, [false, true, true]);
    assert_eq!(acks(&world, 0), [ack(MavCmd::NAV_LAND, MavResult::ACCEPTED, STATION); 3]);
}

/// C-4, S-17: a command that the definitions do not contain is UNSUPPORTED, not ignored.
#[test]
fn unknown_command_is_unsupported() {
    let mut world = World::new(Setup::<1>::new());
    world.gcs[0].command_long(MavCmd(42_424), [f32::NAN; 7]);
    world.gcs[0].command_int(MavCmd(65_535), [f32::INFINITY; 4]);
    world.run_for(millis(5));
    let expected = [42_424, 65_535].map(|id| ack(MavCmd(id), MavResult::UNSUPPORTED, STATION));
    assert_eq!(acks(&world, 0), expected);
}

/// C-13: a COMMAND_ACK is not answered.
#[test]
fn acks_are_not_acked() {
    let mut world = World::new(Setup::<1>::new());
    world.run_for(millis(1));
    world.gcs[0].forget();
    for target_system in [0, 1, 255] {
        world.gcs[0].send(&CommandAck { target_system, ..ack(MavCmd::NAV_LAND, MavResult::ACCEPTED, VEHICLE) });
    }
    world.run_for(millis(500));
    assert_eq!(world.gcs[0].received.len(), 0);
}

/// Sends a REQUEST_MESSAGE with these parameters 1 and 7 in both forms; returns the answer and which messages were received.
fn request(id: f32, target: f32) -> (MavResult, usize, usize) {
    let mut world = World::new(Setup::<1>::new());
    let mut answers = Vec::new();
    for long in [true, false] {
        let gcs = &mut world.gcs[0];
        gcs.forget();
        if long {
            gcs.command_long(MavCmd::REQUEST_MESSAGE, [id, 0.0, 0.0, 0.0, 0.0, 0.0, target]);
        } else {
            gcs.send(&CommandInt {
                command: MavCmd::REQUEST_MESSAGE,
                target_system: 1,
                target_component: 1,
                param1: id,
                z: target,
                ..CommandInt::default()
            });
        }
        world.run_for(millis(100));
        let acks = acks(&world, 0);
        assert_eq!(acks.len(), 1);
        let gcs = &world.gcs[0];
        answers.push((acks[0].result, gcs.count_of::<AutopilotVersion>(), gcs.count_of::<ProtocolVersion>()));
        // the ACK is first.
        let ids: Vec<u32> = gcs.received.iter().map(|frame| frame.header.id).filter(|&id| id != 0).collect();
        assert_eq!(ids[0], CommandAck::ID);
    }
    assert_eq!(answers[0], answers[1], "both forms get the same answer");
    assert_eq!(world.vehicle.commands(), [], "the stack answers without the vehicle");
    answers[0]
}

/// C-8: which messages can be requested, and which requests are refused.
#[test]
fn request_message_accepts_known_messages_only() {
    let (yes, no) = (MavResult::ACCEPTED, MavResult::DENIED);
    assert_eq!(request(148.0, 0.0), (yes, 1, 0));
    assert_eq!(request(300.0, 0.0), (yes, 0, 1));
    for target in [1.0, 2.0, f32::NAN, -0.0] {
        assert_eq!(request(148.0, target), (yes, 1, 0), "response target {target}");
    }
    for target in [3.0, -1.0, 0.5, f32::INFINITY, f32::NEG_INFINITY] {
        assert_eq!(request(148.0, target), (no, 0, 0), "response target {target}");
    }
    let unknown = [f32::NAN, f32::INFINITY, -1.0, -148.0, 148.5, 147.999, 404.0, 99_999.0, 2e7, 4.3e9, 1e30];
    for id in unknown.into_iter().chain([3.0, 32.0, 77.0]) {
        assert_eq!(request(id, 0.0), (no, 0, 0), "message {id}");
    }
    // HEARTBEAT.
    assert_eq!(request(0.0, 0.0), (yes, 0, 0));
}

/// the request commands older than REQUEST_MESSAGE are answered.
#[test]
fn legacy_requests_are_answered() {
    let mut world = World::new(Setup::<1>::new());
    for (command, id) in [
        (MavCmd::REQUEST_AUTOPILOT_CAPABILITIES, AutopilotVersion::ID),
        (MavCmd::REQUEST_PROTOCOL_VERSION, ProtocolVersion::ID),
    ] {
        for (param1, result) in [(1.0, MavResult::ACCEPTED), (0.0, MavResult::DENIED), (f32::NAN, MavResult::DENIED)] {
            world.gcs[0].forget();
            world.gcs[0].command_long(command, [param1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
            world.run_for(millis(100));
            assert_eq!(acks(&world, 0), [ack(command, result, STATION)]);
            let came = world.gcs[0].received.iter().any(|frame| frame.header.id == id);
            assert_eq!(came, result == MavResult::ACCEPTED);
        }
    }
}

/// Q-9, V-4: AUTOPILOT_VERSION announces what the compiled stack supports, what the firmware adds, and the firmware's identity.
#[test]
fn capabilities_match_the_build() {
    let identity = Identity {
        capabilities: MavProtocolCapability::SET_ATTITUDE_TARGET,
        flight_sw_version: 0x0102_03FF,
        middleware_sw_version: 5,
        os_sw_version: 6,
        board_version: 7,
        flight_custom_version: *b"deadbeef",
        vendor_id: 0x1209,
        product_id: 0x0001,
        uid: 0x0123_4567_89AB_CDEF,
        uid2: [0xA5; 18],
    };
    let mut setup = Setup::<1>::new();
    setup.config.identity = identity;
    let mut world = World::new(setup);
    world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [148.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let version: AutopilotVersion = world.expect(0, millis(10));
    let own = MavProtocolCapability::MAVLINK2
        | MavProtocolCapability::COMMAND_INT
        | MavProtocolCapability::PARAM_ENCODE_BYTEWISE;
    let expected = AutopilotVersion {
        capabilities: own | MavProtocolCapability::SET_ATTITUDE_TARGET,
        uid: identity.uid,
        flight_sw_version: identity.flight_sw_version,
        middleware_sw_version: 5,
        os_sw_version: 6,
        board_version: 7,
        vendor_id: identity.vendor_id,
        product_id: identity.product_id,
        flight_custom_version: identity.flight_custom_version,
        uid2: identity.uid2,
        ..AutopilotVersion::default()
    };
    assert_eq!(version, expected);
    // only plans that have memory are announced.
    let mission = MavProtocolCapability::MISSION_INT | MavProtocolCapability::MISSION_FLOAT;
    assert_eq!(capabilities::<Tested<plan_memory!(mission: 10)>>(), own | mission);
    let fence = MavProtocolCapability::MISSION_FENCE;
    assert_eq!(capabilities::<Tested<plan_memory!(mission: 0, fence: 10)>>(), own | fence);
    let rally = MavProtocolCapability::MISSION_RALLY;
    assert_eq!(
        capabilities::<Tested<plan_memory!(mission: 10, fence: 10, rally: 10)>>(),
        own | mission | fence | rally
    );
}

/// Returns what AUTOPILOT_VERSION announces with this plan memory.
fn capabilities<D: Declares<Vehicle = TestVehicle>>() -> MavProtocolCapability {
    let mut world = World::<1, D>::of(Setup::new());
    world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [148.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    world.expect::<AutopilotVersion>(0, millis(10)).capabilities
}

/// V-6, V-8: on a v1 link answers are v1, without what v1 cannot carry. Only PROTOCOL_VERSION is sent as v2, because that is
/// the answer.
#[test]
fn answers_keep_the_version_of_the_link() {
    let links = [LinkConfig::uart(57_600).with_version(TxVersion::V1)];
    let mut setup = Setup { links, ..Setup::new() };
    setup.config.identity.uid2 = [0xA5; 18];
    let mut world = World::new(setup);
    for id in [148.0, 300.0] {
        world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [id, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }
    world.run_for(millis(50));
    for frame in &world.gcs[0].received {
        let version = if frame.header.id == ProtocolVersion::ID { Version::V2 } else { Version::V1 };
        assert_eq!(frame.header.version, version, "message {}", frame.header.id);
    }
    let version: AutopilotVersion = world.expect(0, millis(1));
    assert_eq!(version.uid2, [0; 18], "an extension field");
    let protocol: ProtocolVersion = world.expect(0, millis(1));
    assert_eq!((protocol.min_version, protocol.max_version, protocol.version), (100, 200, 200));
    assert_eq!(world.gcs[0].count_of::<CommandAck>(), 2);
}

/// D-3: while a link is backpressured, four answers can be pending. A fifth command is not carried out and is counted; a
/// retransmission of it is answered.
#[test]
fn command_without_room_for_its_answer_is_not_carried_out() {
    let mut world = World::new(Setup::<2>::new());
    world.run_for(millis(10));
    world.uarts[0].stall_writes_until(mavstack::Instant::from_millis(3_000));
    for target in 1..=6 {
        world.gcs[0].command_long(MavCmd::NAV_TAKEOFF, [target as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }
    world.run_for(millis(100));
    let targets =
        |world: &World<2>| world.vehicle.commands().iter().map(|command| command.params[0]).collect::<Vec<_>>();
    assert_eq!(targets(&world), [1.0, 2.0, 3.0, 4.0]);
    assert_eq!(world.stack.link_counters(LINK).unwrap().no_answer_slot, 2);
    // Each link has its own slots.
    world.gcs[1].command_long(MavCmd::NAV_TAKEOFF, [9.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    world.expect::<CommandAck>(1, millis(10));
    world.run_for(secs(3));
    assert_eq!(acks(&world, 0).len(), 4);
    for target in 5..=6 {
        world.gcs[0].command_long(MavCmd::NAV_TAKEOFF, [target as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }
    world.run_for(millis(100));
    assert_eq!(targets(&world), [1.0, 2.0, 3.0, 4.0, 9.0, 5.0, 6.0]);
    assert_eq!(acks(&world, 0).len(), 6);
}

/// L-3, L-4: over a high-latency link commands are carried out and answered, and nothing else is; messages cannot be requested.
#[test]
fn high_latency_link_carries_commands_only() {
    let satellite = LinkConfig::uart(9_600).with_class(LinkClass::HighLatency);
    let mut world = World::new(Setup { links: [satellite], ..Setup::new() });
    world.gcs[0].command_long(MavCmd::NAV_LAND, [0.0; 7]);
    world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [148.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    world.gcs[0].command_long(MavCmd::REQUEST_PROTOCOL_VERSION, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let (target_system, target_component) = (1, 1);
    world.gcs[0].send(&MissionRequestList { target_system, target_component, ..MissionRequestList::default() });
    world.gcs[0].send(&Ping { seq: 1, ..Ping::default() });
    world.run_for(secs(10));
    let denied = MavResult::DENIED;
    let expected = [
        ack(MavCmd::NAV_LAND, MavResult::ACCEPTED, STATION),
        ack(MavCmd::REQUEST_MESSAGE, denied, STATION),
        ack(MavCmd::REQUEST_PROTOCOL_VERSION, denied, STATION),
    ];
    assert_eq!(acks(&world, 0), expected);
    assert_eq!(world.gcs[0].received.len(), 3, "the answers only");
    assert_eq!(world.vehicle.calls.len(), 1);
    assert_eq!(world.stack.link_counters(LINK).unwrap().out_of_place, 2);
}

/// Any input: a message of the streams, a plan message, a command.
fn any_input() -> impl Strategy<Value = (u32, Vec<u8>)> {
    let ids = [75u32, 76, 76, 76, 44, 43, 51, 73, 47, 45, 40, 41, 4, 0, 11, 66, 111, 253, 20, 23];
    (prop::sample::select(ids.to_vec()), prop::collection::vec(any::<u8>(), 0..40))
}

proptest! {
    #![proptest_config(cases(64))]

    /// L-4: whatever is received on either link, only acknowledgements are sent over satellite, one for each command.
    #[test]
    fn only_acks_are_sent_over_satellite(inputs in prop::collection::vec((any_input(), 0usize..2, 0u8..3), 1..60)) {
        let satellite = LinkConfig::uart(9_600).with_class(LinkClass::HighLatency);
        type Plans = Tested<plan_memory!(mission: 10)>;
        let setup = Setup { links: [satellite, LinkConfig::uart(57_600)], ..Setup::new() };
        let mut world = World::<2, Plans>::of(setup);
        let mut commands = [0, 0];
        for ((id, mut payload), link, target) in inputs {
            let row = <Common as mavstack::message::Dialect>::MESSAGES.get(id).unwrap();
            payload.resize(usize::from(row.max_len()), 0);
            for at in [row.target_system(), row.target_component()].into_iter().flatten() {
                payload[usize::from(at)] = target.min(1);
            }
            if id == 76 || id == 75 {
                commands[link] += 1;
            }
            let frame = reference::v2(id, [0, 0], [255, 190], &payload, row.crc_extra());
            world.gcs[link].send_raw(&frame);
            world.stack.text(world.now(), MavSeverity(payload[0] % 8), "something happened");
            world.run_for(millis(5));
        }
        world.run_for(secs(1));
        prop_assert!(world.gcs[0].received.iter().all(|frame| frame.header.id == CommandAck::ID));
        let answers = [0, 1].map(|link: usize| world.gcs[link].count_of::<CommandAck>());
        prop_assert_eq!(answers, commands);
    }
}
