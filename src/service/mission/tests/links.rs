//! Which frames belong to an upload: one client on two links, and two clients with the same ids (M-11, M-22, M-45).

use super::*;

/// M-11, M-45: a client that was silent on its link for two seconds may continue on another link, with any message; the
/// answers then follow it.
#[test]
fn the_client_may_move_to_another_link() {
    let silence = |bench: &mut Bench| {
        bench.now += Duration::from_secs(2);
        bench.poll();
        bench.drain();
    };
    let mut bench = Bench::new();
    bench.ask(A, &count(MISSION, 3));
    silence(&mut bench);
    bench.send(A_MOVED, &int(MISSION, 0, &item(1, 0)));
    assert!(bench.drain_link(0).is_empty());
    assert_eq!(bench.drain_link(1), [to_a(Ask(1))]);
    silence(&mut bench);
    bench.send(A, &int(MISSION, 1, &item(1, 1)));
    bench.drain();
    silence(&mut bench);
    bench.send(A_MOVED, &int(MISSION, 2, &item(1, 2)));
    assert!(bench.drain_link(0).is_empty());
    assert_eq!(bench.drain_link(1), [to_a(Ack(ACCEPTED, id_of(&plan(1, 3))))]);

    // The same holds for an unexpected item, a repeated COUNT and a MISSION_ACK.
    let messages: [fn(&mut Bench); 3] = [
        |bench| bench.send(A_MOVED, &int(MISSION, 2, &item(1, 2))),
        |bench| bench.send(A_MOVED, &count(MISSION, 3)),
        |bench| bench.send(A_MOVED, &ack(MISSION, ACCEPTED)),
    ];
    for send in messages {
        let mut bench = Bench::new();
        bench.ask(A, &count(MISSION, 3));
        silence(&mut bench);
        send(&mut bench);
        bench.now += Duration::from_secs(1);
        bench.poll();
        assert!(bench.drain_link(0).is_empty());
        assert_eq!(bench.drain_link(1).len(), 1);
    }
}

/// M-45: two stations have the same ids. Frames of one on its link do not affect the other's upload: not its COUNT, its
/// items, the ACK that ends its download, its cancel, its clear.
#[test]
fn a_station_with_the_same_ids_on_another_link_changes_nothing() {
    let mut bench = Bench::new();
    assert_eq!(bench.upload(B, FENCE, &fence(3, 2)), Ack(ACCEPTED, id_of(&fence(3, 2))));
    let items = plan(1, 4);
    let mut asked = bench.ask(A, &count(MISSION, 4));
    for (seq, item) in items.iter().enumerate() {
        assert_eq!(asked, [to_a(Ask(seq as u16))]);
        // The client is heard; frames that are not about plans count too.
        for _ in 0..3 {
            bench.now += Duration::from_millis(1_500);
            bench.missions.heard(bench.now, A);
        }
        let out_of_place = bench.missions.counters().out_of_place;
        for result in [ACCEPTED, CANCELLED, ERROR, UNSUPPORTED] {
            bench.send(A_MOVED, &ack(MISSION, result));
        }
        bench.send(A_MOVED, &int(MISSION, seq, &self::item(9, seq as u16)));
        assert_eq!(bench.missions.counters().out_of_place, out_of_place + 5);
        assert_eq!(bench.ask(A_MOVED, &count(MISSION, 3)), [to_a(Ack(DENIED, 0))]);
        assert_eq!(bench.ask(A_MOVED, &count(FENCE, 4)), [(A.address, FENCE, Ack(DENIED, 0))]);
        assert_eq!(bench.ask(A_MOVED, &clear(FENCE)), [(A.address, FENCE, Ack(DENIED, 0))]);
        assert_eq!(bench.ask(A_MOVED, &list(FENCE)), [(A.address, FENCE, Out::Count(2, id_of(&fence(3, 2))))]);
        bench.send(A, &int(MISSION, seq, item));
        assert_eq!(bench.drain_link(1), [], "the answers stay on the client's link");
        asked = bench.drain_link(0);
    }
    assert_eq!(asked, [to_a(Ack(ACCEPTED, id_of(&items)))]);
    assert_eq!(seen(&bench).0, items);
    assert_eq!(bench.live(PlanType::Fence).0, fence(3, 2));
}

/// M-45: a client sends everything on two links, one of which is slow: all duplicates are ignored, however late. Also
/// while the plan is written to storage.
#[test]
fn duplicates_on_a_second_link_are_ignored() {
    for is_durable in [false, true] {
        let mut bench = Bench::new();
        if is_durable {
            bench.missions.attach_storage(Durability::Durable);
        }
        assert_eq!(ask_numbered(&mut bench, 7, A, &count(MISSION, 2)), [to_a(Ask(0))]);
        assert_eq!(ask_numbered(&mut bench, 7, A_MOVED, &count(MISSION, 2)), []);
        assert_eq!(ask_numbered(&mut bench, 8, A_MOVED, &count(MISSION, 2)), [], "repeated, duplicate first");
        assert_eq!(ask_numbered(&mut bench, 8, A, &count(MISSION, 2)), []);
        assert_eq!(ask_numbered(&mut bench, 9, A_MOVED, &int(MISSION, 0, &item(1, 0))), [], "the duplicate is first");
        assert_eq!(ask_numbered(&mut bench, 9, A, &int(MISSION, 0, &item(1, 0))), [to_a(Ask(1))]);
        for number in [7, 8] {
            assert_eq!(ask_numbered(&mut bench, number, A_MOVED, &count(MISSION, 2)), []);
        }
        let accepted = [to_a(Ack(ACCEPTED, id_of(&plan(1, 2))))];
        let end = ask_numbered(&mut bench, 10, A, &int(MISSION, 1, &item(1, 1)));
        if is_durable {
            assert_eq!(end, []);
            assert_eq!(ask_numbered(&mut bench, 8, A_MOVED, &count(MISSION, 2)), []);
            assert_eq!(ask_numbered(&mut bench, 10, A_MOVED, &int(MISSION, 1, &item(1, 1))), []);
            // A different COUNT is from another station.
            assert_eq!(ask_numbered(&mut bench, 11, A_MOVED, &count(MISSION, 2)), [to_a(Ack(DENIED, 0))]);
            bench.saved();
            assert_eq!(bench.drain_link(0), accepted);
        } else {
            assert_eq!(end, accepted);
        }
        assert_eq!(seen(&bench).0, plan(1, 2));
    }
}

/// M-22: after an item, a COUNT is ignored if its sequence number shows a delayed duplicate; the received items are kept.
/// Without sequence numbers, no COUNT is known to be a duplicate.
#[test]
fn a_delayed_count_does_not_restart_the_upload() {
    let begin = |numbers: [u8; 3]| {
        let mut bench = Bench::new();
        let [first, second, item_0] = numbers;
        ask_numbered(&mut bench, first, A, &count(MISSION, 3));
        ask_numbered(&mut bench, second, A, &count(MISSION, 3));
        assert_eq!(ask_numbered(&mut bench, item_0, A, &int(MISSION, 0, &item(1, 0))), [to_a(Ask(1))]);
        bench
    };
    for (numbers, number, is_restart) in [
        ([5, 7, 9], 5, false),
        ([5, 7, 9], 7, false),
        // A COUNT that was believed lost.
        ([5, 7, 9], 6, false),
        ([5, 7, 9], 10, true),
        ([5, 7, 9], 4, true),
        ([254, 0, 2], 255, false),
        ([254, 0, 2], 3, true),
        ([0, 0, 0], 0, true),
    ] {
        let mut bench = begin(numbers);
        let expected = if is_restart { std::vec![to_a(Ask(0))] } else { std::vec![] };
        assert_eq!(ask_numbered(&mut bench, number, A, &count(MISSION, 3)), expected, "{numbers:?} {number}");
        assert_eq!(bench.staged(), u16::from(!is_restart));
    }
    // A COUNT for another plan is not a duplicate.
    assert_eq!(ask_numbered(&mut begin([5, 7, 9]), 5, A, &count(MISSION, 2)), [to_a(Ask(0))]);
}

/// M-45, M-63: two stations with the same ids have separate downloads: neither the LIST nor the closing ACK of one makes the
/// other mix two plans. A client that moves to another link is recognised there (M-11).
#[test]
fn stations_with_equal_ids_have_separate_downloads() {
    for is_closed in [false, true] {
        let mut bench = Bench::new();
        bench.upload(B, MISSION, &plan(1, 2));
        bench.ask(A, &list(MISSION));
        bench.upload(B, MISSION, &plan(2, 2));
        assert_eq!(bench.ask(A_MOVED, &list(MISSION)), [to_a(Out::Count(2, id_of(&plan(2, 2))))]);
        assert_eq!(bench.ask(A_MOVED, &request(MISSION, 1)), [to_a(Part(1, 0, item(2, 1)))]);
        if is_closed {
            bench.send(A_MOVED, &ack(MISSION, ACCEPTED));
        }
        assert_eq!(bench.ask(A, &request(MISSION, 1)), [to_a(Ack(CANCELLED, 0))]);
    }
    let mut bench = Bench::new();
    bench.upload(B, MISSION, &plan(1, 2));
    bench.ask(A, &list(MISSION));
    bench.upload(B, MISSION, &plan(2, 2));
    assert_eq!(bench.ask(A_MOVED, &request(MISSION, 1)), [to_a(Ack(CANCELLED, 0))]);
}

/// X-1, M-11: a frame that is proved less than the one with which a change began is not its client's. A forged COUNT, item or clear moved
/// the result of the change to the forger's link; now it is refused, and the result stays.
#[test]
fn a_lesser_proof_does_not_move_a_commit() {
    let messages: [fn(&mut Bench, Peer); 3] = [
        |bench, from| bench.send(from, &count(MISSION, 1)),
        |bench, from| bench.send(from, &int(MISSION, 0, &item(1, 0))),
        |bench, from| bench.send(from, &clear(MISSION)),
    ];
    for (number, forge) in messages.into_iter().enumerate() {
        for (trust, is_moved) in [(Trust::Open, false), (Trust::Signed, true)] {
            let mut bench = Bench::new();
            bench.upload(A, MISSION, &plan(2, 2));
            bench.missions.attach_storage(Durability::Durable);
            bench.saved();
            bench.trust = Trust::Signed;
            if number == 2 {
                assert_eq!(bench.ask(A, &clear(MISSION)), []);
            } else {
                bench.ask(A, &count(MISSION, 1));
                assert_eq!(bench.ask(A, &int(MISSION, 0, &item(1, 0))), []);
            }
            // The client is silent on its link for so long that it may move.
            bench.now += Duration::from_secs(2);
            bench.trust = trust;
            forge(&mut bench, A_MOVED);
            let refusal: &[Sent] = if is_moved { &[] } else { &[to_a(Ack(DENIED, 0))] };
            assert_eq!(bench.drain(), refusal, "{number}");
            bench.saved();
            let result = [to_a(Ack(ACCEPTED, if number == 2 { 0 } else { id_of(&plan(1, 1)) }))];
            let sent = [0, 1].map(|link| bench.drain_link(link));
            assert_eq!(
                sent,
                if is_moved { [Vec::new(), result.to_vec()] } else { [result.to_vec(), Vec::new()] },
                "{number}"
            );
        }
    }
}

/// X-1, M-63: frames that are proved less than the one with which a download began neither end it nor begin it anew: after either the
/// client got the items of two plans.
#[test]
fn a_lesser_proof_does_not_mix_two_plans() {
    let messages: [fn(&mut Bench); 2] =
        [|bench| bench.send(A, &ack(MISSION, ACCEPTED)), |bench| bench.send(A, &list(MISSION))];
    for forge in messages {
        for (trust, is_mixed) in [(Trust::Open, false), (Trust::Signed, true)] {
            let mut bench = Bench::new();
            bench.upload(A, MISSION, &plan(1, 3));
            bench.trust = Trust::Signed;
            bench.ask(A, &list(MISSION));
            assert_eq!(bench.ask(A, &request(MISSION, 0)).len(), 1);
            bench.upload(B, MISSION, &plan(2, 3));
            bench.trust = trust;
            forge(&mut bench);
            bench.drain();
            bench.trust = Trust::Signed;
            let answer = if is_mixed { Part(1, 0, item(2, 1)) } else { Ack(CANCELLED, 0) };
            assert_eq!(bench.ask(A, &request(MISSION, 1)), [to_a(answer)]);
        }
    }
}
