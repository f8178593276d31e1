//! Streams of frames: cut anywhere, damaged anyhow. Rules S-12, S-13, S-20, R-9, SEC-1, SEC-2, SEC-5.
//! What one frame is, `frame.rs` tests.

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
/// So many bytes behind a stream end every candidate in it.
const FILLER: [u8; 300] = [0; 300];
/// Somebody who was heard before.
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

/// S-20: three frames, cut into three pieces at every two places.
#[test]
fn every_split_of_three_frames_gives_the_same() {
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

/// `bytes` are read into the decoder's own room.
fn read_into(receiver: &mut Receiver, bytes: &[u8]) {
    let mut rest = bytes;
    while !rest.is_empty() {
        let room = receiver.decoder.spare();
        let (now, behind) = rest.split_at(rest.len().min(room.len()));
        assert!(!now.is_empty(), "no frame waits, and there is no room");
        room[..now.len()].copy_from_slice(now);
        receiver.decoder.filled(now.len(), receiver.now);
        receiver.drain();
        rest = behind;
    }
}

/// A line that gives packets gives each once: where nothing waits there is room for the longest frame, whatever came before.
#[test]
fn a_packet_of_any_length_has_room() {
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

/// What a line may carry: frames of known and unknown messages, whole and damaged, one inside the other, and noise rich in
/// start bytes.
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
        // With some of its extensions, and now and then a byte more.
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

    /// The decoder finds what a second one, written from the guide alone, finds.
    #[test]
    fn decoder_equals_the_reference(stream in any_stream()) {
        let stream = [&stream[..], &FILLER].concat();
        let mut receiver = Receiver { known: vec![KNOWN], ..Receiver::default() };
        receiver.receive(&stream);
        prop_assert_eq!(receiver.found, reference::decode(&stream, TABLE, |source| source == [2, 1]));
    }

    /// S-20: the same frames and the same counters, however the bytes are cut, and however they come in.
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

    /// SEC-2: a search that runs out of budget goes on where it stopped, and finds the same.
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

    /// SEC-5: whatever stands in the payload of a frame that is right, only the frame comes out.
    #[test]
    fn nothing_comes_out_of_a_payload(inner in vec(any_stream(), 1..4)) {
        let frames: Vec<Vec<u8>> = inner
            .iter()
            .map(|inner| reference::v2(FileTransferProtocol::ID, [0, 0], [9, 9], &inner[..inner.len().min(255)], 84))
            .collect();
        let expected: Vec<Found> = frames.iter().map(|frame| (frame.clone(), true)).collect();
        prop_assert_eq!(decode(&frames.concat()), expected);
    }

    /// SEC-1, S-13: noise never panics, and never hides the frame behind it.
    #[test]
    fn noise_costs_nothing_behind_it(noise in vec(any::<u8>(), 0..2_000)) {
        let found = decode(&[&noise[..], &[0; 300], &heartbeat()].concat());
        prop_assert_eq!(found.last(), Some(&(heartbeat(), true)));
    }
}

/// SEC-2: where every third byte is the front of a frame that fails late, each call keeps to its budget, gets on, and in
/// the end finds what is behind.
#[test]
fn nested_false_headers_cannot_hold_the_decoder() {
    // Headers of a message with 255 bytes in each other: nearly every start byte costs a checksum over 265 bytes.
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
        assert!(calls < stream.len(), "a call gets on by a byte at least");
    }
}

/// SEC-2: a checksum for which the budget does not suffice is not begun. A look at the header costs 16, and a byte 1.
#[test]
fn budget_is_kept() {
    // One look, and the checksum over CRC_EXTRA and all but the start byte and itself.
    let cost = 16 + 1 + heartbeat().len() as u32 - 3;
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

/// S-12, R-9: a frame with an unknown id cannot be checked. A known sender speaks for it, together with a start byte or
/// silence behind it: then it is taken whole, nothing inside it counts (SEC-5), and it is marked as unchecked.
#[test]
fn unknown_ids_are_taken_only_when_something_speaks_for_them() {
    let from = |source| reference::v2(UNKNOWN, [0, 0], source, &arm(), 0);
    let (known, stranger) = (from([2, 1]), from([3, 1]));
    let receive = |bytes: &[u8]| {
        let mut receiver = Receiver { known: vec![KNOWN], ..Receiver::default() };
        receiver.receive(bytes);
        receiver
    };
    let followed = receive(&[&known[..], &heartbeat()].concat());
    assert_eq!(followed.found, [(known.clone(), false), (heartbeat(), true)], "a start byte behind it");
    assert_eq!(followed.decoder.counters().unchecked, 1);
    let mut silent = receive(&known);
    silent.wait(millis(19));
    assert_eq!(silent.found, []);
    silent.wait(millis(1));
    assert_eq!(silent.found, [(known.clone(), false)], "silence");
    let searched = receive(&[&known[..], &[0x55], &heartbeat()].concat());
    assert_eq!(searched.found, [(arm(), true), (heartbeat(), true)], "noise behind it: searched");
    assert_eq!(searched.decoder.counters().unknown_id, 1);
    let strange = receive(&[&stranger[..], &heartbeat()].concat());
    assert_eq!(strange.found, [(arm(), true), (heartbeat(), true)], "nobody knows the sender: searched");
}

/// SEC-2, R-9: such a frame, whole on a silent line, waits for budget, and comes out with the next one, once.
#[test]
fn an_unknown_id_waits_for_budget_in_silence() {
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

/// S-13, S-20: of 20,000 frames every one that the line left alone is found, in order, and nothing else is.
///
/// Whether a damaged frame has the right checksum by chance (one in 65,536) depends on the seed; these have none.
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
        assert!(intact.len() > 14_000, "seed {seed}: enough is left to find");
        assert!(intact.len() < 19_000, "seed {seed}: enough is damaged");
        assert!(receiver.checked() == intact, "seed {seed}: found is not what was left intact");
    }
}
