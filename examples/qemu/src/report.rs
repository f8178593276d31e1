//! Where a firmware that reports to the host, and has no log, ends when it finds something wrong.

use core::panic::PanicInfo;

/// Says what and where, and ends the emulator with an error.
#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    semihosting::println!("{info}");
    semihosting::process::exit(1)
}
