//! Storage between the last item and the live plan (M-44, M-52, SEC-11): both policies, failures, timeouts.

use super::*;
use crate::message::Digest;

const INVALID: MavMissionResult = MavMissionResult::INVALID;
const NO_SPACE: MavMissionResult = MavMissionResult::NO_SPACE;

fn durable() -> Bench {
    let mut bench = Bench::new();
    bench.missions.attach_storage(Durability::Durable);
    bench
}

/// Uploads all items; the final answer is pending on storage.
fn upload_to_storage(bench: &mut Bench, from: Peer, mission_type: MavMissionType, items: &[Item]) {
    let mut sent = bench.ask(from, &count(mission_type, items.len()));
    for (seq, item) in items.iter().enumerate() {
        assert_eq!(sent, [(from.address, mission_type, Ask(seq as u16))]);
        sent = bench.ask(from, &int(mission_type, seq, item));
    }
    assert_eq!(sent, []);
}

/// M-44: the plan is written first; it goes live and is accepted when storage holds it.
#[test]
fn accepted_means_stored() {
    let mut bench = durable();
    let (mission, fence) = (plan(1, 5), fence(2, 3));
    upload_to_storage(&mut bench, A, MISSION, &mission);
    assert_eq!(bench.live(PlanType::Mission), (&[][..], 0));
    let (first_job, content) = bench.unsaved().unwrap();
    assert_eq!(content, [(mission.clone(), id_of(&mission)), (Vec::new(), 0), (Vec::new(), 0)]);
    assert_eq!(bench.wait(1_000), [], "nothing is requested meanwhile");
    bench.saved();
    assert_eq!(bench.drain(), [to_a(Ack(ACCEPTED, id_of(&mission)))]);
    assert_eq!(bench.live(PlanType::Mission), (&mission[..], id_of(&mission)));
    assert_eq!(bench.unsaved(), None);
    assert_eq!(bench.vehicle.changes, [(PlanType::Mission, mission.clone(), 0)]);

    // The next plan is written together with the live ones.
    upload_to_storage(&mut bench, B, FENCE, &fence);
    let (job, content) = bench.unsaved().unwrap();
    assert_ne!(job, first_job);
    assert_eq!(content, [(mission.clone(), id_of(&mission)), (fence.clone(), id_of(&fence)), (Vec::new(), 0)]);
    bench.saved();
    assert_eq!(bench.drain(), [(B.address, FENCE, Ack(ACCEPTED, id_of(&fence)))]);
    // M-31: a repeated last item is answered again.
    assert_eq!(bench.ask(B, &int(FENCE, 2, &fence[2])), [(B.address, FENCE, Ack(ACCEPTED, id_of(&fence)))]);
}

/// M-50: one record clears all plans, and one answer confirms it.
#[test]
fn clear_waits_for_storage_too() {
    let mut bench = Bench::new();
    bench.upload(A, MISSION, &plan(1, 4));
    bench.upload(A, FENCE, &fence(2, 2));
    let mission = plan(1, 4);
    bench.missions.attach_storage(Durability::Durable);
    bench.saved();
    for (what, left) in [(FENCE, [true, false]), (MavMissionType::ALL, [false, false])] {
        assert_eq!(bench.ask(B, &clear(what)), []);
        let (_, [new_mission, new_fence, _]) = bench.unsaved().unwrap();
        assert_eq!([!new_mission.0.is_empty(), !new_fence.0.is_empty()], left);
        assert_eq!(bench.live(PlanType::Mission).0, mission, "not yet");
        bench.saved();
        assert_eq!(bench.drain(), [(B.address, what, Ack(ACCEPTED, 0))]);
        assert_eq!(bench.live(PlanType::Fence), (&[][..], 0));
    }
    assert_eq!(bench.live(PlanType::Mission), (&[][..], 0));
    // M-52: already empty, so nothing is written.
    assert_eq!(bench.ask(A, &clear(MISSION)), [to_a(Ack(ACCEPTED, 0))]);
    assert_eq!(bench.ask(A, &count(MISSION, 0)), [to_a(Ack(ACCEPTED, 0))]);
    assert_eq!(bench.unsaved(), None);
}

/// SEC-11: a repeated upload of the live plan causes no write, and is answered at once.
#[test]
fn an_equal_plan_is_not_written() {
    let mut bench = durable();
    let items = plan(1, 3);
    upload_to_storage(&mut bench, A, MISSION, &items);
    bench.saved();
    bench.drain();
    assert_eq!(bench.upload(B, MISSION, &items), Ack(ACCEPTED, id_of(&items)));
    assert_eq!(bench.unsaved(), None);
    assert_eq!(bench.vehicle.changes.len(), 1);
}

/// M-52: a failure is reported by result and text, and the old plan stays live.
#[test]
fn a_plan_that_is_not_stored_is_not_live() {
    let mut bench = durable();
    let items = plan(1, 3);
    upload_to_storage(&mut bench, A, MISSION, &items);
    bench.saved();
    bench.drain();

    upload_to_storage(&mut bench, A, MISSION, &plan(2, 5));
    bench.not_saved();
    assert_eq!(bench.drain(), [to_a(Ack(ERROR, 0))]);
    assert_eq!(bench.texts(), ["Mission not stored: the old one stays"]);
    assert_eq!(bench.live(PlanType::Mission), (&items[..], id_of(&items)));
    assert_eq!((bench.unsaved(), bench.staged()), (None, 0));

    assert_eq!(bench.ask(B, &clear(MISSION)), []);
    bench.not_saved();
    assert_eq!(bench.drain(), [to_b(Ack(ERROR, 0))]);
    assert_eq!(bench.texts(), ["Mission not cleared: storage failed"]);
    assert_eq!(bench.live(PlanType::Mission), (&items[..], id_of(&items)));
    assert_eq!(bench.vehicle.changes.len(), 1);
    assert_eq!(bench.missions.counters().not_saved, 2);
    // The next client is not delayed.
    assert_eq!(bench.ask(B, &count(MISSION, 1)), [to_b(Ask(0))]);
}

/// The staging area is released after a timeout if storage makes no progress.
#[test]
fn a_write_times_out() {
    let mut bench = durable();
    upload_to_storage(&mut bench, A, MISSION, &plan(1, 2));
    let sent = bench.wait(8_000);
    assert_eq!(sent, [(5_000, to_a(Ack(ERROR, 0)))]);
    assert_eq!((bench.unsaved(), bench.live(PlanType::Mission)), (None, (&[][..], 0)));
    assert_eq!(bench.ask(B, &count(MISSION, 2)), [to_b(Ask(0))]);
}

/// M-44: while nothing may be written, an upload is refused before its first item, and a clear at once.
#[test]
fn without_permission_changes_are_denied_at_once() {
    let mut bench = durable();
    upload_to_storage(&mut bench, A, MISSION, &plan(1, 2));
    bench.saved();
    bench.drain();
    bench.vehicle.may_persist = false;
    assert_eq!(bench.ask(A, &count(MISSION, 3)), [to_a(Ack(DENIED, 0))]);
    assert_eq!(bench.ask(A, &clear(MavMissionType::ALL)), [(A.address, MavMissionType::ALL, Ack(DENIED, 0))]);
    assert_eq!(bench.texts(), ["Mission refused: not allowed now"]);
    assert_eq!(bench.live(PlanType::Mission).0, plan(1, 2));
}

/// M-44, M-45: if the vehicle arms during an upload and then permits no writes, the upload is refused at its last item; the
/// client does not wait for storage. A plan that is stored already needs no permission.
#[test]
fn without_permission_a_plan_is_denied_at_its_last_item() {
    let mut bench = durable();
    upload_to_storage(&mut bench, A, MISSION, &plan(1, 2));
    bench.saved();
    bench.drain();
    for (tag, answer) in [(2, Ack(DENIED, 0)), (1, Ack(ACCEPTED, id_of(&plan(1, 2))))] {
        assert_eq!(bench.ask(A, &count(MISSION, 2)), [to_a(Ask(0))]);
        assert_eq!(bench.ask(A, &int(MISSION, 0, &item(tag, 0))), [to_a(Ask(1))]);
        bench.vehicle.may_persist = false;
        assert_eq!(bench.ask(A, &int(MISSION, 1, &item(tag, 1))), [to_a(answer)]);
        assert_eq!((bench.unsaved(), bench.staged()), (None, 0));
        assert_eq!(bench.live(PlanType::Mission).0, plan(1, 2));
        bench.vehicle.may_persist = true;
    }
    assert_eq!(bench.texts(), ["Mission refused: not allowed now"]);
    assert_eq!((bench.missions.counters().refused, bench.missions.counters().accepted), (1, 2));
}

/// M-44, Deferred: a change is live and accepted at once, and written later. A failure is reported once and retried.
#[test]
fn deferred_plans_are_live_first() {
    let mut bench = Bench::new();
    bench.missions.attach_storage(Durability::Deferred);
    bench.vehicle.may_persist = false;
    let items = plan(1, 3);
    assert_eq!(bench.upload(A, MISSION, &items), Ack(ACCEPTED, id_of(&items)));
    let (job, content) = bench.unsaved().unwrap();
    assert_eq!(content[0], (items, id_of(&plan(1, 3))));
    // A change during a write starts another job.
    assert_eq!(bench.upload(A, FENCE, &fence(2, 1)), Ack(ACCEPTED, id_of(&fence(2, 1))));
    assert_ne!(bench.unsaved().unwrap().0, job);

    for _ in 0..3 {
        assert!(bench.missions.pending_write(bench.now).is_some());
        bench.not_saved();
        assert!(bench.missions.pending_write(bench.now).is_none());
        bench.wait(10_000);
    }
    assert_eq!(bench.texts(), ["Plan storage failed"]);
    assert!(bench.unsaved().is_some());
    bench.saved();
    assert_eq!(bench.unsaved(), None);
    assert_eq!(bench.drain(), []);
}

impl Bench {
    /// Loads a plan of the firmware.
    fn load(&mut self, plan: PlanType, items: &[Item]) {
        let items = items.iter().copied();
        let loaded = self.with(|missions, cx, _, _| missions.load_plan(cx, plan, items));
        loaded.expect("a good plan");
    }

    /// Loads a plan from storage.
    fn restore(&mut self, plan: PlanType, expected: (u16, u32), items: &[Item]) -> Result<(), PlanFault> {
        self.with(|missions, cx, _, _| {
            missions.begin_loading(&mut cx.plans);
            let mut digest = Digest::new();
            let mut items = items.iter();
            let staged = items.try_for_each(|item| {
                digest.add(item);
                Missions::stage_item(cx, plan, *item)
            });
            let loaded = staged.and_then(|()| missions.make_loaded(cx, plan, Some(expected), digest));
            missions.end_loading(&mut cx.plans);
            loaded
        })
    }
}

/// A plan loaded by the firmware is written, even if an upload meanwhile is not.
#[test]
fn a_pending_write_stays_pending() {
    let mut bench = durable();
    let fence = fence(2, 2);
    bench.load(PlanType::Fence, &fence);
    upload_to_storage(&mut bench, A, MISSION, &plan(1, 2));
    let (with_mission, _) = bench.unsaved().unwrap();
    bench.not_saved();
    bench.drain();
    let (without, content) = bench.unsaved().unwrap();
    assert_ne!(without, with_mission, "different content");
    assert_eq!(content, [(Vec::new(), 0), (fence.clone(), id_of(&fence)), (Vec::new(), 0)]);
    bench.saved();
    assert_eq!((bench.unsaved(), bench.drain()), (None, Vec::new()));
}

/// M-44: an upload of a plan that is live but not stored is accepted when it is stored; its progress continues.
#[test]
fn accepted_means_stored_even_if_the_plan_is_live() {
    let mut bench = durable();
    let items = plan(1, 3);
    bench.load(PlanType::Mission, &items);
    upload_to_storage(&mut bench, A, MISSION, &items);
    bench.saved();
    assert_eq!(bench.drain(), [to_a(Ack(ACCEPTED, id_of(&items)))]);
    assert_eq!(bench.live(PlanType::Mission), (&items[..], id_of(&items)));
    assert_eq!(bench.vehicle.changes.len(), 1, "it was live already");

    // Nothing is live, but something may be stored; after a clear it must be erased.
    let mut bench = durable();
    bench.missions.set_stored_differs(true);
    assert_eq!(bench.unsaved(), None, "no write without a change");
    assert_eq!(bench.ask(A, &clear(MISSION)), []);
    assert!(bench.unsaved().is_some());
    bench.saved();
    assert_eq!(bench.drain(), [to_a(Ack(ACCEPTED, 0))]);
    assert_eq!(bench.ask(A, &clear(MISSION)), [to_a(Ack(ACCEPTED, 0))]);
}

/// M-52: a clear that is repeated while it is being stored gets one answer; any other clear is refused.
#[test]
fn a_repeated_clear_waits_for_the_first() {
    let mut bench = durable();
    bench.load(PlanType::Mission, &plan(1, 2));
    bench.saved();
    assert_eq!(bench.ask(A, &clear(MISSION)), []);
    assert_eq!(bench.ask(A, &clear(MISSION)), []);
    assert_eq!(bench.ask(A, &clear(FENCE)), [(A.address, FENCE, Ack(DENIED, 0))]);
    assert_eq!(bench.ask(B, &clear(MISSION)), [to_b(Ack(DENIED, 0))]);
    assert_eq!(bench.ask(A_MOVED, &clear(MISSION)), [], "M-45: a duplicate");
    assert_eq!(bench.ask(A_MOVED, &clear(FENCE)), [(A.address, FENCE, Ack(DENIED, 0))]);
    // M-11: the client has moved, and is answered on the link where it was last heard.
    bench.now += Duration::from_secs(2);
    assert_eq!(bench.ask(A_MOVED, &clear(MISSION)), []);
    bench.saved();
    assert_eq!((bench.drain_link(0), bench.drain_link(1)), (Vec::new(), [to_a(Ack(ACCEPTED, 0))].to_vec()));
}

/// M-52: an empty plan may always be cleared, with and without storage.
#[test]
fn an_empty_plan_may_always_be_cleared() {
    let mut bench = Bench::new();
    bench.upload(A, MISSION, &plan(1, 2));
    assert_eq!(bench.unsaved(), None, "there is nowhere to write it");
    assert_eq!(bench.ask(A, &clear(MISSION)), [to_a(Ack(ACCEPTED, 0))]);
    bench.vehicle.may_change = Err(DENIED);
    assert_eq!(bench.ask(A, &clear(MISSION)), [to_a(Ack(ACCEPTED, 0))]);

    let mut bench = durable();
    bench.vehicle.may_persist = false;
    bench.vehicle.may_change = Err(DENIED);
    assert_eq!(bench.ask(A, &clear(MISSION)), [to_a(Ack(ACCEPTED, 0))]);
    bench.load(PlanType::Mission, &plan(1, 2));
    assert_eq!(bench.ask(A, &clear(MISSION)), [to_a(Ack(DENIED, 0))]);
}

/// M-52, C-15: clearing an empty plan writes nothing, so it is accepted even if the token bucket is empty, by CLEAR_ALL and by
/// COUNT 0.
#[test]
fn an_empty_plan_may_be_cleared_without_tokens() {
    let mut bench = durable();
    bench.missions.set_refill(Duration::from_secs(900));
    for _ in 0..64 {
        upload_to_storage(&mut bench, A, MISSION, &plan(1, 1));
        bench.saved();
        assert_eq!(bench.drain(), [to_a(Ack(ACCEPTED, id_of(&plan(1, 1))))]);
        assert_eq!(bench.ask(A, &clear(MISSION)), []);
        bench.saved();
        assert_eq!(bench.drain(), [to_a(Ack(ACCEPTED, 0))]);
    }
    let changes = bench.vehicle.changes.len();
    assert_eq!(bench.ask(A, &count(MISSION, 1)), [to_a(Ack(DENIED, 0))]);
    bench.vehicle.may_change = Err(DENIED);
    assert_eq!(bench.ask(A, &clear(MISSION)), [to_a(Ack(ACCEPTED, 0))]);
    assert_eq!(bench.ask(A, &count(MISSION, 0)), [to_a(Ack(ACCEPTED, 0))]);
    assert_eq!((bench.unsaved(), bench.vehicle.changes.len()), (None, changes));
}

/// D-3: a request is accepted only while the link has a free slot for the result; pending results are not lost.
#[test]
fn a_stalled_link_keeps_the_answer_of_storage() {
    let mut bench = durable();
    assert_eq!(bench.upload(A, MISSION, &[]), Ack(ACCEPTED, 0));
    upload_to_storage(&mut bench, A, MISSION, &plan(1, 2));
    bench.saved();
    // Link 0 does not send. Another client's clear on it could not be answered, so it is not carried out.
    let other = Peer { address: Address::new(253, 1), ..A };
    bench.send(other, &clear(MISSION));
    bench.send(other, &count(MISSION, 2));
    assert_eq!((bench.unsaved(), bench.missions.counters().no_answer_slot), (None, 2));
    assert_eq!(bench.drain_link(0), [to_a(Ack(ACCEPTED, id_of(&plan(1, 2))))]);
    assert_eq!(bench.ask(other, &clear(MISSION)), []);
    bench.saved();
    assert_eq!(bench.drain_link(0), [(other.address, MISSION, Ack(ACCEPTED, 0))]);
}

/// M-31: if configured, the final answer is sent twice, with and without storage, unless another request has begun.
#[test]
fn a_second_final_answer_is_optional() {
    for storage in [false, true] {
        let mut bench = if storage { durable() } else { Bench::new() };
        bench.second_ack = true;
        let items = plan(1, 2);
        let accepted = to_a(Ack(ACCEPTED, id_of(&items)));
        if storage {
            upload_to_storage(&mut bench, A, MISSION, &items);
            bench.saved();
            assert_eq!(bench.drain(), [accepted]);
        } else {
            assert_eq!(bench.upload(A, MISSION, &items), Ack(ACCEPTED, id_of(&items)));
        }
        assert_eq!(bench.wait(2_000), [(400, accepted)]);
        // A refusal is not repeated, nor an answer that another upload has followed.
        bench.vehicle.bad_item = Some((0, ERROR));
        assert_eq!(bench.ask(A, &count(MISSION, 1)), [to_a(Ask(0))]);
        assert_eq!(bench.ask(A, &int(MISSION, 0, &item(2, 0))), [to_a(Ack(ERROR, 0))]);
        assert_eq!(bench.wait(2_000), []);
        bench.vehicle.bad_item = None;
        assert_eq!(bench.upload(A, MISSION, &items), Ack(ACCEPTED, id_of(&items)), "already live");
        assert_eq!(bench.ask(B, &count(MISSION, 1)), [to_b(Ask(0))]);
        assert_eq!(bench.wait(800), [(250, to_b(Ask(0))), (750, to_b(Ask(0)))]);
    }
}

/// A plan restored after a restart is checked again, and is restored completely or not at all.
#[test]
fn plans_come_back_from_storage() {
    let read = |items: &[Item], count: u16, id: u32, bad: Option<(u16, MavMissionResult)>| {
        let mut bench = durable();
        bench.vehicle.bad_item = bad;
        let loaded = bench.restore(PlanType::Mission, (count, id), items);
        assert_eq!((bench.unsaved(), bench.staged()), (None, 0));
        let (live, live_id) = bench.live(PlanType::Mission);
        (live.to_vec(), live_id, bench.vehicle.changes.len(), loaded)
    };
    let items = plan(3, 5);
    let id = id_of(&items);
    assert_eq!(read(&items, 5, id, None), (items.clone(), id, 1, Ok(())));
    assert_eq!(read(&[], 0, 0, None), (Vec::new(), 0, 0, Ok(())));
    let fault = |seq, result| (Vec::new(), 0, 0, Err(PlanFault { seq, result }));
    // The firmware has a smaller capacity than the one that stored the plan.
    assert_eq!(read(&plan(3, 6), 6, id_of(&plan(3, 6)), None), fault(None, NO_SPACE));
    // It cannot fly one of the items.
    assert_eq!(read(&items, 5, id, Some((2, UNSUPPORTED))), fault(Some(2), UNSUPPORTED));
    // The content has changed.
    assert_eq!(read(&items, 5, id ^ 1, None), fault(None, INVALID));
    assert_eq!(read(&items, 4, id, None), fault(None, INVALID));
}

/// M-22, M-44: while a result of storage is pending on the link, the last item is not accepted; it is requested again.
#[test]
fn the_last_item_waits_for_a_slot_for_its_answer() {
    let mut bench = durable();
    upload_to_storage(&mut bench, A, MISSION, &plan(1, 2));
    bench.saved();
    // Link 0 does not send; A's answer is pending there. B begins on link 1, and continues on A's link after two seconds of
    // silence on link 1 (M-45).
    let moved = Peer { link: A.link, ..B };
    bench.send(B, &count(MISSION, 1));
    assert_eq!(bench.drain_link(1), [to_b(Ask(0))]);
    bench.now += Duration::from_secs(2);
    bench.send(moved, &int(MISSION, 0, &item(2, 0)));
    assert_eq!((bench.unsaved(), bench.missions.counters().no_answer_slot), (None, 1));
    assert_eq!(bench.drain_link(0)[0], to_a(Ack(ACCEPTED, id_of(&plan(1, 2)))));
    assert_eq!(bench.ask(moved, &int(MISSION, 0, &item(2, 0))), []);
    bench.saved();
    assert_eq!(bench.drain(), [to_b(Ack(ACCEPTED, id_of(&plan(2, 1))))]);
}

/// M-11, M-44, M-45: the client that waits for storage is answered on the link that it has moved to, unless another answer
/// is pending there.
#[test]
fn a_result_of_storage_follows_its_client_to_a_free_link() {
    for is_taken in [false, true] {
        let mut bench = durable();
        if is_taken {
            upload_to_storage(&mut bench, B, MISSION, &plan(2, 1));
            bench.saved();
        }
        bench.send(A, &count(MISSION, 1));
        assert_eq!(bench.drain_link(0), [to_a(Ask(0))]);
        bench.send(A, &int(MISSION, 0, &item(1, 0)));
        bench.now += Duration::from_secs(2);
        bench.send(A_MOVED, &int(MISSION, 0, &item(1, 0)));
        bench.saved();
        let answer = to_a(Ack(ACCEPTED, id_of(&plan(1, 1))));
        let other = to_b(Ack(ACCEPTED, id_of(&plan(2, 1))));
        let links = [bench.drain_link(0), bench.drain_link(1)];
        assert_eq!(
            links,
            if is_taken { [std::vec![answer], std::vec![other]] } else { [std::vec![], std::vec![answer]] }
        );
    }
}

/// M-31: the answer to a clear, which has no id, is not sent twice.
#[test]
fn a_clear_is_answered_once() {
    let mut bench = durable();
    bench.second_ack = true;
    upload_to_storage(&mut bench, A, MISSION, &plan(1, 2));
    bench.saved();
    bench.drain();
    assert_eq!(bench.ask(A, &clear(MISSION)), []);
    bench.saved();
    assert_eq!(bench.drain(), [to_a(Ack(ACCEPTED, 0))]);
    assert_eq!(bench.wait(2_000), []);
}

/// No plan is loaded during an upload, or while an upload is being stored.
#[test]
fn nothing_is_loaded_during_an_upload() {
    let mut bench = durable();
    upload_to_storage(&mut bench, A, MISSION, &plan(1, 2));
    let none = core::iter::empty();
    let loaded = bench.with(|missions, cx, _, _| missions.load_plan(cx, PlanType::Mission, none));
    assert_eq!(loaded, Err(PlanFault { seq: None, result: DENIED }));
    bench.saved();
    assert_eq!(bench.drain(), [to_a(Ack(ACCEPTED, id_of(&plan(1, 2))))]);

    let mut bench = Bench::new();
    assert_eq!(bench.ask(A, &count(MISSION, 2)), [to_a(Ask(0))]);
    let one = core::iter::once(item(3, 0));
    let loaded = bench.with(|missions, cx, _, _| missions.load_plan(cx, PlanType::Mission, one));
    assert_eq!(loaded, Err(PlanFault { seq: None, result: DENIED }));
    assert_eq!(bench.ask(A, &int(MISSION, 0, &item(1, 0))), [to_a(Ask(1))], "it continues");
}

/// While stored plans are loaded in the staging area, a request that needs it is dropped and counted: its client asks again.
#[test]
fn no_upload_begins_while_plans_are_loaded() {
    let mut bench = durable();
    bench.with(|missions, cx, _, _| missions.begin_loading(&mut cx.plans));
    let dropped = bench.missions.counters().no_answer_slot;
    assert_eq!(bench.ask(A, &count(MISSION, 2)), []);
    assert_eq!(bench.missions.counters().no_answer_slot, dropped + 1);
    let loaded = bench.with(|missions, cx, _, _| missions.load_plan(cx, PlanType::Mission, [].into_iter()));
    assert_eq!(loaded, Err(PlanFault { seq: None, result: DENIED }));
    bench.with(|missions, cx, _, _| missions.end_loading(&mut cx.plans));
    assert_eq!(bench.ask(A, &count(MISSION, 2)), [to_a(Ask(0))]);
}

/// M-45: if the vehicle armed while the change was being written, it refuses the change. The old plan stays live, and is
/// written again.
#[test]
fn a_written_plan_does_not_go_live_once_armed() {
    for is_clear in [false, true] {
        let mut bench = durable();
        bench.load(PlanType::Mission, &plan(1, 2));
        bench.saved();
        let before = seen(&bench);
        if is_clear {
            assert_eq!(bench.ask(A, &clear(MavMissionType::ALL)), []);
        } else {
            upload_to_storage(&mut bench, A, MISSION, &plan(2, 3));
        }
        let (_, [mission, ..]) = bench.unsaved().expect("the change must be written");
        assert_ne!(mission.0, before.0);
        bench.vehicle.may_change = Err(DENIED);
        bench.saved();
        let named = if is_clear { MavMissionType::ALL } else { MISSION };
        assert_eq!(bench.drain(), [(A.address, named, Ack(DENIED, 0))]);
        assert_eq!(bench.texts(), ["Mission refused: not allowed now"]);
        assert_eq!((seen(&bench), bench.vehicle.changes.len()), (before.clone(), 1));
        let (_, [mission, ..]) = bench.unsaved().expect("storage has the wrong plan");
        assert_eq!(mission, before);
        bench.saved();
        assert_eq!((bench.unsaved(), bench.drain()), (None, Vec::new()));
    }
}

/// M-45: the vehicle is also asked before each step of writing, so that a refused plan never becomes a record, not even after a
/// reset. The partial record is abandoned; nothing has to be written again.
#[test]
fn a_write_is_abandoned_once_armed() {
    let refused = |bench: &mut Bench| bench.with_answer(Missions::refuse_commit);
    for is_clear in [false, true] {
        let mut bench = durable();
        bench.load(PlanType::Mission, &plan(1, 2));
        bench.saved();
        let before = seen(&bench);
        let named = if is_clear { MavMissionType::ALL } else { MISSION };
        if is_clear {
            assert_eq!(bench.ask(A, &clear(named)), []);
        } else {
            upload_to_storage(&mut bench, A, MISSION, &plan(2, 3));
        }
        refused(&mut bench);
        assert!(bench.drain().is_empty() && bench.unsaved().is_some(), "it continues");
        bench.vehicle.may_change = Err(DENIED);
        refused(&mut bench);
        assert_eq!(bench.drain(), [(A.address, named, Ack(DENIED, 0))]);
        assert_eq!(bench.texts(), ["Mission refused: not allowed now"]);
        assert_eq!((bench.unsaved(), bench.staged(), seen(&bench)), (None, 0, before));
        assert_eq!(bench.missions.counters().not_saved, 0);
        refused(&mut bench);
        assert!(bench.wait(8_000).is_empty());
    }
}
