//! The emulator, QEMU or another: starting it, reading its output, ending it.

use std::io::{BufRead, BufReader};
use std::process::{Child, ChildStdout, Command, ExitStatus};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use crate::system::{Result, apt_install, has, succeeds};

const QEMU: &str = "qemu-system-arm";
/// The emulated board: a Cortex-M4F.
pub const BOARD: &str = "mps2-an386";

/// Installs QEMU if it is missing.
pub fn prepare() -> Result {
    if has(QEMU) {
        return Ok(());
    }
    let elsewhere = "QEMU for Arm systems (Fedora: `dnf install qemu-system-arm`, Arch: `pacman -S qemu-system-arm`, \
                     macOS: `brew install qemu`)";
    apt_install("the emulator QEMU", &[QEMU], elsewhere)
}

/// Returns QEMU's command, as [`command_of`] does.
pub fn command() -> Command {
    command_of(QEMU)
}

/// Returns the command of an emulator. On Linux the emulator also ends when this program is killed.
pub fn command_of(program: &str) -> Command {
    let dies_with_us = ["--pdeathsig", "KILL"];
    let mut command = if succeeds("setpriv", &[&dies_with_us[..], &["true"]].concat()) {
        let mut command = Command::new("setpriv");
        command.args(dies_with_us).arg(program);
        command
    } else {
        Command::new(program)
    };
    // Ctrl-C on the terminal must reach this program only, or the emulator would seem to end by itself.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    command
}

/// How the emulator ended.
pub enum Ended {
    /// By a signal to this program.
    Stopped,
    /// By itself: the firmware ended or panicked, or QEMU failed.
    ByItself(ExitStatus),
}

/// A running emulator. It is ended when dropped.
pub struct Emulator(Child);

impl Emulator {
    /// Waits until it ends, or until `stop` has a message.
    pub fn wait(&mut self, stop: &mpsc::Receiver<()>) -> Result<Ended> {
        loop {
            if let Some(status) = self.0.try_wait().map_err(|error| format!("the emulator is lost: {error}"))? {
                return Ok(Ended::ByItself(status));
            }
            if stop.recv_timeout(Duration::from_millis(100)).is_ok() {
                return Ok(Ended::Stopped);
            }
        }
    }
}

/// Starts the emulator by its `command`. Returns it with its output, which must be piped.
pub fn start(command: &mut Command) -> Result<(Emulator, ChildStdout)> {
    let mut child = command.spawn().map_err(|error| format!("the emulator could not be started: {error}"))?;
    let output = child.stdout.take();
    let emulator = Emulator(child);
    output.map(|output| (emulator, output)).ok_or_else(|| "the emulator has no output".to_owned())
}

/// The lines of a firmware's output. A thread reads them, so a firmware that hangs is detected.
pub struct Lines(mpsc::Receiver<String>);

impl Lines {
    /// Longer than any firmware here is silent, also on a busy machine.
    const PATIENCE: Duration = Duration::from_secs(300);

    /// Starts to read `output`.
    pub fn of(output: ChildStdout) -> Self {
        let (sender, lines) = mpsc::channel();
        std::thread::spawn(move || {
            // After a timeout nothing receives the lines any more.
            BufReader::new(output).lines().map_while(std::result::Result::ok).try_for_each(|line| sender.send(line))
        });
        Self(lines)
    }

    /// Returns the next line; `None` after the last one.
    ///
    /// # Errors
    ///
    /// The firmware has printed nothing for five minutes.
    pub fn next(&self) -> Result<Option<String>> {
        match self.0.recv_timeout(Self::PATIENCE) {
            Ok(line) => Ok(Some(line)),
            Err(RecvTimeoutError::Disconnected) => Ok(None),
            Err(RecvTimeoutError::Timeout) => {
                Err(format!("the firmware has printed nothing for {:?}: it hangs", Self::PATIENCE))
            }
        }
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        // Both fail only if it has already ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
