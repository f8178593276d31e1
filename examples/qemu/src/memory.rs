//! How much the vehicle remembers, and what of it outlives a power cut.

use core::mem::MaybeUninit;

use mavstack::{Durability, Instant, ParamStore, ParamTable, PlanStore, SigningStore, plan_memory};
use mavstack_demo::{App, Tuning};

use crate::flash::PsramFlash;

/// What a microcontroller can afford: 32 bytes an item, and room for the largest plan once more, for uploads.
pub type DemoPlans = plan_memory!(mission: MISSION, fence: FENCE, rally: RALLY);
const MISSION: usize = 250;
const FENCE: usize = 64;
const RALLY: usize = 16;

/// The vehicle with its stack.
///
/// Not on the stack: it is larger than that should be. And not made by the compiler: its initial value, plan memory and all,
/// would lie in flash. The firmwares write it into a `static` at start.
pub type DemoApp = App<DemoPlans>;

/// The vehicle, written to its place. Apart from what calls it: it is made on the stack and then copied, which is to be over
/// before anything else wants stack.
#[inline(never)]
pub fn make(place: &'static mut MaybeUninit<DemoApp>) -> &'static mut DemoApp {
    place.write(DemoApp::new())
}

/// The plans' part of the flash: the front of it, two slots of which each holds all plans.
type Store = PlanStore<PsramFlash>;
const STORE_LEN: u32 = Store::region_len(MISSION, FENCE, RALLY);
const _: () = assert!(STORE_LEN <= PsramFlash::LEN);

/// The parameters' part of the flash.
type Settings = ParamStore<PsramFlash>;
const SETTINGS_LEN: u32 = Settings::region_len(Tuning::INFO.len());
const _: () = assert!(SETTINGS_LEN <= PsramFlash::LEN);

/// The signing key's part of the flash.
type Key = SigningStore<PsramFlash>;
const _: () = assert!(Key::REGION_LEN <= PsramFlash::LEN);

/// Plans, parameters and key in flash.
pub struct Memory {
    settings: Settings,
    key: Key,
    store: Store,
}

impl Memory {
    /// In these parts of the flash.
    pub fn new([plans, settings, key]: [PsramFlash; 3]) -> Self {
        Self {
            settings: Settings::new(settings, 0..SETTINGS_LEN),
            key: Key::new(key, 0..Key::REGION_LEN),
            store: Store::new(plans, 0..STORE_LEN),
        }
    }

    /// Reads everything back; once, before everything else.
    pub fn restore(&mut self, app: &mut DemoApp, now: Instant) {
        // An error was already reported by text. The vehicle then flies with default parameters and without plans; without its
        // key, links that would sign stay closed.
        let _ = app.restore_parameters(now, &mut self.settings);
        let _ = app.restore_signing(now, &mut self.key);
        let _ = app.restore(now, &mut self.store, Durability::Durable);
    }

    /// Writes pending data to storage, one step per pass. Returns true when there is more to do at once.
    ///
    /// The simulated flash writes within microseconds, so the vehicle always permits it. Where an erase stops the processor,
    /// keep the default `may_persist`, which permits nothing while armed.
    pub fn persist(&mut self, app: &mut DemoApp, now: Instant) -> bool {
        let is_busy = app.persist(now, &mut self.store);
        let is_busy = app.persist_parameters(now, &mut self.settings) | is_busy;
        app.persist_signing(now, &mut self.key) | is_busy
    }
}
