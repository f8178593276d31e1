//! The descriptions of the parameters and events, which the vehicle serves as files, are those of their declarations (O-1, EVT-8).

use mavstack::metadata::{self, MetadataFile};
use mavstack_demo::events::DemoEvents;
use mavstack_demo::{Tuning, files};

/// O-1, EVT-1, EVT-8. With `UPDATE_METADATA=1` it writes the files instead: after a change of the demo's parameters or events.
#[test]
fn descriptions_are_those_of_the_declarations() {
    let (mut parameters, mut events) = (String::new(), String::new());
    metadata::parameters::<Tuning>(&mut parameters).expect("a string takes all");
    metadata::events::<DemoEvents>(&mut events).expect("a string takes all");
    for (name, made) in [("parameters.json", parameters), ("events.json", events)] {
        let path = format!("{}/../demo/metadata/{name}", env!("CARGO_MANIFEST_DIR"));
        if std::env::var_os("UPDATE_METADATA").is_some() {
            std::fs::write(&path, &made).expect("the file can be written");
            continue;
        }
        assert!(
            std::fs::read_to_string(&path).is_ok_and(|file| file == made),
            "{path} is not what the declarations say: run `UPDATE_METADATA=1 cargo test -p mavstack-sitl metadata`"
        );
    }
}

/// O-1: the file that the build script makes names the others, with their checksums.
#[test]
fn general_file_names_the_served_files() {
    let crc = metadata::file_crc;
    let named = [
        MetadataFile::parameters(files::PARAMETERS_URI, crc(files::PARAMETERS.bytes())),
        MetadataFile::events(files::EVENTS_URI, crc(files::EVENTS.bytes())),
    ];
    let mut general = String::new();
    metadata::general(&mut general, &named).expect("a string takes all");
    assert_eq!(std::str::from_utf8(files::GENERAL.bytes()), Ok(&general[..]));
}
