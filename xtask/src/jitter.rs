//! How late flight starts while storage erases, in RTIC and in Embassy: the firmwares `jitter-rtic` and `jitter-embassy`.
//!
//! Time is the emulated one, 8 ns for an instruction, and the traffic is the same in each run.

use crate::emulator;
use crate::faults::{command_at, run};
use crate::firmware;
use crate::system::Result;
use crate::toolchain::{self, Choice, TARGET};

const FIRMWARES: [&str; 2] = ["jitter-rtic", "jitter-embassy"];
/// How storage runs: in a task of its own, and under the lock.
const WAYS: [&str; 2] = ["jobs", "persist"];
/// 8 ns for an instruction: 125 MHz at one cycle for each.
const SPEED: &str = "shift=3";

/// `cargo xtask jitter`.
pub fn measure(choice: Option<Choice>) -> Result {
    emulator::prepare()?;
    let choice = toolchain::prepare(choice, &[TARGET])?;
    for firmware in FIRMWARES {
        let elf = firmware::build_jitter(choice, firmware)?;
        for way in WAYS {
            run(command_at(SPEED, &elf, &[way]), |line, _| println!("{line}"))?;
        }
    }
    Ok(())
}
