//! The description of the parameters, which the vehicle serves as files, is the one of its table (O-1).

use mavstack::metadata;
use mavstack_demo::{Tuning, files};

/// Makes the two files from the table.
fn make() -> [String; 2] {
    let (mut parameters, mut general) = (String::new(), String::new());
    metadata::parameters::<Tuning>(&mut parameters).expect("a string takes all");
    let crc = metadata::file_crc(parameters.as_bytes());
    metadata::general(&mut general, files::PARAMETERS_URI, crc).expect("a string takes all");
    [general, parameters]
}

/// O-1. With `UPDATE_METADATA=1` it writes the files instead: after a change of the demo's parameters.
#[test]
fn files_are_those_of_the_table() {
    for (file, made) in [files::GENERAL, files::PARAMETERS].iter().zip(make()) {
        let path = format!("{}/../demo/metadata/{}", env!("CARGO_MANIFEST_DIR"), file.path());
        if std::env::var_os("UPDATE_METADATA").is_some() {
            std::fs::write(&path, &made).expect("the file can be written");
            continue;
        }
        assert!(
            file.bytes() == made.as_bytes(),
            "{path} is not the description of the parameters: run `UPDATE_METADATA=1 cargo test -p mavstack-sitl metadata`"
        );
    }
}
