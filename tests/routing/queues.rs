//! Forwarded frames beside the vehicle's own: rules R-14, M-11, D-2, D-3, SEC-2. Routes are in `forwarding.rs`.

use crate::Forwarder;
use crate::support::*;
use mavstack::config::{PollBudget, StreamProfile};
use mavstack::dialect::*;
use mavstack::network::ForwardCounters;
use mavstack::{Address, Duration, Instant, LinkConfig, LinkId, Message, plan_memory};

/// The links: a radio, and a companion computer on a much faster link.
const RADIO: usize = 0;
const COMPANION: usize = 1;

/// Another vehicle, behind the companion computer.
const WINGMAN: Address = Address::new(2, 1);

/// A vehicle that forwards between a radio of 57,600 bit/s with these streams and a companion computer.
fn setup(streams: StreamProfile) -> Setup<2> {
    let radio = Wire { bytes_per_second: 5_760, tx_fifo: 16, ..Wire::default() };
    Setup {
        links: [
            LinkConfig::uart(57_600).with_streams(streams),
            LinkConfig::uart(921_600).with_streams(StreamProfile::Off),
        ],
        lines: [LineConfig { down: radio, ..LineConfig::default() }, LineConfig::default()],
        ..Setup::new()
    }
}

fn world(setup: Setup<2>) -> Forwarder<2> {
    let mut world = Forwarder::of(setup);
    world.run_for(millis(100));
    world.gcs[RADIO].forget();
    world
}

fn counters(world: &Forwarder<2>, link: usize) -> ForwardCounters {
    world.stack.forward_counters(LinkId(link as u8)).unwrap()
}

/// A broadcast with a payload of `len` bytes; the frame has 12 more.
fn tunnel(len: u8) -> Tunnel {
    let mut payload = [0; 128];
    payload[usize::from(len) - 6] = 1;
    Tunnel { payload, ..Tunnel::default() }
}

/// on a saturated link streams and forwarded frames are sent by turns, and the link stays saturated.
#[test]
fn streams_and_forwarded_frames_take_turns() {
    let mut world = world(setup(StreamProfile::Onboard));
    // Our own 50 Hz and 10 Hz streams are 3,000 bytes a second; the forwarded frames are twice as much.
    for _ in 0..1_000 {
        world.gcs[COMPANION].send_from(WINGMAN, &Attitude { yaw: 1.0, yawspeed: 0.5, ..Attitude::default() });
        world.run_for(millis(5));
    }
    let is_own = |frame: &&Received| frame.header.source == VEHICLE;
    let own: Vec<_> = world.gcs[RADIO].received.iter().filter(is_own).collect();
    let own_bytes: usize = own.iter().map(|frame| frame.raw.len()).sum();
    let all_bytes: usize = world.gcs[RADIO].received.iter().map(|frame| frame.raw.len()).sum();
    let others = world.gcs[RADIO].received.len() - own.len();
    assert!((27_500..=28_800).contains(&all_bytes), "{all_bytes} bytes in 5 s");
    assert!(own_bytes > 12_000 && others > 300, "{own_bytes} bytes of our own, {others} frames of others");
    // Never two forwarded frames while a stream is pending, nor the reverse: here both are pending nearly always.
    let mut run = 0;
    let mut longest = 0;
    for pair in world.gcs[RADIO].received.windows(2) {
        run = if pair[0].header.source == pair[1].header.source { run + 1 } else { 0 };
        longest = longest.max(run);
    }
    assert!(longest <= 3, "{longest} of one kind in a row");
    assert!(counters(&world, RADIO).queue_full > 100, "{:?}", counters(&world, RADIO));
}

/// Returns the longest time to an answer among 40 commands over the radio, while the companion sends `load`.
fn slowest_answer(mut load: impl FnMut(&mut Gcs)) -> Duration {
    let mut world = world(setup(StreamProfile::Onboard));
    let mut slowest = Duration::ZERO;
    for round in 0..40 {
        for _ in 0..10 + round % 7 {
            load(&mut world.gcs[COMPANION]);
            world.run_for(millis(7));
        }
        let begin = world.now();
        world.gcs[RADIO].command_long(MavCmd::NAV_LAND, [0.0; 7]);
        while world.gcs[RADIO].take::<CommandAck>().is_none() {
            load(&mut world.gcs[COMPANION]);
            world.run_for(millis(1));
        }
        slowest = slowest.max(world.now() - begin);
    }
    slowest
}

/// an answer waits for at most one forwarded frame, however many are queued.
#[test]
fn answers_wait_for_one_forwarded_frame_at_most() {
    let alone = slowest_answer(|_| {});
    for len in [20, 133] {
        let loaded = slowest_answer(|companion| companion.send_from(WINGMAN, &tunnel(len)));
        let frame = Duration::from_micros((u64::from(len) + 12) * 1_000_000 / 5_760);
        let bound = alone.as_micros() + frame.as_micros() + 1_000;
        assert!(loaded.as_micros() <= bound, "{alone:?} alone, {loaded:?} with frames of {frame:?}");
    }
}

/// D-3, R-14: after backpressure, queued frames are sent whole and in order; those that did not fit are counted. Other links
/// are not affected. A frame older than 600 ms is dropped.
#[test]
fn full_queue_drops_whole_frames() {
    for (stall, arrive, stale) in [(550, 6, 0), (650, 0, 6)] {
        let mut world = world(setup(StreamProfile::Off));
        world.uarts[RADIO].stall_writes_until(world.now() + millis(stall));
        world.run_for(millis(2));
        // 50 bytes each, and 6 for the queue's header: 6 of them fit into three quarters of 512 bytes.
        let frames: Vec<_> = (0..20).map(|_| world.gcs[COMPANION].frame_from(WINGMAN, &tunnel(38))).collect();
        for frame in &frames {
            world.gcs[COMPANION].send_raw(frame);
        }
        world.gcs[COMPANION].command_long(MavCmd::NAV_LAND, [0.0; 7]);
        world.run_for(millis(20));
        assert_eq!(world.gcs[COMPANION].count_of::<CommandAck>(), 1);
        world.run_for(secs(2));
        let others: Vec<_> = world.gcs[RADIO]
            .received
            .iter()
            .filter(|frame| frame.header.source == WINGMAN)
            .map(|frame| &frame.raw)
            .collect();
        assert!(others.into_iter().eq(&frames[..arrive]), "{stall} ms");
        let expected = counted::<ForwardCounters>(|counters| {
            counters.sent = arrive as u32;
            counters.queue_full = 14;
            counters.stale = stale
        });
        assert_eq!(counters(&world, RADIO), expected);
        assert_eq!(world.gcs[RADIO].counters().skipped, 0);
    }
}

/// the last quarter of a queue is reserved for addressed frames, so a flood of broadcasts does not keep them out.
#[test]
fn addressed_frames_have_room_during_a_flood() {
    let mut world = world(setup(StreamProfile::Off));
    world.gcs[RADIO].send(&Gcs::heartbeat());
    world.run_for(millis(10));
    let mut sent = Vec::new();
    // Twice the radio's rate for ten seconds.
    for round in 0..2_000 {
        world.gcs[COMPANION].send_from(WINGMAN, &tunnel(45));
        if round % 25 == 0 {
            let tune = PlayTune {
                target_system: STATION.system.wire(),
                target_component: STATION.component.wire(),
                ..PlayTune::default()
            };
            let frame = world.gcs[COMPANION].frame_from(WINGMAN, &tune);
            world.gcs[COMPANION].send_raw(&frame);
            sent.push(frame);
        }
        world.run_for(millis(5));
    }
    world.run_for(secs(1));
    let tunes: Vec<_> = world.gcs[RADIO].received.iter().filter(|frame| frame.header.id == PlayTune::ID).collect();
    assert!(tunes.iter().map(|frame| &frame.raw).eq(&sent));
    assert!(counters(&world, RADIO).queue_full > 500, "{:?}", counters(&world, RADIO));
}

/// while a routing loop is detected, frames are dropped after 150 ms in a queue. A duplicate on the same link, or a source
/// heard on both links, is not a loop. The detection ends after a while.
#[test]
fn frames_expire_sooner_in_a_loop() {
    let stale = |copy: Option<usize>, is_everywhere: bool, pause: u64| {
        let mut world = world(setup(StreamProfile::Off));
        let frame = world.gcs[COMPANION].frame_from(WINGMAN, &tunnel(38));
        world.gcs[COMPANION].send_raw(&frame);
        world.run_for(millis(50));
        if is_everywhere {
            world.gcs[RADIO].skip_seq(WINGMAN, 100);
            world.gcs[RADIO].send_from(WINGMAN, &tunnel(20));
            world.run_for(millis(20));
        }
        if let Some(link) = copy {
            world.gcs[link].send_raw(&frame);
            world.run_for(millis(50));
            assert_eq!(counters(&world, link).duplicates, 1);
        }
        world.run_for(millis(pause));
        world.uarts[RADIO].stall_writes_until(world.now() + millis(300));
        // A source that is heard on this link only.
        for _ in 0..3 {
            world.gcs[COMPANION].send_from(OTHER_STATION, &tunnel(38));
        }
        world.run_for(secs(1));
        counters(&world, RADIO).stale
    };
    assert_eq!(stale(None, false, 0), 0);
    assert_eq!(stale(Some(COMPANION), false, 0), 0, "sent twice");
    assert_eq!(stale(Some(RADIO), true, 0), 0, "by two paths");
    assert_eq!(stale(Some(RADIO), false, 0), 3);
    assert_eq!(stale(Some(RADIO), false, 9_500), 3);
    assert_eq!(stale(Some(RADIO), false, 10_500), 0);
}

/// the ring buffer wraps at every length, and frames leave the queue unchanged.
#[test]
fn queue_wraps_correctly_at_every_length() {
    let mut world = world(setup(StreamProfile::Off));
    let mut sent = Vec::new();
    for round in 0..400 {
        let frame = world.gcs[COMPANION].frame_from(WINGMAN, &tunnel(8 + (round * 37 % 120) as u8));
        world.gcs[COMPANION].send_raw(&frame);
        sent.push(frame);
        world.run_for(millis(30));
    }
    let received: Vec<_> = world.gcs[RADIO].received.iter().filter(|frame| frame.header.source == WINGMAN).collect();
    assert!(received.iter().map(|frame| &frame.raw).eq(&sent));
}

/// A driver that sleeps until `next_deadline` wakes for frames in another link's queue, and no more once it is empty.
#[test]
fn next_deadline_includes_queues() {
    let mut world = world(setup(StreamProfile::Off));
    let frames: Vec<_> = (0..5).map(|_| world.gcs[COMPANION].frame_from(WINGMAN, &tunnel(100))).collect();
    let (stack, vehicle, now) = (&mut world.stack, &mut world.vehicle, world.clock.now());
    assert!(stack.transmit(now, LinkId(0), vehicle).is_empty());
    let resting = stack.next_deadline(now);
    assert!(resting > now + millis(20), "a heartbeat at most");
    for frame in &frames {
        assert_eq!(stack.receive(now, LinkId(1), frame, vehicle), frame.len());
    }
    let (mut at, mut sent, mut passes) = (now, Vec::new(), 0);
    while sent.len() < 3 {
        at = stack.next_deadline(at);
        assert!(at < now + millis(150), "{} sent at {at:?}", sent.len());
        passes += 1;
        assert!(passes < 20, "woken without anything to send");
        let bytes = stack.transmit(at, LinkId(0), vehicle).to_vec();
        stack.transmitted(LinkId(0), bytes.len());
        if !bytes.is_empty() {
            sent.push(bytes);
        }
    }
    // The fourth does not fit into three quarters of 512 bytes.
    assert!(sent.iter().eq(&frames[..3]));
    while stack.next_deadline(at) <= at {
        assert!(stack.transmit(at, LinkId(0), vehicle).is_empty());
        stack.transmit(at, LinkId(1), vehicle);
        at += millis(1);
        assert!(at < now + millis(300), "woken without anything to send");
    }
}

/// D-2, SEC-2: the cost of forwarding counts towards the budget: a poll forwards fewer frames than it could handle, and none is
/// lost.
#[test]
fn forwarding_is_within_the_budget() {
    let links = [LinkConfig::unlimited(); 5];
    let mut setup = Setup { links, ..Setup::<5>::new() };
    setup.config.budget = PollBudget { rx_bytes: 1_000, work: 1_700, frames: 8, tx_bytes: 2_000 };
    let mut world = Forwarder::<5>::of(setup);
    world.run_for(millis(10));
    // 145 bytes: checksum, key, four queues.
    for _ in 0..20 {
        world.gcs[0].send_from(WINGMAN, &tunnel(133));
    }
    let mut most = 0;
    for _ in 0..100 {
        let before = world.vehicle.calls.len();
        world.step();
        most = most.max(world.vehicle.calls.len() - before);
    }
    assert_eq!(most, 1, "per poll");
    for link in 1..5 {
        assert_eq!(world.gcs[link].count_of::<Tunnel>(), 20);
    }
}

/// M-11, M-45: an upload or download that moves to another link halfway completes. The station receives on both links and
/// sends on one; it is silent for two seconds before it switches.
#[test]
fn transfers_move_between_links() {
    for cut in 0..30 {
        let mut world = Forwarder::<2, plan_memory!(mission: 20)>::of(Setup::new());
        let items = plan(12, 0);
        // The vehicle retransmits its request during the silence.
        let mut upload = Upload::new(&world.gcs[0], &items).with_patience(20);
        step_over(&mut world, cut, |now, gcs| upload.poll(now, gcs).is_some());
        assert!(upload.result().unwrap().is_ok(), "cut at {cut} ms");
        world.gcs.iter_mut().for_each(Gcs::forget);
        let mut download = Download::new(&world.gcs[0], MavMissionType::MISSION);
        step_over(&mut world, cut, |now, gcs| download.poll(now, gcs).is_some());
        assert_eq!(download.result().unwrap().unwrap().len(), items.len(), "cut at {cut} ms");
    }
}

/// Runs until `is_done`: with the station on the first link for `cut` ms, and two seconds later with the station on the second
/// link, which received the same frames.
fn step_over(
    world: &mut Forwarder<2, plan_memory!(mission: 20)>,
    cut: u64,
    mut is_done: impl FnMut(Instant, &mut Gcs) -> bool,
) {
    let begin = world.now();
    let (silent, back) = (begin + millis(cut), begin + (millis(cut + 2_001)));
    loop {
        let now = world.now();
        assert!(now < begin + secs(20), "cut at {cut} ms");
        if now < silent {
            world.gcs[1].forget();
            if is_done(now, &mut world.gcs[0]) {
                return;
            }
        } else if now < back {
            world.gcs[1].forget();
        } else {
            let heard = std::mem::take(&mut world.gcs[0].received);
            // The next request is sent where the station was last heard, and is retransmitted after 250 ms.
            let is_late = now > back + millis(260);
            let answers = [MissionRequestInt::ID, MissionAck::ID, MissionCount::ID, MissionItemInt::ID];
            let is_answer = |frame: &Received| is_late && answers.contains(&frame.header.id);
            assert!(!heard.iter().any(is_answer), "the station is answered where it was heard last");
            world.gcs[1].received.extend(heard);
            if is_done(now, &mut world.gcs[1]) {
                return;
            }
        }
        world.step();
    }
}
