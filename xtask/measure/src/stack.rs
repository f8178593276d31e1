//! `cargo measure stack`: the most stack that the firmware can ever take, as the sum of the frames along the deepest chain of calls.
//!
//! The sum is a proof only if every call is known and nothing recurses, so a call through a pointer and a cycle are errors here.
//! Interrupts are masked in the measured firmware; the stack of interrupt handlers comes on top.
//!
//! Stack painting in the emulator checks the sum: the firmware `painted` fills the free RAM with a pattern, exercises all services,
//! and reports how much of the pattern is overwritten. That must not exceed the sum for the same firmware.
//!
//! The stack is begun in place only if it starts as zeros: the firmware's `static` with `VACANT` must lie in `.bss`.
//!
//! For the Cortex-M4 only. Code for the Cortex-M0 uses a helper of the compiler's library for jump tables, and its targets are known
//! at run time only.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Stdio;

use object::read::elf::ElfFile32;
use object::{Endianness, Object, ObjectSection, ObjectSymbol, SectionKind};

use crate::emulator;
use crate::figures::{Figure, Figures, grouped, number, settle};
use crate::firmware::{build_proof, read};
use crate::system::Result;
use crate::thumb::{Function, Program, plain};
use crate::toolchain::{self, Choice, TARGET};

/// The calls that are measured. Flight is the demo vehicle's own.
const ENTRIES: [Subject; 9] = [
    Subject { id: "poll", function: "poll", what: "Stack::poll", goal: CALL },
    Subject { id: "poll-link", function: "poll_link", what: "Stack::poll_link", goal: CALL },
    Subject { id: "receive", function: "receive", what: "Stack::receive", goal: CALL },
    Subject { id: "transmit", function: "transmit", what: "Stack::transmit", goal: CALL },
    Subject { id: "storage-job", function: "storage_job", what: "Stack::storage_job", goal: CALL },
    Subject { id: "storage-done", function: "storage_done", what: "Stack::storage_done", goal: CALL },
    Subject { id: "persist", function: "persist", what: "Stack::persist", goal: CALL },
    Subject { id: "restore", function: "restore", what: "Stack::restore", goal: CALL },
    Subject { id: "fly", function: "fly", what: "the demo vehicle's flight", goal: CALL },
];
/// The goal for one call.
const CALL: u32 = 1_536;

/// The firmware `loop`, from reset on: its start, and its loop.
const WHOLE: Subject = Subject { id: "whole", function: "Reset", what: "the whole firmware, from reset", goal: 2_304 };
/// The firmware's `static` with its stack.
const STATIC: &str = "mavstack_qemu::memory::STACK";
/// The firmware that paints its stack.
const PAINTED: &str = "painted";
/// How many plans it must have accepted and refused at least, or it has not exercised all services: in each of its rounds a mission,
/// a fence and rally points.
const PLANS: (u32, u32) = (3, 1);

/// A figure that moved by more than this (%), up or down, has to be accepted.
const TOLERANCE: f64 = 5.0;

/// A part of a firmware whose stack is measured.
struct Subject {
    /// The key of its figure.
    id: &'static str,
    /// Its function in the firmware `entries`, or in the whole firmware.
    function: &'static str,
    what: &'static str,
    /// Bytes of stack at most, as far as it is reached.
    goal: u32,
}

impl Subject {
    /// Returns the bytes of stack that are allowed: the goal, or the accepted figure where that is larger.
    fn bound(&self, accepted: &Figures) -> u32 {
        let accepted = accepted.get(&format!("stack.{}", self.id)).and_then(number);
        accepted.map_or(self.goal, |bytes| self.goal.max(bytes as u32))
    }
}

/// `cargo measure stack`.
pub fn prove(choice: Option<Choice>, accepts: bool) -> Result {
    let choice = toolchain::prepare(choice, &[TARGET])?;
    let entries = Program::read(&read(&build_proof(choice, "entries", false, "s")?)?)?;
    let elf = read(&build_proof(choice, "loop", false, "s")?)?;
    let zeros = zeros(&elf, STATIC)?;
    let whole = Program::read(&elf)?;
    let mut rows = Vec::new();
    for subject in ENTRIES {
        let name = format!("entries::{}", subject.function);
        let entry = entries.find(&name, |function| function == name)?;
        rows.push((subject, Depths::of(&entries).deepest(entry)?));
    }
    let reset = whole.find(WHOLE.function, |function| function == WHOLE.function)?;
    rows.push((WHOLE, Depths::of(&whole).deepest(reset)?));

    emulator::prepare()?;
    let elf = build_proof(choice, PAINTED, false, "s")?;
    let painted = Program::read(&read(&elf)?)?;
    let reset = painted.find(WHOLE.function, |function| function == WHOLE.function)?;
    let most = total(&Depths::of(&painted).deepest(reset)?);
    let measured = Mark::of(&elf)?;

    let accepted = Figures::read()?;
    println!("\n{:36} {:>8} {:>8} {:>8}", "stack, worst case (opt-level s)", "bytes", "goal", "bound");
    for (subject, chain) in &rows {
        let Subject { what, goal, .. } = subject;
        println!("{what:36} {:>8} {goal:>8} {:>8}", total(chain), subject.bound(&accepted));
    }
    for (Subject { what, .. }, chain) in &rows {
        println!("\n{what}, the deepest chain:");
        for (name, frame) in chain {
            println!("{frame:>8}  {name}");
        }
    }
    println!("\n{STATIC}: {zeros} bytes, all zero bits before it is begun");
    println!("\nthe firmware that paints its stack: at most {most}, measured {}", measured.bytes);
    // A goal that is missed already may be missed by more, if that is accepted. One that is reached stays.
    let is_broken = |(subject, chain): &&(Subject, Chain)| {
        let bound = subject.bound(&accepted);
        total(chain) > bound && !(accepts && bound > subject.goal)
    };
    let broken = rows.iter().filter(is_broken);
    let broken = broken.map(|(subject, chain)| {
        format!("{}: {} bytes of stack, bound {}", subject.what, total(chain), subject.bound(&accepted))
    });
    let broken: Vec<_> = broken.chain(measured.complaint(most)).collect();
    if !broken.is_empty() {
        return Err(broken.join("\n"));
    }
    let bytes = |id: &str, bytes: u32| Figure::new(id, grouped(bytes.into())).within(TOLERANCE);
    let mut figures: Vec<_> = rows.iter().map(|(subject, chain)| bytes(subject.id, total(chain))).collect();
    figures.extend([bytes("painted-sum", most), bytes("painted", measured.bytes)]);
    settle("stack", &toolchain::release(choice), &figures, accepts)
}

/// Returns the length of a `static` that is all zero bits: it lies in `.bss`, which has no image in flash.
fn zeros(elf: &[u8], name: &str) -> Result<u64> {
    let file = ElfFile32::<Endianness>::parse(elf).map_err(|error| format!("not a firmware: {error}"))?;
    let found = file.symbols().find(|symbol| symbol.name().is_ok_and(|symbol| plain(symbol) == name));
    let symbol = found.ok_or_else(|| format!("the firmware has no `static` called {name}"))?;
    let section = symbol.section_index().and_then(|index| file.section_by_index(index).ok());
    match section.map(|section| section.kind()) {
        Some(SectionKind::UninitializedData) => Ok(symbol.size()),
        _ => Err(format!("{name} is not in .bss: some field of `VACANT` is not all zero bits")),
    }
}

/// What the firmware that paints its stack has found.
#[derive(Debug, PartialEq, Eq)]
struct Mark {
    bytes: u32,
    accepted: u32,
    refused: u32,
}

impl Mark {
    fn of(elf: &Path) -> Result<Self> {
        let mut command = emulator::command();
        command
            .args(["-machine", emulator::BOARD, "-display", "none", "-monitor", "none", "-serial", "stdio", "-kernel"])
            .arg(elf)
            .stdin(Stdio::null())
            .stdout(Stdio::piped());
        let (_emulator, output) = emulator::start(&mut command)?;
        let line = emulator::Lines::of(output).next()?.unwrap_or_default();
        Self::parse(&line).ok_or_else(|| format!("the firmware said: {line}"))
    }

    fn parse(line: &str) -> Option<Self> {
        let mut words = line.split_whitespace().map(|word| word.parse().ok());
        let [bytes, accepted, refused] = [(); 3].map(|()| words.next().flatten());
        let mark = Self { bytes: bytes?, accepted: accepted?, refused: refused? };
        words.next().is_none().then_some(mark)
    }

    /// Returns what is wrong with it, where `most` is proven.
    fn complaint(&self, most: u32) -> Option<String> {
        let Self { bytes, accepted, refused } = *self;
        if bytes > most {
            return Some(format!("the firmware took {bytes} bytes of stack, more than the sum of {most}"));
        }
        (accepted < PLANS.0 || refused < PLANS.1).then(|| {
            format!("the firmware has not exercised all services: {accepted} plans accepted, {refused} refused")
        })
    }
}

/// Functions and the bytes of their frames, in the order of the calls.
type Chain = Vec<(String, u32)>;

fn total(chain: &Chain) -> u32 {
    chain.iter().map(|(_, frame)| frame).sum()
}

/// How deep each function's stack gets, as far as it was asked for.
struct Depths<'a> {
    program: &'a Program,
    /// `None` while it is being computed.
    known: BTreeMap<u32, Option<Depth>>,
}

#[derive(Clone, Copy)]
struct Depth {
    bytes: u32,
    /// The deepest call.
    next: Option<u32>,
    /// Whether the caller's frame is still on the stack during that call.
    keeps_frame: bool,
}

impl<'a> Depths<'a> {
    fn of(program: &'a Program) -> Self {
        Self { program, known: BTreeMap::new() }
    }

    /// Returns the deepest chain from the function at `entry`.
    fn deepest(mut self, entry: u32) -> Result<Chain> {
        self.visit(entry)?;
        let mut chain = Chain::new();
        let mut at = Some(entry);
        while let Some(function) = at {
            let Some(Some(depth)) = self.known.get(&function) else { break };
            let Function { name, frame, .. } = &self.program.0[&function];
            // A function that ends with a jump has freed its frame.
            let frame = if depth.keeps_frame { *frame } else { 0 };
            chain.push((name.clone(), frame));
            at = depth.next;
        }
        Ok(chain)
    }

    fn visit(&mut self, at: u32) -> Result<u32> {
        let program = self.program;
        let function = program.0.get(&at).ok_or_else(|| format!("a call to {at:#x}, where no function begins"))?;
        match self.known.get(&at) {
            Some(Some(depth)) => return Ok(depth.bytes),
            Some(None) => return Err(format!("{} is recursive: its stack has no bound", function.name)),
            None => {}
        }
        if let Some(place) = function.indirect.first() {
            return Err(format!("{} calls through a pointer, at {place:#x}: its stack has no bound", function.name));
        }
        if function.is_frame_unknown {
            return Err(format!(
                "{} changes its stack pointer by an amount that is known at run time only",
                function.name
            ));
        }
        self.known.insert(at, None);
        let mut depth = Depth { bytes: function.frame, next: None, keeps_frame: true };
        let calls = function.calls.iter().map(|to| (*to, true));
        for (to, keeps_frame) in calls.chain(function.tail_calls.iter().map(|to| (*to, false))) {
            let bytes = self.visit(to).map_err(|error| format!("{error}\n  called by {}", function.name))?;
            let bytes = bytes + if keeps_frame { function.frame } else { 0 };
            if bytes > depth.bytes {
                depth = Depth { bytes, next: Some(to), keeps_frame };
            }
        }
        self.known.insert(at, Some(depth));
        Ok(depth.bytes)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    /// Functions, by address: frame, calls, tail calls.
    fn program(functions: &[(u32, u32, &[u32], &[u32])]) -> Program {
        let set = |addresses: &[u32]| BTreeSet::from_iter(addresses.iter().copied());
        Program(BTreeMap::from_iter(functions.iter().map(|(at, frame, calls, tail_calls)| {
            let (calls, tail_calls) = (set(calls), set(tail_calls));
            (*at, Function { name: format!("f{at}"), frame: *frame, calls, tail_calls, ..Function::default() })
        })))
    }

    fn bytes(program: &Program) -> Result<u32> {
        Depths::of(program).deepest(0).map(|chain| total(&chain))
    }

    #[test]
    fn the_deepest_chain_is_taken_and_not_the_longest() {
        let program = program(&[(0, 8, &[1, 3], &[]), (1, 8, &[2], &[]), (2, 8, &[], &[]), (3, 100, &[], &[])]);
        let chain = Depths::of(&program).deepest(0).unwrap();
        assert_eq!(chain, [("f0".to_owned(), 8), ("f3".to_owned(), 100)]);
    }

    #[test]
    fn a_frame_is_free_before_a_tail_call_and_not_before_a_call() {
        assert_eq!(bytes(&program(&[(0, 40, &[], &[1]), (1, 50, &[], &[])])), Ok(50));
        assert_eq!(bytes(&program(&[(0, 40, &[1], &[]), (1, 50, &[], &[])])), Ok(90));
        assert_eq!(bytes(&program(&[(0, 60, &[], &[1]), (1, 50, &[], &[])])), Ok(60));
    }

    #[test]
    fn a_recursive_function_is_an_error() {
        assert!(bytes(&program(&[(0, 8, &[1], &[]), (1, 8, &[], &[0])])).unwrap_err().contains("recursive"));
        assert!(bytes(&program(&[(0, 8, &[0], &[])])).is_err());
        // Twice is not a cycle.
        assert_eq!(bytes(&program(&[(0, 8, &[1, 2], &[]), (1, 8, &[2], &[]), (2, 8, &[], &[])])), Ok(24));
    }

    #[test]
    fn a_mark_beyond_what_was_added_up_or_of_a_firmware_that_did_nothing_is_told() {
        let mark = Mark::parse("1200 9 3 \r\n").unwrap();
        assert_eq!(mark, Mark { bytes: 1_200, accepted: 9, refused: 3 });
        assert_eq!((mark.complaint(1_200), Mark::parse("1200 9"), Mark::parse("")), (None, None, None));
        assert!(mark.complaint(1_199).unwrap().contains("more than the sum of 1199"));
        assert!(Mark { accepted: 2, ..mark }.complaint(2_000).unwrap().contains("2 plans accepted"));
    }

    #[test]
    fn a_missed_goal_is_no_permission_to_get_worse() {
        let fly = &ENTRIES[8];
        assert_eq!(fly.bound(&Figures::default()), CALL);
        let accepted = |bytes| Figures::parse(&format!("[stack]\nfly = \"{bytes}\"\n")).unwrap();
        assert_eq!((fly.bound(&accepted("1,736")), fly.bound(&accepted("900"))), (1_736, CALL));
    }

    #[test]
    fn a_call_that_cannot_be_followed_is_an_error() {
        let mut program = program(&[(0, 8, &[1], &[]), (1, 8, &[], &[])]);
        program.0.get_mut(&1).unwrap().indirect.push(6);
        let error = bytes(&program).unwrap_err();
        assert!(error.contains("pointer") && error.contains("f0"), "{error}");
        assert!(bytes(&self::program(&[(0, 8, &[7], &[])])).is_err());
    }
}
