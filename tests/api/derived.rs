//! A stack that `derive(Stack)` declares.

use mavstack::dialect::MavResult;
use mavstack::prelude::*;

struct Rover;

impl Vehicle for Rover {
    fn state(&self) -> Option<VehicleState> {
        None
    }
}

impl Commands for Rover {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}

#[derive(Stack)]
#[stack(vehicle: Rover, links: 2)]
struct Mavlink {}

#[test]
fn a_stack_is_declared_by_a_struct() {
    static PULSE: Pulse = Pulse::new();
    let mut stack = StackOf::<Mavlink>::new(Config::new(Address::new(1, 1), &PULSE), [LinkConfig::unlimited(); 2]);
    stack.poll(Instant::ZERO, &mut Rover);
}
