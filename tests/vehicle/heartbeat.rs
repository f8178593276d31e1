//! HEARTBEAT: rules H-1 to H-7, H-16, V-5.

use crate::support::*;
use mavstack::config::{LinkClass, TxVersion};
use mavstack::dialect::{
    CommandAck, Heartbeat, MavAutopilot, MavCmd, MavModeFlag, MavSeverity, MavState, MavType, Statustext,
};
use mavstack::frame::Version;
use mavstack::{Config, Duration, Instant, LinkConfig, LinkId, Pulse, Stack, VehicleState};

/// Returns the times at which the ground station of `link` received a heartbeat.
fn times<const N: usize>(world: &World<N>, link: usize) -> Vec<Instant> {
    world.gcs[link].all::<Heartbeat>().into_iter().map(|(at, _)| at).collect()
}

/// H-1 to H-4, V-5: a heartbeat every second on every normal link, in both versions, without a peer and while disarmed, with
/// the vehicle's state.
#[test]
fn heartbeat_is_sent_on_every_normal_link() {
    let links = [
        LinkConfig::uart(57_600),
        LinkConfig::uart(57_600).with_version(TxVersion::V1),
        LinkConfig::uart(57_600).with_version(TxVersion::Auto),
    ];
    let mut setup = Setup { links, ..Setup::new() };
    setup.config.r#type = MavType::FIXED_WING;
    let mut world = World::new(setup);
    world.vehicle.state = Some(VehicleState {
        base_mode: MavModeFlag::SAFETY_ARMED | MavModeFlag::CUSTOM_MODE_ENABLED,
        custom_mode: 0x0A0B_0C0D,
        system_status: MavState::CRITICAL,
    });
    world.run_for(millis(2_999));
    for link in 0..3 {
        assert_eq!(times(&world, link), [1, 1_000, 2_000].map(Instant::from_millis), "link {link}");
        for frame in &world.gcs[link].received {
            assert_eq!(frame.header.source, VEHICLE);
            assert_eq!(frame.header.version, if link == 0 { Version::V2 } else { Version::V1 });
            let expected = Heartbeat {
                custom_mode: 0x0A0B_0C0D,
                r#type: MavType::FIXED_WING,
                autopilot: MavAutopilot::GENERIC,
                base_mode: MavModeFlag(0x81),
                system_status: MavState::CRITICAL,
                mavlink_version: 3,
            };
            assert_eq!(frame.decode(), Some(expected));
        }
        // S-16: each link has its own sequence.
        let seqs: Vec<u8> = world.gcs[link].received.iter().map(|frame| frame.header.seq).collect();
        assert_eq!(seqs, [0, 1, 2]);
    }
}

/// H-2: an address that a vehicle must not have cannot be configured.
#[test]
fn invalid_addresses_are_refused() {
    use mavstack::Address;
    use mavstack::config::VehicleAddress;
    for (system, component, possible) in
        [(0, 1, false), (255, 1, false), (1, 0, false), (1, 1, true), (254, 1, true), (7, 255, true)]
    {
        let address = VehicleAddress::new(Address::new(system, component));
        assert_eq!(address.is_some(), possible, "{system}/{component}");
    }
}

/// D-1, H-6: for 10,000 s, across the wrap of a 32-bit millisecond counter and with irregular polls, there is one heartbeat a
/// second, never early, never later than the next poll, and without drift.
#[test]
fn phase_does_not_drift() {
    let pulse: &Pulse = Box::leak(Box::new(Pulse::new()));
    let mut stack = Stack::<Tested, 1>::VACANT;
    stack.begin(Config::new(VEHICLE, pulse), [LinkConfig::uart(57_600)]);
    let mut vehicle = TestVehicle::new();
    let mut rng = Rng::new(5);
    let start = Instant::from_millis((1 << 32) - 5_000_000);
    let mut now = start;
    let mut sent = Vec::new();
    let mut worst_gap = Duration::ZERO;
    while now < start + secs(10_000) {
        pulse.tick();
        stack.poll(now, &mut vehicle);
        let len = stack.transmit(now, LinkId(0), &mut vehicle).len();
        if len > 0 {
            sent.push(now);
            stack.transmitted(LinkId(0), len);
        }
        let step = Duration::from_micros(1_000 + rng.below(49_000));
        worst_gap = worst_gap.max(step);
        now += step;
    }
    assert_eq!(sent.len(), 10_000);
    for (i, at) in (0..).zip(&sent) {
        let due = start + secs(i);
        assert!(*at >= due && *at - due <= worst_gap, "heartbeat {i} at {at:?}, due at {due:?}");
    }
}

/// H-1: the period is configurable.
#[test]
fn period_is_configurable() {
    let mut setup = Setup::<1>::new();
    setup.config.heartbeat_period = millis(250);
    let mut world = World::new(setup);
    world.run_for(millis(9_999));
    assert_eq!(world.gcs[0].count_of::<Heartbeat>(), 40);
}

/// H-5, H-6: the flight loop stops at any phase. The stack is still polled, but sends no heartbeat later than `max_loop_gap`.
/// When the loop resumes, one is sent at once, then one a second, without a burst.
#[test]
fn heartbeat_stops_and_resumes_with_the_flight_loop() {
    for phase in (0..1_000).step_by(53) {
        let mut world = World::new(Setup::<1>::new());
        world.run_for(secs(3).max(Duration::from_millis(3_000 + phase)));
        let stopped = world.now();
        world.loop_runs = false;
        world.run_for(secs(20));
        let last = *times(&world, 0).last().expect("there were some");
        assert!(last - stopped <= millis(500), "phase {phase}: a heartbeat at {last:?}, stopped at {stopped:?}");
        let resumed = world.now();
        world.loop_runs = true;
        world.gcs[0].forget();
        world.run_for(millis(3_500));
        let times = times(&world, 0);
        assert!(times[0] - resumed <= millis(2), "phase {phase}: at once");
        assert_eq!(times.len(), 4, "phase {phase}: no burst");
        assert!(times.windows(2).all(|pair| pair[1] - pair[0] == secs(1)), "phase {phase}: {times:?}");
    }
}

/// H-5: a gap shorter than `max_loop_gap` is a slow pass, not a fault.
#[test]
fn slow_pass_of_the_loop_is_not_a_fault() {
    let mut setup = Setup::<1>::new();
    setup.config.max_loop_gap = secs(2);
    let mut world = World::new(setup);
    for _ in 0..10 {
        world.loop_runs = true;
        world.step();
        world.loop_runs = false;
        world.run_for(millis(1_900));
    }
    assert_eq!(world.gcs[0].count_of::<Heartbeat>(), 20, "one per second for 19.01 s");
}

/// H-5: no heartbeat is sent before the first tick of the flight loop.
#[test]
fn there_is_no_heartbeat_before_the_first_tick() {
    let mut world = World::new(Setup::<1>::new());
    world.loop_runs = false;
    world.run_for(secs(5));
    assert_eq!(world.gcs[0].received.len(), 0);
    world.loop_runs = true;
    world.expect::<Heartbeat>(0, millis(2));
}

/// H-5: a latched fault is permanent, whatever ticks; the rest of the stack keeps running.
#[test]
fn fault_is_latched() {
    let mut world = World::new(Setup::<1>::new());
    world.run_for(millis(2_500));
    world.pulse.fault();
    world.gcs[0].forget();
    world.run_for(secs(60));
    assert_eq!(world.gcs[0].received.len(), 0);
    world.gcs[0].command_long(MavCmd::COMPONENT_ARM_DISARM, [0.0; 7]);
    world.expect::<CommandAck>(0, millis(5));
    assert_eq!(world.gcs[0].count_of::<Heartbeat>(), 0);
}

/// H-5: no heartbeat is sent while the vehicle reports a fault; one is sent soon after the fault has ended.
#[test]
fn vehicle_in_a_fault_sends_no_heartbeat() {
    let mut world = World::new(Setup::<1>::new());
    world.run_for(secs(2));
    let state = world.vehicle.state.take();
    world.gcs[0].forget();
    world.run_for(secs(30));
    assert_eq!(world.gcs[0].received.len(), 0);
    world.vehicle.state = state;
    world.expect::<Heartbeat>(0, millis(105));
    world.expect_no::<Heartbeat>(0, millis(900));
    world.expect::<Heartbeat>(0, millis(105));
}

/// D-4, H-6: after a stall, the first new frame is a single heartbeat, before the pending answers.
#[test]
fn heartbeat_is_sent_first_after_a_stall() {
    let mut world = World::new(Setup::<1>::new());
    world.run_for(millis(500));
    world.uarts[0].stall_writes_until(Instant::from_millis(8_000));
    for _ in 0..4 {
        world.gcs[0].command_long(MavCmd::NAV_LAND, [0.0; 7]);
    }
    world.stack.text(world.now(), MavSeverity::ALERT, "Battery low");
    world.gcs[0].forget();
    world.run_for(millis(7_400));
    assert_eq!(world.gcs[0].received.len(), 0);
    world.run_for(millis(200));
    let ids: Vec<u32> = world.gcs[0].received.iter().map(|frame| frame.header.id).collect();
    assert_eq!(ids, [0, 77, 77, 77, 77, 253]);
    assert_eq!(world.vehicle.commands().len(), 4);
}

/// H-5: after a stall, a link sends the current state. A heartbeat from before the flight loop stopped is not sent.
#[test]
fn stalled_link_sends_no_stale_heartbeat() {
    let mut world = World::new(Setup::<1>::new());
    world.run_for(millis(500));
    world.uarts[0].stall_writes_until(Instant::from_millis(10_000));
    world.run_for(millis(1_500));
    world.gcs[0].forget();
    world.loop_runs = false;
    world.run_for(secs(20));
    assert_eq!(world.gcs[0].count_of::<Heartbeat>(), 0, "the loop stopped at 2 s, the link recovered at 10 s");
}

/// H-7, L-3: a high-latency link carries no heartbeat, and nothing unsolicited.
#[test]
fn high_latency_link_gets_no_heartbeat() {
    let satellite = LinkConfig::uart(9_600).with_class(LinkClass::HighLatency);
    let mut world = World::new(Setup { links: [satellite, LinkConfig::uart(57_600)], ..Setup::new() });
    world.gcs[0].heartbeat_period = Some(secs(1));
    world.stack.text(world.now(), MavSeverity::EMERGENCY, "Engine failure");
    world.run_for(millis(59_999));
    assert_eq!(world.uarts[0].written(), 0);
    assert_eq!(world.gcs[1].count_of::<Heartbeat>(), 60);
}

/// A radio, a companion computer's link, and a satellite link, 2.5 s after boot.
fn three_links() -> World<3> {
    let links = [
        LinkConfig::uart(57_600),
        LinkConfig::uart(921_600),
        LinkConfig::uart(9_600).with_class(LinkClass::HighLatency),
    ];
    let mut world = World::new(Setup { links, ..Setup::new() });
    world.run_for(millis(2_500));
    world.gcs.iter_mut().for_each(Gcs::forget);
    world
}

/// H-4: a custom mode other than 0 is a mode, even if the vehicle declares no modes. The vehicle's own flags are sent too.
#[test]
fn custom_mode_enabled_is_set_with_a_mode() {
    let custom = MavModeFlag::CUSTOM_MODE_ENABLED;
    let (armed, auto) = (MavModeFlag::SAFETY_ARMED, MavModeFlag::AUTO_ENABLED);
    for (state, expected) in [
        (VehicleState::new(false), MavModeFlag::EMPTY),
        (VehicleState::new(true), armed),
        (VehicleState::new(false).with_mode(7), custom),
        (VehicleState::new(true).with_mode(7).with_flags(auto), armed | auto | custom),
        (VehicleState::new(false).with_flags(custom), custom),
    ] {
        let mut world = World::<1>::new(Setup::new());
        world.vehicle.state = Some(state);
        world.run_for(millis(10));
        let (_, heartbeat) = world.gcs[0].take::<Heartbeat>().unwrap();
        let told = (heartbeat.base_mode, heartbeat.custom_mode, heartbeat.system_status);
        assert_eq!(told, (expected, state.custom_mode, state.system_status));
        assert_eq!(state.is_armed(), expected.contains(armed));
    }
}

/// H-16, H-6, H-7: a change of mode, arming or status is reported at once on every normal link, and the periodic
/// schedule is unchanged.
#[test]
fn change_is_reported_at_once() {
    let armed = |state: &mut VehicleState| state.base_mode |= MavModeFlag::SAFETY_ARMED;
    let changes: [fn(&mut VehicleState); 3] =
        [armed, |state| state.custom_mode = 7, |state| state.system_status = MavState::CRITICAL];
    for change in changes {
        let mut world = three_links();
        change(world.vehicle.state.as_mut().unwrap());
        let state = world.vehicle.state.unwrap();
        world.run_for(secs(2));
        for link in 0..2 {
            assert_eq!(times(&world, link), [2_501, 3_000, 4_000].map(Instant::from_millis), "link {link}");
            let (_, first) = world.gcs[link].all::<Heartbeat>()[0];
            let told = (first.base_mode, first.custom_mode, first.system_status);
            assert_eq!(told, (state.base_mode, state.custom_mode, state.system_status));
        }
        assert_eq!(world.uarts[2].written(), 0);
    }
}

/// H-16: a change by a command is reported before its answer, because clients read the last HEARTBEAT when the ACK
/// arrives.
#[test]
fn heartbeat_precedes_the_answer_to_arming() {
    let mut world = three_links();
    world.vehicle.arms = true;
    for (command, is_armed) in [(1.0, true), (0.0, false)] {
        world.gcs[0].command_long(MavCmd::COMPONENT_ARM_DISARM, [command, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        world.run_for(millis(20));
        let ids: Vec<u32> = world.gcs[0].received.iter().map(|frame| frame.header.id).collect();
        assert_eq!(ids, [0, 77], "armed: {is_armed}");
        let (_, heartbeat) = world.gcs[0].take::<Heartbeat>().unwrap();
        assert_eq!(heartbeat.base_mode.contains(MavModeFlag::SAFETY_ARMED), is_armed);
        assert_eq!(world.gcs[1].count_of::<Heartbeat>(), 1, "on the other link too");
        world.run_for(millis(200));
        world.gcs.iter_mut().for_each(Gcs::forget);
    }
}

/// H-16: however often the state changes, a link sends at most one extra heartbeat every 200 ms, and the last state is
/// reported when this time is over. `next_deadline` wakes the driver for it.
#[test]
fn extra_heartbeats_are_limited() {
    let mut world = three_links();
    world.run_for(millis(520));
    world.gcs[0].forget();
    for mode in 100..150 {
        world.vehicle.state.as_mut().unwrap().custom_mode = mode;
        world.run_for(millis(9));
    }
    let last_change = world.now();
    while world.now() < last_change + millis(190) {
        world.skip_to(last_change + millis(190));
    }
    let times: Vec<u64> = times(&world, 0).into_iter().map(Instant::as_millis).collect();
    assert_eq!(times, [3_021, 3_221, 3_421, 3_621]);
    assert_eq!(world.gcs[0].all::<Heartbeat>()[3].1.custom_mode, 149);
}

/// H-16, H-5: a blocked link sends one extra heartbeat when it recovers; while the flight loop hangs, none is sent.
#[test]
fn extra_heartbeat_needs_room_and_credit() {
    let mut world = three_links();
    world.uarts[0].stall_writes_until(Instant::from_millis(2_800));
    world.vehicle.state.as_mut().unwrap().custom_mode = 8;
    world.run_for(millis(50));
    world.vehicle.state.as_mut().unwrap().custom_mode = 9;
    world.run_for(millis(400));
    assert_eq!(world.gcs[0].all::<Heartbeat>().len(), 1);
    assert_eq!(world.gcs[0].all::<Heartbeat>()[0].1.custom_mode, 9, "the state when it is sent");
    world.loop_runs = false;
    world.run_for(secs(1));
    world.gcs.iter_mut().for_each(Gcs::forget);
    world.vehicle.state.as_mut().unwrap().custom_mode = 10;
    world.run_for(secs(2));
    assert_eq!((world.gcs[0].received.len(), world.gcs[1].received.len()), (0, 0));
    world.loop_runs = true;
    world.run_for(millis(300));
    assert_eq!((times(&world, 0).len(), times(&world, 1).len()), (1, 1), "no burst");
}

/// H-16: a change to a fault sends nothing, and does not wake the driver.
#[test]
fn change_to_a_fault_sends_nothing() {
    let mut world = three_links();
    let state = world.vehicle.state.unwrap();
    world.vehicle.state.as_mut().unwrap().custom_mode = 8;
    world.uarts[0].stall_writes_until(Instant::from_millis(2_600));
    world.run_for(millis(10));
    world.vehicle.state = None;
    world.run_for(millis(200));
    assert_eq!(times(&world, 0).len(), 0);
    assert!(world.stack.next_deadline(world.now()) > world.now());
    // After the fault, the link without the latest state gets it at once.
    world.vehicle.state = Some(VehicleState { custom_mode: 8, ..state });
    world.run_for(millis(5));
    assert_eq!((times(&world, 0).len(), times(&world, 1).len()), (1, 1));
    assert_eq!(world.gcs[0].all::<Heartbeat>()[0].1.custom_mode, 8);
}

/// H-16, D-4: a flapping state does not saturate a slow link: an extra heartbeat waits for room, so texts are sent in between,
/// and the last state is reported.
#[test]
fn extra_heartbeats_do_not_fill_a_slow_link() {
    let mut world = World::new(Setup { links: [LinkConfig::uart(1_200)], ..Setup::<1>::new() });
    world.run_for(millis(2_500));
    world.gcs[0].forget();
    for said in 0..3 {
        world.stack.text(world.now(), MavSeverity::WARNING, &format!("{said}: a text of some forty bytes, too long"));
    }
    for mode in 0..200 {
        world.vehicle.state.as_mut().unwrap().custom_mode = mode;
        world.run_for(millis(50));
    }
    assert_eq!(world.gcs[0].count_of::<Statustext>(), 3);
    world.run_for(millis(800));
    assert_eq!(world.gcs[0].all::<Heartbeat>().last().unwrap().1.custom_mode, 199);
}
