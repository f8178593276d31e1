//! The table of commands at work: what real ground stations send passes, and everything else is refused with its own
//! code and a text, without a trace in the live plan.

use crate::support::*;
use mavstack::dialect::rules::*;
use mavstack::dialect::{MavCmd, MavFrame, MavMissionResult, MavMissionType, MissionItemInt, Statustext};
use mavstack::message::ParamRule;
use mavstack::{CommandRule, Item, plan_memory};

const NAN: f32 = f32::NAN;
/// Not given.
const NONE: i32 = i32::MAX;

/// What a copter flies.
const COPTER: &[CommandRule] = &[
    NAV_TAKEOFF,
    NAV_WAYPOINT,
    NAV_LOITER_TIME,
    NAV_LOITER_UNLIM,
    NAV_RETURN_TO_LAUNCH,
    NAV_LAND,
    DO_JUMP,
    DO_CHANGE_SPEED,
    NAV_DELAY,
    CONDITION_DELAY,
    CONDITION_DISTANCE,
    CONDITION_YAW,
];

fn item(frame: u8, command: MavCmd, params: [f32; 4], x: i32, y: i32, z: f32) -> Item {
    Item { frame: MavFrame(frame), command, autocontinue: 1, params, x, y, z }
}

fn check(rules: &[CommandRule], item: &Item) -> Result<(), MavMissionResult> {
    let rule = rules.iter().find(|rule| rule.command() == item.command);
    rule.ok_or(MavMissionResult::UNSUPPORTED)?.check(item)
}

/// C-8, M-4, M-70: items as MAVSDK, QGroundControl, MAVProxy and Mission Planner write them.
#[test]
fn what_ground_stations_send_passes() {
    const X: i32 = 473_977_418;
    const Y: i32 = 85_455_939;
    for item in [
        // MAVSDK's missions: frame 6 for places, MISSION for the rest, NaN for what is not used.
        item(6, MavCmd::NAV_WAYPOINT, [0.5, 1.0, 0.0, NAN], X, Y, 10.0),
        item(2, MavCmd::DO_CHANGE_SPEED, [1.0, 5.0, -1.0, 0.0], 0, 0, NAN),
        item(2, MavCmd::NAV_DELAY, [1.5, -1.0, -1.0, -1.0], 0, 0, 0.0),
        item(2, MavCmd::NAV_RETURN_TO_LAUNCH, [NAN; 4], 0, 0, 0.0),
        // MAVSDK's mission plugin: NaN for all that it does not use.
        item(6, MavCmd::NAV_LAND, [NAN; 4], X, Y, 0.0),
        // QGroundControl: frame 3 with integers, yaw NaN, a loop for ever.
        item(3, MavCmd::NAV_TAKEOFF, [0.0, 0.0, 0.0, NAN], X, Y, 50.0),
        item(3, MavCmd::NAV_TAKEOFF, [15.0, NAN, NAN, NAN], NONE, NONE, 50.0),
        item(3, MavCmd::NAV_LOITER_TIME, [30.0, 1.0, 10.0, NAN], X, Y, 50.0),
        item(0, MavCmd::NAV_LOITER_UNLIM, [0.0, 0.0, -10.0, NAN], X, Y, 500.0),
        item(10, MavCmd::NAV_WAYPOINT, [0.0, 0.0, 0.0, NAN], X, Y, 30.0),
        item(2, MavCmd::DO_JUMP, [1.0, -1.0, 0.0, 0.0], 0, 0, 0.0),
        item(2, MavCmd::CONDITION_YAW, [360.0, 5.0, -1.0, 1.0], 0, 0, 0.0),
        item(3, MavCmd::NAV_LAND, [25.0, 0.0, 0.0, NAN], X, Y, 0.0),
        item(2, MavCmd::NAV_RETURN_TO_LAUNCH, [0.0; 4], 0, 0, 0.0),
        // MAVProxy and Mission Planner: one frame for the whole file, zeros for what is not used.
        item(0, MavCmd::NAV_WAYPOINT, [0.0; 4], X, Y, 584.0),
        item(3, MavCmd::NAV_TAKEOFF, [0.0; 4], 0, 0, 20.0),
        item(3, MavCmd::DO_JUMP, [2.0, 3.0, 0.0, 0.0], 0, 0, 0.0),
        item(3, MavCmd::CONDITION_DELAY, [2.5, 0.0, 0.0, 0.0], 0, 0, 0.0),
        item(3, MavCmd::CONDITION_DISTANCE, [15.0, 0.0, 0.0, 0.0], 0, 0, 0.0),
        item(3, MavCmd::DO_CHANGE_SPEED, [0.0, 7.0, 0.0, 0.0], 0, 0, 0.0),
        item(0, MavCmd::NAV_RETURN_TO_LAUNCH, [0.0; 4], 0, 0, 0.0),
        item(3, MavCmd::NAV_LAND, [0.0; 4], 0, 0, 0.0),
    ] {
        assert_eq!(check(COPTER, &item), Ok(()), "{item:?}");
    }
}

/// M-73, M-74: a firmware declares what it flies, narrower and wider than the definitions.
#[test]
fn a_firmware_has_the_last_word() {
    const COMMANDS: &[CommandRule] = &[
        NAV_WAYPOINT
            .with_frames(&[MavFrame::GLOBAL_RELATIVE_ALT])
            .with_params(&[ParamRule::range(1, 0.0, 600.0), ParamRule::range(4, -180.0, 360.0).or_nan()]),
        NAV_LAND.position_required().altitude_optional(),
        CommandRule::any(MavCmd(31_010)),
    ];
    let waypoint = item(6, MavCmd::NAV_WAYPOINT, [600.0, 0.0, 0.0, NAN], 0, 1, 10.0);
    let land = item(3, MavCmd::NAV_LAND, [0.0; 4], 0, 0, NAN);
    // How QGroundControl begins a landing pattern: no position, whatever the definitions say.
    let pattern = item(2, MavCmd::DO_LAND_START, [0.0; 4], 0, 0, 0.0);
    assert_eq!(check(&[DO_LAND_START], &pattern), Ok(()));
    let own = item(2, MavCmd(31_010), [NAN, -1e30, 0.5, NAN], -7, NONE, NAN);
    for (item, expected) in [
        (waypoint, Ok(())),
        (Item { frame: MavFrame::GLOBAL, ..waypoint }, Err(MavMissionResult::UNSUPPORTED_FRAME)),
        (Item { params: [601.0, 0.0, 0.0, NAN], ..waypoint }, Err(MavMissionResult::INVALID_PARAM1)),
        (Item { params: [0.0, -1.0, 0.0, NAN], ..waypoint }, Err(MavMissionResult::INVALID_PARAM2)),
        (Item { params: [0.0, 0.0, 0.0, 361.0], ..waypoint }, Err(MavMissionResult::INVALID_PARAM4)),
        (land, Ok(())),
        (Item { z: 1e6, ..land }, Ok(())),
        (Item { z: -1.1e6, ..land }, Err(MavMissionResult::INVALID_PARAM7)),
        (Item { x: NONE, y: NONE, ..land }, Err(MavMissionResult::INVALID_PARAM5_X)),
        (own, Ok(())),
        (Item { params: [f32::INFINITY; 4], ..own }, Err(MavMissionResult::INVALID_PARAM1)),
        (Item { command: MavCmd::NAV_DELAY, ..own }, Err(MavMissionResult::UNSUPPORTED)),
    ] {
        assert_eq!(check(COMMANDS, &item), expected, "{item:?}");
    }
}

/// M-70: what is optional, and what is required, is so however often it is said, and nothing else becomes so by it.
#[test]
fn words_may_be_said_twice() {
    let here = item(3, MavCmd::NAV_WAYPOINT, [0.0; 4], NONE, NONE, 10.0);
    let as_it_is = item(3, MavCmd::NAV_WAYPOINT, [0.0; 4], 0, 1, NAN);
    let off_the_globe = item(3, MavCmd::NAV_WAYPOINT, [0.0; 4], 900_000_001, 0, 10.0);
    let passes = |rule: CommandRule| [here, as_it_is, off_the_globe].map(|item| rule.check(&item).is_ok());
    let position = NAV_WAYPOINT.position_optional();
    let altitude = NAV_WAYPOINT.altitude_optional();
    let both = position.altitude_optional();
    for (rule, expected) in [
        (NAV_WAYPOINT, [false, false, false]),
        (position, [true, false, false]),
        (position.position_optional(), [true, false, false]),
        (altitude, [false, true, false]),
        (altitude.altitude_optional(), [false, true, false]),
        (both, [true, true, false]),
        (altitude.position_optional(), [true, true, false]),
        (both.position_required(), [false, true, false]),
        (both.position_required().position_required(), [false, true, false]),
        (both.altitude_required(), [true, false, false]),
        (both.altitude_required().altitude_required(), [true, false, false]),
    ] {
        assert_eq!(passes(rule), expected, "{rule:?}");
    }
}

/// Which parameter a rule is for.
#[test]
fn a_rule_knows_its_parameter() {
    let rules = [
        ParamRule::any(1),
        ParamRule::range(2, 0.0, 1.0),
        ParamRule::at_least(3, 0.0),
        ParamRule::at_most(4, 0.0),
        ParamRule::integers(5, 0, 1),
        ParamRule::bits(6, 1),
        ParamRule::one_of(7, &[]).or_nan(),
    ];
    assert_eq!(rules.map(|rule| rule.index()), [1, 2, 3, 4, 5, 6, 7]);
}

/// M-74: an integer that is no float passes as what it is.
#[test]
fn integers_are_not_rounded() {
    const ODD: i32 = (1 << 24) + 1;
    const RULE: CommandRule = CommandRule::any(MavCmd(31_010)).with_params(&[ParamRule::one_of(5, &[ODD])]);
    let with = |x| RULE.check(&item(2, MavCmd(31_010), [0.0; 4], x, 0, 0.0));
    assert_eq!(with(ODD), Ok(()));
    assert_eq!(with(ODD - 1), Err(MavMissionResult::INVALID_PARAM5_X));
}

type Memory = Tested<plan_memory!(mission: 10, fence: 10, rally: 3)>;

fn wire(plan: MavMissionType, items: &[Item]) -> Vec<MissionItemInt> {
    let wire = |(seq, item): (u16, &Item)| MissionItemInt {
        seq,
        frame: item.frame,
        command: item.command,
        autocontinue: item.autocontinue,
        param1: item.params[0],
        param2: item.params[1],
        param3: item.params[2],
        param4: item.params[3],
        x: item.x,
        y: item.y,
        z: item.z,
        mission_type: plan,
        ..MissionItemInt::default()
    };
    (0..).zip(items).map(wire).collect()
}

/// M-38, M-39: over the line a refusal is its code and a text, and the live plan is what it was.
#[test]
fn refusals_reach_the_operator_and_change_nothing() {
    let mut world = World::<1, Memory>::of(Setup::new());
    let waypoint = item(3, MavCmd::NAV_WAYPOINT, [0.0, 0.0, 0.0, NAN], 1, 1, 10.0);
    let jump = |p1, p2| item(2, MavCmd::DO_JUMP, [p1, p2, 0.0, 0.0], 0, 0, 0.0);
    let corner = |count, x, y| item(0, MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION, [count, 0.0, 0.0, 0.0], x, y, 0.0);
    let circle = |radius| item(0, MavCmd::NAV_FENCE_CIRCLE_EXCLUSION, [radius, 0.0, 0.0, 0.0], 5, 5, 0.0);
    let home = item(3, MavCmd::NAV_FENCE_RETURN_POINT, [0.0; 4], 1, 1, 20.0);
    let rally = item(3, MavCmd::NAV_RALLY_POINT, [0.0; 4], 1, 1, 20.0);
    let triangle = [corner(3.0, 0, 0), corner(3.0, 9, 0), corner(3.0, 0, 9)];
    let (mission, fence, rally_plan) = (MavMissionType::MISSION, MavMissionType::FENCE, MavMissionType::RALLY);
    let good = [
        wire(mission, &[waypoint, waypoint, jump(0.0, -1.0)]),
        wire(fence, &[home, triangle[0], triangle[1], triangle[2], circle(3.0)]),
        wire(rally_plan, &[rally, rally]),
    ];
    for plan in &good {
        world.upload(0, plan).expect("accepted");
    }
    for (plan, items, code, text) in [
        (mission, &[waypoint, rally][..], 3, "Mission item 1: command not supported"),
        (mission, &[circle(3.0)], 3, "Mission item 0: command not supported"),
        (mission, &[Item { frame: MavFrame::MISSION, ..waypoint }], 2, "Mission item 0: frame not supported"),
        (mission, &[waypoint, jump(-1.0, 0.0)], 6, "Mission item 1: parameter 1 out of range"),
        (mission, &[waypoint, Item { z: NAN, ..waypoint }], 12, "Mission item 1: parameter 7 out of range"),
        // Seen when all of the plan is there.
        (mission, &[jump(1.0, 0.0), jump(2.0, 0.0)], 6, "Mission item 1: parameter 1 out of range"),
        (mission, &[jump(0.0, 0.0), waypoint], 6, "Mission item 0: parameter 1 out of range"),
        (fence, &[waypoint], 3, "Fence item 0: command not supported"),
        (fence, &[circle(0.0)], 6, "Fence item 0: parameter 1 out of range"),
        (fence, &[home, circle(1.0), home], 5, "Fence item 2: not consistent"),
        (fence, &triangle[..2], 5, "Fence item 0: not consistent"),
        (fence, &[triangle[0], triangle[1], corner(4.0, 0, 9)], 6, "Fence item 2: parameter 1 out of range"),
        (fence, &[triangle[0], triangle[1], corner(3.0, 4, 0)], 5, "Fence item 0: not consistent"),
        (rally_plan, &[rally, waypoint], 3, "Rally item 1: command not supported"),
        (rally_plan, &[Item { x: NONE, y: NONE, ..rally }], 10, "Rally item 0: parameter 5 out of range"),
    ] {
        // The same text is not said twice within five seconds.
        world.run_for(secs(10));
        world.gcs[0].forget();
        let result = world.upload(0, &wire(plan, items));
        assert_eq!(result, Err(TransferError::Refused(MavMissionResult(code))), "{text}");
        world.run_for(millis(100));
        let texts: Vec<_> = world.gcs[0].all::<Statustext>();
        let texts: Vec<_> = texts.iter().map(|(_, text)| text.text.as_str().expect("UTF-8").to_owned()).collect();
        assert_eq!(texts, [text]);
        let live = [world.stack.mission(), world.stack.fence(), world.stack.rally()].map(|plan| plan.items().len());
        assert_eq!(live, good.each_ref().map(Vec::len), "{text}");
    }
    for plan in &good {
        let downloaded = world.download(0, plan[0].mission_type).expect("complete");
        let content = |items: &[MissionItemInt]| items.iter().map(|item| (item.command, item.x)).collect::<Vec<_>>();
        assert_eq!(content(&downloaded), content(plan));
    }
}
