//! MANUAL_CONTROL and RC_CHANNELS_OVERRIDE: rules J-1 to J-5.

use crate::support::*;
use mavstack::__private::Declares;
use mavstack::__private::NoPlans;
use mavstack::config::LinkClass;
use mavstack::dialect::*;
use mavstack::frame::Version;
use mavstack::manual_control::{ControlSource, ManualControlInput, ManualCounters, ManualInput, RcOverride};
use mavstack::message::SystemId;
use mavstack::{Address, Duration, Instant, LinkConfig, LinkId, Message, Peer, PeerEvent};

const ONLY_STATION: ControlSource = ControlSource::System(SystemId::new(255));
const BOTH_STATIONS: ControlSource = ControlSource::Systems { first: SystemId::new(254), last: SystemId::new(255) };
/// The companion computer on board.
const COMPANION: Address = Address::new(1, 191);
/// An absent axis; an ignored channel; a released channel.
const NONE: i16 = i16::MAX;
const IGNORE: u16 = u16::MAX;
const RELEASE: u16 = u16::MAX - 1;

/// A world whose vehicle declares the service.
type Steerable<const N: usize> = World<N, Tested<NoPlans, 8, Steered>>;

/// A world in which `source` may steer, with the default timeout.
fn world<const N: usize>(source: ControlSource) -> Steerable<N> {
    let mut world = Steerable::of(Setup { start: Instant::from_millis(1_000), ..Setup::new() });
    world.stack.manual_input_mut().set_source(source);
    world
}

/// Receives `message` now.
fn send<const N: usize, D: Declares, M: Message>(world: &mut World<N, D>, link: u8, from: Address, message: &M) {
    let frame = world.gcs[usize::from(link)].frame_from(from, message);
    deliver(world, link, &frame);
}

fn deliver<const N: usize, D: Declares>(world: &mut World<N, D>, link: u8, frame: &[u8]) {
    assert_eq!(world.stack.receive(world.clock.now(), LinkId(link), frame, &mut world.vehicle), frame.len());
}

fn input<const N: usize>(world: &mut Steerable<N>) -> &mut ManualInput {
    world.stack.manual_input_mut()
}

fn sticks<const N: usize>(world: &Steerable<N>) -> Option<ManualControlInput> {
    world.stack.manual_input().manual_control(world.now())
}

fn channels<const N: usize>(world: &Steerable<N>) -> Option<RcOverride> {
    world.stack.manual_input().rc_channels(world.now())
}

fn counters<const N: usize>(world: &Steerable<N>) -> ManualCounters {
    world.stack.manual_input().counters()
}

/// A message to the vehicle with four axes.
fn stick(x: i16) -> ManualControl {
    ManualControl { target: 1, x, y: 20, z: 500, r: -40, buttons: 0b101, ..ManualControl::default() }
}

/// A message to the vehicle with these values in the first and the last channel; the others are ignored.
fn override_of(first: u16, last: u16) -> RcChannelsOverride {
    RcChannelsOverride { chan1_raw: first, chan18_raw: last, ..untouched() }
}

fn untouched() -> RcChannelsOverride {
    RcChannelsOverride {
        target_system: 1,
        target_component: 1,
        chan1_raw: IGNORE,
        chan2_raw: IGNORE,
        chan3_raw: IGNORE,
        chan4_raw: IGNORE,
        chan5_raw: IGNORE,
        chan6_raw: IGNORE,
        chan7_raw: IGNORE,
        chan8_raw: IGNORE,
        ..RcChannelsOverride::default()
    }
}

/// J-1: an absent or invalid axis is `None`; the other axes are used.
#[test]
fn each_axis_is_checked_by_itself() {
    let mut world = world::<1>(ONLY_STATION);
    for (raw, taken, bad) in [
        (0, Some(0), 0),
        (1_000, Some(1_000), 0),
        (-1_000, Some(-1_000), 0),
        (NONE, None, 0),
        (1_001, None, 1),
        (-1_001, None, 1),
        (i16::MIN, None, 1),
        (NONE - 1, None, 1),
    ] {
        for axis in 0..4 {
            let bad_before = counters(&world).bad_axes;
            let mut axes = [10, 20, 30, 40];
            axes[axis] = raw;
            let [x, y, z, r] = axes;
            send(&mut world, 0, STATION, &ManualControl { target: 1, x, y, z, r, ..ManualControl::default() });
            let seen = sticks(&world).unwrap();
            let mut expected = [10, 20, 30, 40].map(Some);
            expected[axis] = taken;
            assert_eq!([seen.x, seen.y, seen.z, seen.r], expected);
            assert_eq!(counters(&world).bad_axes - bad_before, bad, "{raw}");
        }
    }
    let seen = sticks(&world).unwrap();
    assert_eq!((seen.from, seen.at), (Peer { address: STATION, link: LinkId(0) }, world.now()));
    assert_eq!((seen.s, seen.t, seen.aux, seen.buttons), (None, None, [None; 6], 0));
}

/// J-1: an extension axis needs its bit; its value is ignored without the bit.
#[test]
fn extension_axes_need_their_bit() {
    let mut world = world::<1>(ONLY_STATION);
    let message = ManualControl {
        s: 100,
        t: -200,
        aux1: 1,
        aux2: -2,
        aux3: 1_000,
        aux4: -1_000,
        aux5: 5,
        aux6: 2_000,
        buttons: 0x8001,
        buttons2: 0x4002,
        ..stick(0)
    };
    let all = [100, -200, 1, -2, 1_000, -1_000, 5].map(Some);
    for enabled_extensions in 0..=u8::MAX {
        let bad_before = counters(&world).bad_axes;
        send(&mut world, 0, STATION, &ManualControl { enabled_extensions, ..message });
        let seen = sticks(&world).unwrap();
        let [s, t, a, b, c, d, e] = std::array::from_fn(|bit| all[bit].filter(|_| enabled_extensions >> bit & 1 != 0));
        assert_eq!((seen.s, seen.t, seen.aux), (s, t, [a, b, c, d, e, None]));
        assert_eq!(counters(&world).bad_axes - bad_before, u32::from(enabled_extensions >> 7));
        // Buttons need no bit.
        assert_eq!(seen.buttons, 0x4002_8001);
    }
}

/// J-1: fields that a v1 frame or a truncated v2 frame lacks are absent.
#[test]
fn short_forms_have_no_extensions() {
    let mut world = world::<1>(ONLY_STATION);
    world.gcs[0].version = Version::V1;
    let full = ManualControl { enabled_extensions: 0xFF, s: 7, aux6: 8, buttons2: 9, ..stick(300) };
    send(&mut world, 0, STATION, &full);
    let seen = sticks(&world).unwrap();
    assert_eq!((seen.x, seen.y, seen.z, seen.r), (Some(300), Some(20), Some(500), Some(-40)));
    assert_eq!((seen.s, seen.t, seen.aux, seen.buttons), (None, None, [None; 6], 0b101));
    // aux6 is 0, so the frame is truncated before it, and the axis is still present.
    world.gcs[0].version = Version::V2;
    send(&mut world, 0, STATION, &ManualControl { aux6: 0, ..full });
    let seen = sticks(&world).unwrap();
    assert_eq!((seen.s, seen.t, seen.aux), (Some(7), Some(0), [Some(0); 6]));
    assert_eq!(seen.buttons, 0x0009_0005);
}

/// J-1: `target` must be our own system, not another one and not 0, also if its byte was truncated.
#[test]
fn manual_control_must_name_this_vehicle() {
    let mut world = world::<1>(ONLY_STATION);
    for target in [0, 2, 254, 255] {
        send(&mut world, 0, STATION, &ManualControl { target, ..stick(100) });
    }
    let cut_off = reference::v2(ManualControl::ID, [0, 0], [255, 190], &[100, 0, 1], ManualControl::CRC_EXTRA);
    deliver(&mut world, 0, &cut_off);
    assert_eq!(sticks(&world), None);
    assert_eq!(counters(&world), counted::<ManualCounters>(|counters| counters.broadcast = 2));
    assert_eq!(world.stack.link_counters(LinkId(0)).unwrap().not_ours, 3);
    // The message names no component, so it is for us.
    send(&mut world, 0, STATION, &stick(100));
    assert_eq!(sticks(&world).unwrap().x, Some(100));
}

/// J-4, R-1: the same for RC_CHANNELS_OVERRIDE, which also names a component.
#[test]
fn override_must_name_this_vehicle() {
    let mut world = world::<1>(ONLY_STATION);
    for (target_system, target_component) in [(0, 0), (0, 1), (2, 1), (1, 2), (255, 190)] {
        send(
            &mut world,
            0,
            STATION,
            &RcChannelsOverride { target_system, target_component, ..override_of(1_500, 1_600) },
        );
    }
    assert_eq!(channels(&world), None);
    assert_eq!(counters(&world), counted::<ManualCounters>(|counters| counters.broadcast = 2));
    assert_eq!(world.stack.link_counters(LinkId(0)).unwrap().not_ours, 3);
    for (raw, target_component) in [(1_100, 0), (1_200, 1)] {
        send(&mut world, 0, STATION, &RcChannelsOverride { target_component, ..override_of(raw, 0) });
        assert_eq!(channels(&world).unwrap().channel(1), Some(raw));
    }
}

/// J-2: only the configured sender steers; messages of others are counted.
#[test]
fn only_the_configured_sender_steers() {
    use ControlSource::{Nobody, System, Systems};
    let range = |first, last| Systems { first: SystemId::new(first), last: SystemId::new(last) };
    for (source, may) in [
        (Nobody, [false; 4]),
        (System(SystemId::new(255)), [true, true, false, false]),
        (System(SystemId::new(1)), [false, false, false, true]),
        (range(254, 255), [true, true, true, false]),
        (range(254, 254), [false, false, true, false]),
        (range(1, 255), [true; 4]),
        (range(255, 254), [false; 4]),
        // No heartbeat was received.
        (ControlSource::GroundStation, [false; 4]),
    ] {
        for (from, may) in [STATION, Address::new(255, 1), OTHER_STATION, COMPANION].into_iter().zip(may) {
            let mut world = world::<1>(source);
            send(&mut world, 0, from, &stick(100));
            send(&mut world, 0, from, &override_of(1_500, 0));
            assert_eq!((sticks(&world).is_some(), channels(&world).is_some()), (may, may), "{source:?}: {from:?}");
            let expected = if may {
                counted::<ManualCounters>(|counters| counters.taken = 2)
            } else {
                counted::<ManualCounters>(|counters| counters.not_allowed = 2)
            };
            assert_eq!(counters(&world), expected);
        }
    }
}

/// J-2: any ground station, while its heartbeats are received, and only on their link.
#[test]
fn ground_station_needs_heartbeats_to_steer() {
    let mut world = world::<2>(ControlSource::GroundStation);
    let is_taken = |world: &mut Steerable<2>, link, from| {
        let before = counters(world).taken;
        send(world, link, from, &stick(100));
        counters(world).taken > before
    };
    let onboard = Heartbeat { r#type: MavType::ONBOARD_CONTROLLER, ..Gcs::heartbeat() };
    send(&mut world, 0, COMPANION, &onboard);
    send(&mut world, 0, STATION, &Gcs::heartbeat());
    assert!(!is_taken(&mut world, 0, COMPANION), "not a ground station");
    assert!(!is_taken(&mut world, 0, OTHER_STATION), "without heartbeats");
    assert!(!is_taken(&mut world, 1, STATION), "not on this link");
    assert!(is_taken(&mut world, 0, STATION));
    assert_eq!(counters(&world).not_allowed, 3);
    // The joystick is another component of the same system.
    world.run_for(secs(1));
    assert!(is_taken(&mut world, 0, Address::new(255, 25)));
    // Manual control does not keep a peer alive (H-10).
    for _ in 0..50 {
        world.run_for(millis(100));
        is_taken(&mut world, 0, STATION);
    }
    assert!(!is_taken(&mut world, 0, STATION), "lost");
    assert!(world.vehicle.peer_events().contains(&PeerEvent::Lost(Peer { address: STATION, link: LinkId(0) })));
    send(&mut world, 0, STATION, &Gcs::heartbeat());
    assert!(is_taken(&mut world, 0, STATION));
}

/// J-3: an axis is valid until its age reaches the timeout, to the microsecond, whatever else its sender sends.
#[test]
fn sticks_time_out() {
    for timeout in [Duration::from_micros(1), millis(50), ManualInput::TIMEOUT, secs(3)] {
        let mut world = world::<1>(ONLY_STATION);
        input(&mut world).set_timeout(timeout);
        send(&mut world, 0, STATION, &stick(700));
        let sent = world.now();
        send(&mut world, 0, STATION, &override_of(1_700, 0));
        let end = sent + timeout;
        world.step_to(Instant::from_micros(end.as_micros() - 1));
        send(&mut world, 0, STATION, &Gcs::heartbeat());
        send(&mut world, 0, STATION, &untouched());
        assert_eq!(sticks(&world).unwrap().x, Some(700));
        assert_eq!(channels(&world).unwrap().channel(1), Some(1_700));
        world.step_to(end);
        assert_eq!((sticks(&world), channels(&world)), (None, None));
        // It stays invalid although its sender steers with the other message.
        world.run_for(millis(1));
        send(&mut world, 0, STATION, &override_of(IGNORE, 1_800));
        let seen = channels(&world).unwrap();
        assert_eq!((sticks(&world), seen.channel(1), seen.channel(18)), (None, None, Some(1_800)));
    }
}

/// J-3: with a timeout of 0 no input is accepted.
#[test]
fn timeout_of_zero_accepts_nothing() {
    let mut world = world::<1>(ONLY_STATION);
    input(&mut world).set_timeout(Duration::ZERO);
    send(&mut world, 0, STATION, &stick(700));
    send(&mut world, 0, STATION, &override_of(1_700, 1_700));
    assert_eq!((sticks(&world), channels(&world)), (None, None));
    assert_eq!(input(&mut world).holder(Instant::from_millis(1_000)), None);
}

/// J-3: each channel has its own age; an ignored channel is not refreshed.
#[test]
fn channels_time_out_one_by_one() {
    let mut world = world::<1>(ONLY_STATION);
    send(&mut world, 0, STATION, &override_of(1_100, 1_900));
    world.run_for(millis(300));
    for (ignored, first) in [(0, 1_200), (IGNORE, 1_300)] {
        send(&mut world, 0, STATION, &override_of(first, ignored));
        let seen = channels(&world).unwrap();
        assert_eq!((seen.channel(1), seen.channel(18)), (Some(first), Some(1_900)));
    }
    world.run_for(millis(200));
    let seen = channels(&world).unwrap();
    assert_eq!((seen.channel(1), seen.channel(18)), (Some(1_300), None));
    world.run_for(millis(300));
    assert_eq!(channels(&world), None);
}

/// J-4: the meaning of each special value in channels 1 to 8 and in the others.
#[test]
fn channels_are_ignored_or_released() {
    #[derive(Clone, Copy, Debug, PartialEq)]
    enum Then {
        Held,
        Released,
        Set,
    }
    use Then::{Held, Released, Set};
    for (raw, first, last) in [
        (IGNORE, Held, Held),
        (0, Released, Held),
        // The definitions do not name it for the first channels, but no pulse is 65 ms long.
        (RELEASE, Released, Released),
        (1, Set, Set),
        (1_500, Set, Set),
        (4_095, Set, Set),
        (RELEASE - 1, Set, Set),
    ] {
        for number in 1..=18u8 {
            let mut world = world::<1>(ONLY_STATION);
            deliver(&mut world, 0, &override_frame(number, 1_000));
            assert_eq!(channels(&world).unwrap().channel(number), Some(1_000));
            deliver(&mut world, 0, &override_frame(number, raw));
            let expected = match if number <= 8 { first } else { last } {
                Held => Some(1_000),
                Released => None,
                Set => Some(raw),
            };
            let seen = channels(&world);
            assert_eq!(seen.and_then(|seen| seen.channel(number)), expected, "channel {number}: {raw}");
            // The other channels are absent.
            assert_eq!(seen.is_some(), expected.is_some());
            let others = (0..=u8::MAX).filter(|&other| other != number);
            assert!(seen.is_none_or(|seen| others.clone().all(|other| seen.channel(other).is_none())));
            assert_eq!(counters(&world).taken, 2);
        }
    }
}

/// A frame with `raw` in channel `number`; the others are ignored.
fn override_frame(number: u8, raw: u16) -> Vec<u8> {
    let mut payload = [[0xFF; 16].as_slice(), &[1, 1], &[0; 20]].concat();
    let at = usize::from(number - 1) * 2 + if number > 8 { 2 } else { 0 };
    payload[at..at + 2].copy_from_slice(&raw.to_le_bytes());
    reference::v2(RcChannelsOverride::ID, [0, 0], [255, 190], &payload, RcChannelsOverride::CRC_EXTRA)
}

/// J-4: a v1 frame, or a v2 frame that is truncated before them, ignores channels 9 to 18.
#[test]
fn short_forms_ignore_the_last_channels() {
    let mut world = world::<1>(ONLY_STATION);
    let all = RcChannelsOverride { chan9_raw: 1_109, chan18_raw: 1_118, ..override_of(1_101, 0) };
    send(&mut world, 0, STATION, &all);
    world.gcs[0].version = Version::V1;
    send(&mut world, 0, STATION, &RcChannelsOverride { chan9_raw: 1_209, ..override_of(1_201, 1_218) });
    let seen = channels(&world).unwrap();
    assert_eq!([1, 9, 18].map(|number| seen.channel(number)), [Some(1_201), Some(1_109), Some(1_118)]);
    world.gcs[0].version = Version::V2;
    send(&mut world, 0, STATION, &override_of(1_301, 0));
    let seen = channels(&world).unwrap();
    assert_eq!([1, 9, 18].map(|number| seen.channel(number)), [Some(1_301), Some(1_109), Some(1_118)]);
}

/// J-5: manual control is ignored on a high-latency link, even from an authorised system.
#[test]
fn high_latency_link_carries_no_manual_control() {
    let satellite = LinkConfig::uart(9_600).with_class(LinkClass::HighLatency);
    let mut world = Steerable::of(Setup { links: [LinkConfig::uart(57_600), satellite], ..Setup::new() });
    world.stack.manual_input_mut().set_source(ONLY_STATION);
    send(&mut world, 1, STATION, &stick(100));
    send(&mut world, 1, STATION, &override_of(1_500, 0));
    assert_eq!((sticks(&world), channels(&world)), (None, None));
    assert_eq!(world.stack.link_counters(LinkId(1)).unwrap().out_of_place, 2);
    assert_eq!(counters(&world), ManualCounters::default());
}

/// J-2: of two authorised senders, the first one steers until it times out; they do not alternate.
#[test]
fn one_sender_steers_at_a_time() {
    let mut world = world::<2>(BOTH_STATIONS);
    let first = Peer { address: STATION, link: LinkId(0) };
    for _ in 0..20 {
        send(&mut world, 0, STATION, &stick(100));
        world.run_for(millis(40));
        // Another station, another component of the same one, and the same one on another link, with each message.
        send(&mut world, 0, OTHER_STATION, &stick(-100));
        send(&mut world, 0, Address::new(255, 25), &stick(-200));
        send(&mut world, 1, STATION, &stick(-300));
        send(&mut world, 1, OTHER_STATION, &override_of(1_900, 1_900));
        assert_eq!(sticks(&world).map(|seen| (seen.from, seen.x)), Some((first, Some(100))));
        assert_eq!(channels(&world), None);
        let now = world.now();
        assert_eq!(input(&mut world).holder(now), Some(first));
        world.run_for(millis(40));
    }
    assert_eq!(
        counters(&world),
        counted::<ManualCounters>(|counters| {
            counters.taken = 20;
            counters.not_holder = 80
        })
    );
    // Channels also keep the control, even if all of them are ignored.
    send(&mut world, 0, STATION, &override_of(1_500, 1_500));
    world.run_for(millis(499));
    send(&mut world, 0, STATION, &untouched());
    world.run_for(millis(499));
    send(&mut world, 1, OTHER_STATION, &stick(-100));
    assert_eq!(sticks(&world), None);
    world.run_for(millis(1));
    send(&mut world, 1, OTHER_STATION, &stick(-100));
    let second = Peer { address: OTHER_STATION, link: LinkId(1) };
    assert_eq!(sticks(&world).map(|seen| (seen.from, seen.x)), Some((second, Some(-100))));
    send(&mut world, 0, STATION, &stick(100));
    assert_eq!(sticks(&world).map(|seen| seen.from), Some(second), "the second sender steers now");
}

/// J-2: a new sender starts without any value of the previous one, even if the timeout becomes longer.
#[test]
fn values_of_the_previous_sender_do_not_return() {
    let mut world = world::<1>(BOTH_STATIONS);
    send(&mut world, 0, STATION, &stick(100));
    send(&mut world, 0, STATION, &override_of(1_500, 1_500));
    world.run_for(millis(600));
    send(&mut world, 0, OTHER_STATION, &untouched());
    input(&mut world).set_timeout(secs(10));
    assert_eq!((sticks(&world), channels(&world)), (None, None));
}

/// J-3: values that have timed out stay invalid when the timeout becomes longer; others keep their original timeout.
#[test]
fn longer_timeout_does_not_revive_values() {
    for (longer, other) in [(secs(10), secs(20)), (millis(700), millis(100))] {
        let mut world = world::<1>(ONLY_STATION);
        send(&mut world, 0, STATION, &stick(100));
        send(&mut world, 0, STATION, &override_of(1_500, 1_500));
        world.run_for(millis(600));
        input(&mut world).set_timeout(longer);
        assert_eq!((sticks(&world), channels(&world)), (None, None));
        assert_eq!(world.stack.manual_input().holder(world.now()), None);
        send(&mut world, 0, STATION, &stick(200));
        input(&mut world).set_timeout(other);
        world.run_for(millis(690));
        assert_eq!(sticks(&world).unwrap().x, Some(200));
    }
}

/// J-2: another policy ends the control of the present sender; setting the same policy again does not.
#[test]
fn new_policy_applies_at_once() {
    let mut world = world::<1>(ONLY_STATION);
    send(&mut world, 0, STATION, &stick(100));
    send(&mut world, 0, STATION, &override_of(1_500, 1_500));
    input(&mut world).set_source(ONLY_STATION);
    assert!(sticks(&world).is_some() && channels(&world).is_some());
    input(&mut world).set_source(BOTH_STATIONS);
    assert_eq!(input(&mut world).source(), BOTH_STATIONS);
    assert_eq!((sticks(&world), channels(&world)), (None, None));
    send(&mut world, 0, OTHER_STATION, &stick(-100));
    assert_eq!(sticks(&world).unwrap().from.address, OTHER_STATION);
    input(&mut world).set_source(ControlSource::Nobody);
    send(&mut world, 0, OTHER_STATION, &stick(-100));
    assert_eq!(sticks(&world), None);
}

/// H-10: manual control is neither a heartbeat, so it makes no peer alive, nor answered. A text says who steers (J-13).
#[test]
fn manual_control_does_not_make_a_peer_alive() {
    let mut world = world::<1>(ONLY_STATION);
    for _ in 0..50 {
        send(&mut world, 0, STATION, &stick(100));
        send(&mut world, 0, STATION, &override_of(1_500, 0));
        world.run_for(millis(20));
    }
    assert_eq!(world.vehicle.calls, []);
    let (texts, others): (Vec<_>, Vec<_>) =
        world.gcs[0].received.iter().partition(|frame| frame.header.id == Statustext::ID);
    assert_eq!(texts.len(), 1);
    assert!(others.iter().all(|frame| frame.header.id == Heartbeat::ID));
}

/// Without the service, the vehicle gets the messages, broadcasts included.
#[test]
fn without_the_service_the_vehicle_gets_the_messages() {
    let mut world = World::new(Setup::<1>::new());
    send(&mut world, 0, STATION, &stick(100));
    send(&mut world, 0, STATION, &override_of(1_500, 0));
    send(&mut world, 0, STATION, &ManualControl { target: 0, ..stick(100) });
    let ids = world.vehicle.calls.iter().map(|call| if let Call::Message { id, .. } = call { *id } else { 0 });
    assert_eq!(ids.collect::<Vec<_>>(), [69, 70, 69]);
}

/// With the service, the vehicle gets all other messages, and they do not steer.
#[test]
fn other_messages_are_passed_to_the_vehicle() {
    let mut world = world::<1>(ONLY_STATION);
    send(&mut world, 0, STATION, &Attitude::default());
    send(&mut world, 0, STATION, &PlayTune { target_system: 1, ..PlayTune::default() });
    let ids = world.vehicle.calls.iter().map(|call| if let Call::Message { id, .. } = call { *id } else { 0 });
    assert_eq!(ids.collect::<Vec<_>>(), [Attitude::ID, PlayTune::ID]);
    let now = world.now();
    assert_eq!((counters(&world), input(&mut world).holder(now)), (ManualCounters::default(), None));
}

/// RC_CHANNELS as the vehicle uses them: overridden, as received by radio, or unknown.
#[test]
fn overrides_and_received_channels_are_merged() {
    let mut world = world::<1>(ONLY_STATION);
    send(&mut world, 0, STATION, &RcChannelsOverride { chan3_raw: 1_303, ..override_of(1_301, 0) });
    let seen = channels(&world).unwrap();
    let now = Instant::from_micros((u64::from(u32::MAX) + 1) * 1_000 + 7_999);
    let message = seen.to_message(now, &[1_001, 1_002]);
    let expected = RcChannels { chancount: 3, rssi: u8::MAX, time_boot_ms: 7, ..RcChannels::decode(&[0xFF; 42]) };
    assert_eq!(message, RcChannels { chan1_raw: 1_301, chan2_raw: 1_002, chan3_raw: 1_303, ..expected });
    // Without a receiver channels are missing; with more channels than the message has, the count is 18.
    assert_eq!(seen.to_message(now, &[]), RcChannels { chan1_raw: 1_301, chan3_raw: 1_303, ..expected });
    let message = RcOverride::default().to_message(now, &[1_500; 20]);
    assert_eq!((message.chancount, message.chan1_raw, message.chan18_raw), (18, 1_500, 1_500));
    assert_eq!(RcOverride::default().to_message(now, &[]), RcChannels { chancount: 0, ..expected });
}
