//! Plans and parameters of a vehicle, stored in these chips.

use crate::eeprom::{self, Shared};
use crate::fram::{self, Chip};
use embedded_storage::nor_flash::NorFlash;
use mavstack::dialect::{MavCmd, MavResult, MissionState, Statustext, rules};
use mavstack::message::CommandRule;
use mavstack::storage::{RestoreErrors, Store};
use mavstack::{
    Address, Command, Commands, Config, Context, Instant, Item, LinkConfig, LinkId, Message, Outcome, Parameters,
    PlanChange, PlanType, Plans, Progress, Pulse, StackOf, Vehicle, VehicleState, parameters,
};
use mavstack_fram::{Eeprom, Fram};

struct Rover;

impl Vehicle for Rover {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(false))
    }
}

impl Commands for Rover {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}

impl Plans for Rover {
    const MISSION_COMMANDS: &'static [CommandRule] = &[rules::NAV_WAYPOINT];

    fn plan_changed(&mut self, _: &mut Context<'_>, _: PlanChange<'_>) {}

    fn progress(&self) -> Progress {
        Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
    }
}

impl Parameters for Rover {
    type Table = Tuning;
}

parameters! {
    pub struct Tuning {
        CRUISE: f32 = 5.0, 0.5..=15.0, "m/s";
    }
}

#[derive(mavstack::Stack)]
#[stack(vehicle: Rover, links: 1, plans: { mission: 250, fence: 64, rally: 16 }, parameters: Tuning, storage)]
struct Mavlink;

/// A stack with few plans, whose region is short.
#[derive(mavstack::Stack)]
#[stack(vehicle: Rover, links: 1, plans: { mission: 30, fence: 4, rally: 2 }, parameters: Tuning, storage)]
struct Small;

const REGION: u32 = Store::<Fram<Chip>>::region_len::<Mavlink>();
const SMALL: u32 = Store::<Fram<Chip>>::region_len::<Small>();

static PULSE: Pulse = Pulse::new();

/// Starts a stack, and restores what this memory has.
macro_rules! start {
    ($stack:ty, $flash:expr, $len:expr) => {{
        let mut store = Store::new($flash, 0..$len);
        let config = Config::new(Address::new(1, 1), &PULSE);
        let mut stack = Box::new(StackOf::<$stack>::new(config, [LinkConfig::unlimited()]));
        let restored: Result<(), RestoreErrors> = stack.restore(Instant::ZERO, &mut store, &mut Rover);
        (stack, store, restored)
    }};
}

fn items(count: i32) -> impl ExactSizeIterator<Item = Item> + Clone {
    (0..count).map(|x| Item { command: MavCmd::NAV_WAYPOINT, autocontinue: 1, x, y: 1, ..Item::default() })
}

/// M-44: plans of the usual size in a chip of 32 KiB survive restarts, and memory outside of the region is not written.
#[test]
fn plans_survive_restarts() {
    const { assert!(REGION <= 0x8000) };
    let mut chip = fram::chip(None);
    let mut before = Vec::new();
    for count in [250, 3, 0, 17] {
        let (mut stack, mut store, restored) = start!(Mavlink, Fram::new(&mut chip).unwrap(), REGION);
        let error = restored.err().and_then(|errors| errors.plans);
        assert_eq!((error, stack.mission().items()), (None, &before[..]));
        before = items(count).collect();
        stack.load_plan(Instant::ZERO, PlanType::Mission, items(count), &mut Rover).unwrap();
        while stack.persist(Instant::ZERO, &mut store, &mut Rover) {}
    }
    assert!(chip.memory[REGION as usize..].iter().all(|byte| *byte == 0x55), "memory outside of the region");
}

/// Stores 5 items, and 6 m/s in CRUISE.
fn store_both(flash: impl NorFlash) {
    let (mut stack, mut store, _) = start!(Small, flash, SMALL);
    stack.load_plan(Instant::ZERO, PlanType::Mission, items(5), &mut Rover).unwrap();
    assert!(stack.parameters_mut().set(Tuning::CRUISE, 6.0));
    for now in (0..100_000).step_by(10) {
        stack.poll(Instant::from_millis(now), &mut Rover);
        stack.persist(Instant::from_millis(now), &mut store, &mut Rover);
    }
}

/// Returns the texts that the stack has queued.
fn texts(stack: &mut StackOf<Small>) -> Vec<String> {
    let mut texts = Vec::new();
    for now in (0..2_000).step_by(10).map(Instant::from_millis) {
        PULSE.tick();
        stack.poll(now, &mut Rover);
        let bytes = stack.transmit(now, LinkId(0), &mut Rover).to_vec();
        if let [0xFD, len, _, _, _, _, _, a, b, c, rest @ ..] = &bytes[..]
            && u32::from_le_bytes([*a, *b, *c, 0]) == Statustext::ID
        {
            let text = Statustext::decode(&rest[..usize::from(*len)]);
            texts.extend(text.text.as_str().map(str::to_owned));
        }
        stack.transmitted(LinkId(0), bytes.len());
    }
    texts
}

/// G-18: the bus fails at any transaction of a restart. That is an error that a text reports. Each plan is whole or empty,
/// and each parameter has the stored value or its default.
#[test]
fn content_that_cannot_be_read_is_reported() {
    let mut whole = fram::chip(None);
    store_both(Fram::new(&mut whole).unwrap());
    let mut failures = 0;
    loop {
        let good_for = failures + 2;
        let mut chip = Chip { memory: whole.memory.clone(), good_for: Some(good_for), ..fram::chip(None) };
        let (mut stack, _, restored) = start!(Small, Fram::new(&mut chip).unwrap(), SMALL);
        let found = (stack.mission().items().len(), stack.parameters().get(Tuning::CRUISE));
        let Err(errors) = restored else {
            assert_eq!(found, (5, 6.0));
            break;
        };
        assert!([0, 5].contains(&found.0) && [5.0, 6.0].contains(&found.1), "{found:?} after {good_for} transactions");
        let texts = texts(&mut stack);
        for (error, text) in
            [(errors.plans, "Stored plans cannot be read"), (errors.parameters, "Stored parameters cannot be read")]
        {
            assert_eq!(
                texts.iter().any(|sent| sent == text),
                error.is_some(),
                "{texts:?} after {good_for} transactions"
            );
        }
        failures += 1;
    }
    // The end of each page, the pages of a segment, and the records.
    assert!(failures > SMALL / 256 + SMALL / 512, "{failures}");
}

/// Starts with this EEPROM. Returns the number of items that were restored, after storing this many others.
fn restart(chip: &Shared, count: Option<i32>) -> Option<usize> {
    let eeprom = Eeprom::new::<0x8000, 64>(chip.clone(), chip.clone()).ok()?;
    let (mut stack, mut store, restored) = start!(Small, eeprom, 0x8000);
    restored.ok()?;
    let items_before = stack.mission().items().len();
    if let Some(count) = count {
        stack.load_plan(Instant::ZERO, PlanType::Mission, items(count), &mut Rover).unwrap();
        while stack.persist(Instant::ZERO, &mut store, &mut Rover) && !chip.0.borrow().is_off {}
    }
    Some(items_before)
}

/// M-44, SEC-11: the power goes in every write of a page, which leaves garbage in all of it: the plan is the old one or the
/// new one.
#[test]
fn plans_survive_a_cut_in_every_page() {
    let first = eeprom::chip(vec![0xFF; 0x8000]);
    assert_eq!(restart(&first, Some(20)), Some(0));
    assert_eq!(restart(&first, None), Some(20));
    let before = first.0.borrow().memory.clone();
    let (mut old, mut new) = (0, 0);
    for cut in 1.. {
        let cut_chip = eeprom::chip(before.clone());
        cut_chip.0.borrow_mut().cut = Some(cut);
        assert_eq!(restart(&cut_chip, Some(30)), Some(20));
        let was_cut = cut_chip.0.borrow().is_off;
        match restart(&eeprom::chip(cut_chip.0.borrow().memory.clone()), None) {
            Some(20) => old += 1,
            Some(30) => new += 1,
            other => panic!("{other:?} items after a cut in write {cut}"),
        }
        if !was_cut {
            break;
        }
    }
    assert!(old > 10 && new == 1, "{old} old, {new} new");
}
