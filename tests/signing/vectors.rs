//! Frames signed by the reference implementation (G-1 to G-3): we produce the same bytes, and every flipped bit is detected.
//! golden/make_signed.py generates golden/signed.txt.

use crate::support::Rng;
use mavstack::dialect::*;
use mavstack::frame::{Decoder, EncodeError, MAX_FRAME_LEN, Version, encode, encode_signed};
use mavstack::message::Dialect;
use mavstack::signing::SigningKey;
use mavstack::{Address, Frame, Instant, Message};

const VECTORS: &str = include_str!("../golden/signed.txt");
/// The source in make_vectors.py.
const SOURCE: Address = Address::new(42, 17);

struct Vector {
    key: [u8; 32],
    link_id: u8,
    timestamp: u64,
    raw: Vec<u8>,
}

fn bytes(hex: &str) -> Vec<u8> {
    (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap()).collect()
}

fn vectors() -> Vec<Vector> {
    let vector = |line: &str| {
        let words: Vec<_> = line.split(' ').collect();
        let [key, link_id, timestamp, raw] = words[..] else { panic!("{line}") };
        let key = bytes(key).try_into().unwrap();
        Vector { key, link_id: link_id.parse().unwrap(), timestamp: timestamp.parse().unwrap(), raw: bytes(raw) }
    };
    VECTORS.lines().map(vector).collect()
}

/// Applies `look` to the frame in these bytes, if there is one.
fn with_frame<T>(raw: &[u8], look: impl FnOnce(&Frame<'_>) -> T) -> Option<T> {
    let mut decoder = Decoder::default();
    assert_eq!(decoder.push(raw, Instant::ZERO), raw.len());
    decoder.next(Instant::ZERO, Common::MESSAGES, &mut u32::MAX.clone(), |_| false).map(|frame| look(&frame))
}

/// Signs the frame's message with our implementation.
fn signed_again(frame: &Frame<'_>, vector: &Vector, out: &mut [u8]) -> Result<usize, EncodeError> {
    fn again<M: Message>(frame: &Frame<'_>, vector: &Vector, out: &mut [u8]) -> Result<usize, EncodeError> {
        let key = SigningKey::new(vector.key);
        let message = M::decode(frame.payload());
        encode_signed(&message, SOURCE, frame.header().seq, &key, vector.link_id, vector.timestamp, out)
    }
    match frame.id() {
        Heartbeat::ID => again::<Heartbeat>(frame, vector, out),
        CommandLong::ID => again::<CommandLong>(frame, vector, out),
        SetupSigning::ID => again::<SetupSigning>(frame, vector, out),
        Statustext::ID => again::<Statustext>(frame, vector, out),
        FileTransferProtocol::ID => again::<FileTransferProtocol>(frame, vector, out),
        Tunnel::ID => again::<Tunnel>(frame, vector, out),
        other => panic!("message {other}"),
    }
}

/// G-1, G-2: our signatures are the reference's.
#[test]
fn we_sign_as_the_reference_does() {
    let vectors = vectors();
    assert_eq!(vectors.len(), 126);
    for vector in &vectors {
        let frame = with_frame(&vector.raw, |frame| {
            let signature = frame.signature().expect("signed");
            assert_eq!((signature.link_id, signature.timestamp), (vector.link_id, vector.timestamp));
            assert!(frame.is_signed_with(&SigningKey::new(vector.key)));
            let mut out = [0; MAX_FRAME_LEN];
            let len = signed_again(frame, vector, &mut out).expect("room");
            out[..len].to_vec()
        });
        assert_eq!(frame.as_ref(), Some(&vector.raw));
    }
}

/// G-2: every bit of the key counts.
#[test]
fn another_key_does_not_verify() {
    for vector in vectors().iter().take(14) {
        for bit in 0..256 {
            let mut key = vector.key;
            key[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(with_frame(&vector.raw, |frame| frame.is_signed_with(&SigningKey::new(key))), Some(false));
        }
    }
}

/// Returns whether the bytes are a frame with a right checksum and a right signature.
fn judged(vector: &Vector, changed: &[u8]) -> bool {
    with_frame(changed, |frame| frame.is_signed_with(&SigningKey::new(vector.key))).unwrap_or(false)
}

/// Recomputes the checksum.
fn with_checksum(raw: &mut [u8]) {
    let end = usize::from(raw[1]) + 10;
    if end + 2 <= raw.len() {
        let id = u32::from_le_bytes([raw[7], raw[8], raw[9], 0]);
        let extra = Common::MESSAGES.get(id).map_or(0, |info| info.crc_extra());
        let mut crc = crc_any::CRCu16::crc16mcrf4cc();
        crc.digest(&raw[1..end]);
        crc.digest(&[extra]);
        raw[end..end + 2].copy_from_slice(&crc.get_crc().to_le_bytes());
    }
}

/// G-2, G-10: every flipped bit is detected, with the checksum recomputed and without.
#[test]
fn every_flipped_bit_is_detected() {
    for vector in vectors().iter().take(14) {
        for bit in 0..8 * vector.raw.len() {
            let mut changed = vector.raw.clone();
            changed[bit / 8] ^= 1 << (bit % 8);
            assert!(!judged(vector, &changed), "bit {bit}");
            with_checksum(&mut changed);
            assert!(!judged(vector, &changed) || changed == vector.raw, "bit {bit}, right checksum");
        }
    }
}

/// G-7, G-10: randomly changed frames, most of them with a recomputed checksum.
fn mutate(count: u32, seed: u64) {
    let (vectors, mut rng) = (vectors(), Rng::new(seed));
    let mut were_frames = 0;
    for _ in 0..count {
        let vector = &vectors[rng.below(vectors.len() as u64) as usize];
        let mut changed = vector.raw.clone();
        for _ in 0..=rng.below(4) {
            let at = rng.below(changed.len() as u64) as usize;
            match rng.below(8) {
                // A part of another frame with the same key, as a recorder has them.
                0 => {
                    let other = &vectors[rng.below(vectors.len() as u64) as usize].raw;
                    let len = (rng.below(14) as usize).min(other.len()).min(changed.len());
                    let end = changed.len();
                    changed[end - len..].copy_from_slice(&other[other.len() - len..]);
                }
                1 => changed[at] = rng.byte(),
                _ => changed[at] ^= 1 << rng.below(8),
            }
        }
        if rng.below(8) > 0 {
            with_checksum(&mut changed);
        }
        let judged = with_frame(&changed, |frame| frame.is_signed_with(&SigningKey::new(vector.key)));
        were_frames += u32::from(judged.is_some());
        assert!(judged != Some(true) || vectors.iter().any(|vector| vector.raw == changed), "{changed:02x?}");
    }
    assert!(were_frames > count / 2, "{were_frames} of {count} were frames");
}

#[test]
fn changed_frames_do_not_verify() {
    mutate(100_000, 1);
}

#[test]
#[ignore = "minutes: for a release build"]
fn ten_million_changed_frames_do_not_verify() {
    mutate(10_000_000, 2);
}

/// A frame without the flag has no signature, whatever bytes follow it.
#[test]
fn unsigned_frame_has_no_signature() {
    let mut out = [0; MAX_FRAME_LEN];
    for version in [Version::V1, Version::V2] {
        let len = encode(&Heartbeat::default(), version, SOURCE, 0, &mut out).unwrap();
        let signed = with_frame(&out[..len], |frame| frame.is_signed_with(&SigningKey::new([0; 32])));
        assert_eq!(signed, Some(false));
    }
}

#[test]
fn short_buffer_is_an_error() {
    let key = SigningKey::new([1; 32]);
    for len in 0..60 {
        let mut out = vec![0; len];
        let result = encode_signed(&Heartbeat::default(), SOURCE, 0, &key, 0, 1, &mut out);
        // 10 bytes of header, 9 of payload truncated to 1, 2 of checksum, 13 of signature.
        assert_eq!(result.is_ok(), len >= 26, "{len}: {result:?}");
    }
}

/// SEC-15: `Debug` does not show a key.
#[test]
fn key_is_not_in_debug_output() {
    assert_eq!(format!("{:?}", SigningKey::new([0xAB; 32])), "SigningKey");
}
