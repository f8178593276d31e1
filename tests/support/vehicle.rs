//! A vehicle that returns configured answers and records all calls.

use super::{MemoryFiles, MemoryLogs};
use mavstack::clock::WallClock;
use mavstack::command::CommandPolicy;
use mavstack::dialect::{
    MavCmd, MavFrame, MavMissionResult, MavModeFlag, MavResult, MavSeverity, MavState, MissionState, rules,
};
use mavstack::plan::FirstWaypointLimit;
use mavstack::plan::PlanFault;
use mavstack::{
    Address, Command, CommandRule, Commands, Context, Frame, Instant, Item, LinkId, Outcome, ParamChange, Parameters,
    Peer, PeerEvent, PlanChange, PlanType, Plans, Progress, Vehicle, VehicleState,
};
use std::collections::{BTreeMap, BTreeSet};

mavstack::parameters! {
    /// The parameters of the test vehicle.
    pub struct Tuning {
        BAT_LOW: f32 = 10.5, 9.0..=12.6, "V";
        CRUISE: f32 = 5.0, 0.5..=20.0, "m/s";
        FENCE_ACT: i32 = 1, 0..=4, "";
        LAND_SPEED: f32 = 0.7, 0.1..=3.0, "m/s";
        RTL_ALT: f32 = 30.0, 0.0..=120.0, "m";
        STAT_STARTS: u32 = 0, 0..=u32::MAX, "" { read_only };
        SYS_ID: u8 = 1, 1..=254, "" { reboot_required };
        TRIM_ROLL: i8 = -3, -20..=20, "deg";
        YAW_NOW: f32 = 0.0, -180.0..=180.0, "deg" { volatile };
    }
}

/// A call of a vehicle's hook.
#[derive(Clone, Debug, PartialEq)]
pub enum Call {
    Peer(PeerEvent),
    Message {
        id: u32,
        from: Address,
        link: LinkId,
        payload: Vec<u8>,
    },
    Command(Command),
    MayChange(PlanType, Peer),
    ParameterChanged(u16),
    CheckItem(PlanType, u16, Item),
    CheckPlan(PlanType, Vec<Item>),
    PlanChanged {
        plan: PlanType,
        items: Vec<Item>,
        first: u16,
    },
    SetCurrent(u16, bool),
    StartMission(Option<u16>, Option<u16>),
    CancelCommand(MavCmd, Peer),
    /// A setting of an extended parameter.
    SetExtParam(Peer),
    /// Another component has answered the request with this token.
    Answered(u16),
    /// The gimbal has told its attitude.
    DeviceMoved,
}

/// Implements all traits of the stack. Its fields contain its answers.
#[derive(Clone, Debug)]
pub struct TestVehicle {
    /// The state in the heartbeat; `None` for a fault.
    pub state: Option<VehicleState>,
    /// When it was told who holds the sticks, and who.
    pub stick_holders: Vec<(Instant, Option<Peer>)>,
    /// Answers to commands by id. Other commands are UNSUPPORTED.
    pub outcomes: BTreeMap<u16, Outcome>,
    /// Whether it arms and disarms on command.
    pub arms: bool,
    /// Long-running commands, which the test finishes. An entry in `outcomes` takes precedence.
    pub long: BTreeSet<u16>,
    /// Whether it cancels commands on request.
    pub cancels: bool,
    /// The only sender authorised for the commands that it declares; `None` authorises every sender.
    pub controller: Option<Address>,
    /// The time of day.
    pub clock: WallClock,
    /// Whether plans may be changed.
    pub may_change: Result<(), MavMissionResult>,
    /// Refusals of single items, by sequence number.
    pub bad_items: BTreeMap<u16, MavMissionResult>,
    /// Result of the check of a complete plan.
    pub plan_verdict: Result<(), MavMissionResult>,
    /// Limit for the first waypoint: a position and the maximum distance from it.
    pub first_waypoint_limit: Option<FirstWaypointLimit>,
    /// Whether it has a limit even if that is `None`, because its position is not known.
    pub limits_first_waypoint: bool,
    /// Whether each hook that decides about plans or control says so in a text.
    pub is_talkative: bool,
    /// Whether its storage may be written.
    pub may_persist: bool,
    /// Answer to a change of the current item, and to a start of the mission.
    pub progress_verdict: MavResult,
    /// Whether it refuses a broadcast start of the mission.
    pub refuses_broadcast: bool,
    /// Progress of the mission. A new mission sets the current item to its first item.
    pub progress: Progress,
    /// Whether home is known, so that HOME_POSITION can be filled.
    pub has_home: bool,
    /// Ids of the messages that it handles itself.
    pub handles: BTreeSet<u32>,
    /// Its files.
    pub files: MemoryFiles,
    /// Its flight logs.
    pub logs: MemoryLogs,
    /// Every call in order, except [`Vehicle::state`], [`Plans::progress`] and [`Telemetry::fill`].
    pub calls: Vec<Call>,
}

impl TestVehicle {
    /// Creates a healthy vehicle on the ground. It supports arming, takeoff, landing and mission start, and accepts any plan.
    pub fn new() -> Self {
        let known = [MavCmd::COMPONENT_ARM_DISARM, MavCmd::NAV_TAKEOFF, MavCmd::NAV_LAND, MavCmd::MISSION_START];
        Self {
            stick_holders: Vec::new(),
            state: Some(VehicleState {
                base_mode: MavModeFlag::CUSTOM_MODE_ENABLED,
                custom_mode: 4,
                system_status: MavState::STANDBY,
            }),
            outcomes: known.into_iter().map(|id| (id.0, MavResult::ACCEPTED.into())).collect(),
            arms: false,
            long: BTreeSet::new(),
            cancels: true,
            controller: None,
            clock: WallClock::new(),
            may_change: Ok(()),
            bad_items: BTreeMap::new(),
            plan_verdict: Ok(()),
            first_waypoint_limit: None,
            limits_first_waypoint: false,
            is_talkative: false,
            may_persist: true,
            progress_verdict: MavResult::ACCEPTED,
            refuses_broadcast: false,
            progress: Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false },
            has_home: false,
            handles: BTreeSet::new(),
            files: MemoryFiles::default(),
            logs: MemoryLogs::default(),
            calls: Vec::new(),
        }
    }

    /// Says which hook was called, if the test wants to know.
    fn say(&self, cx: &mut Context<'_>, hook: &str) {
        if self.is_talkative {
            cx.text(MavSeverity::INFO, hook);
        }
    }

    /// Returns the commands passed to the vehicle.
    pub fn commands(&self) -> Vec<Command> {
        let command = |call: &Call| if let Call::Command(command) = call { Some(*command) } else { None };
        self.calls.iter().filter_map(command).collect()
    }

    /// Returns the events of peers passed to the vehicle.
    pub fn peer_events(&self) -> Vec<PeerEvent> {
        let event = |call: &Call| if let Call::Peer(event) = call { Some(*event) } else { None };
        self.calls.iter().filter_map(event).collect()
    }

    /// Returns the plans that became live, each with its first item to fly.
    pub fn plan_changes(&self) -> Vec<(PlanType, Vec<Item>, u16)> {
        let change = |call: &Call| match call {
            Call::PlanChanged { plan, items, first } => Some((*plan, items.clone(), *first)),
            _ => None,
        };
        self.calls.iter().filter_map(change).collect()
    }
}

impl Default for TestVehicle {
    fn default() -> Self {
        Self::new()
    }
}

impl Vehicle for TestVehicle {
    fn state(&self) -> Option<VehicleState> {
        self.state
    }

    fn may_persist(&self) -> bool {
        self.may_persist
    }

    fn peer(&mut self, _: &mut Context<'_>, event: PeerEvent) {
        self.calls.push(Call::Peer(event));
    }

    fn stick_holder(&mut self, cx: &mut Context<'_>, holder: Option<Peer>) {
        self.stick_holders.push((cx.now(), holder));
    }

    fn message(&mut self, _: &mut Context<'_>, frame: &Frame<'_>, link: LinkId) -> bool {
        let payload = frame.payload().to_vec();
        self.calls.push(Call::Message { id: frame.id(), from: frame.source(), link, payload });
        self.handles.contains(&frame.id())
    }
}

impl Commands for TestVehicle {
    const POLICIES: &'static [CommandPolicy] = &[
        CommandPolicy::new(rules::DO_REPEAT_SERVO).once(),
        CommandPolicy::new(rules::DO_REPEAT_RELAY).once_per_press(),
        CommandPolicy::new(rules::DO_REPOSITION).int_only(),
        // Only for senders in control. The stack checks the parameters.
        CommandPolicy::new(CommandRule::any(MavCmd::DO_SET_MISSION_CURRENT)),
        CommandPolicy::new(rules::DO_MOTOR_TEST).long_only().no_broadcast(),
        CommandPolicy::new(rules::NAV_VTOL_TAKEOFF.with_frames(&[MavFrame::GLOBAL_RELATIVE_ALT]))
            .long_frame(MavFrame::GLOBAL_RELATIVE_ALT),
    ];

    fn is_in_control(&self, cx: &mut Context<'_>, command: &Command) -> bool {
        self.say(cx, "in control?");
        self.controller.is_none_or(|controller| controller == command.from.address)
    }

    fn cancel_command(&mut self, _: &mut Context<'_>, command: MavCmd, from: Peer) -> bool {
        self.calls.push(Call::CancelCommand(command, from));
        self.cancels
    }

    fn command(&mut self, cx: &mut Context<'_>, command: &Command) -> Outcome {
        self.calls.push(Call::Command(*command));
        if let Some(state) = self.state.as_mut().filter(|_| self.arms && command.id == MavCmd::COMPONENT_ARM_DISARM) {
            let is_armed = command.params[0] == 1.0;
            let armed = if is_armed { MavModeFlag::SAFETY_ARMED } else { MavModeFlag::EMPTY };
            state.base_mode = MavModeFlag::CUSTOM_MODE_ENABLED | armed;
        }
        if self.long.contains(&command.id.0) {
            let started = cx.start();
            return self.outcomes.get(&command.id.0).copied().unwrap_or(started);
        }
        self.outcomes.get(&command.id.0).copied().unwrap_or(MavResult::UNSUPPORTED.into())
    }
}

impl Parameters for TestVehicle {
    type Table = Tuning;

    fn parameter_changed(&mut self, cx: &mut Context<'_>, change: &ParamChange<Tuning>) {
        if let Some(cruise) = change.value(Tuning::CRUISE) {
            assert_eq!(cruise, cx.parameter(Tuning::CRUISE), "{change:?}");
        }
        self.calls.push(Call::ParameterChanged(change.index()));
    }
}

impl Plans for TestVehicle {
    const MISSION_COMMANDS: &'static [CommandRule] =
        &[rules::NAV_TAKEOFF, rules::NAV_WAYPOINT, rules::NAV_LAND, rules::DO_JUMP, rules::DO_CHANGE_SPEED];

    fn may_change(&mut self, cx: &mut Context<'_>, plan: PlanType, from: Peer) -> Result<(), MavMissionResult> {
        self.say(cx, "change?");
        self.calls.push(Call::MayChange(plan, from));
        self.may_change
    }

    fn check_item(
        &mut self,
        cx: &mut Context<'_>,
        plan: PlanType,
        seq: u16,
        item: &Item,
    ) -> Result<(), MavMissionResult> {
        self.say(cx, "item?");
        self.calls.push(Call::CheckItem(plan, seq, *item));
        self.bad_items.get(&seq).copied().map_or(Ok(()), Err)
    }

    fn check_plan(&mut self, cx: &mut Context<'_>, plan: PlanType, items: &[Item]) -> Result<(), PlanFault> {
        self.say(cx, "plan?");
        self.calls.push(Call::CheckPlan(plan, items.to_vec()));
        Ok(self.plan_verdict?)
    }

    fn first_waypoint_limit(&self) -> Option<FirstWaypointLimit> {
        self.first_waypoint_limit
    }

    fn limits_first_waypoint(&self) -> bool {
        self.limits_first_waypoint || self.first_waypoint_limit.is_some()
    }

    fn plan_changed(&mut self, _: &mut Context<'_>, change: PlanChange<'_>) {
        if change.plan == PlanType::Mission {
            self.progress.current = change.first;
        }
        self.calls.push(Call::PlanChanged { plan: change.plan, items: change.items.to_vec(), first: change.first });
    }

    fn progress(&self) -> Progress {
        self.progress
    }

    fn set_current(&mut self, _: &mut Context<'_>, seq: u16, reset: bool) -> MavResult {
        self.calls.push(Call::SetCurrent(seq, reset));
        if self.progress_verdict == MavResult::ACCEPTED {
            self.progress.current = seq;
        }
        self.progress_verdict
    }

    fn start_mission(
        &mut self,
        _: &mut Context<'_>,
        command: &Command,
        first: Option<u16>,
        last: Option<u16>,
    ) -> MavResult {
        if command.is_broadcast && self.refuses_broadcast {
            return MavResult::DENIED;
        }
        self.calls.push(Call::StartMission(first, last));
        self.progress_verdict
    }
}
