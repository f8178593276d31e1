//! The log, and the firmware's last words.

use core::panic::PanicInfo;
use core::sync::atomic::{AtomicU32, Ordering};

use defmt_semihosting as _;
use mavstack::Instant;

/// ms since boot: every line of the log begins with it.
static UPTIME: AtomicU32 = AtomicU32::new(0);

defmt::timestamp!("{=u32:ms}", UPTIME.load(Ordering::Relaxed));

/// The first line: it works.
pub fn begin() {
    defmt::info!("the vehicle is switched on");
}

/// Sets the time of the lines to come.
pub fn set_time(now: Instant) {
    // Wraps after 49 days, and only here.
    UPTIME.store(now.as_millis() as u32, Ordering::Relaxed);
}

/// Says where, and ends the emulator with an error.
#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    match info.location() {
        Some(place) => defmt::error!("panic at {=str}:{=u32}", place.file(), place.line()),
        None => defmt::error!("panic"),
    }
    semihosting::process::exit(1)
}
