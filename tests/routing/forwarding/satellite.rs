//! What is forwarded to a high-latency link: rules, L-3 to L-5.

use super::*;

/// R-13, L-3, L-4, L-5: commands and answers for peers on the satellite link are forwarded to it; from it, these and
/// HIGH_LATENCY2 are.
#[test]
fn satellite_gets_commands_only() {
    let satellite = LinkConfig::uart(2_400).with_class(LinkClass::HighLatency);
    let mut world = world([LinkConfig::uart(115_200), satellite]);
    introduce(&mut world, 1, STATION);
    let (system, component) = (STATION.system.wire(), STATION.component.wire());
    let command = CommandLong { target_system: system, target_component: component, ..Default::default() };
    let int = CommandInt { target_system: system, target_component: component, ..Default::default() };
    let ack = CommandAck { target_system: system, target_component: component, ..Default::default() };
    let cancel = CommandCancel { target_system: system, target_component: component, ..Default::default() };
    macro_rules! reaches {
        ($from:expr, $address:expr, $message:expr) => {{
            world.run_for(secs(2));
            forget(&mut world);
            reaches(&mut world, $from, $address, $message)
        }};
    }
    assert_eq!(reaches!(0, WINGMAN, &command), [1]);
    assert_eq!(reaches!(0, WINGMAN, &int), [1]);
    assert_eq!(reaches!(0, WINGMAN, &ack), [1]);
    assert_eq!(reaches!(0, WINGMAN, &cancel), [1]);
    assert_eq!(reaches!(0, WINGMAN, &CommandLong { target_system: 0, ..command }), [0; 0]);
    assert_eq!(reaches!(0, WINGMAN, &CommandAck { target_system: 0, target_component: 0, ..ack }), [0; 0]);
    assert_eq!(reaches!(0, WINGMAN, &tune(STATION)), [0; 0]);
    assert_eq!(reaches!(0, WINGMAN, &HighLatency2::default()), [0; 0]);
    assert_eq!(reaches!(0, WINGMAN, &Gcs::heartbeat()), [0; 0]);
    // From the satellite.
    assert_eq!(reaches!(1, Address::new(3, 1), &HighLatency2::default()), [0]);
    assert_eq!(reaches!(1, STATION, &CommandLong { target_system: 2, target_component: 1, ..command }), [0]);
    assert_eq!(reaches!(1, STATION, &Gcs::heartbeat()), [0; 0]);
    assert_eq!(reaches!(1, STATION, &tune(WINGMAN)), [0; 0]);
}

/// a station that was once heard by satellite and is alive on a radio gets its frames by radio only; once it times
/// out there, by satellite again. A link without forwarding, or one that only gets frames for its own components, is not an
/// alternative route.
#[test]
fn satellite_is_not_used_for_a_peer_alive_elsewhere() {
    let radio = LinkConfig::uart(57_600);
    let ack = |component: u8| CommandAck { target_system: 255, target_component: component, ..CommandAck::default() };
    for (radio, components, is_other_way) in [
        (radio, [190, 0], true),
        (radio.with_class(LinkClass::Private), [190, 190], true),
        (radio.with_class(LinkClass::Private), [0, 0], false),
        (radio.with_forwarding(false), [190, 0], false),
    ] {
        let satellite = LinkConfig::uart(9_600).with_class(LinkClass::HighLatency);
        let mut world = world([radio, LinkConfig::uart(115_200), satellite]);
        introduce(&mut world, 2, STATION);
        let [one, all] = components.map(ack);
        assert_eq!(reaches(&mut world, 1, COMPANION, &one), [2]);
        let by_radio = |component| if component == 0 && radio.class == LinkClass::Private { vec![] } else { vec![0] };
        world.gcs[0].heartbeat_period = Some(secs(1));
        world.run_for(secs(120));
        for ack in [one, all] {
            let expected = if is_other_way { by_radio(ack.target_component) } else { vec![2] };
            world.run_for(millis(300));
            forget(&mut world);
            assert_eq!(reaches(&mut world, 1, COMPANION, &ack), expected, "{radio:?} to {}", ack.target_component);
        }
        world.gcs[0].heartbeat_period = None;
        world.run_for(secs(7));
        forget(&mut world);
        let expected = if radio.forwards && is_other_way { vec![0, 2] } else { vec![2] };
        assert_eq!(reaches(&mut world, 1, COMPANION, &one), expected, "timed out on {radio:?}");
        // Any frame by radio shows for five seconds that the station is there.
        introduce(&mut world, 0, STATION);
        let expected = if is_other_way { vec![0] } else { vec![2] };
        assert_eq!(reaches(&mut world, 1, COMPANION, &one), expected, "heard on {radio:?}");
    }
}

/// a command to all components of a system reaches the component that is heard by satellite only, although
/// another component of the system is alive on a radio. It is not paid for once that component is alive on the radio too.
#[test]
fn all_components_are_reached_by_satellite_and_radio() {
    let satellite = LinkConfig::uart(9_600).with_class(LinkClass::HighLatency);
    let mut world = world([LinkConfig::uart(57_600), LinkConfig::uart(115_200), satellite]);
    let [on_radio, on_satellite] = [Address::new(2, 1), Address::new(2, 191)];
    let command = |component| CommandLong { target_system: 2, target_component: component, ..Default::default() };
    world.gcs[0].address = on_radio;
    world.gcs[0].heartbeat_period = Some(secs(1));
    world.run_for(secs(3));
    introduce(&mut world, 2, on_satellite);
    // Longer than a frame by satellite makes its sender reachable there.
    world.run_for(secs(7));
    forget(&mut world);
    assert_eq!(reaches(&mut world, 1, COMPANION, &command(0)), [0, 2], "to all components");
    assert_eq!(reaches(&mut world, 1, COMPANION, &command(1)), [0], "to the one on the radio");
    world.run_for(secs(2));
    forget(&mut world);
    assert_eq!(reaches(&mut world, 1, COMPANION, &command(191)), [2], "to the one by satellite");
    introduce(&mut world, 0, on_satellite);
    assert_eq!(reaches(&mut world, 1, COMPANION, &command(0)), [0], "both are on the radio now");
}
