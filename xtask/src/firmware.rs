//! The firmware: how it is built, and how large it is.

use std::path::PathBuf;

use object::read::elf::{ElfFile32, FileHeader};
use object::{Endianness, Object, ObjectSection, SectionFlags, SectionKind, elf};

use crate::system::{Result, run};
use crate::toolchain::{self, Choice, TARGET};

const PACKAGE: &str = "mavstack-qemu";

/// As in `memory.x`.
const FLASH: u64 = 512 * 1024;
const RAM: u64 = 96 * 1024;
/// RAM begins here, flash is below.
const RAM_BASE: u64 = 0x2000_0000;

/// What a firmware takes, in bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Size {
    flash: u64,
    ram: u64,
}

/// Builds the firmware, with or without its log, and returns where it is.
pub fn build(choice: Choice, log: bool) -> Result<PathBuf> {
    let mut command = toolchain::cargo_build(choice);
    command.args(["--package", PACKAGE, "--profile", "firmware"]);
    if !log {
        command.arg("--no-default-features");
    }
    run(&mut command)?;
    Ok(toolchain::build_dir(choice).join(TARGET).join("firmware").join(PACKAGE))
}

/// Prints the size of the firmware `elf`, called `name`.
pub fn print_size(name: &str, elf: &[u8]) -> Result {
    let size = measure(elf)?;
    let row = |what, used: u64, of: u64| format!("{what} {used} of {of} bytes ({} %)", used * 100 / of);
    println!("{name}: {}, {}", row("flash", size.flash, FLASH), row("static RAM", size.ram, RAM));
    Ok(())
}

/// `cargo xtask size`.
pub fn report(choice: Option<Choice>) -> Result {
    let choice = toolchain::prepare(choice)?;
    for (name, log) in [("Firmware without log", false), ("Firmware with log", true)] {
        print_size(name, &read(&build(choice, log)?)?)?;
    }
    Ok(())
}

/// The bytes of a built firmware.
pub fn read(path: &PathBuf) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))
}

/// Flash holds all that is loaded; RAM holds what lies there, loaded or zeroed. The stack takes what remains.
fn measure(bytes: &[u8]) -> Result<Size> {
    let file = ElfFile32::<Endianness>::parse(bytes).map_err(|error| format!("not a firmware: {error}"))?;
    let entry = u64::from(file.elf_header().e_entry(file.endian()));
    if entry >= FLASH {
        return Err(format!("the firmware begins at {entry:#x}, outside the board's flash: was memory.x found?"));
    }
    let mut size = Size::default();
    for section in file.sections() {
        let SectionFlags::Elf { sh_flags } = section.flags() else { continue };
        if sh_flags & u64::from(elf::SHF_ALLOC) == 0 {
            continue;
        }
        if section.address() >= RAM_BASE {
            size.ram += section.size();
        }
        if section.kind() != SectionKind::UninitializedData {
            size.flash += section.size();
        }
    }
    Ok(size)
}
