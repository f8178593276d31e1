//! The current item of the mission: commands, MISSION_SET_CURRENT, MISSION_CURRENT, MISSION_ITEM_REACHED (M-90 to M-95).

use crate::support::*;
use mavstack::config::LinkClass;
use mavstack::dialect::{
    CommandAck, CommandLong, MavCmd, MavMissionType, MavResult, MissionCurrent, MissionItemReached, MissionSetCurrent,
    MissionState, Statustext,
};
use mavstack::plan::PlanFault;
use mavstack::{Item, LinkConfig, Message, PlanType, plan_memory};

type Plans = Tested<plan_memory!(mission: 20)>;

const NAN: f32 = f32::NAN;

fn world<const N: usize>(items: u16) -> World<N, Plans> {
    let mut world = World::of(Setup::new());
    world.upload(0, &plan(items, 1)).expect("accepted");
    settle(&mut world);
    world
}

/// Runs until just after a MISSION_CURRENT, and forgets all received frames.
fn settle<const N: usize>(world: &mut World<N, Plans>) {
    world.expect::<MissionCurrent>(0, secs(2));
    world.run_for(millis(100));
    world.gcs.iter_mut().for_each(Gcs::forget);
    world.vehicle.calls.clear();
}

fn command<const N: usize>(world: &mut World<N, Plans>, id: MavCmd, p1: f32, p2: f32) -> MavResult {
    world.gcs[0].command_long(id, [p1, p2, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let ack: CommandAck = world.expect(0, millis(50));
    assert_eq!(ack.command, id);
    ack.result
}

/// M-92: every combination of parameters.
#[test]
fn do_set_mission_current() {
    use MavResult as R;
    let mut world = world::<1>(3);
    for (p1, p2, result, call) in [
        (2.0, 0.0, R::ACCEPTED, Some((2, false))),
        (0.0, 1.0, R::ACCEPTED, Some((0, true))),
        (1.0, NAN, R::ACCEPTED, Some((1, false))),
        (-1.0, 1.0, R::ACCEPTED, Some((1, true))),
        (-1.0, 0.0, R::ACCEPTED, Some((1, false))),
        (3.0, 0.0, R::FAILED, None),
        (70_000.0, 0.0, R::FAILED, None),
        (1e20, 0.0, R::FAILED, None),
        (1.5, 0.0, R::DENIED, None),
        (-2.0, 0.0, R::DENIED, None),
        (NAN, 0.0, R::DENIED, None),
        (f32::INFINITY, 0.0, R::DENIED, None),
        (1.0, 2.0, R::DENIED, None),
        (1.0, 0.5, R::DENIED, None),
        (1.0, -1.0, R::DENIED, None),
    ] {
        world.vehicle.calls.clear();
        world.gcs[0].forget();
        assert_eq!(command(&mut world, MavCmd::DO_SET_MISSION_CURRENT, p1, p2), result, "{p1} {p2}");
        let call = call.map(|(seq, reset)| Call::SetCurrent(seq, reset));
        assert_eq!(world.vehicle.calls, Vec::from_iter(call), "{p1} {p2}");
        if result == R::ACCEPTED {
            let current: MissionCurrent = world.expect(0, millis(50));
            assert_eq!(current.seq, world.vehicle.progress.current, "sent at once");
        }
    }
    // The vehicle may refuse.
    world.vehicle.progress_verdict = R::TEMPORARILY_REJECTED;
    assert_eq!(command(&mut world, MavCmd::DO_SET_MISSION_CURRENT, 1.0, 0.0), R::TEMPORARILY_REJECTED);
    // Without a mission no item can be set.
    world.vehicle.progress_verdict = R::ACCEPTED;
    world.clear(0, MavMissionType::MISSION).expect("cleared");
    for p1 in [0.0, -1.0] {
        assert_eq!(command(&mut world, MavCmd::DO_SET_MISSION_CURRENT, p1, 0.0), R::FAILED);
    }
}

/// M-93: MISSION_CURRENT is the only answer, on all links; a failure is also explained by a text.
#[test]
fn mission_set_current() {
    let mut world = world::<2>(3);
    let set = |seq| MissionSetCurrent { seq, target_system: 1, target_component: 1 };
    world.gcs[1].send(&set(2));
    for link in [0, 1] {
        assert_eq!(world.expect::<MissionCurrent>(link, millis(100)).seq, 2);
    }
    assert_eq!(world.vehicle.calls, [Call::SetCurrent(2, false)]);
    assert_eq!(world.gcs[0].count_of::<Statustext>(), 0);

    settle(&mut world);
    world.gcs[1].send(&set(3));
    for link in [0, 1] {
        assert_eq!(world.expect::<MissionCurrent>(link, millis(100)).seq, 2, "unchanged");
        let text: Statustext = world.expect(link, millis(100));
        assert_eq!(text.text.as_str(), Some("Mission item 3 cannot be made current"));
    }
    assert_eq!(world.vehicle.calls, []);
}

/// M-46, M-93: a sender that is not authorised to send MAV_CMD_DO_SET_MISSION_CURRENT cannot use MISSION_SET_CURRENT either:
/// the vehicle is not asked, a text says so, and MISSION_CURRENT is unchanged.
#[test]
fn mission_set_current_needs_control() {
    let mut world = world::<2>(3);
    world.vehicle.controller = Some(world.gcs[1].address);
    world.gcs[0].address = OTHER_STATION;
    assert_eq!(command(&mut world, MavCmd::DO_SET_MISSION_CURRENT, 2.0, 0.0), MavResult::NOT_IN_CONTROL);
    settle(&mut world);
    let set = |seq| MissionSetCurrent { seq, target_system: 1, target_component: 1 };
    world.gcs[0].send(&set(2));
    for link in [0, 1] {
        assert_eq!(world.expect::<MissionCurrent>(link, millis(100)).seq, 0, "unchanged");
        let text: Statustext = world.expect(link, millis(100));
        assert_eq!(text.text.as_str(), Some("Mission item 2 cannot be made current"));
    }
    assert_eq!(world.vehicle.calls, []);
    settle(&mut world);
    world.gcs[1].send(&set(2));
    assert_eq!(world.expect::<MissionCurrent>(0, millis(100)).seq, 2);
    assert_eq!(world.vehicle.calls, [Call::SetCurrent(2, false)]);
}

/// M-95: the items are checked, and the vehicle learns which parameters were omitted.
#[test]
fn mission_start() {
    use MavResult as R;
    let mut world = world::<1>(3);
    for (p1, p2, result, call) in [
        (0.0, 0.0, R::ACCEPTED, Some((Some(0), None))),
        (1.0, 2.0, R::ACCEPTED, Some((Some(1), Some(2)))),
        (1.0, 1.0, R::ACCEPTED, Some((Some(1), Some(1)))),
        (NAN, NAN, R::ACCEPTED, Some((None, None))),
        (NAN, 1.0, R::ACCEPTED, Some((None, Some(1)))),
        (2.0, 1.0, R::DENIED, None),
        (3.0, 0.0, R::DENIED, None),
        (0.0, 3.0, R::DENIED, None),
        (0.5, 0.0, R::DENIED, None),
        (-1.0, 0.0, R::DENIED, None),
    ] {
        world.vehicle.calls.clear();
        assert_eq!(command(&mut world, MavCmd::MISSION_START, p1, p2), result, "{p1} {p2}");
        let call = call.map(|(first, last)| Call::StartMission(first, last));
        assert_eq!(world.vehicle.calls, Vec::from_iter(call), "{p1} {p2}");
    }
    // The vehicle sees the sender and whether it was a broadcast, which it may refuse (C-1).
    let start = world.gcs[0].long(MavCmd::MISSION_START, [0.0; 7]);
    world.gcs[0].send(&CommandLong { target_system: 0, ..start });
    world.vehicle.refuses_broadcast = true;
    assert_eq!(world.expect::<CommandAck>(0, millis(50)).result, R::DENIED);
    world.clear(0, MavMissionType::MISSION).expect("cleared");
    assert_eq!(command(&mut world, MavCmd::MISSION_START, 0.0, 0.0), R::FAILED);
}

/// M-91: sent once on every normal link, before the next item becomes current there.
#[test]
fn item_reached_is_sent_before_the_next_item_is_current() {
    let setup = Setup::<3>::new();
    let links = [
        LinkConfig::uart(57_600),
        LinkConfig::uart(57_600),
        LinkConfig::uart(2_400).with_class(LinkClass::HighLatency),
    ];
    let mut world = World::<3, Plans>::of(Setup { links, ..setup });
    world.upload(0, &plan(6, 1)).expect("accepted");
    settle(&mut world);
    for seq in 0..5 {
        // In this order in the flight loop: the vehicle moves on, then reports the item.
        world.vehicle.progress.current = seq + 1;
        let now = world.now();
        world.stack.mission_item_reached(now, seq);
        world.run_for(millis(if seq < 3 { 100 } else { 0 }));
    }
    world.run_for(secs(3));
    for link in [0, 1] {
        let said = world.gcs[link].received.iter().filter_map(|frame| {
            let reached = frame.decode::<MissionItemReached>().map(|reached| (frame.header.id, reached.seq));
            reached.or_else(|| frame.decode::<MissionCurrent>().map(|current| (frame.header.id, current.seq)))
        });
        let mut reached = Vec::new();
        for (id, seq) in said {
            if id == MissionItemReached::ID {
                reached.push(seq);
            } else {
                assert_eq!(usize::from(seq), reached.len(), "item {seq} is current, reached are {reached:?}");
            }
        }
        assert_eq!(reached, [0, 1, 2, 3, 4]);
    }
    assert_eq!(world.gcs[2].count_of::<MissionItemReached>(), 0);
}

/// M-91: repeated by option, three times at most, and not after the plan has changed.
#[test]
fn item_reached_is_repeated_by_option() {
    for (repeats, said) in [(0, 1), (2, 3), (200, 4)] {
        let mut setup = Setup::<1>::new();
        setup.config.item_reached_repeats = repeats;
        let mut world = World::<1, Plans>::of(setup);
        world.upload(0, &plan(4, 1)).expect("accepted");
        settle(&mut world);
        let now = world.now();
        world.stack.mission_item_reached(now, 2);
        world.run_for(secs(10));
        let times: Vec<_> =
            world.gcs[0].all::<MissionItemReached>().iter().map(|(at, _)| (*at - now).as_millis()).collect();
        assert_eq!(times.len(), said, "{times:?}");
        assert!((0..).zip(&times).all(|(i, at)| (i * 1_000..i * 1_000 + 50).contains(at)), "{times:?}");
        world.gcs[0].forget();
        let now = world.now();
        world.stack.mission_item_reached(now, 3);
        world.upload(0, &plan(4, 2)).expect("accepted");
        world.run_for(secs(3));
        assert!(world.gcs[0].count_of::<MissionItemReached>() <= 1, "the items were of the old plan");
    }
}

/// M-94: after an upload of a shorter plan the current item is within it, whatever the vehicle reports.
#[test]
fn current_item_is_within_a_shorter_plan() {
    let mut world = world::<1>(6);
    world.vehicle.progress.current = 5;
    world.upload(0, &plan(2, 2)).expect("accepted");
    assert_eq!(world.vehicle.progress.current, 0, "the vehicle was notified");
    world.vehicle.progress.current = 5;
    settle(&mut world);
    assert_eq!(world.expect::<MissionCurrent>(0, secs(2)).seq, 1);
}

/// M-90: every mission state.
#[test]
fn mission_current_in_every_state() {
    let mut world = World::<1, Plans>::of(Setup::new());
    let current = |world: &mut World<1, Plans>| {
        world.gcs[0].forget();
        world.expect::<MissionCurrent>(0, secs(2))
    };
    let none = current(&mut world);
    assert_eq!((none.seq, none.total, none.mission_state), (0, 65_535, MissionState::NO_MISSION));
    let id = world.upload(0, &plan(4, 1)).expect("accepted").opaque_id;
    for state in [MissionState::NOT_STARTED, MissionState::ACTIVE, MissionState::PAUSED, MissionState::COMPLETE] {
        for (in_mission_mode, mission_mode) in [(true, 1), (false, 2)] {
            world.vehicle.progress = mavstack::Progress { current: 3, state, in_mission_mode };
            world.run_for(millis(50));
            let current = current(&mut world);
            let expected =
                MissionCurrent { seq: 3, total: 4, mission_state: state, mission_mode, mission_id: id, ..current };
            assert_eq!(current, expected);
            assert_eq!((current.fence_id, current.rally_points_id), (0, 0));
        }
    }
}

/// A plan that the firmware loads is checked like an upload, and announced.
#[test]
fn firmware_can_load_a_plan() {
    let mut world = world::<1>(2);
    let items: Vec<Item> = world.stack.mission().items().to_vec();
    let (now, old) = (world.now(), world.stack.mission().id());
    let longer = items.iter().chain(&items).copied();
    assert_eq!(world.stack.load_plan(now, PlanType::Mission, longer, &mut world.vehicle), Ok(()));
    assert_eq!(world.stack.mission().items().len(), 4);
    world.run_for(millis(50));
    assert_ne!(world.expect::<MissionCurrent>(0, millis(50)).mission_id, old);

    use mavstack::dialect::MavMissionResult as R;
    let unknown = Item { command: MavCmd::NAV_ROI, ..items[1] };
    let fault = |seq, result| Err(PlanFault { seq, result });
    for (plan, items, result) in [
        (PlanType::Mission, vec![items[0], unknown], fault(Some(1), R::UNSUPPORTED)),
        (PlanType::Mission, vec![items[0]; 21], fault(None, R::NO_SPACE)),
        (PlanType::Fence, vec![], fault(None, R::UNSUPPORTED)),
    ] {
        assert_eq!(world.stack.load_plan(now, plan, items, &mut world.vehicle), result);
        assert_eq!(world.stack.mission().items().len(), 4, "unchanged");
    }
    assert_eq!(world.stack.load_plan(now, PlanType::Mission, [], &mut world.vehicle), Ok(()));
    assert_eq!((world.stack.mission().items().len(), world.stack.mission().id()), (0, 0));
}

/// Q-1, L-4: MISSION_CURRENT can be requested on normal links, for a valid response target.
#[test]
fn mission_current_can_be_requested() {
    let satellite = LinkConfig::uart(9_600).with_class(LinkClass::HighLatency);
    let setup = Setup { links: [LinkConfig::uart(115_200), satellite], ..Setup::new() };
    let mut world = World::<2, Plans>::of(setup);
    settle(&mut world);
    for (link, target, is_taken) in [(0, 0.0, true), (0, 1.0, true), (0, 3.0, false), (1, 0.0, false)] {
        world.gcs[link].forget();
        let id = MissionCurrent::ID as f32;
        world.gcs[link].command_long(MavCmd::REQUEST_MESSAGE, [id, 0.0, 0.0, 0.0, 0.0, 0.0, target]);
        let ack: CommandAck = world.expect(link, secs(5));
        assert_eq!(ack.result == MavResult::ACCEPTED, is_taken, "link {link}, target {target}");
    }
    assert_eq!(world.gcs[1].count_of::<MissionCurrent>(), 0);
}
