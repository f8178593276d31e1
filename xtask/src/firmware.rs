//! The firmware: how it is built, and how large it is.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use object::read::elf::{ElfFile32, FileHeader};
use object::{Endianness, Object, ObjectSection, SectionFlags, SectionKind, elf};

use crate::system::{Result, root, run};
use crate::toolchain::{self, Choice, TARGET, TARGETS};

/// The demo vehicle's firmwares, by what they are built on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum App {
    /// A loop of its own, without a framework.
    Loop,
    /// RTIC 2: flight above comms, which polls.
    Rtic,
    /// Embassy: flight above comms, which awaits.
    Embassy,
}

impl App {
    pub const ALL: [Self; 3] = [Self::Loop, Self::Rtic, Self::Embassy];

    /// The name of its program in [`PACKAGE`], and of its choice on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Loop => "loop",
            Self::Rtic => "rtic",
            Self::Embassy => "embassy",
        }
    }
}

const PACKAGE: &str = "mavstack-qemu";
/// Firmwares that are only measured; `empty` has the same loop and nothing else.
const MEASURED: &str = "mavstack-size";

/// The firmware of which the plans' items are listed apart, and how many there is room for: the live plans, and the largest of
/// them once more as staging.
const SERVICES: (&str, u64) = ("services", 100 + 40 + 10 + 100);
const ITEM: u64 = 32;

/// As in `memory.x`.
const FLASH: u64 = 512 * 1024;
const RAM: u64 = 96 * 1024;
/// RAM begins here, flash is below.
const RAM_BASE: u64 = 0x2000_0000;

/// What a firmware takes, in bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Size {
    pub flash: u64,
    pub ram: u64,
}

/// Builds the firmware, with or without its log, and returns where it is.
pub fn build(choice: Choice, app: App, log: bool) -> Result<PathBuf> {
    let features: &[&str] = if log { &[] } else { &["--no-default-features"] };
    Ok(build_package(choice, PACKAGE, &[&["--bin", app.name()], features].concat())?.join(app.name()))
}

/// Builds the firmware that links only when no panic is left in it, with overflow checks on in the library and, as always, off in
/// what it depends on; with or without its log. `opt_level` is as in a profile. The frames of its functions are in it.
pub fn build_proof(choice: Choice, bin: &str, log: bool, opt_level: &str) -> Result<PathBuf> {
    let features = if log { "panic-never,defmt" } else { "panic-never" };
    let opt_level = format!("profile.firmware.opt-level={}", level(opt_level));
    let checks = "profile.firmware.package.mavstack.overflow-checks=true";
    build_apart(choice, bin, &["--features", features, "--config", checks, "--config", &opt_level])
}

/// Builds the firmware that measures how much work a poll is, as it is flown with.
pub fn build_work(choice: Choice) -> Result<PathBuf> {
    build_apart(choice, "work", &[])
}

/// In a folder of its own: what is built for proofs is built by other rules.
fn build_apart(choice: Choice, bin: &str, arguments: &[&str]) -> Result<PathBuf> {
    let folder = toolchain::build_dir(choice).join("proofs");
    let mut command = toolchain::cargo_for(choice, "rustc", TARGET, &folder);
    run(command
        .args(["--package", PACKAGE, "--bin", bin, "--profile", "firmware", "--no-default-features"])
        .args(arguments)
        // The flag behind it is for nightly, which this is not.
        .env("RUSTC_BOOTSTRAP", "1")
        .args(["--", "-Zemit-stack-sizes"]))?;
    Ok(folder.join(TARGET).join("firmware").join(bin))
}

/// Numbers are numbers, letters are strings.
fn level(opt_level: &str) -> String {
    if opt_level.parse::<u8>().is_ok() { opt_level.to_owned() } else { format!("\"{opt_level}\"") }
}

/// Returns the folder of what it built.
fn build_package(choice: Choice, package: &str, arguments: &[&str]) -> Result<PathBuf> {
    let mut command = toolchain::cargo_build(choice, TARGET);
    run(command.args(["--package", package, "--profile", "firmware"]).args(arguments))?;
    Ok(toolchain::build_dir(choice).join(TARGET).join("firmware"))
}

/// Builds one of the firmwares that are only measured, with these features and no default ones, and returns its folder.
pub fn build_measured(choice: Choice, name: &str, features: &str) -> Result<PathBuf> {
    build_package(choice, MEASURED, &["--quiet", "--bin", name, "--no-default-features", "--features", features])
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
    let choice = toolchain::prepare(choice, &[TARGET])?;
    // It links only where no panic is left.
    let folder = build_package(choice, MEASURED, &["--bins", "--features", "panic-never"])?;
    let empty = measure(&read(&folder.join("empty"))?)?;
    let sources = root().join("examples/size/src/bin");
    let sources = std::fs::read_dir(&sources).map_err(|error| format!("{}: {error}", sources.display()))?;
    let mut names: Vec<_> = sources
        .flatten()
        .filter_map(|file| Some(file.path().file_stem()?.to_str()?.to_owned()))
        // The latter is for `--options`.
        .filter(|name| name != "empty" && name != "options")
        .collect();
    names.sort_unstable();
    // Those that keep plans have a feature that would be in the others too, and so has the one that signs.
    let (stored, others): (Vec<_>, Vec<_>) = names.into_iter().partition(|name| name.starts_with("stored"));
    let (signed, others): (Vec<_>, Vec<_>) = others.into_iter().partition(|name| name.starts_with("signed"));
    let mut rows = Vec::new();
    let mut add = |name: &str| {
        let size = measure(&read(&folder.join(name))?)?;
        let (flash, ram) = (size.flash.saturating_sub(empty.flash), size.ram.saturating_sub(empty.ram));
        let (subject, items) = SERVICES;
        rows.push(if name == subject {
            let ram = ram.saturating_sub(items * ITEM);
            (format!("{name}, less that and {items} items"), Size { flash, ram })
        } else {
            (format!("{name}, less the empty loop"), Size { flash, ram })
        });
        Result::Ok(())
    };
    others.iter().try_for_each(|name| add(name))?;
    for (names, features) in [(signed, "panic-never,signing"), (stored, "panic-never,storage")] {
        let bins: Vec<_> = names.iter().flat_map(|name| ["--bin", name]).collect();
        build_package(choice, MEASURED, &[&bins[..], &["--features", features]].concat())?;
        names.iter().try_for_each(|name| add(name))?;
    }
    for app in App::ALL {
        let name = match app {
            App::Loop => "the demo vehicle, without its log".to_owned(),
            App::Rtic | App::Embassy => format!("the same with {}", app.name()),
        };
        rows.push((name, measure(&read(&build(choice, app, false)?)?)?));
    }
    rows.push(("the demo vehicle".to_owned(), measure(&read(&build(choice, App::Loop, true)?)?)?));
    println!("\n{:40} {:>14} {:>18}", TARGET, "flash, bytes", "static RAM, bytes");
    for (name, size) in rows {
        println!("{name:40} {:>14} {:>18}", size.flash, size.ram);
    }
    Ok(())
}

/// `cargo xtask cross`: the library for each microcontroller, with no feature and with all.
pub fn cross(choice: Option<Choice>) -> Result {
    let choice = toolchain::prepare(choice, &TARGETS)?;
    for target in TARGETS {
        for features in ["--no-default-features", "--all-features"] {
            println!("mavstack for {target} with {features}");
            run(toolchain::cargo_build(choice, target).args(["--package", "mavstack", "--lib", features]))?;
        }
    }
    Ok(())
}

/// The bytes of a built firmware.
pub fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))
}

/// Flash holds all that is loaded; RAM holds what lies there, loaded or zeroed. The stack takes what remains.
pub fn measure(bytes: &[u8]) -> Result<Size> {
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
