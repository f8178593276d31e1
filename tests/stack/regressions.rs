//! Defects found in review, each reproduced by the sequence that showed it. Rules M-11, M-22, M-32, M-41, H-5, H-14, S-16.

use crate::support::*;
use mavstack::dialect::*;
use mavstack::frame::{MAX_FRAME_LEN, Version, encode};
use mavstack::prelude::*;
use mavstack::{message, plan_memory};

type Plans60 = Tested<plan_memory!(mission: 60, fence: 8, rally: 8)>;

fn world<const N: usize>() -> World<N, Plans60> {
    World::of(Setup::new())
}

fn count(count: u16) -> MissionCount {
    MissionCount { target_system: 1, target_component: 1, count, ..Default::default() }
}

fn item(seq: u16) -> MissionItemInt {
    MissionItemInt { target_system: 1, target_component: 1, seq, ..plan(60, 0)[usize::from(seq)] }
}

/// M-22, M-41: an upload times out while the link is stalled, and its client starts another one. The end of the old upload is
/// not sent to the new one.
#[test]
fn final_ack_of_a_timed_out_upload_is_not_sent_to_the_next() {
    let mut world = world::<1>();
    world.run_for(secs(1));
    world.gcs[0].send(&count(5));
    world.expect::<MissionRequestInt>(0, millis(50));
    let until = world.now() + secs(7);
    world.uarts[0].stall_writes_until(until);
    world.run_for(millis(6_500));
    world.gcs[0].send(&count(6));
    world.run_for(secs(1));
    let cancelled = world.gcs[0].all::<MissionAck>();
    assert!(cancelled.is_empty(), "{cancelled:?}");
    assert!(world.gcs[0].count_of::<MissionRequestInt>() > 1, "items of the new upload are requested");
}

/// The same over a port that was closed and opened again: the next client starts afresh.
#[test]
fn final_ack_of_a_timed_out_upload_is_not_sent_to_the_next_client() {
    let mut world = world::<1>();
    world.run_for(secs(1));
    world.gcs[0].send(&count(5));
    world.expect::<MissionRequestInt>(0, millis(50));
    for _ in 0..60_000 {
        let now = world.now() + millis(1);
        world.clock.set(now);
        world.pulse.tick();
        world.stack.poll(now, &mut world.vehicle);
    }
    world.stack.restart_link(LinkId(0));
    world.gcs[0].forget();
    world.gcs[0].send(&count(6));
    world.run_for(millis(300));
    assert!(world.gcs[0].all::<MissionAck>().is_empty());
    assert!(world.gcs[0].count_of::<MissionRequestInt>() > 0);
}

/// M-22: within a second of an item the client abandons its plan and uploads another one of the same length, and answers every
/// request, as QGroundControl does. No item of the old plan goes live with the new one.
#[test]
fn restarted_upload_keeps_no_item_of_the_old_plan() {
    let new = plan(4, 9);
    for taken in 1..4 {
        let mut world = world::<1>();
        world.run_for(secs(1));
        world.gcs[0].send(&count(4));
        for seq in 0..taken {
            assert_eq!(world.expect::<MissionRequestInt>(0, millis(100)).seq, seq);
            world.gcs[0].send(&item(seq));
        }
        world.run_for(millis(100));
        world.gcs[0].send(&count(4));
        let mut ack = None;
        world.run_until(secs(5), |world| {
            while let Some((_, request)) = world.gcs[0].take::<MissionRequestInt>() {
                world.gcs[0].send(&MissionItemInt {
                    target_system: 1,
                    target_component: 1,
                    ..new[usize::from(request.seq)]
                });
            }
            ack = world.gcs[0].take::<MissionAck>();
            ack.is_some()
        });
        assert_eq!(ack.map(|(_, ack)| ack.r#type), Some(MavMissionResult::ACCEPTED), "{taken}");
        let variants: Vec<_> = world.stack.mission().items().iter().map(|item| item.params[1]).collect();
        assert_eq!(variants, [9.0; 4], "{taken} items of the old plan");
    }
}

/// M-11, M-45: a client whose downlink failed sends its last item again on another link. The next item is requested there, two
/// seconds after the client was last heard on the first link.
#[test]
fn upload_follows_its_client_to_another_link() {
    let mut world = world::<2>();
    world.run_for(secs(1));
    world.gcs[0].send(&count(5));
    world.expect::<MissionRequestInt>(0, millis(50));
    world.lines[0].set_down(|wire| wire.faults.frame_loss = 1.0);
    world.gcs[0].send(&item(0));
    world.run_for(millis(600));
    world.gcs[1].send(&item(0));
    world.expect_no::<MissionRequestInt>(1, millis(1_500));
    world.gcs[1].send(&item(0));
    let request = world.expect::<MissionRequestInt>(1, secs(2));
    assert_eq!(request.seq, 1);
}

/// M-32, M-36: an item of another plan during an upload is dropped, even of a plan without memory: an answer would end the
/// upload in clients that ignore its type.
#[test]
fn item_of_another_plan_is_not_answered() {
    let mut world = world::<1>();
    world.run_for(secs(1));
    world.gcs[0].send(&count(5));
    world.expect::<MissionRequestInt>(0, millis(50));
    world.gcs[0].send(&MissionItemInt { mission_type: MavMissionType::FENCE, ..item(0) });
    world.run_for(millis(50));
    assert_eq!(world.gcs[0].all::<MissionAck>(), []);
}

/// H-5: a task that sleeps until `next_deadline`, beside a 100 Hz flight loop that stops: no heartbeat is sent later than
/// `max_loop_gap`, although the task slept through the loop's last ticks.
#[test]
fn sleeping_driver_sends_no_heartbeat_after_the_loop_stopped() {
    for stop in [3_010, 3_250, 3_500, 3_750, 3_990] {
        let mut world: World<1> = World::new(Setup::new());
        let (mut now, stop) = (Instant::ZERO, Instant::from_millis(stop));
        let mut last = None;
        let sent = |world: &World<1>| world.stack.link_counters(LinkId(0)).unwrap().tx_frames;
        while now < Instant::from_millis(10_000) {
            let wake = world.stack.next_deadline(now).max(now + Duration::from_micros(100));
            let wake = wake.min(now + secs(20));
            let mut tick = Instant::from_millis(now.as_millis() / 10 * 10 + 10);
            while tick <= wake && tick <= stop {
                world.pulse.tick();
                tick += millis(10);
            }
            now = wake;
            world.clock.set(now);
            let before = sent(&world);
            world.stack.poll(now, &mut world.vehicle);
            world.stack.poll_link(now, LinkId(0), &mut world.uarts[0], &mut world.vehicle).unwrap();
            if sent(&world) > before {
                last = Some(now);
            }
        }
        let last = last.unwrap();
        assert!(last <= stop + millis(500), "{:?} after the loop stopped", last - stop);
        assert!(last >= Instant::from_millis(2_900), "until then one per second");
    }
}

/// A transport whose FIFO is full after the last frame is not ready although nothing is left to send: the next heartbeat still
/// has its deadline.
#[test]
fn full_fifo_does_not_hide_a_deadline() {
    let down = Wire { bytes_per_second: 11_520, tx_fifo: 21, ..Wire::default() };
    let mut world: World<1> = World::new(Setup { lines: [LineConfig { down, ..Default::default() }], ..Setup::new() });
    let mut now = Instant::from_millis(100);
    for _ in 0..20 {
        world.clock.set(now);
        world.pulse.tick();
        world.stack.poll(now, &mut world.vehicle);
        world.stack.poll_link(now, LinkId(0), &mut world.uarts[0], &mut world.vehicle).unwrap();
        let has_rest = !world.stack.transmit(now, LinkId(0), &mut world.vehicle).is_empty();
        let next = world.stack.next_deadline(now);
        assert!(has_rest || next < now + secs(2), "no deadline at {now:?}");
        now = if has_rest { now + millis(1) } else { next.max(now + millis(1)) };
    }
    assert!(world.stack.link_counters(LinkId(0)).unwrap().tx_frames >= 2);
}

/// H-14: a router on the ground that joins two links returns our own frames on the other one. These are echoes, not another
/// vehicle.
#[test]
fn echo_on_another_link_is_not_a_conflict() {
    let mut world = world::<2>();
    world.run_for(secs(1));
    world.upload(0, &plan(50, 0)).unwrap();
    world.run_for(secs(1));
    let heartbeat = world.gcs[0].received.iter().rfind(|frame| frame.header.id == Heartbeat::ID).unwrap().clone();
    let mut frame = [0; MAX_FRAME_LEN];
    let message = Heartbeat::decode(&heartbeat.payload);
    let len = encode(&message, Version::V2, VEHICLE, heartbeat.header.seq, &mut frame).unwrap();
    for _ in 0..5 {
        world.gcs[1].send_raw(&frame[..len]);
    }
    world.run_for(millis(100));
    assert_eq!(world.stack.link_counters(LinkId(1)).unwrap().own_address, 5);
    let is_conflict = |event: &PeerEvent| matches!(event, PeerEvent::AddressConflict(_));
    assert!(!world.vehicle.peer_events().iter().any(is_conflict));
}

/// S-16: a received frame with an unknown id is not counted as lost.
#[test]
fn unknown_ids_are_not_losses() {
    message! {
        struct Private: PRIVATE = 42_001 { a: u8, }
    }
    let mut world = world::<1>();
    world.gcs[0].heartbeat_period = Some(millis(100));
    world.run_for(secs(1));
    for _ in 0..50 {
        world.gcs[0].send(&Private { a: 1 });
        world.run_for(millis(50));
    }
    let peer = world.stack.peers(world.now()).next().expect("a peer");
    assert_eq!(peer.lost, 0);
    assert!(peer.received >= 30);
    assert_eq!(world.stack.link_counters(LinkId(0)).unwrap().unknown, 50);
}

/// S-13, SEC-2: a caller that passes bytes until all are taken terminates, also if a call's budget ends before a frame that
/// fills the buffer.
#[test]
fn all_bytes_are_taken_eventually() {
    for noise in 0..200 {
        let mut world = world::<1>();
        let long = reference::v2(FileTransferProtocol::ID, [1, 0], [9, 9], &[7; 254], 84);
        let mut stream = [&[0xFD; 200][..noise], &long, &[1; 13]].concat().repeat(3);
        stream.extend([0; 300]);
        let mut rest = &stream[..];
        for _ in 0..200 {
            let taken = world.stack.receive(Instant::ZERO, LinkId(0), rest, &mut world.vehicle);
            rest = &rest[taken..];
        }
        assert!(rest.is_empty(), "{} bytes are left after {noise}", rest.len());
    }
}
