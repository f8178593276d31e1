//! `mavstack-check doctor` on the boards in the emulators: it finds nothing on the sound ones, and the fault on those made faulty.

use std::collections::VecDeque;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::time::Instant;

use serde_json::Value;

use crate::boards::{self, Emulated, IN_QEMU, IN_RP2040JS};
use crate::emulator::{self, Emulator};
use crate::paced;
use crate::rp2040js;
use crate::system::{Result, cargo, root, run, target_dir};

/// The rate of the boards' UARTs.
const BAUD: u32 = 57_600;
/// The rate of a line that carries less than the rover streams.
const SLOW_BAUD: u32 = 2_400;
/// The firmware that has a fault for each of its features.
const FAULTY: &str = ".ci/boards/faulty";
const TARGET: &str = "thumbv6m-none-eabi";
/// The features, what the doctor must find, and its options. Errors and warnings besides it would mislead. Without heartbeats the doctor
/// must be told that the vehicle is disarmed.
const FAULTS: [(&str, &str, &[&str]); 10] = [
    ("baud", "damage-both-ways", &[]),
    ("fifo", "receive-overrun", &[]),
    ("dma-cut", "receive-cut", &[]),
    ("poll-200-ms", "poll-slow", &[]),
    ("no-poll", "no-heartbeat", &["--disarmed"]),
    ("erase-stall", "stall", &[]),
    ("clock-ms", "clock-unit", &["--disarmed"]),
    ("streams", "streams-above-rate", &[]),
    ("component", "component-id", &[]),
    ("timer", "heartbeats-from-timer", &[]),
];
/// A plan is uploaded to the sound boards.
const SOUND: &[&str] = &["--write"];
/// How many boards are examined at the same time: the emulators mostly wait.
const AT_A_TIME: usize = 2;
/// The emulator of a board, and its link.
#[derive(Clone, Copy)]
enum Place {
    /// The UART in QEMU.
    Qemu(&'static Emulated),
    /// The UART in rp2040js.
    Uart,
    /// The USB in rp2040js.
    Usb,
}

/// A board to examine.
struct Patient {
    name: String,
    firmware: PathBuf,
    place: Place,
    /// The rate of the line (bit/s).
    baud: u32,
    /// The doctor's options.
    options: &'static [&'static str],
    /// What must be found; `None`: nothing.
    expected: Option<&'static str>,
}

/// `cargo xtask boards --doctor`.
pub fn examine_all() -> Result {
    let began = Instant::now();
    let is_built = boards::prepare()?;
    emulator::prepare()?;
    let program = rp2040js::prepare()?;
    run(Command::new(cargo()).args(["build", "--quiet", "--package", "mavstack-check"]).current_dir(root()))?;
    let mut patients = sound(is_built)?;
    patients.extend(faulty()?);
    println!("Built in {} s\n\n{:24} {:40} {:>4}", began.elapsed().as_secs(), "", "errors and warnings", "s");
    let (waiting, again) = (Mutex::new(VecDeque::from(patients)), Mutex::new(Vec::new()));
    let next = || waiting.lock().ok()?.pop_front();
    std::thread::scope(|scope| {
        for _ in 0..AT_A_TIME {
            scope.spawn(|| {
                while let Some(patient) = next() {
                    if let (Err(_), Ok(mut again)) = (patient.examine(&program), again.lock()) {
                        again.push(patient);
                    }
                }
            });
        }
    });
    // A computer that is busy with something else delays the emulators.
    let again = again.into_inner().unwrap_or_default();
    let alone = again.iter().inspect(|patient| println!("{}, once more, alone:", patient.name));
    let failures = alone.filter_map(|patient| Some(format!("{}: {}", patient.name, patient.examine(&program).err()?)));
    let failures: Vec<_> = failures.collect();
    println!("\nDone in {} s", began.elapsed().as_secs());
    if failures.is_empty() { Ok(()) } else { Err(failures.join("\n")) }
}

/// Builds the boards as they are.
fn sound(is_built: impl Fn(&str) -> bool) -> Result<Vec<Patient>> {
    let mut patients = Vec::new();
    for board in IN_QEMU.iter().filter(|board| is_built(board.name)) {
        let firmware = keep(boards::build_by_name(board.name, board.build)?, board.name)?;
        let place = Place::Qemu(board);
        patients.push(Patient { name: board.name.into(), firmware, place, baud: BAUD, options: SOUND, expected: None });
    }
    for (name, links) in IN_RP2040JS {
        let firmware = keep(boards::build_by_name(name, &[])?, name)?;
        for options in links {
            let is_usb = options.contains(&"--usb");
            let (place, link) = if is_usb { (Place::Usb, "USB") } else { (Place::Uart, "UART") };
            let baud = if options.contains(&"--dma") { 2 * BAUD } else { BAUD };
            let name = format!("{name}, {link}");
            patients.push(Patient { name, firmware: firmware.clone(), place, baud, options: SOUND, expected: None });
        }
    }
    Ok(patients)
}

/// Builds the firmware with each fault.
fn faulty() -> Result<Vec<Patient>> {
    let build = |(fault, finding, options)| {
        let firmware = boards::compile(FAULTY, TARGET, "mavstack-faulty", &["--features", fault])?;
        let baud = if fault == "streams" { SLOW_BAUD } else { BAUD };
        let (name, firmware) = (format!("faulty: {fault}"), keep(firmware, fault)?);
        Ok(Patient { name, firmware, place: Place::Uart, baud, options, expected: Some(finding) })
    };
    FAULTS.into_iter().map(build).collect()
}

/// Copies a firmware: the next build with other features overwrites it.
fn keep(firmware: PathBuf, name: &str) -> Result<PathBuf> {
    let folder = target_dir().join("boards/doctor");
    let copy = folder.join(name);
    let copied = fs::create_dir_all(&folder).and_then(|()| fs::copy(firmware, &copy));
    copied.map_err(|error| format!("{}: {error}", copy.display()))?;
    Ok(copy)
}

impl Patient {
    /// Starts the emulator. Returns it with the port of its link.
    fn start(&self, program: &Path) -> Result<(Emulator, u16)> {
        let [uart, usb, control] = boards::free_ports()?;
        match self.place {
            Place::Qemu(board) => {
                let emulator = boards::start_in_qemu(board, &self.firmware, [uart, usb, control])?;
                Ok((emulator, paced::line(uart, self.baud)?))
            }
            Place::Uart | Place::Usb => {
                let options = ["--catch-up", "--baud", &self.baud.to_string()];
                let emulator = rp2040js::start(program, &self.firmware, [uart, usb, control], &options)?;
                Ok((emulator, if matches!(self.place, Place::Usb) { usb } else { uart }))
            }
        }
    }

    /// Runs the doctor, and compares what it finds.
    fn examine(&self, program: &Path) -> Result {
        let began = Instant::now();
        // Ended when dropped.
        let (_emulator, port) = self.start(program)?;
        let mut doctor = Command::new(target_dir().join("debug/mavstack-check"));
        doctor.args(["doctor", &format!("tcp:127.0.0.1:{port}"), "--json", "--quiet"]).stdin(Stdio::null());
        if !matches!(self.place, Place::Usb) {
            doctor.args(["--baud", &self.baud.to_string()]);
        }
        doctor.args(self.options);
        let output = doctor.output().map_err(|error| format!("mavstack-check: {error}"))?;
        let report: Value = serde_json::from_slice(&output.stdout)
            .map_err(|_| format!("no report: {}", String::from_utf8_lossy(&output.stderr)))?;
        let problems = problems(&report);
        let names = if problems.is_empty() { "none".to_owned() } else { problems.join(", ") };
        println!("{:24} {names:40} {:>4}", self.name, began.elapsed().as_secs());
        let expected: Vec<_> = self.expected.into_iter().collect();
        if problems == expected {
            Ok(())
        } else {
            Err(format!("expected {expected:?}, and this is the report:\n{report:#}"))
        }
    }
}

/// Returns the names of the errors and warnings in a report. Notes are facts about a sound board.
fn problems(report: &Value) -> Vec<&str> {
    let findings = report["findings"].as_array().map(Vec::as_slice).unwrap_or_default();
    let problems = findings.iter().filter(|finding| finding["severity"] != "note");
    problems.filter_map(|finding| finding["id"].as_str()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each feature of the firmware is examined.
    #[test]
    fn every_fault_is_in_the_list() {
        let manifest = fs::read_to_string(root().join(FAULTY).join("Cargo.toml")).unwrap();
        let features = manifest.split("[features]").nth(1).and_then(|rest| rest.split("\n[").next()).unwrap();
        let features: Vec<_> = features.lines().filter_map(|line| line.strip_suffix(" = []")).collect();
        assert_eq!(features, FAULTS.map(|(feature, ..)| feature));
    }

    #[test]
    fn notes_are_no_problems() {
        let finding = |id, severity| serde_json::json!({ "id": id, "severity": severity });
        let report = serde_json::json!({ "findings": [finding("stall", "error"), finding("hidden", "note")] });
        assert_eq!(problems(&report), ["stall"]);
        assert!(problems(&Value::Null).is_empty());
    }
}
