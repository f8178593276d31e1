//! What is streamed: units, unknown values, positions, rates.

use mavstack::dialect::{
    Attitude, BatteryStatus, GlobalPositionInt, GpsFixType, GpsRawInt, HomePosition, LocalPositionNed, SysStatus,
    VfrHud,
};
use mavstack::{Duration, Message};

use crate::evidence::Evidence;
use crate::finding::{Finding, Severity, Topic};
use crate::trace::seconds;

/// Judges the telemetry.
pub fn check(evidence: &Evidence) -> Vec<Finding> {
    let checks = [streams, units, origin, unknown, disagreement, battery, unlisted_mode];
    checks.iter().filter_map(|check| check(evidence)).collect()
}

/// Returns the last `M` that was streamed while idle.
fn last<M: Message>(evidence: &Evidence) -> Option<M> {
    evidence.idle.frames.iter().rev().find_map(|frame| frame.decode::<M>())
}

/// Returns the messages that come at less than two thirds of the rate that the vehicle says: id, received and announced interval.
fn slow_streams(evidence: &Evidence) -> Vec<(u32, Duration, Duration)> {
    let slow = evidence.intervals.iter().filter_map(|(id, announced)| {
        let times = evidence.idle.arrivals(*id);
        let (first, last) = (times.first()?, times.last()?);
        let spans = u64::try_from(times.len()).ok()?.checked_sub(1).filter(|spans| *spans > 0)?;
        let interval = Duration::from_micros((*last - *first).as_micros() / spans);
        let is_slow =
            interval.as_micros() * 2 > announced.as_micros() * 3 && interval > *announced + Duration::from_millis(20);
        is_slow.then_some((*id, interval, *announced))
    });
    slow.collect()
}

/// Returns the share of the line that the vehicle uses while idle, from 0 to 1, if its rate is known.
fn utilisation(evidence: &Evidence) -> Option<f64> {
    Some(evidence.idle.bytes_per_second() / evidence.line_rate?)
}

/// Whether the streams take more than the line carries.
pub(crate) fn is_overloaded(evidence: &Evidence) -> bool {
    let is_full = utilisation(evidence).is_some_and(|share| share > 0.85);
    let waits =
        crate::timing::answer_times(&evidence.idle).is_some_and(|[least, ..]| least > Duration::from_millis(250));
    let unanswered = evidence.idle.unanswered() > 0.5;
    match evidence.line_rate {
        Some(_) => is_full && (waits || unanswered || !slow_streams(evidence).is_empty()),
        None => (waits || unanswered) && !slow_streams(evidence).is_empty(),
    }
}

/// The rates of the streams.
fn streams(evidence: &Evidence) -> Option<Finding> {
    if crate::timing::is_clock_wrong(evidence) {
        return None;
    }
    if is_overloaded(evidence) {
        let share = utilisation(evidence)
            .map_or(String::new(), |share| format!(" The line is used to {:.0} %.", share * 100.0));
        let wait = crate::timing::answer_times(&evidence.idle)
            .map_or("Nothing is answered in time.".into(), |[_, median, _]| {
                format!("Half of the answers take {} ms or more.", median.as_millis())
            });
        return Some(Finding::new(
            Topic::Telemetry,
            "streams-above-rate",
            Severity::Error,
            format!("The streams fill the line.{share} {wait}"),
            "The streams take more than the line carries: the rate in `LinkConfig` is higher than that of the slowest part of the link.",
            "Set the rate in `LinkConfig` to what the link carries: the stack then thins its streams. Or declare fewer or slower streams.",
        ));
    }
    let slow = slow_streams(evidence);
    let (id, interval, announced) = slow.first()?;
    // Frames that were lost explain it.
    if evidence.idle.lost() > 0 || evidence.idle.damaged > 0 {
        return None;
    }
    Some(Finding::new(
        Topic::Telemetry,
        "streams-slow",
        Severity::Warning,
        format!(
            "{} messages come more rarely than the vehicle says, such as message {id}: every {:.2} s, not every {:.2} s.",
            slow.len(),
            seconds(*interval),
            seconds(*announced)
        ),
        "The rate in `LinkConfig` is too low for all streams, or RADIO_STATUS throttles them, or a measurement is not available.",
        "Compare the rates with `LinkConfig`. `stack.streams_never_filled()` names messages that `Telemetry::fill` forgets.",
    ))
}

/// Values in a wrong unit.
fn units(evidence: &Evidence) -> Option<Finding> {
    let mut wrong = Vec::new();
    let mut severity = Severity::Error;
    if let Some(attitude) = last::<Attitude>(evidence) {
        let angles = [attitude.roll, attitude.pitch, attitude.yaw];
        if angles.iter().any(|angle| angle.abs() > 2.0 * std::f32::consts::PI) {
            wrong.push(format!("ATTITUDE has angles of {angles:.1?}, which are radians"));
        }
    }
    if let Some(position) = last::<GlobalPositionInt>(evidence) {
        let is_small = |value: i32| value != 0 && value.abs() <= 180;
        if is_small(position.lat) && is_small(position.lon) {
            wrong.push(format!("GLOBAL_POSITION_INT is at {}, {}, which are degrees·10⁷", position.lat, position.lon));
        }
        if position.lat.unsigned_abs() > 900_000_000 || position.lon.unsigned_abs() > 1_800_000_000 {
            wrong.push(format!(
                "GLOBAL_POSITION_INT is at {}, {}: beyond the poles or 180°",
                position.lat, position.lon
            ));
        }
        if position.hdg != u16::MAX && position.hdg >= 36_000 {
            wrong
                .push(format!("GLOBAL_POSITION_INT has a heading of {}, which is at most 35999 (0.01°)", position.hdg));
        }
    }
    if let Some(hud) = last::<VfrHud>(evidence) {
        if !(-1..=360).contains(&hud.heading) {
            wrong.push(format!("VFR_HUD has a heading of {}, which is 0 to 360°", hud.heading));
        }
        if hud.throttle > 100 && hud.throttle != u16::MAX {
            wrong.push(format!("VFR_HUD has a throttle of {} %", hud.throttle));
        }
    }
    if let Some(status) = last::<SysStatus>(evidence) {
        if status.battery_remaining < -1 || status.battery_remaining > 100 {
            wrong.push(format!("SYS_STATUS has {} % of the battery left", status.battery_remaining));
        }
        if (1..=200).contains(&status.voltage_battery) {
            // On the bench the battery may be missing, and its sensor measures noise.
            severity = if wrong.is_empty() { Severity::Warning } else { severity };
            wrong.push(format!("SYS_STATUS has a battery of {} mV", status.voltage_battery));
        }
    }
    (!wrong.is_empty()).then(|| {
        Finding::new(
            Topic::Telemetry,
            "units",
            severity,
            format!("{}.", wrong.join("; ")),
            "A value is put into a message in another unit.",
            "Use the types of `mavstack::telemetry`, which take SI units and convert.",
        )
    })
}

/// A position at 0/0.
fn origin(evidence: &Evidence) -> Option<Finding> {
    let position = last::<GlobalPositionInt>(evidence).is_some_and(|position| (position.lat, position.lon) == (0, 0));
    let home = last::<HomePosition>(evidence).is_some_and(|home| (home.latitude, home.longitude) == (0, 0));
    let gps = last::<GpsRawInt>(evidence)
        .is_some_and(|gps| (gps.lat, gps.lon) == (0, 0) && gps.fix_type.0 >= GpsFixType::_2D_FIX.0);
    let which = [("GLOBAL_POSITION_INT", position), ("HOME_POSITION", home), ("GPS_RAW_INT with a fix", gps)];
    let names: Vec<_> = which.into_iter().filter(|(_, is_zero)| *is_zero).map(|(name, _)| name).collect();
    (!names.is_empty()).then(|| {
        Finding::new(
            Topic::Telemetry,
            "position-zero",
            Severity::Warning,
            format!("{} at latitude 0, longitude 0: maps show the vehicle south of Ghana.", names.join(", ")),
            "An unknown position is sent as 0.",
            "Send no position while none is known: `Motion::global_position_int` returns `None` then, and `fill` returns false.",
        )
    })
}

/// Unknown values.
fn unknown(evidence: &Evidence) -> Option<Finding> {
    if evidence.idle.frames.is_empty() {
        return None;
    }
    let mut names = Vec::new();
    if last::<Attitude>(evidence)
        .is_some_and(|attitude| [attitude.roll, attitude.pitch, attitude.yaw].iter().any(|angle| !angle.is_finite()))
    {
        names.push("attitude");
    }
    if last::<VfrHud>(evidence).is_some_and(|hud| !hud.groundspeed.is_finite() || !hud.alt.is_finite()) {
        names.push("speed or altitude");
    }
    if last::<LocalPositionNed>(evidence)
        .is_some_and(|local| !local.x.is_finite() || !local.y.is_finite() || !local.z.is_finite())
    {
        names.push("local position");
    }
    if last::<SysStatus>(evidence).is_some_and(|status| status.voltage_battery == u16::MAX) {
        names.push("battery voltage");
    }
    if last::<GlobalPositionInt>(evidence).is_none() {
        names.push("position");
    }
    (!names.is_empty()).then(|| {
        Finding::new(
            Topic::Telemetry,
            "unknown-values",
            Severity::Note,
            format!("Unknown: {}.", names.join(", ")),
            "The sensor has no value, or the firmware does not fill it in.",
            "Nothing, if the vehicle has no such sensor. QGroundControl shows dashes.",
        )
    })
}

/// The receiver's position and the estimated one differ.
fn disagreement(evidence: &Evidence) -> Option<Finding> {
    let (gps, position) = (last::<GpsRawInt>(evidence)?, last::<GlobalPositionInt>(evidence)?);
    let far = |a: i32, b: i32| (i64::from(a) - i64::from(b)).abs() > 1_000_000;
    let has_fix = gps.fix_type.0 >= GpsFixType::_3D_FIX.0;
    (has_fix && (far(gps.lat, position.lat) || far(gps.lon, position.lon))).then(|| {
        Finding::new(
            Topic::Telemetry,
            "positions-differ",
            Severity::Warning,
            format!(
                "GPS_RAW_INT is at {}, {}, and GLOBAL_POSITION_INT at {}, {}.",
                gps.lat, gps.lon, position.lat, position.lon
            ),
            "Latitude and longitude are swapped in one of them, or one has another unit.",
            "Use the types of `mavstack::telemetry` for both.",
        )
    })
}

/// Returns the voltage of a battery (mV); `None` if a cell among known ones is unknown.
fn pack_voltage(battery: &BatteryStatus) -> Option<u32> {
    // Cells that the battery does not have are `u16::MAX`, and 0 from the 11th on.
    let more = battery.voltages_ext.iter().map(|cell| if *cell == 0 { u16::MAX } else { *cell });
    let cells: Vec<_> = battery.voltages.into_iter().chain(more).collect();
    let (known, rest) = cells.split_at(cells.iter().position(|cell| *cell == u16::MAX).unwrap_or(cells.len()));
    let is_whole = rest.iter().all(|cell| *cell == u16::MAX);
    is_whole.then(|| known.iter().map(|cell| u32::from(*cell)).sum())
}

/// Two messages with different voltages: SYS_STATUS has that of the first battery.
fn battery(evidence: &Evidence) -> Option<Finding> {
    let batteries = evidence.idle.frames.iter().rev().filter_map(|frame| frame.decode::<BatteryStatus>());
    let (status, battery) = (last::<SysStatus>(evidence)?, batteries.into_iter().find(|battery| battery.id == 0)?);
    // SYS_STATUS has no room for more.
    let sum = pack_voltage(&battery)?.min(u32::from(u16::MAX) - 1);
    let voltage = u32::from(status.voltage_battery);
    let differs = sum.abs_diff(voltage) * 5 > voltage;
    (status.voltage_battery != u16::MAX && sum > 0 && differs).then(|| {
        Finding::new(
            Topic::Telemetry,
            "voltages-differ",
            Severity::Warning,
            format!("SYS_STATUS has {voltage} mV, and the cells of BATTERY_STATUS add up to {sum} mV."),
            "One of them has another unit, or the voltage of the pack is put into every cell.",
            "Use `mavstack::telemetry::Battery` for both.",
        )
    })
}

/// The mode is not in the list.
fn unlisted_mode(evidence: &Evidence) -> Option<Finding> {
    let heartbeat = evidence.heartbeat?;
    let modes = evidence.connected.iter().map(|(_, connected)| &connected.modes).find(|modes| !modes.is_empty())?;
    let is_listed = modes.iter().any(|mode| mode.custom_mode == heartbeat.custom_mode);
    (!is_listed).then(|| {
        Finding::new(
            Topic::Telemetry,
            "mode-not-listed",
            Severity::Error,
            format!("The heartbeat has mode {}, and the list has {} others.", heartbeat.custom_mode, modes.len()),
            "`Vehicle::state` reports a mode that `Modes::MODES` does not have.",
            "List every mode that the vehicle can be in. QGroundControl shows \"Unknown\" for others.",
        )
    })
}
