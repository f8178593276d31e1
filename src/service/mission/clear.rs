//! Clearing: MISSION_CLEAR_ALL, of one plan or of all (M-50 to M-53).

use super::commit::Change;
use super::{Cx, Missions, Plans, Replies};
use crate::dialect::MavMissionType;
use crate::types::{Firmware, Peer, PlanType};

impl Missions {
    /// Handles MISSION_CLEAR_ALL for `only` one plan, or for all.
    pub(super) fn on_clear<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        from: Peer,
        replies: &mut Replies,
        only: Option<PlanType>,
    ) {
        let mission_type = only.map_or(MavMissionType::ALL, PlanType::mission_type);
        let is_on_other_link = self.is_on_other_link(cx.now, from);
        if let Some(commit) = self.committing_mut() {
            // A repeated clear is answered when the first one ends (M-52); anything else is denied.
            let is_repeated = commit.clears(only) && (is_on_other_link || commit.is_by(from, replies));
            return if is_repeated { self.out_of_place() } else { replies.deny(from, mission_type) };
        }
        if self.is_locked(cx.now, from) {
            // M-51
            return replies.deny(from, mission_type);
        }
        self.forget_answer(from, replies);
        self.abandon(&mut cx.plans);
        if self.is_clear(&cx.plans, only) {
            // M-52: even if the vehicle permits no changes.
            return self.clear(cx, from, replies, only);
        }
        // All or nothing: permission for every plan first, then the change.
        let permission = PlanType::ALL.into_iter().try_for_each(|plan| {
            let is_affected = cx.plans.capacity(plan) > 0 && only.is_none_or(|only| only == plan);
            if is_affected { self.may_change(cx, plan, from) } else { Ok(()) }
        });
        let named = only.unwrap_or(PlanType::Mission);
        if let Err(result) = permission.and_then(|()| self.may_write(cx, named, from, 0)) {
            replies.refuse(from, mission_type, result);
        } else if !self.lacks_result_slot(replies) {
            self.done = None;
            self.clear(cx, from, replies, only);
        }
    }

    /// Clears one plan, or all (M-50, M-53).
    pub(super) fn clear<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        from: Peer,
        replies: &mut Replies,
        only: Option<PlanType>,
    ) {
        if let Some(reply) = self.change(cx, from, Change::Clear(only)) {
            replies.push(reply);
        }
    }
}
