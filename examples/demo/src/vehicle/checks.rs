//! What the vehicle reports by events: its checks before arming, which also decide whether it arms, and what it does (EVT-6).

use mavstack::dialect::{MavResult, MavSeverity};
use mavstack::events::HealthReport;
use mavstack::{Context, HealthChecks};

use super::commands::refuse;
use super::{Mode, Quadrotor};
use crate::battery::Charge;
use crate::events::{
    Armed, BatteryLow, BatteryTooLow, Calibrating, DemoEvents, Disarmed, Health, Landed, ModeChanged, ModeGroups,
    ModeName, NoFix, OutsideFence, Terminated, TookOff,
};
use crate::tuning::Tuning;

/// All modes need the same.
const ALL: ModeGroups = ModeGroups::MANUAL.with(ModeGroups::OFFBOARD).with(ModeGroups::AUTOMATIC);

/// What prevents arming. The gravest is first: a text names only one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Problem {
    Terminated,
    Calibrating,
    NoFix,
    OutsideFence,
    BatteryTooLow,
}

impl Problem {
    const ALL: [Self; 5] = [Self::Terminated, Self::Calibrating, Self::NoFix, Self::OutsideFence, Self::BatteryTooLow];

    const fn text(self) -> &'static str {
        match self {
            Self::Terminated => "Arming refused: flight terminated",
            Self::Calibrating => "Arming refused: calibrating",
            Self::NoFix => "Arming refused: no GPS fix yet",
            Self::OutsideFence => "Arming refused: outside the fence",
            Self::BatteryTooLow => "Arming refused: battery low",
        }
    }
}

/// The state that was reported last.
#[derive(Clone, Copy, Debug)]
pub(super) struct Told {
    pub armed: bool,
    pub mode: Mode,
    pub is_in_air: bool,
}

impl HealthChecks for Quadrotor {
    type Events = DemoEvents;

    fn checks(&self, cx: &Context<'_>, report: &mut HealthReport<'_>) {
        report.present(Health::SYSTEM | Health::SENSORS | Health::GPS | Health::BATTERY);
        let remaining = self.percent();
        for problem in self.problems(cx) {
            match problem {
                Problem::Terminated => report.fails(ALL, Health::SYSTEM, &Terminated),
                Problem::Calibrating => report.fails(ALL, Health::SENSORS, &Calibrating),
                Problem::NoFix => {
                    let satellites = cx.parameter(Tuning::SIM_GPS_SATS) as u8;
                    report.fails(ALL, Health::GPS, &NoFix { satellites });
                }
                Problem::OutsideFence => report.fails(ALL, Health::NONE, &OutsideFence),
                Problem::BatteryTooLow => report.fails(ALL, Health::BATTERY, &BatteryTooLow { remaining }),
            }
        }
        if self.battery.is_low() {
            report.fails(ModeGroups::EMPTY, Health::BATTERY, &BatteryLow { remaining });
        }
    }

    /// Sends a text too, which says whether the vehicle can arm.
    fn run_checks(&mut self, cx: &mut Context<'_>) -> MavResult {
        match self.check_arming(cx) {
            _ if self.armed => return refuse(cx, MavResult::TEMPORARILY_REJECTED, "Checks refused: armed"),
            Ok(()) => cx.text(MavSeverity::INFO, "Ready to arm"),
            Err(why) => cx.text(MavSeverity::WARNING, why),
        }
        MavResult::ACCEPTED
    }
}

impl Quadrotor {
    /// Returns the reason that prevents arming, if any.
    pub(crate) fn check_arming(&self, cx: &Context<'_>) -> Result<(), &'static str> {
        self.problems(cx).next().map_or(Ok(()), |problem| Err(problem.text()))
    }

    /// Returns all that prevents arming.
    fn problems(&self, cx: &Context<'_>) -> impl Iterator<Item = Problem> {
        Problem::ALL.into_iter().filter(|problem| self.has(cx, *problem))
    }

    #[inline(never)]
    fn has(&self, cx: &Context<'_>, problem: Problem) -> bool {
        match problem {
            Problem::Terminated => self.is_terminated,
            Problem::Calibrating => self.is_calibrating(),
            Problem::NoFix => !self.last.has_fix && cx.parameter(Tuning::COM_ARM_WO_GPS) == 0,
            Problem::OutsideFence => self.is_outside,
            // In flight the vehicle only reacts when the battery becomes critical, so it must not take off with a critical one.
            Problem::BatteryTooLow => {
                let is_spent = self.battery.charge == Charge::Critical && cx.parameter(Tuning::COM_LOW_BAT_ACT) != 0;
                self.battery.remaining < cx.parameter(Tuning::COM_ARM_BAT_MIN) || is_spent
            }
        }
    }

    /// Returns the charge of the battery in percent.
    fn percent(&self) -> u8 {
        (self.battery.remaining * 100.0) as u8
    }

    /// Records what has changed since the last call.
    #[inline(never)]
    pub(super) fn record_events(&mut self, cx: &mut Context<'_>) {
        let before = self.told;
        self.told = Told { armed: self.armed, mode: self.mode, is_in_air: self.is_in_air };
        let mode = name(self.mode);
        if self.armed && !before.armed {
            cx.event(&Armed { mode });
        }
        if self.mode != before.mode {
            cx.event(&ModeChanged { mode, intended: u8::from(self.mode == self.intended) });
        }
        if self.is_in_air && !before.is_in_air {
            cx.event(&TookOff);
        }
        if !self.is_in_air && before.is_in_air {
            let flown = (self.times.landed - self.times.took_off).as_millis() / 1_000;
            cx.event(&Landed { flown: u32::try_from(flown).unwrap_or(u32::MAX), battery: self.percent() });
        }
        if !self.armed && before.armed {
            cx.event(&Disarmed);
        }
    }
}

const fn name(mode: Mode) -> ModeName {
    match mode {
        Mode::Position => ModeName::POSITION,
        Mode::Offboard => ModeName::OFFBOARD,
        Mode::Takeoff => ModeName::TAKEOFF,
        Mode::Hold => ModeName::HOLD,
        Mode::Mission => ModeName::MISSION,
        Mode::Return => ModeName::RETURN,
        Mode::Land => ModeName::LAND,
    }
}
