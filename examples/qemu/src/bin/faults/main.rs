//! The fault matrix: injects faults and checks what must still hold. `cargo xtask faults` runs it. For tests only.
//!
//! This image contains the demo vehicle, its flash in the board's PSRAM, and simulated peers at the other ends of its lines. Time
//! is simulated and random numbers are seeded, so every run is the same. Each scenario prints one line with its figures, or
//! panics with what it found.
#![no_std]
#![no_main]

mod clock;
mod commit;
mod flash;
mod flood;
mod hang;
mod line;
mod overflow;
mod replay;
mod station;
mod transfer;
mod uart;
mod world;

use cortex_m_rt::entry;
use mavstack_qemu::board::Board;
use mavstack_qemu::memory::STACK;
use semihosting::experimental::env;
use semihosting::{println, process};

use crate::flash::{Flash, retain, retained};
use crate::world::{LINES, Parts};

type Scenario = fn(Parts) -> Parts;

const SCENARIOS: [(&str, Scenario); 13] = [
    ("uart-damage", uart::damage),
    ("uart-stall", uart::stall),
    ("gcs-dies", transfer::silent_station),
    ("two-gcs", transfer::two_stations),
    ("reset-in-upload", transfer::reset),
    ("reset-in-commit", commit::cut_plan),
    ("reset-in-parameters", commit::cut_parameters),
    ("reset-in-key", commit::cut_key),
    ("write-errors", commit::write_errors),
    ("clock-wraps", clock::wraps),
    ("replay", replay::replay),
    ("floods", flood::floods),
    ("hung-loop", hang::hung_loop),
];

/// Marks the retained words as valid.
const MARK: u32 = 0x6D61_7635;
// Indices of words that are retained over a reset.
const IS_VALID: usize = 0;
const SCENARIO: usize = 1;
/// Progress of the scenario that resets the processor.
pub const POSITION: usize = 2;

#[entry]
fn main() -> ! {
    static mut LINES_MEMORY: [line::Line; mavstack_demo::LINKS] = LINES;

    overflow::guard();
    let Some(board) = Board::take() else { Board::reset() };
    let mut parts = Parts { stack: STACK.take(), lines: LINES_MEMORY, flash: Flash(board.flash) };
    let arguments = env::args::<128>().expect("arguments from the emulator");
    let mut arguments = (&arguments).flatten().skip(1);
    let wanted = arguments.next();
    if let Some(size) = arguments.next() {
        overflow::run(parts, size.parse().expect("a stack size in bytes"));
    }
    if retained(IS_VALID) != MARK {
        retain(IS_VALID, MARK);
        retain(SCENARIO, 0);
        retain(POSITION, 0);
    }
    let mut is_known = false;
    for (index, (name, run)) in (0..).zip(SCENARIOS) {
        let is_wanted = wanted.is_none_or(|wanted| wanted == name);
        is_known |= is_wanted;
        if !is_wanted || index < retained(SCENARIO) {
            continue;
        }
        retain(SCENARIO, index);
        parts = run(parts);
    }
    if !is_known {
        println!("unknown scenario; use one of:");
        for (name, _) in SCENARIOS {
            println!("  {name}");
        }
        println!("  stack-overflow");
    }
    process::exit(if is_known { 0 } else { 1 })
}
