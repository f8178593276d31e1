//! What a change of a plan must pass before it is made: the vehicle's permission, the rate of writes, and room for the result
//! (M-27, M-44, C-15).

use super::validate::Problem;
use super::{Cx, Missions, Plans, Replies, increment};
use crate::dialect::MavMissionResult;
use crate::types::{Firmware, Peer, PlanType};

impl Missions {
    /// Whether a durable change has no free slot for its result. Its request is then dropped and counted.
    pub(super) fn lacks_result_slot(&mut self, replies: &Replies) -> bool {
        let lacks = self.is_durable() && replies.has_result();
        if lacks {
            increment(&mut self.counters.no_answer_slot);
        }
        lacks
    }

    /// Refuses a change to `count` items if the token bucket has too few tokens for the write (C-15).
    pub(super) fn may_write<F: Firmware>(
        &mut self,
        cx: &mut Cx<'_, F>,
        plan: PlanType,
        from: Peer,
        count: u16,
    ) -> Result<(), MavMissionResult> {
        if self.has_tokens(cx.now, &cx.plans, count) {
            return Ok(());
        }
        if let Some(refused) = self.refused.count(cx.now) {
            event!("{} change by {}: too many writes to storage; {=u32} refused so far", plan, from, refused);
        }
        Problem::RateLimited(plan).report(cx);
        Err(MavMissionResult::DENIED)
    }

    /// Asks for [permission](Self::permission), and reports a refusal (M-27, M-44).
    pub(super) fn may_change<F: Firmware<Vehicle: Plans>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        plan: PlanType,
        from: Peer,
    ) -> Result<(), MavMissionResult> {
        let Err(result) = self.permission(cx, plan, from, false) else { return Ok(()) };
        if let Some(refused) = self.refused.count(cx.now) {
            event!("{} change by {}: {=u8} by the vehicle; {=u32} refused so far", plan, from, result.0, refused);
        }
        Problem::Refused(plan, result.into()).report(cx);
        Err(result)
    }
}
