//! Code shared by the measured firmwares: a UART, a clock, a panic handler. The size figures subtract the firmware `empty`, which
//! contains only this.
#![no_std]

pub mod events;

use core::cell::UnsafeCell;
use core::convert::Infallible;
use core::mem::MaybeUninit;

#[cfg(target_arch = "arm")]
pub use cortex_m_rt::entry;
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use mavstack::{Address, Config, Pulse};
#[cfg(feature = "panic-never")]
use panic_never as _;
#[cfg(target_arch = "riscv32")]
pub use riscv_rt::entry;

/// The first CMSDK UART of the emulated board, polled.
#[derive(Debug)]
pub struct Uart;

const BASE: usize = 0x4000_4000;
const DATA: usize = BASE;
const STATE: usize = BASE + 4;
const TX_FULL: u32 = 1;
const RX_FULL: u32 = 2;

#[allow(unsafe_code, reason = "a register of the board")]
fn load(register: usize) -> u32 {
    // SAFETY: a register of the UART on this board, which has no side effect on memory.
    unsafe { core::ptr::with_exposed_provenance::<u32>(register).read_volatile() }
}

#[allow(unsafe_code, reason = "a register of the board")]
fn store(register: usize, value: u32) {
    // SAFETY: as for `load`.
    unsafe { core::ptr::with_exposed_provenance_mut::<u32>(register).write_volatile(value) }
}

/// Simulates a clock (µs since boot) that reads one register.
pub fn now_micros() -> u64 {
    u64::from(load(0x4000_0004))
}

impl ErrorType for Uart {
    type Error = Infallible;
}

impl ReadReady for Uart {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(load(STATE) & RX_FULL != 0)
    }
}

impl WriteReady for Uart {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(load(STATE) & TX_FULL == 0)
    }
}

impl Read for Uart {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        let mut len = 0;
        for byte in bytes {
            if load(STATE) & RX_FULL == 0 {
                break;
            }
            let [low, ..] = load(DATA).to_le_bytes();
            *byte = low;
            len += 1;
        }
        Ok(len)
    }
}

impl Write for Uart {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let mut len = 0;
        for byte in bytes {
            if load(STATE) & TX_FULL != 0 {
                break;
            }
            store(DATA, u32::from(*byte));
            len += 1;
        }
        Ok(len)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// The main loop ticks it.
pub static PULSE: Pulse = Pulse::new();

/// A configuration for system 1, component 1.
pub const CONFIG: Config = Config::new(Address::new(1, 1), &PULSE);

/// Static memory for a value, so that its RAM is counted.
#[derive(Debug)]
pub struct Place<T>(UnsafeCell<MaybeUninit<T>>);

#[allow(unsafe_code, reason = "no interrupt of the measured firmwares uses a `Place`")]
// SAFETY: the firmware has a single thread of execution.
unsafe impl<T> Sync for Place<T> {}

impl<T> Place<T> {
    /// Creates an empty place.
    #[allow(clippy::new_without_default, reason = "for statics only")]
    pub const fn new() -> Self {
        Self(UnsafeCell::new(MaybeUninit::uninit()))
    }

    /// Stores the value. Call it once per place, at boot.
    #[allow(unsafe_code, clippy::mut_from_ref, reason = "called once per place")]
    #[inline(always)]
    pub fn put(&'static self, value: T) -> &'static mut T {
        // SAFETY: called once, so no other reference to the value exists.
        unsafe { (*self.0.get()).write(value) }
    }
}

/// A static value whose initial bits are all zero, so that it is in `.bss`.
#[derive(Debug)]
pub struct Vacant<T>(UnsafeCell<T>);

#[allow(unsafe_code, reason = "no interrupt of the measured firmwares uses a `Vacant`")]
// SAFETY: the firmware has a single thread of execution.
unsafe impl<T> Sync for Vacant<T> {}

impl<T> Vacant<T> {
    /// Creates the static with `value`.
    pub const fn new(value: T) -> Self {
        Self(UnsafeCell::new(value))
    }

    /// Returns the value. Call it once for each static, at boot.
    #[allow(unsafe_code, clippy::mut_from_ref, reason = "called once per static")]
    #[inline(always)]
    pub fn take(&'static self) -> &'static mut T {
        // SAFETY: nothing else refers to the value, because this is called only once.
        unsafe { &mut *self.0.get() }
    }
}

/// Simulated storage devices: registers that are read and written in words.
#[cfg(feature = "storage")]
pub mod storage {
    use core::convert::Infallible;

    use embedded_hal::spi::{self, Operation, SpiDevice};
    use embedded_storage::nor_flash::{self, NorFlash, ReadNorFlash};

    use super::{DATA, load, store};

    /// A NOR flash that is written in words.
    #[derive(Debug)]
    pub struct Flash;

    impl nor_flash::ErrorType for Flash {
        type Error = Infallible;
    }

    impl ReadNorFlash for Flash {
        const READ_SIZE: usize = 4;

        fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Infallible> {
            store(DATA, offset);
            for word in bytes.as_chunks_mut().0 {
                *word = load(DATA).to_le_bytes();
            }
            Ok(())
        }

        fn capacity(&self) -> usize {
            0x1_0000
        }
    }

    impl NorFlash for Flash {
        const WRITE_SIZE: usize = 4;
        const ERASE_SIZE: usize = 0x1000;

        fn erase(&mut self, from: u32, _: u32) -> Result<(), Infallible> {
            store(DATA, from);
            Ok(())
        }

        fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Infallible> {
            store(DATA, offset);
            for word in bytes.as_chunks().0 {
                store(DATA, u32::from_le_bytes(*word));
            }
            Ok(())
        }
    }

    /// An SPI bus with an FRAM.
    #[derive(Debug)]
    pub struct Spi;

    impl spi::ErrorType for Spi {
        type Error = Infallible;
    }

    impl SpiDevice for Spi {
        fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
            for operation in operations {
                match operation {
                    Operation::Read(bytes) => bytes.iter_mut().for_each(|byte| [*byte, ..] = load(DATA).to_le_bytes()),
                    Operation::Write(bytes) => bytes.iter().for_each(|byte| store(DATA, u32::from(*byte))),
                    _ => {}
                }
            }
            Ok(())
        }
    }
}

#[cfg(not(feature = "panic-never"))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}
