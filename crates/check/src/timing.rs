//! Answer times, heartbeats, stalls and clocks.

use mavstack::dialect::{Heartbeat, SystemTime};
use mavstack::{Duration, Instant, Message};
use mavstack_station::Failure;

use crate::evidence::Evidence;
use crate::finding::{Finding, Severity, Topic};
use crate::trace::{Trace, seconds, timesync_rate};

/// The spread of the answer times while idle from which on polls are too rare.
const SPREAD: Duration = Duration::from_millis(100);
/// The longest silence while something is stored.
const STALL: Duration = Duration::from_millis(700);
/// The time between two heartbeats from which on one is late.
const LATE_HEARTBEAT: Duration = Duration::from_millis(1_600);
/// When clients give up.
const LOST_AFTER: &str = "QGroundControl and MAVSDK declare the link lost after 3.5 s and 3 s.";

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
        stopped_heartbeats,
        late_heartbeats,
        heartbeats_late_while_busy,
        stall,
        slow_under_load,
    ];
    checks.iter().filter_map(|check| check(evidence)).collect()
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
    Some(Finding::new(Topic::Timing, "clock-unit", Severity::Error, observed(what), cause, remedy))
}

/// The answers to TIMESYNC.
fn timesync(evidence: &Evidence) -> Option<Finding> {
    let rate = timesync_rate(&evidence.idle)?;
    let is_explained = is_clock_wrong(evidence) || crate::telemetry::is_overloaded(evidence);
    (!is_explained && !(0.9..=1.1).contains(&rate)).then(|| {
        Finding::new(
            Topic::Timing,
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
    let time = evidence.idle.frames.iter().rev().find_map(|frame| frame.decode::<SystemTime>())?.time_unix_usec;
    (time != 0 && !PLAUSIBLE.contains(&time)).then(|| {
        Finding::new(
            Topic::Timing,
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
    let is_covered = evidence.idle.time() > Duration::from_secs(5) && !crate::telemetry::is_overloaded(evidence);
    (drift.abs() > 10_000.0 && is_covered).then(|| {
        Finding::new(
            Topic::Timing,
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
        evidence.first.frames.len() + evidence.idle.frames.len(),
        match evidence.echo {
            _ if !evidence.is_asked => "No request was sent, because none says that the vehicle is disarmed.",
            Some(_) => "Requests are answered.",
            None => "No request was answered.",
        },
    );
    Some(Finding::new(
        Topic::Timing,
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
    let stall = evidence.storing.as_ref().and_then(|storing| heartbeats_in_stall(&evidence.idle, storing));
    let numbers = has_own_numbers(&evidence.idle);
    let observed = match (numbers, stall) {
        (false, None) => return None,
        (true, None) => "The heartbeats have sequence numbers of their own.".into(),
        (_, Some((time, count))) => {
            format!("Nothing was answered or streamed for {time:.1} s, and {count} heartbeats came meanwhile.")
        }
    };
    Some(Finding::new(Topic::Timing, "heartbeats-from-timer", Severity::Error, observed, TIMER_CAUSE, TIMER_REMEDY))
}

/// Returns the longest silence (s), and the heartbeats that came in it, if a vehicle whose loop ticks would have sent fewer.
fn heartbeats_in_stall(idle: &Trace, trace: &Trace) -> Option<(f64, usize)> {
    let (begin, time) = trace.longest_silence();
    // The stack stops half a second after the last tick.
    let allowance = Duration::from_millis(600);
    let count = trace.heartbeats_within(begin + allowance, time - allowance);
    let is_stall = time > Duration::from_millis(1_500) && !is_loss(idle, trace, begin, time);
    (is_stall && count > 0).then(|| (seconds(time), count))
}

/// Nothing but heartbeats, and nothing is answered.
fn only_heartbeats(evidence: &Evidence) -> Option<Finding> {
    if !evidence.is_asked || evidence.echo.is_some() || !is_only_heartbeats(&evidence.first) {
        return None;
    }
    let observed =
        format!("{} heartbeats were received and nothing else. No request was answered.", evidence.first.frames.len());
    Some(Finding::new(Topic::Timing, "heartbeats-from-timer", Severity::Error, observed, TIMER_CAUSE, TIMER_REMEDY))
}

/// Returns the shortest, the median and the longest answer time while idle.
pub(crate) fn answer_times(trace: &Trace) -> Option<[Duration; 3]> {
    let times = trace.round_trips();
    Some([*times.first()?, times[times.len() / 2], *times.last()?])
}

/// Returns the spread of the times from the vehicle to the station, by its own times in what it sends; `None` if it has none.
fn way_back(evidence: &Evidence) -> Option<Duration> {
    let mut delays = evidence.idle.ways_back();
    delays.sort_unstable();
    let late = delays.get(delays.len() * 9 / 10)?;
    (delays.len() >= 8).then(|| Duration::from_micros(late.abs_diff(delays[0])))
}

/// The answer times spread: requests wait for the next poll.
pub(crate) fn slow_polls(evidence: &Evidence) -> Option<Finding> {
    let times = evidence.idle.round_trips();
    let [shortest, ..] = answer_times(&evidence.idle)?;
    let late = *times.get(times.len() * 9 / 10)?;
    let spread = late - shortest;
    let is_explained = is_clock_wrong(evidence) || crate::telemetry::is_overloaded(evidence);
    if spread < SPREAD || shortest > spread || is_explained || times.len() < 8 {
        return None;
    }
    let (shortest, late) = (shortest.as_millis(), late.as_millis());
    // A poll delays what the vehicle receives, and not what it sends. The time slots of a radio delay both.
    let is_delayed_before = match way_back(evidence) {
        Some(back) => back * 3 < spread,
        None => false,
    };
    if !is_delayed_before {
        return Some(Finding::new(
            Topic::Timing,
            "answers-spread",
            Severity::Note,
            format!("While idle, answers take {shortest} to {late} ms."),
            "A radio with time slots, such as a SiK radio, delays frames so; or `poll_link` runs too rarely.",
            "Nothing, if this is a radio. Else compare on a cable: there the answers of a vehicle that polls often are not spread.",
        ));
    }
    Some(Finding::new(
        Topic::Timing,
        "poll-slow",
        Severity::Error,
        format!("While idle, answers take {shortest} to {late} ms, and the delay is before they are written."),
        "`poll_link` runs too rarely: a request waits until the next call. The UART's queue overruns meanwhile.",
        "Call `poll_link` in every pass, at least every 10 ms, or when `next_deadline` is reached or a byte has arrived.",
    ))
}

/// All answers are slow.
fn slow_answers(evidence: &Evidence) -> Option<Finding> {
    let [shortest, median, _] = answer_times(&evidence.idle)?;
    if shortest < Duration::from_millis(250) || crate::telemetry::is_overloaded(evidence) || is_clock_wrong(evidence) {
        return None;
    }
    Some(Finding::new(
        Topic::Timing,
        "answers-slow",
        Severity::Warning,
        format!(
            "While idle, every answer takes at least {} ms, half of them {} ms.",
            shortest.as_millis(),
            median.as_millis()
        ),
        "A queue in front of the line is full, or the radio is slow.",
        "Set the rate in `LinkConfig` to what the link carries, so that nothing waits in the transmit queue.",
    ))
}

/// Heartbeats that stop.
fn stopped_heartbeats(evidence: &Evidence) -> Option<Finding> {
    (evidence.ended_by == Some(Failure::NoVehicle) && !is_clock_wrong(evidence)).then(|| {
        Finding::new(
            Topic::Timing,
            "heartbeats-stopped",
            Severity::Error,
            format!("The heartbeats stopped during the examination. {LOST_AFTER}"),
            "The flight loop hangs and ticks its pulse no more; or the board was switched off.",
            "Look at what the examination did last, and look for a loop that waits in the firmware.",
        )
    })
}

/// Heartbeats while idle.
fn late_heartbeats(evidence: &Evidence) -> Option<Finding> {
    let idle = &evidence.idle;
    let gap = idle.longest_heartbeat_gap();
    let explained =
        is_clock_wrong(evidence) || crate::telemetry::is_overloaded(evidence) || idle.lost() > 0 || idle.damaged > 0;
    if evidence.heartbeat.is_none() || explained || gap < LATE_HEARTBEAT {
        return None;
    }
    Some(Finding::new(
        Topic::Timing,
        "heartbeats-late",
        Severity::Error,
        format!("While idle, {:.1} s passed between two heartbeats. {LOST_AFTER}", seconds(gap)),
        "Passes of the flight loop take longer than `max_loop_gap`, or `stack.poll` runs too rarely.",
        "Keep passes short. Move what blocks, such as an erase, to a time when it does not matter.",
    ))
}

/// Heartbeats while a parameter is stored or a plan is uploaded.
fn heartbeats_late_while_busy(evidence: &Evidence) -> Option<Finding> {
    let parts =
        [(evidence.storing.as_ref(), "a parameter was stored"), (evidence.planning.as_ref(), "a plan was uploaded")];
    let is_whole = |trace: &&Trace| trace.lost() == 0 && trace.damaged == 0 || has_own_numbers(trace);
    let gaps = parts.into_iter().filter_map(|(trace, what)| {
        let trace = trace.filter(is_whole)?;
        Some((trace.longest_heartbeat_gap(), trace.longest_silence().1, what))
    });
    let (gap, silence, what) = gaps.max_by_key(|(gap, ..)| *gap)?;
    // A stall delays the heartbeats, too: it is a finding of its own.
    let is_stall = stall(evidence).is_some() && gap < silence + Duration::from_millis(1_500);
    let has_stopped = stopped_heartbeats(evidence).is_some();
    let is_explained = is_stall || has_stopped || is_clock_wrong(evidence) || late_heartbeats(evidence).is_some();
    if evidence.heartbeat.is_none() || is_explained || gap < LATE_HEARTBEAT {
        return None;
    }
    Some(Finding::new(
        Topic::Timing,
        "heartbeats-late",
        if gap < Duration::from_secs(3) { Severity::Warning } else { Severity::Error },
        format!("While {what}, {:.1} s passed between two heartbeats. {LOST_AFTER}", seconds(gap)),
        "The flight loop stands still while something is stored: its passes take longer than `max_loop_gap`.",
        "Store in a task of lower priority than the flight loop, or in memory that does not stop the processor.",
    ))
}

/// Whether lost frames explain a silence: as many are missing, by their numbers, as the vehicle would have streamed meanwhile. If it
/// streams too little to tell, any loss explains the silence.
fn is_loss(idle: &Trace, part: &Trace, begin: Instant, silence: Duration) -> bool {
    let missing = part.lost_within(begin, begin + silence) as f64;
    let streamed = idle.streamed_per_second() * seconds(silence);
    if streamed < 3.0 { idle.unanswered() > 0.0 || idle.lost() > 0 } else { missing * 2.0 >= streamed }
}

/// A silence while a parameter is stored or a plan is uploaded.
fn stall(evidence: &Evidence) -> Option<Finding> {
    let parts =
        [(evidence.storing.as_ref(), "a parameter was stored"), (evidence.planning.as_ref(), "a plan was uploaded")];
    let idle = evidence.idle.longest_silence().1;
    let stalls = parts.into_iter().filter_map(|(trace, what)| {
        let (begin, silence) = trace?.longest_silence();
        (!is_loss(&evidence.idle, trace?, begin, silence)).then_some((silence, what))
    });
    let (silence, what) = stalls.max_by_key(|(silence, _)| *silence)?;
    if silence < STALL || silence < idle + idle || is_clock_wrong(evidence) {
        return None;
    }
    Some(Finding::new(
        Topic::Timing,
        "stall",
        if silence > Duration::from_millis(1_500) { Severity::Error } else { Severity::Warning },
        format!("No answer or telemetry was received for {:.1} s while {what}.", seconds(silence)),
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
    Some(Finding::new(
        Topic::Timing,
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
