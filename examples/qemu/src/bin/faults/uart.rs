//! Lines that lose, flip and add bytes, and lines on which nothing moves.

use mavstack::dialect::{AutopilotVersion, Heartbeat, MavMissionResult, ParamRequestList, ParamValue, Ping};
use mavstack::dialect::{CommandAck, MavType, MissionCount, MissionRequestList, ParamRequestRead};
use mavstack::{Duration, LinkId, Message, ParamTable, Text};
use mavstack_demo::{COMPANION, TELEMETRY, Tuning};
use semihosting::println;

use crate::line::Damage;
use crate::line::Random;
use crate::station::{Pinger, request_message, upload};
use crate::world::{Air, Ear, Heard, OTHER, Parts, STATION, World};

const MISSIONS: u16 = 10;
const ITEMS: u16 = 40;

/// A tenth of the frames is damaged, both ways: each one that is not is heard, nothing else is, and uploads come through.
pub fn damage(mut parts: Parts) -> Parts {
    let (mut intact, mut slowest) = (0, Duration::ZERO);
    for (flips, losses, bursts) in
        [(true, false, false), (false, true, false), (false, false, true), (true, true, true)]
    {
        let mut world = World::fresh(parts);
        let (line, at) = (TELEMETRY, usize::from(TELEMETRY.0));
        world.air.lines[at].damage = Damage { flips, losses, bursts };
        for variant in 1..=MISSIONS {
            // One of the same length at once after another may be a late copy, and is not pursued (M-22).
            world.run(Duration::from_secs(1), &mut []);
            let began = world.now;
            let result = upload(&mut world, line, STATION, ITEMS, variant);
            assert!(result == MavMissionResult::ACCEPTED, "the line is bad: {result:?}");
            assert!(world.live(variant) == Some(ITEMS), "it is not the mission that was sent");
            slowest = slowest.max(world.now.since(began));
        }
        // A thousand more.
        let mut pinger = Pinger::new(line, STATION, Duration::ZERO);
        for _ in 0..1_000 {
            world.pass(&mut [&mut pinger]);
        }
        // What was cut short at the end is given up.
        world.run(Duration::from_secs(2), &mut []);
        let heard = world.app().parts().0.rx_counters(line).map_or(0, |rx| rx.frames);
        let sent = world.air.lines[at].intact;
        assert!(heard == sent, "of {sent} intact frames {heard} are heard");
        intact += sent;
        parts = world.end();
    }
    println!(
        "uart-damage: {intact} of {intact} intact frames heard, no other; {} uploads of {ITEMS} items, at most {} ms",
        4 * MISSIONS,
        slowest.as_millis()
    );
    parts
}

/// What is owed.
#[derive(Default)]
struct Owed {
    version: bool,
    ack: bool,
    ping: bool,
    count: bool,
    value: bool,
    /// Parameters by their number.
    listed: u64,
    beats: u32,
}

impl Ear for Owed {
    fn hear(&mut self, heard: &Heard<'_>, _: &mut Air) {
        if heard.link != TELEMETRY {
            return;
        }
        match heard.id {
            AutopilotVersion::ID => self.version = true,
            CommandAck::ID => self.ack = true,
            Ping::ID => self.ping = true,
            MissionCount::ID => self.count = true,
            Heartbeat::ID => self.beats += 1,
            _ => {}
        }
        if let Some(value) = heard.get::<ParamValue>() {
            self.value |= value.param_id == Text::new("MPC_XY_CRUISE");
            self.listed |= 1 << value.param_index;
        }
    }
}

const STALLS: u32 = 20;

/// Nothing moves for 5 s, either way, from many moments on; what was asked for before is answered after.
pub fn stall(parts: Parts) -> Parts {
    let mut world = World::fresh(parts);
    world.step = Duration::from_millis(5);
    let mut random = Random::new(5);
    let all = (1 << Tuning::INFO.len()) - 1;
    let (mut latest, mut first_beat) = (Duration::ZERO, Duration::ZERO);
    let mut pinger = Pinger::new(COMPANION, OTHER, Duration::from_millis(100));
    world.run(Duration::from_secs(3), &mut [&mut pinger]);
    for turn in 0..STALLS {
        world.run(Duration::from_millis(200 + random.below(1_500) as u64), &mut [&mut pinger]);
        let mut owed = Owed::default();
        let (target_system, target_component) = (1, 1);
        let air = &mut world.air;
        air.send(TELEMETRY, STATION, &Heartbeat { r#type: MavType::GCS, mavlink_version: 3, ..Heartbeat::default() });
        air.send(TELEMETRY, STATION, &request_message(AutopilotVersion::ID));
        air.send(TELEMETRY, STATION, &Ping { seq: turn, ..Ping::default() });
        air.send(TELEMETRY, STATION, &MissionRequestList { target_system, target_component, ..Default::default() });
        let read =
            ParamRequestRead { param_index: -1, param_id: Text::new("MPC_XY_CRUISE"), target_system, target_component };
        air.send(TELEMETRY, STATION, &read);
        air.send(TELEMETRY, STATION, &ParamRequestList { target_system, target_component });
        // Until it has read all this, with every second time no room for an answer; and then a little, so that a frame may be
        // half out.
        world.air.lines[0].is_full = turn % 2 == 1;
        while !world.air.lines[0].up.is_empty() {
            world.pass(&mut [&mut owed, &mut pinger]);
        }
        world.run(Duration::from_millis(u64::from(turn % 7) * 5), &mut [&mut owed, &mut pinger]);
        world.air.lines[0].is_stuck = true;
        owed.beats = 0;
        world.run(Duration::from_secs(5), &mut [&mut owed, &mut pinger]);
        (world.air.lines[0].is_stuck, world.air.lines[0].is_full) = (false, false);
        let opened = world.now;
        let (mut paid, mut beat) = (None, None);
        let is_paid = |owed: &Owed| owed.version && owed.ack && owed.ping && owed.count && owed.value;
        while !is_paid(&owed) || owed.listed & all != all || owed.beats == 0 {
            world.pass(&mut [&mut owed, &mut pinger]);
            let waited = world.now.since(opened);
            assert!(
                waited < Duration::from_secs(5),
                "stall {turn}: ack {}, version {}, ping {}, count {}, value {}, \
                of the list {:x}, heartbeats {}",
                owed.ack,
                owed.version,
                owed.ping,
                owed.count,
                owed.value,
                owed.listed,
                owed.beats
            );
            if is_paid(&owed) {
                paid.get_or_insert(waited);
            }
            if owed.beats > 0 {
                beat.get_or_insert(waited);
            }
        }
        first_beat = first_beat.max(beat.unwrap_or(Duration::MAX));
        latest = latest.max(paid.unwrap_or(Duration::ZERO));
        assert!(first_beat < Duration::from_millis(1_050), "no heartbeat for {} ms", first_beat.as_millis());
    }
    let counters = world.app().parts().0.link_counters(TELEMETRY).map_or(0, |link| link.no_answer_slot);
    assert!(counters == 0, "{counters} requests were not carried out");
    // The other line has noticed nothing.
    assert!(pinger.sent <= pinger.answers + 1, "{} of {} pings answered", pinger.answers, pinger.sent);
    assert!(world.longest_silence(LinkId(1)) < Duration::from_millis(1_050), "the other line has suffered");
    println!(
        "uart-stall: {STALLS} times 5 s; then a heartbeat within {} ms, {} owed replies each time, the last of the single ones \
         within {} ms; {} pings on the other line, at most {} ms",
        first_beat.as_millis(),
        5 + Tuning::INFO.len(),
        latest.as_millis(),
        pinger.answers,
        pinger.slowest.as_millis()
    );
    world.end()
}
