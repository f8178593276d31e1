//! PARAM_REQUEST_READ, and what the vehicle says by itself.

use super::*;

/// T-P2, P-13: by index, whatever the name; by name with a negative index; and a name of 16 bytes, without a NUL.
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

/// P-1: what stands behind the NUL of a name is no part of it.
#[test]
fn what_stands_behind_a_name_does_not_count() {
    let mut bench = Bench::new();
    let param_id = Text::from_wire(*b"BYTE\0rubbish\xFF\0ab");
    let value = bench.value(1);
    assert_eq!(bench.ask(A, &ParamRequestRead { param_id, ..read(-1, "") }), [vec![value], vec![]]);
}

/// P-13, P-30: with the index and the name as they came, to who asked and to nobody else.
#[test]
fn what_does_not_exist_is_refused() {
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
    assert_eq!(bench.texts(0), [""; 0], "who reads knows PARAM_ERROR, or asks again");
}

/// P-12: no read of an existing parameter is dropped, however many there are, and each is answered once.
#[test]
fn reads_need_no_room() {
    let mut bench = Bench::new();
    for _ in 0..3 {
        for index in (0..COUNT).rev() {
            assert_eq!(bench.send(A, &read(index as i16, "")), Taken::Yes);
        }
    }
    let values = bench.values();
    assert_eq!(bench.drain(), [values, vec![]]);
}

/// P-12: who asks for the first ones all the time does not keep the others from their turn.
#[test]
fn each_value_has_its_turn() {
    let mut bench = Bench::new();
    bench.send(A, &read(6, ""));
    let mut sent = Vec::new();
    for _ in 0..4 {
        bench.send(A, &read(0, ""));
        bench.send(A, &read(1, ""));
        sent.push(bench.next(0).expect("owed"));
    }
    assert!(sent.contains(&bench.value(6)), "{sent:?}");
}

/// D-3: a refusal that would have no room is not taken.
#[test]
fn refusals_are_bounded() {
    let mut bench = Bench::new();
    for name in ["A", "B", "C", "D"] {
        assert_eq!(bench.send(A, &read(-1, name)), Taken::Yes);
    }
    assert_eq!(bench.send(A, &read(-1, "E")), Taken::NoRoom);
    let sent = ["A", "B", "C", "D"].map(|name| error(DOES_NOT_EXIST, -1, name));
    assert_eq!(bench.drain(), [sent.to_vec(), vec![]]);
}

/// A link that stalls with all the room for refusals keeps no other one from its own.
#[test]
fn a_link_that_stalls_leaves_room() {
    let mut bench = Bench::new();
    for name in ["A", "B", "C", "D"] {
        assert_eq!(bench.send(A, &read(-1, name)), Taken::Yes);
    }
    for name in ["E", "F"] {
        assert_eq!(bench.send(B, &read(-1, name)), Taken::Yes);
        assert_eq!(bench.send(B, &read(-1, "G")), Taken::NoRoom);
        assert_eq!(bench.drain_link(1), [Error(B.address, DOES_NOT_EXIST, -1, name.into())]);
    }
    // One of its own it has lost: it was a lost frame to who asked.
    let sent = ["A", "B", "C"].map(|name| error(DOES_NOT_EXIST, -1, name));
    assert_eq!(bench.drain_link(0), sent);
}

/// Where nobody is any more who asked, nothing is answered; elsewhere it is.
#[test]
fn a_line_that_was_opened_anew_owes_no_refusal() {
    let mut bench: Bench<false, true> = Bench::of(Version::V2);
    for from in [A, B] {
        bench.send(from, &read(-1, "X"));
        bench.send(from, &read(-1, "_HASH_CHECK"));
        bench.send(from, &LIST);
    }
    bench.params.restart(LinkId(0), &mut bench.lists[0]);
    assert_eq!(bench.lists[0].due(), Instant::NEVER);
    let sent = bench.drain();
    assert_eq!((sent[0].len(), sent[1].len()), (0, 2));
    // A new client is answered.
    bench.send(A, &read(-1, "Y"));
    assert_eq!(bench.drain(), [vec![error(DOES_NOT_EXIST, -1, "Y")], vec![]]);
}

/// P-30: a vehicle may do without PARAM_ERROR; then a text says it, of reading too.
#[test]
fn errors_can_be_switched_off() {
    let mut bench: Bench<false, false, false> = Bench::of(Version::V2);
    for _ in 0..9 {
        assert_eq!(bench.ask(A, &read(-1, "NOTHING")), [vec![], vec![]]);
        let value = bench.value(1);
        assert_eq!(bench.ask(A, &set("BYTE", MavParamType::UINT8, 201)), [vec![value.clone()], vec![value]]);
    }
    assert_eq!(bench.vehicle.table.get(Table::BYTE), 7);
    if cfg!(feature = "plan-texts") {
        assert_eq!(bench.texts(0), ["NOTHING: no such parameter"]);
        bench.wait(1_000);
        bench.send(A, &set("BYTE", MavParamType::UINT8, 201));
        assert_eq!(bench.texts(0), ["BYTE: out of range"]);
    }
}

/// P-31, P-32: MAVLink 1 has no PARAM_ERROR, so a text stands for it.
#[test]
#[cfg(feature = "plan-texts")]
fn mavlink_1_gets_a_text() {
    let mut bench: Bench = Bench::of(Version::V1);
    assert_eq!(bench.ask(A, &read(-1, "NOTHING")), [vec![], vec![]]);
    assert_eq!(bench.texts(0), ["NOTHING: no such parameter"]);
    let value = bench.value(3);
    assert_eq!(bench.ask(A, &read(3, "")), [vec![value], vec![]]);
}

/// P-16: what the vehicle sets goes to everybody, with its true index, and needs nobody's permission.
#[test]
fn what_the_vehicle_sets_is_told_on_every_link() {
    let mut bench = Bench::new();
    assert!(bench.vehicle.table.set(Table::LOCKED, 17), "read-only for others");
    assert!(bench.vehicle.table.set(Table::SMALL, -10));
    assert!(bench.vehicle.table.set(Table::BYTE, 7), "as it was");
    for refused in [
        bench.vehicle.table.set(Table::SMALL, 11),
        bench.vehicle.table.set(Table::NOISE, f32::NAN),
        bench.vehicle.table.set(Table::ALT_MIN, f32::NEG_INFINITY),
    ] {
        assert!(!refused);
    }
    bench.poll();
    let values = vec![bench.value(3), bench.value(5)];
    assert_eq!(bench.drain(), [values.clone(), values]);
    assert_eq!(bench.vehicle.table.get(Table::SMALL), -10);
    assert_eq!((bench.vehicle.asked.len(), bench.vehicle.changed.len()), (0, 0));
    bench.poll();
    assert_eq!(bench.drain(), [vec![], vec![]]);
}
