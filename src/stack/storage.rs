//! Persistence of plans and parameters: the code between the stack, a [`PlanStore`] and a [`ParamStore`] (M-44, P-17,
//! SEC-11, SEC-12).
//!
//! Writing is separate from polling, because an erase of a microcontroller's own flash stops the processor for 100 ms
//! and more. The firmware chooses when [`persist_plans`](Stack::persist_plans) and
//! [`persist_parameters`](Stack::persist_parameters) run. The vehicle is asked before each step, and all stores
//! together do one step per pass.

use embedded_storage::nor_flash::NorFlash;

use super::{Cx, Declares, PeerMemory, Stack, TextMemory, services::Services, split};
use crate::dialect::{MavModeFlag, MavSeverity};
use crate::service::command::Commands;
use crate::service::mission::{self, Durability, Missions, Plans};
use crate::service::param::{ParamService, ParamTable, Parameters, Work};
use crate::storage::{ParamStore, PlanStore, RestoreError, Step};
use crate::time::Instant;
use crate::types::{PlanType, Vehicle};

/// The texts that report the state of stored content.
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

/// Whether the vehicle is known to be disarmed. Otherwise stored content must not replace what it flies with.
fn is_disarmed(vehicle: &impl Vehicle) -> bool {
    vehicle.state().is_some_and(|state| !state.base_mode.contains(MavModeFlag::SAFETY_ARMED))
}

impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Reports the result of reading stored content by one of `texts`. `is_late`: an earlier attempt to read it failed.
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
}

/// With `plans`.
impl<D: Declares<Mission = Missions, Vehicle: Plans + Commands>, const LINKS: usize> Stack<D, LINKS> {
    /// Reads the plans at startup, and persists them in `store` from then on. Call it once, before the loop. It reads
    /// the whole record, and blocks for as long as the flash takes.
    ///
    /// The stack and the vehicle check the plans as in an upload. A plan that this firmware cannot fly, or has no room
    /// for, does not become live, and a text reports it. If nothing was ever stored, the plans are empty.
    ///
    /// # Errors
    ///
    /// Returns an error if the record is damaged or cannot be read (G-18), and a text reports it. The plans that were
    /// not read are empty: a vehicle that must not fly without its geofence learns here that there may have been one.
    /// The store is in use nevertheless.
    ///
    /// While the newest plans cannot be read, older ones do not replace them. [`persist_plans`](Self::persist_plans)
    /// reads again while the vehicle is disarmed. Plans that become readable then go live, unless another plan was
    /// uploaded meanwhile. [`plan_changed`](crate::Plans::plan_changed) informs the vehicle, and a text the operators.
    pub fn restore_plans<F: NorFlash>(
        &mut self,
        now: Instant,
        store: &mut PlanStore<F>,
        durability: Durability,
        vehicle: &mut D::Vehicle,
    ) -> Result<(), RestoreError<F::Error>> {
        self.services.mission.attach_storage(durability);
        self.services.mission.limit_storage(self.shared.config.storage_refill);
        let result = self.read_plans(now, store, vehicle, false);
        self.tell_restored(now, &result, &PLAN_TEXTS, false);
        result
    }

    /// Reads the stored plans: all of them, or only those whose live plan is empty.
    #[inline(never)]
    fn read_plans<F: NorFlash>(
        &mut self,
        now: Instant,
        store: &mut PlanStore<F>,
        vehicle: &mut D::Vehicle,
        keeps_plans: bool,
    ) -> Result<(), RestoreError<F::Error>> {
        let (mut cx, services, ..) = split!(&mut *self, now, vehicle);
        let missions = &mut services.mission;
        let Some((mut cx, vehicle)) = mission::work(&mut cx) else { return Ok(()) };
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

    /// Writes plans that are to be durable, one step per call: it erases at most one erase unit, or writes 256 bytes,
    /// and only while the vehicle [permits](crate::Vehicle::may_persist) it. It may block for as long as that takes.
    /// Returns true if more is to be done at once.
    ///
    /// With [`Durability::Durable`] the final answer to an upload waits for this: call it in every pass of the loop, or
    /// from an idle task. Between uploads it erases in advance, so that a plan is stored within a second of its last
    /// item even if an erase takes 100 ms.
    ///
    /// This call, [`persist_parameters`](Self::persist_parameters) and `persist_signing` share one step per pass. After
    /// one of them has done a step, the next call of each of the others does nothing and returns true, unless
    /// [`poll`](Self::poll) ran in between.
    pub fn persist_plans<F: NorFlash>(
        &mut self,
        now: Instant,
        store: &mut PlanStore<F>,
        vehicle: &mut D::Vehicle,
    ) -> bool {
        let step = self.store_plans(now, store, vehicle);
        if step == Step::Unread {
            let result = self.read_plans(now, store, vehicle, true);
            self.tell_restored(now, &result, &PLAN_TEXTS, true);
        }
        step != Step::Idle
    }

    #[inline(never)]
    fn store_plans<F: NorFlash>(&mut self, now: Instant, store: &mut PlanStore<F>, vehicle: &mut D::Vehicle) -> Step {
        let (mut cx, services, _, states) = split!(&mut *self, now, &mut *vehicle);
        let missions = &mut services.mission;
        let Some((mut cx, hooks)) = mission::work(&mut cx) else { return Step::Idle };
        let refused = missions.refused(&mut cx, hooks);
        if refused.is_some() {
            mission::queue_result(states.iter_mut().map(|state| &mut state.mission), refused);
            return Step::Busy;
        }
        // A running upload uses the memory that reading needs. In flight, only the operator changes plans.
        let may_step = if store.is_unread() {
            is_disarmed(hooks) && !missions.is_receiving()
        } else {
            hooks.may_persist() && !missions.storage_rests(now)
        };
        if !may_step {
            return Step::Idle;
        }
        if !self.turn.is_for(Turn::PLANS) {
            return Step::Busy;
        }
        let (mut cx, services, _, states) = split!(&mut *self, now, vehicle);
        let missions = &mut services.mission;
        let Some((mut cx, vehicle)) = mission::work(&mut cx) else { return Step::Idle };
        let step = store.step(now, missions.unsaved(&cx.plans));
        let owed = match step {
            Step::Idle | Step::Busy => None,
            Step::Done => missions.saved(&mut cx, vehicle),
            // Stored content comes first: the client gets ERROR, and tries again.
            Step::Unread if !missions.awaits_storage() => None,
            Step::Failed | Step::Unread => missions.not_saved(&mut cx),
        };
        mission::queue_result(states.iter_mut().map(|state| &mut state.mission), owed);
        self.turn.took(Turn::PLANS, step);
        step
    }
}

/// With `parameters` (P-17).
impl<D, const LINKS: usize> Stack<D, LINKS>
where
    D: Declares<Parameters: ParamTable, Param = ParamService>,
    D::Vehicle: Parameters<Table = D::Parameters>,
{
    /// Reads the parameters at startup, and persists them in `store` from then on. Call it once, before the loop. It
    /// reads the whole record, and blocks for as long as the flash takes. The vehicle is told of each value that is not
    /// the default.
    ///
    /// # Errors
    ///
    /// Returns an error if the record is damaged or cannot be read (G-18), and a text reports it. The parameters that
    /// were not read keep their values. The store is in use nevertheless.
    ///
    /// While the newest values cannot be read, older ones do not replace them.
    /// [`persist_parameters`](Self::persist_parameters) reads again while the vehicle is disarmed. It then restores the
    /// parameters that still have their defaults, and a text reports it.
    pub fn restore_parameters<F: NorFlash>(
        &mut self,
        now: Instant,
        store: &mut ParamStore<F>,
        vehicle: &mut D::Vehicle,
    ) -> Result<(), RestoreError<F::Error>> {
        self.services.param.limit(&mut self.parameters, self.shared.config.storage_refill);
        let result = self.read_parameters(now, store, vehicle, false);
        self.services.param.loaded(&mut self.parameters, !matches!(result, Err(RestoreError::Storage(_))));
        self.tell_restored(now, &result, &PARAMETER_TEXTS, false);
        result
    }

    /// Restores all parameters, or only those that have their defaults.
    #[inline(never)]
    fn read_parameters<F: NorFlash>(
        &mut self,
        now: Instant,
        store: &mut ParamStore<F>,
        vehicle: &mut D::Vehicle,
        keeps_values: bool,
    ) -> Result<(), RestoreError<F::Error>> {
        let (mut cx, services, ..) = split!(&mut *self, now, vehicle);
        for index in 0..store.open()? {
            if let Some(stored) = store.row(index)? {
                services.param.load(&mut cx, &stored, keeps_values);
            }
        }
        if store.is_damaged() { Err(RestoreError::Damaged) } else { Ok(()) }
    }

    /// Schedules the parameters that are not stored yet for writing at once, like MAV_CMD_PREFLIGHT_STORAGE: for use
    /// before a reboot. Afterwards, [`persist_parameters`](Self::persist_parameters) returns false once they are
    /// stored, or cannot be.
    pub fn save_parameters(&mut self, now: Instant) {
        self.services.param.hurry(now, &mut self.parameters);
    }

    /// Writes changed parameters, one step per call, as [`persist_plans`](Self::persist_plans) does: about a second
    /// after a change, at most every ten seconds, and only while the vehicle [permits](crate::Vehicle::may_persist) it.
    /// Returns true if more is to be done at once.
    pub fn persist_parameters<F: NorFlash>(
        &mut self,
        now: Instant,
        store: &mut ParamStore<F>,
        vehicle: &mut D::Vehicle,
    ) -> bool {
        let may_step = if store.is_unread() { is_disarmed(vehicle) } else { vehicle.may_persist() };
        if !may_step {
            return false;
        }
        if !self.turn.is_for(Turn::PARAMETERS) {
            return true;
        }
        if self.services.param.wants_reload(&mut self.parameters) {
            let _ = self.restore_parameters(now, store, vehicle);
        }
        let step = self.store_parameters(now, store);
        if step == Step::Unread {
            // A value that was set before the record could be read is newer.
            let result = self.read_parameters(now, store, vehicle, true);
            self.services.param.reread(now, &mut self.parameters, result.is_ok());
            self.tell_restored(now, &result, &PARAMETER_TEXTS, true);
        }
        self.turn.took(Turn::PARAMETERS, step);
        step != Step::Idle
    }

    #[inline(never)]
    fn store_parameters<F: NorFlash>(&mut self, now: Instant, store: &mut ParamStore<F>) -> Step {
        let (params, table) = (&mut self.services.param, &mut self.parameters);
        let job = params.unsaved(now, table);
        let step = store.step(now, &table.table_mut(), job);
        match step {
            Step::Idle | Step::Busy | Step::Unread => {}
            Step::Done => params.saved(now, table),
            Step::Failed => {
                let (texts, normal) = (self.texts.view_mut(), self.shared.normal);
                params.not_saved(&mut Work { now, texts, normal }, table);
            }
        }
        step
    }
}

/// Which store has done its step since the last poll. The other stores wait, so that erases do not add up.
///
/// Each of the others is deferred only once. A caller that retries without a poll, as before a reset, waits for storage
/// anyway.
#[derive(Debug)]
pub(super) struct Turn {
    owner: u8,
    deferred: u8,
}

impl Turn {
    pub(super) const FREE: Self = Self { owner: 0, deferred: 0 };
    const PLANS: u8 = 1;
    const PARAMETERS: u8 = 2;
    #[cfg(feature = "signing")]
    pub(super) const KEY: u8 = 4;

    /// Whether this store may do a step now.
    pub(super) fn is_for(&mut self, store: u8) -> bool {
        let is_free = self.owner == 0 || self.owner == store || self.deferred & store != 0;
        self.deferred |= if is_free { 0 } else { store };
        is_free
    }

    /// Records what this store did.
    pub(super) fn took(&mut self, store: u8, step: Step) {
        if step != Step::Idle {
            self.owner = store;
        }
    }
}
