//! A small vehicle that a ground station shows as ready. All boards share it. Copy it, and replace the parts marked "Your …".
//!
//! | QGroundControl needs | here |
//! |---|---|
//! | heartbeats, armed or not, the mode | `Vehicle`, `Modes` |
//! | at least one parameter | `parameters!` |
//! | battery, attitude, position, home | `Telemetry`, by the types of `mavstack::telemetry` |
//! | "ready": the pre-arm check | `Rover::sys_status` |
//! | a mission | `Plans`; boards with a flash driver store it, with the parameters |
//! | a joystick | mode Manual; the pilot's receiver, ExpressLRS or mLRS in MAVLink mode, takes precedence |
//! | a failsafe | `Rover::drive`: the rover drives a mission only while a ground station is alive, and manually only with sticks |
#![no_std]
#![forbid(unsafe_code)]

use mavstack::config::Identity;
use mavstack::dialect::commands::ComponentArmDisarm;
use mavstack::dialect::rules::{NAV_RETURN_TO_LAUNCH, NAV_WAYPOINT};
use mavstack::dialect::*;
use mavstack::manual_control::{ControlSource, ManualControlInput, RcOverride};
use mavstack::message::Item;
use mavstack::plan::Durability;
use mavstack::prelude::*;
use mavstack::telemetry::{Battery, Geofence, GpsFix, Home, Motion};
use mavstack::{firmware_version, parameters};

/// Ticked by the driving loop. When the loop hangs, the heartbeats stop.
pub static PULSE: Pulse = Pulse::new();

/// The configuration: a rover with component id 1. Its system id is the parameter SYS_ID.
pub const CONFIG: Config = config(&PULSE);

/// Returns the configuration with another pulse. Tests run in threads, and each has its own.
pub const fn config(pulse: &'static Pulse) -> Config {
    Config {
        r#type: MavType::GROUND_ROVER,
        // Ground stations show the version of your crate. Your board's version and unique number belong here too.
        identity: Identity { flight_sw_version: firmware_version!(), ..Identity::NONE },
        // An erase of internal flash may take longer than a ground station waits for the answer to an upload.
        durability: Durability::Deferred,
        ..Config::new(Address::new(1, 1), pulse)
    }
}

/// The number of links: your board has one, or two.
pub const LINKS: usize = if cfg!(feature = "two-links") { 2 } else { 1 };

/// A mission item takes 32 bytes, and uploads need a second copy.
#[derive(Stack)]
#[stack(
    vehicle: Rover,
    links: LINKS,
    plans: { mission: if cfg!(feature = "small") { 32 } else { 100 } },
    parameters: Tuning,
    streams,
    modes,
    manual_control,
    storage,
)]
pub struct Mavlink;

parameters! {
    /// The parameters, in ASCII order.
    pub struct Tuning {
        /// Least battery voltage for arming; an unknown one is too low. 0 disables the check.
        BAT_V_LOW: f32 = 0.0, 0.0..=60.0, "V";
        /// Action when the last ground station is lost.
        FS_GCS_ENABLE: i32 = 1, 0..=1, "" { values: { 0 => "None", 1 => "Hold" } };
        /// Maximum speed.
        SPEED_MAX: f32 = 2.0, 0.1..=10.0, "m/s";
        /// MAVLink system id: each vehicle of a ground station has its own.
        SYS_ID: i32 = 1, 1..=254, "" { system_id };
    }
}

/// The modes: sub-modes of PX4's AUTO, because MAVSDK requests PX4's modes from every autopilot that it does not know.
pub const HOLD: u32 = 4 << 16 | 3 << 24;
/// Drives the mission.
pub const MISSION: u32 = 4 << 16 | 4 << 24;
/// The pilot steers.
pub const MANUAL: u32 = 3 << 16;

/// The pilot's receiver, on the first link: ExpressLRS, or mLRS that sends RC_CHANNELS_OVERRIDE; and mLRS that sends
/// RADIO_RC_CHANNELS. One UART carries sticks and telemetry.
pub const RECEIVERS: [Peer; 2] =
    [Peer { address: Address::new(255, 68), link: LinkId(0) }, Peer { address: Address::new(51, 68), link: LinkId(0) }];

/// Forward and right, each -1000 to 1000.
pub type Sticks = [i16; 2];

/// A rover. The board writes the sensor values, in SI units. Unknown values stay `UNKNOWN`, and are sent as "unknown".
#[derive(Debug)]
pub struct Rover {
    /// Your position, velocity and attitude.
    pub motion: Motion,
    /// Your GNSS receiver.
    pub gps: GpsFix,
    /// Your home position, such as the place of the first fix.
    pub home: Option<Home>,
    /// Your battery.
    pub battery: Battery<'static>,
    pulse: &'static Pulse,
    armed: bool,
    mode: u32,
    sticks: Option<Sticks>,
    current: u16,
    is_complete: bool,
    has_station: bool,
    is_station_lost: bool,
    is_battery_low: bool,
    is_restored: bool,
}

impl Default for Rover {
    fn default() -> Self {
        Self::new(&PULSE)
    }
}

impl Rover {
    /// Creates a rover with the pulse of its configuration.
    pub const fn new(pulse: &'static Pulse) -> Self {
        Self {
            motion: Motion::UNKNOWN,
            gps: GpsFix::UNKNOWN,
            home: None,
            battery: Battery::UNKNOWN,
            pulse,
            armed: false,
            mode: HOLD,
            sticks: None,
            current: 0,
            is_complete: false,
            has_station: false,
            is_station_lost: false,
            is_battery_low: false,
            is_restored: false,
        }
    }

    /// Runs one pass of the driving loop, and ticks the pulse.
    pub fn drive(&mut self, now: Instant, stack: &mut StackOf<Mavlink>) {
        let (minimum, voltage) = (stack.parameters().get(Tuning::BAT_V_LOW), self.battery.total_voltage());
        // An unknown voltage is not a sufficient one, and an unreadable plan is not an empty one.
        self.is_battery_low = minimum > 0.0 && !(voltage.is_finite() && voltage >= minimum);
        self.is_restored = stack.restore_errors().is_empty();
        self.read_sticks(now, stack);
        self.has_station = stack.parameters().get(Tuning::FS_GCS_ENABLE) == 0 || stack.has_ground_station(now);
        // A pilot with a receiver needs no ground station.
        let is_lost = self.armed && self.mode != MANUAL && !self.has_station;
        if is_lost && !self.is_station_lost {
            self.mode = HOLD;
            stack.text(now, MavSeverity::CRITICAL, "Ground station lost: holding");
        }
        self.is_station_lost = is_lost;
        let limit = stack.parameters().get(Tuning::SPEED_MAX);
        let _ = (self.target(stack), self.sticks(), limit); // Your navigation and motors; call `self.reached(now, stack)` at the item.
        self.pulse.tick();
    }

    /// Reads the sticks of the pilot's receiver, or of a joystick while it is silent. Without either the rover holds.
    fn read_sticks(&mut self, now: Instant, stack: &mut StackOf<Mavlink>) {
        let input = stack.manual_input_mut();
        input.set_receivers(&RECEIVERS);
        input.set_source(ControlSource::GroundStation);
        let channels = || input.rc_channels(now).and_then(|channels| of_channels(&channels));
        self.sticks = input.manual_control(now).map(|axes| of_axes(&axes)).or_else(channels);
        if self.mode == MANUAL && self.sticks.is_none() {
            self.mode = HOLD;
            stack.text(now, MavSeverity::CRITICAL, "Sticks lost: holding");
        }
    }

    /// Returns where the pilot steers; `None` to stop, or to drive the mission.
    pub fn sticks(&self) -> Option<Sticks> {
        self.sticks.filter(|_| self.armed && self.mode == MANUAL)
    }

    /// Returns the mission item to drive to; `None` to stop.
    pub fn target<'a>(&self, stack: &'a StackOf<Mavlink>) -> Option<&'a Item> {
        let is_driving = self.armed && self.mode == MISSION && !self.is_station_lost;
        stack.mission().items().get(usize::from(self.current)).filter(|_| is_driving)
    }

    /// Reports that the current item is reached, and continues with the next. After the last one the rover holds.
    pub fn reached(&mut self, now: Instant, stack: &mut StackOf<Mavlink>) {
        stack.mission_item_reached(now, self.current);
        if usize::from(self.current) + 1 < stack.mission().items().len() {
            self.current += 1;
        } else {
            (self.is_complete, self.mode) = (true, HOLD);
        }
    }

    /// QGroundControl shows "ready" if the pre-arm check is present, enabled and healthy.
    fn sys_status(&self) -> SysStatus {
        use MavSysStatusSensor as Sensor;
        let present = Sensor::PREARM_CHECK | Sensor::SENSOR_BATTERY;
        let health = match (self.is_battery_low, self.is_restored) {
            (false, true) => present,
            (false, false) => Sensor::SENSOR_BATTERY,
            (true, _) => Sensor::EMPTY,
        };
        SysStatus {
            onboard_control_sensors_present: present,
            onboard_control_sensors_enabled: present,
            onboard_control_sensors_health: health,
            ..self.battery.sys_status(0.0)
        }
        .with_geofence(Geofence::Absent)
    }
}

/// A joystick: forward is `x`, right is `y`.
fn of_axes(axes: &ManualControlInput) -> Sticks {
    [axes.x.unwrap_or(0), axes.y.unwrap_or(0)]
}

/// Radio channels in ArduPilot's order: 1 is right, 2 is forward, and low is forward. `None` if one is not given.
fn of_channels(channels: &RcOverride) -> Option<Sticks> {
    let stick = |number| channels.channel(number).map(|pulse| pulse.clamp(1_000, 2_000).cast_signed() * 2 - 3_000);
    Some([-stick(2)?, stick(1)?])
}

impl Vehicle for Rover {
    fn state(&self) -> Option<VehicleState> {
        let state = VehicleState::new(self.armed).with_mode(self.mode);
        Some(if self.is_station_lost { state.with_status(MavState::CRITICAL) } else { state })
    }

    /// The request for mode Manual may be right behind the first sticks.
    fn control_input(&mut self, _: &mut Context<'_>, input: &ControlInput) {
        match input {
            ControlInput::Sticks(axes) => self.sticks = Some(of_axes(axes)),
            // A joystick's axes take precedence, as in `read_sticks`.
            ControlInput::Channels(channels) => self.sticks = self.sticks.or_else(|| of_channels(channels)),
            _ => {}
        }
    }
}

impl Commands for Rover {
    fn command(&mut self, cx: &mut Context<'_>, command: &Command) -> Outcome {
        let arm = match command.decode() {
            Ok(ComponentArmDisarm { arm, .. }) if !command.is_broadcast => arm,
            Ok(_) => return MavResult::DENIED.into(),
            Err(result) => return result.into(), // UNSUPPORTED: another command. DENIED: invalid parameters.
        };
        if arm && (self.is_battery_low || !self.is_restored) {
            cx.text(MavSeverity::WARNING, "Not armed: battery low or unknown, or stored data unreadable");
            return MavResult::DENIED.into();
        }
        self.armed = arm;
        MavResult::ACCEPTED.into()
    }
}

impl Modes for Rover {
    const MODES: &'static [FlightMode] = &[
        FlightMode::new(HOLD, "Hold").with_properties(MavModeProperty::AUTO_MODE),
        FlightMode::new(MISSION, "Mission").with_standard_mode(MavStandardMode::MISSION),
        FlightMode::new(MANUAL, "Manual"),
    ];
    const CUSTOM_MODE: CustomMode = CustomMode::MainSub;

    fn set_mode(&mut self, cx: &mut Context<'_>, mode: &'static FlightMode, _: &ModeRequest) -> Outcome {
        if mode.custom_mode == MISSION && cx.plan(PlanType::Mission).items().is_empty() {
            cx.text(MavSeverity::WARNING, "No mission");
            return MavResult::DENIED.into();
        }
        if mode.custom_mode == MISSION && self.armed && !self.has_station {
            // It would hold at once: refuse a mode that will not be reported (C-18).
            cx.text(MavSeverity::WARNING, "No ground station");
            return MavResult::TEMPORARILY_REJECTED.into();
        }
        if mode.custom_mode == MANUAL && self.sticks.is_none() {
            cx.text(MavSeverity::WARNING, "No sticks");
            return MavResult::TEMPORARILY_REJECTED.into();
        }
        if mode.custom_mode == MISSION && self.is_complete {
            (self.current, self.is_complete) = (0, false);
        }
        self.mode = mode.custom_mode;
        MavResult::ACCEPTED.into()
    }
}

impl Plans for Rover {
    /// Uploads with other commands are refused.
    const MISSION_COMMANDS: &'static [CommandRule] = &[NAV_WAYPOINT, NAV_RETURN_TO_LAUNCH];

    fn plan_changed(&mut self, _: &mut Context<'_>, _: PlanChange<'_>) {
        (self.current, self.is_complete, self.mode) = (0, false, HOLD);
    }

    fn progress(&self) -> Progress {
        let state = match self.mode {
            _ if self.is_complete => MissionState::COMPLETE,
            MISSION => MissionState::ACTIVE,
            _ if self.current > 0 => MissionState::PAUSED,
            _ => MissionState::NOT_STARTED,
        };
        Progress { current: self.current, state, in_mission_mode: self.mode == MISSION }
    }

    fn set_current(&mut self, _: &mut Context<'_>, seq: u16, _: bool) -> MavResult {
        (self.current, self.is_complete) = (seq, false);
        MavResult::ACCEPTED
    }
}

impl Telemetry for Rover {
    const STREAMS: &'static [Stream] = &[
        Stream::of::<SysStatus>().every(Duration::from_secs(1)),
        Stream::of::<BatteryStatus>().every(Duration::from_secs(2)),
        Stream::of::<Attitude>().every(Duration::from_millis(250)),
        Stream::of::<GlobalPositionInt>().every(Duration::from_millis(500)),
        Stream::of::<GpsRawInt>().every(Duration::from_secs(1)),
        Stream::of::<VfrHud>().every(Duration::from_millis(500)),
        Stream::of::<HomePosition>().every(Duration::from_secs(5)),
    ];

    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
        let now = out.now();
        match id {
            SysStatus::ID => out.put(&self.sys_status()),
            BatteryStatus::ID => out.index() == 0 && out.put(&self.battery.battery_status()),
            Attitude::ID => out.put(&self.motion.attitude(now)),
            GlobalPositionInt::ID => self.motion.global_position_int(now).is_some_and(|position| out.put(&position)),
            GpsRawInt::ID => out.put(&self.gps.gps_raw_int(now)),
            VfrHud::ID => out.put(&self.motion.vfr_hud()),
            HomePosition::ID => self.home.is_some_and(|home| out.put(&home.home_position(now))),
            _ => false,
        }
    }
}

impl Parameters for Rover {
    type Table = Tuning;
}
