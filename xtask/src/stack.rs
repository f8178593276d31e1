//! The most stack that the firmware can ever take: the frames of its functions, added up along the deepest chain of calls.
//!
//! That is a proof only where every call is known and no function comes back to itself: a call through a pointer and a cycle are
//! errors here. Interrupts are masked in the firmware that is measured; one with handlers adds theirs.
//!
//! That the sum is right the emulator confirms: the firmware `painted` paints the RAM that is free, is made to do everything that it
//! can, and says how much of the paint is gone. That may not be more than the sum for the same firmware.
//!
//! For the Cortex-M4 only. What is compiled for the Cortex-M0 jumps through a helper of the compiler's library wherever there is a
//! table of cases, to an address that only shows when it runs.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Stdio;

use crate::firmware::{build_proof, read};
use crate::qemu;
use crate::system::Result;
use crate::thumb::{Function, Program};
use crate::toolchain::{self, Choice, TARGET};

/// What is measured: the function in the firmware `entries`, what it stands for, how many bytes of stack it is to take at most,
/// and how many it takes today where that is more.
///
/// Flight is the demo vehicle's own.
const ENTRIES: [Subject; 7] = [
    Subject::new("poll", "Stack::poll", CALL, 0),
    Subject::new("poll_link", "Stack::poll_link", CALL, 0),
    Subject::new("receive", "Stack::receive", CALL, 0),
    Subject::new("transmit", "Stack::transmit", CALL, 0),
    Subject::new("persist", "Stack::persist_*, all three", CALL, 0),
    Subject::new("restore", "Stack::restore_*, all three", CALL, 0),
    Subject::new("fly", "the demo vehicle's flight", CALL, 1_208),
];
/// The goal for one call.
const CALL: u32 = 1_024;

/// The firmware `loop`, from reset: with the moment in which the vehicle is made, when the compiler puts its links and the queues
/// for others on the stack before it copies them to their place, and nothing else is there yet; and from then on.
const START: Subject = Subject::new("Reset", "the whole firmware, at its start", 2_048, 11_510);
const WHOLE: Subject = Subject::new("Reset", "the whole firmware, from then on", 2_048, 0);
/// The firmware that paints, in the same way, without the moment in which the vehicle is made.
const PAINTED: &str = "painted";
/// So many plans it has to have accepted, and so many refused, or it has not done what it is made to do: in each of its rounds a
/// mission, a fence and rally points.
const PLANS: (u32, u32) = (3, 1);
/// What makes the vehicle.
const MAKE: &str = "mavstack_qemu::memory::make";

/// What may take so much stack.
struct Subject {
    function: &'static str,
    what: &'static str,
    goal: u32,
    /// The goal, or what it is today.
    bound: u32,
}

impl Subject {
    const fn new(function: &'static str, what: &'static str, goal: u32, today: u32) -> Self {
        Self { function, what, goal, bound: if today > goal { today } else { goal } }
    }
}

/// `cargo xtask stack`.
pub fn prove(choice: Option<Choice>) -> Result {
    let choice = toolchain::prepare(choice, &[TARGET])?;
    let entries = Program::read(&read(&build_proof(choice, "entries", false, "s")?)?)?;
    let whole = Program::read(&read(&build_proof(choice, "loop", false, "s")?)?)?;
    let mut rows = Vec::new();
    for subject in ENTRIES {
        let name = format!("entries::{}", subject.function);
        let entry = entries.find(&name, |function| function == name)?;
        rows.push((subject, Depths::of(&entries).deepest(entry)?));
    }
    let reset = whole.find(START.function, |function| function == START.function)?;
    rows.push((START, Depths::of(&whole).deepest(reset)?));
    let make = whole.find(MAKE, |function| function == MAKE)?;
    rows.push((WHOLE, Depths::of(&whole).without(make).deepest(reset)?));

    qemu::prepare()?;
    let elf = build_proof(choice, PAINTED, false, "s")?;
    let painted = Program::read(&read(&elf)?)?;
    let reset = painted.find(START.function, |function| function == START.function)?;
    let make = painted.find(MAKE, |function| function == MAKE)?;
    let most = total(&Depths::of(&painted).without(make).deepest(reset)?);
    let measured = Mark::of(&elf)?;

    println!("\n{:32} {:>8} {:>8} {:>8}", "stack, worst case (opt-level s)", "bytes", "goal", "bound");
    for (Subject { what, goal, bound, .. }, chain) in &rows {
        println!("{what:32} {:>8} {goal:>8} {bound:>8}", total(chain));
    }
    for (Subject { what, .. }, chain) in &rows {
        println!("\n{what}, the deepest chain:");
        for (name, frame) in chain {
            println!("{frame:>8}  {name}");
        }
    }
    let broken = rows.iter().filter(|(subject, chain)| total(chain) > subject.bound);
    let mut broken: Vec<_> = broken
        .map(|(Subject { what, bound, .. }, chain)| format!("{what}: {} bytes of stack, bound {bound}", total(chain)))
        .collect();
    println!("\nthe same firmware, made to do everything: at most {most}, measured {}", measured.bytes);
    broken.extend(measured.complaint(most));
    if broken.is_empty() { Ok(()) } else { Err(broken.join("\n")) }
}

/// What the firmware that paints has found.
#[derive(Debug, PartialEq, Eq)]
struct Mark {
    bytes: u32,
    accepted: u32,
    refused: u32,
}

impl Mark {
    fn of(elf: &Path) -> Result<Self> {
        let mut command = qemu::emulator();
        command
            .args(["-machine", qemu::BOARD, "-display", "none", "-monitor", "none", "-serial", "stdio", "-kernel"])
            .arg(elf)
            .stdin(Stdio::null())
            .stdout(Stdio::piped());
        let (_emulator, output) = qemu::start(&mut command)?;
        let line = qemu::Lines::of(output).next()?.unwrap_or_default();
        Self::parse(&line).ok_or_else(|| format!("the firmware said: {line}"))
    }

    fn parse(line: &str) -> Option<Self> {
        let mut words = line.split_whitespace().map(|word| word.parse().ok());
        let [bytes, accepted, refused] = [(); 3].map(|()| words.next().flatten());
        let mark = Self { bytes: bytes?, accepted: accepted?, refused: refused? };
        words.next().is_none().then_some(mark)
    }

    /// What is wrong with it, where `most` is proven.
    fn complaint(&self, most: u32) -> Option<String> {
        let Self { bytes, accepted, refused } = *self;
        if bytes > most {
            return Some(format!("the firmware took {bytes} bytes of stack, more than the {most} that were added up"));
        }
        (accepted < PLANS.0 || refused < PLANS.1).then(|| {
            format!("the firmware was to be made to do everything: {accepted} plans accepted, {refused} refused")
        })
    }
}

/// Functions and the bytes of their frames, from the first to the last that is called.
type Chain = Vec<(String, u32)>;

fn total(chain: &Chain) -> u32 {
    chain.iter().map(|(_, frame)| frame).sum()
}

/// How deep each function's stack gets, as far as was asked.
struct Depths<'a> {
    program: &'a Program,
    /// Bytes, and the call that takes them, with whether the caller's frame is still there then. `None` while it is being
    /// worked out.
    known: BTreeMap<u32, Option<Depth>>,
}

#[derive(Clone, Copy)]
struct Depth {
    bytes: u32,
    next: Option<u32>,
    keeps_frame: bool,
}

impl<'a> Depths<'a> {
    fn of(program: &'a Program) -> Self {
        Self { program, known: BTreeMap::new() }
    }

    /// As if the function at `address` were never called.
    fn without(mut self, address: u32) -> Self {
        self.known.insert(address, Some(Depth { bytes: 0, next: None, keeps_frame: false }));
        self
    }

    /// The deepest chain from the function at `entry`.
    fn deepest(mut self, entry: u32) -> Result<Chain> {
        self.visit(entry)?;
        let mut chain = Chain::new();
        let mut at = Some(entry);
        while let Some(function) = at {
            let Some(Some(depth)) = self.known.get(&function) else { break };
            let Function { name, frame, .. } = &self.program.0[&function];
            // One that ends with a jump has left the stack by then.
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
            Some(None) => return Err(format!("{} comes back to itself: its stack has no bound", function.name)),
            None => {}
        }
        if let Some(place) = function.indirect.first() {
            return Err(format!("{} calls through a pointer, at {place:#x}: its stack has no bound", function.name));
        }
        if function.is_frame_unknown {
            return Err(format!("{} moves its stack by what only shows when it runs", function.name));
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
    fn a_function_that_is_left_out_takes_nothing() {
        let program = program(&[(0, 8, &[1, 2], &[]), (1, 100, &[], &[]), (2, 16, &[], &[])]);
        let chain = Depths::of(&program).without(1).deepest(0).unwrap();
        assert_eq!(total(&chain), 24);
    }

    #[test]
    fn a_function_that_comes_back_to_itself_is_an_error() {
        assert!(bytes(&program(&[(0, 8, &[1], &[]), (1, 8, &[], &[0])])).unwrap_err().contains("itself"));
        assert!(bytes(&program(&[(0, 8, &[0], &[])])).is_err());
        // Twice is not a cycle.
        assert_eq!(bytes(&program(&[(0, 8, &[1, 2], &[]), (1, 8, &[2], &[]), (2, 8, &[], &[])])), Ok(24));
    }

    #[test]
    fn a_mark_beyond_what_was_added_up_or_of_a_firmware_that_did_nothing_is_told() {
        let mark = Mark::parse("1200 9 3 \r\n").unwrap();
        assert_eq!(mark, Mark { bytes: 1_200, accepted: 9, refused: 3 });
        assert_eq!((mark.complaint(1_200), Mark::parse("1200 9"), Mark::parse("")), (None, None, None));
        assert!(mark.complaint(1_199).unwrap().contains("more than the 1199"));
        assert!(Mark { accepted: 2, ..mark }.complaint(2_000).unwrap().contains("2 plans accepted"));
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
