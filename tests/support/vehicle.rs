//! A vehicle that does as it is told and remembers what it was asked.

use mavstack::dialect::{
    MavCmd, MavFrame, MavMissionResult, MavModeFlag, MavResult, MavState, MissionState, command_rules,
};
use mavstack::{
    Address, Command, CommandMemory, CommandPolicy, CommandRule, CommandSlots, Commands, ForwardQueues, Forwarding,
    Frame, HighLatency, Item, LatLon, LinkId, ManualInput, Outcome, ParamChange, Parameters, Peer, PeerEvent,
    PlanChange, PlanFault, PlanType, Plans, Progress, TimeSlots, TimeSync, Vehicle, VehicleState, WallClock,
};
use std::collections::{BTreeMap, BTreeSet};

mavstack::parameters! {
    /// What can be tuned on the vehicle of the tests.
    pub struct Tuning {
        BAT_LOW: f32 = 10.5, 9.0..=12.6, "V";
        CRUISE: f32 = 5.0, 0.5..=20.0, "m/s";
        FENCE_ACT: i32 = 1, 0..=4, "";
        LAND_SPEED: f32 = 0.7, 0.1..=3.0, "m/s";
        RTL_ALT: f32 = 30.0, 0.0..=120.0, "m";
        STAT_STARTS: u32 = 0, 0..=u32::MAX, "", [read_only];
        SYS_ID: u8 = 1, 1..=254, "", [reboot_required];
        TRIM_ROLL: i8 = -3, -20..=20, "deg";
        YAW_NOW: f32 = 0.0, -180.0..=180.0, "deg", [volatile];
    }
}

/// One call of the stack to the vehicle.
#[derive(Clone, Debug, PartialEq)]
pub enum Call {
    Peer(PeerEvent),
    Message { id: u32, from: Address, link: LinkId, payload: Vec<u8> },
    Command(Command),
    MayChange(PlanType, Peer),
    ParameterChanged(u16),
    CheckItem(PlanType, u16, Item),
    CheckPlan(PlanType, Vec<Item>),
    PlanChanged { plan: PlanType, items: Vec<Item>, first: u16 },
    SetCurrent(u16, bool),
    StartMission(Option<u16>, Option<u16>),
    CancelCommand(MavCmd, Peer),
}

/// Implements all of the stack's traits; what it answers stands in its fields.
#[derive(Clone, Debug)]
pub struct TestVehicle {
    /// What the heartbeat says; `None` for a fault.
    pub state: Option<VehicleState>,
    /// Answers to commands by number; a command that is not here is UNSUPPORTED.
    pub outcomes: BTreeMap<u16, Outcome>,
    /// Whether it arms and disarms on command.
    pub arms: bool,
    /// Commands that it starts and leaves to the test to finish, unless it has another answer.
    pub long: BTreeSet<u16>,
    /// Its memory for those, and for DO_REPEAT_SERVO and DO_REPEAT_RELAY, which it does not carry out twice.
    pub memory: CommandSlots<3>,
    /// Whether it gives up a command when it is asked to.
    pub cancels: bool,
    /// Who may give it the commands that it declares; everybody at first.
    pub controller: Option<Address>,
    /// Answers PING and TIMESYNC; `None` when it does not.
    pub time: Option<TimeSlots<2>>,
    /// Forwards between its links; `None` when it does not.
    pub queues: Option<Box<ForwardQueues<6>>>,
    /// Steered by hand; `None` when it is not.
    pub manual: Option<ManualInput>,
    /// What it knows of the time of day.
    pub clock: WallClock,
    /// Its high-latency links' memory; `None` when only commands travel there.
    pub satellite: Option<HighLatency>,
    /// Signs; `None` when it does not.
    #[cfg(feature = "signing")]
    pub signing: Option<mavstack::SigningMemory>,
    /// Its parameters.
    pub tuning: Tuning,
    /// Whether plans may be changed.
    pub may_change: Result<(), MavMissionResult>,
    /// Refusals of single items.
    pub bad_items: BTreeMap<u16, MavMissionResult>,
    /// What is said of each plan as a whole.
    pub plan_verdict: Result<(), MavMissionResult>,
    /// The limit of the first waypoint: the place it is measured from, and the distance.
    pub first_waypoint_limit: Option<(LatLon, u32)>,
    /// Whether its storage may be written.
    pub may_persist: bool,
    /// What it answers to who sets the current item, or starts the mission.
    pub progress_verdict: MavResult,
    /// Whether it starts no mission that every vehicle is to start.
    pub refuses_broadcast: bool,
    /// Where it is in its mission; a new mission sets it to the mission's first item.
    pub progress: Progress,
    /// Whether it knows where home is, and so can fill HOME_POSITION.
    pub has_home: bool,
    /// The messages that it handles itself.
    pub handles: BTreeSet<u32>,
    /// Every call, in order, but for [`Vehicle::state`], [`Plans::progress`] and [`Telemetry::fill`].
    pub calls: Vec<Call>,
}

impl TestVehicle {
    /// A healthy vehicle on the ground that knows how to arm, take off, land and start a mission, and takes any plan.
    pub fn new() -> Self {
        let known = [MavCmd::COMPONENT_ARM_DISARM, MavCmd::NAV_TAKEOFF, MavCmd::NAV_LAND, MavCmd::MISSION_START];
        Self {
            state: Some(VehicleState {
                base_mode: MavModeFlag::CUSTOM_MODE_ENABLED,
                custom_mode: 4,
                system_status: MavState::STANDBY,
            }),
            outcomes: known.into_iter().map(|id| (id.0, MavResult::ACCEPTED.into())).collect(),
            arms: false,
            long: BTreeSet::new(),
            memory: CommandSlots::new(),
            cancels: true,
            controller: None,
            time: None,
            queues: None,
            manual: None,
            satellite: None,
            clock: WallClock::new(),
            #[cfg(feature = "signing")]
            signing: None,
            tuning: Tuning::new(),
            may_change: Ok(()),
            bad_items: BTreeMap::new(),
            plan_verdict: Ok(()),
            first_waypoint_limit: None,
            may_persist: true,
            progress_verdict: MavResult::ACCEPTED,
            refuses_broadcast: false,
            progress: Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false },
            has_home: false,
            handles: BTreeSet::new(),
            calls: Vec::new(),
        }
    }

    /// The commands that reached the vehicle.
    pub fn commands(&self) -> Vec<Command> {
        let command = |call: &Call| if let Call::Command(command) = call { Some(*command) } else { None };
        self.calls.iter().filter_map(command).collect()
    }

    /// What it was told of its peers.
    pub fn peer_events(&self) -> Vec<PeerEvent> {
        let event = |call: &Call| if let Call::Peer(event) = call { Some(*event) } else { None };
        self.calls.iter().filter_map(event).collect()
    }

    /// The plans that went live, each with the item to begin with.
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

    fn time_sync(&mut self) -> Option<&mut TimeSync> {
        self.time.as_mut().map(|time| time as &mut TimeSync)
    }

    fn manual_input(&mut self) -> Option<&mut ManualInput> {
        self.manual.as_mut()
    }

    fn high_latency(&mut self) -> Option<&mut HighLatency> {
        self.satellite.as_mut()
    }

    fn forwarding(&mut self) -> Option<Forwarding<'_>> {
        self.queues.as_mut().map(|queues| queues.forwarding())
    }

    #[cfg(feature = "signing")]
    fn signing(&mut self) -> Option<&mut mavstack::Signing> {
        self.signing.as_mut().map(|signing| signing as &mut mavstack::Signing)
    }

    fn peer(&mut self, event: PeerEvent) {
        self.calls.push(Call::Peer(event));
    }

    fn message(&mut self, frame: &Frame<'_>, link: LinkId) -> bool {
        let payload = frame.payload().to_vec();
        self.calls.push(Call::Message { id: frame.id(), from: frame.source(), link, payload });
        self.handles.contains(&frame.id())
    }
}

impl Commands for TestVehicle {
    const COMMANDS: &'static [CommandPolicy] = &[
        CommandPolicy::new(command_rules::DO_REPEAT_SERVO).once(),
        CommandPolicy::new(command_rules::DO_REPEAT_RELAY).once_per_press(),
        CommandPolicy::new(command_rules::DO_REPOSITION).int_only(),
        // For senders that are in control; the stack checks its parameters.
        CommandPolicy::new(CommandRule::any(MavCmd::DO_SET_MISSION_CURRENT)),
        CommandPolicy::new(command_rules::DO_MOTOR_TEST).long_only().no_broadcast(),
        CommandPolicy::new(command_rules::NAV_VTOL_TAKEOFF.with_frames(&[MavFrame::GLOBAL_RELATIVE_ALT]))
            .long_frame(MavFrame::GLOBAL_RELATIVE_ALT),
    ];

    fn is_in_control(&self, command: &Command) -> bool {
        self.controller.is_none_or(|controller| controller == command.from.address)
    }

    fn command_memory(&mut self) -> Option<&mut CommandMemory> {
        Some(&mut self.memory)
    }

    fn cancel_command(&mut self, command: MavCmd, from: Peer) -> bool {
        self.calls.push(Call::CancelCommand(command, from));
        self.cancels
    }

    fn command(&mut self, command: &Command) -> Outcome {
        self.calls.push(Call::Command(*command));
        if let Some(state) = self.state.as_mut().filter(|_| self.arms && command.id == MavCmd::COMPONENT_ARM_DISARM) {
            let is_armed = command.params[0] == 1.0;
            let armed = if is_armed { MavModeFlag::SAFETY_ARMED } else { MavModeFlag::EMPTY };
            state.base_mode = MavModeFlag::CUSTOM_MODE_ENABLED | armed;
        }
        if self.long.contains(&command.id.0) {
            let started = self.memory.start(command);
            return self.outcomes.get(&command.id.0).copied().unwrap_or(started);
        }
        self.outcomes.get(&command.id.0).copied().unwrap_or(MavResult::UNSUPPORTED.into())
    }
}

impl Parameters for TestVehicle {
    type Table = Tuning;

    fn parameters_mut(&mut self) -> Option<&mut Tuning> {
        Some(&mut self.tuning)
    }

    fn parameter_changed(&mut self, change: &ParamChange<Tuning>) {
        if let Some(cruise) = change.value(Tuning::CRUISE) {
            assert_eq!(cruise, self.tuning.get(Tuning::CRUISE), "{change:?}");
        }
        self.calls.push(Call::ParameterChanged(change.index()));
    }
}

impl Plans for TestVehicle {
    const MISSION_COMMANDS: &'static [CommandRule] = &[
        command_rules::NAV_TAKEOFF,
        command_rules::NAV_WAYPOINT,
        command_rules::NAV_LAND,
        command_rules::DO_JUMP,
        command_rules::DO_CHANGE_SPEED,
    ];

    fn may_change(&mut self, plan: PlanType, from: Peer) -> Result<(), MavMissionResult> {
        self.calls.push(Call::MayChange(plan, from));
        self.may_change
    }

    fn check_item(&mut self, plan: PlanType, seq: u16, item: &Item) -> Result<(), MavMissionResult> {
        self.calls.push(Call::CheckItem(plan, seq, *item));
        self.bad_items.get(&seq).copied().map_or(Ok(()), Err)
    }

    fn check_plan(&mut self, plan: PlanType, items: &[Item]) -> Result<(), PlanFault> {
        self.calls.push(Call::CheckPlan(plan, items.to_vec()));
        Ok(self.plan_verdict?)
    }

    fn first_waypoint_limit(&self) -> Option<(LatLon, u32)> {
        self.first_waypoint_limit
    }

    fn plan_changed(&mut self, change: PlanChange<'_>) {
        if change.plan == PlanType::Mission {
            self.progress.current = change.first;
        }
        self.calls.push(Call::PlanChanged { plan: change.plan, items: change.items.to_vec(), first: change.first });
    }

    fn progress(&self) -> Progress {
        self.progress
    }

    fn may_persist(&self) -> bool {
        self.may_persist
    }

    fn set_current(&mut self, seq: u16, reset: bool) -> MavResult {
        self.calls.push(Call::SetCurrent(seq, reset));
        if self.progress_verdict == MavResult::ACCEPTED {
            self.progress.current = seq;
        }
        self.progress_verdict
    }

    fn start_mission(&mut self, command: &Command, first: Option<u16>, last: Option<u16>) -> MavResult {
        if command.is_broadcast && self.refuses_broadcast {
            return MavResult::DENIED;
        }
        self.calls.push(Call::StartMission(first, last));
        self.progress_verdict
    }
}
