//! Executes the mission: selects the current item and waits for its conditions.
//!
//! Each NAV_ item is a leg: the vehicle flies it and reaches it once. The DO_ and CONDITION_ items before a leg are executed
//! in order at its beginning, unless a condition defers them. ArduPilot does the same. It is the only interpretation that
//! gives CONDITION_DISTANCE a meaning; PX4 accepts CONDITION_DELAY and CONDITION_DISTANCE but ignores them.
//!
//! When a leg ends before its conditions are met, ArduPilot drops the deferred items. This vehicle waits at the end of the
//! leg, so that every item is executed (M-73). DO_ items after the last leg are executed too.
//!
//! DO_JUMP items are counted in a table of [`JUMPS`] entries. A jump that has reached its repeat count is skipped from then
//! on, even inside an outer loop. The counters restart with a new plan, and with a reset of the mission.

use mavstack::dialect::{MavCmd, MavMissionResult, MavResult, MavSeverity, MissionState};
use mavstack::plan::PlanFault;
use mavstack::{Context, Duration, Instant, Item, PlanType, Plans};

use super::commands::refuse;
use super::{Mode, Quadrotor, disarm_delay};
use crate::body::{Nose, Vector};
use crate::plan::{self, Action, Condition, Maneuver, Situation};
use crate::tuning::Tuning;

/// Maximum number of DO_JUMP items in a plan.
pub const JUMPS: usize = 16;

/// The progress of the mission.
#[derive(Clone, Copy, Debug)]
pub struct Mission {
    /// The number of items in the live plan.
    count: u16,
    /// The last item to fly.
    last: u16,
    /// The current item: the leg's item, or an item before it that waits.
    current: u16,
    leg: Option<Leg>,
    /// When the condition at `current` began to wait.
    waiting: Option<Instant>,
    /// The leg's item was reported as reached. Stays set when the leg is flown again after a pause.
    is_reported: bool,
    /// The mission was flown to its end. It starts at the beginning the next time.
    is_complete: bool,
    jumps: Jumps,
    state: MissionState,
}

/// The execution of one NAV_ item.
#[derive(Clone, Copy, Debug)]
struct Leg {
    /// The item; `None` after the last leg.
    seq: Option<u16>,
    maneuver: Maneuver,
    /// How long to stay after the maneuver.
    stay: Duration,
    /// Heading after the maneuver (rad).
    yaw: Option<f32>,
    /// When the maneuver was done.
    done: Option<Instant>,
}

/// The next leg of the mission.
enum Ahead {
    Leg(u16),
    /// No leg up to the end.
    End,
    /// An endless loop without a leg.
    Loop,
}

/// How often each DO_JUMP was taken: its sequence number and count.
#[derive(Clone, Copy, Debug)]
struct Jumps([(u16, u16); JUMPS]);

impl Jumps {
    const NONE: Self = Self([(0, 0); JUMPS]);

    /// Executes the DO_JUMP `seq` and returns the next item.
    fn pass(&mut self, seq: u16, item: &Item) -> u16 {
        let [target, repeat, ..] = item.params;
        let is_taken = if repeat < 0.0 {
            true
        } else {
            // An entry with count 0 is free.
            let entry = self.0.iter_mut().find(|(of, count)| *of == seq || *count == 0);
            entry.is_some_and(|(of, count)| {
                let is_taken = f32::from(*count) < repeat && *count < u16::MAX;
                if is_taken {
                    (*of, *count) = (seq, *count + 1);
                }
                is_taken
            })
        };
        if is_taken { target as u16 } else { seq.saturating_add(1) }
    }
}

impl Mission {
    pub const NONE: Self = Self {
        count: 0,
        last: 0,
        current: 0,
        leg: None,
        waiting: None,
        is_reported: false,
        is_complete: false,
        jumps: Jumps::NONE,
        state: MissionState::NOT_STARTED,
    };

    /// Starts the plan, at `first`.
    fn restart(&mut self, first: u16) {
        self.go_to(first);
        self.last = self.count.saturating_sub(1);
        self.jumps = Jumps::NONE;
        self.state = MissionState::NOT_STARTED;
    }

    /// Continues at `seq`, with the jump counters unchanged.
    fn go_to(&mut self, seq: u16) {
        (self.current, self.leg, self.waiting) = (seq, None, None);
        (self.is_reported, self.is_complete) = (false, false);
    }

    /// Returns the current maneuver.
    pub fn maneuver(&self) -> Option<Maneuver> {
        self.leg.map(|leg| leg.maneuver)
    }

    /// Returns the destination of the current leg.
    pub fn leg_to(&self) -> Option<Vector> {
        self.leg.and_then(|leg| leg.to())
    }

    /// Pauses the mission. The current leg restarts on resume, but its item is not reported again.
    pub fn pause(&mut self) {
        *self = Self { leg: None, waiting: None, state: MissionState::PAUSED, ..*self };
    }

    fn advance(&mut self) {
        self.current = self.current.saturating_add(1);
        self.waiting = None;
    }

    /// Finds the next leg. The first round visits as many items as the plan has. If that finds no leg, the plan loops: the
    /// second round treats jumps with a repeat count as completed.
    fn ahead(&self, items: &[Item]) -> Ahead {
        let (mut seq, mut jumps) = (self.current, self.jumps);
        for is_second_round in [false, true] {
            for _ in 0..=items.len() {
                let Some(item) = items.get(usize::from(seq)) else { return Ahead::End };
                let [_, repeat, ..] = item.params;
                seq = match item.command {
                    command if plan::is_flown(command) => return Ahead::Leg(seq),
                    MavCmd::DO_JUMP if !is_second_round || repeat < 0.0 => jumps.pass(seq, item),
                    _ => seq.saturating_add(1),
                };
            }
        }
        Ahead::Loop
    }

    pub fn current(&self) -> u16 {
        self.current
    }

    pub fn state(&self) -> MissionState {
        self.state
    }
}

/// Checks that the plan has at most [`JUMPS`] jumps.
pub fn check(items: &[Item]) -> Result<(), PlanFault> {
    let mut jumps = (0..).zip(items).filter(|(_, item)| item.command == MavCmd::DO_JUMP);
    match jumps.nth(JUMPS) {
        Some((seq, _)) => Err(PlanFault { seq: Some(seq), result: MavMissionResult::NO_SPACE }),
        None => Ok(()),
    }
}

impl Quadrotor {
    /// Handles a new live plan. In flight the vehicle continues with it, or stops if the plan is empty (M-94).
    #[inline(never)]
    pub(super) fn replace_mission(&mut self, count: u16, first: u16) {
        self.mission.count = count;
        if self.mode == Mode::Mission && count == 0 {
            self.hold();
        }
        self.mission.restart(first);
        self.end_survey();
        if self.mode == Mode::Mission {
            self.mission.state = MissionState::ACTIVE;
        }
    }

    /// Starts or resumes the mission. A complete mission starts at the beginning.
    pub(super) fn resume_mission(&mut self, cx: &mut Context<'_>) -> MavResult {
        self.fly_from(cx, None)
    }

    /// Starts the mission at `first`; `None` resumes it. At its beginning, the distance of the first waypoint is checked (M-48).
    fn fly_from(&mut self, cx: &mut Context<'_>, first: Option<u16>) -> MavResult {
        if self.mission.count == 0 {
            return refuse(cx, MavResult::FAILED, "Mission refused: no mission uploaded");
        }
        let resumed = if self.mission.is_complete { 0 } else { self.mission.current };
        if first.unwrap_or(resumed) == 0
            && let Err(result) = self.check_start(cx)
        {
            return result;
        }
        let result = self.start(cx, Mode::Mission, self.maneuver);
        if result == MavResult::ACCEPTED {
            if self.mission.is_complete || first.is_some() {
                self.mission.restart(first.unwrap_or(0));
                self.end_survey();
            }
            if self.mission.state == MissionState::NOT_STARTED {
                self.speed = None;
            }
            self.mission.state = MissionState::ACTIVE;
        }
        result
    }

    pub(super) fn fly_from_to(&mut self, cx: &mut Context<'_>, first: Option<u16>, last: Option<u16>) -> MavResult {
        let mission = &self.mission;
        let end = last.unwrap_or(mission.count.saturating_sub(1));
        let begin = first.unwrap_or(if mission.is_complete { 0 } else { mission.current });
        if mission.count > 0 && (begin > end || end >= mission.count) {
            return refuse(cx, MavResult::DENIED, "Mission refused: it starts after its last item");
        }
        let result = self.fly_from(cx, first);
        if result == MavResult::ACCEPTED {
            self.mission.last = end;
        }
        result
    }

    /// MAV_CMD_DO_LAND_START: flies the mission from the nearest marker of a landing on.
    #[inline(never)]
    pub(super) fn fly_landing(&mut self, cx: &mut Context<'_>) -> MavResult {
        let here = self.body.position;
        let distance = |item: &Item| match (item.x, item.y) {
            // A marker without a position is as near as any.
            (0, 0) | (i32::MAX, _) | (_, i32::MAX) => 0.0,
            (latitude, longitude) => {
                let (north, east) = self.home.to_local(latitude, longitude);
                here.distance(Vector { north, east, ..here })
            }
        };
        let items = (0..).zip(cx.plan(PlanType::Mission).items());
        let marks = items.filter(|(_, item)| item.command == MavCmd::DO_LAND_START);
        match marks.min_by(|(_, a), (_, b)| distance(a).total_cmp(&distance(b))) {
            Some((seq, _)) => self.fly_from(cx, Some(seq)),
            None => refuse(cx, MavResult::FAILED, "Landing refused: the mission has no DO_LAND_START"),
        }
    }

    pub(super) fn go_to_item(&mut self, cx: &mut Context<'_>, seq: u16, reset: bool) -> MavResult {
        if seq >= self.mission.count {
            return refuse(cx, MavResult::FAILED, "Mission refused: no such item");
        }
        let mission = &mut self.mission;
        mission.go_to(seq);
        if seq > mission.last {
            mission.last = mission.count - 1;
        }
        if reset {
            mission.jumps = Jumps::NONE;
            if mission.state == MissionState::COMPLETE {
                mission.state = MissionState::PAUSED;
            }
        }
        MavResult::ACCEPTED
    }

    /// Flies one step of the mission.
    #[inline(never)]
    pub(super) fn fly_mission(&mut self, cx: &mut Context<'_>) {
        let items = cx.plan(PlanType::Mission).items();
        let count = items.len().min(usize::from(self.mission.last) + 1);
        let items = items.get(..count).unwrap_or_default();
        let leg = match self.mission.leg {
            Some(leg) => leg,
            None => match self.mission.ahead(items) {
                Ahead::Leg(seq) => self.begin_leg(cx, seq, items),
                Ahead::End => self.begin_end(),
                Ahead::Loop => {
                    return self.finish(cx, MavSeverity::WARNING, "Mission ended: a loop with nothing to fly");
                }
            },
        };
        let are_items_done = self.execute_items(cx, &leg, items);
        if self.mode != Mode::Mission || self.mission.leg.is_none() {
            return;
        }
        let is_done = self.perform(cx, leg.maneuver);
        if self.mode != Mode::Mission {
            return;
        }
        let Some(since) = leg.done else {
            // Only four items can be reported in one pass. In a pass that is late, another one is reached in the next.
            let is_reached = is_done && self.reach(cx, &leg);
            self.mission.leg = Some(Leg { done: is_reached.then_some(self.time), ..leg });
            return;
        };
        // On the ground the vehicle cannot turn.
        let is_turn_done = self.body.is_turned() || self.is_landed();
        if self.time - since >= leg.stay && are_items_done && is_turn_done {
            self.end_leg(cx, &leg, items);
        }
    }

    #[inline(never)]
    fn begin_leg(&mut self, cx: &Context<'_>, seq: u16, items: &[Item]) -> Leg {
        let mut leg = self.leg(cx, seq, items);
        if leg.maneuver == Maneuver::Return {
            leg.maneuver = self.return_landing(cx);
        }
        self.body.nose = match (leg.maneuver, leg.yaw) {
            (Maneuver::Land(_), Some(yaw)) => self.turn_to(yaw),
            _ => Nose::Course,
        };
        self.circled = 0.0;
        self.mission.leg = Some(leg);
        leg
    }

    /// Returns the leg of an item. Not inlined: the choice of a place to land has the deepest call stack.
    #[inline(never)]
    fn leg(&self, cx: &Context<'_>, seq: u16, items: &[Item]) -> Leg {
        let mut leg = self.holding_leg();
        leg.seq = Some(seq);
        if let Some(item) = items.get(usize::from(seq))
            && let Action::Fly { maneuver, stay, yaw } = plan::action(item, &self.situation(cx))
        {
            let lands = matches!(maneuver, Maneuver::Land(_) | Maneuver::Return);
            let stay = if lands { disarm_delay(cx) } else { stay };
            leg = Leg { maneuver, stay, yaw, ..leg };
        }
        leg
    }

    /// Begins the end of the mission: the vehicle holds its position while the remaining items are executed.
    #[inline(never)]
    fn begin_end(&mut self) -> Leg {
        let leg = self.holding_leg();
        self.mission.leg = Some(leg);
        leg
    }

    fn holding_leg(&self) -> Leg {
        let maneuver = Maneuver::Stay(self.body.rest());
        Leg { seq: None, maneuver, stay: Duration::ZERO, yaw: None, done: None }
    }

    pub(super) fn situation(&self, cx: &Context<'_>) -> Situation {
        Situation {
            home: self.home,
            position: self.body.rest(),
            yaw: self.body.yaw(),
            radius: cx.parameter(Tuning::NAV_ACC_RAD),
            turn: self.body.limits.turn,
            speed: self.speed,
            time: self.time,
        }
    }

    /// Executes the items before the leg's item. Returns true when all are done. The number of items per step is bounded, so a
    /// loop without a leg cannot hang it.
    #[inline(never)]
    fn execute_items(&mut self, cx: &Context<'_>, leg: &Leg, items: &[Item]) -> bool {
        for _ in 0..=items.len() {
            let seq = self.mission.current;
            let Some(item) = items.get(usize::from(seq)).filter(|_| leg.seq != Some(seq)) else { return true };
            if plan::is_flown(item.command) {
                // After a loop the next leg can differ from the leg that was found before the loop.
                self.mission.leg = None;
                return false;
            }
            match plan::action(item, &self.situation(cx)) {
                Action::Speed(speed) => self.speed = speed,
                Action::Servo { number, pulse } => self.set_servo(number, pulse),
                Action::Camera if !self.operate_camera(item) => return false,
                Action::Gimbal if !self.operate_gimbal(item) => return false,
                Action::Wait(condition) if !self.is_met(condition, leg) => return false,
                _ => {}
            }
            if item.command == MavCmd::DO_JUMP {
                self.mission.current = self.mission.jumps.pass(seq, item);
            } else {
                self.mission.advance();
            }
            if item.autocontinue == 0 {
                self.hold();
                return false;
            }
        }
        false
    }

    fn is_met(&mut self, condition: Condition, leg: &Leg) -> bool {
        let is_begun = self.mission.waiting.is_some();
        let since = *self.mission.waiting.get_or_insert(self.time);
        match condition {
            Condition::Delay(delay) => self.time - since >= delay,
            Condition::Distance(distance) => {
                leg.done.is_some() || leg.to().is_none_or(|to| self.body.position.distance(to) <= distance)
            }
            Condition::Turn(nose) => {
                if !is_begun {
                    self.body.nose = nose;
                }
                // On the ground the vehicle cannot turn.
                self.body.is_turned() || (self.is_landed() && leg.done.is_some())
            }
        }
    }

    /// Handles the end of the leg's maneuver. False when that cannot be reported yet.
    fn reach(&mut self, cx: &mut Context<'_>, leg: &Leg) -> bool {
        let Some(seq) = leg.seq else { return true };
        if !self.mission.is_reported {
            self.mission.is_reported = cx.mission_item_reached(seq);
        }
        if let Some(yaw) = leg.yaw
            && self.mission.is_reported
        {
            self.body.nose = self.turn_to(yaw);
        }
        self.mission.is_reported
    }

    fn end_leg(&mut self, cx: &mut Context<'_>, leg: &Leg, items: &[Item]) {
        const COMPLETE: &str = "Mission complete";

        if matches!(leg.maneuver, Maneuver::Land(_)) {
            // The mission ends with the landing, because the vehicle disarms.
            self.finish(cx, MavSeverity::INFO, COMPLETE);
            return self.touch_down(cx);
        }
        let item = items.get(usize::from(self.mission.current));
        self.mission.advance();
        self.mission.leg = None;
        self.mission.is_reported = false;
        if usize::from(self.mission.current) >= items.len() {
            self.finish(cx, MavSeverity::INFO, COMPLETE);
        } else if item.is_some_and(|item| item.autocontinue == 0) {
            self.hold();
        }
    }

    /// Completes the mission.
    fn finish(&mut self, cx: &mut Context<'_>, severity: MavSeverity, text: &str) {
        self.hold();
        let mission = &mut self.mission;
        mission.go_to(mission.current.min(mission.last));
        mission.is_complete = true;
        mission.state = MissionState::COMPLETE;
        self.end_survey();
        cx.text(severity, text);
    }
}

impl Leg {
    /// Returns the leg's destination.
    fn to(&self) -> Option<Vector> {
        match self.maneuver {
            Maneuver::Reach { to, .. } | Maneuver::Climb(to) | Maneuver::Land(to) => Some(to),
            Maneuver::Stay(_) | Maneuver::Wait { .. } | Maneuver::Circle { .. } | Maneuver::Return => None,
        }
    }
}
