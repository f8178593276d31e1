//! The plan service's interface to the vehicle.

use super::distance::{FirstWaypointLimit, first_too_far};
use super::problem::{PlanFault, Problem};
use crate::dialect::{MavMissionResult, MavResult, MissionState};
use crate::message::{CommandRule, Item};
use crate::types::{Command, Context, Peer, PlanType, Vehicle};

/// A plan that has just become live.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PlanChange<'a> {
    /// Which plan.
    pub plan: PlanType,
    /// The whole new plan; empty if the plan was cleared.
    pub items: &'a [Item],
    /// The item to start from: the first one uploaded with `current` set, or 0 (M-39).
    pub first: u16,
}

/// The vehicle's progress in its mission, as sent in MISSION_CURRENT (M-90).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Progress {
    /// The sequence number of the item that is being flown or is next, counted from 0.
    pub current: u16,
    /// NOT_STARTED, ACTIVE, PAUSED or COMPLETE. Without a mission, the stack sends NO_MISSION instead.
    pub state: MissionState,
    /// Whether the vehicle is in a mode that flies the mission.
    pub in_mission_mode: bool,
}

/// The hooks of a vehicle with plans: it decides which uploads it accepts, and flies them.
///
/// A refusal is a `MAV_MISSION_RESULT`. It is sent to the ground station as a MISSION_ACK and, with the item's sequence
/// number, as a STATUSTEXT (M-38). A hook can say more with [`Context::text`].
///
/// An upload is received into a staging area and becomes the live plan in one step. Until then, downloads and the
/// vehicle see the old plan (M-39):
///
/// ```text
///   idle ─────────────── COUNT ───────────────▶ receiving
///     ▲                                             │  expected ITEM: staged, the next one is requested
///     │                                             │  no ITEM in time: requested again
///     │                                             │  COUNT, ITEM, CLEAR_ALL of another client: ACK DENIED
///     │                                             │  same ids on another link: treated as another client
///     ├── last ITEM: live in one step, ACK ACCEPTED ┤ stored first, if storage is attached
///     ├── bad ITEM, bad plan: ACK with the fault ───┤
///     ├── COUNT, CLEAR_ALL, ACK of the client ──────┤
///     └── 5 s without ITEM: ACK OPERATION_CANCELLED ┘
/// ```
///
/// [`Durability`](crate::plan::Durability) describes that step with storage.
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `Plans`",
    note = "`plans` in `#[stack]` needs `impl Plans for {Self}`: write it, or leave `plans` out"
)]
pub trait Plans: Vehicle {
    /// The commands that a mission of this vehicle may contain, each with the rule for its frame, parameters and
    /// position. A rule is one of [`dialect::rules`](crate::dialect::rules), narrowed or widened for the vehicle. Any
    /// other command is refused with UNSUPPORTED, never skipped (M-73, M-74). Fences and rally points need no list.
    const MISSION_COMMANDS: &'static [CommandRule];

    /// Decides whether `from` may change this plan now. The stack calls it
    ///
    /// - when an upload or a clear begins, before anything else happens (M-27, M-53);
    /// - before a complete upload goes live, before each step of writing a change to storage, and before the written
    ///   change goes live (M-45).
    ///
    /// After a refusal the old plan stays. The usual refusal is [`MavMissionResult::DENIED`].
    ///
    /// # Errors
    ///
    /// The result for the MISSION_ACK.
    fn may_change(&mut self, cx: &mut Context<'_>, plan: PlanType, from: Peer) -> Result<(), MavMissionResult> {
        let _ = (cx, plan, from);
        Ok(())
    }

    /// Decides whether the vehicle can fly this item, which has passed the stack's own checks. A parameter is refused
    /// with `INVALID_PARAM1` to `INVALID_PARAM7`.
    ///
    /// # Errors
    ///
    /// The result for the MISSION_ACK.
    fn check_item(
        &mut self,
        cx: &mut Context<'_>,
        plan: PlanType,
        seq: u16,
        item: &Item,
    ) -> Result<(), MavMissionResult> {
        let _ = (cx, plan, seq, item);
        Ok(())
    }

    /// Decides whether the vehicle can fly the plan as a whole, which has passed the stack's own checks. Called after
    /// the last item, before the plan goes live, and when a plan is loaded or restored from storage.
    ///
    /// # Errors
    ///
    /// The fault; a `MAV_MISSION_RESULT` converts into one.
    fn check_plan(&mut self, cx: &mut Context<'_>, plan: PlanType, items: &[Item]) -> Result<(), PlanFault> {
        let _ = (cx, plan, items);
        Ok(())
    }

    /// Returns how far the first waypoint of a mission may be away. A mission whose first waypoint is farther away is
    /// refused with `INVALID_PARAM5_X` and a text, when it is uploaded, loaded, or restored from storage (M-48). The
    /// distance is accurate to 3 % up to 100 km and below 80° of latitude.
    ///
    /// `None`, the default, means no limit; return it also while the vehicle does not know its position. A vehicle with
    /// a limit then says so by [`limits_first_waypoint`](Self::limits_first_waypoint). A mission that went live
    /// meanwhile is checked when the position becomes known, and a text reports one that is too far away. Every mission
    /// is checked again before it starts: see [`check_start`](Self::check_start).
    fn first_waypoint_limit(&self) -> Option<FirstWaypointLimit> {
        None
    }

    /// Returns whether the first waypoint is limited, also while [`first_waypoint_limit`](Self::first_waypoint_limit)
    /// is `None` because the position is not known: until then no mission starts (M-48). By default, `None` means that
    /// there is no limit.
    fn limits_first_waypoint(&self) -> bool {
        self.first_waypoint_limit().is_some()
    }

    /// Checks that the first waypoint of the live mission is within the limit, before the mission starts from its first
    /// item (M-48). It may have been stored at another site, or uploaded before the position was known. The stack calls
    /// this for MAV_CMD_MISSION_START, and before item 0 is made current while the vehicle flies its mission. A vehicle
    /// with a limit calls it before it starts the mission for another reason, such as a change of the mode or a switch
    /// of the pilot. A mission that is resumed at a later item is not checked.
    ///
    /// Not to be overridden.
    ///
    /// # Errors
    ///
    /// The answer to the command, after a text that says why: TEMPORARILY_REJECTED while the position is not known,
    /// DENIED for a waypoint that is too far away.
    fn check_start(&self, cx: &mut Context<'_>) -> Result<(), MavResult>
    where
        Self: Sized,
    {
        if !self.limits_first_waypoint() {
            return Ok(());
        }
        let Some(limit) = self.first_waypoint_limit() else {
            Problem::NotChecked.report_from_hook(cx);
            return Err(MavResult::TEMPORARILY_REJECTED);
        };
        match first_too_far(cx.plan(PlanType::Mission).items(), Self::MISSION_COMMANDS, limit) {
            None => Ok(()),
            Some(seq) => {
                Problem::TooFar { seq, limit: limit.distance }.report_from_hook(cx);
                Err(MavResult::DENIED)
            }
        }
    }

    /// Called when a new plan has become live: the vehicle restarts its progress (M-39), even if the old plan was
    /// longer (M-94). Not called for an upload equal to the live plan.
    fn plan_changed(&mut self, cx: &mut Context<'_>, change: PlanChange<'_>);

    /// Returns the vehicle's progress in its mission.
    fn progress(&self) -> Progress;

    /// Makes item `seq`, which exists, the current one: the mission continues from it. The flight mode does not change
    /// (M-92, M-93). `reset` restarts the jump counters; a completed mission becomes ACTIVE or PAUSED again.
    ///
    /// Requested by MAV_CMD_DO_SET_MISSION_CURRENT and MISSION_SET_CURRENT. The command's entry in
    /// [`Commands::POLICIES`](crate::Commands::POLICIES) and
    /// [`Commands::is_in_control`](crate::Commands::is_in_control) apply to both (M-46).
    fn set_current(&mut self, cx: &mut Context<'_>, seq: u16, reset: bool) -> MavResult {
        let _ = (cx, seq, reset);
        MavResult::UNSUPPORTED
    }

    /// Starts the mission (MAV_CMD_MISSION_START), from item `first` to item `last` where they are given. If it starts
    /// at item 0, it has passed [`check_start`](Self::check_start). Both exist, and `first` is not after `last` (M-95).
    /// A `last` of 0 counts as not given, because clients that leave it out send 0; a `first` of 0 is the first item.
    /// `command` has the sender, and whether the command was broadcast (C-1).
    fn start_mission(
        &mut self,
        cx: &mut Context<'_>,
        command: &Command,
        first: Option<u16>,
        last: Option<u16>,
    ) -> MavResult {
        let _ = (cx, command, first, last);
        MavResult::UNSUPPORTED
    }
}
