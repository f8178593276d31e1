//! Decodes every typed command from values that its definition accepts, and checks that values that it excludes are refused
//! (C-6 to C-9). The generated list is compiled a second time here, with this file's macros instead of the crate's.

#![allow(unused_imports, dead_code, reason = "what the generated text imports and declares")]

use mavstack::command::CommandPosition;
use mavstack::config::LinkClass;
use mavstack::dialect::{MavFrame, MavMissionResult, MavResult};
use mavstack::message::{ComponentId, Location, ParamRule, Secret, TypedCommand};
use mavstack::{Address, Command, CommandRule, Item, LinkId, Peer, Text};
use std::fmt::Debug;

macro_rules! tested {
    (
        $(#[$_meta:meta])*
        pub struct $name:ident = $_rule:path { $( $(#[$_field_meta:meta])* $_field:ident: $ty:ty = $index:literal, )+ }
    ) => {
        #[test]
        #[allow(non_snake_case)]
        fn $name() {
            crate::every_command::check::<mavstack::dialect::commands::$name>(&[ $( ($index, stringify!($ty)), )+ ]);
        }
    };
}

macro_rules! nothing {
    ($($_:tt)*) => {};
}

pub(crate) use {
    nothing as dialect, nothing as message, nothing as wire_bitmask, nothing as wire_enum, tested as command,
};

#[path = "../../src/dialect/common.rs"]
mod common;

const NAN: f32 = f32::NAN;
const GCS: Peer = Peer { address: Address::new(255, 190), link: LinkId(0) };

/// Every parameter accepts at least one of these values.
const GOOD: [f32; 6] = [NAN, 0.0, 1.0, 3.0, -1.0, 100.0];

const INVALID: [MavMissionResult; 7] = [
    MavMissionResult::INVALID_PARAM1,
    MavMissionResult::INVALID_PARAM2,
    MavMissionResult::INVALID_PARAM3,
    MavMissionResult::INVALID_PARAM4,
    MavMissionResult::INVALID_PARAM5_X,
    MavMissionResult::INVALID_PARAM6_Y,
    MavMissionResult::INVALID_PARAM7,
];

/// Parameters 5 and 6 are integers here.
fn item<T: TypedCommand>(frame: MavFrame, params: [f32; 7]) -> Item {
    let [p1, p2, p3, p4, x, y, z] = params;
    let integer = |value: f32| if value.is_nan() { i32::MAX } else { value as i32 };
    let (x, y) = (integer(x), integer(y));
    Item { frame, command: T::RULE.command(), params: [p1, p2, p3, p4], x, y, z, ..Item::default() }
}

fn command<T>(item: &Item, position: CommandPosition) -> Result<T, MavResult>
where
    T: TypedCommand,
{
    let (params, z) = (item.params, item.z);
    Command {
        id: item.command,
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
    .decode()
}

fn long<T: TypedCommand>(params: [f32; 7]) -> Result<T, MavResult> {
    let [.., param5, param6, _] = params;
    command(&item::<T>(MavFrame::MISSION, params), CommandPosition::Long { param5, param6 })
}

fn int<T: TypedCommand>(params: [f32; 7]) -> Result<T, MavResult> {
    let item = item::<T>(MavFrame::GLOBAL, params);
    command(&item, CommandPosition::Int { frame: item.frame, x: item.x, y: item.y })
}

/// Checks a type with these fields.
fn check<T: TypedCommand + Debug>(fields: &[(u8, &str)]) {
    let is_located = fields.contains(&(5, "Location"));
    let frame = if is_located { MavFrame::GLOBAL } else { MavFrame::MISSION };
    // Replaces one parameter after another: a refusal is caused by one that is not replaced yet.
    let mut params = [NAN; 7];
    for at in 0..7 {
        let passes = |value: f32| {
            let mut params = params;
            params[at] = value;
            item::<T>(frame, params).decode::<T>().err() != Some(INVALID[at])
        };
        params[at] = GOOD.into_iter().find(|value| passes(*value)).expect("a good value");
    }

    let of_item = item::<T>(frame, params).decode::<T>();
    let of_item = format!("{:?}", of_item.unwrap_or_else(|fault| panic!("{params:?}: {fault:?}")));
    assert_eq!(format!("{:?}", int::<T>(params)), format!("Ok({of_item})"));
    let named = of_item.replace("frame: Some(MavFrame(0))", "frame: None");
    assert_eq!(format!("{:?}", long::<T>(params)), format!("Ok({named})"));

    let with = |index: u8, value: f32| {
        let mut params = params;
        params[usize::from(index) - 1] = value;
        params
    };
    let same = |params: [f32; 7]| {
        let (long, int) = (long::<T>(params), int::<T>(params));
        assert_eq!(long.is_ok(), int.is_ok(), "{params:?}");
        long.map(|_| ())
    };
    for &(index, ty) in fields.iter().filter(|(_, ty)| *ty != "Location") {
        let nan = if ty.starts_with("Option") { Ok(()) } else { Err(MavResult::DENIED) };
        assert_eq!(same(with(index, NAN)), nan, "parameter {index}");
        let at_infinity = long::<T>(with(index, f32::INFINITY)).err();
        assert_eq!(at_infinity, Some(MavResult::DENIED), "parameter {index}");
        if !ty.contains("f32") {
            assert_eq!(long::<T>(with(index, 0.5)).err(), Some(MavResult::DENIED), "parameter {index}");
            assert_eq!(long::<T>(with(index, -3e9)).err(), Some(MavResult::DENIED), "parameter {index}");
            // A rule that accepts any value does not hide what the type cannot hold.
            let anything = CommandRule::any(T::RULE.command());
            let by_any = |value| item::<T>(frame, with(index, value)).decode_by::<T>(&anything).err();
            let invalid = Some(INVALID[usize::from(index) - 1]);
            assert!(ty.contains("i32") || by_any(-3e9) == invalid, "parameter {index}: {:?}", by_any(-3e9));
        }
    }
    // C-8: an unused parameter is 0 or NaN.
    let is_used = |index| fields.iter().any(|(field, _)| *field == index) || (is_located && index > 5);
    for index in (1..=7).filter(|index| !is_used(*index)) {
        assert_eq!((same(with(index, 0.0)), same(with(index, NAN))), (Ok(()), Ok(())), "parameter {index}");
    }
}
