//! Forwarding between a ground station on the radio, a companion computer of the same system, and the satellite link.

use crate::support::wire::{CAMERA, GIMBAL, STATION, Wire};
use mavstack::dialect::*;
use mavstack::frame::{Version, encode};
use mavstack::{Address, LinkId, Message, Text};
use mavstack_demo::{COMPANION, SATELLITE, TELEMETRY};

/// The companion computer.
const ONBOARD: Address = Address::new(1, 191);

/// Returns a booted vehicle that has received a heartbeat from the ground station and one from the companion.
fn connected() -> Wire {
    let mut wire = Wire::booted();
    send_heartbeats(&mut wire);
    wire.received.clear();
    wire
}

fn send_heartbeats(wire: &mut Wire) {
    let gcs = Heartbeat { r#type: MavType::GCS, autopilot: MavAutopilot::INVALID, ..Heartbeat::default() };
    let onboard = Heartbeat { r#type: MavType::ONBOARD_CONTROLLER, ..gcs };
    wire.send_as(TELEMETRY, STATION, &gcs);
    wire.send_as(COMPANION, ONBOARD, &onboard);
    wire.run(20);
}

/// Returns the frames that the vehicle forwarded to a link, in order.
fn forwarded(wire: &Wire, link: LinkId) -> Vec<Vec<u8>> {
    let is_forwarded = |source| ![Address::new(1, 1), CAMERA, GIMBAL].contains(&source);
    let frames = wire.received.iter().filter(|frame| frame.link == link && is_forwarded(frame.source));
    frames.map(|frame| frame.raw.clone()).collect()
}

fn command(target: Address) -> CommandLong {
    CommandLong {
        target_system: target.system.wire(),
        target_component: target.component.wire(),
        command: MavCmd::REQUEST_MESSAGE,
        param1: AutopilotVersion::ID as f32,
        ..CommandLong::default()
    }
}

/// heartbeats and texts are forwarded both ways, byte for byte. They are not sent to the satellite link or back
/// to their sender.
#[test]
fn broadcasts_reach_the_other_link() {
    let mut wire = connected();
    let gcs = Heartbeat { r#type: MavType::GCS, ..Heartbeat::default() };
    let onboard = Heartbeat { r#type: MavType::ONBOARD_CONTROLLER, ..gcs };
    let text = Statustext { text: Text::new("camera ready"), ..Statustext::default() };
    let beat = wire.send_as(TELEMETRY, STATION, &gcs);
    wire.run(20);
    let ours = [wire.send_as(COMPANION, ONBOARD, &onboard), wire.send_as(COMPANION, ONBOARD, &text)];
    wire.run(20);
    assert_eq!(forwarded(&wire, COMPANION), [beat]);
    assert_eq!(forwarded(&wire, TELEMETRY), ours);
    assert!(wire.received.iter().all(|frame| frame.link != SATELLITE));
}

/// a command for the companion is forwarded to its link only, and the answer to the sender's link only. The vehicle
/// handles neither.
#[test]
fn commands_and_answers_are_routed() {
    let mut wire = connected();
    let asked = wire.send_as(TELEMETRY, STATION, &command(ONBOARD));
    wire.run(20);
    assert_eq!(forwarded(&wire, COMPANION), [asked]);
    assert!(wire.take::<CommandAck>().is_empty() && wire.take::<AutopilotVersion>().is_empty());
    let ack = CommandAck {
        command: MavCmd::REQUEST_MESSAGE,
        target_system: STATION.system.wire(),
        target_component: STATION.component.wire(),
        ..CommandAck::default()
    };
    let answered = wire.send_as(COMPANION, ONBOARD, &ack);
    wire.run(20);
    assert_eq!(forwarded(&wire, TELEMETRY), [answered]);
    assert!(wire.received.iter().all(|frame| frame.link != SATELLITE));
    // A command from the companion to the vehicle is answered and not forwarded.
    wire.received.clear();
    wire.send_as(COMPANION, ONBOARD, &command(Address::new(1, 1)));
    wire.run(20);
    assert_eq!((wire.count::<CommandAck>(COMPANION), wire.count::<AutopilotVersion>(COMPANION)), (1, 1));
    assert_eq!(wire.count::<CommandAck>(TELEMETRY), 0);
    assert!(forwarded(&wire, TELEMETRY).is_empty());
}

/// a command for all components of the system is executed and forwarded. A command for an unknown target is neither.
#[test]
fn a_command_for_all_components_is_executed_and_forwarded() {
    let mut wire = connected();
    let asked = wire.send_as(TELEMETRY, STATION, &command(Address::new(1, 0)));
    wire.run(20);
    assert_eq!(forwarded(&wire, COMPANION), [asked]);
    assert_eq!((wire.count::<CommandAck>(TELEMETRY), wire.count::<AutopilotVersion>(TELEMETRY)), (1, 1));
    wire.received.clear();
    for unknown in [Address::new(1, 77), Address::new(9, 1), Address::new(9, 0)] {
        wire.send_as(TELEMETRY, STATION, &command(unknown));
    }
    wire.run(50);
    assert!(forwarded(&wire, COMPANION).is_empty() && wire.take::<CommandAck>().is_empty());
}

/// a message with an unknown id is forwarded unchanged, if its sender is known.
#[test]
fn unknown_messages_are_forwarded_unchanged() {
    let mut wire = connected();
    let known = Heartbeat { r#type: MavType::ONBOARD_CONTROLLER, ..Heartbeat::default() };
    let mut frame = [0; 280];
    let len = encode(&known, Version::V2, ONBOARD, 99, &mut frame).unwrap();
    // Another id: the checksum cannot be verified without its CRC_EXTRA.
    frame[7..10].copy_from_slice(&[0x39, 0x30, 0xAB]);
    wire.send_raw(COMPANION, &frame[..len]);
    // Silence after it confirms the frame. The decoder of the test needs the same.
    wire.run(400);
    assert_eq!(forwarded(&wire, TELEMETRY), [&frame[..len]]);
    assert!(wire.received.iter().all(|frame| frame.link != SATELLITE));
}

/// SETUP_SIGNING and RADIO_STATUS are not forwarded.
#[test]
fn keys_and_radio_status_are_not_forwarded() {
    let mut wire = connected();
    let key = SetupSigning {
        target_system: 1,
        target_component: 191,
        secret_key: mavstack::message::Secret([7; 32]),
        ..SetupSigning::default()
    };
    wire.send_as(TELEMETRY, STATION, &key);
    wire.send_as(TELEMETRY, STATION, &SetupSigning { target_system: 0, target_component: 0, ..key });
    wire.send_as(TELEMETRY, Address::new(51, 68), &RadioStatus { rssi: 200, ..RadioStatus::default() });
    wire.run(50);
    assert!(forwarded(&wire, COMPANION).is_empty());
}

/// a ground station on two links at once does not receive its own broadcasts.
#[test]
fn no_frame_returns_to_its_sender() {
    let mut wire = connected();
    let gcs = Heartbeat { r#type: MavType::GCS, ..Heartbeat::default() };
    wire.send_as(COMPANION, STATION, &gcs);
    wire.run(20);
    wire.received.clear();
    wire.send_as(TELEMETRY, STATION, &gcs);
    wire.run(20);
    assert!(forwarded(&wire, COMPANION).is_empty() && forwarded(&wire, TELEMETRY).is_empty());
}

/// R-13, L-4, L-5: the satellite link carries commands to the companion and their answers, and nothing else from it.
#[test]
fn the_satellite_link_carries_commands_for_the_companion() {
    let mut wire = connected();
    let far = Address::new(250, 190);
    let asked = wire.send_as(SATELLITE, far, &command(ONBOARD));
    wire.run(100);
    assert_eq!(forwarded(&wire, COMPANION), [asked]);
    let ack = CommandAck {
        command: MavCmd::REQUEST_MESSAGE,
        target_system: far.system.wire(),
        target_component: far.component.wire(),
        ..CommandAck::default()
    };
    let answered = wire.send_as(COMPANION, ONBOARD, &ack);
    let set =
        ParamSet { target_system: far.system.wire(), target_component: far.component.wire(), ..ParamSet::default() };
    wire.send_as(COMPANION, ONBOARD, &set);
    wire.send_as(COMPANION, ONBOARD, &Heartbeat::default());
    wire.run(1_000);
    assert_eq!(forwarded(&wire, SATELLITE), [answered]);
    assert!(wire.received.iter().all(|frame| frame.link != SATELLITE || frame.id == CommandAck::ID));
    // Another vehicle's report is forwarded to the ground station.
    let report = wire.send_as(SATELLITE, Address::new(7, 1), &HighLatency2::default());
    wire.run(100);
    assert_eq!(forwarded(&wire, TELEMETRY).last(), Some(&report));
}

/// a companion that floods the vehicle does not delay answers to the ground station. Frames that exceed the capacity of
/// the radio are dropped.
#[test]
fn a_flood_from_the_companion_does_not_delay_answers() {
    let mut wire = connected();
    for round in 0..20 {
        for line in 0..40 {
            let text = Statustext {
                severity: MavSeverity::DEBUG,
                text: Text::new(&format!("{round}.{line}: a line of a log, as long as it may be")),
                ..Statustext::default()
            };
            wire.send_as(COMPANION, ONBOARD, &text);
        }
        let began = wire.millis;
        wire.long(MavCmd::REQUEST_MESSAGE, &[AutopilotVersion::ID as f32]);
        assert!(wire.millis - began <= 40, "round {round}: {} ms", wire.millis - began);
        wire.run(60);
    }
    // The queue holds six frames at a time. Per link 192 frames are remembered for 0.8 s; more are not forwarded.
    let count = forwarded(&wire, TELEMETRY).len();
    assert!((60..800).contains(&count), "{count} of 800");
    wire.received.clear();
    wire.run(3_000);
    assert!(wire.count::<mavstack::dialect::Heartbeat>(TELEMETRY) >= 3);
}
