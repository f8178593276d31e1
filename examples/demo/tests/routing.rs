//! The vehicle between a ground station on the radio and a companion computer of its own system: who hears what.

#[path = "support/wire.rs"]
mod wire;

use mavstack::dialect::*;
use mavstack::{Address, LinkId, Message, Text, Version, encode};
use mavstack_demo::{COMPANION, SATELLITE, TELEMETRY};
use wire::{STATION, Wire};

/// The companion computer.
const ONBOARD: Address = Address::new(1, 191);

/// With a GPS fix; the ground station on the radio and the companion have beaten once.
fn joined() -> Wire {
    let mut wire = Wire::switched_on();
    beat(&mut wire);
    wire.received.clear();
    wire
}

fn beat(wire: &mut Wire) {
    let gcs = Heartbeat { r#type: MavType::GCS, autopilot: MavAutopilot::INVALID, ..Heartbeat::default() };
    let onboard = Heartbeat { r#type: MavType::ONBOARD_CONTROLLER, ..gcs };
    wire.send_as(TELEMETRY, STATION, &gcs);
    wire.send_as(COMPANION, ONBOARD, &onboard);
    wire.run(20);
}

/// The frames of others that came by a link, in their order.
fn heard(wire: &Wire, link: LinkId) -> Vec<Vec<u8>> {
    let is_theirs = |source| source != Address::new(1, 1);
    let frames = wire.received.iter().filter(|frame| frame.link == link && is_theirs(frame.source));
    frames.map(|frame| frame.raw.clone()).collect()
}

fn command(target: Address) -> CommandLong {
    CommandLong {
        target_system: target.system.0,
        target_component: target.component.0,
        command: MavCmd::REQUEST_MESSAGE,
        param1: AutopilotVersion::ID as f32,
        ..CommandLong::default()
    }
}

/// heartbeats and texts both ways, to the byte; nothing of it on the satellite link, and not back.
#[test]
fn broadcasts_reach_the_other_side() {
    let mut wire = joined();
    let gcs = Heartbeat { r#type: MavType::GCS, ..Heartbeat::default() };
    let onboard = Heartbeat { r#type: MavType::ONBOARD_CONTROLLER, ..gcs };
    let text = Statustext { text: Text::new("camera ready"), ..Statustext::default() };
    let beat = wire.send_as(TELEMETRY, STATION, &gcs);
    wire.run(20);
    let ours = [wire.send_as(COMPANION, ONBOARD, &onboard), wire.send_as(COMPANION, ONBOARD, &text)];
    wire.run(20);
    assert_eq!(heard(&wire, COMPANION), [beat]);
    assert_eq!(heard(&wire, TELEMETRY), ours);
    assert!(wire.received.iter().all(|frame| frame.link != SATELLITE));
}

/// a command for the companion goes to it alone, and its answer to who asked; neither is the vehicle's business.
#[test]
fn commands_and_answers_find_their_way() {
    let mut wire = joined();
    let asked = wire.send_as(TELEMETRY, STATION, &command(ONBOARD));
    wire.run(20);
    assert_eq!(heard(&wire, COMPANION), [asked]);
    assert!(wire.take::<CommandAck>().is_empty() && wire.take::<AutopilotVersion>().is_empty());
    let ack = CommandAck {
        command: MavCmd::REQUEST_MESSAGE,
        target_system: STATION.system.0,
        target_component: STATION.component.0,
        ..CommandAck::default()
    };
    let answered = wire.send_as(COMPANION, ONBOARD, &ack);
    wire.run(20);
    assert_eq!(heard(&wire, TELEMETRY), [answered]);
    assert!(wire.received.iter().all(|frame| frame.link != SATELLITE));
    // The other way round, for the vehicle itself: that is answered, and goes nowhere.
    wire.received.clear();
    wire.send_as(COMPANION, ONBOARD, &command(Address::new(1, 1)));
    wire.run(20);
    assert_eq!((wire.count::<CommandAck>(COMPANION), wire.count::<AutopilotVersion>(COMPANION)), (1, 1));
    assert_eq!(wire.count::<CommandAck>(TELEMETRY), 0);
    assert!(heard(&wire, TELEMETRY).is_empty());
}

/// what is for all components of the vehicle's system is done, and goes on; what is for a stranger is neither.
#[test]
fn all_components_are_the_vehicle_and_the_companion() {
    let mut wire = joined();
    let asked = wire.send_as(TELEMETRY, STATION, &command(Address::new(1, 0)));
    wire.run(20);
    assert_eq!(heard(&wire, COMPANION), [asked]);
    assert_eq!((wire.count::<CommandAck>(TELEMETRY), wire.count::<AutopilotVersion>(TELEMETRY)), (1, 1));
    wire.received.clear();
    for nobody in [Address::new(1, 77), Address::new(9, 1), Address::new(9, 0)] {
        wire.send_as(TELEMETRY, STATION, &command(nobody));
    }
    wire.run(50);
    assert!(heard(&wire, COMPANION).is_empty() && wire.take::<CommandAck>().is_empty());
}

/// a message that nobody here knows goes on as it came, from those who were heard before.
#[test]
fn unknown_messages_go_on_as_they_came() {
    let mut wire = joined();
    let known = Heartbeat { r#type: MavType::ONBOARD_CONTROLLER, ..Heartbeat::default() };
    let mut frame = [0; 280];
    let len = encode(&known, Version::V2, ONBOARD, 99, &mut frame).unwrap();
    // Another id: then the checksum is wrong for all that we know.
    frame[7..10].copy_from_slice(&[0x39, 0x30, 0xAB]);
    wire.send_raw(COMPANION, &frame[..len]);
    // Silence behind it says that it is one; on the other line that is what comes next.
    wire.run(400);
    assert_eq!(heard(&wire, TELEMETRY), [&frame[..len]]);
    assert!(wire.received.iter().all(|frame| frame.link != SATELLITE));
}

/// keys and the state of a radio stay where they are.
#[test]
fn keys_and_radio_states_stay_on_their_link() {
    let mut wire = joined();
    let key = SetupSigning {
        target_system: 1,
        target_component: 191,
        secret_key: mavstack::Secret([7; 32]),
        ..SetupSigning::default()
    };
    wire.send_as(TELEMETRY, STATION, &key);
    wire.send_as(TELEMETRY, STATION, &SetupSigning { target_system: 0, target_component: 0, ..key });
    wire.send_as(TELEMETRY, Address::new(51, 68), &RadioStatus { rssi: 200, ..RadioStatus::default() });
    wire.run(50);
    assert!(heard(&wire, COMPANION).is_empty());
}

/// a ground station that is on the radio and on the companion's network at once hears nothing of itself.
#[test]
fn nobody_hears_himself() {
    let mut wire = joined();
    let gcs = Heartbeat { r#type: MavType::GCS, ..Heartbeat::default() };
    wire.send_as(COMPANION, STATION, &gcs);
    wire.run(20);
    wire.received.clear();
    wire.send_as(TELEMETRY, STATION, &gcs);
    wire.run(20);
    assert!(heard(&wire, COMPANION).is_empty() && heard(&wire, TELEMETRY).is_empty());
}

/// R-13, L-4, L-5: over the satellite a companion is commanded, and answers; nothing else of it goes there.
#[test]
fn commands_for_the_companion_come_by_satellite_too() {
    let mut wire = joined();
    let far = Address::new(250, 190);
    let asked = wire.send_as(SATELLITE, far, &command(ONBOARD));
    wire.run(100);
    assert_eq!(heard(&wire, COMPANION), [asked]);
    let ack = CommandAck {
        command: MavCmd::REQUEST_MESSAGE,
        target_system: far.system.0,
        target_component: far.component.0,
        ..CommandAck::default()
    };
    let answered = wire.send_as(COMPANION, ONBOARD, &ack);
    let set = ParamSet { target_system: far.system.0, target_component: far.component.0, ..ParamSet::default() };
    wire.send_as(COMPANION, ONBOARD, &set);
    wire.send_as(COMPANION, ONBOARD, &Heartbeat::default());
    wire.run(1_000);
    assert_eq!(heard(&wire, SATELLITE), [answered]);
    assert!(wire.received.iter().all(|frame| frame.link != SATELLITE || frame.id == CommandAck::ID));
    // Another vehicle's report goes on to where the ground station is.
    let report = wire.send_as(SATELLITE, Address::new(7, 1), &HighLatency2::default());
    wire.run(100);
    assert_eq!(heard(&wire, TELEMETRY).last(), Some(&report));
}

/// a companion that talks without end takes no answer from the ground station, and hears its own; what the radio
/// cannot carry is dropped.
#[test]
fn a_companion_that_talks_without_end_is_no_harm() {
    let mut wire = joined();
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
    // At once the queue holds six; and in 0.8 s one link has 192 of its frames remembered, the others are not forwarded.
    let heard = heard(&wire, TELEMETRY).len();
    assert!((60..800).contains(&heard), "{heard} of 800");
    wire.received.clear();
    wire.run(3_000);
    assert!(wire.count::<mavstack::dialect::Heartbeat>(TELEMETRY) >= 3);
}
