//! Forwarding of frames that their own link refused: rules, G-9. Accepted frames are in `forwarding.rs`.

use crate::support::signer::{KEY, NOW, OTHER_KEY, Signer};
use crate::support::tested::{Forwards, Options};
use crate::support::*;
use mavstack::__private::NoPlans;
use mavstack::config::LinkClass;
use mavstack::dialect::*;
use mavstack::frame::Version;
use mavstack::network::ForwardCounters;
use mavstack::signing::{Accept, LinkSigning};
use mavstack::{Address, LinkConfig, LinkId, Message};

/// A rig whose vehicle forwards.
type Rig<O = SignedForwarded> = crate::support::signer::Rig<4, O>;

/// Services with forwarding.
trait WithForwarding: Options<Tested<NoPlans, 8, Self>, Forwarding = Forwards> + Sized + 'static {}

impl WithForwarding for SignedForwarded {}
impl WithForwarding for Forwarded {}

/// Requires signatures.
const RADIO: usize = 0;
/// Accepts unsigned frames, as the other links do.
const WIRE: usize = 1;
const OTHER_WIRE: usize = 2;
const SATELLITE: usize = 3;

const COMPANION: Address = Address::new(1, 191);
const GIMBAL: Address = Address::new(1, 154);
const WINGMAN: Address = Address::new(2, 1);

/// By their configuration, the wires get the frames that the radio refused.
fn rig() -> Rig {
    rig_with(LinkConfig::unlimited().with_refused_frames(true))
}

/// The wires have the configuration `open`.
fn rig_with(open: LinkConfig) -> Rig {
    let mut rig: Rig =
        Rig::new([open.with_signing(LinkSigning::REQUIRED), open, open, open.with_class(LinkClass::HighLatency)]);
    rig.set_key(KEY);
    sent_on(&mut rig, &[]);
    rig
}

/// Returns the links that a frame is sent on now, once per time.
fn sent_on<O: WithForwarding>(rig: &mut Rig<O>, frame: &[u8]) -> Vec<usize> {
    let sent = |rig: &mut Rig<O>, link| rig.transmit(link).iter().filter(|sent| sent.raw == frame).count();
    (0..4).flat_map(|link| vec![link; sent(rig, link)]).collect()
}

/// Receives a frame and returns the links that it is forwarded to.
fn passes<O: WithForwarding>(rig: &mut Rig<O>, link: usize, frame: &[u8]) -> Vec<usize> {
    rig.receive(link, frame);
    sent_on(rig, frame)
}

fn forwarded<O: WithForwarding>(rig: &Rig<O>, link: usize) -> ForwardCounters {
    rig.stack.forward_counters(LinkId(link as u8)).unwrap()
}

/// a refused frame that is identical to a later accepted one suppresses nothing: the accepted frame is handled,
/// teaches its route, and is forwarded everywhere.
#[test]
fn refused_frame_does_not_suppress_an_accepted_one() {
    let mut rig = rig();
    let mut companion = Signer::new(KEY).of(COMPANION);
    let mut gimbal = Signer::new(KEY).of(GIMBAL);
    rig.receive(OTHER_WIRE, &gimbal.unsigned(Version::V2, &Gcs::heartbeat()));
    sent_on(&mut rig, &[]);
    // The companion was not heard before.
    let hello = companion.unsigned(Version::V2, &Gcs::heartbeat());
    assert_eq!(passes(&mut rig, RADIO, &hello), [WIRE, OTHER_WIRE]);
    assert!(rig.stack.peers(rig.now).all(|info| info.peer.address != COMPANION));
    assert_eq!(passes(&mut rig, WIRE, &hello), [RADIO, OTHER_WIRE]);
    assert!(rig.stack.peers(rig.now).any(|info| info.peer.address == COMPANION && info.is_alive));
    // To all components of the vehicle.
    let long = CommandLong { command: MavCmd::NAV_LAND, target_system: 1, ..CommandLong::default() };
    let command = companion.unsigned(Version::V2, &long);
    assert_eq!(passes(&mut rig, RADIO, &command), [OTHER_WIRE]);
    assert_eq!(rig.vehicle.commands().len(), 0);
    assert_eq!(passes(&mut rig, WIRE, &command), [OTHER_WIRE], "to the gimbal");
    assert_eq!(rig.vehicle.commands().len(), 1);
    // From now on it is a duplicate, on any link.
    for link in [WIRE, RADIO, OTHER_WIRE] {
        assert_eq!(passes(&mut rig, link, &command), [0; 0]);
        assert_eq!(forwarded(&rig, link).duplicates, 1);
    }
    assert_eq!(rig.vehicle.commands().len(), 1);
}

/// an unsigned command from a link that requires signatures is not forwarded to an open wire, whatever its target, so it
/// cannot return to us on a second wire. It is counted on each link that does not get it, and suppresses nothing.
#[test]
fn refused_frames_are_not_forwarded_to_open_links() {
    let mut rig = rig_with(LinkConfig::unlimited());
    let mut companion = Signer::new(KEY).of(COMPANION);
    let mut station = Signer::new(KEY);
    rig.receive(WIRE, &companion.unsigned(Version::V2, &Gcs::heartbeat()));
    sent_on(&mut rig, &[]);
    let arm = |target: Address| CommandLong {
        command: MavCmd::COMPONENT_ARM_DISARM,
        param1: 1.0,
        target_system: target.system.wire(),
        target_component: target.component.wire(),
        ..CommandLong::default()
    };
    let mut held_back = 0;
    for (target, wires) in
        [(COMPANION, vec![WIRE]), (Address::new(1, 0), vec![WIRE]), (Address::new(0, 0), vec![WIRE, OTHER_WIRE])]
    {
        let refused = station.unsigned(Version::V2, &arm(target));
        for _ in 0..2 {
            assert_eq!(passes(&mut rig, RADIO, &refused), [0; 0], "for {target:?}");
            held_back += 1;
            assert_eq!(forwarded(&rig, WIRE).not_accepted, held_back);
        }
        // A frame signed with another key is treated the same.
        let foreign = Signer::new(OTHER_KEY).frame(&arm(target));
        assert_eq!(passes(&mut rig, RADIO, &foreign), [0; 0], "for {target:?}");
        held_back += 1;
        assert!(rig.vehicle.commands().is_empty());
        assert_eq!(passes(&mut rig, RADIO, &station.frame(&arm(target))), wires, "a signed one");
        rig.vehicle.calls.clear();
    }
    assert_eq!([RADIO, WIRE, OTHER_WIRE].map(|link| forwarded(&rig, link).not_accepted), [0, 9, 3]);
    assert_eq!([RADIO, WIRE, OTHER_WIRE].map(|link| forwarded(&rig, link).duplicates), [0; 3]);
    // The same bytes on a link that accepts them are forwarded, and are remembered from then on.
    let late = station.unsigned(Version::V2, &arm(Address::new(0, 0)));
    assert_eq!(passes(&mut rig, RADIO, &late), [0; 0]);
    assert_eq!(passes(&mut rig, OTHER_WIRE, &late), [WIRE]);
    assert_eq!(rig.vehicle.commands().len(), 1);
    assert_eq!(passes(&mut rig, WIRE, &late), [0; 0]);
    assert_eq!(rig.vehicle.commands().len(), 1);
}

/// An unsigned command to arm all vehicles in reach.
fn arm_all() -> CommandLong {
    CommandLong { command: MavCmd::COMPONENT_ARM_DISARM, param1: 1.0, ..CommandLong::default() }
}

/// A vehicle that forwards between these links and has no key yet.
fn rig_without_key<O: WithForwarding>(links: [LinkConfig; 4]) -> Rig<O> {
    let mut rig = Rig::new(links);
    sent_on(&mut rig, &[]);
    rig
}

/// a vehicle without a key carries out unsigned commands on a signed link, so such a link gets no frame that a link with
/// required signatures refused. With a key, the link verifies the frame itself and gets it; a returning frame is refused again.
#[test]
fn signed_link_gets_refused_frames_only_while_there_is_a_key() {
    fn without_key<O: WithForwarding>(signed: LinkConfig, declares_signing: bool) {
        for second in [signed, LinkConfig::unlimited()] {
            let mut rig: Rig<O> = rig_without_key([signed.with_signing(LinkSigning::REQUIRED), signed, second, signed]);
            let mut station = Signer::new(KEY);
            // Without a key no signature can be verified either.
            for refused in [station.unsigned(Version::V2, &arm_all()), station.frame(&arm_all())] {
                // What one link gets could return on any other.
                let sent = passes(&mut rig, RADIO, &refused);
                (0..4).filter(|link| !sent.is_empty() && *link != sent[0]).for_each(|link| rig.receive(link, &refused));
                assert_eq!((rig.vehicle.commands().len(), sent), (0, vec![]), "declares signing: {declares_signing}");
            }
            assert_eq!([1, 2, 3].map(|link| forwarded(&rig, link).not_accepted), [2; 3]);
        }
    }
    let signed = LinkConfig::unlimited().with_signing(LinkSigning::SIGNED);
    without_key::<SignedForwarded>(signed, true);
    without_key::<Forwarded>(signed, false);
    let mut rig: Rig = rig_without_key([signed.with_signing(LinkSigning::REQUIRED), signed, signed, signed]);
    let mut station = Signer::new(KEY);
    rig.set_key(KEY);
    let refused = station.unsigned(Version::V2, &arm_all());
    assert_eq!(passes(&mut rig, RADIO, &refused), [WIRE, OTHER_WIRE, 3]);
    for link in [WIRE, OTHER_WIRE, 3] {
        assert_eq!(passes(&mut rig, link, &refused), [0; 0]);
    }
    assert!(rig.vehicle.commands().is_empty());
    // The current key decides.
    rig.signing().clear_key();
    let refused = station.unsigned(Version::V2, &arm_all());
    assert_eq!(passes(&mut rig, RADIO, &refused), [0; 0]);
    assert_eq!(forwarded(&rig, WIRE).not_accepted, 1);
}

/// R-10, G-9: a signed link accepts the messages in its list unsigned, also with a key. So it does not get these messages if
/// another link refused them, signed with another key or unsigned, unless a link option allows it.
#[test]
fn signed_link_does_not_get_refused_frames_of_its_exceptions() {
    let commands = LinkSigning { accept: Accept::SignedExcept(&[CommandLong::ID]), ..LinkSigning::OPEN };
    let wire = LinkConfig::unlimited().with_signing(commands);
    for takes_refused in [false, true] {
        let mut rig: Rig = rig_without_key([
            wire.with_signing(LinkSigning::REQUIRED),
            wire.with_refused_frames(takes_refused),
            wire,
            wire.with_signing(LinkSigning::SIGNED),
        ]);
        rig.set_key(KEY);
        let mut station = Signer::new(KEY);
        let mut stranger = Signer::new(OTHER_KEY).of(WINGMAN);
        let takers = if takes_refused { vec![WIRE, 3] } else { vec![3] };
        for refused in [station.unsigned(Version::V2, &arm_all()), stranger.frame(&arm_all())] {
            assert_eq!(passes(&mut rig, RADIO, &refused), takers);
        }
        assert_eq!(forwarded(&rig, OTHER_WIRE).not_accepted, 2);
        // A signed link without that exception refuses them too.
        let refused = station.unsigned(Version::V2, &arm_all());
        assert_eq!(passes(&mut rig, 3, &refused), if takes_refused { vec![RADIO, WIRE] } else { vec![RADIO] });
        // Other messages are verified by the links themselves; accepted ones are forwarded to all.
        let hello = station.unsigned(Version::V2, &Gcs::heartbeat());
        assert_eq!(passes(&mut rig, RADIO, &hello), [WIRE, OTHER_WIRE, 3]);
        assert!(rig.vehicle.commands().is_empty());
        assert_eq!(passes(&mut rig, RADIO, &station.frame(&arm_all())), [WIRE, OTHER_WIRE, 3]);
    }
}

/// a bad signature is refused on every link, so such a frame is never forwarded to an open link. A link that verifies
/// signatures itself gets it.
#[test]
fn bad_signatures_are_forwarded_to_verifying_links_only() {
    let open = LinkConfig::unlimited();
    let mut rig: Rig =
        Rig::new([open.with_signing(LinkSigning::REQUIRED), open, open, open.with_signing(LinkSigning::SIGNED)]);
    rig.set_key(KEY);
    sent_on(&mut rig, &[]);
    let mut stranger = Signer::new(OTHER_KEY).of(WINGMAN);
    assert_eq!(passes(&mut rig, RADIO, &stranger.frame(&Gcs::heartbeat())), [3]);
    assert_eq!(passes(&mut rig, WIRE, &stranger.frame(&Gcs::heartbeat())), [RADIO, 3]);
    // The same for an unknown message.
    assert_eq!(
        passes(&mut rig, RADIO, &Signer::new(KEY).of(WINGMAN).frame_of(0x00AB_CDEF, &[7])),
        [WIRE, OTHER_WIRE, 3]
    );
    assert_eq!(forwarded(&rig, OTHER_WIRE).not_accepted, 2);
}

/// a flood of refused frames does not displace accepted frames from the memory of forwarded frames.
#[test]
fn flood_of_refused_frames_does_not_block_accepted_ones() {
    let mut rig = rig();
    let mut stranger = Signer::new(OTHER_KEY).of(WINGMAN);
    let mut station = Signer::new(KEY);
    let mut sent = 0;
    for round in 0..500 {
        passes(&mut rig, RADIO, &stranger.frame(&Attitude { yaw: round as f32, ..Attitude::default() }));
        rig.now += millis(1);
        if round % 10 == 0 {
            sent += usize::from(passes(&mut rig, RADIO, &station.frame(&Gcs::heartbeat())) == [WIRE, OTHER_WIRE]);
        }
    }
    assert_eq!(sent, 50);
    assert!(forwarded(&rig, RADIO).not_remembered > 200);
}

/// refused frames are not sent over a satellite, which costs money. On all other links they are forwarded.
#[test]
fn refused_commands_are_not_sent_over_satellite() {
    let mut rig = rig();
    let mut station = Signer::new(KEY);
    let mut stranger = Signer::new(OTHER_KEY).of(WINGMAN);
    let mut wingman = Signer::new(KEY).of(WINGMAN);
    let there =
        CommandLong { command: MavCmd::NAV_LAND, target_system: 255, target_component: 190, ..Default::default() };
    for link in [WIRE, SATELLITE] {
        rig.receive(link, &station.unsigned(Version::V2, &CommandLong { target_system: 7, ..there }));
    }
    // The station must time out on the wire; otherwise the satellite would not be used at all.
    rig.now += millis(6_000);
    sent_on(&mut rig, &[]);
    let unsigned = wingman.unsigned(Version::V2, &there);
    assert_eq!(passes(&mut rig, RADIO, &unsigned), [WIRE]);
    assert_eq!(passes(&mut rig, RADIO, &stranger.frame(&there)), [WIRE]);
    assert_eq!(forwarded(&rig, SATELLITE).not_accepted, 2);
    assert_eq!(passes(&mut rig, RADIO, &wingman.frame(&there)), [WIRE, SATELLITE]);
    // The first one again, on a link that accepts it.
    assert_eq!(passes(&mut rig, OTHER_WIRE, &unsigned), [WIRE, SATELLITE]);
    assert_eq!(forwarded(&rig, SATELLITE).sent, 2);
}

/// a refused frame whose only route is the satellite is not forwarded. The accepted one is forwarded and carried
/// out, once.
#[test]
fn accepted_frame_is_sent_once_after_a_refused_one() {
    for target in [WINGMAN, Address::new(1, 0)] {
        let mut rig = rig();
        let land = |target: Address| CommandLong {
            command: MavCmd::NAV_LAND,
            target_system: target.system.wire(),
            target_component: target.component.wire(),
            ..CommandLong::default()
        };
        let mut there = Signer::new(KEY).of(if target == WINGMAN { WINGMAN } else { GIMBAL });
        rig.receive(SATELLITE, &there.unsigned(Version::V2, &land(Address::new(7, 0))));
        sent_on(&mut rig, &[]);
        let unsigned = Signer::new(KEY).of(COMPANION).unsigned(Version::V2, &land(target));
        assert_eq!(passes(&mut rig, RADIO, &unsigned), [0; 0]);
        assert_eq!(forwarded(&rig, SATELLITE).not_accepted, 1);
        let mut sent = Vec::new();
        for link in [WIRE, OTHER_WIRE, RADIO, WIRE, OTHER_WIRE] {
            sent.extend(passes(&mut rig, link, &unsigned));
        }
        assert_eq!(sent, [SATELLITE], "for {target:?}");
        assert_eq!(rig.vehicle.commands().len(), usize::from(target != WINGMAN));
    }
}

/// a refused frame that found a queue full, or expired in it, does not suppress the accepted one.
#[test]
fn refused_frames_in_a_queue_suppress_nothing() {
    for (others, wait, times) in [(30, 0, 1), (0, 400, 1), (0, 700, 1), (0, 0, 2)] {
        let mut rig = rig();
        let mut stranger = Signer::new(OTHER_KEY).of(WINGMAN);
        let next = Signer::new(KEY).of(COMPANION).unsigned(Version::V2, &Gcs::heartbeat());
        for _ in 0..others {
            rig.receive(RADIO, &stranger.frame(&Gcs::heartbeat()));
        }
        let full = forwarded(&rig, OTHER_WIRE).queue_full;
        rig.receive(RADIO, &next);
        assert_eq!(forwarded(&rig, OTHER_WIRE).queue_full > full, others > 0);
        rig.now += millis(wait);
        rig.receive(WIRE, &next);
        // The line accepts bytes again; frames that waited for 600 ms have expired.
        rig.now += millis(590);
        let sent = sent_on(&mut rig, &next);
        assert_eq!(sent.into_iter().filter(|&link| link == OTHER_WIRE).count(), times, "{others} others, {wait} ms");
    }
}

/// refused frames fill at most half of a queue, whatever their target, so accepted frames have room. They never use the
/// last quarter.
#[test]
fn refused_frames_leave_half_of_a_queue() {
    let mut rig = rig();
    let mut stranger = Signer::new(OTHER_KEY).of(WINGMAN);
    let mut station = Signer::new(KEY);
    rig.receive(WIRE, &station.unsigned(Version::V2, &Gcs::heartbeat()));
    sent_on(&mut rig, &[]);
    let there = CommandLong { target_system: 255, target_component: 190, ..CommandLong::default() };
    for n in 0..20 {
        rig.receive(RADIO, &stranger.frame(&CommandLong { param1: n as f32, ..there }));
    }
    // Each takes up to 60 bytes of the queue's 512.
    let refused = forwarded(&rig, WIRE).queue_full;
    assert!((15..=16).contains(&refused), "{refused} of 20");
    let mut companion = Signer::new(KEY).of(COMPANION);
    let mut queued = |frame: Vec<u8>| {
        let before = forwarded(&rig, WIRE).queue_full;
        rig.receive(OTHER_WIRE, &frame);
        forwarded(&rig, WIRE).queue_full == before
    };
    let attitude = |n: u8| Attitude { yaw: n.into(), ..Attitude::default() };
    let broadcast = (0..20).filter(|&n| queued(companion.unsigned(Version::V2, &attitude(n)))).count();
    let addressed = (0..20_u8)
        .filter(|&n| queued(companion.unsigned(Version::V2, &CommandLong { param1: n.into(), ..there })))
        .count();
    assert!(broadcast >= 2 && addressed >= 2, "{broadcast} broadcasts, {addressed} for the station");
}

/// a loop is detected when accepted frames return. Duplicates that were refused do not count, and shorten no frame's time
/// in a queue.
#[test]
fn refused_duplicates_do_not_indicate_a_loop() {
    for (link, arrives) in [(RADIO, true), (OTHER_WIRE, false)] {
        let mut rig = rig();
        let mut companion = Signer::new(KEY).of(COMPANION);
        let first = companion.unsigned(Version::V2, &Gcs::heartbeat());
        passes(&mut rig, WIRE, &first);
        passes(&mut rig, link, &first);
        assert_eq!(forwarded(&rig, link).duplicates, 1);
        let second = companion.unsigned(Version::V2, &Gcs::heartbeat());
        rig.receive(WIRE, &second);
        rig.now += millis(400);
        assert_eq!(sent_on(&mut rig, &second), if arrives { vec![RADIO, OTHER_WIRE] } else { vec![] });
    }
}

/// a broadcast that returns on a link where its source is heard does not indicate a loop, because R-4 stops it. An
/// addressed frame does, because only the memory of forwarded frames stops it.
#[test]
fn addressed_duplicates_indicate_a_loop() {
    for (is_addressed, arrives) in [(false, true), (true, false)] {
        let mut rig = rig();
        let mut companion = Signer::new(KEY).of(COMPANION);
        for link in [WIRE, OTHER_WIRE] {
            rig.receive(link, &companion.unsigned(Version::V2, &Gcs::heartbeat()));
        }
        rig.receive(RADIO, &Signer::new(KEY).of(WINGMAN).frame(&Gcs::heartbeat()));
        sent_on(&mut rig, &[]);
        let target_system = if is_addressed { WINGMAN.system.wire() } else { 0 };
        let tune = PlayTune { target_system, ..PlayTune::default() };
        let first = companion.unsigned(Version::V2, &tune);
        passes(&mut rig, WIRE, &first);
        passes(&mut rig, OTHER_WIRE, &first);
        assert_eq!(forwarded(&rig, OTHER_WIRE).duplicates, 1);
        let second = companion.unsigned(Version::V2, &tune);
        rig.receive(WIRE, &second);
        rig.now += millis(400);
        assert_eq!(sent_on(&mut rig, &second).contains(&RADIO), arrives);
    }
}

/// R-3, G-9: a frame that is accepted unsigned as an exception teaches no route, and removes none.
#[test]
fn unsigned_exception_does_not_change_routes() {
    let open = LinkConfig::unlimited();
    let mut rig: Rig = Rig::new([open.with_signing(LinkSigning::SIGNED), open, open, open]);
    rig.set_key(KEY);
    sent_on(&mut rig, &[]);
    let tune = PlayTune { target_system: 2, target_component: 1, ..PlayTune::default() };
    let mut companion = Signer::new(KEY).of(COMPANION);
    let (first, second) = (companion.unsigned(Version::V2, &tune), companion.unsigned(Version::V2, &tune));
    rig.receive(RADIO, &Signer::new(KEY).of(WINGMAN).frame(&Gcs::heartbeat()));
    assert_eq!(passes(&mut rig, WIRE, &first), [RADIO]);
    // Any transmitter near the radio can forge its source.
    rig.receive(RADIO, &Signer::new(OTHER_KEY).of(WINGMAN).unsigned(Version::V2, &RadioStatus::default()));
    assert_eq!(rig.vehicle.calls.len(), 2, "it is delivered");
    assert_eq!(passes(&mut rig, WIRE, &second), [RADIO]);
}

/// H-12, H-13, R-3: RADIO_STATUS needs no signature on a signed link, so its sender can be forged. It evicts no peer that signs
/// or that an open link accepts, silent or not, and its own entry is evicted first.
#[test]
fn radio_reports_evict_no_verified_peers() {
    let open = LinkConfig::unlimited();
    let mut rig: Rig = Rig::new([open.with_signing(LinkSigning::SIGNED), open, open, open]);
    rig.set_key(KEY);
    sent_on(&mut rig, &[]);
    let radio = |rig: &mut Rig, system: u8| {
        let mut radio = Signer::new(OTHER_KEY).of(Address::new(system, 68));
        rig.receive(RADIO, &radio.unsigned(Version::V1, &RadioStatus { rssi: 200, ..RadioStatus::default() }));
    };
    let is_there = |rig: &Rig, address: Address| rig.stack.peers(rig.now).any(|info| info.peer.address == address);
    // These fill the table, and are evicted first when a signed peer comes.
    (20..40).for_each(|system| radio(&mut rig, system));
    let mut wingmen: Vec<Signer> =
        (2..9).map(|system| Signer::new(KEY).of(Address::new(system, 1)).at(NOW + 200_000)).collect();
    for wingman in &mut wingmen {
        rig.now += millis(10);
        rig.receive(RADIO, &wingman.frame(&Attitude::default()));
    }
    rig.receive(WIRE, &Signer::new(KEY).of(COMPANION).unsigned(Version::V2, &Gcs::heartbeat()));
    let verified = || (2..9).map(|system| Address::new(system, 1)).chain([COMPANION]);
    assert!(verified().all(|address| is_there(&rig, address)));
    // Even after a long silence, no unverified frame evicts them.
    rig.now += millis(30_000);
    sent_on(&mut rig, &[]);
    (40..=255).for_each(|system| radio(&mut rig, system));
    assert!(verified().all(|address| is_there(&rig, address)));
    let mut companion = Signer::new(KEY).of(COMPANION);
    companion.seq = 9;
    let tune = PlayTune { target_system: 2, target_component: 1, ..PlayTune::default() };
    assert_eq!(passes(&mut rig, WIRE, &companion.unsigned(Version::V2, &tune)), [RADIO]);
    // A forged source does not show that the peer is heard there.
    radio(&mut rig, 2);
    rig.receive(RADIO, &Signer::new(OTHER_KEY).of(WINGMAN).unsigned(Version::V1, &RadioStatus::default()));
    let hello = Signer::new(KEY).of(WINGMAN).unsigned(Version::V2, &Attitude::default());
    assert!(passes(&mut rig, WIRE, &hello).contains(&RADIO));
}
