//! When a driver that sleeps must poll again. Rules S-16, S-20.

use super::*;

/// Runs a minute; returns what the stack sent, the calls to its vehicle, and the number of passes. The stack runs every
/// millisecond, or only at its deadline, at a received byte, and when the line has room again. The line stalls for ten seconds.
fn minute(sleeps: bool, tx_fifo: usize, tx_bytes: u32) -> (Vec<Received>, Vec<Call>, u32) {
    let down = Wire { bytes_per_second: 2_000, tx_fifo, ..Wire::default() };
    let lines = [LineConfig { down, ..LineConfig::default() }];
    let mut setup = Setup { links: [LinkConfig::uart(9_600)], lines, ..Setup::<1>::new() };
    setup.config.budget.tx_bytes = tx_bytes;
    let mut world = World::new(setup);
    world.uarts[0].stall_writes_until(Instant::from_millis(10_000));
    let (mut script, mut wakes, mut was_full) = (script().into_iter().peekable(), 0, false);
    let mut deadline = Instant::ZERO;
    for ms in 0..60_000 {
        let now = Instant::from_millis(ms);
        world.clock.set(now);
        world.pulse.tick();
        while let Some((_, bytes)) = script.next_if(|(at, _)| *at <= ms) {
            world.gcs[0].send_raw(&bytes);
        }
        if ms % 700 == 0 {
            // The firmware knows about its own calls, and runs the stack after them.
            deadline = now;
            let text = format!("{ms} ms have gone by, and all is well so far, it seems");
            world.stack.text(now, MavSeverity::INFO, &text);
        }
        world.gcs[0].poll(now);
        let uart = &mut world.uarts[0];
        let is_full = uart.write_ready() == Ok(false);
        let room_came = was_full && !is_full;
        if !sleeps || deadline <= now || uart.readable() > 0 || room_came {
            wakes += 1;
            world.stack.poll(now, &mut world.vehicle);
            world.stack.poll_link(now, LINK, uart, &mut world.vehicle).unwrap();
            deadline = world.stack.next_deadline(now);
        }
        was_full = uart.write_ready() == Ok(false);
        world.gcs[0].poll(now);
    }
    (world.gcs.remove(0).received, world.vehicle.calls, wakes)
}

/// Received bytes are held as long as necessary: a frame with an unknown id until silence follows, a partial frame until its
/// rest arrives, and what exceeds a poll's budget until the next poll.
#[test]
fn next_deadline_includes_received_bytes() {
    let mut setup = Setup::<1>::new();
    setup.config.budget.frames = 1;
    let mut world = World::new(setup);
    world.gcs[0].send(&Gcs::heartbeat());
    world.expect::<Heartbeat>(0, secs(2));
    world.gcs[0].forget();
    world.expect::<Heartbeat>(0, secs(2));
    let deadline = |world: &mut World<1>, bytes: &[u8]| {
        let now = world.now();
        assert_eq!(world.stack.receive(now, LINK, bytes, &mut world.vehicle), bytes.len());
        let deadline = world.stack.next_deadline(now) - now;
        world.run_for(millis(25));
        deadline
    };
    let deadline_of_none = deadline(&mut world, &[]);
    assert!((millis(490)..=millis(500)).contains(&deadline_of_none), "the next poll (H-18): {deadline_of_none:?}");
    let unknown = reference::v2(0x00AB_CDEF, [0, 0], [255, 190], &[1, 2, 3], 0);
    let mut signed = reference::v2(0x00AB_CDEF, [1, 0], [255, 190], &[1, 2, 3], 0);
    signed.extend(1..=13);
    assert_eq!(deadline(&mut world, &unknown), millis(20));
    assert_eq!(deadline(&mut world, &signed), millis(20));
    let heartbeat = world.gcs[0].frame_from(STATION, &Gcs::heartbeat());
    assert_eq!(deadline(&mut world, &[&heartbeat[..], &heartbeat].concat()), millis(0));
    assert_eq!(deadline(&mut world, &unknown[..unknown.len() - 1]), millis(500));
}

/// A driver that sleeps until `next_deadline`, a received byte, or room on the line sends the same at the same times as one
/// that polls every millisecond, and it really sleeps. Whether the line's room or the poll's budget interrupts a frame makes no
/// difference.
#[test]
fn next_deadline_is_enough() {
    for (tx_fifo, tx_bytes, most) in [(16, 40, 6_000), (1_024, 280, 1_000), (1_024, 7, 3_000)] {
        let (said, calls, _) = minute(false, tx_fifo, tx_bytes);
        let (said_by_sleeper, calls_by_sleeper, wakes) = minute(true, tx_fifo, tx_bytes);
        assert!(said.len() > 150, "{}", said.len());
        assert!(calls_by_sleeper == calls);
        for (sleeper, poller) in said_by_sleeper.iter().zip(&said) {
            assert_eq!(sleeper, poller);
        }
        assert_eq!(said_by_sleeper.len(), said.len());
        assert!(wakes < most, "{wakes} times in 60,000 ms");
    }
}

/// `next_deadline` returns `now` while work is pending that only the vehicle knows about: the end of a command, on the link
/// that asked for it, or a new mode, before and after the link has written. An answer to PING is pending only until it is
/// written. After the next poll nothing is pending.
#[test]
fn next_deadline_includes_pending_work_of_the_vehicle() {
    let mut world = World::<2, Tested<NoPlans, 8, Timed>>::of(Setup::new());
    world.vehicle.long.insert(MavCmd::PREFLIGHT_CALIBRATION.0);
    let (command, target_system, target_component) = (MavCmd::PREFLIGHT_CALIBRATION, 1, 1);
    let calibrate = CommandLong { command, target_system, target_component, ..CommandLong::default() };
    let arm = CommandLong { command: MavCmd::COMPONENT_ARM_DISARM, ..calibrate };
    let station = &mut world.gcs[0];
    let frames = [
        (1, station.frame_from(STATION, &Ping::default()), false),
        (0, station.frame_from(STATION, &calibrate), true),
        (1, station.frame_from(OTHER_STATION, &CommandCancel { command, target_system, target_component }), true),
        (1, station.frame_from(STATION, &arm), true),
    ];
    world.run_for(millis(1_100));
    for (link, frame, asks_vehicle) in frames {
        let now = world.now();
        assert!(world.stack.next_deadline(now) > now + millis(20));
        world.stack.receive(now, LinkId(link), &frame, &mut world.vehicle);
        assert_eq!(world.stack.next_deadline(now), now);
        loop {
            let len = world.stack.transmit(now, LinkId(link), &mut world.vehicle).len();
            if len == 0 {
                break;
            }
            world.stack.transmitted(LinkId(link), len);
        }
        assert_eq!(world.stack.next_deadline(now) == now, asks_vehicle);
        world.gcs[0].forget();
        world.step();
        let acks = world.gcs[0].all::<CommandAck>();
        let results: Vec<_> = acks.iter().map(|(_, ack)| ack.result).collect();
        let is_cancelled = world.vehicle.calls.iter().any(|call| matches!(call, Call::CancelCommand(..)));
        assert_eq!(results, Vec::from_iter(is_cancelled.then_some(MavResult::CANCELLED)));
        world.vehicle.calls.clear();
    }
}

/// A frame that stops one byte before its end does not wake the driver until its timeout.
#[test]
fn unfinished_frame_does_not_wake_the_driver() {
    let mut world = World::new(Setup::<1>::new());
    world.run_for(millis(100));
    let frame = world.gcs[0].frame_from(STATION, &Gcs::heartbeat());
    world.gcs[0].send_raw(&frame[..frame.len() - 1]);
    world.run_for(millis(50));
    let deadline = world.stack.next_deadline(world.now());
    assert!(deadline > world.now() + millis(400), "{deadline:?} at {:?}", world.now());
}
