//! How late flight starts: while storage erases (the firmwares `jitter-rtic` and `jitter-embassy`), and when MAVLink runs in another
//! task (`tasks-loop`, `tasks-rtic` and `tasks-embassy`).
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

const TASKS: [&str; 3] = ["tasks-loop", "tasks-rtic", "tasks-embassy"];
/// What runs in the other task: a delay loop, and the stack.
const LOADS: [&str; 2] = ["delay", "stack"];
/// The most that the stack may add to the delay of flight (ns): a tick of the timer, which cannot tell less.
const MARGIN: u32 = 40;

/// 8 ns for an instruction: 125 MHz at one cycle for each.
const SPEED: &str = "shift=3";

/// `cargo xtask jitter`.
pub fn measure(choice: Option<Choice>) -> Result {
    emulator::prepare()?;
    let choice = toolchain::prepare(choice, &[TARGET])?;
    for firmware in TASKS {
        let elf = firmware::build_jitter(choice, firmware)?;
        let mut most = [None; 2];
        for (load, most) in LOADS.iter().zip(&mut most) {
            run(command_at(SPEED, &elf, &[load]), |line, _| {
                println!("{line}");
                *most = most.or(longest(line));
            })?;
        }
        let [Some(without), Some(with)] = most else { return Err(format!("{firmware} printed no delay")) };
        if with > without + MARGIN {
            return Err(format!("{firmware}: with the stack, flight is late by {with} ns; without, by {without} ns"));
        }
    }
    for firmware in FIRMWARES {
        let elf = firmware::build_jitter(choice, firmware)?;
        for way in WAYS {
            run(command_at(SPEED, &elf, &[way]), |line, _| println!("{line}"))?;
        }
    }
    Ok(())
}

/// Returns the longest delay in a line such as `tasks-loop stack: flight late by 40 to 80 ns …`.
fn longest(line: &str) -> Option<u32> {
    let (_, range) = line.split_once("late by ")?;
    range.split(' ').nth(2)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::longest;

    #[test]
    fn the_longest_delay_is_read() {
        assert_eq!(longest("tasks-loop stack: flight late by 40 to 920 ns in 5000 passes"), Some(920));
        assert_eq!(longest("tasks-loop: 5000 passes took 3 ticks: some were missed"), None);
    }
}
