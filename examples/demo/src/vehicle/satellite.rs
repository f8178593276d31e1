//! The satellite link: what the vehicle reports over it, and what it does not do for whom it hears there.

use libm::atan2f;
use mavstack::{Duration, HighLatencyConfig, HighLatencyMode, HighLatencySample, LatLon, LinkClass};

use super::{Mode, Quadrotor};
use crate::body::Vector;
use crate::plan::Maneuver;
use crate::tuning::Tuning;

/// Its mode numbers are PX4's, main mode and sub-mode in the upper half. The rest is in parameters.
pub const CONFIG: HighLatencyConfig =
    HighLatencyConfig { custom_mode: HighLatencyMode::High16, ..HighLatencyConfig::DEFAULT };

/// How often it looks what there is to report.
const SAMPLING: Duration = Duration::from_millis(100);
/// Nearer than this the way to a place has no direction, m.
const THERE: f32 = 0.5;
/// How far the receiver may be off, m, horizontally and vertically.
pub(crate) const GPS_ERROR: (f32, f32) = (0.9, 1.4);

impl Quadrotor {
    /// Whether what comes by a link of this class may be old news, on the ground, where it must not begin to fly for that
    /// (L-16).
    pub(super) fn may_be_late(&self, class: LinkClass) -> bool {
        self.is_landed() && class == LinkClass::HighLatency
    }

    /// Takes in what the satellite link is to report, and tells what it has cost.
    #[inline(never)]
    pub(super) fn watch_satellite(&mut self) {
        if self.time.since(self.sampled) < SAMPLING {
            return;
        }
        self.sampled = self.time;
        let period = Duration::from_micros((1e6 / self.tuning.get(Tuning::MAV_2_HL_FREQ)) as u64);
        let loss = self.tuning.get(Tuning::MAV_HL_LOSS_T);
        let on_link_loss_after = (loss > 0).then_some(Duration::from_secs(loss.into()));
        self.satellite.set_config(HighLatencyConfig { period, on_link_loss_after, ..CONFIG });
        let sample = self.situation_report();
        self.satellite.sample(self.time, &sample);
        let counters = self.satellite.counters();
        self.tuning.set(Tuning::STAT_HL_BYTES, counters.bytes);
        self.tuning.set(Tuning::STAT_HL_CREDITS, counters.credits);
    }

    fn situation_report(&self) -> HighLatencySample {
        const UNKNOWN: (f32, f32) = (f32::NAN, f32::NAN);

        let (status, hud) = (self.sys_status(), self.vfr_hud());
        let here = self.body.position;
        let goal = self.goal();
        let distance = goal.map_or(0.0, |goal| here.distance(goal));
        let bearing = goal.filter(|_| distance > THERE).map(|to| atan2f(to.east - here.east, to.north - here.north));
        let (eph, epv) = if self.has_fix() { GPS_ERROR } else { UNKNOWN };
        let position = self.global_position();
        HighLatencySample {
            position: position.map(|at| LatLon { latitude: at.latitude, longitude: at.longitude }),
            altitude: hud.alt,
            target_altitude: goal.map_or(f32::NAN, |goal| self.home.altitude - goal.down),
            heading: self.body.yaw().to_degrees(),
            target_heading: bearing.map_or(f32::NAN, f32::to_degrees),
            target_distance: distance,
            throttle: f32::from(hud.throttle),
            airspeed: hud.airspeed,
            airspeed_sp: if goal.is_some() { self.speed() } else { f32::NAN },
            groundspeed: hud.groundspeed,
            // There is none, from nowhere.
            windspeed: 0.0,
            wind_from_deg: f32::NAN,
            eph,
            epv,
            // No thermometer.
            temperature_air: f32::NAN,
            climb_rate: hud.climb,
            battery: 100.0 * self.battery.remaining,
            wp_num: (self.mode == Mode::Mission).then_some(self.mission.current()),
            failure_flags: HighLatencySample::failures(
                status.onboard_control_sensors_present,
                status.onboard_control_sensors_enabled,
                status.onboard_control_sensors_health,
            ),
            custom: [0; 3],
        }
    }

    /// Where it flies to by itself; at the end of a landing that is on the ground.
    fn goal(&self) -> Option<Vector> {
        if !self.armed || self.mode == Mode::Position {
            return None;
        }
        match self.flown() {
            Maneuver::Stay(to) | Maneuver::Wait { at: to, .. } | Maneuver::Reach { to, .. } | Maneuver::Climb(to) => {
                Some(to)
            }
            Maneuver::Land(to) => Some(Vector { down: 0.0, ..to }),
            Maneuver::Return => None,
        }
    }
}
