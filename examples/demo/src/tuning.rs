//! The parameters. Parameters that PX4 has too use its names, types (INT32 or REAL32) and meanings, which ground stations know.
//! The doc comments are the descriptions that ground stations show.

use mavstack::parameters;

parameters! {
    /// The vehicle's parameters. Each one affects its behaviour.
    pub struct Tuning {
        /// Battery capacity.
        BAT_CAPACITY: f32 = 5_000.0, 100.0..=100_000.0, "mAh";
        /// Critical battery threshold: see `COM_LOW_BAT_ACT`.
        BAT_CRIT_THR: f32 = 0.07, 0.01..=0.5, "norm";
        /// Low battery threshold: the vehicle warns below it.
        BAT_LOW_THR: f32 = 0.15, 0.01..=0.5, "norm";
        /// Number of battery cells in series.
        BAT_N_CELLS: i32 = 3, 1..=10, "";
        /// Internal resistance of the battery, which reduces its voltage under load.
        BAT_R_INTERNAL: f32 = 0.02, 0.0..=0.2, "Ohm";
        /// Voltage of a full cell.
        BAT_V_CHARGED: f32 = 4.2, 4.0..=4.4, "V";
        /// Voltage of an empty cell.
        BAT_V_EMPTY: f32 = 3.5, 2.5..=3.9, "V";
        /// System id of the arm authoriser, which must permit each arming; 0: none.
        COM_ARM_AUTH_ID: i32 = 0, 0..=255, "";
        /// Minimum battery charge for arming; 0 or less: no minimum.
        COM_ARM_BAT_MIN: f32 = 0.0, -1.0..=0.9, "norm";
        /// Arming without a position fix.
        COM_ARM_WO_GPS: i32 = 0, 0..=1, "" { values: { 0 => "Refused", 1 => "Allowed" } };
        /// Time from landing to disarming.
        COM_DISARM_LAND: f32 = 0.0, 0.0..=60.0, "s";
        /// Time after arming until the vehicle disarms if it has not taken off; 0: never.
        COM_DISARM_PRFLT: f32 = 10.0, 0.0..=60.0, "s";
        /// Flight time after which the vehicle returns; 0 or less: no limit.
        COM_FLT_TIME_MAX: i32 = 0, -1..=86_400, "s";
        /// Action at a critical battery in flight. With any but a warning, arming is refused too.
        COM_LOW_BAT_ACT: i32 = 0, 0..=2, "" { values: { 0 => "Warning", 1 => "Return", 2 => "Land" } };
        /// Timeout of manual control input.
        COM_RC_LOSS_T: f32 = 0.5, 0.1..=35.0, "s";
        /// Action after takeoff.
        COM_TAKEOFF_ACT: i32 = 0, 0..=1, "" { values: { 0 => "Hold", 1 => "Start the mission" } };
        /// Action at the fence.
        GF_ACTION: i32 = 2, 0..=3, "" { values: { 0 => "None", 1 => "Warning", 2 => "Hold", 3 => "Return" } };
        /// Distance from the fence at which the vehicle stops. It must exceed the error of the predicted stopping point.
        GF_MARGIN: f32 = 0.5, 0.0..=50.0, "m";
        /// Maximum horizontal distance from home; 0: no limit.
        GF_MAX_HOR_DIST: f32 = 0.0, 0.0..=10_000.0, "m";
        /// Maximum height above home; 0: no limit.
        GF_MAX_VER_DIST: f32 = 0.0, 0.0..=10_000.0, "m";
        /// Rate of HIGH_LATENCY2 on the satellite link while it is enabled.
        MAV_2_HL_FREQ: f32 = 0.015, 0.001..=1.0, "Hz" { decimals: 3 };
        /// System id that may send manual control and setpoints; 0: any ground station.
        MAV_GCS_SYSID: i32 = 0, 0..=255, "";
        /// Time after losing the last ground station on the other links until HIGH_LATENCY2 starts automatically; 0: never.
        MAV_HL_LOSS_T: i32 = 0, 0..=3_600, "s";
        /// MAVLink system id.
        MAV_SYS_ID: i32 = 1, 1..=254, "" { system_id, category: "System" };
        /// Default takeoff altitude.
        MIS_TAKEOFF_ALT: f32 = 10.0, 1.0..=500.0, "m" { decimals: 1, increment: 0.5 };
        /// Maximum horizontal acceleration.
        MPC_ACC_HOR: f32 = 3.0, 0.5..=15.0, "m/s^2";
        /// Height below which the vehicle descends at `MPC_LAND_SPEED`.
        MPC_LAND_ALT: f32 = 4.0, 1.0..=50.0, "m";
        /// Touchdown speed.
        MPC_LAND_SPEED: f32 = 0.7, 0.2..=5.0, "m/s";
        /// Maximum yaw rate in manual flight.
        MPC_MAN_Y_MAX: f32 = 90.0, 5.0..=360.0, "deg/s";
        /// Maximum horizontal speed in manual flight.
        MPC_VEL_MANUAL: f32 = 8.0, 0.5..=25.0, "m/s";
        /// Cruise speed.
        MPC_XY_CRUISE: f32 = 8.0, 0.5..=25.0, "m/s" { decimals: 1, increment: 0.5 };
        /// Approach speed per metre of remaining distance. Lower values give gentler stops.
        MPC_XY_P: f32 = 2.0, 0.1..=4.0, "1/s";
        /// Maximum yaw rate in automatic flight.
        MPC_YAWRAUTO_MAX: f32 = 86.0, 5.0..=360.0, "deg/s";
        /// Heading where the plan gives none.
        MPC_YAW_MODE: i32 = 0, 0..=1, "" { values: { 0 => "Along the course", 1 => "Unchanged" } };
        /// Maximum descent rate.
        MPC_Z_VEL_MAX_DN: f32 = 2.0, 0.5..=8.0, "m/s";
        /// Maximum climb rate.
        MPC_Z_VEL_MAX_UP: f32 = 3.0, 0.5..=8.0, "m/s";
        /// Default acceptance radius of waypoints.
        NAV_ACC_RAD: f32 = 2.0, 0.5..=200.0, "m";
        /// Minimum height above home for the return flight.
        RTL_RETURN_ALT: f32 = 15.0, 0.0..=500.0, "m";
        /// Return destination.
        RTL_TYPE: i32 = 0, 0..=1, "" { values: { 0 => "Home or a rally point, whichever is nearest", 1 => "Home" } };
        /// Altitude at boot, above mean sea level.
        SIH_LOC_H0: f32 = 488.0, -400.0..=8_000.0, "m" { reboot_required };
        /// Latitude at boot.
        SIH_LOC_LAT0: i32 = 473_977_420, -850_000_000..=850_000_000, "deg*1e7" { reboot_required };
        /// Longitude at boot.
        SIH_LOC_LON0: i32 = 85_455_940, -1_800_000_000..=1_799_999_999, "deg*1e7" { reboot_required };
        /// Current drawn in flight.
        SIM_AMP_FLIGHT: f32 = 18.0, 1.0..=200.0, "A";
        /// Current drawn when armed on the ground.
        SIM_AMP_IDLE: f32 = 2.0, 0.1..=50.0, "A";
        /// Current drawn when disarmed.
        SIM_AMP_OFF: f32 = 0.3, 0.0..=5.0, "A";
        /// Battery charge at boot.
        SIM_BAT_START: i32 = 100, 1..=100, "%" { reboot_required };
        /// Height of the geoid above the ellipsoid.
        SIM_GEOID_SEP: i32 = 47, -110..=90, "m";
        /// Time from boot to the first GPS fix.
        SIM_GPS_FIX_TIME: i32 = 2_000, 0..=60_000, "ms";
        /// Number of visible satellites after the first fix.
        SIM_GPS_SATS: i32 = 14, 4..=40, "";
        /// The flight loop hangs until the next boot. Heartbeats must then stop.
        SIM_HANG: i32 = 0, 0..=1, "" { values: { 0 => "Off", 1 => "On" }, category: "Developer", volatile };
        /// Number of flights.
        STAT_FLIGHTS: i32 = 0, 0..=i32::MAX, "" { read_only };
        /// Total flight time.
        STAT_FLIGHT_TIME: i32 = 0, 0..=i32::MAX, "s" { read_only };
        /// Bytes sent by satellite since boot.
        STAT_HL_BYTES: i32 = 0, 0..=i32::MAX, "B" { read_only, volatile };
        /// Satellite credits used since boot: one per 50 bytes of a message, rounded up.
        STAT_HL_CREDITS: i32 = 0, 0..=i32::MAX, "" { read_only, volatile };
    }
}
