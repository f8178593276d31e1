//! The log, and the panic handler that uses it.

use core::panic::PanicInfo;

use defmt_semihosting as _;

use crate::board;

// Each line of the log starts with the time since boot (ms), which wraps after 49 days.
defmt::timestamp!("{=u32:ms}", board::now().as_millis() as u32);

/// Logs the location, and exits the emulator with an error.
#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    match info.location() {
        Some(location) => defmt::error!("panic at {=str}:{=u32}", location.file(), location.line()),
        None => defmt::error!("panic"),
    }
    semihosting::process::exit(1)
}
