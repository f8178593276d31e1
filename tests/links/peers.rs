//! The peers of a vehicle: rules H-10 to H-14, R-8, S-15, S-16.

use crate::support::*;
use mavstack::__private::NoPlans;
use mavstack::config::{LinkClass, StreamProfile};
use mavstack::dialect::{
    Attitude, CommandAck, Heartbeat, MavAutopilot, MavCmd, MavSeverity, MavType, RadioStatus, Statustext,
};
use mavstack::frame::Version;
use mavstack::manual_control::ControlSource;
use mavstack::message::SystemId;
use mavstack::network::PeerInfo;
use mavstack::{Address, Duration, LinkConfig, LinkId, Peer, PeerEvent};

const ANTENNA: Address = Address::new(255, 197);
const CAMERA: Address = Address::new(1, 100);
const ONBOARD: Address = Address::new(255, 191);

fn on_link_0(address: Address) -> Peer {
    Peer { address, link: LinkId(0) }
}

fn info<const N: usize, const PEERS: usize>(
    world: &World<N, Tested<NoPlans, PEERS>>,
    address: Address,
) -> Option<PeerInfo> {
    world.stack.peers(world.now()).find(|info| info.peer.address == address)
}

/// H-11: a peer is found, times out and reconnects, each reported once; it times out five seconds after its last heartbeat,
/// however often the stack is polled.
#[test]
fn peer_is_reported_found_lost_and_reconnected_once() {
    let mut world = World::new(Setup::<1>::new());
    world.gcs[0].heartbeat_period = Some(secs(1));
    world.run_for(millis(10_500));
    let station = on_link_0(STATION);
    assert_eq!(world.vehicle.peer_events(), [PeerEvent::Found(station)]);
    let known = info(&world, STATION).expect("in the table");
    assert_eq!((known.r#type, known.autopilot, known.is_alive), (MavType::GCS, MavAutopilot::INVALID, true));
    let last = known.last_heartbeat().expect("it has one");
    world.gcs[0].heartbeat_period = None;
    world.run_until(secs(60), |world| world.now() >= last + millis(4_999));
    assert_eq!(world.vehicle.peer_events().len(), 1, "not yet");
    world.run_for(millis(1));
    assert_eq!(world.vehicle.peer_events()[1..], [PeerEvent::Lost(station)]);
    world.run_for(secs(60));
    assert_eq!(world.vehicle.peer_events().len(), 2);
    assert!(!info(&world, STATION).expect("kept for its routes").is_alive);
    world.gcs[0].heartbeat_period = Some(secs(1));
    world.run_for(secs(10));
    assert_eq!(world.vehicle.peer_events()[2..], [PeerEvent::Regained(station)]);
}

/// H-11: the timeout is configurable, and other frames do not keep a peer alive.
#[test]
fn only_heartbeats_keep_a_peer_alive() {
    let mut setup = Setup::<1>::new();
    setup.config.peer_timeout = secs(2);
    let mut world = World::new(setup);
    world.gcs[0].send(&Gcs::heartbeat());
    for _ in 0..30 {
        world.run_for(millis(100));
        world.gcs[0].send(&Attitude::default());
    }
    let station = on_link_0(STATION);
    assert_eq!(world.vehicle.peer_events(), [PeerEvent::Found(station), PeerEvent::Lost(station)]);
    let known = info(&world, STATION).expect("in the table");
    assert!(world.now() - known.last_heard() <= millis(200));
}

/// H-10, H-13: any frame with a right checksum makes an entry; only a heartbeat makes it a living peer. A radio's reports do
/// not make a ground station.
#[test]
fn frames_make_entries_and_heartbeats_make_peers() {
    let mut world = World::new(Setup::<1>::new());
    let radio = Address::new(51, 68);
    world.gcs[0].send_from(radio, &RadioStatus { rssi: 200, ..RadioStatus::default() });
    world.gcs[0].send_from(CAMERA, &CommandAck::default());
    world.run_for(secs(30));
    assert_eq!(world.vehicle.peer_events(), []);
    for address in [radio, CAMERA] {
        let known = info(&world, address).expect("in the table");
        assert!(!known.is_alive && known.last_heartbeat().is_none());
    }
}

/// H-11: each component of a system is a peer, and so is one component on each of two links.
#[test]
fn every_component_on_every_link_is_a_peer() {
    let mut world = World::new(Setup::<2>::new());
    world.gcs[0].send(&Gcs::heartbeat());
    world.gcs[0].send_from(ANTENNA, &Heartbeat { r#type: MavType::ANTENNA_TRACKER, ..Gcs::heartbeat() });
    world.gcs[1].version = Version::V1;
    world.gcs[1].send(&Gcs::heartbeat());
    world.run_for(millis(5));
    let elsewhere = Peer { address: STATION, link: LinkId(1) };
    let mut events = world.vehicle.peer_events();
    events.sort_by_key(|event| format!("{event:?}"));
    let mut expected = [on_link_0(STATION), on_link_0(ANTENNA), elsewhere].map(PeerEvent::Found);
    expected.sort_by_key(|event| format!("{event:?}"));
    assert_eq!(events, expected);
    let versions: Vec<_> = world.stack.peers(world.now()).map(|info| (info.peer, info.version)).collect();
    assert!(versions.contains(&(elsewhere, Version::V1)) && versions.contains(&(on_link_0(STATION), Version::V2)));
}

/// H-11: a ground station with two links is alive while one of them works, and until the timeout after the last heartbeat on
/// either.
#[test]
fn station_is_alive_while_one_of_its_links_works() {
    let mut world = World::new(Setup::<2>::new());
    let is_alive = |world: &World<2, Tested<NoPlans, 8>>| {
        let alive = world.stack.has_ground_station(world.now());
        assert_eq!(world.stack.has_controller(world.now(), ControlSource::System(STATION.system)), alive);
        alive
    };
    assert!(!is_alive(&world), "nobody was heard");
    world.gcs[0].heartbeat_period = Some(secs(1));
    world.gcs[1].heartbeat_period = Some(secs(1));
    world.run_for(millis(10_500));
    assert!(is_alive(&world));
    world.gcs[0].heartbeat_period = None;
    world.run_for(secs(10));
    assert_eq!(world.vehicle.peer_events()[2..], [PeerEvent::Lost(on_link_0(STATION))]);
    assert!(is_alive(&world), "by the other link");
    world.gcs[1].heartbeat_period = None;
    let last = world.stack.peers(world.now()).filter_map(|info| info.last_heartbeat()).max().expect("it has one");
    world.run_until(secs(60), |world| world.now() >= last + millis(4_999));
    assert!(is_alive(&world), "not yet");
    world.run_for(millis(1));
    assert!(!is_alive(&world));
    world.gcs[0].send(&Gcs::heartbeat());
    world.run_for(millis(10));
    assert!(is_alive(&world), "reconnected on the first link");
}

/// H-11: only ground stations count, and for the vehicle's controller only those that it names.
#[test]
fn only_the_stations_in_control_are_the_controller() {
    let mut world = World::new(Setup::<2>::new());
    let others =
        [(CAMERA, MavType::CAMERA), (ANTENNA, MavType::ANTENNA_TRACKER), (ONBOARD, MavType::ONBOARD_CONTROLLER)];
    for (address, r#type) in others {
        world.gcs[0].send_from(address, &Heartbeat { r#type, ..Gcs::heartbeat() });
    }
    world.gcs[0].send_from(STATION, &Attitude::default());
    world.run_for(millis(10));
    assert_eq!(world.vehicle.peer_events().len(), 3);
    let range = |first, last| ControlSource::Systems { first: SystemId::new(first), last: SystemId::new(last) };
    let named = [
        ControlSource::System(STATION.system),
        ControlSource::System(SystemId::new(250)),
        range(240, 249),
        range(240, 250),
        ControlSource::GroundStation,
        ControlSource::Nobody,
    ];
    let controllers = |world: &World<2>| named.map(|source| world.stack.has_controller(world.now(), source));
    assert!(
        !world.stack.has_ground_station(world.now()),
        "an antenna tracker beside a station that sends no heartbeats"
    );
    assert_eq!(controllers(&world), [false; 6]);
    world.gcs[1].send_from(Address::new(250, 190), &Gcs::heartbeat());
    world.run_for(millis(10));
    assert!(world.stack.has_ground_station(world.now()));
    assert_eq!(controllers(&world), [false, true, false, true, true, false]);
}

/// H-10: heartbeats on a high-latency link keep no ground station alive.
#[test]
fn satellite_link_keeps_no_station_alive() {
    let mut world = shared();
    beat(&mut world, 2, 255, MavType::GCS);
    assert_eq!(systems_on(&world, 2), [255]);
    assert!(
        !world.stack.has_ground_station(world.now())
            && !world.stack.has_controller(world.now(), ControlSource::GroundStation)
    );
    beat(&mut world, 1, 255, MavType::GCS);
    assert!(
        world.stack.has_ground_station(world.now())
            && world.stack.has_controller(world.now(), ControlSource::GroundStation)
    );
}

/// H-12: a full table evicts peers without heartbeats first, starting with the one that has been silent longest. Evictions are
/// counted.
#[test]
fn silent_entries_are_evicted_first() {
    let mut world = World::<1, Tested<NoPlans, 4>>::of(Setup::new());
    let chatter = |world: &mut World<1, Tested<NoPlans, 4>>, system| {
        world.gcs[0].send_from(Address::new(system, 1), &Attitude::default());
        world.run_for(millis(10));
    };
    world.gcs[0].send(&Gcs::heartbeat());
    world.run_for(millis(10));
    for system in 10..13 {
        chatter(&mut world, system);
    }
    chatter(&mut world, 10);
    let counters = world.stack.link_counters(LinkId(0)).unwrap();
    assert_eq!((counters.evicted_peers, counters.no_peer_slot), (0, 0));
    chatter(&mut world, 20);
    assert!(info(&world, Address::new(11, 1)).is_none(), "silent longest");
    for address in [STATION, Address::new(10, 1), Address::new(12, 1), Address::new(20, 1)] {
        assert!(info(&world, address).is_some(), "{address:?}");
    }
    // A modem that invents ids reuses the entries of silent peers.
    for system in 30..230 {
        chatter(&mut world, system);
    }
    assert!(info(&world, STATION).is_some_and(|info| info.is_alive));
    assert_eq!(world.stack.link_counters(LinkId(0)).unwrap().evicted_peers, 201);
    assert_eq!(world.vehicle.peer_events(), [PeerEvent::Found(on_link_0(STATION))]);
}

/// H-12: a living ground station is never evicted. A new one may evict another living peer, whose loss is reported. A peer
/// without an entry is served too.
#[test]
fn ground_stations_are_not_evicted() {
    let mut world = World::<1, Tested<NoPlans, 3>>::of(Setup::new());
    let beat = |world: &mut World<1, Tested<NoPlans, 3>>, system, r#type| {
        world.gcs[0].send_from(Address::new(system, 1), &Heartbeat { r#type, ..Gcs::heartbeat() });
        world.run_for(millis(10));
    };
    beat(&mut world, 250, MavType::GCS);
    beat(&mut world, 7, MavType::GIMBAL);
    beat(&mut world, 251, MavType::GCS);
    // A second gimbal finds only living peers of at least its rank.
    beat(&mut world, 8, MavType::GIMBAL);
    assert!(info(&world, Address::new(8, 1)).is_none());
    assert_eq!(world.stack.link_counters(LinkId(0)).unwrap().no_peer_slot, 1);
    // A third ground station evicts the gimbal.
    beat(&mut world, 252, MavType::GCS);
    let [a, gimbal, b, c] = [250, 7, 251, 252].map(|system| on_link_0(Address::new(system, 1)));
    let found = PeerEvent::Found;
    let expected = [found(a), found(gimbal), found(b), PeerEvent::Lost(gimbal), found(c)];
    assert_eq!(world.vehicle.peer_events(), expected);
    // A fourth finds no peer that it may evict.
    beat(&mut world, 253, MavType::GCS);
    assert_eq!(world.stack.peers(world.now()).count(), 3);
    assert!(info(&world, Address::new(253, 1)).is_none());
    let command = world.gcs[0].long(MavCmd::NAV_LAND, [0.0; 7]);
    world.gcs[0].send_from(Address::new(253, 1), &command);
    assert_eq!(world.expect::<CommandAck>(0, millis(10)).target_system, 253);
}

/// A table of eight peers for three links, the last of which is a satellite link.
fn shared() -> World<3, Tested<NoPlans, 8>> {
    let link = LinkConfig::uart(921_600).with_own_system(true);
    let satellite = link.with_class(LinkClass::HighLatency);
    World::of(Setup { links: [link, link, satellite], ..Setup::new() })
}

/// Returns the systems in the table that were heard on a link, in order.
fn systems_on(world: &World<3, Tested<NoPlans, 8>>, link: u8) -> Vec<u8> {
    let is_there = |info: &PeerInfo| info.peer.link == LinkId(link);
    let mut systems: Vec<u8> =
        world.stack.peers(world.now()).filter(is_there).map(|info| info.peer.address.system.wire()).collect();
    systems.sort_unstable();
    systems
}

/// Sends a heartbeat from component 1 of a system.
fn beat(world: &mut World<3, Tested<NoPlans, 8>>, link: usize, system: u8, r#type: MavType) {
    world.gcs[link].send_from(Address::new(system, 1), &Heartbeat { r#type, ..Gcs::heartbeat() });
    world.run_for(millis(2));
}

/// H-12: a link takes entries from a link with more of them, those of silent peers first, until both have the same number. It
/// takes no more, whatever it sends.
#[test]
fn links_share_the_table() {
    for r#type in [MavType::GCS, MavType::QUADROTOR] {
        let mut world = shared();
        for system in 1..=8 {
            beat(&mut world, 0, 10 + system, r#type);
        }
        assert_eq!(systems_on(&world, 0).len(), 8);
        // A modem that invents ids evicts no living peer.
        for system in 100..110 {
            world.gcs[1].send_from(Address::new(system, 1), &Attitude::default());
            world.run_for(millis(2));
        }
        assert_eq!((systems_on(&world, 0).len(), systems_on(&world, 1).len()), (8, 0));
        for system in 200..250 {
            beat(&mut world, 1, system, r#type);
            // The peers in the table keep their entries.
            for system in systems_on(&world, 0) {
                beat(&mut world, 0, system, r#type);
            }
        }
        assert_eq!((systems_on(&world, 0).len(), systems_on(&world, 1).len()), (4, 4), "{:?}", r#type);
        let lost = |event: &&PeerEvent| matches!(event, PeerEvent::Lost(peer) if peer.link == LinkId(0));
        assert_eq!(world.vehicle.peer_events().iter().filter(lost).count(), 4, "the evictions are reported");
        // The station on the satellite link sends no heartbeats and has been silent longest; it gets an entry and keeps it.
        world.gcs[2].send_from(Address::new(255, 190), &CommandAck::default());
        for round in 0..30 {
            world.run_for(secs(1));
            for system in 0..4 {
                beat(&mut world, 0, 20 + 4 * round + system, MavType::GCS);
                beat(&mut world, 1, 20 + 4 * round + system, MavType::GCS);
            }
            assert_eq!(systems_on(&world, 2), [255], "{round}");
        }
    }
}

/// H-12: silent peers of a link with few entries stay too, however another link is flooded.
#[test]
fn flood_evicts_only_peers_of_its_own_link() {
    let mut world = shared();
    world.gcs[1].send_from(Address::new(2, 1), &Attitude::default());
    world.gcs[1].send_from(Address::new(3, 1), &Attitude::default());
    world.gcs[2].send_from(Address::new(255, 190), &CommandAck::default());
    world.run_for(secs(20));
    for round in 0..200 {
        world.gcs[0].send_from(Address::new(20 + round, 1), &Attitude::default());
        world.run_for(millis(2));
    }
    assert_eq!((systems_on(&world, 1), systems_on(&world, 2)), (vec![2, 3], vec![255]));
    assert_eq!(systems_on(&world, 0), [215, 216, 217, 218, 219], "the most recent ones");
}

/// H-12, X-9: components of our own system keep their entries for 30 s, silent or not, on links that trust our system.
#[test]
fn own_components_keep_their_entries() {
    let mut world = shared();
    for component in [100, 154, 191] {
        world.gcs[0].send_from(Address::new(1, component), &Attitude::default());
        world.run_for(secs(1));
    }
    for system in 10..200 {
        beat(&mut world, 0, system, MavType::GCS);
        beat(&mut world, 1, system, MavType::GCS);
    }
    assert_eq!(systems_on(&world, 0).iter().filter(|&&system| system == 1).count(), 3);
    // However many there are, they take no entry of the other link.
    for component in 2..100 {
        world.gcs[0].send_from(Address::new(1, component), &Gcs::heartbeat());
        world.run_for(millis(2));
    }
    world.run_for(secs(6));
    for component in 2..100 {
        world.gcs[0].send_from(Address::new(1, component), &Attitude::default());
        world.run_for(millis(2));
    }
    for system in 10..20 {
        beat(&mut world, 0, system, MavType::GCS);
    }
    let ours = world.stack.peers(world.now()).filter(|info| info.peer.address.system.wire() == 1).count();
    assert_eq!(ours, 4);
}

/// of eight stations that someone invents on the pilot's own link, six settle after 30 s; the others take turns with the pilot, who has
/// an entry within 10 s. Before, the pilot had none for as long as they went on.
#[test]
fn invented_stations_leave_places_for_newcomers() {
    let mut world = World::<1, Tested<NoPlans, 8>>::of(Setup::new());
    let beat = |world: &mut World<1, Tested<NoPlans, 8>>, system| {
        world.gcs[0].send_from(Address::new(system, 190), &Gcs::heartbeat());
        world.run_for(millis(10));
    };
    let mut found = None;
    for second in 0..50 {
        for system in 60..68 {
            beat(&mut world, system);
        }
        if second >= 40 {
            beat(&mut world, STATION.system.wire());
        }
        if found.is_none() && info(&world, STATION).is_some_and(|info| info.is_alive) {
            found = Some(second);
        }
        world.run_for(millis(900));
    }
    assert!(found.is_some_and(|second| second < 50), "{found:?}");
    let lost = |system| world.vehicle.peer_events().contains(&PeerEvent::Lost(on_link_0(Address::new(system, 190))));
    assert_eq!((60..68).filter(|&system| !lost(system)).count(), 6, "the settled ones are not evicted");
}

/// peers that have settled and gone leave their places to others. Before, the pilot did not settle for as long as they were in the
/// table, and any newcomers evicted it.
#[test]
fn silent_peers_leave_their_places() {
    let mut world = World::<1, Tested<NoPlans, 8>>::of(Setup::new());
    let beat = |world: &mut World<1, Tested<NoPlans, 8>>, system| {
        world.gcs[0].send_from(Address::new(system, 190), &Gcs::heartbeat());
        world.run_for(millis(10));
    };
    for _ in 0..32 {
        for system in 60..66 {
            beat(&mut world, system);
        }
        world.run_for(millis(940));
    }
    for _ in 0..62 {
        beat(&mut world, STATION.system.wire());
        world.run_for(millis(990));
    }
    world.vehicle.calls.clear();
    for system in 70..110 {
        beat(&mut world, system);
    }
    assert!(!world.vehicle.peer_events().contains(&PeerEvent::Lost(on_link_0(STATION))));
}

/// a peer that was heard for 30 s keeps its entry, whoever comes and on whichever link. One that pauses for `peer_timeout` begins
/// again.
#[test]
fn settled_peers_keep_their_entries() {
    for pause in [0, 6] {
        let mut world = shared();
        for second in 0..31 {
            if pause == 0 || !(20..20 + pause).contains(&second) {
                beat(&mut world, 0, 255, MavType::GCS);
            }
            world.run_for(millis(998));
        }
        world.vehicle.calls.clear();
        for round in 0..200_u8 {
            beat(&mut world, 0, 10 + round % 100, MavType::GCS);
            beat(&mut world, 1, 110 + round % 100, MavType::GCS);
            if round % 20 == 0 {
                beat(&mut world, 0, 255, MavType::GCS);
                world.run_for(millis(1_000));
            }
        }
        let station = Peer { address: Address::new(255, 1), link: LinkId(0) };
        let was_lost = world.vehicle.peer_events().contains(&PeerEvent::Lost(station));
        assert_eq!(was_lost, pause > 0, "a pause of {pause} s");
    }
}

/// S-16: losses are counted by sequence number, also across its wrap. A duplicate or late frame is not a loss.
#[test]
fn losses_are_counted_across_the_wrap() {
    let mut world = World::new(Setup::<1>::new());
    let mut lost = 0;
    for i in 0..2_000u32 {
        if i % 7 == 3 {
            let skipped = (i % 11) as u8;
            world.gcs[0].skip_seq(STATION, skipped);
            lost += u32::from(skipped);
        }
        world.gcs[0].send(&Attitude::default());
        // Each sender has its own sequence.
        world.gcs[0].send_from(CAMERA, &Attitude::default());
        world.step();
    }
    world.run_for(millis(10));
    let known = info(&world, STATION).expect("in the table");
    assert_eq!((known.received, known.lost), (2_000, lost));
    assert_eq!(info(&world, CAMERA).map(|info| (info.received, info.lost)), Some((2_000, 0)));
}

/// S-16: a line that duplicates frames does not change the loss figures.
#[test]
fn duplicates_are_not_losses() {
    let mut line = LineConfig::default();
    line.up.faults = Faults::frames(0.0, 0.2);
    let mut world = World::new(Setup { lines: [line], ..Setup::<1>::new() });
    for _ in 0..500 {
        world.gcs[0].send(&Attitude::default());
        world.run_for(millis(2));
    }
    let known = info(&world, STATION).expect("in the table");
    assert!(known.received > 550, "{} with duplicates", known.received);
    assert_eq!(known.lost, 0);
}

/// R-8, S-15: echoes of our own frames are neither handled nor taken for another vehicle.
#[test]
fn echo_is_ignored() {
    let mut world = World::new(Setup::<1>::new());
    for _ in 0..120 {
        world.run_for(secs(1));
        let mut echo = Vec::new();
        for frame in world.gcs[0].received.drain(..) {
            let id = frame.header.id.to_le_bytes();
            let header = [0xFD, frame.payload.len() as u8, 0, 0, frame.header.seq, 1, 1, id[0], id[1], id[2]];
            echo.extend(reference::seal([&header, &frame.payload[..]].concat(), 50));
        }
        world.gcs[0].send_raw(&echo);
    }
    let counters = world.stack.link_counters(LinkId(0)).unwrap();
    assert!(counters.own_address >= 119, "{counters:?}");
    assert_eq!(world.vehicle.calls, []);
    assert_eq!(world.stack.peers(world.now()).count(), 0);
}

/// R-8, H-14: frames of another vehicle with our address are neither handled nor answered; it is reported once per link.
#[test]
fn other_vehicle_with_our_address_is_reported_once() {
    let mut world = World::new(Setup { links: [LinkConfig::uart(57_600); 2], ..Setup::new() });
    world.run_for(secs(2));
    for _ in 0..100 {
        world.gcs[0].skip_seq(VEHICLE, 100);
        let command = world.gcs[0].long(MavCmd::COMPONENT_ARM_DISARM, [1.0; 7]);
        world.gcs[0].send_from(VEHICLE, &command);
        world.run_for(millis(200));
    }
    assert_eq!(world.vehicle.calls, [Call::Peer(PeerEvent::AddressConflict(LinkId(0)))]);
    assert_eq!(world.gcs[0].count_of::<CommandAck>(), 0);
    for gcs in &mut world.gcs {
        assert_eq!(gcs.count_of::<Statustext>(), 1);
        let (_, text) = gcs.take::<Statustext>().unwrap();
        assert_eq!(text.severity, MavSeverity::WARNING);
        assert_eq!(text.text.as_str(), Some("Another vehicle has system id 1"));
    }
}

/// A vehicle with `N` links that sends only heartbeats, or also fifty ATTITUDE a second.
fn sending<const N: usize>(is_busy: bool) -> World<N> {
    let mut setup = Setup { links: [LinkConfig::uart(115_200); N], ..Setup::new() };
    if !is_busy {
        setup.config.heartbeat_period = millis(20);
        setup.links = setup.links.map(|link| link.with_streams(StreamProfile::Off));
    }
    let mut world = World::new(setup);
    if is_busy {
        for gcs in &mut world.gcs {
            gcs.command_long(MavCmd::SET_MESSAGE_INTERVAL, [30.0, 20_000.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        }
    }
    world
}

fn conflicts<const N: usize>(world: &World<N>) -> usize {
    let is_conflict = |event: &&PeerEvent| matches!(event, PeerEvent::AddressConflict(_));
    world.vehicle.peer_events().iter().filter(is_conflict).count()
}

/// H-14, S-15: a loop or a slow radio returns our own frames up to 255 frames later, on the same link or another one. They are
/// never taken for another vehicle.
#[test]
fn delayed_echoes_are_not_a_conflict() {
    for is_busy in [false, true] {
        let mut world = sending::<2>(is_busy);
        world.run_until(secs(60), |world| world.gcs.iter().all(|gcs| gcs.received.len() > 300));
        for late in 1..=255 {
            for (from, to) in [(0, 0), (0, 1), (1, 0)] {
                let sent = &world.gcs[from].received;
                let echo = sent[sent.len() - late].raw.clone();
                world.gcs[to].send_raw(&echo);
            }
            world.run_for(millis(3));
        }
        // A constant delay of 60 frames for a long time.
        for _ in 0..300 {
            let sent = &world.gcs[0].received;
            let echo = sent[sent.len() - 60].raw.clone();
            world.gcs[1].send_raw(&echo);
            world.run_for(millis(20));
        }
        let own = [0, 1].map(|link| world.stack.link_counters(LinkId(link)).unwrap().own_address);
        assert_eq!((own, conflicts(&world)), ([510, 555], 0), "busy: {is_busy}");
    }
}

/// H-14: another vehicle with our address is reported within seconds, whatever the traffic and the offset between the sequence
/// numbers.
#[test]
fn real_conflict_is_reported_within_seconds() {
    fn seconds_until_reported<const N: usize>(is_busy: bool, period: Duration, offset: u8) -> u64 {
        let mut world = sending::<N>(is_busy);
        // All sequence numbers have been used once.
        world.run_for(secs(6));
        let ours = world.gcs[0].received.last().unwrap().header.seq;
        world.gcs[0].skip_seq(VEHICLE, ours.wrapping_add(offset));
        let begin = world.now();
        while conflicts(&world) == 0 && world.now() - begin < secs(60) {
            let time_boot_ms = world.now().as_millis() as u32 + 77_777;
            if period.as_millis() < 1_000 {
                world.gcs[0].send_from(VEHICLE, &Attitude { time_boot_ms, ..Attitude::default() });
            } else {
                let r#type = MavType::QUADROTOR;
                world.gcs[0].send_from(VEHICLE, &Heartbeat { r#type, custom_mode: 3, ..Heartbeat::default() });
            }
            world.run_for(period);
        }
        (world.now() - begin).as_millis() / 1_000
    }
    for (period, mean) in [(secs(1), 8), (millis(20), 1)] {
        for is_busy in [false, true] {
            let took: Vec<u64> = (0..16)
                .flat_map(|n| {
                    let offset = n * 16 + 3;
                    [
                        seconds_until_reported::<1>(is_busy, period, offset),
                        seconds_until_reported::<2>(is_busy, period, offset),
                    ]
                })
                .collect();
            println!("{period:?} busy {is_busy}: {took:?}");
            assert!(took.iter().sum::<u64>() <= mean * 32, "{period:?}, busy: {is_busy}: {took:?}");
            assert!(took.iter().all(|&seconds| seconds <= 3 * mean), "{period:?}, busy: {is_busy}: {took:?}");
        }
    }
}
