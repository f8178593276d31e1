//! Requested messages, and the intervals of streams.
//!
//! | | QGroundControl | MAVSDK | MAVProxy, pymavlink |
//! |---|---|---|---|
//! | MAV_CMD_REQUEST_MESSAGE | 3 tries, after 1.5 s and 0.5 s | 2 tries, 0.5 s each | once |
//! | accepted, but no message | fails after 1 s | begins again after 1 s | waits |
//! | refused | fails | begins again: 5 times in all, every second time by the old command if there is one | fails |
//! | the message comes without the answer | is not enough | is enough | is enough |

use crate::command::{Send, Timing};
use crate::{Client, Dialogue, Failure, Io, Received};
use mavstack::dialect::{
    AutopilotVersion, CameraCaptureStatus, CameraInformation, CameraSettings, MavCmd, MavDataStream, MavResult,
    MessageInterval, ProtocolVersion, RequestDataStream, StorageInformation,
};
use mavstack::{Address, Duration, Instant, Message};

/// How long QGroundControl and MAVSDK wait for the message after the answer.
const MESSAGE_WITHIN: Duration = Duration::from_secs(1);
/// How often MAVSDK begins again.
const MAVSDK_RETRIES: u32 = 4;

/// Requests one message, and waits for it.
///
/// ```
/// use mavstack::dialect::{AutopilotVersion, AvailableModes};
/// use mavstack_station::streams::Request;
/// let version = Request::<AutopilotVersion>::new();
/// let second_mode = Request::<AvailableModes>::new().with_index(2);
/// # let _ = (version, second_mode);
/// ```
#[derive(Clone, Debug)]
pub struct Request<M> {
    index: u32,
    target: Option<Address>,
    send: Option<Send>,
    /// When the wait for the message ends.
    accepted_until: Option<Instant>,
    is_old: bool,
    /// How often MAVSDK has begun again.
    retries: u32,
    refusal: Option<Failure>,
    message: Option<M>,
}

impl<M: Message> Request<M> {
    /// Creates the dialogue.
    pub fn new() -> Self {
        Self {
            index: 0,
            target: None,
            send: None,
            accepted_until: None,
            is_old: false,
            retries: 0,
            refusal: None,
            message: None,
        }
    }

    /// Requests the message with this index (parameter 2), for example one mode of AVAILABLE_MODES.
    #[must_use]
    pub fn with_index(mut self, index: u32) -> Self {
        self.index = index;
        self
    }

    /// Requests it of another component than the [target](Io::target) of the station.
    #[must_use]
    pub fn of(mut self, target: Address) -> Self {
        self.target = Some(target);
        self
    }

    /// Uses the command from before MAV_CMD_REQUEST_MESSAGE, if the message has one.
    pub(crate) fn by_old_command(mut self) -> Self {
        self.is_old = true;
        self
    }

    fn begin(&mut self, client: Client) {
        let command = MavCmd::REQUEST_MESSAGE;
        let is_old = self.is_old || client == Client::Mavsdk && self.retries % 2 == 1;
        let send = match old_command::<M>().filter(|_| is_old) {
            Some((old, params)) => Send::new(old, params),
            None if self.index == 0 => Send::new(command, &[M::ID as f32]),
            None => Send::new(command, &[M::ID as f32, self.index as f32]),
        };
        let send = match self.target {
            Some(target) => send.to(target),
            None => send,
        };
        self.send = Some(match client {
            Client::Mavsdk => send.with_timing(Timing::even(Duration::from_millis(500), 2)),
            _ => send,
        });
        self.accepted_until = None;
    }

    /// Handles a failure: MAVSDK begins again, unless the command failed.
    fn fail(&mut self, client: Client, failure: Failure) -> Option<Failure> {
        let is_final = matches!(failure, Failure::Command { result: MavResult::FAILED | MavResult::CANCELLED, .. });
        if client != Client::Mavsdk || is_final {
            return Some(failure);
        }
        self.refusal = Some(failure);
        self.retries += 1;
        if self.retries > MAVSDK_RETRIES {
            return self.refusal.take();
        }
        self.send = None;
        None
    }
}

impl<M: Message> Default for Request<M> {
    fn default() -> Self {
        Self::new()
    }
}

/// Returns the command that requested this message before MAV_CMD_REQUEST_MESSAGE, and its parameters.
fn old_command<M: Message>() -> Option<(MavCmd, &'static [f32])> {
    match M::ID {
        AutopilotVersion::ID => Some((MavCmd::REQUEST_AUTOPILOT_CAPABILITIES, &[1.0])),
        ProtocolVersion::ID => Some((MavCmd::REQUEST_PROTOCOL_VERSION, &[1.0])),
        CameraInformation::ID => Some((MavCmd::REQUEST_CAMERA_INFORMATION, &[1.0])),
        CameraSettings::ID => Some((MavCmd::REQUEST_CAMERA_SETTINGS, &[1.0])),
        StorageInformation::ID => Some((MavCmd::REQUEST_STORAGE_INFORMATION, &[0.0, 1.0])),
        CameraCaptureStatus::ID => Some((MavCmd::REQUEST_CAMERA_CAPTURE_STATUS, &[1.0])),
        _ => None,
    }
}

impl<M: Message> Dialogue for Request<M> {
    type Output = M;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<M, Failure>> {
        // QGroundControl wants the answer, too.
        let is_enough = io.client() != Client::QGroundControl || self.accepted_until.is_some();
        if let Some(message) = self.message.take_if(|_| is_enough) {
            return Some(Ok(message));
        }
        if let Some(end) = self.accepted_until {
            let missing = Failure::timeout(format!("the request of {}, though accepted,", M::NAME), 1);
            return if io.now() < end { None } else { self.fail(io.client(), missing).map(Err) };
        }
        if self.send.is_none() {
            self.begin(io.client());
        }
        match self.send.as_mut()?.poll(io)? {
            Ok(_) => {
                let waits = matches!(io.client(), Client::QGroundControl | Client::Mavsdk);
                self.accepted_until = Some(io.now() + if waits { MESSAGE_WITHIN } else { io.client().patience() });
                self.message.take().map(Ok)
            }
            Err(Failure::Timeout { tries, .. }) => {
                let timeout = Failure::timeout(format!("the request of {}", M::NAME), tries);
                self.fail(io.client(), timeout).map(Err)
            }
            Err(failure) => self.fail(io.client(), failure).map(Err),
        }
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        let Some(send) = &mut self.send else { return };
        send.receive(io, frame);
        if frame.source() == self.target.unwrap_or(io.target()) && !is_of_another(frame, self.index) {
            self.message = frame.decode::<M>().or(self.message.take());
        }
    }
}

/// Whether a frame is the MESSAGE_INTERVAL of another message than the requested one: a late answer to an earlier request.
fn is_of_another(frame: &Received, index: u32) -> bool {
    frame.decode::<MessageInterval>().is_some_and(|interval| u32::from(interval.message_id) != index)
}

/// How often a message is streamed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interval {
    /// With this interval.
    Every(Duration),
    /// As the vehicle streams it by default.
    Default,
    /// Not at all.
    Off,
}

impl Interval {
    /// Returns the interval as messages carry it (µs).
    pub fn micros(self) -> f32 {
        match self {
            Self::Every(interval) => interval.as_micros() as f32,
            Self::Default => 0.0,
            Self::Off => -1.0,
        }
    }

    /// Returns the interval that a vehicle reports; `None` if it does not have the message.
    pub fn from_message(message: &MessageInterval) -> Option<Self> {
        match message.interval_us {
            0 => None,
            micros => {
                Some(u64::try_from(micros).map_or(Self::Off, |micros| Self::Every(Duration::from_micros(micros))))
            }
        }
    }
}

impl From<Duration> for Interval {
    fn from(interval: Duration) -> Self {
        Self::Every(interval)
    }
}

/// Returns the command that sets the interval of a message on this link.
pub fn set_interval<M: Message>(interval: impl Into<Interval>) -> Send {
    Send::new(MavCmd::SET_MESSAGE_INTERVAL, &[M::ID as f32, interval.into().micros()])
}

/// Requests all streams at a rate by REQUEST_DATA_STREAM, as MAVProxy does every 15 s, and old ground stations when they connect. The
/// message has no answer.
#[derive(Clone, Copy, Debug)]
pub struct DataStreams {
    rate: u16,
}

impl DataStreams {
    /// Creates the dialogue: `rate` in Hz; 4 is MAVProxy's default, 0 stops the streams.
    pub fn new(rate: u16) -> Self {
        Self { rate }
    }
}

impl Dialogue for DataStreams {
    type Output = ();

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<(), Failure>> {
        let target = io.target();
        io.send(&RequestDataStream {
            req_message_rate: self.rate,
            target_system: target.system.wire(),
            target_component: target.component.wire(),
            req_stream_id: MavDataStream::ALL,
            start_stop: u8::from(self.rate > 0),
        });
        Some(Ok(()))
    }

    fn receive(&mut self, _: &mut Io<'_>, _: &Received) {}
}

/// Waits for the next `M` of the vehicle.
#[derive(Clone, Copy, Debug)]
pub struct Await<M> {
    within: Duration,
    end: Option<Instant>,
    message: Option<M>,
}

impl<M: Message> Await<M> {
    /// Creates the dialogue, which fails after `within`.
    pub fn new(within: Duration) -> Self {
        Self { within, end: None, message: None }
    }
}

impl<M: Message> Dialogue for Await<M> {
    type Output = M;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<M, Failure>> {
        if let Some(message) = self.message.take() {
            return Some(Ok(message));
        }
        let end = *self.end.get_or_insert(io.now() + self.within);
        let missing = || Failure::Protocol(format!("no {} within {} ms", M::NAME, self.within.as_millis()));
        (io.now() >= end).then(|| Err(missing()))
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if frame.source() == io.target() && self.message.is_none() {
            self.message = frame.decode();
        }
    }
}
