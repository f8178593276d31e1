//! Faults that were found in review, each by the sequence that showed it. Rules M-11, M-22, M-32, M-41, H-5, H-14, S-16.

use crate::support::*;
use mavstack::dialect::*;
use mavstack::frame::{MAX_FRAME_LEN, Version, encode};
use mavstack::*;

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

/// M-22, M-41: an upload times out while the line is stalled, and its partner begins another one. The new one hears
/// nothing of the old one's end.
#[test]
fn farewell_of_a_dead_upload_does_not_reach_the_next_one() {
    let mut world = world::<1>();
    world.run_for(secs(1));
    world.gcs[0].send(&count(5));
    world.expect::<MissionRequestInt>(0, millis(50));
    let until = world.now().after(secs(7));
    world.uarts[0].stall_writes_until(until);
    world.run_for(millis(6_500));
    world.gcs[0].send(&count(6));
    world.run_for(secs(1));
    let cancelled = world.gcs[0].all::<MissionAck>();
    assert!(cancelled.is_empty(), "{cancelled:?}");
    assert!(world.gcs[0].count_of::<MissionRequestInt>() > 1, "the new one is asked for its items");
}

/// The same over a line that was closed and opened again: the next client is served as if new.
#[test]
fn farewell_of_a_dead_upload_does_not_reach_the_next_client() {
    let mut world = world::<1>();
    world.run_for(secs(1));
    world.gcs[0].send(&count(5));
    world.expect::<MissionRequestInt>(0, millis(50));
    for _ in 0..60_000 {
        let now = world.now().after(millis(1));
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

/// M-22: within a second of an item the client gives its plan up and begins another one of as many, and answers whatever it is
/// asked for, as QGroundControl does. No item of the old one goes live with the new one.
#[test]
fn another_plan_of_the_same_length_is_not_completed_with_the_old_one() {
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
        assert_eq!(variants, [9.0; 4], "{taken} items of the old one");
    }
}

/// M-11, M-45: a partner whose downlink failed repeats its last item on another link. The next item is requested there,
/// two seconds after the partner was last heard on the first link.
#[test]
fn partner_that_repeats_itself_on_another_link_is_followed() {
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

/// M-32, M-36: an item of another plan during an upload is dropped, also one of a plan that is not served: an answer would
/// end the upload in clients that do not look at its type.
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

/// H-5: a task that sleeps until `next_deadline`, beside a flight loop of 100 Hz that stops: no heartbeat later than
/// `max_loop_gap`, though the task slept through the loop's last ticks.
#[test]
fn sleeper_sends_no_heartbeat_for_a_loop_that_stopped() {
    for stop in [3_010, 3_250, 3_500, 3_750, 3_990] {
        let mut world: World<1> = World::new(Setup::new());
        let (mut now, stop) = (Instant::ZERO, Instant::from_millis(stop));
        let mut last = None;
        let sent = |world: &World<1>| world.stack.link_counters(LinkId(0)).unwrap().tx_frames;
        while now < Instant::from_millis(10_000) {
            let wake = world.stack.next_deadline(now).max(now.after(Duration::from_micros(100)));
            let wake = wake.min(now.after(secs(20)));
            let mut tick = Instant::from_millis(now.as_millis() / 10 * 10 + 10);
            while tick <= wake && tick <= stop {
                world.pulse.tick();
                tick = tick.after(millis(10));
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
        assert!(last <= stop.after(millis(500)), "{:?} after the loop stopped", last.since(stop));
        assert!(last >= Instant::from_millis(2_900), "and until then one a second");
    }
}

/// A transport whose FIFO the last frame filled says "not ready" when nothing is left to be sent: the next heartbeat has
/// its deadline all the same.
#[test]
fn full_fifo_hides_no_deadline() {
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
        assert!(has_rest || next < now.after(secs(2)), "asleep for good at {now:?}");
        now = if has_rest { now.after(millis(1)) } else { next.max(now.after(millis(1))) };
    }
    assert!(world.stack.link_counters(LinkId(0)).unwrap().tx_frames >= 2);
}

/// H-14: a router on the ground that joins two links sends us our own frames back on the other one. That is an echo and no
/// second vehicle.
#[test]
fn echo_over_another_link_is_no_conflict() {
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

/// S-16: a frame whose id we do not know came, and so is no lost one.
#[test]
fn unknown_ids_are_no_losses() {
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
    let peer = world.stack.peers()[0];
    assert_eq!(peer.lost, 0);
    assert!(peer.received >= 30);
    assert_eq!(world.stack.link_counters(LinkId(0)).unwrap().unknown, 50);
}

/// S-13, SEC-2: whoever hands bytes over until all are taken comes to an end, also where a call's budget ends before a frame that
/// fills the buffer.
#[test]
fn bytes_are_taken_in_the_end_whatever_the_budget() {
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
        assert!(rest.is_empty(), "{} bytes are left behind {noise}", rest.len());
    }
}
