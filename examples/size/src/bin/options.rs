//! The smallest vehicle, and by features what it may have besides: `cargo xtask size --options` prints what each adds.
#![no_std]
#![no_main]
#![allow(unused_imports, reason = "each option has names of its own")]

use mavstack::dialect::commands::{ComponentArmDisarm, NavTakeoff};
use mavstack::dialect::{
    Attitude, BatteryStatus, CommandAck, CommandInt, CommandLong, GlobalPositionInt, Heartbeat, MavCmd, MavModeFlag,
    MavResult, MavSeverity, MavState, MissionCount, MissionItemInt, MissionRequestList, MissionState, SysStatus,
    Timesync, command_rules,
};
use mavstack::*;
use mavstack_size::{CONFIG, PULSE, Place, Uart, entry, now_micros};

const LINKS: usize = if cfg!(feature = "link-3") {
    3
} else if cfg!(feature = "link-2") {
    2
} else {
    1
};
const PEERS: usize = if cfg!(feature = "peers-16") { 16 } else { 8 };
const TEXTS: usize = if cfg!(feature = "texts-8") {
    8
} else if cfg!(feature = "texts") {
    4
} else {
    0
};
const STREAMS: usize = if cfg!(feature = "streams-24") {
    24
} else if cfg!(feature = "streams") {
    8
} else {
    0
};

#[cfg(not(feature = "mission"))]
type Memory = NoPlans;
#[cfg(all(feature = "mission", not(feature = "mission-200"), not(feature = "plans-3")))]
type Memory = plan_memory!(mission: 100);
#[cfg(feature = "mission-200")]
type Memory = plan_memory!(mission: 200);
#[cfg(feature = "plans-3")]
type Memory = plan_memory!(mission: 100, fence: 40, rally: 10);

#[cfg(all(feature = "parameters", not(feature = "parameters-16")))]
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

#[cfg(feature = "parameters-16")]
parameters! {
    struct Tuning {
        BAT_LOW: f32 = 10.5, 9.0..=12.6, "V";
        CRUISE: f32 = 5.0, 0.5..=15.0, "m/s";
        PITCH_D: f32 = 0.1, 0.0..=1.0, "";
        PITCH_I: f32 = 0.2, 0.0..=1.0, "";
        PITCH_MAX: f32 = 0.6, 0.0..=1.0, "rad";
        PITCH_P: f32 = 6.0, 0.0..=12.0, "";
        ROLL_D: f32 = 0.1, 0.0..=1.0, "";
        ROLL_I: f32 = 0.2, 0.0..=1.0, "";
        ROLL_MAX: f32 = 0.6, 0.0..=1.0, "rad";
        ROLL_P: f32 = 6.0, 0.0..=12.0, "";
        RTL_ALT: i16 = 30, 5..=120, "m";
        STARTS: u32 = 0, 0..=u32::MAX, "", [read_only];
        SYS_ID: u8 = 1, 1..=254, "", [reboot_required];
        YAW_D: f32 = 0.0, 0.0..=1.0, "";
        YAW_I: f32 = 0.2, 0.0..=1.0, "";
        YAW_P: f32 = 2.5, 0.0..=6.0, "";
    }
}

#[cfg(feature = "messages-few")]
dialect! {
    struct Few: [Heartbeat, CommandLong, CommandInt, CommandAck, Timesync, MissionCount, MissionItemInt, MissionRequestList];
}

/// What `cargo xtask size` lists apart.
#[cfg(all(feature = "forwarding", feature = "link-3"))]
const _: () = assert!(size_of::<ForwardQueues<3>>() == 3864);

struct Rover {
    armed: bool,
    mode: u32,
    #[cfg(feature = "parameters")]
    tuning: Tuning,
    #[cfg(feature = "commands-long")]
    commands: CommandSlots<{ if cfg!(feature = "commands-long-4") { 4 } else { 2 } }>,
    #[cfg(feature = "manual")]
    manual: ManualInput,
    #[cfg(feature = "time")]
    time: TimeSlots<1>,
    #[cfg(feature = "forwarding")]
    queues: ForwardQueues<
        LINKS,
        { if cfg!(feature = "forwarding-1024") { 1024 } else { 512 } },
        { if cfg!(feature = "forwarding-seen-512") { 512 } else { 256 } },
    >,
    #[cfg(feature = "high-latency")]
    satellite: HighLatency,
    #[cfg(feature = "signing")]
    signing: SigningMemory<{ if cfg!(feature = "signing-32") { 32 } else { 16 } }>,
}

impl Rover {
    const fn new() -> Self {
        Self {
            armed: false,
            mode: 0,
            #[cfg(feature = "parameters")]
            tuning: Tuning::new(),
            #[cfg(feature = "commands-long")]
            commands: CommandSlots::new(),
            #[cfg(feature = "manual")]
            manual: ManualInput::new(ControlSource::GroundStation, ManualInput::TIMEOUT),
            #[cfg(feature = "time")]
            time: TimeSlots::new(),
            #[cfg(feature = "forwarding")]
            queues: ForwardQueues::new(),
            #[cfg(feature = "high-latency")]
            satellite: HighLatency::new(HighLatencyConfig::DEFAULT),
            #[cfg(feature = "signing")]
            signing: SigningMemory::new(),
        }
    }
}

impl Vehicle for Rover {
    #[cfg(feature = "messages-few")]
    const MESSAGES: MessageTable = Few::MESSAGES;

    fn state(&self) -> Option<VehicleState> {
        let base_mode = if self.armed { MavModeFlag::SAFETY_ARMED } else { MavModeFlag::EMPTY };
        Some(VehicleState { base_mode, custom_mode: self.mode, system_status: MavState::STANDBY })
    }

    #[cfg(feature = "manual")]
    fn manual_input(&mut self) -> Option<&mut ManualInput> {
        Some(&mut self.manual)
    }

    #[cfg(feature = "time")]
    fn time_sync(&mut self) -> Option<&mut TimeSync> {
        Some(&mut self.time)
    }

    #[cfg(feature = "forwarding")]
    fn forwarding(&mut self) -> Option<Forwarding<'_>> {
        Some(self.queues.forwarding())
    }

    #[cfg(feature = "high-latency")]
    fn high_latency(&mut self) -> Option<&mut HighLatency> {
        Some(&mut self.satellite)
    }

    #[cfg(feature = "signing")]
    fn signing(&mut self) -> Option<&mut Signing> {
        Some(&mut self.signing)
    }
}

impl Commands for Rover {
    #[cfg(feature = "commands-rules")]
    const COMMANDS: &'static [CommandPolicy] = &[CommandPolicy::new(command_rules::NAV_TAKEOFF).no_broadcast().once()];
    #[cfg(feature = "modes")]
    const MODES: &'static [FlightMode] =
        &[FlightMode::new(0, "Hold"), FlightMode::new(1, "Mission"), FlightMode::new(2, "Return")];

    fn command(&mut self, command: &Command) -> Outcome {
        if cfg!(feature = "typed-2")
            && let Ok(NavTakeoff { pitch, .. }) = command.decode()
        {
            self.armed = pitch.is_some_and(|pitch| pitch > 0.0);
            return MavResult::ACCEPTED.into();
        }
        if cfg!(feature = "typed") {
            match command.decode() {
                Ok(ComponentArmDisarm { arm, .. }) => self.armed = arm,
                Err(result) => return result.into(),
            }
            return MavResult::ACCEPTED.into();
        }
        match (command.id, command.params) {
            (MavCmd::COMPONENT_ARM_DISARM, [1.0, ..]) => self.armed = true,
            (MavCmd::COMPONENT_ARM_DISARM, [0.0, ..]) => self.armed = false,
            #[cfg(feature = "commands-long")]
            (MavCmd::NAV_TAKEOFF, _) => return self.commands.start(command),
            _ => return MavResult::UNSUPPORTED.into(),
        }
        MavResult::ACCEPTED.into()
    }

    #[cfg(feature = "commands-long")]
    fn command_memory(&mut self) -> Option<&mut CommandMemory> {
        Some(&mut self.commands)
    }

    #[cfg(feature = "modes")]
    fn set_mode(&mut self, mode: &'static FlightMode, _: &ModeRequest) -> Outcome {
        self.mode = mode.custom_mode;
        MavResult::ACCEPTED.into()
    }
}

impl Telemetry for Rover {
    #[cfg(feature = "streams")]
    const STREAMS: &'static [Stream] = &[
        Stream::of::<Attitude>().every(Duration::from_millis(250)),
        Stream::of::<GlobalPositionInt>().every(Duration::from_millis(500)),
        Stream::of::<SysStatus>().every(Duration::from_secs(1)),
        Stream::of::<BatteryStatus>(),
    ];

    #[cfg(feature = "streams")]
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

impl Plans for Rover {
    const MISSION_COMMANDS: &'static [CommandRule] = &[command_rules::NAV_WAYPOINT];

    fn plan_changed(&mut self, _: PlanChange<'_>) {}

    fn progress(&self) -> Progress {
        Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
    }
}

impl Parameters for Rover {
    #[cfg(not(feature = "parameters"))]
    type Table = NoParams;
    #[cfg(feature = "parameters")]
    type Table = Tuning;

    #[cfg(feature = "parameters")]
    fn parameters_mut(&mut self) -> Option<&mut Tuning> {
        Some(&mut self.tuning)
    }
}

#[cfg(feature = "queues")]
static QUEUES: io::SerialQueues<64, 64> = io::SerialQueues::new();

/// Stands in for the UART's interrupt.
#[cfg(feature = "queues")]
#[cortex_m_rt::exception]
fn SysTick() {
    use embedded_io::{Read, ReadReady, Write, WriteReady};

    let mut queues = QUEUES.interrupt_end();
    let mut byte = [0];
    if Uart.read_ready() == Ok(true) && Uart.read(&mut byte) == Ok(1) {
        queues.received(byte[0]);
    }
    if Uart.write_ready() == Ok(true)
        && let Some(byte) = queues.next_to_send()
    {
        let _ = Uart.write(&[byte]);
    }
}

#[entry]
fn main() -> ! {
    static STACK: Place<Stack<LINKS, Memory, PEERS, TEXTS, STREAMS>> = Place::new();
    static ROVER: Place<Rover> = Place::new();

    #[cfg(not(feature = "signing"))]
    const LINK: LinkConfig = LinkConfig::uart(57_600);
    #[cfg(feature = "signing")]
    const LINK: LinkConfig = LinkConfig::uart(57_600).with_signing(LinkSigning::SIGNED.with_provisioning());
    const CONFIGS: [LinkConfig; LINKS] = {
        let mut configs = [LINK; LINKS];
        if cfg!(feature = "high-latency") {
            configs[LINKS - 1] = LINK.with_class(LinkClass::HighLatency);
        }
        configs
    };

    #[cfg(not(feature = "queues"))]
    let mut uart = Uart;
    #[cfg(feature = "queues")]
    let mut uart = QUEUES.loop_end();
    let rover = ROVER.put(Rover::new());
    let stack = STACK.put(Stack::with_capacities(CONFIG, CONFIGS));
    #[cfg(feature = "store-plans")]
    let mut plans = {
        use mavstack_size::storage::Flash;
        let mut store = PlanStore::new(Flash, 0..PlanStore::<Flash>::region_len(100, 0, 0));
        let _ = stack.restore_plans(Instant::ZERO, &mut store, Durability::Durable, rover);
        store
    };
    #[cfg(feature = "store-plans-fram")]
    let mut plans = {
        use mavstack_size::storage::Spi;
        let Ok(fram) = Fram::new(Spi) else {
            loop {
                core::hint::spin_loop();
            }
        };
        let mut store = PlanStore::new(fram, 0..PlanStore::<Fram<Spi>>::region_len(100, 0, 0));
        let _ = stack.restore_plans(Instant::ZERO, &mut store, Durability::Durable, rover);
        store
    };
    #[cfg(feature = "store-parameters")]
    let mut parameters = {
        use mavstack_size::storage::Flash;
        let mut store = ParamStore::new(Flash, 0x8000..0x8000 + ParamStore::<Flash>::region_len(8));
        let _ = stack.restore_parameters(Instant::ZERO, &mut store, rover);
        store
    };
    #[cfg(feature = "store-key")]
    let mut key = {
        use mavstack_size::storage::Flash;
        let mut store = SigningStore::new(Flash, 0xc000..0xc000 + SigningStore::<Flash>::REGION_LEN);
        let _ = stack.restore_signing(Instant::ZERO, &mut store, rover);
        store
    };
    loop {
        let now = Instant::from_micros(now_micros());
        PULSE.tick();
        #[cfg(feature = "texts")]
        stack.send_text(now, MavSeverity::INFO, "started");
        #[cfg(feature = "time")]
        {
            rover.time.ask(LinkId(0));
            rover.armed ^= rover.time.take_sample().is_some();
        }
        #[cfg(feature = "commands-long")]
        rover.commands.finish(MavCmd::NAV_TAKEOFF, MavResult::ACCEPTED);
        #[cfg(feature = "high-latency")]
        rover.satellite.sample(now, &HighLatencySample::UNKNOWN);
        stack.poll(now, rover);
        for link in 0..LINKS as u8 {
            let _ = stack.poll_link(now, LinkId(link), &mut uart, rover);
        }
        #[cfg(any(feature = "store-plans", feature = "store-plans-fram"))]
        stack.persist_plans(now, &mut plans, rover);
        #[cfg(feature = "store-parameters")]
        stack.persist_parameters(now, &mut parameters, rover);
        #[cfg(feature = "store-key")]
        stack.persist_signing(now, &mut key, rover);
    }
}
