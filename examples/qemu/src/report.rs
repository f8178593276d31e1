//! The panic handler of firmwares that report to the host without a log.

use core::panic::PanicInfo;

/// Prints the message, and exits the emulator with an error.
#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    semihosting::println!("{info}");
    semihosting::process::exit(1)
}
