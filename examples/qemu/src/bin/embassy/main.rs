//! The demo vehicle as tasks of Embassy.
//!
//! ```text
//!   UART interrupts       ──▶ queue ──┐                        ┌─▶ queue ──▶
//!   FLIGHT, an executor   flight, every 10 ms: fly ─▶ pulse     │
//!   COMMS, one below                  └▶ hear ─▶ stack ─▶ speak ┘   two tasks for each link; and remember
//!                                         └──── news ────▶┘
//! ```
//!
//! `hear` awaits bytes; `speak` awaits news or the stack's next deadline. In between the processor sleeps. Both take any UART with
//! the traits of `embedded-io-async` that comes in two halves.
//!
//! Flight and comms share the vehicle and its stack behind a lock that is awaited; one that masks interrupts would have the UARTs
//! wait. Comms has it for one bounded call at a time, so flight waits for no more than that ([`mavstack::Config::budget`] says
//! how much it is). What may not even wait for that, say a rate controller, becomes an interrupt above, which shares nothing.
//!
//! When flight hangs and awaits, the heartbeats stop and comms goes on. When it hangs and does not await, both are silent.
#![no_std]
#![no_main]
#![allow(unsafe_code, reason = "the executors' interrupts: their priorities, and their handlers")]

mod time;
mod uart;

use core::future::pending;

use cortex_m_rt::entry;
use embassy_executor::InterruptExecutor;
use embassy_futures::select::select;
use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::mutex::Mutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Ticker, Timer};
use embedded_io_async::{Read, Write};
use mavstack::{LinkId, MAX_FRAME_LEN};
use mavstack_demo::LINKS;
use mavstack_qemu::board::{self, Board};
use mavstack_qemu::device::{Interrupt, interrupt};
use mavstack_qemu::memory::{DemoApp, Memory};
use static_cell::StaticCell;
use uart::{Receiver, Sender, Uart};

type SharedApp = Mutex<CriticalSectionRawMutex, DemoApp>;

/// For each link: there may be something to say.
static NEWS: [Signal<CriticalSectionRawMutex, ()>; LINKS] = [const { Signal::new() }; LINKS];

/// Wakes who speaks on a link, if that is not `except`.
fn tell(except: Option<LinkId>) {
    for (link, news) in (0..).map(LinkId).zip(&NEWS) {
        if Some(link) != except {
            news.signal(());
        }
    }
}

/// Queues for what comes while flight has the processor, some milliseconds.
static TELEMETRY: Uart<128> = Uart::new();
static COMPANION: Uart<1024> = Uart::new();
static SATELLITE: Uart<32> = Uart::new();

/// In an interrupt each, of a priority below that of the UARTs and the timer, which is 0. COMMS could be the executor of thread
/// mode as well; but that sleeps by WFE, which the emulator takes for a busy loop.
static FLIGHT: InterruptExecutor = InterruptExecutor::new();
const FLIGHT_PRIORITY: u8 = 0x80;
static COMMS: InterruptExecutor = InterruptExecutor::new();
const COMMS_PRIORITY: u8 = 0xC0;

/// The vehicle, written to its place. Apart from `main`, which never ends: what this takes of the stack is free again.
#[inline(never)]
fn make() -> &'static mut SharedApp {
    static APP: StaticCell<SharedApp> = StaticCell::new();

    APP.init_with(|| Mutex::new(DemoApp::new()))
}

#[entry]
fn main() -> ! {
    let app = make();
    let (Some(mut core), Some(board)) = (cortex_m::Peripherals::take(), Board::take()) else {
        unreachable!("the firmware starts once")
    };
    let mut memory = Memory::new(board.flash);
    memory.restore(app.get_mut(), board::now());
    let app = &*app;
    time::start(board.alarm);

    // SAFETY: nobody is in a critical section that a priority makes.
    unsafe {
        core.NVIC.set_priority(Interrupt::GPIO0, FLIGHT_PRIORITY);
        core.NVIC.set_priority(Interrupt::GPIO1, COMMS_PRIORITY);
    }
    // Each task is spawned as often as there is room for it: none fails.
    FLIGHT.start(Interrupt::GPIO0).spawn(flight(app).unwrap());
    let comms = COMMS.start(Interrupt::GPIO1);
    let [uart0, uart1, uart2] = board.uarts;
    let lines = [TELEMETRY.start(uart0), COMPANION.start(uart1), SATELLITE.start(uart2)];
    for (link, (rx, tx)) in (0..).map(LinkId).zip(lines) {
        comms.spawn(hear(app, link, rx).unwrap());
        comms.spawn(speak(app, link, tx).unwrap());
    }
    comms.spawn(remember(app, memory).unwrap());
    loop {
        cortex_m::asm::wfi();
    }
}

/// Flies, and ticks the pulse.
#[embassy_executor::task]
async fn flight(app: &'static SharedApp) {
    let mut ticker = Ticker::every(Duration::from_millis(10));
    loop {
        let (has_news, hangs) = {
            let mut app = app.lock().await;
            (app.fly(board::now()), app.hangs())
        };
        if has_news {
            tell(None);
        }
        if hangs {
            // For a sensor that does not answer, say.
            pending::<()>().await;
        }
        ticker.next().await;
    }
}

/// Takes what comes on a link.
#[embassy_executor::task(pool_size = LINKS)]
async fn hear(app: &'static SharedApp, link: LinkId, mut rx: Receiver) {
    let mut buffer = [0; 64];
    loop {
        // An error is told once, and counted: what was lost, checksums find.
        let Ok(len) = rx.read(&mut buffer).await else { continue };
        let mut rest = buffer.get(..len).unwrap_or_default();
        while !rest.is_empty() {
            let mut app = app.lock().await;
            let (stack, vehicle) = app.parts();
            let now = board::now();
            let taken = stack.receive(now, link, rest, vehicle);
            rest = rest.get(taken..).unwrap_or_default();
            if taken == 0 {
                // Frames that wait for the budget of another call.
                stack.receive(now, link, &[], vehicle);
            }
        }
        // On any link: what came may be for somebody there.
        tell(None);
    }
}

/// Says on a link what there is to say.
#[embassy_executor::task(pool_size = LINKS)]
async fn speak(app: &'static SharedApp, link: LinkId, mut tx: Sender) {
    let mut frame = [0; MAX_FRAME_LEN];
    loop {
        let (len, now, deadline) = {
            let mut app = app.lock().await;
            let now = board::now();
            app.poll(now);
            let (stack, vehicle) = app.parts();
            // What was received and waits: for the budget of another call, or for silence.
            stack.receive(now, link, &[], vehicle);
            let pending = stack.transmit(now, link, vehicle);
            let len = pending.len().min(frame.len());
            frame[..len].copy_from_slice(&pending[..len]);
            (len, now, stack.next_deadline(now))
        };
        if len == 0 {
            // It is any link's deadline. What is due already is not for this one, as a rule, and the others may not know.
            if deadline <= now {
                tell(Some(link));
            }
            let next = deadline.max(now.after(mavstack::Duration::from_millis(1)));
            let next = Timer::at(embassy_time::Instant::from_micros(next.as_micros()));
            select(NEWS[usize::from(link.0)].wait(), next).await;
            continue;
        }
        // Until the line has taken it the next frame is not made: a heartbeat is not to wait behind it, and outlive flight.
        let Ok(()) = tx.write_all(&frame[..len]).await;
        let Ok(()) = tx.flush().await;
        app.lock().await.parts().0.transmitted(link, len);
    }
}

/// Writes what is to last, and restarts the processor when somebody asked for that.
#[embassy_executor::task]
async fn remember(app: &'static SharedApp, mut memory: Memory) {
    loop {
        let is_busy = {
            let mut app = app.lock().await;
            if app.wants_reboot() {
                Board::reset();
            }
            memory.persist(&mut app, board::now())
        };
        if is_busy { yield_now().await } else { Timer::after(Duration::from_millis(10)).await }
    }
}

#[interrupt]
fn GPIO0() {
    // SAFETY: the handler of the interrupt that it was started with, which nothing raises before.
    unsafe { FLIGHT.on_interrupt() }
}

#[interrupt]
fn GPIO1() {
    // SAFETY: as above.
    unsafe { COMMS.on_interrupt() }
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
