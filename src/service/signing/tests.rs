//! What no frame shows: the edges of times, when something is to be stored, and that keys do not stay in a buffer.

#![cfg(feature = "storage")]

use super::*;
use crate::dialect::Common;
use crate::frame::{Decoder, encode};
use crate::message::Dialect;
use crate::{Address, Secret};

const KEY: [u8; 32] = [7; 32];
const NOW: Instant = Instant::from_millis(1_000);
/// A time in 2025.
const TIME: u64 = 33_000_000_000_000;

/// As it is when storage has what it needs.
fn stored(key: Option<[u8; 32]>) -> SigningMemory<2> {
    let mut signing = SigningMemory::new();
    signing.restore(NOW, key.map(SigningKey::new), TIME);
    assert!(signing.unsaved(NOW).is_some(), "the time, for the next start");
    signing.saved();
    assert_eq!(signing.unsaved(NOW), None);
    signing
}

/// G-13: a key that is set, and one that is taken away, is to be stored at once.
#[test]
fn another_key_is_stored_at_once() {
    let mut signing = stored(Some(KEY));
    signing.clear_key();
    assert!(signing.unsaved(NOW).is_some() && signing.content().0.is_none());
    let mut signing = stored(None);
    signing.set_key(NOW, SigningKey::new(KEY), 0);
    assert!(signing.unsaved(NOW).is_some() && signing.content().0.is_some());
}

/// G-15: what could not be written is tried again after ten seconds.
#[test]
fn storage_that_failed_is_left_alone_for_ten_seconds() {
    let mut signing = stored(Some(KEY));
    signing.clear_key();
    signing.not_saved(NOW);
    let again = NOW.after(Duration::from_secs(10));
    assert_eq!(signing.unsaved(Instant::from_micros(again.as_micros() - 1)), None);
    assert!(signing.unsaved(again).is_some());
}

/// G-3, G-14: the last timestamp of 48 bits is one, in 2104; what comes after it is refused.
#[test]
fn time_has_an_end() {
    let last = (MAX_TIMESTAMP + EPOCH * 100_000) * 10;
    let mut signing = SigningMemory::<1>::new();
    assert!(!signing.set_time(Instant::ZERO, last + 10, Duration::MAX));
    assert_eq!(signing.timestamp(Instant::ZERO), 0);
    assert!(signing.set_time(Instant::ZERO, last, Duration::MAX));
    assert_eq!(signing.timestamp(NOW), MAX_TIMESTAMP);
    assert_eq!(signing.counters().refused_times, 1);
}

/// SEC-2: a signature costs by the blocks of SHA-256 in it: 32 bytes of key, the frame without its last 6, and 9 of padding.
#[test]
fn a_signature_costs_by_its_blocks() {
    for blocks in 1..6 {
        let full = 64 * blocks - 32 - 9 + 6;
        assert_eq!([full, full + 1].map(signature_cost), [blocks, blocks + 1].map(|blocks| 150 * blocks as u32));
    }
}

/// SEC-15: a key that came in a frame is overwritten where it was received.
#[test]
fn a_received_key_is_wiped() {
    let mut bytes = [0; 64];
    let setup = SetupSigning { secret_key: Secret(KEY), ..SetupSigning::default() };
    let len = encode(&setup, Version::V2, Address::new(255, 190), 0, &mut bytes).expect("fits");
    let mut decoder = Decoder::default();
    assert_eq!(decoder.push(&bytes[..len], NOW), len);
    assert!(decoder.next(NOW, Common::MESSAGES, &mut u32::MAX.clone(), |_| false).is_some());
    decoder.wipe();
    assert!(decoder.spare().iter().all(|byte| *byte == 0));
}
