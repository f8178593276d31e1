//! A COUNT that is received again after its upload has ended: a delayed duplicate, or the next upload's (M-22).

use super::*;

/// M-22: shortly after an upload, a COUNT equal to its COUNT is answered, once for each duplicate. The timer does not repeat the
/// request, because the COUNT may be a delayed duplicate; the model check shows the harm. This also holds if the sequence
/// numbers do not tell.
#[test]
fn the_request_after_a_possible_duplicate_is_not_repeated() {
    let mut bench = Bench::new();
    assert_eq!(bench.upload(A, MISSION, &plan(1, 2)), Ack(ACCEPTED, id_of(&plan(1, 2))));
    bench.now += Duration::from_millis(900);
    for _ in 0..2 {
        assert_eq!(bench.ask(A, &count(MISSION, 2)), [to_a(Ask(0))]);
        assert_eq!(bench.wait(600), []);
    }
    // From its first item on it is an upload like any other.
    assert_eq!(bench.ask(A, &int(MISSION, 0, &item(2, 0))), [to_a(Ask(1))]);
    assert_eq!(bench.wait(300), [(250, to_a(Ask(1)))]);
    assert_eq!(bench.ask(A, &int(MISSION, 1, &item(2, 1))), [to_a(Ack(ACCEPTED, id_of(&plan(2, 2))))]);
    // A different count, or another client, is not a duplicate.
    assert_eq!(bench.ask(A, &count(MISSION, 3)), [to_a(Ask(0))]);
    assert_eq!(bench.wait(300), [(250, to_a(Ask(0)))]);
}

/// Uploads two items with sequence numbers up to `last`, then waits 900 ms.
fn upload_numbered(bench: &mut Bench, last: u8) {
    let number = |back| last.wrapping_sub(back);
    assert_eq!(ask_numbered(bench, number(2), A, &count(MISSION, 2)), [to_a(Ask(0))]);
    assert_eq!(ask_numbered(bench, number(1), A, &int(MISSION, 0, &item(1, 0))), [to_a(Ask(1))]);
    let end = ask_numbered(bench, last, A, &int(MISSION, 1, &item(1, 1)));
    assert_eq!(end, [to_a(Ack(ACCEPTED, id_of(&plan(1, 2))))]);
    bench.now += Duration::from_millis(900);
}

/// M-22, M-40: a COUNT that was sent after the last item is not a duplicate, even if it is equal to the previous one: a lost
/// request is repeated.
#[test]
fn a_new_count_is_known_by_its_sequence_number() {
    for (last, number) in [(12, 13), (12, 12 + 127), (255, 0), (250, 121)] {
        let mut bench = Bench::new();
        upload_numbered(&mut bench, last);
        assert_eq!(ask_numbered(&mut bench, number, A, &count(MISSION, 2)), [to_a(Ask(0))]);
        assert_eq!(bench.wait(800), [(250, to_a(Ask(0))), (750, to_a(Ask(0)))], "{number} after {last}");
        assert_eq!(bench.ask(A, &int(MISSION, 0, &item(2, 0))), [to_a(Ask(1))]);
        assert_eq!(bench.ask(A, &int(MISSION, 1, &item(2, 1))), [to_a(Ack(ACCEPTED, id_of(&plan(2, 2))))]);
        assert_eq!(seen(&bench).0, plan(2, 2));
    }
    // Also if the last item was refused.
    let mut bench = Bench::new();
    bench.vehicle.bad_item = Some((0, DENIED));
    ask_numbered(&mut bench, 1, A, &count(MISSION, 1));
    assert_eq!(ask_numbered(&mut bench, 2, A, &int(MISSION, 0, &item(1, 0))), [to_a(Ack(DENIED, 0))]);
    assert_eq!(ask_numbered(&mut bench, 3, A, &count(MISSION, 1)), [to_a(Ask(0))]);
    assert_eq!(bench.wait(300), [(250, to_a(Ask(0)))]);
}

/// M-22, M-41: a delayed duplicate is answered once, and its timeout is not reported: the client has its result, or has repeated
/// its COUNT. Sequence numbers of different links are not compared, nor those of a sender that does not increment them.
#[test]
fn the_timeout_after_a_duplicate_is_silent() {
    for (number, from) in [(10, A), (12, A), (12 + 128, A), (13, A_MOVED)] {
        let mut bench = Bench::new();
        upload_numbered(&mut bench, 12);
        assert_eq!(ask_numbered(&mut bench, number, from, &count(MISSION, 2)), [to_a(Ask(0))]);
        assert_eq!(bench.wait(8_000), [], "{number}");
        assert_eq!(bench.texts(), [""; 0]);
        assert_eq!(seen(&bench).0, plan(1, 2));
        assert_eq!(bench.ask(A, &int(MISSION, 0, &item(2, 0))), [to_a(Ack(ERROR, 0))], "no upload is left");
        // A client that still waits starts again.
        assert_eq!(bench.ask(A, &count(MISSION, 2)), [to_a(Ask(0))]);
        assert_eq!(bench.wait(300), [(250, to_a(Ask(0)))]);
    }
}

/// M-22, M-41: a new COUNT after a delayed duplicate starts a normal upload.
#[test]
fn a_new_count_after_a_duplicate_starts_an_upload() {
    let mut bench = Bench::new();
    upload_numbered(&mut bench, 12);
    assert_eq!(ask_numbered(&mut bench, 10, A, &count(MISSION, 2)), [to_a(Ask(0))]);
    assert_eq!(bench.wait(4_900), []);
    assert_eq!(ask_numbered(&mut bench, 13, A, &count(MISSION, 2)), [to_a(Ask(0))]);
    assert!(ask_numbered(&mut bench, 10, A, &count(MISSION, 2)).is_empty(), "another duplicate changes nothing");
    let sent = bench.wait(8_000);
    let (end, last) = *sent.last().unwrap();
    assert_eq!(last, to_a(Ack(CANCELLED, 0)));
    assert!((5_000..=6_000).contains(&end), "after {end} ms");
    assert_eq!(sent[0], (250, to_a(Ask(0))));
    assert_eq!(bench.texts(), ["Mission upload timed out at item 0"]);
}

/// M-23, M-51: an upload that a duplicate may have begun does not lock out other clients before its first item.
#[test]
fn a_duplicate_locks_nobody_out() {
    let begun = || {
        let mut bench = Bench::new();
        upload_numbered(&mut bench, 12);
        assert_eq!(ask_numbered(&mut bench, 10, A, &count(MISSION, 2)), [to_a(Ask(0))]);
        bench
    };
    let mut bench = begun();
    assert_eq!(bench.upload(B, MISSION, &plan(3, 2)), Ack(ACCEPTED, id_of(&plan(3, 2))));
    assert_eq!(seen(&bench).0, plan(3, 2));
    assert_eq!(bench.wait(8_000), []);
    let mut bench = begun();
    assert_eq!(bench.ask(B, &clear(MISSION)), [to_b(Ack(ACCEPTED, 0))]);
    assert_eq!(bench.wait(8_000), []);
    // From its first item on it is an upload like any other.
    let mut bench = begun();
    assert_eq!(bench.ask(A, &int(MISSION, 0, &item(2, 0))), [to_a(Ask(1))]);
    assert_eq!(bench.ask(B, &count(MISSION, 2)), [to_b(Ack(DENIED, 0))]);
    assert_eq!(bench.ask(B, &clear(MISSION)), [to_b(Ack(DENIED, 0))]);
    assert_eq!(bench.wait(8_000).last().unwrap().1, to_a(Ack(CANCELLED, 0)));
    assert_eq!(bench.texts(), ["Mission upload timed out at item 1"]);
}

/// M-31, M-32: after a delayed duplicate, the previous upload is still remembered. Its last item is answered again, and another
/// duplicate is recognised.
#[test]
fn a_duplicate_keeps_the_previous_result() {
    let mut bench = Bench::new();
    upload_numbered(&mut bench, 12);
    assert_eq!(ask_numbered(&mut bench, 10, A, &count(MISSION, 2)), [to_a(Ask(0))]);
    let accepted = [to_a(Ack(ACCEPTED, id_of(&plan(1, 2))))];
    for number in [12, 13] {
        assert_eq!(ask_numbered(&mut bench, number, A, &int(MISSION, 1, &item(1, 1))), accepted);
    }
    assert!(bench.ask(A, &ack(MISSION, CANCELLED)).is_empty());
    assert_eq!(ask_numbered(&mut bench, 10, A, &count(MISSION, 2)), [to_a(Ask(0))]);
    assert_eq!(bench.ask(B, &clear(FENCE)), [(B.address, FENCE, Ack(ACCEPTED, 0))], "the state is kept");
    assert_eq!(bench.ask(A, &int(MISSION, 1, &item(1, 1))), accepted);
    assert_eq!(bench.wait(8_000), []);
    // From item 0 on, the previous upload is forgotten.
    let mut bench = Bench::new();
    upload_numbered(&mut bench, 12);
    assert_eq!(ask_numbered(&mut bench, 10, A, &count(MISSION, 2)), [to_a(Ask(0))]);
    assert_eq!(bench.ask(A, &int(MISSION, 0, &item(2, 0))), [to_a(Ask(1))]);
    assert_eq!(bench.ask(A, &clear(MISSION)), [to_a(Ack(ACCEPTED, 0))]);
    assert_eq!(bench.ask(A, &int(MISSION, 1, &item(1, 1))), [to_a(Ack(ERROR, 0))]);
}

/// M-22, M-42, M-44: an answer that is pending when the delayed duplicate is received is sent.
#[test]
fn a_duplicate_drops_no_pending_answer() {
    let mut bench = Bench::new();
    bench.missions.attach_storage(Durability::Durable);
    ask_numbered(&mut bench, 10, A, &count(MISSION, 2));
    ask_numbered(&mut bench, 11, A, &int(MISSION, 0, &item(1, 0)));
    assert_eq!(ask_numbered(&mut bench, 12, A, &int(MISSION, 1, &item(1, 1))), []);
    bench.saved();
    assert_eq!(ask_numbered(&mut bench, 10, A, &count(MISSION, 2)), [to_a(Ack(ACCEPTED, id_of(&plan(1, 2))))]);
    assert_eq!(bench.wait(8_000), []);
    // The second final answer, which some ground stations need.
    let mut bench = Bench::new();
    bench.second_ack = true;
    ask_numbered(&mut bench, 10, A, &count(MISSION, 1));
    let accepted = to_a(Ack(ACCEPTED, id_of(&plan(1, 1))));
    assert_eq!(ask_numbered(&mut bench, 11, A, &int(MISSION, 0, &item(1, 0))), [accepted]);
    assert_eq!(ask_numbered(&mut bench, 10, A, &count(MISSION, 1)), [to_a(Ask(0))]);
    let later: Vec<_> = bench.wait(8_000).into_iter().map(|(_, sent)| sent).collect();
    assert_eq!(later, [accepted]);
}

/// M-23: after a duplicate, the firmware can load a plan; if the COUNT was new, the upload continues.
#[test]
fn a_duplicate_does_not_prevent_loading_a_plan() {
    let mut bench = Bench::new();
    upload_numbered(&mut bench, 12);
    assert_eq!(ask_numbered(&mut bench, 10, A, &count(MISSION, 2)), [to_a(Ask(0))]);
    let items = plan(5, 2);
    let load = |bench: &mut Bench| {
        bench.with(|missions, cx, _, _| missions.load_plan(cx, PlanType::Mission, items.iter().copied()))
    };
    assert_eq!(load(&mut bench), Ok(()));
    assert_eq!(bench.live(PlanType::Mission).0, items);
    assert_eq!(bench.ask(A, &int(MISSION, 0, &item(2, 0))), [to_a(Ask(1))]);
    assert_eq!(load(&mut bench), Err(DENIED.into()), "now it is an upload");
    assert_eq!(bench.ask(A, &int(MISSION, 1, &item(2, 1))), [to_a(Ack(ACCEPTED, id_of(&plan(2, 2))))]);
}
