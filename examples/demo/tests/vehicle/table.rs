//! Which mission items the vehicle accepts: each item goes through a complete upload.

use crate::support::{act, at, jump, waypoint};
use mavstack::dialect::{
    Common, MavCmd, MavFrame, MavMissionResult, MavMissionType, MissionAck, MissionCount, MissionItemInt,
    MissionRequestInt,
};
use mavstack::frame::{Decoder, Version, encode};
use mavstack::message::Dialect;
use mavstack::{Address, Config, Duration, Instant, Item, LinkConfig, LinkId, Message, Pulse, StackOf};
use mavstack_demo::{Quadrotor, Tuning};

#[derive(mavstack::Stack)]
#[stack(
    vehicle: Quadrotor,
    links: 1,
    plans: { mission: 20, fence: 8, rally: 2 },
    parameters: Tuning,
    commands: { slots: 1 },
)]
struct Mavlink;

const LINK: LinkId = LinkId(0);

/// A vehicle, its stack, and a client that uploads plans over a lossless link.
struct Upload {
    stack: Box<StackOf<Mavlink>>,
    vehicle: Quadrotor,
    decoder: Decoder,
    millis: u64,
}

impl Upload {
    fn new() -> Self {
        let config = Config::new(Address::new(1, 1), Box::leak(Box::new(Pulse::new())));
        Self {
            stack: Box::new(StackOf::<Mavlink>::new(config, [LinkConfig::uart(921_600)])),
            vehicle: Quadrotor::new(),
            decoder: Decoder::new(Duration::from_secs(1)),
            millis: 0,
        }
    }

    fn send(&mut self, message: &impl Message) {
        let mut frame = [0; 280];
        let len = encode(message, Version::V2, Address::new(255, 190), 0, &mut frame).unwrap();
        let taken = self.stack.receive(Instant::from_millis(self.millis), LINK, &frame[..len], &mut self.vehicle);
        assert_eq!(taken, len);
    }

    /// Uploads a plan and returns the answer.
    fn answer(&mut self, plan: MavMissionType, items: &[Item]) -> MavMissionResult {
        let count = items.len() as u16;
        self.send(&MissionCount {
            count,
            target_system: 1,
            target_component: 1,
            mission_type: plan,
            ..Default::default()
        });
        for _ in 0..5_000 {
            self.millis += 1;
            let now = Instant::from_millis(self.millis);
            self.stack.poll(now, &mut self.vehicle);
            let bytes = self.stack.transmit(now, LINK, &mut self.vehicle).to_vec();
            self.stack.transmitted(LINK, bytes.len());
            assert_eq!(self.decoder.push(&bytes, now), bytes.len());
            let mut request = None;
            while let Some(frame) = self.decoder.next(now, Common::MESSAGES, &mut u32::MAX.clone(), |_| true) {
                if let Some(ack) = frame.decode::<MissionAck>() {
                    return ack.r#type;
                }
                request = frame.decode::<MissionRequestInt>().or(request);
            }
            if let Some(MissionRequestInt { seq, .. }) = request {
                let Item { frame, command, autocontinue, params, x, y, z } = items[usize::from(seq)];
                let [param1, param2, param3, param4] = params;
                self.send(&MissionItemInt {
                    param1,
                    param2,
                    param3,
                    param4,
                    x,
                    y,
                    z,
                    seq,
                    command,
                    frame,
                    autocontinue,
                    target_system: 1,
                    target_component: 1,
                    current: 0,
                    mission_type: plan,
                });
            }
        }
        panic!("no answer");
    }
}

/// Every supported item is accepted, also with optional values omitted (M-70).
#[test]
fn supported_items_are_accepted() {
    const NAN: f32 = f32::NAN;
    let nowhere = |item: Item| Item { x: i32::MAX, y: i32::MAX, ..item };
    let plan = [
        nowhere(at(MavCmd::NAV_TAKEOFF, [0.0, 0.0, NAN, NAN], 0.0, 0.0, 10.0)),
        waypoint(10.0, 0.0),
        at(MavCmd::NAV_WAYPOINT, [NAN; 4], 10.0, 0.0, 10.0),
        nowhere(at(MavCmd::NAV_LOITER_TIME, [NAN; 4], 0.0, 0.0, 10.0)),
        nowhere(at(MavCmd::NAV_LOITER_UNLIM, [NAN; 4], 0.0, 0.0, 10.0)),
        act(MavCmd::NAV_DELAY, [0.5, -1.0, -1.0, -1.0]),
        act(MavCmd::NAV_DELAY, [5.0, 0.0, 0.0, 0.0]),
        act(MavCmd::CONDITION_DELAY, [5.0, 0.0, 0.0, 0.0]),
        act(MavCmd::CONDITION_DISTANCE, [5.0, 0.0, 0.0, 0.0]),
        act(MavCmd::CONDITION_YAW, [90.0, 0.0, -1.0, 1.0]),
        act(MavCmd::DO_CHANGE_SPEED, [1.0, 5.0, -1.0, 0.0]),
        act(MavCmd::DO_CHANGE_SPEED, [0.0, -2.0, 0.0, 0.0]),
        jump(1, -1.0),
        jump(1, 3.0),
        act(MavCmd::NAV_RETURN_TO_LAUNCH, [0.0; 4]),
        Item { frame: MavFrame::GLOBAL, z: NAN, ..nowhere(at(MavCmd::NAV_LAND, [NAN; 4], 0.0, 0.0, 0.0)) },
    ];
    assert_eq!(Upload::new().answer(MavMissionType::MISSION, &plan), MavMissionResult::ACCEPTED);
}

/// M-73: unsupported items are refused, each with the code for its reason.
#[test]
fn unsupported_items_are_refused() {
    use MavMissionResult as R;
    let fly = |command, params| at(command, params, 10.0, 0.0, 10.0);
    let table = [
        (fly(MavCmd::NAV_SPLINE_WAYPOINT, [0.0; 4]), R::UNSUPPORTED),
        (act(MavCmd::DO_SET_RELAY, [1.0, 1.0, 0.0, 0.0]), R::UNSUPPORTED),
        (act(MavCmd::DO_SET_SERVO, [5.0, 1_500.0, 0.0, 0.0]), R::INVALID_PARAM1),
        (act(MavCmd::DO_SET_SERVO, [1.0, 3_000.0, 0.0, 0.0]), R::INVALID_PARAM2),
        (act(MavCmd::CONDITION_CHANGE_ALT, [0.0; 4]), R::UNSUPPORTED),
        (Item { frame: MavFrame::GLOBAL_TERRAIN_ALT, ..waypoint(0.0, 0.0) }, R::UNSUPPORTED_FRAME),
        (Item { frame: MavFrame::GLOBAL_TERRAIN_ALT_INT, ..fly(MavCmd::NAV_LAND, [0.0; 4]) }, R::UNSUPPORTED_FRAME),
        (Item { frame: MavFrame::LOCAL_NED, ..waypoint(0.0, 0.0) }, R::UNSUPPORTED_FRAME),
        (fly(MavCmd::NAV_WAYPOINT, [-1.0, 0.0, 0.0, 0.0]), R::INVALID_PARAM1),
        (fly(MavCmd::NAV_WAYPOINT, [0.0, -1.0, 0.0, 0.0]), R::INVALID_PARAM2),
        (Item { x: i32::MAX, y: i32::MAX, ..waypoint(0.0, 0.0) }, R::INVALID_PARAM5_X),
        (Item { z: f32::NAN, ..waypoint(0.0, 0.0) }, R::INVALID_PARAM7),
        (fly(MavCmd::NAV_LAND, [0.0, 2.0, 0.0, 0.0]), R::INVALID_PARAM2),
        (act(MavCmd::NAV_DELAY, [-1.0, 12.0, 30.0, 0.0]), R::INVALID_PARAM1),
        (act(MavCmd::NAV_DELAY, [0.0, -1.0, -1.0, -1.0]), R::INVALID_PARAM1),
        (act(MavCmd::NAV_DELAY, [5.0, 12.0, -1.0, -1.0]), R::INVALID_PARAM2),
        (act(MavCmd::CONDITION_YAW, [400.0, 0.0, 0.0, 0.0]), R::INVALID_PARAM1),
        (act(MavCmd::CONDITION_DELAY, [-1.0, 0.0, 0.0, 0.0]), R::INVALID_PARAM1),
        (act(MavCmd::DO_CHANGE_SPEED, [2.0, 5.0, -1.0, 0.0]), R::INVALID_PARAM1),
        (act(MavCmd::DO_CHANGE_SPEED, [1.0, 0.0, -1.0, 0.0]), R::INVALID_PARAM2),
        (act(MavCmd::DO_CHANGE_SPEED, [1.0, -1.5, -1.0, 0.0]), R::INVALID_PARAM2),
        (act(MavCmd::DO_CHANGE_SPEED, [1.0, f32::NAN, -1.0, 0.0]), R::INVALID_PARAM2),
        (act(MavCmd::DO_CHANGE_SPEED, [1.0, 5.0, 50.0, 0.0]), R::INVALID_PARAM3),
        (jump(7, 1.0), R::INVALID_PARAM1),
    ];
    let mut upload = Upload::new();
    for (item, code) in table {
        assert_eq!(upload.answer(MavMissionType::MISSION, &[waypoint(0.0, 0.0), item]), code, "{item:?}");
    }
    let mut jumps = vec![waypoint(0.0, 0.0)];
    jumps.extend([jump(0, 1.0); 17]);
    assert_eq!(upload.answer(MavMissionType::MISSION, &jumps), R::NO_SPACE, "one jump has no counter");
}

/// M-48: the vehicle never flies to 0, 0. A waypoint there is refused; in a takeoff, landing or loiter it means "here". Once
/// home is known, a mission whose first waypoint is more than 10 km from home is refused.
#[test]
fn missions_must_start_near_home_and_not_at_zero() {
    use MavMissionResult as R;
    let zero = |command| Item { x: 0, y: 0, ..at(command, [0.0, 0.0, 0.0, f32::NAN], 0.0, 0.0, 10.0) };
    let far = waypoint(-10_050.0, 0.0);
    let plans = [
        (vec![zero(MavCmd::NAV_TAKEOFF), waypoint(9_950.0, 0.0), zero(MavCmd::NAV_LOITER_UNLIM)], R::ACCEPTED),
        (vec![waypoint(0.0, -5_000.0), zero(MavCmd::NAV_LOITER_TIME), zero(MavCmd::NAV_LAND)], R::ACCEPTED),
        (vec![zero(MavCmd::NAV_TAKEOFF), zero(MavCmd::NAV_WAYPOINT)], R::INVALID_PARAM5_X),
        (vec![waypoint(0.0, 0.0), far], R::ACCEPTED),
        (vec![zero(MavCmd::NAV_TAKEOFF), far], R::INVALID_PARAM5_X),
        (vec![far, waypoint(0.0, 0.0)], R::INVALID_PARAM5_X),
    ];
    let mut upload = Upload::new();
    assert_eq!(upload.answer(MavMissionType::MISSION, &[far]), R::ACCEPTED, "home is not known yet");
    // Wait for a position fix.
    for millis in 0..60_000 {
        let Upload { stack, vehicle, .. } = &mut upload;
        stack.with_context(Instant::from_millis(millis), |cx| vehicle.control_step(cx));
    }
    assert!(upload.vehicle.has_fix());
    upload.millis = 60_000;
    for (plan, answer) in plans {
        assert_eq!(upload.answer(MavMissionType::MISSION, &plan), answer, "{plan:?}");
    }
}

#[test]
fn fences_and_rally_points_are_checked() {
    let mut upload = Upload::new();
    let circle = |group: f32| at(MavCmd::NAV_FENCE_CIRCLE_INCLUSION, [50.0, group, 0.0, 0.0], 0.0, 0.0, 0.0);
    for (group, answer) in [(31.0, MavMissionResult::ACCEPTED), (32.0, MavMissionResult::INVALID_PARAM2)] {
        assert_eq!(upload.answer(MavMissionType::FENCE, &[circle(group)]), answer, "{group}");
    }
    let rally = at(MavCmd::NAV_RALLY_POINT, [0.0; 4], 30.0, 0.0, 20.0);
    assert_eq!(upload.answer(MavMissionType::RALLY, &[rally]), MavMissionResult::ACCEPTED);
    // The vehicle has no model of the terrain (M-49).
    for frame in [MavFrame::GLOBAL_TERRAIN_ALT, MavFrame::GLOBAL_TERRAIN_ALT_INT] {
        let answer = upload.answer(MavMissionType::RALLY, &[Item { frame, ..rally }]);
        assert_eq!(answer, MavMissionResult::UNSUPPORTED_FRAME);
        let home = at(MavCmd::NAV_FENCE_RETURN_POINT, [0.0; 4], 0.0, 0.0, 20.0);
        let answer = upload.answer(MavMissionType::FENCE, &[Item { frame, ..home }]);
        assert_eq!(answer, MavMissionResult::UNSUPPORTED_FRAME);
    }
}
