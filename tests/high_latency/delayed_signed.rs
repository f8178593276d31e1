//! Commands that a satellite delays, with signatures: the timestamp says when a command was sent, and so in which control.
//! L-15, L-16, C-12, G-15.

use super::delayed::{DONE, LATER, LINKS, ONCE, RADIO, SAT, START, STOP};
use crate::support::signer::{KEY, NOW, Signer};
use crate::support::*;
use mavstack::config::LinkClass;
use mavstack::dialect::{CommandAck, CommandLong, Heartbeat, HighLatency2, MavCmd, MavResult, SetMode};
use mavstack::high_latency::HighLatencyConfig;
use mavstack::signing::{LinkSigning, SigningKey};
use mavstack::{Address, Duration, Instant, LinkConfig};

/// A second in units of a signing timestamp.
const SECOND: u64 = 100_000;

/// A rig whose vehicle declares the high-latency service.
type Rig<const N: usize = 2> = crate::support::signer::Rig<N, SignedSatellite>;

/// A vehicle that accepts signed frames only, with a radio and a satellite.
fn rig() -> Rig {
    let mut rig = Rig::new(LINKS.map(|link| link.with_signing(LinkSigning::REQUIRED)));
    rig.set_key(KEY);
    rig.stack.high_latency.set_config(HighLatencyConfig::DEFAULT);
    rig.vehicle.outcomes.insert(ONCE.0, DONE.into());
    rig
}

fn long(command: MavCmd, p1: f32) -> CommandLong {
    CommandLong {
        command,
        target_system: 1,
        target_component: 1,
        param1: p1,
        param3: 3.0,
        param4: 0.5,
        ..CommandLong::default()
    }
}

/// The station when the vehicle's clock reads `at`, with its own stream on each link.
fn station(link: usize, at: Duration) -> Signer {
    Signer::new(KEY).link(link as u8).at(NOW + at.as_millis() * (SECOND / 1_000))
}

/// Returns a command frame that the station signed at `at`.
fn sent(link: usize, at: Duration, command: MavCmd, p1: f32) -> Vec<u8> {
    station(link, at).frame(&long(command, p1))
}

fn control(rig: &mut Rig, link: usize, at: Duration, enable: f32) -> (MavResult, bool) {
    answer(rig, link, &sent(link, at, MavCmd::CONTROL_HIGH_LATENCY, enable))
}

fn answer(rig: &mut Rig, link: usize, frame: &[u8]) -> (MavResult, bool) {
    rig.transmit(link);
    rig.receive(link, frame);
    let acks = rig.sent::<CommandAck>(link);
    assert_eq!(acks.len(), 1);
    (acks[0].decode::<CommandAck>().unwrap().result, rig.stack.high_latency.is_on())
}

/// Runs until the vehicle's clock reads `at` since its key was set.
fn until(rig: &mut Rig, at: Duration) {
    let end = Instant::from_millis(5_000) + at;
    rig.run_for(end - rig.now);
}

/// L-16: the vehicle gets the age of a command, in both forms, as soon as it knows the time.
#[test]
fn command_has_an_age() {
    let mut rig = rig();
    until(&mut rig, secs(40));
    // Each frame that the vehicle signs moves its time by one unit.
    let in_seconds = |age: Option<Duration>| age.map(|age| age.as_millis() / 1_000);
    let ages = |rig: &Rig| rig.vehicle.commands().iter().map(|command| command.age).map(in_seconds).collect::<Vec<_>>();
    answer(&mut rig, SAT, &sent(SAT, secs(10), MavCmd::NAV_LAND, 0.0));
    assert_eq!(ages(&rig), [None], "a frame by satellite does not tell the current time");
    answer(&mut rig, RADIO, &sent(RADIO, secs(40), MavCmd::NAV_LAND, 0.0));
    answer(&mut rig, SAT, &sent(SAT, secs(15), MavCmd::NAV_LAND, 0.0));
    assert_eq!(ages(&rig)[1..], [Some(0), Some(25)]);
    // The vehicle's own clock also gives the time.
    let mut rig = self::rig();
    until(&mut rig, secs(40));
    let unix_usec = (1_420_070_400 * SECOND + NOW + 50 * SECOND) * 10;
    let now = rig.now;
    assert!(rig.signing().set_time(now, unix_usec, Duration::MAX));
    answer(&mut rig, SAT, &sent(SAT, secs(20), MavCmd::NAV_LAND, 0.0));
    let command = rig.vehicle.commands()[0];
    assert_eq!((in_seconds(command.age), command.class), (Some(30), LinkClass::HighLatency));
    // Without signature checks there is no age.
    let mut rig = Rig::<2>::new(LINKS);
    rig.receive(SAT, &sent(SAT, secs(0), MavCmd::NAV_LAND, 0.0));
    assert_eq!(ages(&rig), [None]);
    // SET_MODE, which a vehicle without modes gets as a message, has none.
    rig.receive(RADIO, &Signer::new(KEY).frame(&SetMode::default()));
    assert_eq!(rig.vehicle.commands().len(), 1);
}

/// L-15, L-16: a START that was sent before a STOP is superseded, however late it arrives, even if it was never seen and its
/// sender is not alive. A START that was sent after the STOP is carried out at once, even if it looks like a duplicate.
#[test]
fn command_signed_earlier_is_superseded() {
    for late in [20, 300, 890] {
        let mut rig = rig();
        until(&mut rig, secs(10));
        // Makes the stream known.
        answer(&mut rig, SAT, &sent(SAT, secs(9), MavCmd::NAV_LAND, 0.0));
        assert_eq!(control(&mut rig, RADIO, secs(10), STOP), (DONE, false));
        until(&mut rig, secs(10 + late));
        assert_eq!(control(&mut rig, SAT, millis(9_990), START), (LATER, false), "{late} s");
        assert_eq!(control(&mut rig, SAT, millis(10_010), START), (DONE, true), "{late} s");
    }
    let mut rig = rig();
    until(&mut rig, secs(10));
    control(&mut rig, RADIO, secs(8), START);
    control(&mut rig, RADIO, secs(9), STOP);
    assert_eq!(control(&mut rig, SAT, secs(10), START), (DONE, true));
    assert_eq!(control(&mut rig, RADIO, secs(10), START), (DONE, true));
    // The same for a STOP.
    until(&mut rig, secs(20));
    assert_eq!(control(&mut rig, SAT, millis(10_001), STOP), (DONE, false), "it was signed after the START");
    control(&mut rig, RADIO, secs(20), START);
    assert_eq!(control(&mut rig, SAT, secs(19), STOP), (LATER, true));
}

/// After a quarter of an hour nothing is superseded: a wrong clock must not block a START forever.
#[test]
fn superseding_ends_after_15_minutes() {
    let mut rig = rig();
    until(&mut rig, secs(10));
    answer(&mut rig, SAT, &sent(SAT, secs(5), MavCmd::NAV_LAND, 0.0));
    control(&mut rig, RADIO, secs(10), STOP);
    until(&mut rig, secs(911));
    assert_eq!(control(&mut rig, SAT, secs(9), START), (DONE, true));
}

/// C-12: a duplicate has the timestamp of its original. A command that was signed later is new, even within the minute.
#[test]
fn duplicate_has_the_timestamp_of_its_original() {
    let mut rig = rig();
    until(&mut rig, secs(10));
    answer(&mut rig, RADIO, &sent(RADIO, secs(10), ONCE, 1.0));
    until(&mut rig, secs(40));
    assert_eq!(answer(&mut rig, SAT, &sent(SAT, secs(10), ONCE, 1.0)).0, DONE, "a known duplicate");
    assert_eq!(rig.vehicle.commands().len(), 1);
    let mut rig = self::rig();
    until(&mut rig, secs(10));
    answer(&mut rig, RADIO, &sent(RADIO, secs(10), ONCE, 1.0));
    until(&mut rig, secs(40));
    answer(&mut rig, SAT, &sent(SAT, secs(20), ONCE, 1.0));
    assert_eq!(rig.vehicle.commands().len(), 2);
    // Signed before the command by radio: it is neither carried out nor answered as done.
    assert_eq!(answer(&mut rig, RADIO, &sent(RADIO, secs(44), ONCE, 2.0)).0, DONE);
    until(&mut rig, secs(50));
    assert_eq!(answer(&mut rig, SAT, &sent(SAT, secs(30), ONCE, 2.0)).0, LATER);
    assert_eq!(rig.vehicle.commands().len(), 3);
}

/// C-12: a retransmission is signed later than its original, and is recognised for as long as a satellite may take.
#[test]
fn retransmission_is_signed_later() {
    let mut rig = rig();
    until(&mut rig, secs(10));
    assert_eq!(answer(&mut rig, SAT, &sent(SAT, secs(10), ONCE, 1.0)).0, DONE);
    until(&mut rig, secs(40));
    let again = |confirmation| CommandLong { confirmation, ..long(ONCE, 1.0) };
    assert_eq!(answer(&mut rig, SAT, &station(SAT, secs(25)).frame(&again(1))).0, DONE);
    assert_eq!(rig.vehicle.commands().len(), 1);
    // Without a higher confirmation it is a new command.
    assert_eq!(answer(&mut rig, SAT, &station(SAT, secs(30)).frame(&again(0))).0, DONE);
    assert_eq!(rig.vehicle.commands().len(), 2);
}

/// Sets the vehicle's clock forward by `ahead`.
fn jump(rig: &mut Rig, at: Duration, ahead: Duration) {
    let now = rig.now;
    let unix_usec = (1_420_070_400 * SECOND + NOW) * 10 + at.as_micros() + ahead.as_micros();
    assert!(rig.signing().set_time(now, unix_usec, Duration::MAX));
}

/// L-15: a command by radio is current, whatever the clocks of the vehicle and the sender say.
#[test]
fn command_by_radio_is_never_superseded() {
    for at in [30, 60, 300, 600] {
        let mut rig = rig();
        until(&mut rig, secs(10));
        assert_eq!(control(&mut rig, RADIO, secs(10), START), (DONE, true));
        until(&mut rig, secs(20));
        jump(&mut rig, secs(20), secs(600));
        until(&mut rig, secs(at));
        assert_eq!(control(&mut rig, RADIO, secs(at), STOP), (DONE, false), "{at} s");
    }
    // The sender's clock was set back.
    let mut rig = rig();
    until(&mut rig, secs(50));
    assert_eq!(control(&mut rig, SAT, secs(50), START), (DONE, true));
    until(&mut rig, secs(55));
    assert_eq!(control(&mut rig, RADIO, secs(20), STOP), (DONE, false));
}

/// C-12: a duplicate on another radio is received within three seconds. A later one is a new command and sends a message, even
/// if its timestamp equals the first one's. It is sent ten seconds after the first (L-17).
#[test]
fn duplicate_on_another_radio_is_received_within_3_s() {
    for (wait, messages) in [(2, 1), (4, 2)] {
        let [radio, satellite] = LINKS.map(|link| link.with_signing(LinkSigning::REQUIRED));
        let mut rig = Rig::new([radio, satellite, radio]);
        rig.set_key(KEY);
        rig.stack.high_latency.set_config(HighLatencyConfig::DEFAULT);
        rig.run_for(secs(10));
        rig.receive(RADIO, &sent(RADIO, secs(10), MavCmd::CONTROL_HIGH_LATENCY, START));
        assert_eq!(rig.sent::<HighLatency2>(SAT).len(), 1);
        rig.run_for(secs(wait));
        rig.receive(2, &sent(2, secs(10), MavCmd::CONTROL_HIGH_LATENCY, START));
        rig.run_for(secs(10));
        assert_eq!(1 + rig.sent::<HighLatency2>(SAT).len(), messages, "{wait} s");
    }
}

/// L-16: the control of a sender's own timestamps decides. Another peer's clock that is ahead does not matter.
#[test]
fn clock_of_another_peer_supersedes_nothing() {
    for at in [70, 120, 300] {
        let mut rig = rig();
        until(&mut rig, secs(10));
        assert_eq!(control(&mut rig, RADIO, secs(10), STOP), (DONE, false));
        answer(&mut rig, SAT, &sent(SAT, secs(9), MavCmd::NAV_LAND, 0.0));
        until(&mut rig, secs(20));
        let mut companion = Signer::new(KEY).of(Address::new(1, 191)).at(NOW + 320 * SECOND);
        rig.receive(RADIO, &companion.frame(&Heartbeat::default()));
        until(&mut rig, secs(at));
        assert_eq!(control(&mut rig, SAT, millis(9_500), START), (LATER, false), "{at} s");
        assert_eq!(control(&mut rig, SAT, secs(at), START), (DONE, true), "{at} s");
        // A delayed command changes neither the state nor what is known about the sender.
        until(&mut rig, secs(at + 20));
        assert_eq!(control(&mut rig, RADIO, secs(at + 20), STOP), (DONE, false));
        assert_eq!(control(&mut rig, RADIO, secs(at + 21), START), (DONE, true));
        assert_eq!(control(&mut rig, SAT, secs(at + 10), START), (DONE, true));
        assert_eq!(control(&mut rig, SAT, secs(at + 20), STOP), (LATER, true));
    }
}

/// C-12: a command on two radios, half a minute apart, is carried out twice, whatever the vehicle's clock does meanwhile.
#[test]
fn command_half_a_minute_later_on_another_radio_is_new() {
    for ahead in [0, 50] {
        let radio = LinkConfig::uart(57_600).with_signing(LinkSigning::REQUIRED);
        let mut rig = Rig::new([radio; 2]);
        rig.set_key(KEY);
        rig.vehicle.outcomes.insert(ONCE.0, DONE.into());
        until(&mut rig, secs(10));
        rig.receive(0, &sent(0, secs(10), ONCE, 1.0));
        // The sender's clocks differ between the links.
        rig.receive(1, &sent(1, secs(14), ONCE, 1.0));
        assert_eq!(rig.vehicle.commands().len(), 1, "a duplicate");
        jump(&mut rig, secs(10), secs(ahead));
        until(&mut rig, secs(40));
        rig.receive(1, &sent(1, secs(40), ONCE, 1.0));
        assert_eq!(rig.vehicle.commands().len(), 2, "{ahead} s");
    }
}

/// L-16, G-15: after a restart the vehicle's clock is up to a minute ahead, which makes no command older. The vehicle's own
/// clock takes precedence; until it is set, peers on the radio provide the time.
#[test]
fn reserved_time_makes_no_command_old() {
    let land = |at: u64| sent(RADIO, secs(at), MavCmd::NAV_LAND, 0.0);
    let age = |rig: &mut Rig, at: u64| {
        rig.transmit(RADIO);
        rig.receive(RADIO, &land(at));
        rig.vehicle.commands().last().and_then(|command| command.age)
    };
    let mut rig = rig();
    let now = rig.now;
    rig.signing().set_key(now, SigningKey::new(KEY), NOW + 55 * SECOND);
    until(&mut rig, secs(10));
    assert_eq!(age(&mut rig, 10), Some(Duration::ZERO));
    until(&mut rig, secs(14));
    assert_eq!(age(&mut rig, 12), Some(secs(2)));
    jump(&mut rig, secs(14), secs(1));
    assert_eq!(age(&mut rig, 13), Some(secs(2)));
    // A clock that is set back does not reduce an age (G-14), and a peer that is ahead no longer counts.
    jump(&mut rig, secs(14), Duration::ZERO);
    assert_eq!(age(&mut rig, 20), Some(Duration::ZERO));
    until(&mut rig, secs(24));
    assert_eq!(age(&mut rig, 21), Some(secs(4)));
}
