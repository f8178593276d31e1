//! The firmware's view of plans: live plans, reached items, and plans that the firmware loads itself.

use super::parts::HasPlans;
use super::{Cx, Declares, Stack, split};
use crate::message::Item;
use crate::service::command::Commands;
use crate::service::mission::{Missions, PlanCounters, PlanFault, Plans};
use crate::time::Instant;
use crate::types::{PlanMemory, PlanType, PlanView};

/// The live plans.
impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Returns a live plan: see [`mission`](Self::mission).
    pub fn plan(&self, plan: PlanType) -> PlanView<'_> {
        self.plans.live(plan)
    }

    /// Returns the live mission. It changes in one step, and only inside calls that are given the vehicle (M-39). Empty
    /// without `plans`.
    pub fn mission(&self) -> PlanView<'_> {
        self.plans.live(PlanType::Mission)
    }

    /// Returns the live geofence, in the same way.
    pub fn fence(&self) -> PlanView<'_> {
        self.plans.live(PlanType::Fence)
    }

    /// Returns the live rally points, in the same way.
    pub fn rally(&self) -> PlanView<'_> {
        self.plans.live(PlanType::Rally)
    }
}

/// Available if `#[stack]` has the entry `plans`.
impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Reports that the vehicle has reached a mission item. MISSION_ITEM_REACHED is sent on every normal link, before
    /// the next item becomes current there (M-91). Call it after the flight loop's step and before
    /// [`poll`](Self::poll).
    pub fn mission_item_reached(&mut self, now: Instant, seq: u16)
    where
        D::Mission: HasPlans<Part = Missions>,
        D::Vehicle: Plans + Commands,
    {
        let (links, repeats) = (self.shared.normal, self.shared.config.item_reached_repeats);
        let now = self.enter(now);
        self.services.mission.part_mut().reached(now, seq, links, repeats);
    }

    /// Makes `items` the live plan: a plan from a file, or the firmware's default plan. The items are checked as in an
    /// upload and take effect at once; with storage they are written later. An empty list clears the plan.
    ///
    /// # Errors
    ///
    /// Returns the fault of the plan, as for an upload; the live plan is then unchanged. [`DENIED`]: an upload is
    /// running, or the stack was not begun. [`UNSUPPORTED`]: there is no memory for such a plan.
    ///
    /// [`DENIED`]: crate::dialect::MavMissionResult::DENIED
    /// [`UNSUPPORTED`]: crate::dialect::MavMissionResult::UNSUPPORTED
    pub fn load_plan(
        &mut self,
        now: Instant,
        plan: PlanType,
        items: impl IntoIterator<Item = Item>,
        vehicle: &mut D::Vehicle,
    ) -> Result<(), PlanFault>
    where
        D::Mission: HasPlans<Part = Missions>,
        D::Vehicle: Plans + Commands,
    {
        if !plan.is_served(&D::Plans::CAPACITIES) {
            return Err(crate::dialect::MavMissionResult::UNSUPPORTED.into());
        }
        if !self.shared.is_begun() {
            return Err(crate::dialect::MavMissionResult::DENIED.into());
        }
        let (mut cx, services, ..) = split!(&mut *self, now, vehicle);
        services.mission.part_mut().load_plan(&mut cx, plan, items.into_iter())
    }

    /// Returns the counters of uploads.
    pub fn plan_counters(&self) -> PlanCounters
    where
        D::Mission: HasPlans<Part = Missions>,
        D::Vehicle: Plans + Commands,
    {
        *self.services.mission.part().counters()
    }
}
