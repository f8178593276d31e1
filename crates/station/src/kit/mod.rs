//! A rig for tests of one's own vehicle: the firmware, its lines, a station at each, and a clock that the test moves.
//!
//! A test implements [`Firmware`] once for its vehicle: a pass of the flight loop, and a poll of the stack. A [`Rig`] runs it in simulated
//! time, so a minute of flight takes milliseconds. The rig is a [`GroundStation`](crate::GroundStation): it connects, sets parameters, arms
//! and uploads as the real client does that its station behaves as.
//!
//! | part | what it simulates |
//! |---|---|
//! | [`Line`] | a UART or a radio: rate, delay, lost and damaged frames, small FIFOs, stalls, a cut cable |
//! | [`FlashChip`] | NOR flash: power cuts at any byte, worn units, the time of an erase |
//! | [`Board`] | what a reset keeps |
//! | [`pulse()`] | a pulse for each boot, so that tests in threads are independent |
//!
//! All randomness has a seed. A test that fails prints it, with the time and the vehicle's last texts.

mod board;
mod flash;
mod line;
mod random;
mod rig;

pub use board::Board;
pub use flash::{ERASE_STEPS, FlashChip, FlashError, FlashTimes, RamFlash, Torn, Worn};
pub use line::{Clock, Faults, Line, LineConfig, LineError, Port, Wire};
pub use random::Random;
pub use rig::{Firmware, OnLine, Rig, SEED};

use mavstack::Pulse;

/// Returns a new pulse, for one boot of one vehicle.
///
/// A firmware has its pulse in a `static`. The tests of a program run in threads and would share it: the flight loop of one test keeps the
/// heartbeats of another alive. Let the function that starts your stack take a `&'static Pulse`, and call it with this one.
///
/// The pulse is never freed: it leaks 8 bytes.
pub fn pulse() -> &'static Pulse {
    Box::leak(Box::new(Pulse::new()))
}
