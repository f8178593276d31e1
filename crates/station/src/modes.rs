//! Flight modes.
//!
//! | | QGroundControl | MAVSDK | MAVProxy, pymavlink |
//! |---|---|---|---|
//! | list (AVAILABLE_MODES) | one by one | none; here all at once | none; here all at once |
//! | set | SET_MODE, at most 3 times, 1.3 s each | MAV_CMD_DO_SET_MODE, PX4's main and sub mode | MAV_CMD_DO_SET_MODE |
//! | is set when | HEARTBEAT reports it | the command is accepted | the command is accepted |
//!
//! Here a mode is set when HEARTBEAT or CURRENT_MODE reports it: an accepted mode that is never reported is a fault of the vehicle.

use crate::command::Send;
use crate::streams::Request;
use crate::{Client, Dialogue, Due, Failure, Io, Received, Retry};
use mavstack::Duration;
use mavstack::dialect::{
    AvailableModes, CommandAck, CurrentMode, Heartbeat, MavCmd, MavModeFlag, MavModeProperty, MavResult,
    MavStandardMode, SetMode,
};
use std::collections::BTreeMap;

/// How long an accepted mode may take until it is reported. A heartbeat or two may be lost.
const REPORTED_WITHIN: Duration = Duration::from_secs(5);
/// Silence after which the modes are complete, or some were lost.
const SILENCE: Duration = Duration::from_secs(1);

/// A flight mode of the vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct Mode {
    /// Its number in HEARTBEAT.
    pub custom_mode: u32,
    /// Its name.
    pub name: String,
    /// The standard mode that it is, if any.
    pub standard_mode: MavStandardMode,
    /// Its properties.
    pub properties: MavModeProperty,
}

/// Lists the modes.
#[derive(Clone, Debug, Default)]
pub struct List {
    modes: BTreeMap<u8, Mode>,
    count: Option<u8>,
    request: Option<Request<AvailableModes>>,
    silence: Option<Retry>,
}

impl List {
    /// Creates the dialogue.
    pub fn new() -> Self {
        Self::default()
    }

    fn take(&mut self, message: &AvailableModes) {
        self.count = Some(message.number_modes);
        let mode = Mode {
            custom_mode: message.custom_mode,
            name: String::from_utf8_lossy(message.mode_name.as_bytes()).into_owned(),
            standard_mode: message.standard_mode,
            properties: message.properties,
        };
        self.modes.insert(message.mode_index, mode);
    }

    /// Returns the first mode that is missing; 0, which means all, for a client that asks for all at once.
    fn next(&self, client: Client) -> Option<u8> {
        let first = if client == Client::QGroundControl { 1 } else { 0 };
        let Some(count) = self.count else { return Some(first) };
        (1..=count).find(|index| !self.modes.contains_key(index))
    }

    fn is_complete(&self) -> bool {
        self.count.is_some_and(|count| usize::from(count) == self.modes.len())
    }

    /// Whether the modes that were all requested at once may still be coming.
    fn is_coming(&mut self, io: &Io<'_>) -> bool {
        self.silence.as_mut().is_some_and(|silence| silence.is_waiting(io.now()))
    }
}

impl Dialogue for List {
    type Output = Vec<Mode>;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Vec<Mode>, Failure>> {
        if let Some(request) = &mut self.request {
            match request.poll(io)? {
                Ok(message) => self.take(&message),
                Err(failure) => return Some(Err(failure)),
            }
            self.request = None;
        }
        if self.is_complete() {
            return Some(Ok(std::mem::take(&mut self.modes).into_values().collect()));
        }
        if !self.is_coming(io) {
            let next = self.next(io.client())?;
            self.request = Some(Request::new().with_index(next.into()));
        }
        None
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let Some(request) = &mut self.request {
            request.receive(io, frame);
        }
        let Some(message) = frame.decode::<AvailableModes>().filter(|_| frame.source() == io.target()) else { return };
        if io.client() != Client::QGroundControl {
            self.take(&message);
            self.silence.get_or_insert(Retry::new(SILENCE, 1)).extend(io.now(), SILENCE);
        }
    }
}

/// Sets the flight mode, and waits until the vehicle reports it.
#[derive(Clone, Debug)]
pub struct Set {
    wanted: Wanted,
    phase: Phase,
    /// The mode reported since the request.
    reported: Option<CurrentMode>,
    refusal: Option<MavResult>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Wanted {
    Custom(u32),
    Standard(MavStandardMode),
}

#[derive(Clone, Debug)]
enum Phase {
    New,
    /// By SET_MODE, which has no answer of its own.
    Message(Retry),
    Command(Send),
    /// The command was accepted.
    Accepted(Retry),
}

impl Set {
    /// Creates the dialogue for a mode by its number in HEARTBEAT.
    pub fn new(custom_mode: u32) -> Self {
        Self::wanting(Wanted::Custom(custom_mode))
    }

    /// Creates the dialogue for a standard mode, by MAV_CMD_DO_SET_STANDARD_MODE.
    pub fn standard(mode: MavStandardMode) -> Self {
        Self::wanting(Wanted::Standard(mode))
    }

    fn wanting(wanted: Wanted) -> Self {
        Self { wanted, phase: Phase::New, reported: None, refusal: None }
    }

    fn begin(&self, io: &Io<'_>) -> Phase {
        let flags = f32::from(MavModeFlag::CUSTOM_MODE_ENABLED.0);
        match (self.wanted, io.client()) {
            (Wanted::Standard(mode), _) => {
                Phase::Command(Send::new(MavCmd::DO_SET_STANDARD_MODE, &[f32::from(mode.0)]))
            }
            (Wanted::Custom(_), Client::QGroundControl) => Phase::Message(Retry::new(Duration::from_millis(1_300), 3)),
            (Wanted::Custom(mode), Client::Mavsdk) => {
                let armed =
                    f32::from((base_mode(io).0 & MavModeFlag::SAFETY_ARMED.0) | MavModeFlag::CUSTOM_MODE_ENABLED.0);
                let [low, _, main, sub] = mode.to_le_bytes();
                // MAVSDK knows only the modes of PX4, whose numbers have a main mode in the third byte.
                let (main, sub) = if main == 0 { (low, 0) } else { (main, sub) };
                Phase::Command(Send::new(MavCmd::DO_SET_MODE, &[armed, f32::from(main), f32::from(sub)]))
            }
            (Wanted::Custom(mode), Client::MavProxy | Client::Pymavlink) => {
                Phase::Command(Send::new(MavCmd::DO_SET_MODE, &[flags, mode as f32]))
            }
        }
    }

    fn is_reported(&self) -> bool {
        self.reported.is_some_and(|reported| match self.wanted {
            Wanted::Custom(mode) => reported.custom_mode == mode,
            Wanted::Standard(mode) => reported.standard_mode == mode,
        })
    }

    /// Sends SET_MODE with the flags of the last heartbeat.
    fn send_message(&self, io: &mut Io<'_>) {
        let Wanted::Custom(custom_mode) = self.wanted else { return };
        // The lower bits are those of MAV_MODE_FLAG; QGroundControl keeps all others.
        let base_mode = base_mode(io) | MavModeFlag::CUSTOM_MODE_ENABLED;
        io.send(&SetMode { custom_mode, target_system: io.target().system.wire(), base_mode });
    }

    fn unreported(&self) -> Failure {
        Failure::Protocol(format!("the vehicle accepted mode {:?} and does not report it", self.wanted))
    }
}

/// Returns the flags of the last heartbeat.
fn base_mode(io: &Io<'_>) -> MavModeFlag {
    let heartbeat = io.seen().component(io.target()).and_then(|component| component.heartbeat);
    heartbeat.map_or(MavModeFlag::EMPTY, |heartbeat| heartbeat.base_mode)
}

impl Dialogue for Set {
    type Output = ();

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<(), Failure>> {
        if matches!(self.phase, Phase::New) {
            self.phase = self.begin(io);
        }
        if matches!(self.phase, Phase::Message(_) | Phase::Accepted(_)) && self.is_reported() {
            return Some(Ok(()));
        }
        match &mut self.phase {
            Phase::New => None,
            Phase::Message(retry) => match (retry.due(io.now()), self.refusal) {
                (_, Some(result)) => Some(Err(Failure::Command { command: MavCmd::DO_SET_MODE, result, text: None })),
                (Due::Wait, _) => None,
                (Due::Send, _) => {
                    self.send_message(io);
                    None
                }
                (Due::GiveUp, _) => Some(Err(Failure::timeout("SET_MODE", retry.tries()))),
            },
            Phase::Command(send) => match send.poll(io)? {
                Ok(_) => {
                    let mut wait = Retry::new(REPORTED_WITHIN, 1);
                    wait.extend(io.now(), REPORTED_WITHIN);
                    self.phase = Phase::Accepted(wait);
                    None
                }
                Err(failure) => Some(Err(failure)),
            },
            Phase::Accepted(wait) if wait.is_waiting(io.now()) => None,
            Phase::Accepted(_) => Some(Err(self.unreported())),
        }
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let Phase::Command(send) = &mut self.phase {
            send.receive(io, frame);
        }
        if matches!(self.phase, Phase::New) || frame.source() != io.target() {
            return;
        }
        if let Some(heartbeat) = frame.decode::<Heartbeat>()
            && let Wanted::Custom(_) = self.wanted
        {
            let mode = CurrentMode { custom_mode: heartbeat.custom_mode, ..CurrentMode::default() };
            self.reported = Some(mode);
        }
        self.reported = frame.decode::<CurrentMode>().or(self.reported);
        // The answer to SET_MODE names the message's id as the command.
        let is_refusal = |ack: &CommandAck| ack.command == MavCmd(11) && ack.result != MavResult::ACCEPTED;
        self.refusal = frame.decode::<CommandAck>().filter(is_refusal).map(|ack| ack.result).or(self.refusal);
    }
}
