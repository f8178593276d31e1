//! Boundary cases: timers due exactly now, links with nothing pending, counters, limits of values.

use super::*;
use crate::dialect::MissionItemReached;

impl Bench {
    /// Whether anything is pending on a link.
    fn is_pending(&mut self, link: usize) -> bool {
        let turns = [Turn::MissionAck, Turn::MissionTransfer, Turn::MissionProgress];
        self.with_link(link, |missions, cx, port, replies| {
            let view = cx.view();
            turns.iter().any(|&turn| Service::<Board>::pending(missions, &view, port, replies, turn).is_some())
        })
    }

    /// Returns the next MISSION_ITEM_REACHED of a link, if that is the next message.
    fn next_reached(&mut self, link: usize) -> Option<u16> {
        let sent = self.offer(link, Turn::MissionProgress);
        let tx = &mut self.ports[link].outbox;
        sent.then(|| with_frame(&take(tx), |frame| frame.decode::<MissionItemReached>().map(|message| message.seq)))?
    }

    fn drain_progress(&mut self) {
        while (0..2).any(|link| self.next_current(link).is_some()) {}
    }
}

/// M-90: MISSION_CURRENT is sent once a second, even if a poll is a whole second late.
#[test]
fn a_late_poll_sends_the_current_item_once() {
    let mut bench = Bench::new();
    bench.poll();
    bench.drain_progress();
    bench.now += Duration::from_secs(2);
    bench.poll();
    assert!(bench.next_current(0).is_some() && bench.next_current(1).is_some());
    bench.poll();
    assert!(!bench.is_pending(0) && !bench.is_pending(1), "sent a moment ago");
    assert_eq!(bench.deadline(), bench.now + Duration::from_secs(1));
}

/// M-30: the deadline is when a request for an item must be repeated, not earlier.
#[test]
fn a_request_is_repeated_at_the_deadline() {
    let mut bench = Bench::new();
    bench.poll();
    bench.drain_progress();
    assert_eq!(bench.ask(A, &count(MISSION, 2)), [to_a(Ask(0))]);
    let due = bench.deadline();
    assert!(due > bench.now && due < bench.now + Duration::from_secs(2));
    bench.now = Instant::from_micros(due.as_micros() - 1);
    bench.poll();
    assert_eq!(bench.drain_link(0), []);
    bench.now = due;
    bench.poll();
    assert_eq!(bench.drain_link(0), [to_a(Ask(0))]);
}

/// A message is pending only on the links that it is for.
#[test]
fn each_link_has_its_own_pending_messages() {
    let mut bench = Bench::new();
    bench.poll();
    bench.drain_progress();
    let pending = |bench: &mut Bench| [bench.is_pending(0), bench.is_pending(1)];
    assert_eq!(pending(&mut bench), [false, false]);
    // A request for an item.
    bench.send(A, &count(MISSION, 2));
    assert_eq!(pending(&mut bench), [true, false]);
    bench.drain();
    assert_eq!(pending(&mut bench), [false, false]);
    // An answer.
    bench.send(B, &list(FENCE));
    assert_eq!(pending(&mut bench), [false, true]);
    bench.drain();
    assert_eq!(pending(&mut bench), [false, false]);
    // MISSION_ITEM_REACHED.
    bench.missions.reached(bench.now, 3, LinkMask::of(LinkId(1)), 0);
    assert_eq!(pending(&mut bench), [false, true]);
}

/// M-91: a message that is pending on a stalled link is not repeated on the other one, and sets no deadline.
#[test]
fn a_stalled_link_repeats_nothing() {
    let mut bench = Bench::new();
    bench.poll();
    bench.drain_progress();
    bench.missions.reached(bench.now, 3, both_links(), 0);
    assert_eq!(bench.next_reached(0), Some(3));
    bench.now += Duration::from_secs(2);
    bench.poll();
    assert!(bench.deadline() > bench.now);
    assert_eq!(bench.next_reached(0), None);
    assert_eq!(bench.next_reached(1), Some(3));
}

/// M-91: a repetition is due a second after the first, whatever MISSION_CURRENT does.
#[test]
fn a_reached_item_is_repeated_at_the_deadline() {
    let mut bench = Bench::new();
    bench.poll();
    bench.now += Duration::from_millis(300);
    bench.missions.reached(bench.now, 3, both_links(), 1);
    let again = bench.now + Duration::from_secs(1);
    bench.now = bench.deadline();
    assert!(bench.now < again, "MISSION_CURRENT");
    bench.poll();
    assert_eq!(bench.deadline(), again);
}

/// M-44: after a record is written, access to storage pauses for a moment.
#[test]
fn storage_pauses_after_a_record() {
    let mut bench = Bench::new();
    bench.missions.attach_storage(Durability::Deferred);
    bench.upload(A, MISSION, &plan(1, 2));
    assert!(bench.missions.pending_write(bench.now).is_some());
    bench.saved();
    bench.upload(A, MISSION, &plan(2, 2));
    assert!(bench.missions.pending_write(bench.now + Duration::from_micros(199_999)).is_none());
    assert!(bench.missions.pending_write(bench.now + Duration::from_millis(200)).is_some());
}

/// M-22, M-44: frames that do not fit the state are counted.
#[test]
fn what_is_out_of_place_is_counted() {
    let mut bench = Bench::new();
    bench.missions.attach_storage(Durability::Durable);
    bench.ask(A, &count(MISSION, 1));
    bench.ask(A, &int(MISSION, 0, &item(1, 0)));
    assert_eq!(bench.missions.counters().out_of_place, 0);
    // The client repeats its COUNT while the plan is being stored.
    assert_eq!(bench.ask(A, &count(MISSION, 1)), []);
    assert_eq!(bench.missions.counters().out_of_place, 1);
}

/// M-70: the limit of an altitude is 1000 km.
#[test]
fn altitudes_have_a_limit() {
    let check = |z| rules::NAV_WAYPOINT.check(&Item { z, ..item(0, 0) });
    for z in [-1e6, 0.0, 1e6] {
        assert_eq!(check(z), Ok(()), "{z}");
    }
    for z in [-1_000_001.0, 1_000_001.0] {
        assert_eq!(check(z), Err(MavMissionResult::INVALID_PARAM7), "{z}");
    }
}

/// M-38: each result has its text.
#[test]
fn a_refusal_has_a_reason() {
    let mut bench = Bench::new();
    for (result, reason) in [
        (MavMissionResult::UNSUPPORTED_FRAME, "frame not supported"),
        (MavMissionResult::UNSUPPORTED, "command not supported"),
        (MavMissionResult::NO_SPACE, "too many items"),
        (MavMissionResult::INVALID, "not consistent"),
        (DENIED, "not allowed now"),
        (MavMissionResult::INVALID_PARAM1, "parameter 1 out of range"),
        (MavMissionResult::INVALID_PARAM7, "parameter 7 out of range"),
        (ERROR, "refused by the vehicle"),
    ] {
        let fault = PlanFault { seq: Some(2), result };
        bench.with(|_, cx, _, _| Missions::report_refused(cx, PlanType::Rally, fault));
        assert_eq!(bench.texts().pop(), Some(std::format!("Rally item 2: {reason}")));
    }
}

/// SEC-2: whatever a client repeats and is refused, it is logged at most once a second.
#[test]
fn every_refusal_is_logged_at_most_once_a_second() {
    let mut bench = Bench::new();
    let mut refused = 0;
    let mut expect = |bench: &Bench, what: &str| {
        refused += 1;
        assert_eq!(bench.missions.refused.total(), refused, "{what}");
    };
    bench.ask(A, &count(MISSION, 6));
    expect(&bench, "no space");
    bench.ask(A, &MissionSetCurrent { seq: 9, ..Default::default() });
    expect(&bench, "no such item");
    bench.vehicle.may_change = Err(DENIED);
    bench.ask(A, &count(MISSION, 2));
    expect(&bench, "refused by the vehicle");
    bench.vehicle.may_change = Ok(());
    bench.vehicle.bad_item = Some((0, MavMissionResult::INVALID));
    bench.ask(A, &count(MISSION, 2));
    bench.ask(A, &int(MISSION, 0, &item(1, 0)));
    expect(&bench, "an item is refused");
    bench.vehicle.bad_item = None;
    assert!(matches!(bench.upload(A, MISSION, &plan(1, 2)), Ack(ACCEPTED, _)));
    bench.ask(A, &int(MISSION, 1, &item(1, 1)));
    assert_eq!(bench.missions.repeated.total(), 1, "the final answer is sent again");
    // The plan changes during a download.
    bench.ask(B, &list(MISSION));
    bench.upload(A, MISSION, &plan(2, 2));
    assert_eq!(bench.ask(B, &request(MISSION, 0)), [to_b(Ack(CANCELLED, 0))]);
    assert_eq!(bench.missions.sessions.refused.total(), 1, "a stale download");
    assert_eq!(bench.missions.refused.total(), refused, "an accepted upload");
}
