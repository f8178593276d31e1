//! The firmwares: how they are built, and how large they are.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use object::read::elf::{ElfFile32, FileHeader};
use object::{Endianness, Object, ObjectSection, SectionFlags, SectionKind, elf};

use crate::system::{Result, run};
use crate::toolchain::{self, Choice, TARGET, TARGETS};

/// The demo vehicle's firmwares, by framework.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum App {
    /// A bare loop, without a framework.
    Loop,
    /// RTIC 2: flight above comms, which polls.
    Rtic,
    /// Embassy: flight above comms, which awaits.
    Embassy,
    /// As `loop`, with telemetry over UDP on the board's Ethernet, by smoltcp.
    Ethernet,
    /// As `embassy`, with telemetry over UDP on the board's Ethernet, by embassy-net.
    EthernetEmbassy,
}

impl App {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Loop, Self::Rtic, Self::Embassy, Self::Ethernet, Self::EthernetEmbassy];

    /// Returns the name of its program, which is also its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Loop => "loop",
            Self::Rtic => "rtic",
            Self::Embassy => "embassy",
            Self::Ethernet => "ethernet",
            Self::EthernetEmbassy => "ethernet-embassy",
        }
    }

    /// Whether telemetry is on the board's Ethernet, in place of UART0.
    pub fn has_network(self) -> bool {
        matches!(self, Self::Ethernet | Self::EthernetEmbassy)
    }

    /// Checks that the compiler is new enough for this firmware.
    ///
    /// # Errors
    ///
    /// It needs a later version, which the error names.
    pub fn check_rust(self, choice: Choice) -> Result {
        let release = toolchain::release(choice);
        if !self.has_network() || is_at_least(&release, NETWORK_RUST) {
            return Ok(());
        }
        let [major, minor] = NETWORK_RUST;
        let name = self.name();
        Err(format!(
            "`{name}` needs Rust {major}.{minor} or later, as smoltcp does; this is {release}: run `rustup update`"
        ))
    }
}

/// The minimum version of Rust for a network: smoltcp's.
const NETWORK_RUST: [u32; 2] = [1, 91];

/// Returns whether a compiler's version, such as "1.95.0", is not before this one. An unknown version is left to Cargo to judge.
fn is_at_least(release: &str, minimum: [u32; 2]) -> bool {
    let mut parts = release.split('.').map_while(|part| part.parse().ok());
    let (Some(major), Some(minor)) = (parts.next(), parts.next()) else { return true };
    [major, minor] >= minimum
}

const PACKAGE: &str = "mavstack-qemu";
/// The package of firmwares that are only measured.
const MEASURED: &str = "mavstack-size";

/// Linker flags for microcontrollers other than the emulated one, whose flags are in `.cargo/config.toml`.
const LINKED: [(&str, &str); 2] = [
    (TARGETS[1], "'-Clink-arg=--nmagic', '-Clink-arg=-Tlink.x'"),
    (TARGETS[2], "'-Clink-arg=--nmagic', '-Clink-arg=-Texamples/size/riscv.x', '-Clink-arg=-Tlink.x'"),
];
const COMPACT: &str = r#"'--cfg=sha2_backend_soft="compact"'"#;

/// One of the firmwares in `examples/size`.
#[derive(Clone, Copy, Debug)]
pub struct Measured<'a> {
    /// Its program.
    pub bin: &'a str,
    /// Its features, separated by commas.
    pub features: &'a str,
    /// The microcontroller.
    pub target: &'a str,
    /// `opt-level`, as in a profile.
    pub level: &'a str,
}

/// As in `memory.x`.
const FLASH: u64 = 512 * 1024;
const RAM: u64 = 96 * 1024;
/// The address of RAM. Flash is below.
pub const RAM_BASE: u64 = 0x2000_0000;

/// The size of a firmware, in bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Size {
    /// All that is loaded.
    pub flash: u64,
    /// Static RAM, loaded or zeroed.
    pub ram: u64,
}

/// Builds the demo vehicle's firmware, with or without its log, and returns its path.
pub fn build(choice: Choice, app: App, log: bool) -> Result<PathBuf> {
    app.check_rust(choice)?;
    let features: &[&str] = if log { &[] } else { &["--no-default-features"] };
    let network: &[&str] = if app.has_network() { &["--features", "network"] } else { &[] };
    let mut command = toolchain::cargo_build(choice, TARGET);
    command.args(["--package", PACKAGE, "--profile", "firmware", "--bin", app.name()]).args(features).args(network);
    run(&mut command)?;
    Ok(toolchain::build_dir(choice).join(TARGET).join("firmware").join(app.name()))
}

/// Builds a firmware for proofs: it links only if it has no panic left, and it contains the stack size of each function. Overflow
/// checks are on in the library, and off in its dependencies. `opt_level` is as in a profile.
pub fn build_proof(choice: Choice, bin: &str, log: bool, opt_level: &str) -> Result<PathBuf> {
    let features = if log { "panic-never,defmt" } else { "panic-never" };
    let opt_level = format!("profile.firmware.opt-level={}", level(opt_level));
    let checks = "profile.firmware.package.mavstack.overflow-checks=true";
    build_apart(choice, bin, &["--features", features, "--config", checks, "--config", &opt_level])
}

/// Builds the firmware that measures the cost of a poll, with the flags of the demo vehicle.
pub fn build_work(choice: Choice) -> Result<PathBuf> {
    build_apart(choice, "work", &[])
}

/// Builds the firmware of the fault matrix. Its stack is below everything else in RAM, so an overflow faults.
pub fn build_faults(choice: Choice) -> Result<PathBuf> {
    build_linked(choice, "faults", &["--features", "faults"], &["-Clink-arg=-Tflipped.x"])
}

/// Builds a firmware that measures how late flight starts.
pub fn build_jitter(choice: Choice, bin: &str) -> Result<PathBuf> {
    build_apart(choice, bin, &["--features", "faults"])
}

fn build_apart(choice: Choice, bin: &str, arguments: &[&str]) -> Result<PathBuf> {
    build_linked(choice, bin, arguments, &[])
}

/// Builds into a separate folder, because proofs use other flags.
fn build_linked(choice: Choice, bin: &str, arguments: &[&str], linker: &[&str]) -> Result<PathBuf> {
    let folder = toolchain::build_dir(choice).join("proofs");
    let mut command = toolchain::cargo_for(choice, "rustc", TARGET, &folder);
    run(command
        .args(["--package", PACKAGE, "--bin", bin, "--profile", "firmware", "--no-default-features"])
        // Nothing reads it, and it takes a third of the time to link.
        .args(["--config", "profile.firmware.debug=false"])
        .args(arguments)
        // Allows `-Zemit-stack-sizes` on a stable compiler.
        .env("RUSTC_BOOTSTRAP", "1")
        .args(["--", "-Zemit-stack-sizes"])
        .args(linker))?;
    Ok(folder.join(TARGET).join("firmware").join(bin))
}

/// Formats an `opt-level` as TOML: `3`, `"s"`.
fn level(opt_level: &str) -> String {
    if opt_level.parse::<u8>().is_ok() { opt_level.to_owned() } else { format!("\"{opt_level}\"") }
}

/// Builds a firmware that is only measured, without default features. It links only if it has no panic left.
pub fn build_measured(choice: Choice, measured: &Measured<'_>) -> Result<Vec<u8>> {
    let Measured { bin, features, target, level: opt_level } = *measured;
    let mut command = toolchain::cargo_build(choice, target);
    command
        .args(["--quiet", "--package", MEASURED, "--bin", bin, "--profile", "firmware", "--no-default-features"])
        .args(["--features", &format!("panic-never,{features}"), "--config", "profile.firmware.debug=false"])
        .args(["--config", &format!("profile.firmware.opt-level={}", level(opt_level))]);
    if let Some((_, flags)) = LINKED.iter().find(|(linked, _)| *linked == target) {
        command.args(["--config", &format!("target.{target}.rustflags=[{flags},{COMPACT}]")]);
    }
    run(&mut command)?;
    read(&toolchain::build_dir(choice).join(target).join("firmware").join(bin))
}

/// Prints the size of the firmware `elf`, called `name`.
pub fn print_size(name: &str, elf: &[u8]) -> Result {
    let size = measure(elf)?;
    let row = |what, used: u64, of: u64| format!("{what} {used} of {of} bytes ({} %)", used * 100 / of);
    println!("{name}: {}, {}", row("flash", size.flash, FLASH), row("static RAM", size.ram, RAM));
    Ok(())
}

/// Reads a built firmware.
pub fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))
}

/// Measures the firmware `bytes`. The stack is not in it: it uses the remaining RAM.
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
        // Some linker scripts call the remaining RAM a section.
        if section.name() == Ok(".stack") {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_compared_by_number() {
        assert!(
            ["1.91.0", "1.100.0", "2.0.0", "1.92.0-nightly", ""].iter().all(|release| is_at_least(release, [1, 91]))
        );
        assert!(!["1.90.2", "1.88.0", "0.99.0"].iter().any(|release| is_at_least(release, [1, 91])));
    }
}
