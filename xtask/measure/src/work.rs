//! `cargo measure work`: the cost of a poll, in instructions. The firmware `work` receives the most expensive traffic that is known,
//! and all that the fuzzer found.
//!
//! The emulator takes one nanosecond of its own time for an instruction, and the firmware measures with SysTick, which ticks every
//! 40 ns: so the counts are the same on every machine.

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::emulator;
use crate::figures::{Figure, grouped, settle};
use crate::firmware;
use crate::system::{Result, cargo, root, run, target_dir};
use crate::toolchain::{self, Choice, TARGET};

/// A poll's budget.
struct Budget {
    /// The firmware's name for it, and the begin of its figures' keys.
    name: &'static str,
    what: &'static str,
}

const BUDGETS: [Budget; 2] = [
    Budget { name: "small", what: "the small budget: 64 bytes, 2 frames, 1,100 cost units" },
    Budget { name: "default", what: "the default budget: 128 bytes, 1,700 cost units, which are 3 frames" },
];

/// The usual traffic, which the worst is compared with: a pair of COMMAND_LONG.
const TYPICAL: &str = "two-commands";
/// The instructions of a poll without signatures at most, whatever is received.
const BOUND: u32 = 30_000;
/// The same, as a multiple of the worst poll with that pair: twice, and the tolerance.
const TIMES: f64 = 2.2;
/// How many kinds of traffic there are: with the noise, and with the fuzzer's corpus.
const KINDS: usize = 46;
const CORPUS: &str = "corpus";
/// A figure that moved by more than this (%), up or down, has to be accepted.
const TOLERANCE: f64 = 10.0;

/// A minute of random bytes: its polls; the processor's clock; the share of the processor at most (%); the time between two
/// heartbeats, and how late one may be (µs).
const NOISE: &str = "noise-1-mbaud-60-s";
const NOISE_POLLS: u32 = 60_000;
const CORE_HZ: u32 = 168_000_000;
const NOISE_SHARE: u32 = 20;
const HEARTBEAT: u32 = 1_000_000;
const NOISE_DELAY: u32 = 100_000;

/// Where the firmware looks for the corpus: the board's PSRAM.
const CORPUS_AT: &str = "0x21000000";

/// `cargo measure work`.
pub fn measure(choice: Option<Choice>, accepts: bool) -> Result {
    emulator::prepare()?;
    let choice = toolchain::prepare(choice, &[TARGET])?;
    let corpus = corpus()?;
    let elf = firmware::build_work(choice)?;
    let started = Instant::now();
    let mut command = emulator::command();
    command
        .args(["-machine", emulator::BOARD, "-display", "none", "-monitor", "none", "-icount", "shift=0"])
        .args(["-serial", "stdio", "-device"])
        .arg(format!("loader,file={},addr={CORPUS_AT},force-raw=on", corpus.display()))
        .arg("-kernel")
        .arg(&elf)
        .stdin(Stdio::null())
        .stdout(Stdio::piped());
    let (_emulator, output) = emulator::start(&mut command)?;
    let mut rows = Vec::new();
    let lines = emulator::Lines::of(output);
    while let Some(line) = lines.next()? {
        if line.trim() == "end" {
            let figures = report(&rows, started.elapsed())?;
            return settle("work", &toolchain::release(choice), &figures, accepts);
        }
        rows.push(Row::parse(&line).ok_or_else(|| format!("the firmware said: {line}"))?);
    }
    Err("the firmware ended before it was done".to_owned())
}

/// Writes what the fuzzer found as the byte streams that the firmware reads, and returns the file. The sessions are run for that.
fn corpus() -> Result<PathBuf> {
    let path = target_dir().join("streams.bin");
    // A file of an earlier run must not be taken for that of this run.
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

/// The cost of a kind of traffic, in instructions.
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

    /// Returns its worst call as a multiple of the worst `poll_link` of `other`.
    fn times(&self, other: &Self) -> f64 {
        f64::from(self.most()) / f64::from(other.worst.max(1))
    }

    /// Returns the worse of the two calls.
    fn most(&self) -> u32 {
        self.worst.max(self.timers)
    }

    fn is_signed(&self) -> bool {
        self.traffic.starts_with("signed")
    }
}

/// Prints the costs, and returns the figures; an error where a bound is broken.
fn report(rows: &[Row], took: Duration) -> Result<Vec<Figure>> {
    let (mut complaints, mut figures) = (Vec::new(), Vec::new());
    for Budget { name, what } in BUDGETS {
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
            rows.max_by_key(|row| row.most()).ok_or_else(|| format!("the firmware reported nothing for {what}"))
        };
        let (plain, signed) = (worst(false)?, worst(true)?);
        let find = |traffic| {
            let row = own.iter().find(|row| row.traffic == traffic);
            row.ok_or_else(|| format!("the firmware reported nothing for {traffic}"))
        };
        let (usual, noise) = (find(TYPICAL)?, find(NOISE)?);
        println!("typical: {} ({TYPICAL})", usual.typical);
        let (most, by) = (plain.most(), &plain.traffic);
        println!("the worst: {most} ({by}), bound {BOUND}");
        println!("that is {:.2} times the worst poll with two COMMAND_LONG, {}", plain.times(usual), usual.worst);
        println!("the worst with signatures: {} ({})", signed.most(), signed.traffic);
        if most > BOUND || plain.times(usual) > TIMES {
            complaints.push(format!("{what}: {most} instructions ({by}): above the bound"));
        }
        if own.len() != KINDS || own.iter().any(|row| row.polls == 0) || find(CORPUS).is_err() {
            complaints
                .push(format!("{what}: {} kinds of traffic, expected {KINDS}, or some without a poll", own.len()));
        }
        let (share, complaint) = starved(noise);
        complaints.extend(complaint.map(|complaint| format!("{what}: {complaint}")));
        let instructions = [("typical", usual.typical), ("worst", most), ("signed", signed.most())];
        let instructions = instructions.map(|(key, count)| (key, grouped(count.into())));
        let others = [("times", format!("{:.2}", plain.times(usual))), ("noise", share)];
        let figure = |(key, value)| Figure::new(format!("{name}.{key}"), value).within(TOLERANCE);
        figures.extend(instructions.into_iter().chain(others).map(figure));
    }
    // Without the noise and the corpus, which have figures of their own.
    figures.push(Figure::new("kinds", KINDS - 2).within(0.0));
    println!("\nmeasured in {} s", took.as_secs());
    if complaints.is_empty() { Ok(figures) } else { Err(complaints.join("\n")) }
}

/// Prints the cost of a minute of random bytes, at one cycle an instruction and at two. Returns the former as a share of the
/// processor (%), and what is wrong.
fn starved(noise: &Row) -> (String, Option<String>) {
    let thousandths = |cycles: u64| {
        let seconds = u64::from(NOISE_POLLS) / 1_000;
        cycles * u64::from(noise.polls) * u64::from(noise.typical) * 1_000 / (u64::from(CORE_HZ) * seconds)
    };
    let percent = |thousandths: u64| format!("{}.{}", thousandths / 10, thousandths % 10);
    let (one, two, delay) = (thousandths(1), thousandths(2), noise.gap.saturating_sub(HEARTBEAT));
    println!(
        "a minute of random bytes at 1 Mbit/s: {} % of a processor of {} MHz at one cycle an instruction, {} % at two; heartbeats up \
         to {delay} µs late",
        percent(one),
        CORE_HZ / 1_000_000,
        percent(two),
    );
    let is_whole = noise.polls == NOISE_POLLS && noise.gap >= HEARTBEAT;
    let is_good = is_whole && two <= u64::from(NOISE_SHARE) * 10 && delay <= NOISE_DELAY;
    let complaint = format!("random bytes: the bound is {NOISE_SHARE} % of the processor and {NOISE_DELAY} µs");
    (percent(one), (!is_good).then_some(complaint))
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
    fn noise_that_takes_the_processor_or_delays_heartbeats_is_told() {
        let row = |typical, gap| Row { typical, gap, ..Row::parse(LINE).unwrap() };
        assert_eq!(starved(&row(16_800, 1_100_000)), ("10.0".to_owned(), None));
        for bad in [row(16_900, 1_000_000), row(100, 1_100_001), row(100, 0)] {
            assert!(starved(&bad).1.is_some(), "{bad:?}");
        }
    }

    #[test]
    fn a_budget_of_which_nothing_was_heard_is_an_error() {
        assert!(report(&[], Duration::ZERO).is_err());
    }
}
