//! Streams of frames, split and damaged in every way: rules S-12, S-13, S-20, R-9, SEC-1, SEC-2, SEC-5. Single frames are in
//! `single_frame.rs`.

use crate::support::damage::{Damage, damage};
use crate::support::reference::{self, Found};
use crate::support::{Receiver, Rng, cases, decode, millis, stream};
use mavstack::dialect::*;
use mavstack::frame::{Decoder, MAX_FRAME_LEN, Version, encode};
use mavstack::message::{Dialect, MessageTable};
use mavstack::{Address, Instant, Message};
use proptest::{collection::vec, prelude::*};

const TABLE: MessageTable = Common::MESSAGES;
/// An id that common does not have.
const UNKNOWN: u32 = 0x00AB_CDEF;
/// This many bytes after a stream complete or reject every candidate in it.
const FILLER: [u8; 300] = [0; 300];
/// A sender that was heard before.
const KNOWN: Address = Address::new(2, 1);

fn frame<M: Message>(message: &M, version: Version) -> Vec<u8> {
    let mut out = [0; MAX_FRAME_LEN];
    let len = encode(message, version, Address::new(42, 17), 7, &mut out).expect("fits");
    out[..len].to_vec()
}

fn heartbeat() -> Vec<u8> {
    frame(&Heartbeat { mavlink_version: 3, ..Heartbeat::default() }, Version::V2)
}

fn arm() -> Vec<u8> {
    frame(&CommandLong { command: MavCmd::COMPONENT_ARM_DISARM, param1: 1.0, ..CommandLong::default() }, Version::V1)
}

/// S-20: three frames, split into three pieces at every two places.
#[test]
fn every_split_of_three_frames_is_decoded() {
    let mut signed = reference::v2(0, [1, 0], [42, 17], &[1, 2, 3, 4, 5, 6, 7, 8, 9], 50);
    signed.extend(1..=13);
    let frames = [signed, arm(), heartbeat()];
    let stream = frames.concat();
    let expected: Vec<Found> = frames.iter().map(|frame| (frame.clone(), true)).collect();
    for first in 0..=stream.len() {
        for second in first..=stream.len() {
            let mut receiver = Receiver::default();
            for piece in [&stream[..first], &stream[first..second], &stream[second..]] {
                receiver.receive(piece);
            }
            assert_eq!(receiver.found, expected, "split at {first} and {second}");
        }
    }
}

/// Reads `bytes` into the decoder's own buffer.
fn read_into(receiver: &mut Receiver, bytes: &[u8]) {
    let mut rest = bytes;
    while !rest.is_empty() {
        let room = receiver.decoder.spare();
        let (now, behind) = rest.split_at(rest.len().min(room.len()));
        assert!(!now.is_empty(), "no frame is pending, and there is no room");
        room[..now.len()].copy_from_slice(now);
        receiver.decoder.filled(now.len(), receiver.now);
        receiver.drain();
        rest = behind;
    }
}

/// A packet transport delivers each packet once: while nothing is pending, there is room for the longest frame, whatever came
/// before.
#[test]
fn packet_of_any_length_has_room() {
    let mut receiver = Receiver::default();
    for _ in 0..40 {
        let room = receiver.decoder.spare();
        assert!(room.len() >= MAX_FRAME_LEN, "{}", room.len());
        let frame = heartbeat();
        room[..frame.len()].copy_from_slice(&frame);
        receiver.decoder.filled(frame.len(), receiver.now);
        receiver.drain();
    }
    assert_eq!(receiver.found.len(), 40);
}

/// A random stream: known and unknown messages, whole and damaged, nested frames, and noise with many start bytes.
fn any_stream() -> impl Strategy<Value = Vec<u8>> {
    let id = prop_oneof![Just(0), Just(76), Just(253), Just(110), Just(UNKNOWN), Just(200), 0u32..512];
    let payload = prop_oneof![vec(any::<u8>(), 0..40), Just(heartbeat()), vec(any::<u8>(), 200..256)];
    let extra = |id| TABLE.get(id).map_or(0, |row| row.crc_extra());
    let flags = prop_oneof![8 => Just(0u8), 1 => Just(1), 1 => any::<u8>()];
    let v2 = (id, payload.clone(), flags, 0u8..4).prop_map(move |(id, payload, flags, system)| {
        let mut frame = reference::v2(id, [flags, 0], [system, 1], &payload, extra(id));
        frame.extend(vec![0xFD; if flags & 1 == 0 { 0 } else { 13 }]);
        frame
    });
    let v1 = (prop_oneof![any::<u8>(), Just(44), Just(253)], 0u8..6, payload).prop_map(move |(id, more, payload)| {
        let row = TABLE.get(u32::from(id));
        // With some of its extensions, and sometimes one byte too many.
        let len = row.map_or(payload.len(), |row| {
            usize::from(row.base_len())
                + usize::from(more).min(usize::from(row.max_len() - row.base_len()) + usize::from(more / 5))
        });
        let payload: Vec<u8> = payload.into_iter().cycle().chain([7]).take(len).collect();
        reference::v1(id, [1, 1], &payload, extra(u32::from(id)))
    });
    let noise = vec(prop_oneof![3 => any::<u8>(), 1 => Just(0xFD), 1 => Just(0xFE), 2 => 0u8..3], 0..30);
    let part = prop_oneof![4 => v2, 2 => v1, 2 => noise];
    let damage = (any::<prop::sample::Index>(), any::<u8>(), 0u8..4);
    let damaged = (part, damage).prop_map(|(mut part, (at, byte, how))| {
        match how {
            0 if !part.is_empty() => {
                let at = at.index(part.len());
                part[at] = byte;
            }
            1 => part.truncate(at.index(part.len() + 1)),
            _ => {}
        }
        part
    });
    vec(damaged, 0..12).prop_map(|parts| parts.concat())
}

proptest! {
    #![proptest_config(cases(256))]

    /// The decoder finds the same frames as the reference decoder.
    #[test]
    fn decoder_equals_the_reference(stream in any_stream()) {
        let stream = [&stream[..], &FILLER].concat();
        let mut receiver = Receiver { known: vec![KNOWN], ..Receiver::default() };
        receiver.receive(&stream);
        prop_assert_eq!(receiver.found, reference::decode(&stream, TABLE, |source| source == [2, 1]));
    }

    /// S-20: frames and counters are the same, however the bytes are split and passed in.
    #[test]
    fn output_does_not_depend_on_chunking(stream in any_stream(), cuts in vec(1usize..300, 1..50)) {
        let mut whole = Receiver { known: vec![KNOWN], ..Receiver::default() };
        whole.receive(&stream);
        let mut cut = Receiver { known: vec![KNOWN], ..Receiver::default() };
        let mut bytewise = Receiver { known: vec![KNOWN], ..Receiver::default() };
        let mut direct = Receiver { known: vec![KNOWN], ..Receiver::default() };
        let mut rest = &stream[..];
        for len in cuts.into_iter().cycle() {
            let (piece, behind) = rest.split_at(len.min(rest.len()));
            cut.receive(piece);
            read_into(&mut direct, piece);
            rest = behind;
            if rest.is_empty() {
                break;
            }
        }
        stream.iter().for_each(|byte| bytewise.receive(&[*byte]));
        prop_assert_eq!(&cut.found, &whole.found);
        prop_assert_eq!(&bytewise.found, &whole.found);
        prop_assert_eq!(&direct.found, &whole.found);
        prop_assert_eq!(cut.decoder.counters(), whole.decoder.counters());
        prop_assert_eq!(bytewise.decoder.counters(), whole.decoder.counters());
        prop_assert_eq!(direct.decoder.counters(), whole.decoder.counters());
    }

    /// SEC-2: a scan that exhausts its budget resumes where it stopped, and finds the same.
    #[test]
    fn budget_delays_and_changes_nothing(stream in any_stream(), more in 0u32..600) {
        let mut free = Receiver { known: vec![KNOWN], ..Receiver::default() };
        free.receive(&stream);
        let budget = Some(Decoder::MIN_BUDGET + more);
        let mut bounded = Receiver { known: vec![KNOWN], budget, ..Receiver::default() };
        bounded.receive(&stream);
        prop_assert_eq!(bounded.found, free.found);
        prop_assert_eq!(bounded.decoder.counters(), free.decoder.counters());
    }

    /// SEC-5: whatever is in the payload of a valid frame, only the frame is found.
    #[test]
    fn payload_is_not_scanned(inner in vec(any_stream(), 1..4)) {
        let frames: Vec<Vec<u8>> = inner
            .iter()
            .map(|inner| reference::v2(FileTransferProtocol::ID, [0, 0], [9, 9], &inner[..inner.len().min(255)], 84))
            .collect();
        let expected: Vec<Found> = frames.iter().map(|frame| (frame.clone(), true)).collect();
        prop_assert_eq!(decode(&frames.concat()), expected);
    }

    /// SEC-1, S-13: noise neither panics nor hides the next frame.
    #[test]
    fn noise_does_not_hide_the_next_frame(noise in vec(any::<u8>(), 0..2_000)) {
        let found = decode(&[&noise[..], &[0; 300], &heartbeat()].concat());
        prop_assert_eq!(found.last(), Some(&(heartbeat(), true)));
    }
}

/// SEC-2: every third byte starts a frame that fails late. Each call keeps to its budget and makes progress, and the frame at
/// the end is found.
#[test]
fn nested_false_headers_do_not_stall_the_decoder() {
    // Nested headers of a message of 255 bytes: nearly every start byte costs a checksum over 265 bytes.
    let nest = [0xFD, 0xFD, 0x00].repeat(2_000);
    let evil: Vec<u8> = nest.iter().enumerate().map(|(i, &byte)| if i % 97 == 0 { 0xFE } else { byte }).collect();
    let stream = [&evil[..], &FILLER, &heartbeat()].concat();
    let mut decoder = Decoder::default();
    let (mut calls, mut rest) = (0, &stream[..]);
    let now = Instant::ZERO;
    loop {
        rest = &rest[decoder.push(rest, now)..];
        let mut budget = Decoder::MIN_BUDGET;
        if let Some(frame) = decoder.next(now, TABLE, &mut budget, |_| true).filter(|frame| frame.is_checked()) {
            assert_eq!(frame.raw(), heartbeat());
            break;
        }
        calls += 1;
        assert!(calls < stream.len(), "each call advances by at least a byte");
    }
}

/// SEC-2: a checksum that exceeds the budget is not started. A header costs 17, and each byte 1.
#[test]
fn budget_is_kept() {
    // One header, and the checksum over CRC_EXTRA and all bytes but the start byte and the checksum itself.
    let cost = 17 + 1 + heartbeat().len() as u32 - 3;
    for budget in 0..cost + 10 {
        let mut decoder = Decoder::default();
        let _ = decoder.push(&heartbeat(), Instant::ZERO);
        let mut left = budget;
        let found = decoder.next(Instant::ZERO, TABLE, &mut left, |_| false).is_some();
        assert_eq!(found, budget >= cost, "{budget}");
        assert!(!found || budget - left == cost, "{budget}, {left} left");
        let mut rest = Decoder::MIN_BUDGET;
        let found_later = decoder.next(Instant::ZERO, TABLE, &mut rest, |_| false).is_some();
        assert_eq!(found_later, !found, "{budget}");
    }
}

/// S-12, R-9: a frame with an unknown id cannot be verified. It is accepted as a whole, marked as unverified, if its sender is
/// known and a start byte or silence follows; then nothing inside it is found (SEC-5).
#[test]
fn unknown_ids_need_a_known_sender_and_a_start_byte_or_silence() {
    let from = |source| reference::v2(UNKNOWN, [0, 0], source, &arm(), 0);
    let (known, stranger) = (from([2, 1]), from([3, 1]));
    let receive = |bytes: &[u8]| {
        let mut receiver = Receiver { known: vec![KNOWN], ..Receiver::default() };
        receiver.receive(bytes);
        receiver
    };
    let followed = receive(&[&known[..], &heartbeat()].concat());
    assert_eq!(followed.found, [(known.clone(), false), (heartbeat(), true)], "a start byte follows");
    assert_eq!(followed.decoder.counters().unchecked, 1);
    let mut silent = receive(&known);
    silent.wait(millis(19));
    assert_eq!(silent.found, []);
    silent.wait(millis(1));
    assert_eq!(silent.found, [(known.clone(), false)], "silence");
    let searched = receive(&[&known[..], &[0x55], &heartbeat()].concat());
    assert_eq!(searched.found, [(arm(), true), (heartbeat(), true)], "noise follows: scanned");
    assert_eq!(searched.decoder.counters().unknown_id, 1);
    let strange = receive(&[&stranger[..], &heartbeat()].concat());
    assert_eq!(strange.found, [(arm(), true), (heartbeat(), true)], "unknown sender: scanned");
}

/// SEC-2, R-9: after silence such a frame waits for budget, and is returned by the next call, once.
#[test]
fn unknown_id_waits_for_budget_after_silence() {
    let frame = reference::v2(UNKNOWN, [0, 0], [2, 1], &arm(), 0);
    let mut receiver = Receiver { known: vec![KNOWN], ..Receiver::default() };
    receiver.receive(&frame);
    receiver.budget = Some(0);
    receiver.wait(millis(20));
    assert_eq!(receiver.found, [], "no budget");
    receiver.budget = Some(Decoder::MIN_BUDGET);
    receiver.drain();
    receiver.wait(millis(1_000));
    assert_eq!(receiver.found, [(frame, false)]);
    assert_eq!(receiver.decoder.counters().unchecked, 1);
}

/// S-13, S-20: of 20,000 frames, every one without damage is found, in order, and nothing else.
///
/// A damaged frame has the right checksum by chance once in 65,536 times; with these seeds none has.
#[test]
fn every_intact_frame_is_recovered() {
    for (seed, how) in [
        (1, Damage { flips: true, losses: false, bursts: false }),
        (2, Damage { flips: false, losses: true, bursts: false }),
        (3, Damage { flips: false, losses: false, bursts: true }),
        (4, Damage { flips: true, losses: true, bursts: true }),
    ] {
        let frames = stream::frames(seed, 20_000, KNOWN);
        let (bytes, intact) = damage(&frames, how, &mut Rng::new(!seed));
        let mut receiver = Receiver { known: vec![KNOWN], ..Receiver::default() };
        bytes.chunks(64).for_each(|piece| receiver.receive(piece));
        receiver.receive(&FILLER);
        assert!(intact.len() > 14_000, "seed {seed}: too few intact frames");
        assert!(intact.len() < 19_000, "seed {seed}: too few damaged frames");
        assert!(receiver.checked() == intact, "seed {seed}: the frames found are not the intact ones");
    }
}
