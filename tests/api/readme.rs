//! The README's loop, which it quotes.

use crate::support::{TestVehicle as Quadrotor, Tuning};
use embedded_io::{Read, ReadReady, Write, WriteReady};
use mavstack::prelude::*;

/// The flight controller's own code.
trait Flight {
    fn control_step(&mut self, now: Instant, mission: &[Item]);
}

impl Flight for Quadrotor {
    fn control_step(&mut self, _: Instant, _: &[Item]) {}
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

#[rustfmt::skip]
#[allow(dead_code, reason = "it has no end")]
fn the_loop<U: Read + ReadReady + Write + WriteReady>(clock: Clock, mut uart: U, mut errors: Errors) -> ! {
    static PULSE: Pulse = Pulse::new();       // ticked by the flight loop, watched by the stack
    const CONFIG: Config = Config::new(Address::new(1, 1), &PULSE);
    #[derive(Stack)]                          // all memory
    #[stack(vehicle: Quadrotor, links: 1, plans: { mission: 250 }, parameters: Tuning, streams, commands: { slots: 2 })]
    struct Mavlink;

    let mut vehicle = Quadrotor::new();       // yours: implements Vehicle, Commands, Plans, Telemetry, Parameters
    let mut stack = StackOf::<Mavlink>::new(CONFIG, [LinkConfig::uart(57_600)]);
    loop {
        let now = clock.now();                // µs since boot
        vehicle.control_step(now, stack.mission().items());
        PULSE.tick();                         // no tick, no heartbeat
        stack.poll(now, &mut vehicle);        // timers
        // A bounded read, the answers, a bounded write. Never waits. The link survives errors.
        if let Err(error) = stack.poll_link(now, LinkId(0), &mut uart, &mut vehicle) {
            errors.note(error);
        }
    }
}
