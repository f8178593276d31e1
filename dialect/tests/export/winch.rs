//! The messages and commands of a winch, as a firmware declares them.
#![allow(dead_code, missing_docs, reason = "the tests read this file, and compile it")]

use mavstack::CommandRule;
use mavstack::dialect::MavResult;
use mavstack::message::{Char, Location, ParamRule, Text};

mavstack::wire_enum! {
    /// What the winch does.
    pub struct WinchState: u8 {
        /// Nothing moves.
        IDLE = 0,
        LOWERING = 1,
        LIFTING = 2,
    }
}

mavstack::wire_bitmask! {
    /// Faults of the winch.
    pub struct WinchFault: u16 {
        OVERLOAD = 1,
        JAMMED = 2,
        HOT = 0x8000,
    }
}

mavstack::message! {
    /// Reports the state of the winch: "length", tension & <faults>.
    pub struct WinchReport: WINCH_REPORT = 53_100 {
        time_usec: u64,
        /// Energy since boot (J).
        energy: f64 = f64::NAN,
        /// Length of line that is out (m).
        line_out: f32 = f32::NAN,
        /// Acceleration of the hook (m/s/s).
        acceleration: [f32; 3] = [f32::NAN; 3],
        turns: i32 = -1,
        id: u32 = u32::MAX,
        faults: WinchFault,
        /// Tension (mV): the sensor's voltage.
        tension: u16 = u16::MAX,
        temperatures: [i16; 2] = [i16::MAX; 2],
        state: WinchState = WinchState(u8::MAX),
        result: MavResult,
        /// A keyword in Rust.
        r#type: u8,
        trim: i8 = i8::MIN,
        grade: Char,
        name: Text<20>,
        cells: [u8; 4] = [u8::MAX; 4],
    } extensions {
        odometer: i64,
        last: [WinchState; 2],
    }
}

mavstack::message! {
    /// Sets the speed of the winch.
    pub struct WinchControl: WINCH_CONTROL = 53_101 {
        /// Speed, negative to wind up. (m/s)
        speed: f32,
        target_system: u8,
        target_component: u8,
    }
}

pub const WINCH_RUN: CommandRule = CommandRule::without_position(
    50_010,
    &[
        ParamRule::integers(1, 0, 2),
        ParamRule::range(2, -4.0, 4.0).or_nan(),
        ParamRule::integers(3, 0, 1),
        ParamRule::integers(4, 0, 100),
        ParamRule::bits(5, 0x8003),
        ParamRule::at_least(6, 0.5),
    ],
);

pub const WINCH_DROP: CommandRule =
    CommandRule::at_position(50_011, &[ParamRule::integers(1, i32::MIN, 9)]).altitude_optional();

pub const WINCH_HOOK: CommandRule = CommandRule::without_position(50_012, &[]);

mavstack::command! {
    /// Runs the winch.
    pub struct WinchRun = WINCH_RUN {
        state: WinchState = 1,
        /// Speed. (m/s)
        speed: Option<f32> = 2,
        brake: bool = 3,
        percent: u8 = 4,
        faults: WinchFault = 5,
        least_length: f32 = 6,
    }
}

mavstack::command! {
    /// Drops the load at a place.
    pub struct WinchDrop = WINCH_DROP {
        count: i32 = 1,
        location: Location = 5,
    }
}

mavstack::command! {
    /// Opens the hook.
    pub struct WinchHook = WINCH_HOOK {
        angle: Option<f32> = 1,
    }
}

#[cfg(test)]
mod tests {
    mavstack::message! {
        /// No message of the winch.
        struct Untold: UNTOLD = 53_102 {
            a: u8,
        }
    }
}
