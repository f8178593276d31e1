//! The machine we run on: programs, packages, the project's folders.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc;

/// What a task ends with. Errors are sentences for the user.
pub type Result<T = ()> = std::result::Result<T, String>;

/// The workspace's folder.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap_or(Path::new("."))
}

/// Where builds go.
pub fn target_dir() -> PathBuf {
    // A relative path is relative to where cargo was called, which is where we are.
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from)
}

/// The cargo that runs us.
pub fn cargo() -> PathBuf {
    std::env::var_os("CARGO").map_or_else(|| "cargo".into(), PathBuf::from)
}

/// Whether `program` can be started.
pub fn has(program: &str) -> bool {
    Command::new(program).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok()
}

/// Whether `program` with `arguments` succeeds; what it prints is dropped.
pub fn succeeds(program: &str, arguments: &[&str]) -> bool {
    output(program, arguments).is_some()
}

/// What `program` prints; `None` when it fails.
pub fn output(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).stderr(Stdio::null()).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// Runs `command` with our own output; what it says is for the user.
pub fn run(command: &mut Command) -> Result {
    let name = command.get_program().to_string_lossy().into_owned();
    match command.status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("{name} failed ({status})")),
        Err(error) => Err(format!("{name} could not be started: {error}")),
    }
}

/// Sees to it that there is a nightly toolchain with these components.
pub fn nightly(components: &[&str]) -> Result {
    if !succeeds("rustup", &["run", "nightly", "rustc", "--version"]) {
        println!("Installing a nightly toolchain: rustup toolchain install nightly");
        let install = ["toolchain", "install", "nightly", "--profile", "minimal", "--no-self-update"];
        run(Command::new("rustup").args(install))?;
    }
    let list = ["component", "list", "--installed", "--toolchain", "nightly"];
    let installed = output("rustup", &list).unwrap_or_default();
    let is_missing = |name: &&&str| !installed.lines().any(|line| line.starts_with(**name));
    for component in components.iter().filter(is_missing) {
        println!("Installing: rustup component add --toolchain nightly {component}");
        run(Command::new("rustup").args(["component", "add", "--toolchain", "nightly", component]))?;
    }
    Ok(())
}

/// The library's test files by their names, without those that are left out.
pub fn tests_of_library(left_out: &[&str]) -> Result<Vec<String>> {
    let folder = root().join("tests");
    let entries = std::fs::read_dir(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let files =
        entries.flatten().map(|entry| entry.path()).filter(|path| path.extension().is_some_and(|it| it == "rs"));
    let names = files.filter_map(|path| Some(path.file_stem()?.to_string_lossy().into_owned()));
    let mut names: Vec<_> = names.filter(|name| !left_out.contains(&name.as_str())).collect();
    names.sort_unstable();
    Ok(names)
}

/// Installs Debian packages if we may; else says how to.
pub fn apt_install(purpose: &str, packages: &[&str], elsewhere: &str) -> Result {
    let list = packages.join(" ");
    if !has("apt-get") {
        return Err(format!("{purpose} is missing; install it: {elsewhere}"));
    }
    if output("id", &["-u"]).as_deref() != Some("0") {
        return Err(format!("{purpose} is missing; install it, then try again:\n\n    sudo apt-get install {list}\n"));
    }
    println!("Installing {purpose}: apt-get install {list}");
    let quiet = |arguments: &[&str]| {
        run(Command::new("apt-get")
            .args(["-qq", "-o", "Dpkg::Use-Pty=0"])
            .args(arguments)
            .env("DEBIAN_FRONTEND", "noninteractive")
            .stdin(Stdio::null())
            .stdout(Stdio::null()))
    };
    let install: Vec<&str> =
        ["install", "--yes", "--no-install-recommends"].into_iter().chain(packages.iter().copied()).collect();
    // A fresh machine has no package lists yet; a stale one may be good enough.
    let updated = quiet(&["update"]);
    quiet(&install).and(updated.or(Ok(())))
}

/// Gets a message at Ctrl-C and SIGTERM, which from now on no longer end us by themselves. To be called once.
pub fn stop_signal() -> Result<mpsc::Receiver<()>> {
    let (sender, receiver) = mpsc::channel();
    ctrlc::set_handler(move || sender.send(()).unwrap_or(())).map_err(|error| format!("signals: {error}"))?;
    Ok(receiver)
}
