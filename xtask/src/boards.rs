//! The boards: a small vehicle on real microcontrollers, with the HALs that their users have.

use std::net::{Ipv4Addr, TcpListener};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use object::read::elf::{ElfFile32, ProgramHeader};
use object::{Endianness, Object, ObjectSection, SectionFlags, SectionKind, elf};

use crate::emulator::{self, Emulator};
use crate::figures;
use crate::firmware::read;
use crate::python;
use crate::rp2040js;
use crate::system::{self, Result, cargo, root, run, target_dir};
use crate::toolchain::{self, Choice, TARGETS};

/// A folder of `examples/boards`.
struct Board {
    name: &'static str,
    target: &'static str,
    /// Where the first byte of its firmware is in its flash.
    load: u64,
    /// Begin and end of what it writes to.
    ram: [u64; 2],
}

const BOARDS: [Board; 8] = [
    Board {
        name: "embassy-stm32f405",
        target: "thumbv7em-none-eabihf",
        load: 0x0800_0000,
        ram: [0x2000_0000, 0x2002_0000],
    },
    Board {
        name: "esp32c3",
        target: "riscv32imc-unknown-none-elf",
        // Behind the headers that the boot loader's image has.
        load: 0x3C00_0020,
        ram: [0x3FC8_0000, 0x3FCE_0000],
    },
    Board { name: "microbit", target: "thumbv6m-none-eabi", load: 0, ram: [0x2000_0000, 0x2000_4000] },
    Board { name: "rp2040", target: "thumbv6m-none-eabi", load: 0x1000_0000, ram: [0x2000_0000, 0x2004_2000] },
    Board { name: "rp2040-dma", target: "thumbv6m-none-eabi", load: 0x1000_0000, ram: [0x2000_0000, 0x2004_2000] },
    Board { name: "rp2040-embassy", target: "thumbv6m-none-eabi", load: 0x1000_0000, ram: [0x2000_0000, 0x2004_2000] },
    Board { name: "stm32f405", target: "thumbv7em-none-eabihf", load: 0x0800_0000, ram: [0x2000_0000, 0x2002_0000] },
    Board { name: "stm32vldiscovery", target: M3, load: 0x0800_0000, ram: [0x2000_0000, 0x2000_2000] },
];

/// The target of a Cortex-M3, which only one board has.
const M3: &str = "thumbv7m-none-eabi";

/// A board that QEMU emulates well enough.
pub struct Emulated {
    pub name: &'static str,
    /// The machine in QEMU.
    pub machine: &'static str,
    /// The options of QEMU and of its build, and of the acceptance test.
    pub options: &'static [&'static str],
    pub build: &'static [&'static str],
    test: &'static [&'static str],
    /// The register that the driver of its flash reads after each word that it writes.
    ready: Option<&'static str>,
}

/// For a board whose clock counts ticks: by default, QEMU loses some while it has no processor of this computer. With these options,
/// instructions pass the time, 31 in a microsecond, and QEMU waits for this computer's clock.
const TICKS: [&str; 2] = ["-icount", "shift=5,align=on"];
pub static IN_QEMU: [Emulated; 3] = [
    Emulated { name: "microbit", machine: "microbit", options: &[], build: &[], test: &[], ready: Some("0x4001e400") },
    Emulated {
        name: "stm32f405",
        machine: "netduinoplus2",
        options: &[],
        build: &["--features", "qemu"],
        test: &[],
        ready: None,
    },
    Emulated {
        name: "stm32vldiscovery",
        machine: "stm32vldiscovery",
        options: &TICKS,
        build: &["--features", "qemu"],
        test: &["--items", "32", "--forgets"],
        ready: None,
    },
];
/// The boards with an RP2040, and the options of the acceptance test for each of their links.
pub const IN_RP2040JS: [(&str, &[&[&str]]); 3] =
    [("rp2040", &[&[], &["--usb"]]), ("rp2040-dma", &[&["--dma"]]), ("rp2040-embassy", &[&[], &["--usb"]])];
/// By how many percent flash and RAM may differ from the accepted figures.
const TOLERANCE: f64 = 2.0;
/// The acceptance test of a port.
const TEST: &str = ".ci/boards/acceptance.py";

/// Installs the targets. Returns whether a board is built: without the target of the Cortex-M3, its board is left out.
pub fn prepare() -> Result<impl Fn(&str) -> bool> {
    // Debian's toolchain has none of the libraries but `core`, and the HALs ask for newer compilers.
    toolchain::prepare(Some(Choice::Rustup), &TARGETS)?;
    let m3 = toolchain::prepare(Some(Choice::Rustup), &[M3]);
    let has_m3 = m3.is_ok();
    if let Err(error) = m3 {
        if system::is_ci() {
            return Err(error);
        }
        println!("The target {M3} is not available here: the board with it is left out.");
    }
    Ok(move |name: &str| has_m3 || BOARDS.iter().any(|board| board.name == name && board.target != M3))
}

/// `cargo xtask boards`.
pub fn build_all(runs: bool) -> Result {
    let began = Instant::now();
    let is_built = prepare()?;
    let mut rows = Vec::new();
    for board in BOARDS.iter().filter(|board| is_built(board.name)) {
        let firmware = build(board, &[])?;
        let (flash, ram) = measure(board, &read(&firmware)?).map_err(|error| format!("{}: {error}", board.name))?;
        rows.push((board.name, board.load, flash, ram));
    }
    println!("\n{:20} {:>12} {:>14} {:>18}", "", "loaded at", "flash, bytes", "static RAM, bytes");
    for (name, load, flash, ram) in &rows {
        println!("{name:20} {load:>#12x} {flash:>14} {ram:>18}");
    }
    println!("Built in {} s", began.elapsed().as_secs());
    let text = figures::read()?;
    let accepted = figures::section(&text, "boards")?;
    let sizes = rows.iter().flat_map(|(name, _, flash, ram)| [(name, "flash", flash), (name, "ram", ram)]);
    let moved = sizes.filter_map(|(name, kind, bytes)| compare(&accepted, &format!("{name}.{kind}"), *bytes).err());
    let moved: Vec<_> = moved.collect();
    if runs {
        emulator::prepare()?;
        let python = python::environment()?;
        for board in IN_QEMU.iter().filter(|board| is_built(board.name)) {
            run_in_qemu(&python, board).map_err(|error| format!("{}: {error}", board.name))?;
        }
        let program = rp2040js::prepare()?;
        for (name, links) in IN_RP2040JS {
            run_in_rp2040js(&python, &program, name, links).map_err(|error| format!("{name}: {error}"))?;
        }
    }
    // At the end, because they also change with the compiler.
    if moved.is_empty() { Ok(()) } else { Err(moved.join("\n")) }
}

/// An error if this differs from the accepted figure of the same key.
fn compare(accepted: &[(&str, String)], key: &str, bytes: u64) -> Result {
    let figure = accepted.iter().find(|(found, _)| *found == key).and_then(|(_, value)| value.parse().ok());
    let figure: f64 = figure.ok_or_else(|| format!("{} lacks boards.{key}", figures::FILE))?;
    if (bytes as f64 - figure).abs() > figure * TOLERANCE / 100.0 {
        return Err(format!(
            "boards.{key} is {bytes}, and {figure} in {}: correct it there if that is right",
            figures::FILE
        ));
    }
    Ok(())
}

/// Builds a board's firmware, and returns its path.
fn build(board: &Board, options: &[&str]) -> Result<PathBuf> {
    let (folder, package) = (format!("examples/boards/{}", board.name), format!("mavstack-{}", board.name));
    compile(&folder, board.target, &package, options)
}

/// Builds the firmware of the board with this name, and returns its path.
pub fn build_by_name(name: &str, options: &[&str]) -> Result<PathBuf> {
    let board = BOARDS.iter().find(|board| board.name == name).ok_or("no such board")?;
    build(board, options)
}

/// Builds the firmware in a folder, and returns its path.
pub fn compile(folder: &str, target: &str, package: &str, options: &[&str]) -> Result<PathBuf> {
    println!("Building {folder} {}", options.join(" "));
    // One for all, so that what they share is built once.
    let build_dir = target_dir().join("boards");
    let mut command = Command::new(cargo());
    command.args(["build", "--release"]).args(options).arg("--target-dir").arg(&build_dir);
    command.current_dir(root().join(folder));
    // They would replace the link arguments of the board's `.cargo/config.toml`.
    run(command.env_remove("RUSTFLAGS").env_remove("CARGO_ENCODED_RUSTFLAGS"))?;
    Ok(build_dir.join(target).join("release").join(package))
}

/// Runs a board in QEMU, under pymavlink.
fn run_in_qemu(python: &Path, board: &Emulated) -> Result {
    let Emulated { name, machine, .. } = board;
    let firmware = build_by_name(name, board.build)?;
    println!("\nRunning examples/boards/{name} in QEMU's {machine}");
    let ports @ [uart, qmp, gdb] = free_ports()?;
    let gdb = gdb.to_string();
    let mut options = board.test.to_vec();
    if let Some(ready) = board.ready {
        options.extend(["--gdb", &gdb, ready]);
    }
    // Ended when dropped, also if the test fails.
    let _emulator = start_in_qemu(board, &firmware, ports)?;
    test(python, uart, qmp, &options)
}

/// Starts a firmware in QEMU. Its UART, QMP and GDB are TCP servers on these ports.
pub fn start_in_qemu(board: &Emulated, firmware: &Path, [uart, qmp, gdb]: [u16; 3]) -> Result<Emulator> {
    let mut command = emulator::command();
    command
        .args(["-machine", board.machine, "-display", "none", "-monitor", "none"])
        // Without `nodelay` the emulator's single bytes wait for acknowledgements, 40 ms each.
        .args(["-serial", &format!("tcp:127.0.0.1:{uart},server=on,wait=off,nodelay=on")])
        .args(["-qmp", &format!("tcp:127.0.0.1:{qmp},server=on,wait=off")])
        .args(["-gdb", &format!("tcp:127.0.0.1:{gdb}")])
        .arg("-kernel")
        .arg(firmware)
        .args(board.options)
        .stdin(Stdio::null())
        .stdout(Stdio::piped());
    Ok(emulator::start(&mut command)?.0)
}

/// Runs a board in rp2040js, under pymavlink: a start for each of its links.
fn run_in_rp2040js(python: &Path, program: &Path, name: &str, links: &[&[&str]]) -> Result {
    let firmware = build_by_name(name, &[])?;
    for options in links {
        let [uart, usb, control] = free_ports()?;
        let (link, port) = if options.contains(&"--usb") { ("USB", usb) } else { ("UART0", uart) };
        println!("\nRunning examples/boards/{name} in rp2040js, by its {link}");
        // Ended when dropped, also if the test fails.
        let _emulator = rp2040js::start(program, &firmware, [uart, usb, control], &[])?;
        test(python, port, control, &[&["--rp2040js"], *options].concat())?;
    }
    Ok(())
}

/// Runs the acceptance test with these ports of the link and of the emulator's control.
fn test(python: &Path, link: u16, control: u16, options: &[&str]) -> Result {
    let began = Instant::now();
    let mut test = Command::new(python);
    test.arg(root().join(TEST))
        .args(["--port", &link.to_string(), "--qmp-port", &control.to_string()])
        .args(options)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .env("PYTHONPATH", root().join(python::CLIENTS))
        .env("MAVLINK20", "1")
        .env("MAVLINK_DIALECT", "common");
    run(&mut test)?;
    println!("Tested in {} s", began.elapsed().as_secs());
    Ok(())
}

/// Free TCP ports.
pub fn free_ports<const N: usize>() -> Result<[u16; N]> {
    // All are held until all are known.
    let listeners: Vec<_> = (0..N).map(|_| TcpListener::bind((Ipv4Addr::LOCALHOST, 0))).collect();
    let mut ports = [0; N];
    for (port, listener) in ports.iter_mut().zip(listeners) {
        let address = listener.and_then(|listener| listener.local_addr());
        *port = address.map_err(|error| format!("no free port: {error}"))?.port();
    }
    Ok(ports)
}

/// Bytes of flash and RAM; an error when the firmware is not where the board begins.
fn measure(board: &Board, bytes: &[u8]) -> Result<(u64, u64)> {
    let file = ElfFile32::<Endianness>::parse(bytes).map_err(|error| format!("not a firmware: {error}"))?;
    let endian = file.endian();
    let load = file
        .elf_program_headers()
        .iter()
        .filter(|segment| segment.p_type(endian) == elf::PT_LOAD && segment.p_filesz(endian) > 0)
        .map(|segment| u64::from(segment.p_paddr(endian)))
        .min();
    if load != Some(board.load) {
        let found = load.map_or("nowhere".to_owned(), |load| format!("{load:#x}"));
        return Err(format!("it is loaded at {found} and not at {:#x}: was the board's memory.x found?", board.load));
    }
    let (mut flash, mut ram) = (0, 0);
    for section in file.sections() {
        let SectionFlags::Elf { sh_flags } = section.flags() else { continue };
        // The stack is what remains, which some linker scripts call a section.
        if sh_flags & u64::from(elf::SHF_ALLOC) == 0 || section.name() == Ok(".stack") {
            continue;
        }
        if (board.ram[0]..board.ram[1]).contains(&section.address()) {
            ram += section.size();
        }
        if section.kind() != SectionKind::UninitializedData {
            flash += section.size();
        }
    }
    Ok((flash, ram))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_compared_with_the_figures() {
        let accepted =
            figures::section("\n[boards]\na.flash = \"10,000\"\n\n[miri]\na.ram = \"1\"\n", "boards").unwrap();
        assert_eq!(compare(&accepted, "a.flash", 10_200), Ok(()));
        assert!(compare(&accepted, "a.flash", 9_799).is_err());
        assert!(compare(&accepted, "a.ram", 1).is_err());
    }

    /// Every folder with a firmware is built, so that none rots.
    #[test]
    fn every_board_is_in_the_list() {
        let folders = std::fs::read_dir(root().join("examples/boards")).unwrap();
        let mut found: Vec<_> = folders
            .map(|folder| folder.unwrap())
            .filter(|folder| folder.path().join("src/main.rs").exists())
            .map(|folder| folder.file_name().into_string().unwrap())
            .collect();
        found.sort();
        assert_eq!(found, BOARDS.map(|board| board.name));
    }
}
