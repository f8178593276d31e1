//! The demo vehicle as firmware, for QEMU's board mps2-an386. `cargo qemu` builds and runs it.
#![no_std]
#![no_main]

mod board;
#[cfg(feature = "defmt")]
mod log;

use core::mem::MaybeUninit;

use board::Board;
use cortex_m_rt::entry;
use mavstack::{LinkId, plan_memory};
use mavstack_demo::App;

/// What a microcontroller can afford: 32 bytes an item, and room for the largest plan once more, for uploads.
type DemoPlans = plan_memory!(mission: 250, fence: 64, rally: 16);

#[entry]
fn main() -> ! {
    // Not on the stack: it is larger than that should be. And not made by the compiler: its initial value, plan memory
    // and all, would lie in flash.
    static mut APP: MaybeUninit<App<DemoPlans>> = MaybeUninit::uninit();

    let app = APP.write(App::new());
    let Some(mut board) = Board::take() else { unreachable!("the entry point is entered once") };
    #[cfg(feature = "defmt")]
    log::begin();
    loop {
        let now = board.clock.now();
        #[cfg(feature = "defmt")]
        log::set_time(now);
        app.control(now);
        let mut is_busy = false;
        for (link, uart) in (0..).map(LinkId).zip(&mut board.uarts) {
            // The stack counts errors and goes on: what was lost in an overrun, checksums find.
            let _ = app.serve(now, link, uart);
            is_busy |= uart.has_received();
        }
        if !is_busy {
            board.sleep();
        }
    }
}

/// Without a log there is nobody to tell. A real vehicle would cut its motors here and reset.
#[cfg(not(feature = "defmt"))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {
        cortex_m::asm::wfi();
    }
}
