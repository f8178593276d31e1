//! The parameters. The build script reads this file too.

mavstack::parameters! {
    /// The parameters of the boat.
    pub struct Tuning {
        /// Speed between waypoints.
        CRUISE: f32 = 2.0, 0.5..=8.0, "m/s" { decimals: 1, increment: 0.1 };
        /// Action when the last ground station is lost.
        FS_GCS_ACT: i32 = 1, 0..=2, "" { values: { 0 => "None", 1 => "Hold", 2 => "Return" }, category: "Failsafe" };
        /// Sensors that the boat uses.
        SENSORS: i32 = 3, 0..=7, "" { bitmask: { 0 => "GPS", 1 => "Compass", 2 => "Sonar" }, reboot_required };
        /// MAVLink system id.
        SYS_ID: i32 = 1, 1..=254, "" { system_id };
    }
}
