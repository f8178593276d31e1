//! The firmware's log: defmt's frames, decoded with the strings that are in its ELF file.

use std::io::{IsTerminal, Read};

use defmt_decoder::{DecodeError, Table};
use mavstack_demo::Status;

use crate::system::Result;

/// The strings of a firmware.
pub fn table(elf: &[u8]) -> Result<Table> {
    Table::parse(elf)
        .map_err(|error| format!("the firmware's log cannot be read: {error}"))?
        .ok_or_else(|| "the firmware has no log".to_owned())
}

/// Hands over the log that `input` gives until its end: the lines to `print`, what the vehicle says of its status to `show`.
pub fn read(table: &Table, mut input: impl Read, mut print: impl FnMut(String), mut show: impl FnMut(Status)) {
    let colored = std::io::stdout().is_terminal();
    let mut decoder = table.new_stream_decoder();
    let mut bytes = [0; 1024];
    while let Ok(len @ 1..) = input.read(&mut bytes) {
        decoder.received(&bytes[..len]);
        loop {
            match decoder.decode() {
                Ok(frame) => match Status::from_log(&frame.display_message().to_string()) {
                    Some(status) => show(status),
                    None => print(frame.display(colored).to_string()),
                },
                Err(DecodeError::UnexpectedEof) => break,
                // The stream decoder continues after it.
                Err(DecodeError::Malformed) => print("(a line of the log was damaged)".to_owned()),
            }
        }
    }
}
