//! The firmware's log: defmt's frames, decoded with the strings that are in its ELF file.

use std::io::{IsTerminal, Read, Write};

use defmt_decoder::{DecodeError, Table};

use crate::system::Result;

/// The strings of a firmware.
pub fn table(elf: &[u8]) -> Result<Table> {
    Table::parse(elf)
        .map_err(|error| format!("the firmware's log cannot be read: {error}"))?
        .ok_or_else(|| "the firmware has no log".to_owned())
}

/// Writes the log that `input` gives to `out` until its end.
pub fn print(table: &Table, mut input: impl Read, mut out: impl Write) {
    let colored = std::io::stdout().is_terminal();
    let mut decoder = table.new_stream_decoder();
    let mut bytes = [0; 1024];
    while let Ok(len @ 1..) = input.read(&mut bytes) {
        decoder.received(&bytes[..len]);
        loop {
            // Nobody reads it any more: no reason to stop the vehicle.
            let _ = match decoder.decode() {
                Ok(frame) => writeln!(out, "{}", frame.display(colored)),
                Err(DecodeError::UnexpectedEof) => break,
                // The stream decoder goes on behind it.
                Err(DecodeError::Malformed) => writeln!(out, "(a line of the log was damaged)"),
            };
        }
    }
}
