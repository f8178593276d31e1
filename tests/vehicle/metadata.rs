//! The files of component metadata (O-1, EVT-8): what a ground station reads about a table of parameters, and about events.

use mavstack::metadata::{self, MetadataFile};

mavstack::parameters! {
    /// One of each type.
    pub struct Tuning {
        /// A byte. What it is good for
        /// stands here.
        A_BYTE: u8 = 1, 0..=255, "";
        /// With "quotes", a \ and
        /// no end
        B_SIGNED: i8 = -1, -128..=127, "%" { reboot_required };
        C_WORD: u16 = 2, 0..=u16::MAX, "ms" { volatile };
        /// Metres, 1.5 of them at first.
        D: i16 = -300, i16::MIN..=i16::MAX, "m";
        E_LONG: u32 = u32::MAX, 0..=u32::MAX, "" { read_only };
        F_LONG: i32 = i32::MIN, i32::MIN..=i32::MAX, "deg*1e7";
        G_FLOAT: f32 = 0.1, -1e30..=12.5, "1/s";
    }
}

#[test]
fn every_parameter_has_type_range_and_unit() {
    let mut file = String::new();
    metadata::parameters::<Tuning>(&mut file).unwrap();
    let expected = [
        r#"{"name":"A_BYTE","type":"Uint8","shortDesc":"A byte","longDesc":"A byte. What it is good for stands here.","#,
        r#""group":"A","default":1,"min":0,"max":255},"#,
        r#"{"name":"B_SIGNED","type":"Int8","shortDesc":"With \"quotes\", a \\ and no end","group":"B","units":"%","#,
        r#""default":-1,"min":-128,"max":127,"rebootRequired":true},"#,
        r#"{"name":"C_WORD","type":"Uint16","shortDesc":"","group":"C","units":"ms","default":2,"min":0,"max":65535,"#,
        r#""volatile":true},"#,
        r#"{"name":"D","type":"Int16","shortDesc":"Metres, 1.5 of them at first.","group":"D","units":"m","#,
        r#""default":-300,"min":-32768,"max":32767},"#,
        r#"{"name":"E_LONG","type":"Uint32","shortDesc":"","group":"E","default":4294967295,"min":0,"max":4294967295,"#,
        r#""readOnly":true},"#,
        r#"{"name":"F_LONG","type":"Int32","shortDesc":"","group":"F","units":"deg*1e7","default":-2147483648,"#,
        r#""min":-2147483648,"max":2147483647},"#,
        r#"{"name":"G_FLOAT","type":"Float","shortDesc":"","group":"G","units":"1/s","default":0.1,"#,
        r#""min":-1000000000000000000000000000000,"max":12.5}"#,
    ];
    assert_eq!(file, format!(r#"{{"version":1,"parameters":[{}]}}"#, expected.concat()));
}

/// Where the radio sits.
const RADIO: i32 = 2;

mavstack::parameters! {
    /// One of each attribute.
    pub struct Attributes {
        BAT_LOW: f32 = 0.1, -1.0..=12.6, "V" { decimals: 2, increment: 0.1, values: { -1.0 => "Off", 0.1 => "Some" } };
        FS_ACT: i32 = 1, -1..=2, "" {
            values: { -1 => "By \"mode\"", 1 => "Hold", RADIO => "Radio" },
            category: "Failsafe",
            group: "Loss",
            increment: 1,
            reboot_required,
        };
        MODULES: u32 = 5, 0..=u32::MAX, "" { bitmask: { 0 => "GPS", 31 => "Sonar" }, volatile };
        SIGNS: i8 = 0, -128..=127, "" { read_only, bitmask: { 7 => "Sign" } };
        SYS_ID: i32 = 7, 1..=254, "" { system_id, category: "System" };
    }
}

#[test]
fn every_attribute_is_described() {
    let mut file = String::new();
    metadata::parameters::<Attributes>(&mut file).unwrap();
    let expected = [
        r#"{"name":"BAT_LOW","type":"Float","shortDesc":"","group":"BAT","units":"V","default":0.1,"min":-1,"max":12.6,"#,
        r#""decimalPlaces":2,"increment":0.1,"values":[{"value":-1,"description":"Off"},{"value":0.1,"description":"Some"}]},"#,
        r#"{"name":"FS_ACT","type":"Int32","shortDesc":"","group":"Loss","category":"Failsafe","default":1,"min":-1,"max":2,"#,
        r#""increment":1,"rebootRequired":true,"values":[{"value":-1,"description":"By \"mode\""},"#,
        r#"{"value":1,"description":"Hold"},{"value":2,"description":"Radio"}]},"#,
        r#"{"name":"MODULES","type":"Uint32","shortDesc":"","group":"MODULES","default":5,"min":0,"max":4294967295,"#,
        r#""volatile":true,"bitmask":[{"index":0,"description":"GPS"},{"index":31,"description":"Sonar"}]},"#,
        r#"{"name":"SIGNS","type":"Int8","shortDesc":"","group":"SIGNS","default":0,"min":-128,"max":127,"readOnly":true,"#,
        r#""bitmask":[{"index":7,"description":"Sign"}]},"#,
        r#"{"name":"SYS_ID","type":"Int32","shortDesc":"","group":"SYS","category":"System","default":7,"min":1,"max":254,"#,
        r#""rebootRequired":true}"#,
    ];
    assert_eq!(file, format!(r#"{{"version":1,"parameters":[{}]}}"#, expected.concat()));
}

/// What `component_metadata/parameter.schema.json` of MAVLink (July 2026) permits in a parameter. It permits nothing else. Its third
/// version differs from the first in nothing that is written here, and QGroundControl reads only the first.
#[test]
fn file_has_the_form_that_mavlinks_schema_permits() {
    use serde_json::Value;
    const TYPES: [&str; 7] = ["Uint8", "Int8", "Uint16", "Int16", "Uint32", "Int32", "Float"];
    type Form = fn(&Value) -> bool;
    fn has_form(key: &str, value: &Value) -> bool {
        let are = |fields: [(&str, Form); 2]| {
            value.as_array().is_some_and(|items| {
                items.iter().all(|item| {
                    let item = item.as_object().unwrap();
                    item.len() == 2 && fields.iter().all(|(field, is)| item.get(*field).is_some_and(is))
                })
            })
        };
        match key {
            "name" => value.as_str().is_some_and(|name| {
                (1..=16).contains(&name.len())
                    && name.bytes().all(|c| c.is_ascii_alphanumeric() || b".-_{}".contains(&c))
            }),
            "type" => value.as_str().is_some_and(|name| TYPES.contains(&name)),
            "shortDesc" | "longDesc" | "units" | "group" | "category" => value.is_string(),
            "default" | "min" | "max" | "increment" => value.is_number(),
            "decimalPlaces" => value.is_u64(),
            "rebootRequired" | "volatile" | "readOnly" => value.is_boolean(),
            "values" => are([("value", Value::is_number), ("description", Value::is_string)]),
            "bitmask" => are([("index", Value::is_u64), ("description", Value::is_string)]),
            _ => false,
        }
    }
    let (mut first, mut second) = (String::new(), String::new());
    metadata::parameters::<Tuning>(&mut first).unwrap();
    metadata::parameters::<Attributes>(&mut second).unwrap();
    for file in [first, second] {
        let file: Value = serde_json::from_str(&file).unwrap();
        let keys: Vec<_> = file.as_object().unwrap().keys().collect();
        assert_eq!(keys, ["parameters", "version"]);
        for parameter in file["parameters"].as_array().unwrap() {
            let parameter = parameter.as_object().unwrap();
            assert!(parameter.contains_key("name"));
            assert_eq!(parameter.iter().find(|(key, value)| !has_form(key, value)), None);
        }
    }
}

#[test]
fn general_file_names_the_others() {
    let mut file = String::new();
    let parameters = MetadataFile::parameters("https://rover.example/p.json", 0xFFFF_FFFF);
    metadata::general(&mut file, &[parameters, MetadataFile::events("mftp:///e.json", 7)]).unwrap();
    let expected = [
        r#"{"version":1,"metadataTypes":[{"type":1,"uri":"https://rover.example/p.json","fileCrc":4294967295},"#,
        r#"{"type":4,"uri":"mftp:///e.json","fileCrc":7}]}"#,
    ];
    assert_eq!(file, expected.concat());
}

#[test]
fn control_characters_are_escaped() {
    let mut file = String::new();
    metadata::general(&mut file, &[MetadataFile::parameters("a\nb\u{1f}", 0)]).unwrap();
    assert!(file.contains(r#""uri":"a\u000ab\u001f""#), "{file}");
}

mavstack::events! {
    /// The events of a crane.
    struct Events in "crane", component 200 {
        enums {
            /// Sides.
            Side: bitmask u8 {
                /// left
                LEFT_SIDE = 1,
            }
        }
        modes ModeGroups {
            /// By hand
            MANUAL = [1, 65_536],
            /// By itself
            AUTO = [],
        }
        components Part {
            /// The hook
            HOOK,
        }
        arming_checks {
            HookOpen(Error) { /** how far */ width: f32 } = "Hook open: {3:.1m}";
        }
        health_checks {
            Rusty(Warning) = "Rusty";
        }
        events {
            /// Too heavy:
            /// lower it.
            Overload(Critical, Disabled) { side: Side, load: i64 } = "Overload \"{1}\"";
        }
    }
}

/// EVT-1, EVT-8: names, ids, texts, arguments and enumerations of all events, in libevents' format.
#[test]
fn every_event_is_described() {
    use mavstack::events::DeclaredEvent;

    let mut file = String::new();
    metadata::events::<Events>(&mut file).unwrap();
    let id = |id: u32| {
        assert_eq!(id >> 24, 200);
        (id & 0x00FF_FFFF).to_string()
    };
    let number = |name: &str| {
        let hash = name.bytes().fold(0x811C_9DC5_u32, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
        (hash & 0x00FF_FFFF).to_string()
    };
    assert_eq!([id(Overload::INFO.id()), id(HookOpen::INFO.id())], [number("overload"), number("hook_open")]);
    let expected = [
        r#"{"version":2,"components":{"200":{"namespace":"crane","enums":{"#,
        r#""side_t":{"is_bitfield":true,"type":"uint8_t","description":"Sides.","entries":{"1":{"name":"left_side","#,
        r#""description":"left"}}},"#,
        r#""mode_groups_t":{"is_bitfield":true,"type":"uint32_t","description":"Groups of flight modes.","entries":{"#,
        r#""1":{"name":"manual","description":"By hand"},"2":{"name":"auto","description":"By itself"}}},"#,
        r#""part_t":{"is_bitfield":true,"type":"uint32_t","description":"What can fail.","entries":{"#,
        r#""1":{"name":"none","description":"None"},"2":{"name":"hook","description":"The hook"}}}},"event_groups":{"#,
        r#""default":{"events":{"#,
        &format!(r#""{}":{{"name":"overload","message":"Overload \"{{1}}\"","#, number("overload")),
        r#""description":"Too heavy: lower it.","arguments":[{"name":"side","type":"side_t"},"#,
        r#"{"name":"load","type":"int64_t"}]}}},"arming_check":{"events":{"#,
        &format!(r#""{}":{{"name":"arming_check_summary","#, number("arming_check_summary")),
        r#""message":"Arming checks","type":"summary","arguments":[{"name":"chunk_idx","type":"uint8_t"},"#,
        r#"{"name":"error","type":"part_t"},{"name":"warning","type":"part_t"},{"name":"can_arm","type":"mode_groups_t"},"#,
        r#"{"name":"can_run","type":"mode_groups_t"}]},"#,
        &format!(r#""{}":{{"name":"hook_open","message":"Hook open: {{3:.1m}}","#, number("hook_open")),
        r#""arguments":[{"name":"modes","type":"mode_groups_t"},{"name":"health_component_index","type":"uint8_t"},"#,
        r#"{"name":"width","type":"float","description":"how far"}]}}},"health":{"events":{"#,
        &format!(r#""{}":{{"name":"rusty","message":"Rusty","#, number("rusty")),
        r#""arguments":[{"name":"modes","type":"mode_groups_t"},{"name":"health_component_index","type":"uint8_t"}]},"#,
        &format!(r#""{}":{{"name":"health_summary","#, number("health_summary")),
        r#""message":"Health","type":"summary","arguments":[{"name":"chunk_idx","type":"uint8_t"},"#,
        r#"{"name":"is_present","type":"part_t"},{"name":"error","type":"part_t"},{"name":"warning","type":"part_t"}]}}}},"#,
        r#""supported_protocols":["health_and_arming_check"],"#,
        r#""navigation_mode_groups":{"groups":{"0":[1, 65536],"1":[]}}}}}"#,
    ];
    assert_eq!(file, expected.concat());
}

/// MAVLink's CRC-32 of the digits 1 to 9 is JAMCRC with the initial value 0.
#[test]
fn checksum_is_the_one_of_mavlink() {
    let mut reference = crc_any::CRCu32::create_crc(0xEDB8_8320, 32, 0, 0, true);
    reference.digest(b"123456789");
    assert_eq!(metadata::file_crc(b"123456789"), reference.get_crc());
    assert_eq!(metadata::file_crc(b""), 0);
}

/// A write error is returned.
#[test]
fn write_error_is_returned() {
    struct Full;
    impl core::fmt::Write for Full {
        fn write_str(&mut self, _: &str) -> core::fmt::Result {
            Err(core::fmt::Error)
        }
    }
    assert!(metadata::parameters::<Tuning>(&mut Full).is_err());
    assert!(metadata::general(&mut Full, &[]).is_err());
    assert!(metadata::events::<Events>(&mut Full).is_err());
}
