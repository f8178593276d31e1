//! The capacities of the vehicle, and its storage in flash.

use mavstack::Instant;
use mavstack::param::ParamTable;
use mavstack::plan::Durability;
use mavstack::storage::{ParamStore, PlanStore, SigningStore};
use mavstack_demo::{App, FENCE, MISSION, Mavlink, RALLY, Tuning};
use static_cell::{ConstStaticCell, StaticCell};

use crate::board::Board;
use crate::flash::PsramFlash;

/// The stack before it is begun. It is all zeros, so it is in `.bss`: it takes no flash, and no call stack at boot.
pub static STACK: ConstStaticCell<Mavlink> = ConstStaticCell::new(Mavlink::VACANT);

/// Boots the vehicle. Call it once. Not inlined: the vehicle is built on the call stack and then copied to its place.
#[inline(never)]
pub fn start() -> &'static mut App {
    static APP: StaticCell<App> = StaticCell::new();

    let app = STACK.try_take().and_then(|stack| APP.try_init_with(|| App::new(stack)));
    app.unwrap_or_else(|| Board::reset())
}

/// The plans' partition: two slots, each of which holds all plans.
type Store = PlanStore<PsramFlash>;
const STORE_LEN: u32 = Store::region_len(MISSION, FENCE, RALLY);
const _: () = assert!(STORE_LEN <= PsramFlash::LEN);

/// The parameters' partition.
type Settings = ParamStore<PsramFlash>;
const SETTINGS_LEN: u32 = Settings::region_len(Tuning::INFO.len());
const _: () = assert!(SETTINGS_LEN <= PsramFlash::LEN);

/// The signing key's partition.
type Key = SigningStore<PsramFlash>;
const _: () = assert!(Key::REGION_LEN <= PsramFlash::LEN);

/// The storage of plans, parameters and key.
pub struct Memory {
    settings: Settings,
    key: Key,
    store: Store,
}

impl Memory {
    /// Creates the storage in these partitions.
    pub fn new([plans, settings, key]: [PsramFlash; 3]) -> Self {
        Self {
            settings: Settings::new(settings, 0..SETTINGS_LEN),
            key: Key::new(key, 0..Key::REGION_LEN),
            store: Store::new(plans, 0..STORE_LEN),
        }
    }

    /// Restores everything. Call it once, before anything else.
    pub fn restore(&mut self, app: &mut App, now: Instant) {
        // The stack has already reported errors by STATUSTEXT. The vehicle then uses default parameters and has no plans. Without
        // its key, links that require signatures stay closed.
        let _ = app.restore_parameters(now, &mut self.settings);
        let _ = app.restore_signing(now, &mut self.key);
        let _ = app.restore(now, &mut self.store, Durability::Durable);
    }

    /// Writes pending data, one step per call. Returns true when more work is pending.
    ///
    /// The simulated flash writes within microseconds, so the vehicle always permits it. If an erase stalls the processor, keep
    /// the default `may_persist`, which permits nothing while armed.
    pub fn persist(&mut self, app: &mut App, now: Instant) -> bool {
        let is_busy = app.persist(now, &mut self.store);
        let is_busy = app.persist_parameters(now, &mut self.settings) | is_busy;
        app.persist_signing(now, &mut self.key) | is_busy
    }
}
