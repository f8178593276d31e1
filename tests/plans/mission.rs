//! Plan transfers over simulated lines with latency, losses and several clients: uploads, downloads and clears.

mod clients;

use crate::support::tested::Planned;
use crate::support::*;
use mavstack::__private::PlanMemory;
use mavstack::config::{LinkClass, TxVersion};
use mavstack::dialect::{
    CommandAck, MavCmd, MavMissionResult, MavMissionType, MavResult, MissionAck, MissionClearAll, MissionCount,
    MissionCurrent, MissionItem, MissionItemInt, MissionRequest, MissionRequestInt, MissionRequestList,
    MissionSetCurrent, MissionState, Statustext,
};
use mavstack::frame::Version;
use mavstack::message::LatLon;
use mavstack::plan::FirstWaypointLimit;
use mavstack::plan::PlanCounters;
use mavstack::{Item, LinkConfig, LinkId, Message, Peer, PlanType, plan_memory};

const CAPACITY: u16 = 60;

type Plans = Tested<plan_memory!(mission: 60)>;

type TestWorld<const N: usize> = World<N, Plans>;

const MISSION: MavMissionType = MavMissionType::MISSION;
const ACCEPTED: MavMissionResult = MavMissionResult::ACCEPTED;

fn world<const N: usize>() -> TestWorld<N> {
    World::of(Setup::new())
}

/// Returns the bytes of each item, without the fields that belong to the transfer.
fn content(items: &[MissionItemInt]) -> Vec<Vec<u8>> {
    let content = |item: &MissionItemInt| {
        let mut bytes = vec![0; MissionItemInt::MAX_LEN];
        let item = MissionItemInt { target_system: 0, target_component: 0, current: 0, ..*item };
        item.encode(&mut bytes).expect("room");
        bytes
    };
    items.iter().map(content).collect()
}

fn item_of(message: &MissionItemInt) -> Item {
    let MissionItemInt { frame, command, autocontinue, param1, param2, param3, param4, x, y, z, .. } = *message;
    Item { frame, command, autocontinue, params: [param1, param2, param3, param4], x, y, z }
}

fn assert_downloads<const N: usize>(world: &mut TestWorld<N>, link: usize, items: &[MissionItemInt]) {
    let downloaded = world.download(link, MISSION).expect("a complete download");
    assert_eq!(content(&downloaded), content(items));
}

/// M-6, M-21: a plan of any length is downloaded as it was uploaded, starting with item 0. A plan with one item too many is
/// refused before its first item is requested.
#[test]
fn uploaded_plan_is_downloaded_unchanged() {
    let mut world = world::<1>();
    for len in [1, 2, CAPACITY, 3, 0] {
        let items = plan(len, len);
        let ack = world.upload(0, &items).expect("accepted");
        assert_eq!(ack.opaque_id, world.stack.mission().id());
        assert_eq!(ack.opaque_id == 0, len == 0);
        assert_downloads(&mut world, 0, &items);
    }
    world.upload(0, &plan(2, 1)).expect("accepted");
    world.gcs[0].forget();
    let refused = world.upload(0, &plan(CAPACITY + 1, 0));
    assert_eq!(refused, Err(TransferError::Refused(MavMissionResult::NO_SPACE)));
    assert_eq!(world.gcs[0].count_of::<MissionRequestInt>(), 0);
    assert_downloads(&mut world, 0, &plan(2, 1));
}

/// M-2, M-21: each plan can be filled to its capacity and no further, whichever plan is the largest.
#[test]
fn each_plan_can_be_filled() {
    fn fills<P: PlanMemory + Planned<Tested<P>> + 'static>() {
        let mut world = World::<1, Tested<P>>::of(Setup::new());
        for (kind, capacity) in PlanType::ALL.into_iter().zip(P::CAPACITIES) {
            let mission_type = kind.mission_type();
            let command = match kind {
                PlanType::Mission => MavCmd::NAV_WAYPOINT,
                PlanType::Fence => MavCmd::NAV_FENCE_CIRCLE_INCLUSION,
                PlanType::Rally => MavCmd::NAV_RALLY_POINT,
            };
            let of_kind = |count| {
                let item =
                    |item| MissionItemInt { mission_type, command, param1: 9.0, param2: 0.0, param4: 0.0, ..item };
                plan(count, count).into_iter().map(item).collect::<Vec<_>>()
            };
            world.upload(0, &of_kind(capacity)).expect("room");
            assert_eq!(world.download(0, mission_type).expect("complete").len(), usize::from(capacity));
            let refused = world.upload(0, &of_kind(capacity + 1));
            assert_eq!(refused, Err(TransferError::Refused(MavMissionResult::NO_SPACE)));
        }
    }
    fills::<plan_memory!(mission: 9, fence: 5, rally: 2)>();
    fills::<plan_memory!(mission: 5, fence: 9, rally: 2)>();
    fills::<plan_memory!(mission: 2, fence: 5, rally: 9)>();
}

/// Each upload is counted by its outcome.
#[test]
fn uploads_are_counted_by_outcome() {
    let mut world = world::<1>();
    let counters = |world: &TestWorld<1>| world.stack.plan_counters();
    assert_eq!(counters(&world), PlanCounters::default());
    world.upload(0, &plan(2, 1)).expect("accepted");
    assert_eq!(counters(&world), counted(|counters: &mut PlanCounters| counters.accepted = 1));
    let stranger = MissionItemInt { command: MavCmd(31_999), ..plan(1, 2)[0] };
    world.upload(0, &[stranger]).expect_err("no such command");
    assert_eq!((counters(&world).accepted, counters(&world).refused), (1, 1));
    let (target_system, target_component) = (1, 1);
    world.gcs[0].send(&MissionCount { target_system, target_component, count: 3, ..MissionCount::default() });
    world.gcs[0].send(&MissionItemInt { target_system, target_component, ..plan(3, 1)[2] });
    world.run_for(secs(60));
    assert_eq!((counters(&world).out_of_place, counters(&world).abandoned), (1, 1), "the first item was not sent");
    assert_eq!((counters(&world).accepted, counters(&world).refused), (1, 1));
}

/// A lossless transfer takes a request and an item for each item, and two more frames: no frame is sent twice.
#[test]
fn lossless_transfer_repeats_no_frame() {
    let mut world = World::<1, Plans>::of(Setup {
        links: [LinkConfig::uart(57_600)],
        lines: [LineConfig::radio(57_600, millis(20))],
        ..Setup::new()
    });
    world.upload(0, &plan(CAPACITY, 1)).expect("accepted");
    world.run_for(secs(2));
    let gcs = &world.gcs[0];
    assert_eq!(gcs.count_of::<MissionRequestInt>(), usize::from(CAPACITY));
    assert_eq!(gcs.count_of::<MissionAck>(), 1);
    world.gcs[0].forget();
    assert_downloads(&mut world, 0, &plan(CAPACITY, 1));
    let gcs = &world.gcs[0];
    assert_eq!((gcs.count_of::<MissionItemInt>(), gcs.count_of::<MissionCount>()), (usize::from(CAPACITY), 1));
}

/// M-40: transfers complete although any single frame is lost.
#[test]
fn loss_of_any_single_frame_is_recovered() {
    let items = plan(4, 1);
    for up in [true, false] {
        for moment in 0..40 {
            let mut world = world::<1>();
            world.run_for(millis(1_500));
            let silence = |world: &mut TestWorld<1>, now: u64| {
                let loss = if now == moment { 1.0 } else { 0.0 };
                if up {
                    world.lines[0].set_up(|wire| wire.faults.frame_loss = loss);
                } else {
                    world.lines[0].set_down(|wire| wire.faults.frame_loss = loss);
                }
            };
            let mut upload = Upload::new(&world.gcs[0], &items);
            for now in 0..5_000 {
                silence(&mut world, now);
                world.step();
                let now = world.now();
                if upload.poll(now, &mut world.gcs[0]).is_some() {
                    break;
                }
            }
            let ack = upload.result().expect("an end");
            // MAVSDK does not send the last item again, so a lost final ACK fails its upload. The plan is live all the same.
            let lost_ack = ack == Err(TransferError::Timeout) && !up;
            assert!(ack.is_ok() || lost_ack, "{ack:?}, lost at {moment} ms, up {up}");
            silence(&mut world, u64::MAX);
            assert_downloads(&mut world, 0, &items);

            let mut download = Download::new(&world.gcs[0], MISSION);
            let mut clear = None;
            for now in 0..5_000 {
                silence(&mut world, now);
                world.step();
                let now = world.now();
                if let Some(downloaded) = download.poll(now, &mut world.gcs[0]) {
                    assert_eq!(content(&downloaded.expect("complete")), content(&items));
                    let clear = clear.get_or_insert_with(|| Clear::new(&world.gcs[0], MISSION));
                    if clear.poll(now, &mut world.gcs[0]).is_some() {
                        break;
                    }
                }
            }
            clear.and_then(|clear| clear.result()).expect("an end").expect("cleared");
            assert!(world.stack.mission().items().is_empty());
        }
    }
}

/// M-1, M-41: over a lossy line a transfer completes, or fails and leaves a whole plan. Soon after, the vehicle is idle again.
#[test]
fn lossy_line_leaves_a_whole_plan() {
    let mut completed = 0;
    for seed in 1..=60 {
        let loss = 0.05 + 0.25 * (seed as f64 / 60.0);
        let faults = Faults { frame_reorder: 0.02, reorder_by: millis(30), ..Faults::frames(loss, 0.05) };
        let mut world = World::<2, Plans>::of(Setup { seed, ..Setup::new() });
        let (old, new) = (plan(7, 1), plan(20, 2));
        world.upload(0, &old).expect("accepted");
        world.lines[0].set_up(|wire| wire.faults = faults);
        world.lines[0].set_down(|wire| wire.faults = faults);
        let began = world.now();
        let result = world.upload(0, &new);
        assert!(world.now() - began < secs(60), "seed {seed}");
        let live = if world.stack.mission().items().len() == old.len() { &old } else { &new };
        assert_downloads(&mut world, 1, live);
        if result.is_ok() {
            completed += 1;
            assert_eq!(live.len(), new.len(), "seed {seed}");
        }
        // A client that gave up does not block the next one.
        world.run_for(secs(8));
        world.gcs[1].address = OTHER_STATION;
        world.upload(1, &plan(3, 3)).expect("accepted");
    }
    assert!(completed >= 30, "{completed} of 60");
}

/// M-45: a vehicle that arms during an upload keeps its plan.
#[test]
fn arming_during_an_upload_keeps_the_plan() {
    let mut world = world::<1>();
    world.upload(0, &plan(3, 1)).expect("accepted");
    let mut upload = Upload::new(&world.gcs[0], &plan(6, 2));
    world.run_until(secs(2), |world| {
        let now = world.now();
        if upload.items_sent() == 3 {
            world.vehicle.may_change = Err(MavMissionResult::DENIED);
        }
        upload.poll(now, &mut world.gcs[0]).is_some()
    });
    assert_eq!(upload.result(), Some(Err(TransferError::Refused(MavMissionResult::DENIED))));
    let text: Statustext = world.expect(0, secs(1));
    assert_eq!(text.text.as_bytes(), b"Mission refused: not allowed now");
    assert_downloads(&mut world, 0, &plan(3, 1));
}

/// M-48: a waypoint at 0, 0 is refused with a text, and so is a mission whose first waypoint is beyond the vehicle's limit. The
/// old plan stays.
#[test]
fn waypoint_without_position_or_too_far_away_is_refused() {
    let mut world = world::<1>();
    let old = plan(3, 1);
    world.upload(0, &old).expect("accepted");
    let refused = Err(TransferError::Refused(MavMissionResult::INVALID_PARAM5_X));
    let mut zero = plan(4, 2);
    for (seq, text) in [(0, None), (2, Some("Mission item 2: no position (0, 0)"))] {
        let mut zero = zero.clone();
        (zero[seq].x, zero[seq].y) = (0, 0);
        assert_eq!(world.upload(0, &zero).is_ok(), text.is_none(), "a take-off at 0, 0 is at the current position");
        if let Some(text) = text {
            assert_eq!(world.upload(0, &zero), refused);
            assert_eq!(world.expect::<Statustext>(0, secs(1)).text.as_str(), Some(text));
        }
    }
    world.upload(0, &old).expect("accepted");
    let home = LatLon { latitude: zero[0].x + 1_000_000, longitude: zero[0].y };
    world.vehicle.first_waypoint_limit = Some(FirstWaypointLimit { from: home, distance: 11_000 });
    world.gcs[0].forget();
    assert_eq!(world.upload(0, &zero), refused);
    let text: Statustext = world.expect(0, secs(1));
    assert_eq!(text.text.as_str(), Some("Mission item 0: more than 11000 m away"));
    assert_downloads(&mut world, 0, &old);
    world.vehicle.first_waypoint_limit = Some(FirstWaypointLimit { from: home, distance: 11_200 });
    world.upload(0, &zero).expect("near enough");
    world.vehicle.first_waypoint_limit = Some(FirstWaypointLimit { from: home, distance: 11_000 });
    zero[0].x = home.latitude;
    world.upload(0, &zero).expect("only the first waypoint is checked");
}

/// M-48: a mission that went live before the position was known counts as not checked. It is checked when the position becomes
/// known, and before it starts. However it came: by an upload, from the firmware, or as a file.
#[test]
fn distance_is_checked_when_the_position_becomes_known_and_before_the_start() {
    const UNKNOWN: &str = "Mission refused: no position yet";
    const FAR: &str = "Mission item 0: more than 11000 m away";
    let items = plan(4, 2);
    let far = LatLon { latitude: items[0].x + 1_000_000, longitude: items[0].y };
    let near = LatLon { latitude: items[0].x, longitude: items[0].y };
    for is_loaded in [false, true] {
        let mut world = world::<1>();
        world.vehicle.limits_first_waypoint = true;
        if is_loaded {
            let (now, items) = (world.now(), items.iter().map(item_of));
            world.stack.load_plan(now, PlanType::Mission, items, &mut world.vehicle).expect("loaded");
        } else {
            world.upload(0, &items).expect("accepted");
        }
        world.run_for(secs(1));
        let start = |world: &mut TestWorld<1>, first: f32| {
            // An equal text is not repeated at once (T-5).
            world.run_for(secs(6));
            world.gcs[0].forget();
            world.vehicle.calls.clear();
            let command = world.gcs[0].long(MavCmd::MISSION_START, [first, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
            world.gcs[0].send(&command);
            world.run_for(millis(100));
            let result = world.gcs[0].all::<CommandAck>().pop().expect("an answer").1.result;
            let texts = world.gcs[0].all::<Statustext>();
            let has_started = world.vehicle.calls.iter().any(|call| matches!(call, Call::StartMission(..)));
            (result, has_started, texts.first().map(|(_, text)| text.text.as_str().unwrap_or_default().to_owned()))
        };
        let refused = |result, text: &str| (result, false, Some(text.to_owned()));
        let accepted = (MavResult::ACCEPTED, true, None);
        for first in [0.0, f32::NAN] {
            assert_eq!(start(&mut world, first), refused(MavResult::TEMPORARILY_REJECTED, UNKNOWN));
        }
        assert_eq!(start(&mut world, 1.0), accepted, "not from item 0");
        // The position becomes known: one text.
        world.gcs[0].forget();
        world.vehicle.first_waypoint_limit = Some(FirstWaypointLimit { from: far, distance: 11_000 });
        world.run_for(secs(3));
        let texts = world.gcs[0].all::<Statustext>();
        assert_eq!(texts.iter().map(|(_, text)| text.text.as_str()).collect::<Vec<_>>(), [Some(FAR)]);
        for first in [0.0, f32::NAN] {
            assert_eq!(start(&mut world, first), refused(MavResult::DENIED, FAR));
        }
        // Resumed past item 0; a complete mission starts again.
        world.vehicle.progress.current = 2;
        assert_eq!(start(&mut world, f32::NAN), accepted);
        assert_eq!(start(&mut world, 0.0), refused(MavResult::DENIED, FAR));
        world.vehicle.progress.state = MissionState::COMPLETE;
        assert_eq!(start(&mut world, f32::NAN), refused(MavResult::DENIED, FAR));
        world.vehicle.first_waypoint_limit = Some(FirstWaypointLimit { from: near, distance: 11_000 });
        assert_eq!(start(&mut world, 0.0), accepted);
    }
}

/// M-48: a mission that was begun past its first item does not go back to it unchecked, by the command or by the message. While the
/// vehicle flies no mission, the start checks it.
#[test]
fn going_back_to_the_first_item_is_a_start() {
    const UNKNOWN: &str = "Mission refused: no position yet";
    const FAR: &str = "Mission item 0: more than 11000 m away";
    let items = plan(4, 2);
    let far = LatLon { latitude: items[0].x + 1_000_000, longitude: items[0].y };
    let mut world = world::<1>();
    world.vehicle.limits_first_waypoint = true;
    world.upload(0, &items).expect("accepted");
    let mut go = |limit, in_mission_mode, seq: u16, is_command| {
        // An equal text is not repeated at once (T-5).
        world.run_for(secs(6));
        world.vehicle.first_waypoint_limit = limit;
        world.vehicle.progress.in_mission_mode = in_mission_mode;
        world.run_for(secs(6));
        world.gcs[0].forget();
        world.vehicle.calls.clear();
        if is_command {
            world.gcs[0].command_long(MavCmd::DO_SET_MISSION_CURRENT, [f32::from(seq), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        } else {
            world.gcs[0].send(&MissionSetCurrent { seq, target_system: 1, target_component: 1 });
        }
        world.run_for(millis(100));
        let is_set = world.vehicle.calls.iter().any(|call| matches!(call, Call::SetCurrent(..)));
        let texts = world.gcs[0].all::<Statustext>();
        let texts: Vec<_> = texts.iter().map(|(_, text)| text.text.as_str().unwrap_or_default().to_owned()).collect();
        (is_set, world.gcs[0].all::<CommandAck>().pop().map(|(_, ack)| ack.result), texts)
    };
    for (limit, result, why) in [
        (None, MavResult::TEMPORARILY_REJECTED, UNKNOWN),
        (Some(FirstWaypointLimit { from: far, distance: 11_000 }), MavResult::DENIED, FAR),
    ] {
        assert_eq!(go(limit, true, 0, true), (false, Some(result), vec![why.to_owned()]));
        let (is_set, _, texts) = go(limit, true, 0, false);
        assert!(!is_set && texts.contains(&why.to_owned()), "{texts:?}");
        for is_command in [false, true] {
            assert!(go(limit, true, 1, is_command).0, "past the first item");
            assert!(go(limit, false, 0, is_command).0, "the start checks it");
        }
    }
}

/// M-50, M-52: each clear is acknowledged, the vehicle is notified once, and MISSION_CURRENT says that there is no mission.
#[test]
fn repeated_clear_is_acknowledged() {
    let mut world = world::<1>();
    world.upload(0, &plan(3, 1)).expect("accepted");
    world.vehicle.calls.clear();
    for mission_type in [MISSION, MISSION, MavMissionType::ALL] {
        assert_eq!(world.clear(0, mission_type).expect("cleared").r#type, ACCEPTED);
    }
    assert_eq!(world.vehicle.plan_changes(), [(PlanType::Mission, Vec::new(), 0)]);
    world.run_for(millis(10));
    let (_, current) = world.gcs[0].all::<MissionCurrent>().pop().expect("one");
    assert_eq!((current.total, current.mission_state, current.mission_id), (65_535, MissionState::NO_MISSION, 0));
    assert_downloads(&mut world, 0, &[]);
}

/// V-7: a link that sends v1 uploads and downloads missions.
#[test]
fn v1_link_transfers_missions() {
    let mut world =
        World::<1, Plans>::of(Setup { links: [LinkConfig::uart(57_600).with_version(TxVersion::V1)], ..Setup::new() });
    world.gcs[0].version = Version::V1;
    world.upload(0, &plan(12, 1)).expect("accepted");
    assert_downloads(&mut world, 0, &plan(12, 1));
    world.clear(0, MISSION).expect("cleared");
    assert!(world.gcs[0].received.iter().all(|frame| frame.header.version == Version::V1));
}

/// M-10, M-11: plan messages must be addressed to this vehicle. Its component has three valid ids.
#[test]
fn only_messages_to_this_vehicle_are_handled() {
    let mut world = world::<1>();
    for (target_system, target_component, answered) in
        [(1, 1, true), (1, 0, true), (1, 190, true), (0, 1, false), (0, 0, false), (2, 1, false), (1, 2, false)]
    {
        world.gcs[0].forget();
        world.gcs[0].send(&MissionRequestList { target_system, target_component, mission_type: MISSION });
        world.gcs[0].send(&MissionClearAll { target_system, target_component, mission_type: MISSION });
        world.run_for(millis(100));
        let answers = (world.gcs[0].count_of::<MissionCount>(), world.gcs[0].count_of::<MissionAck>());
        assert_eq!(answers, if answered { (1, 1) } else { (0, 0) }, "{target_system} {target_component}");
    }
}

/// M-13: a high-latency link carries no plan messages.
#[test]
fn high_latency_links_carry_no_plans() {
    let mut world = World::<1, Plans>::of(Setup {
        links: [LinkConfig::uart(57_600).with_class(LinkClass::HighLatency)],
        ..Setup::new()
    });
    assert_eq!(world.upload(0, &plan(2, 1)), Err(TransferError::Timeout));
    assert!(world.gcs[0].received.is_empty());
    assert!(world.vehicle.plan_changes().is_empty());
}

/// M-27: the vehicle may refuse an upload; a text says why.
#[test]
fn vehicle_can_refuse_an_upload() {
    let mut world = world::<1>();
    world.vehicle.may_change = Err(MavMissionResult::DENIED);
    assert_eq!(world.upload(0, &plan(2, 1)), Err(TransferError::Refused(MavMissionResult::DENIED)));
    let text: Statustext = world.expect(0, secs(1));
    assert_eq!(text.text.as_bytes(), b"Mission refused: not allowed now");
    let peer = Peer { address: STATION, link: LinkId(0) };
    assert_eq!(world.vehicle.calls.iter().filter(|call| **call == Call::MayChange(PlanType::Mission, peer)).count(), 1);
}

/// M-27, M-38, M-46: every hook that decides can explain itself, in a text that the operator reads.
#[test]
fn hooks_that_decide_can_say_something() {
    let mut world = world::<1>();
    world.vehicle.is_talkative = true;
    world.upload(0, &plan(2, 1)).expect("accepted");
    world.gcs[0].send(&MissionSetCurrent { target_system: 1, target_component: 1, ..MissionSetCurrent::default() });
    world.run_for(secs(1));
    let texts = world.gcs[0].all::<Statustext>();
    let texts: Vec<_> = texts.iter().filter_map(|(_, text)| text.text.as_str()).collect();
    assert_eq!(texts, ["change?", "item?", "plan?", "in control?"]);
}

/// M-39, M-90: MISSION_CURRENT is sent at once after an upload, then once a second, on every link.
#[test]
fn mission_current_is_sent_on_every_link() {
    let mut world = world::<2>();
    world.run_for(secs(2));
    let ack = world.upload(0, &plan(5, 1)).expect("accepted");
    world.run_for(millis(5));
    for link in 0..2 {
        let (_, current) = world.gcs[link].all::<MissionCurrent>().pop().expect("one");
        assert_eq!((current.seq, current.total, current.mission_id), (0, 5, ack.opaque_id));
        assert_eq!(current.mission_state, MissionState::NOT_STARTED);
    }
    world.gcs[1].forget();
    world.run_for(secs(10));
    assert_eq!(world.gcs[1].count_of::<MissionCurrent>(), 10);
    world.gcs[1].forget();
    world.vehicle.progress.current = 3;
    let current: MissionCurrent = world.expect(1, millis(5));
    assert_eq!(current.seq, 3, "a change is sent at once");
}

/// D-3: answers on a backpressured link stay pending; other links are not affected.
#[test]
fn backpressured_link_does_not_delay_others() {
    let mut world = world::<2>();
    world.upload(0, &plan(5, 1)).expect("accepted");
    let stuck_until = world.now() + secs(3);
    world.uarts[0].stall_writes_until(stuck_until);
    for _ in 0..20 {
        world.gcs[0].send(&MissionRequestList { target_system: 1, target_component: 1, mission_type: MISSION });
    }
    world.gcs[0].send(&MissionRequestInt { seq: 2, target_system: 1, target_component: 1, mission_type: MISSION });
    world.gcs[0].forget();
    world.gcs[1].address = OTHER_STATION;
    let began = world.now();
    assert_downloads(&mut world, 1, &plan(5, 1));
    world.upload(1, &plan(5, 1)).expect("accepted");
    assert!(world.now() - began < millis(100));
    assert_eq!(world.gcs[0].received.len(), 0);
    world.run_for(secs(4));
    assert!(world.gcs[0].count_of::<MissionCount>() <= 2, "one was in flight, and one is pending for all others");
    assert_eq!(world.gcs[0].count_of::<MissionItemInt>(), 1);
}

/// an upload of an item in 4.8 s gives way to a client that waits, after 15 s. Before, 24 of 24 uploads of the pilot were refused. An
/// upload over 1,200 baud is no slow one.
#[test]
fn slow_upload_gives_way() {
    for (baud, period, gives_way) in [(115_200, 4_800, true), (1_200, 1_300, false)] {
        let mut world = TestWorld::<2>::of(Setup { links: [LinkConfig::uart(baud); 2], ..Setup::new() });
        world.gcs[1].address = OTHER_STATION;
        let items = plan(CAPACITY, 0);
        let count = |count| MissionCount { count, target_system: 1, target_component: 1, ..MissionCount::default() };
        world.gcs[0].send(&count(CAPACITY));
        world.run_for(millis(300));
        let mut accepted_after = None;
        for (round, item) in items.iter().take(24).enumerate() {
            world.gcs[0].send(&MissionItemInt { target_system: 1, target_component: 1, ..*item });
            world.run_for(millis(period - 300));
            world.gcs[1].forget();
            world.gcs[1].send(&count(2));
            world.run_for(millis(300));
            let is_requested = world.gcs[1].count_of::<MissionRequestInt>() > 0;
            if accepted_after.is_none() && is_requested {
                accepted_after = Some((round as u64 + 1) * period);
            }
        }
        if gives_way {
            assert!(accepted_after.is_some_and(|after| (15_000..20_000).contains(&after)), "{accepted_after:?}");
            let cancelled = world.gcs[0].all::<MissionAck>();
            assert!(cancelled.iter().any(|(_, ack)| ack.r#type == MavMissionResult::OPERATION_CANCELLED));
        } else {
            assert_eq!(accepted_after, None);
        }
    }
}

/// an upload that is begun again every five seconds, with or without a cancel, keeps no lease: all 140 of the
/// pilot's uploads were refused. Now the time counts on, and the pilot's begins within 16 s.
#[test]
fn restarts_keep_no_upload() {
    for cancels in [false, true] {
        let mut world = TestWorld::<2>::of(Setup { links: [LinkConfig::uart(115_200); 2], ..Setup::new() });
        world.gcs[1].address = OTHER_STATION;
        let item = MissionItemInt { target_system: 1, target_component: 1, ..plan(CAPACITY, 0)[0] };
        let count = |count| MissionCount { count, target_system: 1, target_component: 1, ..MissionCount::default() };
        let (mut refused, mut last_accepted) = (0, 0);
        for second in 0..140_u64 {
            if second % 5 == 0 {
                let result = MavMissionResult::OPERATION_CANCELLED;
                if cancels {
                    let ack =
                        MissionAck { r#type: result, target_system: 1, target_component: 1, ..MissionAck::default() };
                    world.gcs[0].send(&ack);
                }
                world.gcs[0].send(&count(CAPACITY));
                world.run_for(millis(50));
                world.gcs[0].send(&item);
            } else {
                world.run_for(millis(50));
            }
            world.run_for(millis(450));
            world.gcs[1].forget();
            world.gcs[1].send(&count(2));
            world.run_for(millis(300));
            if world.gcs[1].count_of::<MissionRequestInt>() > 0 {
                assert!(second - last_accepted <= 16, "cancels: {cancels}: {second} s");
                last_accepted = second;
                // The pilot's upload ends at once, so that the other one may begin again.
                let result = MavMissionResult::OPERATION_CANCELLED;
                let ack = MissionAck { r#type: result, target_system: 1, target_component: 1, ..MissionAck::default() };
                world.gcs[1].send(&ack);
            } else {
                refused += 1;
            }
            world.run_for(millis(200));
        }
        println!("{refused} of 140 refused");
        assert!(last_accepted >= 120, "cancels: {cancels}: {refused} of 140 refused");
    }
}

/// forty items at once do not pay for an item in 4.8 s afterwards: such an upload gives way within 75 s to a client that
/// waits. Before, it kept the staging area to its end.
#[test]
fn quick_beginning_pays_for_no_slow_end() {
    let mut world = TestWorld::<2>::of(Setup { links: [LinkConfig::uart(115_200); 2], ..Setup::new() });
    world.gcs[1].address = OTHER_STATION;
    world.run_for(secs(200));
    let (items, began) = (plan(CAPACITY, 0), world.now());
    let count = |count| MissionCount { count, target_system: 1, target_component: 1, ..MissionCount::default() };
    world.gcs[0].send(&count(CAPACITY));
    world.run_for(millis(300));
    let mut accepted_at = None;
    for (round, item) in items.iter().enumerate() {
        world.gcs[0].send(&MissionItemInt { target_system: 1, target_component: 1, ..*item });
        if round < 40 {
            world.run_for(millis(50));
            continue;
        }
        world.run_for(millis(4_500));
        world.gcs[1].forget();
        world.gcs[1].send(&count(2));
        world.run_for(millis(300));
        if world.gcs[1].count_of::<MissionRequestInt>() > 0 {
            accepted_at = Some(world.now() - began);
            break;
        }
    }
    let bounds = millis(30_000)..millis(75_000);
    assert!(accepted_at.is_some_and(|at| bounds.contains(&at)), "{accepted_at:?}");
}
