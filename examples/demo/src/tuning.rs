//! The parameters. Those that PX4 has too use its names, types (INT32 or REAL32) and meanings, because ground stations know them.

use mavstack::parameters;

parameters! {
    /// The vehicle's parameters, each of which changes what it does.
    pub struct Tuning {
        /// Charge of a full battery.
        BAT_CAPACITY: f32 = 5_000.0, 100.0..=100_000.0, "mAh";
        /// It is critical with less of it: see `COM_LOW_BAT_ACT`.
        BAT_CRIT_THR: f32 = 0.07, 0.01..=0.5, "norm";
        /// The operator is warned below this.
        BAT_LOW_THR: f32 = 0.15, 0.01..=0.5, "norm";
        /// Cells in series.
        BAT_N_CELLS: i32 = 3, 1..=10, "";
        /// Resistance of all cells together: what the voltage loses under load.
        BAT_R_INTERNAL: f32 = 0.02, 0.0..=0.2, "Ohm";
        /// A full cell.
        BAT_V_CHARGED: f32 = 4.2, 4.0..=4.4, "V";
        /// An empty cell.
        BAT_V_EMPTY: f32 = 3.5, 2.5..=3.9, "V";
        /// Minimum battery charge for arming; 0 or less: no minimum.
        COM_ARM_BAT_MIN: f32 = 0.0, -1.0..=0.9, "norm";
        /// 1: it arms without a position too.
        COM_ARM_WO_GPS: i32 = 0, 0..=1, "";
        /// How long it stands on the ground until the motors are off.
        COM_DISARM_LAND: f32 = 0.0, 0.0..=60.0, "s";
        /// Disarms when the vehicle has not taken off this long after arming; 0: never.
        COM_DISARM_PRFLT: f32 = 10.0, 0.0..=60.0, "s";
        /// Returns home after this flight time; 0 or less: never.
        COM_FLT_TIME_MAX: i32 = 0, -1..=86_400, "s";
        /// With a critical battery in flight. 0: a warning, 1: it flies home, 2: it lands; 1 and 2: and does not arm.
        COM_LOW_BAT_ACT: i32 = 0, 0..=2, "";
        /// Sticks that are older do not count.
        COM_RC_LOSS_T: f32 = 0.5, 0.1..=35.0, "s";
        /// After a take-off. 0: it holds, 1: it flies the mission.
        COM_TAKEOFF_ACT: i32 = 0, 0..=1, "";
        /// At the fence. 0: nothing, 1: a warning, 2: it holds, 3: it flies home.
        GF_ACTION: i32 = 2, 0..=3, "";
        /// It stops so far from the fence: more than it is wrong about where it comes to rest.
        GF_MARGIN: f32 = 0.5, 0.0..=50.0, "m";
        /// A fence around home; 0: none.
        GF_MAX_HOR_DIST: f32 = 0.0, 0.0..=10_000.0, "m";
        /// The highest above home; 0: no limit.
        GF_MAX_VER_DIST: f32 = 0.0, 0.0..=10_000.0, "m";
        /// How often HIGH_LATENCY2 goes out by satellite, while it does.
        MAV_2_HL_FREQ: f32 = 0.015, 0.001..=1.0, "Hz";
        /// The system whose sticks it follows; 0: any ground station's.
        MAV_GCS_SYSID: u8 = 0, 0..=u8::MAX, "";
        /// HIGH_LATENCY2 goes out by itself so long after the last ground station on the other links was lost; 0: never.
        MAV_HL_LOSS_T: u16 = 0, 0..=3_600, "s";
        /// System id.
        MAV_SYS_ID: i32 = 1, 1..=254, "", [reboot_required];
        /// Where a take-off without an altitude ends.
        MIS_TAKEOFF_ALT: f32 = 10.0, 1.0..=500.0, "m";
        /// Horizontal acceleration.
        MPC_ACC_HOR: f32 = 3.0, 0.5..=15.0, "m/s^2";
        /// Lower than this it comes down with `MPC_LAND_SPEED`.
        MPC_LAND_ALT: f32 = 4.0, 1.0..=50.0, "m";
        /// How fast it touches down.
        MPC_LAND_SPEED: f32 = 0.7, 0.2..=5.0, "m/s";
        /// By hand it turns no faster than this.
        MPC_MAN_Y_MAX: f32 = 90.0, 5.0..=360.0, "deg/s";
        /// By hand it flies no faster than this.
        MPC_VEL_MANUAL: f32 = 8.0, 0.5..=25.0, "m/s";
        /// Cruise speed.
        MPC_XY_CRUISE: f32 = 8.0, 0.5..=25.0, "m/s";
        /// Speed for each metre that is left to fly, for gentle stops.
        MPC_XY_P: f32 = 2.0, 0.1..=4.0, "1/s";
        /// It turns no faster than this.
        MPC_YAWRAUTO_MAX: f32 = 86.0, 5.0..=360.0, "deg/s";
        /// On a way without a heading of its own. 0: the nose points along the course, 1: it stays.
        MPC_YAW_MODE: i32 = 0, 0..=1, "";
        /// It goes down no faster than this.
        MPC_Z_VEL_MAX_DN: f32 = 2.0, 0.5..=8.0, "m/s";
        /// It goes up no faster than this.
        MPC_Z_VEL_MAX_UP: f32 = 3.0, 0.5..=8.0, "m/s";
        /// A waypoint counts as reached within so many metres, unless it says otherwise.
        NAV_ACC_RAD: f32 = 2.0, 0.5..=200.0, "m";
        /// It flies home no lower than this.
        RTL_RETURN_ALT: f32 = 15.0, 0.0..=500.0, "m";
        /// Where it returns to. 0: home or a rally point, whichever is nearest, 1: home.
        RTL_TYPE: i32 = 0, 0..=1, "";
        /// Where it is switched on: altitude above mean sea level.
        SIH_LOC_H0: f32 = 488.0, -400.0..=8_000.0, "m", [reboot_required];
        /// Latitude.
        SIH_LOC_LAT0: i32 = 473_977_420, -850_000_000..=850_000_000, "deg*1e7", [reboot_required];
        /// Longitude.
        SIH_LOC_LON0: i32 = 85_455_940, -1_800_000_000..=1_799_999_999, "deg*1e7", [reboot_required];
        /// What it draws in the air.
        SIM_AMP_FLIGHT: f32 = 18.0, 1.0..=200.0, "A";
        /// What it draws armed on the ground.
        SIM_AMP_IDLE: f32 = 2.0, 0.1..=50.0, "A";
        /// What it draws disarmed.
        SIM_AMP_OFF: f32 = 0.3, 0.0..=5.0, "A";
        /// What the battery has when it is switched on.
        SIM_BAT_START: i8 = 100, 1..=100, "%", [reboot_required];
        /// How far the geoid is above the ellipsoid.
        SIM_GEOID_SEP: i16 = 47, -110..=90, "m";
        /// The receiver needs so long from the start to find its position.
        SIM_GPS_FIX_TIME: u32 = 2_000, 0..=60_000, "ms";
        /// Satellites that it sees then.
        SIM_GPS_SATS: u8 = 14, 4..=40, "";
        /// 1: the flight loop stands still until the next start. What keeps beating then is wrong.
        SIM_HANG: u8 = 0, 0..=1, "", [volatile];
        /// How often it took off.
        STAT_FLIGHTS: u16 = 0, 0..=u16::MAX, "", [read_only];
        /// How long it was in the air, all flights together.
        STAT_FLIGHT_TIME: u32 = 0, 0..=u32::MAX, "s", [read_only];
        /// What went out by satellite since the start.
        STAT_HL_BYTES: u32 = 0, 0..=u32::MAX, "B", [read_only, volatile];
        /// What that cost, at a credit for every 50 bytes of a message that were begun.
        STAT_HL_CREDITS: u32 = 0, 0..=u32::MAX, "", [read_only, volatile];
    }
}
