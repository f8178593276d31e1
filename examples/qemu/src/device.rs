//! A minimal peripheral access crate: the interrupts that the firmware uses, and their vector table.
#![allow(unsafe_code, reason = "the vector table refers to the handlers by name, and the linker places it")]
#![allow(non_snake_case, reason = "handlers have the names of their interrupts")]

use cortex_m::interrupt::InterruptNumber;
pub use cortex_m_rt::interrupt;

pub use self::Interrupt as interrupt;

/// The number of priority bits of an interrupt.
pub const NVIC_PRIO_BITS: u8 = 3;

/// An interrupt of the board mps2-an386.
///
/// Not an `enum`: the niche for `None` in an `Option<enum>` is not 0. Statics that contain such an option, with their queues,
/// would lie in `.data` and take flash for their initialiser.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interrupt(u16);

impl Interrupt {
    /// UART0 received a byte.
    pub const UART0: Self = Self(0);
    /// UART0 has sent a byte. The handler of `UART0` serves it too, because a UART has a single interrupt on most chips.
    pub const UART0_TX: Self = Self(1);
    /// As `UART0`.
    pub const UART1: Self = Self(2);
    /// As `UART0_TX`.
    pub const UART1_TX: Self = Self(3);
    /// As `UART0`.
    pub const UART2: Self = Self(4);
    /// As `UART0_TX`.
    pub const UART2_TX: Self = Self(5);
    /// Unused by the board, free for frameworks.
    pub const GPIO0: Self = Self(6);
    /// Unused by the board, free for frameworks.
    pub const GPIO1: Self = Self(7);
    /// Timer 0 has reached zero. The clock does not enable it, so it is free for frameworks.
    pub const TIMER0: Self = Self(8);
    /// Timer 1 has reached zero.
    pub const TIMER1: Self = Self(9);
    /// The Ethernet controller has received a frame.
    #[cfg(feature = "network")]
    pub const ETHERNET: Self = Self(13);
}

// SAFETY: each value is the constant number of one of the board's interrupts.
unsafe impl InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self.0
    }
}

// `device.x` provides default handlers.
unsafe extern "C" {
    fn UART0();
    fn UART1();
    fn UART2();
    fn GPIO0();
    fn GPIO1();
    fn TIMER0();
    fn TIMER1();
    #[cfg(feature = "network")]
    fn ETHERNET();
}

/// The vector table of the interrupts.
#[cfg(not(feature = "network"))]
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
static __INTERRUPTS: [unsafe extern "C" fn(); 10] =
    [UART0, UART0, UART1, UART1, UART2, UART2, GPIO0, GPIO1, TIMER0, TIMER1];

/// The same up to the interrupt of the Ethernet controller. The interrupts in between are never enabled.
#[cfg(feature = "network")]
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
static __INTERRUPTS: [unsafe extern "C" fn(); 14] =
    [UART0, UART0, UART1, UART1, UART2, UART2, GPIO0, GPIO1, TIMER0, TIMER1, ETHERNET, ETHERNET, ETHERNET, ETHERNET];
