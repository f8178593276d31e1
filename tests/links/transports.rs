//! Links between a transport and the stack. Rules D-2, D-3, R-1, R-8, R-15, S-16, S-20, SEC-2, V-1, V-2, M-10.

mod deadlines;

use crate::support::*;
use embedded_io::{Write, WriteReady};
use mavstack::__private::NoPlans;
use mavstack::config::{PollBudget, TxVersion};
use mavstack::dialect::*;
use mavstack::frame::{Decoder, MAX_FRAME_LEN, Version, encode};
use mavstack::message::Dialect;
use mavstack::network::LinkError;
use mavstack::{Address, Config, Instant, LinkConfig, LinkId, Message, Stack};

const LINK: LinkId = LinkId(0);

/// The simulated line keeps to its rate, its buffer and its latency.
#[test]
fn simulated_line_keeps_to_its_properties() {
    let clock = Clock::default();
    let wire = Wire { bytes_per_second: 1_000, latency: millis(10), tx_fifo: 8, ..Wire::default() };
    let (mut vehicle, ground) = Line::new(&clock, LineConfig::both(wire), 1).ends();
    assert_eq!(vehicle.write(&[7; 20]), Ok(8));
    assert_eq!(vehicle.write_ready(), Ok(false));
    clock.set(Instant::from_millis(3));
    assert_eq!(vehicle.write(&[7; 20]), Ok(3), "one byte per millisecond leaves the FIFO");
    assert_eq!(ground.readable(), 0);
    clock.set(Instant::from_millis(15));
    assert_eq!(ground.readable(), 5, "the bytes that left ten milliseconds ago");
}

/// D-2, D-3, S-20: over lines with short reads and writes, small FIFOs, any speed and stalls, frames are sent whole and in
/// order, every command is answered, and no call blocks (the simulated line would panic).
#[test]
fn partial_reads_and_writes_change_nothing() {
    for seed in 0..20 {
        let faults = Faults { stall: 0.002, stall_for: millis(30), ..Faults::default() };
        let wire = Wire { bytes_per_second: 11_520, latency: millis(3), tx_fifo: 7, rx_fifo: 300, chunk: 5, faults };
        let lines = [LineConfig { up: Wire { faults: Faults::default(), ..wire }, down: wire }; 2];
        let mut world = World::new(Setup { lines, seed, jitter: millis(2), ..Setup::new() });
        for round in 0..40 {
            for gcs in &mut world.gcs {
                gcs.command_long(MavCmd::NAV_TAKEOFF, [round as f32; 7]);
            }
            world.stack.text(world.now(), MavSeverity::INFO, &format!("round {round}"));
            world.run_for(millis(100));
        }
        world.run_for(secs(5));
        for (link, gcs) in (0..).zip(&world.gcs) {
            assert_eq!(gcs.count_of::<CommandAck>(), 40, "seed {seed}, link {link}");
            assert_eq!((gcs.counters().checksum, gcs.counters().skipped), (0, 0), "seed {seed}, link {link}");
            // S-16: no sequence number is missing or repeated.
            let seqs: Vec<u8> = gcs.received.iter().map(|frame| frame.header.seq).collect();
            let expected: Vec<u8> = (0..=255).cycle().take(seqs.len()).collect();
            assert_eq!(seqs, expected, "seed {seed}, link {link}");
        }
        assert_eq!(world.errors, []);
    }
}

/// D-2, SEC-2: one poll reads, handles and writes at most its budget, whichever limit applies; the rest stays pending and is
/// not lost.
#[test]
fn one_poll_keeps_to_its_budget() {
    for (work, frames, most) in [(u32::MAX, 2, 2), (300, 8, 1), (1_200, 8, 2)] {
        let mut setup = Setup::<1>::new();
        setup.config.budget = PollBudget { rx_bytes: 150, work, frames, tx_bytes: 30 };
        let mut world = World::new(setup);
        world.run_for(millis(5));
        let mut handled_at_most = 0;
        for round in 1..=20 {
            for _ in 0..3 {
                world.gcs[0].command_long(MavCmd::NAV_LAND, [1.0; 7]);
            }
            let now = world.now();
            world.gcs[0].poll(now);
            let (written, waiting) = (world.uarts[0].written(), world.uarts[0].readable());
            let handled = world.vehicle.calls.len();
            let result = world.stack.poll_link(now, LINK, &mut world.uarts[0], &mut world.vehicle);
            assert_eq!(result, Ok(()));
            assert!(waiting - world.uarts[0].readable() <= 150, "round {round}");
            assert!(world.uarts[0].written() - written <= 30, "round {round}");
            handled_at_most = handled_at_most.max(world.vehicle.calls.len() - handled);
        }
        assert_eq!(handled_at_most, most, "work {work}, {frames} frames");
        world.run_for(secs(2));
        let counters = world.stack.link_counters(LINK).unwrap();
        assert_eq!(world.vehicle.calls.len() + counters.no_answer_slot as usize, 60);
        assert_eq!(world.gcs[0].count_of::<CommandAck>(), world.vehicle.calls.len());
    }
}

/// D-2: one poll handles at most the budgeted frames, however large the other limits; the others stay pending.
#[test]
fn one_poll_handles_at_most_its_frame_budget() {
    for frames in [0, 1, 2, 5] {
        let mut setup = Setup::<1>::new();
        setup.config.budget = PollBudget { rx_bytes: u32::MAX, work: u32::MAX, frames, tx_bytes: 280 };
        let mut world = World::new(setup);
        let bytes: Vec<u8> = (0..5).flat_map(|_| world.gcs[0].frame_from(STATION, &Attitude::default())).collect();
        let now = world.now();
        assert_eq!(world.stack.receive(now, LINK, &bytes, &mut world.vehicle), bytes.len());
        let most = usize::try_from(frames.max(1)).unwrap();
        let handled = |vehicle: &TestVehicle| {
            vehicle.calls.iter().filter(|call| matches!(call, Call::Message { id: Attitude::ID, .. })).count()
        };
        for round in 1..=5 {
            assert_eq!(handled(&world.vehicle), 5.min(round * most), "{frames} frames, round {round}");
            assert_eq!(world.stack.next_deadline(now) == now, round * most < 5, "{frames} frames, round {round}");
            world.stack.receive(now, LINK, &[], &mut world.vehicle);
        }
    }
}

/// Calls for a link that does not exist do nothing and do not affect other links.
#[test]
fn calls_for_a_missing_link_do_nothing() {
    const NOWHERE: LinkId = LinkId(1);
    let mut world = World::new(Setup::<1>::new());
    let command = world.gcs[0].long(MavCmd::NAV_LAND, [1.0; 7]);
    let frame = world.gcs[0].frame_from(STATION, &command);
    let now = world.now();
    let World { stack, vehicle, .. } = &mut world;
    assert_eq!(stack.receive(now, NOWHERE, &frame, vehicle), 0);
    assert!(stack.receive_buffer(NOWHERE).is_empty());
    stack.received(now, NOWHERE, frame.len(), vehicle);
    assert!(stack.transmit(now, NOWHERE, vehicle).is_empty());
    stack.transmitted(NOWHERE, 20);
    stack.restart_link(NOWHERE);
    assert!(stack.link_counters(NOWHERE).is_none());
    assert_eq!((vehicle.calls.len(), stack.peers(now).count()), (0, 0));
    assert_eq!(stack.receive(now, LINK, &frame, vehicle), frame.len());
    assert_eq!(vehicle.commands().len(), 1);
}

/// SEC-2: a byte that is moved to make room costs half a unit; a poll needs that much more to do the same.
#[test]
fn moved_bytes_cost_work() {
    const HELD: usize = 240;
    let file = FileTransferProtocol { target_network: 0, target_system: 1, target_component: 1, payload: [7; 251] };
    let handled = |garbage: usize, work: u32| {
        let mut setup = Setup::<1>::new();
        setup.config.budget = PollBudget { work, frames: u32::MAX, ..PollBudget::DEFAULT };
        let mut world = World::new(setup);
        let frame = world.gcs[0].frame_from(STATION, &file);
        let held = [&vec![0; garbage][..], &frame[..HELD]].concat();
        let now = world.now();
        assert_eq!(world.stack.receive(now, LINK, &held, &mut world.vehicle), held.len());
        world.gcs[0].send_raw(&frame[HELD..]);
        world.gcs[0].send(&Gcs::heartbeat());
        world.gcs[0].send(&Gcs::heartbeat());
        world.gcs[0].poll(now);
        world.stack.poll_link(now, LINK, &mut world.uarts[0], &mut world.vehicle).unwrap();
        world.stack.rx_counters(LINK).unwrap().frames
    };
    let works: Vec<u32> = (700..3_000).collect();
    for frames in [2, 3] {
        let least = |garbage| 700 + works.partition_point(|work| handled(garbage, *work) < frames);
        assert_eq!(least(30) - least(0), HELD / 2, "{frames} frames");
    }
}

/// S-20: a transport error is returned and counted, and the link recovers: a partly sent frame is completed, and new bytes are
/// read.
#[test]
fn transport_error_is_reported_and_link_recovers() {
    let mut world = World::new(Setup::<1>::new());
    world.run_for(millis(10));
    world.uarts[0].fail_next_read(LineError::Overrun);
    world.run_for(millis(10));
    assert_eq!(world.errors, [(LINK, LinkError::Read(LineError::Overrun))]);
    world.gcs[0].command_long(MavCmd::NAV_LAND, [0.0; 7]);
    world.uarts[0].fail_next_write(LineError::Injected);
    world.run_for(millis(10));
    assert_eq!(world.errors[1..], [(LINK, LinkError::Write(LineError::Injected))]);
    assert_eq!(world.gcs[0].count_of::<CommandAck>(), 1);
    let counters = world.stack.link_counters(LINK).unwrap();
    assert_eq!((counters.read_errors, counters.write_errors), (1, 1));
    // A link that does not exist.
    let nowhere = world.stack.poll_link(world.now(), LinkId(1), &mut world.uarts[0], &mut world.vehicle);
    assert_eq!(nowhere, Err(LinkError::NoSuchLink));
    world.uarts[0].fail_next_write(LineError::Injected);
    let nowhere = world.stack.poll_link(world.now(), LinkId(1), &mut world.uarts[0], &mut world.vehicle);
    assert_eq!(nowhere, Err(LinkError::NoSuchLink));
    let counters = world.stack.link_counters(LINK).unwrap();
    assert_eq!((counters.read_errors, counters.write_errors), (1, 1));
}

/// S-20: on a line that delivers more than is read, lost bytes are counted and the others are handled.
#[test]
fn overrun_loses_only_its_own_bytes() {
    let mut line = LineConfig::default();
    line.up.rx_fifo = 256;
    let mut world = World::new(Setup { lines: [line], ..Setup::<1>::new() });
    for _ in 0..100 {
        // 40 commands of 45 bytes at once.
        for _ in 0..40 {
            world.gcs[0].command_long(MavCmd::NAV_LAND, [1.0; 7]);
        }
        world.run_for(millis(20));
    }
    assert!(world.errors.iter().all(|error| *error == (LINK, LinkError::Read(LineError::Overrun))));
    assert_eq!(world.stack.link_counters(LINK).unwrap().read_errors as usize, world.errors.len());
    let handled = world.vehicle.commands().len();
    assert!(handled >= 400, "{handled} commands: those before each overrun");
    world.run_for(secs(1));
    world.gcs[0].forget();
    world.gcs[0].command_long(MavCmd::NAV_LAND, [1.0; 7]);
    world.expect::<CommandAck>(0, millis(5));
}

/// One byte per millisecond to the ground, so that a test can stop in the middle of a frame.
fn slow_down() -> LineConfig {
    let down = Wire { bytes_per_second: 1_000, tx_fifo: 4, ..Wire::default() };
    LineConfig { down, ..LineConfig::default() }
}

/// A client disconnects in the middle of a frame, in both directions, and another one connects: it gets whole frames, and the
/// partial old frame does not damage its first one.
#[test]
fn next_client_starts_with_a_whole_frame() {
    for cut in 1..43 {
        let line = slow_down();
        let mut world = World::new(Setup { lines: [line], ..Setup::<1>::new() });
        world.run_for(millis(100));
        // Its last command is truncated; the answer to the previous one is in transmission.
        let command = world.gcs[0].long(MavCmd::NAV_LAND, [1.0; 7]);
        world.gcs[0].send(&command);
        let frame = world.gcs[0].frame_from(STATION, &command);
        world.gcs[0].send_raw(&frame[..cut]);
        world.run_for(millis(8));
        world.uarts[0].set_closed(true);
        world.run_for(millis(50));
        assert_eq!(world.errors.last(), Some(&(LINK, LinkError::Closed)));
        world.uarts[0].set_closed(false);
        world.stack.restart_link(LINK);
        world.gcs[0] = Gcs::new(world.gcs[0].end.clone());
        let version = [AutopilotVersion::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, version);
        world.run_for(millis(700));
        let ids: Vec<u32> = world.gcs[0].received.iter().map(|frame| frame.header.id).collect();
        // The answer to the old client is sent again from its first byte, because it may not have arrived (H-17).
        assert_eq!(ids, [Heartbeat::ID, 77, 77, 148], "cut at {cut}");
        assert_eq!(world.gcs[0].counters().skipped, 0, "cut at {cut}");
    }
}

/// H-5: an interrupted heartbeat is not sent to the next client, because it is out of date.
#[test]
fn next_client_gets_no_old_heartbeat() {
    let line = slow_down();
    let mut world = World::new(Setup { lines: [line], ..Setup::<1>::new() });
    world.run_for(millis(8));
    world.uarts[0].set_closed(true);
    world.step();
    world.loop_runs = false;
    for _ in 0..60 {
        world.clock.set(world.now() + secs(1));
        world.stack.poll(world.now(), &mut world.vehicle);
    }
    world.uarts[0].set_closed(false);
    world.stack.restart_link(LINK);
    world.run_for(secs(5));
    assert_eq!(world.gcs[0].received.len(), 0);
}

/// V-1, V-2: a link answers in its own version, whatever it receives. `Auto` starts with v1 and switches to v2 for good at the
/// first real v2 frame.
#[test]
fn versions_are_kept_per_link() {
    let [v2, auto, v1] = [TxVersion::V2, TxVersion::Auto, TxVersion::V1];
    let mut world =
        World::new(Setup { links: [v2, auto, v1].map(|v| LinkConfig::uart(57_600).with_version(v)), ..Setup::new() });
    let ask = |world: &mut World<3>, version| {
        let mut versions = Vec::new();
        for link in 0..3 {
            world.gcs[link].version = version;
            world.gcs[link].forget();
            world.gcs[link].command_long(MavCmd::NAV_LAND, [0.0; 7]);
            world.run_for(millis(10));
            let acks = world.gcs[link].received.iter().filter(|frame| frame.header.id == CommandAck::ID);
            versions.extend(acks.map(|frame| frame.header.version));
        }
        versions
    };
    use Version::{V1, V2};
    assert_eq!(ask(&mut world, V1), [V2, V1, V1]);
    // None of these is a v2 frame from a peer: damaged, unknown id, our own echo.
    let mut damaged = world.gcs[1].frame_from(STATION, &Gcs::heartbeat());
    world.gcs[1].version = V2;
    damaged[11] ^= 1;
    let unknown = reference::v2(0x00AB_CDEF, [0, 0], [255, 190], &[1], 0);
    let echo = world.gcs[1].frame_from(VEHICLE, &Gcs::heartbeat());
    world.gcs[1].send_raw(&[damaged, unknown, echo].concat());
    world.run_for(millis(600));
    assert_eq!(ask(&mut world, V1), [V2, V1, V1]);
    assert_eq!(ask(&mut world, V2), [V2, V2, V1]);
    assert_eq!(ask(&mut world, V1), [V2, V2, V1], "for good");
}

/// the firmware gets messages without a target, broadcasts, and messages to us; it gets no others.
#[test]
fn messages_for_others_do_not_reach_the_vehicle() {
    let mut world = World::new(Setup::<1>::new());
    let seen = |world: &mut World<1>| {
        world.run_for(millis(5));
        std::mem::take(&mut world.vehicle.calls).len() == 1
    };
    world.gcs[0].send(&Attitude::default());
    assert!(seen(&mut world), "no target at all");
    for (system, component, ours) in [
        (1, 1, true),
        (0, 0, true),
        (0, 1, true),
        (1, 0, true),
        (2, 1, false),
        (1, 2, false),
        (0, 2, false),
        (1, 190, false),
    ] {
        let tune = PlayTune { target_system: system, target_component: component, ..PlayTune::default() };
        world.gcs[0].send(&tune);
        assert_eq!(seen(&mut world), ours, "PLAY_TUNE to {system}/{component}");
    }
    for (system, ours) in [(1, true), (0, true), (2, false)] {
        // A target system without a component; MANUAL_CONTROL names the field differently.
        world.gcs[0].send(&SetMode { target_system: system, ..SetMode::default() });
        assert_eq!(seen(&mut world), ours, "SET_MODE to {system}");
        world.gcs[0].send(&ManualControl { target: system, x: 1_000, ..ManualControl::default() });
        assert_eq!(seen(&mut world), ours, "MANUAL_CONTROL to {system}");
    }
    assert_eq!(world.stack.link_counters(LINK).unwrap().not_ours, 6);
    // The stack handles heartbeats itself.
    world.gcs[0].send(&Gcs::heartbeat());
    world.run_for(millis(5));
    assert!(matches!(world.vehicle.calls[..], [Call::Peer(_)]));
}

/// S-12: a message whose checksum cannot be verified is counted, and not delivered.
#[test]
fn unverified_frames_are_not_delivered() {
    let mut world = World::new(Setup::<1>::new());
    world.gcs[0].send(&Attitude::default());
    world.gcs[0].send_raw(&reference::v2(0x00AB_CDEF, [0, 0], [255, 190], &[1, 2, 3], 9));
    world.run_for(millis(100));
    assert_eq!(world.vehicle.calls.len(), 1);
    assert_eq!(world.stack.link_counters(LINK).unwrap().unknown, 1);
    assert_eq!(world.stack.rx_counters(LINK).unwrap().unchecked, 1);
}

/// The input of both halves of the next test: times in milliseconds, and bytes.
fn script() -> Vec<(u64, Vec<u8>)> {
    let world = World::new(Setup::<1>::new());
    let mut gcs = world.gcs.into_iter().next().unwrap();
    let mut script = Vec::new();
    let mut rng = Rng::new(9);
    let mut at = 3;
    for _ in 0..400 {
        at += rng.below(60);
        let command = gcs.long(MavCmd::NAV_LAND, [1.0; 7]);
        let mut bytes = match rng.below(5) {
            0 => gcs.frame_from(STATION, &Gcs::heartbeat()),
            1 => gcs.frame_from(STATION, &gcs.long(MavCmd::REQUEST_MESSAGE, [148.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])),
            // Noise without start bytes: it defers nothing, so each pass finds the same frames.
            2 => (0..rng.below(90)).map(|_| rng.byte() & 0x7F).collect(),
            _ => gcs.frame_from(OTHER_STATION, &command),
        };
        if rng.chance(0.1) {
            bytes.truncate(rng.below(bytes.len() as u64 + 1) as usize);
        }
        script.push((at, bytes));
    }
    script
}

/// Returns everything that a stack sends for the script when `drive` runs it: it delivers the received bytes and takes the
/// bytes to send.
fn bytes_sent(mut drive: impl FnMut(&mut Stack<Tested, 1>, Instant, &[u8], &mut TestVehicle) -> Vec<u8>) -> Vec<u8> {
    let setup = Setup::<1>::new();
    let mut stack: Box<Stack<Tested, 1>> = begun(setup.config, setup.links);
    let mut vehicle = TestVehicle::new();
    let (mut sent, mut script) = (Vec::new(), script().into_iter().peekable());
    for ms in 0..20_000 {
        let now = Instant::from_millis(ms);
        setup.config.pulse.expect("a setup has a pulse").tick();
        stack.poll(now, &mut vehicle);
        let bytes = script.next_if(|(at, _)| *at <= ms).map(|(_, bytes)| bytes).unwrap_or_default();
        sent.extend(drive(&mut stack, now, &bytes, &mut vehicle));
    }
    assert!(vehicle.commands().len() > 120);
    sent
}

/// The calls for interrupts and DMA do the same as `poll_link`, byte for byte, also for one byte at a time.
#[test]
fn byte_level_calls_equal_poll_link() {
    fn take(stack: &mut Stack<Tested, 1>, now: Instant, vehicle: &mut TestVehicle, piece: usize) -> Vec<u8> {
        let mut taken = Vec::new();
        loop {
            let bytes = stack.transmit(now, LINK, vehicle);
            let len = bytes.len().min(piece);
            if len == 0 {
                return taken;
            }
            taken.extend(&bytes[..len]);
            stack.transmitted(LINK, len);
        }
    }
    let clock = Clock::default();
    let (mut uart, mut far) = Line::new(&clock, LineConfig::default(), 1).ends();
    let polled = bytes_sent(|stack, now, bytes, vehicle| {
        clock.set(now);
        if !bytes.is_empty() {
            assert_eq!(far.write(bytes), Ok(bytes.len()));
        }
        stack.poll_link(now, LINK, &mut uart, vehicle).unwrap();
        let mut sent = vec![0; far.readable()];
        if !sent.is_empty() {
            embedded_io::Read::read(&mut far, &mut sent).unwrap();
        }
        sent
    });
    let received = bytes_sent(|stack, now, bytes, vehicle| {
        assert_eq!(stack.receive(now, LINK, bytes, vehicle), bytes.len());
        take(stack, now, vehicle, 280)
    });
    let bytewise = bytes_sent(|stack, now, bytes, vehicle| {
        stack.receive(now, LINK, &[], vehicle);
        for byte in bytes {
            assert_eq!(stack.receive(now, LINK, &[*byte], vehicle), 1);
        }
        take(stack, now, vehicle, 1)
    });
    let in_place = bytes_sent(|stack, now, mut bytes, vehicle| {
        stack.received(now, LINK, 0, vehicle);
        while !bytes.is_empty() {
            let room = stack.receive_buffer(LINK);
            let len = room.len().min(bytes.len());
            room[..len].copy_from_slice(&bytes[..len]);
            stack.received(now, LINK, len, vehicle);
            bytes = &bytes[len..];
        }
        take(stack, now, vehicle, 17)
    });
    assert!(polled.len() > 5_000);
    for (how, bytes) in [("receive", received), ("a byte at a time", bytewise), ("in place", in_place)] {
        assert_eq!(bytes.iter().zip(&polled).position(|(a, b)| a != b), None, "{how}");
        assert_eq!(bytes.len(), polled.len(), "{how}");
    }
}

/// M-10: old ground stations address plans to component 190; other messages to it are not handled.
#[test]
fn plans_may_be_addressed_to_the_old_planner() {
    type Plans = Tested<mavstack::plan_memory!(mission: 10)>;
    let mut world = World::<1, Plans>::of(Setup::new());
    for (system, component, answered) in
        [(1, 190, true), (1, 1, true), (1, 0, true), (1, 2, false), (2, 1, false), (0, 0, false), (0, 190, false)]
    {
        let list = MissionRequestList { target_system: system, target_component: component, ..Default::default() };
        world.gcs[0].send(&list);
        world.run_for(millis(50));
        assert_eq!(world.gcs[0].take::<MissionCount>().is_some(), answered, "to {system}/{component}");
    }
}

/// The vehicle gets each frame with its true sender, listed or not.
#[test]
fn vehicle_gets_the_sender() {
    let mut world = World::new(Setup::<1>::new());
    let camera = Address::new(1, 100);
    world.gcs[0].send_from(camera, &Attitude::default());
    world.run_for(millis(5));
    assert!(matches!(world.vehicle.calls[..], [Call::Message { id: 30, from, link: LINK, .. }] if from == camera));
}

/// S-11: pymavlink sends as component 0 by default. It is answered at that address, unless the configuration refuses it.
#[test]
fn component_0_is_answered_unless_configured_otherwise() {
    let config = Setup::<1>::new().config;
    for (config, answers) in [(config, 1), (Config { accepts_component_0: false, ..config }, 0)] {
        let mut stack: Box<Stack<Tested, 1>> = begun(config, [LinkConfig::uart(57_600)]);
        let mut vehicle = TestVehicle::default();
        let mut frame = [0; MAX_FRAME_LEN];
        let command = CommandLong { command: MavCmd::NAV_LAND, target_system: 1, ..Default::default() };
        let len = encode(&command, Version::V2, Address::new(255, 0), 0, &mut frame).unwrap();
        assert_eq!(stack.receive(Instant::ZERO, LINK, &frame[..len], &mut vehicle), len);
        let dropped = stack.rx_counters(LINK).unwrap().zero_source;
        assert_eq!((vehicle.commands().len(), dropped), (answers, 1 - answers as u32));
        let mut decoder = Decoder::default();
        let _ = decoder.push(stack.transmit(Instant::ZERO, LINK, &mut vehicle), Instant::ZERO);
        let answer = decoder.next(Instant::ZERO, Common::MESSAGES, &mut u32::MAX.clone(), |_| false);
        let ack = answer.and_then(|frame| frame.decode::<CommandAck>());
        let target = ack.map(|ack| (ack.target_system, ack.target_component));
        assert_eq!(target, (answers == 1).then_some((255, 0)));
    }
}
