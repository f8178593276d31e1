//! The satellite link: the content of HIGH_LATENCY2, and the limits for commands that arrive there.

use libm::atan2f;
use mavstack::config::LinkClass;
use mavstack::high_latency::{HighLatencyConfig, HighLatencyMode, HighLatencySample};
use mavstack::message::LatLon;
use mavstack::{Context, Duration, StackOf};

use super::{Mode, Quadrotor};
use crate::app::Mavlink;
use crate::body::Vector;
use crate::plan::Maneuver;
use crate::tuning::Tuning;

/// The mode numbers are PX4's, with main mode and sub-mode in the upper 16 bits. Parameters set the other fields.
pub const CONFIG: HighLatencyConfig =
    HighLatencyConfig { custom_mode: HighLatencyMode::High16, ..HighLatencyConfig::DEFAULT };

/// Sampling interval of the reported values.
const SAMPLING: Duration = Duration::from_millis(100);
/// Distance to the target below which it has no bearing (m).
const ARRIVED: f32 = 0.5;
/// Accuracy of the GPS receiver, horizontal and vertical (m).
pub(crate) const GPS_ERROR: (f32, f32) = (0.9, 1.4);

impl Quadrotor {
    /// Whether a command on a link of this class may be too old to start a flight: true on the ground for a high-latency link
    /// (L-16).
    pub(super) fn may_be_delayed(&self, class: LinkClass) -> bool {
        self.is_landed() && class == LinkClass::HighLatency
    }

    /// Samples the values for HIGH_LATENCY2, and updates the parameters that count the cost of the link.
    #[inline(never)]
    pub(crate) fn watch_satellite(&mut self, stack: &mut StackOf<Mavlink>) {
        if self.time - self.sampled < SAMPLING {
            return;
        }
        self.sampled = self.time;
        let tuning = stack.parameters();
        let period = Duration::from_micros((1e6 / tuning.get(Tuning::MAV_2_HL_FREQ)) as u64);
        let loss = tuning.get(Tuning::MAV_HL_LOSS_T);
        let on_link_loss_after = (loss > 0).then_some(Duration::from_secs(loss as u64));
        let sample = stack.with_context(self.time, |cx| self.high_latency_sample(cx));
        let satellite = &mut stack.high_latency;
        satellite.set_config(HighLatencyConfig { period, on_link_loss_after, ..CONFIG });
        satellite.sample(self.time, &sample);
        let counters = satellite.counters();
        let tuning = stack.parameters_mut();
        tuning.set(Tuning::STAT_HL_BYTES, counters.bytes.min(i32::MAX as u32) as i32);
        tuning.set(Tuning::STAT_HL_CREDITS, counters.credits.min(i32::MAX as u32) as i32);
    }

    fn high_latency_sample(&self, cx: &Context<'_>) -> HighLatencySample {
        const UNKNOWN: (f32, f32) = (f32::NAN, f32::NAN);

        let (status, motion) = (self.sys_status(), self.motion());
        let here = self.body.position;
        let goal = self.goal();
        let distance = goal.map_or(0.0, |goal| here.distance(goal));
        let bearing = goal.filter(|_| distance > ARRIVED).map(|to| atan2f(to.east - here.east, to.north - here.north));
        let (eph, epv) = if self.last.has_fix { GPS_ERROR } else { UNKNOWN };
        let position = self.global_position();
        HighLatencySample {
            position: position.map(LatLon::from),
            altitude: motion.altitude,
            target_altitude: goal.map_or(f32::NAN, |goal| self.home.altitude - goal.down),
            heading: self.body.yaw().to_degrees(),
            target_heading: bearing.map_or(f32::NAN, f32::to_degrees),
            target_distance: distance,
            throttle: motion.throttle,
            airspeed: motion.airspeed,
            airspeed_sp: if goal.is_some() { self.speed(cx) } else { f32::NAN },
            groundspeed: motion.groundspeed,
            // No wind is simulated, so it has no direction.
            windspeed: 0.0,
            wind_from_deg: f32::NAN,
            eph,
            epv,
            // The vehicle has no thermometer.
            temperature_air: f32::NAN,
            climb_rate: -motion.velocity[2],
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

    /// Returns the target of automatic flight. The target of a landing is on the ground.
    fn goal(&self) -> Option<Vector> {
        if !self.armed || self.mode == Mode::Position {
            return None;
        }
        match self.active_maneuver() {
            Maneuver::Stay(to) | Maneuver::Wait { at: to, .. } | Maneuver::Reach { to, .. } | Maneuver::Climb(to) => {
                Some(to)
            }
            Maneuver::Circle { center, .. } => Some(center),
            Maneuver::Land(to) => Some(Vector { down: 0.0, ..to }),
            Maneuver::Return => None,
        }
    }
}
