//! The events of the firmware `options`.

mavstack::events! {
    /// The events of a rover.
    pub struct RoverEvents in "rover" {
        modes Groups {
            /// Manual
            MANUAL = [1],
            /// Automatic
            AUTOMATIC = [4, 5],
        }
        components Parts {
            /// Battery
            BATTERY,
            /// GPS
            GPS,
        }
        arming_checks {
            /// Wait until the GPS has a position.
            NoFix(Error) { satellites: u8 } = "No GPS fix, {3} satellites";
            /// Charge it.
            BatteryTooLow(Error) { voltage: f32 } = "Battery too low: {3:.1} V";
        }
        events {
            /// Charge it soon.
            BatteryLow(Warning) { voltage: f32 } = "Battery low: {1:.1} V";
        }
    }
}
