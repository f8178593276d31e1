//! The demo vehicle in a loop of its own, without a framework.
//!
//! ```text
//!   ┌─▶ control ─▶ serve, link by link ─▶ persist ─▶ sleep, until a byte or for 1 ms ─┐
//!   │      └▶ pulse                                                                   │
//!   └─────────────────────────────────────────────────────────────────────────────────┘
//! ```
//!
//! Every call is bounded and none waits: so is, and does, the loop. When flight hangs in it, everything is silent.
#![no_std]
#![no_main]

use core::mem::MaybeUninit;

use cortex_m_rt::entry;
use mavstack::LinkId;
use mavstack_qemu::board::{self, Board};
use mavstack_qemu::memory::{self, DemoApp, Memory};
use mavstack_qemu::polled::{Bed, Polled};

#[entry]
fn main() -> ! {
    static mut APP: MaybeUninit<DemoApp> = MaybeUninit::uninit();

    let app = memory::make(APP);
    let (Some(core), Some(board)) = (cortex_m::Peripherals::take(), Board::take()) else { Board::reset() };
    let mut bed = Bed::make(core.SYST);
    let mut uarts = board.uarts.map(Polled::new);
    let mut memory = Memory::new(board.flash);
    memory.restore(app, board::now());
    loop {
        let now = board::now();
        app.control(now);
        while app.hangs() {}
        let mut is_busy = false;
        for (link, uart) in (0..).map(LinkId).zip(&mut uarts) {
            // The stack counts errors and goes on: what was lost in an overrun, checksums find.
            let _ = app.serve(now, link, uart);
            is_busy |= uart.has_received();
        }
        is_busy |= memory.persist(app, now);
        if app.wants_reboot() {
            Board::reset();
        }
        if !is_busy {
            bed.sleep(&mut uarts);
        }
    }
}
