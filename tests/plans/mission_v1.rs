//! Plans in MAVLink 1 frames with extension bytes, as pymavlink's `force_mavlink1` sends them (V-7).

use crate::support::*;
use mavstack::dialect::{
    MavMissionResult, MavMissionType, MissionAck, MissionClearAll, MissionCount, MissionItemInt, MissionRequest,
    MissionRequestInt, MissionRequestList,
};
use mavstack::{LinkId, Message, PlanType, plan_memory};

type Plans = Tested<plan_memory!(mission: 10, fence: 10)>;

/// Returns a v1 frame with the message's extensions up to `mission_type`, which is the first one.
fn with_type<M: Message>(message: &M, base_len: usize, mission_type: MavMissionType) -> Vec<u8> {
    let mut payload = vec![0; M::MAX_LEN];
    message.encode(&mut payload);
    payload.truncate(base_len);
    payload.push(mission_type.0);
    reference::v1(M::ID as u8, [255, 190], &payload, M::CRC_EXTRA)
}

/// V-7: a v1 frame whose extension names another plan than the mission is UNSUPPORTED. It neither clears, replaces nor reads
/// the mission. The same frame with type 0 applies to the mission.
#[test]
fn v1_frame_that_names_another_plan_is_unsupported() {
    let (target_system, target_component) = (1, 1);
    let clear = MissionClearAll { target_system, target_component, ..Default::default() };
    let list = MissionRequestList { target_system, target_component, ..Default::default() };
    let count = MissionCount { target_system, target_component, count: 1, ..Default::default() };
    let request = MissionRequestInt { target_system, target_component, ..Default::default() };
    let old_request = MissionRequest { target_system, target_component, ..Default::default() };
    for kind in [MavMissionType::FENCE, MavMissionType::RALLY, MavMissionType::ALL, MavMissionType(77)] {
        let mut world = World::<1, Plans>::of(Setup::new());
        world.upload(0, &plan(3, 1)).expect("accepted");
        let fence: Vec<_> = plan(2, 2)
            .into_iter()
            .map(|item| MissionItemInt {
                mission_type: MavMissionType::FENCE,
                command: mavstack::dialect::MavCmd::NAV_FENCE_CIRCLE_INCLUSION,
                param1: 9.0,
                param2: 0.0,
                param4: 0.0,
                ..item
            })
            .collect();
        world.upload(0, &fence).expect("accepted");
        for frame in [
            with_type(&clear, 2, kind),
            with_type(&list, 2, kind),
            with_type(&count, 4, kind),
            with_type(&request, 4, kind),
            with_type(&old_request, 4, kind),
        ] {
            world.gcs[0].forget();
            world.vehicle.calls.clear();
            let frames = |world: &World<1, Plans>| world.stack.rx_counters(LinkId(0)).expect("link 0").frames;
            let before = frames(&world);
            world.gcs[0].send_raw(&frame);
            world.run_for(millis(20));
            let taken = frames(&world) - before;
            let answers: Vec<_> = world.gcs[0].all::<MissionAck>().into_iter().map(|(_, ack)| ack).collect();
            assert!(answers.iter().all(|ack| (ack.r#type, ack.mission_type) == (MavMissionResult::UNSUPPORTED, kind)));
            assert_eq!((taken, answers.len()), (1, 1), "type {}", kind.0);
            let others = world.gcs[0].count_of::<MissionCount>() + world.gcs[0].count_of::<MissionItemInt>();
            assert_eq!((others, world.gcs[0].count_of::<MissionRequestInt>()), (0, 0));
            assert_eq!(world.vehicle.calls, []);
        }
        assert_eq!(world.stack.mission().items().len(), 3);
        assert_eq!(world.stack.fence().items().len(), 2);
    }
    // The extension may also name the mission.
    let mut world = World::<1, Plans>::of(Setup::new());
    world.upload(0, &plan(3, 1)).expect("accepted");
    let before = world.stack.rx_counters(LinkId(0)).expect("link 0").frames;
    world.gcs[0].send_raw(&with_type(&clear, 2, MavMissionType::MISSION));
    world.run_for(millis(20));
    assert_eq!(world.stack.rx_counters(LinkId(0)).expect("link 0").frames - before, 1);
    assert!(world.stack.mission().items().is_empty());
    assert_eq!(world.vehicle.plan_changes().len(), 2);
    assert_eq!(world.vehicle.plan_changes()[0].0, PlanType::Mission);
}
