//! A firmware's machine code, as far as the proofs need it: the call graph, and each function's stack.
//!
//! Reads Thumb-2 as it is encoded in the ARMv7-M Architecture Reference Manual, A5 to A7. Everything that is not a call, a
//! jump or a change of the stack pointer is passed over.

use std::collections::{BTreeMap, BTreeSet};

use object::read::elf::ElfFile32;
use object::{Endianness, Object, ObjectSection, ObjectSymbol, SectionKind, SymbolKind};

use crate::system::Result;

/// What an instruction does to the flow of the program, or to the stack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Effect {
    /// Neither, or a return.
    None,
    Call(u32),
    /// With or without a condition; within the function, or a call whose return is that of the function.
    Jump(u32),
    /// To where a register or memory says.
    Indirect,
    /// The stack grows by so many bytes.
    Grow(u32),
    /// The stack pointer gets a value that cannot be read off the instruction.
    SetStack,
}

/// The effect of the instruction at `address`, and its length in bytes.
fn decode(address: u32, first: u16, second: u16) -> (Effect, u32) {
    if first >> 11 < 0b11101 { (narrow(address, first), 2) } else { (wide(address, first, second), 4) }
}

fn narrow(address: u32, op: u16) -> Effect {
    let jump = |offset: i32| Effect::Jump(address.wrapping_add(4).wrapping_add_signed(offset));
    let field = |low: u32, bits: u32| i32::from(op >> low) & ((1 << bits) - 1);
    match op {
        // The last two are UDF and SVC.
        0xD000..0xDE00 => jump(signed(field(0, 8), 8) * 2),
        0xE000..0xE800 => jump(signed(field(0, 11), 11) * 2),
        // CBZ and CBNZ, forwards only.
        _ if op & 0xF500 == 0xB100 => jump(field(9, 1) << 6 | field(3, 5) << 1),
        // BX LR and MOV PC, LR return; other registers may hold anything.
        0x4770 | 0x46F7 => Effect::None,
        _ if op & 0xFF07 == 0x4700 || op & 0xFF87 == 0x4687 || op & 0xFF87 == 0x4487 => Effect::Indirect,
        _ if op & 0xFF87 == 0x4685 || op & 0xFF87 == 0x4485 => Effect::SetStack,
        0xB400..0xB600 => Effect::Grow((op & 0x1FF).count_ones() * 4),
        0xB080..0xB100 => Effect::Grow(u32::from(op & 0x7F) * 4),
        _ => Effect::None,
    }
}

fn wide(address: u32, first: u16, second: u16) -> Effect {
    let (high, low) = (u32::from(first), u32::from(second));
    let to = |offset: i32| address.wrapping_add(4).wrapping_add_signed(offset);
    if high >> 11 == 0b11110 && low & 0x8000 != 0 {
        let sign = (high >> 10) & 1;
        let (j1, j2) = ((low >> 13) & 1, (low >> 11) & 1);
        let far = {
            let (i1, i2) = (!(j1 ^ sign) & 1, !(j2 ^ sign) & 1);
            let bits = sign << 24 | i1 << 23 | i2 << 22 | (high & 0x3FF) << 12 | (low & 0x7FF) << 1;
            signed(bits as i32, 25)
        };
        return match low & 0x5000 {
            0x5000 => Effect::Call(to(far)),
            0x1000 => Effect::Jump(to(far)),
            // What would be conditions 14 and 15 are system instructions.
            0 if (high >> 6) & 0xF < 14 => {
                let bits = sign << 20 | j2 << 19 | j1 << 18 | (high & 0x3F) << 12 | (low & 0x7FF) << 1;
                Effect::Jump(to(signed(bits as i32, 21)))
            }
            _ => Effect::None,
        };
    }
    let destination = (low >> 8) & 0xF;
    let constant = ((high >> 10) & 1) << 11 | ((low >> 12) & 7) << 8 | low & 0xFF;
    match high {
        0xE92D => Effect::Grow(low.count_ones() * 4),
        0xE96D => Effect::Grow((low & 0xFF) * 4),
        0xF84D if low & 0x0F00 == 0x0D00 => Effect::Grow(low & 0xFF),
        0xED2D | 0xED6D => Effect::Grow((low & 0xFF) * 4),
        _ if high & 0xFBEF == 0xF1AD && destination == 13 => Effect::Grow(expand(constant)),
        _ if high & 0xFBFF == 0xF2AD && destination == 13 => Effect::Grow(constant),
        // SUB.W SP, with a register, or from another register.
        _ if high & 0xFFE0 == 0xEBA0 && destination == 13 => Effect::SetStack,
        _ if (high & 0xFBE0 == 0xF1A0 || high & 0xFBF0 == 0xF2A0) && destination == 13 => Effect::SetStack,
        // LDR PC: from the stack it is a return.
        0xF85D if low >> 12 == 15 => Effect::None,
        _ if high & 0xFF70 == 0xF850 && low >> 12 == 15 => Effect::Indirect,
        _ => Effect::None,
    }
}

fn signed(value: i32, bits: u32) -> i32 {
    (value << (32 - bits)) >> (32 - bits)
}

/// The manual's ThumbExpandImm.
fn expand(constant: u32) -> u32 {
    let byte = constant & 0xFF;
    match constant >> 8 {
        0 => byte,
        1 => byte << 16 | byte,
        2 => byte << 24 | byte << 8,
        3 => byte * 0x0101_0101,
        _ => (byte | 0x80).rotate_right(constant >> 7),
    }
}

/// A piece of the program with a name.
#[derive(Debug, Default)]
pub struct Function {
    pub name: String,
    /// Bytes of stack, without those of the functions that it calls.
    pub frame: u32,
    pub calls: BTreeSet<u32>,
    /// Calls that it ends with, when its own stack is free again.
    pub tail_calls: BTreeSet<u32>,
    /// Where it calls, or jumps, to what a register says.
    pub indirect: Vec<u32>,
    /// Its frame was read off the code, which sets the stack pointer in a way that cannot be followed.
    pub is_frame_unknown: bool,
}

/// All functions of a firmware, by their addresses.
pub struct Program(pub BTreeMap<u32, Function>);

impl Program {
    /// Of the ELF file `bytes`. The frames are the compiler's own figures where there are some (`-Zemit-stack-sizes`), for what
    /// is written in assembly and for the compiler's library they are read off the code.
    pub fn read(bytes: &[u8]) -> Result<Self> {
        let file = ElfFile32::<Endianness>::parse(bytes).map_err(|error| format!("not a firmware: {error}"))?;
        let mut frames = BTreeMap::new();
        for section in file.sections().filter(|section| section.name() == Ok(".stack_sizes")) {
            let data = section.data().map_err(|error| format!(".stack_sizes: {error}"))?;
            frames.extend(stack_sizes(data).ok_or(".stack_sizes is cut off")?);
        }
        // Names of the same address: the shortest is the least decorated.
        let mut names: BTreeMap<u32, (String, u32)> = BTreeMap::new();
        let mut marks = BTreeMap::new();
        // The debugger's sections have marks too, at addresses that are none.
        let is_loaded =
            |section| file.section_by_index(section).is_ok_and(|section| section.kind() == SectionKind::Text);
        for symbol in file.symbols().filter(|symbol| symbol.section_index().is_some_and(is_loaded)) {
            let (address, name) = (symbol.address() as u32, symbol.name().unwrap_or_default());
            if name == "$t" || name.starts_with("$t.") {
                marks.insert(address, true);
            } else if name == "$d" || name.starts_with("$d.") {
                marks.entry(address).or_insert(false);
            } else if symbol.kind() == SymbolKind::Text && symbol.is_definition() {
                let name = plain(name);
                let found = names.entry(address & !1).or_insert_with(|| (name.clone(), 0));
                found.1 = found.1.max(symbol.size() as u32);
                if name.len() < found.0.len() {
                    found.0 = name;
                }
            }
        }
        let mut functions = BTreeMap::new();
        for section in file.sections().filter(|section| section.kind() == SectionKind::Text) {
            let (base, Ok(data)) = (section.address() as u32, section.data()) else { continue };
            let end = base.saturating_add(data.len() as u32);
            let mut own = names.range(base..end).peekable();
            while let Some((&begin, (name, size))) = own.next() {
                let next = own.peek().map_or(end, |(address, _)| **address);
                let after = if *size > 0 { begin + size } else { next };
                let code = |address: u32| -> Option<u16> {
                    let at = (address - base) as usize;
                    Some(u16::from_le_bytes(data.get(at..at + 2)?.try_into().ok()?))
                };
                let is_code = |address: u32| marks.range(..=address).next_back().is_some_and(|(_, is_code)| *is_code);
                let mut function = Function { name: name.clone(), ..Function::default() };
                function.take((begin, after), is_code, code);
                if let Some(frame) = frames.get(&begin) {
                    function.frame = *frame;
                    function.is_frame_unknown = false;
                }
                functions.insert(begin, function);
            }
        }
        if functions.is_empty() {
            return Err("the firmware has no functions: was it stripped?".to_owned());
        }
        Ok(Self(functions))
    }

    /// The address of the function that `test` is true for; an error unless it is exactly one.
    pub fn find(&self, what: &str, test: impl Fn(&str) -> bool) -> Result<u32> {
        let found: Vec<_> = self.0.iter().filter(|(_, function)| test(&function.name)).collect();
        match found[..] {
            [(address, _)] => Ok(*address),
            _ => Err(format!("{} functions called {what} in the firmware, and there should be one", found.len())),
        }
    }
}

impl Function {
    /// Takes what the code in this range does.
    fn take(&mut self, range: (u32, u32), is_code: impl Fn(u32) -> bool, code: impl Fn(u32) -> Option<u16>) {
        let (mut at, end) = range;
        while at < end {
            let Some(first) = code(at) else { break };
            if !is_code(at) {
                at += 2;
                continue;
            }
            let (effect, len) = decode(at, first, code(at + 2).unwrap_or(0));
            match effect {
                Effect::None => {}
                Effect::Call(to) => {
                    self.calls.insert(to);
                }
                Effect::Jump(to) if (range.0..range.1).contains(&to) => {}
                Effect::Jump(to) => {
                    self.tail_calls.insert(to);
                }
                Effect::Indirect => self.indirect.push(at),
                Effect::Grow(bytes) => self.frame += bytes,
                Effect::SetStack => self.is_frame_unknown = true,
            }
            at += len;
        }
    }
}

/// The entries of a section `.stack_sizes`: address, and size as ULEB128. `None` when it is cut off.
fn stack_sizes(mut data: &[u8]) -> Option<BTreeMap<u32, u32>> {
    let mut sizes = BTreeMap::new();
    while !data.is_empty() {
        let (address, mut rest) = data.split_first_chunk::<4>()?;
        let mut size = 0u32;
        for shift in (0..32).step_by(7) {
            let (byte, after) = rest.split_first()?;
            rest = after;
            size |= u32::from(byte & 0x7F) << shift;
            if byte & 0x80 == 0 {
                break;
            }
        }
        sizes.insert(u32::from_le_bytes(*address) & !1, size);
        data = rest;
    }
    Some(sizes)
}

/// A symbol's name as it is in the source, without the compiler's hash.
pub fn plain(symbol: &str) -> String {
    format!("{:#}", rustc_demangle::demangle(symbol))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn calls_and_jumps_are_found_where_they_go() {
        let cases: [(u32, u16, u16, Effect); 18] = [
            // As GNU's assembler has them.
            (0x1000, 0xF000, 0xF800, Effect::Call(0x1004)),
            (0x1000, 0xF7FF, 0xFFFE, Effect::Call(0x1000)),
            (0x1000, 0xF000, 0xB800, Effect::Jump(0x1004)),
            (0x1000, 0xF43F, 0xAFFE, Effect::Jump(0x1000)),
            (0x1000, 0xE7FE, 0, Effect::Jump(0x1000)),
            (0x1000, 0xD0FE, 0, Effect::Jump(0x1000)),
            (0x1000, 0xD101, 0, Effect::Jump(0x1006)),
            // CBZ r0 and CBNZ r0, four bytes on.
            (0x1000, 0xB100, 0, Effect::Jump(0x1004)),
            (0x1000, 0xB910, 0, Effect::Jump(0x1008)),
            // BLX r3; BX r0; BX LR; LDR PC, [r0]; POP {PC} in both lengths; MOV PC, r0.
            (0x1000, 0x4798, 0, Effect::Indirect),
            (0x1000, 0x4700, 0, Effect::Indirect),
            (0x1000, 0x4770, 0, Effect::None),
            (0x1000, 0xF8D0, 0xF000, Effect::Indirect),
            (0x1000, 0xBD10, 0, Effect::None),
            (0x1000, 0xF85D, 0xFB04, Effect::None),
            (0x1000, 0x4687, 0, Effect::Indirect),
            // TBB [PC, r0] stays in its function; DMB is none.
            (0x1000, 0xE8DF, 0xF000, Effect::None),
            (0x1000, 0xF3BF, 0x8F5F, Effect::None),
        ];
        for (address, first, second, effect) in cases {
            assert_eq!(decode(address, first, second).0, effect, "{first:04x} {second:04x}");
        }
    }

    #[test]
    fn the_stack_grows_as_the_instructions_say() {
        let cases: [(u16, u16, Effect); 12] = [
            // PUSH {r4, r7, lr}; PUSH.W {r4-r11, lr}; VPUSH {d8, d9}.
            (0xB590, 0, Effect::Grow(12)),
            (0xE92D, 0x4FF0, Effect::Grow(36)),
            (0xED2D, 0x8B04, Effect::Grow(16)),
            // SUB SP, #16; SUB.W SP, SP, #512; SUBW SP, SP, #1234.
            (0xB084, 0, Effect::Grow(16)),
            (0xF5AD, 0x7D00, Effect::Grow(512)),
            (0xF2AD, 0x4DD2, Effect::Grow(1234)),
            // STR LR, [SP, #-8]!; STRD r0, r1, [SP, #-16]!.
            (0xF84D, 0xED08, Effect::Grow(8)),
            (0xE96D, 0x0104, Effect::Grow(16)),
            // ADD SP, #16; SUB r0, SP, #4 as SUBW; MOV SP, r4; SUB.W SP, r7, #16.
            (0xB004, 0, Effect::None),
            (0xF2AD, 0x0004, Effect::None),
            (0x46A5, 0, Effect::SetStack),
            (0xF1A7, 0x0D10, Effect::SetStack),
        ];
        for (first, second, effect) in cases {
            assert_eq!(decode(0, first, second).0, effect, "{first:04x} {second:04x}");
        }
    }

    #[test]
    fn a_table_of_stack_sizes_is_read_whole_or_not_at_all() {
        let table = [0x01, 0x10, 0, 0, 0x18, 0x41, 0x20, 0, 0, 0x98, 0x02];
        assert_eq!(stack_sizes(&table), Some(BTreeMap::from([(0x1000, 24), (0x2040, 280)])));
        assert_eq!(stack_sizes(&table[..10]), None);
    }

    #[test]
    fn a_function_has_what_its_code_does_and_not_what_its_constants_look_like() {
        // PUSH {r7, lr}; BL +0; B own begin; B.W elsewhere; then a constant that would be BLX r3.
        let code = [0xB580, 0xF000, 0xF800, 0xE7FB, 0xF000, 0xB880, 0x4798];
        let mut function = Function::default();
        function.take((0, 14), |at| at < 12, |at| code.get(at as usize / 2).copied());
        assert_eq!(function.frame, 8);
        assert_eq!(function.calls, BTreeSet::from([6]));
        assert_eq!(function.tail_calls, BTreeSet::from([0x10C]));
        assert_eq!((function.indirect, function.is_frame_unknown), (vec![], false));
    }
}
