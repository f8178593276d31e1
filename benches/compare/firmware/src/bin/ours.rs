//! mavstack: receives 12 message types, reads every field of each, and sends 8 types.
#![no_std]
#![no_main]

#[path = "../../../../../examples/size/src/twelve.rs"]
mod twelve;

use core::hint::black_box;
use core::mem::MaybeUninit;

use mavstack::frame::{Decoder, Version, encode};
use mavstack::message::Dialect;
use mavstack::{Address, Instant, Message};
use mavstack_compare_firmware::{Uart, measure};
use twelve::{Twelve, handle};

struct Tx {
    seq: u8,
    frame: [u8; 280],
}

impl Tx {
    fn send<M: Message>(&mut self, message: &M) {
        let len = encode(message, Version::V2, Address::new(1, 1), self.seq, &mut self.frame).unwrap_or(0);
        self.seq = self.seq.wrapping_add(1);
        Uart::send(self.frame.get(..len).unwrap_or_default());
    }
}

static mut TX: Tx = Tx { seq: 0, frame: [0; 280] };
static mut DECODER: MaybeUninit<Decoder> = MaybeUninit::uninit();

fn app(mut uart: Uart) -> u32 {
    // SAFETY: only this function uses them, and it is not reentered.
    let (tx, decoder) = unsafe { (&mut *(&raw mut TX), (*(&raw mut DECODER)).write(Decoder::default())) };
    let mut frames = 0;
    loop {
        let len = uart.take(decoder.spare());
        if len == 0 {
            return frames;
        }
        decoder.filled(len, Instant::ZERO);
        let mut budget = Decoder::MIN_BUDGET;
        while let Some(frame) = decoder.next(Instant::ZERO, Twelve::MESSAGES, &mut budget, |_| false) {
            frames += 1;
            if cfg!(feature = "framing") {
                black_box(frame.raw());
            } else {
                handle(&frame, tx);
            }
        }
    }
}

#[cortex_m_rt::entry]
fn main() -> ! {
    measure(app)
}
