//! Plan ids are checksums, and two plans may have the same: T-M20, M-39, SEC-11.

use super::*;

/// `items` with another parameter 4 in item `at`, so that the plan's id becomes `wanted`.
///
/// A checksum of messages of one length is affine: what flipping a bit changes in it does not depend on the other bits. So
/// the 32 bits of one field can be solved for, whatever stands before and behind it.
fn with_id(items: &[Item], at: usize, wanted: u32) -> Vec<Item> {
    let with = |bits: u32| {
        let mut items = items.to_vec();
        items[at].params[3] = f32::from_bits(bits);
        items
    };
    let base = id_of(&with(0));
    let mut rows: Vec<(u32, u32)> = (0..32).map(|bit| (id_of(&with(1 << bit)) ^ base, 1 << bit)).collect();
    let (mut missing, mut bits) = (wanted ^ base, 0);
    for bit in (0..32).rev() {
        let pivot = rows.iter().position(|(value, _)| value >> bit == 1).expect("any checksum can be had");
        let (value, pattern) = rows.swap_remove(pivot);
        for row in rows.iter_mut().filter(|(value, _)| value >> bit == 1) {
            *row = (row.0 ^ value, row.1 ^ pattern);
        }
        if missing >> bit == 1 {
            (missing, bits) = (missing ^ value, bits ^ pattern);
        }
    }
    let items = with(bits);
    assert_eq!(id_of(&items), wanted, "a collision");
    items
}

/// M-39, SEC-11: an equal id is no proof. Wherever the difference is, and between plans of different lengths, the new plan
/// replaces the live one; a second time it does not.
#[test]
fn a_plan_with_the_same_id_is_another_plan() {
    let live = plan(1, 3);
    let id = id_of(&live);
    let others = [
        with_id(&plan(2, 3), 0, id),
        with_id(&plan(2, 3), 1, id),
        with_id(&plan(2, 3), 2, id),
        // All but the last two items are the live plan's.
        with_id(&[item(1, 0), item(2, 1), item(1, 2)], 2, id),
        with_id(&plan(2, 1), 0, id),
        with_id(&plan(2, 5), 3, id),
    ];
    for other in others {
        assert!(other != live && other.iter().all(|item| !item.params[3].is_infinite()));
        let mut bench = Bench::new();
        assert_eq!(bench.upload(A, MISSION, &live), Ack(ACCEPTED, id));
        for _ in 0..2 {
            assert_eq!(bench.upload(A, MISSION, &other), Ack(ACCEPTED, id));
            assert_eq!(bench.live(PlanType::Mission), (&other[..], id));
        }
        assert_eq!(bench.upload(A, MISSION, &live), Ack(ACCEPTED, id));
        assert_eq!(bench.live(PlanType::Mission), (&live[..], id));
        let changes = [live.clone(), other, live.clone()].map(|items| (PlanType::Mission, items, 0));
        assert_eq!(bench.vehicle.changes, changes);
    }
}

/// T-M20, SEC-11: what is written is what is compared: a plan with the live one's id is stored, the live one is not.
#[cfg(feature = "storage")]
#[test]
fn a_plan_with_the_same_id_is_stored() {
    let live = plan(1, 3);
    let id = id_of(&live);
    let other = with_id(&plan(2, 3), 1, id);
    let mut bench = Bench::new();
    bench.upload(A, MISSION, &live);
    bench.missions.attach_storage(Durability::Durable);
    bench.saved();

    assert_eq!(bench.upload(A, MISSION, &live), Ack(ACCEPTED, id));
    assert_eq!(bench.unsaved(), None);

    bench.ask(A, &count(MISSION, 3));
    for (seq, item) in other.iter().enumerate() {
        bench.ask(A, &int(MISSION, seq, item));
    }
    let (_, [mission, ..]) = bench.unsaved().expect("it is to be written");
    assert_eq!(mission, (other.clone(), id));
    bench.saved();
    assert_eq!(bench.drain(), [to_a(Ack(ACCEPTED, id))]);
    assert_eq!(bench.live(PlanType::Mission), (&other[..], id));
}
