//! The Rust toolchain that builds for microcontrollers: the user's own, or Debian's.

use std::process::Command;

use clap::ValueEnum;

use crate::system::{Result, apt_install, cargo, has, output, succeeds, target_dir};

/// The emulated processor: Cortex-M4 with FPU.
pub const TARGET: &str = "thumbv7em-none-eabihf";
/// All microcontrollers that the library is built for, large ones first.
pub const TARGETS: [&str; 3] = [TARGET, "thumbv6m-none-eabi", "riscv32imc-unknown-none-elf"];

/// Where the compiler comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Choice {
    /// The Rust toolchain in use. A missing target is added through rustup.
    Rustup,
    /// Debian's packages, which include the source of `core`. For machines without access to rustup's downloads.
    Debian,
}

const PACKAGES: [&str; 4] = ["rustc-web", "cargo-web", "rust-web-src", "binutils-arm-none-eabi"];
const DEBIAN_CARGO: &str = "/usr/bin/cargo";
const DEBIAN_RUSTC: &str = "/usr/bin/rustc";
const LINKER: &str = "arm-none-eabi-ld";

/// Finds a toolchain for `targets`, installs what it lacks where possible, and prints its version.
pub fn prepare(choice: Option<Choice>, targets: &[&str]) -> Result<Choice> {
    if choice != Some(Choice::Debian) {
        match targets.iter().try_for_each(|target| prepare_rustup(target)) {
            Ok(()) => {
                println!("Toolchain: {} with {}", version("rustc"), targets.join(", "));
                return Ok(Choice::Rustup);
            }
            Err(error) if choice.is_some() => return Err(error),
            Err(error) => println!("{error}; trying Debian's packages."),
        }
    }
    prepare_debian()?;
    println!("Toolchain: {} from Debian's packages, with core from source", version(DEBIAN_RUSTC));
    Ok(Choice::Debian)
}

/// Returns the version number of the compiler, such as 1.95.0.
pub fn release(choice: Choice) -> String {
    let version = version(match choice {
        Choice::Rustup => "rustc",
        Choice::Debian => DEBIAN_RUSTC,
    });
    version.split_whitespace().nth(1).unwrap_or_default().to_owned()
}

fn version(rustc: &str) -> String {
    output(rustc, &["--version"]).unwrap_or_else(|| "rustc".to_owned())
}

fn prepare_rustup(target: &str) -> Result {
    if is_installed(target) {
        return Ok(());
    }
    if !has("rustup") {
        return Err(format!("The compiler in use has no target {target}, and there is no rustup to add it"));
    }
    println!("Adding the target: rustup target add {target}");
    if succeeds("rustup", &["target", "add", target]) && is_installed(target) {
        return Ok(());
    }
    Err(format!("`rustup target add {target}` failed"))
}

/// Asks the compiler, not rustup, so that distributions' toolchains count too.
fn is_installed(target: &str) -> bool {
    let Some(folder) = output("rustc", &["--print", "target-libdir", "--target", target]) else { return false };
    let Ok(files) = std::fs::read_dir(folder) else { return false };
    files.flatten().any(|file| file.file_name().to_string_lossy().starts_with("libcore-"))
}

fn prepare_debian() -> Result {
    let is_there = || {
        let has_sources = output(DEBIAN_RUSTC, &["--print", "sysroot"])
            .is_some_and(|sysroot| std::path::Path::new(&sysroot).join("lib/rustlib/src/rust/library/core").is_dir());
        has_sources && has(DEBIAN_CARGO) && has(LINKER)
    };
    if !is_there() {
        let elsewhere = format!("rustup target add {TARGET}");
        apt_install("a Rust toolchain for the microcontroller", &PACKAGES, &elsewhere)?;
        if !is_there() {
            return Err(format!("Debian's packages {} do not make a whole toolchain here", PACKAGES.join(", ")));
        }
    }
    Ok(())
}

/// Returns a `cargo build` for the microcontroller `target`, into [`build_dir`]. The caller adds package and profile.
pub fn cargo_build(choice: Choice, target: &str) -> Command {
    cargo_for(choice, "build", target, &build_dir(choice))
}

/// Returns a `cargo build` or `cargo rustc` for the microcontroller `target`, into `folder`.
pub fn cargo_for(choice: Choice, task: &str, target: &str, folder: &std::path::Path) -> Command {
    let mut command;
    match choice {
        Choice::Rustup => {
            command = Command::new(cargo());
            command.arg(task);
        }
        Choice::Debian => {
            command = Command::new(DEBIAN_CARGO);
            let path = std::env::var("PATH").unwrap_or_default();
            command
                .args([task, "-Zbuild-std=core"])
                .env("PATH", format!("/usr/bin:{path}"))
                .env("RUSTC", DEBIAN_RUSTC)
                // Allows `-Zbuild-std` on a stable compiler.
                .env("RUSTC_BOOTSTRAP", "1")
                .env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", LINKER);
        }
    }
    command
        .args(["--target", target])
        .arg("--target-dir")
        .arg(folder)
        // These would replace the link arguments of `.cargo/config.toml`.
        .env_remove("RUSTFLAGS")
        .env_remove("CARGO_ENCODED_RUSTFLAGS")
        // Incremental builds inline differently: size and stack would not be the firmware's.
        .env_remove("CARGO_INCREMENTAL")
        .current_dir(crate::system::root());
    command
}

/// Returns the build folder of a compiler. Each has its own, or they would rebuild each other's work.
pub fn build_dir(choice: Choice) -> std::path::PathBuf {
    match choice {
        Choice::Rustup => target_dir(),
        Choice::Debian => target_dir().join("debian"),
    }
}
