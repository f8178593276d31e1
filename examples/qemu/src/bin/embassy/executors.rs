//! The executors, each in an interrupt of its own, at a lower priority than the UARTs and the timer (0).
//!
//! STORAGE could be the thread-mode executor. But that sleeps with WFE, which the emulator treats as a busy loop.
#![allow(unsafe_code, reason = "priorities and handlers of the executors' interrupts")]

use cortex_m::peripheral::NVIC;
use embassy_executor::{InterruptExecutor, SendSpawner};
use mavstack_qemu::device::{Interrupt, interrupt};

static FLIGHT: InterruptExecutor = InterruptExecutor::new();
static COMMS: InterruptExecutor = InterruptExecutor::new();
static STORAGE: InterruptExecutor = InterruptExecutor::new();

/// Starts the executors for flight, comms and storage, in the order of their priorities.
pub fn start(nvic: &mut NVIC) -> [SendSpawner; 3] {
    // SAFETY: no critical section is active that relies on priorities.
    unsafe {
        nvic.set_priority(Interrupt::GPIO0, 0x80);
        nvic.set_priority(Interrupt::GPIO1, 0xC0);
        nvic.set_priority(Interrupt::TIMER0, 0xE0);
    }
    [FLIGHT.start(Interrupt::GPIO0), COMMS.start(Interrupt::GPIO1), STORAGE.start(Interrupt::TIMER0)]
}

#[interrupt]
fn GPIO0() {
    // SAFETY: this is the handler of the interrupt that the executor was started with. Nothing raises it before.
    unsafe { FLIGHT.on_interrupt() }
}

#[interrupt]
fn GPIO1() {
    // SAFETY: as above.
    unsafe { COMMS.on_interrupt() }
}

#[interrupt]
fn TIMER0() {
    // SAFETY: as above.
    unsafe { STORAGE.on_interrupt() }
}
