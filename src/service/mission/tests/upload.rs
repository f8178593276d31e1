//! Uploads: cases that the table of states and events does not cover.

use super::*;

/// M-21: 0, 1, the capacity, and one more.
#[test]
fn a_plan_of_any_length_up_to_the_capacity_goes_live() {
    for len in [1, 5, 2, 0] {
        let mut bench = Bench::new();
        let items = plan(len, len);
        assert_eq!(bench.upload(A, MISSION, &items), Ack(ACCEPTED, id_of(&items)));
        assert_eq!(seen(&bench), (items.clone(), id_of(&items)));
        let changes = if len == 0 { Vec::new() } else { std::vec![(PlanType::Mission, items, 0)] };
        assert_eq!(bench.vehicle.changes, changes);
        assert!(bench.wait(7_000).is_empty(), "the engine is at rest");
    }
    for len in [6, 65_534, 65_535] {
        let mut bench = Bench::new();
        assert_eq!(bench.ask(A, &count(MISSION, len)), [to_a(Ack(MavMissionResult::NO_SPACE, 0))]);
        assert!(bench.wait(7_000).is_empty());
    }
}

/// M-39: the mission starts from the item that is marked as current; the mark is not part of the plan.
#[test]
fn the_mission_starts_from_the_marked_item() {
    let mut bench = Bench::new();
    bench.ask(A, &count(MISSION, 3));
    for seq in 0..3 {
        bench.ask(A, &MissionItemInt { current: u8::from(seq > 0), ..int(MISSION, seq, &item(1, seq as u16)) });
    }
    assert_eq!(bench.vehicle.changes, [(PlanType::Mission, plan(1, 3), 1)]);
}

/// M-39: an upload equal to the live plan changes nothing; one that differs in a bit does.
#[test]
fn an_equal_plan_changes_nothing() {
    let mut bench = Bench::new();
    let id = id_of(&plan(1, 3));
    for _ in 0..2 {
        assert_eq!(bench.upload(A, MISSION, &plan(1, 3)), Ack(ACCEPTED, id));
    }
    assert_eq!(bench.vehicle.changes.len(), 1);
    let mut other = plan(1, 3);
    other[2].z = f32::from_bits(other[2].z.to_bits() ^ 1);
    assert_eq!(bench.upload(A, MISSION, &other), Ack(ACCEPTED, id_of(&other)));
    assert_eq!(bench.vehicle.changes.len(), 2);
    assert_eq!(seen(&bench).0, other);
}

/// M-1, M-38: after a refusal at any item, or of the plan as a whole, the live plan is unchanged and a text has the reason.
#[test]
fn a_refused_plan_leaves_the_live_one() {
    for bad in 0..4 {
        let mut bench = Bench::new();
        bench.upload(A, MISSION, &plan(1, 2));
        let before = seen(&bench);
        let code = MavMissionResult::INVALID_PARAM2;
        let text = if bad < 3 {
            bench.vehicle.bad_item = Some((bad, code));
            std::format!("Mission item {bad}: parameter 2 out of range")
        } else {
            bench.vehicle.verdict = Err(code);
            "Mission refused: parameter 2 out of range".into()
        };
        let mut out = bench.ask(B, &count(MISSION, 3));
        for seq in 0..3 {
            if out[..] == [to_b(Ask(seq as u16))] {
                out = bench.ask(B, &int(MISSION, seq, &item(2, seq as u16)));
            }
        }
        assert_eq!(out, [to_b(Ack(code, 0))]);
        assert_eq!(bench.texts(), [text]);
        assert_eq!(seen(&bench), before);
        assert_eq!(bench.vehicle.changes.len(), 1);
        assert!(bench.wait(7_000).is_empty(), "the engine is at rest");
    }
}

/// SEC-14: the stack refuses items that no vehicle can fly, without asking the vehicle.
#[test]
fn a_bad_number_is_refused_before_the_vehicle_is_asked() {
    let mut bench = Bench::new();
    bench.vehicle.bad_item = Some((0, DENIED));
    bench.ask(A, &count(MISSION, 1));
    let bad = Item { x: 900_000_001, ..item(1, 0) };
    let code = MavMissionResult::INVALID_PARAM5_X;
    assert_eq!(bench.ask(A, &int(MISSION, 0, &bad)), [to_a(Ack(code, 0))]);
    assert_eq!(bench.texts(), ["Mission item 0: parameter 5 out of range"]);
}

/// M-27: if the vehicle permits no changes, COUNT is refused, before any item.
#[test]
fn a_forbidden_upload_is_refused_at_once() {
    let mut bench = Bench::new();
    bench.upload(A, MISSION, &plan(1, 2));
    bench.vehicle.may_change = Err(DENIED);
    for message in [count(MISSION, 3), count(MISSION, 0)] {
        assert_eq!(bench.ask(B, &message), [to_b(Ack(DENIED, 0))]);
    }
    for mission_type in [MISSION, MavMissionType::ALL] {
        assert_eq!(bench.ask(B, &clear(mission_type)), [(B.address, mission_type, Ack(DENIED, 0))]);
    }
    assert_eq!(seen(&bench).0, plan(1, 2));
    assert_eq!(bench.texts(), ["Mission refused: not allowed now"], "only once");
}

/// M-45: the vehicle is asked again before the plan goes live. If it armed during the upload, the answer is DENIED with a
/// text, and the old plan stays live.
#[test]
fn the_policy_is_asked_again_before_the_commit() {
    let mut bench = Bench::new();
    bench.upload(A, MISSION, &plan(1, 2));
    assert_eq!(bench.ask(A, &count(MISSION, 3)), [to_a(Ask(0))]);
    for seq in 0..2 {
        assert_eq!(bench.ask(A, &int(MISSION, seq, &item(2, seq as u16))), [to_a(Ask(seq as u16 + 1))]);
    }
    bench.vehicle.may_change = Err(DENIED);
    for _ in 0..2 {
        assert_eq!(bench.ask(A, &int(MISSION, 2, &item(2, 2))), [to_a(Ack(DENIED, 0))], "and again (M-31)");
    }
    assert_eq!(seen(&bench), (plan(1, 2), id_of(&plan(1, 2))));
    assert_eq!(bench.vehicle.changes.len(), 1);
    assert_eq!(bench.texts(), ["Mission refused: not allowed now"]);
    assert_eq!((bench.missions.counters().refused, bench.staged()), (1, 0));
}

/// M-40: a request is repeated after 250 ms. Until the round trip is measured, each repetition doubles the wait, up to a
/// second.
#[test]
fn a_missing_item_is_requested_again() {
    let mut bench = Bench::new();
    bench.ask(A, &count(MISSION, 5));
    let times: Vec<u64> = bench.wait(2_700).iter().map(|(at, _)| *at).collect();
    assert_eq!(times, [250, 750, 1_750]);
    // With a round trip of 400 ms, items are received twice until the engine has adapted its wait.
    let mut asked = Vec::new();
    for seq in 0..5 {
        asked.push(bench.wait(400).len());
        let out = bench.ask(A, &int(MISSION, seq, &item(1, seq as u16)));
        assert_eq!(out.len(), 1, "the next request, or the end");
        if asked[seq] > 0 {
            assert!(bench.ask(A, &int(MISSION, seq, &item(1, seq as u16))).is_empty(), "M-30");
        }
    }
    assert_eq!(*asked.last().unwrap(), 0, "{asked:?}");
}

/// M-41, PX4#27132: a client that vanishes does not lock out others.
#[test]
fn a_stalled_upload_times_out_and_another_may_begin() {
    for items in 0..3 {
        let mut bench = Bench::new();
        bench.ask(A, &count(MISSION, 3));
        for seq in 0..items {
            bench.ask(A, &int(MISSION, seq, &item(1, seq as u16)));
        }
        let sent = bench.wait(8_000);
        let (end, last) = *sent.last().unwrap();
        assert_eq!(last, to_a(Ack(CANCELLED, 0)));
        assert!((5_000..=6_000).contains(&end), "after {end} ms");
        let requests = [Ask(items as u16), AskLegacy(items as u16)].map(to_a);
        assert!(sent.iter().filter(|(_, sent)| requests.contains(sent)).count() >= 5);
        assert_eq!(bench.texts(), [std::format!("Mission upload timed out at item {items}")]);
        assert_eq!(bench.upload(B, MISSION, &plan(2, 2)), Ack(ACCEPTED, id_of(&plan(2, 2))));
    }
}

/// M-41: the timeout runs even if nothing can be sent.
#[test]
fn a_stalled_link_does_not_stop_the_timeout() {
    let mut bench = Bench::new();
    bench.send(A, &count(MISSION, 3));
    for _ in 0..800 {
        bench.now += Duration::from_millis(10);
        bench.poll();
        assert!(bench.drain_link(1).is_empty());
    }
    bench.send(B, &count(MISSION, 2));
    assert_eq!(bench.drain_link(1), [to_b(Ask(0))]);
    assert_eq!(bench.drain_link(0), [to_a(Ack(CANCELLED, 0))], "delayed, not lost");
}

/// M-41: the pending answer of an upload that timed out is dropped if its client starts again or is gone.
#[test]
fn a_late_cancel_does_not_end_the_next_upload() {
    for restart in [false, true] {
        let mut bench = Bench::new();
        bench.send(A, &count(MISSION, 3));
        for _ in 0..800 {
            bench.now += Duration::from_millis(10);
            bench.poll();
        }
        let expected = if restart {
            bench.replies[usize::from(A.link.0)].clear_result();
            Vec::new()
        } else {
            bench.send(A, &count(MISSION, 2));
            std::vec![to_a(Ask(0))]
        };
        assert_eq!(bench.drain(), expected);
    }
}

/// M-31: for ten seconds, a repeated last item means that the final answer was lost.
#[test]
fn a_lost_final_answer_is_repeated() {
    let id = id_of(&plan(1, 3));
    let mut bench = Bench::new();
    bench.upload(A, MISSION, &plan(1, 3));
    let last = int(MISSION, 2, &item(1, 2));
    for _ in 0..3 {
        bench.wait(2_500);
        assert_eq!(bench.ask(A, &last), [to_a(Ack(ACCEPTED, id))]);
    }
    assert_eq!(bench.ask(B, &last), [to_b(Ack(ERROR, 0))], "from another client");
    assert_eq!(bench.ask(A, &int(MISSION, 1, &item(1, 1))), [to_a(Ack(ERROR, 0))], "not the last");
    bench.wait(1_000);
    assert_eq!(bench.ask(A, &int(FENCE, 2, &item(1, 2))), [(A.address, FENCE, Ack(ERROR, 0))], "of another plan");
    bench.wait(1_500);
    assert_eq!(bench.ask(A, &last), [to_a(Ack(ERROR, 0))], "too late");
    assert_eq!(bench.vehicle.changes.len(), 1);

    let mut bench = Bench::new();
    bench.vehicle.bad_item = Some((1, DENIED));
    bench.ask(A, &count(MISSION, 3));
    bench.ask(A, &int(MISSION, 0, &item(1, 0)));
    for _ in 0..2 {
        assert_eq!(bench.ask(A, &int(MISSION, 1, &item(1, 1))), [to_a(Ack(DENIED, 0))], "a refusal too");
    }
}

/// M-31, M-36: items that belong to no upload are answered once a second.
#[test]
fn late_items_are_not_answered_one_by_one() {
    let mut bench = Bench::new();
    bench.ask(A, &count(MISSION, 5));
    bench.ask(A, &ack(MISSION, CANCELLED));
    let mut answers = 0;
    for seq in 0..30 {
        answers += bench.ask(A, &int(MISSION, seq % 5, &item(1, 0))).len();
        bench.wait(100);
    }
    assert_eq!(answers, 3);
}

/// M-22, M-43: a repeated COUNT before and after the first item.
#[test]
fn a_repeated_count_is_answered_once_or_restarts() {
    let mut bench = Bench::new();
    assert_eq!(bench.ask(A, &count(MISSION, 3)), [to_a(Ask(0))]);
    assert!(bench.ask(A, &count(MISSION, 3)).is_empty(), "before the first item, the request was sent already");
    assert_eq!(bench.wait(260), [(250, to_a(Ask(0)))], "and is repeated by the timer");
    bench.wait(1_000);
    assert!(bench.ask(A, &count(MISSION, 3)).is_empty(), "at most once per period of the timer");
    for pause in [0, 500, 1_010] {
        assert_eq!(bench.ask(A, &int(MISSION, 0, &item(1, 0))), [to_a(Ask(1))]);
        assert_eq!(bench.ask(A, &int(MISSION, 1, &item(1, 1))), [to_a(Ask(2))]);
        bench.now += Duration::from_millis(pause);
        assert_eq!(bench.ask(A, &count(MISSION, 3)), [to_a(Ask(0))], "after an item, a restart");
        assert!(
            bench.ask(A, &int(MISSION, 2, &item(1, 2))).is_empty(),
            "the item that was requested before is dropped"
        );
    }
    assert_eq!(bench.ask(A, &count(MISSION, 2)), [to_a(Ask(0))], "or with another count");
    bench.ask(A, &int(MISSION, 0, &item(2, 0)));
    assert_eq!(bench.ask(A, &int(MISSION, 1, &item(2, 1))), [to_a(Ack(ACCEPTED, id_of(&plan(2, 2))))]);
    assert_eq!(seen(&bench).0, plan(2, 2), "nothing of the first attempts is left");
}

/// M-22: the sequence numbers of a restarted client start from 0, so its COUNT may have the number of the first COUNT. Once a
/// request had to be repeated, such a COUNT starts another plan: item 0 is requested, and nothing of the first plan is left.
/// While the client answers at once, it is a delayed duplicate.
#[test]
fn a_restarted_client_restarts_its_upload() {
    for taken in 1..3 {
        let mut bench = Bench::new();
        let run = |bench: &mut Bench, tag: u16, items: u8| {
            assert_eq!(ask_numbered(bench, 0, A, &count(MISSION, 3)), [to_a(Ask(0))], "run {tag}");
            (0..items).fold(Vec::new(), |_, seq| {
                ask_numbered(bench, seq + 1, A, &int(MISSION, seq.into(), &item(tag, seq.into())))
            })
        };
        assert_eq!(run(&mut bench, 1, taken), [to_a(Ask(taken.into()))]);
        assert_eq!(ask_numbered(&mut bench, 0, A, &count(MISSION, 3)), [], "a delayed duplicate");
        assert_eq!(bench.missions.counters().out_of_place, 1);
        bench.wait(1_000);
        assert_eq!(run(&mut bench, 2, 3), [to_a(Ack(ACCEPTED, id_of(&plan(2, 3))))]);
        assert_eq!(seen(&bench).0, plan(2, 3), "nothing of the first run is left");
    }
}

/// M-34, M-36: "go there now" is not part of a plan. The answer is UNSUPPORTED and a text, once a second, with or without an
/// upload of any client.
#[test]
fn guided_items_are_not_stored() {
    for current in [2, 3] {
        let guided = |seq| MissionItemInt { current, ..int(MISSION, seq, &item(9, 0)) };
        let mut bench = Bench::new();
        assert_eq!(bench.ask(A, &guided(0)), [to_a(Ack(UNSUPPORTED, 0))]);
        assert_eq!(bench.texts(), ["Guided items not supported: send DO_REPOSITION"]);
        assert_eq!(bench.ask(A, &guided(0)), []);
        bench.wait(1_010);
        bench.ask(A, &count(MISSION, 2));
        assert_eq!(bench.ask(A, &guided(0)), [to_a(Ack(UNSUPPORTED, 0))]);
        assert_eq!(bench.ask(A, &guided(0)), []);
        assert_eq!(bench.ask(B, &guided(0)), [to_b(Ack(UNSUPPORTED, 0))]);
        assert_eq!(bench.ask(A, &int(MISSION, 0, &item(1, 0))), [to_a(Ask(1))]);
        bench.ask(A, &int(MISSION, 1, &item(1, 1)));
        assert_eq!(seen(&bench).0, plan(1, 2));
    }
}

/// M-37: items in the old float form are accepted, and requested in that form if the client needs it.
#[test]
fn float_items_are_accepted_and_requested() {
    let float = |seq: u16| MissionItem { x: 47.5, y: -8.25, ..item(1, seq).to_float(VEHICLE, MISSION, seq, false) };
    let mut bench = Bench::new();
    bench.ask(A, &count(MISSION, 2));
    assert_eq!(bench.ask(A, &ack(MISSION, UNSUPPORTED)), [to_a(AskLegacy(0))]);
    assert_eq!(bench.ask(A, &float(0)), [to_a(AskLegacy(1))]);
    let expected = [0, 1].map(|seq| Item { x: 475_000_000, y: -82_500_000, ..item(1, seq) });
    assert_eq!(bench.ask(A, &float(1)), [to_a(Ack(ACCEPTED, id_of(&expected)))]);
    assert_eq!(seen(&bench).0, expected);

    bench.ask(A, &count(MISSION, 1));
    let code = MavMissionResult::INVALID_PARAM6_Y;
    assert_eq!(bench.ask(A, &MissionItem { y: f32::INFINITY, ..float(0) }), [to_a(Ack(code, 0))]);
    bench.ask(A, &count(MISSION, 2));
    bench.ask(A, &int(MISSION, 0, &item(1, 0)));
    bench.ask(A, &ack(MISSION, UNSUPPORTED));
    assert!(bench.wait(1_000).is_empty(), "after an item, UNSUPPORTED cancels the upload");
}

/// M-47: until the first item, the forms alternate from the third repetition on; the first item fixes the form of the last
/// request, whatever its own type. Each row: which request is answered, and whether item 1 is requested by MISSION_REQUEST.
#[test]
fn the_first_item_fixes_the_form_that_it_answered() {
    let float = |seq: u16| item(1, seq).to_float(VEHICLE, MISSION, seq, false);
    let forms = [Ask(0), Ask(0), Ask(0), AskLegacy(0), Ask(0), AskLegacy(0)];
    let answer = |bench: &mut Bench, seq: u16, is_float: bool| {
        if is_float { bench.ask(A, &float(seq)) } else { bench.ask(A, &int(MISSION, seq.into(), &item(1, seq))) }
    };
    for (answered, is_old) in [(0, false), (2, false), (3, true), (4, false), (5, true)] {
        for is_float in [false, true] {
            let mut bench = Bench::new();
            let mut sent: Vec<Out> = bench.ask(A, &count(MISSION, 3)).into_iter().map(|(.., out)| out).collect();
            while sent.len() <= answered {
                sent.extend(bench.wait(10).into_iter().map(|(_, (.., out))| out));
            }
            assert_eq!(sent, forms[..=answered]);
            let form = |seq, is_old| to_a(if is_old { AskLegacy(seq) } else { Ask(seq) });
            assert_eq!(answer(&mut bench, 0, is_float), [form(1, is_old)], "{answered} {is_float}");
            // If both forms had requested item 0, it may be a late answer to the other one, so they alternate.
            let alternates = answered >= 3;
            let repeated = bench.wait(2_000);
            assert!(repeated.len() >= 3, "{repeated:?}");
            for ((_, sent), repetition) in repeated.iter().zip(1..) {
                assert_eq!(*sent, form(1, is_old ^ (alternates && repetition % 2 == 1)), "{answered} {repetition}");
            }
            // Item 1 answers the last request. From an item on that a single request had asked for, the form stays.
            let is_old = repeated.last().unwrap().1 == form(1, true);
            assert_eq!(answer(&mut bench, 1, is_float), [form(2, is_old)]);
            assert_eq!(bench.wait(250).len(), 1);
        }
    }
    // Item 1 answers a single MISSION_REQUEST: item 2 is requested by nothing else.
    let mut bench = Bench::new();
    bench.ask(A, &count(MISSION, 3));
    bench.wait(1_750);
    assert_eq!(answer(&mut bench, 0, false), [to_a(AskLegacy(1))]);
    assert_eq!(answer(&mut bench, 1, false), [to_a(AskLegacy(2))]);
    let repeated = bench.wait(4_500);
    assert!(repeated.len() > 3 && repeated.iter().all(|(_, sent)| *sent == to_a(AskLegacy(2))), "{repeated:?}");
}

/// M-35, M-47: after a MISSION_REQUEST, UNSUPPORTED requests the other form and is not a cancel, before and after the
/// first item, and however often it is sent; new requests are not sent as fast as the client refuses.
#[test]
fn unsupported_after_the_old_request_cancels_nothing() {
    let refusal = ack(MISSION, UNSUPPORTED);
    // MAVSDK, with every request lost except the fourth.
    let mut bench = Bench::new();
    bench.ask(A, &count(MISSION, 2));
    assert_eq!(bench.wait(1_750).last().unwrap().1, to_a(AskLegacy(0)));
    assert_eq!(bench.ask(A, &refusal), [to_a(Ask(0))]);
    assert!(bench.ask(A, &refusal).is_empty(), "once");
    assert_eq!(bench.ask(A, &int(MISSION, 0, &item(1, 0))), [to_a(Ask(1))]);
    assert!(bench.ask(A, &refusal).is_empty(), "a delayed refusal");
    assert_eq!(bench.ask(A, &int(MISSION, 1, &item(1, 1))), [to_a(Ack(ACCEPTED, id_of(&plan(1, 2))))]);
    // The old form has ended, also when the refusal arrives after the next request.
    let mut bench = Bench::new();
    bench.ask(A, &count(MISSION, 2));
    assert_eq!(bench.wait(2_750).last().unwrap().1, to_a(Ask(0)));
    assert!(bench.ask(A, &refusal).is_empty());
    let repeated = bench.wait(2_000);
    assert!(!repeated.is_empty() && repeated.iter().all(|(_, sent)| *sent == to_a(Ask(0))), "{repeated:?}");
    // A client that refuses MISSION_REQUEST_INT, over a long round trip: its second refusal is delayed.
    let mut bench = Bench::new();
    bench.ask(A, &count(MISSION, 2));
    assert_eq!(bench.wait(250).len(), 1);
    assert_eq!(bench.ask(A, &refusal), [to_a(AskLegacy(0))]);
    assert!(bench.ask(A, &refusal).is_empty());
    assert_eq!(bench.ask(A, &int(MISSION, 0, &item(1, 0))), [to_a(AskLegacy(1))]);
    // A client that accepts neither form.
    let mut bench = Bench::new();
    let mut requests = bench.ask(A, &count(MISSION, 1)).len();
    let end = loop {
        while !bench.ask(A, &refusal).is_empty() {
            requests += 1;
        }
        match bench.wait(10)[..] {
            [] => {}
            [(_, (.., Ack(result, _)))] => break result,
            _ => requests += 1,
        }
    };
    assert_eq!(end, CANCELLED, "the timer ends it");
    assert!(requests < 16, "{requests}");
}

/// V-7: v1 frames are about the mission, and a link that sends v1 has no other plans.
#[test]
fn v1_knows_only_missions() {
    let mut bench = Bench::new();
    bench.send_as(Version::V1, A, &count(FENCE, 1));
    assert_eq!(bench.drain(), [to_a(Ask(0))]);
    bench.send_as(Version::V1, A, &int(FENCE, 0, &item(1, 0)));
    assert_eq!(bench.drain(), [to_a(Ack(ACCEPTED, id_of(&plan(1, 1))))]);

    let mut bench = Bench::of(false, Version::V1);
    bench.send(A, &count(FENCE, 1));
    // mission_type and opaque_id are extensions, which v1 does not carry.
    assert_eq!(bench.drain(), [to_a(Ack(UNSUPPORTED, 0))]);
    assert_eq!(bench.ask(A, &count(MISSION, 1)), [to_a(Ask(0))]);
    assert_eq!(bench.ask(A, &int(MISSION, 0, &item(1, 0))), [to_a(Ack(ACCEPTED, 0))]);
}

/// M-68
#[test]
fn partial_lists_are_refused() {
    let mut bench = Bench::new();
    let read = MissionRequestPartialList { mission_type: FENCE, ..Default::default() };
    let write = MissionWritePartialList { start_index: 0, end_index: 1, ..Default::default() };
    assert_eq!(bench.ask(A, &read), [(A.address, FENCE, Ack(UNSUPPORTED, 0))]);
    assert_eq!(bench.ask(A, &write), [to_a(Ack(UNSUPPORTED, 0))]);
}

/// M-50 to M-53: clears of one plan, of an empty plan, and of all plans.
#[test]
fn clear_is_repeatable() {
    let mut bench = Bench::new();
    bench.upload(A, MISSION, &plan(1, 3));
    bench.upload(A, FENCE, &fence(2, 1));
    for changes in [3, 3] {
        assert_eq!(bench.ask(A, &clear(MISSION)), [to_a(Ack(ACCEPTED, 0))]);
        assert_eq!(bench.vehicle.changes.len(), changes);
    }
    assert_eq!(bench.live(PlanType::Fence).0, fence(2, 1));
    let all = MavMissionType::ALL;
    assert_eq!(bench.ask(A, &clear(all)), [(A.address, all, Ack(ACCEPTED, 0))]);
    assert_eq!(bench.live(PlanType::Fence), (&[][..], 0));
    assert_eq!(bench.vehicle.changes.last(), Some(&(PlanType::Fence, Vec::new(), 0)));
    // Twice for each upload, once for the clear of a non-empty plan, and once for each existing plan in the clear of all.
    use PlanType::{Fence, Mission};
    assert_eq!(bench.vehicle.asked, [Mission, Mission, Fence, Fence, Mission, Mission, Fence]);
    let bad = MavMissionType(3);
    assert_eq!(bench.ask(A, &clear(bad)), [(A.address, bad, Ack(MavMissionResult::INVALID, 0))]);
    let rally = MavMissionType::RALLY;
    assert_eq!(bench.ask(A, &clear(rally)), [(A.address, rally, Ack(UNSUPPORTED, 0))]);
}

/// M-31, M-50: the final answer is not repeated after the plan was cleared.
#[test]
fn a_cleared_plan_is_not_accepted_again() {
    for by_count in [false, true] {
        let mut bench = Bench::new();
        bench.upload(A, MISSION, &plan(1, 3));
        let cleared = if by_count { bench.ask(A, &count(MISSION, 0)) } else { bench.ask(A, &clear(MISSION)) };
        assert_eq!(cleared, [to_a(Ack(ACCEPTED, 0))]);
        assert_eq!(bench.ask(A, &int(MISSION, 2, &item(1, 2))), [to_a(Ack(ERROR, 0))]);
    }
}

/// D-3: without a free slot for its answer, a request is not carried out. Pending answers are not lost, and other links are not
/// delayed.
#[test]
fn a_stalled_link_keeps_its_answers_and_takes_no_more() {
    let mut bench = Bench::new();
    bench.upload(B, MISSION, &plan(1, 2));
    for _ in 0..3 {
        bench.send(A, &list(MISSION));
        bench.send(A, &request(MISSION, 1));
    }
    for seq in 7..10 {
        bench.send(A, &request(MISSION, seq));
    }
    bench.send(A, &clear(FENCE));
    bench.send(A, &clear(MISSION));
    assert_eq!(bench.missions.counters().no_answer_slot, 1);
    assert_eq!(seen(&bench).0, plan(1, 2), "the last request was not carried out");
    assert_eq!(bench.ask_on_link_1(), [to_b(Out::Count(2, id_of(&plan(1, 2))))]);
    let invalid = Ack(MavMissionResult::INVALID_SEQUENCE, 0);
    let answers = [Out::Count(2, id_of(&plan(1, 2))), Part(1, 0, item(1, 1)), invalid, invalid, invalid].map(to_a);
    let cleared = (A.address, FENCE, Ack(ACCEPTED, 0));
    assert_eq!(bench.drain_link(0), [&[cleared][..], &answers].concat(), "in order, acknowledgements first");
    assert_eq!(bench.ask(A, &clear(MISSION)), [to_a(Ack(ACCEPTED, 0))], "then there are free slots again");
}

impl Bench {
    fn ask_on_link_1(&mut self) -> Vec<Sent> {
        self.send(B, &list(MISSION));
        self.drain_link(1)
    }
}

/// The size of the engine without the plans, and without the part that only a firmware with a log has.
#[test]
fn engine_fits_its_budget() {
    let size = size_of::<Missions>() - 3 * size_of::<crate::log::RefusalLog>();
    assert!(size <= 400, "{size}");
    assert!(size_of::<Replies>() <= 64, "{}", size_of::<Replies>());
}

/// M-38, in both forms: the command is checked before the frame.
#[test]
fn an_unknown_command_is_unsupported_in_any_frame() {
    let unknown = Item { frame: MavFrame::BODY_FRD, command: MavCmd::NAV_ROI, ..item(1, 0) };
    let mut bench = Bench::new();
    bench.ask(A, &count(MISSION, 1));
    assert_eq!(bench.ask(A, &int(MISSION, 0, &unknown)), [to_a(Ack(UNSUPPORTED, 0))]);
    bench.ask(A, &count(MISSION, 1));
    let float = MissionItem { frame: unknown.frame, command: unknown.command, ..Default::default() };
    assert_eq!(bench.ask(A, &float), [to_a(Ack(UNSUPPORTED, 0))]);
}

/// M-83: the vehicle sees the whole new fence at once, never a part of it. M-71: `autocontinue` is stored as received; any value
/// but 0 means yes.
#[test]
fn the_vehicle_sees_whole_plans_only() {
    let mut bench = Bench::new();
    let (old, mut new) = (fence(1, 3), fence(2, 2));
    new[1].autocontinue = 7;
    bench.upload(A, FENCE, &old);
    bench.ask(A, &count(FENCE, 2));
    bench.ask(A, &int(FENCE, 0, &new[0]));
    assert_eq!((bench.live(PlanType::Fence).0, bench.vehicle.changes.len()), (&old[..], 1));
    bench.ask(A, &int(FENCE, 1, &new[1]));
    assert_eq!(bench.vehicle.changes.last(), Some(&(PlanType::Fence, new.clone(), 0)));
    assert_eq!(bench.live(PlanType::Fence), (&new[..], id_of(&new)));
}

/// SEC-9, SEC-10: another client's flood of COUNTs, items, cancels and clears does not affect an upload.
#[test]
fn a_flood_changes_nothing() {
    let mut bench = Bench::new();
    let items = plan(1, 4);
    let mut asked = bench.ask(A, &count(MISSION, 4));
    for (seq, item) in items.iter().enumerate() {
        assert_eq!(asked.last(), Some(&to_a(Ask(seq as u16))));
        for attempt in 0..20 {
            bench.send(B, &count(MISSION, attempt));
            bench.send(B, &int(MISSION, seq, &self::item(9, seq as u16)));
            bench.send(B, &ack(MISSION, CANCELLED));
            bench.send(B, &clear(MavMissionType::ALL));
            bench.drain_link(1);
        }
        asked = bench.ask(A, &int(MISSION, seq, item));
    }
    assert_eq!(asked, [to_a(Ack(ACCEPTED, id_of(&items)))]);
    assert_eq!(bench.live(PlanType::Mission).0, items);
}
