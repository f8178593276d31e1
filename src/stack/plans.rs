//! Plans as the firmware sees them: what is live, what was reached, what it brings itself.

use super::Stack;
use crate::service::mission::{Item, PlanCounters, PlanStorage, PlanType, PlanView};
use crate::time::Instant;
use crate::vehicle::{Autopilot, PlanFault};

impl<const LINKS: usize, P: PlanStorage, const PEERS: usize, const TEXTS: usize, const STREAMS: usize>
    Stack<LINKS, P, PEERS, TEXTS, STREAMS>
{
    /// The live mission: changes in one step, inside calls that are given the vehicle (M-39).
    pub fn mission(&self) -> PlanView<'_> {
        self.plans.live(PlanType::Mission)
    }

    /// The live geofence, in the same way.
    pub fn fence(&self) -> PlanView<'_> {
        self.plans.live(PlanType::Fence)
    }

    /// The live rally points, in the same way.
    pub fn rally(&self) -> PlanView<'_> {
        self.plans.live(PlanType::Rally)
    }

    /// The vehicle has reached an item of the mission: MISSION_ITEM_REACHED on every normal link, before the next item is
    /// current there (M-91). Call it after the flight loop's step and before [`poll`](Self::poll).
    pub fn mission_item_reached(&mut self, now: Instant, seq: u16) {
        if let Some((missions, _)) = self.plans.parts(&mut self.missions) {
            missions.reached(now, seq, self.core.normal, self.core.config.item_reached_repeats);
        }
    }

    /// Makes `items` the live plan: one from a file, or that the firmware is born with. They are checked as an upload is, and
    /// go live at once; where there is storage they are written later. No items clear the plan.
    ///
    /// # Errors
    ///
    /// What is wrong with the plan, which then stays as it was: as for an upload; [`DENIED`] while an upload runs, and
    /// [`UNSUPPORTED`] where there is no room for such a plan at all.
    ///
    /// [`DENIED`]: crate::dialect::MavMissionResult::DENIED
    /// [`UNSUPPORTED`]: crate::dialect::MavMissionResult::UNSUPPORTED
    pub fn load_plan<V: Autopilot>(
        &mut self,
        now: Instant,
        plan: PlanType,
        items: impl IntoIterator<Item = Item>,
        vehicle: &mut V,
    ) -> Result<(), PlanFault> {
        let unsupported = PlanFault::from(crate::dialect::MavMissionResult::UNSUPPORTED);
        if !plan.is_served(&P::CAPACITIES) {
            return Err(unsupported);
        }
        let (missions, mut plans) = self.plans.parts(&mut self.missions).ok_or(unsupported)?;
        let mut context = self.core.plan_context(now, &mut plans, &mut self.texts);
        let mut items = items.into_iter();
        missions.load(&mut context, vehicle, plan, None, |_| items.next())
    }

    /// What became of plans that were uploaded.
    pub fn plan_counters(&self) -> PlanCounters {
        P::engine(&self.missions).map(|missions| *missions.counters()).unwrap_or_default()
    }
}
