//! Measures how late flight starts while storage erases and writes: the common part of the firmwares `jitter-rtic` and
//! `jitter-embassy`. `cargo xtask jitter` runs them. For tests only.
//!
//! They have the tasks, priorities and locks of the firmwares `rtic` and `embassy`. But flight runs at 1 kHz, the flash keeps the
//! processor busy for seconds, and two lines are full. The lines are simulated, so there are no UART interrupts.

use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use mavstack::storage::Store;
use mavstack::{Duration, Instant};
use mavstack_demo::{App, Mavlink, Tuning};
use semihosting::experimental::env;
use semihosting::{println, process};

use crate::board::{self, COMPANION_BAUD, TELEMETRY_BAUD};
use crate::flash::PsramFlash;

/// Period of flight (ms).
pub const PERIOD: u32 = 1;
/// Number of measured passes of flight: 20 s.
const PASSES: u32 = 20_000;
/// The largest delay that is accepted (µs).
const LIMIT: u64 = 100;
/// Bytes that arrive per ms on each line, with ten bits per byte. The third line, the satellite modem's, is silent.
pub const BYTES: [usize; 3] = [TELEMETRY_BAUD as usize / 10_000, COMPANION_BAUD as usize / 10_000, 0];

/// How storage runs.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Way {
    /// Jobs run without the lock.
    Jobs,
    /// `persist` runs under the lock.
    Persist,
}

impl Way {
    /// Returns the way that is named on the emulator's command line.
    pub fn from_command_line() -> Self {
        let arguments = env::args::<64>().expect("arguments from the emulator");
        match (&arguments).flatten().nth(1) {
            Some("jobs") => Self::Jobs,
            Some("persist") => Self::Persist,
            other => panic!("expected `jobs` or `persist`, not {other:?}"),
        }
    }
}

static ERASES: AtomicU32 = AtomicU32::new(0);
static WRITES: AtomicU32 = AtomicU32::new(0);

/// The board's flash, but an erase takes 2 s and a write takes 1 ms. Both keep the processor busy.
struct SlowFlash(PsramFlash);

impl SlowFlash {
    const ERASE: Duration = Duration::from_secs(2);
    const WRITE: Duration = Duration::from_millis(1);
    /// Processor cycles between two reads of the clock.
    const CYCLES: u32 = 1_000;

    fn wait(time: Duration) {
        let end = board::now() + time;
        while board::now() < end {
            cortex_m::asm::delay(Self::CYCLES);
        }
    }
}

impl ErrorType for SlowFlash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for SlowFlash {
    const READ_SIZE: usize = PsramFlash::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        self.0.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl NorFlash for SlowFlash {
    const WRITE_SIZE: usize = PsramFlash::WRITE_SIZE;
    const ERASE_SIZE: usize = PsramFlash::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        Self::wait(Self::ERASE);
        ERASES.fetch_add(1, Relaxed);
        self.0.erase(from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        Self::wait(Self::WRITE);
        WRITES.fetch_add(1, Relaxed);
        self.0.write(offset, bytes)
    }
}

/// The storage, in the shortest region, so that units are erased often.
pub struct SlowStore {
    store: Store<SlowFlash>,
    way: Way,
    /// When to change a parameter next.
    due: Instant,
    value: i32,
}

impl SlowStore {
    /// Restores the vehicle from the flash. At power-up it holds no log, so it is erased unit by unit.
    pub fn restore(flash: PsramFlash, app: &mut App, way: Way) -> Self {
        let mut store = Store::new(SlowFlash(flash), 0..Store::<SlowFlash>::region_len::<Mavlink>());
        // The stack reports that there is no log.
        let _ = app.restore(board::now(), &mut store);
        Self { store, way, due: Instant::ZERO, value: 0 }
    }

    /// Exchanges the job under the lock, or runs `persist`. Returns true when more work is pending. A parameter changes and is
    /// saved ten times a second, or as often as the flash permits.
    pub fn step(&mut self, app: &mut App) -> bool {
        let now = board::now();
        if now >= self.due {
            self.due = now + Duration::from_millis(100);
            self.value = self.value.wrapping_add(1) % 1_000;
            let (stack, _) = app.parts();
            stack.parameters_mut().set(Tuning::MAV_HL_LOSS_T, self.value);
            stack.save_parameters(now);
        }
        match self.way {
            Way::Jobs => app.exchange_job(now, self.store.slot()),
            Way::Persist => app.persist(now, &mut self.store),
        }
    }

    /// Runs the job, if there is one. Needs no lock.
    pub fn run(&mut self) {
        self.store.run();
    }
}

/// The delays of flight.
pub struct Delays {
    firmware: &'static str,
    way: Way,
    passes: u32,
    sum: u64,
    max: u64,
}

impl Delays {
    /// Starts the measurement.
    pub const fn new(firmware: &'static str, way: Way) -> Self {
        Self { firmware, way, passes: 0, sum: 0, max: 0 }
    }

    /// Counts a pass that was due at `due` and has the lock now. The last pass prints the result and exits the emulator.
    pub fn started(&mut self, due: Instant, app: &App) {
        let now = board::now();
        let late = (now - due).as_micros();
        self.max = self.max.max(late);
        self.sum += late;
        self.passes += 1;
        if self.passes == PASSES {
            self.report(now, app);
        }
    }

    /// Prints the result, and exits with an error if it is larger than the limit or if nothing was tried.
    fn report(&self, now: Instant, app: &App) -> ! {
        let Self { firmware, way, passes, sum, max } = *self;
        let (erases, writes) = (ERASES.load(Relaxed), WRITES.load(Relaxed));
        let [telemetry, companion, _] = app.status(now).links;
        let received = telemetry.received + companion.received;
        let sent = telemetry.sent + companion.sent;
        println!(
            "{firmware} {}: flight late by {max} us at most, {} us on average, in {passes} passes; {erases} erases, {writes} \
             writes, {received} frames received, {sent} sent",
            if way == Way::Jobs { "jobs" } else { "persist" },
            sum / u64::from(passes)
        );
        let is_tried = erases >= 3 && writes > 0 && received > passes / 10 && sent > passes / 10;
        process::exit(if is_tried && (way == Way::Persist || max <= LIMIT) { 0 } else { 1 })
    }
}
