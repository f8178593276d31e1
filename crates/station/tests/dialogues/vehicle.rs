//! A vehicle with every service that the core's dialogues use.

use std::collections::BTreeMap;

use mavstack::dialect::commands::{ComponentArmDisarm, NavTakeoff};
use mavstack::dialect::rules::{DO_CHANGE_SPEED, DO_JUMP, NAV_LAND, NAV_TAKEOFF, NAV_WAYPOINT};
use mavstack::dialect::{Attitude, MavCmd, MavDataStream, MavMissionResult, MavStandardMode, MissionState};
use mavstack::parameters;
use mavstack::prelude::*;
use mavstack_station::Client;
use mavstack_station::kit::{self, Board, LineConfig, Port, Rig};

parameters! {
    /// More parameters than a batch of any client.
    pub struct Tuning {
        A_ACC: f32 = 1.0, 0.0..=9.0, "";
        A_GAIN: f32 = 2.0, 0.0..=9.0, "";
        B_ACC: f32 = 3.0, 0.0..=9.0, "";
        B_GAIN: f32 = 4.0, 0.0..=9.0, "";
        CRUISE: f32 = 5.0, 0.5..=20.0, "m/s";
        C_ACC: f32 = 1.5, 0.0..=9.0, "";
        C_GAIN: f32 = 2.5, 0.0..=9.0, "";
        D_ACC: f32 = 3.5, 0.0..=9.0, "";
        D_GAIN: f32 = 4.5, 0.0..=9.0, "";
        E_ACC: f32 = 0.1, 0.0..=9.0, "";
        E_GAIN: f32 = 0.2, 0.0..=9.0, "";
        FENCE_ACT: i32 = 1, 0..=4, "";
        F_ACC: f32 = 0.3, 0.0..=9.0, "";
        F_GAIN: f32 = 0.4, 0.0..=9.0, "";
        G_ACC: f32 = 0.5, 0.0..=9.0, "";
        G_GAIN: f32 = 0.6, 0.0..=9.0, "";
        H_ACC: f32 = 0.7, 0.0..=9.0, "";
        H_GAIN: f32 = 0.8, 0.0..=9.0, "";
        RTL_ALT: f32 = 30.0, 0.0..=120.0, "m";
        STARTS: u32 = 7, 0..=u32::MAX, "" { read_only };
        SYS_ID: u8 = 1, 1..=254, "";
        TRIM: i16 = -300, -1000..=1000, "";
    }
}

/// The stack with its services.
#[derive(mavstack::Stack)]
#[stack(
    vehicle: Copter,
    links: 1,
    plans: { mission: 60, fence: 20, rally: 10 },
    parameters: Tuning,
    streams,
    modes,
    commands: { slots: 2 },
    files: { sessions: 1 },
)]
pub struct Mavlink {
    pub time: mavstack::clock::Time,
}

/// A vehicle that records what it was told.
#[derive(Debug)]
pub struct Copter {
    pub armed: bool,
    pub mode: u32,
    /// Whether it accepts modes without entering them.
    pub ignores_modes: bool,
    pub current: u16,
    /// When the calibration ends.
    calibrated_at: Option<Instant>,
    is_cancelled: bool,
    /// How often each command was carried out.
    pub commands: BTreeMap<u16, u32>,
}

impl Vehicle for Copter {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(self.armed).with_mode(self.mode))
    }
}

impl Commands for Copter {
    fn command(&mut self, cx: &mut Context<'_>, command: &Command) -> Outcome {
        *self.commands.entry(command.id.0).or_default() += 1;
        if command.id == MavCmd::PREFLIGHT_CALIBRATION {
            let outcome = cx.start();
            self.calibrated_at = Some(cx.now() + Duration::from_secs(8));
            return outcome;
        }
        if let Ok(ComponentArmDisarm { arm, .. }) = command.decode() {
            self.armed = arm;
            return MavResult::ACCEPTED.into();
        }
        if let Ok(NavTakeoff { .. }) = command.decode() {
            if !self.armed {
                cx.text(MavSeverity::WARNING, "Takeoff refused: arm first");
                return MavResult::DENIED.into();
            }
            return MavResult::ACCEPTED.into();
        }
        if command.id == MavCmd::DO_REPOSITION { MavResult::ACCEPTED.into() } else { MavResult::UNSUPPORTED.into() }
    }

    fn cancel_command(&mut self, _: &mut Context<'_>, command: MavCmd, _: Peer) -> bool {
        self.is_cancelled = command == MavCmd::PREFLIGHT_CALIBRATION;
        self.is_cancelled
    }
}

impl Plans for Copter {
    const MISSION_COMMANDS: &'static [CommandRule] = &[NAV_TAKEOFF, NAV_WAYPOINT, NAV_LAND, DO_JUMP, DO_CHANGE_SPEED];

    fn may_change(&mut self, cx: &mut Context<'_>, plan: PlanType, _: Peer) -> Result<(), MavMissionResult> {
        if self.armed && plan == PlanType::Fence {
            cx.text(MavSeverity::WARNING, "Fence refused: disarm first");
            return Err(MavMissionResult::DENIED);
        }
        Ok(())
    }

    fn plan_changed(&mut self, _: &mut Context<'_>, change: PlanChange<'_>) {
        if change.plan == PlanType::Mission {
            self.current = change.first;
        }
    }

    fn progress(&self) -> Progress {
        Progress { current: self.current, state: MissionState::NOT_STARTED, in_mission_mode: false }
    }

    fn set_current(&mut self, _: &mut Context<'_>, seq: u16, _: bool) -> MavResult {
        self.current = seq;
        MavResult::ACCEPTED
    }
}

impl Parameters for Copter {
    type Table = Tuning;
}

impl Telemetry for Copter {
    const STREAMS: &'static [Stream] = &[Stream::of::<Attitude>().in_group(MavDataStream::EXTRA1)];

    fn fill(&mut self, _: u32, out: &mut Fill<'_>) -> bool {
        let time_boot_ms = out.now().time_boot_ms();
        out.put(&Attitude { time_boot_ms, yaw: 1.0, ..Attitude::default() })
    }
}

impl Modes for Copter {
    const MODES: &'static [FlightMode] = &[
        FlightMode::new(1, "Manual"),
        FlightMode::new(4, "Hold").with_standard_mode(MavStandardMode::POSITION_HOLD),
        FlightMode::new(6, "Return").with_standard_mode(MavStandardMode::SAFE_RECOVERY),
        FlightMode::new(9, "Follow"),
    ];

    fn set_mode(&mut self, cx: &mut Context<'_>, mode: &'static FlightMode, _: &ModeRequest) -> Outcome {
        if mode.custom_mode == 9 {
            cx.text(MavSeverity::WARNING, "Follow refused: nobody to follow");
            return MavResult::DENIED.into();
        }
        if !self.ignores_modes {
            self.mode = mode.custom_mode;
        }
        MavResult::ACCEPTED.into()
    }
}

impl Files for Copter {}

/// The vehicle in a rig.
pub struct Firmware {
    pub stack: Box<StackOf<Mavlink>>,
    pub vehicle: Copter,
    pulse: &'static Pulse,
}

impl Firmware {
    fn boot(_: &Board) -> Self {
        let pulse = kit::pulse();
        let config = Config::new(Address::new(1, 1), pulse);
        let vehicle = Copter {
            armed: false,
            mode: 1,
            ignores_modes: false,
            current: 0,
            calibrated_at: None,
            is_cancelled: false,
            commands: BTreeMap::new(),
        };
        let mut stack: Box<StackOf<Mavlink>> = Box::new(StackOf::<Mavlink>::VACANT);
        stack.begin(config, [LinkConfig::uart(115_200)]);
        Self { stack, vehicle, pulse }
    }
}

impl kit::Firmware for Firmware {
    fn fly(&mut self, now: Instant) {
        self.pulse.tick();
        let calibration = MavCmd::PREFLIGHT_CALIBRATION;
        if self.vehicle.is_cancelled {
            self.stack.long_commands_mut().finish(calibration, MavResult::CANCELLED);
            (self.vehicle.is_cancelled, self.vehicle.calibrated_at) = (false, None);
        }
        if let Some(end) = self.vehicle.calibrated_at {
            let left = (end - now).as_millis() / 80;
            self.stack.long_commands_mut().progress(calibration, 100 - left.min(100) as u8);
            if now >= end {
                self.stack.long_commands_mut().finish(calibration, MavResult::ACCEPTED);
                self.vehicle.calibrated_at = None;
            }
        }
    }

    fn poll(&mut self, now: Instant, ports: &mut [Port]) {
        self.stack.poll(now, &mut self.vehicle);
        for (link, port) in (0..).map(LinkId).zip(ports) {
            let _ = self.stack.poll_link(now, link, port, &mut self.vehicle);
        }
    }
}

/// Returns the vehicle on a UART of 115,200 bit/s that loses frames with this probability, each way.
pub fn rig(client: Client, loss: f64, seed: u64) -> Rig<Firmware> {
    on(LineConfig::uart(115_200).with_loss(loss), client, seed)
}

/// Returns the vehicle on another line.
pub fn on(line: LineConfig, client: Client, seed: u64) -> Rig<Firmware> {
    let rig = Rig::new(Firmware::boot).with_seed(seed).with_line(line, client);
    // Faults take simulated minutes: a slower loop saves real seconds.
    if line == LineConfig::uart(115_200) { rig } else { rig.with_pass(Duration::from_millis(5)) }
}

/// Does something as an operator does: again, at most `times` in all, until it succeeds.
pub fn persist<R, T>(
    rig: &mut R,
    times: u32,
    mut action: impl FnMut(&mut R) -> Result<T, mavstack_station::Failure>,
) -> T {
    let mut failures = Vec::new();
    for _ in 0..times {
        match action(rig) {
            Ok(result) => return result,
            Err(failure) => failures.push(failure.to_string()),
        }
    }
    panic!("{failures:?}")
}
