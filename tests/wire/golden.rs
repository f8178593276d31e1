//! Frames that the reference implementation encoded: decoding and encoding them again gives the same bytes.
//! `golden/make_vectors.py` generates golden/common.bin and golden/unknown.bin.

use crate::all::{self, Declared, Visit};
use mavstack::dialect::Common;
use mavstack::frame::{Decoder, MAX_FRAME_LEN, Version, encode};
use mavstack::message::Dialect;
use mavstack::{Address, Instant, Message};
use std::{collections::BTreeMap, fmt::Debug};

const STREAM: &[u8] = include_bytes!("../golden/common.bin");
const UNKNOWN: &[u8] = include_bytes!("../golden/unknown.bin");
/// The source in make_vectors.py.
const SOURCE: Address = Address::new(42, 17);

/// One frame of the stream.
struct Golden {
    version: Version,
    seq: u8,
    payload: Vec<u8>,
    raw: Vec<u8>,
}

/// Returns the frames by message id, in order, and the total number.
fn golden(stream: &[u8]) -> (BTreeMap<u32, Vec<Golden>>, usize) {
    let mut decoder = Decoder::default();
    let (mut frames, mut count): (BTreeMap<u32, Vec<Golden>>, usize) = Default::default();
    let mut rest = stream;
    while !rest.is_empty() {
        rest = &rest[decoder.push(rest, Instant::ZERO)..];
        while let Some(frame) = decoder.next(Instant::ZERO, Common::MESSAGES, &mut u32::MAX.clone(), |_| false) {
            let header = frame.header();
            assert_eq!((frame.source(), header.seq), (SOURCE, count as u8), "a frame was lost before number {count}");
            count += 1;
            frames.entry(frame.id()).or_default().push(Golden {
                version: header.version,
                seq: header.seq,
                payload: frame.payload().to_vec(),
                raw: frame.raw().to_vec(),
            });
        }
    }
    let raw: usize = frames.values().flatten().map(|frame| frame.raw.len()).sum();
    assert_eq!(raw, stream.len(), "every byte belongs to a frame");
    (frames, count)
}

struct RoundTrip {
    golden: BTreeMap<u32, Vec<Golden>>,
}

impl Visit for RoundTrip {
    fn visit<M: Message + Declared + Debug + Default + PartialEq>(&mut self) {
        let name = M::NAME;
        let frames = self.golden.remove(&M::ID).unwrap_or_else(|| panic!("no frame of {name}: run make_vectors.py"));
        let expected = if M::ID <= 255 { 6 } else { 3 };
        assert_eq!(frames.len(), expected, "frames of {name}");
        for frame in &frames {
            let message = M::decode(&frame.payload);
            let mut out = [0; MAX_FRAME_LEN];
            let len = encode(&message, frame.version, SOURCE, frame.seq, &mut out).expect("a frame has room");
            assert_eq!(out[..len], frame.raw, "{name}, number {}: {message:?}", frame.seq);
        }
        assert_eq!(M::decode(&frames[0].payload), M::default(), "{name}: zeros are the default");
        assert_eq!(frames[0].payload, [0], "{name}: zeros are trimmed to one byte");
        assert_eq!(frames[2].payload, vec![0xFF; M::MAX_LEN], "{name}: all bits set");
        if let [_, _, _, zeros, _, ones] = &frames[..] {
            assert_eq!(zeros.payload, vec![0; M::BASE_LEN], "{name}: v1 is not trimmed");
            assert_eq!(ones.payload, vec![0xFF; M::BASE_LEN], "{name}: v1 has no extensions");
        }
    }
}

#[test]
fn frames_of_the_reference_round_trip_byte_for_byte() {
    let (golden, count) = golden(STREAM);
    let mut visitor = RoundTrip { golden };
    all::each(&mut visitor);
    assert!(visitor.golden.is_empty(), "frames of no message: {:?}", visitor.golden.keys());
    assert_eq!(count, 1_131, "3 for each of 235 messages in v2, 3 for each of 142 in v1");
}

struct Unknown {
    golden: BTreeMap<u32, Vec<Golden>>,
    differ: usize,
}

impl Visit for Unknown {
    fn visit<M: Message + Declared + Debug + Default + PartialEq>(&mut self) {
        let name = M::NAME;
        let frames = self.golden.remove(&M::ID).unwrap_or_else(|| panic!("no frame of {name}: run make_vectors.py"));
        let [frame] = &frames[..] else { panic!("one frame of {name}") };
        let mut out = [0; MAX_FRAME_LEN];
        let len = encode(&M::unknown(), frame.version, SOURCE, frame.seq, &mut out).expect("a frame has room");
        assert_eq!(out[..len], frame.raw, "{name}: {:?}", M::unknown());
        self.differ += usize::from(M::unknown() != M::default());
    }
}

/// `UNKNOWN` has the values of the definitions' `invalid` attributes in every field of every message. An independent parser of
/// the definitions produced the expected frames.
#[test]
fn unknown_has_the_invalid_values_of_the_definitions() {
    let (golden, count) = golden(UNKNOWN);
    let mut visitor = Unknown { golden, differ: 0 };
    all::each(&mut visitor);
    assert!(visitor.golden.is_empty(), "frames of no message: {:?}", visitor.golden.keys());
    assert_eq!((count, visitor.differ), (235, 71), "messages, and those with a value that is not zero");
}
