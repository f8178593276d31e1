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
mod time;
mod uart;

use core::future::pending;

use cortex_m_rt::entry;
use embassy_futures::select::select;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::mutex::Mutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Instant, Ticker, Timer};
use mavstack::LinkId;
use mavstack::frame::MAX_FRAME_LEN;
use mavstack::io::{AsyncReceiver, AsyncTransmitter};
use mavstack_demo::{App, LINKS};
use mavstack_qemu::board::{self, Board};
use mavstack_qemu::device::interrupt;
use mavstack_qemu::memory::{self, FlashStore};
use static_cell::StaticCell;
use uart::{Receiver, Sender, Uart};

/// The most bytes for one call of the stack: not much more than one frame, so that flight waits for one frame.
const PIECE: usize = 16;

type SharedApp = Mutex<CriticalSectionRawMutex, &'static mut App>;
/// The tasks `exchange` and `run` use it in turn.
type SharedStore = Mutex<CriticalSectionRawMutex, FlashStore>;

/// Signals to each link's `transmit` task that output may be pending.
static WAKE: [Signal<CriticalSectionRawMutex, ()>; LINKS] = [const { Signal::new() }; LINKS];

/// Wakes the `transmit` tasks of all links: a received frame may be forwarded to any of them.
fn wake_transmitters() {
    WAKE.iter().for_each(|wake| wake.signal(()));
}

/// Signals to `run` that the store has a job, and to `exchange` that the job has ended.
static JOB: Signal<CriticalSectionRawMutex, ()> = Signal::new();
static DONE: Signal<CriticalSectionRawMutex, ()> = Signal::new();

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

/// Runs the flight loop, which ticks the pulse.
#[embassy_executor::task]
async fn flight(app: &'static SharedApp) {
    let mut ticker = Ticker::every(Duration::from_millis(10));
    loop {
        let (has_output, hangs) = {
            let mut app = app.lock().await;
            (app.fly(board::now()), app.simulates_hang())
        };
        if has_output {
            wake_transmitters();
        }
        if hangs {
            // For example for a sensor that does not answer.
            pending::<()>().await;
        }
        ticker.next().await;
    }
}

/// Receives bytes on a link.
#[embassy_executor::task(pool_size = LINKS)]
async fn receive(app: &'static SharedApp, link: LinkId, rx: Receiver) {
    let mut buffer = [0; 64];
    let mut receiver = AsyncReceiver::new(rx, &mut buffer).with_piece(PIECE);
    loop {
        receiver.wait().await;
        let is_pending = {
            let mut app = app.lock().await;
            let (stack, vehicle) = app.parts();
            // An error is reported once, and counted. Checksums detect the lost bytes.
            stack.receive_from(board::now(), link, &mut receiver, vehicle)
        };
        if is_pending != Ok(true) {
            wake_transmitters();
        }
    }
}

/// Transmits pending frames on a link.
#[embassy_executor::task(pool_size = LINKS)]
async fn transmit(app: &'static SharedApp, link: LinkId, tx: Sender) {
    let mut frame = [0; MAX_FRAME_LEN];
    let mut transmitter = AsyncTransmitter::new(tx, &mut frame);
    loop {
        // One call for each lock, so that flight waits for one call at most.
        app.lock().await.poll(board::now());
        let (has_bytes, deadline) = {
            let mut app = app.lock().await;
            let now = board::now();
            let (stack, vehicle) = app.parts();
            let has_bytes = stack.transmit_to(now, link, &mut transmitter, vehicle);
            (has_bytes, stack.link_deadline(now, link))
        };
        if has_bytes == Ok(true) {
            transmitter.send().await;
        } else {
            let next = Timer::at(Instant::from_micros(deadline.as_micros()));
            select(WAKE[usize::from(link.0)].wait(), next).await;
        }
    }
}

/// Exchanges the storage's jobs, and resets the processor when a reboot was requested.
#[embassy_executor::task]
async fn exchange(app: &'static SharedApp, store: &'static SharedStore) {
    loop {
        let has_job = {
            let mut store = store.lock().await;
            let mut app = app.lock().await;
            if app.wants_reboot() {
                Board::reset();
            }
            store.exchange_job(&mut app, board::now())
        };
        if has_job {
            JOB.signal(());
            DONE.wait().await;
        } else {
            Timer::after(Duration::from_millis(10)).await;
        }
    }
}

/// Runs the storage's jobs. Its priority is the lowest, because an erase may keep the processor busy.
#[embassy_executor::task]
async fn run(store: &'static SharedStore) {
    loop {
        JOB.wait().await;
        store.lock().await.run();
        DONE.signal(());
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
