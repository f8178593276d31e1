//! `mavstack-dialect`: generates a Rust module from a MAVLink definition.

use clap::Parser;
use mavstack_dialect::{Error, Options, export, generate, is_current, load, write};
use std::{fs, path::PathBuf, process::ExitCode};

/// Generates Rust declarations for mavstack from a MAVLink definition and its includes.
///
/// On an error, the output is not changed, and the exit code is 1.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    /// The definition, in MAVLink's XML schema; with --export, the Rust file
    input: PathBuf,
    /// The Rust file to write; with --export, the definition
    output: PathBuf,
    /// Write a definition of the messages and commands that a Rust file declares by `message!` and `command!`
    #[arg(long, conflicts_with_all = ["only", "only_from", "name", "beside_common", "include_dir"])]
    export: bool,
    /// Generate only the messages, enums and typed commands with these MAVLink names, and the enums of their fields
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    only: Vec<String>,
    /// Like --only, with names from a file: one per line, `#` begins a comment
    #[arg(long, value_name = "FILE")]
    only_from: Option<PathBuf>,
    /// Name of the struct that lists the messages; by default that of the input file
    #[arg(long)]
    name: Option<String>,
    /// Leave out what `mavstack::dialect` has already, and use its types
    #[arg(long)]
    beside_common: bool,
    /// A directory to search for included files
    #[arg(short = 'I', long, value_name = "DIR")]
    include_dir: Vec<PathBuf>,
    /// Path of the crate with the macros
    #[arg(long, value_name = "PATH", default_value = "mavstack")]
    crate_path: String,
    /// Write nothing; exit with code 1 if the output is not up to date
    #[arg(long)]
    check: bool,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<(), Error> {
    let text = if arguments.export { export(&arguments.input)? } else { generated(arguments)? };
    if !arguments.check {
        return write(&arguments.output, &text);
    }
    if is_current(&arguments.output, &text) {
        return Ok(());
    }
    let input = if arguments.export { "declarations" } else { "definition" };
    Err(about(&arguments.output, format!("is not up to date with the {input}; generate it again")))
}

fn generated(arguments: &Arguments) -> Result<String, Error> {
    let mut options = Options::for_file(&arguments.input);
    options.crate_path.clone_from(&arguments.crate_path);
    options.beside_common = arguments.beside_common;
    if let Some(name) = &arguments.name {
        options.name.clone_from(name);
    }
    let mut only = arguments.only.clone();
    if let Some(file) = &arguments.only_from {
        let text = fs::read_to_string(file).map_err(|error| about(file, format!("cannot be read: {error}")))?;
        let lines = text.lines().map(|line| line.split('#').next().unwrap_or_default().trim());
        only.extend(lines.filter(|name| !name.is_empty()).map(str::to_owned));
    }
    if arguments.only_from.is_some() || !only.is_empty() {
        options.only = Some(only);
    }
    generate(&load(&arguments.input, &arguments.include_dir)?, &options)
}

fn about(file: &std::path::Path, problem: String) -> Error {
    Error { file: file.into(), line: None, element: "the file".into(), problem }
}
