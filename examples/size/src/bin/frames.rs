//! Frames and messages only: receives 12 message types, reads every field of each, and sends 8 types.
#![no_std]
#![no_main]

#[path = "../twelve.rs"]
mod twelve;

use embedded_io::{Read, ReadReady, Write};
use mavstack::frame::{Decoder, Version, encode};
use mavstack::message::Dialect;
use mavstack::{Address, Instant, Message};
use mavstack_size::{Place, Uart, entry, now_micros};
use twelve::{Twelve, handle};

struct Tx {
    uart: Uart,
    seq: u8,
    frame: [u8; 280],
}

impl Tx {
    fn send<M: Message>(&mut self, message: &M) {
        let len = encode(message, Version::V2, Address::new(1, 1), self.seq, &mut self.frame).unwrap_or(0);
        self.flush(len);
    }

    fn flush(&mut self, len: usize) {
        self.seq = self.seq.wrapping_add(1);
        let mut rest = self.frame.get(..len).unwrap_or_default();
        while !rest.is_empty() {
            let sent = self.uart.write(rest).unwrap_or(0);
            rest = rest.get(sent..).unwrap_or_default();
        }
    }
}

#[entry]
fn main() -> ! {
    static TX: Place<Tx> = Place::new();
    static DECODER: Place<Decoder> = Place::new();

    let mut uart = Uart;
    let tx = TX.put(Tx { uart: Uart, seq: 0, frame: [0; 280] });
    let decoder = DECODER.put(Decoder::default());
    loop {
        let now = Instant::from_micros(now_micros());
        if uart.read_ready() == Ok(true) {
            let len = uart.read(decoder.spare()).unwrap_or(0);
            decoder.filled(len, now);
        }
        let mut budget = Decoder::MIN_BUDGET;
        while let Some(frame) = decoder.next(now, Twelve::MESSAGES, &mut budget, |_| false) {
            handle(&frame, tx);
        }
    }
}
