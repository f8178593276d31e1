//! Writes the streams for the comparison to a folder.

use std::fs;
use std::path::PathBuf;

use mavstack::dialect::*;
use mavstack::frame::{MAX_FRAME_LEN, Version, encode};
use mavstack::{Address, Message};
use mavstack_compare::{DAMAGED, DAMAGED_SOURCE, FILLER, FRAMES, SOURCE};

#[path = "../../../../tests/support/damage.rs"]
mod damage;
#[path = "../../../../crates/station/src/kit/random.rs"]
mod random;
#[path = "../../../../tests/support/stream.rs"]
#[allow(dead_code, reason = "shared with the tests")]
mod stream;
use damage::{Damage, damage};
use random::Random as Rng;
use stream::Mixed;

const SENDER: Address = Address::new(SOURCE.0, SOURCE.1);

fn main() {
    let folder = PathBuf::from(std::env::args().nth(1).expect("a folder"));
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.join(name).with_extension("bin");
        fs::write(&path, bytes).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    };
    let mut rng = Rng::new(2);
    let mut out = [0; MAX_FRAME_LEN];
    let frame = |(seq, message): (usize, Mixed)| {
        let len = tame(message, &mut rng).encode(SENDER, seq as u8, &mut out).expect("every message fits");
        out[..len].to_vec()
    };
    let frames: Vec<_> = stream::messages(1, FRAMES).into_iter().enumerate().flat_map(frame).collect();
    println!("{FRAMES} frames, {:.1} bytes per frame", frames.len() as f64 / FRAMES as f64);
    write("frames", &frames);

    write("twelve", &twelve());

    let how = |flips, losses, bursts| Damage { flips, losses, bursts };
    let ways = [how(true, false, false), how(false, true, false), how(false, false, true), how(true, true, true)];
    // The same damage as in tests/wire/byte_stream.rs, with seeds for which no damaged frame has a valid checksum by chance.
    for (seed, name) in [1, 2, 3, 4, 6].into_iter().zip(DAMAGED) {
        let frames = stream::frames(seed, 20_000, Address::new(DAMAGED_SOURCE.0, DAMAGED_SOURCE.1));
        let mut rng = Rng::new(!seed);
        let (mut stream, intact) = match ways.get(seed as usize - 1) {
            Some(&how) => damage(&frames, how, &mut rng),
            None => noise(&frames, &mut rng),
        };
        stream.extend(FILLER);
        write(name, &stream);
        write(&format!("{name}-intact"), &intact.concat());
    }
}

/// Returns frames of the twelve messages that the firmwares read, twenty of each, with enum values that the definitions contain.
fn twelve() -> Vec<u8> {
    let mut rng = Rng::new(5);
    let mut all = Vec::new();
    for round in 0..20u16 {
        let mut frame = |message: &dyn Fn(&[u8], &mut [u8]) -> usize| {
            let (payload, mut out) = (std::array::from_fn::<u8, 255, _>(|_| rng.byte()), [0; MAX_FRAME_LEN]);
            let len = message(&payload, &mut out);
            all.extend_from_slice(&out[..len]);
        };
        macro_rules! frames {
            ($($message:ident { $($field:ident: $value:expr),* },)+) => { $(
                frame(&|payload, out| {
                    let message = $message { $($field: $value,)* ..$message::decode(&payload[..$message::BASE_LEN]) };
                    encode(&message, Version::V2, SENDER, round as u8, out).expect("every message fits")
                });
            )+ };
        }
        let command = MavCmd([16, 20, 21, 22, 176, 400, 511, 512][usize::from(round % 8)]);
        let number = round as u8;
        frames! {
            Heartbeat {
                r#type: MavType(number), autopilot: MavAutopilot(number % 19), system_status: MavState(number % 9),
                mavlink_version: 3
            },
            CommandLong { command: command },
            CommandInt { command: command, frame: MavFrame(number % 7) },
            MissionCount {},
            MissionItemInt { command: command, frame: MavFrame(number % 7) },
            MissionRequestInt {},
            MissionRequestList {},
            MissionAck { r#type: MavMissionResult(number % 16) },
            MissionClearAll {},
            ParamRequestList {},
            ParamRequestRead {},
            ParamSet { param_type: MavParamType(1 + number % 10) },
        }
    }
    all
}

/// Restricts enum values to those in the definitions. Some libraries refuse messages with unknown values, or encode other values.
fn tame(mut message: Mixed, rng: &mut Rng) -> Mixed {
    let mut one_of = |numbers: &[u16]| numbers[rng.below(numbers.len() as u64) as usize];
    let commands = [16, 20, 21, 22, 176, 400, 511, 512];
    match &mut message {
        Mixed::Heartbeat(heartbeat) => {
            heartbeat.r#type = MavType(heartbeat.r#type.0 % 30);
            heartbeat.autopilot = MavAutopilot(heartbeat.autopilot.0 % 19);
            heartbeat.system_status = MavState(heartbeat.system_status.0 % 9);
            // The C library always writes 3.
            heartbeat.mavlink_version = 3;
        }
        Mixed::SysStatus(status) => {
            for sensors in [
                &mut status.onboard_control_sensors_present,
                &mut status.onboard_control_sensors_enabled,
                &mut status.onboard_control_sensors_health,
            ] {
                sensors.0 &= 0x00FF_FFFF;
            }
        }
        Mixed::GpsRawInt(gps) => gps.fix_type = GpsFixType(gps.fix_type.0 % 9),
        Mixed::CommandLong(command) => command.command = MavCmd(one_of(&commands)),
        Mixed::CommandAck(ack) => {
            ack.command = MavCmd(one_of(&commands));
            ack.result = MavResult(ack.result.0 % 7);
        }
        Mixed::ParamValue(value) => value.param_type = MavParamType(1 + value.param_type.0 % 10),
        Mixed::MissionItemInt(item) => {
            item.frame = MavFrame(item.frame.0 % 7);
            item.command = MavCmd(one_of(&commands));
        }
        Mixed::Statustext(text) => text.severity = MavSeverity(text.severity.0 % 8),
        _ => {}
    }
    message
}

/// Changes one in a hundred bytes and inserts garbage between the frames. Returns the stream and the intact frames.
fn noise(frames: &[Vec<u8>], rng: &mut Rng) -> (Vec<u8>, Vec<Vec<u8>>) {
    let (mut stream, mut intact) = (Vec::new(), Vec::new());
    for frame in frames {
        let mut sent = frame.clone();
        for byte in &mut sent {
            if rng.chance(0.01) {
                *byte ^= 1 + rng.below(255) as u8;
            }
        }
        if sent == *frame {
            intact.push(sent.clone());
        }
        stream.extend(sent);
        stream.extend((0..rng.below(20)).map(|_| rng.byte()));
    }
    (stream, intact)
}
