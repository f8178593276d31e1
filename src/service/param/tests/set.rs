//! PARAM_SET: every row of P-14.

use super::*;
use MavParamType as Type;

/// P-14, P-15: every PARAM_SET is answered by one PARAM_VALUE with the resulting value on every link. A refusal is sent to the
/// client before it, and the text on its link only.
#[test]
fn every_row_of_the_table() {
    let full = |bits: f32| bits.to_bits();
    let rows = [
        ("ALT_MIN", Type::REAL32, full(-100.0), Ok(full(-100.0))),
        ("ALT_MIN", Type::REAL32, full(100.0), Ok(full(100.0))),
        ("BYTE", Type::UINT8, 200, Ok(200)),
        ("ID_OF_16_LETTERS", Type::INT32, (-1_000i32).cast_unsigned(), Ok((-1_000i32).cast_unsigned())),
        ("ID_OF_16_LETTERS", Type::INT32, 1_000_000_000, Ok(1_000_000_000)),
        ("SMALL", Type::INT8, 0xF6, Ok(0xF6)),
        ("SMALL", Type::INT8, (-9i32).cast_unsigned(), Ok(0xF7)),
        ("WIDE", Type::INT16, 0xFC18, Ok(0xFC18)),
        ("WORD", Type::UINT16, 65_535, Ok(65_535)),
        // The current value.
        ("BYTE", Type::UINT8, 7, Ok(7)),
        // Another integer type: the value is read in the type that was sent, and answered in the parameter's own type.
        ("BYTE", Type::INT8, 8, Ok(8)),
        ("BYTE", Type::INT32, 200, Ok(200)),
        ("WORD", Type::UINT32, 8, Ok(8)),
        ("SMALL", Type::INT32, (-10i32).cast_unsigned(), Ok(0xF6)),
        ("SMALL", Type::INT16, (-10i32).cast_unsigned(), Ok(0xF6)),
        ("SMALL", Type::UINT8, 10, Ok(10)),
        ("WIDE", Type::INT8, 0xFF, Ok(0xFFFF)),
        ("ID_OF_16_LETTERS", Type::INT8, 0x80, Ok((-128i32).cast_unsigned())),
        ("ID_OF_16_LETTERS", Type::UINT32, 1_000_000_000, Ok(1_000_000_000)),
        // The current value, in another type.
        ("BYTE", Type::INT32, 7, Ok(7)),
        // A value that does not fit the parameter's type, or is out of its range.
        ("BYTE", Type::INT8, 0xFF, Err(OUT_OF_RANGE)),
        ("BYTE", Type::INT32, 256 + 8, Err(OUT_OF_RANGE)),
        ("BYTE", Type::UINT16, 201, Err(OUT_OF_RANGE)),
        ("SMALL", Type::UINT8, 0xF6, Err(OUT_OF_RANGE)),
        ("SMALL", Type::INT32, 0xF6, Err(OUT_OF_RANGE)),
        ("WORD", Type::INT32, u32::MAX, Err(OUT_OF_RANGE)),
        ("WORD", Type::UINT32, 65_536, Err(OUT_OF_RANGE)),
        ("ID_OF_16_LETTERS", Type::UINT32, (-1_000i32).cast_unsigned(), Err(OUT_OF_RANGE)),
        ("LOCKED", Type::INT32, 5, Err(MavParamError::READ_ONLY)),
        // P-19: the upper bytes of a small integer are zeros or copies of its top bit. Any other is read as a float:
        // MAVSDK 4.1 sends 0x7FC00000, a client that casts 0x3F800000 for 1, and an uninitialised union has anything.
        ("BYTE", Type::UINT8, 0xFFFF_FF80, Ok(128)),
        ("BYTE", Type::UINT8, 0x3F80_0000, Ok(1)),
        ("BYTE", Type::UINT8, 0x4348_0000, Ok(200)),
        ("WORD", Type::UINT16, 0x477F_FF00, Ok(65_535)),
        ("WIDE", Type::INT16, 0xC47A_0000, Ok(0xFC18)),
        ("SMALL", Type::INT8, 0xC120_0000, Ok(0xF6)),
        ("WORD", Type::UINT16, 0x3F80_0000, Ok(1)),
        ("BYTE", Type::UINT8, 0x7FC0_0000, Err(OUT_OF_RANGE)),
        ("SMALL", Type::INT8, 0x7FC0_0000, Err(OUT_OF_RANGE)),
        ("WIDE", Type::INT16, 0x7FC0_0000, Err(OUT_OF_RANGE)),
        ("WORD", Type::UINT16, 0x7FC0_0000, Err(OUT_OF_RANGE)),
        ("BYTE", Type::UINT8, 0x3FC0_0000, Err(OUT_OF_RANGE)),
        ("BYTE", Type::UINT8, 0x4349_0000, Err(OUT_OF_RANGE)),
        ("BYTE", Type::UINT8, 0xFFFF_FF01, Err(OUT_OF_RANGE)),
        ("BYTE", Type::UINT16, 0xFFFF_0008, Err(OUT_OF_RANGE)),
        ("WORD", Type::UINT8, 0xFFFF_FF08, Err(OUT_OF_RANGE)),
        ("WORD", Type::UINT16, 0xAAAA_0001, Err(OUT_OF_RANGE)),
        ("ID_OF_16_LETTERS", Type::INT8, 0x7FC0_0000, Err(OUT_OF_RANGE)),
        // P-19: a float for an integer, as MAVProxy sends it.
        ("BYTE", Type::REAL32, full(8.0), Ok(8)),
        ("SMALL", Type::REAL32, full(-10.0), Ok(0xF6)),
        ("WIDE", Type::REAL32, full(-1_000.0), Ok(0xFC18)),
        ("WORD", Type::REAL32, full(65_535.0), Ok(65_535)),
        ("ID_OF_16_LETTERS", Type::REAL32, full(-1_000.0), Ok((-1_000i32).cast_unsigned())),
        ("BYTE", Type::REAL32, full(7.0), Ok(7)),
        ("BYTE", Type::REAL32, full(8.5), Err(OUT_OF_RANGE)),
        ("BYTE", Type::REAL32, full(201.0), Err(OUT_OF_RANGE)),
        ("BYTE", Type::REAL32, full(264.0), Err(OUT_OF_RANGE)),
        ("BYTE", Type::REAL32, full(f32::NAN), Err(OUT_OF_RANGE)),
        ("ID_OF_16_LETTERS", Type::REAL32, full(0.5), Err(OUT_OF_RANGE)),
        ("ID_OF_16_LETTERS", Type::REAL32, full(3e9), Err(OUT_OF_RANGE)),
        ("ID_OF_16_LETTERS", Type::REAL32, full(f32::INFINITY), Err(OUT_OF_RANGE)),
        ("LOCKED", Type::REAL32, full(5.0), Err(MavParamError::READ_ONLY)),
        // An integer for a float; a type that the stack does not have, or an invalid one.
        ("ALT_MIN", Type::INT32, 8, Err(MavParamError::TYPE_MISMATCH)),
        ("ALT_MIN", Type::UINT8, 8, Err(MavParamError::TYPE_MISMATCH)),
        ("ALT_MIN", Type::REAL64, full(8.0), Err(MavParamError::TYPE_UNSUPPORTED)),
        ("WORD", Type::UINT64, 8, Err(MavParamError::TYPE_UNSUPPORTED)),
        ("WORD", Type::INT64, 8, Err(MavParamError::TYPE_UNSUPPORTED)),
        ("WORD", Type(0), 8, Err(MavParamError::TYPE_UNSUPPORTED)),
        ("WORD", Type(11), 8, Err(MavParamError::TYPE_UNSUPPORTED)),
        // Not a number.
        ("ALT_MIN", Type::REAL32, full(f32::NAN), Err(OUT_OF_RANGE)),
        ("ALT_MIN", Type::REAL32, full(f32::INFINITY), Err(OUT_OF_RANGE)),
        ("ALT_MIN", Type::REAL32, full(f32::NEG_INFINITY), Err(OUT_OF_RANGE)),
        // Out of range: not clamped.
        ("ALT_MIN", Type::REAL32, full(100.00001), Err(OUT_OF_RANGE)),
        ("ALT_MIN", Type::REAL32, full(-100.00001), Err(OUT_OF_RANGE)),
        ("BYTE", Type::UINT8, 0, Err(OUT_OF_RANGE)),
        ("BYTE", Type::UINT8, 201, Err(OUT_OF_RANGE)),
        ("ID_OF_16_LETTERS", Type::INT32, (-1_001i32).cast_unsigned(), Err(OUT_OF_RANGE)),
        ("SMALL", Type::INT8, 11, Err(OUT_OF_RANGE)),
        ("SMALL", Type::INT8, 0xF5, Err(OUT_OF_RANGE)),
        ("WIDE", Type::INT16, 0x8000, Err(OUT_OF_RANGE)),
        // Read-only, even for the current value.
        ("LOCKED", Type::UINT32, 5, Err(MavParamError::READ_ONLY)),
        ("LOCKED", Type::UINT32, 4_000_000_000, Err(MavParamError::READ_ONLY)),
    ];
    for (name, r#type, bits, outcome) in rows {
        let mut bench = Bench::new();
        let (index, info) = Table::INFO.iter().enumerate().find(|(_, info)| info.name() == name).expect("exists");
        let index = index as u16;
        let old = bench.bits(index);
        let [to_a, to_b] = bench.ask(A, &set(name, r#type, bits));
        let value = |bits| Value(index, name.into(), info.param_type(), bits);
        let row = std::format!("{name} {type:?} {bits:#x}");
        match outcome {
            Ok(new) => {
                assert_eq!((to_a, to_b), (vec![value(new)], vec![value(new)]), "{row}");
                assert_eq!(bench.bits(index), new, "{row}");
                let changes = if new == old { vec![] } else { vec![(index, new)] };
                assert_eq!((bench.vehicle.asked, bench.vehicle.changed), (changes.clone(), changes), "{row}");
            }
            Err(code) => {
                assert_eq!((to_a, to_b), (vec![error(code, -1, name), value(old)], vec![value(old)]), "{row}");
                assert_eq!(bench.bits(index), old, "{row}");
                let texts = usize::from(cfg!(feature = "plan-texts"));
                assert_eq!((bench.texts(0).len(), bench.texts(1).len()), (texts, 0), "{row}");
                assert_eq!((bench.vehicle.asked.len(), bench.vehicle.changed.len()), (0, 0), "{row}");
            }
        }
    }
}

/// P-14: the vehicle decides last, after all other checks.
#[test]
fn the_vehicle_may_refuse() {
    let mut bench = Bench::new();
    bench.vehicle.verdict = Err(MavParamError::PERMISSION_DENIED);
    let old = bench.value(1);
    let sent = bench.ask(A, &set("BYTE", Type::UINT8, 8));
    assert_eq!(sent, [vec![error(MavParamError::PERMISSION_DENIED, -1, "BYTE"), old.clone()], vec![old]]);
    assert_eq!((bench.vehicle.asked, bench.vehicle.changed), (vec![(1, 8)], vec![]));
}

/// P-14: an unknown name has no value.
#[test]
fn an_unknown_name_is_refused_without_a_value() {
    let mut bench = Bench::new();
    let sent = bench.ask(A, &set("MIS_TAKEOFF_ALT", Type::REAL32, 0));
    assert_eq!(sent, [vec![error(DOES_NOT_EXIST, -1, "MIS_TAKEOFF_ALT")], vec![]]);
    let text: &[_] = if cfg!(feature = "plan-texts") { &["MIS_TAKEOFF_ALT: no such parameter"] } else { &[] };
    assert_eq!(bench.texts(0), text);
}

/// P-19: MAVSDK 4.1's `set_param_int` of a small integer sends NaN, and old versions of QGroundControl the rest of a union. Only
/// the firmware can mend that, so the text says how. An `i32`, and a client that sends another wrong value, get the usual text.
#[test]
#[cfg(feature = "plan-texts")]
fn what_is_no_integer_gets_a_text_with_the_mend() {
    for (name, r#type, bits, text) in [
        ("BYTE", Type::UINT8, 0x7FC0_0000, "BYTE: firmware should declare it i32"),
        ("SMALL", Type::INT8, 0x7FC0_0000, "SMALL: firmware should declare it i32"),
        ("WIDE", Type::INT16, 0xAAAA_0001, "WIDE: firmware should declare it i32"),
        ("WORD", Type::UINT16, 0x3FC0_0000, "WORD: firmware should declare it i32"),
        ("BYTE", Type::UINT8, 0, "BYTE: out of range"),
        ("BYTE", Type::REAL32, 0x3FC0_0000, "BYTE: out of range"),
        ("ID_OF_16_LETTERS", Type::INT8, 0x7FC0_0000, "ID_OF_16_LETTERS: out of range"),
        ("ID_OF_16_LETTERS", Type::INT32, 0x7FC0_0000, "ID_OF_16_LETTERS: out of range"),
    ] {
        let mut bench = Bench::new();
        bench.ask(A, &set(name, r#type, bits));
        assert_eq!(bench.texts(0), [text], "{name} {type:?} {bits:#x}");
    }
}

/// One PARAM_SET must not set every vehicle in reach.
#[test]
fn a_broadcast_sets_nothing() {
    let mut bench = Bench::new();
    let everywhere = ParamSet { target_system: 0, ..set("BYTE", Type::UINT8, 8) };
    assert_eq!(bench.send(A, &everywhere), Handled::OutOfPlace);
    assert_eq!(bench.drain(), [vec![], vec![]]);
    assert_eq!(bench.table.get(Table::BYTE), 7);
}

/// D-3: nothing is set without a slot for a refusal, because it is not known beforehand whether one is needed.
#[test]
fn a_set_that_cannot_be_answered_is_dropped() {
    let mut bench = Bench::new();
    for name in ["A", "B", "C", "D"] {
        bench.send(A, &read(-1, name));
    }
    assert_eq!(bench.send(A, &set("BYTE", Type::UINT8, 8)), Handled::NoRoom);
    assert_eq!(bench.table.get(Table::BYTE), 7);
    assert_eq!(bench.vehicle.asked, []);
    assert_eq!(bench.send(B, &set("BYTE", Type::UINT8, 8)), Handled::Yes);
    assert_eq!(bench.table.get(Table::BYTE), 8);
}

/// P-14, P-32: a MAVLink 1 client gets the old value and a text.
#[test]
#[cfg(feature = "plan-texts")]
fn mavlink_1_gets_the_value_and_a_text() {
    let mut bench: Bench = Bench::of(Version::V1);
    let old = bench.value(1);
    for _ in 0..6 {
        assert_eq!(bench.ask(A, &set("BYTE", Type::UINT8, 0)), [vec![old.clone()], vec![old.clone()]]);
    }
    assert_eq!(bench.texts(0), ["BYTE: out of range"]);
}

/// P-32: texts about refusals are rate-limited.
#[test]
#[cfg(feature = "plan-texts")]
fn a_flood_of_refusals_causes_few_texts() {
    let mut bench = Bench::new();
    for number in 0..300 {
        bench.ask(A, &set(&std::format!("NO_{number}"), Type::UINT8, 0));
        bench.wait(10);
    }
    assert_eq!(bench.texts(0), ["NO_0: no such parameter", "NO_100: no such parameter", "NO_200: no such parameter"]);
}

/// P-14: with casts, a client may send any supported type; a number that the parameter's type cannot hold is out of range.
#[test]
fn casts_ignore_the_type() {
    let full = |number: f32| number.to_bits();
    let mut bench = Bench::<true, false>::of(Version::V2);
    let values = bench.ask(A, &read(5, ""))[0].clone();
    assert_eq!(values, [Value(5, "SMALL".into(), Type::INT8, full(-1.0))]);
    for (name, r#type, number, outcome) in [
        ("SMALL", Type::REAL32, -3.0, Ok(0xFD)),
        ("WORD", Type::INT32, 65_535.0, Ok(65_535)),
        ("ALT_MIN", Type::UINT8, -2.5, Ok(full(-2.5))),
        ("SMALL", Type::INT8, 2.5, Err(OUT_OF_RANGE)),
        ("SMALL", Type::INT8, 256.0, Err(OUT_OF_RANGE)),
        ("WORD", Type::UINT16, -1.0, Err(OUT_OF_RANGE)),
        ("WORD", Type::UINT16, f32::NAN, Err(OUT_OF_RANGE)),
        ("WORD", Type(0), 5.0, Err(MavParamError::TYPE_UNSUPPORTED)),
        ("LOCKED", Type::REAL32, 5.0, Err(MavParamError::READ_ONLY)),
    ] {
        let index = Table::INFO.iter().position(|info| info.name() == name).expect("exists") as u16;
        let [to_a, to_b] = bench.ask(A, &set(name, r#type, full(number)));
        let value = bench.value(index);
        match outcome {
            Ok(bits) => assert_eq!((bench.bits(index), to_a), (bits, vec![value.clone()]), "{name} {number}"),
            Err(code) => assert_eq!(to_a, [error(code, -1, name), value.clone()], "{name} {number}"),
        }
        assert_eq!(to_b, [value]);
    }
}
