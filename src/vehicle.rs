//! What a firmware implements: a few small traits.
//!
//! The stack calls them from inside its own calls that get the vehicle, so that none of them can call back into the stack;
//! none may block.

use crate::dialect::{Common, MavCmd, MavFrame, MavMissionResult, MavModeFlag, MavResult, MavState, MissionState};
use crate::frame::Frame;
use crate::link::{LinkClass, LinkId, Peer};
use crate::message::{Dialect, MessageTable};
use crate::network::Forwarding;
use crate::service::command::{CommandMemory, CommandPolicy, LatLon};
use crate::service::high_latency::HighLatency;
use crate::service::manual_control::ManualInput;
use crate::service::mission::{CommandRule, Item, PlanType};
use crate::service::mode::{CustomMode, FlightMode, ModeRequest};
use crate::service::param::Parameters;
#[cfg(feature = "signing")]
use crate::service::signing::Signing;
use crate::service::stream::{Fill, Stream};
use crate::service::time::TimeSync;
use crate::time::Duration;

/// What the heartbeat says of the vehicle (H-4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct VehicleState {
    /// [`MavModeFlag::SAFETY_ARMED`] must be true to the facts.
    pub base_mode: MavModeFlag,
    /// The firmware's own number of the mode; set [`MavModeFlag::CUSTOM_MODE_ENABLED`] when it means something.
    pub custom_mode: u32,
    /// From [`MavState::BOOT`] over [`MavState::STANDBY`] to [`MavState::ACTIVE`], or worse.
    pub system_status: MavState,
}

impl VehicleState {
    /// No state reported yet; all bits are zero.
    pub(crate) const ZERO: Self =
        Self { base_mode: MavModeFlag::EMPTY, custom_mode: 0, system_status: MavState::UNINIT };
}

/// What happened to a peer (H-11, H-14). The states are drawn at [`PeerInfo`](crate::PeerInfo).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum PeerEvent {
    /// Its first heartbeat.
    Found(Peer),
    /// No heartbeat for [`peer_timeout`](crate::Config::peer_timeout).
    Lost(Peer),
    /// A heartbeat again.
    Regained(Peer),
    /// Somebody else on this link sends with our own address. Reported once a link.
    AddressConflict(LinkId),
}

/// What the stack asks of every vehicle.
pub trait Vehicle {
    /// The messages whose frames can be checked: all of common, at first. A vehicle with messages of its own names a table that
    /// has these too, or theirs are [unknown](crate::LinkCounters::unknown) and never reach [`message`](Self::message); it has
    /// them from [`dialect!`](crate::dialect!), or from XML by `mavstack-dialect`. A vehicle that is short of flash names a
    /// table that has few.
    ///
    /// ```
    /// use mavstack::dialect::Common;
    /// use mavstack::{Dialect, Frame, LinkId, MessageTable, Vehicle, VehicleState};
    ///
    /// mavstack::message! {
    ///     /// Tells our winch what to do.
    ///     pub struct WinchControl: WINCH_CONTROL = 53_000 {
    ///         /// (m/s) Negative: in.
    ///         speed: f32,
    ///         target_system: u8,
    ///         target_component: u8,
    ///     }
    /// }
    /// mavstack::dialect! {
    ///     /// All of common, and the winch's.
    ///     struct Known: [WinchControl] + Common;
    /// }
    ///
    /// struct Rover { winch_speed: f32 }
    ///
    /// impl Vehicle for Rover {
    ///     const MESSAGES: MessageTable = Known::MESSAGES;
    ///
    ///     fn message(&mut self, frame: &Frame<'_>, _: LinkId) -> bool {
    ///         let Some(WinchControl { speed, .. }) = frame.decode() else { return false };
    ///         self.winch_speed = speed;
    ///         true
    ///     }
    /// #   fn state(&self) -> Option<VehicleState> { None }
    /// }
    /// ```
    const MESSAGES: MessageTable = Common::MESSAGES;

    /// Returns what the next heartbeat says; `None` while the vehicle is in a fault, which stops the heartbeats (H-5).
    ///
    /// The stack asks in every [`poll`](crate::Stack::poll), so make it cheap. A change is reported at once, by an extra heartbeat
    /// on each normal link; each link sends at most one of those every 200 ms (H-16).
    fn state(&self) -> Option<VehicleState>;

    /// A peer was found, lost, regained. For the failsafe that watches the ground station.
    fn peer(&mut self, event: PeerEvent) {
        let _ = event;
    }

    /// The vehicle's memory for PING and TIMESYNC; `None`, as at first, when the stack is not to answer them: then they come
    /// to [`message`](Self::message).
    fn time_sync(&mut self) -> Option<&mut TimeSync> {
        None
    }

    /// The vehicle's memory for MANUAL_CONTROL and RC_CHANNELS_OVERRIDE; `None`, as at first, when nobody steers it by hand
    /// over MAVLink: then they come to [`message`](Self::message).
    fn manual_input(&mut self) -> Option<&mut ManualInput> {
        None
    }

    /// The vehicle's memory for its high-latency links; `None`, as at first, when there are none, or only commands travel
    /// there: then MAV_CMD_CONTROL_HIGH_LATENCY comes to [`Commands::command`], which does not know it (L-12).
    fn high_latency(&mut self) -> Option<&mut HighLatency> {
        None
    }

    /// The vehicle's memory for what is forwarded from link to link; `None`, as at first, when nothing is. See
    /// [`ForwardQueues`](crate::ForwardQueues).
    fn forwarding(&mut self) -> Option<Forwarding<'_>> {
        None
    }

    /// The vehicle's memory for signing; `None`, as at first, when it signs nothing and verifies nothing: then only links that
    /// are [open](crate::Accept::Open) are heard.
    #[cfg(feature = "signing")]
    fn signing(&mut self) -> Option<&mut Signing> {
        None
    }

    /// Handles a frame with a right checksum, addressed to us or to all, whose message the stack does not handle itself.
    /// Returns whether the vehicle handles that message. The default is false: a frame addressed to our system is then
    /// counted as [`unhandled`](crate::LinkCounters::unhandled). With the feature `signing`, only frames that their link
    /// accepts (`LinkSigning`) are passed on; without it, signatures are not verified. Frames from a high-latency link are
    /// never passed on (L-4), nor is SETUP_SIGNING, which contains a key (G-11).
    ///
    /// Setpoints (SET_POSITION_TARGET_LOCAL_NED, SET_POSITION_TARGET_GLOBAL_INT, SET_ATTITUDE_TARGET) are passed on too: the
    /// stack has no service for offboard control yet.
    fn message(&mut self, frame: &Frame<'_>, link: LinkId) -> bool {
        let _ = (frame, link);
        false
    }
}

/// A command as it came, from COMMAND_LONG or COMMAND_INT.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Command {
    /// Which command.
    pub id: MavCmd,
    /// Parameters 1 to 4. NaN and 0 both mean "default" where a command does not use one (C-8).
    pub params: [f32; 4],
    /// Parameters 5 and 6, as the message's form has them.
    pub position: CommandPosition,
    /// Parameter 7: the altitude (m) of a command with a location.
    pub z: f32,
    /// Who asks, over which link.
    pub from: Peer,
    /// The link's class: what came by [`HighLatency`](LinkClass::HighLatency) may be old, and overtaken by others (L-16). A
    /// vehicle may refuse to arm or take off for that.
    pub class: LinkClass,
    /// Age of the command when it was received, by its signature: the current time minus its timestamp. The current time is the
    /// latest one from `Signing::set_time`, or else the latest timestamp of any peer: `Signing::age` has the details. `None`
    /// when neither is known since the start, when the command is not signed, and without the feature `signing`. The age is only
    /// as accurate as both clocks: a sender whose clock is behind makes its commands look older than they are, one whose clock
    /// is ahead makes them look younger. There is no other source for the age, because MAVLink's commands carry no timestamp.
    pub age: Option<Duration>,
    /// Whether it was sent to every system (C-1): a vehicle may refuse to arm or take off on a broadcast. The stack itself
    /// denies broadcasts that would reset, erase or restart, such as PREFLIGHT_STORAGE and PREFLIGHT_REBOOT_SHUTDOWN (C-14).
    pub is_broadcast: bool,
    /// 0 at first, rising with each repetition; COMMAND_INT has none. Many clients never raise it (C-10).
    pub confirmation: u8,
}

impl Command {
    /// Whether parameter 7 is a response target, as in the commands that ask for a message: 0 default, 1 the requester, 2
    /// broadcast; NaN is "not used" (C-8, Q-3).
    pub(crate) fn has_response_target(&self) -> bool {
        self.z.is_nan() || matches!(crate::num::integer(self.z), Some(0..=2))
    }
}

/// Parameters 5 and 6 of a command.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CommandPosition {
    /// Of a COMMAND_LONG: as floats; degrees, for a command with a location (C-6).
    Long {
        /// Parameter 5: latitude (deg) in a command with a location; NaN means "not given".
        param5: f32,
        /// Parameter 6: longitude (deg) in a command with a location; NaN means "not given".
        param6: f32,
    },
    /// Of a COMMAND_INT: deg·1e7 for a command with a location, in `frame` (C-7).
    Int {
        /// The frame of the position; without meaning for a command that has none.
        frame: MavFrame,
        /// Parameter 5: latitude (deg·1e7) in a global frame, m·1e4 in a local one; `i32::MAX` means "not given".
        x: i32,
        /// Parameter 6: longitude (deg·1e7) in a global frame, m·1e4 in a local one; `i32::MAX` means "not given".
        y: i32,
    },
}

impl CommandPosition {
    /// Latitude and longitude in deg·1e7, for a command with a location: each `None` when it is not given (NaN, or
    /// `i32::MAX`) or out of the integer's range. Exact: a float's degrees are scaled without another float's rounding.
    pub fn lat_lon(&self) -> (Option<i32>, Option<i32>) {
        match *self {
            Self::Long { param5, param6 } => (crate::num::scale_1e7(param5), crate::num::scale_1e7(param6)),
            Self::Int { x, y, .. } => (Some(x).filter(|&x| x != i32::MAX), Some(y).filter(|&y| y != i32::MAX)),
        }
    }

    /// Parameters 5 and 6 of a command without a location; NaN for one that is not given (C-7).
    pub fn params(&self) -> (f32, f32) {
        match *self {
            Self::Long { param5, param6 } => (param5, param6),
            Self::Int { x, y, .. } => (crate::num::from_i32(x), crate::num::from_i32(y)),
        }
    }
}

/// What became of a command: goes out as its COMMAND_ACK.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[must_use = "who sent the command waits for it: return it from `Commands::command`"]
pub struct Outcome {
    /// The result, chosen as [`MavResult`] describes (C-4).
    pub result: MavResult,
    /// COMMAND_ACK.result_param2: more about the result, its meaning the command's own.
    pub result_param2: i32,
}

impl From<MavResult> for Outcome {
    fn from(result: MavResult) -> Self {
        Self { result, result_param2: 0 }
    }
}

/// Commands that reach the vehicle.
///
/// ```text
///   COMMAND_LONG ─┐                                                       ┌─▶ plans ───┐
///                 ├─▶ declared? form, control, frame, parameters ─▶ known? ┼─▶ requests ┼─▶ COMMAND_ACK
///   COMMAND_INT ──┘                 (COMMANDS)           (command_memory) └─▶ command ─┘
/// ```
///
/// The stack explains its own refusals in a STATUSTEXT on the sender's link, at most once a second (feature
/// `plan-texts`). The vehicle must explain what it refuses in [`command`](Self::command) itself, with
/// [`Stack::send_text`](crate::Stack::send_text).
pub trait Commands {
    /// Commands whose form, frame and parameters the stack checks before the vehicle hears of them (C-5), and those that
    /// must not be carried out twice. Others come to [`command`](Self::command) as they are.
    const COMMANDS: &'static [CommandPolicy] = &[];

    /// Carries out `command`, or [starts](CommandMemory::start) to, or refuses. A command that the vehicle does not know is
    /// [`MavResult::UNSUPPORTED`]. Called once for each copy of a command that arrives, so repeating must do no harm
    /// (C-11), unless it is declared [`once`](CommandPolicy::once). Every call is answered by exactly one COMMAND_ACK
    /// (C-3), and a command that was started by one more when it has ended.
    ///
    /// A reboot is answered before it happens (C-30): return ACCEPTED, take no more commands, and reset when
    /// [`Stack::has_answered`](crate::Stack::has_answered) says that the answer has left.
    fn command(&mut self, command: &Command) -> Outcome;

    /// Whether the sender of `command`, one of [`COMMANDS`](Self::COMMANDS), is authorised to give it; if not, it is answered
    /// NOT_IN_CONTROL. Also asked about SET_MODE and MISSION_SET_CURRENT, as MAV_CMD_DO_SET_MODE and
    /// MAV_CMD_DO_SET_MISSION_CURRENT.
    fn is_in_control(&self, command: &Command) -> bool {
        let _ = command;
        true
    }

    /// The vehicle's memory for commands that take their time and for those that must not be carried out twice; `None`, as
    /// at first, for a vehicle that has neither.
    fn command_memory(&mut self) -> Option<&mut CommandMemory> {
        None
    }

    /// `from` asks for `command`, which runs, to be given up (COMMAND_CANCEL): true when it was, and then who asked for it
    /// gets CANCELLED; false when it goes on (C-23).
    fn cancel_command(&mut self, command: MavCmd, from: Peer) -> bool {
        let _ = (command, from);
        false
    }

    /// The flight modes, those that may be asked for and those that the vehicle only enters by itself: at most
    /// [`MAX_MODES`](crate::MAX_MODES), with names of 1 to 34 bytes, no `custom_mode` and no standard mode twice, or it does
    /// not compile. The stack tells them to who asks (AVAILABLE_MODES), tells which one the vehicle is in with every second
    /// HEARTBEAT and at once when it changes (CURRENT_MODE, Q-10), and turns MAV_CMD_DO_SET_MODE, its old message SET_MODE
    /// and MAV_CMD_DO_SET_STANDARD_MODE into [`set_mode`](Self::set_mode). Which one the vehicle is in, its
    /// [`custom_mode`](VehicleState::custom_mode) says; its `base_mode` should have
    /// [`CUSTOM_MODE_ENABLED`](MavModeFlag::CUSTOM_MODE_ENABLED) then, or ground stations do not look at the number.
    ///
    /// With none, as at first, the service is not linked: the two commands come to [`command`](Self::command), SET_MODE to
    /// [`Vehicle::message`].
    ///
    /// ```
    /// use mavstack::dialect::{MavModeProperty, MavResult, MavStandardMode};
    /// use mavstack::{Command, Commands, CustomMode, FlightMode, ModeRequest, Outcome};
    ///
    /// const HOLD: u32 = 0x0304_0000;
    /// const RETURN: u32 = 0x0504_0000;
    /// const AFLOAT: u32 = 0x0009_0000;
    ///
    /// struct Copter { mode: u32, has_fix: bool }
    ///
    /// impl Commands for Copter {
    ///     const MODES: &'static [FlightMode] = &[
    ///         FlightMode::new(HOLD, "Hold"),
    ///         FlightMode::new(RETURN, "Return").with_standard_mode(MavStandardMode::SAFE_RECOVERY),
    ///         // Told, when it is so, but nobody can ask for it.
    ///         FlightMode::new(AFLOAT, "Afloat").with_properties(MavModeProperty::NOT_USER_SELECTABLE),
    ///     ];
    ///     const CUSTOM_MODE: CustomMode = CustomMode::MainSub;
    ///
    ///     fn set_mode(&mut self, mode: &'static FlightMode, _: &ModeRequest) -> Outcome {
    ///         if mode.custom_mode == RETURN && !self.has_fix {
    ///             return MavResult::TEMPORARILY_REJECTED.into();
    ///         }
    ///         self.mode = mode.custom_mode;
    ///         MavResult::ACCEPTED.into()
    ///     }
    ///
    ///     fn command(&mut self, _: &Command) -> Outcome {
    ///         MavResult::UNSUPPORTED.into()
    ///     }
    /// }
    /// ```
    const MODES: &'static [FlightMode] = &[];

    /// How parameters 2 and 3 of MAV_CMD_DO_SET_MODE make a `custom_mode`.
    const CUSTOM_MODE: CustomMode = CustomMode::Whole;

    /// Enters `mode`, one of [`MODES`](Self::MODES) that may be asked for, or refuses; the answer goes out at once and is the
    /// only one, so not IN_PROGRESS. Being asked for the mode that it is in must do no harm (C-11). What is no such mode was
    /// DENIED before: a number or a standard mode that the table has not, NaN, a fraction, flags without
    /// [`CUSTOM_MODE_ENABLED`](MavModeFlag::CUSTOM_MODE_ENABLED). The armed flag is not looked at, as in ArduPilot: nobody arms
    /// or disarms this way, and who sets a mode sends back what the heartbeat said.
    ///
    /// Where MAV_CMD_DO_SET_MODE is one of [`COMMANDS`](Self::COMMANDS), what is declared of it holds for SET_MODE too
    /// (C-5); MAV_CMD_DO_SET_STANDARD_MODE is declared by itself. SET_MODE is answered by a COMMAND_ACK for command 11
    /// (C-32), but not taken from a high-latency link.
    fn set_mode(&mut self, mode: &'static FlightMode, request: &ModeRequest) -> Outcome {
        let _ = (mode, request);
        MavResult::UNSUPPORTED.into()
    }

    /// The `custom_mode` that was asked for last, by whoever it was, or what that ended in: a take-off in a hold. It differs
    /// from the vehicle's mode after a failsafe only. 0, as at first, when it is not known. Goes into CURRENT_MODE.
    fn intended_mode(&self) -> u32 {
        0
    }
}

/// A plan that is live from now on.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PlanChange<'a> {
    /// Which plan.
    pub plan: PlanType,
    /// The whole new plan; empty when it was cleared.
    pub items: &'a [Item],
    /// The item to begin with: the one that was uploaded with `current` set, else 0 (M-39).
    pub first: u16,
}

/// Where the vehicle is in its mission: what MISSION_CURRENT says (M-90).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Progress {
    /// The item that is being flown, or is next: its `seq`, from 0.
    pub current: u16,
    /// NOT_STARTED, ACTIVE, PAUSED or COMPLETE; without a mission the stack says NO_MISSION by itself.
    pub state: MissionState,
    /// Whether the vehicle is in a mode that flies the mission.
    pub in_mission_mode: bool,
}

/// What is wrong with a plan as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PlanFault {
    /// The item that is to blame, when there is one: MISSION_ACK has no room for it, the text has (M-38).
    pub seq: Option<u16>,
    /// The MISSION_ACK's type.
    pub result: MavMissionResult,
}

impl core::fmt::Display for PlanFault {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let result = self.result.0;
        match self.seq {
            Some(seq) => write!(f, "item {seq} is to blame for MAV_MISSION_RESULT {result}"),
            None => write!(f, "the plan as a whole is MAV_MISSION_RESULT {result}"),
        }
    }
}

impl core::error::Error for PlanFault {}

impl From<MavMissionResult> for PlanFault {
    fn from(result: MavMissionResult) -> Self {
        Self { seq: None, result }
    }
}

/// Plans: what may be uploaded, and what becomes of it.
///
/// A refusal is a `MAV_MISSION_RESULT`; it reaches the ground station as MISSION_ACK and, with the item's number, as
/// STATUSTEXT (M-38).
///
/// An upload goes into a staging area and becomes the live plan in one step; until then everything that anybody can see is
/// the old plan (M-39):
///
/// ```text
///   idle ─────────────── COUNT ───────────────▶ receiving
///     ▲                                             │  ITEM of the next number: stored, the next one asked for
///     │                                             │  no ITEM in time: asked for again
///     │                                             │  another client's COUNT, ITEM, CLEAR_ALL: ACK DENIED
///     │                                             │  the client's ids on another link: not taken for the client
///     ├── last ITEM: live in one step, ACK ACCEPTED ┤ by way of storage, where there is one
///     ├── bad ITEM, bad plan: ACK with the fault ───┤
///     ├── COUNT, CLEAR_ALL, ACK of the partner ─────┤
///     └── 5 s without ITEM: ACK OPERATION_CANCELLED ┘
/// ```
///
/// What "live in one step" is with storage, [`Durability`](crate::Durability) says.
pub trait Plans: Vehicle {
    /// The commands that a mission of this vehicle may have, each with the rule for its frame, parameters and position:
    /// one of [`dialect::command_rules`](crate::dialect::command_rules), made narrower or wider where the vehicle is. Any
    /// other command is refused with UNSUPPORTED, never skipped (M-73, M-74). Fences and rally points need no list.
    const MISSION_COMMANDS: &'static [CommandRule];

    /// Whether `from` may change this plan now: asked when an upload or a clear begins, before anything else happens
    /// (M-27, M-53), and again before a complete upload goes live, before each step of writing a change to storage, and before
    /// what was written goes live (M-45). A refusal then leaves the old plan. The usual refusal is [`MavMissionResult::DENIED`].
    ///
    /// # Errors
    ///
    /// The MISSION_ACK's type.
    fn may_change(&mut self, plan: PlanType, from: Peer) -> Result<(), MavMissionResult> {
        let _ = (plan, from);
        Ok(())
    }

    /// Returns whether the storage of plans, parameters and key may be written now. It is called before every erase and every
    /// write (SEC-12), which on a microcontroller's own flash stop the processor for milliseconds to seconds. While this is
    /// false, a durable upload is refused at its beginning (M-44), and parameters and the signing time wait.
    ///
    /// By default it is true while [`state`](Vehicle::state) says that the vehicle is disarmed. In a fault, when `state` is
    /// `None`, it is false, because the vehicle may be flying. A vehicle whose storage does not stop the processor, FRAM for
    /// example, can always return true.
    fn may_persist(&self) -> bool {
        self.state().is_some_and(|state| !state.base_mode.contains(MavModeFlag::SAFETY_ARMED))
    }

    /// Whether the vehicle can fly this item, which has passed the stack's own checks. A parameter is refused with
    /// `INVALID_PARAM1` to `INVALID_PARAM7`.
    ///
    /// # Errors
    ///
    /// The MISSION_ACK's type.
    fn check_item(&mut self, plan: PlanType, seq: u16, item: &Item) -> Result<(), MavMissionResult> {
        let _ = (plan, seq, item);
        Ok(())
    }

    /// Whether the vehicle can fly the plan as a whole, which has passed the stack's own checks: asked after the last item
    /// and before it goes live, and when it comes back from storage.
    ///
    /// # Errors
    ///
    /// What is wrong; a bare `MAV_MISSION_RESULT` will do.
    fn check_plan(&mut self, plan: PlanType, items: &[Item]) -> Result<(), PlanFault> {
        let _ = (plan, items);
        Ok(())
    }

    /// Returns the maximum distance of a mission's first waypoint (m), and the place from which it is measured: usually home
    /// or the vehicle's position. A mission whose first waypoint is farther away is refused with `INVALID_PARAM5_X` and a
    /// text, when it is uploaded, loaded, or restored from storage (M-48). `None`, the default, means no limit; return it as
    /// long as the vehicle does not know its position. The distance is accurate to 3 % up to 100 km and below 80° of
    /// latitude.
    fn first_waypoint_limit(&self) -> Option<(LatLon, u32)> {
        None
    }

    /// A new plan is live: progress begins anew (M-39), also where the old plan was longer (M-94). Not called for an upload
    /// equal to the live plan.
    fn plan_changed(&mut self, change: PlanChange<'_>);

    /// Where the vehicle is in its mission.
    fn progress(&self) -> Progress;

    /// Goes on from item `seq`, which exists, whenever the mission is flown; the flight mode stays as it is (M-92, M-93).
    /// With `reset` jump counters begin anew, and a mission that was complete is ACTIVE or PAUSED again. Asked for by
    /// MAV_CMD_DO_SET_MISSION_CURRENT and MISSION_SET_CURRENT; what [`Commands::COMMANDS`] declares for the command
    /// applies to both, and so does [`Commands::is_in_control`] (M-46).
    fn set_current(&mut self, seq: u16, reset: bool) -> MavResult {
        let _ = (seq, reset);
        MavResult::UNSUPPORTED
    }

    /// MAV_CMD_MISSION_START: flies the mission, from item `first` to item `last` where they are given; both exist, and
    /// `first` is not behind `last` (M-95). A `last` of 0 counts as not given, since clients that leave it out send 0; a
    /// `first` of 0 is the first item. `command` says who asks, and whether he asks every vehicle in reach (C-1).
    fn start_mission(&mut self, command: &Command, first: Option<u16>, last: Option<u16>) -> MavResult {
        let _ = (command, first, last);
        MavResult::UNSUPPORTED
    }
}

/// Telemetry: the messages in which the vehicle tells of itself, when it is asked to and in streams.
///
/// Start from a message's constant `UNKNOWN` when you fill only a part of it: in most fields zero is a measured value, an empty
/// battery for example, and MAVLink has another value for "not known". `Default` is zero in every field.
///
/// ```
/// use mavstack::dialect::{Attitude, BatteryStatus, MavDataStream};
/// use mavstack::{Duration, Fill, Message, Stream, Telemetry};
///
/// struct Rover { yaw: f32, cells: [u16; 4] }
///
/// impl Telemetry for Rover {
///     const STREAMS: &'static [Stream] = &[
///         Stream::of::<Attitude>().every(Duration::from_millis(250)).onboard(Duration::from_millis(20)),
///         Stream::of::<BatteryStatus>().every(Duration::from_secs(2)).in_group(MavDataStream::EXTRA3),
///     ];
///
///     fn fill(&mut self, id: u32, out: Fill<'_>) -> bool {
///         let time_boot_ms = out.now().as_millis() as u32;
///         match id {
///             Attitude::ID => out.put(&Attitude { time_boot_ms, yaw: self.yaw, ..Attitude::UNKNOWN }),
///             // The second pack is not measured.
///             BatteryStatus::ID if out.index() == 0 => {
///                 let mut voltages = BatteryStatus::UNKNOWN.voltages;
///                 voltages[..4].copy_from_slice(&self.cells);
///                 out.put(&BatteryStatus { voltages, ..BatteryStatus::UNKNOWN })
///             }
///             _ => false,
///         }
///     }
/// }
/// ```
pub trait Telemetry {
    /// The messages that the vehicle can fill, with the intervals at which it sends them unasked: at most
    /// [`MAX_STREAMS`](crate::MAX_STREAMS) and what the [`Stack`](crate::Stack) has room for, none of them one that the stack
    /// sends itself, or it does not compile. With none, as at first, the service is not linked.
    const STREAMS: &'static [Stream] = &[];

    /// Fills message `id` of [`STREAMS`](Self::STREAMS) and hands it to [`Fill::put`], whose result is this one's. False
    /// when there is no such message now, no position without a fix for example: then a request is refused (Q-1), and a
    /// stream leaves one out. Also called to find out which of the two, so it must change nothing that matters.
    fn fill(&mut self, id: u32, out: Fill<'_>) -> bool {
        let _ = (id, out);
        false
    }
}

/// A vehicle with all that the stack needs: the bound of [`Stack::poll`](crate::Stack::poll). Implemented by itself.
pub trait Autopilot: Vehicle + Commands + Plans + Telemetry + Parameters {}

impl<T: Vehicle + Commands + Plans + Telemetry + Parameters> Autopilot for T {}
