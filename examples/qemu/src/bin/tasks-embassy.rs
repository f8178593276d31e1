//! Flight on an interrupt executor of Embassy, MAVLink on another one of a lower priority. `examples/tasks` is the vehicle. For tests
//! only: the ground stations are simulated, and the firmware measures how late flight starts.
//!
//! Embassy's own critical sections delay flight, those of its timer queue for example. They do so with and without the stack.
#![no_std]
#![no_main]
#![allow(unsafe_code, reason = "priorities and handlers of the executors' interrupts")]

#[path = "embassy/time.rs"]
mod time;

use cortex_m_rt::{entry, exception};
use embassy_executor::InterruptExecutor;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Ticker};
use mavstack_qemu::board::Board;
use mavstack_qemu::device::{Interrupt, interrupt};
use mavstack_qemu::tasks::{self, FlightTask, MAVLINK_PERIOD, MavlinkTask};

static FLIGHT: InterruptExecutor = InterruptExecutor::new();
static MAVLINK: InterruptExecutor = InterruptExecutor::new();
static TICK: Signal<CriticalSectionRawMutex, ()> = Signal::new();

#[entry]
fn main() -> ! {
    let (Some(mut core), Some(board)) = (cortex_m::Peripherals::take(), Board::take()) else {
        unreachable!("the firmware starts once")
    };
    let (flight_task, mavlink_task) = tasks::start("tasks-embassy");
    // SAFETY: no critical section is active that relies on priorities. SysTick has the same as flight: 0, the highest.
    unsafe {
        core.NVIC.set_priority(Interrupt::GPIO0, 0);
        core.NVIC.set_priority(Interrupt::TIMER1, 0x80);
        core.NVIC.set_priority(Interrupt::GPIO1, 0xC0);
    }
    time::start(board.alarm);
    // No spawn fails, because each task is spawned once.
    FLIGHT.start(Interrupt::GPIO0).spawn(flight(flight_task).unwrap());
    MAVLINK.start(Interrupt::GPIO1).spawn(mavlink(mavlink_task).unwrap());
    tasks::start_timer(core.SYST);
    // Does not sleep: the emulator's timers are late after it has skipped idle time.
    loop {
        cortex_m::asm::nop();
    }
}

#[embassy_executor::task]
async fn flight(mut flight: FlightTask) {
    loop {
        TICK.wait().await;
        flight.pass(FlightTask::late());
    }
}

#[embassy_executor::task]
async fn mavlink(mut mavlink: MavlinkTask) {
    let mut ticker = Ticker::every(Duration::from_micros(MAVLINK_PERIOD.into()));
    loop {
        ticker.next().await;
        mavlink.pass();
    }
}

/// The timer of flight; on a vehicle perhaps the interrupt of the gyroscope.
#[exception]
fn SysTick() {
    TICK.signal(());
}

#[interrupt]
fn GPIO0() {
    // SAFETY: this is the handler of the interrupt that the executor was started with. Nothing raises it before.
    unsafe { FLIGHT.on_interrupt() }
}

#[interrupt]
fn GPIO1() {
    // SAFETY: as above.
    unsafe { MAVLINK.on_interrupt() }
}
