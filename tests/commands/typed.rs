//! Typed commands and items: every kind of parameter, both message forms, and refusals. Rules C-4, C-6 to C-9, M-4, M-70.

use mavstack::command::CommandPosition;
use mavstack::config::LinkClass;
use mavstack::dialect::commands::*;
use mavstack::dialect::*;
use mavstack::message::{ComponentId, LatLon, Location, ParamRule, TypedCommand};
use mavstack::{Address, Command, CommandRule, Item, LinkId, Peer, command};
use proptest::prelude::*;

const NAN: f32 = f32::NAN;
const GCS: Peer = Peer { address: Address::new(255, 190), link: LinkId(0) };

/// Returns what the vehicle gets from a COMMAND_LONG.
fn long(id: MavCmd, [p1, p2, p3, p4, param5, param6, z]: [f32; 7]) -> Command {
    let position = CommandPosition::Long { param5, param6 };
    Command {
        id,
        params: [p1, p2, p3, p4],
        position,
        z,
        from: GCS,

        trust: mavstack::Trust::Open,
        class: LinkClass::Normal,
        age: None,
        component: ComponentId::new(1),
        is_broadcast: false,
        confirmation: 0,
    }
}

/// Returns what the vehicle gets from a COMMAND_INT.
fn int(id: MavCmd, frame: MavFrame, params: [f32; 4], x: i32, y: i32, z: f32) -> Command {
    let position = CommandPosition::Int { frame, x, y };
    Command {
        id,
        params,
        position,
        z,
        from: GCS,

        trust: mavstack::Trust::Open,
        class: LinkClass::Normal,
        age: None,
        component: ComponentId::new(1),
        is_broadcast: false,
        confirmation: 0,
    }
}

/// Decodes a COMMAND_LONG as a `T`.
fn decode<T: TypedCommand>(params: [f32; 7]) -> Result<T, MavResult> {
    long(T::RULE.command(), params).decode()
}

fn is_denied<T: TypedCommand + std::fmt::Debug>(params: [f32; 7]) {
    assert_eq!(decode::<T>(params).err(), Some(MavResult::DENIED), "{params:?}");
}

/// C-9: MAV_BOOL is a `bool`; integers keep their increments.
#[test]
fn booleans_and_integers() {
    let arm = |p1, p2| decode::<ComponentArmDisarm>([p1, p2, NAN, 0.0, NAN, 0.0, NAN]);
    assert_eq!(arm(1.0, 0.0), Ok(ComponentArmDisarm { arm: true, force: Some(0) }));
    assert_eq!(arm(0.0, 21_196.0), Ok(ComponentArmDisarm { arm: false, force: Some(21_196) }));
    for (p1, p2) in [(2.0, 0.0), (-1.0, 0.0), (0.5, 0.0), (NAN, 0.0), (1.0, 1.0), (1.0, -1.0), (1.0, f32::INFINITY)] {
        assert_eq!(arm(p1, p2), Err(MavResult::DENIED), "{p1}, {p2}");
    }
    // −1 repeats forever (M-72).
    assert_eq!(decode([3.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0]), Ok(DoJump { number: 3, repeat: -1 }));
    is_denied::<DoJump>([-1.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    is_denied::<DoJump>([1.5, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let delay = NavDelay { delay: 1.5, hour: -1, minute: 59, second: 0 };
    assert_eq!(decode([1.5, -1.0, 59.0, -0.0, 0.0, 0.0, 0.0]), Ok(delay), "a duration is not an integer");
    is_denied::<NavDelay>([1.5, -1.0, 60.0, 0.0, 0.0, 0.0, 0.0]);
    let interval = |id| decode::<GetMessageInterval>([id, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(interval(16_777_215.0), Ok(GetMessageInterval { message_id: 0xFF_FFFF }));
    assert_eq!(interval(16_777_216.0), Err(MavResult::DENIED));
}

/// C-9: an enum parameter has an open type, and accepts only what the definition lists.
#[test]
fn enumerations_and_bits() {
    let speed = |kind| decode::<DoChangeSpeed>([kind, 5.0, -1.0, 0.0, 0.0, 0.0, 0.0]).map(|speed| speed.speed_type);
    assert_eq!(speed(1.0), Ok(SpeedType::GROUNDSPEED));
    for kind in [4.0, -1.0, 0.25, NAN, 257.0, 1e20] {
        assert_eq!(speed(kind), Err(MavResult::DENIED), "{kind}");
    }
    // An enum with gaps, 16 bits wide.
    let failure =
        |unit| decode::<InjectFailure>([unit, 1.0, 0.0, 0.0, NAN, NAN, NAN]).map(|failure| failure.failure_unit);
    assert_eq!(failure(100.0), Ok(FailureUnit::SYSTEM_BATTERY));
    assert_eq!(failure(99.0), Err(MavResult::DENIED));
    // A bitmask of 32 bits.
    let gimbal = |flags| decode::<DoGimbalManagerPitchyaw>([0.0, NAN, 1.0, NAN, flags, 0.0, 0.0]);
    let flags = GimbalManagerFlags::NEUTRAL | GimbalManagerFlags::YAW_LOCK;
    assert_eq!(gimbal(18.0).map(|gimbal| gimbal.gimbal_manager_flags), Ok(flags));
    for flags in [32_768.0, -1.0, 0.5, NAN, 2_147_483_648.0] {
        assert_eq!(gimbal(flags), Err(MavResult::DENIED), "{flags}");
    }
}

/// C-8: NaN is `None` where it has a meaning; elsewhere NaN is refused. Infinities are always refused.
#[test]
fn floats_and_nan() {
    let home = |roll| decode::<DoSetHome>([1.0, roll, NAN, -180.0, NAN, NAN, NAN]);
    let here = Location { position: None, altitude: None, frame: None };
    let expected = DoSetHome { use_current: true, roll: Some(180.0), pitch: None, yaw: Some(-180.0), location: here };
    assert_eq!(home(180.0), Ok(expected));
    assert_eq!(home(180.1), Err(MavResult::DENIED));
    let camera =
        |id| decode::<ImageStartCapture>([id, 1.0, 2.0, NAN, NAN, NAN, NAN]).map(|image| image.target_camera_id);
    assert_eq!((camera(NAN), camera(255.0)), (Ok(None), Ok(Some(255))));
    assert_eq!((camera(256.0), camera(0.5)), (Err(MavResult::DENIED), Err(MavResult::DENIED)));
    let test =
        |value, timeout| decode::<ActuatorTest>([value, timeout, 0.0, 0.0, 1.0, 0.0, 0.0]).map(|test| test.value);
    assert_eq!((test(NAN, 3.0), test(-1.0, 0.0)), (Ok(None), Ok(Some(-1.0))));
    assert_eq!((test(0.0, NAN), test(1.5, 1.0)), (Err(MavResult::DENIED), Err(MavResult::DENIED)));
    // A parameter without a range.
    let speed = |speed| decode::<DoRallyLand>([NAN, speed, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(speed(-1e30), Ok(DoRallyLand { altitude: None, speed: Some(-1e30) }));
    assert_eq!(speed(f32::INFINITY), Err(MavResult::DENIED));
}

/// C-6, C-7, M-4: the position of both forms, exactly as it was sent.
#[test]
fn location() {
    let place = |position, altitude, frame| NavTakeoff {
        pitch: Some(0.0),
        flags: None,
        yaw: None,
        location: Location { position, altitude, frame },
    };
    let take_off = |lat, lon, z| decode::<NavTakeoff>([0.0, 0.0, NAN, NAN, lat, lon, z]);
    let zurich = Some(LatLon { latitude: 473_977_432, longitude: 85_455_952 });
    // The nearest floats.
    assert_eq!(take_off(47.397_743, 8.545_595, 12.5), Ok(place(zurich, Some(12.5), None)));
    assert_eq!(take_off(NAN, NAN, NAN), Ok(place(None, None, None)));
    for (lat, lon) in [(NAN, 8.5), (47.0, NAN), (90.1, 0.0), (0.0, 180.1), (1e9, 0.0), (f32::INFINITY, 0.0)] {
        assert_eq!(take_off(lat, lon, 1.0), Err(MavResult::DENIED), "{lat}, {lon}");
    }
    for z in [f32::INFINITY, 2e6] {
        assert_eq!(take_off(47.0, 8.0, z), Err(MavResult::DENIED), "{z}");
    }

    let take_off = |frame, x, y, z| int(MavCmd::NAV_TAKEOFF, frame, [0.0, 0.0, NAN, NAN], x, y, z).decode();
    for (frame, twin) in [
        (MavFrame::GLOBAL, MavFrame::GLOBAL_INT),
        (MavFrame::GLOBAL_RELATIVE_ALT, MavFrame::GLOBAL_RELATIVE_ALT_INT),
        (MavFrame::GLOBAL_TERRAIN_ALT, MavFrame::GLOBAL_TERRAIN_ALT_INT),
    ] {
        let expected = Ok(place(zurich, Some(2.0), Some(frame)));
        assert_eq!([frame, twin].map(|frame| take_off(frame, 473_977_432, 85_455_952, 2.0)), [expected; 2]);
    }
    assert_eq!(take_off(MavFrame::GLOBAL_INT, i32::MAX, i32::MAX, NAN), Ok(place(None, None, Some(MavFrame::GLOBAL))));
    assert_eq!(take_off(MavFrame::MISSION, 0, 0, 7.0), Ok(place(None, Some(7.0), Some(MavFrame::MISSION))));
    for (x, y) in [(i32::MAX, 0), (0, i32::MAX), (900_000_001, 0), (0, i32::MIN), (0x7FC0_0000, 0x7FC0_0000)] {
        assert_eq!(take_off(MavFrame::GLOBAL, x, y, 2.0), Err(MavResult::DENIED), "{x}, {y}");
    }
    let result = take_off(MavFrame::LOCAL_NED, 0, 0, 2.0);
    assert_eq!(result, Err(MavResult::COMMAND_UNSUPPORTED_MAV_FRAME));
}

/// C-7: without a position the frame is ignored. An integer is exact even where a float is not.
#[test]
fn integers_of_a_command_int_are_exact() {
    const RULE: CommandRule = CommandRule::without_position(
        31_010,
        &[ParamRule::integers(5, 0, 20_000_000), ParamRule::bits(6, 0x0300_0000), ParamRule::integers(7, -1, 1)],
    );
    command! {
        /// Integers that no float represents.
        struct Fine = RULE {
            serial: u32 = 5,
            bits: u64 = 6,
            sign: i8 = 7,
        }
    }
    let decode = |x, y, z| int(MavCmd::USER_1, MavFrame(77), [NAN; 4], x, y, z).decode::<Fine>();
    assert_eq!(decode(16_777_217, 0x0300_0000, -1.0), Ok(Fine { serial: 16_777_217, bits: 0x0300_0000, sign: -1 }));
    assert_eq!(decode(20_000_001, 0, 0.0), Err(MavResult::DENIED));
    assert_eq!(decode(0, 0x0300_0001, 0.0), Err(MavResult::DENIED));
    assert_eq!(decode(i32::MAX, 0, 0.0), Err(MavResult::DENIED), "not given");
}

/// A type refuses values that it cannot hold, whatever the rule accepts.
#[test]
fn field_refuses_values_out_of_its_type() {
    const RULE: CommandRule = CommandRule::without_position(31_010, &[]);
    command! {
        /// Parameters without rules.
        struct Loose = RULE { a: u8 = 1, b: i8 = 2, c: u16 = 3, d: u32 = 4, e: i32 = 5, f: bool = 6, g: Option<i16> = 7, }
    }
    let good = [255.0, -128.0, 65_535.0, 2_147_483_520.0, -2_147_483_648.0, 1.0, NAN];
    let loose = Loose { a: 255, b: -128, c: 65_535, d: 2_147_483_520, e: i32::MIN, f: true, g: None };
    assert_eq!(decode(good), Ok(loose));
    let bad: [&[f32]; 7] = [
        &[256.0, -1.0, 0.5, NAN],
        &[128.0, -129.0, 255.0],
        &[65_536.0, -1.0],
        &[2_147_483_648.0, -1.0],
        &[2_147_483_648.0, -2_147_483_904.0, 0.25],
        &[2.0, -1.0, 0.5, NAN],
        &[32_768.0, -32_769.0, 0.5],
    ];
    for (at, values) in bad.iter().enumerate() {
        for value in *values {
            let mut params = good;
            params[at] = *value;
            is_denied::<Loose>(params);
        }
    }
}

#[test]
fn another_command_is_not_decoded() {
    let land = long(MavCmd::NAV_LAND, [0.0; 7]);
    assert_eq!(land.decode::<NavTakeoff>(), Err(MavResult::UNSUPPORTED));
    let item = Item { command: MavCmd::NAV_LAND, ..Item::default() };
    assert_eq!(item.decode::<NavTakeoff>(), Err(MavMissionResult::UNSUPPORTED));
}

/// M-74: the vehicle's own rule replaces the generated one.
#[test]
fn rule_of_the_vehicle_replaces_the_generated_one() {
    const OWN: CommandRule =
        rules::NAV_WAYPOINT.with_params(&[ParamRule::at_least(1, -1.0).or_nan()]).with_frames(&[MavFrame::GLOBAL]);
    let at = |frame, hold| int(MavCmd::NAV_WAYPOINT, frame, [hold, 0.0, 0.0, NAN], 0, 1, 10.0);
    let hold = |command: Command| command.decode_by::<NavWaypoint>(&OWN).map(|waypoint| waypoint.hold);
    assert_eq!(at(MavFrame::GLOBAL, -1.0).decode::<NavWaypoint>(), Err(MavResult::DENIED));
    assert_eq!(hold(at(MavFrame::GLOBAL, -1.0)), Ok(-1.0));
    assert!(hold(at(MavFrame::GLOBAL, NAN)).is_ok_and(f32::is_nan), "the rule accepts it");
    assert_eq!(hold(at(MavFrame::GLOBAL_RELATIVE_ALT, 0.0)), Err(MavResult::COMMAND_UNSUPPORTED_MAV_FRAME));
    let somewhere = int(MavCmd::NAV_WAYPOINT, MavFrame::GLOBAL, [0.0; 4], i32::MAX, i32::MAX, 10.0);
    assert!(somewhere.decode::<NavWaypoint>().is_ok_and(|waypoint| waypoint.location.position.is_none()));
    assert_eq!(hold(somewhere), Err(MavResult::DENIED), "a waypoint needs a position");
}

/// M-4, M-38: an item decodes to the same values, and its refusal names the parameter.
#[test]
fn items_decode_like_commands() {
    let item = Item {
        frame: MavFrame::GLOBAL_RELATIVE_ALT_INT,
        command: MavCmd::NAV_WAYPOINT,
        params: [2.5, 3.0, NAN, 90.0],
        x: -1,
        y: 1_800_000_000,
        z: 10.0,
        ..Item::default()
    };
    let location = Location {
        position: Some(LatLon { latitude: -1, longitude: 1_800_000_000 }),
        altitude: Some(10.0),
        frame: Some(MavFrame::GLOBAL_RELATIVE_ALT),
    };
    let waypoint = NavWaypoint { hold: 2.5, accept_radius: 3.0, pass_radius: None, yaw: Some(90.0), location };
    assert_eq!(item.decode(), Ok(waypoint));
    let fault = |item: Item| item.decode::<NavWaypoint>().err();
    assert_eq!(fault(Item { params: [-1.0, 0.0, 0.0, 0.0], ..item }), Some(MavMissionResult::INVALID_PARAM1));
    assert_eq!(fault(Item { params: [0.0, NAN, 0.0, 0.0], ..item }), Some(MavMissionResult::INVALID_PARAM2));
    assert_eq!(fault(Item { x: i32::MAX, ..item }), Some(MavMissionResult::INVALID_PARAM5_X));
    assert_eq!(fault(Item { y: i32::MAX, ..item }), Some(MavMissionResult::INVALID_PARAM6_Y));
    assert_eq!(fault(Item { z: f32::INFINITY, ..item }), Some(MavMissionResult::INVALID_PARAM7));
    assert_eq!(fault(Item { frame: MavFrame::LOCAL_ENU, ..item }), Some(MavMissionResult::UNSUPPORTED_FRAME));

    // Parameters 5 and 6 of a command without a position are plain numbers in every frame (M-75).
    let calibration = |frame, x, y| {
        let item = Item { frame, command: MavCmd::PREFLIGHT_CALIBRATION, x, y, ..Item::default() };
        item.decode::<PreflightCalibration>()
            .map(|calibration| (calibration.accelerometer, calibration.compmot_or_airspeed))
    };
    let expected = Ok((PreflightCalibrationAccelerometer::SIMPLE, Some(2)));
    for frame in [MavFrame::MISSION, MavFrame::GLOBAL, MavFrame::GLOBAL_RELATIVE_ALT_INT] {
        assert_eq!(calibration(frame, 4, 2), expected);
    }
    assert_eq!(calibration(MavFrame::GLOBAL, 40_000_000, 2), Err(MavMissionResult::INVALID_PARAM5_X));
    assert_eq!(calibration(MavFrame::GLOBAL, 4, 20_000_000), Err(MavMissionResult::INVALID_PARAM6_Y));
    assert_eq!(calibration(MavFrame::MISSION, 40_000_000, 2), Err(MavMissionResult::INVALID_PARAM5_X));
}

/// Values with a meaning for some parameter, and others.
fn value() -> impl Strategy<Value = f32> {
    let known =
        prop::sample::select(vec![NAN, 0.0, 1.0, 2.0, 3.0, 4.0, -1.0, 0.5, 76.0, 180.0, 21_196.0, f32::INFINITY]);
    prop_oneof![8 => known, 1 => -200.0f32..200.0, 1 => any::<u32>().prop_map(f32::from_bits)]
}

/// Values that an integer parameter can have too.
fn whole() -> impl Strategy<Value = Option<i32>> {
    prop_oneof![Just(None), (-3..80).prop_map(Some), (-(1 << 24)..1 << 24).prop_map(Some)]
}

/// Returns the float that means the same.
fn float(value: Option<i32>) -> f32 {
    value.map_or(NAN, |value| value as f32)
}

/// Formats the result; as text, NaN equals NaN.
fn text<T: TypedCommand + std::fmt::Debug>(command: Command) -> String {
    format!("{:?}", command.decode::<T>())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    /// C-6, C-7
    #[test]
    fn both_forms_and_items_give_the_same_parameters(
        params in [value(), value(), value(), value()],
        x in whole(),
        y in whole(),
        z in value(),
    ) {
        let [p1, p2, p3, p4] = params;
        let (raw_x, raw_y) = (x.unwrap_or(i32::MAX), y.unwrap_or(i32::MAX));
        macro_rules! same {
            ($($ty:ty),+) => { $(
                let id = <$ty>::RULE.command();
                let of_long = text::<$ty>(long(id, [p1, p2, p3, p4, float(x), float(y), z]));
                let of_int = text::<$ty>(int(id, MavFrame(99), params, raw_x, raw_y, z));
                prop_assert_eq!(&of_long, &of_int);
                let item =
                    Item { frame: MavFrame::MISSION, command: id, params, x: raw_x, y: raw_y, z, ..Item::default() };
                let of_item = item.decode::<$ty>().map_err(|_| MavResult::DENIED);
                prop_assert_eq!(&of_long, &format!("{:?}", of_item));
            )+ };
        }
        same!(
            PreflightCalibration, ActuatorTest, DoGimbalManagerPitchyaw, DoMotorTest, PreflightRebootShutdown,
            DoSetActuator, CameraTrackRectangle, DoMountControl, ConditionYaw, RequestMessage
        );
    }

    /// C-6: degrees and deg·1e7 give the same position, apart from the frame, which a COMMAND_LONG lacks.
    #[test]
    fn both_forms_give_the_same_place(
        lat in prop_oneof![9 => -95.0f32..95.0, 1 => Just(NAN)],
        lon in prop_oneof![9 => -185.0f32..185.0, 1 => Just(NAN)],
        z in value(),
        params in [value(), value(), value(), value()],
    ) {
        let [p1, p2, p3, p4] = params;
        let scaled = |degrees: f32| if degrees.is_nan() { i32::MAX } else { (f64::from(degrees) * 1e7).round() as i32 };
        macro_rules! same {
            ($($ty:ty),+) => { $(
                let id = <$ty>::RULE.command();
                let of_long = text::<$ty>(long(id, [p1, p2, p3, p4, lat, lon, z]));
                let of_int = text::<$ty>(int(id, MavFrame::GLOBAL, params, scaled(lat), scaled(lon), z));
                prop_assert_eq!(of_long, of_int.replace("frame: Some(MavFrame(0))", "frame: None"));
            )+ };
        }
        same!(NavTakeoff, NavLand, NavWaypoint, NavLoiterTurns, DoReposition, DoOrbit, DoSetHome, NavRallyPoint);
    }
}
