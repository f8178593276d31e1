//! Wrong clocks: a frame from far ahead, the end of the 48-bit timestamps, and a vehicle's clock that is set back. Rules G-4,
//! G-6, G-14, G-17, L-16.

use crate::support::signer::*;
use crate::support::*;
use mavstack::config::LinkClass;
use mavstack::dialect::*;
use mavstack::frame::Version;
use mavstack::message::Secret;
use mavstack::signing::{LinkSigning, SigningKey};
use mavstack::{Address, Duration, LinkConfig, Message};

/// A minute, how far ahead a clock may be, an hour and a year, in units of a timestamp.
const MINUTE: u64 = 6_000_000;
const LEAD: u64 = 10 * MINUTE;
const HOUR: u64 = 60 * MINUTE;
const YEAR: u64 = 365 * 24 * HOUR;
const LAST: u64 = (1 << 48) - 1;

/// A vehicle with a key, an open wire, a radio that requires signatures, and a satellite link.
fn rig() -> Rig<3> {
    let link = LinkConfig::uart(115_200);
    let mut rig = Rig::new([
        link.with_signing(LinkSigning::OPEN),
        link.with_signing(LinkSigning::REQUIRED),
        link.with_signing(LinkSigning::REQUIRED).with_class(LinkClass::HighLatency),
    ]);
    rig.set_key(KEY);
    rig
}

const WIRE: usize = 0;
const RADIO: usize = 1;
const SAT: usize = 2;

/// Sets the vehicle's time from its own clock.
fn tell(rig: &mut Rig<3>, timestamp: u64) {
    let (now, unix) = (rig.now, 1_420_070_400_000_000);
    assert!(rig.signing().set_time(now, unix + 10 * timestamp, Duration::MAX));
}

fn command() -> CommandLong {
    CommandLong { target_system: 1, target_component: 1, command: MavCmd::NAV_LAND, ..CommandLong::default() }
}

/// Returns whether a new station whose clock reads `timestamp` is accepted.
fn hears(rig: &mut Rig<3>, station: u8, timestamp: u64) -> bool {
    let (commands, verified) = (rig.vehicle.commands().len(), rig.counters().verified);
    rig.receive(RADIO, &Signer::new(KEY).of(Address::new(station, 190)).at(timestamp).frame(&command()));
    rig.transmit(RADIO);
    let is_heard = rig.vehicle.commands().len() > commands;
    assert_eq!(rig.counters().verified > verified, is_heard);
    is_heard
}

/// G-17: once the vehicle has set the time, a frame from more than ten minutes ahead is refused, counted, and does not move our
/// time. That also holds on an open wire, and in steps of ten minutes. Peers with right clocks are still accepted.
#[test]
fn wrong_clock_of_a_peer_locks_out_no_other() {
    let mut rig = rig();
    tell(&mut rig, NOW);
    for (n, ahead) in [LEAD + 1, 14 * YEAR, LAST - NOW].into_iter().enumerate() {
        let before = rig.timestamp();
        assert!(!hears(&mut rig, 10, NOW + ahead));
        rig.receive(WIRE, &Signer::new(KEY).at(NOW + ahead).frame(&command()));
        assert_eq!(rig.vehicle.commands().len(), n);
        assert!(rig.timestamp() < before + 100, "our time does not move");
        assert_eq!(rig.counters().too_far_ahead, 2 * (n as u32 + 1));
        assert!(hears(&mut rig, 20 + n as u8, NOW), "a right clock");
    }
    assert!(hears(&mut rig, 11, NOW + LEAD), "wrong, but within ten minutes");
    assert!(!hears(&mut rig, 12, NOW + 2 * LEAD));
    // Ten minutes later the bound is that much later too, although the vehicle has not set the time since.
    rig.now += secs(600);
    assert!(hears(&mut rig, 12, NOW + 2 * LEAD));
}

/// G-17: before the vehicle has set the time there is no bound. Another key undoes the effect of a wrong clock, and once the
/// time is right the bound applies.
#[test]
fn another_key_undoes_the_effect_of_a_wrong_clock() {
    for is_told in [false, true] {
        let mut rig = rig();
        assert!(hears(&mut rig, 10, NOW + 14 * YEAR), "as after a year without power");
        if is_told {
            tell(&mut rig, NOW);
        }
        assert_eq!(hears(&mut rig, 20, NOW), is_told, "locked out until the vehicle knows the time");
        // A peer that follows our time is accepted; otherwise no peer would be.
        let ours = rig.timestamp();
        assert!(hears(&mut rig, 21, ours + 100));
        let now = rig.now;
        rig.signing().set_key(now, SigningKey::new(KEY), NOW);
        assert!(!hears(&mut rig, 20, NOW), "the same key");
        rig.signing().set_key(now, SigningKey::new(OTHER_KEY), NOW);
        rig.signing().set_key(now, SigningKey::new(KEY), NOW);
        assert!(hears(&mut rig, 20, NOW));
        assert_eq!(hears(&mut rig, 10, NOW + 14 * YEAR), !is_told);
    }
}

/// Returns the texts of a link about clocks.
fn texts(rig: &mut Rig<3>, link: usize) -> Vec<String> {
    rig.run_for(millis(100));
    let texts = rig.sent::<Statustext>(link).into_iter().filter_map(|frame| frame.decode::<Statustext>());
    texts.map(|text| text.text.as_str().unwrap().to_owned()).collect()
}

/// G-17: a tablet whose clock is 23 hours ahead, for a wrong time zone, locks out no right clock once the vehicle has told the
/// time: neither if the tablet was heard before, nor if it is heard after. From then on it is refused, and a text names it, at
/// most every ten seconds.
#[test]
fn clock_in_another_time_zone_locks_out_no_right_one() {
    for heard_before in [false, true] {
        let mut rig = rig();
        if heard_before {
            assert!(hears(&mut rig, 200, NOW + 23 * HOUR));
            assert!(!hears(&mut rig, 20, NOW), "there is no better time yet");
        }
        tell(&mut rig, NOW);
        let sent = rig.timestamp();
        assert!(hears(&mut rig, 21, NOW), "a right clock");
        assert!(rig.timestamp() >= sent, "our own time does not go back");
        // A peer that follows our time is accepted; otherwise no peer would be.
        if heard_before {
            assert!(hears(&mut rig, 201, NOW + 23 * HOUR));
        } else {
            let expected = ["System 201 refused: its clock is too far ahead"];
            for second in 0..=10 {
                rig.receive(
                    RADIO,
                    &Signer::new(KEY).of(Address::new(201, 190)).at(NOW + 23 * HOUR + second).frame(&command()),
                );
                let expected = if second % 10 == 0 { &expected[..] } else { &[] };
                for link in [RADIO, WIRE] {
                    assert_eq!(texts(&mut rig, link), expected, "{second} s");
                }
                rig.run_for(millis(800));
            }
            assert_eq!(rig.counters().too_far_ahead, 11);
        }
        assert!(hears(&mut rig, 22, NOW + 2 * MINUTE), "another right clock");
    }
}

/// G-6, G-17: once the vehicle has told the time, a new stream begins at most a minute behind *that* time, whatever peers have
/// sent, and a known stream stays where it was.
#[test]
fn window_for_new_streams_rests_on_the_time_of_the_vehicle() {
    let mut rig = rig();
    tell(&mut rig, NOW);
    assert!(hears(&mut rig, 10, NOW + 9 * MINUTE));
    assert!(rig.timestamp() >= NOW + 9 * MINUTE, "our stamps are no earlier");
    assert!(hears(&mut rig, 11, NOW - MINUTE + 10_000) && !hears(&mut rig, 12, NOW - MINUTE - 1));
    assert!(!hears(&mut rig, 10, NOW + 9 * MINUTE - 1), "its own stream goes on");
    assert_eq!((rig.counters().too_old, rig.counters().replayed), (1, 1));
}

/// G-6, G-17: a firmware that refuses recorded frames refuses all that it has accepted, of peers whose clocks are ahead too. Only a
/// clock that is further ahead than the bound does not count: it would lock out the right ones.
#[test]
fn recorded_frames_of_a_clock_that_is_ahead_are_refused() {
    for (ahead, is_heard) in [(9 * MINUTE, false), (23 * HOUR, true)] {
        // Our time as it was stored before a restart.
        let mut rig = rig();
        let now = rig.now;
        rig.signing().set_key(now, SigningKey::new(KEY), NOW + ahead);
        tell(&mut rig, NOW);
        rig.signing().refuse_recorded(now);
        assert!(is_heard || !hears(&mut rig, 10, NOW + ahead - 10), "recorded");
        assert!(!hears(&mut rig, 11, NOW - 1), "recorded");
        assert_eq!(hears(&mut rig, 12, NOW + 10_000), is_heard, "a right clock that does not follow our time");
        let ours = rig.timestamp();
        assert!(hears(&mut rig, 13, ours + 1), "one that does");
    }
}

/// G-6, G-17: a tablet was 23 hours ahead before the vehicle knew the time. What it signed earlier, hours ago, does not begin a
/// stream again.
#[test]
fn recorded_frames_from_beyond_the_bound_begin_no_stream() {
    let mut rig = rig();
    assert!(hears(&mut rig, 200, NOW + 23 * HOUR));
    tell(&mut rig, NOW);
    for ahead in [LEAD + MINUTE, 18 * HOUR, 23 * HOUR - 2 * MINUTE] {
        let too_old = rig.counters().too_old;
        assert!(!hears(&mut rig, 201, NOW + ahead), "{ahead}");
        assert_eq!(rig.counters().too_old, too_old + 1);
    }
    assert!(hears(&mut rig, 20, NOW) && hears(&mut rig, 21, NOW + LEAD), "clocks that are right, or nearly so");
    let ours = rig.timestamp();
    assert!(hears(&mut rig, 22, ours), "a peer that follows our time");
}

/// G-17: how far ahead a clock may be is a setting.
#[test]
fn bound_on_the_future_is_a_setting() {
    let mut rig = rig();
    let link = LinkConfig::uart(115_200).with_signing(LinkSigning::REQUIRED);
    let config = mavstack::Config { max_signing_lead: secs(3_600), ..Setup::<1>::new().config };
    rig.stack = begun(config, [link; 3]);
    rig.set_key(KEY);
    tell(&mut rig, NOW);
    assert!(hears(&mut rig, 10, NOW + HOUR) && !hears(&mut rig, 11, NOW + HOUR + MINUTE));
}

/// G-17: a vehicle whose clock is years behind, and that has stored no time, refuses stations with right clocks, and their
/// keys. Setting the right time ends that, and so does a restart.
#[test]
fn clock_that_is_far_behind_refuses_right_clocks() {
    let link = LinkConfig::uart(115_200);
    let wire = LinkSigning::OPEN.with_provisioning();
    let new_vehicle = || Rig::<3>::new([link.with_signing(wire), link.with_signing(LinkSigning::REQUIRED), link]);
    let set_up = |rig: &mut Rig<3>, secret_key| {
        let initial_timestamp = NOW;
        let setup =
            SetupSigning { initial_timestamp, target_system: 1, target_component: 1, secret_key: Secret(secret_key) };
        let setups = rig.counters().setups;
        rig.receive(WIRE, &Signer::new(KEY).unsigned(Version::V2, &setup));
        rig.transmit(WIRE);
        rig.counters().setups > setups
    };
    let mut rig = new_vehicle();
    let now = rig.now;
    rig.signing().set_key(now, SigningKey::new(KEY), 0);
    tell(&mut rig, NOW - 10 * YEAR);
    assert!(!hears(&mut rig, 10, NOW) && hears(&mut rig, 11, NOW - 10 * YEAR));
    assert!(!set_up(&mut rig, OTHER_KEY));
    assert_eq!((rig.counters().too_far_ahead, rig.counters().refused_setups), (1, 1));
    // The right time is years ahead of ours too.
    let unix = 1_420_070_400_000_000 + 10 * NOW;
    assert!(!rig.signing().set_time(now, unix, secs(7 * 86_400)));
    assert!(!hears(&mut rig, 10, NOW));
    tell(&mut rig, NOW);
    assert!(hears(&mut rig, 10, NOW) && set_up(&mut rig, OTHER_KEY));
    // After a restart no time is set.
    let mut rig = new_vehicle();
    let now = rig.now;
    rig.signing().set_key(now, SigningKey::new(KEY), NOW - 10 * YEAR);
    assert!(hears(&mut rig, 10, NOW) && set_up(&mut rig, OTHER_KEY));
}

/// G-17: the bound does not apply while our own time is beyond it.
#[test]
fn bound_does_not_apply_behind_our_own_time() {
    let mut rig = rig();
    tell(&mut rig, NOW - 10 * YEAR);
    assert!(hears(&mut rig, 10, NOW + 10) && hears(&mut rig, 11, NOW + YEAR));
    assert_eq!(rig.counters().too_far_ahead, 0);
}

/// G-4, G-17: the last 48-bit timestamp is always refused. After the one before it we sign one more frame. Further frames are
/// unsigned instead of repeating a timestamp, until another key is set.
#[test]
fn last_timestamp_is_not_repeated() {
    let mut rig = rig();
    assert!(!hears(&mut rig, 10, LAST));
    assert_eq!((rig.counters().too_far_ahead, rig.timestamp() < LAST), (1, true));
    assert!(hears(&mut rig, 10, LAST - 1));
    let mut stamps = Vec::new();
    let mut unsigned = 0;
    for _ in 0..5 {
        rig.receive(WIRE, &Signer::new(KEY).unsigned(Version::V2, &command()));
        let frames: Vec<_> = [WIRE, RADIO].into_iter().flat_map(|link| rig.transmit(link)).collect();
        assert!(frames.iter().any(|frame| frame.id() == CommandAck::ID), "no answer is lost");
        for frame in frames {
            if frame.is_signed() {
                stamps.push(frame.signature().timestamp);
            } else {
                unsigned += 1;
            }
        }
        rig.run_for(secs(1));
    }
    assert!(stamps.len() <= 1 && stamps.iter().all(|stamp| *stamp == LAST), "{stamps:?}");
    assert!(unsigned >= 10);
    assert_eq!(rig.timestamp(), LAST);
    let now = rig.now;
    rig.signing().set_key(now, SigningKey::new(KEY), LAST);
    rig.run_for(secs(1));
    assert!(!rig.transmit(RADIO)[0].is_signed(), "the same key");
    let now = rig.now;
    rig.signing().set_key(now, SigningKey::new(OTHER_KEY), NOW);
    rig.run_for(secs(1));
    assert!(rig.transmit(RADIO).iter().all(|frame| frame.is_signed_with(OTHER_KEY)));
}

/// G-4: a frame that is interrupted after the last timestamp was used is dropped, not signed with it again.
#[test]
fn interrupted_frame_without_a_timestamp_is_dropped() {
    let mut rig = rig();
    rig.transmit(RADIO);
    rig.receive(RADIO, &Signer::new(KEY).at(LAST - 1).frame(&command()));
    rig.begin(RADIO, 5);
    rig.restart(RADIO);
    rig.run_for(secs(1));
    assert!(rig.transmit(RADIO).iter().all(|frame| frame.id() != CommandAck::ID && !frame.is_signed()));
}

/// Returns the age of a satellite command that was signed at `timestamp`.
fn age(rig: &mut Rig<3>, timestamp: u64) -> Option<u64> {
    let before = rig.vehicle.commands().len();
    rig.receive(SAT, &Signer::new(KEY).link(SAT as u8).at(timestamp).frame(&command()));
    rig.transmit(SAT);
    assert_eq!(rig.vehicle.commands().len(), before + 1, "carried out");
    rig.vehicle.commands()[before].age.map(|age| age.as_millis() / 1_000)
}

/// L-16, G-14: a clock that is set back, by minutes or years, does not reduce a command's age. A clock that is set forward
/// increases it, and earlier times after that have no effect.
#[test]
fn clock_that_is_set_back_does_not_reduce_an_age() {
    let mut rig = rig();
    assert_eq!(age(&mut rig, NOW), None, "the time is not known");
    tell(&mut rig, NOW + 10 * MINUTE);
    assert_eq!(age(&mut rig, NOW + 1), Some(599));
    for back in [NOW + 10 * MINUTE - 1, NOW + MINUTE, NOW - 1, NOW - 9 * YEAR, 1] {
        tell(&mut rig, back);
        assert_eq!(age(&mut rig, NOW + 2), Some(599), "{back}");
        rig = self::rig();
        age(&mut rig, NOW);
        tell(&mut rig, NOW + 10 * MINUTE);
    }
    tell(&mut rig, NOW + 20 * MINUTE);
    tell(&mut rig, NOW - 9 * YEAR);
    rig.now += secs(60);
    assert_eq!(age(&mut rig, NOW + 2), Some(1_259));
}

/// L-16, G-17: before the vehicle has set the time, a peer on a radio provides it. A vehicle's clock that is a little behind
/// the peer is trusted. One that was never set is not: it neither reduces a command's age nor refuses peers with a right clock.
#[test]
fn first_time_that_is_years_behind_is_not_trusted() {
    for (told, expected) in [(NOW + 9 * MINUTE, 540), (NOW - 9 * YEAR, 600), (1, 600)] {
        let mut rig = rig();
        age(&mut rig, NOW);
        assert!(hears(&mut rig, 10, NOW + 10 * MINUTE));
        assert_eq!(age(&mut rig, NOW + 1), Some(599));
        tell(&mut rig, told);
        assert_eq!(age(&mut rig, NOW + 2).map(|age| age + 1), Some(expected));
        let ours = rig.timestamp();
        assert!(hears(&mut rig, 11, ours + 1_000));
    }
}
