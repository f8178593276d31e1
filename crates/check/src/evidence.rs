//! The examination: what is sent and measured, in its order. The checks judge what it gathers.

use mavstack::dialect::{
    Attitude, AutopilotVersion, CommandInt, CommandLong, GlobalPositionInt, Heartbeat, MavCmd, MavParamType,
    MessageInterval, SystemTime,
};
use mavstack::{Address, Duration, Item, Message, PlanType};
use mavstack_station::command::{Place, Send};
use mavstack_station::connect::{Connect, Connected};
use mavstack_station::parameters::{Parameter, Value};
use mavstack_station::plans::{self, waypoint};
use mavstack_station::streams::{Interval, Request};
use mavstack_station::{Client, Drive, Failure, GroundStation, Received, SeenText, parameters};

use crate::chunks::{self, Chunks};
use crate::echo::Echo;
use crate::examiner::{Examiner, Load};
use crate::trace::{self, Trace};
use crate::{Depth, Options, Step, telemetry, timing};

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
/// How often a parameter or a plan is restored, until it is read as it was.
const RESTORE_TRIES: u32 = 5;
/// The time between two of the first requests: a small FIFO should not have to hold both.
const BETWEEN_REQUESTS: Duration = Duration::from_millis(120);
/// The most messages whose intervals are asked for.
const MAX_INTERVALS: usize = 16;

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
    /// Whether any request was answered.
    pub echo: Option<Echo>,
    /// Whether a request was answered only when its bytes were sent one by one.
    pub answers_slow_bytes: bool,
    /// A calm time with a few requests.
    pub calm: Trace,
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
    /// What is left changed, because restoring it failed.
    pub unrestored: Vec<String>,
    /// The vehicle's texts.
    pub texts: Vec<SeenText>,
    /// What was not examined, and why.
    pub skipped: Vec<String>,
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

/// Gathers the evidence.
///
/// # Errors
///
/// The transport failed.
pub fn gather<T: Drive>(drive: &mut T, options: &Options, progress: &mut dyn FnMut(Step)) -> Result<Evidence, Failure> {
    let mut examiner = Examiner::new(drive);
    let mut evidence = Evidence { line_rate: options.line_rate.map(f64::from), ..Evidence::default() };
    progress(Step::Listening);
    listen(&mut examiner, &mut evidence)?;
    if evidence.echo.is_none() {
        note_texts(&mut examiner, &mut evidence);
        return Ok(evidence);
    }
    progress(Step::Calm);
    let calm_time = Duration::from_secs(if options.depth == Depth::Quick { 4 } else { 10 });
    evidence.calm = examiner.measure(Load::calm(calm_time))?;
    if evidence.calm.damaged > 0 {
        // Which direction it is shows only in many requests.
        let more = examiner.measure(Load::calm(calm_time * 2))?;
        evidence.calm.extend(more);
    }
    evidence.clock_rate = clock_rate(&mut examiner, &evidence.calm)?;
    let is_armed = evidence.heartbeat.is_some_and(|heartbeat| is_armed(&heartbeat));
    let is_silent = evidence.calm.arrivals(Heartbeat::ID).is_empty();
    let why = match options.depth {
        _ if is_armed => Some("it is armed"),
        _ if is_silent => Some("it sends no heartbeats"),
        Depth::Quick => Some("the examination is a quick one"),
        _ => None,
    };
    if let Some(why) = why {
        evidence.skipped.push(format!("what loads the vehicle, and the clients: {why}"));
        note_texts(&mut examiner, &mut evidence);
        return Ok(evidence);
    }
    progress(Step::Intervals);
    evidence.intervals = intervals(&mut examiner, &evidence.calm)?;
    if telemetry::is_overloaded(&evidence) {
        evidence.skipped.push("what loads the vehicle, and the clients: its streams fill the line".into());
        note_texts(&mut examiner, &mut evidence);
        return Ok(evidence);
    }
    progress(Step::Bursts);
    let answer_time = timing::answer_times(&evidence.calm).map_or(Duration::ZERO, |[.., longest]| longest);
    evidence.chunks = Some(chunks::measure(&mut examiner, evidence.rate(), answer_time)?);
    progress(Step::Load);
    evidence.load = Some(load(&mut examiner, &evidence)?);
    // What could not be restored is not changed.
    if evidence.calm.unanswered() > MAX_UNANSWERED {
        evidence.skipped.push("what changes the vehicle, and the clients: too many requests are lost".into());
        note_texts(&mut examiner, &mut evidence);
        return Ok(evidence);
    }
    progress(Step::Storing);
    store(&mut examiner, &mut evidence)?;
    if options.depth == Depth::WithPlan {
        progress(Step::Plan);
        plan(&mut examiner, &mut evidence)?;
    } else {
        evidence.skipped.push("the upload of a plan: only with --write".into());
    }
    note_texts(&mut examiner, &mut evidence);
    progress(Step::Clients);
    clients(&mut examiner, &mut evidence)?;
    services(&mut examiner, &mut evidence)?;
    Ok(evidence)
}

fn is_armed(heartbeat: &Heartbeat) -> bool {
    heartbeat.base_mode.contains(mavstack::dialect::MavModeFlag::SAFETY_ARMED)
}

/// Waits for a heartbeat, then looks for a request that is answered.
fn listen<T: Drive>(examiner: &mut Examiner<'_, T>, evidence: &mut Evidence) -> Result<(), Failure> {
    let before = examiner.station().counters();
    let first = examiner.trace(|examiner| {
        let end = examiner.now() + FIRST_HEARTBEAT;
        while examiner.station().target().is_none() && examiner.step()? < end {}
        // Without heartbeats of an autopilot it may be any component.
        let heard = examiner.station().seen().components().next().map(|component| component.address);
        if let (None, Some(heard)) = (examiner.station().target(), heard) {
            examiner.station().set_target(heard);
        }
        evidence.echo = find_echo(examiner)?;
        if evidence.echo.is_none() {
            evidence.answers_slow_bytes = answers_slow_bytes(examiner)?;
        }
        Ok(Vec::new())
    })?;
    let after = examiner.station().counters();
    let is_frame = after.frames != before.frames || after.unchecked != before.unchecked;
    evidence.any_byte = is_frame || first.damaged + first.stray > 0;
    evidence.vehicle = examiner.station().target();
    note_heartbeat(examiner, evidence);
    evidence.first = first;
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
    while !examiner.frames()[first..].iter().any(is_answer) && examiner.step()? < end {}
    let frames = &examiner.frames()[first..];
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
fn clock_rate<T: Drive>(examiner: &mut Examiner<'_, T>, calm: &Trace) -> Result<Option<f64>, Failure> {
    let least = Duration::from_secs(2);
    // A stack whose clock is too slow sends no heartbeats, and answers late.
    let has_heartbeats = !calm.arrivals(Heartbeat::ID).is_empty();
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

/// Returns the intervals that the vehicle says of what it streams.
fn intervals<T: Drive>(examiner: &mut Examiner<'_, T>, calm: &Trace) -> Result<Vec<(u32, Duration)>, Failure> {
    let answer = [Heartbeat::ID, mavstack::dialect::Timesync::ID, mavstack::dialect::ParamValue::ID];
    let streamed = calm.ids().into_iter().filter(|(id, count)| *count >= 2 && !answer.contains(id));
    let mut intervals = Vec::new();
    for (id, _) in streamed.take(MAX_INTERVALS) {
        let request = Request::<MessageInterval>::new().with_index(id);
        if let Some(message) = transport(examiner.run(request))?
            && let Some(Interval::Every(interval)) = Interval::from_message(&message)
        {
            intervals.push((id, interval));
        }
    }
    Ok(intervals)
}

/// Fills the line: requests and heartbeats to the vehicle, ATTITUDE from it.
fn load<T: Drive>(examiner: &mut Examiner<'_, T>, evidence: &Evidence) -> Result<Trace, Failure> {
    /// ATTITUDE with its header, and a share for what else is streamed.
    const ATTITUDE_LEN: f64 = 40.0;
    let rate = evidence.rate();
    let before = transport(examiner.interval::<Attitude>())?.flatten();
    let share = (rate * 0.8 - evidence.calm.bytes_per_second()).max(ATTITUDE_LEN);
    let interval = Duration::from_micros((ATTITUDE_LEN / share * 1e6) as u64).max(Duration::from_millis(4));
    let is_streamed = evidence.calm.ids().contains_key(&Attitude::ID);
    if is_streamed {
        transport(examiner.set_interval::<Attitude>(interval))?;
    }
    let load = Load { fill: rate * 0.8, ..Load::calm(Duration::from_secs(6)) };
    let trace = examiner.measure(load)?;
    if is_streamed {
        transport(examiner.set_interval::<Attitude>(before.unwrap_or(Interval::Default)))?;
    }
    // What is queued on the way arrives before the next measurement.
    examiner.wait(Duration::from_secs(1))?;
    Ok(trace)
}

/// Changes a parameter by as little as possible, and restores it: twice the vehicle has something to store.
fn store<T: Drive>(examiner: &mut Examiner<'_, T>, evidence: &mut Evidence) -> Result<(), Failure> {
    let list = transport(examiner.run(parameters::List::new()))?.unwrap_or_default();
    let Some((name, value)) = list.iter().find_map(harmless) else {
        evidence.skipped.push("stalls while a parameter is stored: no parameter is a float other than 0".into());
        return Ok(());
    };
    let near = f32::from_bits(value.to_bits() + 1);
    let trace = examiner.trace(|examiner| {
        let mut probes = Vec::new();
        let load = Load { probe_every: Duration::from_millis(60), ..Load::calm(Duration::from_secs(4)) };
        for value in [near, value] {
            transport(examiner.set(&name, value))?;
            probes.extend(examiner.probe(load)?);
        }
        Ok(probes)
    })?;
    let mut is_restored = false;
    for _ in 0..RESTORE_TRIES {
        is_restored = transport(examiner.get(&name))? == Some(Value::F32(value));
        if is_restored {
            break;
        }
        transport(examiner.set(&name, value))?;
    }
    if !is_restored {
        evidence.unrestored.push(format!("{name} was {value}"));
    }
    evidence.storing = Some(trace);
    Ok(())
}

/// Returns a parameter that may change in its last bit: a float, and not 0, which often means "off".
fn harmless(parameter: &Parameter) -> Option<(String, f32)> {
    let Value::F32(value) = parameter.value else { return None };
    let is_float = parameter.param_type == MavParamType::REAL32;
    (is_float && value.is_normal() && value.abs() < 1e6).then(|| (parameter.name.clone(), value))
}

/// Uploads the mission that the vehicle has. If it has none, uploads one and clears it.
fn plan<T: Drive>(examiner: &mut Examiner<'_, T>, evidence: &mut Evidence) -> Result<(), Failure> {
    let Some(old) = transport(examiner.download_mission())? else {
        evidence.skipped.push("the upload of a plan: the mission could not be downloaded".into());
        return Ok(());
    };
    let items = if old.is_empty() { route(examiner) } else { old.clone() };
    let mut uploaded = Ok(0);
    let trace = examiner.trace(|examiner| {
        uploaded = examiner.upload_mission(&items);
        examiner.probe(Load::calm(Duration::from_secs(4)))
    })?;
    restore_plan(examiner, evidence, &old)?;
    match uploaded {
        Err(failure @ Failure::Transport(_)) => return Err(failure),
        // It may have its reasons, such as a place that is too far away.
        Err(failure @ Failure::Plan { .. }) => {
            evidence.skipped.push(format!("the upload of a plan to its end: {failure}"));
        }
        Err(failure) => evidence.unanswered_plan = Some(failure),
        Ok(_) => {}
    }
    evidence.planning = Some(trace);
    Ok(())
}

/// Makes sure that the vehicle has its old mission.
fn restore_plan<T: Drive>(
    examiner: &mut Examiner<'_, T>,
    evidence: &mut Evidence,
    old: &[Item],
) -> Result<(), Failure> {
    for _ in 0..RESTORE_TRIES {
        if transport(examiner.download_mission())?.is_some_and(|items| items == old) {
            return Ok(());
        }
        match old {
            [] => transport(examiner.run(plans::Clear::new(PlanType::Mission))).map(drop)?,
            old => transport(examiner.upload_mission(old)).map(drop)?,
        }
    }
    evidence.unrestored.push(format!("the mission had {} items", old.len()));
    Ok(())
}

/// Returns a mission of 20 waypoints around the vehicle.
fn route<T: Drive>(examiner: &mut Examiner<'_, T>) -> Vec<Item> {
    let position = examiner.station().seen().last::<GlobalPositionInt>().unwrap_or_default();
    let [latitude, longitude] = [position.lat, position.lon].map(|angle| f64::from(angle) / 1e7);
    (0..20).map(|step| waypoint(Place::relative(latitude + f64::from(step) * 1e-5, longitude, 10.0))).collect()
}

/// Connects as each client, MAVProxy last: it changes the rates of all streams, which are restored.
fn clients<T: Drive>(examiner: &mut Examiner<'_, T>, evidence: &mut Evidence) -> Result<(), Failure> {
    for client in [Client::QGroundControl, Client::Mavsdk, Client::MavProxy] {
        examiner.become_client(client);
        // Requests that were sent before are answered first.
        if let Some(connected) = transport(examiner.run(Connect::new()))? {
            evidence.connected.push((client, connected));
        }
    }
    examiner.become_client(Client::QGroundControl);
    let old = evidence.intervals.clone();
    for (id, interval) in old {
        let command = Send::new(MavCmd::SET_MESSAGE_INTERVAL, &[id as f32, Interval::Every(interval).micros()]);
        transport(examiner.run(command))?;
    }
    Ok(())
}

/// Tries the services that the capabilities announce.
fn services<T: Drive>(examiner: &mut Examiner<'_, T>, evidence: &mut Evidence) -> Result<(), Failure> {
    use mavstack::dialect::MavProtocolCapability as Capability;
    let connected = evidence.connected.iter().map(|(_, connected)| connected.capabilities());
    let announced = connected.fold(Capability::EMPTY, |all, capabilities| all | capabilities);
    let mut note = |name, result: Result<(), Failure>| match result {
        Err(failure @ Failure::Transport(_)) => Err(failure),
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

fn note_texts<T: Drive>(examiner: &mut Examiner<'_, T>, evidence: &mut Evidence) {
    evidence.texts = examiner.station().seen().texts().cloned().collect();
    note_heartbeat(examiner, evidence);
}

/// Notes the vehicle's last heartbeat.
fn note_heartbeat<T: Drive>(examiner: &mut Examiner<'_, T>, evidence: &mut Evidence) {
    let seen = examiner.station().seen();
    let component = evidence.vehicle.and_then(|vehicle| seen.component(vehicle));
    evidence.heartbeat = component.and_then(|component| component.heartbeat).or(evidence.heartbeat);
}

/// Passes on a failure of the transport. Others are what the examination looks for.
fn transport<O>(result: Result<O, Failure>) -> Result<Option<O>, Failure> {
    match result {
        Ok(output) => Ok(Some(output)),
        Err(failure @ Failure::Transport(_)) => Err(failure),
        Err(_) => Ok(None),
    }
}
