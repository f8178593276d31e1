//! Which frames are for us, and what happens to unhandled ones: rules, C-2. Forwarding is in `forwarding.rs`.

use crate::Forwarder;
use crate::support::*;
use mavstack::dialect::*;
use mavstack::{Address, LinkConfig, LinkId, Message};

/// C-2: a frame for a component of our system that was never heard is neither handled, answered nor forwarded, but
/// counted. Until 2026 the guide required us to handle it (mavlink-devguide#725). Once the component is heard, frames for it
/// are forwarded to its link.
#[test]
fn frames_for_unknown_components_of_our_system_are_not_handled() {
    let mut world = Forwarder::<3>::of(Setup { links: [LinkConfig::uart(115_200); 3], ..Setup::new() });
    world.run_for(millis(10));
    let camera = Address::new(1, 100);
    let send = |world: &mut Forwarder<3>| {
        world.vehicle.calls.clear();
        world.gcs.iter_mut().for_each(Gcs::forget);
        let long = world.gcs[0].long(MavCmd::NAV_LAND, [0.0; 7]);
        world.gcs[0].send(&CommandLong { target_component: camera.component.wire(), ..long });
        let (target_system, target_component) = (camera.system.wire(), camera.component.wire());
        world.gcs[0].send(&PlayTune { target_system, target_component, ..PlayTune::default() });
        world.gcs[0].send(&ParamRequestList { target_system, target_component });
        world.gcs[0].send(&MissionRequestList { target_system, target_component, ..MissionRequestList::default() });
        world.run_for(millis(300));
        let is_handled = world.vehicle.calls.iter().any(|call| !matches!(call, Call::Peer(_)));
        let answers = world.gcs[0].count_of::<CommandAck>()
            + world.gcs[0].count_of::<ParamValue>()
            + world.gcs[0].count_of::<MissionCount>()
            + world.gcs[0].count_of::<MissionAck>();
        let ids = [CommandLong::ID, PlayTune::ID, ParamRequestList::ID, MissionRequestList::ID];
        let forwarded =
            |link: usize| world.gcs[link].received.iter().filter(|frame| ids.contains(&frame.header.id)).count();
        (is_handled, answers, [1, 2].map(forwarded))
    };
    assert_eq!(send(&mut world), (false, 0, [0, 0]));
    let no_route = world.stack.forward_counters(LinkId(0)).unwrap().no_route;
    let counters = world.stack.link_counters(LinkId(0)).unwrap();
    assert_eq!((no_route, counters.not_ours, counters.unhandled), (4, 4, 0));
    // Hearing another component of the system makes no difference.
    world.gcs[2].send_from(Address::new(1, 191), &Attitude::default());
    world.run_for(millis(10));
    assert_eq!(send(&mut world), (false, 0, [0, 0]));
    world.gcs[1].send_from(camera, &Attitude::default());
    world.run_for(millis(10));
    assert_eq!(send(&mut world), (false, 0, [4, 0]));
}

/// a message to us that neither the stack nor the vehicle handles, such as a setpoint, is counted. A message that the
/// vehicle handles, a broadcast, or a message to another vehicle is not.
#[test]
fn unhandled_messages_are_counted() {
    let mut world = World::new(Setup::<1>::new());
    let unhandled = |world: &mut World<1>| {
        world.run_for(millis(5));
        world.stack.link_counters(LinkId(0)).unwrap().unhandled
    };
    let local = SetPositionTargetLocalNed { target_system: 1, target_component: 1, ..Default::default() };
    world.gcs[0].send(&local);
    world.gcs[0].send(&SetPositionTargetGlobalInt { target_system: 1, target_component: 1, ..Default::default() });
    world.gcs[0].send(&SetAttitudeTarget { target_system: 1, target_component: 1, ..Default::default() });
    assert_eq!(unhandled(&mut world), 3);
    world.gcs[0].send(&SetPositionTargetLocalNed { target_component: 0, ..local });
    assert_eq!(unhandled(&mut world), 4, "to all our components");
    for _ in 0..10 {
        world.gcs[0].send(&Attitude::default());
        world.gcs[0].send(&SetPositionTargetLocalNed { target_system: 0, target_component: 0, ..local });
        world.gcs[0].send(&SetPositionTargetLocalNed { target_system: 2, ..local });
        world.gcs[0].send(&Gcs::heartbeat());
        world.gcs[0].command_long(MavCmd::NAV_LAND, [0.0; 7]);
    }
    assert_eq!(unhandled(&mut world), 4);
    world.vehicle.handles.insert(SetPositionTargetLocalNed::ID);
    world.gcs[0].send(&local);
    assert_eq!(unhandled(&mut world), 4);
}
