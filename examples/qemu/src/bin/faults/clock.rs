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
const WATCHED: usize = 18;
/// What all units of time that are in use have in common, µs: with that, two runs may be the same.
const COMMON: u64 = 640_000;

/// What came in each second: when, from where, what.
struct Transcript {
    from: Instant,
    seconds: [u32; WATCHED],
    frames: u32,
}

impl Transcript {
    fn note(&mut self, value: u32, at: Instant) {
        let second = (at.since(self.from).as_millis() / 1_000) as usize;
        if let Some(hash) = self.seconds.get_mut(second) {
            *hash = (*hash ^ value).wrapping_mul(0x0100_0193).rotate_left(7);
        }
    }
}

impl Ear for Transcript {
    fn hear(&mut self, heard: &Heard<'_>, _: &mut Air) {
        self.frames += 1;
        self.note(heard.now.since(self.from).as_micros() as u32, heard.now);
        self.note(heard.id << 8 | u32::from(heard.link.0), heard.now);
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
fn watch(parts: Parts, start: Instant, what: &str) -> (Parts, [u32; WATCHED], u32) {
    let mut parts = parts;
    parts.erase();
    let mut world = World::start(parts, start);
    let mut transcript = Transcript { from: start, seconds: [0; WATCHED], frames: 0 };
    let mut script = Script { from: start, next: 0 };
    let mut pinger = Pinger::new(TELEMETRY, STATION, Duration::from_millis(700));
    // One upload is through before, one waits for its dead owner over the wrap, one comes after it.
    let mut dead = Upload::new(TELEMETRY, STATION, 20, 2).dying_after(9);
    let mut heir = None;
    let end = start.after(Duration::from_secs(WATCHED as u64));
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
    (world.end(), transcript.seconds, transcript.frames)
}

/// Over each wrap all passes as it does at any other time: no timer is early, late or lost.
pub fn wraps(mut parts: Parts) -> Parts {
    let (usual, mut frames);
    (parts, usual, frames) = watch(parts, Instant::from_micros(100 * COMMON), "at any time");
    for (what, wrap) in WRAPS {
        let start = (wrap - BEFORE.as_micros()) / COMMON * COMMON;
        let seconds;
        (parts, seconds, frames) = watch(parts, Instant::from_micros(start), what);
        for (second, (is, was)) in seconds.iter().zip(&usual).enumerate() {
            assert!(is == was, "{what}: second {second} is not as at any other time");
        }
    }
    println!(
        "clock-wraps: over each of {} wraps the same {frames} frames at the same moments as at any other time, {WATCHED} s each",
        WRAPS.len()
    );
    parts
}
