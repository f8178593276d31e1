//! The demo vehicle in a plain main loop, without a framework.
//!
//! ```text
//!   ┌─▶ control ─▶ serve, link by link ─▶ persist ─▶ sleep until a byte or for 1 ms ─┐
//!   │      └▶ pulse                                                                  │
//!   └────────────────────────────────────────────────────────────────────────────────┘
//! ```
//!
//! Every call is bounded and none blocks, and so the loop is bounded and never blocks. When flight hangs, the vehicle is silent.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use mavstack::LinkId;
use mavstack_qemu::board::{self, Board};
use mavstack_qemu::memory::{self, FlashStore};
use mavstack_qemu::polled::{Polled, Sleep};

#[entry]
fn main() -> ! {
    let app = memory::start();
    let (Some(core), Some(board)) = (cortex_m::Peripherals::take(), Board::take()) else { Board::reset() };
    let mut sleep = Sleep::new(core.SYST);
    let mut uarts = board.uarts.map(Polled::new);
    let mut store = FlashStore::new(board.flash);
    store.restore(app, board::now());
    loop {
        let now = board::now();
        app.control(now);
        while app.simulates_hang() {}
        let mut is_busy = false;
        for (link, uart) in (0..).map(LinkId).zip(&mut uarts) {
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
