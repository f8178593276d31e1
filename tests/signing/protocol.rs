//! Message signing through the whole stack: rules G-4 to G-12 and G-14, V-3, SEC-5 to SEC-7, SEC-15.

mod routes;

use crate::support::signer::*;
use crate::support::*;
use mavstack::__private::SigningStreams;
use mavstack::config::{LinkClass, PollBudget, TxVersion};
use mavstack::dialect::*;
use mavstack::frame::{Decoder, Version};
use mavstack::message::{Dialect, Secret};
use mavstack::signing::{Accept, LinkSigning, SigningCounters, SigningKey};
use mavstack::{Address, Config, LinkConfig, Message, Pulse};

/// A minute, in units of a timestamp.
const MINUTE: u64 = 6_000_000;

fn rig(links: [LinkSigning; 2]) -> Rig {
    Rig::new(links.map(|signing| LinkConfig::uart(115_200).with_signing(signing)))
}

/// A vehicle with a key whose time is [`NOW`].
fn keyed(links: [LinkSigning; 2]) -> Rig {
    let mut rig = rig(links);
    rig.set_key(KEY);
    rig
}

fn command() -> CommandLong {
    CommandLong { target_system: 1, target_component: 1, command: MavCmd::NAV_LAND, ..CommandLong::default() }
}

/// G-6: a signed frame is handled once.
#[test]
fn signed_command_is_carried_out() {
    let mut rig = keyed([LinkSigning::REQUIRED; 2]);
    let frame = Signer::new(KEY).frame(&command());
    rig.receive(0, &frame);
    assert_eq!(rig.vehicle.commands().len(), 1);
    let answers = rig.sent::<CommandAck>(0);
    assert_eq!(answers.len(), 1);
    assert!(answers[0].is_signed_with(KEY));
    assert_eq!(rig.counters().verified, 1);
}

/// G-6: a replay, an equal timestamp and an older one are refused, on the same link and on another.
#[test]
fn frame_is_accepted_once() {
    for other in [0, 1] {
        let mut rig = keyed([LinkSigning::SIGNED; 2]);
        let mut gcs = Signer::new(KEY);
        let first = gcs.frame(&command());
        rig.receive(0, &first);
        rig.receive(other, &first);
        gcs.timestamp -= 1;
        let equal = gcs.frame(&command());
        rig.receive(other, &equal);
        gcs.timestamp -= 100;
        rig.receive(other, &gcs.frame(&command()));
        assert_eq!(rig.vehicle.commands().len(), 1);
        assert_eq!((rig.counters().verified, rig.counters().replayed), (1, 3));
        gcs.timestamp += 100;
        rig.receive(other, &gcs.frame(&command()));
        assert_eq!(rig.vehicle.commands().len(), 2);
    }
}

/// G-6: a new stream may be 59 s behind our time, but not 61; it may be ahead by any amount.
#[test]
fn new_stream_is_at_most_a_minute_old() {
    for (behind, is_accepted) in [(59 * 100_000, true), (MINUTE, true), (MINUTE + 1, false), (61 * 100_000, false)] {
        let mut rig = keyed([LinkSigning::SIGNED; 2]);
        rig.receive(0, &Signer::new(KEY).at(NOW - behind).frame(&command()));
        assert_eq!(rig.vehicle.commands().len(), usize::from(is_accepted), "{behind}");
        assert_eq!(rig.counters().too_old, u32::from(!is_accepted));
    }
    let mut rig = keyed([LinkSigning::SIGNED; 2]);
    rig.receive(0, &Signer::new(KEY).at(NOW + 1_000 * MINUTE).frame(&command()));
    assert_eq!(rig.vehicle.commands().len(), 1);
    // G-6: our time follows the peer's.
    assert!(rig.timestamp() >= NOW + 1_000 * MINUTE);
    rig.receive(0, &Signer::new(KEY).of(OTHER_STATION).frame(&command()));
    assert_eq!(rig.vehicle.commands().len(), 1, "it is too old now");
}

/// G-8: the seventeenth stream is refused while the others were heard within a minute. Then it evicts the one that has been
/// silent longest, which cannot be replayed.
#[test]
fn seventeenth_stream_is_accepted_after_a_minute() {
    let mut rig = keyed([LinkSigning::REQUIRED; 2]);
    let mut recorded = Vec::new();
    for link_id in 0..16 {
        let frame = Signer::new(KEY).link(link_id).at(NOW + u64::from(link_id)).frame(&command());
        rig.receive(0, &frame);
        rig.transmit(0);
        recorded.push(frame);
    }
    assert_eq!(rig.vehicle.commands().len(), 16);
    let mut late = Signer::new(KEY).of(OTHER_STATION);
    for _ in 0..59 {
        rig.run_for(secs(1));
        late.timestamp = rig.timestamp();
        rig.receive(0, &late.frame(&command()));
    }
    assert_eq!((rig.vehicle.commands().len(), rig.counters().no_stream_slot), (16, 59));
    rig.run_for(secs(2));
    late.timestamp = rig.timestamp();
    rig.receive(0, &late.frame(&command()));
    assert_eq!(rig.vehicle.commands().len(), 17, "no stream is locked out for longer");
    for frame in &recorded {
        rig.receive(1, frame);
    }
    assert_eq!(rig.vehicle.commands().len(), 17, "none of them twice");
    assert_eq!((rig.counters().too_old, rig.counters().replayed), (1, 15));
}

/// G-9, G-10: what each policy accepts, with and without a key.
#[test]
fn each_policy_accepts_its_frames_only() {
    const ONLY: LinkSigning = LinkSigning { accept: Accept::SignedExcept(&[CommandLong::ID]), ..LinkSigning::SIGNED };
    // With a key: unsigned; MAVLink 1; signed; signed with another key. Without a key: unsigned; signed.
    let table = [
        (LinkSigning::OPEN, [true, true, true, false], [true, true]),
        (LinkSigning::SIGNED, [false, false, true, false], [true, true]),
        (ONLY, [true, true, true, false], [true, true]),
        (LinkSigning::REQUIRED, [false, false, true, false], [false, false]),
    ];
    for (policy, with_key, without_key) in table {
        let accepts = |has_key, frame: Vec<u8>| {
            let mut rig = rig([policy; 2]);
            if has_key {
                rig.set_key(KEY);
            }
            rig.receive(0, &frame);
            let is_accepted = rig.vehicle.commands().len() == 1;
            assert_eq!(rig.sent::<CommandAck>(0).len(), usize::from(is_accepted), "an answer");
            assert_eq!(rig.stack.peers(rig.now).count(), usize::from(is_accepted), "a peer");
            is_accepted
        };
        let signed = |key| Signer::new(key).frame(&command());
        let unsigned = |version| Signer::new(KEY).unsigned(version, &command());
        let frames = [unsigned(Version::V2), unsigned(Version::V1), signed(KEY), signed(OTHER_KEY)];
        assert_eq!(frames.map(|frame| accepts(true, frame)), with_key, "{policy:?}");
        assert_eq!([unsigned(Version::V2), signed(KEY)].map(|frame| accepts(false, frame)), without_key, "{policy:?}");
    }
}

/// G-10, SEC-6: RADIO_STATUS is accepted unsigned, and refused with a wrong signature.
#[test]
fn radio_status_is_accepted_unsigned() {
    let mut rig = keyed([LinkSigning::SIGNED, LinkSigning::REQUIRED]);
    let radio = Address::new(51, 68);
    let is_heard = |rig: &Rig| rig.stack.peers(rig.now).any(|info| info.peer.address == radio);
    rig.receive(1, &Signer::new(KEY).of(radio).unsigned(Version::V1, &RadioStatus::default()));
    rig.receive(0, &Signer::new(OTHER_KEY).of(radio).frame(&RadioStatus::default()));
    assert!(!is_heard(&rig));
    rig.receive(0, &Signer::new(KEY).of(radio).unsigned(Version::V1, &RadioStatus::default()));
    assert!(is_heard(&rig));
    assert_eq!((rig.counters().bad_signature, rig.counters().unsigned), (1, 1));
}

/// G-7, G-10: frames with a bad signature change nothing: no time, stream, peer or version, and they get no answer.
#[test]
fn bad_signature_changes_nothing() {
    for accept in [Accept::Open, LinkSigning::SIGNED.accept, Accept::Required] {
        let config = LinkConfig::uart(115_200).with_version(TxVersion::Auto);
        let signing = LinkSigning { accept, sign_out: false, ..LinkSigning::OPEN };
        let mut rig: Rig = Rig::new([config.with_signing(signing); 2]);
        rig.set_key(KEY);
        let before = rig.timestamp();
        let mut bad = Signer::new(OTHER_KEY).at(NOW + 99 * MINUTE);
        rig.receive(0, &bad.frame(&Gcs::heartbeat()));
        rig.receive(0, &bad.frame(&command()));
        rig.receive(0, &bad.frame(&MissionCount { target_system: 1, count: 3, ..Default::default() }));
        rig.receive(0, &bad.frame(&ParamSet { target_system: 1, ..Default::default() }));
        rig.receive(0, &bad.clone().of(VEHICLE).frame(&Gcs::heartbeat()));
        assert_eq!((rig.timestamp(), rig.stack.peers(rig.now).count()), (before, 0));
        assert_eq!(rig.vehicle.calls, []);
        let sent = rig.transmit(0);
        assert!(sent.iter().all(|frame| frame.id() == Heartbeat::ID && frame.raw[0] == 0xFE), "{sent:?}");
        assert_eq!(rig.counters().bad_signature, 4, "the signature of a frame with our address is not checked");
        // They have made no stream.
        rig.receive(0, &Signer::new(KEY).frame(&command()));
        assert_eq!(rig.vehicle.commands().len(), 1);
    }
}

/// G-6, G-8 to G-11: each reason for a refusal has its own counter, only that one is incremented, and nothing else happens.
#[test]
fn each_refusal_has_its_own_counter() {
    type Case = (&'static str, fn(&mut Rig) -> Vec<u8>, fn(&mut SigningCounters) -> &mut u32);
    let cases: [Case; 9] = [
        ("unsigned", |_| Signer::new(KEY).unsigned(Version::V2, &command()), |c| &mut c.unsigned),
        ("MAVLink 1", |_| Signer::new(KEY).unsigned(Version::V1, &command()), |c| &mut c.unsigned),
        (
            "no key to verify it with",
            |rig| {
                rig.signing().clear_key();
                Signer::new(KEY).frame(&command())
            },
            |c| &mut c.unsigned,
        ),
        ("another key", |_| Signer::new(OTHER_KEY).frame(&command()), |c| &mut c.bad_signature),
        (
            "another payload",
            |_| {
                let mut frame = Signer::new(KEY).frame(&command());
                frame[12] ^= 1;
                repair(&mut frame);
                frame
            },
            |c| &mut c.bad_signature,
        ),
        (
            "equal timestamp",
            |rig| {
                rig.receive(0, &Signer::new(KEY).frame(&Gcs::heartbeat()));
                Signer::new(KEY).frame(&command())
            },
            |c| &mut c.replayed,
        ),
        ("61 s", |_| Signer::new(KEY).at(NOW - 61 * 100_000).frame(&command()), |c| &mut c.too_old),
        (
            "seventeenth stream",
            |rig| {
                (0..16).for_each(|link| rig.receive(0, &Signer::new(KEY).link(link).frame(&Gcs::heartbeat())));
                Signer::new(KEY).link(16).frame(&command())
            },
            |c| &mut c.no_stream_slot,
        ),
        (
            "a key on the radio",
            |_| {
                let secret_key = Secret(OTHER_KEY);
                let setup = SetupSigning { target_system: 1, secret_key, ..Default::default() };
                Signer::new(KEY).link(77).frame(&setup)
            },
            |c| &mut c.refused_setups,
        ),
    ];
    for (what, frame, counter) in cases {
        let mut rig = keyed([LinkSigning::REQUIRED; 2]);
        let frame = frame(&mut rig);
        let (mut expected, time, peers) = (rig.counters(), rig.timestamp(), rig.stack.peers(rig.now).count());
        rig.receive(0, &frame);
        *counter(&mut expected) += 1;
        // The sender of this one has a valid key.
        let is_verified = what == "a key on the radio";
        expected.verified += u32::from(is_verified);
        assert_eq!(rig.counters(), expected, "{what}");
        assert!(rig.vehicle.commands().is_empty(), "{what}");
        if !is_verified {
            assert_eq!((rig.timestamp(), rig.stack.peers(rig.now).count()), (time, peers), "{what}");
        }
    }
}

/// G-7: a frame with any single bit flipped, with its checksum corrected, is refused.
#[test]
fn every_flipped_bit_is_refused() {
    let frame = Signer::new(KEY).frame(&command());
    for bit in 0..8 * frame.len() {
        let mut rig = keyed([LinkSigning::REQUIRED; 2]);
        let mut changed = frame.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        repair(&mut changed);
        rig.receive(0, &changed);
        rig.run_for(secs(1));
        // A flipped bit of the checksum was corrected.
        assert!(changed == frame || rig.vehicle.commands().is_empty(), "bit {bit}");
        assert!(changed == frame || rig.counters().verified == 0, "bit {bit}");
    }
}

/// L-16: the age of an accepted frame, once the vehicle has set the time; other frames have none.
#[test]
fn age_of_a_frame_is_known_once_the_time_is_set() {
    let mut rig = keyed([LinkSigning::SIGNED; 2]);
    let mut gcs = Signer::new(KEY).at(NOW - 59 * 100_000);
    let (first, unsigned) = (gcs.frame(&command()), gcs.unsigned(Version::V2, &command()));
    let age_of = |rig: &mut Rig, raw: &[u8]| {
        let mut decoder = Decoder::default();
        let _ = decoder.push(raw, rig.now);
        let frame = decoder.next(rig.now, Common::MESSAGES, &mut u32::MAX.clone(), |_| false).unwrap();
        let now = rig.now;
        rig.signing().age(now, &frame)
    };
    assert_eq!(age_of(&mut rig, &first), None, "the time is not set");
    rig.receive(0, &first);
    assert_eq!(age_of(&mut rig, &first), Some(secs(0)), "by the peer's clock");
    let (now, unix_usec) = (rig.now, (1_420_070_400 * 100_000 + NOW) * 10);
    assert!(rig.signing().set_time(now, unix_usec, secs(1)));
    assert_eq!(age_of(&mut rig, &first), Some(secs(59)));
    rig.run_for(secs(90));
    // A frame of a known stream may have any age.
    let second = gcs.frame(&command());
    rig.receive(0, &second);
    assert_eq!(rig.vehicle.commands().len(), 2);
    assert_eq!(age_of(&mut rig, &second), Some(mavstack::Duration::from_micros(148_999_990)), "10 µs less than 149 s");
    let ahead = gcs.at(NOW + 99 * MINUTE).frame(&command());
    rig.receive(0, &ahead);
    assert_eq!(age_of(&mut rig, &ahead), Some(secs(0)));
    assert_eq!(age_of(&mut rig, &unsigned), None);
    rig.signing().clear_key();
    assert_eq!(age_of(&mut rig, &ahead), None);
}

/// G-4: timestamps strictly rise on each link, follow the clock, and are never behind a received one.
#[test]
fn timestamps_follow_the_clock_and_rise() {
    let mut rig = keyed([LinkSigning::OPEN; 2]);
    let mut last = [0; 2];
    let mut signers = [KEY; 3].map(Signer::new);
    for round in 0..400u64 {
        let link = (round % 2) as usize;
        let gcs = &mut signers[(round % 3) as usize];
        gcs.timestamp += (round % 7) * 1_000_000;
        gcs.address = Address::new(200 + (round % 3) as u8, 190);
        rig.receive(link, &gcs.frame(&command()));
        for _ in 0..round % 5 {
            rig.receive(link, &gcs.frame(&command()));
        }
        let heard = gcs.timestamp - 1;
        let now = rig.timestamp();
        for frame in rig.transmit(link) {
            let signature = frame.signature();
            assert!(signature.timestamp > last[link] && signature.timestamp >= heard, "{round}: {frame:?}");
            assert!((now..now + 100).contains(&signature.timestamp), "{round}: the clock");
            assert_eq!(usize::from(signature.link_id), link, "G-5");
            last[link] = signature.timestamp;
        }
        let before = rig.timestamp();
        rig.run_for(millis(10 * round));
        assert!((rig.timestamp() - before).abs_diff(round * 1_000) <= 100, "{round}");
    }
    assert!(last[0] > NOW && last[1] > NOW);
}

/// G-4: a frame that is sent again from its first byte is signed again; the rest of an interrupted frame is not.
#[test]
fn frame_sent_from_its_start_is_signed_again() {
    let mut rig = keyed([LinkSigning::OPEN; 2]);
    rig.transmit(0);
    rig.receive(0, &Signer::new(KEY).frame(&command()));
    let first = rig.begin(0, 7);
    rig.run_for(secs(90));
    rig.restart(0);
    let again = rig.transmit(0);
    let ack = again.iter().find(|frame| frame.id() == CommandAck::ID).expect("the ACK is sent again");
    assert_eq!(ack.raw[..first.len() - 13], first[..first.len() - 13]);
    assert!(ack.is_signed_with(KEY));
    let old = u64::from_le_bytes([&first[first.len() - 12..first.len() - 6], &[0; 2]].concat().try_into().unwrap());
    assert!(ack.signature().timestamp >= old + 90 * 100_000);
    // Without a key it cannot be signed, and is not sent.
    let now = rig.timestamp();
    rig.receive(0, &Signer::new(KEY).at(now).frame(&command()));
    rig.begin(0, 7);
    rig.signing().clear_key();
    rig.restart(0);
    assert!(rig.transmit(0).iter().all(|frame| frame.raw[2] == 0), "no frame with a signature flag");
}

/// V-3: a link that signs sends v2 from its first frame, whatever its configured version. Other links keep theirs.
#[test]
fn signing_link_sends_mavlink_2() {
    for version in [TxVersion::V1, TxVersion::Auto, TxVersion::V2] {
        let link = LinkConfig::uart(57_600).with_version(version);
        let silent = LinkSigning { sign_out: false, ..LinkSigning::OPEN };
        let mut rig: Rig = Rig::new([link.with_signing(LinkSigning::SIGNED), link.with_signing(silent)]);
        rig.set_key(KEY);
        let sent = rig.transmit(0);
        assert!(!sent.is_empty() && sent.iter().all(|frame| frame.is_signed_with(KEY)));
        let start = if version == TxVersion::V2 { 0xFD } else { 0xFE };
        assert!(rig.transmit(1).iter().all(|frame| frame.raw[0] == start && !frame.is_signed()));
    }
}

/// G-16: without a key nothing is signed.
#[test]
fn without_a_key_nothing_is_signed() {
    let mut rig = rig([LinkSigning::OPEN, LinkSigning::SIGNED]);
    for link in 0..2 {
        assert!(rig.transmit(link).iter().all(|frame| !frame.is_signed()));
    }
    assert!(!rig.signing().is_active());
}

/// H-14: another vehicle with our address is reported on links that accept unsigned frames.
#[test]
fn address_conflict_is_reported_only_where_unsigned_frames_are_accepted() {
    for (signing, is_told) in [(LinkSigning::OPEN, true), (LinkSigning::SIGNED, false), (LinkSigning::REQUIRED, false)]
    {
        let mut rig = keyed([signing; 2]);
        let mut stranger = Signer::new(OTHER_KEY).of(VEHICLE);
        for seq in 100..110 {
            stranger.seq = seq;
            rig.receive(0, &stranger.unsigned(Version::V2, &Gcs::heartbeat()));
        }
        assert_eq!(!rig.vehicle.peer_events().is_empty(), is_told, "{signing:?}");
        assert_eq!(rig.stack.link_counters(LINKS[0]).unwrap().own_address, 10);
    }
}

/// G-14: the wall clock moves our time forward, never back, and at most by the given step.
#[test]
fn wall_clock_moves_time_forward_by_a_bounded_step() {
    const EPOCH: u64 = 1_420_070_400_000_000;
    let mut rig = keyed([LinkSigning::OPEN; 2]);
    let now = rig.now;
    let signing = rig.signing();
    let start = signing.timestamp(now);
    for early in [0, 1, EPOCH - 1, EPOCH, EPOCH + 10 * (start - 1)] {
        assert!(signing.set_time(now, early, secs(0)));
        assert_eq!(signing.timestamp(now), start);
    }
    assert!(signing.set_time(now, EPOCH + 10 * (start + 50), millis(1)));
    assert_eq!(signing.timestamp(now), start + 50);
    assert!(!signing.set_time(now, EPOCH + 10 * (start + 50 + 101), millis(1)), "1.01 ms");
    assert!(!signing.set_time(now, u64::MAX, mavstack::Duration::MAX), "after 2104");
    assert_eq!((signing.timestamp(now), signing.counters().refused_times), (start + 50, 2));
    assert!(signing.set_time(now, EPOCH + 10 * (start + MINUTE), mavstack::Duration::MAX));
    assert_eq!(signing.timestamp(now), start + MINUTE);
}

/// SEC-5: a frame with an unknown id and a right signature is consumed as a whole: frames in its payload are not found. A frame
/// without a right signature is scanned, and what is found inside is judged by itself.
#[test]
fn payload_of_a_signed_frame_is_not_scanned() {
    for (key, commands) in [(KEY, 0), (OTHER_KEY, 1)] {
        let mut rig = keyed([LinkSigning::OPEN; 2]);
        let inside = Signer::new(KEY).of(OTHER_STATION).unsigned(Version::V2, &command());
        let frame = Signer::new(key).frame_of(0x00_F0_0D, &inside);
        rig.receive(0, &frame);
        rig.receive(0, &Signer::new(KEY).frame(&Gcs::heartbeat()));
        rig.run_for(secs(1));
        assert_eq!(rig.vehicle.commands().len(), commands);
        assert_eq!(rig.stack.link_counters(LINKS[0]).unwrap().unknown, 1 - commands as u32);
    }
    // On a link that requires signatures the inner frame needs its own.
    let mut rig = keyed([LinkSigning::SIGNED; 2]);
    let inside = Signer::new(KEY).of(OTHER_STATION).unsigned(Version::V2, &command());
    rig.receive(0, &Signer::new(OTHER_KEY).frame_of(0x00_F0_0D, &inside));
    rig.run_for(secs(1));
    assert_eq!(rig.vehicle.commands().len(), 0);
}

/// Without signing declared, a link that should verify accepts nothing, which is counted; an open link accepts everything.
#[test]
fn without_signing_only_open_links_accept_frames() {
    let links = [LinkSigning::OPEN, LinkSigning::SIGNED].map(|signing| LinkConfig::uart(115_200).with_signing(signing));
    let mut rig = Rig::<2, Plain>::new(links);
    for link in 0..2 {
        let mut gcs = Signer::new(KEY);
        rig.receive(link, &gcs.frame(&command()));
        rig.receive(link, &gcs.unsigned(Version::V2, &command()));
        assert_eq!(rig.vehicle.commands().len(), 2);
        let counters = rig.stack.link_counters(mavstack::LinkId(link as u8)).unwrap();
        assert_eq!(counters.out_of_place, 2 * link as u32);
    }
}

/// A high-latency link signs like any other, and its cost includes the signatures.
#[test]
fn high_latency_link_signs() {
    let link = LinkConfig::uart(1_200).with_class(LinkClass::HighLatency).with_signing(LinkSigning::REQUIRED);
    let mut rig = Rig::<2, SignedSatellite>::new([link; 2]);
    rig.set_key(KEY);
    rig.receive(0, &Signer::new(KEY).unsigned(Version::V2, &command()));
    rig.receive(0, &Signer::new(KEY).frame(&command()));
    assert_eq!(rig.vehicle.commands().len(), 1);
    let sent = rig.transmit(0);
    assert!(sent.len() == 1 && sent[0].is_signed_with(KEY));
    assert_eq!(rig.stack.high_latency.counters().bytes as usize, sent[0].raw.len());
}

/// SEC-15: neither the memory nor the `Debug` output of a vehicle shows the key.
#[test]
fn key_is_not_in_debug_output() {
    let secret = *b"0123456789abcdef_ABCDEFGHIJKLMN!";
    let mut signing = SigningStreams::<2>::new();
    signing.set_key(mavstack::Instant::ZERO, SigningKey::new(secret), 77);
    let text = format!("{signing:?} {signing:#?}");
    assert!(text.contains("is_active: true"));
    for shown in ["012345", "48, 49", "0x30", "3031", "77"] {
        assert!(!text.contains(shown), "{text}");
    }
}

/// A line that accepts everything at once, and receives nothing.
#[derive(Default)]
struct Line {
    written: Vec<u8>,
}

impl embedded_io::ErrorType for Line {
    type Error = core::convert::Infallible;
}

impl embedded_io::Read for Line {
    fn read(&mut self, _: &mut [u8]) -> Result<usize, Self::Error> {
        unreachable!("it is not ready")
    }
}

impl embedded_io::ReadReady for Line {
    fn read_ready(&mut self) -> Result<bool, Self::Error> {
        Ok(false)
    }
}

impl embedded_io::Write for Line {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
        self.written.extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Self::Error> {
        Ok(())
    }
}

impl embedded_io::WriteReady for Line {
    fn write_ready(&mut self) -> Result<bool, Self::Error> {
        Ok(true)
    }
}

/// SEC-2: making or comparing a signature costs work, so a poll handles fewer frames. An unchecked signature costs nothing.
#[test]
fn signatures_cost_work() {
    let budget = |work| PollBudget { work, frames: u32::MAX, ..PollBudget::DEFAULT };
    let rig = |work, key: Option<[u8; 32]>| {
        let mut rig: Rig<1> = Rig::new([LinkConfig::uart(115_200)]);
        let pulse: &'static Pulse = Box::leak(Box::new(Pulse::new()));
        let config = Config { budget: budget(work), ..Config::new(VEHICLE, pulse) };
        rig.stack = begun(config, [LinkConfig::uart(115_200)]);
        if let Some(key) = key {
            rig.set_key(key);
        }
        rig
    };
    // Two blocks each. A handled frame costs 500 units, its bytes and header 48, and its signature 300.
    for (key, is_signed, handled) in
        [(None, false, 5), (None, true, 5), (Some(KEY), false, 5), (Some(KEY), true, 3), (Some(OTHER_KEY), true, 3)]
    {
        let mut rig = rig(3_000, key);
        let mut signer = Signer::new(KEY);
        let next = |_| match is_signed {
            true => signer.frame(&Gcs::heartbeat()),
            false => signer.unsigned(Version::V2, &Gcs::heartbeat()),
        };
        let bytes: Vec<u8> = (0..8).flat_map(next).collect();
        assert_eq!(rig.stack.receive(rig.now, LINKS[0], &bytes, &mut rig.vehicle), bytes.len());
        assert_eq!(rig.stack.rx_counters(LINKS[0]).unwrap().frames, handled, "{key:?} {is_signed}");
    }
    // A sent frame costs 220 units, and is made only if they are left.
    for (work, key, sent) in [(500, None, 2), (660, None, 3), (500, Some(KEY), 1)] {
        let mut rig = rig(work, key);
        for _ in 0..8 {
            rig.receive(0, &Signer::new(KEY).unsigned(Version::V2, &command()));
        }
        let mut line = Line::default();
        rig.stack.poll_link(rig.now, LINKS[0], &mut line, &mut rig.vehicle).unwrap();
        let mut frames = 0;
        let mut rest = &line.written[..];
        while let [0xFD, len, incompat_flags, ..] = *rest {
            rest = &rest[usize::from(len) + 12 + 13 * usize::from(incompat_flags)..];
            frames += 1;
        }
        assert_eq!((frames, rest.len()), (sent, 0), "{key:?}");
    }
}
