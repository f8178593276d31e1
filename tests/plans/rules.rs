//! The table of commands: what ground stations send is accepted. Everything else is refused with its own code and a text, and
//! leaves the live plan unchanged.

use crate::support::*;
use mavstack::dialect::rules::*;
use mavstack::dialect::{MavCmd, MavFrame, MavMissionResult, MavMissionType, MissionItemInt, Statustext};
use mavstack::message::ParamRule;
use mavstack::{CommandRule, Item, plan_memory};

const NAN: f32 = f32::NAN;
/// Not given.
const NONE: i32 = i32::MAX;

/// The commands of a copter.
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

/// C-8, M-4, M-70: items as written by MAVSDK, QGroundControl, MAVProxy and Mission Planner are accepted.
#[test]
fn items_of_ground_stations_are_accepted() {
    const X: i32 = 473_977_418;
    const Y: i32 = 85_455_939;
    for item in [
        // MAVSDK's missions: frame 6 with a position, MISSION without one, NaN for unused parameters.
        item(6, MavCmd::NAV_WAYPOINT, [0.5, 1.0, 0.0, NAN], X, Y, 10.0),
        item(2, MavCmd::DO_CHANGE_SPEED, [1.0, 5.0, -1.0, 0.0], 0, 0, NAN),
        item(2, MavCmd::NAV_DELAY, [1.5, -1.0, -1.0, -1.0], 0, 0, 0.0),
        item(2, MavCmd::NAV_RETURN_TO_LAUNCH, [NAN; 4], 0, 0, 0.0),
        // MAVSDK's mission plugin: NaN for every unused parameter.
        item(6, MavCmd::NAV_LAND, [NAN; 4], X, Y, 0.0),
        // QGroundControl: frame 3 with integers, NaN as yaw, an endless loop.
        item(3, MavCmd::NAV_TAKEOFF, [0.0, 0.0, 0.0, NAN], X, Y, 50.0),
        item(3, MavCmd::NAV_TAKEOFF, [15.0, NAN, NAN, NAN], NONE, NONE, 50.0),
        item(3, MavCmd::NAV_LOITER_TIME, [30.0, 1.0, 10.0, NAN], X, Y, 50.0),
        item(0, MavCmd::NAV_LOITER_UNLIM, [0.0, 0.0, -10.0, NAN], X, Y, 500.0),
        item(10, MavCmd::NAV_WAYPOINT, [0.0, 0.0, 0.0, NAN], X, Y, 30.0),
        item(2, MavCmd::DO_JUMP, [1.0, -1.0, 0.0, 0.0], 0, 0, 0.0),
        item(2, MavCmd::CONDITION_YAW, [360.0, 5.0, -1.0, 1.0], 0, 0, 0.0),
        item(3, MavCmd::NAV_LAND, [25.0, 0.0, 0.0, NAN], X, Y, 0.0),
        item(2, MavCmd::NAV_RETURN_TO_LAUNCH, [0.0; 4], 0, 0, 0.0),
        // MAVProxy and Mission Planner: one frame for the whole file, zeros for unused parameters.
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

/// M-73, M-74: the rules of a firmware may be stricter or looser than the definitions.
#[test]
fn rules_of_the_firmware_replace_the_generated_ones() {
    const COMMANDS: &[CommandRule] = &[
        NAV_WAYPOINT
            .with_frames(&[MavFrame::GLOBAL_RELATIVE_ALT])
            .with_params(&[ParamRule::range(1, 0.0, 600.0), ParamRule::range(4, -180.0, 360.0).or_nan()]),
        NAV_LAND.position_required().altitude_optional(),
        CommandRule::any(MavCmd(31_010)),
    ];
    let waypoint = item(6, MavCmd::NAV_WAYPOINT, [600.0, 0.0, 0.0, NAN], 0, 1, 10.0);
    let land = item(3, MavCmd::NAV_LAND, [0.0; 4], 0, 0, NAN);
    // QGroundControl begins a landing pattern without a position, contrary to the definitions.
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

/// M-70: repeating "optional" or "required" for a parameter has no effect, also on other parameters.
#[test]
fn repeated_declaration_has_no_effect() {
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

/// Each rule names its parameter.
#[test]
fn rule_names_its_parameter() {
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

/// M-74: an integer that no float represents is compared exactly.
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

/// M-38, M-39: a refused plan gets its code and a text, and the live plan stays.
#[test]
fn refusal_has_code_and_text_and_changes_nothing() {
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
        // Detected when the plan is complete.
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
        // The same text is not repeated within five seconds.
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
