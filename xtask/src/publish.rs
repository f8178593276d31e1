//! `cargo xtask publish-check`: whether the crates could be published as they are. Publishes nothing.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

use crate::system::{Result, cargo, root, run};

/// What is published, and where it is. A crate comes after those that it uses.
const CRATES: [(&str, &str); 11] = [
    ("mavstack-macros", "crates/macros"),
    ("mavstack", "."),
    ("mavstack-traffic", "crates/traffic"),
    ("mavstack-station", "crates/station"),
    ("mavstack-check", "crates/check"),
    ("mavstack-dialect", "dialect"),
    ("mavstack-snapshot", "crates/snapshot"),
    ("mavstack-fram", "crates/fram"),
    ("mavstack-demo", "examples/demo"),
    ("mavstack-console", "examples/console"),
    ("mavstack-sitl", "examples/sitl"),
];

/// What a package must have, besides its sources.
const FILES: [&str; 4] = ["Cargo.toml", "LICENSE-APACHE", "LICENSE-MIT", "README.md"];

/// What has no place in one.
const REFUSED: [&str; 5] = ["tests/", "benches/", "examples/", "xtask/", ".ci/"];

/// The registry's categories that we are in: it warns of others only once a crate is there.
const CATEGORIES: [&str; 8] = [
    "aerospace::unmanned-aerial-vehicles",
    "command-line-utilities",
    "concurrency",
    "development-tools::build-utils",
    "development-tools::testing",
    "embedded",
    "no-std::no-alloc",
    "simulation",
];

/// Contents and metadata of each crate, and that all others stay here. With `builds`, also the documentation as docs.rs builds it,
/// and Cargo's own dry run.
pub fn check(builds: bool) -> Result {
    members_stay_here()?;
    for (name, folder) in CRATES {
        contents(name)?;
        metadata(name, &root().join(folder))?;
        println!("{name}: contents and metadata are as they should be");
    }
    if !builds {
        return Ok(());
    }
    let mut doc = command(&["doc", "--no-deps", "--all-features"]);
    doc.args(CRATES.iter().flat_map(|(name, _)| ["--package", name])).env("RUSTDOCFLAGS", "-D warnings");
    run(&mut doc)?;
    dry_run()
}

/// All members but these say `publish = false`.
fn members_stay_here() -> Result {
    let metadata = output(&["metadata", "--format-version", "1", "--no-deps"])?;
    // `"publish":null` is what may be published: as many as there are crates here.
    let published = metadata.matches("\"publish\":null").count();
    if published != CRATES.len() {
        return Err(format!("{published} packages may be published, not {}: say `publish = false`", CRATES.len()));
    }
    Ok(())
}

fn contents(name: &str) -> Result {
    let list = output(&["package", "--list", "--allow-dirty", "--package", name])?;
    let files: Vec<_> = list.lines().map(|line| line.replace('\\', "/")).collect();
    if let Some(missing) = FILES.iter().find(|wanted| files.iter().all(|file| file != *wanted)) {
        return Err(format!("{name}: the package has no {missing}; see `include` in its Cargo.toml"));
    }
    match files.iter().find(|file| REFUSED.iter().any(|prefix| file.starts_with(prefix))) {
        Some(file) => Err(format!("{name}: {file} is in the package; see `include` in its Cargo.toml")),
        None => Ok(()),
    }
}

/// What the registry refuses, and what a reader misses.
fn metadata(name: &str, folder: &Path) -> Result {
    let text = read(&folder.join("Cargo.toml"))?;
    let list = |key: &str| -> Vec<String> {
        let line = text.lines().find_map(|line| line.strip_prefix(key)?.trim_start().strip_prefix('='));
        line.unwrap_or_default().split('"').skip(1).step_by(2).map(str::to_owned).collect()
    };
    let refuse = |what: String| Err(format!("{name}: {what}"));
    let keywords = list("keywords");
    let is_keyword = |word: &String| {
        let is_char = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '+');
        word.len() <= 20 && word.starts_with(|c: char| c.is_ascii_alphanumeric()) && word.chars().all(is_char)
    };
    if !(1..=5).contains(&keywords.len()) || !keywords.iter().all(is_keyword) {
        return refuse(format!("1 to 5 keywords of at most 20 letters and digits, not {keywords:?}"));
    }
    let categories = list("categories");
    if categories.is_empty() || categories.len() > 5 {
        return refuse("1 to 5 categories".to_owned());
    }
    if let Some(other) = categories.iter().find(|category| !CATEGORIES.contains(&category.as_str())) {
        return refuse(format!(
            "is there a category {other}? Look it up, and add it to the list in xtask/src/publish.rs"
        ));
    }
    for key in ["description", "readme", "license.workspace", "repository.workspace", "rust-version.workspace"] {
        if !text.lines().any(|line| line.strip_prefix(key).is_some_and(|rest| rest.trim_start().starts_with('='))) {
            return refuse(format!("no `{key}` in its Cargo.toml"));
        }
    }
    // A licence is a link here, and the text itself in the package.
    for licence in ["LICENSE-APACHE", "LICENSE-MIT"] {
        if read(&folder.join(licence))? != read(&root().join(licence))? {
            return refuse(format!("its {licence} is not the project's"));
        }
    }
    Ok(())
}

/// Each package built from its own contents alone. Without the registry at hand that is all; with it, all that publishing
/// does but the upload.
fn dry_run() -> Result {
    forget_unpacked()?;
    // Cargo would also take what it has built of the same version.
    let target = root().join("target/publish");
    if target.exists() {
        fs::remove_dir_all(&target).map_err(|error| format!("{}: {error}", target.display()))?;
    }
    let packages: Vec<_> = CRATES.iter().flat_map(|(name, _)| ["--package", name]).collect();
    let is_online = command(&["info", "mavstack", "--registry", "crates-io", "--quiet"]).output();
    let is_online = is_online.is_ok_and(|output| {
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        output.status.success() || said.contains("could not find")
    });
    let task: &[&str] = if is_online {
        &["publish", "--dry-run", "--allow-dirty"]
    } else {
        println!(
            "The registry cannot be reached: the packages are built from their contents, and not held against it."
        );
        &["package", "--offline", "--allow-dirty"]
    };
    // A package lacks the profiles of the workspace.
    run(command(task).args(packages).arg("--target-dir").arg(target).env("CARGO_PROFILE_DEV_DEBUG", "0"))
}

/// Removes what Cargo has unpacked of these crates in an earlier dry run: it would take the same version for the same contents. Local
/// registries are the folders whose names begin with `-`, because they have no host.
fn forget_unpacked() -> Result {
    let home = env::var_os("CARGO_HOME").map(PathBuf::from);
    let home = home.or_else(|| env::home_dir().map(|home| home.join(".cargo")));
    let Some(registries) = home.and_then(|home| fs::read_dir(home.join("registry/src")).ok()) else { return Ok(()) };
    for registry in registries.flatten().filter(|entry| entry.file_name().to_string_lossy().starts_with('-')) {
        for unpacked in fs::read_dir(registry.path()).into_iter().flatten().flatten() {
            let folder = unpacked.file_name().to_string_lossy().into_owned();
            if CRATES.iter().any(|(name, _)| folder.strip_prefix(name).is_some_and(is_version)) {
                fs::remove_dir_all(unpacked.path()).map_err(|error| format!("{folder}: {error}"))?;
            }
        }
    }
    Ok(())
}

/// Whether the end of a folder's name is a version: `-0.1.0`.
fn is_version(end: &str) -> bool {
    end.strip_prefix('-').is_some_and(|version| version.starts_with(|first: char| first.is_ascii_digit()))
}

fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(cargo());
    command.args(arguments).current_dir(root());
    command
}

fn output(arguments: &[&str]) -> Result<String> {
    let output = command(arguments).output().map_err(|error| format!("cargo could not be started: {error}"))?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    Err(format!("cargo {} failed: {}", arguments.join(" "), String::from_utf8_lossy(&output.stderr)))
}

fn read(path: &Path) -> Result<String> {
    fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))
}
