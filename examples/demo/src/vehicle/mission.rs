//! Flying the mission: which item's turn it is, and what it waits for.
//!
//! An item of the NAV_ commands is a leg: it is flown, and reached once. The DO_ and CONDITION_ items before it are carried
//! out on the way there: in their order, at the leg's beginning, unless a condition holds them back. That is ArduPilot's
//! reading, and the only one in which CONDITION_DISTANCE means something (PX4 takes CONDITION_DELAY and
//! CONDITION_DISTANCE and passes over them). Where a leg ends before its conditions do, ArduPilot drops what they hold
//! back; here the vehicle waits at the leg's end, so that every item is carried out (M-73). DO_ items behind the last leg
//! are carried out as well.
//!
//! DO_JUMP counts in a table of fixed size, [`JUMPS`]: a jump that was taken as often as it says is passed over from then
//! on, also in a loop around it. The counters begin anew with a new plan, and where the mission is told to.

use mavstack::dialect::{MavCmd, MavMissionResult, MavResult, MavSeverity, MissionState};
use mavstack::{Duration, Instant, Item, PlanFault};

use super::{Live, Mode, Quadrotor};
use crate::body::{Nose, Vector};
use crate::plan::{self, Condition, Maneuver, Order, Situation};
use crate::tuning::Tuning;

/// How many DO_JUMP items a plan may have.
pub const JUMPS: usize = 16;

/// How far it is with the plan.
#[derive(Clone, Copy, Debug)]
pub struct Mission {
    /// Items of the live plan.
    count: u16,
    /// It is flown up to this item, with it.
    last: u16,
    /// The item whose turn it is: the leg's, or one before it that waits.
    current: u16,
    leg: Option<Leg>,
    /// The condition at `current` has been waiting since then.
    waiting: Option<Instant>,
    /// It was told that the leg's item is reached; also when the leg is flown again after a pause.
    is_told: bool,
    /// It was flown to its end: it begins at its beginning the next time.
    is_over: bool,
    jumps: Jumps,
    state: MissionState,
}

/// The flight to an item's end.
#[derive(Clone, Copy, Debug)]
struct Leg {
    /// The item; `None` behind the last one that is flown.
    seq: Option<u16>,
    maneuver: Maneuver,
    /// How long to stay there.
    stay: Duration,
    /// Where to point the nose there, rad.
    yaw: Option<f32>,
    /// The maneuver is done, since then.
    done: Option<Instant>,
}

/// What comes next that is flown.
enum Ahead {
    Leg(u16),
    /// Nothing up to the end.
    End,
    /// Nothing, round and round.
    Loop,
}

/// How often each DO_JUMP was taken.
#[derive(Clone, Copy, Debug)]
struct Jumps([(u16, u16); JUMPS]);

impl Jumps {
    const NONE: Self = Self([(0, 0); JUMPS]);

    /// Where the plan goes on after the DO_JUMP `seq`.
    fn pass(&mut self, seq: u16, item: &Item) -> u16 {
        let [target, repeat, ..] = item.params;
        let is_taken = if repeat < 0.0 {
            true
        } else {
            // An entry is free as long as its count is 0.
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
        is_told: false,
        is_over: false,
        jumps: Jumps::NONE,
        state: MissionState::NOT_STARTED,
    };

    /// A new plan.
    fn of(count: u16, first: u16) -> Self {
        Self { count, last: count.saturating_sub(1), current: first, ..Self::NONE }
    }

    /// Goes on from `seq`, with jump counters as they are.
    fn go_to(&mut self, seq: u16) {
        *self = Self { current: seq, leg: None, waiting: None, is_told: false, is_over: false, ..*self };
    }

    /// What is flown now.
    pub fn maneuver(&self) -> Option<Maneuver> {
        self.leg.map(|leg| leg.maneuver)
    }

    /// What is under way is begun again when the mission goes on; what was told is not told again.
    pub fn pause(&mut self) {
        *self = Self { leg: None, waiting: None, state: MissionState::PAUSED, ..*self };
    }

    fn advance(&mut self) {
        self.current = self.current.saturating_add(1);
        self.waiting = None;
    }

    /// The next leg. A plan has no more items than this looks at, unless it goes round without anything to fly: then
    /// once more, behind the jumps that come to an end.
    fn ahead(&self, items: &[Item]) -> Ahead {
        let (mut seq, mut jumps) = (self.current, self.jumps);
        for is_round in [false, true] {
            for _ in 0..=items.len() {
                let Some(item) = items.get(usize::from(seq)) else { return Ahead::End };
                let [_, repeat, ..] = item.params;
                seq = match item.command {
                    command if plan::is_flown(command) => return Ahead::Leg(seq),
                    MavCmd::DO_JUMP if !is_round || repeat < 0.0 => jumps.pass(seq, item),
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

/// Whether there are counters for its jumps.
pub fn check(items: &[Item]) -> Result<(), PlanFault> {
    let mut jumps = (0..).zip(items).filter(|(_, item)| item.command == MavCmd::DO_JUMP);
    match jumps.nth(JUMPS) {
        Some((seq, _)) => Err(PlanFault { seq: Some(seq), result: MavMissionResult::NO_SPACE }),
        None => Ok(()),
    }
}

impl Quadrotor {
    /// A new plan is live. Under way it goes on with that, or stops where it is when there is none (M-94).
    #[inline(never)]
    pub(super) fn replace_mission(&mut self, count: u16, first: u16) {
        self.mission = Mission::of(count, first);
        if self.mode == Mode::Mission {
            self.mission.state = MissionState::ACTIVE;
            if count == 0 {
                self.hold();
                self.mission = Mission::NONE;
            }
        }
    }

    /// Flies the mission from where it was left; from its beginning when it was flown to its end.
    pub(super) fn fly_on(&mut self) -> MavResult {
        self.fly_from(None)
    }

    /// The same, or from this item.
    fn fly_from(&mut self, first: Option<u16>) -> MavResult {
        if self.mission.count == 0 {
            return self.refuse(MavResult::FAILED, "Mission refused: there is none");
        }
        let result = self.start(Mode::Mission, self.maneuver);
        if result == MavResult::ACCEPTED {
            if self.mission.is_over || first.is_some() {
                self.mission = Mission::of(self.mission.count, first.unwrap_or(0));
            }
            if self.mission.state == MissionState::NOT_STARTED {
                self.speed = None;
            }
            self.mission.state = MissionState::ACTIVE;
        }
        result
    }

    pub(super) fn fly_from_to(&mut self, first: Option<u16>, last: Option<u16>) -> MavResult {
        let mission = &self.mission;
        let end = last.unwrap_or(mission.count.saturating_sub(1));
        let begin = first.unwrap_or(if mission.is_over { 0 } else { mission.current });
        if mission.count > 0 && (begin > end || end >= mission.count) {
            return self.refuse(MavResult::DENIED, "Mission refused: it begins behind its end");
        }
        let result = self.fly_from(first);
        if result == MavResult::ACCEPTED {
            self.mission.last = end;
        }
        result
    }

    pub(super) fn go_to_item(&mut self, seq: u16, reset: bool) -> MavResult {
        if seq >= self.mission.count {
            return self.refuse(MavResult::FAILED, "Mission refused: no such item");
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

    /// A step of it.
    #[inline(never)]
    pub(super) fn fly_mission(&mut self, live: &Live<'_>) {
        let count = live.mission.len().min(usize::from(self.mission.last) + 1);
        let items = live.mission.get(..count).unwrap_or_default();
        let leg = match self.mission.leg {
            Some(leg) => leg,
            None => match self.mission.ahead(items) {
                Ahead::Leg(seq) => self.begin_leg(seq, items, live),
                Ahead::End => self.begin_end(),
                Ahead::Loop => return self.finish(MavSeverity::WARNING, "Mission ends: a loop without a leg"),
            },
        };
        let is_next = self.carry_out(&leg, items);
        if self.mode != Mode::Mission || self.mission.leg.is_none() {
            return;
        }
        let is_done = self.perform(leg.maneuver, live);
        if self.mode != Mode::Mission {
            return;
        }
        let Some(since) = leg.done else {
            self.mission.leg = Some(Leg { done: is_done.then_some(self.time), ..leg });
            if is_done {
                self.reach(&leg);
            }
            return;
        };
        // On the ground it neither turns nor waits for that.
        let is_still = self.body.is_turned() || self.is_landed();
        if self.time.since(since) >= leg.stay && is_next && is_still {
            self.end_leg(&leg, items);
        }
    }

    #[inline(never)]
    fn begin_leg(&mut self, seq: u16, items: &[Item], live: &Live<'_>) -> Leg {
        let mut leg = self.end_of_legs();
        leg.seq = Some(seq);
        if let Some(item) = items.get(usize::from(seq))
            && let Order::Fly { maneuver, stay, yaw } = plan::order(item, &self.situation())
        {
            let maneuver = if maneuver == Maneuver::Return { self.way_home(live) } else { maneuver };
            let stay = if matches!(maneuver, Maneuver::Land(_)) { self.rest_on_ground() } else { stay };
            leg = Leg { maneuver, stay, yaw, ..leg };
        }
        self.body.nose = match (leg.maneuver, leg.yaw) {
            (Maneuver::Land(_), Some(yaw)) => plan::turn_to(yaw, &self.situation()),
            _ => Nose::Course,
        };
        self.mission.leg = Some(leg);
        leg
    }

    /// Nothing is flown any more: it stays where it is.
    #[inline(never)]
    fn begin_end(&mut self) -> Leg {
        let leg = self.end_of_legs();
        self.mission.leg = Some(leg);
        leg
    }

    fn end_of_legs(&self) -> Leg {
        let maneuver = Maneuver::Stay(self.body.rest());
        Leg { seq: None, maneuver, stay: Duration::ZERO, yaw: None, done: None }
    }

    pub(super) fn situation(&self) -> Situation {
        Situation {
            home: self.home,
            position: self.body.rest(),
            yaw: self.body.yaw(),
            radius: self.tuning.get(Tuning::NAV_ACC_RAD),
            turn: self.body.limits.turn,
            speed: self.speed,
            time: self.time,
        }
    }

    /// Carries out what comes before the leg's item; true when all of it is. As many items at most as there are: a way
    /// round without a leg is not begun.
    #[inline(never)]
    fn carry_out(&mut self, leg: &Leg, items: &[Item]) -> bool {
        for _ in 0..=items.len() {
            let seq = self.mission.current;
            let Some(item) = items.get(usize::from(seq)).filter(|_| leg.seq != Some(seq)) else { return true };
            if plan::is_flown(item.command) {
                // Behind a way round, it is another leg than was seen from before it.
                self.mission.leg = None;
                return false;
            }
            match plan::order(item, &self.situation()) {
                Order::Speed(speed) => self.speed = speed,
                Order::Wait(condition) if !self.is_met(condition, leg) => return false,
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
            Condition::Delay(delay) => self.time.since(since) >= delay,
            Condition::Distance(distance) => {
                leg.done.is_some() || leg.to().is_none_or(|to| self.body.position.distance(to) <= distance)
            }
            Condition::Turn(nose) => {
                if !is_begun {
                    self.body.nose = nose;
                }
                // On the ground it does not turn.
                self.body.is_turned() || (self.is_landed() && leg.done.is_some())
            }
        }
    }

    /// The leg's maneuver is done.
    fn reach(&mut self, leg: &Leg) {
        let Some(seq) = leg.seq else { return };
        if !self.mission.is_told {
            self.mission.is_told = true;
            self.reached.push(seq);
        }
        if let Some(yaw) = leg.yaw {
            self.body.nose = plan::turn_to(yaw, &self.situation());
        }
    }

    fn end_leg(&mut self, leg: &Leg, items: &[Item]) {
        const COMPLETE: &str = "Mission complete";

        if matches!(leg.maneuver, Maneuver::Land(_)) {
            // On the ground, motors off: there is no way on.
            self.finish(MavSeverity::INFO, COMPLETE);
            return self.touch_down();
        }
        let item = items.get(usize::from(self.mission.current));
        self.mission.advance();
        self.mission.leg = None;
        self.mission.is_told = false;
        if usize::from(self.mission.current) >= items.len() {
            self.finish(MavSeverity::INFO, COMPLETE);
        } else if item.is_some_and(|item| item.autocontinue == 0) {
            self.hold();
        }
    }

    /// The plan is flown.
    fn finish(&mut self, severity: MavSeverity, text: &'static str) {
        self.hold();
        let mission = &mut self.mission;
        mission.go_to(mission.current.min(mission.last));
        mission.is_over = true;
        mission.state = MissionState::COMPLETE;
        self.say(severity, text);
    }
}

impl Leg {
    /// Where it goes.
    fn to(&self) -> Option<Vector> {
        match self.maneuver {
            Maneuver::Reach { to, .. } | Maneuver::Climb(to) | Maneuver::Land(to) => Some(to),
            Maneuver::Stay(_) | Maneuver::Wait { .. } | Maneuver::Return => None,
        }
    }
}
