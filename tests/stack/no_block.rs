//! No call blocks, nothing pending is lost, and nothing starves: D-2 to D-4, H-15, SEC-1, SEC-2.
//!
//! The simulated line panics when it is read or written without being ready, so every poll here returns.

use crate::support::*;
use mavstack::__private::Declares;
use mavstack::dialect::*;
use mavstack::{Instant, LinkConfig, LinkId, Stack, plan_memory};

const LINK: LinkId = LinkId(0);

/// Returns the longest time between two heartbeats at the ground station of `link`, and from the last one until now.
fn longest_silence<const N: usize, D: Declares<Vehicle: Default>>(
    world: &World<N, D>,
    link: usize,
) -> mavstack::Duration {
    let mut times: Vec<Instant> = world.gcs[link].all::<Heartbeat>().into_iter().map(|(at, _)| at).collect();
    times.push(world.now());
    times.windows(2).map(|pair| pair[1] - pair[0]).max().expect("there is a heartbeat")
}

/// A radio at 57,600 bit/s behind a UART with a small buffer; bytes in a large one would delay the heartbeat too.
fn telemetry() -> LineConfig {
    LineConfig::both(Wire { bytes_per_second: 5_760, latency: millis(5), tx_fifo: 32, ..Wire::default() })
}

/// D-3: a link accepts no bytes for 10 s, from any byte of a frame on, while requests arrive. Afterwards every request that was
/// carried out is answered, the others are counted, and another link is not affected.
#[test]
fn stalled_link_loses_nothing_that_was_accepted() {
    for begin in 0..25 {
        // One byte per millisecond, so that the stall begins inside a frame.
        let wire = Wire { bytes_per_second: 1_000, tx_fifo: 2, ..Wire::default() };
        let lines = [LineConfig { down: wire, ..LineConfig::default() }, LineConfig::default()];
        let mut world = World::new(Setup { lines, ..Setup::<2>::new() });
        world.gcs[0].command_long(MavCmd::NAV_TAKEOFF, [0.0; 7]);
        world.run_for(millis(1 + begin));
        let stalled = world.now();
        world.uarts[0].stall_writes_until(stalled + secs(10));
        for request in 1..=20 {
            world.gcs[0].command_long(MavCmd::NAV_LAND, [request as f32; 7]);
            world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [148.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
            world.gcs[1].command_long(MavCmd::NAV_LAND, [request as f32; 7]);
            world.run_for(millis(400));
        }
        assert_eq!(world.gcs[1].count_of::<CommandAck>(), 20, "the other link");
        assert!(longest_silence(&world, 1) <= millis(1_002));
        world.run_for(secs(8));
        let counters = world.stack.link_counters(LINK).unwrap();
        let carried_out = 41 - counters.no_answer_slot as usize;
        assert!((4..=10).contains(&carried_out), "begin {begin}: {carried_out}");
        assert_eq!(world.gcs[0].count_of::<CommandAck>(), carried_out, "begin {begin}");
        let asked = world.gcs[0].all::<CommandAck>();
        let asked = asked.iter().filter(|(_, ack)| ack.command == MavCmd::REQUEST_MESSAGE).count();
        // Several requests for a pending message are one.
        assert!(asked >= 1 && world.gcs[0].count_of::<AutopilotVersion>() >= 1, "begin {begin}");
        let on_link_0 = world.vehicle.commands().iter().filter(|command| command.from.link == LINK).count();
        assert_eq!(on_link_0 + asked, carried_out, "begin {begin}");
        assert_eq!((world.gcs[0].counters().checksum, world.gcs[0].counters().skipped), (0, 0), "begin {begin}");
        // A client retransmits unanswered commands, and they are answered.
        world.gcs[0].forget();
        world.gcs[0].command_long(MavCmd::NAV_LAND, [99.0; 7]);
        world.expect::<CommandAck>(0, millis(100));
    }
}

/// D-3: the same for reading: a line delivers nothing for 10 s, and then everything at once.
#[test]
fn stalled_reads_recover() {
    let mut world = World::new(Setup::<1>::new());
    world.uarts[0].stall_reads_until(Instant::from_millis(10_000));
    for _ in 0..80 {
        world.gcs[0].command_long(MavCmd::NAV_LAND, [1.0; 7]);
        world.run_for(millis(100));
    }
    assert_eq!(world.vehicle.commands().len(), 0);
    world.run_for(secs(3));
    assert_eq!(world.vehicle.commands().len(), 80);
    assert_eq!(world.gcs[0].count_of::<CommandAck>(), 80);
    assert!(longest_silence(&world, 0) <= millis(1_002));
}

/// H-15, D-4: a flood of requests at line rate, each of them answered or dropped whole, delays heartbeats neither on this link
/// nor on the other.
#[test]
fn flood_of_commands_does_not_delay_heartbeats() {
    let links = [LinkConfig::uart(57_600); 2];
    let mut world = World::new(Setup { links, lines: [telemetry(); 2], ..Setup::<2>::new() });
    for _ in 0..30_000 {
        if world.gcs[0].is_idle() {
            world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [148.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
            world.gcs[0].command_long(MavCmd::NAV_LAND, [1.0; 7]);
        }
        world.step();
    }
    for link in 0..2 {
        // One frame may have started before it; the longest here takes 13 ms.
        assert!(longest_silence(&world, link) <= millis(1_020), "link {link}: {:?}", longest_silence(&world, link));
    }
    let counters = world.stack.link_counters(LINK).unwrap();
    let acks = world.gcs[0].count_of::<CommandAck>();
    assert!(acks > 2_000, "{acks} answers, {counters:?}");
}

/// SEC-2, H-15: at a megabaud of noise, of start bytes, or of nested false headers, heartbeats are on time, and a real command
/// in between is answered.
#[test]
fn flood_of_noise_does_not_starve() {
    let mut rng = Rng::new(11);
    let mut kinds: Vec<Box<dyn FnMut() -> u8>> =
        vec![Box::new(move || rng.byte()), Box::new(|| 0xFD), Box::new(|| 0xFE)];
    // A v2 header of FILE_TRANSFER_PROTOCOL with the longest payload, repeated: each costs a whole checksum.
    let mut nest = [0xFD, 0xFF, 0x00, 0x00, 0x01, 0x09, 0x09, 0x6E, 0x00, 0x00].into_iter().cycle();
    kinds.push(Box::new(move || nest.next().unwrap()));
    for (kind, next) in kinds.iter_mut().enumerate() {
        let line = LineConfig { up: Wire { bytes_per_second: 100_000, ..Wire::default() }, ..LineConfig::default() };
        let mut world = World::new(Setup { lines: [line, LineConfig::default()], ..Setup::<2>::new() });
        for ms in 0..10_000 {
            let noise: Vec<u8> = (0..100).map(|_| next()).collect();
            world.gcs[0].send_raw(&noise);
            if ms % 1_000 == 500 {
                // After enough zeros no earlier byte can delay it.
                world.gcs[0].send_raw(&[0; 300]);
                world.gcs[0].command_long(MavCmd::NAV_LAND, [1.0; 7]);
            }
            world.step();
        }
        world.run_for(secs(3));
        for link in 0..2 {
            assert!(longest_silence(&world, link) <= millis(1_002), "noise {kind}, link {link}");
        }
        // The last kind costs more work than a poll may do: what exceeds the line's FIFO is lost, and reported.
        let acks = world.gcs[0].count_of::<CommandAck>();
        let overruns = world.stack.link_counters(LINK).unwrap().read_errors;
        assert!(acks == 10 || (overruns > 0 && kind == 3), "noise {kind}: {acks} answers, {overruns} overruns");
        world.gcs[0].forget();
        world.gcs[0].command_long(MavCmd::NAV_LAND, [1.0; 7]);
        world.expect::<CommandAck>(0, secs(2));
    }
}

/// H-15, M-10: a flood of plan requests, from one sender and from two hundred, does not delay heartbeats.
#[test]
fn flood_of_plan_requests_does_not_delay_heartbeats() {
    type Plans = Tested<plan_memory!(mission: 20)>;
    let links = [LinkConfig::uart(57_600)];
    let mut world = World::<1, Plans>::of(Setup { links, lines: [telemetry()], ..Setup::new() });
    world.upload(0, &plan(20, 1)).expect("the plan is taken");
    let mut rng = Rng::new(3);
    let (target_system, target_component) = (1, 1);
    for _ in 0..30_000 {
        if world.gcs[0].is_idle() {
            let from = mavstack::Address::new(55 + rng.below(200) as u8, 190);
            let count = MissionCount { target_system, target_component, count: 5, ..MissionCount::default() };
            let list = MissionRequestList { target_system, target_component, ..MissionRequestList::default() };
            let seq = rng.below(20) as u16;
            let item = MissionRequestInt { target_system, target_component, seq, ..MissionRequestInt::default() };
            match rng.below(3) {
                0 => world.gcs[0].send_from(from, &count),
                1 => world.gcs[0].send_from(from, &list),
                _ => world.gcs[0].send_from(from, &item),
            }
        }
        world.step();
    }
    assert!(longest_silence(&world, 0) <= millis(1_020), "{:?}", longest_silence(&world, 0));
    world.gcs[0].forget();
    world.run_for(secs(10));
    world.upload(0, &plan(20, 2)).expect("another plan is taken when the flood is over");
}

/// SEC-1: random bytes at random times through every call, over many seeds: nothing panics, and a command is answered
/// afterwards.
#[test]
fn nothing_panics() {
    type Plans = Tested<plan_memory!(mission: 5, fence: 5, rally: 5)>;
    for seed in 0..60 {
        let mut rng = Rng::new(seed);
        let faults = Faults {
            byte_loss: 0.01,
            byte_flip: 0.02,
            byte_duplicate: 0.01,
            burst: 0.01,
            burst_len: 40,
            stall: 0.001,
            stall_for: millis(50),
            ..Faults::default()
        };
        let lines = [LineConfig::both(Wire { faults, chunk: 9, rx_fifo: 200, ..Wire::default() }); 2];
        let mut world = World::<2, Plans>::of(Setup { lines, seed, jitter: millis(40), ..Setup::new() });
        for _ in 0..300 {
            let link = rng.below(2) as usize;
            let ids = [0, 11, 39, 40, 41, 43, 44, 45, 47, 51, 73, 75, 76, 77, 110, 253, 300];
            let id = ids[rng.below(ids.len() as u64) as usize];
            let extra = <Common as mavstack::message::Dialect>::MESSAGES.get(id).map_or(0, |row| row.crc_extra());
            let payload: Vec<u8> = (0..rng.below(60)).map(|_| rng.byte() & rng.byte() & rng.byte()).collect();
            world.gcs[link].send_raw(&reference::v2(id, [0, 0], [rng.byte() | 1, 190], &payload, extra));
            if rng.chance(0.05) {
                world.stack.restart_link(LinkId(link as u8));
            }
            world.step();
        }
        for line in &world.lines {
            line.set_up(|wire| wire.faults = Faults::default());
            line.set_down(|wire| wire.faults = Faults::default());
        }
        world.run_for(secs(3));
        // A station of its own: the old one may wait for the rest of a false frame.
        world.gcs[0] = Gcs::new(world.gcs[0].end.clone());
        world.gcs[0].command_long(MavCmd::NAV_LAND, [1.0; 7]);
        world.expect::<CommandAck>(0, secs(1));
    }
}

/// D-2: a link without a transport costs nothing and delays nothing: its backlog is bounded.
#[test]
fn link_that_is_never_polled_is_harmless() {
    let setup = Setup::<2>::new();
    let mut stack = Stack::<Tested, 2>::VACANT;
    stack.begin(setup.config, setup.links);
    let mut vehicle = TestVehicle::new();
    for ms in 0..5_000 {
        let now = Instant::from_millis(ms);
        setup.config.pulse.unwrap().tick();
        stack.poll(now, &mut vehicle);
        stack.text(now, MavSeverity::EMERGENCY, if ms % 2 == 0 { "even" } else { "odd" });
        let len = stack.transmit(now, LINK, &mut vehicle).len();
        stack.transmitted(LINK, len);
    }
    assert_eq!(stack.link_counters(LINK).map(|counters| counters.tx_frames), Some(5 + 2));
    assert_eq!(stack.link_counters(LinkId(1)).map(|counters| counters.tx_frames), Some(0));
}
