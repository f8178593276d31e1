//! `cargo measure panic-free`: the proof that the firmware cannot panic. It links only if no call to the panic handler is left.
//!
//! Also refused are `core::fmt`, an allocator, and `f64` arithmetic, which the processor does not have. A function that is not linked
//! is not called.

use crate::firmware::{self, read};
use crate::system::Result;
use crate::thumb::Program;
use crate::toolchain::{self, Choice, TARGET};

/// Begins of the names of the compiler's functions for `f64` arithmetic and conversions.
const F64: [&str; 12] = [
    "__aeabi_d",
    "__aeabi_cd",
    "__aeabi_f2d",
    "__aeabi_i2d",
    "__aeabi_ui2d",
    "__aeabi_l2d",
    "__aeabi_ul2d",
    "__adddf3",
    "__subdf3",
    "__muldf3",
    "__divdf3",
    "__extendsfdf2",
];

/// `cargo measure panic-free`: at opt-level s, and unless `only_s` at 3 too.
pub fn prove(choice: Option<Choice>, only_s: bool) -> Result {
    let choice = toolchain::prepare(choice, &[TARGET])?;
    let mut rows = Vec::new();
    for (log, what) in [(false, "signing and storage, no log"), (true, "and defmt, by a logger that cannot panic")] {
        for level in if only_s { &["s"][..] } else { &["s", "3"] } {
            println!("Linking the demo vehicle, {what}, opt-level {level}, overflow checks on in mavstack");
            let elf = read(&firmware::build_proof(choice, "loop", log, level)?)?;
            let found = Found::of(&Program::read(&elf)?);
            rows.push((what, *level, found));
        }
    }
    println!("\n{:45} {:>9} {:>9} {:>9}  calls to f64 arithmetic", "no panics:", "opt-level", "core::fmt", "allocator");
    let mut complaints = Vec::new();
    for (what, level, found) in &rows {
        let f64 = if found.f64.is_empty() { "none".to_owned() } else { found.f64.join(", ") };
        println!("{what:45} {level:>9} {:>9} {:>9}  {f64}", found.fmt.len(), found.alloc.len());
        complaints.extend(found.complaints().map(|complaint| format!("opt-level {level}: {complaint}")));
    }
    if complaints.is_empty() { Ok(()) } else { Err(complaints.join("\n")) }
}

/// Functions that must not be in a firmware.
#[derive(Debug, Default)]
struct Found {
    fmt: Vec<String>,
    alloc: Vec<String>,
    /// The callers of `f64` arithmetic.
    f64: Vec<String>,
}

impl Found {
    fn of(program: &Program) -> Self {
        let mut found = Self::default();
        let is_f64 = |name: &str| F64.iter().any(|begin| name.starts_with(begin)) || name.contains("::float::");
        for function in program.0.values() {
            let name = &function.name;
            if name.contains("core::fmt") {
                found.fmt.push(name.clone());
            }
            if name.starts_with("alloc::")
                || ["__rust_alloc", "__rg_alloc", "malloc"].iter().any(|begin| name.contains(begin))
            {
                found.alloc.push(name.clone());
            }
            let mut called = function.calls.iter().chain(&function.tail_calls).filter_map(|to| program.0.get(to));
            if !is_f64(name) && called.any(|called| F64.iter().any(|begin| called.name.starts_with(begin))) {
                found.f64.push(name.clone());
            }
        }
        found.f64.sort_unstable();
        found
    }

    fn complaints(&self) -> impl Iterator<Item = String> {
        [("core::fmt is linked", &self.fmt), ("an allocator is linked", &self.alloc), ("f64 in", &self.f64)]
            .into_iter()
            .filter(|(_, names)| !names.is_empty())
            .map(|(what, names)| format!("{what}: {}", names.join(", ")))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use super::*;
    use crate::thumb::Function;

    fn program(functions: &[(u32, &str, &[u32])]) -> Program {
        let function = |name: &&str, calls: &[u32]| Function {
            name: (*name).to_owned(),
            calls: BTreeSet::from_iter(calls.iter().copied()),
            ..Function::default()
        };
        Program(BTreeMap::from_iter(functions.iter().map(|(at, name, calls)| (*at, function(name, calls)))))
    }

    #[test]
    fn a_firmware_without_them_passes() {
        let found = Found::of(&program(&[(0, "main", &[2]), (2, "__aeabi_memcpy", &[])]));
        assert_eq!(found.complaints().count(), 0);
    }

    #[test]
    fn each_function_that_is_not_to_be_there_is_named() {
        let found = Found::of(&program(&[
            (0, "main", &[2, 4]),
            (2, "<u32 as core::fmt::Display>::fmt", &[]),
            (4, "__aeabi_dmul", &[]),
            (6, "__rust_alloc", &[]),
        ]));
        let complaints: Vec<_> = found.complaints().collect();
        assert_eq!(complaints.len(), 3);
        assert!(complaints[0].contains("Display") && complaints[1].contains("__rust_alloc"));
        assert_eq!(complaints[2], "f64 in: main");
    }
}
