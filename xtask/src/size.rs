//! `cargo xtask size`: flash and RAM of whole firmwares, for each kind of microcontroller, and whether that is what
//! docs/sizing.md says.

use object::read::elf::ElfFile32;
use object::{Endianness, Object, ObjectSymbol, SymbolKind};

use crate::firmware::{self, App, Measured, Size, measure, read};
use crate::system::{Result, output, root};
use crate::toolchain::{self, Choice, TARGET, TARGETS};

pub const SIZING: &str = "docs/sizing.md";
/// The table is between these lines.
const BEGIN: &str = "<!-- Written by `cargo xtask size --accept`. -->";
pub const END: &str = "<!-- End of what is written. -->";

/// Cortex-M4F at `s` first, which has all rows.
const COLUMNS: [(&str, &str, &str); 6] = [
    (TARGETS[0], "s", "M4F, s"),
    (TARGETS[0], "z", "M4F, z"),
    (TARGETS[1], "s", "M0+, s"),
    (TARGETS[1], "z", "M0+, z"),
    (TARGETS[2], "s", "RV32IMC, s"),
    (TARGETS[2], "z", "RV32IMC, z"),
];

/// A firmware, and what it is to take at most, after `docs/sizing.md`.
struct Row {
    name: &'static str,
    /// Of `examples/size`.
    bin: &'static str,
    features: &'static str,
    /// What of its RAM is as long as the vehicle wants: items of plans of 32 bytes, queues of forwarded frames.
    apart: u64,
    goal: Option<Size>,
    /// For each microcontroller.
    is_for_all: bool,
}

const ITEM: u64 = 32;
/// 100 items with the fence of 40 and the 10 rally points, and the largest of these once more as staging.
const PLANS_3: u64 = ITEM * (100 + 40 + 10 + 100);
/// `size_of::<ForwardQueues<3>>()`.
const QUEUES_3: u64 = 3_816;

const fn kib(flash: u64, ram: u64) -> Option<Size> {
    Some(Size { flash: flash * 1024, ram: ram * 1024 / 10 })
}

const ROWS: [Row; 7] = [
    Row { name: "frames: 12 messages in, 8 out", bin: "frames", features: "", apart: 0, goal: None, is_for_all: false },
    Row {
        name: "heartbeat, commands, peers",
        bin: "options",
        features: "",
        apart: 0,
        goal: kib(10, 15),
        is_for_all: true,
    },
    Row {
        name: "the same, texts, missions",
        bin: "options",
        features: "plan-texts,texts,mission",
        apart: ITEM * 200,
        goal: None,
        is_for_all: true,
    },
    Row {
        name: "the same, parameters",
        bin: "options",
        features: "plan-texts,texts,mission,parameters",
        apart: ITEM * 200,
        goal: None,
        is_for_all: true,
    },
    Row {
        name: "the same, fence, rally, streams, modes, time",
        bin: "options",
        features: "plan-texts,texts,plans-3,parameters,streams,modes,time",
        apart: PLANS_3,
        goal: kib(24, 30),
        is_for_all: true,
    },
    Row {
        name: "the same, three links, forwarding, high latency, signing",
        bin: "options",
        features: "plan-texts,texts,plans-3,parameters,streams,modes,time,link-3,forwarding,high-latency,signing",
        apart: PLANS_3 + QUEUES_3,
        goal: kib(34, 60),
        is_for_all: true,
    },
    Row { name: "plans as text", bin: "wpl", features: "", apart: 0, goal: None, is_for_all: false },
];

/// What is done beside printing the sizes.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Sizes become those of `docs/sizing.md`.
    pub accepts: bool,
    /// How many symbols of each firmware are listed.
    pub symbols: usize,
}

/// A row as it was measured, or as it stands in the table; what is not measured is `None`.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Line {
    name: String,
    flash: [Option<u64>; COLUMNS.len()],
    /// The most of all columns.
    ram: u64,
    apart: u64,
}

/// `cargo xtask size`.
pub fn report(choice: Option<Choice>, options: Options) -> Result {
    let choice = toolchain::prepare(choice, &TARGETS)?;
    let mut lines: Vec<_> = ROWS
        .iter()
        .map(|row| Line { name: row.name.to_owned(), flash: [None; COLUMNS.len()], ram: 0, apart: row.apart })
        .collect();
    // Debian's toolchain links for one target only.
    let columns = if choice == Choice::Debian { 1 } else { COLUMNS.len() };
    for (column, (target, level, name)) in COLUMNS.into_iter().enumerate().take(columns) {
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
    for (name, app, log) in [
        ("the demo vehicle, without its log", App::Loop, false),
        ("the same with RTIC", App::Rtic, false),
        ("the same with Embassy", App::Embassy, false),
        ("the demo vehicle", App::Loop, true),
    ] {
        let size = measure(&read(&firmware::build(choice, app, log)?)?)?;
        let mut flash = [None; COLUMNS.len()];
        flash[0] = Some(size.flash);
        lines.push(Line { name: name.to_owned(), flash, ram: size.ram, apart: 0 });
    }
    print(&lines);
    let missed = goals(&lines);
    print!("{missed}");

    let path = root().join(SIZING);
    let text = std::fs::read_to_string(&path).map_err(|error| format!("{SIZING}: {error}"))?;
    let (before, rest) = text.split_once(BEGIN).ok_or_else(|| format!("{SIZING} has no line {BEGIN}"))?;
    let (table, after) = rest.split_once(END).ok_or_else(|| format!("{SIZING} has no line {END}"))?;
    let changes = changes(&parse(table)?, &lines);
    for change in &changes {
        println!("{change}");
    }
    if options.accepts {
        let text = format!("{before}{BEGIN}\n{}{END}{after}", written(&lines, &compiler()));
        return std::fs::write(&path, text).map_err(|error| format!("{SIZING}: {error}"));
    }
    if changes.is_empty() {
        return Ok(());
    }
    if is_by_another(choice, &text) {
        return Ok(());
    }
    Err(format!(
        "{} sizes are not those of {SIZING}. Where that is meant: `cargo xtask size --accept` writes them there, and the change \
         belongs into CHANGELOG.md",
        changes.len()
    ))
}

/// Its version.
fn compiler() -> String {
    let version = output("rustc", &["--version"]).unwrap_or_default();
    version.split_whitespace().nth(1).unwrap_or_default().to_owned()
}

/// Whether what `text` says of sizes was measured with another compiler, so that it cannot be held against these. Says so.
pub fn is_by_another(choice: Choice, text: &str) -> bool {
    let is_other = choice == Choice::Debian || !text.contains(&format!("By rustc {},", compiler()));
    if is_other {
        println!("The tables in {SIZING} are by another compiler: these are no errors.");
    }
    is_other
}

fn print(lines: &[Line]) {
    print!("\n{:58}", "flash, bytes");
    for (_, _, name) in COLUMNS {
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

/// What is above its goal, and where `z` is larger than `s`.
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
            if let ([Some(s), Some(z)], [_, (_, _, name)]) = (pair, columns)
                && z > s
            {
                text += &format!("{}: {name} is {} bytes more than s\n", line.name, z - s);
            }
        }
    }
    text
}

/// What moved by more than 1 %, whichever way, or is not in both.
fn changes(old: &[Line], new: &[Line]) -> Vec<String> {
    let has_moved = |old: u64, new: u64| old.abs_diff(new) * 100 > old;
    let percent = |old: u64, new: u64| (new as f64 - old as f64) * 100.0 / old as f64;
    let mut changes = Vec::new();
    for line in new {
        let Some(before) = old.iter().find(|before| before.name == line.name) else {
            changes.push(format!("{}: is new", line.name));
            continue;
        };
        for ((_, _, name), (old, new)) in COLUMNS.iter().zip(before.flash.iter().zip(line.flash)) {
            match (*old, new) {
                (Some(old), Some(new)) if has_moved(old, new) => {
                    changes.push(format!("{}: {name}: {old} -> {new} bytes, {:+.1} %", line.name, percent(old, new)));
                }
                (Some(_), None) | (None, Some(_)) => {
                    changes.push(format!("{}: {name}: in one of both only", line.name))
                }
                _ => {}
            }
        }
        if has_moved(before.ram, line.ram) {
            changes.push(format!("{}: RAM: {} -> {} bytes", line.name, before.ram, line.ram));
        }
    }
    let gone = old.iter().filter(|before| new.iter().all(|line| line.name != before.name));
    changes.extend(gone.map(|line| format!("{}: is gone", line.name)));
    changes
}

/// The table as it stands in the documentation.
fn written(lines: &[Line], compiler: &str) -> String {
    let mut text = format!("By rustc {compiler}, in bytes:\n\n| flash at opt-level |");
    for (_, _, name) in COLUMNS {
        text += &format!(" {name} |");
    }
    text += " RAM | and apart |\n|---|---|---|---|---|---|---|---|---|\n";
    for line in lines {
        text += &format!("| {} |", line.name);
        for flash in line.flash {
            text += &flash.map_or(" |".to_owned(), |flash| format!(" {} |", grouped(flash)));
        }
        let apart = if line.apart > 0 { format!(" {} |", grouped(line.apart)) } else { " |".to_owned() };
        text += &format!(" {} |{apart}\n", grouped(line.ram));
    }
    text
}

/// With commas between thousands.
pub fn grouped(number: u64) -> String {
    if number < 1000 { number.to_string() } else { format!("{},{:03}", grouped(number / 1000), number % 1000) }
}

/// The opposite of [`written`].
fn parse(table: &str) -> Result<Vec<Line>> {
    let rows = table.lines().filter_map(|line| line.strip_prefix("| ")?.strip_suffix('|'));
    rows.skip(1)
        .map(|row| {
            let wrong = || format!("{SIZING}: not a row of sizes: {row}");
            let mut cells = row.split('|').map(str::trim);
            let name = cells.next().ok_or_else(wrong)?.to_owned();
            let numbers: Vec<Option<u64>> = cells
                .map(|cell| if cell.is_empty() { Ok(None) } else { cell.replace(',', "").parse().map(Some) })
                .collect::<std::result::Result<_, _>>()
                .map_err(|_| wrong())?;
            let ([flash @ .., ram, apart], true) = (&numbers[..], numbers.len() == COLUMNS.len() + 2) else {
                return Err(wrong());
            };
            let flash = flash.try_into().map_err(|_| wrong())?;
            Ok(Line { name, flash, ram: ram.ok_or_else(wrong)?, apart: apart.unwrap_or(0) })
        })
        .collect()
}

/// The largest functions and constants of a firmware.
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

    fn line(name: &str, flash: u64, ram: u64) -> Line {
        let mut line = Line { name: name.to_owned(), flash: [None; COLUMNS.len()], ram, apart: 0 };
        line.flash[0] = Some(flash);
        line
    }

    #[test]
    fn what_is_written_is_read() {
        let lines = [
            line("a, b", 123, 0),
            Line { apart: 8_000, flash: [Some(1_234_567); COLUMNS.len()], ..line("c", 0, 4_096) },
        ];
        assert_eq!(parse(&written(&lines, "1.95.0")), Ok(lines.to_vec()));
    }

    #[test]
    fn up_to_one_percent_is_no_change() {
        let old = [line("a", 10_000, 1_000)];
        assert_eq!(changes(&old, &[line("a", 10_100, 990)]), [""; 0]);
        assert_eq!(changes(&old, &[line("a", 9_899, 1_000)]), ["a: M4F, s: 10000 -> 9899 bytes, -1.0 %"]);
        assert_eq!(changes(&old, &[line("a", 10_000, 1_011)]), ["a: RAM: 1000 -> 1011 bytes"]);
    }

    #[test]
    fn rows_that_come_and_go_are_changes() {
        assert_eq!(changes(&[line("a", 1, 1)], &[line("b", 1, 1)]), ["b: is new", "a: is gone"]);
        let mut empty = line("a", 1, 1);
        empty.flash[0] = None;
        assert_eq!(changes(&[line("a", 1, 1)], &[empty]), ["a: M4F, s: in one of both only"]);
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
