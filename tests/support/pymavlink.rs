//! A Python with pymavlink, for tests that compare with it.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::OnceLock;

/// The same version as in `.ci/integration/requirements.txt`.
const PYMAVLINK: &str = "pymavlink==2.4.50";

/// Returns a Python with pymavlink, which is installed on first use. Returns `None` if that is not possible, and the test is then
/// skipped; in CI it panics.
pub fn python() -> Option<&'static Path> {
    // Tests run in parallel; the first one creates the environment.
    static PYTHON: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    match PYTHON.get_or_init(environment) {
        Ok(python) => Some(python),
        Err(reason) => {
            assert!(std::env::var_os("CI").is_none_or(|ci| ci != "true"), "CI has no pymavlink: {reason}");
            println!("SKIPPED: nothing was compared with pymavlink: {reason}");
            None
        }
    }
}

/// Returns the Python of a virtual environment in the target folder, which is created on first use.
fn environment() -> Result<PathBuf, String> {
    let environment = Path::new(env!("CARGO_TARGET_TMPDIR")).join("pymavlink");
    let python = environment.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
    let version = PYMAVLINK.rsplit('=').next().unwrap_or_default();
    let check = format!("import importlib.metadata as m; assert m.version('pymavlink') == '{version}'");
    if run(Command::new(&python).args(["-c", &check])).is_ok() {
        return Ok(python);
    }
    run(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&environment))?;
    run(Command::new(&python).args(["-m", "pip", "install", "--quiet", "--no-input", PYMAVLINK]))?;
    Ok(python)
}

fn run(command: &mut Command) -> Result<ExitStatus, String> {
    let what = format!("{command:?}");
    let output = command.stdin(Stdio::null()).output().map_err(|error| format!("{what}: {error}"))?;
    if output.status.success() {
        return Ok(output.status);
    }
    Err(format!("{what}: {}", String::from_utf8_lossy(&output.stderr).lines().last().unwrap_or("failed")))
}
