//! Power cuts during writes, and write errors of the flash.

use mavstack::dialect::{CommandLong, MavCmd, MavMissionResult, MavParamType, ParamSet, SetupSigning};
use mavstack::message::Secret;
use mavstack::signing::SigningKey;
use mavstack::{Duration, Instant, Text};
use mavstack_demo::{COMPANION, TELEMETRY, Tuning};
use semihosting::println;

use crate::flash;
use crate::station::{Counter, Upload, request_message, upload};
use crate::world::{Parts, STATION, Signer, World};

const ITEMS: u16 = 12;
const ACCEPTED: MavMissionResult = MavMissionResult::ACCEPTED;
const ERROR: MavMissionResult = MavMissionResult::ERROR;

/// The steps of a page of the log: 256 bytes, written in words.
const PAGE: u32 = 64;

/// Runs until writing has finished. After a record units are erased ahead, so wait for a quiet period.
fn settle(world: &mut World) {
    let mut quiet = 0;
    while quiet < 30 && !flash::is_power_off() {
        world.pass(&mut []);
        quiet = if world.is_writing { 0 } else { quiet + 1 };
    }
}

/// The contents found after the power cuts.
#[derive(Default)]
struct Outcomes {
    cuts: u32,
    old: u32,
    new: u32,
}

/// Cuts the power at each step of the writes of `change`. `change` returns whether the client received a confirmation. `find`
/// returns whether the new value is present after the reboot, or the old one; `None` if neither.
fn every_cut(
    mut parts: Parts,
    change: fn(&mut World) -> bool,
    find: fn(&mut World, &Outcomes) -> Option<bool>,
) -> (Parts, Outcomes) {
    let mut outcomes = Outcomes::default();
    flash::snapshot(&mut parts.flash, false);
    loop {
        flash::snapshot(&mut parts.flash, true);
        flash::cut_after(outcomes.cuts + 1);
        let mut world = World::start(parts, Instant::ZERO);
        let is_confirmed = change(&mut world);
        let was_cut = flash::is_power_off();
        let mut world = world.restarted();
        let found = find(&mut world, &outcomes);
        let Some(is_new) = found else {
            panic!("cut after {} steps: neither the old nor the new value", outcomes.cuts)
        };
        assert!(is_new || !is_confirmed, "cut after {} steps: the change was confirmed but is lost", outcomes.cuts);
        parts = world.end();
        if !was_cut {
            assert!(is_new && is_confirmed, "no change even without a cut");
            // The last step of a record makes it valid. A cut leaves the new value only if more is written after it.
            assert!(outcomes.old > 0, "no cut left the old value");
            return (parts, outcomes);
        }
        outcomes.cuts += 1;
        outcomes.old += u32::from(!is_new);
        outcomes.new += u32::from(is_new);
    }
}

impl Outcomes {
    fn print(&self, name: &str) {
        let Self { cuts, old, new } = self;
        println!(
            "{name}: power cut at each of {cuts} steps of the flash: old value {old} times, new value {new} times, never a mix"
        );
    }
}

/// Cuts the power at each word and erase of a plan: of one that is appended to the log, and of one that opens a new segment,
/// for which everything else is copied.
pub fn cut_plan(parts: Parts) -> Parts {
    let (parts, appended) = cut_plan_after(parts, 1);
    appended.print("reset-in-commit");
    let mut world = with_parameters(parts);
    let mut saves = 0;
    loop {
        let steps;
        (world, steps) = save_plan(world, 3 + saves);
        if steps > appended.cuts + PAGE {
            break;
        }
        saves += 1;
        assert!(saves < 100, "no segment was opened");
    }
    let (parts, copied) = cut_plan_after(world.end(), saves);
    assert!(copied.cuts > appended.cuts + PAGE, "no segment was opened: {} steps", copied.cuts);
    copied.print("reset-in-commit, with a new segment");
    parts
}

/// Returns a vehicle with stored parameters, which are copied to each new segment.
fn with_parameters(parts: Parts) -> World {
    let mut world = World::fresh(parts);
    set_speed(&mut world, 5.0);
    while !world.app().wants_reboot() {
        world.pass(&mut []);
    }
    world.restarted()
}

/// Stores the plan of this variant, after a reboot because saves are rate-limited (C-15). Returns the steps of the flash.
fn save_plan(world: World, variant: u16) -> (World, u32) {
    const STEPS: u32 = 1_000_000;
    let mut world = world.restarted();
    flash::cut_after(STEPS);
    assert!(upload(&mut world, COMPANION, STATION, ITEMS, variant) == ACCEPTED);
    settle(&mut world);
    let steps = STEPS - flash::steps_left();
    flash::clear_faults();
    (world, steps)
}

/// Cuts the power at each step of a save, after as many saves as this: the last of variant 1, to be replaced by variant 2.
fn cut_plan_after(parts: Parts, saves: u16) -> (Parts, Outcomes) {
    let mut world = with_parameters(parts);
    for variant in (3..).take((saves - 1).into()).chain([1]) {
        (world, _) = save_plan(world, variant);
    }
    let change = |world: &mut World| {
        let mut upload = Upload::new(COMPANION, STATION, ITEMS, 2);
        while upload.result.is_none() && !flash::is_power_off() {
            world.pass(&mut [&mut upload]);
        }
        settle(world);
        assert!(upload.result.is_none_or(|result| result == ACCEPTED), "{:?}", upload.result);
        upload.result.is_some()
    };
    let find = |world: &mut World, _: &Outcomes| {
        let (old, new) = (world.live(1) == Some(ITEMS), world.live(2) == Some(ITEMS));
        (old || new).then_some(new)
    };
    every_cut(world.end(), change, find)
}

fn set_speed(world: &mut World, param_value: f32) {
    let set = ParamSet {
        target_system: 1,
        target_component: 1,
        param_id: Text::new("MPC_XY_CRUISE"),
        param_type: MavParamType::REAL32,
        param_value,
    };
    world.network.send(COMPANION, STATION, &set);
    // A reboot writes changed parameters at once, without the usual delay.
    let command = MavCmd::PREFLIGHT_REBOOT_SHUTDOWN;
    let reboot = CommandLong { target_system: 1, target_component: 1, command, param1: 1.0, ..CommandLong::default() };
    world.network.send(COMPANION, STATION, &reboot);
}

/// Cuts the power while parameters are written before a reboot. The reboot itself is the confirmation.
pub fn cut_parameters(parts: Parts) -> Parts {
    let mut world = World::fresh(parts);
    let change = |world: &mut World| {
        set_speed(world, 6.0);
        while !world.app().wants_reboot() && !flash::is_power_off() {
            world.pass(&mut []);
            assert!(world.now < Instant::from_millis(10_000), "no reboot");
        }
        let is_confirmed = !flash::is_power_off();
        // Without a reboot, units are erased ahead. The confirmed value survives a cut there, too.
        settle(world);
        is_confirmed
    };
    set_speed(&mut world, 5.0);
    while !world.app().wants_reboot() {
        world.pass(&mut []);
    }
    let find = |world: &mut World, _: &Outcomes| match world.app().stack().parameters().get(Tuning::MPC_XY_CRUISE) {
        5.0 => Some(false),
        6.0 => Some(true),
        _ => None,
    };
    let (parts, outcomes) = every_cut(world.end(), change, find);
    outcomes.print("reset-in-parameters");
    parts
}

const OLD_KEY: [u8; 32] = [0x42; 32];
const NEW_KEY: [u8; 32] = [0x43; 32];
/// A time in 2025, in units of 10 µs.
const TIME: u64 = 33_000_000_000_000;

fn set_key(world: &mut World, secret_key: [u8; 32]) {
    let setup =
        SetupSigning { target_system: 1, target_component: 1, secret_key: Secret(secret_key), initial_timestamp: TIME };
    world.network.send(COMPANION, STATION, &setup);
}

/// Cuts the power while the signing key is written. After the reboot exactly one of the two keys is valid. The end of writing
/// is the confirmation.
pub fn cut_key(parts: Parts) -> Parts {
    let mut world = World::fresh(parts);
    set_key(&mut world, OLD_KEY);
    settle(&mut world);
    let change = |world: &mut World| {
        set_key(world, NEW_KEY);
        settle(world);
        !flash::is_power_off()
    };
    let find = |world: &mut World, _: &Outcomes| {
        let is_valid = [OLD_KEY, NEW_KEY].map(|key| {
            // Later than the stored timestamp, which is a minute ahead.
            let timestamp = TIME + 3 * 6_000_000;
            world.network.signer = Some(Signer { key: SigningKey::new(key), timestamp });
            let mut counter = Counter::default();
            world.network.send(TELEMETRY, STATION, &request_message(0));
            world.run(Duration::from_millis(100), &mut [&mut counter]);
            counter.acks == 1
        });
        world.network.signer = None;
        match is_valid {
            [true, false] => Some(false),
            [false, true] => Some(true),
            _ => None,
        }
    };
    let (mut parts, outcomes) = every_cut(world.end(), change, find);
    outcomes.print("reset-in-key");
    parts.erase();
    let mut world = World::start(parts, Instant::ZERO);
    let is_empty = !world.app().stack().signing().is_active();
    assert!(is_empty, "erased flash contains a key");
    world.end()
}

/// Every flash operation fails after a number of successful ones. A failed operation has no effect, or half of it.
pub fn write_errors(parts: Parts) -> Parts {
    let mut world = World::fresh(parts);
    assert!(upload(&mut world, COMPANION, STATION, ITEMS, 1) == ACCEPTED);
    settle(&mut world);
    let mut parts = world.end();
    flash::snapshot(&mut parts.flash, false);
    let mut errors = 0;
    for does_half in [false, true] {
        for calls in 0.. {
            flash::snapshot(&mut parts.flash, true);
            let mut world = World::start(parts, Instant::ZERO);
            world.run(Duration::from_secs(1), &mut []);
            settle(&mut world);
            world.reset_tally();
            flash::fail_after(calls, does_half);
            let result = upload(&mut world, COMPANION, STATION, ITEMS, 2);
            if result == ACCEPTED {
                assert!(calls > 0 && world.live(2) == Some(ITEMS), "after {calls} calls: accepted but not live");
                flash::clear_faults();
                parts = world.end();
                break;
            }
            errors += 1;
            assert!(result == ERROR && world.live(1) == Some(ITEMS), "after {calls} calls: {result:?}");
            // Retries keep failing, and one text reports it.
            world.run(Duration::from_secs(15), &mut []);
            let texts = world.tally[usize::from(COMPANION.0)].texts;
            assert!(texts == 1, "after {calls} calls: {texts} texts");
            world = world.restarted();
            assert!(world.live(1) == Some(ITEMS), "after {calls} calls and a reboot: the old plan is lost");
            assert!(
                upload(&mut world, COMPANION, STATION, ITEMS, 3) == ACCEPTED,
                "refused after the flash works again"
            );
            parts = world.end();
        }
    }
    assert!(errors > 1, "no operation has failed");
    println!(
        "write-errors: {errors} operations from which on the flash fails: each time ERROR, one text, and the old plan, live and \
         after a reboot"
    );
    parts
}
