//! SETUP_SIGNING: rules G-11 and G-12.

use crate::support::signer::*;
use crate::support::*;
use mavstack::config::LinkClass;
use mavstack::dialect::*;
use mavstack::frame::Version;
use mavstack::message::Secret;
use mavstack::signing::{Accept, LinkSigning, SigningKey};
use mavstack::{Address, LinkConfig, Message};

const WIRE: LinkSigning = LinkSigning::OPEN.with_provisioning();
/// A minute, and how far ahead a clock may be, in units of a timestamp.
const MINUTE: u64 = 6_000_000;
const LEAD: u64 = 10 * MINUTE;
/// Unix time of timestamp 0 (µs).
const UNIX: u64 = 1_420_070_400_000_000;

/// Link 0 is a wire on which keys can be set, link 1 a radio.
fn rig() -> Rig {
    Rig::new(links())
}

fn links() -> [LinkConfig; 2] {
    [WIRE, LinkSigning::SIGNED].map(|signing| LinkConfig::uart(115_200).with_signing(signing))
}

fn setup(key: [u8; 32], initial_timestamp: u64) -> SetupSigning {
    SetupSigning { initial_timestamp, target_system: 1, target_component: 1, secret_key: Secret(key) }
}

/// A frame of a ground station that has no key yet.
fn unsigned(message: &impl Message) -> Vec<u8> {
    Signer::new(KEY).unsigned(Version::V2, message)
}

fn texts(sent: &[Sent]) -> Vec<(String, bool)> {
    let text = |frame: &Sent| {
        let text = frame.decode::<Statustext>()?.text;
        Some((String::from_utf8_lossy(text.as_bytes()).into_owned(), frame.is_signed()))
    };
    sent.iter().filter_map(text).collect()
}

fn arm(rig: &mut Rig, is_armed: bool) {
    let state = rig.vehicle.state.as_mut().expect("no fault");
    let armed = if is_armed { MavModeFlag::SAFETY_ARMED } else { MavModeFlag::EMPTY };
    state.base_mode = armed.with(MavModeFlag::CUSTOM_MODE_ENABLED);
}

/// G-11: the key is set, and time moves to its timestamp. A signed heartbeat and a text confirm it at once.
#[test]
fn key_is_set_and_confirmed_at_once() {
    for target_component in [1, 0] {
        let mut rig = rig();
        assert!(!rig.transmit(0).is_empty() && !rig.transmit(1).is_empty(), "the first heartbeats");
        rig.receive(0, &unsigned(&SetupSigning { target_component, ..setup(KEY, NOW) }));
        let sent = rig.transmit(0);
        assert_eq!(sent[0].id(), Heartbeat::ID, "at once");
        assert!(sent.iter().all(|frame| frame.is_signed_with(KEY)));
        assert_eq!(texts(&sent), [("Signing key set".to_owned(), true)]);
        assert!(rig.timestamp() >= NOW);
        assert_eq!((rig.counters().setups, rig.counters().refused_setups), (1, 0));
        assert_eq!(rig.vehicle.calls, [], "the vehicle does not see the message");
        // From now on the radio requires signatures.
        rig.receive(1, &unsigned(&Gcs::heartbeat()));
        assert_eq!(rig.counters().unsigned, 1);
        rig.run_for(secs(1));
        assert!(rig.sent::<Heartbeat>(1)[0].is_signed_with(KEY));
    }
}

/// G-17: the same key, set again, moves our time forward and never back. Streams are kept, so recorded frames are not accepted
/// again.
#[test]
fn setting_the_same_key_again_keeps_its_streams() {
    for (initial_timestamp, least) in [(NOW, NOW), (0, NOW), (NOW - 1_000_000, NOW), (NOW + 1_000_000, NOW + 1_000_000)]
    {
        let mut rig = rig();
        rig.receive(0, &unsigned(&setup(KEY, NOW)));
        let mut signers = [STATION, OTHER_STATION].map(|address| Signer::new(KEY).of(address));
        let recorded = signers.each_mut().map(|signer| signer.frame(&Gcs::heartbeat()));
        for frame in &recorded {
            rig.receive(1, frame);
        }
        rig.transmit(0);
        let before = rig.timestamp();
        rig.receive(0, &unsigned(&setup(KEY, initial_timestamp)));
        assert!(rig.timestamp() >= before.max(least), "{initial_timestamp}");
        for frame in &recorded {
            rig.receive(1, frame);
        }
        assert_eq!((rig.counters().verified, rig.counters().replayed), (2, 2), "{initial_timestamp}");
        for signer in &mut signers {
            rig.receive(1, &signer.frame(&Gcs::heartbeat()));
        }
        assert_eq!(rig.counters().verified, 4, "{initial_timestamp}");
    }
}

/// G-17: another key starts with its own timestamp, even an earlier one, and without streams; so does a key after none.
#[test]
fn another_key_starts_with_its_own_timestamp() {
    for is_off_between in [false, true] {
        let mut rig = rig();
        rig.set_key(KEY);
        rig.receive(1, &Signer::new(KEY).at(NOW + 9 * 6_000_000).frame(&Gcs::heartbeat()));
        if is_off_between {
            rig.receive(0, &unsigned(&setup([0; 32], 0)));
            rig.transmit(0);
        }
        rig.receive(0, &unsigned(&setup(OTHER_KEY, NOW - 7_000_000)));
        assert_eq!(rig.timestamp(), NOW - 7_000_000);
        assert!(rig.transmit(0).iter().all(|frame| frame.is_signed_with(OTHER_KEY)));
        for (n, at) in [NOW - 13_000_001, NOW - 12_900_000, NOW].into_iter().enumerate() {
            rig.receive(1, &Signer::new(OTHER_KEY).at(at).frame(&Gcs::heartbeat()));
            let counters = rig.counters();
            assert_eq!((counters.too_old, counters.verified), (1, 1 + n as u32), "the stream is new");
        }
    }
}

/// G-17: a time that the vehicle has set since the start overrides an earlier timestamp of another key.
#[test]
fn another_key_does_not_move_a_set_time_back() {
    for initial_timestamp in [0, NOW - 1_000_000, NOW + 1_000_000] {
        let mut rig = rig();
        rig.set_key(KEY);
        let now = rig.now;
        assert!(rig.signing().set_time(now, UNIX + 10 * NOW, mavstack::Duration::MAX));
        rig.receive(0, &unsigned(&setup(OTHER_KEY, initial_timestamp)));
        assert_eq!(rig.timestamp(), NOW.max(initial_timestamp));
    }
}

/// G-8, G-17: a key that is set again has lost its streams. Frames recorded with it are accepted once more if they are at most
/// a minute older than the key's new timestamp. A timestamp one minute in the future leaves no window.
#[test]
fn key_that_is_set_again_has_a_replay_window() {
    const RECORDED: u64 = NOW + 100_000;
    let (none, other) = (([0; 32], 0), (OTHER_KEY, NOW + 7));
    for way in [&[none][..], &[other], &[other, none]] {
        for (initial_timestamp, is_open) in
            [(0, true), (RECORDED, true), (RECORDED + MINUTE - 100, true), (RECORDED + MINUTE + 1, false)]
        {
            let mut rig = rig();
            rig.set_key(KEY);
            let recorded = Signer::new(KEY).at(RECORDED).frame(&Gcs::heartbeat());
            rig.receive(1, &recorded);
            for (key, initial_timestamp) in way.iter().copied().chain([(KEY, initial_timestamp)]) {
                // Our own answers advance our time by a few units.
                rig.receive(0, &unsigned(&setup(key, initial_timestamp)));
                rig.transmit(0);
            }
            for _ in 0..2 {
                rig.receive(1, &recorded);
            }
            let counters = rig.counters();
            let again = (counters.verified - 1, counters.replayed, counters.too_old);
            assert_eq!(again, if is_open { (1, 1, 0) } else { (0, 0, 2) }, "{way:?}, {initial_timestamp}");
            rig.receive(1, &Signer::new(KEY).at(initial_timestamp.max(RECORDED + 1)).frame(&Gcs::heartbeat()));
            assert_eq!(rig.counters().verified, counters.verified + 1, "a peer with a right clock is accepted");
        }
    }
}

/// A signed frame that was handled unverified before the key was set can be replayed for a minute after it, but not if the
/// key's timestamp excludes that.
#[test]
fn frame_from_before_the_key_can_be_replayed_for_a_minute() {
    for refuses in [false, true] {
        let mut rig = rig();
        let recorded = Signer::new(KEY).at(NOW - 100).frame(&Gcs::heartbeat());
        rig.receive(1, &recorded);
        assert_eq!((rig.stack.peers(rig.now).count(), rig.counters().verified), (1, 0));
        rig.set_key(KEY);
        let now = rig.now;
        if refuses {
            rig.signing().refuse_recorded(now);
        }
        rig.receive(1, &recorded);
        assert_eq!((rig.counters().verified, rig.counters().too_old), if refuses { (0, 1) } else { (1, 0) });
    }
}

/// G-11: a key of zeros turns signing off in both directions. The confirming heartbeat is unsigned, and the radio is open.
#[test]
fn key_of_zeros_turns_signing_off() {
    let mut rig = rig();
    rig.receive(0, &unsigned(&setup(KEY, NOW)));
    rig.transmit(0);
    rig.receive(0, &unsigned(&setup([0; 32], 0)));
    let sent = rig.transmit(0);
    assert_eq!(sent[0].id(), Heartbeat::ID);
    assert!(sent.iter().all(|frame| !frame.is_signed()));
    assert_eq!(texts(&sent), [("Signing is off".to_owned(), false)]);
    assert!(!rig.signing().is_active());
    rig.receive(1, &unsigned(&Gcs::heartbeat()));
    rig.receive(1, &Signer::new(KEY).frame(&Gcs::heartbeat()));
    assert_eq!((rig.counters().unsigned, rig.counters().bad_signature), (0, 0));
}

/// G-11, G-17: zeros with a timestamp are a key, though a bad one. A meaningless timestamp, or one without a successor, is
/// refused.
#[test]
fn bad_timestamp_is_refused() {
    let mut rig = rig();
    rig.receive(0, &unsigned(&setup([0; 32], 1)));
    assert!(rig.signing().is_active());
    rig.transmit(0);
    for late in [(1 << 48) - 1, 1 << 48, u64::MAX] {
        rig.receive(0, &unsigned(&setup(OTHER_KEY, late)));
        let sent = rig.transmit(0);
        assert_eq!(texts(&sent), [("Signing not changed: bad timestamp".to_owned(), false)]);
    }
    assert_eq!(rig.counters().refused_setups, 3);
    assert!(rig.sent::<Heartbeat>(0).iter().all(|frame| frame.is_signed_with([0; 32])));
}

/// G-11: pending answers wake a driver that sleeps until `next_deadline`, also refusals, which no heartbeat accompanies.
#[test]
fn next_deadline_includes_answers() {
    for (link, message) in [(0, setup(KEY, NOW)), (0, setup(OTHER_KEY, 1 << 48)), (1, setup(KEY, NOW))] {
        let mut rig = rig();
        assert!(!rig.transmit(0).is_empty() && !rig.transmit(1).is_empty(), "the first heartbeats");
        rig.run_for(millis(100));
        assert!(rig.stack.next_deadline(rig.now) > rig.now);
        rig.receive(link, &unsigned(&message));
        while rig.stack.next_deadline(rig.now) <= rig.now {
            let sent = rig.stack.transmit(rig.now, LINKS[link], &mut rig.vehicle).len();
            rig.stack.transmitted(LINKS[link], sent);
            rig.stack.poll(rig.now, &mut rig.vehicle);
        }
        assert_eq!(texts(&rig.transmit(link)), [], "it was already sent");
    }
}

/// G-11: while armed or in a fault, the key is refused, with an unsigned text that a station with another key can read.
#[test]
fn armed_vehicle_keeps_its_key() {
    for key in [None, Some(KEY)] {
        let mut rig = rig();
        if let Some(key) = key {
            rig.set_key(key);
        }
        arm(&mut rig, true);
        rig.transmit(0);
        for message in [setup(OTHER_KEY, NOW), setup([0; 32], 0)] {
            rig.receive(0, &unsigned(&message));
            let sent = rig.transmit(0);
            assert_eq!(texts(&sent), [("Signing not changed: vehicle is armed".to_owned(), false)]);
            assert_eq!(sent.len(), 1, "no heartbeat that could be taken as confirmation");
            let text: Statustext = sent[0].decode().expect("a text");
            assert_eq!(text.severity, MavSeverity::WARNING);
        }
        rig.run_for(secs(1));
        let heartbeat = &rig.sent::<Heartbeat>(0)[0];
        assert_eq!(heartbeat.is_signed_with(KEY), key.is_some());
        assert_eq!((rig.counters().setups, rig.counters().refused_setups), (0, 2));
        let state = rig.vehicle.state.take();
        rig.receive(0, &unsigned(&setup(OTHER_KEY, NOW)));
        assert_eq!(rig.counters().refused_setups, 3, "in a fault");
        rig.vehicle.state = state;
        rig.transmit(0);
        arm(&mut rig, false);
        rig.receive(0, &unsigned(&setup(OTHER_KEY, NOW)));
        assert_eq!(rig.counters().setups, 1);
    }
}

/// G-11, G-14: once the vehicle has set the time, a key cannot move it more than ten minutes beyond that, also not step by step. A
/// station that knows our time may repeat it, wherever it is.
#[test]
fn key_does_not_set_a_time_far_ahead() {
    let mut rig = rig();
    let now = rig.now;
    assert!(rig.signing().set_time(now, UNIX + 10 * NOW, mavstack::Duration::MAX));
    rig.transmit(0);
    for (timestamp, is_taken) in [
        (NOW + LEAD + 1, false),
        (NOW + 3_650 * LEAD, false),
        (NOW + LEAD, true),
        (NOW + 2 * LEAD, false),
        (NOW + LEAD, true),
        (0, true),
    ] {
        let (before, refused) = (rig.timestamp(), rig.counters().refused_setups);
        rig.receive(0, &unsigned(&setup(KEY, timestamp)));
        let sent = rig.transmit(0);
        assert_eq!(texts(&sent).iter().any(|(text, _)| text == "Signing key set"), is_taken, "{timestamp}");
        if !is_taken {
            assert_eq!(texts(&sent), [("Signing not changed: bad timestamp".to_owned(), false)]);
            assert_eq!(rig.timestamp(), before);
        }
        assert_eq!(rig.counters().refused_setups, refused + u32::from(!is_taken));
    }
    // Ten minutes later the bound is that much later.
    rig.now += secs(600);
    rig.receive(0, &unsigned(&setup(KEY, NOW + 2 * LEAD)));
    assert!(rig.timestamp() >= NOW + 2 * LEAD);
    let now = rig.now;
    rig.signing().set_key(now, SigningKey::new(KEY), NOW + 9 * LEAD);
    rig.transmit(0);
    rig.receive(0, &unsigned(&setup(OTHER_KEY, NOW + 9 * LEAD)));
    assert_eq!(texts(&rig.transmit(0)), [("Signing key set".to_owned(), true)]);
}

/// G-11: a vehicle without the time accepts any, and so does one whose clock was never set.
#[test]
fn key_sets_the_time_of_a_vehicle_without_one() {
    for told in [None, Some(0), Some(946_684_800_000_000)] {
        let mut rig = rig();
        let now = rig.now;
        if let Some(unix_usec) = told {
            assert!(rig.signing().set_time(now, unix_usec, mavstack::Duration::MAX));
        }
        rig.receive(0, &unsigned(&setup(KEY, NOW)));
        assert!(rig.timestamp() >= NOW && rig.signing().is_active(), "{told:?}");
    }
}

/// G-11: on a link without provisioning an accepted SETUP_SIGNING is refused with a text; otherwise it gets no answer.
#[test]
fn key_is_accepted_on_provisioning_links_only() {
    let mut rig = rig();
    rig.transmit(1);
    rig.receive(1, &unsigned(&setup(KEY, NOW)));
    assert_eq!(texts(&rig.transmit(1)), [("Signing not changed: not by this link".to_owned(), false)]);
    assert!(!rig.signing().is_active());
    rig.set_key(KEY);
    rig.receive(1, &unsigned(&setup(OTHER_KEY, NOW)));
    rig.receive(1, &Signer::new(OTHER_KEY).frame(&setup(OTHER_KEY, NOW)));
    assert_eq!(texts(&rig.transmit(1)), []);
    rig.receive(1, &Signer::new(KEY).frame(&setup(OTHER_KEY, NOW)));
    assert_eq!(texts(&rig.transmit(1)), [("Signing not changed: not by this link".to_owned(), false)]);
    assert_eq!((rig.counters().setups, rig.counters().refused_setups), (0, 2));
}

/// A wire that requires signatures accepts the first key unsigned, and each later one only if it is signed with the previous
/// key.
#[test]
fn strict_wire_accepts_the_first_key_unsigned() {
    for accept in [Accept::Required, LinkSigning::SIGNED.accept] {
        let wire = LinkSigning { accept, ..WIRE };
        let mut rig: Rig = Rig::new([LinkConfig::uart(115_200).with_signing(wire); 2]);
        rig.receive(0, &Signer::new(KEY).unsigned(Version::V1, &Gcs::heartbeat()));
        assert_eq!(rig.counters().unsigned, u32::from(accept == Accept::Required));
        rig.receive(0, &unsigned(&setup(KEY, NOW)));
        rig.transmit(0);
        rig.receive(0, &unsigned(&setup(OTHER_KEY, NOW)));
        rig.receive(0, &unsigned(&setup([0; 32], 0)));
        rig.receive(0, &Signer::new(OTHER_KEY).frame(&setup(OTHER_KEY, NOW)));
        assert!(rig.sent::<Statustext>(0).is_empty());
        rig.run_for(secs(1));
        assert!(rig.sent::<Heartbeat>(0)[0].is_signed_with(KEY));
        let now = rig.timestamp();
        rig.receive(0, &Signer::new(KEY).at(now).frame(&setup(OTHER_KEY, NOW)));
        assert!(rig.transmit(0)[0].is_signed_with(OTHER_KEY));
    }
}

/// G-11: the confirmation of a key is signed, also on a link that signs nothing else.
#[test]
fn provisioning_link_signs_the_confirmation() {
    let wire = LinkSigning { sign_out: false, ..WIRE };
    let mut rig: Rig = Rig::new(
        [wire, LinkSigning { provisioning: false, ..wire }]
            .map(|signing| LinkConfig::uart(115_200).with_signing(signing)),
    );
    rig.receive(0, &unsigned(&setup(KEY, NOW)));
    assert!(rig.transmit(0)[0].is_signed_with(KEY));
    assert!(!rig.transmit(1)[0].is_signed());
}

/// A link that requires signatures and has no provisioning does not answer.
#[test]
fn strict_radio_does_not_answer() {
    let mut rig: Rig = Rig::new([LinkConfig::uart(57_600).with_signing(LinkSigning::REQUIRED); 2]);
    rig.transmit(0);
    rig.receive(0, &unsigned(&setup(KEY, NOW)));
    assert_eq!((texts(&rig.transmit(0)), rig.counters().unsigned, rig.counters().refused_setups), (vec![], 1, 0));
}

/// G-12: SETUP_SIGNING applies to the component that it addresses; a broadcast is not accepted.
#[test]
fn key_applies_to_one_component() {
    let mut rig = rig();
    for (target_system, target_component) in [(0, 0), (0, 1), (2, 1), (1, 2), (1, 190), (2, 0)] {
        rig.receive(0, &unsigned(&SetupSigning { target_system, target_component, ..setup(KEY, NOW) }));
    }
    assert!(!rig.signing().is_active());
    let counters = rig.stack.link_counters(LINKS[0]).unwrap();
    assert_eq!((counters.out_of_place, counters.not_ours), (2, 4));
    assert_eq!(rig.vehicle.calls, []);
    assert_eq!(texts(&rig.transmit(0)), []);
}

/// SETUP_SIGNING is never forwarded, whatever its target.
#[test]
fn key_is_not_forwarded() {
    let mut rig = Rig::<2, SignedForwarded>::new(links());
    for link in [0, 1] {
        rig.transmit(link);
    }
    let companion = Address::new(1, 191);
    rig.receive(1, &Signer::new(KEY).of(companion).unsigned(Version::V2, &Gcs::heartbeat()));
    for (target_system, target_component) in [(0, 0), (1, 191), (1, 0), (2, 1), (1, 1)] {
        rig.receive(0, &unsigned(&SetupSigning { target_system, target_component, ..setup(KEY, NOW) }));
    }
    rig.receive(0, &unsigned(&Ping { target_system: 1, target_component: 191, ..Ping::default() }));
    let sent = rig.transmit(1);
    assert!(sent.iter().any(|frame| frame.id() == Ping::ID), "other messages are");
    assert!(sent.iter().all(|frame| frame.id() != SetupSigning::ID));
}

/// a refused frame is forwarded unchanged, and teaches nothing about its sender.
#[test]
fn refused_frame_is_forwarded_unchanged() {
    let mut rig = Rig::<2, SignedForwarded>::new([LinkConfig::uart(115_200).with_signing(LinkSigning::REQUIRED); 2]);
    rig.set_key(KEY);
    for link in [0, 1] {
        rig.transmit(link);
    }
    let mut stranger = Signer::new(OTHER_KEY);
    let mut frames = vec![stranger.frame(&Gcs::heartbeat()), stranger.unsigned(Version::V2, &Gcs::heartbeat())];
    frames.push(Signer::new(KEY).frame(&Gcs::heartbeat()));
    for frame in &frames {
        rig.receive(0, frame);
    }
    let sent: Vec<_> = rig.transmit(1).into_iter().map(|frame| frame.raw).collect();
    for frame in &frames {
        assert!(sent.contains(frame), "unchanged");
    }
    assert_eq!(rig.stack.peers(rig.now).count(), 1);
    // An interruption in the middle of a forwarded frame does not change its signature.
    let frame = stranger.frame(&Ping::default());
    rig.receive(0, &frame);
    rig.begin(1, 5);
    rig.restart(1);
    let sent = rig.transmit(1);
    assert_eq!((sent[0].id(), &sent[1].raw), (Heartbeat::ID, &frame));
}

/// SEC-15: no part of the key remains in the link's buffer, however the bytes were split and whatever preceded them.
#[test]
fn key_is_erased_from_the_buffer() {
    let frame = unsigned(&setup(KEY, NOW));
    for piece in [1, 7, 300] {
        for message in [frame.clone(), [unsigned(&Gcs::heartbeat()), frame.clone()].concat()] {
            let mut rig = rig();
            for bytes in message.chunks(piece) {
                rig.receive(0, bytes);
            }
            assert!(rig.signing().is_active());
            let buffer = rig.stack.receive_buffer(LINKS[0]);
            assert!(KEY.windows(8).all(|part| !buffer.windows(8).any(|bytes| bytes == part)), "pieces of {piece}");
        }
    }
}

/// D-3: while an answer is pending, a second SETUP_SIGNING is dropped for want of room. A backpressured link does not delay
/// other links.
#[test]
fn second_key_is_dropped_while_an_answer_is_pending() {
    let mut rig: Rig = Rig::new([LinkConfig::uart(115_200).with_signing(WIRE); 2]);
    rig.receive(0, &unsigned(&setup(KEY, 1 << 48)));
    rig.receive(0, &unsigned(&setup(KEY, NOW)));
    assert_eq!(rig.stack.link_counters(LINKS[0]).unwrap().no_answer_slot, 1);
    assert!(!rig.signing().is_active());
    rig.receive(1, &unsigned(&setup(OTHER_KEY, NOW)));
    assert_eq!(rig.stack.link_counters(LINKS[1]).unwrap().no_answer_slot, 0);
    let sent = rig.transmit(1);
    assert_eq!(texts(&sent), [("Signing key set".to_owned(), true)], "the answer is sent on the link of the request");
    assert!(sent.iter().all(|frame| frame.is_signed_with(OTHER_KEY)));
    assert_eq!(texts(&rig.transmit(0)), [("Signing not changed: bad timestamp".to_owned(), false)]);
    rig.receive(0, &unsigned(&setup(KEY, NOW)));
    assert!(rig.transmit(0)[0].is_signed_with(KEY));
}

/// A high-latency link accepts no key. Without signing declared, the vehicle does not see SETUP_SIGNING either.
#[test]
fn setup_is_ignored_without_signing_and_over_satellite() {
    let satellite = LinkConfig::uart(1_200).with_class(LinkClass::HighLatency).with_signing(WIRE);
    let mut rig: Rig = Rig::new([satellite, LinkConfig::uart(115_200)]);
    rig.receive(0, &unsigned(&setup(KEY, NOW)));
    assert!(!rig.signing().is_active());
    assert_eq!(rig.stack.link_counters(LINKS[0]).unwrap().out_of_place, 1);
    let mut rig = Rig::<2, Plain>::new([satellite, LinkConfig::uart(115_200)]);
    rig.receive(1, &unsigned(&setup(KEY, NOW)));
    assert_eq!(rig.vehicle.calls, []);
    assert_eq!(rig.stack.link_counters(LINKS[1]).unwrap().out_of_place, 1);
}

/// The firmware can set and clear a key.
#[test]
fn firmware_can_set_a_key() {
    let mut rig = rig();
    let now = rig.now;
    rig.signing().set_key(now, SigningKey::new(KEY), NOW);
    assert!(rig.transmit(1)[0].is_signed_with(KEY));
    rig.signing().clear_key();
    rig.run_for(secs(1));
    assert!(!rig.transmit(1)[0].is_signed());
}

/// G-11, G-10: on an open provisioning wire, an unsigned text tells a station that its key is wrong, at most every ten seconds.
/// Its frames are still dropped, and SETUP_SIGNING is not delayed. Other links send no hint.
#[test]
fn wrong_key_gets_a_hint() {
    const HINT: &str = "Wrong signing key: set it again on this link";
    let mut rig = rig();
    rig.set_key(KEY);
    let mut stale = Signer::new(OTHER_KEY);
    for link in [0, 1] {
        rig.transmit(link);
    }
    rig.run_for(millis(100));
    assert!(rig.stack.next_deadline(rig.now) > rig.now);
    rig.receive(0, &stale.frame(&Ping::default()));
    assert!(rig.stack.next_deadline(rig.now) <= rig.now, "a sleeping firmware is woken");
    let mut hints = Vec::new();
    for tenth in 0..250 {
        for link in [0, 1] {
            rig.receive(link, &stale.frame(&Ping::default()));
            let told = texts(&rig.transmit(link));
            assert!(told.is_empty() || (link == 0 && told == [(HINT.to_owned(), false)]), "{told:?}");
            hints.extend(told.iter().map(|_| tenth));
        }
        rig.run_for(millis(100));
    }
    assert_eq!(hints, [0, 100, 200]);
    assert_eq!((rig.counters().bad_signature, rig.counters().refused_setups), (501, 0));
    assert!(
        rig.stack.peers(rig.now).next().is_none() && rig.vehicle.calls.is_empty(),
        "the frames have no other effect"
    );
    // A hint is pending when the key arrives.
    rig.run_for(secs(10));
    rig.receive(0, &stale.frame(&Ping::default()));
    rig.receive(0, &unsigned(&setup(OTHER_KEY, NOW)));
    assert_eq!(texts(&rig.transmit(0)), [("Signing key set".to_owned(), true)]);
    rig.run_for(secs(10));
    rig.receive(0, &stale.frame(&Gcs::heartbeat()));
    assert_eq!((texts(&rig.transmit(0)), rig.counters().verified), (vec![], 1));
    // Replayed and unsigned frames do not indicate a wrong key.
    stale.timestamp -= 1;
    rig.receive(0, &stale.frame(&Gcs::heartbeat()));
    rig.receive(0, &unsigned(&Gcs::heartbeat()));
    assert_eq!(texts(&rig.transmit(0)), []);
}
