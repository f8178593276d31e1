//! How much a poll can be made to do: instructions, counted by the emulator, of the firmware `work`, to which others send the worst
//! that there is.
//!
//! The emulator takes one nanosecond of its own time for an instruction and the firmware measures with SysTick, which ticks every
//! 40: so the counts are the same on every machine.

use std::io::{BufRead, BufReader};
use std::process::Stdio;

use crate::firmware;
use crate::qemu;
use crate::system::Result;
use crate::toolchain::{self, Choice, TARGET};

/// Budgets of a poll: the firmware's name for it, what it is, the most instructions that a poll may take, and what its worst
/// one takes today.
const BUDGETS: [(&str, &str, u32, u32); 2] = [
    ("small", "64 bytes in, 2 frames, one frame out", 25_000, 25_000),
    ("default", "the default: 128 bytes in, 8 frames, 280 bytes out", 45_200, 41_040),
];

/// A change of the worst poll by more is to be looked at.
const TOLERANCE_PERCENT: u32 = 10;

/// `cargo xtask work`.
pub fn measure(choice: Option<Choice>) -> Result {
    qemu::prepare()?;
    let choice = toolchain::prepare(choice, &[TARGET])?;
    let elf = firmware::build_work(choice)?;
    let mut command = qemu::emulator();
    command
        .args(["-machine", qemu::BOARD, "-display", "none", "-monitor", "none", "-icount", "shift=0"])
        .args(["-serial", "stdio", "-kernel"])
        .arg(&elf)
        .stdin(Stdio::null())
        .stdout(Stdio::piped());
    let (_emulator, output) = qemu::start(&mut command)?;
    let mut rows = Vec::new();
    for line in BufReader::new(output).lines() {
        let line = line.map_err(|error| format!("the emulator's output: {error}"))?;
        if line.trim() == "end" {
            return report(&rows);
        }
        rows.push(Row::parse(&line).ok_or_else(|| format!("the firmware said: {line}"))?);
    }
    Err("the firmware ended before it was done".to_owned())
}

/// What a kind of traffic costs, in instructions.
#[derive(Debug, PartialEq, Eq)]
struct Row {
    budget: String,
    traffic: String,
    /// `poll_link`, on average.
    typical: u32,
    /// `poll_link`, at most.
    worst: u32,
    /// `poll`, at most.
    timers: u32,
}

impl Row {
    fn parse(line: &str) -> Option<Self> {
        let mut words = line.split_whitespace();
        let (budget, traffic) = (words.next()?.to_owned(), words.next()?.to_owned());
        let [typical, worst, timers] = [(); 3].map(|()| words.next().and_then(|word| word.parse().ok()));
        let row = Self { budget, traffic, typical: typical?, worst: worst?, timers: timers? };
        words.next().is_none().then_some(row)
    }
}

fn report(rows: &[Row]) -> Result {
    let mut complaints = Vec::new();
    for (name, what, bound, pinned) in BUDGETS {
        let own = || rows.iter().filter(|row| row.budget == name);
        println!("\n{:40} {:>9} {:>9} {:>12}", format!("{what}; instructions"), "average", "worst", "worst poll()");
        for Row { traffic, typical, worst, timers, .. } in own() {
            println!("{traffic:40} {typical:>9} {worst:>9} {timers:>12}");
        }
        let worst = own().map(|row| row.worst.max(row.timers)).max().ok_or_else(|| format!("nothing on {what}"))?;
        println!("{:40} {:>9} {worst:>9}", format!("the worst of all, bound {bound}"), "");
        complaints.extend(complaint(what, worst, bound, pinned));
    }
    if complaints.is_empty() { Ok(()) } else { Err(complaints.join("\n")) }
}

/// What is wrong with a worst poll of so many instructions.
fn complaint(what: &str, worst: u32, bound: u32, pinned: u32) -> Option<String> {
    if worst > bound {
        return Some(format!("{what}: {worst} instructions, bound {bound}"));
    }
    let tolerance = pinned / 100 * TOLERANCE_PERCENT;
    (worst.abs_diff(pinned) > tolerance)
        .then(|| format!("{what}: {worst} instructions, pinned at {pinned}: write the new figure down if it is meant"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_the_firmware_is_read_whole_or_not_at_all() {
        let row = Row::parse("small noise 1200 3400 560").unwrap();
        assert_eq!((row.budget.as_str(), row.traffic.as_str()), ("small", "noise"));
        assert_eq!((row.typical, row.worst, row.timers), (1200, 3400, 560));
        for line in ["small noise 1200 3400", "small noise 1200 3400 560 7", "small noise a b c", ""] {
            assert_eq!(Row::parse(line), None, "{line}");
        }
    }

    #[test]
    fn a_worst_poll_beyond_the_bound_or_far_from_the_last_one_is_told() {
        assert_eq!(complaint("", 1000, 1000, 1000), None);
        assert_eq!(complaint("", 900, 1000, 1000), None);
        assert!(complaint("", 1001, 1000, 1000).unwrap().contains("bound"));
        assert!(complaint("", 899, 1000, 1000).unwrap().contains("pinned"));
        assert!(complaint("", 1101, 2000, 1000).unwrap().contains("pinned"));
    }

    #[test]
    fn a_budget_of_which_nothing_was_heard_is_an_error() {
        assert!(report(&[]).is_err());
    }
}
