//! The files of component metadata (O-1): what a ground station reads about a table of parameters.

use mavstack::metadata;

mavstack::parameters! {
    /// One of each type.
    pub struct Tuning {
        /// A byte. What it is good for
        /// stands here.
        A_BYTE: u8 = 1, 0..=255, "";
        /// With "quotes", a \ and
        /// no end
        B_SIGNED: i8 = -1, -128..=127, "%", [reboot_required];
        C_WORD: u16 = 2, 0..=u16::MAX, "ms", [volatile];
        /// Metres, 1.5 of them at first.
        D: i16 = -300, i16::MIN..=i16::MAX, "m";
        E_LONG: u32 = u32::MAX, 0..=u32::MAX, "", [read_only];
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
        r#"{"name":"E_LONG","type":"Uint32","shortDesc":"","group":"E","default":4294967295,"min":0,"max":4294967295},"#,
        r#"{"name":"F_LONG","type":"Int32","shortDesc":"","group":"F","units":"deg*1e7","default":-2147483648,"#,
        r#""min":-2147483648,"max":2147483647},"#,
        r#"{"name":"G_FLOAT","type":"Float","shortDesc":"","group":"G","units":"1/s","default":0.1,"#,
        r#""min":-1000000000000000000000000000000,"max":12.5}"#,
    ];
    assert_eq!(file, format!(r#"{{"version":1,"parameters":[{}]}}"#, expected.concat()));
}

#[test]
fn general_file_names_the_parameter_file() {
    let mut file = String::new();
    metadata::general(&mut file, "https://rover.example/p.json", 0xFFFF_FFFF).unwrap();
    let expected =
        r#"{"version":1,"metadataTypes":[{"type":1,"uri":"https://rover.example/p.json","fileCrc":4294967295}]}"#;
    assert_eq!(file, expected);
}

#[test]
fn control_characters_are_escaped() {
    let mut file = String::new();
    metadata::general(&mut file, "a\nb\u{1f}", 0).unwrap();
    assert!(file.contains(r#""uri":"a\u000ab\u001f""#), "{file}");
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
    assert!(metadata::general(&mut Full, "", 0).is_err());
}
