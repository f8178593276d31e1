//! The README's loop compiles: it stands here word for word.
#![cfg(feature = "storage")]

mod support;

use embedded_io::{Read, ReadReady, Write, WriteReady};
use embedded_storage::nor_flash::NorFlash;
use mavstack::*;
use support::TestVehicle as Quadrotor;

/// What a flight controller's own code has.
trait Flight {
    fn control_step(&mut self, now: Instant, mission: &[Item], fence: &[Item], rally: &[Item]);
}

impl Flight for Quadrotor {
    fn control_step(&mut self, _: Instant, _: &[Item], _: &[Item], _: &[Item]) {}
}

struct Clock;

impl Clock {
    fn now(&self) -> Instant {
        Instant::ZERO
    }
}

struct Errors;

impl Errors {
    fn note<E>(&mut self, _: E) {}
}

const PLAN_REGION: core::ops::Range<u32> = 0..0x8000;

#[rustfmt::skip]
#[allow(dead_code, reason = "it has no end")]
fn the_loop<U: Read + ReadReady + Write + WriteReady>(
    flash: impl NorFlash,
    clock: Clock,
    mut uart0: U,
    mut uart1: U,
    mut errors: Errors,
) -> ! {
    static PULSE: Pulse = Pulse::new();                 // ticked by the flight loop, watched by the stack
    const CONFIG: Config = Config::new(Address::new(1, 1), &PULSE);
    const LINKS: [LinkConfig; 2] = [LinkConfig::uart(115_200), LinkConfig::uart(57_600)];
    type Plans = plan_memory!(mission: 250, fence: 64, rally: 16);

    let mut vehicle = Quadrotor::new();                 // yours: implements Vehicle, Commands, Plans, Telemetry, Parameters
    let mut stack: Stack<2, Plans> = Stack::new(CONFIG, LINKS);
    let mut store = PlanStore::new(flash, PLAN_REGION); // any embedded-storage NorFlash, or an FRAM; leave it out if you like
    if let Err(error) = stack.restore_plans(clock.now(), &mut store, Durability::Durable, &mut vehicle) {
        errors.note(error);                             // the vehicle flies without the plans that could not be read
    }
    loop {
        let now = clock.now();                          // µs since boot
        vehicle.control_step(now, stack.mission().items(), stack.fence().items(), stack.rally().items());
        PULSE.tick();                                   // no tick, no heartbeat
        stack.poll(now, &mut vehicle);                  // timers
        // A bounded read, what the frames in it ask for, a bounded write. Never waits.
        if let Err(error) = stack.poll_link(now, LinkId(0), &mut uart0, &mut vehicle) {
            errors.note(error);                         // an overrun, say; the link goes on
        }
        if let Err(error) = stack.poll_link(now, LinkId(1), &mut uart1, &mut vehicle) {
            errors.note(error);
        }
        // At most one erase or one write of 256 bytes, when the vehicle permits: the one call that may block.
        stack.persist_plans(now, &mut store, &mut vehicle);
    }
}

#[test]
fn the_readme_has_this_loop() {
    let readme = include_str!("../README.md");
    let (_, block) = readme.split_once("```rust\n").expect("a block of Rust");
    let (block, _) = block.split_once("```\n").expect("its end");
    let indented: String =
        block.lines().map(|line| if line.is_empty() { "\n".to_owned() } else { format!("    {line}\n") }).collect();
    assert!(include_str!("readme.rs").contains(&indented), "README.md and tests/readme.rs differ in the loop");
}
