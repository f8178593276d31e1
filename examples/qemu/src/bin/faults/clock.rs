//! Clocks that come to where a number of theirs wraps.

use mavstack::dialect::{
    Attitude, AutopilotVersion, CommandLong, Heartbeat, MavCmd, MavMissionResult, MavType, RadioStatus,
};
use mavstack::{Address, Duration, Instant, LinkId, Message};
use mavstack_demo::TELEMETRY;
use semihosting::println;

use crate::station::{Pinger, Upload, request_message};
use crate::world::{Air, Ear, Heard, OTHER, Parts, STATION, World};

/// Moments at which something wraps that counts time in so many bits, µs.
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
/// So long before it the vehicle is switched on, and so long it is watched.
const BEFORE: Duration = Duration::from_secs(5);
const WATCHED: u64 = 18;
/// What all units of time that are in use have in common, µs: with that, two runs may be the same.
const COMMON: u64 = 640_000;

/// Kinds of messages on links; there are fewer.
const KINDS: usize = 64;
/// By so much may moments differ, ms: a frame that tells the time is a byte or two longer or shorter then, and others wait for it.
const TOLERANCE: u64 = 30;

/// What came of one kind on one link.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Row {
    link: LinkId,
    id: u32,
    count: u32,
    last: Instant,
    /// From one to the next.
    longest: Duration,
    shortest: Duration,
}

impl Row {
    /// Whether it came as often as another, and as regularly.
    fn is_like(&self, other: &Self) -> bool {
        let is_near = |a: Duration, b: Duration| a.as_millis().abs_diff(b.as_millis()) <= TOLERANCE;
        (self.link, self.id) == (other.link, other.id)
            && self.count.abs_diff(other.count) <= 1
            && is_near(self.longest, other.longest)
            && is_near(self.shortest, other.shortest)
    }
}

/// What came, kind by kind.
struct Transcript {
    from: Instant,
    rows: [Option<Row>; KINDS],
    frames: u32,
}

impl Ear for Transcript {
    fn hear(&mut self, heard: &Heard<'_>, _: &mut Air) {
        self.frames += 1;
        let (link, id, now) = (heard.link, heard.id, heard.now);
        let is_it = |row: &Option<Row>| row.is_none_or(|row| (row.link, row.id) == (link, id));
        let place = self.rows.iter_mut().find(|row| is_it(row)).expect("there are fewer kinds");
        let fresh = Row { link, id, count: 0, last: self.from, longest: Duration::ZERO, shortest: Duration::MAX };
        let row = place.get_or_insert(fresh);
        let gap = now.since(row.last);
        (row.count, row.last) = (row.count + 1, now);
        (row.longest, row.shortest) = (row.longest.max(gap), row.shortest.min(gap));
    }
}

/// Sends what sets all timers going.
struct Script {
    from: Instant,
    next: u32,
}

impl Ear for Script {
    fn hear(&mut self, _: &Heard<'_>, _: &mut Air) {}

    fn tick(&mut self, now: Instant, air: &mut Air) {
        let due = Duration::from_millis(u64::from(self.next) * 500);
        if now.since(self.from) < due {
            return;
        }
        // A ground station that is lost after a while, and comes back.
        if self.next < 6 || self.next > 28 {
            let beat = Heartbeat { r#type: MavType::GCS, mavlink_version: 3, ..Heartbeat::default() };
            air.send(TELEMETRY, STATION, &beat);
        }
        match self.next {
            2 => air.send(TELEMETRY, RADIO, &RadioStatus { txbuf: 30, ..RadioStatus::default() }),
            3 | 9 | 15 => air.send(TELEMETRY, STATION, &request_message(AutopilotVersion::ID)),
            4 => {
                let (command, param1) = (MavCmd::SET_MESSAGE_INTERVAL, Attitude::ID as f32);
                air.send(LinkId(1), OTHER, &CommandLong { command, param1, param2: 70_000.0, ..request_message(0) });
            }
            _ => {}
        }
        self.next += 1;
    }
}

/// What passes from `start` on, and whether the vehicle is well.
fn watch(parts: Parts, start: Instant, what: &str) -> (Parts, Transcript) {
    let mut parts = parts;
    parts.erase();
    let mut world = World::start(parts, start);
    let mut transcript = Transcript { from: start, rows: [None; KINDS], frames: 0 };
    let mut script = Script { from: start, next: 0 };
    let mut pinger = Pinger::new(TELEMETRY, STATION, Duration::from_millis(700));
    // One upload is through before, one waits for its dead owner over the wrap, one comes after it.
    let mut dead = Upload::new(TELEMETRY, STATION, 20, 2).dying_after(9);
    let mut heir = None;
    let end = start.after(Duration::from_secs(WATCHED));
    let mut first = Upload::new(LinkId(1), OTHER, 20, 1);
    let mut is_well = false;
    while world.now < end {
        let since = world.now.since(start);
        let mut ears: [&mut dyn Ear; 4] = [&mut transcript, &mut script, &mut pinger, &mut first];
        if since >= Duration::from_secs(12) {
            let heir = heir.get_or_insert_with(|| Upload::new(LinkId(1), OTHER, 20, 3));
            ears[3] = heir;
            world.pass(&mut ears);
            is_well = heir.result == Some(MavMissionResult::ACCEPTED);
        } else if since >= Duration::from_secs(3) {
            ears[3] = &mut dead;
            world.pass(&mut ears);
        } else {
            world.pass(&mut ears);
        }
    }
    assert!(first.result == Some(MavMissionResult::ACCEPTED), "{what}: before: {:?}", first.result);
    assert!(dead.is_dead && is_well && world.live(3) == Some(20), "{what}: an upload still waits for the dead one");
    assert!(pinger.answers + 1 >= pinger.sent, "{what}: {} of {} pings answered", pinger.answers, pinger.sent);
    for link in [0, 1] {
        let tally = world.tally[usize::from(link)];
        let (longest, shortest) = (world.longest_silence(LinkId(link)).as_millis(), tally.shortest.as_millis());
        assert!(longest <= 1_030 && shortest >= 970, "{what}: heartbeats {shortest} to {longest} ms apart");
    }
    (world.end(), transcript)
}

/// Over each wrap all passes as it does at any other time: no timer is early, late or lost.
pub fn wraps(mut parts: Parts) -> Parts {
    let usual;
    (parts, usual) = watch(parts, Instant::from_micros(100 * COMMON), "at any time");
    let mut kinds = 0;
    for (what, wrap) in WRAPS {
        let start = (wrap - BEFORE.as_micros()) / COMMON * COMMON;
        let here;
        (parts, here) = watch(parts, Instant::from_micros(start), what);
        kinds = here.rows.iter().flatten().count();
        assert!(kinds == usual.rows.iter().flatten().count(), "{what}: {kinds} kinds of messages");
        for was in usual.rows.iter().flatten() {
            let Some(is) = here.rows.iter().flatten().find(|row| (row.link, row.id) == (was.link, was.id)) else {
                panic!("{what}: no message {} by link {}", was.id, was.link.0)
            };
            assert!(
                is.is_like(was),
                "{what}: message {} by link {}: {} times, {} to {} ms apart, instead of {}, {} to {}",
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
        "clock-wraps: over each of {} wraps, {WATCHED} s: {} frames of {kinds} kinds, each as often, and at most {TOLERANCE} ms \
         earlier or later, as at any other time",
        WRAPS.len(),
        usual.frames
    );
    parts
}
