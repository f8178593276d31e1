//! Plans as text: reads a file and writes it again, item by item.
#![no_std]
#![no_main]

use embedded_io::{Read, ReadReady, Write};
use mavstack::wpl::{HomeRow, Reader, Writer};
use mavstack_size::{Place, Uart, entry};

fn send(uart: &mut Uart, mut bytes: &[u8]) {
    while !bytes.is_empty() {
        let sent = uart.write(bytes).unwrap_or(0);
        bytes = bytes.get(sent..).unwrap_or_default();
    }
}

#[entry]
fn main() -> ! {
    static READER: Place<Reader> = Place::new();
    static WRITER: Place<Writer> = Place::new();

    let mut uart = Uart;
    let reader = READER.put(Reader::new(HomeRow::First));
    let writer = WRITER.put(Writer::new(HomeRow::None));
    let mut block = [0; 64];
    send(&mut uart, Writer::HEADER);
    loop {
        if uart.read_ready() == Ok(true) {
            let len = uart.read(&mut block).unwrap_or(0);
            let mut bytes = block.get(..len).unwrap_or_default();
            if len == 0 {
                // Simulates the end of the file.
                let _ = reader.finish();
            }
            while let Ok(Some(item)) = reader.next(&mut bytes) {
                if let Ok(line) = writer.row(&item) {
                    send(&mut uart, line);
                }
            }
        }
    }
}
