//! Power that goes while something is written, and flash that takes no more.

use mavstack::dialect::{CommandLong, MavCmd, MavMissionResult, MavParamType, ParamSet, SetupSigning};
use mavstack::{Duration, Instant, Secret, SigningKey, Text, Vehicle};
use mavstack_demo::{COMPANION, TELEMETRY, Tuning};
use semihosting::println;

use crate::flash;
use crate::station::{Counter, Upload, request_message, upload};
use crate::world::{Parts, STATION, Signer, World};

const ITEMS: u16 = 12;
const ACCEPTED: MavMissionResult = MavMissionResult::ACCEPTED;
const ERROR: MavMissionResult = MavMissionResult::ERROR;

/// Until nothing has been written for a while: room for the next plan is erased ahead.
fn settle(world: &mut World) {
    let mut quiet = 0;
    while quiet < 30 && !flash::is_off() {
        world.pass(&mut []);
        quiet = if world.is_writing { 0 } else { quiet + 1 };
    }
}

/// What was found after the cuts.
#[derive(Default)]
struct Outcomes {
    cuts: u32,
    old: u32,
    new: u32,
}

/// Cuts the power at each step of what `change` has written, which tells whether the ground was told that it is; `find` looks
/// what is there after a restart: the new one, or the old one.
fn every_cut(
    mut parts: Parts,
    change: fn(&mut World) -> bool,
    find: fn(&mut World, &Outcomes) -> Option<bool>,
) -> (Parts, Outcomes) {
    let mut outcomes = Outcomes::default();
    flash::copy(&mut parts.flash, false);
    loop {
        flash::copy(&mut parts.flash, true);
        flash::cut_after(outcomes.cuts + 1);
        let mut world = World::start(parts, Instant::ZERO);
        let is_told = change(&mut world);
        let was_cut = flash::is_off();
        let mut world = world.restarted();
        let found = find(&mut world, &outcomes);
        let Some(is_new) = found else { panic!("cut after {} steps: neither the old nor the new", outcomes.cuts) };
        assert!(is_new || !is_told, "cut after {} steps: the ground was told, and it is lost", outcomes.cuts);
        parts = world.end();
        if !was_cut {
            assert!(is_new && is_told, "without a cut nothing changes");
            assert!(outcomes.old > 0 && outcomes.new > 0, "{} old, {} new", outcomes.old, outcomes.new);
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
            "{name}: the power cut at each of {cuts} steps of the flash: {old} times the old, {new} times the new, never a mix"
        );
    }
}

/// A plan, at each word and erase.
pub fn cut_plan(parts: Parts) -> Parts {
    let mut world = World::fresh(parts);
    assert!(upload(&mut world, COMPANION, STATION, ITEMS, 1) == ACCEPTED);
    settle(&mut world);
    let change = |world: &mut World| {
        let mut upload = Upload::new(COMPANION, STATION, ITEMS, 2);
        while upload.result.is_none() && !flash::is_off() {
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
    let (parts, outcomes) = every_cut(world.end(), change, find);
    outcomes.print("reset-in-commit");
    parts
}

fn set_speed(world: &mut World, param_value: f32) {
    let set = ParamSet {
        target_system: 1,
        target_component: 1,
        param_id: Text::new("MPC_XY_CRUISE"),
        param_type: MavParamType::REAL32,
        param_value,
    };
    world.air.send(COMPANION, STATION, &set);
    // It writes what was set before it restarts, and need not rest then.
    let command = MavCmd::PREFLIGHT_REBOOT_SHUTDOWN;
    let reboot = CommandLong { target_system: 1, target_component: 1, command, param1: 1.0, ..CommandLong::default() };
    world.air.send(COMPANION, STATION, &reboot);
}

/// Parameters, on their way to a restart; "told" is the restart itself.
pub fn cut_parameters(parts: Parts) -> Parts {
    let mut world = World::fresh(parts);
    let change = |world: &mut World| {
        set_speed(world, 6.0);
        while !world.app().wants_reboot() && !flash::is_off() {
            world.pass(&mut []);
            assert!(world.now < Instant::from_millis(10_000), "it does not restart");
        }
        !flash::is_off()
    };
    set_speed(&mut world, 5.0);
    while !world.app().wants_reboot() {
        world.pass(&mut []);
    }
    let find = |world: &mut World, _: &Outcomes| match world.app().vehicle().tuning().get(Tuning::MPC_XY_CRUISE) {
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
/// Some time in 2025, in units of 10 µs.
const TIME: u64 = 33_000_000_000_000;

fn set_key(world: &mut World, secret_key: [u8; 32]) {
    let setup =
        SetupSigning { target_system: 1, target_component: 1, secret_key: Secret(secret_key), initial_timestamp: TIME };
    world.air.send(COMPANION, STATION, &setup);
}

/// The signing key: exactly one of the two is good after a restart. "Told" is the end of writing.
pub fn cut_key(parts: Parts) -> Parts {
    let mut world = World::fresh(parts);
    set_key(&mut world, OLD_KEY);
    settle(&mut world);
    let change = |world: &mut World| {
        set_key(world, NEW_KEY);
        settle(world);
        !flash::is_off()
    };
    let find = |world: &mut World, _: &Outcomes| {
        let is_good = [OLD_KEY, NEW_KEY].map(|key| {
            // A minute ahead of where it was stored.
            let timestamp = TIME + 3 * 6_000_000;
            world.air.signer = Some(Signer { key: SigningKey::new(key), timestamp });
            let mut counter = Counter::default();
            world.air.send(TELEMETRY, STATION, &request_message(0));
            world.run(Duration::from_millis(100), &mut [&mut counter]);
            counter.acks == 1
        });
        world.air.signer = None;
        match is_good {
            [true, false] => Some(false),
            [false, true] => Some(true),
            _ => None,
        }
    };
    let (mut parts, outcomes) = every_cut(world.end(), change, find);
    outcomes.print("reset-in-key");
    parts.erase();
    let mut world = World::start(parts, Instant::ZERO);
    let is_gone = world.app().parts().1.signing().is_some_and(|signing| !signing.is_active());
    assert!(is_gone, "erased flash has no key");
    world.end()
}

/// Every call of the flash from some moment on fails, and does nothing or half of it.
pub fn write_errors(parts: Parts) -> Parts {
    let mut world = World::fresh(parts);
    assert!(upload(&mut world, COMPANION, STATION, ITEMS, 1) == ACCEPTED);
    settle(&mut world);
    let mut parts = world.end();
    flash::copy(&mut parts.flash, false);
    let mut errors = 0;
    for does_half in [false, true] {
        for calls in 0.. {
            flash::copy(&mut parts.flash, true);
            let mut world = World::start(parts, Instant::ZERO);
            world.run(Duration::from_secs(1), &mut []);
            settle(&mut world);
            world.count_anew();
            flash::fail_after(calls, does_half);
            let result = upload(&mut world, COMPANION, STATION, ITEMS, 2);
            if result == ACCEPTED {
                assert!(calls > 0 && world.live(2) == Some(ITEMS), "after {calls} calls: accepted, and not live");
                flash::heal();
                parts = world.end();
                break;
            }
            errors += 1;
            assert!(result == ERROR && world.live(1) == Some(ITEMS), "after {calls} calls: {result:?}");
            // It goes on failing, and a text says so once.
            world.run(Duration::from_secs(15), &mut []);
            let texts = world.tally[usize::from(COMPANION.0)].texts;
            assert!(texts == 1, "after {calls} calls: {texts} texts");
            world = world.restarted();
            assert!(world.live(1) == Some(ITEMS), "after {calls} calls and a restart: the old plan is gone");
            assert!(upload(&mut world, COMPANION, STATION, ITEMS, 3) == ACCEPTED, "the flash is good again");
            parts = world.end();
        }
    }
    assert!(errors > 1, "nothing has failed");
    println!(
        "write-errors: {errors} places from which on the flash fails: ERROR each time, the old plan live and after a \
              restart, one text"
    );
    parts
}
