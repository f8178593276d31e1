//! The emulator of the RP2040: rp2040js, an npm package, with the programs in `.ci/boards/rp2040`.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::emulator::{self, Emulator, Lines};
use crate::system::{Result, apt_install, has, output, root, run, target_dir};

/// The programs, and the versions of the packages.
const SOURCES: &str = ".ci/boards/rp2040";
const LOCK: &str = "package-lock.json";

/// The oldest major version of Node.js that runs the programs.
const OLDEST: u32 = 18;

/// Returns whether Node.js, by its version such as "v18.20.4", runs the programs.
fn is_new_enough(version: &str) -> bool {
    let major = version.trim_start_matches('v').split('.').next();
    major.and_then(|major| major.parse().ok()).is_some_and(|major: u32| major >= OLDEST)
}

/// Installs the emulator, and returns the program that runs it.
pub fn prepare() -> Result<PathBuf> {
    if !has("node") || !has("npm") {
        apt_install("Node.js", &["nodejs", "npm"], "https://nodejs.org")?;
    }
    let version = output("node", &["--version"]).unwrap_or_default();
    if !is_new_enough(&version) {
        return Err(format!(
            "Node.js {version} is too old for rp2040js; install version {OLDEST} or later: https://nodejs.org"
        ));
    }
    let folder = target_dir().join("rp2040js");
    let installed = folder.join("node_modules/.installed");
    let fails = |error| format!("{}: {error}", folder.display());
    let lock = fs::read(root().join(SOURCES).join(LOCK)).map_err(fails)?;
    fs::create_dir_all(&folder).map_err(fails)?;
    // The programs find the package in a folder beside them.
    for file in fs::read_dir(root().join(SOURCES)).map_err(fails)? {
        let file = file.map_err(fails)?;
        fs::copy(file.path(), folder.join(file.file_name())).map_err(fails)?;
    }
    if fs::read(&installed).ok().as_ref() != Some(&lock) {
        println!("Installing rp2040js into {}", folder.display());
        let options = ["ci", "--silent", "--no-audit", "--no-fund", "--ignore-scripts"];
        run(Command::new("npm").args(options).current_dir(&folder))?;
        fs::write(&installed, lock).map_err(fails)?;
    }
    Ok(folder.join("run.mjs"))
}

/// Starts a firmware. Its UART0 and its USB are TCP servers on these ports, and so is the control of the emulator.
pub fn start(program: &Path, firmware: &Path, [uart, usb, control]: [u16; 3], options: &[&str]) -> Result<Emulator> {
    let mut command = emulator::command_of("node");
    command
        .arg(program)
        .arg("--firmware")
        .arg(firmware)
        .args(["--uart", &uart.to_string(), "--usb", &usb.to_string(), "--control", &control.to_string()])
        .args(options)
        .stdin(Stdio::null())
        .stdout(Stdio::piped());
    let (emulator, output) = emulator::start(&mut command)?;
    match Lines::of(output).next()? {
        Some(_) => Ok(emulator),
        None => Err("rp2040js has ended by itself".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn old_versions_of_node_are_refused() {
        assert!(["v18.0.0", "v20.19.2", "v100.1.0"].into_iter().all(is_new_enough));
        assert!(!["v12.22.9", "v17.9.1", ""].into_iter().any(is_new_enough));
    }
}
