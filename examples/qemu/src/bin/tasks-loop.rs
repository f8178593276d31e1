//! Flight in a timer interrupt at 1 kHz, MAVLink in the main loop. `examples/tasks` is the vehicle. For tests only: the ground stations
//! are simulated, and the firmware measures how late flight starts.
#![no_std]
#![no_main]

use core::cell::Cell;

use cortex_m::interrupt::{Mutex, free};
use cortex_m_rt::{entry, exception};
use mavstack_qemu::board::{self, Board, CLOCK_HZ};
use mavstack_qemu::tasks::{self, FlightTask, MAVLINK_PERIOD};

/// Hands flight to its interrupt, once.
static START: Mutex<Cell<Option<FlightTask>>> = Mutex::new(Cell::new(None));

#[entry]
fn main() -> ! {
    let (Some(core), Some(_)) = (cortex_m::Peripherals::take(), Board::take()) else { Board::reset() };
    let (flight, mut mavlink) = tasks::start("tasks-loop");
    free(|cs| START.borrow(cs).set(Some(flight)));
    // The priority of SysTick is the highest, unless it is changed.
    tasks::start_timer(core.SYST);
    let mut due = board::ticks();
    loop {
        mavlink.pass();
        due = due.wrapping_add(CLOCK_HZ / 1_000_000 * MAVLINK_PERIOD);
        // Does not sleep: the emulator's timers are late after it has skipped idle time.
        while due.wrapping_sub(board::ticks()).cast_signed() > 0 {}
    }
}

#[exception]
fn SysTick() {
    static mut FLIGHT: Option<FlightTask> = None;

    let late = FlightTask::late();
    // Only the first pass needs the critical section.
    if FLIGHT.is_none() {
        *FLIGHT = free(|cs| START.borrow(cs).take());
    }
    if let Some(flight) = FLIGHT {
        flight.pass(late);
    }
}
