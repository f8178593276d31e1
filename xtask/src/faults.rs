//! The fault matrix: what may go wrong, as scenarios that the firmware `faults` plays inside the emulator.
//!
//! Time there is the emulated one, 16 ns for an instruction, and all numbers are seeded: each run is the same, on every machine.
//! With a real client at a real socket, and the emulator's own reset button, are `test_faults.py` and `test_power.py` among the
//! tests with ground stations.

use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use crate::emulator::{self, Ended};
use crate::firmware;
use crate::system::Result;
use crate::toolchain::{self, Choice, TARGET};

/// The row of the stack that is too small, which takes one start of the emulator for each size.
const OVERFLOW: &str = "stack-overflow";
/// Bytes; with the last of them the work is done. `cargo measure stack` prints what the vehicle needs.
const STACKS: [u32; 10] = [64, 128, 256, 512, 768, 1_024, 1_536, 2_048, 4_096, 16_384];
/// The others, which the firmware plays one after the other; what each has found begins with its name.
const SCENARIOS: [&str; 13] = [
    "uart-damage",
    "uart-stall",
    "gcs-dies",
    "two-gcs",
    "reset-in-upload",
    "reset-in-commit",
    "reset-in-parameters",
    "reset-in-key",
    "write-errors",
    "clock-wraps",
    "replay",
    "floods",
    "hung-loop",
];

/// `cargo xtask faults`.
pub fn play(scenario: Option<&str>, choice: Option<Choice>) -> Result {
    emulator::prepare()?;
    let choice = toolchain::prepare(choice, &[TARGET])?;
    let elf = firmware::build_faults(choice)?;
    let began = Instant::now();
    if scenario != Some(OVERFLOW) {
        let arguments: Vec<_> = scenario.into_iter().collect();
        let mut missing = scenario.map_or(SCENARIOS.to_vec(), |scenario| vec![scenario]);
        run(command(&elf, &arguments), |line, took| {
            println!("{line} [{:.1} s]", took.as_secs_f32());
            missing.retain(|name| line.split([' ', ':']).next() != Some(name));
        })?;
        if !missing.is_empty() {
            return Err(format!("not played: {}", missing.join(", ")));
        }
    }
    if scenario.is_none_or(|scenario| scenario == OVERFLOW) {
        let mut found = Vec::new();
        for size in STACKS {
            let mut unknown = Vec::new();
            let result = run(command(&elf, &[OVERFLOW, &size.to_string()]), |line, _| match Overflow::parse(line) {
                Some(overflow) if overflow.size == size => found.push(overflow),
                _ => unknown.push(line.to_owned()),
            });
            unknown.iter().for_each(|line| println!("{line}"));
            result?;
        }
        println!("{}", report(&found)?);
    }
    println!("In all: {:.0} s.", began.elapsed().as_secs_f32());
    Ok(())
}

/// Runs the firmware to its end, and passes on each line that it prints, with the time that the line took.
pub fn run(mut command: Command, mut each: impl FnMut(&str, Duration)) -> Result {
    let (mut emulator, output) = emulator::start(&mut command)?;
    let lines = emulator::Lines::of(output);
    let mut last = Instant::now();
    while let Some(line) = lines.next()? {
        each(&line, last.elapsed());
        last = Instant::now();
    }
    let (_nobody, stop) = mpsc::channel();
    match emulator.wait(&stop)? {
        Ended::ByItself(status) if status.success() => Ok(()),
        Ended::ByItself(status) => Err(format!("the firmware found a fault ({status})")),
        Ended::Stopped => Err("stopped".to_owned()),
    }
}

/// Returns the command that runs the firmware with these arguments, at 16 ns for an instruction. While the processor sleeps, its time jumps
/// to the next interrupt and does not depend on the host's.
fn command(elf: &Path, arguments: &[&str]) -> Command {
    command_at("shift=4,sleep=off", elf, arguments)
}

/// Returns the command that runs the firmware with these arguments, at this speed.
pub fn command_at(speed: &str, elf: &Path, arguments: &[&str]) -> Command {
    let mut command = emulator::command();
    let arguments: String = arguments.iter().map(|argument| format!(",arg={argument}")).collect();
    command
        .args(["-machine", emulator::BOARD, "-display", "none", "-monitor", "none", "-serial", "none"])
        .args(["-icount", speed, "-chardev", "stdio,id=log,signal=off", "-semihosting-config"])
        .arg(format!("enable=on,target=native,chardev=log,arg=faults{arguments}"))
        .arg("-kernel")
        .arg(elf)
        .stdin(Stdio::null())
        .stdout(Stdio::piped());
    command
}

/// What became of a stack of some size.
#[derive(Debug, PartialEq, Eq)]
struct Overflow {
    size: u32,
    /// How far outside of RAM the fault was, in bytes; `None` without one.
    outside: Option<u32>,
}

impl Overflow {
    fn parse(line: &str) -> Option<Self> {
        let mut words = line.split_whitespace();
        if words.next()? != OVERFLOW {
            return None;
        }
        let size = words.next()?.parse().ok()?;
        let ended = words.next()?;
        let outside = words.next()?.parse().ok()?;
        let outside = match ended {
            "fault" => Some(outside),
            "enough" => None,
            _ => return None,
        };
        words.next().is_none().then_some(Self { size, outside })
    }
}

/// A larger stack does what a smaller one did, and the smallest is too small: else nothing was tried.
fn report(found: &[Overflow]) -> Result<String> {
    let is_fault = |overflow: &Overflow| overflow.outside.is_some();
    let faults = found.iter().take_while(|overflow| is_fault(overflow)).count();
    if found.len() != STACKS.len() || faults == 0 || faults == found.len() || found.iter().skip(faults).any(is_fault) {
        return Err(format!("{OVERFLOW}: {found:?}"));
    }
    let farthest = found.iter().filter_map(|overflow| overflow.outside).max().unwrap_or(0);
    let (largest, enough) = (found[faults - 1].size, found[faults].size);
    Ok(format!(
        "{OVERFLOW}: {faults} stacks of {} to {largest} bytes: a fault at once, at most {farthest} bytes outside of RAM, nothing \
         else changed; {enough} bytes are enough",
        found[0].size
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_became_of_a_stack_is_read_whole_or_not_at_all() {
        assert_eq!(Overflow::parse("stack-overflow 64 fault 12"), Some(Overflow { size: 64, outside: Some(12) }));
        assert_eq!(Overflow::parse("stack-overflow 4096 enough 0"), Some(Overflow { size: 4_096, outside: None }));
        for line in
            ["", "stack-overflow 64", "stack-overflow 64 panic 0", "stack-overflow 64 fault 1 2", "other 64 fault 1"]
        {
            assert_eq!(Overflow::parse(line), None, "{line}");
        }
    }

    #[test]
    fn small_stacks_fault_and_large_ones_do_not() {
        let found = |faults: usize| -> Vec<_> {
            STACKS
                .iter()
                .enumerate()
                .map(|(at, &size)| Overflow { size, outside: (at < faults).then_some(8) })
                .collect()
        };
        assert!(
            report(&found(5)).is_ok_and(|line| line.contains("768 bytes") && line.contains("1024 bytes are enough"))
        );
        assert!(report(&found(0)).is_err() && report(&found(STACKS.len())).is_err());
        let mut holed = found(5);
        holed[2].outside = None;
        assert!(report(&holed).is_err() && report(&found(5)[1..]).is_err());
    }
}
