//! What is due exactly now, what nobody is owed, what is counted: where a comparison has its edge.

use super::*;
use crate::dialect::MissionItemReached;

impl Bench {
    /// Whether something waits to be sent on a link.
    fn is_pending(&mut self, link: usize) -> bool {
        let (missions, _) = self.memory.parts(&mut self.missions).expect("there are plans");
        missions.is_pending(&self.replies[link], &self.boxes[link])
    }

    /// The MISSION_ITEM_REACHED that a link sends next, if that is what it sends.
    fn next_reached(&mut self, link: usize) -> Option<u16> {
        let tx = &mut self.boxes[link];
        let (missions, plans) = self.memory.parts(&mut self.missions).expect("there are plans");
        let sent = missions.next_progress(&plans, &self.vehicle.progress, tx);
        sent.then(|| with_frame(&take(tx), |frame| frame.decode::<MissionItemReached>().map(|message| message.seq)))?
    }

    fn drain_progress(&mut self) {
        while (0..2).any(|link| self.next_current(link).is_some()) {}
    }
}

/// M-90: everyone is told once a second, also when the poll that was to do so comes a whole second late.
#[test]
fn a_late_poll_tells_the_current_item_once() {
    let mut bench = Bench::new();
    bench.poll();
    bench.drain_progress();
    bench.now = bench.now.after(Duration::from_secs(2));
    bench.poll();
    assert!(bench.next_current(0).is_some() && bench.next_current(1).is_some());
    bench.poll();
    assert!(!bench.is_pending(0) && !bench.is_pending(1), "told a moment ago");
    assert_eq!(bench.missions.deadline(), bench.now.after(Duration::from_secs(1)));
}

/// M-30: the stack is to be polled again when a request for an item is to be repeated, and not before.
#[test]
fn a_request_is_repeated_when_the_engine_asks_for_the_poll() {
    let mut bench = Bench::new();
    bench.poll();
    bench.drain_progress();
    assert_eq!(bench.ask(A, &count(MISSION, 2)), [to_a(Ask(0))]);
    let due = bench.missions.deadline();
    assert!(due > bench.now && due < bench.now.after(Duration::from_secs(2)));
    bench.now = Instant::from_micros(due.as_micros() - 1);
    bench.poll();
    assert_eq!(bench.drain_link(0), []);
    bench.now = due;
    bench.poll();
    assert_eq!(bench.drain_link(0), [to_a(Ask(0))]);
}

/// What is owed on one link is no reason to send on the other, and nothing is pending that nobody is owed.
#[test]
fn each_link_knows_what_it_owes() {
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

/// M-91: what a stalled link is still owed is not said again on the other, and is nothing to be polled for.
#[test]
fn a_stalled_link_repeats_nothing() {
    let mut bench = Bench::new();
    bench.poll();
    bench.drain_progress();
    bench.missions.reached(bench.now, 3, both_links(), 0);
    assert_eq!(bench.next_reached(0), Some(3));
    bench.now = bench.now.after(Duration::from_secs(2));
    bench.poll();
    assert!(bench.missions.deadline() > bench.now);
    assert_eq!(bench.next_reached(0), None);
    assert_eq!(bench.next_reached(1), Some(3));
}

/// M-91: a repetition is due a second after the first, whatever MISSION_CURRENT does.
#[test]
fn an_item_is_said_again_when_the_engine_asks_for_the_poll() {
    let mut bench = Bench::new();
    bench.poll();
    bench.now = bench.now.after(Duration::from_millis(300));
    bench.missions.reached(bench.now, 3, both_links(), 1);
    let again = bench.now.after(Duration::from_secs(1));
    bench.now = bench.missions.deadline();
    assert!(bench.now < again, "MISSION_CURRENT");
    bench.poll();
    assert_eq!(bench.missions.deadline(), again);
}

/// M-44: after a record was written its storage has a moment of rest.
#[test]
fn storage_rests_after_a_record() {
    let mut bench = Bench::new();
    bench.missions.attach_storage(Durability::Deferred);
    bench.upload(A, MISSION, &plan(1, 2));
    assert!(!bench.missions.storage_rests(bench.now));
    bench.saved();
    assert!(bench.missions.storage_rests(bench.now));
    assert!(!bench.missions.storage_rests(bench.now.after(Duration::from_millis(200))));
}

/// Section 8.3: what has no place in a transfer is counted.
#[test]
fn what_is_out_of_place_is_counted() {
    let mut bench = Bench::new();
    bench.missions.attach_storage(Durability::Durable);
    bench.ask(A, &count(MISSION, 1));
    bench.ask(A, &int(MISSION, 0, &item(1, 0)));
    assert_eq!(bench.missions.counters().out_of_place, 0);
    // Its partner asks again while the plan is being stored.
    assert_eq!(bench.ask(A, &count(MISSION, 1)), []);
    assert_eq!(bench.missions.counters().out_of_place, 1);
}

/// M-70: an altitude of a thousand kilometres is the last that is one.
#[test]
fn altitudes_have_a_limit() {
    let check = |z| command_rules::NAV_WAYPOINT.check(&Item { z, ..item(0, 0) });
    for z in [-1e6, 0.0, 1e6] {
        assert_eq!(check(z), Ok(()), "{z}");
    }
    for z in [-1_000_001.0, 1_000_001.0] {
        assert_eq!(check(z), Err(MavMissionResult::INVALID_PARAM7), "{z}");
    }
}

/// M-38: each reason has its words.
#[test]
fn a_refusal_says_why() {
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
        bench.with(|missions, cx, _, _| missions.tell_refused(cx, PlanType::Rally, fault));
        assert_eq!(bench.texts().pop(), Some(std::format!("Rally item 2: {reason}")));
    }
}
