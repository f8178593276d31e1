//! The vehicle: a quadrotor that exists as a few numbers. The same steps in time give the same flight.

use mavstack::dialect::{
    command_rules, MavCmd, MavFrame, MavMissionResult, MavModeFlag, MavResult, MavSeverity, MavState, MissionState,
};
use mavstack::{
    Command, CommandPosition, CommandRule, Commands, Duration, Instant, Item, Outcome, PlanChange, PlanType, Plans, Progress,
    Vehicle, VehicleState,
};

use crate::body::{Body, Vector};
use crate::geo::Home;
use crate::plan::{self, CRUISE, Maneuver, Order};

/// Its physics go in steps of 10 ms.
const STEP: Duration = Duration::from_millis(10);
const DT: f32 = 0.01;
/// A flight loop that stood still is not made up for beyond so many steps.
const MAX_STEPS: u32 = 10;
/// The receiver needs so long to find its position.
const GPS_FIX: Instant = Instant::from_millis(2_000);
/// Where a take-off without an altitude ends, m.
const TAKEOFF_HEIGHT: f32 = 10.0;
/// It flies home no lower than this, m.
const RETURN_HEIGHT: f32 = 15.0;
/// MAV_CMD_COMPONENT_ARM_DISARM: parameter 2 that forces it (C-31).
const FORCE: f32 = 21_196.0;

/// What the vehicle is doing: `HEARTBEAT.custom_mode`. The numbers are beyond those of the well-known autopilots, so that
/// a client that takes us for one of them is refused and not misunderstood.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Mode {
    /// Stays where it is.
    Hold = 100,
    /// Goes up.
    Takeoff = 101,
    /// Flies the live plan.
    Mission = 102,
    /// Flies home and lands.
    Return = 103,
    /// Lands.
    Land = 104,
}

impl Mode {
    const ALL: [Self; 5] = [Self::Hold, Self::Takeoff, Self::Mission, Self::Return, Self::Land];
}

/// A position on the globe.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GlobalPosition {
    /// deg·1e7
    pub latitude: i32,
    /// deg·1e7
    pub longitude: i32,
    /// m above mean sea level
    pub altitude: f32,
}

/// The battery: three cells.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Battery {
    /// From 1 (full) to 0.
    pub remaining: f32,
    /// V
    pub voltage: f32,
    /// A
    pub current: f32,
}

impl Battery {
    const FULL: Self = Self { remaining: 1.0, voltage: 12.6, current: 0.0 };
    /// A·s
    const CAPACITY: f32 = 5.0 * 3_600.0;
    const LOW: f32 = 0.15;

    fn drain(&mut self, current: f32, dt: f32) {
        self.current = current;
        self.remaining = (self.remaining - current * dt / Self::CAPACITY).max(0.0);
        self.voltage = 10.5 + 2.1 * self.remaining - 0.02 * current;
    }
}

/// How far it is with the plan.
#[derive(Clone, Copy, Debug)]
struct Mission {
    /// Items of the live plan.
    count: u16,
    current: u16,
    /// The current item's maneuver and how long to stay there afterwards; `None` until it is begun.
    leg: Option<(Maneuver, Duration)>,
    /// The maneuver is done, since then.
    reached: Option<Instant>,
    state: MissionState,
}

impl Mission {
    fn begin(&mut self, current: u16) {
        *self = Self { current, leg: None, reached: None, ..*self };
    }
}

/// The vehicle.
#[derive(Clone, Copy, Debug)]
pub struct Quadrotor {
    home: Home,
    body: Body,
    battery: Battery,
    /// The physics are done up to here.
    time: Instant,
    armed: bool,
    mode: Mode,
    /// What is flown in every mode but [`Mode::Mission`].
    maneuver: Maneuver,
    /// m/s
    speed: f32,
    mission: Mission,
    text: Option<(MavSeverity, &'static str)>,
}

impl Quadrotor {
    /// On the ground at home, disarmed, with a full battery.
    pub const fn new() -> Self {
        Self {
            home: Home::DEMO,
            body: Body::AT_HOME,
            battery: Battery::FULL,
            time: Instant::ZERO,
            armed: false,
            mode: Mode::Hold,
            maneuver: Maneuver::Stay(Vector::ZERO),
            speed: CRUISE,
            mission: Mission { count: 0, current: 0, leg: None, reached: None, state: MissionState::NOT_STARTED },
            text: None,
        }
    }

    /// One pass of the flight loop: the physics up to `now`, flying `items`, the live plan.
    pub fn control_step(&mut self, now: Instant, items: &[Item]) {
        for _ in 0..MAX_STEPS {
            if self.time.after(STEP) > now {
                return;
            }
            self.time = self.time.after(STEP);
            self.step(items);
        }
        self.time = now;
    }

    /// Where it is; `None` without a GPS fix.
    pub fn global_position(&self) -> Option<GlobalPosition> {
        let Vector { north, east, down } = self.body.position;
        let (latitude, longitude) = self.home.to_global(north, east);
        self.has_fix().then_some(GlobalPosition { latitude, longitude, altitude: self.home.altitude - down })
    }

    /// Where it is, m from home.
    pub fn local_position(&self) -> Vector {
        self.body.position
    }

    /// How fast it moves, m/s.
    pub fn velocity(&self) -> Vector {
        self.body.velocity
    }

    /// Roll, pitch, yaw, rad.
    pub fn attitude(&self) -> [f32; 3] {
        self.body.attitude()
    }

    /// The battery.
    pub fn battery(&self) -> Battery {
        self.battery
    }

    /// Whether the receiver has found its position.
    pub fn has_fix(&self) -> bool {
        self.time >= GPS_FIX
    }

    /// Whether the motors may turn.
    pub fn is_armed(&self) -> bool {
        self.armed
    }

    /// Whether it stands on the ground.
    pub fn is_landed(&self) -> bool {
        self.body.is_on_ground()
    }

    /// What it is doing.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Something to tell the operator, once.
    pub fn take_text(&mut self) -> Option<(MavSeverity, &'static str)> {
        self.text.take()
    }

    fn step(&mut self, items: &[Item]) {
        let was_low = self.battery.remaining < Battery::LOW;
        self.battery.drain(
            if !self.armed {
                0.3
            } else if self.is_landed() {
                2.0
            } else {
                18.0
            },
            DT,
        );
        if !was_low && self.battery.remaining < Battery::LOW {
            self.text = Some((MavSeverity::WARNING, "Battery low"));
        }
        if !self.armed {
            return self.body.fall(DT);
        }
        if self.mode == Mode::Mission {
            return self.fly_mission(items);
        }
        if self.perform(self.maneuver) {
            match self.mode {
                Mode::Takeoff => self.hold(),
                Mode::Return | Mode::Land => self.touch_down(),
                Mode::Hold | Mode::Mission => {}
            }
        }
    }

    /// Flies a step of `maneuver`; true when it is done.
    fn perform(&mut self, maneuver: Maneuver) -> bool {
        let here = self.body.position;
        let (goal, done) = match maneuver {
            Maneuver::Stay(to) => (to, true),
            Maneuver::Reach { to, radius } => {
                (to, here.distance(to) <= radius && (to.down - here.down).abs() <= radius)
            }
            Maneuver::Climb(to) => {
                let is_up = (to.down - here.down).abs() < 0.5;
                let goal = if is_up { to } else { Vector { down: to.down, ..here } };
                (goal, is_up && here.distance(to) < 2.0)
            }
            Maneuver::Land(spot) => land(here, spot),
            Maneuver::Return => land(here, Vector { down: here.down.min(-RETURN_HEIGHT), ..Vector::ZERO }),
        };
        self.body.fly(goal, self.speed, DT);
        done
    }

    fn fly_mission(&mut self, items: &[Item]) {
        let Some(item) = items.get(usize::from(self.mission.current)) else {
            return self.finish();
        };
        let Some((maneuver, stay)) = self.mission.leg else {
            match plan::order(self.home, item, self.body.position, self.speed) {
                Order::Fly(maneuver, stay) => {
                    self.mission.leg = Some((maneuver, Duration::from_micros((stay * 1e6) as u64)));
                }
                Order::Speed(speed) => {
                    self.speed = speed;
                    self.next_item(item);
                }
                Order::Unknown => self.hold(),
            }
            return;
        };
        let Some(since) = self.mission.reached else {
            if self.perform(maneuver) {
                self.mission.reached = Some(self.time);
            }
            return;
        };
        if self.time.since(since) < stay {
            self.perform(match maneuver {
                Maneuver::Reach { to, .. } => Maneuver::Stay(to),
                other => other,
            });
            return;
        }
        if matches!(maneuver, Maneuver::Land(_) | Maneuver::Return) {
            // On the ground, motors off: there is no way on.
            self.touch_down();
            self.finish();
        } else {
            self.next_item(item);
        }
    }

    /// The current item is done.
    fn next_item(&mut self, item: &Item) {
        let next = self.mission.current.saturating_add(1);
        if next >= self.mission.count {
            return self.finish();
        }
        self.mission.begin(next);
        if item.autocontinue == 0 {
            self.hold();
        }
    }

    /// The plan is flown.
    fn finish(&mut self) {
        self.mission.begin(self.mission.count.saturating_sub(1));
        self.hold();
        self.mission.state = MissionState::COMPLETE;
        self.text = Some((MavSeverity::INFO, "Mission complete"));
    }

    fn hold(&mut self) {
        self.enter(Mode::Hold, Maneuver::Stay(self.body.position));
    }

    fn touch_down(&mut self) {
        self.hold();
        self.armed = false;
        self.text = Some((MavSeverity::INFO, "Landed, disarmed"));
    }

    fn enter(&mut self, mode: Mode, maneuver: Maneuver) {
        if self.mode == Mode::Mission && mode != Mode::Mission {
            self.mission.state = MissionState::PAUSED;
        }
        self.mode = mode;
        self.maneuver = maneuver;
    }

    fn arm_disarm(&mut self, p1: f32, p2: f32, is_broadcast: bool) -> MavResult {
        let is_forced = p2 == FORCE;
        if !(is_forced || is_default(p2)) {
            return MavResult::DENIED;
        }
        if p1 == 0.0 {
            if self.armed && !self.is_landed() && !is_forced {
                return self.refuse(MavResult::DENIED, "Disarming refused: flying");
            }
            self.hold();
            self.armed = false;
        } else if p1 == 1.0 {
            if is_broadcast {
                return self.refuse(MavResult::DENIED, "Arming refused: sent to all vehicles");
            }
            if !self.has_fix() && !is_forced {
                return self.refuse(MavResult::TEMPORARILY_REJECTED, "Arming refused: no GPS fix yet");
            }
            self.armed = true;
        } else {
            return MavResult::DENIED;
        }
        MavResult::ACCEPTED
    }

    fn take_off(&mut self, command: &Command) -> MavResult {
        // COMMAND_LONG has no frame; its altitude is taken as above home.
        let frame = match command.position {
            CommandPosition::Long { .. } => MavFrame::GLOBAL_RELATIVE_ALT,
            CommandPosition::Int { frame, .. } => frame,
        };
        if self.home.to_height(frame, 0.0).is_none() {
            return MavResult::COMMAND_UNSUPPORTED_MAV_FRAME;
        }
        let height = if is_default(command.z) { Some(TAKEOFF_HEIGHT) } else { self.home.to_height(frame, command.z) };
        match height {
            Some(height) if height > 0.0 => {
                let (north, east) = self.place(command);
                self.start(Mode::Takeoff, Maneuver::Climb(Vector { north, east, down: -height }))
            }
            _ => MavResult::DENIED,
        }
    }

    /// MAV_CMD_MISSION_START: NaN as the first item goes on where it was left.
    fn start_mission(&mut self, first: f32, last: f32) -> MavResult {
        let count = self.mission.count;
        if count == 0 {
            return self.refuse(MavResult::FAILED, "Mission refused: there is none");
        }
        // To the plan's end; a shorter flight needs a shorter plan.
        if !is_default(last) && whole(last) != Some(count - 1) {
            return MavResult::DENIED;
        }
        let first = match self.mission.state {
            MissionState::COMPLETE if first.is_nan() => Some(0),
            _ if first.is_nan() => Some(self.mission.current),
            _ => whole(first),
        };
        let Some(first) = first.filter(|&first| first < count) else { return MavResult::DENIED };
        let result = self.start(Mode::Mission, self.maneuver);
        if result == MavResult::ACCEPTED {
            self.mission.begin(first);
            self.mission.state = MissionState::ACTIVE;
            self.speed = CRUISE;
        }
        result
    }

    /// MAV_CMD_DO_SET_MODE: our modes have no sub-modes.
    fn set_mode(&mut self, command: &Command) -> MavResult {
        let [base, custom, sub, _] = command.params;
        let is_custom = whole(base).is_some_and(|base| base & 1 != 0);
        let mode = Mode::ALL.into_iter().find(|&mode| whole(custom) == Some(mode as u16));
        let Some(mode) = mode.filter(|_| is_custom && is_default(sub)) else { return MavResult::DENIED };
        let here = self.body.position;
        match mode {
            Mode::Hold => {
                self.hold();
                MavResult::ACCEPTED
            }
            Mode::Takeoff => self.start(mode, Maneuver::Climb(Vector { down: here.down.min(-TAKEOFF_HEIGHT), ..here })),
            Mode::Mission => self.start_mission(f32::NAN, 0.0),
            Mode::Return => self.start(mode, Maneuver::Return),
            Mode::Land => self.start(mode, Maneuver::Land(here)),
        }
    }

    fn start(&mut self, mode: Mode, maneuver: Maneuver) -> MavResult {
        if mode == Mode::Land && self.is_landed() {
            return MavResult::ACCEPTED;
        }
        if !self.armed {
            return self.refuse(MavResult::TEMPORARILY_REJECTED, "Refused: not armed");
        }
        self.enter(mode, maneuver);
        MavResult::ACCEPTED
    }

    fn place(&self, command: &Command) -> (f32, f32) {
        match command.position.lat_lon() {
            // A client that fills what it does not use with zeros means no place in the Gulf of Guinea.
            (Some(latitude), Some(longitude)) if (latitude, longitude) != (0, 0) => {
                self.home.to_local(latitude, longitude)
            }
            _ => (self.body.position.north, self.body.position.east),
        }
    }

    fn refuse(&mut self, result: MavResult, why: &'static str) -> MavResult {
        self.text = Some((MavSeverity::WARNING, why));
        result
    }
}

impl Default for Quadrotor {
    fn default() -> Self {
        Self::new()
    }
}

impl Vehicle for Quadrotor {
    fn state(&self) -> Option<VehicleState> {
        let mut base_mode =
            MavModeFlag::CUSTOM_MODE_ENABLED | MavModeFlag::STABILIZE_ENABLED | MavModeFlag::GUIDED_ENABLED;
        if self.mode != Mode::Hold {
            base_mode |= MavModeFlag::AUTO_ENABLED;
        }
        if self.armed {
            base_mode |= MavModeFlag::SAFETY_ARMED;
        }
        let system_status = match self.armed {
            _ if !self.has_fix() => MavState::BOOT,
            false => MavState::STANDBY,
            true if self.battery.remaining < Battery::LOW => MavState::CRITICAL,
            true => MavState::ACTIVE,
        };
        Some(VehicleState { base_mode, custom_mode: self.mode as u32, system_status })
    }
}

impl Commands for Quadrotor {
    fn command(&mut self, command: &Command) -> Outcome {
        let [p1, p2, ..] = command.params;
        let (north, east) = self.place(command);
        let here = Vector { north, east, ..self.body.position };
        let result = match command.id {
            MavCmd::COMPONENT_ARM_DISARM => self.arm_disarm(p1, p2, command.is_broadcast),
            MavCmd::NAV_TAKEOFF => self.take_off(command),
            MavCmd::NAV_LAND => self.start(Mode::Land, Maneuver::Land(here)),
            MavCmd::NAV_RETURN_TO_LAUNCH => self.start(Mode::Return, Maneuver::Return),
            MavCmd::MISSION_START => self.start_mission(p1, p2),
            MavCmd::DO_SET_MODE => self.set_mode(command),
            _ => MavResult::UNSUPPORTED,
        };
        result.into()
    }
}

impl Plans for Quadrotor {
    const MISSION_COMMANDS: &'static [CommandRule] = &[
        command_rules::NAV_TAKEOFF,
        command_rules::NAV_WAYPOINT,
        command_rules::NAV_LOITER_TIME,
        command_rules::NAV_RETURN_TO_LAUNCH,
        command_rules::NAV_LAND,
        command_rules::DO_CHANGE_SPEED,
    ];

    fn check_item(&mut self, plan: PlanType, _seq: u16, item: &Item) -> Result<(), MavMissionResult> {
        match plan {
            PlanType::Mission => plan::check(item),
            // There is no fence or rally point in its flying: it must not pretend.
            _ => Err(MavMissionResult::UNSUPPORTED),
        }
    }

    fn plan_changed(&mut self, change: PlanChange<'_>) {
        if change.plan != PlanType::Mission {
            return;
        }
        self.mission.count = u16::try_from(change.items.len()).unwrap_or(u16::MAX);
        self.mission.begin(change.first);
        self.mission.state = MissionState::NOT_STARTED;
        if self.mode == Mode::Mission {
            // Under way it goes on with the new plan, or stops where it is.
            self.mission.state = MissionState::ACTIVE;
            if self.mission.count == 0 {
                self.hold();
            }
        }
    }

    fn progress(&self) -> Progress {
        Progress {
            current: self.mission.current,
            state: self.mission.state,
            in_mission_mode: self.mode == Mode::Mission,
        }
    }
}

/// Where to fly to land on `spot`, at `spot`'s height as long as it is far; and whether it has landed.
fn land(here: Vector, spot: Vector) -> (Vector, bool) {
    let height = Vector { down: spot.down, ..here };
    if here.distance(spot) <= 1.0 {
        (Vector { down: 1.0, ..spot }, here.down >= 0.0)
    } else if here.down - spot.down > 0.5 {
        (height, false)
    } else {
        (spot, false)
    }
}

/// Whether a parameter is left to us (C-8).
fn is_default(parameter: f32) -> bool {
    parameter == 0.0 || parameter.is_nan()
}

/// The whole number that a parameter holds, if it is one (C-9).
fn whole(parameter: f32) -> Option<u16> {
    let whole = parameter as u16;
    (f32::from(whole) == parameter).then_some(whole)
}
