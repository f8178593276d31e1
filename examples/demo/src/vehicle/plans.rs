//! Uploaded plans: which items the vehicle accepts, and how it uses new plans.

use mavstack::dialect::rules;
use mavstack::dialect::{MavCmd, MavFrame, MavMissionResult, MavResult, MavSeverity};
use mavstack::message::{LatLon, ParamRule};
use mavstack::plan::FirstWaypointLimit;
use mavstack::plan::PlanFault;
use mavstack::{Command, CommandRule, Context, Item, PlanChange, PlanType, Plans, Progress};

use super::commands::refuse;
use super::{Mode, Quadrotor, mission};
use crate::fence::{self, GROUPS};
use crate::plan;

/// Maximum distance of a mission's first waypoint from home (m), as in PX4.
const MAX_FIRST_WAYPOINT_DISTANCE: u32 = 10_000;

/// Supported frames. Terrain frames are not supported: the vehicle has no terrain model.
pub(super) const FRAMES: &[MavFrame] = &[MavFrame::GLOBAL, MavFrame::GLOBAL_RELATIVE_ALT];

/// The servos on the auxiliary outputs: 1 to [`SERVOS`](super::SERVOS).
pub(super) const SET_SERVO: CommandRule =
    rules::DO_SET_SERVO.with_params(&[ParamRule::integers(1, 1, 4), ParamRule::range(2, 800.0, 2_200.0)]);

impl Plans for Quadrotor {
    const MISSION_COMMANDS: &'static [CommandRule] = &[
        rules::NAV_WAYPOINT
            .with_frames(FRAMES)
            .with_params(&[ParamRule::at_least(1, 0.0).or_nan(), ParamRule::at_least(2, 0.0).or_nan()]),
        rules::NAV_LOITER_TIME
            .with_frames(FRAMES)
            .with_params(&[ParamRule::at_least(1, 0.0).or_nan(), ParamRule::any(2)]),
        rules::NAV_LOITER_UNLIM.with_frames(FRAMES),
        rules::NAV_LOITER_TURNS.with_frames(FRAMES).with_params(&[
            ParamRule::at_least(1, 0.0),
            ParamRule::any(2),
            ParamRule::any(3),
            ParamRule::any(4),
        ]),
        rules::NAV_RETURN_TO_LAUNCH,
        // Precision landing: off or opportunistic. The vehicle has no beacon receiver.
        rules::NAV_LAND.with_frames(FRAMES).with_params(&[ParamRule::integers(2, 0, 1).or_nan()]).altitude_optional(),
        rules::NAV_TAKEOFF.with_frames(FRAMES),
        // A delay only: the time of day is not supported.
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
        rules::DO_LAND_START,
        SET_SERVO,
        // The camera. The id of the camera is 0 for all, or its component.
        rules::DO_SET_CAM_TRIGG_DIST,
        rules::SET_CAMERA_MODE,
        rules::IMAGE_START_CAPTURE,
        rules::IMAGE_STOP_CAPTURE,
        rules::VIDEO_START_CAPTURE,
        rules::VIDEO_STOP_CAPTURE,
        // The gimbal.
        rules::DO_GIMBAL_MANAGER_PITCHYAW,
        rules::DO_GIMBAL_MANAGER_CONFIGURE,
        rules::DO_SET_ROI_LOCATION.with_frames(FRAMES),
        rules::DO_SET_ROI_WPNEXT_OFFSET,
        rules::DO_SET_ROI_NONE,
        rules::DO_MOUNT_CONFIGURE,
        rules::DO_MOUNT_CONTROL,
        // Horizontal speed only, without a throttle setting.
        rules::DO_CHANGE_SPEED.with_params(&[
            ParamRule::integers(1, 0, 1),
            ParamRule::at_least(2, -2.0),
            ParamRule::integers(3, -2, 0).or_nan(),
        ]),
    ];

    /// Returns the limit around home, once home is known.
    fn first_waypoint_limit(&self) -> Option<FirstWaypointLimit> {
        let home = self.home.spot;
        let (latitude, longitude) = self.home.to_global(home.north, home.east);
        let from = LatLon { latitude, longitude };
        self.last.has_fix.then_some(FirstWaypointLimit { from, distance: MAX_FIRST_WAYPOINT_DISTANCE })
    }

    fn limits_first_waypoint(&self) -> bool {
        true
    }

    fn check_item(
        &mut self,
        _: &mut Context<'_>,
        _plan: PlanType,
        _seq: u16,
        item: &Item,
    ) -> Result<(), MavMissionResult> {
        let [_, p2, ..] = item.params;
        if plan::is_for_payload(item.command) && !self.has_components {
            return Err(MavMissionResult::UNSUPPORTED);
        }
        let is_bad = match item.command {
            // -1 keeps the speed, -2 restores the default. At 0 the vehicle would never arrive.
            MavCmd::DO_CHANGE_SPEED => !(p2 > 0.0 || p2 == -1.0 || p2 == -2.0),
            MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION | MavCmd::NAV_FENCE_CIRCLE_INCLUSION => p2 >= GROUPS as f32,
            _ => false,
        };
        if is_bad { Err(MavMissionResult::INVALID_PARAM2) } else { Ok(()) }
    }

    /// While armed, refuses a fence that excludes the vehicle or within which it could not stop (M-82).
    fn check_plan(&mut self, cx: &mut Context<'_>, plan: PlanType, items: &[Item]) -> Result<(), PlanFault> {
        match plan {
            PlanType::Mission => mission::check(items),
            PlanType::Fence if self.armed => {
                let (from, to) = (self.body.position, self.body.ahead(self.last.margin));
                if fence::allows(self.home, items, from, to) {
                    return Ok(());
                }
                cx.text(MavSeverity::WARNING, "Fence refused: the vehicle is outside it");
                Err(MavMissionResult::DENIED.into())
            }
            PlanType::Fence | PlanType::Rally => Ok(()),
        }
    }

    fn plan_changed(&mut self, _: &mut Context<'_>, change: PlanChange<'_>) {
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

    fn set_current(&mut self, cx: &mut Context<'_>, seq: u16, reset: bool) -> MavResult {
        self.go_to_item(cx, seq, reset)
    }

    fn start_mission(
        &mut self,
        cx: &mut Context<'_>,
        command: &Command,
        first: Option<u16>,
        last: Option<u16>,
    ) -> MavResult {
        if command.is_broadcast {
            return refuse(cx, MavResult::DENIED, "Mission refused: sent to all vehicles");
        }
        if self.may_be_delayed(command.class) {
            return refuse(cx, MavResult::DENIED, "Mission refused: sent by satellite; use the radio");
        }
        self.fly_from_to(cx, first, last)
    }
}
