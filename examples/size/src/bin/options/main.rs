//! A minimal vehicle with optional features. `cargo measure options` prints the cost of each.
#![no_std]
#![no_main]
#![allow(unused_imports, unused_variables, dead_code, reason = "each option uses other names")]

mod payload;

use mavstack::camera::{CameraControl, Image, Shot};
use mavstack::clock::Time;
use mavstack::command::CommandPolicy;
use mavstack::config::LinkClass;
use mavstack::dialect::commands::{ComponentArmDisarm, NavTakeoff};
use mavstack::dialect::{
    Attitude, AttitudeQuaternion, BatteryStatus, CameraCapFlags, CameraInformation, CameraMode, CameraSettings,
    CameraZoomType, CommandAck, CommandInt, CommandLong, EstimatorStatus, ExtendedSysState, GlobalPositionInt,
    GpsRawInt, Heartbeat, HomePosition, LocalPositionNed, MavCmd, MavModeFlag, MavParamError, MavResult, MavSeverity,
    MavState, MavType, MissionCount, MissionItemInt, MissionRequestList, MissionState, NavControllerOutput, ParamAck,
    RawImu, RcChannels, ScaledImu, ScaledPressure, ServoOutputRaw, SetFocusType, StorageInformation, SysStatus,
    SystemTime, Timesync, Tunnel, VfrHud, Vibration, VideoStreamInformation, WindCov, rules,
};
use mavstack::dialect::{
    AutopilotStateForGimbalDevice, GimbalDeviceAttitudeStatus, GimbalDeviceInformation, GimbalDeviceSetAttitude,
    GimbalManagerFlags, GimbalManagerInformation,
};
use mavstack::ext_parameters::{ExtParamServer, ExtValue};
use mavstack::gimbal::{DeviceService, DeviceSetpoint, GimbalSetpoint, GimbalTarget, ManagerService};
use mavstack::high_latency::{HighLatency, HighLatencySample};
use mavstack::logs::LogStreamer;
use mavstack::manual_control::ControlSource;
use mavstack::message::{Dialect, MessageTable};
use mavstack::network::ForwardQueues;
use mavstack::param::{ExternalParams, ParamInfo, ParamWrite, RuntimeTable};
use mavstack::plan::Durability;
use mavstack::prelude::*;
use mavstack::setpoints::Setpoints;
#[cfg(feature = "signing")]
use mavstack::signing::LinkSigning;
#[cfg(feature = "storage")]
use mavstack::storage::*;
use mavstack::{dialect, events, io, logs, message, parameters};
use mavstack_size::events::{BatteryLow, BatteryTooLow, Groups, NoFix, Parts, RoverEvents};
use mavstack_size::{CONFIG, PULSE, Place, Uart, Vacant, entry, now_micros};

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
const MISSION: usize = if cfg!(feature = "mission-200") { 200 } else { 100 };
const FENCE: usize = if cfg!(feature = "plans-3") { 40 } else { 0 };
const RALLY: usize = if cfg!(feature = "plans-3") { 10 } else { 0 };
const SLOTS: usize = if cfg!(feature = "commands-long-4") { 4 } else { 2 };
const BYTES: usize = if cfg!(feature = "forwarding-1024") { 1024 } else { 512 };
const SEEN: usize = if cfg!(feature = "forwarding-seen-512") { 512 } else { 256 };
const SENDERS: usize = if cfg!(feature = "signing-32") { 32 } else { 16 };

/// Each option is an entry.
#[derive(Stack)]
#[stack(vehicle: Rover, links: LINKS, peers: PEERS, texts: TEXTS)]
#[cfg_attr(feature = "mission", stack(plans: { mission: MISSION, fence: FENCE, rally: RALLY }))]
#[cfg_attr(feature = "parameters", stack(parameters: Tuning))]
#[cfg_attr(feature = "streams", stack(streams))]
#[cfg_attr(feature = "messages", stack(messages))]
#[cfg_attr(feature = "modes", stack(modes))]
#[cfg_attr(feature = "commands-long", stack(commands: { slots: SLOTS }))]
#[cfg_attr(feature = "client", stack(command_client: { slots: if cfg!(feature = "client-4") { 4 } else { 2 } }))]
#[cfg_attr(feature = "components", stack(components))]
#[cfg_attr(feature = "events", stack(events: { history: if cfg!(feature = "events-32") { 32 } else { 16 } }))]
#[cfg_attr(feature = "events-checks", stack(events: { history: 16, checks }))]
#[cfg_attr(feature = "files", stack(files: { sessions: if cfg!(feature = "files-4") { 4 } else { 2 }, upload: if cfg!(feature = "files-upload") { 512 } else if cfg!(feature = "files-plans-upload") { 276 } else { 0 }, }))]
#[cfg_attr(feature = "logs", stack(logs))]
#[cfg_attr(feature = "forwarding", stack(forwarding: { bytes: BYTES, seen: SEEN }))]
#[cfg_attr(feature = "signing", stack(signing: { streams: SENDERS }))]
#[cfg_attr(feature = "manual", stack(manual_control))]
#[cfg_attr(feature = "operator-control", stack(operator_control))]
#[cfg_attr(feature = "storage", stack(storage))]
struct Mavlink {
    #[cfg(feature = "camera")]
    camera: CameraControl<[Image; if cfg!(feature = "camera-64") { 64 } else { 16 }]>,
    #[cfg(feature = "ext-parameters")]
    ext_parameters: ExtParamServer,
    #[cfg(feature = "log-streaming")]
    log_streaming: LogStreamer,
    #[cfg(feature = "time")]
    time: Time,
    #[cfg(feature = "setpoints")]
    setpoints: Setpoints,
    #[cfg(feature = "gimbal-manager")]
    gimbal_manager: ManagerService,
    #[cfg(feature = "gimbal-device")]
    gimbal_device: DeviceService,
    #[cfg(feature = "high-latency")]
    high_latency: HighLatency,
}

#[cfg(feature = "parameters-run-time")]
type Tuning = RuntimeTable<{ if cfg!(feature = "parameters-run-time-16") { 16 } else { 8 } }>;

#[cfg(feature = "parameters-external")]
type Tuning = ExternalParams<8>;

/// A setting of a firmware that has settings: name, value, and range.
#[cfg(any(feature = "parameters-run-time", feature = "parameters-external"))]
type Setting = (&'static str, f32, f32, f32);

#[cfg(any(feature = "parameters-run-time", feature = "parameters-external"))]
static SETTINGS: [Setting; 8] = [
    ("BAT_LOW", 10.5, 9.0, 12.6),
    ("CRUISE", 5.0, 0.5, 15.0),
    ("PITCH_P", 6.0, 0.0, 12.0),
    ("ROLL_P", 6.0, 0.0, 12.0),
    ("RTL_ALT", 30.0, 5.0, 120.0),
    ("STARTS", 0.0, 0.0, 1e9),
    ("SYS_ID", 1.0, 1.0, 254.0),
    ("YAW_P", 2.5, 0.0, 6.0),
];

#[cfg(any(feature = "parameters-run-time", feature = "parameters-external"))]
fn info((name, default, min, max): &Setting) -> Option<ParamInfo> {
    ParamInfo::new(name, *default, *min..=*max).ok()
}

#[cfg(feature = "parameters-external")]
impl ParamBackend for Rover {
    const SORTED: bool = true;

    fn param_count(&self) -> u16 {
        8
    }

    fn param_info(&self, index: u16) -> Option<ParamInfo> {
        info(SETTINGS.get(usize::from(index))?)
    }

    fn param_bits(&self, index: u16) -> Option<u32> {
        self.values.get(usize::from(index)).copied()
    }

    fn set_param(&mut self, _: &mut Context<'_>, write: &ParamWrite) -> Result<(), MavParamError> {
        *self.values.get_mut(usize::from(write.index())).ok_or(MavParamError::DOES_NOT_EXIST)? = write.bits();
        Ok(())
    }
}

#[cfg(all(
    feature = "parameters",
    not(any(feature = "parameters-16", feature = "parameters-run-time", feature = "parameters-external"))
))]
parameters! {
    struct Tuning {
        BAT_LOW: f32 = 10.5, 9.0..=12.6, "V";
        CRUISE: f32 = 5.0, 0.5..=15.0, "m/s";
        PITCH_P: f32 = 6.0, 0.0..=12.0, "";
        ROLL_P: f32 = 6.0, 0.0..=12.0, "";
        RTL_ALT: i32 = 30, 5..=120, "m";
        STARTS: i32 = 0, 0..=i32::MAX, "" { read_only };
        SYS_ID: i32 = 1, 1..=254, "" { reboot_required };
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
        RTL_ALT: i32 = 30, 5..=120, "m";
        STARTS: i32 = 0, 0..=i32::MAX, "" { read_only };
        SYS_ID: i32 = 1, 1..=254, "" { reboot_required };
        YAW_D: f32 = 0.0, 0.0..=1.0, "";
        YAW_I: f32 = 0.2, 0.0..=1.0, "";
        YAW_P: f32 = 2.5, 0.0..=6.0, "";
    }
}

#[cfg(feature = "messages-few")]
dialect! {
    struct Few: [Heartbeat, CommandLong, CommandInt, CommandAck, Timesync, MissionCount, MissionItemInt, MissionRequestList];
}

/// `cargo measure size` lists this size separately.
#[cfg(all(feature = "forwarding", feature = "link-3"))]
const _: () = assert!(size_of::<ForwardQueues<3>>() == 5920);

struct Rover {
    armed: bool,
    mode: u32,
    #[cfg(feature = "parameters-external")]
    values: [u32; 8],
}

impl Vehicle for Rover {
    #[cfg(feature = "messages-few")]
    const MESSAGES: MessageTable = Few::MESSAGES;

    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(self.armed).with_mode(self.mode))
    }
}

impl Commands for Rover {
    #[cfg(feature = "commands-rules")]
    const POLICIES: &'static [CommandPolicy] = &[CommandPolicy::new(rules::NAV_TAKEOFF).no_broadcast()];

    fn command(&mut self, cx: &mut Context<'_>, command: &Command) -> Outcome {
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
            (MavCmd::NAV_TAKEOFF, _) => return cx.start(),
            _ => return MavResult::UNSUPPORTED.into(),
        }
        MavResult::ACCEPTED.into()
    }
}

#[cfg(feature = "modes")]
impl Modes for Rover {
    const MODES: &'static [FlightMode] =
        &[FlightMode::new(0, "Hold"), FlightMode::new(1, "Mission"), FlightMode::new(2, "Return")];

    fn set_mode(&mut self, _: &mut Context<'_>, mode: &'static FlightMode, _: &ModeRequest) -> Outcome {
        self.mode = mode.custom_mode;
        MavResult::ACCEPTED.into()
    }
}

#[cfg(feature = "streams")]
impl Telemetry for Rover {
    const STREAMS: &'static [Stream] = &[
        Stream::of::<Attitude>().every(Duration::from_millis(250)),
        Stream::of::<GlobalPositionInt>().every(Duration::from_millis(500)),
        Stream::of::<SysStatus>().every(Duration::from_secs(1)),
        Stream::of::<BatteryStatus>(),
        #[cfg(feature = "streams-20")]
        Stream::of::<AttitudeQuaternion>(),
        #[cfg(feature = "streams-20")]
        Stream::of::<EstimatorStatus>(),
        #[cfg(feature = "streams-20")]
        Stream::of::<ExtendedSysState>(),
        #[cfg(feature = "streams-20")]
        Stream::of::<GpsRawInt>(),
        #[cfg(feature = "streams-20")]
        Stream::of::<HomePosition>(),
        #[cfg(feature = "streams-20")]
        Stream::of::<LocalPositionNed>(),
        #[cfg(feature = "streams-20")]
        Stream::of::<NavControllerOutput>(),
        #[cfg(feature = "streams-20")]
        Stream::of::<RawImu>(),
        #[cfg(feature = "streams-20")]
        Stream::of::<RcChannels>(),
        #[cfg(feature = "streams-20")]
        Stream::of::<ScaledImu>(),
        #[cfg(feature = "streams-20")]
        Stream::of::<ScaledPressure>(),
        #[cfg(feature = "streams-20")]
        Stream::of::<ServoOutputRaw>(),
        #[cfg(feature = "streams-20")]
        Stream::of::<SystemTime>(),
        #[cfg(feature = "streams-20")]
        Stream::of::<VfrHud>(),
        #[cfg(feature = "streams-20")]
        Stream::of::<Vibration>(),
        #[cfg(feature = "streams-20")]
        Stream::of::<WindCov>(),
    ];

    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
        match id {
            Attitude::ID => out.put(&Attitude::default()),
            GlobalPositionInt::ID => out.put(&GlobalPositionInt::default()),
            SysStatus::ID => out.put(&SysStatus::default()),
            BatteryStatus::ID => out.put(&BatteryStatus::default()),
            #[cfg(feature = "messages")]
            Tunnel::ID => out.put(&Tunnel { target_system: out.target().system.wire(), ..Tunnel::default() }),
            _ => false,
        }
    }
}

#[cfg(feature = "events-checks")]
impl HealthChecks for Rover {
    type Events = RoverEvents;

    fn checks(&self, cx: &Context<'_>, report: &mut events::HealthReport<'_>) {
        report.present(Parts::BATTERY | Parts::GPS);
        if self.armed {
            report.fails(Groups::AUTOMATIC, Parts::GPS, &NoFix { satellites: 3 });
        }
        if cx.now() < Instant::from_millis(5_000) {
            report.fails(Groups::MANUAL | Groups::AUTOMATIC, Parts::BATTERY, &BatteryTooLow { voltage: 10.0 });
        }
    }
}

#[cfg(feature = "files")]
impl Files for Rover {}

#[cfg(feature = "logs")]
impl Logs for Rover {
    fn log_count(&self) -> u16 {
        u16::from(self.armed)
    }

    fn log_info(&self, id: u16) -> Option<logs::LogInfo> {
        (id < self.log_count()).then_some(logs::LogInfo { size: 1_000, time_utc: 0 })
    }

    fn read_log(&mut self, _: u16, offset: u32, out: &mut [u8]) -> logs::LogRead {
        out.fill(offset as u8);
        logs::LogRead::Done
    }
}

#[cfg(feature = "log-streaming")]
impl LogStreaming for Rover {
    fn start_log_stream(&mut self, _: &mut Context<'_>, _: Peer) -> MavResult {
        MavResult::ACCEPTED
    }

    fn stop_log_stream(&mut self, _: &mut Context<'_>) {
        self.armed = false;
    }

    fn read_log_definitions(&mut self, offset: u32, out: &mut [u8]) -> usize {
        out.fill(offset as u8);
        if offset < 1_000 { out.len() } else { 0 }
    }

    fn log_data_len(&self) -> usize {
        usize::from(self.armed)
    }

    fn take_log_data(&mut self, out: &mut [u8]) -> usize {
        out.fill(u8::from(self.armed));
        self.log_data_len()
    }
}

#[cfg(feature = "components")]
impl Components for Rover {
    const COMPONENTS: &'static [Component] = &[Component::new(message::ComponentId::new(154), MavType::GIMBAL)];

    fn component_command(&mut self, _: &mut Context<'_>, _: message::ComponentId, command: &Command) -> Outcome {
        self.armed ^= command.id == MavCmd::USER_1;
        MavResult::ACCEPTED.into()
    }
}

#[cfg(feature = "client")]
impl CommandClient for Rover {
    fn command_for(&mut self, token: u16) -> Option<OutgoingCommand> {
        let params = [f32::from(token), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        Some(OutgoingCommand::long(MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, params))
    }

    fn command_answered(&mut self, _: &mut Context<'_>, _: u16, reply: CommandReply) {
        self.armed &= reply != CommandReply::TimedOut;
    }
}

#[cfg(feature = "ext-parameters")]
impl ExtParameters for Rover {
    fn ext_param_count(&self) -> u16 {
        2
    }

    fn ext_param(&self, index: u16) -> Option<(&str, ExtValue<'_>)> {
        match index {
            0 => Some(("CAM_ISO", ExtValue::U32(self.mode))),
            1 => Some(("CAM_WBMODE", ExtValue::U8(u8::from(self.armed)))),
            _ => None,
        }
    }

    fn set_ext_param(&mut self, _: &mut Context<'_>, index: u16, value: ExtValue<'_>, _: Peer) -> ParamAck {
        match (index, value) {
            (0, ExtValue::U32(iso)) => self.mode = iso,
            (1, ExtValue::U8(mode)) => self.armed = mode != 0,
            _ => return ParamAck::VALUE_UNSUPPORTED,
        }
        ParamAck::ACCEPTED
    }
}

#[cfg(feature = "mission")]
impl Plans for Rover {
    const MISSION_COMMANDS: &'static [CommandRule] = &[rules::NAV_WAYPOINT];

    fn plan_changed(&mut self, _: &mut Context<'_>, _: PlanChange<'_>) {}

    fn progress(&self) -> Progress {
        Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
    }
}

#[cfg(all(feature = "parameters", not(feature = "parameters-external")))]
impl Parameters for Rover {
    type Table = Tuning;
}

#[cfg(feature = "queues")]
static QUEUES: io::SerialQueues<64, 64> = io::SerialQueues::new();

/// Simulates the UART's interrupt.
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
    static STACK: Vacant<StackOf<Mavlink>> = Vacant::new(StackOf::<Mavlink>::VACANT);
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
    let rover = ROVER.put(Rover {
        armed: false,
        mode: 0,
        #[cfg(feature = "parameters-external")]
        values: [0; 8],
    });
    let stack = STACK.take();
    stack.begin(CONFIG, CONFIGS);
    #[cfg(feature = "parameters-run-time")]
    for setting in &SETTINGS {
        let _ = info(setting).map(|info| stack.parameters_mut().add(info));
    }
    #[cfg(feature = "setpoints")]
    stack.setpoints.set_source(ControlSource::GroundStation);
    #[cfg(feature = "manual")]
    stack.manual_input_mut().set_source(ControlSource::GroundStation);
    #[cfg(all(feature = "storage", not(feature = "store-fram")))]
    let mut store = {
        use mavstack_size::storage::Flash;
        Store::new(Flash, 0..Store::<Flash>::region_len::<Mavlink>())
    };
    #[cfg(feature = "store-fram")]
    let mut store = {
        use mavstack_fram::Fram;
        use mavstack_size::storage::Spi;
        let Ok(fram) = Fram::new(Spi) else {
            loop {
                core::hint::spin_loop();
            }
        };
        Store::new(fram, 0..Store::<Fram<Spi>>::region_len::<Mavlink>())
    };
    #[cfg(feature = "storage")]
    let _ = stack.restore(Instant::ZERO, &mut store, rover);
    loop {
        let now = Instant::from_micros(now_micros());
        PULSE.tick();
        #[cfg(feature = "client")]
        let _ = stack.send_command(Recipient::Type(MavType::GIMBAL), 1);
        #[cfg(any(feature = "events", feature = "events-checks"))]
        stack.event(now, &BatteryLow { voltage: 10.5 });
        #[cfg(feature = "messages")]
        let _ = stack.send::<Tunnel>(Destination::All, 0);
        #[cfg(feature = "setpoints")]
        {
            rover.armed ^= stack.setpoints.current(now).is_some_and(|setpoint| setpoint.time_boot_ms == 7);
        }
        #[cfg(feature = "gimbal-manager")]
        {
            let item = Item::default();
            let result = stack.with_services(now, rover, |services, cx| services.gimbal_manager.point(cx, &item));
            rover.armed ^= result == MavResult::ACCEPTED;
        }
        #[cfg(feature = "texts")]
        stack.text(now, MavSeverity::INFO, "started");
        #[cfg(feature = "time")]
        {
            stack.time.ask(LinkId(0));
            rover.armed ^= stack.time.take_sample().is_some();
        }
        #[cfg(feature = "commands-long")]
        stack.long_commands_mut().finish(MavCmd::NAV_TAKEOFF, MavResult::ACCEPTED);
        #[cfg(feature = "high-latency")]
        stack.high_latency.sample(now, &HighLatencySample::UNKNOWN);
        stack.poll(now, rover);
        for link in 0..LINKS as u8 {
            let _ = stack.poll_link(now, LinkId(link), &mut uart, rover);
        }
        #[cfg(feature = "storage")]
        stack.persist(now, &mut store, rover);
    }
}
