//! Clearing a plan.

use super::{Timing, ack_of, refused, target};
use crate::failure::plan_name;
use crate::{Dialogue, Due, Failure, Io, Received, Retry};
use mavstack::PlanType;
use mavstack::dialect::{MavMissionResult, MissionClearAll};

/// Clears a plan.
#[derive(Clone, Debug)]
pub struct Clear {
    plan: PlanType,
    retry: Option<Retry>,
    result: Option<MavMissionResult>,
}

impl Clear {
    /// Creates the dialogue.
    pub fn new(plan: PlanType) -> Self {
        Self { plan, retry: None, result: None }
    }
}

impl Dialogue for Clear {
    type Output = ();

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<(), Failure>> {
        match self.result {
            Some(MavMissionResult::ACCEPTED) => return Some(Ok(())),
            Some(result) => return Some(Err(refused(self.plan, None, result))),
            None => {}
        }
        let timing = Timing::of(io.client());
        let retry = self.retry.get_or_insert(Retry::new(timing.wait, timing.tries));
        match retry.due(io.now()) {
            Due::Wait => None,
            Due::Send => {
                let (target_system, target_component) = target(io);
                let mission_type = self.plan.mission_type();
                io.send(&MissionClearAll { target_system, target_component, mission_type });
                None
            }
            Due::GiveUp => {
                let request = format!("MISSION_CLEAR_ALL of the {}", plan_name(self.plan));
                Some(Err(Failure::timeout(request, retry.tries())))
            }
        }
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let Some(ack) = ack_of(io, frame, self.plan).filter(|_| self.retry.is_some()) {
            self.result = Some(ack.r#type);
        }
    }
}
