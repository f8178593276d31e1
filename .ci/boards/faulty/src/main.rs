//! A rover on a Raspberry Pi Pico, on UART0 at 57,600 bit/s: `examples/boards/rp2040` without USB, made faulty. Each feature is a fault
//! that people report of their boards. Without a feature it is sound.
//!
//! `cargo xtask boards --doctor` builds it with each fault, and runs it in rp2040js. `mavstack-check doctor` must name the fault.
#![no_std]
#![no_main]
#![deny(unsafe_code)]

#[path = "../../../../examples/boards/rp2040/src/board.rs"]
mod board;
#[cfg(any(feature = "dma-cut", feature = "poll-200-ms"))]
#[path = "../../../../examples/boards/rp2040-dma/src/dma.rs"]
mod dma;
#[path = "../../../../examples/boards/rp2040/src/flash.rs"]
mod flash;
#[cfg_attr(any(feature = "dma-cut", feature = "poll-200-ms"), path = "line/dma.rs")]
#[cfg_attr(feature = "timer", path = "line/timer.rs")]
mod line;
#[cfg_attr(feature = "erase-stall", path = "memory/rewriting.rs")]
mod memory;

use board::Board;
use line::Line;
use mavstack::config::VehicleAddress;
use mavstack::storage::Store;
use mavstack::{Address, Config, Instant, LinkConfig, LinkId, StackOf};
use mavstack_rover::{Mavlink, PULSE, Rover};
use panic_halt as _;
use static_cell::ConstStaticCell;

/// The rate of the UART. The adapter's is 57,600: `baud` is 3.5 % off. `streams` has a slow line, and an adapter that is as slow.
const BAUD: u32 = if cfg!(feature = "baud") {
    59_600
} else if cfg!(feature = "streams") {
    2_400
} else {
    57_600
};
/// The rate that the stack is told: with `streams`, it is 24 times that of the line.
const LINK: LinkConfig = LinkConfig::uart(if cfg!(feature = "streams") { 57_600 } else { BAUD });
/// How often the loop runs. The UART's FIFO of 32 bytes is full after 5.5 ms.
const PERIOD_MS: u32 = if cfg!(feature = "fifo") {
    20
} else if cfg!(feature = "poll-200-ms") {
    200
} else {
    1
};
const TELEM: LinkId = LinkId(0);
#[cfg(any(feature = "dma-cut", feature = "poll-200-ms"))]
const PERIOD: mavstack::Duration = mavstack::Duration::from_millis(PERIOD_MS as u64);
#[cfg(any(feature = "dma-cut", feature = "poll-200-ms"))]
const ERASE: mavstack::Duration = mavstack::Duration::from_millis(400);

static STACK: ConstStaticCell<StackOf<Mavlink>> = ConstStaticCell::new(StackOf::<Mavlink>::VACANT);

/// Component 1 is the autopilot.
const COMPONENT: u8 = if cfg!(feature = "component") { 50 } else { 1 };
const CONFIG: Config = Config {
    address: VehicleAddress::new(Address::new(1, COMPONENT)).expect("a vehicle's address"),
    // Without a pulse the stack sends no heartbeats.
    pulse: if cfg!(feature = "timer") { None } else { Some(&PULSE) },
    ..mavstack_rover::CONFIG
};

/// Returns the time that the stack is told.
fn time(now: Instant) -> Instant {
    if cfg!(feature = "clock-ms") { Instant::from_micros(now.as_millis()) } else { now }
}

#[rp2040_hal::entry]
fn main() -> ! {
    let Board { uart, mut clock, flash, dma, mut resets, .. } = Board::start(BAUD);
    let mut line = Line::new(uart, dma, &mut resets);
    let mut rover = Rover::default();
    let stack = STACK.take();
    stack.begin(CONFIG, [LINK]);
    let mut store = Store::new(memory::new(flash), memory::REGION);
    let _ = stack.restore(time(clock.now()), &mut store, &mut rover);
    loop {
        clock.begin_pass(PERIOD_MS);
        let now = time(clock.now());
        rover.drive(now, stack);
        if !cfg!(feature = "no-poll") {
            stack.poll(now, &mut rover);
        }
        line.poll(now, stack, &mut rover);
        stack.persist(now, &mut store, &mut rover);
        clock.sleep();
    }
}
