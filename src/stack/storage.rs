//! Plans and parameters that survive a power cut: what joins the stack, a [`PlanStore`] and a [`ParamStore`] (M-44, P-17,
//! SEC-11, SEC-12).
//!
//! Apart from polling: an erase of a microcontroller's own flash stops the processor for 100 ms and more, so the firmware
//! chooses when [`persist_plans`](Stack::persist_plans) and [`persist_parameters`](Stack::persist_parameters) run, and the vehicle is
//! asked before each step.

use embedded_storage::nor_flash::NorFlash;

use super::{Stack, owe};
use crate::dialect::MavSeverity;
use crate::message::Text;
use crate::service::mission::{Durability, PlanStorage, PlanType};
use crate::service::param::{self, ParamTable};
use crate::service::statustext::StatusTexts;
use crate::storage::{ParamStore, PlanStore, Step};
use crate::time::Instant;
use crate::vehicle::Autopilot;

impl<const LINKS: usize, P: PlanStorage, const PEERS: usize, const TEXTS: usize, const STREAMS: usize>
    Stack<LINKS, P, PEERS, TEXTS, STREAMS>
{
    /// Reads the plans back after a start, and keeps them in `store` from now on. Call it once, before the loop; it reads all
    /// of the record, which blocks for as long as the flash takes.
    ///
    /// What comes back is checked as an upload is, by the stack and the vehicle: a plan that this firmware cannot fly, or has
    /// no room for, is not live, and a text says so. Without a whole record the plans are empty.
    ///
    /// # Errors
    ///
    /// What the flash reported when it could not be read. The plans that were not read are empty then; the store is in use
    /// nevertheless.
    #[inline(never)]
    pub fn restore_plans<F: NorFlash, V: Autopilot>(
        &mut self,
        now: Instant,
        store: &mut PlanStore<F>,
        durability: Durability,
        vehicle: &mut V,
    ) -> Result<(), F::Error> {
        let Some((missions, mut plans)) = self.plans.parts(&mut self.missions) else { return Ok(()) };
        missions.attach_storage(durability);
        let mut cx = self.core.plan_context(now, &mut plans, &mut self.texts);
        let result = store.open().and_then(|stored| {
            let Some(stored) = stored else {
                if store.is_foreign() {
                    missions.stored_differs();
                }
                return Ok(());
            };
            for ((plan, count), id) in PlanType::ALL.into_iter().zip(stored.counts).zip(stored.ids) {
                let mut failure = None;
                let item = |seq| {
                    store.item(plan, seq).unwrap_or_else(|error| {
                        failure = Some(error);
                        None
                    })
                };
                let loaded = missions.load(&mut cx, vehicle, plan, Some((count, id)), item);
                if let Some(error) = failure {
                    return Err(error);
                }
                if let Err(fault) = loaded {
                    missions.stored_differs();
                    missions.tell_refused(&mut cx, plan, fault);
                }
            }
            Ok(())
        });
        if result.is_err() {
            missions.stored_differs();
        }
        if result.is_err() || store.is_impaired() {
            event!("plans: storage cannot be read");
            cx.texts.push(now, cx.normal, MavSeverity::ERROR, &Text::new("Stored plans cannot all be read"));
        }
        result
    }

    /// Writes plans that are to be durable, one step at a time: at most one erase unit is erased, or 256 bytes are written,
    /// and only while the vehicle [permits](crate::Plans::may_persist). May block for as long as that takes. True when there
    /// is more to do at once.
    ///
    /// With [`Durability::Durable`] an upload's final answer waits for this: call it in every pass of the loop, or from an
    /// idle task. Between uploads it erases ahead of need, so that a plan is stored within a second of its last item even where
    /// an erase takes 100 ms.
    #[inline(never)]
    pub fn persist_plans<F: NorFlash, V: Autopilot>(
        &mut self,
        now: Instant,
        store: &mut PlanStore<F>,
        vehicle: &mut V,
    ) -> bool {
        let Some((missions, mut plans)) = self.plans.parts(&mut self.missions) else { return false };
        if missions.storage_rests(now) || !vehicle.may_persist() {
            return false;
        }
        let step = store.step(missions.unsaved(&plans));
        let mut cx = self.core.plan_context(now, &mut plans, &mut self.texts);
        let owed = match step {
            Step::Idle => return false,
            Step::Busy => return true,
            Step::Done => missions.saved(&mut cx, vehicle),
            Step::Failed => missions.not_saved(&mut cx),
        };
        owe(&mut self.links, owed);
        true
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
    /// What the flash reported when it could not be read. The parameters that were not read have their defaults then; the store
    /// is in use nevertheless.
    #[inline(never)]
    pub fn restore_parameters<F: NorFlash, V: Autopilot>(
        &mut self,
        now: Instant,
        store: &mut ParamStore<F>,
        vehicle: &mut V,
    ) -> Result<(), F::Error> {
        let core = &mut self.core;
        let result = store.open().and_then(|rows| {
            for index in 0..rows {
                if let Some(stored) = store.row(index)? {
                    core.params.load(vehicle, &stored, core.normal);
                }
            }
            Ok(())
        });
        core.params.loaded(vehicle);
        if result.is_err() {
            event!("parameters: storage cannot be read");
            let texts: &mut StatusTexts = &mut self.texts;
            texts.push(now, core.normal, MavSeverity::ERROR, &Text::new("Stored parameters cannot be read"));
        }
        result
    }

    /// Has parameters that are not stored yet written at once, as MAV_CMD_PREFLIGHT_STORAGE does: before a reboot. From the
    /// next call of [`persist_parameters`](Self::persist_parameters) on, false says that they are, or cannot be.
    pub fn save_parameters<V: Autopilot>(&mut self, now: Instant, vehicle: &mut V) {
        self.core.params.hurry(now, vehicle);
    }

    /// Writes parameters that have changed, one step at a time, as [`persist_plans`](Self::persist_plans) does with plans: about a second
    /// behind a change, not more often than every ten seconds, and only while the vehicle
    /// [permits](crate::Plans::may_persist). True when there is more to do at once.
    #[inline(never)]
    pub fn persist_parameters<F: NorFlash, V: Autopilot>(
        &mut self,
        now: Instant,
        store: &mut ParamStore<F>,
        vehicle: &mut V,
    ) -> bool {
        if !vehicle.may_persist() {
            return false;
        }
        if self.core.params.wants_reload(vehicle) {
            let _ = self.restore_parameters(now, store, vehicle);
        }
        let params = &mut self.core.params;
        let job = params.unsaved(now, vehicle);
        let Some(table) = vehicle.parameters_mut() else { return false };
        match store.step(&table.table_mut(), job) {
            Step::Idle => return false,
            Step::Busy => {}
            Step::Done => params.saved(now, vehicle),
            Step::Failed => {
                let texts: &mut StatusTexts = &mut self.texts;
                params.not_saved(&mut param::Context { now, texts, normal: self.core.normal }, vehicle);
            }
        }
        true
    }
}
