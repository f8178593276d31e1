//! Random events in random order: a live plan is always one that was uploaded completely.

use super::*;
use proptest::prelude::*;

#[derive(Clone, Debug)]
enum Event {
    /// Begins an upload of this many items.
    Count(usize),
    /// The expected item, or another one.
    Item(Option<u16>),
    FloatItem(Option<u16>),
    Ack(u8),
    List,
    Request(u16),
    Clear(u8),
    /// The pending answers of a link are sent.
    Drain,
    /// This many ms pass.
    Wait(u64),
}

fn event() -> impl Strategy<Value = Event> {
    prop_oneof![
        3 => (0usize..7).prop_map(Event::Count),
        12 => Just(Event::Item(None)),
        2 => (0u16..6).prop_map(|seq| Event::Item(Some(seq))),
        3 => Just(Event::FloatItem(None)),
        1 => (0u8..16).prop_map(Event::Ack),
        1 => Just(Event::List),
        1 => (0u16..6).prop_map(Event::Request),
        1 => prop_oneof![0u8..4, Just(255)].prop_map(Event::Clear),
        8 => Just(Event::Drain),
        1 => (0u64..3_000).prop_map(Event::Wait),
    ]
}

/// An upload, as its client sees it.
#[derive(Clone, Copy, Default)]
struct Client {
    /// Unique for each plan of each client.
    tag: u16,
    count: u16,
    /// The last item that the vehicle requested.
    next: u16,
}

/// Asserts that a live plan is complete, in order, and from one upload.
fn assert_whole(bench: &Bench, plan: PlanType) {
    let (items, id) = bench.live(plan);
    assert_eq!(id, id_of(items));
    if let Some(first) = items.first() {
        let [tag, len, ..] = first.params;
        assert_eq!(len, items.len() as f32, "complete");
        for (seq, item) in items.iter().enumerate() {
            assert_eq!((item.params[0], item.params[2]), (tag, seq as f32), "from one upload, in order");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    /// M-1: live plans are complete, and change only at a last item or a clear.
    #[test]
    fn live_plans_are_whole(events in proptest::collection::vec((any::<bool>(), any::<bool>(), any::<bool>(), event()), 1..250)) {
        let mut bench = Bench::new();
        let mut clients = [[Client::default(); 2]; 2];
        let mut tags = 0;
        for (is_b, is_fence, is_moved, event) in events {
            let mut from = if is_b { B } else { A };
            if is_moved {
                from.link = LinkId(1 - from.link.0);
            }
            let mission_type = if is_fence { FENCE } else { MISSION };
            let client = &mut clients[usize::from(is_b)][usize::from(is_fence)];
            let before = [PlanType::Mission, PlanType::Fence].map(|plan| bench.live(plan).1);
            let changes = bench.vehicle.changes.len();
            let mut may_change = false;
            let mut make = |seq: Option<u16>| {
                let seq = seq.unwrap_or(client.next);
                may_change = seq.wrapping_add(1) == client.count;
                let item = item(client.tag, seq);
                (seq, Item { params: [client.tag.into(), client.count.into(), seq.into(), 0.0], ..item })
            };
            match event {
                Event::Count(len) => {
                    tags += 1;
                    // As a real client would, sends a COUNT that may look like a duplicate for the same plan.
                    let tag = if usize::from(client.count) == len { client.tag } else { tags };
                    may_change = len == 0;
                    let dropped = bench.missions.counters().no_answer_slot;
                    let is_on_other_link = bench.missions.is_on_other_link(bench.now, from);
                    bench.send(from, &count(mission_type, len));
                    // A dropped frame counts as lost: no client continues with the new plan before it gets a request. Nor
                    // does a client that was denied on another link than its transfer's (M-45).
                    if dropped == bench.missions.counters().no_answer_slot && !is_on_other_link {
                        *client = Client { tag, count: len as u16, next: 0 };
                    }
                }
                Event::Item(seq) => {
                    let (seq, item) = make(seq);
                    bench.send(from, &int(mission_type, seq.into(), &item));
                }
                Event::FloatItem(seq) => {
                    let (seq, item) = make(seq);
                    bench.send(from, &item.to_float(VEHICLE, mission_type, seq, false));
                }
                Event::Ack(result) => bench.send(from, &ack(mission_type, MavMissionResult(result))),
                Event::List => bench.send(from, &list(mission_type)),
                Event::Request(seq) => bench.send(from, &request(mission_type, seq)),
                Event::Clear(mission_type) => {
                    may_change = true;
                    bench.send(from, &clear(MavMissionType(mission_type)));
                }
                Event::Drain => {
                    for (to, mission_type, out) in bench.drain_link(usize::from(is_b)) {
                        let client = &mut clients[usize::from(to == B.address)][usize::from(mission_type == FENCE)];
                        if let Ask(seq) | AskLegacy(seq) = out {
                            client.next = seq;
                        }
                    }
                }
                Event::Wait(millis) => {
                    bench.now += Duration::from_millis(millis);
                    bench.poll();
                }
            }
            assert_whole(&bench, PlanType::Mission);
            assert_whole(&bench, PlanType::Fence);
            let after = [PlanType::Mission, PlanType::Fence].map(|plan| bench.live(plan).1);
            let reported = bench.vehicle.changes.len() - changes;
            prop_assert_eq!(reported, (0..2).filter(|&plan| before[plan] != after[plan]).count(), "the vehicle is notified");
            prop_assert!(may_change || reported == 0, "only a last item or a clear changes a plan");
            if !matches!(bench.missions.transfer, Transfer::Upload(_)) {
                prop_assert_eq!(bench.staged(), 0);
            }
        }
        // In any case the engine becomes idle and accepts an upload.
        bench.drain();
        bench.wait(7_000);
        prop_assert_eq!(bench.upload(B, MISSION, &plan(9_999, 5)), Ack(ACCEPTED, id_of(&plan(9_999, 5))));
    }
}
