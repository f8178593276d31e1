//! `cargo xtask compare`: other MAVLink libraries beside this one, on the same frames.
//!
//! What is measured is in `benches/compare`, a workspace of its own. Each library has its own program; they run in turns, so
//! that whatever else the machine does falls on all of them, and medians are compared. The C library is generated and compiled
//! here; nothing of it is kept.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::system::{Result, apt_install, cargo, has, root, run, target_dir};
use crate::toolchain::{self, Choice, TARGET};
use crate::{compare_firmware, integration};

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

/// What the tables begin with, and how wide their columns are.
const LABEL: usize = 36;
const COLUMN: usize = 16;

/// Runs all, prints the tables, and fails where another library is ahead.
pub fn run_all(rounds: u16, choice: Option<Choice>) -> Result {
    let folder = target_dir().join("compare");
    make_folder(&folder)?;
    let library = compile_c(&folder)?;
    let programs = PEERS.iter().map(|peer| build(peer, &folder, &library)).collect::<Result<Vec<_>>>()?;
    if !has("valgrind") {
        apt_install("valgrind", &["valgrind"], "https://valgrind.org")?;
    }
    let streams = build_program("streams", None, &folder, &library)?;
    run(Command::new(streams).arg(&folder))?;

    let mut behind = Vec::new();
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
    println!("\nMedian of {rounds} rounds, ns of processor time a frame; and how often ours goes into it");
    header(&columns);
    for (work, what) in WORKS {
        let row: Vec<_> = times.iter_mut().map(|times| median(times.entry(work.to_owned()).or_default())).collect();
        print_row(what, &row, "ns a frame", &mut behind);
    }

    println!("\nInstructions a byte, x86-64 by callgrind; and the same ratio");
    header(&columns);
    let bytes = std::fs::metadata(folder.join("frames.bin")).map_err(|error| format!("frames.bin: {error}"))?.len();
    for (work, what) in WORKS.into_iter().filter(|(work, _)| COUNTED.contains(work)) {
        let row =
            programs.iter().map(|program| instructions(program, &folder, work, bytes)).collect::<Result<Vec<_>>>()?;
        print_row(what, &row, "instructions", &mut behind);
    }

    println!("\nRecovery: of 20,000 frames on a bad line, intact ones that are found, and false accepts");
    header(&columns);
    recovery(&programs, &folder, &mut behind)?;

    println!(
        "\nFirmware, Cortex-M4F, 12 messages in and 8 out, less one that only reads; and how often ours goes into it"
    );
    let choice = toolchain::prepare(choice, &[TARGET])?;
    compare_firmware::measure(choice, &folder, &library, &folder.join("twelve.bin"), &mut behind)?;
    if behind.is_empty() { Ok(()) } else { Err(format!("not ahead of every library: {}", behind.join("; "))) }
}

fn make_folder(folder: &Path) -> Result {
    std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))
}

/// Generates the C library from our own definitions and returns the folder of the compiled archive.
fn compile_c(folder: &Path) -> Result<PathBuf> {
    let python = integration::environment()?;
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

/// Ours, then each other's with how many times ours it is. An equal one is not behind us.
fn print_row(what: &str, row: &[f64], unit: &str, behind: &mut Vec<String>) {
    let [ours, others @ ..] = row else { return };
    print!("{what:LABEL$}{ours:>COLUMN$.1}");
    for (other, peer) in others.iter().zip(&PEERS[1..]) {
        print!("{:>COLUMN$}", format!("{other:.1} = {:.2}x", other / ours));
        if !ahead(*ours, *other, 1.0) {
            behind.push(format!("{what}, {}: {other:.1} {unit} against our {ours:.1}", peer.name));
        }
    }
    println!();
}

/// Whether another's number is more than `times` ours; never of what is no number, or none that can be measured.
pub fn ahead(ours: f64, other: f64, times: f64) -> bool {
    ours > 0.0 && other > ours * times
}

/// Those of one pass, without what comes before the first: a run with a pass less one without.
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

/// Ours must find all and accept nothing false.
fn recovery(programs: &[PathBuf], folder: &Path, behind: &mut Vec<String>) -> Result {
    let outputs = programs
        .iter()
        .map(|program| output(Command::new(program).arg(folder).arg("recover")))
        .collect::<Result<Vec<_>>>()?;
    let Some(ours) = outputs.first().filter(|ours| ours.lines().count() == DAMAGED) else {
        return Err(format!("of {DAMAGED} damaged streams ours has read {:?}", outputs.first()));
    };
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
            print!("{:>COLUMN$}", format!("{:.2} %, {false_accepts}", f64::from(found) * 100.0 / f64::from(intact)));
            if peer.feature.is_none() && (intact == 0 || found != intact || false_accepts > 0) {
                behind.push(format!("{}: {found} of {intact} found, {false_accepts} false", damage(name)));
            }
        }
        println!();
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
