//! Downloads and MISSION_CURRENT.

use super::*;

const C: Peer = Peer { address: Address::new(253, 190), link: LinkId(1) };

fn bench_with(items: &[Item]) -> Bench {
    let mut bench = Bench::new();
    bench.upload(A, MISSION, items);
    bench
}

/// M-60, M-64: any item, in any order, for any number of clients, with or without a request for the count.
#[test]
fn clients_download_any_item_in_any_order() {
    let mut bench = bench_with(&plan(1, 5));
    let id = id_of(&plan(1, 5));
    for client in [A, B] {
        assert_eq!(bench.ask(client, &list(MISSION)), [(client.address, MISSION, Out::Count(5, id))]);
    }
    for (client, seq) in [(A, 0), (B, 4), (C, 2), (B, 0), (A, 0), (C, 1), (A, 3)] {
        let part = Part(seq, u8::from(seq == 0), item(1, seq));
        assert_eq!(bench.ask(client, &request(MISSION, seq)), [(client.address, MISSION, part)]);
    }
    for seq in [5, 65_535] {
        assert_eq!(bench.ask(B, &request(MISSION, seq)), [to_b(Ack(MavMissionResult::INVALID_SEQUENCE, 0))]);
    }
}

/// M-25, M-60: an empty plan is downloaded normally; a plan that is not served or not defined is refused.
#[test]
fn empty_and_missing_plans() {
    let mut bench = Bench::new();
    assert_eq!(bench.ask(A, &list(FENCE)), [(A.address, FENCE, Out::Count(0, 0))]);
    assert_eq!(bench.ask(A, &request(FENCE, 0)), [(A.address, FENCE, Ack(MavMissionResult::INVALID_SEQUENCE, 0))]);
    for (mission_type, code) in [
        (MavMissionType::RALLY, UNSUPPORTED),
        (MavMissionType::ALL, MavMissionResult::INVALID),
        (MavMissionType(77), MavMissionResult::INVALID),
    ] {
        let refusal = [(A.address, mission_type, Ack(code, 0))];
        assert_eq!(bench.ask(A, &list(mission_type)), refusal);
        assert_eq!(bench.ask(A, &request(mission_type, 0)), refusal);
    }
}

/// M-67: the mission item that is being flown is marked as current.
#[test]
fn the_current_item_is_marked() {
    let mut bench = bench_with(&plan(1, 3));
    bench.upload(A, FENCE, &fence(2, 3));
    bench.vehicle.progress.current = 2;
    assert_eq!(bench.ask(A, &request(MISSION, 2)), [to_a(Part(2, 1, item(1, 2)))]);
    assert_eq!(bench.ask(A, &request(MISSION, 0)), [to_a(Part(0, 0, item(1, 0)))]);
    assert_eq!(bench.ask(A, &request(FENCE, 2)), [(A.address, FENCE, Part(2, 0, fence(2, 3)[2]))]);
}

/// M-61: MISSION_REQUEST is answered with integers, or with floats if so configured.
#[test]
fn the_old_request_is_answered_as_configured() {
    let old = MissionRequest { seq: 1, ..Default::default() };
    let fine = Item { x: 475_000_000, y: -82_500_000, ..item(1, 1) };
    for float_form in [false, true] {
        let mut bench = Bench::of(float_form, Version::V2);
        bench.upload(A, MISSION, &[item(1, 0), fine]);
        let expected = if float_form { FloatPart(1, 47.5, -8.25) } else { Part(1, 0, fine) };
        assert_eq!(bench.ask(A, &old), [to_a(expected)]);
        assert_eq!(bench.ask(A, &request(MISSION, 1)), [to_a(Part(1, 0, fine))]);
    }
}

/// M-61, M-75: only positions are scaled. Parameters 5 and 6 of a command without one are plain numbers in every frame, in both
/// forms, and served as they were stored.
#[test]
fn numbers_without_a_position_are_not_scaled() {
    for frame in [0, 2, 3, 5, 6, 10, 11].map(MavFrame) {
        let jump = Item { frame, command: MavCmd::DO_JUMP, params: [0.0; 4], x: 3, y: -70_000, ..item(1, 1) };
        let old = MissionRequest { seq: 1, ..Default::default() };
        for is_float in [false, true] {
            let mut bench = Bench::of(true, Version::V2);
            bench.ask(A, &count(MISSION, 2));
            bench.ask(A, &int(MISSION, 0, &item(1, 0)));
            let ack = to_a(Ack(ACCEPTED, id_of(&[item(1, 0), jump])));
            let last = jump.to_float(VEHICLE, MISSION, 1, false);
            assert_eq!(last.x, 3.0);
            let sent = if is_float { bench.ask(A, &last) } else { bench.ask(A, &int(MISSION, 1, &jump)) };
            assert_eq!(sent, [ack], "{frame:?}");
            assert_eq!(bench.ask(A, &old), [to_a(FloatPart(1, 3.0, -70_000.0))]);
            assert_eq!(bench.ask(A, &request(MISSION, 1)), [to_a(Part(1, 0, jump))]);
        }
        // A number that the client has scaled.
        let (scaled, mut bench) = (Item { y: 120_000_000, ..jump }, Bench::new());
        bench.ask(A, &count(MISSION, 2));
        bench.ask(A, &int(MISSION, 0, &item(1, 0)));
        let sent = bench.ask(A, &int(MISSION, 1, &scaled));
        if frame == MavFrame::MISSION {
            assert_eq!(sent, [to_a(Ack(ACCEPTED, id_of(&[item(1, 0), scaled])))]);
        } else {
            assert_eq!(sent, [to_a(Ack(MavMissionResult::INVALID_PARAM6_Y, 0))]);
            assert_eq!(bench.texts(), ["Mission item 1: parameter 6 out of range"]);
        }
    }
}

/// M-63: a client that began with the old plan gets no item of the new one until it requests the count again.
#[test]
fn a_download_does_not_mix_two_plans() {
    let mut bench = bench_with(&plan(1, 3));
    bench.ask(B, &list(MISSION));
    bench.ask(B, &request(MISSION, 0));
    bench.upload(A, FENCE, &fence(3, 1));
    assert_eq!(bench.ask(B, &request(MISSION, 1)), [to_b(Part(1, 0, item(1, 1)))], "another plan's change");
    bench.upload(A, MISSION, &plan(2, 3));
    for _ in 0..3 {
        bench.wait(5_000);
        assert_eq!(bench.ask(B, &request(MISSION, 1)), [to_b(Ack(CANCELLED, 0))], "however often it tries");
    }
    assert_eq!(bench.ask(C, &request(MISSION, 1)), [(C.address, MISSION, Part(1, 0, item(2, 1)))], "a new client");
    assert_eq!(bench.ask(B, &list(MISSION)), [to_b(Out::Count(3, id_of(&plan(2, 3))))]);
    assert_eq!(bench.ask(B, &request(MISSION, 1)), [to_b(Part(1, 0, item(2, 1)))]);
}

/// M-63: the same for an answer that was pending when the plan changed, and for a plan that was cleared.
#[test]
fn a_pending_item_of_a_replaced_plan_is_not_sent() {
    let mut bench = bench_with(&plan(1, 3));
    bench.ask(B, &list(MISSION));
    bench.send(B, &request(MISSION, 2));
    assert_eq!(bench.missions.counters().accepted, 1);
    bench.send(A, &clear(MISSION));
    assert_eq!(bench.drain_link(1), [to_b(Ack(CANCELLED, 0))]);
    bench.send(C, &list(MISSION));
    bench.drain();
    bench.upload(A, MISSION, &plan(2, 1));
    assert_eq!(bench.ask(C, &request(MISSION, 0)), [(C.address, MISSION, Ack(CANCELLED, 0))]);
}

/// M-63, M-65: a download ends with the client's ACK, or ten seconds after its last request.
#[test]
fn a_finished_download_is_forgotten() {
    for wait in [0, 10_000] {
        let mut bench = bench_with(&plan(1, 2));
        bench.ask(B, &list(MISSION));
        bench.ask(B, &request(MISSION, 1));
        if wait == 0 {
            assert!(bench.ask(B, &ack(MISSION, ACCEPTED)).is_empty());
        }
        bench.wait(wait);
        bench.upload(A, MISSION, &plan(2, 2));
        assert_eq!(bench.ask(B, &request(MISSION, 1)), [to_b(Part(1, 0, item(2, 1)))]);
    }
}

/// M-63: a client's own upload renews its session, though it never acknowledged its download. Others with its ids on another link
/// keep the old one (M-45).
#[test]
fn a_client_downloads_again_after_its_own_upload() {
    let mut bench = bench_with(&plan(1, 3));
    for client in [A, B, A_MOVED] {
        bench.ask(client, &list(MISSION));
        bench.ask(client, &request(MISSION, 2));
    }
    bench.wait(2_010);
    bench.upload(A, MISSION, &plan(2, 3));
    for seq in [0, 2, 1] {
        let part = Part(seq, u8::from(seq == 0), item(2, seq));
        assert_eq!(bench.ask(A, &request(MISSION, seq)), [to_a(part)]);
    }
    assert_eq!(bench.ask(B, &request(MISSION, 1)), [to_b(Ack(CANCELLED, 0))]);
    assert_eq!(bench.ask(A_MOVED, &request(MISSION, 1)), [to_a(Ack(CANCELLED, 0))]);
}

/// M-63: a fifth client evicts only the client that has been silent for longest.
#[test]
fn a_fifth_client_evicts_the_most_silent() {
    let mut bench = bench_with(&plan(1, 1));
    let clients: Vec<Peer> = (10..15).map(|system| Peer { address: Address::new(system, 190), ..B }).collect();
    for client in &clients {
        bench.ask(*client, &list(MISSION));
        bench.wait(100);
    }
    bench.upload(A, MISSION, &plan(2, 1));
    for (i, client) in clients.iter().enumerate() {
        let expected = if i == 0 { Part(0, 1, item(2, 0)) } else { Ack(CANCELLED, 0) };
        assert_eq!(bench.ask(*client, &request(MISSION, 0)), [(client.address, MISSION, expected)]);
    }
}

/// M-90: all fields, without a mission and with one.
#[test]
fn mission_current_reports_progress_and_plans() {
    let mut bench = Bench::new();
    bench.poll();
    let empty = MissionCurrent {
        total: 65_535,
        mission_state: MissionState::NO_MISSION,
        mission_mode: 2,
        ..MissionCurrent::default()
    };
    assert_eq!((bench.next_current(0), bench.next_current(1)), (Some(empty), Some(empty)));
    assert_eq!(bench.next_current(0), None, "once");

    bench.upload(A, MISSION, &plan(1, 3));
    bench.upload(A, FENCE, &fence(2, 2));
    let (mission_id, fence_id) = (id_of(&plan(1, 3)), id_of(&fence(2, 2)));
    let fresh = MissionCurrent {
        seq: 0,
        total: 3,
        mission_state: MissionState::NOT_STARTED,
        mission_mode: 2,
        mission_id,
        fence_id,
        rally_points_id: 0,
    };
    assert_eq!((bench.next_current(0), bench.next_current(1)), (Some(fresh), Some(fresh)), "M-39: at once");

    bench.vehicle.progress = Progress { current: 2, state: MissionState::ACTIVE, in_mission_mode: true };
    bench.poll();
    let flying = MissionCurrent { seq: 2, mission_state: MissionState::ACTIVE, mission_mode: 1, ..fresh };
    assert_eq!(bench.next_current(0), Some(flying));

    bench.ask(A, &clear(MISSION));
    let cleared = MissionCurrent { fence_id, mission_mode: 1, ..empty };
    assert_eq!(bench.next_current(0), Some(cleared), "M-53: at once");
}

/// M-90: once a second when nothing changes, without drift, and without a burst after a pause.
#[test]
fn mission_current_is_sent_once_a_second() {
    let mut bench = Bench::new();
    let mut at = Vec::new();
    // The loop takes 300 ms; a second is not a multiple of that.
    for step in 0..330 {
        bench.now = Instant::from_millis(60_000 + step * 300);
        bench.poll();
        at.extend(bench.next_current(0).map(|_| step * 300 / 1_000));
    }
    assert_eq!(at, (0..99).collect::<Vec<_>>());
    bench.now = Instant::from_millis(200_500);
    bench.poll();
    assert!(bench.next_current(0).is_some());
    bench.poll();
    assert!(bench.next_current(0).is_none());
    assert_eq!(bench.deadline(), Instant::from_millis(201_500));
}
