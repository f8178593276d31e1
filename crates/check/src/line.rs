//! Bytes and frames that are lost or damaged.

use crate::evidence::Evidence;
use crate::finding::{Finding, Severity, Topic};
use crate::trace::{Trace, seconds};
use mavstack_station::Failure;

/// Judges the line.
pub fn check(evidence: &Evidence) -> Vec<Finding> {
    let checks = [failed, silence, garbage, unanswered, damage, stray, bursts, lost_requests, lost_frames];
    checks.iter().filter_map(|check| check(evidence)).collect()
}

/// The transport failed.
fn failed(evidence: &Evidence) -> Option<Finding> {
    let Some(Failure::Transport(what)) = &evidence.ended_by else { return None };
    Some(Finding::new(
        Topic::Line,
        "line-failed",
        Severity::Error,
        format!("The line failed during the examination: {what}."),
        "The cable or the adapter was unplugged; or the board was reset, and its USB port with it; or the far side closed the connection.",
        "Check the power supply and the cable. If the board resets itself, look for its watchdog or a brown-out.",
    ))
}

/// Not one byte.
fn silence(evidence: &Evidence) -> Option<Finding> {
    let (observed, cause) = match evidence.is_asked {
        true => (
            "Not one byte was received, and no request was answered.",
            "The wiring, the pins or the port; or the firmware calls neither `stack.begin` nor `poll_link`, or it hangs.",
        ),
        false => (
            "Not one byte was received. No request was sent, because no heartbeat says that the vehicle is disarmed.",
            "The wiring, the pins or the port; or the firmware does not call `poll_link`, or not `stack.poll`, which sends the heartbeats; or \
             it hangs.",
        ),
    };
    let has_failed = matches!(evidence.ended_by, Some(Failure::Transport(_)));
    (!evidence.any_byte && !has_failed).then(|| {
        Finding::new(
            Topic::Line,
            "silent",
            Severity::Error,
            observed,
            cause,
            "Check with `stack.link_counters(link)` whether the firmware sends. If it does, swap RX and TX, and check the ground wire.",
        )
    })
}

/// Bytes, but no frames.
fn garbage(evidence: &Evidence) -> Option<Finding> {
    let first = &evidence.first;
    (evidence.any_byte && evidence.vehicle.is_none()).then(|| {
        Finding::new(
            Topic::Line,
            "no-frames",
            Severity::Error,
            format!(
                "Bytes were received, but no frame: {} stray bytes, {} damaged frames.",
                first.stray, first.damaged
            ),
            "The baud rate is wrong, or something that does not speak MAVLink sends on this port.",
            "Set the same baud rate on both sides. Check the clock from which the UART's rate is derived.",
        )
    })
}

/// Heartbeats, but no answer.
fn unanswered(evidence: &Evidence) -> Option<Finding> {
    let hears = !evidence.first.frames.is_empty() && evidence.is_asked && evidence.echo.is_none();
    let (observed, cause, remedy) = match evidence.answers_slow_bytes {
        _ if !hears || is_timer_alone(evidence) => return None,
        true => (
            "Requests are answered only if their bytes arrive one by one.",
            "The UART's receive FIFO overruns between two polls: it cannot hold a frame.",
            "Receive by interrupt or DMA into a queue, and poll the link from the queue.",
        ),
        false => (
            "Frames arrive, but no request was answered: neither TIMESYNC, nor a parameter, nor a command.",
            "The receive side of the UART, if `checksum` or `skipped` of `stack.rx_counters(link)` grow; the wiring to its RX pin if no \
             counter grows; or nothing polls the link.",
            "Call `poll_link` in every pass. Check the RX pin, and that the UART's receiver is enabled.",
        ),
    };
    Some(Finding::new(Topic::Line, "no-answers", Severity::Error, observed, cause, remedy))
}

/// Nothing but heartbeats: see [`timing`](crate::timing).
fn is_timer_alone(evidence: &Evidence) -> bool {
    crate::timing::is_only_heartbeats(&evidence.first)
}

/// The parts in which the line is judged: idle, and full.
fn parts(evidence: &Evidence) -> impl Iterator<Item = (&'static str, &Trace)> {
    std::iter::once(("While idle", &evidence.idle)).chain(evidence.load.as_ref().map(|load| ("On a full line", load)))
}

/// Whether a noticeable share of the frames is damaged.
fn is_damaged(trace: &Trace) -> bool {
    let frames = trace.frames.len().max(1) as f64;
    f64::from(trace.damaged) / frames >= 0.005 || trace.damaged >= 2
}

/// Damaged frames.
fn damage(evidence: &Evidence) -> Option<Finding> {
    let (when, trace) = parts(evidence).find(|(_, trace)| is_damaged(trace))?;
    let observed = |up: &str| {
        let frames = trace.damaged as usize + trace.frames.len();
        format!("{when}, {} of {frames} frames from the vehicle were damaged, {up}.", trace.damaged)
    };
    let (unheard, probes) = (trace.unheard(), trace.probes.len());
    let unanswered = trace.probes.iter().filter(|probe| probe.answered.is_none()).count();
    let is_limited = evidence.chunks.as_ref().is_some_and(|chunks| chunks.limit().is_some());
    if unheard > 0 && unheard * 10 >= unanswered && !is_limited {
        return Some(Finding::new(
            Topic::Line,
            "damage-both-ways",
            Severity::Error,
            observed(&format!("and {unheard} of {probes} requests did not reach it")),
            "The baud rates of the two sides differ slightly, or the clock of one UART is inaccurate. An error above 2 % damages bytes.",
            "Compute the rate that the UART really has from its clock and divider. Use a crystal, or a rate that the clock divides well. \
             Else check the ground wire and the levels.",
        ));
    }
    let (up, cause) = match probes {
        0 => (
            "and no request was sent",
            "The baud rates of the two sides differ slightly; or two writers share the vehicle's UART.",
        ),
        _ => (
            "but requests reach it",
            "The vehicle's transmit side: two writers share the UART, or a DMA buffer is changed while it is sent, or a queue overruns; or \
             the line is disturbed.",
        ),
    };
    Some(Finding::new(
        Topic::Line,
        "damage-from-vehicle",
        Severity::Error,
        observed(up),
        cause,
        "Let only `poll_link` write to the UART. Do not reuse a DMA buffer before its transfer has ended.",
    ))
}

/// Bytes outside frames.
fn stray(evidence: &Evidence) -> Option<Finding> {
    let is_any_damaged = parts(evidence).any(|(_, trace)| trace.damaged > 0);
    let (when, trace) = parts(evidence).find(|(_, trace)| trace.stray > 4).filter(|_| !is_any_damaged)?;
    let seconds = trace.time().as_millis() / 1_000;
    Some(Finding::new(
        Topic::Line,
        "stray-bytes",
        Severity::Warning,
        format!("{when}, {} bytes outside frames were received in {seconds} s.", trace.stray),
        "Something else writes to the same port: a log, `printf`, a boot loader.",
        "Log over another port, such as defmt over RTT, or in STATUSTEXT.",
    ))
}

/// The end of large bursts is lost.
///
/// A queue that is emptied by polls holds at least what arrives from one to the next, or it overruns. The spread of the answer times
/// is that time. A limit that polls do not explain is that of a buffer which is only handed over when the line is idle.
fn bursts(evidence: &Evidence) -> Option<Finding> {
    let limit = evidence.chunks.as_ref()?.limit()?;
    let times = evidence.idle.round_trips();
    let spread = *times.get(times.len() * 9 / 10)? - *times.first()?;
    let between_polls = seconds(spread) * evidence.rate();
    let observed = format!(
        "Bursts of {limit} bytes or more lose their end. Requests wait up to {} ms for a poll, in which {between_polls:.0} bytes arrive.",
        spread.as_millis()
    );
    let is_cut = between_polls < 0.6 * limit as f64;
    if is_cut && crate::timing::slow_polls(evidence).is_some() {
        // The answer to a large burst comes too late: the stack takes a part of it in each poll.
        return None;
    }
    if is_cut {
        return Some(Finding::new(
            Topic::Line,
            "receive-cut",
            Severity::Error,
            observed,
            "The receive buffer of the DMA is too short, and what does not fit is cut until the line is idle.",
            "Use circular DMA, and take the bytes when it is half full, when it is full, and when the line is idle. Or use a buffer \
             that is longer than the longest burst: a frame has up to 280 bytes.",
        ));
    }
    Some(Finding::new(
        Topic::Line,
        "receive-overrun",
        Severity::Error,
        observed,
        "The UART's receive FIFO or queue overruns between two polls.",
        "Poll the link more often, or make the receive queue longer. The guide `transports` has the size for a rate and an interval.",
    ))
}

/// Requests are lost without damage and without a limit of size.
fn lost_requests(evidence: &Evidence) -> Option<Finding> {
    let share = |trace: &Trace| trace.unheard() as f64 / trace.probes.len().max(1) as f64;
    let (when, lost) = parts(evidence).map(|(when, trace)| (when, share(trace))).find(|(_, lost)| *lost >= 0.03)?;
    let limit = evidence.chunks.as_ref().and_then(|chunks| chunks.limit());
    let is_damaged = parts(evidence).any(|(_, trace)| trace.damaged > 1);
    // Without bursts it is not known whether a FIFO overruns.
    let is_measured = evidence.chunks.is_some();
    if !is_measured || limit.is_some() || is_damaged || crate::timing::is_clock_wrong(evidence) {
        return None;
    }
    Some(Finding::new(
        Topic::Line,
        "requests-lost",
        Severity::Warning,
        format!("{when}, {:.0} % of the requests did not reach the vehicle.", lost * 100.0),
        "The line loses frames, as a radio does at its range; or the receive queue overruns between two polls. QEMU does not pace \
         what it delivers to a UART, and overruns queues that are right for the board.",
        "Look at `stack.rx_counters(link)`: `checksum` grows with lost bytes. Compare on a cable.",
    ))
}

/// Frames of the vehicle are lost without damage.
fn lost_frames(evidence: &Evidence) -> Option<Finding> {
    let is_damaged = parts(evidence).any(|(_, trace)| trace.damaged > 1);
    if is_damaged || crate::timing::has_own_numbers(&evidence.idle) {
        return None;
    }
    let (when, trace) = parts(evidence).find(|(_, trace)| trace.lost() * 50 > trace.frames.len() as u64)?;
    Some(Finding::new(
        Topic::Line,
        "frames-lost",
        Severity::Warning,
        format!(
            "{when}, {} frames from the vehicle were lost, and {} arrived, by their sequence numbers.",
            trace.lost(),
            trace.frames.len()
        ),
        "The line loses whole frames, as a radio or UDP does; or the transmit queue drops what it cannot hold; or two encoders share an \
         address.",
        "Let `write` take as many bytes as fit, and return that number. Give each component its own address.",
    ))
}
