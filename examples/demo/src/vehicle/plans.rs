//! Plans that are uploaded: which of them the vehicle takes, and what becomes of them.

use mavstack::dialect::command_rules as rules;
use mavstack::dialect::{MavCmd, MavFrame, MavMissionResult, MavResult, MavSeverity};
use mavstack::{Command, CommandRule, Item, LatLon, ParamRule, PlanChange, PlanFault, PlanType, Plans, Progress};

use super::{Mode, Quadrotor, mission};
use crate::fence::{self, GROUPS};

/// Maximum distance of a mission's first waypoint from home (m), as in PX4.
const FAR: u32 = 10_000;

/// It has no model of the terrain.
pub(super) const FRAMES: &[MavFrame] = &[MavFrame::GLOBAL, MavFrame::GLOBAL_RELATIVE_ALT];

impl Plans for Quadrotor {
    const MISSION_COMMANDS: &'static [CommandRule] = &[
        rules::NAV_WAYPOINT
            .with_frames(FRAMES)
            .with_params(&[ParamRule::at_least(1, 0.0).or_nan(), ParamRule::at_least(2, 0.0).or_nan()]),
        rules::NAV_LOITER_TIME
            .with_frames(FRAMES)
            .with_params(&[ParamRule::at_least(1, 0.0).or_nan(), ParamRule::any(2)]),
        rules::NAV_LOITER_UNLIM.with_frames(FRAMES),
        rules::NAV_RETURN_TO_LAUNCH,
        // No landing by a beacon; "if there is one" will do.
        rules::NAV_LAND.with_frames(FRAMES).with_params(&[ParamRule::integers(2, 0, 1).or_nan()]).altitude_optional(),
        rules::NAV_TAKEOFF.with_frames(FRAMES),
        // It has no clock: a delay, and no time of day.
        rules::NAV_DELAY.with_params(&[
            ParamRule::at_least(1, f32::MIN_POSITIVE),
            ParamRule::integers(2, -1, 0).or_nan(),
            ParamRule::integers(3, -1, 0).or_nan(),
            ParamRule::integers(4, -1, 0).or_nan(),
        ]),
        rules::CONDITION_DELAY,
        rules::CONDITION_DISTANCE,
        rules::CONDITION_YAW,
        rules::DO_JUMP,
        // The horizontal speed, and no throttle.
        rules::DO_CHANGE_SPEED.with_params(&[
            ParamRule::integers(1, 0, 1),
            ParamRule::at_least(2, -2.0),
            ParamRule::integers(3, -2, 0).or_nan(),
        ]),
    ];

    /// Measured from home, once it is known.
    fn first_waypoint_limit(&self) -> Option<(LatLon, u32)> {
        let home = self.home.spot;
        let (latitude, longitude) = self.home.to_global(home.north, home.east);
        self.has_fix().then_some((LatLon { latitude, longitude }, FAR))
    }

    /// The examples' storage writes within microseconds, so writing is permitted in flight too. On a microcontroller's own flash
    /// remove this override: by default nothing is written while armed.
    fn may_persist(&self) -> bool {
        true
    }

    fn check_item(&mut self, _plan: PlanType, _seq: u16, item: &Item) -> Result<(), MavMissionResult> {
        let [_, p2, ..] = item.params;
        let is_bad = match item.command {
            // -1 keeps the speed, -2 is the default; there is nothing between them, and at 0 it would never arrive.
            MavCmd::DO_CHANGE_SPEED => !(p2 > 0.0 || p2 == -1.0 || p2 == -2.0),
            MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION | MavCmd::NAV_FENCE_CIRCLE_INCLUSION => p2 >= GROUPS as f32,
            _ => false,
        };
        if is_bad { Err(MavMissionResult::INVALID_PARAM2) } else { Ok(()) }
    }

    /// A fence that the vehicle would be outside of, or could not stop inside of, is refused while it is armed (M-82).
    fn check_plan(&mut self, plan: PlanType, items: &[Item]) -> Result<(), PlanFault> {
        match plan {
            PlanType::Mission => mission::check(items),
            PlanType::Fence if self.armed => {
                let (from, to) = (self.body.position, self.body.ahead(self.fence_margin()));
                if fence::allows(self.home, items, from, to) {
                    return Ok(());
                }
                self.say(MavSeverity::WARNING, "Fence refused: the vehicle is outside of it");
                Err(MavMissionResult::DENIED.into())
            }
            PlanType::Fence | PlanType::Rally => Ok(()),
        }
    }

    fn plan_changed(&mut self, change: PlanChange<'_>) {
        if change.plan == PlanType::Mission {
            self.replace_mission(u16::try_from(change.items.len()).unwrap_or(u16::MAX), change.first);
        }
    }

    fn progress(&self) -> Progress {
        Progress {
            current: self.mission.current(),
            state: self.mission.state(),
            in_mission_mode: self.mode == Mode::Mission,
        }
    }

    fn set_current(&mut self, seq: u16, reset: bool) -> MavResult {
        self.go_to_item(seq, reset)
    }

    fn start_mission(&mut self, command: &Command, first: Option<u16>, last: Option<u16>) -> MavResult {
        if command.is_broadcast {
            return self.refuse(MavResult::DENIED, "Mission refused: sent to all vehicles");
        }
        if self.may_be_late(command.class) {
            return self.refuse(MavResult::DENIED, "Mission refused: by satellite");
        }
        self.fly_from_to(first, last)
    }
}
