//! A vehicle with flight modes, and functions to request them.

use super::tested::{HookServices, Hooks, Plain, Tested, WithModes, check_modes};
use super::{Setup, World, secs};
use mavstack::__private::NoPlans;
use mavstack::__private::{Absent, Firmware, NoParams, StreamService};
use mavstack::command::CommandPolicy;
use mavstack::dialect::*;
use mavstack::{
    Address, Command, Commands, Context, CustomMode, Duration, Fill, FlightMode, Frame, LinkId, ModeRequest, Modes,
    Outcome, Stream, Telemetry, Vehicle, VehicleState,
};

pub const POSITION: u32 = 3 << 16;
pub const HOLD: u32 = 4 << 16 | 3 << 24;
pub const MISSION: u32 = 4 << 16 | 4 << 24;
pub const RETURN: u32 = 4 << 16 | 5 << 24;
pub const TEST: u32 = 7;
pub const AFLOAT: u32 = 9 << 16;
/// A number that `f32` cannot represent.
pub const ODD: u32 = 0xFEDC_BA99;

pub const LONGEST: &str = "a mode whose name is 34 bytes long";

pub const MODES: &[FlightMode] = &[
    FlightMode::new(POSITION, "Position").with_standard_mode(MavStandardMode::POSITION_HOLD),
    FlightMode::new(HOLD, "Hold"),
    FlightMode::new(MISSION, LONGEST)
        .with_standard_mode(MavStandardMode::MISSION)
        .with_properties(MavModeProperty::AUTO_MODE),
    FlightMode::new(RETURN, "Return").with_standard_mode(MavStandardMode::SAFE_RECOVERY),
    FlightMode::new(TEST, "Test").with_properties(MavModeProperty::ADVANCED),
    FlightMode::new(AFLOAT, "Afloat")
        .with_standard_mode(MavStandardMode::LAND)
        .with_properties(MavModeProperty::NOT_USER_SELECTABLE),
    FlightMode::new(ODD, "Odd"),
];

/// The maximum number of modes.
pub const ALL_32: &[FlightMode] = &{
    let mut modes = [FlightMode::new(0, "Mode"); 32];
    let mut i = 0;
    while i < 32 {
        modes[i].custom_mode = i as u32;
        i += 1;
    }
    modes
};

// The variants of the declaration of modes.
pub const PX4: u8 = 0;
pub const ARDUPILOT: u8 = 1;
/// As PX4, with a policy for MAV_CMD_DO_SET_MODE.
pub const DECLARED: u8 = 2;
pub const MANY: u8 = 3;
/// As PX4, without telemetry.
pub const QUIET: u8 = 4;

/// A vehicle with modes, declared in variant `W`.
pub struct Pilot<const W: u8> {
    pub state: Option<VehicleState>,
    pub intended: u32,
    pub verdict: Outcome,
    pub controller: Option<Address>,
    /// The requested modes.
    pub asked: Vec<(u32, ModeRequest)>,
    pub commands: usize,
    pub messages: Vec<u32>,
}

impl<const W: u8> Default for Pilot<W> {
    fn default() -> Self {
        Self {
            state: Some(VehicleState::new(false)),
            intended: 0,
            verdict: MavResult::ACCEPTED.into(),
            controller: None,
            asked: Vec::new(),
            commands: 0,
            messages: Vec::new(),
        }
    }
}

impl<const W: u8> Pilot<W> {
    pub fn enter(&mut self, custom_mode: u32) {
        self.state.as_mut().unwrap().custom_mode = custom_mode;
    }
}

impl<const W: u8> Vehicle for Pilot<W> {
    fn state(&self) -> Option<VehicleState> {
        self.state
    }

    fn message(&mut self, _: &mut Context<'_>, frame: &Frame<'_>, _: LinkId) -> bool {
        self.messages.push(frame.id());
        true
    }
}

impl<const W: u8> Commands for Pilot<W> {
    const POLICIES: &'static [CommandPolicy] =
        if W == DECLARED { &[CommandPolicy::new(rules::DO_SET_MODE).no_broadcast()] } else { &[] };

    fn is_in_control(&self, _: &mut Context<'_>, command: &Command) -> bool {
        self.controller.is_none_or(|controller| controller == command.from.address)
    }

    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        self.commands += 1;
        MavResult::UNSUPPORTED.into()
    }
}

impl<const W: u8> Modes for Pilot<W> {
    const MODES: &'static [FlightMode] = if W == MANY { ALL_32 } else { MODES };
    const CUSTOM_MODE: CustomMode = if W == ARDUPILOT { CustomMode::Whole } else { CustomMode::MainSub };

    fn set_mode(&mut self, _: &mut Context<'_>, mode: &'static FlightMode, request: &ModeRequest) -> Outcome {
        assert!(Self::MODES.contains(mode));
        self.asked.push((mode.custom_mode, *request));
        self.verdict
    }

    fn intended_mode(&self) -> u32 {
        self.intended
    }
}

/// One message that clients may request at an interval.
impl<const W: u8> Telemetry for Pilot<W> {
    const STREAMS: &'static [Stream] =
        if W == QUIET { &[] } else { &[Stream::of::<Attitude>().onboard(Duration::from_millis(20))] };

    fn fill(&mut self, _: u32, out: &mut Fill<'_>) -> bool {
        out.put(&Attitude { yaw: 1.0, ..Attitude::default() })
    }
}

impl<const W: u8> Hooks for Pilot<W> {
    type Parameters = NoParams;
    const HAS_MODES: bool = true;
    const CHECKED: () = check_modes::<Self>();
}

impl<D: Firmware<Vehicle = Self>, const W: u8> HookServices<D> for Pilot<W> {
    type Param = Absent;
    type Stream = StreamService<1>;
    type Mode = WithModes;
}

/// A world with such a vehicle.
pub type Piloted<const N: usize, const W: u8 = PX4> = World<N, Tested<NoPlans, 8, Plain, Pilot<W>>>;

pub fn world<const N: usize, const W: u8>() -> Piloted<N, W> {
    Piloted::of(Setup::new())
}

pub fn seven(params: &[f32]) -> [f32; 7] {
    let mut all = [0.0; 7];
    all[..params.len()].copy_from_slice(params);
    all
}

/// Sends COMMAND_LONG and returns the result.
pub fn command<const N: usize, const W: u8>(
    world: &mut Piloted<N, W>,
    link: usize,
    id: MavCmd,
    params: &[f32],
) -> MavResult {
    world.gcs[link].command_long(id, seven(params));
    let ack: CommandAck = world.expect(link, secs(2));
    assert_eq!(ack.command, id);
    ack.result
}

/// Sends MAV_CMD_REQUEST_MESSAGE and returns the result.
pub fn request<const N: usize, const W: u8>(world: &mut Piloted<N, W>, link: usize, id: u32, index: f32) -> MavResult {
    command(world, link, MavCmd::REQUEST_MESSAGE, &[id as f32, index])
}

pub const AVAILABLE: u32 = 435;
pub const CURRENT: u32 = 436;
pub const MONITOR: u32 = 437;

/// Takes the modes requested since the last call.
pub fn asked<const N: usize, const W: u8>(world: &mut Piloted<N, W>) -> Vec<u32> {
    std::mem::take(&mut world.vehicle.asked).iter().map(|(mode, _)| *mode).collect()
}

pub fn set_mode(base_mode: u8, custom_mode: u32) -> SetMode {
    SetMode { custom_mode, target_system: 1, base_mode: MavModeFlag(base_mode) }
}
