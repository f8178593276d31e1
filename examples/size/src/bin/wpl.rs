//! Plans as text: a file comes in, and goes out again item by item.
#![no_std]
#![no_main]

use embedded_io::{Read, ReadReady, Write};
use mavstack::wpl::{HomeRow, Reader, Writer};
use mavstack_size::Uart;

fn send(uart: &mut Uart, mut bytes: &[u8]) {
    while !bytes.is_empty() {
        let sent = uart.write(bytes).unwrap_or(0);
        bytes = bytes.get(sent..).unwrap_or_default();
    }
}

#[cortex_m_rt::entry]
fn main() -> ! {
    // Statics, so that their RAM is counted.
    static mut READER: Reader = Reader::new(HomeRow::First);
    static mut WRITER: Writer = Writer::new(HomeRow::None);

    let mut uart = Uart;
    let mut block = [0; 64];
    send(&mut uart, Writer::HEADER);
    loop {
        if uart.read_ready() == Ok(true) {
            let len = uart.read(&mut block).unwrap_or(0);
            let mut bytes = block.get(..len).unwrap_or_default();
            if len == 0 {
                // Stands in for the end of the file.
                let _ = READER.finish();
            }
            while let Ok(Some(item)) = READER.next(&mut bytes) {
                if let Ok(line) = WRITER.row(&item) {
                    send(&mut uart, line);
                }
            }
        }
    }
}
