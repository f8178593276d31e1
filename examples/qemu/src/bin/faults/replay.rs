//! A replay attack: a recorded signed session is sent again.

use mavstack::dialect::{
    AutopilotVersion, Heartbeat, MavMissionResult, MavParamType, MavType, ParamRequestList, ParamSet, Ping,
    SetupSigning,
};
use mavstack::message::Secret;
use mavstack::signing::{SigningCounters, SigningKey};
use mavstack::{Duration, LinkId, Message, Text};
use mavstack_demo::{COMPANION, TELEMETRY, Tuning};
use semihosting::println;

use crate::station::{Counter, request_message, upload};
use crate::world::{Parts, STATION, Signer, Tape, World};

const KEY: [u8; 32] = [0x42; 32];
/// A time in 2025, in units of 10 µs.
const TIME: u64 = 33_000_000_000_000;
const ITEMS: u16 = 20;

fn counters(world: &mut World) -> SigningCounters {
    world.app().stack().signing().counters()
}

/// Replays the recording on `link`. Returns how many frames were dropped for their timestamp.
fn play(world: &mut World, tape: &Tape, link: LinkId) -> u32 {
    let before = counters(world);
    let mut counter = Counter::default();
    for piece in tape.bytes[..tape.len].chunks(32) {
        while world.network.lines[usize::from(link.0)].up.room() < 200 {
            world.pass(&mut [&mut counter]);
        }
        piece.iter().for_each(|byte| world.network.lines[usize::from(link.0)].up.push(*byte));
    }
    while !world.network.lines[usize::from(link.0)].up.is_empty() {
        world.pass(&mut [&mut counter]);
    }
    world.run(Duration::from_millis(500), &mut [&mut counter]);
    assert!(counter.answers == 0, "link {}: {} answers", link.0, counter.answers);
    let after = counters(world);
    assert!(after.verified == before.verified, "link {}: {} accepted", link.0, after.verified - before.verified);
    after.replayed + after.too_old - before.replayed - before.too_old
}

/// Records a signed session with uploads, commands and parameters. Replays it on each link, before and after a reboot.
pub fn replay(parts: Parts) -> Parts {
    let mut world = World::fresh(parts);
    world.run(Duration::from_secs(1), &mut []);
    let setup =
        SetupSigning { target_system: 1, target_component: 1, secret_key: Secret(KEY), initial_timestamp: TIME };
    world.network.send(COMPANION, STATION, &setup);
    world.run(Duration::from_secs(1), &mut []);

    // Not on the stack, because it has 2 kB.
    let tape = cortex_m::singleton!(: Tape = Tape { bytes: [0; 2048], len: 0, frames: 0 });
    world.network.tape = tape;
    world.network.signer = Some(Signer { key: SigningKey::new(KEY), timestamp: TIME + 1_000_000 });
    let mut counter = Counter::default();
    let heartbeat = Heartbeat { r#type: MavType::GCS, mavlink_version: 3, ..Heartbeat::default() };
    world.network.send(TELEMETRY, STATION, &heartbeat);
    assert!(upload(&mut world, TELEMETRY, STATION, ITEMS, 1) == MavMissionResult::ACCEPTED);
    world.network.send(TELEMETRY, STATION, &request_message(AutopilotVersion::ID));
    world.network.send(TELEMETRY, STATION, &Ping { seq: 1, ..Ping::default() });
    world.network.send(TELEMETRY, STATION, &ParamRequestList { target_system: 1, target_component: 1 });
    let speed = ParamSet {
        target_system: 1,
        target_component: 1,
        param_id: Text::new("MPC_XY_CRUISE"),
        param_type: MavParamType::REAL32,
        param_value: 3.0,
    };
    world.network.send(TELEMETRY, STATION, &speed);
    world.run(Duration::from_secs(12), &mut [&mut counter]);
    assert!(counter.answers > 10 && counter.acks == 1, "the session itself: {} answers", counter.answers);

    let tape = world.network.tape.take().expect("set above");
    // Change everything that the session has set.
    assert!(upload(&mut world, TELEMETRY, STATION, ITEMS, 2) == MavMissionResult::ACCEPTED);
    world.network.send(TELEMETRY, STATION, &ParamSet { param_value: 4.0, ..speed });
    world.run(Duration::from_secs(12), &mut []);
    let mut dropped = 0;
    for restarts in 0..2 {
        for link in [TELEMETRY, COMPANION, LinkId(2)] {
            let count = play(&mut world, tape, link);
            assert!(count == tape.frames, "link {}: {count} of {} frames dropped", link.0, tape.frames);
            dropped += count;
        }
        let speed = world.app().stack().parameters().get(Tuning::MPC_XY_CRUISE);
        assert!(
            world.live(2) == Some(ITEMS) && speed == 4.0,
            "after {restarts} reboots: the plan or a parameter has changed"
        );
        world = world.restarted();
        // Without this a new stream may start up to a minute in the past, and the recording could be as recent as that (G-6).
        let now = world.now;
        world.app().parts().0.signing_mut().refuse_recorded(now);
        world.run(Duration::from_secs(1), &mut []);
    }
    println!(
        "replay: a session of {} signed frames, replayed on each of 3 links, before and after a reboot: {dropped} of {} dropped \
         and counted, no answer",
        tape.frames,
        tape.frames * 6
    );
    world.end()
}
