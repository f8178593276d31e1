//! The signing key of the demo vehicle: how it is set, and which frames are accepted then.

use crate::support::wire::{Received, STATION, Sent, Wire, command_long};
use mavstack::dialect::*;
use mavstack::frame::{Decoder, encode_signed};
use mavstack::message::{Dialect, Secret};
use mavstack::signing::SigningKey;
use mavstack::{Address, Duration, Instant, LinkId, Message};
use mavstack_demo::{COMPANION, SATELLITE, TELEMETRY};

const SECRET: [u8; 32] = [0x42; 32];
/// A time in 2025, in units of 10 µs.
const TIME: u64 = 33_000_000_000_000;

fn key() -> SigningKey {
    SigningKey::new(SECRET)
}

fn setup(secret_key: [u8; 32], initial_timestamp: u64) -> SetupSigning {
    SetupSigning { target_system: 1, target_component: 1, secret_key: Secret(secret_key), initial_timestamp }
}

/// Returns a vehicle whose key was set on the companion link.
fn signing() -> Wire {
    let mut wire = Wire::booted();
    wire.received.clear();
    wire.send(COMPANION, &setup(SECRET, TIME));
    wire.run(20);
    wire
}

fn is_signed(frame: &Received) -> bool {
    let (mut decoder, now) = (Decoder::new(Duration::from_secs(1)), Instant::ZERO);
    assert_eq!(decoder.push(&frame.raw, now), frame.raw.len());
    let mut work = u32::MAX;
    decoder.next(now, Sent::MESSAGES, &mut work, |_| true).is_some_and(|frame| frame.is_signed_with(&key()))
}

/// Returns a signed frame with a command that is answered in every state.
fn signed(key: &SigningKey, timestamp: u64) -> Vec<u8> {
    let command = command_long(1, MavCmd::REQUEST_MESSAGE, &[AutopilotVersion::ID as f32]);
    let mut frame = [0; 280];
    let len = encode_signed(&command, STATION, 0, key, 3, timestamp, &mut frame).unwrap();
    frame[..len].to_vec()
}

/// Sends a frame and counts the answers.
fn answers(wire: &mut Wire, link: LinkId, frame: &[u8]) -> usize {
    wire.take::<CommandAck>();
    wire.send_raw(link, frame);
    wire.run(200);
    wire.take::<CommandAck>().len()
}

/// G-11: once a key is set every frame is signed, on every link. A text and a heartbeat follow at once.
#[test]
fn frames_are_signed_once_a_key_is_set() {
    let mut wire = signing();
    assert!(wire.count::<Heartbeat>(COMPANION) >= 1 && wire.count::<Statustext>(COMPANION) == 1);
    wire.received.clear();
    wire.run(3_000);
    assert!(wire.received.len() > 100 && wire.received.iter().all(is_signed));
    wire.send_raw(SATELLITE, &signed(&key(), TIME + 1_000_000));
    wire.run(500);
    let ack = wire.received.iter().find(|frame| frame.link == SATELLITE).unwrap();
    assert!(ack.id == CommandAck::ID && is_signed(ack));
}

/// G-6, G-9, G-10: the radio links accept signed frames only, and each frame once. The companion link stays open.
#[test]
fn radio_links_accept_signed_frames_only() {
    let mut wire = signing();
    let command = command_long(1, MavCmd::REQUEST_MESSAGE, &[AutopilotVersion::ID as f32]);
    for link in [TELEMETRY, SATELLITE] {
        wire.take::<CommandAck>();
        wire.send(link, &command);
        wire.run(200);
        assert_eq!(wire.take::<CommandAck>().len(), 0, "unsigned");
    }
    wire.send(COMPANION, &command);
    wire.run(200);
    assert_eq!(wire.take::<CommandAck>().len(), 1);
    let frame = signed(&key(), TIME + 1_000_000);
    assert_eq!(answers(&mut wire, TELEMETRY, &frame), 1);
    assert_eq!(answers(&mut wire, TELEMETRY, &frame), 0, "replayed");
    assert_eq!(answers(&mut wire, SATELLITE, &frame), 0, "replayed elsewhere");
    let wrong = signed(&SigningKey::new([0x43; 32]), TIME + 1_000_001);
    for link in [TELEMETRY, COMPANION, SATELLITE] {
        assert_eq!(answers(&mut wire, link, &wrong), 0, "signed with another key");
    }
    let mut flipped = signed(&key(), TIME + 1_000_002);
    flipped[40] ^= 1;
    assert_eq!(answers(&mut wire, TELEMETRY, &flipped), 0);
    let newer = signed(&key(), TIME + 1_000_003);
    assert_eq!(answers(&mut wire, SATELLITE, &newer), 1);
}

/// G-11, SEC-6: the key is accepted on the companion link only, and not while armed. The same holds for its removal.
#[test]
fn the_key_is_set_on_the_companion_link_while_disarmed() {
    let mut wire = Wire::booted();
    for link in [TELEMETRY, SATELLITE] {
        wire.send(link, &setup(SECRET, TIME));
        wire.run(500);
    }
    wire.send(COMPANION, &SetupSigning { target_system: 0, ..setup(SECRET, TIME) });
    wire.run(500);
    wire.received.clear();
    assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED, "no key is set");
    wire.send(COMPANION, &setup(SECRET, TIME));
    wire.run(500);
    assert!(!wire.received.iter().any(is_signed));
    assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[0.0]), MavResult::ACCEPTED);
    wire.send(COMPANION, &setup(SECRET, TIME));
    wire.run(500);
    wire.received.clear();
    wire.run(1_000);
    assert!(wire.received.iter().all(is_signed));
    wire.send(COMPANION, &setup([0; 32], 0));
    wire.run(500);
    wire.received.clear();
    wire.run(1_000);
    assert!(!wire.received.is_empty() && !wire.received.iter().any(is_signed));
    assert_eq!(wire.long(MavCmd::REQUEST_MESSAGE, &[AutopilotVersion::ID as f32]), MavResult::ACCEPTED);
}

/// Takes the signature timestamps of the frames received since the last call, in units of 10 µs.
fn timestamps(wire: &mut Wire) -> Vec<u64> {
    let stamp = |frame: &Received| {
        let at = frame.raw.len() - 12;
        u64::from_le_bytes([&frame.raw[at..at + 6], &[0; 2]].concat().try_into().unwrap())
    };
    let stamps = wire.received.iter().filter(|frame| is_signed(frame)).map(stamp).collect();
    wire.received.clear();
    stamps
}

/// G-4, G-14: signatures and SYSTEM_TIME follow the vehicle's real-time clock. An old timestamp that comes with a key, unsigned
/// SYSTEM_TIME and GPS time do not change it.
#[test]
fn signatures_follow_the_clock() {
    const UNIX: u64 = 1_420_070_400_000_000 + 10 * (TIME + 5_000 * 6_000_000);
    let mut wire = Wire::new();
    assert!(!wire.app.vehicle().has_fix());
    wire.run(10);
    assert!(wire.take::<SystemTime>().iter().all(|(_, time)| time.time_unix_usec == 0));
    let (now, millis) = (Instant::from_millis(wire.millis), wire.millis);
    wire.app.set_calendar(now, UNIX);
    wire.send(COMPANION, &setup(SECRET, TIME));
    for seconds in [1, 3, 30] {
        wire.run(1_000 * seconds);
        let passed = (wire.millis - millis) * 100;
        let stamps = timestamps(&mut wire);
        let expected = TIME + 5_000 * 6_000_000 + passed;
        assert!(stamps.iter().all(|stamp| *stamp <= expected + 100), "{seconds}");
        assert!(stamps.last().is_some_and(|last| last.abs_diff(expected) < 10_000), "{seconds}: within 0.1 s");
        let late = SystemTime { time_unix_usec: UNIX + 1_000_000_000_000, time_boot_ms: 1 };
        wire.send(COMPANION, &late);
        wire.send(TELEMETRY, &late);
    }
    assert!(wire.app.vehicle().has_fix());
    wire.run(1_100);
    let times = wire.take::<SystemTime>();
    let (_, time) = times.last().expect("once a second");
    assert!(time.time_unix_usec - UNIX <= (wire.millis - millis) * 1_000 && time.time_unix_usec > UNIX + 34_000_000);
    // A signature moves the clock forward (G-6), unless it is more than ten minutes ahead (G-17).
    assert_eq!(answers(&mut wire, TELEMETRY, &signed(&key(), TIME + 5_012 * 6_000_000)), 0);
    assert!(timestamps(&mut wire).last().is_some_and(|last| *last < TIME + 5_005 * 6_000_000));
    assert_eq!(answers(&mut wire, TELEMETRY, &signed(&key(), TIME + 5_009 * 6_000_000)), 1);
    assert!(timestamps(&mut wire).last().is_some_and(|last| *last >= TIME + 5_009 * 6_000_000));
}

/// frames from the radio are forwarded to the open companion link only if the radio link accepts them.
#[test]
fn frames_refused_on_the_radio_are_not_forwarded() {
    let mut wire = signing();
    wire.received.clear();
    let stranger = Address::new(250, 190);
    let beat = Heartbeat { r#type: MavType::GCS, ..Heartbeat::default() };
    let refused = wire.send_as(TELEMETRY, stranger, &beat);
    wire.run(50);
    let mut frame = [0; 280];
    let len = encode_signed(&beat, stranger, 7, &key(), 3, TIME + 1_000_000, &mut frame).unwrap();
    wire.send_raw(TELEMETRY, &frame[..len]);
    wire.run(50);
    let reached = |frame: &[u8]| wire.received.iter().any(|got| got.link == COMPANION && got.raw == frame);
    assert!(!reached(&refused) && reached(&frame[..len]));
}
