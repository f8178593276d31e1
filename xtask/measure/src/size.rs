//! `cargo measure size`: flash and RAM of whole firmwares, for each kind of microcontroller.

use object::read::elf::ElfFile32;
use object::{Endianness, Object, ObjectSymbol, SymbolKind};

use crate::figures::{Figure, Figures, grouped, settle};
use crate::firmware::{self, App, Measured, Size, measure, read};
use crate::system::Result;
use crate::toolchain::{self, Choice, TARGET, TARGETS};

/// A size that moved by more than this (%), up or down, has to be accepted.
pub const TOLERANCE: f64 = 1.0;

/// Microcontroller, `opt-level`, heading, and the end of the figures' keys. Cortex-M4F at `s`, which has all rows, is the first.
const COLUMNS: [(&str, &str, &str, &str); 6] = [
    (TARGETS[0], "s", "M4F, s", "m4-s"),
    (TARGETS[0], "z", "M4F, z", "m4-z"),
    (TARGETS[1], "s", "M0+, s", "m0-s"),
    (TARGETS[1], "z", "M0+, z", "m0-z"),
    (TARGETS[2], "s", "RV32IMC, s", "riscv-s"),
    (TARGETS[2], "z", "RV32IMC, z", "riscv-z"),
];

/// A firmware, and its size at most.
struct Row {
    /// The begin of its figures' keys.
    id: &'static str,
    name: &'static str,
    /// Of `examples/size`.
    bin: &'static str,
    features: &'static str,
    /// RAM that is as large as the vehicle wants, and is listed apart: items of plans, queues of forwarded frames.
    apart: u64,
    goal: Option<Size>,
    /// Whether it is measured for each microcontroller.
    is_for_all: bool,
}

/// `size_of::<MissionItem>()`.
const ITEM: u64 = 32;
/// 100 items, a fence of 40, 10 rally points, and the staging of the largest.
const PLANS_3: u64 = ITEM * (100 + 40 + 10 + 100);
/// `size_of::<ForwardQueues<3>>()`, as `examples/size/src/bin/options/main.rs` asserts it.
const QUEUES_3: u64 = 5_920;

const fn kib(flash: u64, ram: u64) -> Option<Size> {
    Some(Size { flash: flash * 1024, ram: ram * 1024 / 10 })
}

const ROWS: [Row; 7] = [
    Row {
        id: "frames",
        name: "frames: 12 messages in, 8 out",
        bin: "frames",
        features: "",
        apart: 0,
        goal: None,
        is_for_all: false,
    },
    Row {
        id: "heartbeat",
        name: "heartbeat, commands, peers",
        bin: "options",
        features: "",
        apart: 0,
        goal: kib(10, 15),
        is_for_all: true,
    },
    Row {
        id: "missions",
        name: "the same, texts, missions",
        bin: "options",
        features: "plan-texts,texts,mission",
        apart: ITEM * 200,
        goal: None,
        is_for_all: true,
    },
    Row {
        id: "parameters",
        name: "the same, parameters",
        bin: "options",
        features: "plan-texts,texts,mission,parameters",
        apart: ITEM * 200,
        goal: None,
        is_for_all: true,
    },
    Row {
        id: "services",
        name: "the same, fence, rally, streams, modes, time",
        bin: "options",
        features: "plan-texts,texts,plans-3,parameters,streams,modes,time",
        apart: PLANS_3,
        goal: kib(24, 30),
        is_for_all: true,
    },
    Row {
        id: "all",
        name: "the same, three links, forwarding, high latency, signing",
        bin: "options",
        features: "plan-texts,texts,plans-3,parameters,streams,modes,time,link-3,forwarding,high-latency,signing",
        apart: PLANS_3 + QUEUES_3,
        goal: kib(34, 60),
        is_for_all: true,
    },
    Row { id: "wpl", name: "plans as text", bin: "wpl", features: "", apart: 0, goal: None, is_for_all: false },
];

/// The demo vehicle's firmwares, whole: the begin of the figures' keys, name, framework, and whether with log.
const DEMOS: [(&str, &str, App, bool); 6] = [
    ("demo", "the demo vehicle, without its log", App::Loop, false),
    ("demo-rtic", "the same with RTIC", App::Rtic, false),
    ("demo-embassy", "the same with Embassy", App::Embassy, false),
    ("demo-ethernet", "the demo vehicle with UDP by smoltcp, without its log", App::Ethernet, false),
    ("demo-ethernet-embassy", "the same with UDP by embassy-net, in Embassy", App::EthernetEmbassy, false),
    ("demo-log", "the demo vehicle", App::Loop, true),
];

/// What is done besides printing the sizes.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Whether the figures become the accepted ones.
    pub accepts: bool,
    /// Whether only the Cortex-M4F at `opt-level` s is measured, and of the demo vehicle's firmwares only the first.
    pub only_m4: bool,
    /// How many symbols of each firmware are listed.
    pub symbols: usize,
}

/// A row as it was measured; `None` where it is not measured.
#[derive(Clone, Debug)]
struct Line {
    id: &'static str,
    name: &'static str,
    flash: [Option<u64>; COLUMNS.len()],
    /// The largest of all columns.
    ram: u64,
    apart: u64,
}

/// `cargo measure size`.
pub fn report(choice: Option<Choice>, options: Options) -> Result {
    let choice = toolchain::prepare(choice, &TARGETS)?;
    let line = |id, name, apart| Line { id, name, flash: [None; COLUMNS.len()], ram: 0, apart };
    let mut lines: Vec<_> = ROWS.iter().map(|row| line(row.id, row.name, row.apart)).collect();
    // Debian's toolchain links for one target only.
    let columns = if options.only_m4 || choice == Choice::Debian { 1 } else { COLUMNS.len() };
    for (column, (target, level, name, _)) in COLUMNS.into_iter().enumerate().take(columns) {
        println!("\n{name}");
        let build = |bin, features| {
            let elf = firmware::build_measured(choice, &Measured { bin, features, target, level })?;
            Result::Ok((measure(&elf)?, elf))
        };
        let (empty, _) = build("empty", "")?;
        for (row, line) in ROWS.iter().zip(&mut lines).filter(|(row, _)| row.is_for_all || column == 0) {
            let (size, elf) = build(row.bin, row.features)?;
            line.flash[column] = Some(size.flash.saturating_sub(empty.flash));
            line.ram = line.ram.max(size.ram.saturating_sub(empty.ram + row.apart));
            println!("{:58}{:>12}", row.name, size.flash.saturating_sub(empty.flash));
            if column == 0 && options.symbols > 0 {
                print_symbols(row.name, &elf, options.symbols)?;
            }
        }
    }
    let demos = if options.only_m4 { 1 } else { DEMOS.len() };
    for (id, name, app, log) in DEMOS.into_iter().take(demos) {
        let size = measure(&read(&firmware::build(choice, app, log)?)?)?;
        let mut line = line(id, name, 0);
        line.flash[0] = Some(size.flash);
        line.ram = size.ram;
        lines.push(line);
    }
    print(&lines);
    print!("{}", goals(&lines));
    let mut figures = figures(&lines);
    if options.only_m4 {
        // What is not measured stays as it is.
        let accepted = Figures::read()?;
        let columns = lines.iter().flat_map(|line| COLUMNS.iter().skip(1).map(|(.., column)| (line.id, *column)));
        let demos = DEMOS.iter().skip(demos).flat_map(|(id, ..)| [(*id, COLUMNS[0].3), (*id, "ram")]);
        for (id, column) in columns.chain(demos) {
            let key = format!("{id}.{column}");
            figures.extend(accepted.get(&format!("size.{key}")).map(|value| Figure::new(key, value)));
        }
    }
    settle("size", &toolchain::release(choice), &figures, options.accepts)
}

/// Returns the figures of the rows.
fn figures(lines: &[Line]) -> Vec<Figure> {
    let mut figures = Vec::new();
    for Line { id, flash, ram, apart, .. } in lines {
        let mut add = |column: &str, bytes| {
            figures.push(Figure::new(format!("{id}.{column}"), grouped(bytes)).within(TOLERANCE));
        };
        for (flash, (.., column)) in flash.iter().zip(COLUMNS) {
            flash.iter().for_each(|flash| add(column, *flash));
        }
        add("ram", *ram);
        if *apart > 0 {
            add("apart", *apart);
        }
    }
    figures
}

/// Returns the table of docs/sizing.md. `.ci/run` reads the version of the compiler from it.
pub fn table(figures: &Figures) -> String {
    let figure = |id: &str| figures.get(&format!("size.{id}")).unwrap_or_default();
    let mut text = format!("By rustc {}, in bytes:\n\n| flash at opt-level |", figure("rustc"));
    for (.., name, _) in COLUMNS {
        text += &format!(" {name} |");
    }
    text += " RAM | and apart |\n|---|---|---|---|---|---|---|---|---|\n";
    let rows = ROWS.iter().map(|row| (row.id, row.name));
    for (id, name) in rows.chain(DEMOS.map(|(id, name, ..)| (id, name))) {
        text += &format!("| {name} |");
        let columns = COLUMNS.map(|(.., column)| column);
        for column in columns.into_iter().chain(["ram", "apart"]) {
            text += &format!(" {} |", figure(&format!("{id}.{column}"))).replace("  ", " ");
        }
        text += "\n";
    }
    text
}

fn print(lines: &[Line]) {
    print!("\n{:58}", "flash, bytes");
    for (.., name, _) in COLUMNS {
        print!("{name:>12}");
    }
    println!("{:>10}{:>10}", "RAM", "and apart");
    for line in lines {
        print!("{:58}", line.name);
        for flash in line.flash {
            print!("{:>12}", flash.map_or("-".to_owned(), |flash| flash.to_string()));
        }
        println!("{:>10}{:>10}", line.ram, line.apart);
    }
}

/// Returns what is above its goal, and where `z` is larger than `s`.
fn goals(lines: &[Line]) -> String {
    let mut text = String::new();
    for (row, line) in ROWS.iter().zip(lines) {
        if let (Some(goal), Some(flash)) = (row.goal, line.flash[0]) {
            for (what, size, goal) in [("flash", flash, goal.flash), ("RAM", line.ram, goal.ram)] {
                if size > goal {
                    text += &format!("{}: {what} is {} bytes above the goal of {goal}\n", line.name, size - goal);
                }
            }
        }
        for (pair, columns) in line.flash.chunks(2).zip(COLUMNS.chunks(2)) {
            if let ([Some(s), Some(z)], [_, (.., name, _)]) = (pair, columns)
                && z > s
            {
                text += &format!("{}: {name} is {} bytes more than s\n", line.name, z - s);
            }
        }
    }
    text
}

/// Prints the largest functions and constants of a firmware.
fn print_symbols(name: &str, elf: &[u8], count: usize) -> Result {
    let file = ElfFile32::<Endianness>::parse(elf).map_err(|error| format!("not a firmware: {error}"))?;
    let mut symbols: Vec<_> = file
        .symbols()
        .filter(|symbol| {
            matches!(symbol.kind(), SymbolKind::Text | SymbolKind::Data) && symbol.address() < firmware::RAM_BASE
        })
        .map(|symbol| (symbol.size(), format!("{:#}", rustc_demangle::demangle(symbol.name().unwrap_or_default()))))
        .collect();
    symbols.sort_unstable_by(|one, other| other.cmp(one));
    println!("\n{name}, {TARGET}:");
    for (size, symbol) in symbols.iter().take(count) {
        println!("{size:8}  {symbol}");
    }
    println!();
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::system::root;

    fn line(id: &'static str, flash: u64, ram: u64) -> Line {
        let mut line = Line { id, name: id, flash: [None; COLUMNS.len()], ram, apart: 0 };
        line.flash[0] = Some(flash);
        line
    }

    #[test]
    fn figures_are_those_that_were_measured() {
        let figure = |key: &str, value: &str| Figure::new(key, value).within(TOLERANCE);
        let lines = [line("a", 1_234, 0), Line { apart: 8_000, ..line("b", 7, 5) }];
        assert_eq!(
            figures(&lines),
            [
                figure("a.m4-s", "1,234"),
                figure("a.ram", "0"),
                figure("b.m4-s", "7"),
                figure("b.ram", "5"),
                figure("b.apart", "8,000")
            ]
        );
    }

    /// The compiler knows the size for the microcontroller only, where an assertion compares it with the same number.
    #[test]
    fn the_queues_are_as_large_as_the_measured_firmware_says() {
        let path = root().join("examples/size/src/bin/options/main.rs");
        let text = std::fs::read_to_string(path).expect("the firmware");
        assert!(text.contains(&format!("size_of::<ForwardQueues<3>>() == {QUEUES_3}")));
    }

    #[test]
    fn goals_are_for_flash_and_ram_and_z() {
        let mut lines: Vec<_> = ROWS.iter().map(|row| line(row.name, 0, 0)).collect();
        assert_eq!(goals(&lines), "");
        lines[1].flash[..2].copy_from_slice(&[Some(10 * 1024 + 1), Some(10 * 1024 + 4)]);
        lines[1].ram = 1537;
        let said = goals(&lines);
        assert!(said.contains("flash is 1 bytes above the goal of 10240"), "{said}");
        assert!(said.contains("RAM is 1 bytes above the goal of 1536"), "{said}");
        assert!(said.contains("M4F, z is 3 bytes more than s"), "{said}");
    }
}
