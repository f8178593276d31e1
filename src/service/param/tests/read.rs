//! PARAM_REQUEST_READ, and values that the vehicle sets.

use super::*;

/// P-13: a read by index ignores the name; a negative index means a read by name; a name may have 16 bytes, without a NUL.
#[test]
fn a_value_is_read_by_index_or_name() {
    let mut bench = Bench::new();
    for (request, index) in [
        (read(0, ""), 0),
        (read(5, "BYTE"), 5),
        (read(7, "no such thing"), 7),
        (read(-1, "ID_OF_16_LETTERS"), 2),
        (read(-2, "WORD"), 7),
        (read(i16::MIN, "ALT_MIN"), 0),
    ] {
        let value = bench.value(index);
        assert_eq!(bench.ask(A, &request), [vec![value], vec![]], "{request:?}");
    }
    assert_eq!(bench.texts(0), [""; 0]);
}

/// P-1: bytes after the NUL are not part of a name.
#[test]
fn bytes_after_a_name_are_ignored() {
    let mut bench = Bench::new();
    let param_id = Text::from_wire(*b"BYTE\0rubbish\xFF\0ab");
    let value = bench.value(1);
    assert_eq!(bench.ask(A, &ParamRequestRead { param_id, ..read(-1, "") }), [vec![value], vec![]]);
}

/// P-13, P-30: the refusal has the index and the name of the request, and is sent to its sender only.
#[test]
fn unknown_parameters_are_refused() {
    let mut bench = Bench::new();
    for (request, index, name) in [
        (read(8, "WORD"), 8, "WORD"),
        (read(i16::MAX, ""), i16::MAX, ""),
        (read(-1, "word"), -1, "word"),
        (read(-1, ""), -1, ""),
        (read(-7, "BYTES"), -1, "BYTES"),
        (read(-1, "BYT"), -1, "BYT"),
        (read(-1, "ID_OF_16_LETTER"), -1, "ID_OF_16_LETTER"),
        (read(-1, "ZZZZZZZZZZZZZZZZ"), -1, "ZZZZZZZZZZZZZZZZ"),
    ] {
        assert_eq!(bench.ask(A, &request), [vec![error(DOES_NOT_EXIST, index, name)], vec![]], "{request:?}");
    }
    assert_eq!(bench.texts(0), [""; 0], "no text about a refused read");
}

/// P-12: no read of an existing parameter is dropped, however many there are, and each is answered once.
#[test]
fn reads_need_no_slots() {
    let mut bench = Bench::new();
    for _ in 0..3 {
        for index in (0..COUNT).rev() {
            assert_eq!(bench.send(A, &read(index as i16, "")), Handled::Yes);
        }
    }
    let values = bench.values();
    assert_eq!(bench.drain(), [values, vec![]]);
}

/// P-12: repeated reads of the first values do not starve the others.
#[test]
fn each_value_has_its_turn() {
    let mut bench = Bench::new();
    bench.send(A, &read(6, ""));
    let mut sent = Vec::new();
    for _ in 0..4 {
        bench.send(A, &read(0, ""));
        bench.send(A, &read(1, ""));
        sent.push(bench.next(0).expect("pending"));
    }
    assert!(sent.contains(&bench.value(6)), "{sent:?}");
}

/// D-3: without a slot for the refusal, a request is dropped.
#[test]
fn refusals_are_bounded() {
    let mut bench = Bench::new();
    for name in ["A", "B", "C", "D"] {
        assert_eq!(bench.send(A, &read(-1, name)), Handled::Yes);
    }
    assert_eq!(bench.send(A, &read(-1, "E")), Handled::NoRoom);
    let sent = ["A", "B", "C", "D"].map(|name| error(DOES_NOT_EXIST, -1, name));
    assert_eq!(bench.drain(), [sent.to_vec(), vec![]]);
}

/// A stalled link that has all slots for refusals does not block other links.
#[test]
fn a_stalled_link_leaves_a_slot() {
    let mut bench = Bench::new();
    for name in ["A", "B", "C", "D"] {
        assert_eq!(bench.send(A, &read(-1, name)), Handled::Yes);
    }
    for name in ["E", "F"] {
        assert_eq!(bench.send(B, &read(-1, name)), Handled::Yes);
        assert_eq!(bench.send(B, &read(-1, "G")), Handled::NoRoom);
        assert_eq!(bench.drain_link(1), [Error(B.address, DOES_NOT_EXIST, -1, name.into())]);
    }
    // One of its own refusals was evicted; to its client it looks like a lost frame.
    let sent = ["A", "B", "C"].map(|name| error(DOES_NOT_EXIST, -1, name));
    assert_eq!(bench.drain_link(0), sent);
}

/// A reopened link drops its refusals; those of other links stay.
#[test]
fn a_reopened_link_has_no_refusals() {
    let mut bench: Bench<false, true> = Bench::of(Version::V2);
    for from in [A, B] {
        bench.send(from, &read(-1, "X"));
        bench.send(from, &read(-1, "_HASH_CHECK"));
        bench.send(from, &LIST);
    }
    bench.restart(0);
    assert_eq!(bench.lists[0].due(), Instant::NEVER);
    let sent = bench.drain();
    assert_eq!((sent[0].len(), sent[1].len()), (0, 2));
    // A new client is answered.
    bench.send(A, &read(-1, "Y"));
    assert_eq!(bench.drain(), [vec![error(DOES_NOT_EXIST, -1, "Y")], vec![]]);
}

/// P-30: without PARAM_ERROR, a text reports refusals, including refused reads.
#[test]
fn errors_can_be_switched_off() {
    let mut bench: Bench<false, false, false> = Bench::of(Version::V2);
    for _ in 0..9 {
        assert_eq!(bench.ask(A, &read(-1, "NOTHING")), [vec![], vec![]]);
        let value = bench.value(1);
        assert_eq!(bench.ask(A, &set("BYTE", MavParamType::UINT8, 201)), [vec![value.clone()], vec![value]]);
    }
    assert_eq!(bench.table.get(Table::BYTE), 7);
    if cfg!(feature = "plan-texts") {
        assert_eq!(bench.texts(0), ["NOTHING: no such parameter"]);
        bench.wait(1_000);
        bench.send(A, &set("BYTE", MavParamType::UINT8, 201));
        assert_eq!(bench.texts(0), ["BYTE: out of range"]);
    }
}

/// P-31, P-32: MAVLink 1 has no PARAM_ERROR; a text replaces it.
#[test]
#[cfg(feature = "plan-texts")]
fn mavlink_1_gets_a_text() {
    let mut bench: Bench = Bench::of(Version::V1);
    assert_eq!(bench.ask(A, &read(-1, "NOTHING")), [vec![], vec![]]);
    assert_eq!(bench.texts(0), ["NOTHING: no such parameter"]);
    let value = bench.value(3);
    assert_eq!(bench.ask(A, &read(3, "")), [vec![value], vec![]]);
}

/// P-16: values set by the vehicle are sent on all links, with their index, and need no permission.
#[test]
fn values_set_by_the_vehicle_are_sent_on_every_link() {
    let mut bench = Bench::new();
    assert!(bench.table.set(Table::LOCKED, 17), "read-only for clients");
    assert!(bench.table.set(Table::SMALL, -10));
    assert!(bench.table.set(Table::BYTE, 7), "unchanged");
    for refused in [
        bench.table.set(Table::SMALL, 11),
        bench.table.set(Table::NOISE, f32::NAN),
        bench.table.set(Table::ALT_MIN, f32::NEG_INFINITY),
    ] {
        assert!(!refused);
    }
    bench.poll();
    let values = vec![bench.value(3), bench.value(5)];
    assert_eq!(bench.drain(), [values.clone(), values]);
    assert_eq!(bench.table.get(Table::SMALL), -10);
    assert_eq!((bench.vehicle.asked.len(), bench.vehicle.changed.len()), (0, 0));
    bench.poll();
    assert_eq!(bench.drain(), [vec![], vec![]]);
}
