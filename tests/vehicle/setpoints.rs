//! SET_POSITION_TARGET_LOCAL_NED, SET_POSITION_TARGET_GLOBAL_INT and SET_ATTITUDE_TARGET: rules J-6 to J-8.

use crate::support::*;
use mavstack::__private::{Declares, NoPlans};
use mavstack::config::LinkClass;
use mavstack::dialect::*;
use mavstack::manual_control::ControlSource;
use mavstack::message::SystemId;
use mavstack::setpoints::{AttitudeSetpoint, Place, PositionSetpoint, Setpoint, SetpointCounters, Setpoints, Target};
use mavstack::{Address, Duration, Instant, LinkConfig, LinkId, Message, Peer};

const ONLY_STATION: ControlSource = ControlSource::System(SystemId::new(255));
const BOTH_STATIONS: ControlSource = ControlSource::Systems { first: SystemId::new(254), last: SystemId::new(255) };
/// The companion computer on board.
const COMPANION: Address = Address::new(1, 191);

/// A world whose vehicle declares the service.
type Offboard<const N: usize> = World<N, Tested<NoPlans, 8, Steered>>;

/// A world in which `source` is authorised, with the default timeout.
fn world<const N: usize>(source: ControlSource) -> Offboard<N> {
    let mut world = Offboard::of(Setup { start: Instant::from_millis(1_000), ..Setup::new() });
    world.stack.setpoints.set_source(source);
    world
}

/// Receives `message` now.
fn send<const N: usize, D: Declares, M: Message>(world: &mut World<N, D>, link: u8, from: Address, message: &M) {
    let frame = world.gcs[usize::from(link)].frame_from(from, message);
    assert_eq!(world.stack.receive(world.clock.now(), LinkId(link), &frame, &mut world.vehicle), frame.len());
}

fn current<const N: usize>(world: &Offboard<N>) -> Option<Setpoint> {
    world.stack.setpoints.current(world.now())
}

fn counters<const N: usize>(world: &Offboard<N>) -> SetpointCounters {
    world.stack.setpoints.counters()
}

/// The north velocity of the current setpoint.
fn north<const N: usize>(world: &Offboard<N>) -> Option<f32> {
    match current(world)?.target {
        Target::Position(PositionSetpoint { velocity: [north, ..], .. }) => north,
        Target::Attitude(_) => None,
    }
}

/// A velocity to the north, to the vehicle.
fn fly(vx: f32) -> SetPositionTargetLocalNed {
    SetPositionTargetLocalNed { vx, type_mask: PositionTargetTypemask(!8 & 0xDFF), ..local() }
}

/// All fields given.
fn local() -> SetPositionTargetLocalNed {
    SetPositionTargetLocalNed {
        time_boot_ms: 77,
        x: 1.0,
        y: -2.0,
        z: -3.0,
        vx: 4.0,
        vy: 5.0,
        vz: 6.0,
        afx: 7.0,
        afy: 8.0,
        afz: 9.0,
        yaw: 1.5,
        yaw_rate: -0.5,
        target_system: 1,
        target_component: 1,
        coordinate_frame: MavFrame::LOCAL_NED,
        ..Default::default()
    }
}

fn global() -> SetPositionTargetGlobalInt {
    let SetPositionTargetLocalNed { time_boot_ms, vx, vy, vz, afx, afy, afz, yaw, yaw_rate, .. } = local();
    SetPositionTargetGlobalInt {
        time_boot_ms,
        lat_int: -473_977_421,
        lon_int: 1_799_999_999,
        alt: 500.5,
        vx,
        vy,
        vz,
        afx,
        afy,
        afz,
        yaw,
        yaw_rate,
        target_system: 1,
        target_component: 1,
        coordinate_frame: MavFrame::GLOBAL_RELATIVE_ALT_INT,
        ..Default::default()
    }
}

fn attitude() -> SetAttitudeTarget {
    SetAttitudeTarget {
        time_boot_ms: 78,
        q: [0.5, -0.5, 0.5, -0.5],
        body_roll_rate: 0.1,
        body_pitch_rate: 0.2,
        body_yaw_rate: 0.3,
        thrust: 0.6,
        target_system: 1,
        target_component: 1,
        ..Default::default()
    }
}

/// J-8: each bit of a position's mask takes out its field, and no other.
#[test]
fn ignored_fields_of_a_position_are_absent() {
    let mut world = world::<1>(ONLY_STATION);
    for mask in 0..0x1000_u16 {
        let type_mask = PositionTargetTypemask(mask);
        let is_local = mask & 1 == mask >> 1 & 1;
        if is_local {
            send(&mut world, 0, STATION, &SetPositionTargetLocalNed { type_mask, ..local() });
        } else {
            send(&mut world, 0, STATION, &SetPositionTargetGlobalInt { type_mask, ..global() });
        }
        let given = |bit: u16, value: f32| (mask & 1 << bit == 0).then_some(value);
        let expected = PositionSetpoint {
            frame: if is_local { MavFrame::LOCAL_NED } else { MavFrame::GLOBAL_RELATIVE_ALT_INT },
            place: if is_local {
                Place::Local([given(0, 1.0), given(1, -2.0), given(2, -3.0)])
            } else {
                let degrees = |bit: u16, value: i32| (mask & 1 << bit == 0).then_some(value);
                Place::Global {
                    latitude: degrees(0, -473_977_421),
                    longitude: degrees(1, 1_799_999_999),
                    altitude: given(2, 500.5),
                }
            },
            velocity: [given(3, 4.0), given(4, 5.0), given(5, 6.0)],
            acceleration: [given(6, 7.0), given(7, 8.0), given(8, 9.0)],
            is_force: mask & 0x200 != 0,
            yaw: given(10, 1.5),
            yaw_rate: given(11, -0.5),
        };
        let from = Peer { address: STATION, link: LinkId(0) };
        let target = Target::Position(expected);
        assert_eq!(current(&world), Some(Setpoint { from, at: world.now(), time_boot_ms: 77, target }), "{mask:#x}");
    }
    assert_eq!(counters(&world), counted::<SetpointCounters>(|counters| counters.taken = 0x1000));
}

/// J-8: the same for an attitude. Thrust in the body frame takes the place of collective thrust.
#[test]
fn ignored_fields_of_an_attitude_are_absent() {
    let mut world = world::<1>(ONLY_STATION);
    for mask in 0..=u8::MAX {
        let type_mask = AttitudeTargetTypemask(mask);
        let thrust_body = [0.25, -1.0, 1.0];
        send(&mut world, 0, STATION, &SetAttitudeTarget { type_mask, thrust_body, ..attitude() });
        let given = |bit: u8, value: f32| (mask & 1 << bit == 0).then_some(value);
        let is_body = mask & 0x20 != 0;
        let expected = AttitudeSetpoint {
            attitude: (mask & 0x80 == 0).then_some([0.5, -0.5, 0.5, -0.5]),
            rates: [given(0, 0.1), given(1, 0.2), given(2, 0.3)],
            thrust: given(6, 0.6).filter(|_| !is_body),
            thrust_body: is_body.then_some(thrust_body),
        };
        let seen = current(&world).unwrap();
        assert_eq!((seen.time_boot_ms, seen.target), (78, Target::Attitude(expected)), "{mask:#x}");
    }
}

/// J-8: any frame is passed on as sent, known or not (S-17).
#[test]
fn frames_are_passed_on() {
    let mut world = world::<1>(ONLY_STATION);
    for frame in 0..=u8::MAX {
        send(&mut world, 0, STATION, &SetPositionTargetLocalNed { coordinate_frame: MavFrame(frame), ..local() });
        let Some(Target::Position(seen)) = current(&world).map(|seen| seen.target) else { panic!("{frame}") };
        assert_eq!(seen.frame, MavFrame(frame));
    }
}

/// J-8: a given field that is not finite refuses the message, whatever the others are. An ignored one may hold anything.
#[test]
fn numbers_must_be_finite() {
    let mut refused = 0;
    let mut world = world::<1>(ONLY_STATION);
    send(&mut world, 0, STATION, &fly(1.0));
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for (index, bit) in (0..11).zip([0_u16, 1, 2, 3, 4, 5, 6, 7, 8, 10, 11]) {
            let mut message = local();
            let fields = [
                &mut message.x,
                &mut message.y,
                &mut message.z,
                &mut message.vx,
                &mut message.vy,
                &mut message.vz,
                &mut message.afx,
                &mut message.afy,
                &mut message.afz,
                &mut message.yaw,
                &mut message.yaw_rate,
            ];
            *fields.into_iter().nth(index).unwrap() = bad;
            send(&mut world, 0, STATION, &message);
            refused += 1;
            assert_eq!(counters(&world).not_finite, refused, "field {index}");
            assert_eq!(north(&world), Some(1.0), "the one before stays");
            send(
                &mut world,
                0,
                STATION,
                &SetPositionTargetLocalNed { type_mask: PositionTargetTypemask(1 << bit), ..message },
            );
            assert_eq!(current(&world).unwrap().time_boot_ms, 77);
            send(&mut world, 0, STATION, &fly(1.0));
        }
        let type_mask = PositionTargetTypemask::Z_IGNORE;
        send(&mut world, 0, STATION, &SetPositionTargetGlobalInt { alt: bad, ..global() });
        let thrust = SetAttitudeTarget { thrust: bad, ..attitude() };
        send(&mut world, 0, STATION, &thrust);
        send(&mut world, 0, STATION, &SetAttitudeTarget { body_yaw_rate: bad, ..attitude() });
        send(&mut world, 0, STATION, &SetAttitudeTarget { q: [0.5, 0.5, bad, 0.5], ..attitude() });
        refused += 4;
        assert_eq!(counters(&world).not_finite, refused);
        assert_eq!(north(&world), Some(1.0));
        send(&mut world, 0, STATION, &SetPositionTargetGlobalInt { alt: bad, type_mask, ..global() });
        let type_mask = AttitudeTargetTypemask::THROTTLE_IGNORE;
        send(&mut world, 0, STATION, &SetAttitudeTarget { type_mask, ..thrust });
        assert!(matches!(current(&world).unwrap().target, Target::Attitude(AttitudeSetpoint { thrust: None, .. })));
        send(&mut world, 0, STATION, &fly(1.0));
    }
    assert_eq!(counters(&world).out_of_range, 0);
}

/// J-8: a quaternion is normalised within 1 %, thrust is at most 1, and a position is on the globe.
#[test]
fn numbers_must_be_in_range() {
    let mut world = world::<1>(ONLY_STATION);
    let is_taken = |world: &mut Offboard<1>, message: &dyn Fn(&mut Offboard<1>)| {
        let before = counters(world);
        message(world);
        let after = counters(world);
        assert_eq!(after.taken - before.taken + after.out_of_range - before.out_of_range, 1);
        after.taken > before.taken
    };
    for (q, is_right) in [
        ([1.0, 0.0, 0.0, 0.0], true),
        ([0.0, 0.0, 0.0, -1.0], true),
        ([0.991, 0.0, 0.0, 0.0], true),
        ([1.009, 0.0, 0.0, 0.0], true),
        ([0.5, 0.5, 0.5, 0.51], true),
        ([0.989, 0.0, 0.0, 0.0], false),
        ([1.011, 0.0, 0.0, 0.0], false),
        ([0.0, 0.0, 0.0, 0.0], false),
        ([1.0, 1.0, 0.0, 0.0], false),
        ([f32::MAX, f32::MAX, 0.0, 0.0], false),
    ] {
        let message = SetAttitudeTarget { q, ..attitude() };
        assert_eq!(is_taken(&mut world, &|world| send(world, 0, STATION, &message)), is_right, "{q:?}");
        let type_mask = AttitudeTargetTypemask::ATTITUDE_IGNORE;
        let message = SetAttitudeTarget { type_mask, ..message };
        assert!(is_taken(&mut world, &|world| send(world, 0, STATION, &message)), "ignored: {q:?}");
    }
    for (thrust, is_right) in [(0.0, true), (1.0, true), (-1.0, true), (1.001, false), (-1.001, false), (50.0, false)] {
        let message = SetAttitudeTarget { thrust, ..attitude() };
        assert_eq!(is_taken(&mut world, &|world| send(world, 0, STATION, &message)), is_right, "{thrust}");
        let type_mask = AttitudeTargetTypemask::THRUST_BODY_SET;
        for axis in 0..3 {
            let mut message = SetAttitudeTarget { type_mask, ..attitude() };
            message.thrust_body[axis] = thrust;
            assert_eq!(is_taken(&mut world, &|world| send(world, 0, STATION, &message)), is_right, "{axis}: {thrust}");
        }
    }
    for (lat_int, lon_int, is_right) in [
        (900_000_000, 1_800_000_000, true),
        (-900_000_000, -1_800_000_000, true),
        (900_000_001, 0, false),
        (-900_000_001, 0, false),
        (0, 1_800_000_001, false),
        (0, -1_800_000_001, false),
        (i32::MAX, 0, false),
        (i32::MIN, 0, false),
        (0, i32::MIN, false),
    ] {
        let message = SetPositionTargetGlobalInt { lat_int, lon_int, ..global() };
        assert_eq!(is_taken(&mut world, &|world| send(world, 0, STATION, &message)), is_right, "{lat_int} {lon_int}");
        let message = SetPositionTargetGlobalInt { type_mask: PositionTargetTypemask(3), ..message };
        assert!(is_taken(&mut world, &|world| send(world, 0, STATION, &message)), "ignored");
    }
}

/// J-6: each message must name our own system, not another one and not 0.
#[test]
fn setpoints_must_name_this_vehicle() {
    let mut world = world::<1>(ONLY_STATION);
    for (target_system, target_component) in [(0, 0), (0, 1), (2, 1), (1, 2), (255, 190)] {
        send(&mut world, 0, STATION, &SetPositionTargetLocalNed { target_system, target_component, ..local() });
        send(&mut world, 0, STATION, &SetPositionTargetGlobalInt { target_system, target_component, ..global() });
        send(&mut world, 0, STATION, &SetAttitudeTarget { target_system, target_component, ..attitude() });
    }
    assert_eq!(current(&world), None);
    assert_eq!(counters(&world), counted::<SetpointCounters>(|counters| counters.broadcast = 6));
    assert_eq!(world.stack.link_counters(LinkId(0)).unwrap().not_ours, 9);
    assert_eq!(world.vehicle.calls, [], "they are not passed to the vehicle either");
    for target_component in [0, 1] {
        send(&mut world, 0, STATION, &SetPositionTargetLocalNed { target_component, ..local() });
    }
    assert_eq!(counters(&world).taken, 2);
}

/// J-6: only the configured sender is followed; by default none is.
#[test]
fn only_the_configured_sender_is_followed() {
    use ControlSource::{GroundStation, Nobody, System, Systems};
    let range = |first, last| Systems { first: SystemId::new(first), last: SystemId::new(last) };
    for (source, may) in [
        (None, [false; 4]),
        (Some(Nobody), [false; 4]),
        (Some(System(SystemId::new(255))), [true, true, false, false]),
        (Some(System(SystemId::new(1))), [false, false, false, true]),
        (Some(range(254, 255)), [true, true, true, false]),
        // No heartbeat was received.
        (Some(GroundStation), [false; 4]),
    ] {
        for (from, may) in [STATION, Address::new(255, 1), OTHER_STATION, COMPANION].into_iter().zip(may) {
            let mut world = Offboard::<1>::of(Setup::new());
            if let Some(source) = source {
                world.stack.setpoints.set_source(source);
                assert_eq!(world.stack.setpoints.source(), source);
            }
            send(&mut world, 0, from, &local());
            assert_eq!(current(&world).is_some(), may, "{source:?}: {from:?}");
            let expected = counted::<SetpointCounters>(|counters| {
                (counters.taken, counters.not_allowed) = (may.into(), (!may).into());
            });
            assert_eq!(counters(&world), expected);
        }
    }
}

/// J-6: a ground station is followed while its heartbeats are received, and on their link. Setpoints keep no peer alive (H-10).
#[test]
fn a_ground_station_needs_heartbeats() {
    let mut world = world::<2>(ControlSource::GroundStation);
    send(&mut world, 0, STATION, &Gcs::heartbeat());
    send(&mut world, 1, STATION, &fly(1.0));
    assert_eq!(current(&world), None, "not on this link");
    for _ in 0..55 {
        send(&mut world, 0, STATION, &fly(1.0));
        world.run_for(millis(100));
    }
    assert_eq!(current(&world), None, "lost");
    assert!((45..55).contains(&counters(&world).taken));
    send(&mut world, 0, STATION, &Gcs::heartbeat());
    send(&mut world, 0, STATION, &fly(1.0));
    assert_eq!(north(&world), Some(1.0));
}

/// J-7: a setpoint is valid until its age reaches the timeout, to the microsecond.
#[test]
fn setpoints_expire() {
    for timeout in [Duration::from_micros(1), millis(50), Setpoints::TIMEOUT, secs(3)] {
        let mut world = world::<1>(ONLY_STATION);
        world.stack.setpoints.set_timeout(timeout);
        send(&mut world, 0, STATION, &fly(1.0));
        let end = world.now() + timeout;
        world.step_to(Instant::from_micros(end.as_micros() - 1));
        let seen = current(&world).unwrap();
        assert_eq!(seen.age(world.now()).as_micros(), timeout.as_micros() - 1);
        // Neither another message nor a refused setpoint prolongs it.
        send(&mut world, 0, STATION, &Gcs::heartbeat());
        send(&mut world, 0, STATION, &fly(f32::NAN));
        world.step_to(end);
        assert_eq!((current(&world), world.stack.setpoints.owner(end)), (None, None));
    }
}

/// J-7: with a timeout of 0 no setpoint is followed, and a longer timeout does not revive one.
#[test]
fn longer_timeout_does_not_revive_a_setpoint() {
    let mut world = world::<1>(ONLY_STATION);
    world.stack.setpoints.set_timeout(Duration::ZERO);
    send(&mut world, 0, STATION, &fly(1.0));
    assert_eq!(current(&world), None);
    world.stack.setpoints.set_timeout(millis(500));
    send(&mut world, 0, STATION, &fly(1.0));
    world.run_for(millis(500));
    world.stack.setpoints.set_timeout(secs(10));
    assert_eq!(current(&world), None);
}

/// J-6: of two authorised senders the first one is followed until its setpoint has expired; they do not alternate. A refused
/// setpoint takes over nothing.
#[test]
fn one_sender_owns_the_setpoints() {
    let mut world = world::<2>(BOTH_STATIONS);
    let first = Peer { address: STATION, link: LinkId(0) };
    send(&mut world, 1, OTHER_STATION, &fly(f32::NAN));
    for _ in 0..20 {
        send(&mut world, 0, STATION, &fly(1.0));
        world.run_for(millis(100));
        // Another station, another component of the same one, and the same one on another link, with each message.
        send(&mut world, 0, OTHER_STATION, &fly(2.0));
        send(&mut world, 0, Address::new(255, 25), &global());
        send(&mut world, 1, STATION, &attitude());
        assert_eq!((north(&world), current(&world).unwrap().from), (Some(1.0), first));
        assert_eq!(world.stack.setpoints.owner(world.now()), Some(first));
        world.run_for(millis(100));
    }
    let expected = counted::<SetpointCounters>(|counters| {
        (counters.taken, counters.not_owner, counters.not_finite) = (20, 60, 1);
    });
    assert_eq!(counters(&world), expected);
    send(&mut world, 0, STATION, &fly(1.0));
    world.run_for(millis(499));
    send(&mut world, 1, OTHER_STATION, &fly(2.0));
    assert_eq!(north(&world), Some(1.0));
    world.run_for(millis(1));
    send(&mut world, 1, OTHER_STATION, &fly(2.0));
    send(&mut world, 0, STATION, &fly(1.0));
    let second = Peer { address: OTHER_STATION, link: LinkId(1) };
    assert_eq!((north(&world), current(&world).unwrap().from), (Some(2.0), second), "the second sender owns them now");
}

/// J-6: another policy ends the ownership at once; setting the same policy again does not.
#[test]
fn new_policy_applies_at_once() {
    let mut world = world::<1>(ONLY_STATION);
    send(&mut world, 0, STATION, &fly(1.0));
    world.stack.setpoints.set_source(ONLY_STATION);
    assert_eq!(north(&world), Some(1.0));
    world.stack.setpoints.set_source(BOTH_STATIONS);
    assert_eq!(current(&world), None);
    send(&mut world, 0, OTHER_STATION, &fly(2.0));
    assert_eq!(north(&world), Some(2.0));
}

/// J-6: setpoints are ignored on a high-latency link, even from an authorised system.
#[test]
fn high_latency_link_carries_no_setpoints() {
    let satellite = LinkConfig::uart(9_600).with_class(LinkClass::HighLatency);
    let mut world = Offboard::of(Setup { links: [LinkConfig::uart(57_600), satellite], ..Setup::new() });
    world.stack.setpoints.set_source(ONLY_STATION);
    send(&mut world, 1, STATION, &local());
    send(&mut world, 1, STATION, &global());
    send(&mut world, 1, STATION, &attitude());
    assert_eq!((current(&world), counters(&world)), (None, SetpointCounters::default()));
    assert_eq!(world.stack.link_counters(LinkId(1)).unwrap().out_of_place, 3);
}

/// Setpoints do not steer by hand, sticks are no setpoints, and neither is answered, except for the texts that say who steers (J-13).
#[test]
fn sticks_and_setpoints_do_not_mix() {
    let mut world = world::<1>(ONLY_STATION);
    world.stack.manual_input_mut().set_source(ONLY_STATION);
    send(&mut world, 0, STATION, &ManualControl { target: 1, ..Default::default() });
    assert_eq!(current(&world), None);
    assert!(world.stack.manual_input().manual_control(world.now()).is_some());
    world.run_for(millis(600));
    send(&mut world, 0, STATION, &fly(1.0));
    assert_eq!(world.stack.manual_input().manual_control(world.now()), None);
    world.run_for(millis(100));
    assert!(world.gcs[0].received.iter().all(|frame| [Heartbeat::ID, Statustext::ID].contains(&frame.header.id)));
    assert_eq!(world.vehicle.calls, []);
}

/// Without the service, the vehicle gets the messages, broadcasts included.
#[test]
fn without_the_service_the_vehicle_gets_the_messages() {
    let mut world = World::new(Setup::<1>::new());
    send(&mut world, 0, STATION, &local());
    send(&mut world, 0, STATION, &global());
    send(&mut world, 0, STATION, &SetAttitudeTarget { target_system: 0, ..attitude() });
    let ids = world.vehicle.calls.iter().map(|call| if let Call::Message { id, .. } = call { *id } else { 0 });
    assert_eq!(ids.collect::<Vec<_>>(), [84, 86, 82]);
}
