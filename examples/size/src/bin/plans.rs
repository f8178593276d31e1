//! The same vehicle with texts, and missions of up to 100 items.
#![no_std]
#![no_main]

use core::mem::MaybeUninit;

use mavstack::dialect::{MavCmd, MavMissionResult, MavModeFlag, MavResult, MavState, MissionState};
use mavstack::{
    Address, Command, Commands, Config, Instant, Item, LinkConfig, LinkId, Outcome, PlanChange, PlanType, Plans,
    Progress, Pulse, Stack, Vehicle, VehicleState, plan_memory,
};
use mavstack_size::{Uart, now_micros};

static PULSE: Pulse = Pulse::new();
const CONFIG: Config = Config::new(Address::new(1, 1), &PULSE);

struct Rover {
    armed: bool,
}

impl Vehicle for Rover {
    fn state(&self) -> Option<VehicleState> {
        let base_mode = if self.armed { MavModeFlag::SAFETY_ARMED } else { MavModeFlag::EMPTY };
        Some(VehicleState { base_mode, custom_mode: 0, system_status: MavState::STANDBY })
    }
}

impl Commands for Rover {
    fn command(&mut self, command: &Command) -> Outcome {
        match (command.id, command.params) {
            (MavCmd::COMPONENT_ARM_DISARM, [1.0, ..]) => self.armed = true,
            (MavCmd::COMPONENT_ARM_DISARM, [0.0, ..]) => self.armed = false,
            _ => return MavResult::UNSUPPORTED.into(),
        }
        MavResult::ACCEPTED.into()
    }
}

impl Plans for Rover {
    fn check_item(&mut self, _: PlanType, _: u16, item: &Item) -> Result<(), MavMissionResult> {
        if item.command == MavCmd::NAV_WAYPOINT { Ok(()) } else { Err(MavMissionResult::UNSUPPORTED) }
    }

    fn plan_changed(&mut self, _: PlanChange<'_>) {}

    fn progress(&self) -> Progress {
        Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
    }
}

#[cortex_m_rt::entry]
fn main() -> ! {
    // A static, so that its RAM is counted.
    static mut STACK: MaybeUninit<Stack<1, plan_memory!(mission: 100)>> = MaybeUninit::uninit();

    let mut uart = Uart;
    let mut rover = Rover { armed: false };
    let stack = STACK.write(Stack::new(CONFIG, [LinkConfig::uart(57_600)]));
    loop {
        let now = Instant::from_micros(now_micros());
        PULSE.tick();
        stack.poll(now, &mut rover);
        let _ = stack.poll_link(now, LinkId(0), &mut uart, &mut rover);
    }
}
