//! What an examination changes in the vehicle: a stream's interval, a parameter, the mission. All of it is restored, and read back.
//!
//! What is about to be changed is noted in [`Evidence::unrestored`] first, and crossed out once it was read as before. So an examination
//! that ends early says what it has left changed.

use mavstack::dialect::{
    Attitude, GlobalPositionInt, Heartbeat, MavAutopilot, MavCmd, MavParamType, MessageInterval, ParamValue, Timesync,
};
use mavstack::{Duration, Item, Message, PlanType};
use mavstack_station::command::{Place, Send};
use mavstack_station::parameters::{Parameter, Value};
use mavstack_station::plans::{self, waypoint};
use mavstack_station::streams::{Interval, Request};
use mavstack_station::{Drive, Failure, GroundStation, Received, parameters};

use crate::evidence::Evidence;
use crate::examiner::{Examiner, Load};
use crate::trace::Trace;

/// How often something is restored, until it is read as it was.
const RESTORE_TRIES: u32 = 5;
/// The most messages whose intervals are asked for.
const MAX_INTERVALS: usize = 16;
/// A vehicle that does not say the intervals of so many is not asked for others.
const UNKNOWN_INTERVALS: usize = 3;
/// How long MESSAGE_INTERVAL is awaited after the command was accepted.
const INTERVAL_WITHIN: Duration = Duration::from_secs(1);
/// The share of the line that the load fills in each direction.
const FULL: f64 = 0.8;
/// The share of the line from which on it counts as full. Stacks leave room for answers.
const NEARLY_FULL: f64 = 0.4;
/// The time in which what is queued on the way arrives.
const DRAIN: Duration = Duration::from_secs(1);

/// Whether a failure ends the examination. Others are what it looks for.
pub(crate) fn is_end(failure: &Failure) -> bool {
    matches!(failure, Failure::Transport(_) | Failure::Armed | Failure::NoVehicle)
}

/// Passes on a failure that ends the examination. Returns `None` for others.
pub(crate) fn answered<O>(result: Result<O, Failure>) -> Result<Option<O>, Failure> {
    match result {
        Ok(output) => Ok(Some(output)),
        Err(failure) if is_end(&failure) => Err(failure),
        Err(_) => Ok(None),
    }
}

/// Returns a trace, unless the transport has failed: what is missing then is not the vehicle's fault.
fn judged(trace: Trace, result: &Result<(), Failure>) -> Option<Trace> {
    (!matches!(result, Err(Failure::Transport(_)))).then_some(trace)
}

/// Notes that something is about to change, and what it is now.
fn note(evidence: &mut Evidence, before: &str) {
    evidence.unrestored.push(before.to_owned());
}

/// Notes that something was read as it was before.
fn cross_out(evidence: &mut Evidence, before: &str) {
    evidence.unrestored.retain(|other| other != before);
}

/// Returns the intervals that the vehicle says of what it streams.
pub(crate) fn intervals<T: Drive>(
    examiner: &mut Examiner<'_, T>,
    idle: &Trace,
) -> Result<Vec<(u32, Duration)>, Failure> {
    let answers = [Heartbeat::ID, Timesync::ID, ParamValue::ID];
    let streamed = idle.ids().into_iter().filter(|(id, count)| *count >= 2 && !answers.contains(id));
    let mut intervals = Vec::new();
    for (index, (id, _)) in streamed.take(MAX_INTERVALS).enumerate() {
        if let Some(interval) = interval(examiner, id)? {
            intervals.push((id, interval));
        }
        if intervals.is_empty() && index + 1 == UNKNOWN_INTERVALS {
            break;
        }
    }
    Ok(intervals)
}

/// Returns the interval that the vehicle says of a message; `None` if it says none.
fn interval<T: Drive>(examiner: &mut Examiner<'_, T>, id: u32) -> Result<Option<Duration>, Failure> {
    let request = Request::<MessageInterval>::new().with_index(id);
    let message = match answered(examiner.run(request))? {
        None => interval_by_old_command(examiner, id)?,
        message => message,
    };
    Ok(message.and_then(|message| match Interval::from_message(&message)? {
        Interval::Every(interval) => Some(interval),
        Interval::Default | Interval::Off => None,
    }))
}

/// Asks for an interval by MAV_CMD_GET_MESSAGE_INTERVAL: ArduPilot knew it before MAV_CMD_REQUEST_MESSAGE.
fn interval_by_old_command<T: Drive>(
    examiner: &mut Examiner<'_, T>,
    id: u32,
) -> Result<Option<MessageInterval>, Failure> {
    let first = examiner.frames().len();
    let answer =
        |frame: &Received| frame.decode::<MessageInterval>().filter(|interval| u32::from(interval.message_id) == id);
    let command = Send::new(MavCmd::GET_MESSAGE_INTERVAL, &[id as f32]);
    if answered(examiner.run(command))?.is_none() {
        return Ok(None);
    }
    let end = examiner.now() + INTERVAL_WITHIN;
    loop {
        let found = examiner.frames_after(first).iter().find_map(answer);
        if found.is_some() || examiner.step()? >= end {
            return Ok(found);
        }
    }
}

/// Returns the streamed message that is to fill the line, with its interval: ATTITUDE, or else the longest one.
fn filler(evidence: &Evidence) -> Option<(u32, Duration)> {
    let known = evidence.intervals.iter().copied();
    known.max_by_key(|(id, _)| (*id == Attitude::ID, evidence.idle.mean_len(*id)))
}

/// Fills the line: requests and heartbeats to the vehicle, a streamed message from it.
pub(crate) fn load<T: Drive>(examiner: &mut Examiner<'_, T>, evidence: &mut Evidence) -> Result<(), Failure> {
    let rate = evidence.rate();
    let load = Load { fill: rate * FULL, ..Load::idle(Duration::from_secs(6)) };
    let Some((id, before)) = filler(evidence) else {
        let why = "the vehicle says the interval of no message that it streams";
        evidence.skipped.push(format!("a full line from the vehicle: {why}"));
        let (trace, result) = examiner.measure(load);
        evidence.load = judged(trace, &result);
        return result;
    };
    let len = evidence.idle.mean_len(id) as f64;
    let share = (rate * FULL - evidence.idle.bytes_per_second()).max(len);
    let interval = Duration::from_micros((len / share * 1e6) as u64).max(Duration::from_millis(4));
    let text = format!("message {id} came every {} µs", before.as_micros());
    note(evidence, &text);
    set_interval(examiner, id, interval)?;
    let (trace, result) = examiner.measure(load);
    let share = trace.bytes_per_second() / rate;
    evidence.load = judged(trace, &result);
    result?;
    if share < NEARLY_FULL {
        let share = share * 100.0;
        evidence.skipped.push(format!("a full line from the vehicle: message {id} fills it to {share:.0} %"));
    }
    restore_interval(examiner, evidence, (id, before), &text)
}

fn set_interval<T: Drive>(examiner: &mut Examiner<'_, T>, id: u32, interval: Duration) -> Result<(), Failure> {
    examiner.ensure_disarmed()?;
    let command = Send::new(MavCmd::SET_MESSAGE_INTERVAL, &[id as f32, Interval::Every(interval).micros()]);
    answered(examiner.run(command)).map(drop)
}

/// Sets the interval that a message had, until the vehicle says so.
fn restore_interval<T: Drive>(
    examiner: &mut Examiner<'_, T>,
    evidence: &mut Evidence,
    (id, before): (u32, Duration),
    text: &str,
) -> Result<(), Failure> {
    for _ in 0..RESTORE_TRIES {
        set_interval(examiner, id, before)?;
        examiner.wait(DRAIN)?;
        if interval(examiner, id)?.is_some_and(|now| is_same_interval(now, before)) {
            cross_out(evidence, text);
            return Ok(());
        }
    }
    Ok(())
}

/// Whether two intervals are the same, but for the rounding of a vehicle that counts in milliseconds.
fn is_same_interval(a: Duration, b: Duration) -> bool {
    a.as_micros().abs_diff(b.as_micros()) <= 1_000
}

/// Changes a parameter by as little as possible, and restores it: twice the vehicle has something to store.
pub(crate) fn store<T: Drive>(examiner: &mut Examiner<'_, T>, evidence: &mut Evidence) -> Result<(), Failure> {
    let list = answered(examiner.run(parameters::List::new()))?.unwrap_or_default();
    let Some((name, value)) = list.iter().find_map(harmless) else {
        evidence.skipped.push("stalls while a parameter is stored: no parameter is a float other than 0".into());
        return Ok(());
    };
    let text = format!("{name} was {value}");
    note(evidence, &text);
    let near = f32::from_bits(value.to_bits() + 1);
    let mut is_changed = false;
    let (trace, result) = examiner.trace(|examiner, probes| {
        let load = Load { probe_every: Duration::from_millis(60), ..Load::idle(Duration::from_secs(4)) };
        for value in [near, value] {
            examiner.ensure_disarmed()?;
            is_changed |= answered(examiner.set(&name, value))? == Some(Value::F32(near));
            examiner.probe(load, probes)?;
        }
        Ok(())
    });
    evidence.storing = judged(trace, &result);
    result?;
    if !is_changed {
        evidence.skipped.push(format!("stalls while a parameter is stored: {name} could not be changed"));
    }
    for _ in 0..RESTORE_TRIES {
        // A late answer to the set is not what the vehicle has now.
        examiner.wait(DRAIN)?;
        if answered(examiner.get(&name))? == Some(Value::F32(value)) {
            cross_out(evidence, &text);
            break;
        }
        examiner.ensure_disarmed()?;
        answered(examiner.set(&name, value))?;
    }
    Ok(())
}

/// Returns a parameter whose least significant bit may change: a float, and not 0, which often means "off".
fn harmless(parameter: &Parameter) -> Option<(String, f32)> {
    let Value::F32(value) = parameter.value else { return None };
    let is_float = parameter.param_type == MavParamType::REAL32;
    (is_float && value.is_normal() && value.abs() < 1e6).then(|| (parameter.name.clone(), value))
}

/// Uploads the mission that the vehicle has. If it has none, uploads one and clears it.
pub(crate) fn plan<T: Drive>(examiner: &mut Examiner<'_, T>, evidence: &mut Evidence) -> Result<(), Failure> {
    let Some(old) = answered(examiner.download_mission())? else {
        evidence.skipped.push("the upload of a plan: the mission could not be downloaded".into());
        return Ok(());
    };
    let has_mission = !own_items(evidence, &old).is_empty();
    let items = if has_mission { old.clone() } else { route(examiner) };
    let text = format!("the mission had {} items", old.len());
    examiner.ensure_disarmed()?;
    note(evidence, &text);
    let (trace, result) = examiner.trace(|examiner, probes| {
        match examiner.upload_mission(&items) {
            Err(failure) if is_end(&failure) => return Err(failure),
            // It may have its reasons, such as a place that is too far away.
            Err(failure @ Failure::Plan { .. }) => {
                evidence.skipped.push(format!("the upload of a plan to its end: {failure}"));
            }
            Err(failure) => evidence.unanswered_plan = Some(failure),
            Ok(_) => {}
        }
        examiner.probe(Load::idle(Duration::from_secs(4)), probes)
    });
    evidence.planning = judged(trace, &result);
    result?;
    restore_plan(examiner, evidence, &old, &text)
}

/// Makes sure that the vehicle has its old mission.
fn restore_plan<T: Drive>(
    examiner: &mut Examiner<'_, T>,
    evidence: &mut Evidence,
    old: &[Item],
    text: &str,
) -> Result<(), Failure> {
    for _ in 0..RESTORE_TRIES {
        let now = answered(examiner.download_mission())?;
        if now.is_some_and(|now| own_items(evidence, &now) == own_items(evidence, old)) {
            cross_out(evidence, text);
            return Ok(());
        }
        examiner.ensure_disarmed()?;
        if own_items(evidence, old).is_empty() {
            answered(examiner.run(plans::Clear::new(PlanType::Mission)))?;
        } else {
            answered(examiner.upload_mission(old))?;
        }
    }
    Ok(())
}

/// Returns the items that a mission keeps. ArduPilot's first one is its home position, which moves by itself.
pub(crate) fn own_items<'a>(evidence: &Evidence, items: &'a [Item]) -> &'a [Item] {
    let is_ardupilot = evidence.heartbeat.is_some_and(|heartbeat| heartbeat.autopilot == MavAutopilot::ARDUPILOTMEGA);
    items.get(usize::from(is_ardupilot)..).unwrap_or_default()
}

/// Returns a mission of 20 waypoints around the vehicle.
fn route<T: Drive>(examiner: &mut Examiner<'_, T>) -> Vec<Item> {
    /// Where a vehicle is that has no position: it may refuse latitude 0, longitude 0 as unknown.
    const ELSEWHERE: [i32; 2] = [473_977_000, 85_456_000];
    let target = examiner.target();
    let position = examiner.station().seen().last_from::<GlobalPositionInt>(target);
    let position = position.map_or(ELSEWHERE, |position| [position.lat, position.lon]);
    let position = if position == [0, 0] { ELSEWHERE } else { position };
    let [latitude, longitude] = position.map(|angle| f64::from(angle) / 1e7);
    (0..20).map(|step| waypoint(Place::relative(latitude + f64::from(step) * 1e-5, longitude, 10.0))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_item_of_ardupilot_is_its_home() {
        let home = |altitude| waypoint(Place::global(47.0, 8.0, altitude));
        let (before, after) = ([home(500.0), home(10.0)], [home(501.5), home(10.0)]);
        let with = |autopilot| Evidence {
            heartbeat: Some(Heartbeat { autopilot, ..Heartbeat::default() }),
            ..Evidence::default()
        };
        let (ardupilot, generic) = (with(MavAutopilot::ARDUPILOTMEGA), with(MavAutopilot::GENERIC));
        assert_eq!(own_items(&ardupilot, &before), own_items(&ardupilot, &after));
        assert_ne!(own_items(&generic, &before), own_items(&generic, &after));
        assert!(own_items(&ardupilot, &[]).is_empty());
    }
}
