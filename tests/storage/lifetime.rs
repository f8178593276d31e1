//! The lifetime that `docs/storage.md` promises: a formula for the number of saves, and wear that is even.

use crate::support::flash::RamFlash;
use crate::support::*;
use mavstack::dialect::MavCmd;
use mavstack::storage::Store;
use mavstack::{Config, Instant, Item, PlanType};

#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: 1,
    plans: { mission: 20, fence: 4, rally: 2 },
    parameters: Tuning,
    commands: { slots: 1 },
    storage,
)]
struct Mavlink;

/// The pages of the content: 21 rows of a plan, and nine parameters.
const PLAN: u32 = 3;
const PARAMETERS: u32 = 1;

/// Saves the parameters this many times, beside a plan. Returns the number of erases of each unit.
fn wear<const ERASE: usize>(units: u32, saves: u32) -> Vec<u32> {
    let len = units * ERASE as u32;
    let setup = Setup::<1>::new();
    // The vehicle's own writes are not rate-limited, except that there are ten seconds between two of them.
    let mut stack =
        begun::<Mavlink, 1>(Config { storage_refill: mavstack::Duration::ZERO, ..setup.config }, setup.links);
    let mut vehicle = TestVehicle::new();
    let mut store = Store::new(RamFlash::<8, ERASE>::new(len), 0..len);
    let mut now = Instant::from_millis(1_000);
    stack.restore(now, &mut store, &mut vehicle).unwrap();
    let item = |x| Item { command: MavCmd::NAV_WAYPOINT, autocontinue: 1, x, y: 1, ..Item::default() };
    stack.load_plan(now, PlanType::Mission, (0..20).map(item), &mut vehicle).unwrap();
    for save in 0..saves {
        stack.parameters_mut().set(Tuning::CRUISE, 1.0 + (save % 100) as f32 / 10.0);
        let before = store.flash().bytes_written;
        while store.flash().bytes_written == before {
            now += secs(1);
            stack.save_parameters(now);
            while stack.persist(now, &mut store, &mut vehicle) {}
        }
        now += secs(10);
        while stack.persist(now, &mut store, &mut vehicle) {}
    }
    store.into_inner().erases_of
}

/// `saves × r / (P - 2 × L)` erases of each unit, for records of `r` pages among `L` live ones in a region of `P` pages.
fn check<const ERASE: usize>(units: u32, saves: u32) {
    let erases = wear::<ERASE>(units, saves);
    let (most, least) = (*erases.iter().max().unwrap(), *erases.iter().min().unwrap());
    let pages = units / 2 * 2 * ERASE as u32 / 256;
    let formula = saves as f64 * f64::from(PARAMETERS) / f64::from(pages - 2 * (PLAN + PARAMETERS));
    println!(
        "{units} units of {ERASE} bytes, {saves} saves: {least} to {most} erases of a unit, by the formula {formula:.0}"
    );
    assert!(f64::from(most) <= formula + 2.0, "{most} erases, and {formula} by the formula");
    assert!(most - least <= 2, "{erases:?}");
}

#[test]
fn flash_lasts_as_long_as_the_guide_says() {
    check::<4096>(16, 5_000);
    check::<2048>(8, 5_000);
    check::<2048>(5, 5_000);
    check::<131_072>(2, 5_000);
    check::<256>(32, 2_000);
}
