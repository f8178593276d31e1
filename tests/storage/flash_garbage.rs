//! A vehicle starts whatever the flash contains: with plans that are whole and can be flown, or with none (G-18).

use crate::of_plans;
use crate::pages::{self, PLANS};
use crate::support::flash::RamFlash;
use crate::support::*;
use mavstack::dialect::{MavCmd, MavFrame};
use mavstack::plan::PlanView;
use mavstack::storage::{RestoreError, Store};
use mavstack::{Instant, Item, PlanType};

#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: 1,
    plans: { mission: 6, fence: 2, rally: 2 },
    commands: { slots: 1 },
    storage,
)]
struct Plans;

type Flash = RamFlash<4, 256>;

/// Length of a segment in bytes.
const SEGMENT: usize = Store::<Flash>::region_len::<Plans>() as usize / 2;

fn crc(bytes: &[u8]) -> [u8; 4] {
    let mut crc = crc_any::CRCu32::crc32();
    crc.digest(bytes);
    crc.get_crc().to_le_bytes()
}

/// Returns a segment with a record of this content. All checksums are correct.
fn segment(number: u32, content: &[u8]) -> Vec<u8> {
    let mut segment = pages::record(PLANS, number, content);
    segment.resize(SEGMENT, 0xFF);
    segment
}

/// Starts a vehicle with this flash. Returns the live plans and their ids.
fn start(bytes: Vec<u8>) -> (Vec<Vec<Item>>, Vec<u32>) {
    let setup = Setup::<1>::new();
    let mut stack = begun::<Plans, 1>(setup.config, setup.links);
    let mut store = Store::new(Flash::of(bytes), 0..2 * SEGMENT as u32);
    let mut vehicle = TestVehicle::new();
    let result = of_plans(stack.restore(Instant::ZERO, &mut store, &mut vehicle));
    assert!(matches!(result, Ok(()) | Err(RestoreError::Damaged)), "flash that can be read: {result:?}");
    let plans = [stack.mission(), stack.fence(), stack.rally()];
    let found = (plans.map(|plan: PlanView| plan.items().to_vec()).to_vec(), plans.map(|plan| plan.id()).to_vec());
    // M-5: the id is computed from the items; it is 0 if there are none.
    for (items, id) in found.0.iter().zip(&found.1) {
        let expected = if items.is_empty() { 0 } else { u32::from_le_bytes(crc(&bytes_of(items))).max(1) };
        assert_eq!(*id, expected);
    }
    // A new plan can be stored, whatever the flash contained.
    let waypoint =
        Item { command: MavCmd::NAV_WAYPOINT, frame: MavFrame::GLOBAL, autocontinue: 1, x: 1, ..Item::default() };
    let loaded = stack.load_plan(Instant::ZERO, PlanType::Mission, [waypoint], &mut vehicle);
    assert_eq!(loaded, Ok(()));
    while stack.persist(Instant::ZERO, &mut store, &mut vehicle) {}
    let mut again = begun::<Plans, 1>(setup.config, setup.links);
    of_plans(again.restore(Instant::ZERO, &mut store, &mut vehicle)).expect("flash that can be read");
    assert_eq!(again.mission().items(), [waypoint]);
    found
}

/// Returns the rows of items. Their id is computed from the same bytes.
fn bytes_of(items: &[Item]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for item in items {
        bytes.push(item.frame.0);
        bytes.extend(item.command.0.to_le_bytes());
        bytes.push(item.autocontinue);
        bytes.extend(item.params.iter().flat_map(|param| param.to_bits().to_le_bytes()));
        bytes.extend([item.x.to_le_bytes(), item.y.to_le_bytes(), item.z.to_bits().to_le_bytes()].concat());
    }
    bytes
}

/// Returns the content of a record with three plans and their ids.
fn content(plans: &[Vec<Item>; 3]) -> Vec<u8> {
    let mut content: Vec<u8> = plans.iter().flat_map(|items| (items.len() as u32).to_le_bytes()).collect();
    for items in plans {
        let id = if items.is_empty() { 0 } else { u32::from_le_bytes(crc(&bytes_of(items))).max(1) };
        content.extend(id.to_le_bytes());
    }
    content.resize(32, 0);
    plans.iter().for_each(|items| content.extend(bytes_of(items)));
    content
}

fn plans(rng: &mut Rng) -> [Vec<Item>; 3] {
    let mut items = |command, len: u64| -> Vec<Item> {
        let item = |rng: &mut Rng| Item {
            command,
            frame: MavFrame::GLOBAL_RELATIVE_ALT,
            autocontinue: 1,
            params: [5.0, 0.0, 0.0, f32::NAN],
            x: rng.below(900_000_000) as i32,
            y: rng.below(1_800_000_000) as i32,
            z: 20.0,
        };
        (0..rng.below(len + 1)).map(|_| item(rng)).collect()
    };
    let mission = items(MavCmd::NAV_WAYPOINT, 6);
    let mut fence = items(MavCmd::NAV_FENCE_CIRCLE_INCLUSION, 2);
    fence.iter_mut().for_each(|item| item.params = [100.0, 0.0, 0.0, 0.0]);
    let mut rally = items(MavCmd::NAV_RALLY_POINT, 2);
    rally.iter_mut().for_each(|item| item.params = [0.0; 4]);
    [mission, fence, rally]
}

fn fill(rng: &mut Rng, bytes: &mut [u8]) {
    bytes.fill_with(|| rng.byte());
}

/// M-44: a record with correct checksums is restored.
#[test]
fn whole_records_are_restored() {
    let mut rng = Rng::new(1);
    for _ in 0..500 {
        let plans = plans(&mut rng);
        let (items, _) = start([segment(1, &content(&plans)), vec![0xFF; SEGMENT]].concat());
        assert_eq!(items, plans);
    }
}

/// G-18: the checksums are correct, but the content is not: each plan is as it was stored, or empty.
#[test]
fn invalid_content_is_not_restored() {
    let mut rng = Rng::new(2);
    let (mut as_stored, mut differs) = (0, 0);
    for _ in 0..10_000 {
        let plans = plans(&mut rng);
        let good = content(&plans);
        let mut changed = good.clone();
        for _ in 0..=rng.below(3) {
            let at = rng.below(changed.len() as u64) as usize;
            changed[at] = rng.byte();
        }
        if rng.chance(0.1) {
            fill(&mut rng, &mut changed[32..]);
        }
        let (items, _) = start([segment(9, &changed), segment(8, &good)].concat());
        for (found, plan) in items.iter().zip(&plans) {
            // A changed item has another id.
            assert!(found.is_empty() || found == plan, "{found:?}");
        }
        if items == plans { as_stored += 1 } else { differs += 1 }
    }
    assert!(as_stored > 100 && differs > 5_000, "{as_stored} as stored, {differs} not");
}

/// M-44: stored plans that this vehicle cannot fly do not become live: an unsupported command, an invalid position, too many
/// items. The other plans do.
#[test]
fn plans_that_cannot_be_flown_are_not_live() {
    let mut rng = Rng::new(3);
    let good = loop {
        let plans = plans(&mut rng);
        if plans.iter().all(|items| !items.is_empty()) {
            break plans;
        }
    };
    let mut unknown = good.clone();
    unknown[0][0].command = MavCmd(65_000);
    let mut beyond = good.clone();
    beyond[0][0].x = 900_000_001;
    let mut large = good.clone();
    large[0] = vec![good[0][0]; 7];
    for bad in [unknown, beyond, large] {
        let (items, _) = start([segment(1, &content(&bad)), vec![0xFF; SEGMENT]].concat());
        assert_eq!(items[0], []);
        assert_eq!(items[1..], good[1..], "the other plans");
    }
}

/// G-18: noise, and noise over a part of the records. Each plan is as it was stored, or empty.
#[test]
fn noise_is_not_restored() {
    let mut rng = Rng::new(4);
    let mut empty = 0;
    for round in 0..5_000 {
        let plans = plans(&mut rng);
        let mut bytes = [segment(1, &content(&plans)), segment(2, &content(&plans))].concat();
        let from = rng.below(2 * SEGMENT as u64) as usize;
        let to = if round % 2 == 0 { bytes.len() } else { from + rng.below((bytes.len() - from) as u64) as usize };
        fill(&mut rng, &mut bytes[from..to]);
        let (items, _) = start(bytes);
        let is_empty = items.iter().all(Vec::is_empty);
        assert!(is_empty || items == plans);
        empty += u32::from(is_empty);
    }
    assert!(empty > 500, "{empty}");
}
