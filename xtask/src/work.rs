//! How much a poll can be made to do: instructions, counted by the emulator, of the firmware `work`, to which others send the worst
//! that there is, and all that the fuzzer found.
//!
//! The emulator takes one nanosecond of its own time for an instruction and the firmware measures with SysTick, which ticks every
//! 40: so the counts are the same on every machine.

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::firmware;
use crate::qemu;
use crate::system::{Result, cargo, root, run, target_dir};
use crate::toolchain::{self, Choice, TARGET};

/// A poll's budget.
struct Budget {
    /// The firmware's name for it.
    name: &'static str,
    what: &'static str,
    /// The most instructions of a poll, today: usual traffic's average, the worst of all without signatures, and with them.
    pinned: Pinned,
}

struct Pinned {
    typical: u32,
    worst: u32,
    signed: u32,
}

const BUDGETS: [Budget; 2] = [
    Budget {
        name: "small",
        what: "small: 64 bytes, 2 frames, 1,100 units of work",
        pinned: Pinned { typical: 6_337, worst: 19_360, signed: 50_720 },
    },
    Budget {
        name: "default",
        what: "the default: 128 bytes, 1,700 units of work, which are 3 frames",
        pinned: Pinned { typical: 10_820, worst: 23_640, signed: 66_200 },
    },
];

/// What is usual, and what the worst is measured by: a pair of COMMAND_LONG.
const TYPICAL: &str = "two-commands";
/// A poll with nothing signed takes at most this, whatever comes (GOAL-3).
const BOUND: u32 = 25_000;
/// And at most so many times what that pair takes: twice, and the tolerance.
const TIMES: f64 = 2.2;
/// So many kinds of traffic there are, with the noise and this: what the fuzzer found.
const KINDS: usize = 46;
const CORPUS: &str = "corpus";
/// By so many percent may a figure differ from what it was, up or down.
const TOLERANCE: u32 = 10;

/// A minute of random bytes (GOAL-16): so many polls, of a processor of so many instructions a second, of which they may take so
/// many percent; and a heartbeat may come so much later than the second that it is due (µs).
const NOISE: &str = "noise-1-mbaud-60-s";
const NOISE_POLLS: u32 = 60_000;
const CORE_HZ: u32 = 168_000_000;
const NOISE_SHARE: u32 = 20;
const HEARTBEAT: u32 = 1_000_000;
const NOISE_DELAY: u32 = 100_000;

/// Where the firmware looks for the corpus: the board's PSRAM.
const CORPUS_AT: &str = "0x21000000";

/// `cargo xtask work`.
pub fn measure(choice: Option<Choice>) -> Result {
    qemu::prepare()?;
    let choice = toolchain::prepare(choice, &[TARGET])?;
    let corpus = corpus()?;
    let elf = firmware::build_work(choice)?;
    let started = Instant::now();
    let mut command = qemu::emulator();
    command
        .args(["-machine", qemu::BOARD, "-display", "none", "-monitor", "none", "-icount", "shift=0"])
        .args(["-serial", "stdio", "-device"])
        .arg(format!("loader,file={},addr={CORPUS_AT},force-raw=on", corpus.display()))
        .arg("-kernel")
        .arg(&elf)
        .stdin(Stdio::null())
        .stdout(Stdio::piped());
    let (_emulator, output) = qemu::start(&mut command)?;
    let mut rows = Vec::new();
    let lines = qemu::Lines::of(output);
    while let Some(line) = lines.next()? {
        if line.trim() == "end" {
            return report(&rows, started.elapsed());
        }
        rows.push(Row::parse(&line).ok_or_else(|| format!("the firmware said: {line}"))?);
    }
    Err("the firmware ended before it was done".to_owned())
}

/// What the fuzzer found, as the streams of bytes that the firmware reads; the sessions have to be played for that.
fn corpus() -> Result<PathBuf> {
    let path = target_dir().join("streams.bin");
    // Nothing from before may stand for what is not written now.
    if path.exists() {
        fs::remove_file(&path).map_err(|error| format!("{}: {error}", path.display()))?;
    }
    run(Command::new(cargo())
        .args(["test", "--quiet", "--lib", "--manifest-path"])
        .arg(root().join("fuzz").join("Cargo.toml"))
        .arg("--target-dir")
        .arg(target_dir().join("fuzz").join("test"))
        .args(["--", "--ignored", "write_streams"])
        .env("MAVSTACK_STREAMS", &path))?;
    if !path.exists() {
        return Err("the test `write_streams` of fuzz/ has written nothing".to_owned());
    }
    Ok(path)
}

/// What a kind of traffic costs, in instructions.
#[derive(Debug, PartialEq, Eq)]
struct Row {
    budget: String,
    traffic: String,
    polls: u32,
    /// `poll_link`, on average.
    typical: u32,
    /// `poll_link`, at most.
    worst: u32,
    /// `poll`, at most.
    timers: u32,
    /// The longest time between two heartbeats, µs.
    gap: u32,
}

impl Row {
    fn parse(line: &str) -> Option<Self> {
        let mut words = line.split_whitespace();
        let (budget, traffic) = (words.next()?.to_owned(), words.next()?.to_owned());
        let [polls, typical, worst, timers, gap] = [(); 5].map(|()| words.next().and_then(|word| word.parse().ok()));
        let row = Self { budget, traffic, polls: polls?, typical: typical?, worst: worst?, timers: timers?, gap: gap? };
        words.next().is_none().then_some(row)
    }

    /// How often what `other` takes at most.
    fn times(&self, other: &Self) -> f64 {
        f64::from(self.most()) / f64::from(other.worst.max(1))
    }

    /// The worse of the two calls.
    fn most(&self) -> u32 {
        self.worst.max(self.timers)
    }

    fn is_signed(&self) -> bool {
        self.traffic.starts_with("signed")
    }
}

fn report(rows: &[Row], took: Duration) -> Result {
    let mut complaints = Vec::new();
    for Budget { name, what, pinned } in BUDGETS {
        let own: Vec<_> = rows.iter().filter(|row| row.budget == name).collect();
        println!(
            "\n{what}; instructions\n{:24} {:>7} {:>9} {:>9} {:>13}",
            "", "polls", "average", "worst", "worst poll()"
        );
        for Row { traffic, polls, typical, worst, timers, .. } in &own {
            println!("{traffic:24} {polls:>7} {typical:>9} {worst:>9} {timers:>13}");
        }
        let worst = |is_signed| {
            let rows = own.iter().filter(|row| row.is_signed() == is_signed);
            rows.max_by_key(|row| row.most()).ok_or_else(|| format!("the firmware said nothing of {what}"))
        };
        let (plain, signed) = (worst(false)?, worst(true)?);
        let find = |traffic| {
            let row = own.iter().find(|row| row.traffic == traffic);
            row.ok_or_else(|| format!("the firmware said nothing of {traffic}"))
        };
        let (usual, noise) = (find(TYPICAL)?, find(NOISE)?);
        println!("typical: {} ({TYPICAL}), pinned at {}", usual.typical, pinned.typical);
        let (most, by) = (plain.most(), &plain.traffic);
        println!("the worst: {most} ({by}), pinned at {}, bound {BOUND}", pinned.worst);
        println!("as much as {:.2} times two COMMAND_LONG at their worst, {}", plain.times(usual), usual.worst);
        println!("the worst with signatures: {} ({}), pinned at {}", signed.most(), signed.traffic, pinned.signed);
        let pins = [("typical", usual.typical, pinned.typical), ("worst", most, pinned.worst)];
        for (which, is, was) in pins.into_iter().chain([("worst with signatures", signed.most(), pinned.signed)]) {
            complaints.extend(moved(is, was).map(|complaint| format!("{what}: {which}: {complaint}")));
        }
        if most > BOUND || plain.times(usual) > TIMES {
            complaints.push(format!("{what}: {most} instructions ({by}): out of bounds"));
        }
        if own.len() != KINDS || own.iter().any(|row| row.polls == 0) || find(CORPUS).is_err() {
            complaints
                .push(format!("{what}: {} kinds of traffic, not {KINDS}, or some that came to nothing", own.len()));
        }
        complaints.extend(starved(noise).map(|complaint| format!("{what}: {complaint}")));
    }
    println!("\nmeasured in {} s", took.as_secs());
    if complaints.is_empty() { Ok(()) } else { Err(complaints.join("\n")) }
}

/// What is wrong with a figure that was another.
fn moved(is: u32, was: u32) -> Option<String> {
    let limit = was / 100 * TOLERANCE;
    let what = match is {
        is if is > was + limit => "if that is meant, write it down",
        is if is < was - limit => "better: write it down, so that it stays so",
        _ => return None,
    };
    Some(format!("{is} instructions, pinned at {was}: {what}"))
}

/// Prints what a minute of random bytes costs, at an instruction a cycle and at two cycles for each, and what is wrong with it.
fn starved(noise: &Row) -> Option<String> {
    let thousandths = |cycles: u64| {
        let seconds = u64::from(NOISE_POLLS) / 1_000;
        cycles * u64::from(noise.polls) * u64::from(noise.typical) * 1_000 / (u64::from(CORE_HZ) * seconds)
    };
    let percent = |thousandths: u64| format!("{}.{} %", thousandths / 10, thousandths % 10);
    let (one, two, delay) = (thousandths(1), thousandths(2), noise.gap.saturating_sub(HEARTBEAT));
    println!(
        "a minute of random bytes at 1 Mbit/s: {} of a core of {} MHz at a cycle for each instruction, {} at two; heartbeats up \
         to {delay} µs late",
        percent(one),
        CORE_HZ / 1_000_000,
        percent(two),
    );
    let is_whole = noise.polls == NOISE_POLLS && noise.gap >= HEARTBEAT;
    let is_good = is_whole && two <= u64::from(NOISE_SHARE) * 10 && delay <= NOISE_DELAY;
    (!is_good).then(|| format!("random bytes: bound {NOISE_SHARE} % of the core and {NOISE_DELAY} µs"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINE: &str = "small noise-1-mbaud-60-s 60000 1200 3400 560 1000000";

    #[test]
    fn a_line_of_the_firmware_is_read_whole_or_not_at_all() {
        let row = Row::parse(LINE).unwrap();
        assert_eq!((row.budget.as_str(), row.traffic.as_str()), ("small", NOISE));
        assert_eq!((row.polls, row.typical, row.worst, row.timers, row.gap), (60_000, 1_200, 3_400, 560, 1_000_000));
        for line in ["small noise 600 1200 3400 560", &format!("{LINE} 7"), "small noise a b c d e", ""] {
            assert_eq!(Row::parse(line), None, "{line}");
        }
    }

    #[test]
    fn a_figure_that_moved_is_told_either_way() {
        for is in [900, 1_000, 1_100] {
            assert_eq!(moved(is, 1_000), None);
        }
        assert!(moved(1_101, 1_000).unwrap().contains("if that is meant"));
        assert!(moved(899, 1_000).unwrap().contains("better"));
    }

    #[test]
    fn noise_that_takes_the_core_or_holds_up_heartbeats_is_told() {
        let row = |typical, gap| Row { typical, gap, ..Row::parse(LINE).unwrap() };
        assert_eq!(starved(&row(16_800, 1_100_000)), None);
        for bad in [row(16_900, 1_000_000), row(100, 1_100_001), row(100, 0)] {
            assert!(starved(&bad).is_some(), "{bad:?}");
        }
    }

    #[test]
    fn a_budget_of_which_nothing_was_heard_is_an_error() {
        assert!(report(&[], Duration::ZERO).is_err());
    }
}
