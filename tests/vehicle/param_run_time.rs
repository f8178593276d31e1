//! Tables of parameters that are filled at run time: what can be added, and until when.

use super::param_places::*;
use crate::support::*;
use mavstack::dialect::*;
use mavstack::param::{ParamFault, ParamInfo, ParamTable, RuntimeTable};
use proptest::prelude::*;

type Table = RuntimeTable<ROOM>;

fn names<const N: usize>(table: &RuntimeTable<N>) -> Vec<&str> {
    table.info().iter().map(ParamInfo::name).collect()
}

/// P-1: a name has 1 to 16 printable ASCII bytes and is not that of the hash; the type is one that PARAM_VALUE can carry (P-3);
/// the default is within the range.
#[test]
fn what_is_no_parameter() {
    for name in ["", "A_NAME_OF_17_BYTES", "SCHRÄGE", "A B", "TAB\t", "_HASH_CHECK"] {
        assert_eq!(ParamInfo::new(name, 0u8, 0..=1), Err(ParamFault::Name), "{name:?}");
        assert_eq!(ParamInfo::from_bits(name.as_bytes(), MavParamType::UINT8, 0, [0, 1]), Err(ParamFault::Name));
    }
    for r#type in [MavParamType::UINT64, MavParamType::INT64, MavParamType::REAL64, MavParamType(0), MavParamType(11)] {
        assert_eq!(ParamInfo::from_bits(b"A", r#type, 0, [0, 1]), Err(ParamFault::Type), "{type:?}");
    }
    assert_eq!(ParamInfo::new("A", 3i8, -2..=2), Err(ParamFault::Default));
    assert_eq!(ParamInfo::from_bits(b"A", MavParamType::UINT8, 3, [4, 2]), Err(ParamFault::Default));
    for [default, min, max] in [[f32::NAN, -2.0, 2.0], [0.0, f32::NAN, 2.0], [0.0, -2.0, f32::INFINITY]] {
        assert_eq!(ParamInfo::new("A", default, min..=max), Err(ParamFault::Default));
    }
    let long = ParamInfo::new("ID_OF_16_LETTERS", 0u8, 0..=1).expect("valid");
    assert_eq!(ParamInfo::from_bits(b"ID_OF_16_LETTERS", MavParamType::UINT8, 0, [0, 1]), Ok(long));
    let short = ParamInfo::from_bits(b"AB\0rubbish of a C array", MavParamType::UINT8, 0, [0, 1]).expect("valid");
    assert_eq!(short.name(), "AB");
}

/// A declaration made at run time is that of `parameters!`.
#[test]
fn both_declarations_are_equal() {
    let made = [
        ParamInfo::new("ALT_MIN", -5.0f32, -100.0..=100.0),
        ParamInfo::new("BYTE", 7u8, 1..=200),
        ParamInfo::new("ID_OF_16_LETTERS", -2i32, -1_000..=1_000_000_000).map(ParamInfo::reboot_required),
        ParamInfo::new("LOCKED", 4_000_000_000u32, 0..=u32::MAX).map(ParamInfo::read_only),
        ParamInfo::new("NOISE", 0.5f32, 0.0..=1.0).map(ParamInfo::volatile),
        ParamInfo::new("SMALL", -1i8, -10..=10),
        ParamInfo::new("WIDE", -300i16, -1_000..=1_000),
        ParamInfo::new("WORD", 60_000u16, 0..=u16::MAX),
    ];
    assert_eq!(made.map(|info| info.expect("valid")), Fixed::INFO);
}

/// P-1: each name once, and no more parameters than there is room for. What cannot be added changes nothing.
#[test]
fn what_cannot_be_added() {
    let mut table = RuntimeTable::<2>::new();
    let info = |name: &str, value| ParamInfo::new(name, value, 0u8..=9).expect("valid");
    assert_eq!(table.add(info("B", 1)), Ok(()));
    assert_eq!(table.add(info("B", 2)), Err(ParamFault::Taken));
    assert_eq!(table.add(info("A", 3)), Ok(()));
    assert_eq!(table.add(info("C", 4)), Err(ParamFault::NoRoom));
    assert_eq!(table.add(info("A", 5)), Err(ParamFault::Taken));
    assert_eq!((names(&table), [0, 1, 2].map(|index| table.bits(index))), (vec!["A", "B"], [Some(3), Some(1), None]));
    // A name and its type.
    assert!(table.param::<i8>("A").is_none() && table.param::<u8>("C").is_none());
    let b = table.param::<u8>("B").expect("added");
    assert!(table.set(b, 9) && !table.set(b, 10));
    assert_eq!((b.index(), table.get(b)), (1, 9));
    assert!(table.set_bits(0, 0) && !table.set_bits(0, 10) && !table.set_bits(2, 0));
    assert_eq!(table.add(info("A", 5)), Err(ParamFault::Sealed));
    for fault in [ParamFault::Taken, ParamFault::NoRoom, ParamFault::Sealed] {
        assert!(!fault.to_string().is_empty());
    }
}

/// P-1: from the first poll, the first frame or the first look for an index, the table stays as it is. A list that has begun
/// never gets another length.
#[test]
fn a_table_in_use_is_sealed() {
    let late = || ParamInfo::new("AAA", 0u8, 0..=1).expect("valid");
    type Act = fn(&mut Place<Table>);
    let acts: [(Act, bool); 4] = [
        (|world| world.step(), true),
        (
            |world| {
                let frame = world.gcs[0].frame_from(STATION, &LIST);
                let now = world.now();
                world.stack.receive(now, mavstack::LinkId(0), &frame, &mut world.vehicle);
            },
            true,
        ),
        (|world| assert!(world.stack.parameters_mut().param::<u8>("BYTE").is_some()), true),
        (|world| assert_eq!(world.stack.parameters().info().len(), COUNT), false),
    ];
    for (number, (act, seals)) in acts.into_iter().enumerate() {
        let mut world = Table::world::<false>(Setup::new());
        act(&mut world);
        let expected = if seals { Err(ParamFault::Sealed) } else { Ok(()) };
        assert_eq!(world.stack.parameters_mut().add(late()), expected, "{number}");
        world.gcs[0].send(&LIST);
        world.run_for(secs(1));
        assert_eq!(world.stack.parameters_mut().add(late()), Err(ParamFault::Sealed));
        let count = COUNT + usize::from(!seals);
        let listed = values(&mut world, 0);
        let indices: std::collections::BTreeSet<_> = listed.iter().map(|value| value.0).collect();
        assert_eq!(indices.len(), count);
        assert!(listed.iter().all(|value| usize::from(value.1) == count));
    }
}

/// P-18: without parameters, a list is not answered, and no link waits for one.
#[test]
fn an_empty_table_has_no_list() {
    let mut world: Place<Table> = World::of(Setup::new());
    world.gcs[0].send(&LIST);
    world.run_for(millis(200));
    assert_eq!(values(&mut world, 0), []);
    let now = world.now();
    assert!(world.stack.next_deadline(now) > now);
    let error = (MavParamError::DOES_NOT_EXIST, 0, String::new());
    assert_eq!(ask(&mut world, &read(0, "")), (vec![error], [vec![], vec![]]));
}

proptest! {
    /// P-1, P-20: in whatever order they are added, parameters are in the order of their names, each with its default.
    #[test]
    fn parameters_are_sorted(names in prop::collection::vec("[A-C_]{1,4}", 0..24)) {
        let mut table = RuntimeTable::<16>::new();
        let mut known = std::collections::BTreeMap::new();
        for (number, name) in names.into_iter().enumerate() {
            let info = ParamInfo::new(&name, number as u16, 0..=u16::MAX).expect("valid");
            let expected = match () {
                () if known.contains_key(&name) => Err(ParamFault::Taken),
                () if known.len() == 16 => Err(ParamFault::NoRoom),
                () => Ok(()),
            };
            prop_assert_eq!(table.add(info), expected);
            if expected.is_ok() {
                known.insert(name, number as u32);
            }
        }
        for (index, (name, value)) in known.iter().enumerate() {
            prop_assert_eq!(table.info()[index].name(), name);
            prop_assert_eq!(table.bits(index as u16), Some(*value));
            prop_assert_eq!(table.param::<u16>(name).map(|param| param.index()), Some(index as u16));
        }
        prop_assert_eq!(table.info().len(), known.len());
    }
}

#[cfg(feature = "storage")]
mod stored {
    use super::*;
    use crate::support::flash::RamFlash;
    use mavstack::storage::Store;

    type Flash = RamFlash<8, 512>;
    const REGION: u32 = Store::<Flash>::region_len::<Declared<Table, false>>();

    /// Runs until everything is stored.
    fn run(world: &mut Place<Table>, store: &mut Store<&mut Flash>) {
        for _ in 0..1_000 {
            world.step();
            world.stack.persist(world.now(), store, &mut world.vehicle);
        }
    }

    /// P-17: what was set is there after a restart, also if another firmware adds other parameters, in another order; and a
    /// table is sealed by reading it.
    #[test]
    fn values_survive_a_restart() {
        let mut flash = Flash::new(REGION);
        let mut store = Store::new(&mut flash, 0..REGION);
        let mut world = Table::world::<false>(Setup::new());
        world.stack.restore(world.now(), &mut store, &mut world.vehicle).expect("readable");
        ask(&mut world, &set("BYTE", MavParamType::UINT8, f32::from_bits(9)));
        ask(&mut world, &set("WIDE", MavParamType::INT16, f32::from_bits(44)));
        assert_eq!(storage(&mut world, 1.0), MavResult::ACCEPTED);
        run(&mut world, &mut store);

        let mut later: Place<Table> = World::of(Setup::new());
        for info in [
            ParamInfo::new("ZOOM", 1u8, 0..=9),
            ParamInfo::new("WIDE", 0i16, -5..=5),
            ParamInfo::new("BYTE", 1u8, 0..=255),
        ] {
            later.stack.parameters_mut().add(info.expect("valid")).expect("new");
        }
        later.stack.restore(later.now(), &mut store, &mut later.vehicle).expect("readable");
        let bits = |index| later.stack.parameters().bits(index);
        assert_eq!([bits(0), bits(1), bits(2)], [Some(9), Some(0), Some(1)], "44 is out of range now");
        assert_eq!(later.vehicle.changed, [(0, 9)]);
        let late = ParamInfo::new("A", 0u8, 0..=1).expect("valid");
        assert_eq!(later.stack.parameters_mut().add(late), Err(ParamFault::Sealed));
    }

    /// P-17, C-15: PREFLIGHT_STORAGE 0 reads the stored values again, unless a value is not stored yet: that is written at once.
    #[test]
    fn values_are_read_again() {
        let mut flash = Flash::new(REGION);
        let mut store = Store::new(&mut flash, 0..REGION);
        let mut world = Table::world::<false>(Setup::new());
        world.stack.restore(world.now(), &mut store, &mut world.vehicle).expect("readable");
        ask(&mut world, &set("BYTE", MavParamType::UINT8, f32::from_bits(9)));
        assert_eq!(storage(&mut world, 1.0), MavResult::ACCEPTED);
        run(&mut world, &mut store);
        ask(&mut world, &set("BYTE", MavParamType::UINT8, f32::from_bits(50)));
        assert_eq!(storage(&mut world, 0.0), MavResult::TEMPORARILY_REJECTED);
        run(&mut world, &mut store);
        assert_eq!(storage(&mut world, 0.0), MavResult::ACCEPTED);
        run(&mut world, &mut store);
        assert_eq!(world.stack.parameters().bits(1), Some(50));
    }
}
