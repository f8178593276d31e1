//! What may go wrong, and what has to hold then: the fault matrix. `cargo xtask faults` runs it. Nobody flies with it.
//!
//! The demo vehicle, its flash in the board's PSRAM, and at the other ends of its lines those who talk to it: all in this image,
//! with a time of its own and numbers that are no chance, so that each run is the same. Each scenario prints a line with its
//! figures, or panics and says what it has seen.
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

use core::mem::MaybeUninit;

use cortex_m_rt::entry;
use mavstack_qemu::board::Board;
use mavstack_qemu::memory::{self, DemoApp};
use semihosting::experimental::env;
use semihosting::{println, process};

use crate::flash::{Flash, keep, kept};
use crate::world::{LINES, Parts};

type Scenario = fn(Parts) -> Parts;

const SCENARIOS: [(&str, Scenario); 13] = [
    ("uart-damage", uart::damage),
    ("uart-stall", uart::stall),
    ("gcs-dies", transfer::dead_station),
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

/// In what is kept over a reset: that it is kept, and where we were.
const MARK: u32 = 0x6D61_7635;
const IS_KEPT: usize = 0;
const SCENARIO: usize = 1;
/// For the scenario that resets.
pub const POSITION: usize = 2;

#[entry]
fn main() -> ! {
    static mut APP: MaybeUninit<DemoApp> = MaybeUninit::uninit();
    static mut PLACE: [line::Line; mavstack_demo::LINKS] = LINES;

    overflow::guard();
    let Some(board) = Board::take() else { Board::reset() };
    let app = memory::make(APP);
    flash::keep_new(app);
    let mut parts = Parts { app, lines: PLACE, flash: board.flash.map(Flash) };
    let arguments = env::args::<128>().expect("the emulator tells what to run");
    let mut arguments = (&arguments).flatten().skip(1);
    let wanted = arguments.next();
    if let Some(size) = arguments.next() {
        overflow::run(parts, size.parse().expect("a size of the stack"));
    }
    if kept(IS_KEPT) != MARK {
        keep(IS_KEPT, MARK);
        keep(SCENARIO, 0);
        keep(POSITION, 0);
    }
    let mut is_known = false;
    for (index, (name, run)) in (0..).zip(SCENARIOS) {
        let is_wanted = wanted.is_none_or(|wanted| wanted == name);
        is_known |= is_wanted;
        if !is_wanted || index < kept(SCENARIO) {
            continue;
        }
        keep(SCENARIO, index);
        parts = run(parts);
    }
    if !is_known {
        println!("the scenarios are:");
        for (name, _) in SCENARIOS {
            println!("  {name}");
        }
        println!("  stack-overflow");
    }
    process::exit(if is_known { 0 } else { 1 })
}
