//! The capacities of the vehicle, and its storage in flash.

use mavstack::storage::Store;
use mavstack::{Instant, StackOf};
use mavstack_demo::{App, Mavlink};
use static_cell::{ConstStaticCell, StaticCell};

use crate::board::{self, Board};
use crate::flash::PsramFlash;

/// The stack before it is begun. It is all zeros, so it is in `.bss`: it takes no flash, and no call stack at boot.
pub static STACK: ConstStaticCell<StackOf<Mavlink>> = ConstStaticCell::new(StackOf::<Mavlink>::VACANT);

/// Boots the vehicle. Call it once. Not inlined: the vehicle is built on the call stack and then copied to its place.
#[inline(never)]
pub fn start() -> &'static mut App {
    static APP: StaticCell<App> = StaticCell::new();

    let app = STACK.try_take().and_then(|stack| APP.try_init_with(|| App::new(stack)));
    let app = app.unwrap_or_else(|| Board::reset());
    app.keep_logs(crate::flash::logs());
    if board::is_without_components() {
        app.leave_out_components();
    }
    app
}

/// The storage of the signing key, the parameters and the plans, in all of the flash.
pub struct FlashStore(Store<PsramFlash>);

const _: () = assert!(Store::<PsramFlash>::region_len::<Mavlink>() <= PsramFlash::LEN);

impl FlashStore {
    /// Creates the storage in this flash.
    pub fn new(flash: PsramFlash) -> Self {
        Self(Store::new(flash, 0..PsramFlash::LEN))
    }

    /// Restores everything. Call it once, before anything else.
    pub fn restore(&mut self, app: &mut App, now: Instant) {
        // The stack has already reported errors by STATUSTEXT.
        let _ = app.restore(now, &mut self.0);
    }

    /// Writes pending data, one step per call. Returns true when more work is pending. It blocks during an erase or a write: for
    /// a firmware with one loop.
    ///
    /// The simulated flash writes within microseconds, so the vehicle always permits it. If an erase stalls the processor, keep
    /// the default `may_persist`, which permits nothing while armed.
    pub fn persist(&mut self, app: &mut App, now: Instant) -> bool {
        app.persist(now, &mut self.0)
    }

    /// Reports the last job's result, and gets the next job. Returns true when there is one: then call [`run`](Self::run). For a
    /// task of its own, which locks the vehicle for this call only.
    pub fn exchange_job(&mut self, app: &mut App, now: Instant) -> bool {
        app.exchange_job(now, self.0.slot())
    }

    /// Runs the job: blocks during an erase or a write. Needs no lock.
    pub fn run(&mut self) {
        self.0.run();
    }
}
