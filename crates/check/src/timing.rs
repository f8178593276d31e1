//! Answer times, heartbeats, stalls and clocks.

use mavstack::dialect::{Heartbeat, SystemTime};
use mavstack::{Duration, Message};

use crate::evidence::Evidence;
use crate::finding::{Finding, Severity, Topic};
use crate::trace::{Trace, seconds, timesync_rate};

/// The spread of the answer times in calm from which on polls are too rare.
const SPREAD: Duration = Duration::from_millis(100);
/// The longest silence while something is stored.
const STALL: Duration = Duration::from_millis(700);

/// Judges the times.
pub fn check(evidence: &Evidence) -> Vec<Finding> {
    let checks = [
        clock,
        timesync,
        unix_time,
        no_heartbeats,
        own_numbers,
        only_heartbeats,
        slow_polls,
        slow_answers,
        late_heartbeats,
        stall,
        slow_under_load,
    ];
    checks.iter().filter_map(|check| check(evidence)).collect()
}

fn finding(
    id: &'static str,
    severity: Severity,
    observed: String,
    cause: &'static str,
    remedy: &'static str,
) -> Finding {
    Finding { id, topic: Topic::Timing, severity, observed, cause, remedy }
}

/// Whether the clock runs at a wrong rate, which explains everything else.
pub(crate) fn is_clock_wrong(evidence: &Evidence) -> bool {
    // A queue that grows looks like a slow clock.
    let is_near = |rate: &f64| {
        (0.9..=1.1).contains(rate) || (0.5..1.0).contains(rate) && crate::telemetry::is_overloaded(evidence)
    };
    evidence.clock_rate.is_some_and(|rate| !is_near(&rate))
}

/// The vehicle's clock against the station's.
fn clock(evidence: &Evidence) -> Option<Finding> {
    let rate = evidence.clock_rate?;
    if !is_clock_wrong(evidence) {
        return drift(evidence, rate);
    }
    let observed = |what: &str| format!("The vehicle's clock counts {rate:.4} s a second: {what}.");
    let (what, cause, remedy) = match rate {
        _ if rate <= 0.0 => (
            "it stands still or runs backwards",
            "The clock that is passed as `now` wraps, as a 32-bit counter of microseconds does after 71 minutes, or was reset.",
            "Extend the counter to 64 bits, as the guide `start` shows.",
        ),
        0.0005..=0.002 => (
            "1,000 times too slow",
            "Milliseconds are passed as microseconds.",
            "Use `Instant::from_millis` for a counter of milliseconds, and `Instant::from_micros` for microseconds.",
        ),
        500.0..=2_000.0 => (
            "1,000 times too fast",
            "Microseconds are passed as milliseconds, or are put into a field of milliseconds.",
            "Use `Instant::from_micros` for a counter of microseconds. `time_boot_ms` is in milliseconds.",
        ),
        _ => (
            "the wrong rate",
            "The timer's frequency is not the one that the firmware divides by.",
            "Check the timer's clock and prescaler. Times of the library are microseconds.",
        ),
    };
    Some(finding("clock-unit", Severity::Error, observed(what), cause, remedy))
}

/// The answers to TIMESYNC.
fn timesync(evidence: &Evidence) -> Option<Finding> {
    let rate = timesync_rate(&evidence.calm)?;
    let is_explained = is_clock_wrong(evidence) || crate::telemetry::is_overloaded(evidence);
    (!is_explained && !(0.9..=1.1).contains(&rate)).then(|| {
        finding(
            "timesync-unit",
            Severity::Error,
            format!("The answers to TIMESYNC count {:.0} ns a second.", rate * 1e9),
            "`tc1` is in nanoseconds, and something else is put into it.",
            "Use `mavstack::clock::Time`, or multiply microseconds by 1,000.",
        )
    })
}

/// The date in SYSTEM_TIME.
fn unix_time(evidence: &Evidence) -> Option<Finding> {
    /// 2015-01-01, which is before every vehicle with this message, and 2100-01-01 (µs since 1970).
    const PLAUSIBLE: std::ops::Range<u64> = 1_420_070_400_000_000..4_102_444_800_000_000;
    let time = evidence.calm.frames.iter().rev().find_map(|frame| frame.decode::<SystemTime>())?.time_unix_usec;
    (time != 0 && !PLAUSIBLE.contains(&time)).then(|| {
        finding(
            "unix-time",
            Severity::Warning,
            format!("SYSTEM_TIME has {time} µs since 1970, which is not a date of today."),
            "`time_unix_usec` is in microseconds since 1970, UTC. Seconds, milliseconds or the time since boot are put into it.",
            "Convert the time of the receiver. Send 0 while the date is not known.",
        )
    })
}

/// A clock at nearly the right rate.
fn drift(evidence: &Evidence, rate: f64) -> Option<Finding> {
    let drift = (rate - 1.0) * 1e6;
    let is_covered = evidence.calm.time() > Duration::from_secs(5) && !crate::telemetry::is_overloaded(evidence);
    (drift.abs() > 10_000.0 && is_covered).then(|| {
        finding(
            "clock-drift",
            Severity::Warning,
            format!("The vehicle's clock drifts by {drift:.0} ppm."),
            "The timer runs from an RC oscillator, or its divider is rounded.",
            "Run it from a crystal, or correct it by TIMESYNC.",
        )
    })
}

/// Frames, but no heartbeat.
fn no_heartbeats(evidence: &Evidence) -> Option<Finding> {
    let has_frames = !evidence.first.frames.is_empty();
    if !has_frames || is_clock_wrong(evidence) || evidence.heartbeat.is_some() {
        return None;
    }
    let observed = format!(
        "{} frames were received, but no HEARTBEAT. {}",
        evidence.first.frames.len() + evidence.calm.frames.len(),
        if evidence.echo.is_some() { "Requests are answered." } else { "No request was answered." },
    );
    Some(finding(
        "no-heartbeat",
        Severity::Error,
        observed,
        "`stack.poll` is not called, or not within `max_loop_gap`; or the flight loop does not tick the pulse; or `Vehicle::state` returns \
         `None`; or the link's class is `HighLatency`.",
        "Call `stack.poll` in every pass, besides `poll_link` for each link. Call `Pulse::tick` in the flight loop.",
    ))
}

/// Whether nothing but heartbeats was received, several of them.
pub(crate) fn is_only_heartbeats(trace: &Trace) -> bool {
    trace.frames.len() >= 4 && trace.frames.iter().all(|frame| frame.header.id == Heartbeat::ID)
}

/// Whether the heartbeats have sequence numbers of their own: without them, none is missing.
pub(crate) fn has_own_numbers(trace: &Trace) -> bool {
    let heartbeats = trace.arrivals(Heartbeat::ID).len() as u64;
    let breaks = breaks_at_heartbeats(trace);
    heartbeats >= 3 && breaks * 2 > heartbeats && trace.lost_without_heartbeats() * 20 <= trace.frames.len() as u64
}

/// Returns the number of heartbeats whose number does not follow the frame before them.
fn breaks_at_heartbeats(trace: &Trace) -> u64 {
    let pairs = trace.frames.windows(2).filter(|pair| pair[0].source() == pair[1].source());
    let breaks = pairs.filter(|pair| {
        let follows = pair[1].header.seq == pair[0].header.seq.wrapping_add(1);
        pair[1].header.id == Heartbeat::ID && pair[0].header.id != Heartbeat::ID && !follows
    });
    breaks.count() as u64
}

const TIMER_CAUSE: &str = "The heartbeats are sent from a timer or an interrupt, not by the stack. They say that the vehicle is alive while \
                           its flight loop hangs, and a ground station does not notice.";
const TIMER_REMEDY: &str = "Send no heartbeats yourself: the stack sends them while the flight loop ticks its pulse. Call `Pulse::tick` in \
                            the flight loop, and nowhere else.";

/// Heartbeats with numbers of their own.
fn own_numbers(evidence: &Evidence) -> Option<Finding> {
    let stall = evidence.storing.as_ref().and_then(heartbeats_in_stall);
    let numbers = has_own_numbers(&evidence.calm);
    let observed = match (numbers, stall) {
        (false, None) => return None,
        (true, None) => "The heartbeats have sequence numbers of their own.".into(),
        (_, Some((time, count))) => {
            format!("Nothing was answered or streamed for {time:.1} s, and {count} heartbeats came meanwhile.")
        }
    };
    Some(finding("heartbeats-from-timer", Severity::Error, observed, TIMER_CAUSE, TIMER_REMEDY))
}

/// Returns the longest silence (s), and the heartbeats that came in it, if a vehicle whose loop ticks would have sent fewer.
fn heartbeats_in_stall(trace: &Trace) -> Option<(f64, usize)> {
    let (begin, time) = trace.longest_silence();
    // The stack stops half a second after the last tick.
    let allowance = Duration::from_millis(600);
    let count = trace.heartbeats_within(begin + allowance, time - allowance);
    (time > Duration::from_millis(1_500) && count > 0).then(|| (seconds(time), count))
}

/// Nothing but heartbeats, and nothing is answered.
fn only_heartbeats(evidence: &Evidence) -> Option<Finding> {
    if evidence.echo.is_some() || !is_only_heartbeats(&evidence.first) {
        return None;
    }
    let observed =
        format!("{} heartbeats were received and nothing else. No request was answered.", evidence.first.frames.len());
    Some(finding("heartbeats-from-timer", Severity::Error, observed, TIMER_CAUSE, TIMER_REMEDY))
}

/// Returns the shortest, the median and the longest answer time in calm.
pub(crate) fn answer_times(trace: &Trace) -> Option<[Duration; 3]> {
    let times = trace.round_trips();
    Some([*times.first()?, times[times.len() / 2], *times.last()?])
}

/// The answer times spread: requests wait for the next poll.
fn slow_polls(evidence: &Evidence) -> Option<Finding> {
    let times = evidence.calm.round_trips();
    let [shortest, ..] = answer_times(&evidence.calm)?;
    let late = *times.get(times.len() * 9 / 10)?;
    let spread = late - shortest;
    let is_explained = is_clock_wrong(evidence) || crate::telemetry::is_overloaded(evidence);
    if spread < SPREAD || shortest > spread || is_explained || times.len() < 8 {
        return None;
    }
    Some(finding(
        "poll-slow",
        Severity::Error,
        format!("In calm, answers take {} to {} ms, evenly spread.", shortest.as_millis(), late.as_millis()),
        "`poll_link` runs too rarely: a request waits until the next call. The UART's queue overruns meanwhile.",
        "Call `poll_link` in every pass, at least every 10 ms, or when `next_deadline` is reached or a byte has arrived.",
    ))
}

/// All answers are slow.
fn slow_answers(evidence: &Evidence) -> Option<Finding> {
    let [shortest, median, _] = answer_times(&evidence.calm)?;
    if shortest < Duration::from_millis(250) || crate::telemetry::is_overloaded(evidence) || is_clock_wrong(evidence) {
        return None;
    }
    Some(finding(
        "answers-slow",
        Severity::Warning,
        format!(
            "In calm, every answer takes at least {} ms, half of them {} ms.",
            shortest.as_millis(),
            median.as_millis()
        ),
        "A queue in front of the line is full, or the radio is slow.",
        "Set the rate in `LinkConfig` to what the link carries, so that nothing waits in the transmit queue.",
    ))
}

/// Heartbeats in calm.
fn late_heartbeats(evidence: &Evidence) -> Option<Finding> {
    let calm = &evidence.calm;
    let gap = calm.longest_heartbeat_gap();
    let explained =
        is_clock_wrong(evidence) || crate::telemetry::is_overloaded(evidence) || calm.lost() > 0 || calm.damaged > 0;
    if evidence.heartbeat.is_none() || explained || gap < Duration::from_millis(1_600) {
        return None;
    }
    Some(finding(
        "heartbeats-late",
        Severity::Error,
        format!(
            "In calm, {:.1} s passed between two heartbeats. QGroundControl waits 3.5 s, MAVSDK 3 s.",
            seconds(gap)
        ),
        "Passes of the flight loop take longer than `max_loop_gap`, or `stack.poll` runs too rarely.",
        "Keep passes short. Move what blocks, such as an erase, to a time when it does not matter.",
    ))
}

/// A silence while a parameter is stored or a plan comes.
fn stall(evidence: &Evidence) -> Option<Finding> {
    let parts =
        [(evidence.storing.as_ref(), "a parameter is stored"), (evidence.planning.as_ref(), "a plan is uploaded")];
    let calm = evidence.calm.longest_silence().1;
    let stalls = parts.into_iter().filter_map(|(trace, what)| Some((trace?.longest_silence().1, what)));
    let (silence, what) = stalls.max_by_key(|(silence, _)| *silence)?;
    if silence < STALL || silence < calm + calm || is_clock_wrong(evidence) {
        return None;
    }
    Some(finding(
        "stall",
        if silence > Duration::from_millis(1_500) { Severity::Error } else { Severity::Warning },
        format!("Nothing was received for {:.1} s while {what}.", seconds(silence)),
        "The firmware stands still in an erase or a write: an erase of internal flash stops the processor, and the UART's queue overruns.",
        "Keep the storage in a second bank, in external flash or in FRAM; or use smaller sectors. The stack stores only while disarmed, \
         unless `Vehicle::may_persist` says otherwise.",
    ))
}

/// Answers on a full line.
fn slow_under_load(evidence: &Evidence) -> Option<Finding> {
    let load = evidence.load.as_ref()?;
    let times = load.round_trips();
    let median = *times.get(times.len() / 2)?;
    let gap = load.longest_heartbeat_gap();
    let is_explained =
        is_clock_wrong(evidence) || crate::telemetry::is_overloaded(evidence) || slow_polls(evidence).is_some();
    if is_explained || (median < Duration::from_millis(1_000) && gap < Duration::from_secs(3)) {
        return None;
    }
    Some(finding(
        "slow-under-load",
        Severity::Warning,
        format!(
            "On a full line, half of the answers take {} ms, and heartbeats are {:.1} s apart.",
            median.as_millis(),
            seconds(gap)
        ),
        "The rate in `LinkConfig` is higher than the link carries, so answers wait behind streams.",
        "Set the rate in `LinkConfig` to that of the slowest part of the link, such as the radio's air rate.",
    ))
}
