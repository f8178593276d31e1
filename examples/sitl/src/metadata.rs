//! The descriptions of the parameters and events, which the vehicle serves as files, are those of their declarations (O-1, EVT-8).

use mavstack::metadata::{self, MetadataFile};
use mavstack_demo::events::DemoEvents;
use mavstack_demo::{Tuning, files};

/// Makes the files from the table and the events.
fn make() -> [String; 3] {
    let (mut parameters, mut events, mut general) = (String::new(), String::new(), String::new());
    metadata::parameters::<Tuning>(&mut parameters).expect("a string takes all");
    metadata::events::<DemoEvents>(&mut events).expect("a string takes all");
    let crc = |file: &str| metadata::file_crc(file.as_bytes());
    let named = [
        MetadataFile::parameters(files::PARAMETERS_URI, crc(&parameters)),
        MetadataFile::events(files::EVENTS_URI, crc(&events)),
    ];
    metadata::general(&mut general, &named).expect("a string takes all");
    [general, parameters, events]
}

/// O-1, EVT-1, EVT-8. With `UPDATE_METADATA=1` it writes the files instead: after a change of the demo's parameters or events.
#[test]
fn files_are_those_of_the_table() {
    for (file, made) in [files::GENERAL, files::PARAMETERS, files::EVENTS].iter().zip(make()) {
        let path = format!("{}/../demo/metadata/{}", env!("CARGO_MANIFEST_DIR"), file.path());
        if std::env::var_os("UPDATE_METADATA").is_some() {
            std::fs::write(&path, &made).expect("the file can be written");
            continue;
        }
        assert!(
            file.bytes() == made.as_bytes(),
            "{path} is not what the declarations say: run `UPDATE_METADATA=1 cargo test -p mavstack-sitl metadata`"
        );
    }
}
