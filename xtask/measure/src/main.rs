//! `cargo measure`: proofs and figures. What a contributor runs from day to day is `cargo xtask`.

mod compare;
mod compare_firmware;
mod coverage;
mod figures;
mod loom;
mod miri;
mod mutants;
mod nightly;
mod options;
mod panic_free;
mod size;
mod stack;
mod thumb;
mod work;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};
use xtask_common::{emulator, firmware, python, system, toolchain};

use toolchain::Choice;

/// Proofs and figures of mavstack.
///
/// The accepted figures are in docs/figures.toml. A command fails if a figure has moved by more than its tolerance; with `--accept` it
/// writes the new figures into the file and onto the pages that show them.
#[derive(Parser)]
#[command(name = "cargo measure", bin_name = "cargo measure")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Measure flash and RAM of the library on three kinds of microcontroller, and of the demo vehicle.
    ///
    /// A size that moved by more than 1 %, up or down, fails until it is accepted. Inlining is a part of a size: a change anywhere can
    /// move single rows by some per cent, small rows most. If the other rows stay, accept it.
    Size {
        /// Also list the largest functions and constants of each firmware, for Cortex-M4F at opt-level s.
        #[arg(long, value_name = "COUNT", num_args = 0..=1, default_value_t = 0, default_missing_value = "20")]
        symbols: usize,
        /// Measure the Cortex-M4F at opt-level s only, and one firmware of the demo vehicle. `cargo measure nightly size` measures
        /// everything.
        #[arg(long, conflicts_with = "accept")]
        only_m4: bool,
        #[command(flatten)]
        figures: Figures,
        #[command(flatten)]
        build: Build,
    },
    /// Measure what each option adds to the smallest vehicle, and what whole vehicles take.
    ///
    /// Builds some forty firmwares, which takes minutes. A whole vehicle that moved by more than 1 % fails until it is accepted.
    Options {
        #[command(flatten)]
        figures: Figures,
        #[command(flatten)]
        build: Build,
    },
    /// Prove how much stack the library's calls and the demo vehicle's firmware take at most.
    ///
    /// The call graph and each function's frame are read from the machine code. Recursion and calls through a pointer are errors. Stack
    /// painting in the emulator checks the sum.
    Stack {
        #[command(flatten)]
        figures: Figures,
        #[command(flatten)]
        build: Build,
    },
    /// Count the instructions of a poll, in the emulator, under the most expensive traffic.
    Work {
        #[command(flatten)]
        figures: Figures,
        #[command(flatten)]
        build: Build,
    },
    /// Prove that the demo vehicle's firmware, with the whole library in it, cannot panic.
    ///
    /// It links without a panic handler: at opt-level s and 3, with overflow checks on in the library, with and without a log.
    /// `core::fmt`, an allocator and f64 arithmetic are errors too.
    PanicFree {
        /// Only at opt-level s. `cargo measure nightly panic-free` does both.
        #[arg(long)]
        only_s: bool,
        #[command(flatten)]
        build: Build,
    },
    /// Measure other MAVLink libraries beside this one, on the same frames.
    ///
    /// These are mavlink, mavio, and the C library, which is generated and compiled for it. Measured are processor time (the median of
    /// rounds in which all libraries take turns), instructions by valgrind, recovery on damaged streams, and firmwares. Fails where
    /// another library is ahead. Takes some minutes.
    Compare {
        /// How many rounds are measured.
        #[arg(long, default_value_t = 15, value_parser = clap::value_parser!(u16).range(1..))]
        rounds: u16,
        #[command(flatten)]
        figures: Figures,
        #[command(flatten)]
        build: Build,
    },
    /// Measure the lines and branches of the library that its tests reach.
    ///
    /// What is missing (a nightly toolchain, cargo-llvm-cov) is installed first. Builds and runs all tests of the library, which takes a
    /// while.
    Coverage {
        /// Also list the lines that are not reached, and those with branches that are not taken.
        #[arg(long)]
        missing: bool,
        #[command(flatten)]
        figures: Figures,
    },
    /// Run the snapshot between two tasks in every interleaving, with loom.
    Loom,
    /// Run the tests of the library and of the snapshot in Miri, an interpreter that detects undefined behaviour.
    ///
    /// The library has no `unsafe`, but its dependencies and the snapshot have. What is missing (a nightly toolchain, Miri) is installed first. Without
    /// rustup nothing is run, and that is printed.
    Miri {
        #[command(flatten)]
        figures: Figures,
    },
    /// Change the library in one place at a time, and find the changes that no test catches.
    ///
    /// Fails if a mutant survives that is not listed in xtask/measure/mutants.txt with a reason. What is missing (cargo-mutants) is
    /// installed first. One mutant takes seconds, all of them hours.
    Mutants {
        /// Which of signing, frame, mission, storage; by default all.
        #[arg(value_name = "AREA")]
        areas: Vec<String>,
        /// Only a part of the mutants: the K-th of N, from 0.
        #[arg(long, value_name = "K/N")]
        shard: Option<String>,
        /// Only mutants in the lines that this file changes, the output of `git diff`.
        #[arg(long, value_name = "FILE")]
        in_diff: Option<PathBuf>,
        #[command(flatten)]
        figures: Figures,
    },
    /// Compare the figures on all pages with docs/figures.toml.
    Figures {
        /// Correct the pages.
        #[arg(long)]
        write: bool,
    },
    /// Run the checks that take too long for every change, in steps.
    ///
    /// The result and the output of each step are kept in target/nightly, with the tested commit. A step that has passed at this commit
    /// is skipped, so an interrupted run can be resumed. Failures are reported at the end and do not stop the other steps.
    Nightly {
        /// Only the steps whose names start with one of these.
        #[arg(value_name = "STEP")]
        steps: Vec<String>,
        /// Also run the steps that have passed at this commit.
        #[arg(long)]
        again: bool,
        /// Run nothing: print the steps and their results.
        #[arg(long, conflicts_with = "again")]
        list: bool,
    },
}

#[derive(Args)]
struct Figures {
    /// Accept the figures: write them into docs/figures.toml and onto the pages.
    #[arg(long)]
    accept: bool,
}

#[derive(Args)]
struct Build {
    /// The Rust toolchain for the build; by default the first that works.
    #[arg(long)]
    toolchain: Option<Choice>,
}

fn main() -> ExitCode {
    let result = match Arguments::parse().task {
        Task::Size { symbols, only_m4, figures, build } => {
            size::report(build.toolchain, size::Options { accepts: figures.accept, only_m4, symbols })
        }
        Task::Options { figures, build } => options::report(build.toolchain, figures.accept),
        Task::Stack { figures, build } => stack::prove(build.toolchain, figures.accept),
        Task::Work { figures, build } => work::measure(build.toolchain, figures.accept),
        Task::PanicFree { only_s, build } => panic_free::prove(build.toolchain, only_s),
        Task::Compare { rounds, figures, build } => compare::run_all(rounds, build.toolchain, figures.accept),
        Task::Coverage { missing, figures } => coverage::measure(missing, figures.accept),
        Task::Loom => loom::run_tests(),
        Task::Miri { figures } => miri::run_tests(figures.accept),
        Task::Mutants { areas, shard, in_diff, figures } => {
            mutants::run_areas(&mutants::Options { areas, shard, in_diff, accepts: figures.accept })
        }
        Task::Figures { write } => figures::check(write),
        Task::Nightly { steps, again, list } => nightly::run(&nightly::Options { names: steps, again, lists: list }),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
