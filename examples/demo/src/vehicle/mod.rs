//! The vehicle: a simulated quadrotor. The simulation is deterministic: the same time steps give the same flight.

mod authorise;
mod camera;
mod checks;
mod client;
mod commands;
mod fly;
mod gimbal;
mod ground;
mod manual;
mod mission;
mod modes;
mod offboard;
mod params;
mod payload;
mod plans;
mod recorder;
mod satellite;
mod traffic;

use mavstack::clock::WallClock;
use mavstack::dialect::{HomePosition, MavModeFlag, MavSeverity, MavState, MavType, SystemTime};
use mavstack::manual_control::RcOverride;
use mavstack::message::LatLon;
use mavstack::telemetry::Geofence;
use mavstack::{Component, Components, Context, ControlInput, Duration, Frame, Instant, LinkId, Vehicle, VehicleState};

use crate::battery::{Battery, Charge};
use crate::body::{Body, Limits, Nose, Vector};
use crate::geo::Home;
use crate::plan::Maneuver;
use crate::tuning::Tuning;
use authorise::Authorisation;
pub(crate) use camera::CAMERA;
use camera::Photographer;
use checks::Told;
use fly::is_above;
pub(crate) use gimbal::GIMBAL;
use gimbal::Gimbal;
use ground::Reboot;
use manual::Sticks;
use mission::Mission;
pub use modes::Mode;
use offboard::Course;
use payload::Payload;
use recorder::Recorder;
pub(crate) use satellite::{CONFIG as SATELLITE_CONFIG, GPS_ERROR};

/// Time step of the simulation.
const STEP: Duration = Duration::from_millis(10);
/// [`STEP`] in seconds.
const DT: f32 = 0.01;
/// Maximum number of steps per pass. After a longer stall of the flight loop the simulation skips time.
const MAX_STEPS: usize = 10;

/// The number of servos, on the outputs after those of the four motors.
const SERVOS: usize = 4;

/// A position on the globe.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GlobalPosition {
    /// Latitude (1e-7 degrees).
    pub latitude: i32,
    /// Longitude (1e-7 degrees).
    pub longitude: i32,
    /// Altitude above mean sea level (m).
    pub altitude: f32,
}

impl From<GlobalPosition> for LatLon {
    fn from(position: GlobalPosition) -> Self {
        Self { latitude: position.latitude, longitude: position.longitude }
    }
}

/// Times of the last events since boot; zero means never.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Times {
    pub armed: Instant,
    pub took_off: Instant,
    /// Also zero in flight.
    pub landed: Instant,
}

/// Results of the last pass of the flight loop, for hooks without a context: those that fill messages and check plans.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Snapshot {
    /// Whether the GPS receiver has a fix.
    pub has_fix: bool,
    /// Whether the vehicle can arm.
    pub is_ready: bool,
    /// Distance from the fence at which the vehicle stops (m).
    margin: f32,
    pub fence: Geofence,
    pub satellites: u8,
    /// Height of the geoid above the ellipsoid (m).
    pub geoid_separation: i32,
    pub flights: i32,
}

/// Counts that are not stored in the parameters yet.
#[derive(Clone, Copy, Debug)]
struct Counts {
    flights: i32,
    /// Flight time (s).
    flight_time: i32,
}

/// A simulated quadrotor: its state, and its side of every MAVLink service.
#[derive(Clone, Debug)]
pub struct Quadrotor {
    home: Home,
    body: Body,
    battery: Battery,
    /// Simulated time.
    time: Instant,
    armed: bool,
    mode: Mode,
    /// The mode that was requested last, or that followed from it. A failsafe may select another mode.
    intended: Mode,
    /// The maneuver in every mode but [`Mode::Mission`].
    maneuver: Maneuver,
    /// Cruise speed (m/s); `None` means the parameter's.
    speed: Option<f32>,
    mission: Mission,
    /// The angle flown around the centre of a circle (rad), clockwise positive.
    circled: f32,
    /// The pulses of the servos (µs); 0 is off.
    servos: [u16; SERVOS],
    /// The vehicle is disarmed outside its fence.
    is_outside: bool,
    /// The vehicle is outside its fence, also in flight.
    has_breached: bool,
    /// The current contact with the fence was reported.
    is_warned: bool,
    is_in_air: bool,
    times: Times,
    /// The flight time limit was reached.
    is_overdue: bool,
    /// The motors are off until the next boot.
    is_terminated: bool,
    /// When the running calibration of the sensors began.
    calibration: Option<Instant>,
    reboot: Option<Reboot>,
    /// A command to arm that waits for the authoriser.
    authorisation: Option<Authorisation>,
    /// The number of requests to the authoriser. It wraps.
    authorisations: u8,
    /// Our system id.
    system: u8,
    payload: Payload,
    /// Whether the vehicle has its own camera and gimbal.
    has_components: bool,
    camera: Photographer,
    gimbal: Gimbal,
    recorder: Recorder,
    last: Snapshot,
    counts: Counts,
    sticks: Option<Sticks>,
    channels: RcOverride,
    /// What the current setpoint asks for, if the vehicle can fly it.
    course: Option<Course>,
    /// The time of day, if a real-time clock has set it.
    calendar: WallClock,
    /// When the values for HIGH_LATENCY2 were last sampled.
    sampled: Instant,
    /// What events have reported.
    told: Told,
}

impl Quadrotor {
    /// Creates a vehicle on the ground at home, disarmed, with a full battery.
    pub fn new() -> Self {
        Self {
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
            circled: 0.0,
            servos: [0; SERVOS],
            is_outside: false,
            has_breached: false,
            is_warned: false,
            is_in_air: false,
            times: Times { armed: Instant::ZERO, took_off: Instant::ZERO, landed: Instant::ZERO },
            is_overdue: false,
            is_terminated: false,
            calibration: None,
            reboot: None,
            authorisation: None,
            authorisations: 0,
            system: 1,
            payload: Payload::NONE,
            has_components: true,
            camera: Photographer::NEW,
            gimbal: Gimbal::NEW,
            recorder: Recorder::NONE,
            last: Snapshot {
                has_fix: false,
                is_ready: false,
                margin: 0.0,
                fence: Geofence::Absent,
                satellites: 0,
                geoid_separation: 0,
                flights: 0,
            },
            counts: Counts { flights: 0, flight_time: 0 },
            sticks: None,
            channels: RcOverride::default(),
            course: None,
            calendar: WallClock::new(),
            sampled: Instant::ZERO,
            told: Told { armed: false, mode: Mode::Hold, is_in_air: false },
        }
    }

    /// Leaves out the camera and the gimbal.
    pub(crate) fn leave_out_components(&mut self) {
        self.has_components = false;
    }

    /// Runs one pass of the flight loop: simulates up to the context's time, with the live plans.
    pub fn control_step(&mut self, cx: &mut Context<'_>) {
        if self.time == Instant::ZERO {
            self.apply_boot_parameters(cx);
        }
        self.body.limits = Limits::of(cx);
        self.take_steps(cx);
        self.record_events(cx);
        self.last = Snapshot {
            has_fix: self.last.has_fix,
            is_ready: self.check_arming(cx).is_ok(),
            margin: self.fence_margin(cx),
            fence: self.fence_state(cx),
            satellites: cx.parameter(Tuning::SIM_GPS_SATS) as u8,
            geoid_separation: cx.parameter(Tuning::SIM_GEOID_SEP),
            flights: cx.parameter(Tuning::STAT_FLIGHTS),
        };
    }

    /// Simulates up to the context's time, or up to a step in which the camera triggers: the image shows the place of that step, even
    /// if passes are rare. The next pass catches up.
    fn take_steps(&mut self, cx: &mut Context<'_>) {
        for _ in 0..MAX_STEPS {
            if self.time + STEP > cx.now() {
                return;
            }
            self.time += STEP;
            self.step(cx);
            if self.camera.has_triggered() {
                return;
            }
        }
        self.time = cx.now();
    }

    /// Adds the counts since the last call to the parameters.
    pub fn store_counts(&mut self, tuning: &mut Tuning) {
        let Counts { flights, flight_time } =
            core::mem::replace(&mut self.counts, Counts { flights: 0, flight_time: 0 });
        tuning.set(Tuning::STAT_FLIGHTS, tuning.get(Tuning::STAT_FLIGHTS).saturating_add(flights));
        tuning.set(Tuning::STAT_FLIGHT_TIME, tuning.get(Tuning::STAT_FLIGHT_TIME).saturating_add(flight_time));
    }

    /// Sets the time of day: `unix_usec` µs since 1970 (UTC) at `now`.
    pub(crate) fn set_calendar(&mut self, now: Instant, unix_usec: u64) {
        self.calendar.set(now, unix_usec);
    }

    /// Returns SYSTEM_TIME. Until the time of day is known it contains the time since boot only.
    pub(crate) fn system_time(&mut self, now: Instant) -> SystemTime {
        self.calendar.message(now)
    }

    /// Returns the pulses of the servos (µs); 0 is off.
    pub fn servos(&self) -> [u16; SERVOS] {
        self.servos
    }

    /// Returns the global position; `None` without a GPS fix.
    pub fn global_position(&self) -> Option<GlobalPosition> {
        let Vector { north, east, down } = self.body.position;
        let (latitude, longitude) = self.home.to_global(north, east);
        self.last.has_fix.then_some(GlobalPosition { latitude, longitude, altitude: self.home.altitude - down })
    }

    /// Returns the local position (m from the position at boot).
    pub fn local_position(&self) -> Vector {
        self.body.position
    }

    /// Returns the velocity (m/s).
    pub fn velocity(&self) -> Vector {
        self.body.velocity
    }

    /// Returns roll, pitch and yaw (rad).
    pub fn attitude(&self) -> [f32; 3] {
        self.body.attitude()
    }

    /// Returns the rates of roll, pitch and yaw (rad/s).
    pub(crate) fn attitude_rates(&self) -> [f32; 3] {
        let [roll, pitch] = self.body.tilt_rate;
        [roll, pitch, self.body.yaw_rate]
    }

    /// Returns the home position.
    pub(crate) fn home(&self) -> Home {
        self.home
    }

    /// Returns the battery.
    pub fn battery(&self) -> Battery {
        self.battery
    }

    /// Whether the GPS receiver has a fix.
    pub fn has_fix(&self) -> bool {
        self.last.has_fix
    }

    /// Returns the results of the last pass.
    pub(crate) fn last(&self) -> Snapshot {
        self.last
    }

    /// Whether the motors may run.
    pub fn is_armed(&self) -> bool {
        self.armed
    }

    /// Whether the vehicle is on the ground.
    pub fn is_landed(&self) -> bool {
        self.body.is_on_ground()
    }

    /// Whether the vehicle is taking off.
    pub(crate) fn is_taking_off(&self) -> bool {
        matches!(self.active_maneuver(), Maneuver::Climb(_))
    }

    /// Whether the vehicle is in the final descent, in any mode.
    pub(crate) fn is_landing(&self) -> bool {
        matches!(self.active_maneuver(), Maneuver::Land(spot) if is_above(self.body.position, spot))
    }

    fn active_maneuver(&self) -> Maneuver {
        self.mission.maneuver().filter(|_| self.mode == Mode::Mission).unwrap_or(self.maneuver)
    }

    /// Returns the flight mode.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Returns the times of the last events.
    pub(crate) fn times(&self) -> Times {
        self.times
    }

    fn step(&mut self, cx: &mut Context<'_>) {
        self.turn_gimbal();
        self.survey();
        self.watch_receiver(cx);
        self.watch_ground();
        self.watch_battery(cx);
        self.watch_time(cx);
        self.watch_idling(cx);
        self.watch_calibration(cx);
        self.watch_sticks(cx);
        self.watch_setpoints(cx);
        if !self.armed {
            self.is_outside = !self.allows(cx, self.body.position, self.body.position);
            self.has_breached = self.is_outside;
            return self.body.fall(DT);
        }
        if self.mode == Mode::Mission {
            return self.fly_mission(cx);
        }
        if self.mode == Mode::Position {
            return self.follow_sticks(cx);
        }
        if self.mode == Mode::Offboard {
            return self.follow_setpoints(cx);
        }
        if self.maneuver == Maneuver::Return {
            self.maneuver = self.return_landing(cx);
        }
        if self.perform(cx, self.maneuver) {
            match self.mode {
                Mode::Takeoff => {
                    let Maneuver::Climb(to) = self.maneuver else { return };
                    self.enter(Mode::Hold, Maneuver::Stay(to));
                    self.intended = Mode::Hold;
                    if cx.parameter(Tuning::COM_TAKEOFF_ACT) == 1 {
                        self.resume_mission(cx);
                    }
                }
                Mode::Return | Mode::Land if self.time - self.times.landed >= disarm_delay(cx) => self.touch_down(cx),
                Mode::Return | Mode::Land => {}
                Mode::Hold | Mode::Position | Mode::Offboard | Mode::Mission => {}
            }
        }
    }

    /// Home is known with the first fix, and sent then (O-6).
    fn watch_receiver(&mut self, cx: &mut Context<'_>) {
        let has_fix = self.time >= Instant::from_millis(cx.parameter(Tuning::SIM_GPS_FIX_TIME) as u64);
        if has_fix && !self.last.has_fix {
            cx.announce::<HomePosition, Self>();
        }
        self.last.has_fix = has_fix;
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
            self.counts.flights += 1;
        } else {
            self.times.landed = self.time;
            let flown = (self.time - self.times.took_off).as_millis() / 1_000;
            self.counts.flight_time += i32::try_from(flown).unwrap_or(i32::MAX);
        }
    }

    #[inline(never)]
    fn watch_battery(&mut self, cx: &mut Context<'_>) {
        let current = cx.parameter(match self.armed {
            false => Tuning::SIM_AMP_OFF,
            true if self.is_landed() => Tuning::SIM_AMP_IDLE,
            true => Tuning::SIM_AMP_FLIGHT,
        });
        let before = self.battery.charge;
        self.battery.drain(cx, current, DT);
        if self.battery.charge >= before {
            return;
        }
        if self.battery.charge == Charge::Low {
            return cx.text(MavSeverity::WARNING, "Battery low");
        }
        cx.text(MavSeverity::CRITICAL, "Battery critical");
        if self.armed && self.is_in_air {
            match cx.parameter(Tuning::COM_LOW_BAT_ACT) {
                1 => self.enter(Mode::Return, Maneuver::Return),
                2 => self.enter(Mode::Land, Maneuver::Land(self.body.rest())),
                _ => {}
            }
        }
    }

    #[inline(never)]
    fn watch_time(&mut self, cx: &mut Context<'_>) {
        let most = u32::try_from(cx.parameter(Tuning::COM_FLT_TIME_MAX)).unwrap_or(0);
        let is_over = most > 0 && self.time - self.times.took_off >= Duration::from_secs(most.into());
        if self.armed && self.is_in_air && is_over && !self.is_overdue {
            self.is_overdue = true;
            cx.text(MavSeverity::WARNING, "Returning: flight time limit reached");
            self.enter(Mode::Return, Maneuver::Return);
        }
    }

    /// Disarms when the vehicle has not taken off for a while after arming, as PX4 does. A mission is exempt because it may
    /// start with a delay.
    #[inline(never)]
    fn watch_idling(&mut self, cx: &mut Context<'_>) {
        let limit = cx.parameter(Tuning::COM_DISARM_PRFLT);
        let Times { armed, took_off, .. } = self.times;
        let is_idle = self.armed && self.is_landed() && took_off <= armed && self.mode != Mode::Mission;
        if is_idle && limit > 0.0 && self.time - armed >= Duration::from_micros((limit * 1e6) as u64) {
            self.disarm();
            cx.text(MavSeverity::INFO, "Disarmed: no takeoff after arming");
        }
    }

    /// Returns the cruise speed (m/s).
    fn speed(&self, cx: &Context<'_>) -> f32 {
        self.speed.unwrap_or(cx.parameter(Tuning::MPC_XY_CRUISE))
    }

    /// Stops and holds the position. The requested mode ends.
    fn hold(&mut self) {
        self.stop();
        self.intended = Mode::Hold;
    }

    /// Stops and holds the position. [`intended`](Self::intended) stays unchanged.
    fn stop(&mut self) {
        self.enter(Mode::Hold, Maneuver::Stay(self.body.rest()));
        // Keep the heading. The course points backwards when the vehicle flies backwards.
        self.body.nose = Nose::Turn { remaining: 0.0, rate: 0.0 };
    }

    fn touch_down(&mut self, cx: &mut Context<'_>) {
        self.disarm();
        cx.text(MavSeverity::INFO, "Landed, disarmed");
    }

    fn enter(&mut self, mode: Mode, maneuver: Maneuver) {
        if self.mode == Mode::Mission && mode != Mode::Mission {
            self.mission.pause();
            self.leave_payload();
        }
        if mode != Mode::Mission {
            self.body.nose = Nose::Course;
        }
        self.mode = mode;
        self.maneuver = maneuver;
    }
}

/// Returns the time from landing to disarming.
fn disarm_delay(cx: &Context<'_>) -> Duration {
    Duration::from_micros((cx.parameter(Tuning::COM_DISARM_LAND) * 1e6) as u64)
}

impl Default for Quadrotor {
    fn default() -> Self {
        Self::new()
    }
}

impl Components for Quadrotor {
    const COMPONENTS: &'static [Component] =
        &[Component::new(GIMBAL, MavType::GIMBAL), Component::new(CAMERA, MavType::CAMERA)];
    const OPTIONAL: bool = true;
}

impl Vehicle for Quadrotor {
    fn state(&self) -> Option<VehicleState> {
        let flags = match self.mode {
            Mode::Hold | Mode::Offboard => MavModeFlag::GUIDED_ENABLED,
            Mode::Position => MavModeFlag::MANUAL_INPUT_ENABLED,
            _ => MavModeFlag::GUIDED_ENABLED | MavModeFlag::AUTO_ENABLED,
        };
        let system_status = match self.armed {
            _ if self.is_terminated => MavState::FLIGHT_TERMINATION,
            _ if self.is_rebooting() => MavState::POWEROFF,
            _ if self.is_calibrating() => MavState::CALIBRATING,
            false if !self.last.has_fix => MavState::BOOT,
            false => MavState::STANDBY,
            true if self.battery.is_low() => MavState::CRITICAL,
            true => MavState::ACTIVE,
        };
        let state = VehicleState::new(self.armed).with_mode(self.mode.number()).with_status(system_status);
        Some(state.with_flags(MavModeFlag::STABILIZE_ENABLED | flags))
    }

    fn message(&mut self, cx: &mut Context<'_>, frame: &Frame<'_>, _link: LinkId) -> bool {
        self.on_gimbal_information(cx, frame)
    }

    fn control_input(&mut self, _cx: &mut Context<'_>, input: &ControlInput) {
        self.take_input(input);
    }

    /// Permits writing in flight too, because the simulated storage writes within microseconds. On a microcontroller's internal
    /// flash remove this override: by default nothing is written while armed.
    fn may_persist(&self) -> bool {
        true
    }
}
