//! The smallest vehicle with a second link, and forwarding between the two: what is more than `heartbeat` is a link and this.
#![no_std]
#![no_main]

use core::mem::MaybeUninit;

use mavstack::{
    Command, CommandRule, Commands, ForwardQueues, Forwarding, Instant, LinkConfig, LinkId, NoParams, NoPlans, Outcome,
    Parameters, PlanChange, Plans, Progress, Stack, Telemetry, Vehicle, VehicleState,
};
use mavstack_size::{CONFIG, PULSE, Rover, Uart, now_micros};

struct Router {
    rover: Rover,
    queues: ForwardQueues<2>,
}

impl Vehicle for Router {
    fn state(&self) -> Option<VehicleState> {
        self.rover.state()
    }

    fn forwarding(&mut self) -> Option<Forwarding<'_>> {
        Some(self.queues.forwarding())
    }
}

impl Commands for Router {
    fn command(&mut self, command: &Command) -> Outcome {
        self.rover.command(command)
    }
}

impl Telemetry for Router {}

impl Parameters for Router {
    type Table = NoParams;
}

impl Plans for Router {
    const MISSION_COMMANDS: &'static [CommandRule] = Rover::MISSION_COMMANDS;

    fn plan_changed(&mut self, _: PlanChange<'_>) {}

    fn progress(&self) -> Progress {
        self.rover.progress()
    }
}

#[cortex_m_rt::entry]
fn main() -> ! {
    // Statics, so that their RAM is counted.
    static mut STACK: MaybeUninit<Stack<2, NoPlans, 8, 0, 0>> = MaybeUninit::uninit();
    static mut ROUTER: MaybeUninit<Router> = MaybeUninit::uninit();

    let mut uart = Uart;
    let router = ROUTER.write(Router { rover: Rover::default(), queues: ForwardQueues::new() });
    let stack = STACK.write(Stack::with_capacities(CONFIG, [LinkConfig::uart(57_600); 2]));
    loop {
        let now = Instant::from_micros(now_micros());
        PULSE.tick();
        stack.poll(now, router);
        let _ = stack.poll_link(now, LinkId(0), &mut uart, router);
        let _ = stack.poll_link(now, LinkId(1), &mut uart, router);
    }
}
