//! Tests that need more than frames: the limits of times, when something is stored, and that keys do not stay in a
//! buffer.

#![cfg(feature = "storage")]

use super::timestamp::{EPOCH, MINUTE};
use super::*;
use crate::__private::SigningStreams;
use crate::Address;
use crate::dialect::{Common, SetupSigning};
use crate::frame::{Decoder, MAX_TIMESTAMP, Version, encode, signature_cost};
use crate::message::Dialect;
use crate::message::Secret;

const KEY: [u8; 32] = [7; 32];
const NOW: Instant = Instant::from_millis(1_000);
/// A time in 2025.
const TIME: u64 = 33_000_000_000_000;

/// Returns the state after everything was stored.
fn stored(key: Option<[u8; 32]>) -> SigningStreams<2> {
    let mut signing = SigningStreams::new();
    signing.restore(NOW, key.map(SigningKey::new), TIME);
    assert_eq!(signing.pending_write(NOW).is_some(), key.is_some(), "the time, for the next start");
    signing.on_saved(NOW);
    assert_eq!(signing.pending_write(NOW), None);
    signing
}

/// G-13: setting or removing a key stores it at once.
#[test]
fn a_changed_key_is_stored_at_once() {
    let mut signing = stored(Some(KEY));
    signing.clear_key();
    assert!(signing.pending_write(NOW).is_some() && signing.content().0.is_none());
    let mut signing = stored(None);
    signing.set_key(NOW, SigningKey::new(KEY), 0);
    assert!(signing.pending_write(NOW).is_some() && signing.content().0.is_some());
}

/// G-15: a failed write is tried again after ten seconds.
#[test]
fn a_failed_write_is_retried_after_ten_seconds() {
    let mut signing = stored(Some(KEY));
    signing.clear_key();
    signing.on_save_failed(NOW);
    let again = NOW + Duration::from_secs(10);
    assert_eq!(signing.pending_write(Instant::from_micros(again.as_micros() - 1)), None);
    assert!(signing.pending_write(again).is_some());
}

/// G-3, G-14, G-17: the last 48-bit timestamp, in 2104, has no successor and is refused; the one before is accepted.
#[test]
fn the_last_timestamp_is_refused() {
    let last = (MAX_TIMESTAMP + EPOCH * 100_000) * 10;
    let mut signing = SigningStreams::<1>::new();
    for late in [last, last + 10, u64::MAX] {
        assert!(!signing.set_time(Instant::ZERO, late, Duration::MAX));
    }
    assert_eq!(signing.timestamp(Instant::ZERO), 0);
    assert!(signing.set_time(Instant::ZERO, last - 10, Duration::MAX));
    assert_eq!((signing.timestamp(Instant::ZERO), signing.timestamp(NOW)), (MAX_TIMESTAMP - 1, MAX_TIMESTAMP));
    assert_eq!(signing.counters().refused_times, 3);
}

/// G-4, G-15, G-17: an older version may have used a stored time at the end up to the last timestamp, so nothing is
/// signed with it again. Another key starts with its own time.
#[test]
fn a_stored_time_at_the_end_is_not_used_again() {
    for stored in [MAX_TIMESTAMP + 1, MAX_TIMESTAMP + MINUTE, u64::MAX] {
        let mut signing = SigningStreams::<1>::new();
        signing.restore(NOW, Some(SigningKey::new(KEY)), stored);
        assert_eq!((signing.timestamp(NOW), signing.take_timestamp(NOW)), (MAX_TIMESTAMP, None));
        signing.set_key(NOW, SigningKey::new(KEY), TIME);
        assert_eq!(signing.take_timestamp(NOW), None, "the same key");
        signing.set_key(NOW, SigningKey::new([8; 32]), TIME);
        assert_eq!((signing.take_timestamp(NOW), signing.take_timestamp(NOW)), (Some(TIME), Some(TIME + 1)));
        assert!(signing.pending_write(NOW).is_some());
        assert_eq!(signing.content().1, TIME + 1 + MINUTE, "stored a minute ahead");
    }
}

/// G-17: our time starts with the timestamp of another key, even when that is less than the clock; a clock that reads
/// less afterwards causes no fault.
#[test]
fn another_key_may_start_with_an_early_time() {
    let mut signing = SigningStreams::<1>::new();
    let hour = Instant::from_millis(3_600_000);
    signing.set_key(hour, SigningKey::new(KEY), 5);
    assert_eq!(signing.timestamp(hour), 5);
    assert_eq!(signing.timestamp(hour + Duration::from_millis(1)), 105);
    assert_eq!(signing.timestamp(NOW), 0);
}

/// SEC-2: a signature costs by the blocks of SHA-256 in it: 32 bytes of key, the frame without its last 6, and 9 of
/// padding.
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
