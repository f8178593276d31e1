//! Operator control: of several ground stations, one is in control of the vehicle.
//!
//! The messages are those of MAVLink's `development.xml`. QGroundControl has buttons for them; a script with another client sends the
//! same command. Source: QGroundControl's `GCSControlManager.cc`.

use crate::command::Send;
use crate::{Dialogue, Failure, Io, Received};
use mavstack::dialect::{CommandAck, CommandLong, MavCmd, MavResult};
use mavstack::{Address, Duration, Instant};

/// MAV_CMD_REQUEST_OPERATOR_CONTROL.
pub const REQUEST_OPERATOR_CONTROL: MavCmd = MavCmd(32_100);

/// GCS_CONTROL_STATUS_FLAGS_SYSTEM_MANAGER: it is about the whole system.
const SYSTEM_MANAGER: u8 = 1;
/// GCS_CONTROL_STATUS_FLAGS_TAKEOVER_ALLOWED: a request is granted.
const TAKEOVER_ALLOWED: u8 = 2;

/// How long CONTROL_STATUS is awaited, which vehicles send every second.
const STATUS: Duration = Duration::from_secs(5);

mavstack::message! {
    /// Which ground stations control the vehicle.
    pub struct ControlStatus: CONTROL_STATUS = 512, crc_extra = 21 {
        /// `GCS_CONTROL_STATUS_FLAGS`.
        flags: u8,
        /// The system in control; 0 if none is.
        gcs_main: u8,
        /// Further systems that may send commands; 0 is none.
        gcs_secondary: [u8; 10],
    }
}

impl ControlStatus {
    /// Whether it is about the whole system, not only its sender. QGroundControl ignores others.
    pub const fn is_of_system(&self) -> bool {
        self.flags & SYSTEM_MANAGER != 0
    }

    /// Whether a request for control is granted.
    pub const fn allows_takeover(&self) -> bool {
        self.flags & TAKEOVER_ALLOWED != 0 || self.gcs_main == 0
    }
}

/// Whether others may take over control from the station in control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Takeover {
    /// A request is granted.
    Allowed,
    /// A request is refused, and the station in control is asked.
    Asked,
}

/// The vehicle's answer to a request for control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// The station is in control.
    Granted,
    /// The station in control was asked.
    OwnerAsked,
}

/// Requests control. Ends with the vehicle's answer.
#[derive(Debug)]
pub struct Request {
    takeover: Takeover,
    timeout: Duration,
    command: Option<Send>,
}

impl Request {
    /// Requests control, and says whether others may take it over then. The station in control is asked for `timeout`, in whole
    /// seconds; QGroundControl asks for 10 s.
    pub fn new(takeover: Takeover, timeout: Duration) -> Self {
        Self { takeover, timeout, command: None }
    }
}

fn command(io: &Io<'_>, action: f32, takeover: Takeover, timeout: Duration) -> Send {
    let takeover = if takeover == Takeover::Allowed { 1.0 } else { 0.0 };
    let seconds = (timeout.as_millis() / 1_000) as f32;
    let system = f32::from(io.address().system.wire());
    Send::new(REQUEST_OPERATOR_CONTROL, &[action, takeover, seconds, system, 0.0]).without_waiting()
}

impl Dialogue for Request {
    type Output = Answer;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Answer, Failure>> {
        let command = self.command.get_or_insert_with(|| command(io, 1.0, self.takeover, self.timeout));
        Some(match command.poll(io)? {
            Ok(accepted) if accepted.result == MavResult::ACCEPTED => Ok(Answer::Granted),
            Ok(_) | Err(Failure::Command { result: MavResult::FAILED, .. }) => Ok(Answer::OwnerAsked),
            Err(failure) => Err(failure),
        })
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let Some(command) = &mut self.command {
            command.receive(io, frame);
        }
    }
}

/// Takes over control: requests it, waits until the station in control allows it, and requests it again.
#[derive(Debug)]
pub struct TakeOver {
    takeover: Takeover,
    patience: Duration,
    end: Option<Instant>,
    request: Option<Request>,
    is_allowed: bool,
}

impl TakeOver {
    /// Waits up to `patience` for the station in control.
    pub fn new(takeover: Takeover, patience: Duration) -> Self {
        Self { takeover, patience, end: None, request: None, is_allowed: true }
    }
}

impl Dialogue for TakeOver {
    type Output = ();

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<(), Failure>> {
        let end = *self.end.get_or_insert(io.now() + self.patience);
        if self.request.is_none() && self.is_allowed {
            self.request = Some(Request::new(self.takeover, self.patience));
        }
        if let Some(request) = &mut self.request {
            match request.poll(io)? {
                Ok(Answer::Granted) => return Some(Ok(())),
                Ok(Answer::OwnerAsked) => (self.request, self.is_allowed) = (None, false),
                Err(failure) => return Some(Err(failure)),
            }
        }
        let (command, result) = (REQUEST_OPERATOR_CONTROL, MavResult::FAILED);
        (io.now() >= end).then_some(Err(Failure::Command { command, result, text: None }))
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let Some(request) = &mut self.request {
            request.receive(io, frame);
        } else if let Some(status) = frame.decode::<ControlStatus>() {
            self.is_allowed |= status.is_of_system() && status.allows_takeover();
        }
    }
}

/// Releases control.
#[derive(Debug, Default)]
pub struct Release {
    command: Option<Send>,
}

impl Release {
    /// Creates the dialogue.
    pub fn new() -> Self {
        Self::default()
    }
}

impl Dialogue for Release {
    type Output = ();

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<(), Failure>> {
        let command = self.command.get_or_insert_with(|| command(io, 0.0, Takeover::Asked, Duration::ZERO));
        Some(command.poll(io)?.map(drop))
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let Some(command) = &mut self.command {
            command.receive(io, frame);
        }
    }
}

/// A request of another station that the station in control is asked about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Notice {
    /// The system that requests control.
    pub system: u8,
    /// Whether it would let others take over.
    pub takeover: Takeover,
    /// How long it waits.
    pub timeout: Duration,
}

/// Waits until the vehicle asks about a request of another station, and acknowledges that. Ends with the request; allow it by
/// [`Request`] with [`Takeover::Allowed`], or by [`Release`].
#[derive(Debug)]
pub struct AwaitNotice {
    limit: Duration,
    end: Option<Instant>,
    notice: Option<Notice>,
}

impl AwaitNotice {
    /// Waits up to `limit`. Vehicles repeat a question that was not acknowledged.
    pub fn new(limit: Duration) -> Self {
        Self { limit, end: None, notice: None }
    }
}

impl Dialogue for AwaitNotice {
    type Output = Notice;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Notice, Failure>> {
        let end = *self.end.get_or_insert(io.now() + self.limit);
        if let Some(notice) = self.notice {
            return Some(Ok(notice));
        }
        (io.now() >= end).then(|| Err(Failure::timeout("a question about operator control", 1)))
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        let Some(message) = frame.decode::<CommandLong>() else { return };
        let is_for_us = io.is_for_us(message.target_system, message.target_component);
        if message.command != REQUEST_OPERATOR_CONTROL || frame.source() != io.target() || !is_for_us {
            return;
        }
        acknowledge(io, frame.source());
        // QGroundControl ignores the release of another station.
        if message.param1 == 1.0 {
            self.notice = Some(Notice {
                system: message.param4 as u8,
                takeover: if message.param2 > 0.0 { Takeover::Allowed } else { Takeover::Asked },
                timeout: Duration::from_secs(message.param3 as u64),
            });
        }
    }
}

fn acknowledge(io: &mut Io<'_>, to: Address) {
    io.send(&CommandAck {
        command: REQUEST_OPERATOR_CONTROL,
        result: MavResult::ACCEPTED,
        target_system: to.system.wire(),
        target_component: to.component.wire(),
        ..CommandAck::default()
    });
}

/// Waits for the next CONTROL_STATUS about the whole system. Ends with it.
#[derive(Debug, Default)]
pub struct Status {
    end: Option<Instant>,
    status: Option<ControlStatus>,
}

impl Status {
    /// Creates the dialogue.
    pub fn new() -> Self {
        Self::default()
    }
}

impl Dialogue for Status {
    type Output = ControlStatus;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<ControlStatus, Failure>> {
        let end = *self.end.get_or_insert(io.now() + STATUS);
        if let Some(status) = self.status {
            return Some(Ok(status));
        }
        (io.now() >= end).then(|| Err(Failure::timeout("CONTROL_STATUS", 1)))
    }

    fn receive(&mut self, _: &mut Io<'_>, frame: &Received) {
        self.status = frame.decode().filter(ControlStatus::is_of_system).or(self.status);
    }
}
