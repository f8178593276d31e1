//! Forwarding between the links of one vehicle: rules, L-3 to L-5. Several vehicles are in `networks.rs`.

mod satellite;

use crate::Forwarder;
use crate::support::*;
use mavstack::__private::NoPlans;
use mavstack::config::{LinkClass, TxVersion};
use mavstack::dialect::*;
use mavstack::frame::Version;
use mavstack::network::ForwardCounters;
use mavstack::{Address, Command, LinkConfig, LinkId, Message, Text};

/// A companion computer of the vehicle's own system.
const COMPANION: Address = Address::new(1, 191);
/// Another component of the vehicle's own system.
const GIMBAL: Address = Address::new(1, 154);
/// Another vehicle.
const WINGMAN: Address = Address::new(2, 1);

/// A vehicle that forwards between its links. Each link has already sent its first frames.
fn world<const N: usize>(links: [LinkConfig; N]) -> Forwarder<N> {
    let mut world = Forwarder::of(Setup { links, ..Setup::new() });
    for gcs in &mut world.gcs {
        gcs.takes_unknown = true;
    }
    world.run_for(millis(10));
    world
}

/// `N` normal links.
fn normal<const N: usize>() -> Forwarder<N> {
    world([LinkConfig::uart(115_200); N])
}

/// Makes `address` known on a link.
fn introduce<const N: usize>(world: &mut Forwarder<N>, link: usize, address: Address) {
    // Different sequence numbers on each link, or this would be one frame by two paths.
    world.gcs[link].skip_seq(address, 50 * link as u8 + 1);
    world.gcs[link].send_from(address, &Attitude::default());
    world.run_for(millis(5));
    forget(world);
}

fn forget<const N: usize>(world: &mut Forwarder<N>) {
    world.gcs.iter_mut().for_each(Gcs::forget);
}

/// Sends `frame` on a link and returns the links that it is forwarded to, unchanged, once per time. Takes 60 ms, because a
/// frame with an unknown id waits for silence.
fn sent_on<const N: usize>(world: &mut Forwarder<N>, link: usize, frame: &[u8]) -> Vec<usize> {
    world.gcs[link].send_raw(frame);
    world.run_for(millis(60));
    let found = |gcs: &Gcs| gcs.received.iter().filter(|received| received.raw == frame).count();
    let links = (0..N).flat_map(|link| vec![link; found(&world.gcs[link])]).collect();
    // Frames of others are never changed.
    for received in world.gcs.iter().flat_map(|gcs| &gcs.received) {
        assert!(received.header.source == VEHICLE || received.raw == frame, "{received:?}");
    }
    forget(world);
    links
}

/// Returns the links to which a message of `from`, sent on `link`, is forwarded.
fn reaches<const N: usize, M: Message>(
    world: &mut Forwarder<N>,
    link: usize,
    from: Address,
    message: &M,
) -> Vec<usize> {
    let frame = world.gcs[link].frame_from(from, message);
    sent_on(world, link, &frame)
}

/// PLAY_TUNE for `target`.
fn tune(target: Address) -> PlayTune {
    let (target_system, target_component) = (target.system.wire(), target.component.wire());
    PlayTune { target_system, target_component, ..PlayTune::default() }
}

fn counters<const N: usize>(world: &Forwarder<N>, link: u8) -> ForwardCounters {
    world.stack.forward_counters(LinkId(link)).unwrap()
}

/// a broadcast is handled here and forwarded to every other link, never back.
#[test]
fn broadcast_is_forwarded_to_all_other_links() {
    let mut world = normal::<4>();
    assert_eq!(reaches(&mut world, 1, STATION, &Attitude::default()), [0, 2, 3]);
    assert_eq!(reaches(&mut world, 3, OTHER_STATION, &tune(Address::new(0, 0))), [0, 1, 2]);
    // heartbeats too.
    assert_eq!(reaches(&mut world, 0, WINGMAN, &Gcs::heartbeat()), [1, 2, 3]);
    let ids: Vec<u32> = world
        .vehicle
        .calls
        .iter()
        .filter_map(|call| match call {
            Call::Message { id, .. } => Some(*id),
            _ => None,
        })
        .collect();
    assert_eq!(ids, [Attitude::ID, PlayTune::ID], "handled here once");
}

/// an addressed frame is forwarded to each link where its target was heard, and to no other.
#[test]
fn addressed_frames_follow_learned_routes() {
    let mut world = normal::<4>();
    assert_eq!(reaches(&mut world, 0, STATION, &tune(WINGMAN)), [0; 0], "the target was not heard yet");
    assert_eq!(counters(&world, 0).no_route, 1);
    introduce(&mut world, 2, WINGMAN);
    assert_eq!(reaches(&mut world, 0, STATION, &tune(WINGMAN)), [2]);
    introduce(&mut world, 3, WINGMAN);
    assert_eq!(reaches(&mut world, 0, STATION, &tune(WINGMAN)), [2, 3]);
    // The way back; all components of a system; a component that was not heard.
    assert_eq!(reaches(&mut world, 2, WINGMAN, &tune(STATION)), [0]);
    assert_eq!(reaches(&mut world, 0, STATION, &tune(Address::new(2, 0))), [2, 3]);
    assert_eq!(reaches(&mut world, 0, STATION, &tune(Address::new(2, 7))), [0; 0]);
    // Two peers on one line reach each other without us.
    introduce(&mut world, 0, OTHER_STATION);
    assert_eq!(reaches(&mut world, 0, STATION, &tune(OTHER_STATION)), [0; 0]);
    assert_eq!(counters(&world, 0).no_route, 2, "its link is known");
    assert!(
        !world.vehicle.calls.iter().any(|call| matches!(call, Call::Message { id: PlayTune::ID, .. })),
        "not for us"
    );
}

/// frames for other components of our system; a frame for all of them is handled here too.
#[test]
fn frames_for_own_components_are_forwarded() {
    let mut world = normal::<3>();
    introduce(&mut world, 1, COMPANION);
    introduce(&mut world, 2, WINGMAN);
    let handled = |world: &mut Forwarder<3>| std::mem::take(&mut world.vehicle.calls).len();
    handled(&mut world);
    assert_eq!(reaches(&mut world, 0, STATION, &tune(COMPANION)), [1]);
    assert_eq!(handled(&mut world), 0);
    assert_eq!(reaches(&mut world, 0, STATION, &tune(Address::new(1, 0))), [1]);
    assert_eq!(handled(&mut world), 1);
    assert_eq!(reaches(&mut world, 0, STATION, &tune(VEHICLE)), [0; 0]);
    assert_eq!(handled(&mut world), 1);
    // A target system without a component; MANUAL_CONTROL names the field differently.
    assert_eq!(reaches(&mut world, 0, STATION, &SetMode { target_system: 1, ..Default::default() }), [1]);
    assert_eq!(reaches(&mut world, 0, STATION, &ManualControl { target: 2, x: 9, ..Default::default() }), [2]);
    assert_eq!(handled(&mut world), 1, "SET_MODE");
}

/// targets that were removed as trailing zeros mean everyone.
#[test]
fn truncated_targets_mean_everyone() {
    let mut world = normal::<3>();
    introduce(&mut world, 1, WINGMAN);
    let ack = |target: Address| CommandAck {
        command: MavCmd::NAV_LAND,
        target_system: target.system.wire(),
        target_component: target.component.wire(),
        ..CommandAck::default()
    };
    let frame = world.gcs[0].frame_from(STATION, &ack(Address::new(0, 0)));
    assert_eq!(frame.len(), 12 + 1, "half of the command's id");
    assert_eq!(sent_on(&mut world, 0, &frame), [1, 2]);
    assert_eq!(reaches(&mut world, 0, STATION, &ack(WINGMAN)), [1]);
    // A v1 frame has no extensions, so an answer has no target.
    world.gcs[0].version = Version::V1;
    assert_eq!(reaches(&mut world, 0, STATION, &ack(WINGMAN)), [1, 2]);
}

/// a broadcast is not forwarded to a link where its source is heard; an addressed frame still reaches its target.
#[test]
fn broadcast_is_not_forwarded_to_links_of_its_source() {
    let mut world = normal::<4>();
    introduce(&mut world, 0, WINGMAN);
    introduce(&mut world, 1, WINGMAN);
    introduce(&mut world, 1, STATION);
    assert_eq!(reaches(&mut world, 0, WINGMAN, &Attitude::default()), [2, 3]);
    assert_eq!(counters(&world, 1).source_heard, 1);
    assert_eq!(reaches(&mut world, 0, WINGMAN, &tune(STATION)), [1]);
}

/// a single frame that took another path or was forged blocks no route: addressed frames are forwarded at once, broadcasts
/// after 5 s. Broadcasts that are withheld until then are counted.
#[test]
fn single_forged_frame_blocks_no_route() {
    let mut world = normal::<3>();
    introduce(&mut world, 1, WINGMAN);
    introduce(&mut world, 0, STATION);
    // A forged frame in the station's name.
    introduce(&mut world, 1, STATION);
    let begin = world.now();
    assert_eq!(reaches(&mut world, 0, STATION, &tune(WINGMAN)), [1]);
    let mut withheld = 0;
    while world.now() - begin < millis(4_900) {
        assert_eq!(reaches(&mut world, 0, STATION, &Attitude::default()), [2]);
        withheld += 1;
        assert_eq!(reaches(&mut world, 0, STATION, &tune(WINGMAN)), [1]);
    }
    assert_eq!(
        [0, 1, 2].map(|link| counters(&world, link).source_heard),
        [1, withheld, 0],
        "the forged one, and the real ones"
    );
    world.run_for(millis(110));
    forget(&mut world);
    assert_eq!(reaches(&mut world, 0, STATION, &Attitude::default()), [1, 2]);
    assert_eq!(reaches(&mut world, 0, STATION, &tune(WINGMAN)), [1]);
}

/// frames are forwarded unchanged: unknown ids, signatures with any key, compatibility flags, untrimmed
/// payloads, payloads longer than known, v1.
#[test]
fn frames_are_forwarded_bit_for_bit() {
    let mut world = normal::<2>();
    introduce(&mut world, 1, WINGMAN);
    introduce(&mut world, 0, STATION);
    let crc = 39; // ATTITUDE's
    let signature = [3, 1, 2, 3, 4, 5, 6, 0xBA, 0xD0, 0xBA, 0xD0, 0xBA, 0xD0];
    let signed = [reference::v2(30, [1, 0], [255, 190], &[9; 28], crc), signature.to_vec()].concat();
    let longest = [reference::v2(30, [1, 0], [255, 190], &[8; 255], crc), signature.to_vec()].concat();
    let unknown = reference::v2(0x00AB_CDEF, [0, 0], [255, 190], &[1, 2, 0, 0], 0);
    let unknown_signed = [reference::v2(0x00AB_CDEF, [1, 7], [255, 190], &[5], 0), signature.to_vec()].concat();
    for (name, frame) in [
        ("signed", signed),
        ("longest", longest),
        ("unknown", unknown),
        ("unknown and signed", unknown_signed),
        ("unknown v1", reference::v1(199, [255, 190], &[1, 2, 3], 0)),
        ("compatibility flags", reference::v2(30, [0, 0xA5], [255, 190], &[7; 28], crc)),
        ("untrimmed", reference::v2(30, [0, 0], [255, 190], &[0; 28], crc)),
        ("v1", reference::v1(30, [255, 190], &[6; 28], crc)),
        // PLAY_TUNE to 2/1, signed with an unknown key.
        ("addressed", [reference::v2(258, [1, 0], [255, 190], &[2, 1, 65], 187), signature.to_vec()].concat()),
    ] {
        assert_eq!(sent_on(&mut world, 0, &frame), [1], "{name}");
    }
}

/// a v2 frame for a link that sends v1 is dropped and counted; a v1 frame is forwarded to any link.
#[test]
fn v1_links_get_v1_frames() {
    let v1 = LinkConfig::uart(115_200).with_version(TxVersion::V1);
    let auto = LinkConfig::uart(115_200).with_version(TxVersion::Auto);
    let mut world = world([LinkConfig::uart(115_200), v1, auto]);
    assert_eq!(reaches(&mut world, 0, STATION, &Attitude::default()), [0; 0]);
    assert_eq!([1, 2].map(|link| counters(&world, link).needs_v2), [1, 1]);
    world.gcs[0].version = Version::V1;
    assert_eq!(reaches(&mut world, 0, STATION, &Attitude::default()), [1, 2]);
    // A link that has switched to v2 gets v2 frames.
    introduce(&mut world, 2, WINGMAN);
    world.gcs[0].version = Version::V2;
    assert_eq!(reaches(&mut world, 0, STATION, &Attitude::default()), [2]);
}

/// a frame that returns on another link is dropped: it is neither forwarded nor handled again, and teaches no route. A
/// frame that is sent again has a new sequence number and is forwarded.
#[test]
fn returning_frame_is_dropped() {
    let mut world = normal::<3>();
    let command =
        CommandLong { target_system: 0, command: MavCmd::NAV_LAND, ..world.gcs[0].long(MavCmd::NAV_LAND, [0.0; 7]) };
    let frame = world.gcs[0].frame_from(STATION, &command);
    assert_eq!(sent_on(&mut world, 0, &frame), [1, 2]);
    assert_eq!(sent_on(&mut world, 1, &frame), [0; 0]);
    assert_eq!(sent_on(&mut world, 0, &frame), [0; 0]);
    assert_eq!(world.vehicle.commands().len(), 1);
    assert_eq!([0, 1, 2].map(|link| counters(&world, link).duplicates), [1, 1, 0]);
    assert!(world.stack.peers(world.now()).all(|info| info.peer.link == LinkId(0)));
    let again = world.gcs[0].frame_from(STATION, &command);
    assert_eq!(sent_on(&mut world, 0, &again), [1, 2]);
    assert_eq!(world.vehicle.commands().len(), 2);
    // A sender that does not count: the same bytes a second later are a new frame.
    world.run_for(secs(1));
    assert_eq!(sent_on(&mut world, 0, &frame), [1, 2]);
}

/// the station's command is carried out, although another sender has sent a frame with the same hash before. The two frames collide
/// under the 32-bit hash without a key by which duplicates were recognised.
#[test]
fn nobody_can_hide_a_command_by_a_collision() {
    const FORGED: &str = "FD1F000000FE014C0000000000008785ED000000803F00000000000000000000000000000000900101917B";
    const DISARM: &str = "FD1F0000B0FFBE4C0000000000000000000000000000000000000000000000000000000000009001012E14";
    let bytes = |hex: &str| -> Vec<u8> {
        (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).expect("hexadecimal")).collect()
    };
    let mut world = normal::<3>();
    // A camera of the vehicle, to which its commands are forwarded.
    introduce(&mut world, 2, Address::new(1, 100));
    assert_eq!(sent_on(&mut world, 1, &bytes(FORGED)), [2]);
    world.vehicle.calls.clear();
    world.gcs[0].forget();
    world.gcs[0].send_raw(&bytes(DISARM));
    world.run_for(millis(100));
    let commands = world.vehicle.commands();
    assert!(matches!(&commands[..], [Command { id: MavCmd::COMPONENT_ARM_DISARM, .. }]), "{commands:?}");
    assert_eq!(world.gcs[0].count_of::<CommandAck>(), 1);
    assert_eq!(counters(&world, 0).duplicates, 0);
}

/// duplicates, on the same link or another, do not keep other frames from being forwarded.
#[test]
fn duplicates_do_not_block_other_frames() {
    for copy in [None, Some(0), Some(1)] {
        let mut world = world([LinkConfig::uart(921_600); 2]);
        introduce(&mut world, 1, WINGMAN);
        let tune = tune(WINGMAN);
        let mut sent = Vec::new();
        for round in 0..2_000 {
            let frame = world.gcs[0].frame_from(STATION, &PlayTune { tune: Text::new(&format!("{round}")), ..tune });
            world.gcs[0].send_raw(&frame);
            world.run_for(millis(5));
            if let Some(link) = copy.filter(|_| round % 100 == 0) {
                world.gcs[link].send_raw(&frame);
            }
            sent.push(frame);
        }
        world.run_for(millis(50));
        let arrived =
            world.gcs[1].received.iter().filter(|frame| frame.header.id == PlayTune::ID).map(|frame| &frame.raw);
        assert!(arrived.eq(&sent), "duplicates on {copy:?}");
        let duplicates = [0, 1].map(|link| counters(&world, link as u8).duplicates);
        assert_eq!(duplicates, [0, 1].map(|link| if copy == Some(link) { 20 } else { 0 }));
    }
}

/// a flood that exceeds the memory on one link delays only broadcasts of that link.
#[test]
fn flood_affects_only_its_own_link() {
    let mut world = world([LinkConfig::uart(921_600); 3]);
    introduce(&mut world, 0, STATION);
    let (mut heard, mut tunes) = (0, 0);
    for round in 0..2_000 {
        world.gcs[1].send_from(WINGMAN, &Attitude { yaw: round as f32, ..Attitude::default() });
        if round % 50 == 0 {
            world.gcs[0].send_from(STATION, &Gcs::heartbeat());
            world.gcs[1].send_from(WINGMAN, &tune(STATION));
        }
        world.run_for(millis(1));
        heard += world.gcs[2].count_of::<Heartbeat>();
        tunes += world.gcs[0].count_of::<PlayTune>();
        forget(&mut world);
    }
    // Two of the heartbeats are the vehicle's own.
    assert_eq!((heard, tunes), (40 + 2, 40));
    let dropped = [0, 1, 2].map(|link| counters(&world, link).not_remembered);
    // 240 frames a second are remembered.
    assert!(dropped[0] == 0 && (1_300..1_500).contains(&dropped[1]) && dropped[2] == 0, "{dropped:?}");
}

/// a duplicate keeps a peer alive, as any frame of it does.
#[test]
fn duplicates_keep_a_known_peer_alive() {
    let mut world = normal::<3>();
    world.gcs[0].send(&Gcs::heartbeat());
    world.run_for(millis(10));
    world.gcs[1].skip_seq(STATION, 100);
    world.gcs[1].send_from(STATION, &Gcs::heartbeat());
    world.run_for(secs(1));
    assert_eq!(world.vehicle.peer_events().len(), 2);
    // The station's heartbeats arrive on both links, always later on the second.
    for _ in 0..20 {
        let frame = world.gcs[0].frame_from(STATION, &Gcs::heartbeat());
        world.gcs[0].send_raw(&frame);
        world.run_for(millis(30));
        world.gcs[1].send_raw(&frame);
        world.run_for(millis(970));
    }
    assert_eq!(world.vehicle.peer_events().len(), 2, "it never timed out");
    assert_eq!(counters(&world, 1).duplicates, 20);
}

/// R-7, D-1: a reboot of the sender makes its routes invalid on the links where it is not heard any more; a wrap of 2^32 ms is not a
/// reboot.
#[test]
fn reboot_forgets_routes() {
    let mut world = normal::<3>();
    let time = |ms: u32| SystemTime { time_boot_ms: ms, time_unix_usec: 0 };
    for (link, ms) in [(1, u32::MAX - 500), (2, u32::MAX - 400), (1, 600), (2, 700)] {
        world.gcs[link].send_from(WINGMAN, &time(ms));
        world.run_for(millis(5));
    }
    forget(&mut world);
    assert_eq!(reaches(&mut world, 0, STATION, &tune(WINGMAN)), [1, 2]);
    world.gcs[2].send_from(WINGMAN, &time(3_700_000));
    world.run_for(millis(5));
    for second in 1..7 {
        world.gcs[2].send_from(WINGMAN, &time(second * 1_000));
        world.run_for(secs(1));
        forget(&mut world);
        let links: &[usize] = if second < 6 { &[1, 2] } else { &[2] };
        assert_eq!(reaches(&mut world, 0, STATION, &tune(WINGMAN)), links, "{second} s after the reboot");
    }
    assert_eq!(reaches(&mut world, 2, WINGMAN, &Attitude::default()), [0, 1], "not heard there since");
    introduce(&mut world, 1, WINGMAN);
    assert_eq!(reaches(&mut world, 0, STATION, &tune(WINGMAN)), [1, 2]);
}

/// a forged SYSTEM_TIME leads nobody away from a component that is still heard on its own link. Before, all 160 of 160 frames for
/// it went to the attacker.
#[test]
fn forged_reboot_leads_nobody_away() {
    let mut world = normal::<3>();
    let time = |ms: u32| SystemTime { time_boot_ms: ms, time_unix_usec: 0 };
    let mut received = 0;
    for round in 0..160 {
        world.gcs[1].send_from(WINGMAN, &time(10_000_000 + 100 * round));
        world.gcs[2].send_from(WINGMAN, &time(20_000_000));
        world.gcs[2].send_from(WINGMAN, &time(round));
        world.run_for(millis(100));
        forget(&mut world);
        received += usize::from(reaches(&mut world, 0, STATION, &tune(WINGMAN)).contains(&1));
    }
    assert_eq!(received, 160);
}

/// R-11, G-11, H-13: keys and the reports of a radio are not forwarded.
#[test]
fn keys_and_radio_reports_are_not_forwarded() {
    let mut world = normal::<2>();
    introduce(&mut world, 1, WINGMAN);
    let key = |target: Address| SetupSigning {
        target_system: target.system.wire(),
        target_component: target.component.wire(),
        secret_key: mavstack::message::Secret([7; 32]),
        ..SetupSigning::default()
    };
    for target in [Address::new(0, 0), WINGMAN, Address::new(1, 0), VEHICLE] {
        assert_eq!(reaches(&mut world, 0, STATION, &key(target)), [0; 0], "to {target:?}");
    }
    let radio = Address::new(51, 68);
    assert_eq!(reaches(&mut world, 0, radio, &RadioStatus { rssi: 9, ..Default::default() }), [0; 0]);
    // The older form, which common does not define.
    let older = reference::v1(166, [51, 68], &[0; 9], 21);
    assert_eq!(sent_on(&mut world, 0, &older), [0; 0]);
}

/// S-15, R-8: our own frames that return are not forwarded.
#[test]
fn own_frames_are_not_forwarded() {
    let mut world = normal::<2>();
    assert_eq!(reaches(&mut world, 0, VEHICLE, &Attitude::default()), [0; 0]);
}

/// a private link gets only frames for components that were heard there; its own frames are forwarded.
#[test]
fn private_links_get_no_broadcasts() {
    let private = LinkConfig::uart(115_200).with_class(LinkClass::Private);
    let mut world = world([LinkConfig::uart(115_200), private, LinkConfig::uart(115_200)]);
    introduce(&mut world, 1, GIMBAL);
    for target in [Address::new(0, 0), Address::new(1, 0), COMPANION, WINGMAN] {
        assert!(!reaches(&mut world, 0, STATION, &tune(target)).contains(&1), "to {target:?}");
    }
    assert_eq!(reaches(&mut world, 0, STATION, &tune(GIMBAL)), [1]);
    assert_eq!(reaches(&mut world, 1, GIMBAL, &Gcs::heartbeat()), [0, 2]);
    // The vehicle's own messages are sent there as on any link.
    world.run_for(secs(2));
    assert_eq!(world.gcs[1].count_of::<Heartbeat>(), 2);
}

/// A link without a queue gets no frames of others, and works like any other.
#[test]
fn link_without_a_queue_gets_no_forwarded_frames() {
    let mut world = normal::<7>();
    assert_eq!(reaches(&mut world, 0, STATION, &Gcs::heartbeat()), [1, 2, 3, 4, 5]);
    world.gcs[6].send_from(WINGMAN, &Attitude::default());
    world.run_for(millis(5));
    forget(&mut world);
    assert_eq!(reaches(&mut world, 0, STATION, &tune(WINGMAN)), [0; 0]);
    assert_eq!(world.stack.forward_counters(LinkId(6)), None);
    let request = [Attitude::ID as f32, 20_000.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    world.gcs[6].command_long(MavCmd::SET_MESSAGE_INTERVAL, request);
    world.expect::<CommandAck>(6, millis(100));
    world.run_for(millis(500));
    assert!(world.gcs[6].count_of::<Attitude>() >= 10);
}

/// With forwarding off on a link, none of its frames are forwarded, and it gets none.
#[test]
fn forwarding_can_be_off_on_a_link() {
    let out = LinkConfig::uart(115_200).with_forwarding(false);
    let mut world = world([LinkConfig::uart(115_200), out, LinkConfig::uart(115_200)]);
    introduce(&mut world, 1, WINGMAN);
    assert_eq!(reaches(&mut world, 0, STATION, &Attitude::default()), [2]);
    assert_eq!(reaches(&mut world, 0, STATION, &tune(WINGMAN)), [0; 0]);
    assert_eq!(reaches(&mut world, 1, WINGMAN, &Attitude::default()), [0; 0]);
    assert_eq!(reaches(&mut world, 1, WINGMAN, &tune(STATION)), [0; 0]);
}

/// R-4, H-12: broadcasts of a source without an entry in the peer table are forwarded; its addressed frames are handled locally
/// only, and counted.
#[test]
fn broadcasts_of_an_unlisted_source_are_forwarded() {
    let mut world = Forwarder::<2, NoPlans, 2>::of(Setup { links: [LinkConfig::uart(115_200); 2], ..Setup::new() });
    world.run_for(millis(10));
    world.gcs[0].send_from(STATION, &Gcs::heartbeat());
    world.gcs[1].send_from(OTHER_STATION, &Gcs::heartbeat());
    world.run_for(millis(10));
    world.vehicle.calls.clear();
    let send = |world: &mut Forwarder<2, NoPlans, 2>| {
        world.gcs[1].forget();
        world.gcs[0].send_from(WINGMAN, &Attitude::default());
        world.gcs[0].send_from(WINGMAN, &tune(Address::new(1, 0)));
        world.gcs[0].send_from(WINGMAN, &tune(OTHER_STATION));
        world.run_for(millis(30));
        (world.gcs[1].count_of::<Attitude>(), world.gcs[1].count_of::<PlayTune>())
    };
    assert_eq!(send(&mut world), (1, 0));
    assert_eq!(world.vehicle.calls.len(), 2, "the first two are for us too");
    let no_slot = |world: &Forwarder<2, NoPlans, 2>| {
        world.stack.forward_counters(LinkId(0)).map(|counters| counters.no_peer_slot)
    };
    assert_eq!(no_slot(&world), Some(2));
    // Once a station has timed out, its entry can be evicted.
    world.gcs[1].heartbeat_period = Some(secs(1));
    world.gcs[1].address = OTHER_STATION;
    world.run_for(secs(6));
    assert_eq!(send(&mut world), (1, 1));
    assert_eq!(no_slot(&world), Some(2));
}

/// H-12, R-3, R-4: eight invented ground stations on one link fill the table and block no route: peers on other links get
/// entries and keep them. Broadcasts of newcomers on that link are forwarded too.
#[test]
fn invented_ground_stations_block_no_route() {
    let mut world = world([LinkConfig::uart(921_600); 3]);
    let mut sent = [0; 3];
    let mut arrived = [0; 3];
    for round in 0..60 {
        for system in 201..=240 {
            // Eight are alive, and others try to get an entry.
            if system <= 208 || round % 4 == 0 {
                world.gcs[0].send_from(Address::new(system, 190), &Gcs::heartbeat());
            }
        }
        world.run_for(millis(20));
        if round >= 10 {
            world.gcs[1].send_from(STATION, &Gcs::heartbeat());
            world.gcs[2].send_from(COMPANION, &Heartbeat { r#type: MavType::ONBOARD_CONTROLLER, ..Gcs::heartbeat() });
            world.run_for(millis(80));
            forget(&mut world);
            world.gcs[1].send_from(STATION, &tune(COMPANION));
            world.gcs[2].send_from(COMPANION, &tune(STATION));
            // A newcomer on the flooded link.
            world.gcs[0].send_from(WINGMAN, &Attitude::default());
            world.run_for(millis(100));
            sent = sent.map(|sent| sent + 1);
            arrived[0] += world.gcs[2].count_of::<PlayTune>();
            arrived[1] += world.gcs[1].count_of::<PlayTune>();
            arrived[2] += world.gcs[2].count_of::<Attitude>();
        }
        world.run_for(millis(800));
    }
    assert_eq!((sent, arrived), ([50; 3], [50; 3]));
}
