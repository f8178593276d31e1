//! Plans and parameters that survive a power cut: what joins the stack, a [`PlanStore`] and a [`ParamStore`] (M-44, P-17,
//! SEC-11, SEC-12).
//!
//! Writing is separate from polling: an erase of a microcontroller's own flash stops the processor for 100 ms and more. So the
//! firmware chooses when [`persist_plans`](Stack::persist_plans) and [`persist_parameters`](Stack::persist_parameters) run, the
//! vehicle is asked before each step, and all stores together do one step per pass.

use embedded_storage::nor_flash::NorFlash;

use super::{Stack, owe};
use crate::dialect::{MavModeFlag, MavSeverity};
use crate::service::mission::{Durability, PlanStorage, PlanType};
use crate::service::param::{self, ParamTable};
use crate::service::statustext::StatusTexts;
use crate::storage::{ParamStore, PlanStore, RestoreError, Step};
use crate::time::Instant;
use crate::vehicle::Autopilot;

/// What the operators are told of stored content.
pub(super) struct RestoreTexts {
    pub(super) unreadable: &'static str,
    pub(super) damaged: &'static str,
    pub(super) readable: &'static str,
}

const PLAN_TEXTS: RestoreTexts = RestoreTexts {
    unreadable: "Stored plans cannot all be read",
    damaged: "Stored plans are damaged",
    readable: "Stored plans can be read again",
};

const PARAMETER_TEXTS: RestoreTexts = RestoreTexts {
    unreadable: "Stored parameters cannot be read",
    damaged: "Stored parameters are damaged",
    readable: "Stored parameters can be read again",
};

/// Whether the vehicle is known to be disarmed: what it flies with is not changed from storage otherwise.
fn is_disarmed<V: Autopilot>(vehicle: &V) -> bool {
    vehicle.state().is_some_and(|state| !state.base_mode.contains(MavModeFlag::SAFETY_ARMED))
}

impl<const LINKS: usize, P: PlanStorage, const PEERS: usize, const TEXTS: usize, const STREAMS: usize>
    Stack<LINKS, P, PEERS, TEXTS, STREAMS>
{
    /// Reads the plans back after a start, and keeps them in `store` from now on. Call it once, before the loop; it reads all
    /// of the record, which blocks for as long as the flash takes.
    ///
    /// What comes back is checked as an upload is, by the stack and the vehicle: a plan that this firmware cannot fly, or has
    /// no room for, does not become live, and a text says so. If nothing was ever stored, the plans are empty.
    ///
    /// # Errors
    ///
    /// What is stored is damaged, or cannot be read (G-18). A text says so, and the plans that were not read are empty: a vehicle
    /// that must not fly without its geofence learns here that there may have been one. The store is in use nevertheless.
    ///
    /// As long as the newest plans cannot be read, older ones do not stand in for them. [`persist_plans`](Self::persist_plans)
    /// reads again while the vehicle is disarmed. Plans that come back then are live, unless another plan was uploaded meanwhile;
    /// the vehicle is told by [`plan_changed`](crate::Plans::plan_changed), the operators by a text.
    pub fn restore_plans<F: NorFlash, V: Autopilot>(
        &mut self,
        now: Instant,
        store: &mut PlanStore<F>,
        durability: Durability,
        vehicle: &mut V,
    ) -> Result<(), RestoreError<F::Error>> {
        if let Some((missions, _)) = self.plans.parts(&mut self.missions) {
            missions.attach_storage(durability);
            missions.limit_storage(self.core.config.storage_refill);
        }
        let result = self.read_plans(now, store, vehicle, false);
        self.tell_restored(now, &result, &PLAN_TEXTS, false);
        result
    }

    /// Tells the operators what became of stored content: one of `texts`. `is_late`: it could not be read before.
    pub(super) fn tell_restored<E>(
        &mut self,
        now: Instant,
        result: &Result<(), RestoreError<E>>,
        texts: &RestoreTexts,
        is_late: bool,
    ) {
        let (severity, text) = match result {
            Ok(()) if is_late => (MavSeverity::INFO, texts.readable),
            Ok(()) => return,
            Err(RestoreError::Storage(_)) if is_late => return,
            Err(RestoreError::Storage(_)) => (MavSeverity::ERROR, texts.unreadable),
            Err(_) => (MavSeverity::ERROR, texts.damaged),
        };
        event!("storage: {=str}", text);
        self.push_text(now, severity, text.as_bytes());
    }

    /// Reads what is stored, of all plans or of those that are empty.
    #[inline(never)]
    fn read_plans<F: NorFlash, V: Autopilot>(
        &mut self,
        now: Instant,
        store: &mut PlanStore<F>,
        vehicle: &mut V,
        keeps_plans: bool,
    ) -> Result<(), RestoreError<F::Error>> {
        let Some((missions, mut plans)) = self.plans.parts(&mut self.missions) else { return Ok(()) };
        let mut cx = self.core.plan_context(now, &mut plans, &mut self.texts);
        missions.stored_differs(true);
        let Some(stored) = store.open()? else {
            missions.stored_differs(store.is_impaired());
            return Ok(());
        };
        let mut differs = store.is_impaired() || store.is_damaged();
        for ((plan, count), id) in PlanType::ALL.into_iter().zip(stored.counts).zip(stored.ids) {
            // A plan that was uploaded in the meantime is newer.
            if keeps_plans && cx.plans.count(plan) > 0 {
                continue;
            }
            let mut failure = None;
            let item = |seq| {
                store.item(plan, seq).unwrap_or_else(|error| {
                    failure = Some(error);
                    None
                })
            };
            let loaded = missions.load(&mut cx, vehicle, plan, Some((count, id)), item);
            if let Some(error) = failure {
                return Err(RestoreError::Storage(error));
            }
            if let Err(fault) = loaded {
                differs = true;
                missions.tell_refused(&mut cx, plan, fault);
            }
        }
        missions.stored_differs(differs);
        if store.is_damaged() { Err(RestoreError::Damaged) } else { Ok(()) }
    }

    /// Writes plans that are to be durable, one step at a time: at most one erase unit is erased, or 256 bytes are written,
    /// and only while the vehicle [permits](crate::Plans::may_persist). May block for as long as that takes. True when there
    /// is more to do at once.
    ///
    /// With [`Durability::Durable`] an upload's final answer waits for this: call it in every pass of the loop, or from an
    /// idle task. Between uploads it erases ahead of need, so that a plan is stored within a second of its last item even where
    /// an erase takes 100 ms.
    ///
    /// This call, [`persist_parameters`](Self::persist_parameters) and `persist_signing` share one step per pass: after one of
    /// them has done a step, the next call of each of the others does nothing and returns true, unless [`poll`](Self::poll) ran
    /// in between.
    pub fn persist_plans<F: NorFlash, V: Autopilot>(
        &mut self,
        now: Instant,
        store: &mut PlanStore<F>,
        vehicle: &mut V,
    ) -> bool {
        let step = self.store_plans(now, store, vehicle);
        if step == Step::Unread {
            let result = self.read_plans(now, store, vehicle, true);
            self.tell_restored(now, &result, &PLAN_TEXTS, true);
        }
        step != Step::Idle
    }

    #[inline(never)]
    fn store_plans<F: NorFlash, V: Autopilot>(
        &mut self,
        now: Instant,
        store: &mut PlanStore<F>,
        vehicle: &mut V,
    ) -> Step {
        let Some((missions, mut plans)) = self.plans.parts(&mut self.missions) else { return Step::Idle };
        let refused = missions.refused(&mut self.core.plan_context(now, &mut plans, &mut self.texts), vehicle);
        if refused.is_some() {
            owe(&mut self.links, refused);
            return Step::Busy;
        }
        // An upload has the room that is needed for reading, and no plan changes in flight but by the operator.
        let may_step = if store.is_unread() {
            is_disarmed(vehicle) && !missions.is_receiving()
        } else {
            vehicle.may_persist() && !missions.storage_rests(now)
        };
        if !may_step {
            return Step::Idle;
        }
        if !self.core.turn.is_for(Turn::PLANS) {
            return Step::Busy;
        }
        let step = store.step(now, missions.unsaved(&plans));
        self.core.turn.took(Turn::PLANS, step);
        let mut cx = self.core.plan_context(now, &mut plans, &mut self.texts);
        let owed = match step {
            Step::Idle | Step::Busy => None,
            Step::Done => missions.saved(&mut cx, vehicle),
            // What is stored comes first: the client is told ERROR, and tries again.
            Step::Unread if !missions.awaits_storage() => None,
            Step::Failed | Step::Unread => missions.not_saved(&mut cx),
        };
        owe(&mut self.links, owed);
        step
    }
}

/// The parameters, in the same way (P-17).
impl<const LINKS: usize, P: PlanStorage, const PEERS: usize, const TEXTS: usize, const STREAMS: usize>
    Stack<LINKS, P, PEERS, TEXTS, STREAMS>
{
    /// Reads the parameters back after a start, and keeps them in `store` from now on. Call it once, before the loop; it reads
    /// all of the record, which blocks for as long as the flash takes. The vehicle is told of each value that is not the
    /// default.
    ///
    /// # Errors
    ///
    /// What is stored is damaged, or cannot be read (G-18). The parameters that were not read stay as they are, and a text says
    /// so; the store is in use nevertheless.
    ///
    /// As long as the newest values cannot be read, older ones do not stand in for them.
    /// [`persist_parameters`](Self::persist_parameters) reads again while the vehicle is disarmed. Parameters that still have
    /// their defaults come back then, and a text says so.
    pub fn restore_parameters<F: NorFlash, V: Autopilot>(
        &mut self,
        now: Instant,
        store: &mut ParamStore<F>,
        vehicle: &mut V,
    ) -> Result<(), RestoreError<F::Error>> {
        self.core.params.limit(vehicle, self.core.config.storage_refill);
        let result = self.read_parameters(store, vehicle, false);
        self.core.params.loaded(vehicle, !matches!(result, Err(RestoreError::Storage(_))));
        self.tell_restored(now, &result, &PARAMETER_TEXTS, false);
        result
    }

    /// Restores all parameters, or only those that have their defaults.
    #[inline(never)]
    fn read_parameters<F: NorFlash, V: Autopilot>(
        &mut self,
        store: &mut ParamStore<F>,
        vehicle: &mut V,
        keeps_values: bool,
    ) -> Result<(), RestoreError<F::Error>> {
        let core = &mut self.core;
        for index in 0..store.open()? {
            if let Some(stored) = store.row(index)? {
                core.params.load(vehicle, &stored, core.normal, keeps_values);
            }
        }
        if store.is_damaged() { Err(RestoreError::Damaged) } else { Ok(()) }
    }

    /// Has parameters that are not stored yet written at once, as MAV_CMD_PREFLIGHT_STORAGE does: before a reboot. From the
    /// next call of [`persist_parameters`](Self::persist_parameters) on, false says that they are, or cannot be.
    pub fn save_parameters<V: Autopilot>(&mut self, now: Instant, vehicle: &mut V) {
        self.core.params.hurry(now, vehicle);
    }

    /// Writes parameters that have changed, one step at a time, as [`persist_plans`](Self::persist_plans) does with plans: about a second
    /// behind a change, not more often than every ten seconds, and only while the vehicle
    /// [permits](crate::Plans::may_persist). True when there is more to do at once.
    pub fn persist_parameters<F: NorFlash, V: Autopilot>(
        &mut self,
        now: Instant,
        store: &mut ParamStore<F>,
        vehicle: &mut V,
    ) -> bool {
        let may_step = if store.is_unread() { is_disarmed(vehicle) } else { vehicle.may_persist() };
        if vehicle.parameters_mut().is_none() || !may_step {
            return false;
        }
        if !self.core.turn.is_for(Turn::PARAMETERS) {
            return true;
        }
        if self.core.params.wants_reload(vehicle) {
            let _ = self.restore_parameters(now, store, vehicle);
        }
        let step = self.store_parameters(now, store, vehicle);
        if step == Step::Unread {
            // What was set before this could be read is newer.
            let result = self.read_parameters(store, vehicle, true);
            self.core.params.reread(now, vehicle, result.is_ok());
            self.tell_restored(now, &result, &PARAMETER_TEXTS, true);
        }
        self.core.turn.took(Turn::PARAMETERS, step);
        step != Step::Idle
    }

    #[inline(never)]
    fn store_parameters<F: NorFlash, V: Autopilot>(
        &mut self,
        now: Instant,
        store: &mut ParamStore<F>,
        vehicle: &mut V,
    ) -> Step {
        let params = &mut self.core.params;
        let job = params.unsaved(now, vehicle);
        let Some(table) = vehicle.parameters_mut() else { return Step::Idle };
        let step = store.step(now, &table.table_mut(), job);
        match step {
            Step::Idle | Step::Busy | Step::Unread => {}
            Step::Done => params.saved(now, vehicle),
            Step::Failed => {
                let texts: &mut StatusTexts = &mut self.texts;
                params.not_saved(&mut param::Context { now, texts, normal: self.core.normal }, vehicle);
            }
        }
        step
    }
}

/// Which store has done its step since the last poll. The others wait, so that their erases do not add up.
///
/// Each of the others is deferred only once: a caller that retries without a poll, as before a reset, waits for storage
/// anyway.
#[derive(Debug)]
pub(super) struct Turn {
    holder: u8,
    refused: u8,
}

impl Turn {
    pub(super) const FREE: Self = Self { holder: 0, refused: 0 };
    const PLANS: u8 = 1;
    const PARAMETERS: u8 = 2;
    #[cfg(feature = "signing")]
    pub(super) const KEY: u8 = 4;

    /// Whether this store may do a step now.
    pub(super) fn is_for(&mut self, store: u8) -> bool {
        let is_free = self.holder == 0 || self.holder == store || self.refused & store != 0;
        self.refused |= if is_free { 0 } else { store };
        is_free
    }

    /// Records what this store did.
    pub(super) fn took(&mut self, store: u8, step: Step) {
        if step != Step::Idle {
            self.holder = store;
        }
    }
}
