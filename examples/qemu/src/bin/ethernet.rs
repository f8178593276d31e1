//! The demo vehicle on a network, in a plain main loop: telemetry over UDP on Ethernet, the other two links on UARTs.
//!
//! ```text
//!   ┌─▶ control ─▶ serve: stations, other links ─▶ persist ─▶ sleep until a byte, a frame or for 1 ms ─┐
//!   │      └▶ pulse                                                                                    │
//!   └──────────────────────────────────────────────────────────────────────────────────────────────────┘
//! ```
//!
//! It is `loop.rs` with a network. Each ground station that sends to UDP port 14550 has a link of its own, up to four.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use mavstack_demo::{COMPANION, SATELLITE};
use mavstack_qemu::board::{self, Board};
use mavstack_qemu::memory::{self, FlashStore};
use mavstack_qemu::network::Network;
use mavstack_qemu::polled::{Polled, Sleep};

#[entry]
fn main() -> ! {
    let app = memory::start();
    let (Some(core), Some(board)) = (cortex_m::Peripherals::take(), Board::take()) else { Board::reset() };
    let mut sleep = Sleep::new(core.SYST);
    let Some(network) = Network::start(board.ethernet, board::now()) else { Board::reset() };
    let [_, companion, satellite] = board.uarts;
    let mut uarts = [companion, satellite].map(Polled::new);
    let mut store = FlashStore::new(board.flash);
    store.restore(app, board::now());
    loop {
        let now = board::now();
        app.control(now);
        while app.simulates_hang() {}
        let mut is_busy = network.serve(app, now);
        for (link, uart) in [COMPANION, SATELLITE].into_iter().zip(&mut uarts) {
            // The stack counts errors and continues. Checksums detect bytes lost in an overrun.
            let _ = app.serve(now, link, uart);
            is_busy |= uart.has_received();
        }
        is_busy |= store.persist(app, now);
        if app.wants_reboot() {
            Board::reset();
        }
        if !is_busy {
            sleep.until_event(&mut uarts);
        }
    }
}
