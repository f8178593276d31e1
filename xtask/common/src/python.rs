//! A Python environment with the ground stations' libraries.

use std::path::PathBuf;
use std::process::Command;

use crate::system::{Result, apt_install, output, root, run, target_dir};

/// The folder of the tests with ground stations, and of the list of what they need.
pub const CLIENTS: &str = ".ci/integration";

/// Makes a Python environment with pymavlink, MAVSDK and MAVProxy, unless it is there, and returns its interpreter.
pub fn environment() -> Result<PathBuf> {
    let folder = target_dir().join("integration-python");
    let python = folder.join("bin/python");
    let requirements = root().join(CLIENTS).join("requirements.txt");
    let wanted =
        std::fs::read_to_string(&requirements).map_err(|error| format!("{}: {error}", requirements.display()))?;
    let stamp = folder.join("installed.txt");
    if std::fs::read_to_string(&stamp).is_ok_and(|installed| installed == wanted) {
        return Ok(python);
    }
    println!("Installing the clients into {}", folder.display());
    let create = || output("python3", &["-m", "venv", "--clear", &folder.to_string_lossy()]).is_some();
    if !create() {
        apt_install("Python with venv", &["python3", "python3-venv"], "https://www.python.org")?;
        if !create() {
            return Err("`python3 -m venv` fails".to_owned());
        }
    }
    let pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps", "--requirement"];
    run(Command::new(&python).args(pip).arg(&requirements))?;
    std::fs::write(&stamp, wanted).map_err(|error| format!("{}: {error}", stamp.display()))?;
    Ok(python)
}
