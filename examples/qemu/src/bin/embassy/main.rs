//! The demo vehicle as Embassy tasks.
//!
//! ```text
//!   UART interrupts         ──▶ queue ──┐                                    ┌──▶ queue ──▶
//!   FLIGHT, high priority   flight, every 10 ms: fly ─▶ pulse                │
//!   COMMS, lower                        └─▶ receive ──▶ stack ──▶ transmit ──┘   two tasks per link, and exchange
//!                                              └────── wake ────────▶┘
//!   STORAGE, lowest         run the storage job that exchange has got: erase or write
//! ```
//!
//! `receive` awaits bytes. `transmit` awaits a wake-up or the link's next deadline. In between the processor sleeps. Their ends of
//! the link, [`AsyncReceiver`] and [`AsyncTransmitter`], work with any UART that implements the traits of `embedded-io-async` and
//! splits into two halves.
//!
//! Flight and comms share the vehicle and its stack behind an async mutex. A critical section would delay the UART interrupts.
//! Comms locks for one bounded call at a time, so flight waits at most for one call ([`mavstack::Config::budget`] bounds it). Code
//! that cannot wait that long, such as a rate controller, runs in an interrupt of a higher priority and shares nothing.
//!
//! A storage job runs without the lock, so flight and comms preempt an erase of seconds. `cargo xtask jitter` measures how late
//! flight starts meanwhile. STORAGE never locks the vehicle: embassy's mutex stores one waker, so while a lower priority holds
//! it, two waiting tasks wake each other forever. With an async driver, [`mavstack::storage::AsyncStore`] needs no STORAGE: COMMS
//! awaits the job.
//!
//! When flight hangs in an `await`, the heartbeats stop and comms continues. When it hangs in a busy loop, both are silent.
#![no_std]
#![no_main]

mod executors;
mod shared;
mod tasks;
mod time;
mod uart;

use cortex_m_rt::entry;
use embassy_sync::mutex::Mutex;
use mavstack::LinkId;
use mavstack_qemu::board::{self, Board};
use mavstack_qemu::device::interrupt;
use mavstack_qemu::memory::{self, FlashStore};
use shared::SharedApp;
use static_cell::StaticCell;
use tasks::{SharedStore, exchange, flight, receive, run, transmit};
use uart::Uart;

/// Queues for the bytes that arrive while flight runs, for some milliseconds.
static TELEMETRY: Uart<128> = Uart::new();
static COMPANION: Uart<1024> = Uart::new();
static SATELLITE: Uart<32> = Uart::new();

#[entry]
fn main() -> ! {
    static APP: StaticCell<SharedApp> = StaticCell::new();
    static STORE: StaticCell<SharedStore> = StaticCell::new();

    let app = memory::start();
    let (Some(mut core), Some(board)) = (cortex_m::Peripherals::take(), Board::take()) else {
        unreachable!("the firmware starts once")
    };
    let mut store = FlashStore::new(board.flash);
    store.restore(app, board::now());
    let app = &*APP.init(Mutex::new(app));
    let store = &*STORE.init(Mutex::new(store));
    time::start(board.alarm);

    let [flights, comms, storage] = executors::start(&mut core.NVIC);
    // No spawn fails, because each pool has enough slots.
    flights.spawn(flight(app).unwrap());
    let [uart0, uart1, uart2] = board.uarts;
    let lines = [TELEMETRY.start(uart0), COMPANION.start(uart1), SATELLITE.start(uart2)];
    for (link, (rx, tx)) in (0..).map(LinkId).zip(lines) {
        comms.spawn(receive(app, link, rx).unwrap());
        comms.spawn(transmit(app, link, tx).unwrap());
    }
    comms.spawn(exchange(app, store).unwrap());
    storage.spawn(run(store).unwrap());
    loop {
        cortex_m::asm::wfi();
    }
}

#[interrupt]
fn UART0() {
    TELEMETRY.on_interrupt();
}

#[interrupt]
fn UART1() {
    COMPANION.on_interrupt();
}

#[interrupt]
fn UART2() {
    SATELLITE.on_interrupt();
}
