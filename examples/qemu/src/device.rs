//! What a crate made from the chip's description would bring: its interrupts, and where their handlers are.
//!
//! Only what the firmware uses.
#![allow(unsafe_code, reason = "names and numbers of handlers meet in the vector table, which the linker places")]
#![allow(non_snake_case, reason = "handlers are called as their interrupts")]

use cortex_m::interrupt::InterruptNumber;
pub use cortex_m_rt::interrupt;

pub use self::Interrupt as interrupt;

/// Bits of an interrupt's priority.
pub const NVIC_PRIO_BITS: u8 = 3;

/// An interrupt of the board mps2-an386.
///
/// No `enum`, of whose values `None` would be one that is not 0: statics with an `Option` of it, queues and all, would lie in
/// flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interrupt(u16);

impl Interrupt {
    /// UART0 received a byte.
    pub const UART0: Self = Self(0);
    /// UART0 has sent a byte. It leads to the handler of `UART0`: on most chips a UART has one.
    pub const UART0_TX: Self = Self(1);
    /// As `UART0`.
    pub const UART1: Self = Self(2);
    /// As `UART0_TX`.
    pub const UART1_TX: Self = Self(3);
    /// As `UART0`.
    pub const UART2: Self = Self(4);
    /// As `UART0_TX`.
    pub const UART2_TX: Self = Self(5);
    /// Nothing raises it here: a framework may.
    pub const GPIO0: Self = Self(6);
    /// Nothing raises it here: a framework may.
    pub const GPIO1: Self = Self(7);
    /// Timer 1 has reached zero.
    pub const TIMER1: Self = Self(9);
}

// SAFETY: each is the number of one of the board's interrupts, and stays so.
unsafe impl InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self.0
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
