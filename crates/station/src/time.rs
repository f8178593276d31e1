//! Time: TIMESYNC and PING both ways, and SYSTEM_TIME.
//!
//! | | QGroundControl | MAVSDK | MAVProxy | pymavlink |
//! |---|---|---|---|---|
//! | answers PING | yes | yes | | |
//! | answers TIMESYNC | | once it has measured | with the module `system_time` | |
//! | measures by TIMESYNC | | every 5 s | every 10 s | |
//!
//! Its own measurements have no address, as those of all of them. The station's clock counts from the time 0 of its
//! [`Drive`](crate::Drive).

use crate::{Client, Dialogue, Due, Failure, Io, Received, Retry};
use mavstack::dialect;
use mavstack::{Duration, Instant};

/// How long an answer is awaited, and how often a request is sent.
const WAIT: Duration = Duration::from_secs(1);
const TRIES: u32 = 5;

/// A measurement of the vehicle's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// How far the vehicle's clock is ahead of the station's (ns), if the request took as long as its answer.
    pub offset: i64,
    /// The time from the request to its answer.
    pub round_trip: Duration,
}

/// Measures the vehicle's clock by TIMESYNC, several times. Ends with the sample of the shortest round trip.
#[derive(Debug)]
pub struct Timesync {
    left: u32,
    retry: Retry,
    /// The time in the last request (ns).
    sent: i64,
    best: Option<Sample>,
}

impl Timesync {
    /// Measures once.
    pub fn new() -> Self {
        Self::of(1)
    }

    /// Measures `samples` times, at least once.
    pub fn of(samples: u32) -> Self {
        Self { left: samples.max(1), retry: Retry::new(WAIT, TRIES), sent: 0, best: None }
    }
}

impl Default for Timesync {
    fn default() -> Self {
        Self::new()
    }
}

/// Returns the station's clock (ns). It is never 0, which TIMESYNC takes for no time.
fn nanos(now: Instant) -> i64 {
    now.as_micros() as i64 * 1_000 + 1
}

impl Dialogue for Timesync {
    type Output = Sample;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Sample, Failure>> {
        if self.left == 0 {
            return self.best.map(Ok);
        }
        match self.retry.due(io.now()) {
            Due::Wait => None,
            Due::Send => {
                self.sent = nanos(io.now());
                io.send(&dialect::Timesync { tc1: 0, ts1: self.sent, ..dialect::Timesync::default() });
                None
            }
            Due::GiveUp => Some(Err(Failure::timeout("TIMESYNC", self.retry.tries()))),
        }
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        let Some(answer) = frame.decode::<dialect::Timesync>().filter(|_| frame.source() == io.target()) else {
            return;
        };
        let is_ours = answer.tc1 != 0 && answer.ts1 == self.sent && self.left > 0;
        if !is_ours || !io.is_for_us(answer.target_system, answer.target_component) {
            return;
        }
        let elapsed = nanos(io.now()) - self.sent;
        let sample = Sample {
            offset: answer.tc1 - (self.sent + elapsed / 2),
            round_trip: Duration::from_micros(elapsed as u64 / 1_000),
        };
        self.best = Some(self.best.filter(|best| best.round_trip <= sample.round_trip).unwrap_or(sample));
        self.left -= 1;
        self.retry.restart();
    }
}

/// Sends PING. Ends with the time until its answer.
#[derive(Debug)]
pub struct Ping {
    retry: Retry,
    sent: Option<Instant>,
    seq: u32,
    answered: Option<Instant>,
}

impl Ping {
    /// Creates a ping that is sent when it is polled.
    pub fn new() -> Self {
        Self { retry: Retry::new(WAIT, TRIES), sent: None, seq: 0, answered: None }
    }
}

impl Default for Ping {
    fn default() -> Self {
        Self::new()
    }
}

impl Dialogue for Ping {
    type Output = Duration;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Duration, Failure>> {
        if let (Some(sent), Some(answered)) = (self.sent, self.answered) {
            return Some(Ok(answered - sent));
        }
        match self.retry.due(io.now()) {
            Due::Wait => None,
            Due::Send => {
                self.sent = Some(io.now());
                self.seq += 1;
                io.send(&dialect::Ping {
                    time_usec: io.now().as_micros(),
                    seq: self.seq,
                    target_system: 0,
                    target_component: 0,
                });
                None
            }
            Due::GiveUp => Some(Err(Failure::timeout("PING", self.retry.tries()))),
        }
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        let Some(ping) = frame.decode::<dialect::Ping>().filter(|_| frame.source() == io.target()) else { return };
        let is_answer = ping.target_system == io.address().system.wire();
        if is_answer && ping.seq == self.seq && self.sent.is_some_and(|sent| sent.as_micros() == ping.time_usec) {
            self.answered.get_or_insert(io.now());
        }
    }
}

/// Answers the vehicle's TIMESYNC as the client does. Never ends: it runs [alongside](crate::GroundStation::alongside). PING is answered
/// by the [`Station`](crate::Station) itself.
#[derive(Debug, Default)]
pub struct Answering {
    answers: u32,
}

impl Answering {
    /// Creates the dialogue.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the number of requests answered.
    pub fn answers(&self) -> u32 {
        self.answers
    }
}

impl Dialogue for Answering {
    type Output = ();

    fn poll(&mut self, _: &mut Io<'_>) -> Option<Result<(), Failure>> {
        None
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        let client = io.client();
        if let Some(request) = frame.decode::<dialect::Timesync>()
            && request.tc1 == 0
            && io.is_for_us(request.target_system, request.target_component)
            && matches!(client, Client::Mavsdk | Client::MavProxy)
        {
            // Both send the form of MAVLink 1, which has no address.
            io.send(&dialect::Timesync { tc1: nanos(io.now()), ts1: request.ts1, ..dialect::Timesync::default() });
            self.answers += 1;
        }
    }
}

/// Sends the time to the vehicle by SYSTEM_TIME. The message has no answer, so this ends at once.
#[derive(Clone, Copy, Debug)]
pub struct SendTime {
    unix_usec: u64,
}

impl SendTime {
    /// Sends this time (µs since 1970, UTC).
    pub fn new(unix_usec: u64) -> Self {
        Self { unix_usec }
    }
}

impl Dialogue for SendTime {
    type Output = ();

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<(), Failure>> {
        io.send(&dialect::SystemTime { time_unix_usec: self.unix_usec, time_boot_ms: io.now().time_boot_ms() });
        Some(Ok(()))
    }

    fn receive(&mut self, _: &mut Io<'_>, _: &Received) {}
}
