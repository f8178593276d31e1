//! Events and arming checks.

use mavstack::dialect::MavResult;
use mavstack::events::HealthReport;
use mavstack::prelude::*;

mavstack::events! {
    /// The events of this boat.
    pub struct BoatEvents in "boat" {
        // HEARTBEAT.custom_mode of each group of modes.
        modes ModeGroups { /** Manual */ MANUAL = [1], /** Automatic */ AUTOMATIC = [2, 3] }
        components Health { /** GPS */ GPS, /** Hull */ HULL }
        arming_checks {
            /// Wait until the GPS has a position.
            NoFix(Error) { satellites: u8 } = "No GPS fix, {3} satellites";
        }
        events {
            /// Return before it sinks.
            Leaking(Critical) { litres: f32 } = "Leak: {1:.1} l";
        }
    }
}

#[derive(Stack)]
#[stack(vehicle: Boat, links: 1, events: { history: 16, checks })]
struct Mavlink;

struct Boat {
    satellites: u8,
}

impl HealthChecks for Boat {
    type Events = BoatEvents;

    fn checks(&self, _: &Context<'_>, report: &mut HealthReport<'_>) {
        report.present(Health::GPS);
        if self.satellites < 6 {
            report.fails(ModeGroups::AUTOMATIC, Health::GPS, &NoFix { satellites: self.satellites });
        }
    }
}

impl Boat {
    /// Whether the command to arm is accepted: decided by the same checks.
    fn can_arm(&self, cx: &Context<'_>) -> bool {
        HealthReport::of(self, cx).can_arm(ModeGroups::AUTOMATIC)
    }

    fn on_leak(&self, cx: &mut Context<'_>, litres: f32) {
        cx.event(&Leaking { litres });
    }
}

impl Vehicle for Boat {
    fn state(&self) -> Option<VehicleState> {
        None
    }
}

impl Commands for Boat {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}
