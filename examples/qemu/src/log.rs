//! The log, and the firmware's last words.

use core::panic::PanicInfo;

use defmt_semihosting as _;

use crate::board;

// ms since boot begin every line of the log. They wrap after 49 days, and only here.
defmt::timestamp!("{=u32:ms}", board::now().as_millis() as u32);

/// Says where, and ends the emulator with an error.
#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    match info.location() {
        Some(place) => defmt::error!("panic at {=str}:{=u32}", place.file(), place.line()),
        None => defmt::error!("panic"),
    }
    semihosting::process::exit(1)
}
