//! The firmwares of `cargo measure compare`, on an emulated Cortex-M4F: twelve messages are received and each of their fields is
//! read, eight are sent, with each library.
//!
//! Flash and RAM are less those of a firmware that only reads the line. RAM is static RAM and the peak of the stack, by stack painting.
//! Instructions are the emulator's, for each byte of the stream; reading the line is included.

use std::path::Path;
use std::process::{Command, Stdio};

use crate::compare::{Results, TOLERANCE, ahead, slug};
use crate::emulator;
use crate::figures::{Figure, grouped};
use crate::firmware;
use crate::system::{Result, apt_install, root, run};
use crate::toolchain::{self, Choice, TARGET};

/// A library's name and its firmware. Ours is the first; it and the lean ones have a table of the twelve messages.
const PEERS: [(&str, &str); 7] = [
    ("mavstack", "ours"),
    ("mavlink enum", "mavlink-enum"),
    ("mavlink lean", "mavlink-lean"),
    ("mavio enum", "mavio-enum"),
    ("mavio lean", "mavio-lean"),
    ("C -Os", "c-library"),
    ("C -Os lean", "c-lean"),
];

const LABEL: usize = 36;
const COLUMN: usize = 18;

/// A row of the table.
struct Row {
    what: &'static str,
    /// The begin of its figures' keys.
    key: &'static str,
    goal: f64,
    of: fn(&Figures) -> f64,
}

const ROWS: [Row; 6] = [
    Row { what: "flash, bytes", key: "flash", goal: 4_000.0, of: |figures| figures.flash },
    Row { what: "RAM with peak stack, bytes", key: "ram", goal: 750.0, of: |figures| figures.ram },
    Row {
        what: "framing, pieces of 64: instr/byte",
        key: "framing.pieces",
        goal: 17.0,
        of: |figures| figures.framing[0],
    },
    Row { what: "framing, byte by byte", key: "framing.bytes", goal: 45.0, of: |figures| figures.framing[1] },
    Row { what: "all of it, pieces of 64", key: "whole.pieces", goal: 42.0, of: |figures| figures.whole[0] },
    Row { what: "all of it, byte by byte", key: "whole.bytes", goal: 75.0, of: |figures| figures.whole[1] },
];

/// Where another library is ahead: the row, its name, and its number as a multiple of ours, rounded down.
const BEHIND: [(&str, &str, f64); 1] = [
    // It reads each byte once and loses what follows a false header. Only ours has code that finds it again.
    ("flash, bytes", "C -Os lean", 0.65),
];

/// The figures of a firmware: bytes, and instructions a byte for both ways of reading.
#[derive(Debug, Default)]
struct Figures {
    flash: f64,
    ram: f64,
    framing: [f64; 2],
    whole: [f64; 2],
}

/// Prints the table. `stream` is what the firmwares read, `library` the folder of the C library.
pub fn measure(choice: Choice, folder: &Path, library: &Path, stream: &Path, results: &mut Results) -> Result {
    emulator::prepare()?;
    archive(library)?;
    let build_dir = folder.join("build");
    let build = |framing: bool| -> Result {
        let mut command = toolchain::cargo_for(choice, "build", TARGET, &build_dir);
        run(command
            .args(["--package", "mavstack-compare-firmware", "--profile", "firmware", "--locked", "--bins"])
            .args(["--features", if framing { "framing,mavlink,mavio,c" } else { "mavlink,mavio,c" }])
            .env("COMPARE_C_LIBRARY", library)
            .env("COMPARE_STREAM", stream)
            .current_dir(root().join("benches/compare")))
    };
    let built = build_dir.join(TARGET).join("firmware");
    let mut all: Vec<Figures> = PEERS.iter().map(|_| Figures::default()).collect();
    let mut reading = [0.0; 2];
    for framing in [true, false] {
        build(framing)?;
        let empty = Measured::of(&built.join("empty"))?;
        reading = empty.instructions;
        for ((name, program), figures) in PEERS.iter().zip(&mut all) {
            let measured = Measured::of(&built.join(program))?;
            if measured.frames != empty.frames {
                return Err(format!("{name} found {} of {} frames", measured.frames, empty.frames));
            }
            if framing {
                figures.framing = measured.instructions;
            } else {
                figures.whole = measured.instructions;
                figures.flash = measured.flash - empty.flash;
                figures.ram = measured.ram - empty.ram;
            }
        }
    }
    print!("{:LABEL$}", "");
    PEERS.iter().for_each(|(name, _)| print!("{name:>COLUMN$}"));
    println!("{:>COLUMN$}", "goal");
    let (mut flash, mut instructions) = (Vec::new(), Vec::new());
    for row in &ROWS {
        let numbers: Vec<f64> = all.iter().map(row.of).collect();
        let multiples = print_row(row, &numbers, results);
        match row.key {
            "flash" => flash = multiples,
            "ram" => {}
            _ => instructions.extend(multiples),
        }
    }
    results.add_range("times.firmware.instructions", instructions.into_iter());
    // Without the one that is ahead.
    results.add_range("times.firmware.flash", flash.into_iter().filter(|multiple| *multiple > 1.0));
    let [pieces, bytes] = reading;
    if let Some(ours) = all.first() {
        for (key, [in_pieces, byte_by_byte]) in [("framing", ours.framing), ("whole", ours.whole)] {
            for (how, above) in [("pieces", in_pieces - pieces), ("bytes", byte_by_byte - bytes)] {
                let figure = Figure::new(format!("firmware.above.{key}.{how}"), format!("{above:.1}"));
                results.figures.push(figure.within(TOLERANCE));
            }
        }
    }
    println!("reading the line alone takes {pieces:.1} instructions a byte in pieces, {bytes:.1} byte by byte");
    Ok(())
}

/// Prints our number, then each other's with its multiple of ours, and returns these multiples.
fn print_row(row: &Row, numbers: &[f64], results: &mut Results) -> Vec<f64> {
    let [ours, others @ ..] = numbers else { return Vec::new() };
    print!("{:LABEL$}{ours:>COLUMN$.1}", row.what);
    let is_bytes = ["flash", "ram"].contains(&row.key);
    let value = |number: f64| if is_bytes { grouped(number as u64) } else { format!("{number:.1}") };
    let key = |name: &str| format!("firmware.{}.{}", row.key, slug(name));
    results.figures.push(Figure::new(key(PEERS[0].0), value(*ours)).within(TOLERANCE));
    for (other, (name, _)) in others.iter().zip(&PEERS[1..]) {
        print!("{:>COLUMN$}", format!("{other:.1} = {:.2}x", other / ours));
        results.figures.push(Figure::new(key(name), value(*other)));
        let known = BEHIND.iter().find(|(what, whose, _)| what == &row.what && whose == name);
        let bound = known.map_or(1.0, |(.., bound)| *bound);
        if !ahead(*ours, *other, bound) {
            results
                .behind
                .push(format!("{}, {name}: {other:.1} against our {ours:.1}, bound {bound:.2} times", row.what));
        }
    }
    println!("{:>COLUMN$}", row.goal);
    others.iter().map(|other| other / ours).collect()
}

/// Compiles the C library for the microcontroller: as it is, and with a table of the twelve messages and nothing to sign with.
fn archive(library: &Path) -> Result {
    // The C library is a package of its own; the compiler prints the bare name when it has none.
    let specs = Command::new("arm-none-eabi-gcc").arg("-print-file-name=nano.specs").output();
    if !specs.is_ok_and(|output| output.stdout.contains(&b'/')) {
        let packages = ["gcc-arm-none-eabi", "libnewlib-arm-none-eabi"];
        apt_install("a C compiler for the microcontroller", &packages, "https://developer.arm.com")?;
    }
    let archive = library.join("libcomparefirmware.a");
    for (object, defines) in [("firmware", &["-DRUN=compare_run"][..]), ("lean", &["-DRUN=compare_run_lean", "-DLEAN"])]
    {
        let object = library.join(object).with_extension("o");
        let mut gcc = Command::new("arm-none-eabi-gcc");
        gcc.args(["-std=gnu11", "-Os", "-w", "-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]);
        gcc.args(["-ffunction-sections", "-fdata-sections"]).args(defines).arg("-c");
        gcc.arg("-I").arg(library.join("headers"));
        run(gcc.arg(root().join("benches/compare/c/firmware.c")).arg("-o").arg(&object))?;
        run(Command::new("arm-none-eabi-ar").arg("rcs").arg(&archive).arg(&object))?;
    }
    Ok(())
}

/// What was measured of one firmware.
struct Measured {
    flash: f64,
    ram: f64,
    /// A byte, in pieces and byte by byte.
    instructions: [f64; 2],
    frames: u32,
}

impl Measured {
    fn of(elf: &Path) -> Result<Self> {
        let size = firmware::measure(&firmware::read(elf)?)?;
        let mut command = emulator::command();
        command
            .args(["-machine", emulator::BOARD, "-display", "none", "-monitor", "none", "-icount", "shift=0"])
            .args(["-serial", "stdio", "-kernel"])
            .arg(elf)
            .stdin(Stdio::null())
            .stdout(Stdio::piped());
        let (_emulator, output) = emulator::start(&mut command)?;
        let (mut instructions, mut frames, mut stack) = (Vec::new(), None, 0);
        let lines = emulator::Lines::of(output);
        while let Some(line) = lines.next()? {
            if line.trim() == "." {
                break;
            }
            let said = || format!("{}: the firmware said: {line}", elf.display());
            let numbers: Vec<u32> = line.split_whitespace().flat_map(str::parse).collect();
            let &[_, count, found, bytes, deepest] = &numbers[..] else { return Err(said()) };
            instructions.push(f64::from(count) / f64::from(bytes));
            // In pieces it finds as many as byte by byte.
            if *frames.get_or_insert(found) != found {
                return Err(said());
            }
            stack = stack.max(deepest);
        }
        let instructions = instructions[..].try_into().map_err(|_| format!("{} ended too early", elf.display()))?;
        let (flash, ram) = (size.flash as f64, size.ram as f64 + f64::from(stack));
        Ok(Self { flash, ram, instructions, frames: frames.unwrap_or(0) })
    }
}
