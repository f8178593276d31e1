//! `cargo measure compare`: other MAVLink libraries beside this one, on the same frames.
//!
//! The measured programs are in `benches/compare`, a workspace of its own: one for each library. They run in turns, so that other load
//! on the machine affects all of them, and medians are compared. The C library is generated and compiled here; none of it is checked
//! in.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::figures::{Figure, settle};
use crate::system::{Result, apt_install, cargo, has, root, run, target_dir};
use crate::toolchain::{self, Choice, TARGET};
use crate::{compare_firmware, python};

/// A library's name, the program that measures it, and the feature of `benches/compare` that it is built with.
struct Peer {
    name: &'static str,
    program: &'static str,
    feature: Option<&'static str>,
}

/// The first is ours.
const PEERS: [Peer; 5] = [
    Peer { name: "mavstack", program: "ours", feature: None },
    Peer { name: "mavlink no_std", program: "mavlink", feature: Some("mavlink-no-std") },
    Peer { name: "mavlink std", program: "mavlink", feature: Some("mavlink-std") },
    Peer { name: "mavio", program: "mavio", feature: Some("mavio") },
    Peer { name: "C -O2", program: "c", feature: Some("c") },
];

/// Returns `name` as a part of a figure's key.
pub fn slug(name: &str) -> String {
    name.to_lowercase().split([' ', '-', '_']).filter(|word| !word.is_empty()).collect::<Vec<_>>().join("-")
}

/// The works of `benches/compare/src/lib.rs`, and what the tables call them.
const WORKS: [(&str, &str); 5] = [
    ("whole", "framing + checksum, whole buffer"),
    ("16", "the same in pieces of 16 bytes"),
    ("1", "the same byte by byte"),
    ("decode", "framing + decode, every field read"),
    ("encode", "encode"),
];
/// Those whose instructions are counted.
const COUNTED: [&str; 3] = ["whole", "decode", "encode"];

/// How many percent a figure of ours may differ from the accepted one. Times depend on the machine, and may differ by any amount.
pub const TOLERANCE: f64 = 3.0;

/// The results of all comparisons.
#[derive(Default)]
pub struct Results {
    pub figures: Vec<Figure>,
    /// Where another library is ahead.
    pub behind: Vec<String>,
}

impl Results {
    /// Adds the least and the greatest of these numbers as figures.
    pub fn add_range(&mut self, key: &str, numbers: impl Iterator<Item = f64>) {
        let none = (f64::INFINITY, f64::NEG_INFINITY);
        let (least, most) = numbers.fold(none, |(least, most), number| (least.min(number), most.max(number)));
        for (end, number) in [("least", least), ("most", most)] {
            self.figures.push(Figure::new(format!("{key}.{end}"), format!("{number:.1}")));
        }
    }
}

/// The widths of the first column and of the others.
const LABEL: usize = 36;
const COLUMN: usize = 16;

/// Runs all, prints the tables, and fails where another library is ahead.
pub fn run_all(rounds: u16, choice: Option<Choice>, accepts: bool) -> Result {
    let folder = target_dir().join("compare");
    make_folder(&folder)?;
    let library = compile_c(&folder)?;
    let programs = PEERS.iter().map(|peer| build(peer, &folder, &library)).collect::<Result<Vec<_>>>()?;
    if !has("valgrind") {
        apt_install("valgrind", &["valgrind"], "https://valgrind.org")?;
    }
    let streams = build_program("streams", None, &folder, &library)?;
    run(Command::new(streams).arg(&folder))?;

    let mut results = Results::default();
    let columns: Vec<_> = PEERS.iter().map(|peer| peer.name).collect();

    let mut times = vec![BTreeMap::<String, Vec<f64>>::new(); programs.len()];
    for round in 1..=rounds {
        eprintln!("Round {round} of {rounds}");
        for (program, times) in programs.iter().zip(&mut times) {
            for line in output(Command::new(program).arg(&folder).arg("time"))?.lines() {
                if let Some((work, Ok(ns))) = line.split_once(' ').map(|(work, ns)| (work, ns.parse())) {
                    times.entry(work.to_owned()).or_default().push(ns);
                }
            }
        }
    }
    println!("\nProcessor time, ns a frame, median of {rounds} rounds; and as a multiple of ours");
    header(&columns);
    let mut multiples = Vec::new();
    for (work, what) in WORKS {
        let row: Vec<_> = times.iter_mut().map(|times| median(times.entry(work.to_owned()).or_default())).collect();
        multiples.push(print_row(what, &format!("ns.{work}"), &row, "ns a frame", &mut results));
    }
    for library in ["mavlink", "mavio", "c"] {
        let of_library = |row| PEERS[1..].iter().zip(row).filter(|(peer, _)| peer.program == library);
        let numbers = multiples.iter().flat_map(of_library).map(|(_, number): (_, &f64)| *number);
        results.add_range(&format!("times.ns.{library}"), numbers);
    }

    println!("\nInstructions a byte, on x86-64 by callgrind; and as a multiple of ours");
    header(&columns);
    let bytes = std::fs::metadata(folder.join("frames.bin")).map_err(|error| format!("frames.bin: {error}"))?.len();
    for (work, what) in WORKS.into_iter().filter(|(work, _)| COUNTED.contains(work)) {
        let row =
            programs.iter().map(|program| instructions(program, &folder, work, bytes)).collect::<Result<Vec<_>>>()?;
        print_row(what, &format!("instructions.{work}"), &row, "instructions", &mut results);
    }

    println!("\nRecovery: of 20,000 frames on a bad line, the share of intact ones that are found, and false accepts");
    header(&columns);
    recovery(&programs, &folder, &mut results)?;

    println!("\nFirmware, Cortex-M4F, 12 messages in and 8 out, less one that only reads; and as a multiple of ours");
    let choice = toolchain::prepare(choice, &[TARGET])?;
    compare_firmware::measure(choice, &folder, &library, &folder.join("twelve.bin"), &mut results)?;
    let Results { figures, behind } = results;
    if !behind.is_empty() {
        return Err(format!("not ahead of every library: {}", behind.join("; ")));
    }
    settle("compare", &toolchain::release(choice), &figures, accepts)
}

fn make_folder(folder: &Path) -> Result {
    std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))
}

/// Generates the C library from our own definitions and returns the folder of the compiled archive.
fn compile_c(folder: &Path) -> Result<PathBuf> {
    let python = python::environment()?;
    if !has("cc") || !has("ar") {
        apt_install("a C compiler", &["gcc", "libc6-dev", "binutils"], "https://gcc.gnu.org")?;
    }
    let library = folder.join("mavgen");
    make_folder(&library)?;
    let headers = library.join("headers");
    let mut mavgen = Command::new(python);
    mavgen.args(["-m", "pymavlink.tools.mavgen", "--lang", "C", "--wire-protocol", "2.0", "--output"]).arg(&headers);
    output(mavgen.arg(root().join("dialect/definitions/common.xml")))?;
    let object = library.join("compare.o");
    // Without warnings: they are about the generated headers.
    let mut cc = Command::new("cc");
    cc.args(["-std=gnu11", "-O2", "-w", "-c", "-I"]).arg(&headers).arg("-o").arg(&object);
    run(cc.arg(root().join("benches/compare/c/compare.c")))?;
    run(Command::new("ar").arg("rcs").arg(library.join("libcompare.a")).arg(&object))?;
    Ok(library)
}

fn build(peer: &Peer, folder: &Path, library: &Path) -> Result<PathBuf> {
    let built = build_program(peer.program, peer.feature, folder, library)?;
    // The next one may be built under the same name.
    let program = folder.join(peer.feature.unwrap_or(peer.program));
    std::fs::copy(&built, &program).map_err(|error| format!("{}: {error}", built.display()))?;
    Ok(program)
}

fn build_program(name: &str, feature: Option<&str>, folder: &Path, library: &Path) -> Result<PathBuf> {
    let build_dir = folder.join("build");
    let mut command = Command::new(cargo());
    command
        .args(["build", "--release", "--locked", "--bin", name])
        .args(feature.iter().flat_map(|feature| ["--features", feature]))
        .arg("--target-dir")
        .arg(&build_dir)
        .env("COMPARE_C_LIBRARY", library)
        .current_dir(root().join("benches/compare"));
    run(&mut command)?;
    Ok(build_dir.join("release").join(name))
}

/// What it prints; an error with its own words when it fails.
fn output(command: &mut Command) -> Result<String> {
    let name = command.get_program().to_string_lossy().into_owned();
    let output = command.output().map_err(|error| format!("{name} could not be started: {error}"))?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    Err(format!("{name} failed ({}):\n{}", output.status, String::from_utf8_lossy(&output.stderr)))
}

fn median(numbers: &mut [f64]) -> f64 {
    numbers.sort_unstable_by(f64::total_cmp);
    numbers.get(numbers.len() / 2).copied().unwrap_or(f64::NAN)
}

fn header(columns: &[&str]) {
    print!("{:LABEL$}", "");
    columns.iter().for_each(|column| print!("{column:>COLUMN$}"));
    println!();
}

/// Prints our number, then each other's with its multiple of ours, and returns these multiples. An equal one is not behind.
fn print_row(what: &str, key: &str, row: &[f64], unit: &str, results: &mut Results) -> Vec<f64> {
    let [ours, others @ ..] = row else { return Vec::new() };
    print!("{what:LABEL$}{ours:>COLUMN$.1}");
    let own = Figure::new(key, format!("{ours:.1}"));
    results.figures.push(if unit.starts_with("ns") { own } else { own.within(TOLERANCE) });
    for (other, peer) in others.iter().zip(&PEERS[1..]) {
        print!("{:>COLUMN$}", format!("{other:.1} = {:.2}x", other / ours));
        if !ahead(*ours, *other, 1.0) {
            results.behind.push(format!("{what}, {}: {other:.1} {unit} against our {ours:.1}", peer.name));
        }
    }
    println!();
    others.iter().map(|other| other / ours).collect()
}

/// Returns whether another's number is more than `times` ours; false for what is no number, or cannot be measured.
pub fn ahead(ours: f64, other: f64, times: f64) -> bool {
    ours > 0.0 && other > ours * times
}

/// Returns the instructions of one pass, without the start of the program: those of a run with a pass, less those of one without.
fn instructions(program: &Path, folder: &Path, work: &str, bytes: u64) -> Result<f64> {
    let count = |passes: &str| {
        let mut valgrind = Command::new("valgrind");
        valgrind.args(["--tool=callgrind", "--callgrind-out-file=/dev/null"]).arg(program).arg(folder);
        let output = valgrind.args(["once", work, passes]).output().map_err(|error| format!("valgrind: {error}"))?;
        let words = String::from_utf8_lossy(&output.stderr).into_owned();
        let collected = words.lines().find_map(|line| line.split_once("Collected : "));
        collected
            .and_then(|(_, number)| number.trim().parse::<f64>().ok())
            .ok_or_else(|| format!("valgrind counted nothing:\n{words}"))
    };
    Ok((count("1")? - count("0")?) / bytes as f64)
}

/// The damaged streams of `benches/compare/src/lib.rs`.
const DAMAGED: usize = 5;

/// Prints what each library finds in the damaged streams. Ours must find all intact frames and accept no false one.
fn recovery(programs: &[PathBuf], folder: &Path, results: &mut Results) -> Result {
    let outputs = programs
        .iter()
        .map(|program| output(Command::new(program).arg(folder).arg("recover")))
        .collect::<Result<Vec<_>>>()?;
    let Some(ours) = outputs.first().filter(|ours| ours.lines().count() == DAMAGED) else {
        return Err(format!("ours did not read all {DAMAGED} damaged streams: {:?}", outputs.first()));
    };
    let mut lost = Vec::new();
    for (row, line) in ours.lines().enumerate() {
        let name = line.split(' ').next().unwrap_or_default();
        print!("{:LABEL$}", damage(name));
        for (output, peer) in outputs.iter().zip(&PEERS) {
            let cells: Vec<u32> = output
                .lines()
                .nth(row)
                .into_iter()
                .flat_map(|line| line.split(' ').skip(1))
                .flat_map(str::parse)
                .collect();
            let &[intact, found, false_accepts] = &cells[..] else { return Err(format!("{}: {output}", peer.name)) };
            let percent = f64::from(found) * 100.0 / f64::from(intact);
            print!("{:>COLUMN$}", format!("{percent:.2} %, {false_accepts}"));
            lost.push((peer.program, 100.0 - percent));
            if peer.feature.is_none() && (intact == 0 || found != intact || false_accepts > 0) {
                results.behind.push(format!("{}: {found} of {intact} found, {false_accepts} false", damage(name)));
            }
        }
        println!();
    }
    for (library, program) in [("mavstack", "ours"), ("mavlink", "mavlink"), ("mavio", "mavio"), ("c", "c")] {
        let numbers = lost.iter().filter(|(whose, _)| *whose == program).map(|(_, percent)| *percent);
        results.add_range(&format!("lost.{library}"), numbers);
    }
    Ok(())
}

fn damage(name: &str) -> &str {
    match name {
        "flips" => "bits flipped in 10 % of the frames",
        "losses" => "bytes lost from 10 %",
        "bursts" => "bursts of garbage in 10 %",
        "all" => "all three",
        "noise" => "1 % of bytes changed, garbage between",
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_keys() {
        assert_eq!(["mavlink no_std", "C -O2", "mavstack"].map(slug), ["mavlink-no-std", "c-o2", "mavstack"]);
    }
}
