//! Single frames, byte by byte: rules S-1 to S-19, SEC-3 to SEC-5. The reference implementation's frames are in `golden.rs`.

use crate::support::stream::Mixed;
use crate::support::{Receiver, Rng, cases, decode, millis, reference};
use mavstack::dialect::*;
use mavstack::frame::{Decoder, EncodeError, MAX_FRAME_LEN, RxCounters, Version, encode};
use mavstack::message::{Dialect, MessageTable};
use mavstack::{Address, Instant, Message, Text};
use proptest::{collection::vec, prelude::*};

const SOURCE: Address = Address::new(42, 17);
const TABLE: MessageTable = Common::MESSAGES;
/// This many bytes after a stream complete or reject every candidate in it.
const FILLER: [u8; 300] = [0; 300];

fn counters_of(bytes: &[u8]) -> RxCounters {
    let mut receiver = Receiver::default();
    receiver.receive(bytes);
    receiver.decoder.counters()
}

/// Decodes the message in `bytes`, which are a single frame.
fn message<M: Message>(bytes: &[u8]) -> Option<M> {
    let mut decoder = Decoder::default();
    let _ = decoder.push(bytes, Instant::ZERO);
    decoder.next(Instant::ZERO, TABLE, &mut u32::MAX.clone(), |_| false)?.decode()
}

fn frame<M: Message>(message: &M, version: Version) -> Vec<u8> {
    let mut out = [0; MAX_FRAME_LEN];
    let len = encode(message, version, SOURCE, 7, &mut out).expect("fits");
    out[..len].to_vec()
}

fn sample() -> CommandLong {
    CommandLong {
        command: MavCmd::NAV_TAKEOFF,
        target_system: 1,
        target_component: 1,
        param1: 0.5,
        param7: 12.25,
        ..CommandLong::default()
    }
}

fn heartbeat() -> Vec<u8> {
    frame(&Heartbeat { mavlink_version: 3, ..Heartbeat::default() }, Version::V2)
}

/// A frame with a signature, which is not valid.
fn signed() -> Vec<u8> {
    let payload = [1, 2, 3, 4, 5, 6, 7, 8, 9];
    let mut frame = reference::v2(0, [1, 0], [42, 17], &payload, 50);
    frame.extend(1..=13);
    frame
}

/// S-1, S-2, S-5, S-8: every byte of a frame.
#[test]
fn frame_has_the_bytes_of_the_guide() {
    let message = Heartbeat { custom_mode: 0x0102_0304, mavlink_version: 3, ..Heartbeat::default() };
    let payload = [4, 3, 2, 1, 0, 0, 0, 0, 3];
    let source = [SOURCE.system.wire(), SOURCE.component.wire()];
    assert_eq!(frame(&message, Version::V2), reference::v2(0, [0, 0], source, &payload, 50));
    assert_eq!(frame(&message, Version::V1), reference::v1(0, source, &payload, 50));
    // Trailing zeros are removed, but not the first byte.
    let trimmed = Heartbeat { custom_mode: 0x0102, ..Heartbeat::default() };
    assert_eq!(frame(&trimmed, Version::V2), reference::v2(0, [0, 0], source, &[2, 1], 50));
    let zero = Heartbeat::default();
    assert_eq!(frame(&zero, Version::V2), reference::v2(0, [0, 0], source, &[0], 50));
    assert_eq!(frame(&zero, Version::V1), reference::v1(0, source, &[0; 9], 50));
}

/// S-1, S-8: frames of every message of common are found, at every length that the version allows.
#[test]
fn every_message_is_found_in_both_versions() {
    let mut rng = Rng::new(1);
    for row in TABLE.rows() {
        let extra = row.crc_extra();
        for len in 0..=u8::MAX {
            let payload: Vec<u8> = (0..len).map(|_| rng.byte()).collect();
            let frame = reference::v2(row.id(), [0, 0], [1, 1], &payload, extra);
            assert_eq!(decode(&frame), [(frame.clone(), true)], "{row:?} with {len} bytes");
        }
        let Ok(id) = u8::try_from(row.id()) else { continue };
        for len in row.base_len()..=row.max_len() {
            let frame = reference::v1(id, [1, 1], &vec![rng.byte(); usize::from(len)], extra);
            assert_eq!(decode(&frame), [(frame.clone(), true)], "{row:?} with {len} bytes as v1");
        }
    }
}

proptest! {
    #![proptest_config(cases(256))]

    /// S-19: typed fields survive the round trip in both versions, NaN included.
    #[test]
    fn typed_messages_round_trip(seed: u64, seq: u8, system in 1u8.., component in 1u8..) {
        let sent = Mixed::random(&mut Rng::new(seed));
        let mut out = [0; MAX_FRAME_LEN];
        let source = Address::new(system, component);
        let len = sent.encode(source, seq, &mut out).unwrap();
        let mut decoder = Decoder::default();
        let _ = decoder.push(&out[..len], Instant::ZERO);
        let frame = decoder.next(Instant::ZERO, TABLE, &mut u32::MAX.clone(), |_| false).expect("a frame");
        prop_assert_eq!((frame.header().seq, frame.source()), (seq, source));
        let received = Mixed::decode(&frame).expect("of the same kind");
        // NaN is not equal to itself, but its bytes are.
        let mut again = [0; MAX_FRAME_LEN];
        let again_len = received.encode(source, seq, &mut again).unwrap();
        prop_assert_eq!(&out[..len], &again[..again_len]);
    }

    /// S-8: v1 carries every base field, and no extension.
    #[test]
    fn v1_carries_the_base_fields(bytes in vec(any::<u8>(), 38)) {
        let sent = MissionItemInt::decode(&bytes);
        let received = message::<MissionItemInt>(&frame(&sent, Version::V1)).expect("a frame");
        let (mut theirs, mut ours) = ([0; 38], [0; 38]);
        received.encode(&mut theirs);
        sent.encode(&mut ours);
        prop_assert_eq!(&theirs[..37], &ours[..37]);
        prop_assert_eq!(theirs[37], 0, "S-8: the extension is not sent");
    }

    /// S-5, S-6, S-7: trailing zeros removed, trailing zeros kept, and extra bytes of a newer dialect give the same message.
    #[test]
    fn payload_length_does_not_change_the_message(known in vec(any::<u8>(), 33), more in vec(any::<u8>(), 0..222)) {
        let trimmed = known.iter().rposition(|&byte| byte != 0).map_or(1, |at| at + 1);
        let long = [&known[..], &more].concat();
        let expected = CommandLong::decode(&known);
        for payload in [&known[..trimmed], &known, &long] {
            let frame = reference::v2(CommandLong::ID, [0, 0], [9, 9], payload, CommandLong::CRC_EXTRA);
            let received = message::<CommandLong>(&frame).expect("a frame");
            prop_assert_eq!(format!("{received:?}"), format!("{expected:?}"));
        }
    }
}

/// S-6: earlier bytes in the buffer do not appear in fields that a short frame lacks.
#[test]
fn stale_bytes_do_not_leak() {
    let mut decoder = Decoder::default();
    let full = reference::v2(CommandAck::ID, [0, 0], [9, 9], &[0xEE; 10], CommandAck::CRC_EXTRA);
    let short = reference::v2(CommandAck::ID, [0, 0], [9, 9], &[0x11; 1], CommandAck::CRC_EXTRA);
    for bytes in [&full, &short, &full] {
        let _ = decoder.push(bytes, Instant::ZERO);
        let frame = decoder.next(Instant::ZERO, TABLE, &mut u32::MAX.clone(), |_| false).expect("a frame");
        let ack = frame.decode::<CommandAck>().expect("an ack");
        if frame.payload().len() == 1 {
            assert_eq!(ack, CommandAck { command: MavCmd(0x11), ..CommandAck::default() });
        }
    }
}

/// S-17, S-18: undefined values decode unchanged; a text may hold any bytes.
#[test]
fn unknown_values_decode() {
    let frame = reference::v2(0, [0, 0], [9, 9], &[0xFF; 9], 50);
    let heartbeat = message::<Heartbeat>(&frame).expect("a frame");
    assert_eq!((heartbeat.r#type, heartbeat.autopilot), (MavType(255), MavAutopilot(255)));
    assert_eq!((heartbeat.base_mode, heartbeat.system_status), (MavModeFlag(255), MavState(255)));
    let command = CommandLong { command: MavCmd(42_424), param1: f32::INFINITY, ..sample() };
    assert_eq!(message::<CommandLong>(&self::frame(&command, Version::V2)), Some(command));
    let text = Statustext { text: Text::from_wire([0xC3; 50]), ..Statustext::default() };
    let text = message::<Statustext>(&self::frame(&text, Version::V2)).expect("a frame").text;
    assert_eq!((text.as_bytes().len(), text.as_str()), (50, None));
}

/// S-10: an id above 255 does not fit into v1. A frame that is too long for the buffer is not partly written.
#[test]
fn encoder_refuses_frames_that_do_not_fit() {
    let mut out = [0; MAX_FRAME_LEN];
    let version = ProtocolVersion { version: 200, ..ProtocolVersion::default() };
    assert_eq!(encode(&version, Version::V1, SOURCE, 0, &mut out), Err(EncodeError::NeedsV2));
    assert!(encode(&version, Version::V2, SOURCE, 0, &mut out).is_ok());
    let long = CommandLong { confirmation: 1, ..sample() };
    for room in 0..12 + CommandLong::MAX_LEN {
        let result = encode(&long, Version::V2, SOURCE, 0, &mut out[..room]);
        assert_eq!(result, Err(EncodeError::BufferTooSmall), "{room} bytes");
    }
}

/// S-9, S-9b, SEC-3: an unknown incompatibility flag rejects the candidate before its length is used, so the next frame is
/// found at once. Compatibility flags are kept and ignored.
#[test]
fn unknown_incompatibility_flag_rejects_the_frame() {
    for flag in 1..8 {
        let mut bytes = reference::v2(0, [1 << flag, 0], [9, 9], &[0; 9], 50);
        bytes[1] = 255;
        let start = [&bytes[..3], &heartbeat()].concat();
        assert_eq!(decode(&start), [(heartbeat(), true)], "flag {flag}");
        assert_eq!(counters_of(&start).incompat_flags, 1);
    }
    let odd = reference::v2(0, [0, 0xFF], [9, 9], &[1; 9], 50);
    assert_eq!(decode(&odd), [(odd.clone(), true)]);
}

/// S-11, S-13: system id 0 is invalid, so its header is rejected before the payload is received. Component 0 is accepted,
/// because pymavlink sends it by default.
#[test]
fn system_0_is_not_a_source() {
    for source in [[0, 1], [1, 0], [0, 0]] {
        for frame in [reference::v2(0, [0, 0], source, &[3; 9], 50), reference::v1(0, source, &[3; 9], 50)] {
            let is_dropped = source[0] == 0;
            let expected = if is_dropped { vec![] } else { vec![(frame.clone(), true)] };
            assert_eq!(decode(&frame), expected, "{source:?}");
            assert_eq!(counters_of(&frame).zero_source, u32::from(is_dropped));
        }
    }
}

/// S-8, S-13, SEC-4: a v1 header with a length that its message cannot have is rejected before its payload is received; the
/// next frame is found at once. STATUSTEXT may have 51 to 54 bytes; HEARTBEAT has no extensions.
#[test]
fn v1_length_must_fit() {
    for (id, extra, lens) in [(0, Heartbeat::CRC_EXTRA, 9..=9), (253, Statustext::CRC_EXTRA, 51..=54)] {
        for len in (0..=100).filter(|len| !lens.contains(len)) {
            let bytes = [&reference::v1(id, [9, 9], &vec![5; len], extra)[..6], &heartbeat()].concat();
            assert_eq!(decode(&bytes), [(heartbeat(), true)], "{len} bytes");
            assert_eq!(counters_of(&bytes).length, 1);
        }
    }
}

/// S-8: pymavlink's MAVLink 1 frames end with extensions. Received extension bytes are decoded, even a part of a field; the
/// rest is zero. The frame is kept as received, for forwarding.
#[test]
fn received_v1_extensions_are_decoded() {
    let count = [3, 0, 1, 1, 1];
    for len in [4, 5] {
        let bytes = reference::v1(44, [9, 9], &count[..len], MissionCount::CRC_EXTRA);
        let expected = MavMissionType(if len == 5 { 1 } else { 0 });
        let received = message::<MissionCount>(&bytes).expect("a frame");
        assert_eq!((received.count, received.mission_type), (3, expected), "{len} bytes");
        assert_eq!(decode(&bytes), [(bytes.clone(), true)]);
    }
    let text = Statustext { text: Text::new("Gear down"), ..Statustext::default() };
    let mut payload = [0; Statustext::MAX_LEN];
    text.encode(&mut payload);
    payload[51..].copy_from_slice(&[0x34, 0x12, 2]);
    for (len, id, chunk_seq) in [(51, 0, 0), (52, 0x34, 0), (53, 0x1234, 0), (54, 0x1234, 2)] {
        let bytes = reference::v1(253, [9, 9], &payload[..len], Statustext::CRC_EXTRA);
        let expected = Statustext { id, chunk_seq, ..text };
        assert_eq!(message::<Statustext>(&bytes), Some(expected), "{len} bytes");
    }
}

/// S-14: a bad checksum stays bad, even if a corrupted flag makes the decoder wait for a signature.
#[test]
fn bad_checksum_stays_bad_with_a_signature() {
    let mut bytes = signed();
    assert_eq!(decode(&bytes), [(bytes.clone(), true)]);
    bytes[19] ^= 0x40;
    assert_eq!(decode(&bytes), []);
    assert_eq!(counters_of(&bytes).checksum, 1);
    // The flag itself is corrupted: a whole frame, then bytes that are taken for its signature.
    let mut flagged = heartbeat();
    flagged[2] = 1;
    let stream = [&flagged[..], &heartbeat(), &FILLER].concat();
    assert_eq!(decode(&stream), [(heartbeat(), true)]);
}

/// G-1: the signature is kept, and is not part of the checksum.
#[test]
fn signature_is_carried() {
    let mut decoder = Decoder::default();
    let _ = decoder.push(&signed(), Instant::ZERO);
    let frame = decoder.next(Instant::ZERO, TABLE, &mut u32::MAX.clone(), |_| false).expect("a frame");
    let signature = frame.signature().expect("signed");
    assert_eq!((signature.link_id, signature.timestamp), (1, 0x0706_0504_0302));
    assert_eq!(signature.bytes, [8, 9, 10, 11, 12, 13]);
    let _ = decoder.push(&heartbeat(), Instant::ZERO);
    assert!(decoder.next(Instant::ZERO, TABLE, &mut u32::MAX.clone(), |_| false).unwrap().signature().is_none());
}

/// Frames of all kinds, for the exhaustive tests.
fn kinds() -> Vec<Vec<u8>> {
    let text = Statustext { text: Text::new("GPS glitch, 12 satellites"), id: 3, ..Statustext::default() };
    vec![
        heartbeat(),
        frame(&sample(), Version::V2),
        frame(&sample(), Version::V1),
        frame(&Heartbeat::default(), Version::V1),
        reference::v1(44, [42, 17], &[3, 0, 1, 1, 1], MissionCount::CRC_EXTRA),
        frame(&text, Version::V2),
        signed(),
    ]
}

/// The number of bytes that the checksum protects, itself included: all but the signature.
fn guarded(frame: &[u8]) -> usize {
    frame.len() - if frame[0] == 0xFD && frame[2] == 1 { 13 } else { 0 }
}

/// S-2, S-13: every flipped bit is detected, and the next frame is found. Signatures are not verified here, so frames with a
/// bit flipped in the signature are accepted.
#[test]
fn every_flipped_bit_is_detected() {
    for good in kinds() {
        for bit in 0..guarded(&good) * 8 {
            let mut bad = good.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            let mut receiver = Receiver::default();
            receiver.receive(&[&bad[..], &heartbeat(), &FILLER].concat());
            assert_eq!(receiver.checked(), [heartbeat()], "bit {bit} of {good:02x?}");
        }
    }
}

/// S-13, S-20: a frame truncated at any byte is rejected, and the next one is found. A frame truncated inside its signature
/// takes the start of the next frame as its rest, because without a key the signature is not verified.
#[test]
fn every_truncation_is_detected() {
    for good in kinds() {
        for len in 0..guarded(&good) {
            let stream = [&good[..len], &heartbeat(), &FILLER].concat();
            let mut receiver = Receiver::default();
            receiver.receive(&stream);
            assert_eq!(receiver.checked(), [heartbeat()], "{len} bytes of {good:02x?}");
        }
    }
}

/// S-13: a valid frame inside a longer one with a wrong checksum is found, at every position.
#[test]
fn frame_hidden_in_a_corrupted_one_is_found() {
    let inner = frame(&sample(), Version::V2);
    for at in 0..=251 - inner.len() {
        let mut payload = [0x55; 251];
        payload[at..at + inner.len()].copy_from_slice(&inner);
        let mut outer = reference::v2(FileTransferProtocol::ID, [0, 0], [9, 9], &payload, 84);
        assert_eq!(decode(&outer).len(), 1, "SEC-5: only the outer frame while it is valid");
        *outer.last_mut().unwrap() ^= 1;
        assert_eq!(decode(&outer), [(inner.clone(), true)], "at {at}");
    }
}

/// SEC-4: a partial frame does not hide what follows on a line that fell silent: 500 ms after its last byte it is dropped, and
/// the bytes after its first one are scanned.
#[test]
fn candidate_that_stops_growing_is_dropped() {
    let mut receiver = Receiver::default();
    receiver.receive(&[&[0xFD, 255, 0, 0, 1, 9, 9, 0, 0, 0], &heartbeat()[..]].concat());
    receiver.wait(millis(499));
    assert_eq!(receiver.found, []);
    receiver.wait(millis(1));
    assert_eq!(receiver.found, [(heartbeat(), true)]);
    assert_eq!(receiver.decoder.counters().stale, 1);
    // Each byte restarts the timeout.
    let mut slow = Receiver::default();
    for byte in heartbeat() {
        slow.wait(millis(499));
        slow.receive(&[byte]);
    }
    assert_eq!(slow.found, [(heartbeat(), true)]);
}

/// Clearing the decoder drops a partial frame, which then hides no later one. The counters stay.
#[test]
fn cleared_decoder_starts_afresh() {
    let mut receiver = Receiver::default();
    receiver.receive(&heartbeat());
    receiver.receive(&heartbeat()[..12]);
    receiver.decoder.clear();
    receiver.receive(&heartbeat());
    assert_eq!(receiver.found, [(heartbeat(), true), (heartbeat(), true)]);
    let counters = receiver.decoder.counters();
    assert_eq!((counters.frames, counters.skipped, counters.checksum), (2, 0, 0));
}

/// What a frame says about its message. The `Debug` output of a frame, and of the decoder, omits the payload.
#[test]
fn debug_output_of_a_frame_omits_the_payload() {
    let mut decoder = Decoder::default();
    let _ = decoder.push(&heartbeat(), Instant::ZERO);
    assert!(format!("{decoder:?}").starts_with("Decoder { waiting: 21"), "{decoder:?}");
    let frame = decoder.next(Instant::ZERO, TABLE, &mut u32::MAX.clone(), |_| false).expect("a frame");
    assert_eq!(frame.info().map(|info| info.id()), Some(Heartbeat::ID));
    assert_eq!(frame.decode::<SysStatus>(), None, "another message");
    let shown = format!("{frame:?}");
    assert!(shown.starts_with("Frame { header: Header") && shown.contains("is_checked: true"), "{shown}");
}

/// SEC-3: the third byte rejects an unreadable frame; the decoder does not wait for the rest of the header.
#[test]
fn unknown_flags_are_rejected_at_the_third_byte() {
    for flags in [2, 0x80, 0xFF] {
        let mut receiver = Receiver::default();
        receiver.receive(&[0xFD, 9]);
        assert_eq!(receiver.decoder.counters(), RxCounters::default());
        receiver.receive(&[flags]);
        assert_eq!(receiver.decoder.counters().incompat_flags, 1);
    }
}

/// SEC-2: the minimum budget is exactly what the longest frame needs.
#[test]
fn minimum_budget_is_the_longest_frames_cost() {
    let longest = frame(&LoggingData { data: [7; 249], ..LoggingData::default() }, Version::V2);
    assert_eq!(longest.len(), 10 + 255 + 2);
    for (mut budget, is_found) in [(Decoder::MIN_BUDGET, true), (Decoder::MIN_BUDGET - 1, false)] {
        let mut decoder = Decoder::default();
        assert_eq!(decoder.push(&longest, Instant::ZERO), longest.len());
        assert_eq!(decoder.next(Instant::ZERO, TABLE, &mut budget, |_| false).is_some(), is_found);
    }
}

/// SEC-2: the header of an unknown message costs twice as much as that of a known one.
#[test]
fn unknown_id_costs_twice_as_much() {
    let mut stream = reference::v2(0x00AB_CDEF, [0, 0], [42, 17], &[1, 2, 3], 0);
    stream.push(0xFD);
    let mut decoder = Decoder::default();
    assert_eq!(decoder.push(&stream, Instant::ZERO), stream.len());
    let mut budget = 1_000;
    assert!(decoder.next(Instant::ZERO, TABLE, &mut budget, |_| true).is_some());
    assert_eq!(budget, 1_000 - 34);
}

mavstack::message! {
    /// The message with the last id that v1 can carry.
    pub struct LastOfV1: LAST_OF_V1 = 255 {
        n: u8,
    }
}

/// S-10: 255 is the last id that v1 can carry.
#[test]
fn id_255_fits_into_v1() {
    let mut out = [0; MAX_FRAME_LEN];
    assert_eq!(encode(&LastOfV1 { n: 7 }, Version::V1, SOURCE, 0, &mut out), Ok(9));
    assert_eq!((out[5], out[6]), (255, 7));
}
