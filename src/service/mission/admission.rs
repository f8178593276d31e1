//! What a change of a plan must pass before it is made: the vehicle's permission, the rate of writes, and room for the result
//! (M-27, M-44, C-15).

use super::validate::Problem;
use super::{Caller, Missions, Plans, Work};
use crate::dialect::MavMissionType;
use crate::service::increment;
use crate::types::PlanType;

impl Missions {
    /// Whether a durable change has no free slot for its result. Its request is then dropped and counted.
    pub(super) fn lacks_result_slot(&mut self, caller: &Caller<'_>) -> bool {
        let lacks = self.is_durable() && caller.replies.has_result();
        if lacks {
            increment(&mut self.counters.no_answer_slot);
        }
        lacks
    }

    /// Whether the token bucket has too few tokens for a change to `count` items; if so, queues the refusal (C-15).
    pub(super) fn is_rate_limited(
        &mut self,
        cx: &mut Work<'_, '_>,
        caller: &mut Caller<'_>,
        plan: PlanType,
        mission_type: MavMissionType,
        count: u16,
    ) -> bool {
        if self.has_tokens(cx, count) {
            return false;
        }
        if let Some(refused) = self.refused.count(cx.now) {
            event!("{} change by {}: too many writes to storage; {=u32} refused so far", plan, caller.from, refused);
        }
        cx.report(&Problem::RateLimited(plan));
        caller.deny(mission_type);
        true
    }

    /// Asks for [permission](Self::permission), and queues the answer to a refusal (M-27, M-44).
    pub(super) fn may_change<V: Plans>(
        &mut self,
        cx: &mut Work<'_, '_>,
        vehicle: &mut V,
        caller: &mut Caller<'_>,
        plan: PlanType,
        mission_type: MavMissionType,
    ) -> bool {
        let Err(result) = self.permission(cx, vehicle, plan, caller.from, false) else { return true };
        if let Some(refused) = self.refused.count(cx.now) {
            event!(
                "{} change by {}: {=u8} by the vehicle; {=u32} refused so far",
                plan,
                caller.from,
                result.0,
                refused
            );
        }
        cx.report(&Problem::Refused(plan, result.into()));
        caller.ack(mission_type, result, 0);
        false
    }
}
