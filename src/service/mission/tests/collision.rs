//! Plan ids are checksums: two different plans may have the same id (M-39, SEC-11).

use super::*;

/// Returns `items` with parameter 4 of item `at` changed, so that the plan's id becomes `wanted`.
///
/// For messages of one length, a CRC is affine: the effect of flipping a bit does not depend on the other bits. So the 32 bits of
/// one field are the solution of a linear system, whatever precedes and follows them.
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
        let pivot = rows.iter().position(|(value, _)| value >> bit == 1).expect("any checksum is reachable");
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

/// M-39, SEC-11: an equal id does not prove that the plans are equal. Wherever they differ, even in length, the new plan replaces
/// the live one; a repeated upload does not.
#[test]
fn a_plan_with_the_same_id_is_another_plan() {
    let live = plan(1, 3);
    let id = id_of(&live);
    let others = [
        with_id(&plan(2, 3), 0, id),
        with_id(&plan(2, 3), 1, id),
        with_id(&plan(2, 3), 2, id),
        // All items but the last two are those of the live plan.
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

/// M-39, SEC-11: the content decides about a write: a different plan with the live plan's id is stored, an equal plan is not.
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
    let (_, [mission, ..]) = bench.unsaved().expect("it must be written");
    assert_eq!(mission, (other.clone(), id));
    bench.saved();
    assert_eq!(bench.drain(), [to_a(Ack(ACCEPTED, id))]);
    assert_eq!(bench.live(PlanType::Mission), (&other[..], id));
}
