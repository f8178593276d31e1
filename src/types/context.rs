//! The context that the vehicle's hooks get.

use super::events::EventLog;
use super::link::LinkMask;
use super::plans::{PlanType, PlanView, PlansMut};
use super::requests::Requests;
use super::texts::StatusTexts;
use crate::dialect::MavSeverity;
use crate::time::Instant;

/// The context of a hook: the time, the live plans and parameters, and a way to report. Each hook that decides or
/// learns something gets one. Hooks that only describe the vehicle, such as [`Vehicle::state`](crate::Vehicle::state),
/// [`Plans::progress`](crate::Plans::progress) and [`Telemetry::fill`](crate::Telemetry::fill), get none: the stack asks
/// them whenever and as often as it needs, so they must have no effect.
///
/// Nothing in it calls back into the stack. Texts are queued and messages are remembered; they are sent when a link has
/// room.
pub struct Context<'a> {
    /// By the stack's clock.
    pub(crate) now: Instant,
    pub(crate) texts: &'a mut StatusTexts,
    pub(crate) requests: &'a mut Requests,
    pub(crate) events: &'a mut EventLog,
    pub(crate) normal: LinkMask,
    pub(crate) plans: &'a PlansMut<'a>,
    pub(crate) values: &'a [u32],
    /// Whether there is a slot for another long-running command.
    pub(crate) can_start: bool,
}

impl<'a> Context<'a> {
    /// Returns the time of the call, by the firmware's clock.
    pub fn now(&self) -> Instant {
        self.now - self.requests.lead
    }

    /// Sends a STATUSTEXT on every normal link: see [`Stack::text`](crate::Stack::text).
    pub fn text(&mut self, severity: MavSeverity, text: &(impl AsRef<[u8]> + ?Sized)) {
        self.texts.push(self.now, self.normal, severity, text.as_ref());
    }

    /// Reports that the vehicle has reached a mission item: see
    /// [`Stack::mission_item_reached`](crate::Stack::mission_item_reached). Returns false, and reports nothing, if four
    /// reports are pending for the next [`poll`](crate::Stack::poll).
    pub fn mission_item_reached(&mut self, seq: u16) -> bool {
        self.requests.reached.push(seq).is_ok()
    }

    /// Returns a live plan. It is empty if the vehicle has no plans of this kind.
    pub fn plan(&self, plan: PlanType) -> PlanView<'a> {
        self.plans.live(plan)
    }
}

impl core::fmt::Debug for Context<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Context").field("now", &self.now()).finish_non_exhaustive()
    }
}
