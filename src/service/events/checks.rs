//! Health and arming checks: a report of everything that prevents arming, as events.
//!
//! Implements the sender's side of libevents' protocol `health_and_arming_check` (EVT-6, EVT-7), as PX4 does
//! (`src/modules/commander/HealthAndArmingChecks`). A report is a summary of arming, the failing checks, and a summary
//! of health:
//!
//! ```text
//!   arming_check_summary ─ check ─ check ─ … ─ health_summary
//! ```
//!
//! The first summary depends on the checks after it, so the stack asks the vehicle twice: first for the summary, then
//! for the events. A report therefore takes no memory besides the history.

use core::fmt;
use core::num::Saturating;

use super::declaration::{
    ArgumentInfo, Check, CheckBits, CheckSet, EventGroup, EventInfo, EventSet, FNV1A_BASIS, LogLevel, fnv1a,
};
use crate::dialect::{MavCmd, MavResult};
use crate::message::FieldWriter;
use crate::service::{Cx, increment};
use crate::time::{Duration, Instant};
use crate::types::{Context, EventEntry, EventLog, Firmware, MAX_EVENT_ARGUMENTS};

/// The interval at which the vehicle is asked for its checks.
const PERIOD: Duration = Duration::from_millis(500);

/// The shortest time between two reports, as in PX4.
const REPORT_INTERVAL: Duration = Duration::from_secs(2);

/// The events of a report besides its checks.
const SUMMARIES: usize = 2;

/// The arming checks, for a vehicle that declares `events: { history: N, checks }` in [`#[stack]`](macro@crate::Stack).
///
/// The stack calls the hook twice a second. It reports the result as events when it has changed, and when a peer is
/// heard on a link that was opened, and on MAV_CMD_RUN_PREARM_CHECKS, which QGroundControl and MAVSDK send when they
/// connect. Reports come at most every two seconds, so that requests leave the other events in the history (X-2). The ground
/// station then shows the failing checks, and the flight modes in which the vehicle can arm (EVT-6).
///
/// ```
/// # use mavstack::prelude::*;
/// # use mavstack::events;
/// # struct Rover { voltage: f32, has_fix: bool, satellites: u8 }
/// mavstack::events! {
///     /// The events of this rover.
///     pub struct RoverEvents in "rover" {
///         modes ModeGroups { /** Manual */ MANUAL = [1], /** Automatic */ AUTO = [4, 5] }
///         components Health { /** Battery */ BATTERY, /** GPS */ GPS }
///         arming_checks {
///             BatteryLow(Error) { voltage: f32 } = "Battery too low: {3:.1} V";
///             NoFix(Error) { satellites: u8 } = "No GPS fix, {3} satellites";
///         }
///     }
/// }
///
/// impl HealthChecks for Rover {
///     type Events = RoverEvents;
///
///     fn checks(&self, _: &Context<'_>, report: &mut events::HealthReport<'_>) {
///         report.present(Health::BATTERY | Health::GPS);
///         if self.voltage < 10.5 {
///             let check = BatteryLow { voltage: self.voltage };
///             report.fails(ModeGroups::MANUAL | ModeGroups::AUTO, Health::BATTERY, &check);
///         }
///         if !self.has_fix {
///             report.fails(ModeGroups::AUTO, Health::GPS, &NoFix { satellites: self.satellites });
///         }
///     }
/// }
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `HealthChecks`",
    note = "`checks` in `events` of `#[stack]` needs `impl HealthChecks for {Self}`: write it, or leave `checks` out"
)]
pub trait HealthChecks {
    /// The set of events that [`events!`](crate::events!) declared with `modes` and `components`.
    type Events: CheckSet;

    /// Reports the components that are present, and the checks that fail. Called twice for a report, and whenever the
    /// stack looks for changes. It must have no effect, and report the same for the same time. `cx` has the parameters
    /// and the live plans.
    fn checks(&self, cx: &Context<'_>, report: &mut HealthReport<'_>);

    /// Returns the result of MAV_CMD_RUN_PREARM_CHECKS, ACCEPTED by default; the report is sent in any case. Override
    /// it to also send a text, or to refuse the command while armed.
    fn run_checks(&mut self, cx: &mut Context<'_>) -> MavResult {
        let _ = cx;
        MavResult::ACCEPTED
    }
}

/// The content of a summary. Initially all zero bits.
#[derive(Clone, Copy, Debug, Default)]
struct Summary {
    /// Groups of modes.
    cannot_arm: u32,
    cannot_run: u32,
    /// Components.
    present: u32,
    arming: Marks,
    health: Marks,
}

/// Components with an error or a warning.
#[derive(Clone, Copy, Debug, Default)]
struct Marks {
    error: u32,
    warning: u32,
}

/// A report of the checks, which [`HealthChecks::checks`] fills.
pub struct HealthReport<'a> {
    summary: Summary,
    /// A hash of the report, without the checks' own arguments.
    hash: u32,
    now: Instant,
    /// Where the events are recorded; `None` while only the summary is computed.
    recording: Option<Recording<'a>>,
    /// The number of checks that did not fit.
    left_out: u32,
}

/// The history, and how many more checks fit into it.
struct Recording<'a> {
    log: &'a mut EventLog,
    room: Saturating<usize>,
}

impl<'a> HealthReport<'a> {
    fn new(now: Instant, recording: Option<Recording<'a>>) -> Self {
        Self { summary: Summary::default(), hash: FNV1A_BASIS, now, recording, left_out: 0 }
    }

    /// Returns the report of a vehicle without sending it: for example to decide about a command to arm.
    pub fn of<V: HealthChecks>(vehicle: &V, cx: &Context<'_>) -> Self {
        let mut report = Self::new(cx.now(), None);
        vehicle.checks(cx, &mut report);
        report
    }

    /// Reports that components exist.
    pub fn present(&mut self, components: impl CheckBits) {
        self.summary.present |= components.bits();
    }

    /// Reports that a check fails: the vehicle cannot arm in `modes`. With `EMPTY` it can arm in all modes, and the
    /// check is shown for all. `component` is one component, or `NONE`. A level of `Error` or above marks it as failed,
    /// `Warning` marks it with a warning.
    pub fn fails<C: Check>(
        &mut self,
        modes: <C::Set as CheckSet>::Modes,
        component: <C::Set as CheckSet>::Components,
        check: &C,
    ) {
        let (modes, component) = (modes.bits(), component.bits());
        let shown = if modes == 0 { <C::Set as CheckSet>::ALL_MODES } else { modes };
        self.summary.cannot_arm |= modes;
        let (id, levels) = const { (C::INFO.id, C::INFO.log_levels) };
        let mut event = EventEntry::new(self.now, id, levels);
        let mut out = FieldWriter::new(&mut event.arguments);
        out.push(shown);
        // The component's number is 0 for none, which is also the bit of `NONE`.
        out.push(u8::try_from(component.checked_ilog2().unwrap_or(0)).unwrap_or(0));
        check.write(&mut out);
        self.add(&event, component, const { matches!(C::INFO.group, EventGroup::Health) });
    }

    /// Reports that the vehicle, while armed, cannot switch to `modes` or continue in them.
    pub fn cannot_run(&mut self, modes: impl CheckBits) {
        self.summary.cannot_run |= modes.bits();
    }

    /// Whether the vehicle can arm in all of `modes`, as far as this report says.
    pub fn can_arm(&self, modes: impl CheckBits) -> bool {
        self.summary.cannot_arm & modes.bits() == 0
    }

    fn add(&mut self, event: &EventEntry, component: u32, is_health: bool) {
        let Summary { arming, health, .. } = &mut self.summary;
        let marks = if is_health { health } else { arming };
        // The lowest bit is none.
        let component = component & !1;
        match event.log_levels & 0x0F {
            0..=3 => marks.error |= component,
            4 => marks.warning |= component,
            _ => {}
        }
        let [a, b, c, d, part, ..] = event.arguments;
        self.add_to_hash([event.id, u32::from_le_bytes([a, b, c, d]), u32::from(part)]);
        match &mut self.recording {
            Some(Recording { log, room }) if room.0 > 0 => {
                *room -= 1;
                log.push(event);
            }
            Some(_) => increment(&mut self.left_out),
            None => {}
        }
    }

    fn add_to_hash(&mut self, numbers: [u32; 3]) {
        self.hash = numbers.iter().flat_map(|number| number.to_le_bytes()).fold(self.hash, fnv1a);
    }
}

impl fmt::Debug for HealthReport<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("HealthReport").field("summary", &self.summary).finish_non_exhaustive()
    }
}

/// Records a summary: a chunk's number and the masks.
fn summarize(log: &mut EventLog, now: Instant, id: u32, levels: u8, masks: &[u32]) {
    let mut event = EventEntry::new(now, id, levels);
    let mut out = FieldWriter::new(&mut event.arguments);
    out.push(0_u8);
    for mask in masks {
        out.push(*mask);
    }
    log.push(&event);
}

/// Returns the declaration of a summary.
#[doc(hidden)]
pub const fn summary<S: CheckSet>(is_arming: bool) -> EventInfo {
    let levels = [LogLevel::Protocol; 2];
    let new = if is_arming {
        EventInfo::new(<S as EventSet>::COMPONENT, "ArmingCheckSummary", EventGroup::ArmingCheck, levels)
    } else {
        EventInfo::new(<S as EventSet>::COMPONENT, "HealthSummary", EventGroup::Health, levels)
    };
    if is_arming {
        new.with("Arming checks", "", const { &arming_arguments::<S>() }).summary()
    } else {
        new.with("Health", "", const { &health_arguments::<S>() }).summary()
    }
}

const fn arming_arguments<S: CheckSet>() -> [ArgumentInfo; 5] {
    [
        ArgumentInfo::new::<u8>("chunk_idx", ""),
        ArgumentInfo::new::<S::Components>("error", ""),
        ArgumentInfo::new::<S::Components>("warning", ""),
        ArgumentInfo::new::<S::Modes>("can_arm", ""),
        ArgumentInfo::new::<S::Modes>("can_run", ""),
    ]
}

const fn health_arguments<S: CheckSet>() -> [ArgumentInfo; 4] {
    [
        ArgumentInfo::new::<u8>("chunk_idx", ""),
        ArgumentInfo::new::<S::Components>("is_present", ""),
        ArgumentInfo::new::<S::Components>("error", ""),
        ArgumentInfo::new::<S::Components>("warning", ""),
    ]
}

/// The service's handling of checks.
#[doc(hidden)]
pub trait Checker<F: Firmware>: fmt::Debug {
    const NEW: Self;

    /// Reports the checks if they have changed. Returns the number of checks that did not fit.
    fn poll(&mut self, cx: &mut Cx<'_, F>) -> u32 {
        let _ = cx;
        0
    }

    fn deadline(&self) -> Instant {
        Instant::NEVER
    }

    fn on_command(&mut self, cx: &mut Cx<'_, F>, command: MavCmd) -> Option<MavResult> {
        let _ = (cx, command);
        None
    }

    /// Reports the checks again soon: a link was opened, or a peer has requested it.
    fn repeat(&mut self) {}
}

/// Without checks. `N`: the length of the history.
#[derive(Debug)]
pub struct Unchecked<const N: usize>;

impl<const N: usize, F: Firmware> Checker<F> for Unchecked<N> {
    const NEW: Self = {
        assert!(N > 0, "the history of events has at least one: `events: {{ history: 16 }}`");
        Self
    };
}

/// Reports the checks. Initially all zero bits. `N`: the length of the history.
#[derive(Debug)]
pub struct Checking<const N: usize> {
    /// When to ask the vehicle next.
    at: Instant,
    reported_at: Instant,
    next_report: NextReport,
}

/// When the checks are reported again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum NextReport {
    /// Without waiting.
    AtOnce,
    /// Not within [`REPORT_INTERVAL`].
    Soon,
    /// As `Soon`, once the hash of the report is not this one.
    OnChange(u32),
}

impl<const N: usize, F: Firmware<Vehicle: HealthChecks>> Checker<F> for Checking<N> {
    const NEW: Self = {
        assert!(
            N >= 8,
            "with `checks`, the history has at least 8 events, because it holds a whole report: `events: {{ history: 16, checks }}`"
        );
        Self { at: Instant::ZERO, reported_at: Instant::ZERO, next_report: NextReport::AtOnce }
    };

    fn poll(&mut self, cx: &mut Cx<'_, F>) -> u32 {
        let now = cx.now;
        if now < self.at {
            return 0;
        }
        self.at = now + PERIOD;
        let (vehicle, context) = cx.hook();
        let mut report = HealthReport::of(vehicle, &context);
        let Summary { cannot_arm, cannot_run, present, arming, health } = report.summary;
        report.add_to_hash([cannot_arm, cannot_run, present]);
        let unchanged = NextReport::OnChange(report.hash);
        let is_due = self.next_report != unchanged && now >= self.reported_at + REPORT_INTERVAL;
        if !is_due && self.next_report != NextReport::AtOnce {
            return 0;
        }
        self.next_report = unchanged;
        self.reported_at = now;
        let all = <<F::Vehicle as HealthChecks>::Events as CheckSet>::ALL_MODES;
        let (can_arm, can_run) = (all & !cannot_arm, all & !cannot_run);
        let (id, levels) = const {
            let info = <<F::Vehicle as HealthChecks>::Events as CheckSet>::ARMING_SUMMARY;
            (info.id, info.log_levels)
        };
        summarize(cx.events, now, id, levels, &[arming.error, arming.warning, can_arm, can_run]);
        let (vehicle, mut context) = cx.hook();
        // The report has the history: the hook describes the vehicle, and records no other events.
        let mut none = EventLog::<[EventEntry; 0]>::EMPTY;
        let log = core::mem::replace::<&mut EventLog>(&mut context.events, &mut none);
        let room = Saturating(log.capacity()) - Saturating(SUMMARIES);
        let mut report = HealthReport::new(now, Some(Recording { log, room }));
        vehicle.checks(&context, &mut report);
        let left_out = report.left_out;
        let (id, levels) = const {
            let info = <<F::Vehicle as HealthChecks>::Events as CheckSet>::HEALTH_SUMMARY;
            (info.id, info.log_levels)
        };
        summarize(cx.events, now, id, levels, &[present, health.error, health.warning]);
        left_out
    }

    fn deadline(&self) -> Instant {
        self.at
    }

    fn on_command(&mut self, cx: &mut Cx<'_, F>, command: MavCmd) -> Option<MavResult> {
        if command != MavCmd::RUN_PREARM_CHECKS {
            return None;
        }
        Checker::<F>::repeat(self);
        self.at = self.at.min(self.reported_at + REPORT_INTERVAL);
        let (vehicle, mut context) = cx.hook();
        Some(vehicle.run_checks(&mut context))
    }

    fn repeat(&mut self) {
        if self.next_report != NextReport::AtOnce {
            self.next_report = NextReport::Soon;
        }
    }
}

/// The size of the arguments that every check has: the modes and the component.
const _: () = assert!(MAX_EVENT_ARGUMENTS - size_of::<u32>() - size_of::<u8>() == 20, "documented at `events!`");
