//! The vehicle's events, and its checks before arming. The texts are in `metadata/events.json`, which a test in `examples/sitl`
//! compares.

use crate::vehicle::Mode;

mavstack::events! {
    /// The events of the demo vehicle.
    pub struct DemoEvents in "demo" {
        enums {
            /// A flight mode.
            ModeName: u8 {
                /// Position
                POSITION = 0,
                /// Offboard
                OFFBOARD = 1,
                /// Takeoff
                TAKEOFF = 2,
                /// Hold
                HOLD = 3,
                /// Mission
                MISSION = 4,
                /// Return
                RETURN = 5,
                /// Land
                LAND = 6,
            }
        }
        modes ModeGroups {
            /// Manual
            MANUAL = [Mode::Position.number()],
            /// Offboard
            OFFBOARD = [Mode::Offboard.number()],
            /// Automatic
            AUTOMATIC = [
                Mode::Takeoff.number(),
                Mode::Hold.number(),
                Mode::Mission.number(),
                Mode::Return.number(),
                Mode::Land.number(),
            ],
        }
        components Health {
            /// System
            SYSTEM,
            /// Sensors
            SENSORS,
            /// GPS
            GPS,
            /// Battery
            BATTERY,
        }
        arming_checks {
            /// The motors stay off until the next boot.
            Terminated(Critical) = "Flight terminated";
            /// Keep the vehicle still.
            Calibrating(Error) = "Calibrating";
            /// Wait until the receiver has a position. <param>COM_ARM_WO_GPS</param> permits arming without one.
            NoFix(Error) { satellites: u8 } = "No GPS fix, {3} satellites";
            /// Bring the vehicle into the fence, or change the fence.
            OutsideFence(Error) = "Outside the fence";
            /// Charge it. <param>COM_ARM_BAT_MIN</param> is the least charge.
            BatteryTooLow(Error) { remaining: u8 } = "Battery too low: {3} %";
        }
        health_checks {
            /// Charge it after this flight.
            BatteryLow(Warning) { remaining: u8 } = "Battery low: {3} %";
        }
        events {
            Armed(Info) { mode: ModeName } = "Armed in {1}";
            Disarmed(Info) = "Disarmed";
            TookOff(Info) = "Took off";
            Landed(Info) { /** flight time in s */ flown: u32, /** in % */ battery: u8 } = "Landed after {1} s, battery at {2} %";
            ModeChanged(Info, Debug) { mode: ModeName, /** whether it was requested */ intended: u8 } = "Mode {1}";
        }
    }
}
