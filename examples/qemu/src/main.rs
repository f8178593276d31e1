//! The demo vehicle as firmware, for QEMU's board mps2-an386. `cargo qemu` builds and runs it.
#![no_std]
#![no_main]

mod board;
mod flash;
#[cfg(feature = "defmt")]
mod log;

use core::mem::MaybeUninit;

use board::Board;
use cortex_m_rt::entry;
use flash::PsramFlash;
use mavstack::{Durability, LinkId, ParamStore, ParamTable, PlanStore, SigningStore, plan_memory};
use mavstack_demo::{App, Tuning};

/// What a microcontroller can afford: 32 bytes an item, and room for the largest plan once more, for uploads.
type DemoPlans = plan_memory!(mission: MISSION, fence: FENCE, rally: RALLY);
const MISSION: usize = 250;
const FENCE: usize = 64;
const RALLY: usize = 16;

/// The plans' part of the flash: the front of it, two slots of which each holds all plans.
type Store = PlanStore<PsramFlash>;
const STORE_LEN: u32 = Store::region_len(MISSION, FENCE, RALLY);
const _: () = assert!(STORE_LEN <= PsramFlash::LEN);

/// The parameters' part of the flash.
type Settings = ParamStore<PsramFlash>;
const SETTINGS_LEN: u32 = Settings::region_len(Tuning::INFO.len());
const _: () = assert!(SETTINGS_LEN <= PsramFlash::LEN);

/// The signing key's part of the flash.
type Key = SigningStore<PsramFlash>;
const _: () = assert!(Key::REGION_LEN <= PsramFlash::LEN);

#[entry]
fn main() -> ! {
    // Not on the stack: it is larger than that should be. And not made by the compiler: its initial value, plan memory
    // and all, would lie in flash.
    static mut APP: MaybeUninit<App<DemoPlans>> = MaybeUninit::uninit();

    let app = APP.write(App::new());
    let Some((mut board, [plan_flash, settings_flash, key_flash])) = Board::take() else {
        unreachable!("the entry point is entered once")
    };
    #[cfg(feature = "defmt")]
    log::begin();
    let mut settings = Settings::new(settings_flash, 0..SETTINGS_LEN);
    let mut store = Store::new(plan_flash, 0..STORE_LEN);
    let mut key = Key::new(key_flash, 0..Key::REGION_LEN);
    // An error was told by text; the vehicle flies with the defaults, without the plans and without a key then.
    let _ = app.restore_parameters(board.clock.now(), &mut settings);
    let _ = app.restore_signing(board.clock.now(), &mut key);
    let _ = app.restore(board.clock.now(), &mut store, Durability::Durable);
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
        // The stand-in takes microseconds. Where an erase stops the processor the vehicle's `may_persist` says when.
        is_busy |= app.persist(now, &mut store);
        is_busy |= app.persist_parameters(now, &mut settings);
        is_busy |= app.persist_signing(now, &mut key);
        if app.wants_reboot() {
            Board::reset();
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
