//! `cargo xtask fuzz`: the fuzz targets, one on each core, with what they need installed first.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::thread;
use std::time::{Duration, Instant};

use crate::corpus;
use crate::system::{self, Result, apt_install, has, output, root, run, succeeds, target_dir};

/// All of them, the quick ones first.
pub const TARGETS: [&str; 8] = ["decode", "wpl", "roundtrip", "sign", "record", "dialect", "files", "session"];

/// An input that takes longer than this (s) ends the run. On a busy machine a quick one may wait for seconds.
const TIMEOUT: u32 = 10;
/// No input may take longer than this (ms), measured alone. The best of several runs counts, because other programs share the machine.
const SLOWEST: u64 = 10;
/// Maximum number of runs of an input, and their duration, to find one within the bound.
const MAX_RUNS: u32 = 60;
const MAX_TIME: Duration = Duration::from_secs(30);

/// Of what is checked in beside the seeds.
const MAX_BYTES: u64 = 100_000;

/// What to do.
pub struct Options {
    /// How long each target runs, unless a number of executions is given.
    pub seconds: u32,
    /// Executions of each target.
    pub executions: Option<u64>,
    /// Run nothing: rebuild the checked-in corpora from what was found.
    pub minimises: bool,
    /// All, when none is named.
    pub targets: Vec<String>,
}

/// A target, and where its inputs are.
struct Target {
    name: String,
    binary: PathBuf,
    /// Checked in: the archive that a run starts with, and the inputs of old defects.
    archive: PathBuf,
    regressions: PathBuf,
    /// The archive, unpacked.
    corpus: PathBuf,
    /// What runs on this machine have found.
    found: PathBuf,
    artifacts: PathBuf,
}

/// Runs targets, and prints their figures.
pub fn fuzz(options: &Options) -> Result {
    let known = TARGETS.map(str::to_owned).to_vec();
    let names = if options.targets.is_empty() { &known } else { &options.targets };
    if let Some(unknown) = names.iter().find(|name| !known.contains(name)) {
        return Err(format!("there is no fuzz target {unknown}; there are {}", known.join(", ")));
    }
    let binaries = build()?;
    let targets: Vec<_> = names.iter().map(|name| Target::new(name, &binaries)).collect();
    if options.minimises {
        return targets.iter().try_for_each(Target::minimise);
    }
    println!(
        "{:<10} {:>13} {:>9} {:>7} {:>7} {:>7} {:>11}",
        "target", "executions", "each s", "edges", "feats", "corpus", "slowest ms"
    );
    // Whichever worker is free takes the next one.
    let (left, failed) = (Mutex::new(targets.iter()), Mutex::new(Vec::new()));
    let next = || left.lock().ok()?.next();
    let run_all = || {
        while let Some(target) = next() {
            if let (Err(error), Ok(mut failed)) = (target.run(options), failed.lock()) {
                failed.push(error);
            }
        }
    };
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(run_all);
        }
    });
    let failed = failed.into_inner().map_err(|error| error.to_string())?;
    if failed.is_empty() { Ok(()) } else { Err(failed.join("\n\n")) }
}

/// Installs a nightly toolchain, cargo-fuzz and a C++ compiler if they are missing.
pub fn prepare() -> Result {
    system::nightly(&[])?;
    if !succeeds("cargo", &["fuzz", "--version"]) {
        println!("Installing cargo-fuzz: cargo install cargo-fuzz --locked");
        run(Command::new("rustup").args(["run", "stable", "cargo", "install", "--quiet", "cargo-fuzz", "--locked"]))?;
    }
    if !has("c++") {
        apt_install("a C++ compiler, for the fuzzer", &["g++"], "a C++ compiler, as `c++`")?;
    }
    Ok(())
}

/// Builds all targets and returns their folder.
fn build() -> Result<PathBuf> {
    prepare()?;
    let host = output("rustup", &["run", "nightly", "rustc", "-vV"]).unwrap_or_default();
    let host = host.lines().find_map(|line| line.strip_prefix("host: ")).ok_or("rustc does not say what it is for")?;
    let folder = target_dir().join("fuzz").join("build");
    let mut command = Command::new("rustup");
    // No sanitizer: there is no `unsafe` to watch, and fuzzing is four times as fast. Without traces of comparisons it is twice
    // as fast; the seeds, and targets that repair checksums, make up for the traces.
    command.args(["run", "nightly", "cargo", "fuzz", "build", "--sanitizer", "none", "--no-trace-compares"]);
    command.arg("--target-dir").arg(&folder);
    // The nightly cargo must not get the environment of this one.
    let command =
        command.env_remove("CARGO").env_remove("RUSTUP_TOOLCHAIN").env_remove("RUSTFLAGS").current_dir(root());
    run(command)?;
    Ok(folder.join(host).join("release"))
}

impl Target {
    fn new(name: &str, binaries: &Path) -> Self {
        let (checked_in, here) = (root().join("fuzz"), target_dir().join("fuzz"));
        Self {
            name: name.to_owned(),
            binary: binaries.join(name),
            archive: checked_in.join("corpus").join(format!("{name}.tar")),
            regressions: checked_in.join("regressions").join(name),
            corpus: here.join("corpus").join(name),
            found: here.join(name),
            artifacts: here.join("artifacts").join(name),
        }
    }

    /// The fuzzer, writing what it finds to where the next run looks for it.
    fn command(&self) -> Command {
        let mut command = Command::new(&self.binary);
        command.arg(format!("-timeout={TIMEOUT}")).arg("-rss_limit_mb=1024").stdout(Stdio::null()).stdin(Stdio::null());
        command.arg(format!("-artifact_prefix={}/", self.artifacts.display()));
        command
    }

    fn max_len(&self) -> u32 {
        match self.name.as_str() {
            "decode" => 300,
            "roundtrip" => 264,
            "sign" | "session" | "files" => 512,
            _ => 4_096,
        }
    }

    /// Replaces the content of the corpus folder with the inputs of the archive.
    fn unpack(&self) -> Result {
        let inputs = corpus::read(&self.archive).map_err(|error| error.to_string())?;
        let failed = |error: std::io::Error| format!("{}: {error}", self.corpus.display());
        if self.corpus.exists() {
            fs::remove_dir_all(&self.corpus).map_err(failed)?;
        }
        fs::create_dir_all(&self.corpus).map_err(failed)?;
        inputs.iter().try_for_each(|(name, input)| fs::write(self.corpus.join(name), input)).map_err(failed)
    }

    fn run(&self, options: &Options) -> Result {
        self.unpack()?;
        for folder in [&self.found, &self.artifacts] {
            fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
        }
        let mut command = self.command();
        match options.executions {
            Some(count) => command.arg(format!("-runs={count}")),
            None => command.arg(format!("-max_total_time={}", options.seconds)),
        };
        command.arg(format!("-max_len={}", self.max_len())).arg("-print_final_stats=1");
        let folders = [&self.found, &self.corpus, &self.regressions];
        command.args(folders.into_iter().filter(|folder| folder.is_dir()));
        let log = self.log(&mut command)?;
        if !log.is_success {
            let again = format!("{} {}/…", self.binary.display(), self.artifacts.display());
            let why = log.tail("panicked at", 40);
            return Err(format!(
                "{} failed:\n{why}\nThe input is in {}; again:\n\n    {again}",
                self.name,
                self.artifacts.display()
            ));
        }
        let statistic = |name: &str| {
            let number = log.number(&format!("stat::{name}:"));
            number.ok_or_else(|| format!("{}: the fuzzer does not say its {name}", self.name))
        };
        let last = |name: &str| log.last_in_line(name).unwrap_or("-").to_owned();
        let executions = statistic("number_of_executed_units")?;
        let (slowest, ms) = self.slowest()?;
        println!(
            "{:<10} {executions:>13} {:>9} {:>7} {:>7} {:>7} {ms:>11}",
            self.name,
            statistic("average_exec_per_sec")?,
            last("cov:"),
            last("ft:"),
            last("corp:").split('/').next().unwrap_or("-"),
        );
        if executions == 0 {
            return Err(format!("{}: nothing was run", self.name));
        }
        if ms > SLOWEST {
            return Err(format!("{}: {} takes {ms} ms, bound {SLOWEST}", self.name, slowest.display()));
        }
        Ok(())
    }

    /// The input that takes longest by itself, and how long that is (ms).
    fn slowest(&self) -> Result<(PathBuf, u64)> {
        let mut slowest = (PathBuf::new(), 0);
        for files in files(&[&self.found, &self.corpus, &self.regressions])?.chunks(500) {
            let files: Vec<_> = files.iter().map(|(file, _)| file.as_path()).collect();
            for (file, ms) in files.iter().zip(self.times(&files)?) {
                let (mut best, began) = (ms, Instant::now());
                for _ in 1..MAX_RUNS {
                    if best <= SLOWEST || began.elapsed() > MAX_TIME {
                        break;
                    }
                    best = self.times(&[file])?.into_iter().fold(best, u64::min);
                }
                if best >= slowest.1 {
                    slowest = (file.to_path_buf(), best);
                }
            }
        }
        Ok(slowest)
    }

    /// How long each of `files` takes (ms), in their order.
    fn times(&self, files: &[&Path]) -> Result<Vec<u64>> {
        let log = self.log(self.command().args(files))?;
        let times = log.text.lines().filter_map(|line| line.strip_prefix("Executed ")?.strip_suffix(" ms"));
        let times: Vec<_> = times.filter_map(|line| line.rsplit(' ').next()?.parse().ok()).collect();
        let is_whole = log.is_success && times.len() == files.len();
        is_whole.then_some(times).ok_or_else(|| format!("{}: its inputs could not be run one by one", self.name))
    }

    /// Replaces what is checked in beside the seeds by the least that reaches all the code that is reached, as far as there is
    /// room.
    fn minimise(&self) -> Result {
        self.unpack()?;
        let merged = target_dir().join("fuzz").join("merged").join(&self.name);
        let failed = |error: std::io::Error| format!("{}: {error}", merged.display());
        if merged.exists() {
            fs::remove_dir_all(&merged).map_err(failed)?;
        }
        fs::create_dir_all(&merged).map_err(failed)?;
        let folders = [&self.found, &self.corpus];
        let mut command = self.command();
        // Edges only: how often each is passed would be ten times as many inputs.
        command.args(["-set_cover_merge=1", "-use_counters=0"]).arg(&merged);
        command.args(folders.into_iter().filter(|folder| folder.is_dir()));
        if !self.log(&mut command)?.is_success {
            return Err(format!("{}: the corpora could not be merged", self.name));
        }
        let mut inputs = corpus::read(&self.archive).map_err(|error| error.to_string())?;
        inputs.retain(|name, _| name.starts_with(corpus::SEED));
        let mut found = files(&[&merged])?;
        found.sort_by_key(|(path, len)| (*len, path.clone()));
        let (mut count, mut bytes) = (0, 0);
        for (file, len) in &found {
            bytes += len;
            if bytes > MAX_BYTES {
                break;
            }
            let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
            inputs.insert(name, fs::read(file).map_err(failed)?);
            count += 1;
        }
        corpus::write(&self.archive, &inputs).map_err(|error| error.to_string())?;
        println!("{}: {count} of {} inputs, beside the seeds", self.name, found.len());
        Ok(())
    }

    fn log(&self, command: &mut Command) -> Result<Log> {
        let output = command.stderr(Stdio::piped()).output();
        let output = output.map_err(|error| format!("{} could not be started: {error}", self.binary.display()))?;
        Ok(Log { is_success: output.status.success(), text: String::from_utf8_lossy(&output.stderr).into_owned() })
    }
}

/// All files of these folders, with their lengths; a folder that is not there has none.
fn files(folders: &[&PathBuf]) -> Result<Vec<(PathBuf, u64)>> {
    let mut files = Vec::new();
    for folder in folders {
        let Ok(entries) = fs::read_dir(folder) else { continue };
        for entry in entries.flatten() {
            let metadata = entry.metadata().map_err(|error| format!("{}: {error}", entry.path().display()))?;
            files.push((entry.path(), metadata.len()));
        }
    }
    Ok(files)
}

/// What the fuzzer has said.
struct Log {
    is_success: bool,
    text: String,
}

impl Log {
    /// The number behind `name` at the beginning of a line.
    fn number(&self, name: &str) -> Option<u64> {
        self.text.lines().find_map(|line| line.strip_prefix(name)?.trim().parse().ok())
    }

    /// The word behind `name` in the last line that has both.
    fn last_in_line(&self, name: &str) -> Option<&str> {
        let words = |line: &'_ str| line.split_whitespace().any(|word| word == name);
        let line = self.text.lines().rev().find(|line| line.starts_with('#') && words(line))?;
        line.split_whitespace().skip_while(|word| *word != name).nth(1)
    }

    /// Returns at most this many lines, starting with the last one that contains `word`; without one, the last lines.
    fn tail(&self, word: &str, lines: usize) -> String {
        let all: Vec<_> = self.text.lines().collect();
        let at = all.iter().rposition(|line| line.contains(word)).unwrap_or(all.len().saturating_sub(lines));
        all.iter().skip(at).take(lines).copied().collect::<Vec<_>>().join("\n")
    }
}

#[cfg(test)]
mod tests {
    use super::Log;

    /// As libFuzzer writes it.
    #[test]
    fn figures_are_read() {
        let text = "INFO: seed corpus: files: 70\n\
            #77\tINITED cov: 400 ft: 900 corp: 60/10Kb exec/s: 0 rss: 40Mb\n\
            #512000\tDONE   cov: 455 ft: 1203 corp: 99/17Kb lim: 1024 exec/s: 8533 rss: 55Mb\n\
            Done 512000 runs in 61 second(s)\n\
            stat::number_of_executed_units: 512000\n";
        let log = Log { is_success: true, text: text.to_owned() };
        assert_eq!(log.number("stat::number_of_executed_units:"), Some(512_000));
        assert_eq!(log.number("stat::slowest_unit_time_sec:"), None);
        assert_eq!((log.last_in_line("cov:"), log.last_in_line("corp:")), (Some("455"), Some("99/17Kb")));
        assert_eq!(log.tail("Done", 1), "Done 512000 runs in 61 second(s)");
    }
}
