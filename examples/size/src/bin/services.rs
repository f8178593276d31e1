//! All services on one link: the three plans, 8 parameters, 4 streams, texts, the time, commands that take their time, modes
//! and manual control.
#![no_std]
#![no_main]

use core::mem::MaybeUninit;

use mavstack::dialect::command_rules::{DO_JUMP, NAV_LAND, NAV_TAKEOFF, NAV_WAYPOINT};
use mavstack::dialect::{
    Attitude, BatteryStatus, GlobalPositionInt, MavCmd, MavModeFlag, MavResult, MavStandardMode, MavState,
    MissionState, SysStatus,
};
use mavstack::{
    Command, CommandMemory, CommandPolicy, CommandRule, CommandSlots, Commands, ControlSource, Duration, Fill,
    FlightMode, Instant, LinkConfig, LinkId, ManualInput, Message, ModeRequest, Outcome, Parameters, PlanChange, Plans,
    Progress, Stack, Stream, Telemetry, TimeSlots, TimeSync, Vehicle, VehicleState, parameters, plan_memory,
};
use mavstack_size::{CONFIG, PULSE, Uart, now_micros};

parameters! {
    struct Tuning {
        BAT_LOW: f32 = 10.5, 9.0..=12.6, "V";
        CRUISE: f32 = 5.0, 0.5..=15.0, "m/s";
        PITCH_P: f32 = 6.0, 0.0..=12.0, "";
        ROLL_P: f32 = 6.0, 0.0..=12.0, "";
        RTL_ALT: i16 = 30, 5..=120, "m";
        STARTS: u32 = 0, 0..=u32::MAX, "", [read_only];
        SYS_ID: u8 = 1, 1..=254, "", [reboot_required];
        YAW_P: f32 = 2.5, 0.0..=6.0, "";
    }
}

struct Copter {
    armed: bool,
    mode: u32,
    tuning: Tuning,
    commands: CommandSlots<2>,
    time: TimeSlots<1>,
    manual: ManualInput,
}

impl Vehicle for Copter {
    fn state(&self) -> Option<VehicleState> {
        let armed = if self.armed { MavModeFlag::SAFETY_ARMED } else { MavModeFlag::EMPTY };
        let base_mode = armed.with(MavModeFlag::CUSTOM_MODE_ENABLED);
        Some(VehicleState { base_mode, custom_mode: self.mode, system_status: MavState::STANDBY })
    }

    fn time_sync(&mut self) -> Option<&mut TimeSync> {
        Some(&mut self.time)
    }

    fn manual_input(&mut self) -> Option<&mut ManualInput> {
        Some(&mut self.manual)
    }
}

impl Commands for Copter {
    const COMMANDS: &'static [CommandPolicy] = &[CommandPolicy::new(NAV_TAKEOFF).no_broadcast().once()];
    const MODES: &'static [FlightMode] = &[
        FlightMode::new(0, "Hold"),
        FlightMode::new(1, "Mission").with_standard_mode(MavStandardMode::MISSION),
        FlightMode::new(2, "Return").with_standard_mode(MavStandardMode::SAFE_RECOVERY),
    ];

    fn command(&mut self, command: &Command) -> Outcome {
        match (command.id, command.params) {
            (MavCmd::COMPONENT_ARM_DISARM, [1.0, ..]) => self.armed = true,
            (MavCmd::COMPONENT_ARM_DISARM, [0.0, ..]) => self.armed = false,
            (MavCmd::NAV_TAKEOFF, _) => return self.commands.start(command),
            _ => return MavResult::UNSUPPORTED.into(),
        }
        MavResult::ACCEPTED.into()
    }

    fn command_memory(&mut self) -> Option<&mut CommandMemory> {
        Some(&mut self.commands)
    }

    fn set_mode(&mut self, mode: &'static FlightMode, _: &ModeRequest) -> Outcome {
        self.mode = mode.custom_mode;
        MavResult::ACCEPTED.into()
    }
}

impl Telemetry for Copter {
    const STREAMS: &'static [Stream] = &[
        Stream::of::<Attitude>().every(Duration::from_millis(250)),
        Stream::of::<GlobalPositionInt>().every(Duration::from_millis(500)),
        Stream::of::<SysStatus>().every(Duration::from_secs(1)),
        Stream::of::<BatteryStatus>(),
    ];

    fn fill(&mut self, id: u32, out: Fill<'_>) -> bool {
        match id {
            Attitude::ID => out.put(&Attitude::default()),
            GlobalPositionInt::ID => out.put(&GlobalPositionInt::default()),
            SysStatus::ID => out.put(&SysStatus::default()),
            BatteryStatus::ID => out.put(&BatteryStatus::default()),
            _ => false,
        }
    }
}

impl Parameters for Copter {
    type Table = Tuning;

    fn parameters_mut(&mut self) -> Option<&mut Tuning> {
        Some(&mut self.tuning)
    }
}

impl Plans for Copter {
    const MISSION_COMMANDS: &'static [CommandRule] = &[NAV_WAYPOINT, NAV_TAKEOFF, NAV_LAND, DO_JUMP];

    fn plan_changed(&mut self, _: PlanChange<'_>) {}

    fn progress(&self) -> Progress {
        Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
    }
}

#[cortex_m_rt::entry]
fn main() -> ! {
    // Statics, so that their RAM is counted.
    static mut STACK: MaybeUninit<Stack<1, plan_memory!(mission: 100, fence: 40, rally: 10)>> = MaybeUninit::uninit();
    static mut COPTER: MaybeUninit<Copter> = MaybeUninit::uninit();

    let mut uart = Uart;
    let copter = COPTER.write(Copter {
        armed: false,
        mode: 0,
        tuning: Tuning::new(),
        commands: CommandSlots::new(),
        time: TimeSlots::new(),
        manual: ManualInput::new(ControlSource::GroundStation, ManualInput::TIMEOUT),
    });
    let stack = STACK.write(Stack::new(CONFIG, [LinkConfig::uart(57_600)]));
    loop {
        let now = Instant::from_micros(now_micros());
        PULSE.tick();
        stack.send_text(now, mavstack::dialect::MavSeverity::INFO, "started");
        copter.time.ask(LinkId(0));
        stack.poll(now, copter);
        let _ = stack.poll_link(now, LinkId(0), &mut uart, copter);
        if copter.time.take_sample().is_some() {
            copter.commands.finish(MavCmd::NAV_TAKEOFF, MavResult::ACCEPTED);
        }
    }
}
