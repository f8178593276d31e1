//! Commands: COMMAND_LONG and COMMAND_INT, their results, their progress, and COMMAND_CANCEL.
//!
//! | | QGroundControl | MAVSDK | MAVProxy, pymavlink |
//! |---|---|---|---|
//! | waits for the answer | 1.5 s, then 0.5 s for each retry | 0.5 s | never gives up; here [`Client::patience`] |
//! | tries | 1; 3 for requests of messages and the like | 4 | 1 |
//! | `confirmation` of a retry | counts up | 0 | |
//! | after IN_PROGRESS | 1.5 s, and no retry | 3 s, then the retries | as before |
//! | answers to others | taken | ignored | taken |
//! | parameters not given | 0 | NaN | 0 |
//!
//! QGroundControl means 1.2 s. It looks every 0.5 s, and counts from the first try.

use crate::names::Named;
use crate::{Client, Dialogue, Due, Failure, Io, Received, Retry};
use mavstack::dialect::{CommandAck, CommandCancel, CommandInt, CommandLong, MavCmd, MavFrame, MavResult};
use mavstack::{Address, Duration, Instant};

/// A place for a COMMAND_INT, or an item of a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// What the altitude is measured from.
    pub frame: MavFrame,
    /// Latitude (deg).
    pub latitude: f64,
    /// Longitude (deg).
    pub longitude: f64,
    /// Altitude (m), as the frame counts it.
    pub altitude: f32,
}

impl Place {
    /// Returns a place with an altitude above mean sea level: latitude and longitude (deg), altitude (m).
    pub const fn global(latitude: f64, longitude: f64, altitude: f32) -> Self {
        Self { frame: MavFrame::GLOBAL, latitude, longitude, altitude }
    }

    /// Returns a place with an altitude above home: latitude and longitude (deg), altitude (m).
    pub const fn relative(latitude: f64, longitude: f64, altitude: f32) -> Self {
        Self { frame: MavFrame::GLOBAL_RELATIVE_ALT, latitude, longitude, altitude }
    }

    /// Returns latitude and longitude (deg·1e7).
    pub fn scaled(&self) -> (i32, i32) {
        let scaled = |degrees: f64| (degrees * 1e7).round() as i32;
        (scaled(self.latitude), scaled(self.longitude))
    }
}

/// A command that was accepted.
#[derive(Clone, Debug, PartialEq)]
pub struct Accepted {
    /// [`MavResult::ACCEPTED`]; [`MavResult::IN_PROGRESS`] if the dialogue [does not wait](Send::without_waiting).
    pub result: MavResult,
    /// The `result_param2` of the answer.
    pub param: i32,
    /// The progress reports (%), in order; 255 is unknown.
    pub progress: Vec<u8>,
}

/// The form of a command.
#[derive(Clone, Copy, Debug)]
enum Form {
    Long(CommandLong),
    Int(CommandInt),
}

/// How a dialogue ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    /// With the final result.
    Result,
    /// With the first report of progress, too.
    Progress,
    /// With the final result, after COMMAND_CANCEL this long after the first try.
    Cancel(Duration),
}

/// Sends a command and waits for its result.
///
/// ```
/// use mavstack::dialect::MavCmd;
/// use mavstack_station::command::{Place, Send};
/// let arm = Send::new(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
/// let go = Send::at(MavCmd::DO_REPOSITION, &[-1.0], Place::relative(47.4, 8.5, 20.0));
/// # let _ = (arm, go);
/// ```
#[derive(Clone, Debug)]
pub struct Send {
    form: Form,
    /// The number of parameters that were given.
    given: usize,
    target: Option<Address>,
    end: End,
    timing: Option<Timing>,
    running: Option<Running>,
    progress: Vec<u8>,
    result: Option<CommandAck>,
}

/// The timers of a client.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Timing {
    /// The time for an answer to the first try.
    pub first: Duration,
    /// The time for an answer to each other try.
    pub wait: Duration,
    /// The number of tries.
    pub tries: u32,
}

/// A command that was sent.
#[derive(Clone, Copy, Debug)]
struct Running {
    retry: Retry,
    since: Instant,
    is_cancelled: bool,
}

/// When QGroundControl notices that 1.2 s are over.
const QGROUNDCONTROL_WAIT: Duration = Duration::from_millis(1_500);

impl Timing {
    /// Returns timers with the same time for every try.
    pub(crate) fn even(wait: Duration, tries: u32) -> Self {
        Self { first: wait, wait, tries }
    }

    /// Returns the timers of a client for a command.
    pub(crate) fn of(client: Client, command: MavCmd) -> Self {
        match client {
            Client::QGroundControl => Self {
                first: QGROUNDCONTROL_WAIT,
                wait: Duration::from_millis(500),
                tries: if is_retried_by_qgroundcontrol(command) { 3 } else { 1 },
            },
            Client::Mavsdk => Self::even(Duration::from_millis(500), 4),
            Client::MavProxy | Client::Pymavlink => Self::even(client.patience(), 1),
        }
    }
}

/// QGroundControl repeats only requests: a command that takes effect seconds after the operator gave it up is dangerous.
fn is_retried_by_qgroundcontrol(command: MavCmd) -> bool {
    [
        MavCmd::REQUEST_AUTOPILOT_CAPABILITIES,
        MavCmd::REQUEST_MESSAGE,
        MavCmd::PREFLIGHT_STORAGE,
        MavCmd::RUN_PREARM_CHECKS,
    ]
    .contains(&command)
}

impl Send {
    /// Creates a command in the form COMMAND_LONG. `params` are its first parameters, at most 7; the client fills the others.
    pub fn new(command: MavCmd, params: &[f32]) -> Self {
        let params = &params[..params.len().min(7)];
        let mut all = [f32::NAN; 7];
        all[..params.len()].copy_from_slice(params);
        let [param1, param2, param3, param4, param5, param6, param7] = all;
        let message = CommandLong {
            command,
            param1,
            param2,
            param3,
            param4,
            param5,
            param6,
            param7,
            target_system: 0,
            target_component: 0,
            confirmation: 0,
        };
        Self::of(Form::Long(message), params.len())
    }

    /// Creates a command in the form COMMAND_INT, at a place. `params` are its first parameters, at most 4; the client fills the
    /// others.
    pub fn at(command: MavCmd, params: &[f32], place: Place) -> Self {
        let params = &params[..params.len().min(4)];
        let mut all = [f32::NAN; 4];
        all[..params.len()].copy_from_slice(params);
        let [param1, param2, param3, param4] = all;
        let (x, y) = place.scaled();
        let message = CommandInt {
            command,
            frame: place.frame,
            param1,
            param2,
            param3,
            param4,
            x,
            y,
            z: place.altitude,
            ..CommandInt::default()
        };
        Self::of(Form::Int(message), params.len())
    }

    /// Sends this COMMAND_LONG as it is, except for the target.
    pub fn long(message: CommandLong) -> Self {
        Self::of(Form::Long(message), 7)
    }

    /// Sends this COMMAND_INT as it is, except for the target.
    pub fn int(message: CommandInt) -> Self {
        Self::of(Form::Int(message), 4)
    }

    fn of(form: Form, given: usize) -> Self {
        Self {
            form,
            given,
            target: None,
            end: End::Result,
            timing: None,
            running: None,
            progress: Vec::new(),
            result: None,
        }
    }

    /// Sends it to another component than the [target](Io::target) of the station. Component 0 means all.
    #[must_use]
    pub fn to(mut self, target: Address) -> Self {
        self.target = Some(target);
        self
    }

    /// Ends with the first report of progress, so that something else can be done while a long-running command runs.
    #[must_use]
    pub fn without_waiting(mut self) -> Self {
        self.end = End::Progress;
        self
    }

    /// Sends COMMAND_CANCEL this long after the first try, if there is no final result. A command that was cancelled ends as
    /// [`Failure::Command`] with [`MavResult::CANCELLED`].
    #[must_use]
    pub fn cancelled_after(mut self, time: Duration) -> Self {
        self.end = End::Cancel(time);
        self
    }

    /// Uses other timers than the client's for commands.
    pub(crate) fn with_timing(mut self, timing: Timing) -> Self {
        self.timing = Some(timing);
        self
    }

    /// Returns the command.
    pub fn command(&self) -> MavCmd {
        match &self.form {
            Form::Long(message) => message.command,
            Form::Int(message) => message.command,
        }
    }

    fn begin(&mut self, io: &Io<'_>) -> Running {
        let Timing { first, wait, tries } = self.timing.unwrap_or_else(|| Timing::of(io.client(), self.command()));
        let target = *self.target.get_or_insert(io.target());
        let (target_system, target_component) = (target.system.wire(), target.component.wire());
        // MAVSDK fills with NaN; the others fill with 0.
        let fills = io.client() != Client::Mavsdk;
        match &mut self.form {
            Form::Long(message) => {
                *message = CommandLong { target_system, target_component, ..*message };
                let params = [
                    &mut message.param1,
                    &mut message.param2,
                    &mut message.param3,
                    &mut message.param4,
                    &mut message.param5,
                    &mut message.param6,
                    &mut message.param7,
                ];
                params.into_iter().skip(self.given).filter(|_| fills).for_each(|param| *param = 0.0);
            }
            Form::Int(message) => {
                *message = CommandInt { target_system, target_component, ..*message };
                let params = [&mut message.param1, &mut message.param2, &mut message.param3, &mut message.param4];
                params.into_iter().skip(self.given).filter(|_| fills).for_each(|param| *param = 0.0);
            }
        }
        Running { retry: Retry::new(wait, tries).with_first(first), since: io.now(), is_cancelled: false }
    }

    /// Sends the try with this number, from 1. Only QGroundControl counts them.
    fn transmit(&self, io: &mut Io<'_>, try_number: u32) {
        match &self.form {
            Form::Long(message) if io.client() == Client::QGroundControl => {
                let retries = u8::try_from(try_number.saturating_sub(1)).unwrap_or(u8::MAX);
                io.send(&CommandLong { confirmation: message.confirmation.saturating_add(retries), ..*message });
            }
            Form::Long(message) => io.send(message),
            Form::Int(message) => io.send(message),
        }
    }

    /// Returns the result if it has ended.
    fn outcome(&self) -> Option<Result<Accepted, Failure>> {
        let ack = self.result?;
        let accepted = || Accepted { result: ack.result, param: ack.result_param2, progress: self.progress.clone() };
        match ack.result {
            MavResult::ACCEPTED => Some(Ok(accepted())),
            MavResult::IN_PROGRESS => (self.end == End::Progress).then(|| Ok(accepted())),
            result => Some(Err(Failure::Command { command: self.command(), result, text: None })),
        }
    }

    /// Whether the client takes this answer for its own.
    fn takes(&self, io: &Io<'_>, frame: &Received, ack: &CommandAck) -> bool {
        let Some(target) = self.target.filter(|_| ack.command == self.command()) else { return false };
        let is_from = |of: u8, from: u8| of == 0 || of == from;
        let source = frame.source();
        let is_from_target = is_from(target.system.wire(), source.system.wire())
            && is_from(target.component.wire(), source.component.wire());
        // Only MAVSDK looks at the addressee.
        is_from_target && (io.client() != Client::Mavsdk || io.is_for_us(ack.target_system, ack.target_component))
    }
}

impl Dialogue for Send {
    type Output = Accepted;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Accepted, Failure>> {
        if let Some(outcome) = self.outcome() {
            return Some(outcome);
        }
        let mut running = match self.running {
            Some(running) => running,
            None => self.begin(io),
        };
        let due = running.retry.due(io.now());
        if due == Due::Send {
            self.transmit(io, running.retry.tries());
        }
        if let End::Cancel(time) = self.end
            && !running.is_cancelled
            && io.now() - running.since >= time
        {
            running.is_cancelled = true;
            send_cancel(io, self.command(), self.target);
        }
        self.running = Some(running);
        (due == Due::GiveUp).then(|| Err(Failure::timeout(self.command().named(), running.retry.tries())))
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        let Some(ack) = frame.decode::<CommandAck>().filter(|ack| self.takes(io, frame, ack)) else { return };
        let has_ended = self.result.is_some_and(|result| result.result != MavResult::IN_PROGRESS);
        if has_ended {
            return;
        }
        self.result = Some(ack);
        let Some(running) = self.running.as_mut().filter(|_| ack.result == MavResult::IN_PROGRESS) else { return };
        self.progress.push(ack.progress);
        match io.client() {
            Client::QGroundControl => running.retry.finish(io.now(), QGROUNDCONTROL_WAIT),
            Client::Mavsdk => running.retry.extend(io.now(), Duration::from_secs(3)),
            client => running.retry.extend(io.now(), client.patience()),
        }
    }
}

/// Sends COMMAND_CANCEL. It must name one component.
fn send_cancel(io: &mut Io<'_>, command: MavCmd, target: Option<Address>) {
    let target = target.unwrap_or(io.target());
    io.send(&CommandCancel { command, target_system: target.system.wire(), target_component: target.component.wire() });
}

/// Cancels a long-running command: COMMAND_CANCEL every second, at most 5 times, until the vehicle answers.
///
/// Ends with the final result of the command: [`MavResult::CANCELLED`], or another one if it ended before. None of the real clients
/// cancels commands.
#[derive(Clone, Debug)]
pub struct Cancel {
    command: MavCmd,
    retry: Retry,
    result: Option<MavResult>,
}

impl Cancel {
    /// Creates the dialogue.
    pub fn new(command: MavCmd) -> Self {
        Self { command, retry: Retry::new(Duration::from_secs(1), 5), result: None }
    }
}

impl Dialogue for Cancel {
    type Output = MavResult;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<MavResult, Failure>> {
        if let Some(result) = self.result {
            return Some(Ok(result));
        }
        match self.retry.due(io.now()) {
            Due::Wait => None,
            Due::Send => {
                send_cancel(io, self.command, None);
                None
            }
            Due::GiveUp => {
                let request = format!("COMMAND_CANCEL of {}", self.command.named());
                Some(Err(Failure::timeout(request, self.retry.tries())))
            }
        }
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        let is_final = |ack: &CommandAck| ack.command == self.command && ack.result != MavResult::IN_PROGRESS;
        if let Some(ack) = frame.decode::<CommandAck>().filter(is_final)
            && io.is_for_us(ack.target_system, ack.target_component)
        {
            self.result = Some(ack.result);
        }
    }
}
