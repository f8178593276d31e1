//! The examination: what is sent and measured, in its order. The checks judge what it gathers.
//!
//! Nothing is sent until a heartbeat says that the vehicle is disarmed, see [`Examiner`].

use mavstack::dialect::{Attitude, AutopilotVersion, CommandInt, CommandLong, Heartbeat, MavCmd, MavType, SystemTime};
use mavstack::{Address, Duration, Instant, Message};
use mavstack_station::command::Send;
use mavstack_station::connect::{Connect, Connected};
use mavstack_station::{Client, Drive, Failure, GroundStation, Received, SeenText, SeenVehicle, Sending};

use crate::changes;
use crate::chunks::{self, Chunks};
use crate::echo::Echo;
use crate::examiner::{Examiner, Load};
use crate::trace::{self, Trace};
use crate::{Depth, Options, Permission, Step, telemetry, timing};

/// How long the first heartbeat is awaited.
const FIRST_HEARTBEAT: Duration = Duration::from_secs(6);
/// How long the first answers are awaited: a full transmit queue of 1 KiB takes 4 s at 2,400 baud.
const LISTEN_PATIENCE: Duration = Duration::from_secs(6);
/// The rate that a line has at least (bytes/s): 2,400 baud.
const LEAST_RATE: f64 = 240.0;
/// The rate up to which a line is filled if it is not known (bytes/s): 57,600 baud, as most radios.
const MOST_RATE: f64 = 5_760.0;
/// The share of unanswered requests from which on nothing is changed.
const MAX_UNANSWERED: f64 = 0.3;
/// The time between two of the first requests: a small FIFO should not have to hold both.
const BETWEEN_REQUESTS: Duration = Duration::from_millis(120);
/// The time that a measurement of the vehicle's clock takes at least.
const CLOCK_TIME: Duration = Duration::from_secs(2);
/// What is not examined if the vehicle is armed.
const ARMED: &str = "everything that needs requests: the vehicle is armed";
/// What is not examined if the vehicle does not say whether it is armed.
const NOT_DISARMED: &str =
    "everything that needs requests: no heartbeat says that the vehicle is disarmed. If it is, add --disarmed";

/// What an examination has gathered.
#[derive(Clone, Debug, Default)]
pub struct Evidence {
    /// The rate of the line (bytes/s), if it is known.
    pub line_rate: Option<f64>,
    /// The vehicle: the sender of heartbeats, or of any frame.
    pub vehicle: Option<Address>,
    /// Its last heartbeat.
    pub heartbeat: Option<Heartbeat>,
    /// The time until the first heartbeat, and what came meanwhile.
    pub first: Trace,
    /// Whether any request was sent.
    pub is_asked: bool,
    /// Whether any request was answered.
    pub echo: Option<Echo>,
    /// Whether a request was answered only when its bytes were sent one by one.
    pub answers_slow_bytes: bool,
    /// The line idle, except for a few requests; without them if none may be sent.
    pub idle: Trace,
    /// The line nearly full, both ways.
    pub load: Option<Trace>,
    /// Bursts of different sizes.
    pub chunks: Option<Chunks>,
    /// While a parameter is stored.
    pub storing: Option<Trace>,
    /// While a plan is uploaded.
    pub planning: Option<Trace>,
    /// The intervals that the vehicle says, by the id of the message.
    pub intervals: Vec<(u32, Duration)>,
    /// How fast the vehicle's clock runs; 1 is right.
    pub clock_rate: Option<f64>,
    /// What the clients have learned.
    pub connected: Vec<(Client, Connected)>,
    /// Services that were tried because the capabilities announce them.
    pub services: Vec<(&'static str, Result<(), Failure>)>,
    /// Why the upload of a plan failed, if it was not refused.
    pub unanswered_plan: Option<Failure>,
    /// What is changed and was not read as it was before: what had which value.
    pub unrestored: Vec<String>,
    /// The vehicle's texts.
    pub texts: Vec<SeenText>,
    /// What was not examined, and why.
    pub skipped: Vec<String>,
    /// Why nothing was sent, or nothing more: the vehicle was armed, its heartbeats stopped, or the transport failed.
    pub ended_by: Option<Failure>,
    /// Bytes received, in frames or not.
    pub any_byte: bool,
}

impl Evidence {
    /// Returns the rate of the line (bytes/s). If it is not known, it is what bursts have shown, up to that of a usual radio.
    pub fn rate(&self) -> f64 {
        let shown = || self.chunks.as_ref().and_then(Chunks::rate);
        self.line_rate.unwrap_or_else(|| shown().unwrap_or(LEAST_RATE).clamp(LEAST_RATE, MOST_RATE))
    }
}

/// Gathers the evidence. A failure ends the examination early: what was gathered until then is returned.
pub fn gather<T: Drive>(drive: &mut T, options: &Options, progress: &mut dyn FnMut(Step)) -> Evidence {
    let mut examiner = Examiner::new(drive);
    let mut evidence = Evidence { line_rate: options.line_rate.map(f64::from), ..Evidence::default() };
    if let Err(failure) = steps(&mut examiner, &mut evidence, options, progress) {
        evidence.skipped.push(format!("the remaining steps: {failure}"));
        evidence.ended_by = Some(failure);
    }
    if evidence.clock_rate.is_none() {
        evidence.clock_rate = trace::clock_rate(examiner.frames(), CLOCK_TIME);
    }
    note_texts(&mut examiner, &mut evidence);
    evidence
}

/// All steps, in order.
fn steps<T: Drive>(
    examiner: &mut Examiner<'_, T>,
    evidence: &mut Evidence,
    options: &Options,
    progress: &mut dyn FnMut(Step),
) -> Result<(), Failure> {
    let idle_time = Duration::from_secs(if options.depth == Depth::Quick { 4 } else { 10 });
    progress(Step::Listening);
    listen(examiner, evidence, options.permission)?;
    if !evidence.is_asked && evidence.vehicle.is_some() {
        progress(Step::Idle);
        let (idle, result) = examiner.listen(idle_time);
        evidence.idle = idle;
        return result;
    }
    if evidence.echo.is_none() {
        return Ok(());
    }
    progress(Step::Idle);
    idle(examiner, evidence, idle_time)?;
    let is_silent = evidence.idle.arrivals(Heartbeat::ID).is_empty();
    let why = match options.depth {
        _ if is_silent => Some("it sends no heartbeats"),
        Depth::Quick => Some("the examination is a quick one"),
        _ => None,
    };
    if let Some(why) = why {
        evidence.skipped.push(format!("what loads the vehicle, and the clients: {why}"));
        return Ok(());
    }
    full(examiner, evidence, options.depth, progress)
}

/// The steps that load and change the vehicle, and the clients.
fn full<T: Drive>(
    examiner: &mut Examiner<'_, T>,
    evidence: &mut Evidence,
    depth: Depth,
    progress: &mut dyn FnMut(Step),
) -> Result<(), Failure> {
    let mut begin = |examiner: &mut Examiner<'_, T>, step| {
        examiner.ensure_disarmed()?;
        progress(step);
        Ok::<(), Failure>(())
    };
    begin(examiner, Step::Intervals)?;
    evidence.intervals = changes::intervals(examiner, &evidence.idle)?;
    if telemetry::is_overloaded(evidence) {
        evidence.skipped.push("what loads the vehicle, and the clients: its streams fill the line".into());
        return Ok(());
    }
    begin(examiner, Step::Bursts)?;
    let answer_time = timing::answer_times(&evidence.idle).map_or(Duration::ZERO, |[.., longest]| longest);
    evidence.chunks = Some(chunks::measure(examiner, evidence.rate(), answer_time)?);
    // What could not be restored is not changed.
    if evidence.idle.unanswered() > MAX_UNANSWERED {
        evidence.skipped.push("what changes the vehicle, and the clients: too many requests are lost".into());
        return Ok(());
    }
    begin(examiner, Step::Load)?;
    changes::load(examiner, evidence)?;
    begin(examiner, Step::Storing)?;
    changes::store(examiner, evidence)?;
    if depth == Depth::WithPlan {
        begin(examiner, Step::Plan)?;
        changes::plan(examiner, evidence)?;
    } else {
        evidence.skipped.push("the upload of a plan: only with --write".into());
    }
    begin(examiner, Step::Clients)?;
    clients(examiner, evidence)?;
    services(examiner, evidence)
}

/// Waits for a heartbeat. If it says that the vehicle is disarmed, looks for a request that is answered.
fn listen<T: Drive>(
    examiner: &mut Examiner<'_, T>,
    evidence: &mut Evidence,
    permission: Permission,
) -> Result<(), Failure> {
    let before = examiner.station().counters();
    let (first, result) = examiner.trace(|examiner, _| {
        let has_heard = await_vehicle(examiner)?;
        if has_heard || permission == Permission::User {
            evidence.is_asked = may_send(examiner, permission);
        }
        if !evidence.is_asked {
            return Ok(());
        }
        evidence.echo = find_echo(examiner)?;
        // It may have sent nothing before.
        choose_vehicle(examiner);
        if evidence.echo.is_none() {
            evidence.answers_slow_bytes = answers_slow_bytes(examiner)?;
        }
        Ok(())
    });
    let after = examiner.station().counters();
    let is_frame = after.frames != before.frames || after.unchecked != before.unchecked;
    evidence.any_byte = is_frame || first.damaged + first.stray > 0;
    evidence.vehicle = examiner.station().target();
    note_heartbeat(examiner, evidence);
    if !evidence.is_asked && result.is_ok() {
        let is_armed = examiner.station().is_any_armed();
        evidence.ended_by = is_armed.then_some(Failure::Armed);
        evidence.skipped.push(if is_armed { ARMED.into() } else { NOT_DISARMED.into() });
    }
    evidence.first = first;
    result
}

/// Waits for a vehicle, and sends nothing. Without heartbeats of an autopilot it may be any component but a ground station. Returns whether
/// it has sent a heartbeat: one that was heard before may be out of date.
fn await_vehicle<T: Drive>(examiner: &mut Examiner<'_, T>) -> Result<bool, Failure> {
    let (began, end) = (examiner.now(), examiner.now() + FIRST_HEARTBEAT);
    let is_new = |at: Instant| at > began;
    while !examiner.last_heartbeat().is_some_and(is_new) && examiner.step()? < end {}
    choose_vehicle(examiner);
    Ok(examiner.last_heartbeat().is_some_and(is_new))
}

/// Speaks with the autopilot that was heard, or with another component.
fn choose_vehicle<T: Drive>(examiner: &mut Examiner<'_, T>) {
    if examiner.station().target().is_some() {
        return;
    }
    let is_station = |heard: &SeenVehicle| heard.heartbeat.is_some_and(|heartbeat| heartbeat.r#type == MavType::GCS);
    let heard = examiner.station().seen().components();
    let heard = heard.min_by_key(|heard| (is_station(heard), heard.heartbeat.is_none()));
    if let Some(address) = heard.map(|heard| heard.address) {
        examiner.station().set_target(address);
    }
}

/// Begins to send, if a heartbeat has said that the vehicle is disarmed, or the user has. Returns whether it has begun.
fn may_send<T: Drive>(examiner: &mut Examiner<'_, T>, permission: Permission) -> bool {
    examiner.begin(match permission {
        Permission::Heartbeat => Sending::WhileDisarmed,
        Permission::User => Sending::UnlessArmed,
    });
    let may_send = examiner.station().may_send();
    if !may_send {
        examiner.begin(Sending::Never);
    }
    may_send
}

/// Measures while the line is idle, and the vehicle's clock.
fn idle<T: Drive>(examiner: &mut Examiner<'_, T>, evidence: &mut Evidence, time: Duration) -> Result<(), Failure> {
    let (idle, result) = examiner.measure(Load::idle(time));
    evidence.idle = idle;
    result?;
    if evidence.idle.damaged > 0 {
        // Which direction it is shows only in many requests.
        let (more, result) = examiner.measure(Load::idle(time * 2));
        evidence.idle.extend(more);
        result?;
    }
    evidence.clock_rate = clock_rate(examiner, &evidence.idle)?;
    Ok(())
}

/// Sends all kinds of requests, and returns the best one that is answered.
fn find_echo<T: Drive>(examiner: &mut Examiner<'_, T>) -> Result<Option<Echo>, Failure> {
    const ROUNDS: u32 = 3;
    let (began, first) = (examiner.now(), examiner.frames().len());
    let mut sent = Vec::new();
    for echo in [Echo::ALL; ROUNDS as usize].concat() {
        let (now, target) = (examiner.now(), examiner.target());
        echo.send(examiner.station(), now, target);
        sent.push((echo, now));
        examiner.wait(BETWEEN_REQUESTS)?;
    }
    let is_answer = |frame: &Received| sent.iter().any(|(echo, at)| echo.is_answer(frame, *at));
    let end = examiner.now() + LISTEN_PATIENCE;
    while !examiner.frames_after(first).iter().any(is_answer) && examiner.step()? < end {}
    let frames = examiner.frames_after(first);
    let is_answered = |echo: &Echo| {
        sent.iter().any(|(other, at)| other == echo && frames.iter().any(|frame| echo.is_answer(frame, *at)))
    };
    let best = Echo::ALL.into_iter().find(is_answered);
    if let (Some(echo), Some(answer)) = (best, frames.iter().find(|frame| is_answer(frame))) {
        examiner.patience = (answer.at - began) * 2 + Duration::from_secs(1);
        examiner.echo = echo;
    }
    Ok(best)
}

/// Whether a request is answered if its bytes arrive one by one: then the receiver loses bytes that follow each other.
fn answers_slow_bytes<T: Drive>(examiner: &mut Examiner<'_, T>) -> Result<bool, Failure> {
    let interval = examiner.station().client().heartbeat_interval();
    // A heartbeat in between would not be slow.
    examiner.station().set_heartbeats(None);
    let is_answered = any_slow_answer(examiner)?;
    examiner.station().set_heartbeats(interval);
    Ok(is_answered)
}

fn any_slow_answer<T: Drive>(examiner: &mut Examiner<'_, T>) -> Result<bool, Failure> {
    for echo in Echo::ALL {
        let (now, target) = (examiner.now(), examiner.target());
        examiner.step()?;
        echo.send(examiner.station(), now, target);
        let bytes = examiner.station().take_output();
        examiner.send_slowly(&bytes, Duration::from_millis(10))?;
        if examiner.until(Duration::from_secs(1), |frame| echo.is_answer(frame, now))? {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Returns how fast the vehicle's clock runs. Requests a message with a time if none is streamed.
fn clock_rate<T: Drive>(examiner: &mut Examiner<'_, T>, idle: &Trace) -> Result<Option<f64>, Failure> {
    let least = CLOCK_TIME;
    // A stack whose clock is too slow sends no heartbeats, and answers late.
    let has_heartbeats = !idle.arrivals(Heartbeat::ID).is_empty();
    let patience = Duration::from_secs(if has_heartbeats { 3 } else { 30 });
    for id in [Attitude::ID, SystemTime::ID] {
        let rate = trace::clock_rate(examiner.frames(), least);
        if rate.is_some() {
            return Ok(rate);
        }
        // Two messages tell how much time has passed between them.
        while request(examiner, id, patience)? && trace::clock_rate(examiner.frames(), least).is_none() {
            examiner.wait(least)?;
        }
    }
    Ok(trace::clock_rate(examiner.frames(), least))
}

/// Requests a message. Returns whether it came.
fn request<T: Drive>(examiner: &mut Examiner<'_, T>, id: u32, patience: Duration) -> Result<bool, Failure> {
    let target = examiner.target();
    examiner.station().send(&CommandLong {
        param1: id as f32,
        command: MavCmd::REQUEST_MESSAGE,
        target_system: target.system.wire(),
        target_component: target.component.wire(),
        ..CommandLong::default()
    });
    examiner.until(patience, |frame| frame.header.id == id)
}

/// Connects as each client.
fn clients<T: Drive>(examiner: &mut Examiner<'_, T>, evidence: &mut Evidence) -> Result<(), Failure> {
    for client in [Client::QGroundControl, Client::Mavsdk, Client::MavProxy] {
        become_client(examiner, evidence, client)?;
        // Requests that were sent before are answered first.
        if let Some(connected) = changes::answered(examiner.run(Connect::new()))? {
            evidence.connected.push((client, connected));
        }
    }
    become_client(examiner, evidence, Client::QGroundControl)
}

/// Behaves as another client from now on. The texts of the last one are kept.
fn become_client<T: Drive>(
    examiner: &mut Examiner<'_, T>,
    evidence: &mut Evidence,
    client: Client,
) -> Result<(), Failure> {
    note_texts(examiner, evidence);
    examiner.become_client(client)
}

/// Tries the services that the capabilities announce.
fn services<T: Drive>(examiner: &mut Examiner<'_, T>, evidence: &mut Evidence) -> Result<(), Failure> {
    use mavstack::dialect::MavProtocolCapability as Capability;
    let connected = evidence.connected.iter().map(|(_, connected)| connected.capabilities());
    let announced = connected.fold(Capability::EMPTY, |all, capabilities| all | capabilities);
    let mut note = |name, result: Result<(), Failure>| match result {
        Err(failure) if changes::is_end(&failure) => Err(failure),
        result => {
            evidence.services.push((name, result));
            Ok(())
        }
    };
    if announced.contains(Capability::COMMAND_INT) {
        let target = examiner.target();
        let request = CommandInt {
            param1: AutopilotVersion::ID as f32,
            command: MavCmd::REQUEST_MESSAGE,
            target_system: target.system.wire(),
            target_component: target.component.wire(),
            ..CommandInt::default()
        };
        note("COMMAND_INT", examiner.run(Send::int(request)).map(drop))?;
    }
    if announced.contains(Capability::FTP) {
        note("FTP", examiner.list_files("/").map(drop))?;
    }
    if announced.contains(Capability::MISSION_INT) {
        note("MISSION_INT", examiner.download_mission().map(drop))?;
    }
    if announced.contains(Capability::MISSION_FENCE) {
        note("MISSION_FENCE", examiner.download_fence().map(drop))?;
    }
    if announced.contains(Capability::MISSION_RALLY) {
        note("MISSION_RALLY", examiner.download_rally().map(drop))?;
    }
    Ok(())
}

/// Notes the texts that this client has received, once for each client.
fn note_texts<T: Drive>(examiner: &mut Examiner<'_, T>, evidence: &mut Evidence) {
    evidence.texts.extend(examiner.station().seen().texts().cloned());
    note_heartbeat(examiner, evidence);
}

/// Notes the vehicle's last heartbeat.
fn note_heartbeat<T: Drive>(examiner: &mut Examiner<'_, T>, evidence: &mut Evidence) {
    let seen = examiner.station().seen();
    let component = evidence.vehicle.and_then(|vehicle| seen.component(vehicle));
    evidence.heartbeat = component.and_then(|component| component.heartbeat).or(evidence.heartbeat);
}
