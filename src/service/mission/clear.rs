//! Clearing: MISSION_CLEAR_ALL, of one plan or of all (M-50 to M-53).

use super::commit::Change;
use super::{Caller, Missions, Plans, Work};
use crate::dialect::MavMissionType;
use crate::types::PlanType;

impl Missions {
    /// Handles MISSION_CLEAR_ALL.
    #[inline(never)]
    pub(super) fn on_clear<V: Plans>(
        &mut self,
        cx: &mut Work<'_, '_>,
        vehicle: &mut V,
        caller: &mut Caller<'_>,
        mission_type: MavMissionType,
    ) {
        let only = match mission_type {
            MavMissionType::ALL => None,
            _ => match caller.plan(cx, mission_type) {
                Ok(plan) => Some(plan),
                Err(result) => return caller.ack(mission_type, result, 0),
            },
        };
        let is_on_other_link = self.is_on_other_link(cx.now, caller.from);
        if let Some(commit) = self.committing_mut() {
            // A repeated clear is answered when the first one ends (M-52); anything else is denied.
            let is_repeated = commit.clears(mission_type) && (is_on_other_link || commit.is_by(caller));
            return if is_repeated { self.out_of_place() } else { caller.deny(mission_type) };
        }
        if self.is_locked(cx.now, caller) {
            // M-51
            return caller.deny(mission_type);
        }
        self.forget_answer(caller);
        self.abandon(cx);
        if self.is_clear(cx, only) {
            // M-52: even if the vehicle permits no changes.
            return self.clear(cx, vehicle, caller, mission_type, only);
        }
        // All or nothing: permission for every plan first, then the change.
        for plan in PlanType::ALL {
            let is_affected = cx.plans.capacity(plan) > 0 && only.is_none_or(|only| only == plan);
            if is_affected && !self.may_change(cx, vehicle, caller, plan, mission_type) {
                return;
            }
        }
        let named = only.unwrap_or(PlanType::Mission);
        if !self.is_rate_limited(cx, caller, named, mission_type, 0) && !self.lacks_result_slot(caller) {
            self.done = None;
            self.clear(cx, vehicle, caller, mission_type, only);
        }
    }

    /// Clears one plan, or all (M-50, M-53).
    pub(super) fn clear<V: Plans>(
        &mut self,
        cx: &mut Work<'_, '_>,
        vehicle: &mut V,
        caller: &mut Caller<'_>,
        mission_type: MavMissionType,
        only: Option<PlanType>,
    ) {
        if let Some(reply) = self.change(cx, vehicle, caller.from, mission_type, Change::Clear(only)) {
            caller.replies.push(reply);
        }
    }
}
