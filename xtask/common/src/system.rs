//! The machine: its programs and packages, and the project's folders.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The result of a task. An error is a sentence for the user.
pub type Result<T = ()> = std::result::Result<T, String>;

/// Returns the workspace's folder.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap_or(Path::new("."))
}

/// Returns the folder for builds.
pub fn target_dir() -> PathBuf {
    // A relative path is relative to the folder where cargo was called, which is the current one.
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from)
}

/// Returns the cargo that runs this program.
pub fn cargo() -> PathBuf {
    std::env::var_os("CARGO").map_or_else(|| "cargo".into(), PathBuf::from)
}

/// Returns whether nothing may be skipped because something is missing: the variable `CI` is `true`.
pub fn is_ci() -> bool {
    std::env::var_os("CI").is_some_and(|ci| ci == "true")
}

/// Returns whether `program` can be started.
pub fn has(program: &str) -> bool {
    Command::new(program).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok()
}

/// Returns whether `program` with `arguments` succeeds. Its output is dropped.
pub fn succeeds(program: &str, arguments: &[&str]) -> bool {
    output(program, arguments).is_some()
}

/// Returns the output of `program`, trimmed; `None` if it fails.
pub fn output(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).stderr(Stdio::null()).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// Runs `command`. Its output is for the user.
pub fn run(command: &mut Command) -> Result {
    let name = command.get_program().to_string_lossy().into_owned();
    match command.status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("{name} failed ({status})")),
        Err(error) => Err(format!("{name} could not be started: {error}")),
    }
}

/// Installs a nightly toolchain with these components, as far as they are missing.
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

/// Returns the options of `cargo test` and the filters for its test binaries that run only these files of `tests/`. Each is named
/// as `group/file`: `tests/group` is a binary, and the file a module of it. A file that does not exist is an error.
pub fn test_files(files: &[&str]) -> Result<(Vec<String>, Vec<String>)> {
    let (mut options, mut filters) = (BTreeSet::new(), Vec::new());
    for file in files {
        let is_there = root().join("tests").join(file).with_extension("rs").is_file();
        let names = file.split_once('/').filter(|_| is_there);
        let (group, name) = names.ok_or_else(|| format!("there is no tests/{file}.rs"))?;
        options.insert(format!("--test={group}"));
        filters.push(format!("{name}::"));
    }
    Ok((options.into_iter().collect(), filters))
}

/// Installs Debian packages. Without root or apt-get it fails, and the error says what to do.
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
