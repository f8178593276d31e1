//! Clock values that wrap.

use mavstack::dialect::{
    Attitude, AutopilotVersion, CommandLong, Heartbeat, MavCmd, MavMissionResult, MavType, RadioStatus,
};
use mavstack::{Address, Duration, Instant, LinkId, Message};
use mavstack_demo::TELEMETRY;
use semihosting::println;

use crate::station::{Pinger, Upload, request_message};
use crate::world::{Client, Network, OTHER, Parts, Received, STATION, World};

/// Times (µs) at which a counter of some width and unit wraps.
const WRAPS: [(&str, u64); 11] = [
    ("2^31 us", 1 << 31),
    ("2^32 us", 1 << 32),
    ("2^31 units of 1,024 us", 1 << 41),
    ("2^32 units of 1,024 us", 1 << 42),
    ("2^31 ms", 1_000 << 31),
    ("2^32 ms", 1_000 << 32),
    ("2^31 s", 1_000_000 << 31),
    ("2^32 s", 1_000_000 << 32),
    ("2^48 units of 10 us", 10 << 48),
    ("2^53 us", 1 << 53),
    ("2^63 ns", (1 << 63) / 1_000),
];
const RADIO: Address = Address::new(51, 68);
/// Time from boot to the wrap.
const BEFORE: Duration = Duration::from_secs(5);
/// Simulated time per run (s).
const RUN_TIME: u64 = 18;
/// A common multiple of all units of time (µs). Runs that start at multiples of it are comparable.
const COMMON: u64 = 640_000;

/// Capacity for message types per link.
const KINDS: usize = 64;
/// Tolerance for times of frames (ms). A frame that contains a time may be a byte or two longer or shorter, which delays others.
const TOLERANCE: u64 = 30;

/// Statistics of one message type on one link.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Row {
    link: LinkId,
    id: u32,
    count: u32,
    last: Instant,
    longest: Duration,
    shortest: Duration,
}

impl Row {
    /// Whether both have the same count and intervals, within the tolerance.
    fn matches(&self, other: &Self) -> bool {
        let is_near = |a: Duration, b: Duration| a.as_millis().abs_diff(b.as_millis()) <= TOLERANCE;
        (self.link, self.id) == (other.link, other.id)
            && self.count.abs_diff(other.count) <= 1
            && is_near(self.longest, other.longest)
            && is_near(self.shortest, other.shortest)
    }
}

/// Records the frames of a run by link and message type.
struct Transcript {
    from: Instant,
    rows: [Option<Row>; KINDS],
    frames: u32,
}

impl Client for Transcript {
    fn on_frame(&mut self, frame: &Received<'_>, _: &mut Network) {
        self.frames += 1;
        let (link, id, now) = (frame.link, frame.id, frame.now);
        let is_it = |row: &Option<Row>| row.is_none_or(|row| (row.link, row.id) == (link, id));
        let slot = self.rows.iter_mut().find(|row| is_it(row)).expect("fewer message types");
        let fresh = Row { link, id, count: 0, last: self.from, longest: Duration::ZERO, shortest: Duration::MAX };
        let row = slot.get_or_insert(fresh);
        let gap = now - row.last;
        (row.count, row.last) = (row.count + 1, now);
        (row.longest, row.shortest) = (row.longest.max(gap), row.shortest.min(gap));
    }
}

/// A client that starts all timers of the vehicle.
struct Script {
    from: Instant,
    next: u32,
}

impl Client for Script {
    fn on_frame(&mut self, _: &Received<'_>, _: &mut Network) {}

    fn tick(&mut self, now: Instant, network: &mut Network) {
        let due = Duration::from_millis(u64::from(self.next) * 500);
        if now - self.from < due {
            return;
        }
        // A ground station that times out and reconnects.
        if self.next < 6 || self.next > 28 {
            let heartbeat = Heartbeat { r#type: MavType::GCS, mavlink_version: 3, ..Heartbeat::default() };
            network.send(TELEMETRY, STATION, &heartbeat);
        }
        match self.next {
            2 => network.send(TELEMETRY, RADIO, &RadioStatus { txbuf: 30, ..RadioStatus::default() }),
            3 | 9 | 15 => network.send(TELEMETRY, STATION, &request_message(AutopilotVersion::ID)),
            4 => {
                let (command, param1) = (MavCmd::SET_MESSAGE_INTERVAL, Attitude::ID as f32);
                network.send(
                    LinkId(1),
                    OTHER,
                    &CommandLong { command, param1, param2: 70_000.0, ..request_message(0) },
                );
            }
            _ => {}
        }
        self.next += 1;
    }
}

/// Runs the vehicle from `start`, checks it, and returns the transcript.
fn run_from(parts: Parts, start: Instant, what: &str) -> (Parts, Transcript) {
    let mut parts = parts;
    parts.erase();
    let mut world = World::start(parts, start);
    let mut transcript = Transcript { from: start, rows: [None; KINDS], frames: 0 };
    let mut script = Script { from: start, next: 0 };
    let mut pinger = Pinger::new(TELEMETRY, STATION, Duration::from_millis(700));
    // One upload completes before the wrap, one stalls during it because its client falls silent, and one follows.
    let mut silent = Upload::new(TELEMETRY, STATION, 20, 2).silent_after(9);
    let mut successor = None;
    let end = start + Duration::from_secs(RUN_TIME);
    let mut first = Upload::new(LinkId(1), OTHER, 20, 1);
    let mut is_accepted = false;
    // The vehicle reports at once that it has booted, 10 ms after its first heartbeat.
    world.run(Duration::from_millis(100), &mut [&mut transcript, &mut script]);
    world.reset_tally();
    while world.now < end {
        let since = world.now - start;
        let mut clients: [&mut dyn Client; 4] = [&mut transcript, &mut script, &mut pinger, &mut first];
        if since >= Duration::from_secs(12) {
            let successor = successor.get_or_insert_with(|| Upload::new(LinkId(1), OTHER, 20, 3));
            clients[3] = successor;
            world.pass(&mut clients);
            is_accepted = successor.result == Some(MavMissionResult::ACCEPTED);
        } else if since >= Duration::from_secs(3) {
            clients[3] = &mut silent;
            world.pass(&mut clients);
        } else {
            world.pass(&mut clients);
        }
    }
    assert!(first.result == Some(MavMissionResult::ACCEPTED), "{what}: first upload: {:?}", first.result);
    assert!(
        silent.is_silent && is_accepted && world.live(3) == Some(20),
        "{what}: the stalled upload has not timed out"
    );
    assert!(pinger.answers + 1 >= pinger.sent, "{what}: {} of {} pings answered", pinger.answers, pinger.sent);
    for link in [0, 1] {
        let tally = world.tally[usize::from(link)];
        let (longest, shortest) = (world.longest_silence(LinkId(link)).as_millis(), tally.shortest.as_millis());
        assert!(longest <= 1_030 && shortest >= 970, "{what}: heartbeats {shortest} to {longest} ms apart");
    }
    (world.end(), transcript)
}

/// A run over each wrap behaves like a run at any other time: no timer is early, late or lost.
pub fn wraps(mut parts: Parts) -> Parts {
    let reference;
    (parts, reference) = run_from(parts, Instant::from_micros(100 * COMMON), "reference");
    let mut kinds = 0;
    for (what, wrap) in WRAPS {
        let start = (wrap - BEFORE.as_micros()) / COMMON * COMMON;
        let here;
        (parts, here) = run_from(parts, Instant::from_micros(start), what);
        kinds = here.rows.iter().flatten().count();
        assert!(kinds == reference.rows.iter().flatten().count(), "{what}: {kinds} message types");
        for was in reference.rows.iter().flatten() {
            let Some(is) = here.rows.iter().flatten().find(|row| (row.link, row.id) == (was.link, was.id)) else {
                panic!("{what}: no message {} on link {}", was.id, was.link.0)
            };
            assert!(
                is.matches(was),
                "{what}: message {} on link {}: {} times, {} to {} ms apart; expected {}, {} to {}",
                is.id,
                is.link.0,
                is.count,
                is.shortest.as_millis(),
                is.longest.as_millis(),
                was.count,
                was.shortest.as_millis(),
                was.longest.as_millis()
            );
        }
    }
    println!(
        "clock-wraps: {} wraps, {RUN_TIME} s each: {} frames of {kinds} types, the same counts as at any other time, at most \
         {TOLERANCE} ms earlier or later",
        WRAPS.len(),
        reference.frames
    );
    parts
}
