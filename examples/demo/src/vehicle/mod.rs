//! The vehicle: a quadrotor that exists as a few numbers. The same steps in time give the same flight.

mod commands;
mod fly;
mod ground;
mod manual;
mod mission;
mod modes;
mod params;
mod plans;
mod satellite;

use mavstack::dialect::{ComponentMetadata, MavModeFlag, MavSeverity, MavState, SystemTime};
use mavstack::{
    CommandSlots, ControlSource, Duration, ForwardCounters, ForwardQueues, Forwarding, HighLatency, Instant, Item,
    LinkId, ManualInput, Signing, SigningCounters, SigningMemory, TimeSlots, TimeSync, Vehicle, VehicleState,
    WallClock,
};

use crate::app::LINKS;
use crate::battery::{Battery, Charge};
use crate::body::{Body, Limits, Nose, Vector};
use crate::geo::Home;
use crate::plan::Maneuver;
use crate::queue::Queue;
use crate::tuning::Tuning;
use fly::is_over;
use ground::Reboot;
use mission::Mission;
pub use modes::Mode;
pub(crate) use satellite::GPS_ERROR;

/// Its physics go in steps of 10 ms.
const STEP: Duration = Duration::from_millis(10);
const DT: f32 = 0.01;
/// A flight loop that stood still is not made up for beyond so many steps.
const MAX_STEPS: usize = 10;

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

/// When it did what last, since it was switched on; zero for never.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Times {
    pub armed: Instant,
    pub took_off: Instant,
    /// Zero in the air too.
    pub landed: Instant,
}

/// The plans that are live.
#[derive(Clone, Copy, Debug)]
struct Live<'a> {
    mission: &'a [Item],
    fence: &'a [Item],
    rally: &'a [Item],
}

/// The vehicle.
#[derive(Clone, Debug)]
pub struct Quadrotor {
    tuning: Tuning,
    home: Home,
    body: Body,
    battery: Battery,
    /// The physics are done up to here.
    time: Instant,
    armed: bool,
    mode: Mode,
    /// The one that somebody asked for last, or that followed from it: any other is a failsafe's.
    intended: Mode,
    /// What is flown in every mode but [`Mode::Mission`].
    maneuver: Maneuver,
    /// m/s; `None` for the parameter's.
    speed: Option<f32>,
    mission: Mission,
    /// It stands outside its fence.
    is_outside: bool,
    /// It has warned of the fence that it is at.
    is_warned: bool,
    is_in_air: bool,
    times: Times,
    /// It has been in the air for longer than it is to be.
    is_overdue: bool,
    /// The motors are off for good.
    is_terminated: bool,
    /// Sensors are being calibrated, since then.
    calibration: Option<Instant>,
    reboot: Option<Reboot>,
    /// Home is known since a moment ago, or another one.
    has_new_home: bool,
    commands: CommandSlots<4>,
    clocks: TimeSlots<LINKS>,
    input: ManualInput,
    queues: ForwardQueues<LINKS>,
    satellite: HighLatency,
    signing: SigningMemory,
    /// The time of day, where there is a clock for it.
    calendar: WallClock,
    /// When what the satellite link reports was last looked at.
    sampled: Instant,
    /// A step reaches no more than one item.
    reached: Queue<u16, MAX_STEPS>,
    texts: Queue<(MavSeverity, &'static str), 4>,
    /// Where its parameters are described.
    metadata: Option<&'static ComponentMetadata>,
}

impl Quadrotor {
    /// On the ground at home, disarmed, with a full battery.
    pub const fn new() -> Self {
        Self {
            tuning: Tuning::new(),
            home: Home::DEMO,
            body: Body::AT_HOME,
            battery: Battery::FULL,
            time: Instant::ZERO,
            armed: false,
            mode: Mode::Hold,
            intended: Mode::Hold,
            maneuver: Maneuver::Stay(Vector::ZERO),
            speed: None,
            mission: Mission::NONE,
            is_outside: false,
            is_warned: false,
            is_in_air: false,
            times: Times { armed: Instant::ZERO, took_off: Instant::ZERO, landed: Instant::ZERO },
            is_overdue: false,
            is_terminated: false,
            calibration: None,
            reboot: None,
            has_new_home: true,
            commands: CommandSlots::new(),
            clocks: TimeSlots::new(),
            input: ManualInput::new(ControlSource::Nobody, ManualInput::TIMEOUT),
            queues: ForwardQueues::new(),
            satellite: HighLatency::new(satellite::CONFIG),
            signing: SigningMemory::new(),
            calendar: WallClock::new(),
            sampled: Instant::ZERO,
            reached: Queue::new(),
            texts: Queue::new(),
            metadata: None,
        }
    }

    /// One pass of the flight loop: the physics up to `now`, flying `mission` within `fence`, with `rally` to return to:
    /// the live plans.
    pub fn control_step(&mut self, now: Instant, mission: &[Item], fence: &[Item], rally: &[Item]) {
        let live = Live { mission, fence, rally };
        if self.time == Instant::ZERO {
            self.switch_on();
        }
        self.body.limits = Limits::of(&self.tuning);
        self.tune_sticks();
        self.watch_satellite();
        for _ in 0..MAX_STEPS {
            if self.time.after(STEP) > now {
                return;
            }
            self.time = self.time.after(STEP);
            self.step(&live);
        }
        self.time = now;
    }

    /// It is `unix_usec` µs after the beginning of 1970 (UTC) at `now`, by a clock of its own that runs while it is switched off.
    /// Signatures follow that, whatever it says (G-4). They do not follow a satellite receiver, which anybody can make believe
    /// something, nor what somebody tells who does not sign; who signs moves them on by that (G-6, G-14).
    pub fn set_calendar(&mut self, now: Instant, unix_usec: u64) {
        self.calendar.set(now, unix_usec);
        self.signing.set_time(now, unix_usec, Duration::MAX);
    }

    /// Without the time of day as long as it is not known.
    pub(crate) fn system_time(&self, now: Instant) -> SystemTime {
        self.calendar.message(now)
    }

    /// What was forwarded to a link, and what was not.
    pub(crate) fn forward_counters(&self, link: LinkId) -> ForwardCounters {
        self.queues.counters(link).unwrap_or_default()
    }

    /// What was accepted and refused for its signature.
    pub(crate) fn signing_counters(&self) -> SigningCounters {
        self.signing.counters()
    }

    /// Where it is; `None` without a GPS fix.
    pub fn global_position(&self) -> Option<GlobalPosition> {
        let Vector { north, east, down } = self.body.position;
        let (latitude, longitude) = self.home.to_global(north, east);
        self.has_fix().then_some(GlobalPosition { latitude, longitude, altitude: self.home.altitude - down })
    }

    /// Where it is, m from where it was switched on.
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

    /// How fast roll, pitch, yaw change, rad/s.
    pub(crate) fn attitude_rates(&self) -> [f32; 3] {
        let [roll, pitch] = self.body.tilt_rate;
        [roll, pitch, self.body.yaw_rate]
    }

    /// Where home is.
    pub(crate) fn home(&self) -> Home {
        self.home
    }

    /// Whether home is known now, and was not or was elsewhere when this was asked last.
    pub(crate) fn take_new_home(&mut self) -> bool {
        self.has_fix() && core::mem::take(&mut self.has_new_home)
    }

    /// The battery.
    pub fn battery(&self) -> Battery {
        self.battery
    }

    /// Whether the receiver has found its position.
    pub fn has_fix(&self) -> bool {
        self.time >= Instant::from_millis(self.tuning.get(Tuning::SIM_GPS_FIX_TIME).into())
    }

    /// Whether the motors may turn.
    pub fn is_armed(&self) -> bool {
        self.armed
    }

    /// Whether it stands on the ground.
    pub fn is_landed(&self) -> bool {
        self.body.is_on_ground()
    }

    /// Whether it goes up to where a flight begins.
    pub(crate) fn is_taking_off(&self) -> bool {
        matches!(self.flown(), Maneuver::Climb(_))
    }

    /// Whether it comes down to land, in whatever mode.
    pub(crate) fn is_landing(&self) -> bool {
        matches!(self.flown(), Maneuver::Land(spot) if is_over(self.body.position, spot))
    }

    fn flown(&self) -> Maneuver {
        self.mission.maneuver().filter(|_| self.mode == Mode::Mission).unwrap_or(self.maneuver)
    }

    /// What it is doing.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// When it did what.
    pub(crate) fn times(&self) -> Times {
        self.times
    }

    /// Something to tell the operator, once.
    pub fn take_text(&mut self) -> Option<(MavSeverity, &'static str)> {
        self.texts.take()
    }

    /// An item of the mission that was reached, once each and in their order (M-91). Fetch all after each
    /// [`control_step`](Self::control_step): there is room for those of one.
    pub fn take_reached(&mut self) -> Option<u16> {
        self.reached.take()
    }

    /// Where ground stations find what its parameters mean; without it they are told that there is nothing (O-1).
    pub fn set_metadata(&mut self, metadata: &'static ComponentMetadata) {
        self.metadata = Some(metadata);
    }

    /// Where its parameters are described.
    pub(crate) fn metadata(&self) -> Option<&'static ComponentMetadata> {
        self.metadata
    }

    fn step(&mut self, live: &Live<'_>) {
        self.watch_ground();
        self.watch_battery();
        self.watch_time();
        self.watch_idling();
        self.watch_calibration();
        self.watch_sticks();
        if !self.armed {
            self.is_outside = !self.allows(live, self.body.position, self.body.position);
            return self.body.fall(DT);
        }
        if self.mode == Mode::Mission {
            return self.fly_mission(live);
        }
        if self.mode == Mode::Position {
            return self.follow_sticks(live);
        }
        if self.maneuver == Maneuver::Return {
            self.maneuver = self.way_home(live);
        }
        if self.perform(self.maneuver, live) {
            match self.mode {
                Mode::Takeoff => {
                    let Maneuver::Climb(to) = self.maneuver else { return };
                    self.enter(Mode::Hold, Maneuver::Stay(to));
                    self.intended = Mode::Hold;
                    if self.tuning.get(Tuning::COM_TAKEOFF_ACT) == 1 {
                        self.fly_on();
                    }
                }
                Mode::Return | Mode::Land if self.time.since(self.times.landed) >= self.rest_on_ground() => {
                    self.touch_down()
                }
                Mode::Return | Mode::Land => {}
                Mode::Hold | Mode::Position | Mode::Mission => {}
            }
        }
    }

    #[inline(never)]
    fn watch_ground(&mut self) {
        let is_in_air = !self.is_landed();
        if is_in_air == self.is_in_air {
            return;
        }
        self.is_in_air = is_in_air;
        self.is_overdue = false;
        if is_in_air {
            self.times.took_off = self.time;
            self.times.landed = Instant::ZERO;
            let count = self.tuning.get(Tuning::STAT_FLIGHTS).saturating_add(1);
            self.tuning.set(Tuning::STAT_FLIGHTS, count);
        } else {
            self.times.landed = self.time;
            let flown = self.time.since(self.times.took_off).as_millis() / 1_000;
            let flown = u32::try_from(flown).unwrap_or(u32::MAX);
            let sum = self.tuning.get(Tuning::STAT_FLIGHT_TIME).saturating_add(flown);
            self.tuning.set(Tuning::STAT_FLIGHT_TIME, sum);
        }
    }

    #[inline(never)]
    fn watch_battery(&mut self) {
        let current = self.tuning.get(match self.armed {
            false => Tuning::SIM_AMP_OFF,
            true if self.is_landed() => Tuning::SIM_AMP_IDLE,
            true => Tuning::SIM_AMP_FLIGHT,
        });
        let before = self.battery.charge;
        self.battery.drain(&self.tuning, current, DT);
        if self.battery.charge >= before {
            return;
        }
        if self.battery.charge == Charge::Low {
            return self.say(MavSeverity::WARNING, "Battery low");
        }
        self.say(MavSeverity::CRITICAL, "Battery critical");
        if self.armed && self.is_in_air {
            match self.tuning.get(Tuning::COM_LOW_BAT_ACT) {
                1 => self.enter(Mode::Return, Maneuver::Return),
                2 => self.enter(Mode::Land, Maneuver::Land(self.body.rest())),
                _ => {}
            }
        }
    }

    #[inline(never)]
    fn watch_time(&mut self) {
        let most = u32::try_from(self.tuning.get(Tuning::COM_FLT_TIME_MAX)).unwrap_or(0);
        let is_over = most > 0 && self.time.since(self.times.took_off) >= Duration::from_secs(most.into());
        if self.armed && self.is_in_air && is_over && !self.is_overdue {
            self.is_overdue = true;
            self.say(MavSeverity::WARNING, "Returning: time is up");
            self.enter(Mode::Return, Maneuver::Return);
        }
    }

    /// Disarms when the vehicle has not taken off for a while after arming, as PX4 does. A mission may start with a
    /// wait.
    #[inline(never)]
    fn watch_idling(&mut self) {
        let limit = self.tuning.get(Tuning::COM_DISARM_PRFLT);
        let Times { armed, took_off, .. } = self.times;
        let is_idle = self.armed && self.is_landed() && took_off <= armed && self.mode != Mode::Mission;
        if is_idle && limit > 0.0 && self.time.since(armed) >= Duration::from_micros((limit * 1e6) as u64) {
            self.disarm();
            self.say(MavSeverity::INFO, "Disarmed: it did not take off");
        }
    }

    /// How long it stands on the ground until the motors are off.
    fn rest_on_ground(&self) -> Duration {
        Duration::from_micros((self.tuning.get(Tuning::COM_DISARM_LAND) * 1e6) as u64)
    }

    /// m/s
    fn speed(&self) -> f32 {
        self.speed.unwrap_or(self.tuning.get(Tuning::MPC_XY_CRUISE))
    }

    /// Stops, and stays there: what was asked for is over.
    fn hold(&mut self) {
        self.stop();
        self.intended = Mode::Hold;
    }

    /// Stops, and stays there, whatever was asked for.
    fn stop(&mut self) {
        self.enter(Mode::Hold, Maneuver::Stay(self.body.rest()));
        // Not to where it comes to rest, which is behind it when it flies backwards.
        self.body.nose = Nose::Turn { left: 0.0, rate: 0.0 };
    }

    fn touch_down(&mut self) {
        self.disarm();
        self.say(MavSeverity::INFO, "Landed, disarmed");
    }

    fn enter(&mut self, mode: Mode, maneuver: Maneuver) {
        if self.mode == Mode::Mission && mode != Mode::Mission {
            self.mission.pause();
        }
        if mode != Mode::Mission {
            self.body.nose = Nose::Course;
        }
        self.mode = mode;
        self.maneuver = maneuver;
    }

    fn say(&mut self, severity: MavSeverity, text: &'static str) {
        self.texts.push((severity, text));
    }
}

impl Default for Quadrotor {
    fn default() -> Self {
        Self::new()
    }
}

impl Vehicle for Quadrotor {
    fn state(&self) -> Option<VehicleState> {
        let mut base_mode = MavModeFlag::CUSTOM_MODE_ENABLED | MavModeFlag::STABILIZE_ENABLED;
        base_mode |= match self.mode {
            Mode::Hold => MavModeFlag::GUIDED_ENABLED,
            Mode::Position => MavModeFlag::MANUAL_INPUT_ENABLED,
            _ => MavModeFlag::GUIDED_ENABLED | MavModeFlag::AUTO_ENABLED,
        };
        if self.armed {
            base_mode |= MavModeFlag::SAFETY_ARMED;
        }
        let system_status = match self.armed {
            _ if self.is_terminated => MavState::FLIGHT_TERMINATION,
            _ if self.is_going_down() => MavState::POWEROFF,
            _ if self.is_calibrating() => MavState::CALIBRATING,
            false if !self.has_fix() => MavState::BOOT,
            false => MavState::STANDBY,
            true if self.battery.is_low() => MavState::CRITICAL,
            true => MavState::ACTIVE,
        };
        Some(VehicleState { base_mode, custom_mode: self.mode.number(), system_status })
    }

    fn time_sync(&mut self) -> Option<&mut TimeSync> {
        Some(&mut self.clocks)
    }

    fn manual_input(&mut self) -> Option<&mut ManualInput> {
        Some(&mut self.input)
    }

    fn high_latency(&mut self) -> Option<&mut HighLatency> {
        Some(&mut self.satellite)
    }

    fn forwarding(&mut self) -> Option<Forwarding<'_>> {
        Some(self.queues.forwarding())
    }

    fn signing(&mut self) -> Option<&mut Signing> {
        Some(&mut self.signing)
    }
}
