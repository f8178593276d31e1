//! Lines that lose, flip and insert bytes, and lines that stall.

use mavstack::dialect::{AutopilotVersion, Heartbeat, MavMissionResult, ParamRequestList, ParamValue, Ping};
use mavstack::dialect::{CommandAck, MavType, MissionCount, MissionRequestList, ParamRequestRead};
use mavstack::param::ParamTable;
use mavstack::{Duration, LinkId, Message, Text};
use mavstack_demo::{COMPANION, TELEMETRY, Tuning};
use semihosting::println;

use crate::line::Damage;
use crate::line::Random;
use crate::station::{Pinger, request_message, upload};
use crate::world::{Client, Network, OTHER, Parts, Received, STATION, World};

const MISSIONS: u16 = 10;
const ITEMS: u16 = 40;

/// Damages one in ten frames in both directions. Every intact frame is received, no damaged one is, and uploads succeed.
pub fn damage(mut parts: Parts) -> Parts {
    let (mut intact, mut slowest) = (0, Duration::ZERO);
    for (flips, losses, bursts) in
        [(true, false, false), (false, true, false), (false, false, true), (true, true, true)]
    {
        let mut world = World::fresh(parts);
        let (line, at) = (TELEMETRY, usize::from(TELEMETRY.0));
        world.network.lines[at].damage = Damage { flips, losses, bursts };
        for variant in 1..=MISSIONS {
            // Directly after an upload, a MISSION_COUNT with the same count may be a delayed duplicate and is ignored (M-22).
            world.run(Duration::from_secs(1), &mut []);
            let began = world.now;
            let result = upload(&mut world, line, STATION, ITEMS, variant);
            assert!(result == MavMissionResult::ACCEPTED, "upload over a damaged line: {result:?}");
            assert!(world.live(variant) == Some(ITEMS), "the live mission differs from the one sent");
            slowest = slowest.max(world.now - began);
        }
        // A thousand more frames.
        let mut pinger = Pinger::new(line, STATION, Duration::ZERO);
        for _ in 0..1_000 {
            world.pass(&mut [&mut pinger]);
        }
        // Let the decoder discard an incomplete frame at the end.
        world.run(Duration::from_secs(2), &mut []);
        let received = world.app().parts().0.rx_counters(line).map_or(0, |rx| rx.frames);
        let sent = world.network.lines[at].intact;
        assert!(received == sent, "{received} of {sent} intact frames received");
        intact += sent;
        parts = world.end();
    }
    println!(
        "uart-damage: {intact} of {intact} intact frames received, no damaged one; {} uploads of {ITEMS} items, at most {} ms",
        4 * MISSIONS,
        slowest.as_millis()
    );
    parts
}

/// The pending answers, and whether they were received.
#[derive(Default)]
struct Pending {
    version: bool,
    ack: bool,
    ping: bool,
    count: bool,
    value: bool,
    /// Parameters of the list, as bits.
    listed: u64,
    heartbeats: u32,
}

impl Client for Pending {
    fn on_frame(&mut self, frame: &Received<'_>, _: &mut Network) {
        if frame.link != TELEMETRY {
            return;
        }
        match frame.id {
            AutopilotVersion::ID => self.version = true,
            CommandAck::ID => self.ack = true,
            Ping::ID => self.ping = true,
            MissionCount::ID => self.count = true,
            Heartbeat::ID => self.heartbeats += 1,
            _ => {}
        }
        if let Some(value) = frame.get::<ParamValue>() {
            self.value |= value.param_id == Text::new("MPC_XY_CRUISE");
            self.listed |= 1 << value.param_index;
        }
    }
}

const STALLS: u32 = 20;

/// Stalls the line in both directions for 5 s, at various times. Requests from before the stall are answered after it.
pub fn stall(parts: Parts) -> Parts {
    let mut world = World::fresh(parts);
    world.step = Duration::from_millis(5);
    let mut random = Random::new(5);
    let all = (1 << Tuning::INFO.len()) - 1;
    let (mut latest, mut first_heartbeat) = (Duration::ZERO, Duration::ZERO);
    let mut pinger = Pinger::new(COMPANION, OTHER, Duration::from_millis(100));
    world.run(Duration::from_secs(3), &mut [&mut pinger]);
    for turn in 0..STALLS {
        world.run(Duration::from_millis(200 + random.below(1_500) as u64), &mut [&mut pinger]);
        let mut pending = Pending::default();
        let (target_system, target_component) = (1, 1);
        let network = &mut world.network;
        network.send(
            TELEMETRY,
            STATION,
            &Heartbeat { r#type: MavType::GCS, mavlink_version: 3, ..Heartbeat::default() },
        );
        network.send(TELEMETRY, STATION, &request_message(AutopilotVersion::ID));
        network.send(TELEMETRY, STATION, &Ping { seq: turn, ..Ping::default() });
        network.send(TELEMETRY, STATION, &MissionRequestList { target_system, target_component, ..Default::default() });
        let read =
            ParamRequestRead { param_index: -1, param_id: Text::new("MPC_XY_CRUISE"), target_system, target_component };
        network.send(TELEMETRY, STATION, &read);
        network.send(TELEMETRY, STATION, &ParamRequestList { target_system, target_component });
        // Run until the vehicle has read all requests; every second time its output is stalled meanwhile. Then run a little
        // longer, so that a frame may be partly sent.
        world.network.lines[0].is_full = turn % 2 == 1;
        while !world.network.lines[0].up.is_empty() {
            world.pass(&mut [&mut pending, &mut pinger]);
        }
        world.run(Duration::from_millis(u64::from(turn % 7) * 5), &mut [&mut pending, &mut pinger]);
        world.network.lines[0].is_stuck = true;
        pending.heartbeats = 0;
        world.run(Duration::from_secs(5), &mut [&mut pending, &mut pinger]);
        (world.network.lines[0].is_stuck, world.network.lines[0].is_full) = (false, false);
        let resumed = world.now;
        let (mut answered, mut heartbeat) = (None, None);
        let is_answered =
            |pending: &Pending| pending.version && pending.ack && pending.ping && pending.count && pending.value;
        while !is_answered(&pending) || pending.listed & all != all || pending.heartbeats == 0 {
            world.pass(&mut [&mut pending, &mut pinger]);
            let waited = world.now - resumed;
            assert!(
                waited < Duration::from_secs(5),
                "stall {turn}: ack {}, version {}, ping {}, count {}, value {}, \
                list {:x}, heartbeats {}",
                pending.ack,
                pending.version,
                pending.ping,
                pending.count,
                pending.value,
                pending.listed,
                pending.heartbeats
            );
            if is_answered(&pending) {
                answered.get_or_insert(waited);
            }
            if pending.heartbeats > 0 {
                heartbeat.get_or_insert(waited);
            }
        }
        first_heartbeat = first_heartbeat.max(heartbeat.unwrap_or(Duration::MAX));
        latest = latest.max(answered.unwrap_or(Duration::ZERO));
        assert!(first_heartbeat < Duration::from_millis(1_050), "no heartbeat for {} ms", first_heartbeat.as_millis());
    }
    let counters = world.app().parts().0.link_counters(TELEMETRY).map_or(0, |link| link.no_answer_slot);
    assert!(counters == 0, "{counters} requests were not carried out");
    // The other link is not affected.
    assert!(pinger.sent <= pinger.answers + 1, "{} of {} pings answered", pinger.answers, pinger.sent);
    assert!(world.longest_silence(LinkId(1)) < Duration::from_millis(1_050), "heartbeats missing on the other link");
    println!(
        "uart-stall: {STALLS} stalls of 5 s; then a heartbeat within {} ms, {} pending answers each time, all single ones within \
         {} ms; {} pings on the other link, at most {} ms",
        first_heartbeat.as_millis(),
        5 + Tuning::INFO.len(),
        latest.as_millis(),
        pinger.answers,
        pinger.slowest.as_millis()
    );
    world.end()
}
