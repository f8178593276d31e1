//! What a crate made from the chip's description would bring: its interrupts, and where their handlers are.
//!
//! Only what the firmware uses. Names and numbers of a handler meet in the vector table: `unsafe`.
#![allow(unsafe_code, non_snake_case)]

use cortex_m::interrupt::InterruptNumber;
pub use cortex_m_rt::interrupt;

pub use self::Interrupt as interrupt;

/// Bits of an interrupt's priority.
pub const NVIC_PRIO_BITS: u8 = 3;

/// Interrupts of the board mps2-an386.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(non_camel_case_types, reason = "as chips' descriptions have them")]
pub enum Interrupt {
    /// UART0 received a byte.
    UART0 = 0,
    /// UART0 has sent a byte. It leads to the handler of `UART0`: on most chips a UART has one.
    UART0_TX = 1,
    /// As `UART0`.
    UART1 = 2,
    /// As `UART0_TX`.
    UART1_TX = 3,
    /// As `UART0`.
    UART2 = 4,
    /// As `UART0_TX`.
    UART2_TX = 5,
    /// Nothing raises it here: a framework may.
    GPIO0 = 6,
    /// Nothing raises it here: a framework may.
    GPIO1 = 7,
    /// Timer 1 has reached zero.
    TIMER1 = 9,
}

// SAFETY: each is the number of one of the board's interrupts.
unsafe impl InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self as u16
    }
}

// `device.x` has what stands in for those that a firmware has no handler for.
unsafe extern "C" {
    fn UART0();
    fn UART1();
    fn UART2();
    fn GPIO0();
    fn GPIO1();
    fn TIMER0();
    fn TIMER1();
}

/// Where the processor looks for handlers.
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
static __INTERRUPTS: [unsafe extern "C" fn(); 10] =
    [UART0, UART0, UART1, UART1, UART2, UART2, GPIO0, GPIO1, TIMER0, TIMER1];
