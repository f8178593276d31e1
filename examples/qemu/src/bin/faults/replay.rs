//! A signed session that somebody has recorded, and sends once more.

use mavstack::dialect::{
    AutopilotVersion, Heartbeat, MavMissionResult, MavParamType, MavType, ParamRequestList, ParamSet, Ping,
    SetupSigning,
};
use mavstack::{Duration, LinkId, Message, Secret, SigningCounters, SigningKey, Text, Vehicle};
use mavstack_demo::{COMPANION, TELEMETRY, Tuning};
use semihosting::println;

use crate::station::{Counter, request_message, upload};
use crate::world::{Parts, STATION, Signer, Tape, World};

const KEY: [u8; 32] = [0x42; 32];
/// Some time in 2025, in units of 10 µs.
const TIME: u64 = 33_000_000_000_000;
const ITEMS: u16 = 20;

fn counters(world: &mut World) -> SigningCounters {
    world.app().parts().1.signing().map(|signing| signing.counters()).unwrap_or_default()
}

/// Plays the tape on `link`; how many of its frames were dropped for their time.
fn play(world: &mut World, tape: &Tape, link: LinkId) -> u32 {
    let before = counters(world);
    let mut counter = Counter::default();
    for piece in tape.bytes[..tape.len].chunks(32) {
        while world.air.lines[usize::from(link.0)].up.room() < 200 {
            world.pass(&mut [&mut counter]);
        }
        piece.iter().for_each(|byte| world.air.lines[usize::from(link.0)].up.push(*byte));
    }
    while !world.air.lines[usize::from(link.0)].up.is_empty() {
        world.pass(&mut [&mut counter]);
    }
    world.run(Duration::from_millis(500), &mut [&mut counter]);
    assert!(counter.answers == 0, "by link {}: {} answers", link.0, counter.answers);
    let after = counters(world);
    assert!(after.verified == before.verified, "by link {}: {} accepted", link.0, after.verified - before.verified);
    after.replayed + after.too_old - before.replayed - before.too_old
}

/// Uploads, commands and parameters, signed; and all of it again, by each line, before and after a restart.
pub fn replay(parts: Parts) -> Parts {
    let mut world = World::fresh(parts);
    world.run(Duration::from_secs(1), &mut []);
    let setup =
        SetupSigning { target_system: 1, target_component: 1, secret_key: Secret(KEY), initial_timestamp: TIME };
    world.air.send(COMPANION, STATION, &setup);
    world.run(Duration::from_secs(1), &mut []);

    // 2 kB is more than a stack's frame should be.
    let tape = cortex_m::singleton!(: Tape = Tape { bytes: [0; 2048], len: 0, frames: 0 });
    world.air.tape = tape;
    world.air.signer = Some(Signer { key: SigningKey::new(KEY), timestamp: TIME + 1_000_000 });
    let mut counter = Counter::default();
    let beat = Heartbeat { r#type: MavType::GCS, mavlink_version: 3, ..Heartbeat::default() };
    world.air.send(TELEMETRY, STATION, &beat);
    assert!(upload(&mut world, TELEMETRY, STATION, ITEMS, 1) == MavMissionResult::ACCEPTED);
    world.air.send(TELEMETRY, STATION, &request_message(AutopilotVersion::ID));
    world.air.send(TELEMETRY, STATION, &Ping { seq: 1, ..Ping::default() });
    world.air.send(TELEMETRY, STATION, &ParamRequestList { target_system: 1, target_component: 1 });
    let speed = ParamSet {
        target_system: 1,
        target_component: 1,
        param_id: Text::new("MPC_XY_CRUISE"),
        param_type: MavParamType::REAL32,
        param_value: 3.0,
    };
    world.air.send(TELEMETRY, STATION, &speed);
    world.run(Duration::from_secs(12), &mut [&mut counter]);
    assert!(counter.answers > 10 && counter.acks == 1, "the session itself: {} answers", counter.answers);

    let tape = world.air.tape.take().expect("it was put in");
    // Since then all has changed.
    assert!(upload(&mut world, TELEMETRY, STATION, ITEMS, 2) == MavMissionResult::ACCEPTED);
    world.air.send(TELEMETRY, STATION, &ParamSet { param_value: 4.0, ..speed });
    world.run(Duration::from_secs(12), &mut []);
    let mut dropped = 0;
    for restarts in 0..2 {
        for link in [TELEMETRY, COMPANION, LinkId(2)] {
            let count = play(&mut world, tape, link);
            assert!(count == tape.frames, "by link {}: {count} of {} frames dropped", link.0, tape.frames);
            dropped += count;
        }
        let speed = world.app().vehicle().tuning().get(Tuning::MPC_XY_CRUISE);
        assert!(world.live(2) == Some(ITEMS) && speed == 4.0, "after {restarts} restarts: something has changed");
        world = world.restarted();
        // Without this a stream may begin up to a minute ago, which the session may be (G-6).
        let now = world.now;
        if let Some(signing) = world.app().parts().1.signing() {
            signing.refuse_recorded(now);
        }
        world.run(Duration::from_secs(1), &mut []);
    }
    println!(
        "replay: a session of {} signed frames, resent by each of 3 lines, before and after a restart: {dropped} of {} \
              dropped and counted, no answer",
        tape.frames,
        tape.frames * 6
    );
    world.end()
}
