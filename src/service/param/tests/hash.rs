//! `_HASH_CHECK`.

use super::*;

/// The hash by a library (P-20): the CRC-32 of zip, with initial value 0 and no complement.
fn reference(bench: &mut Bench<false, true>) -> u32 {
    let mut crc = crc_any::CRCu32::create_crc(0xEDB8_8320, 32, 0, 0, true);
    for index in 0..COUNT {
        let (info, bits) = bench.table.table_mut().get(index).expect("exists");
        let size = match info.param_type() {
            MavParamType::UINT8 | MavParamType::INT8 => 1,
            MavParamType::UINT16 | MavParamType::INT16 => 2,
            _ => 4,
        };
        if info.name() != "NOISE" {
            crc.digest(info.name().as_bytes());
            crc.digest(&bits.to_le_bytes()[..size]);
        }
    }
    crc.get_crc()
}

fn hash(bits: u32) -> Out {
    Value(u16::MAX, "_HASH_CHECK".into(), MavParamType::UINT32, bits)
}

fn new() -> Bench<false, true> {
    Bench::of(Version::V2)
}

/// P-21: on the link of the request.
#[test]
fn the_hash_is_read_by_its_name() {
    let mut bench = new();
    for value in [3, 4, 4, 3] {
        bench.table.set(Table::BYTE, value);
        bench.poll();
        bench.drain();
        let expected = hash(reference(&mut bench));
        assert_eq!(bench.ask(B, &read(-1, "_HASH_CHECK")), [vec![], vec![expected]]);
    }
}

/// P-20: the hash includes every parameter that is not volatile.
#[test]
fn the_hash_includes_every_stored_value() {
    let mut bench = new();
    let mut seen = vec![reference(&mut bench)];
    bench.table.set(Table::NOISE, 0.75);
    bench.poll();
    bench.drain();
    assert_eq!(bench.ask(A, &read(-1, "_HASH_CHECK"))[0], [hash(seen[0])]);
    for (name, r#type, bits) in [
        ("ALT_MIN", MavParamType::REAL32, 0),
        ("BYTE", MavParamType::UINT8, 9),
        ("SMALL", MavParamType::INT8, 9),
        ("WIDE", MavParamType::INT16, 9),
    ] {
        bench.ask(A, &set(name, r#type, bits));
        let now = reference(&mut bench);
        assert!(!seen.contains(&now));
        seen.push(now);
        assert_eq!(bench.ask(A, &read(-1, "_HASH_CHECK"))[0], [hash(now)]);
    }
}

/// P-20: the list begins with the hash; a restarted list does not.
#[test]
fn a_list_begins_with_the_hash() {
    let mut bench = new();
    bench.send(A, &LIST);
    let sent: Vec<_> = bench.run(0, 40).into_iter().map(|(_, out)| out).collect();
    assert_eq!(sent[..2], [hash(reference(&mut bench)), bench.value(0)]);
    bench.send(A, &LIST);
    let sent: Vec<_> = bench.run(0, 1_000).into_iter().map(|(_, out)| out).collect();
    assert_eq!(sent, bench.values());
    bench.send(A, &LIST);
    assert_eq!(bench.run(0, 1_000).len(), usize::from(COUNT) + 1, "the list was over");
}

/// P-20: a list has the hash only if configured: clients take it for a parameter unless the autopilot is PX4.
#[test]
fn a_list_has_no_hash_by_default() {
    let mut bench = Bench::new();
    bench.send(A, &LIST);
    let sent: Vec<_> = bench.run(0, 1_000).into_iter().map(|(_, out)| out).collect();
    assert_eq!(sent, bench.values());
}

/// P-20: a client that has the values sets the hash, which ends the list on its link. If the hash were sent again, QGroundControl
/// would set it forever. Before the hash is computed, no value is right.
#[test]
fn setting_the_hash_ends_the_list() {
    for (before, rest) in [(0, usize::from(COUNT) + 1), (40, 0)] {
        let mut bench = new();
        bench.send(A, &LIST);
        bench.send(B, &LIST);
        bench.run(0, before);
        let bits = reference(&mut bench);
        assert_eq!(bench.send(A, &set("_HASH_CHECK", MavParamType::UINT32, bits)), Handled::Yes);
        assert_eq!(bench.run(0, 1_000).len(), rest);
        assert_eq!(bench.run(1, 1_000).len(), usize::from(COUNT) + 1);
    }
}

/// P-20: a wrong hash, or one of a client that has not requested the list or is not the only one that has, ends no list.
#[test]
fn a_list_ends_only_for_its_one_client() {
    let other = Peer { address: Address::new(253, 190), ..A };
    for (clients, sender, flips, is_ended) in [
        (&[A][..], A, 0, true),
        (&[A, A], A, 0, true),
        (&[A], A, 1, false),
        (&[A], A, 1 << 31, false),
        (&[A], other, 0, false),
        (&[A, other], A, 0, false),
        (&[A, other, A], A, 0, false),
        (&[other, A], A, 0, false),
    ] {
        let mut bench = new();
        bench.send(clients[0], &LIST);
        assert_eq!(bench.run(0, 40).len(), 4, "the hash and three values");
        for client in &clients[1..] {
            bench.send(*client, &LIST);
        }
        let bits = reference(&mut bench) ^ flips;
        assert_eq!(bench.send(sender, &set("_HASH_CHECK", MavParamType::UINT32, bits)), Handled::Yes);
        let values = if clients.len() == 1 { COUNT - 3 } else { COUNT };
        let rest = if is_ended { 0 } else { usize::from(values) };
        assert_eq!(bench.run(0, 1_000).len(), rest, "{clients:?}, {sender:?}, {flips:x}");
        // The next list has an owner again.
        bench.send(A, &LIST);
        bench.run(0, 40);
        bench.send(A, &set("_HASH_CHECK", MavParamType::UINT32, bits ^ flips));
        assert_eq!(bench.run(0, 1_000), []);
    }
}

/// P-20: after a change during the computation, the next hash is correct.
#[test]
fn a_change_during_the_computation_is_in_the_next_hash() {
    let mut bench = new();
    bench.send(A, &read(-1, "_HASH_CHECK"));
    assert_eq!(bench.next(0), None, "a few parameters at a time");
    bench.table.set(Table::BYTE, 9);
    bench.poll();
    let sent = bench.drain();
    assert!(sent[0].contains(&bench.value(1)));
    let expected = hash(reference(&mut bench));
    assert_eq!(bench.ask(A, &read(-1, "_HASH_CHECK"))[0], [expected]);
}

/// P-20: neither a link that takes nothing nor a client that is gone leaves old values in the next hash.
#[test]
fn the_hash_has_no_values_from_before_the_request() {
    for is_gone in [false, true] {
        let mut bench = new();
        bench.send(A, &read(-1, "_HASH_CHECK"));
        for _ in 0..COUNT {
            bench.poll();
        }
        if is_gone {
            bench.restart(0);
        }
        bench.table.set(Table::BYTE, 9);
        bench.poll();
        let expected = hash(reference(&mut bench));
        bench.send(B, &read(-1, "_HASH_CHECK"));
        assert!(bench.drain_link(1).contains(&expected));
        assert_eq!(bench.drain_link(0).contains(&expected), !is_gone);
    }
}

/// A cast would lose bits of the hash.
#[test]
fn casts_have_no_hash() {
    let mut bench = Bench::<true, true>::of(Version::V2);
    assert_eq!(bench.ask(A, &read(-1, "_HASH_CHECK"))[0], [error(DOES_NOT_EXIST, -1, "_HASH_CHECK")]);
    bench.send(A, &LIST);
    assert_eq!(bench.run(0, 1_000).len(), usize::from(COUNT));
    assert_eq!(
        bench.ask(A, &set("_HASH_CHECK", MavParamType::UINT32, 0))[0],
        [error(DOES_NOT_EXIST, -1, "_HASH_CHECK")]
    );
}
