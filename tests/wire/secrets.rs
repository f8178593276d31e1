//! SEC-15, G-11: keys and passwords are in no `Debug` output of a message, frame, decoder or stack. SETUP_SIGNING is passed to
//! no hook, whether or not the stack signs.

use crate::support::*;
use mavstack::dialect::*;
use mavstack::frame::{Decoder, MAX_FRAME_LEN, Version, encode};
use mavstack::message::{Dialect, Secret};
use mavstack::{Config, Instant, LinkConfig, LinkId, Message, Pulse, Stack, Text};

const KEY: [u8; 32] = *b"0123456789abcdef_ABCDEFGHIJKLMN!";

fn setup() -> SetupSigning {
    SetupSigning { initial_timestamp: 77, target_system: 1, target_component: 1, secret_key: Secret(KEY) }
}

fn frame_of(message: &impl Message) -> Vec<u8> {
    let mut out = [0; MAX_FRAME_LEN];
    let len = encode(message, Version::V2, STATION, 0, &mut out).expect("every message fits");
    out[..len].to_vec()
}

/// Asserts that no secret is in `text`: neither as text, nor as numbers, nor in hexadecimal.
#[track_caller]
fn assert_hidden(text: &str) {
    let text = text.to_lowercase().replace([' ', '\n'], "");
    for shown in ["012345", "abcde", "48,49", "49,50", "65,66", "0x30,0x31", "3031", "4142"] {
        assert!(!text.contains(shown), "{text}");
    }
}

/// A hidden key still compares and encodes correctly.
#[test]
fn key_in_a_message_is_hidden() {
    let text = format!("{:?} {:#?} {:x?}", setup(), setup(), setup());
    assert!(text.contains("initial_timestamp: 77"), "{text}");
    assert_hidden(&text);
    let mut payload = [0; SetupSigning::MAX_LEN];
    assert_eq!(setup().encode(&mut payload), Some(42));
    assert_eq!(payload[10..], KEY);
    assert_eq!(SetupSigning::decode(&payload), setup());
    payload[41] ^= 1;
    assert_ne!(SetupSigning::decode(&payload), setup());
}

#[test]
fn other_secrets_of_common_are_hidden() {
    let secret = "0123456789ABCDEF";
    assert_hidden(&format!("{:?}", AuthKey { key: Secret(Text::new(secret)) }));
    assert_hidden(&format!("{:?}", ChangeOperatorControl { passkey: Secret(Text::new(secret)), ..Default::default() }));
    assert_hidden(&format!("{:?}", WifiConfigAp { password: Secret(Text::new(secret)), ..Default::default() }));
    let pin = Secret(Text::new(secret));
    assert_hidden(&format!("{:?}", CellularConfig { pin, new_pin: pin, puk: pin, ..Default::default() }));
}

/// The key is also hidden in a raw frame, complete or partial.
#[test]
fn key_in_a_frame_is_hidden() {
    let raw = frame_of(&setup());
    for len in 0..=raw.len() {
        let mut decoder = Decoder::default();
        let _ = decoder.push(&raw[..len], Instant::ZERO);
        assert_hidden(&format!("{decoder:?} {decoder:#?}"));
        let mut budget = u32::MAX;
        let frame = decoder.next(Instant::ZERO, Common::MESSAGES, &mut budget, |_| false);
        assert_eq!(frame.is_some(), len == raw.len());
        assert_hidden(&format!("{frame:?} {frame:#?} {frame:x?}"));
    }
    // The same with a dialect that does not know the message.
    let mut decoder = Decoder::default();
    let _ = decoder.push(&raw, Instant::ZERO);
    mavstack::dialect! { struct Little: [Heartbeat]; }
    let late = Instant::from_millis(100);
    let frame = decoder.next(late, Little::MESSAGES, &mut u32::MAX.clone(), |_| true).expect("an unknown id");
    assert!(!frame.is_checked());
    assert_hidden(&format!("{frame:?}"));
}

/// A vehicle without signing drops SETUP_SIGNING and counts it; no hook gets it, it is not answered, and not shown.
#[test]
fn vehicle_without_signing_drops_a_key() {
    let pulse: &'static Pulse = Box::leak(Box::new(Pulse::new()));
    let links = [LinkConfig::uart(115_200); 2];
    let mut stack = Stack::<Tested, 2>::VACANT;
    stack.begin(Config::new(VEHICLE, pulse), links);
    let (mut vehicle, now, link) = (TestVehicle::new(), Instant::from_millis(5_000), LinkId(0));
    for target_system in [0, 1] {
        let raw = frame_of(&SetupSigning { target_system, ..setup() });
        assert_eq!(stack.receive(now, link, &raw, &mut vehicle), raw.len());
        assert_hidden(&format!("{stack:?}"));
    }
    assert_eq!(vehicle.calls, []);
    assert_eq!(stack.link_counters(link).unwrap().out_of_place, 2);
    // Other messages that the stack does not handle are passed to the hook.
    let raw = frame_of(&AuthKey::default());
    stack.receive(now, link, &raw, &mut vehicle);
    assert_eq!(vehicle.calls.len(), 1);
}
