//! Damaged and unreadable plans.

use super::*;

/// Starts a vehicle with a damaged fence. Returns the number of items that were restored.
fn start_damaged(flash: &mut Flash, bit: usize) -> usize {
    let mut store = Plans::new(flash, 0..PLANS);
    let mut world = PlanWorld::of(Setup { step: millis(10), ..Setup::new() });
    let result = of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
    assert_eq!(result, Err(RestoreError::Damaged), "bit {bit}");
    let len = world.stack.fence().items().len();
    run_plans(&mut world, &mut store, millis(100));
    let text: Statustext = world.expect(0, millis(10));
    assert_eq!(text.text.as_str(), Some("Stored plans are damaged"));
    len
}

/// Starts a vehicle with damaged plans, uploads a fence, and restarts it.
fn store_again(flash: &mut Flash) {
    let (mut store, mut world, result) = start_plans(flash);
    assert!(result.is_err());
    assert_eq!(upload(&mut world, &mut store, &fence()), MavMissionResult::ACCEPTED);
    let mut world = PlanWorld::of(Setup::new());
    let result = of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
    assert_eq!((result, world.stack.fence().items().len()), (Ok(()), 2));
}

/// G-18: whichever bit of the page with a fence flips, a text reports it: an empty fence is never restored silently. The damage
/// remains until plans are stored.
#[test]
fn a_damaged_fence_is_reported() {
    let whole = with_fence();
    for bit in bits(&whole) {
        let mut flash = flipped(&whole, bit);
        for _ in 0..2 {
            assert_eq!(start_damaged(&mut flash, bit), 0);
        }
        store_again(&mut flash);
    }
}

/// G-18: the newest plans are damaged, and an older record is whole. It is restored, and the damage is reported until plans are
/// stored again.
#[test]
fn an_older_fence_replaces_a_damaged_one() {
    let mut whole = with_fence();
    let (mut store, mut world, result) = start_plans(&mut whole);
    assert_eq!(result, Ok(()));
    assert_eq!(upload(&mut world, &mut store, &fence()[..1]), MavMissionResult::ACCEPTED);
    for bit in bits_of_newest(&whole, KIND_OF_PLANS) {
        let mut flash = flipped(&whole, bit);
        assert_eq!(start_damaged(&mut flash, bit), 2);
        if bit % 61 == 0 {
            assert_eq!(start_damaged(&mut flash, bit), 2);
            store_again(&mut flash);
        }
    }
}

/// M-44: the stored bytes, one by one: later versions must be able to read them. The first row has the numbers of items and the
/// ids of the three plans. Each item is a row of 32 bytes, and a page has seven rows.
#[test]
fn the_layout_of_plans_is_as_documented() {
    let mut flash = with_fence();
    let (mut store, mut world, result) = start_plans(&mut flash);
    assert_eq!(result, Ok(()));
    assert_eq!(upload(&mut world, &mut store, &plan(6, 1)), MavMissionResult::ACCEPTED);
    let mission = world.stack.mission();
    let fence = world.stack.fence();
    let mut rows = vec![0; 32];
    rows[0..12].copy_from_slice(&[6, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0]);
    rows[12..16].copy_from_slice(&mission.id().to_le_bytes());
    rows[16..20].copy_from_slice(&fence.id().to_le_bytes());
    for item in mission.items().iter().chain(fence.items()) {
        rows.push(item.frame.0);
        rows.extend(item.command.0.to_le_bytes());
        rows.push(item.autocontinue);
        rows.extend(item.params.iter().flat_map(|param| param.to_bits().to_le_bytes()));
        rows.extend([item.x.to_le_bytes(), item.y.to_le_bytes(), item.z.to_bits().to_le_bytes()].concat());
    }
    let pages: Vec<_> = pages::pages(&flash.bytes).into_iter().map(|(_, page)| page).collect();
    let [_, first, last] = &pages[..] else { panic!("{} pages", pages.len()) };
    assert_eq!((&first.payload[..], &last.payload[..]), rows.split_at(224));
    assert_eq!((first.kind, first.schema, first.index, first.flags), (1, 1, 0, 0));
    assert_eq!((last.kind, last.schema, last.index, last.flags), (1, 1, 1, pages::LAST));
}

/// G-18, M-44: any one read fails at the start. The fence is restored late, the vehicle is informed, and a mission that is uploaded
/// meanwhile does not replace the fence.
#[test]
fn a_failed_read_loses_no_fence() {
    let whole = with_fence();
    let mut late = 0;
    for (read, durability) in (0..16).flat_map(|read| [(read, Durability::Durable), (read, Durability::Deferred)]) {
        for is_slow in [false, true] {
            let mut flash = whole.clone();
            (flash.reads, flash.fault) = (0, Fault::Reads(read..read + 1));
            let mut store = Plans::new(&mut flash, 0..PLANS);
            let mut world = PlanWorld::of(crate::setup(durability));
            let result = of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
            late += u32::from(result.is_err());
            // Storage cannot be read before the upload is over.
            world.vehicle.may_persist = !is_slow;
            let mission = plan(5, 1);
            if is_slow && durability == Durability::Deferred {
                assert_eq!(upload(&mut world, &mut store, &mission), MavMissionResult::ACCEPTED);
            }
            world.vehicle.may_persist = true;
            let mut result = upload(&mut world, &mut store, &mission);
            if result != MavMissionResult::ACCEPTED {
                // Reading is repeated after a second.
                run_plans(&mut world, &mut store, millis(1_100));
                result = upload(&mut world, &mut store, &mission);
            }
            assert_eq!(result, MavMissionResult::ACCEPTED);
            run_plans(&mut world, &mut store, secs(12));
            assert_eq!(world.stack.fence().items().len(), 2, "read {read}");
            let fences =
                world.vehicle.plan_changes().into_iter().filter(|(plan, ..)| *plan == mavstack::PlanType::Fence);
            assert_eq!(fences.count(), 1, "the vehicle is informed once");
            let mut world = PlanWorld::of(crate::setup(durability));
            let result = of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
            assert_eq!(result, Ok(()));
            assert_eq!((world.stack.mission().items().len(), world.stack.fence().items().len()), (5, 2), "read {read}");
        }
    }
    assert!(late > 8, "{late} starts without the plans");
}
