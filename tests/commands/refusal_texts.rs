//! Texts that explain refused commands: rules C-4 and C-32, for refusals by the stack itself.

use crate::support::pilot::{self, ARDUPILOT, PX4};
use crate::support::*;
use mavstack::__private::Declares;
use mavstack::config::LinkClass;
use mavstack::dialect::*;
use mavstack::{Address, LinkConfig};

const NAN: f32 = f32::NAN;
/// Declared in `support/vehicle.rs`: a position above home; COMMAND_LONG only, no broadcast; COMMAND_INT only.
const PLACE: MavCmd = MavCmd::NAV_VTOL_TAKEOFF;
const MOTOR: MavCmd = MavCmd::DO_MOTOR_TEST;
const FLY: MavCmd = MavCmd::DO_REPOSITION;

fn texts<const N: usize, D: Declares>(world: &World<N, D>, link: usize) -> Vec<String> {
    let texts = world.gcs[link].all::<Statustext>();
    texts.iter().map(|(_, text)| text.text.as_str().expect("UTF-8").to_owned()).collect()
}

/// Sends a COMMAND_LONG to `system`, after the rate limit has expired. Returns the answer and the texts that come with
/// it.
fn long<const N: usize>(
    world: &mut World<N>,
    system: u8,
    command: MavCmd,
    params: [f32; 7],
) -> (MavResult, Vec<String>) {
    world.run_for(secs(6));
    world.gcs[0].forget();
    let message = CommandLong { target_system: system, ..world.gcs[0].long(command, params) };
    world.gcs[0].send(&message);
    let result = world.expect::<CommandAck>(0, millis(50)).result;
    world.run_for(millis(50));
    (result, texts(world, 0))
}

fn one(text: &str) -> Vec<String> {
    vec![text.to_owned()]
}

/// C-4, C-1, C-5: when a declared rule refuses a command, the text says what is wrong and what to do.
#[test]
fn refusal_by_declared_rule_is_explained() {
    let mut world: World<1> = World::new(Setup::new());
    let motor = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    for (system, command, params, result, text) in [
        (0, MOTOR, motor, MavResult::DENIED, "Command 209 refused: sent to 0; use system 1"),
        (1, MOTOR, [0.5; 7], MavResult::DENIED, "Command 209 refused: parameter 1 out of range"),
        (
            1,
            MOTOR,
            [1.0, NAN, 0.0, 0.0, 0.0, 0.0, 0.0],
            MavResult::DENIED,
            "Command 209 refused: parameter 2 out of range",
        ),
        (
            1,
            PLACE,
            [0.0, 0.0, 0.0, 0.0, 91.0, 0.0, 5.0],
            MavResult::DENIED,
            "Command 84 refused: parameter 5 out of range",
        ),
        (
            1,
            PLACE,
            [0.0, 0.0, 0.0, 0.0, 1.0, 181.0, 5.0],
            MavResult::DENIED,
            "Command 84 refused: parameter 6 out of range",
        ),
        (
            1,
            PLACE,
            [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, NAN],
            MavResult::DENIED,
            "Command 84 refused: parameter 7 out of range",
        ),
    ] {
        assert_eq!(long(&mut world, system, command, params), (result, one(text)), "{params:?}");
        assert!(text.len() <= 50, "{text}");
    }
    world.run_for(secs(1));
    let frame = MavFrame::LOCAL_NED;
    world.gcs[0].forget();
    world.gcs[0].send(&CommandInt {
        target_system: 1,
        target_component: 1,
        command: PLACE,
        frame,
        ..CommandInt::default()
    });
    world.run_for(secs(1));
    assert_eq!(texts(&world, 0), ["Command 84 refused: frame not supported"]);
    world.vehicle.controller = Some(Address::new(9, 9));
    let refused = long(&mut world, 1, MOTOR, motor);
    assert_eq!(refused, (MavResult::NOT_IN_CONTROL, one("Command 209 refused: another station has control")));
}

/// C-4: a result that implies the reason has no text; the client silently tries the other form.
#[test]
fn self_explanatory_result_has_no_text() {
    let mut world: World<1> = World::new(Setup::new());
    assert_eq!(long(&mut world, 1, FLY, [0.0; 7]), (MavResult::COMMAND_INT_ONLY, vec![]));
    assert_eq!(long(&mut world, 1, MavCmd(31_999), [0.0; 7]), (MavResult::UNSUPPORTED, vec![]));
    // Clients request many messages that do not exist.
    assert_eq!(long(&mut world, 1, MavCmd::REQUEST_MESSAGE, [9_999.0; 7]).1, [""; 0]);
    assert_eq!(long(&mut world, 1, MavCmd::SET_MESSAGE_INTERVAL, [9_999.0; 7]).1, [""; 0]);
    // The vehicle explains its own refusals.
    world.vehicle.outcomes.insert(MavCmd::DO_SET_HOME.0, MavResult::DENIED.into());
    assert_eq!(long(&mut world, 1, MavCmd::DO_SET_HOME, [0.0; 7]), (MavResult::DENIED, vec![]));
}

/// C-4, C-22: refusals by a service of the stack, and for want of a command slot, are explained too.
#[test]
fn refusal_by_a_service_is_explained() {
    let mut world: World<1, Tested<mavstack::plan_memory!(mission: 4)>> = World::of(Setup::new());
    let mut ask = |command: MavCmd, first: f32| {
        world.run_for(secs(6));
        world.gcs[0].forget();
        world.gcs[0].command_long(command, [first, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        world.run_for(millis(50));
        (world.expect::<CommandAck>(0, millis(50)).result, texts(&world, 0))
    };
    let (denied, failed) = (MavResult::DENIED, MavResult::FAILED);
    let no_item = |command: u16| one(&format!("Command {command} refused: there is no such item"));
    let range = |command: u16| one(&format!("Command {command} refused: a parameter is out of range"));
    assert_eq!(ask(MavCmd::MISSION_START, 0.0), (failed, no_item(300)));
    assert_eq!(ask(MavCmd::DO_SET_MISSION_CURRENT, 3.0), (failed, no_item(224)));
    assert_eq!(ask(MavCmd::DO_SET_MISSION_CURRENT, 0.5), (denied, range(224)));
    assert_eq!(ask(MavCmd::PREFLIGHT_STORAGE, 9.0), (denied, range(245)));

    let mut world: World<1> = World::new(Setup::new());
    world.vehicle.long.insert(MavCmd::PREFLIGHT_CALIBRATION.0);
    let calibrate = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(long(&mut world, 1, MavCmd::PREFLIGHT_CALIBRATION, calibrate), (MavResult::IN_PROGRESS, vec![]));
    let other = [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let busy = one("Command 241 refused: not now; try again later");
    assert_eq!(long(&mut world, 1, MavCmd::PREFLIGHT_CALIBRATION, other), (MavResult::TEMPORARILY_REJECTED, busy));
}

/// C-32, C-4: a text explains why a mode is refused: unknown, not selectable, or without the custom flag. This holds for every
/// message that requests modes.
#[test]
fn refused_mode_is_explained() {
    let mut world = pilot::world::<1, PX4>();
    let set = |mode: f32, sub: f32| (MavCmd::DO_SET_MODE, [1.0, mode, sub]);
    for ((command, params), text) in [
        // PX4's OFFBOARD.
        (set(6.0, 0.0), "Mode 393216 refused: not in AVAILABLE_MODES"),
        (set(NAN, 0.0), "Mode refused: not in AVAILABLE_MODES"),
        (set(9.0, 0.0), "Mode 589824 refused: not selectable"),
        ((MavCmd::DO_SET_MODE, [0.0, 3.0, 0.0]), "Mode 196608 refused: set CUSTOM_MODE_ENABLED"),
        ((MavCmd::DO_SET_STANDARD_MODE, [8.0, 0.0, 0.0]), "Mode refused: not in AVAILABLE_MODES"),
    ] {
        world.run_for(secs(6));
        world.gcs[0].forget();
        assert_eq!(pilot::command(&mut world, 0, command, &params), MavResult::DENIED, "{text}");
        world.run_for(millis(50));
        assert_eq!(texts(&world, 0), [text]);
    }
    let mut world = pilot::world::<1, ARDUPILOT>();
    // ArduPilot's GUIDED.
    world.gcs[0].send(&pilot::set_mode(1, 4));
    world.run_for(millis(50));
    assert_eq!(texts(&world, 0), ["Mode 4 refused: not in AVAILABLE_MODES"]);
}

/// C-4: whatever is sent, a link gets at most one text a second, and only about commands on this link.
#[test]
fn refusal_texts_are_rate_limited() {
    let mut world: World<2> = World::new(Setup::new());
    for number in 0..200_u8 {
        let mut params = [0.0; 7];
        params[usize::from(number % 5 + 2)] = f32::INFINITY;
        world.gcs[0].command_long(PLACE, params);
        world.run_for(millis(50));
    }
    let count = texts(&world, 0).len();
    assert!((5..=10).contains(&count), "{count} in 10 s");
    assert_eq!(texts(&world, 1), [""; 0]);
    // The other link gets its text at once.
    world.gcs[1].command_long(MOTOR, [0.5; 7]);
    world.run_for(millis(50));
    assert_eq!(texts(&world, 1), ["Command 209 refused: parameter 1 out of range"]);
}

/// C-4, C-16: the same refusal on two links is explained on both. On each link a text is repeated after two seconds at the
/// earliest.
#[test]
fn same_refusal_is_explained_on_each_link() {
    let mut world: World<2> = World::new(Setup::new());
    for at in [0, 1_500] {
        for link in 0..2 {
            world.gcs[link].command_long(MOTOR, [0.5; 7]);
            world.run_for(millis(100));
            let told = one("Command 209 refused: parameter 1 out of range");
            assert_eq!((texts(&world, link), at), (told, at), "once");
        }
        world.run_for(millis(1_300));
    }
    assert_eq!(world.stack.dropped_texts(), 2);
    for link in 0..2 {
        world.gcs[link].command_long(MOTOR, [0.5; 7]);
        world.run_for(millis(100));
        assert_eq!(texts(&world, link).len(), 2, "again after two seconds");
    }
}

/// C-16: the same command refused again 3.6 s later has its text again, also if the vehicle refuses it. What the flight loop
/// repeats is still dropped for five seconds (T-5).
#[test]
fn another_press_of_the_button_is_explained_again() {
    let mut world: World<1> = World::new(Setup::new());
    for _ in 0..4 {
        world.gcs[0].forget();
        world.gcs[0].command_long(MOTOR, [0.5; 7]);
        world.run_for(millis(1_800));
        world.gcs[0].command_long(PLACE, [f32::NAN; 7]);
        world.run_for(millis(1_800));
        assert_eq!(texts(&world, 0).len(), 2);
    }
    world.gcs[0].forget();
    for _ in 0..4 {
        world.stack.text(world.now(), MavSeverity::WARNING, "Low battery");
        world.run_for(millis(1_200));
    }
    assert_eq!(texts(&world, 0), ["Low battery"]);
}

/// C-16: the text names what was sent: SET_MODE is not "command 176".
#[test]
fn refused_set_mode_is_named() {
    let mut world = pilot::world::<1, { pilot::DECLARED }>();
    world.gcs[0].send(&SetMode { target_system: 0, ..pilot::set_mode(1, pilot::HOLD) });
    world.run_for(millis(50));
    assert_eq!(texts(&world, 0), ["SET_MODE refused: sent to 0; use system 1"]);
    world.run_for(secs(2));
    world.gcs[0].forget();
    world.vehicle.controller = Some(Address::new(9, 9));
    world.gcs[0].send(&pilot::set_mode(1, pilot::HOLD));
    world.run_for(millis(50));
    assert_eq!(texts(&world, 0), ["SET_MODE refused: another station has control"]);
}

/// C-16, P-17: the reason is what was found: without storage, no parameter of PREFLIGHT_STORAGE is wrong.
#[test]
fn missing_storage_is_named() {
    let mut world: World<1> = World::new(Setup::new());
    let no_storage = one("Command 245 refused: there is no storage");
    let range = one("Command 245 refused: a parameter is out of range");
    for (action, missions, expected) in
        [(0.0, -1.0, &no_storage), (1.0, NAN, &no_storage), (1.0, 7.0, &range), (3.0, -1.0, &range), (5.0, NAN, &range)]
    {
        let params = [action, missions, 0.0, 0.0, 0.0, 0.0, 0.0];
        let refused = long(&mut world, 1, MavCmd::PREFLIGHT_STORAGE, params);
        assert_eq!(refused, (MavResult::DENIED, expected.clone()), "{action}");
    }
}

/// C-16, M-21: an upload of more items than there is room for is refused with its reason, again after two seconds.
#[test]
fn missing_room_for_a_plan_is_named() {
    let mut world: World<1, Tested<mavstack::plan_memory!(mission: 4)>> = World::of(Setup::new());
    for _ in 0..2 {
        world.run_for(secs(2));
        world.gcs[0].forget();
        world.gcs[0].send(&MissionCount { target_system: 1, target_component: 1, count: 5, ..Default::default() });
        assert_eq!(world.expect::<MissionAck>(0, millis(50)).r#type, MavMissionResult::NO_SPACE);
        world.run_for(millis(50));
        assert_eq!(texts(&world, 0), ["Mission refused: too many items"]);
    }
}

/// C-4, L-4: the text is not sent over a high-latency link, nor on another link instead.
#[test]
fn refusal_over_satellite_is_not_explained() {
    let mut setup = Setup::<2>::new();
    setup.links[0] = LinkConfig { class: LinkClass::HighLatency, ..setup.links[0] };
    let mut world: World<2> = World::new(setup);
    world.gcs[0].command_long(MOTOR, [0.5; 7]);
    assert_eq!(world.expect::<CommandAck>(0, secs(2)).result, MavResult::DENIED);
    world.run_for(secs(2));
    assert_eq!((texts(&world, 0).len(), texts(&world, 1).len()), (0, 0));
}
