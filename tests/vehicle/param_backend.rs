//! Parameters that live elsewhere: what the backend is asked, and how often.

use super::param_places::*;
use crate::support::*;
use mavstack::dialect::*;
use mavstack::param::{ExternalParams, ParamFault, ParamInfo, ParamUpdate};
use mavstack::{LinkConfig, LinkId, ParamBackend};

type Sorted = ExternalParams<ROOM>;
type Shuffled = ExternalParams<UNSORTED>;

fn world() -> Place<Sorted> {
    Sorted::world(Setup::new())
}

fn byte(value: u32) -> ParamSet {
    set("BYTE", MavParamType::UINT8, f32::from_bits(value))
}

/// The values of all parameters, in order.
fn all(world: &Place<Sorted>) -> Vec<Seen> {
    (0..COUNT).map(|index| shown::<Sorted>(index, world.vehicle.backend.values[index])).collect()
}

/// P-17: PREFLIGHT_STORAGE is passed on, and its result is the answer. What is no action is not.
#[test]
fn storage_is_the_backends() {
    let mut world = world();
    for (action, hook) in [(0.0, "load"), (1.0, "save"), (2.0, "reset"), (4.0, "reset all")] {
        for result in [MavResult::ACCEPTED, MavResult::FAILED, MavResult::DENIED] {
            world.vehicle.backend.result = result;
            assert_eq!(storage(&mut world, action), result);
            assert_eq!(core::mem::take(&mut world.vehicle.backend.actions), [hook]);
        }
        world.vehicle.is_armed = true;
        assert_eq!(storage(&mut world, action), MavResult::TEMPORARILY_REJECTED);
        world.vehicle.is_armed = false;
    }
    assert_eq!(storage(&mut world, 3.0), MavResult::DENIED);
    assert_eq!(storage(&mut world, -1.0), MavResult::ACCEPTED);
    assert_eq!(world.vehicle.backend.actions, [""; 0]);
}

/// P-17, P-16: after a load and a reset, every link gets all values; after one that failed, and after a save, nothing.
#[test]
fn loaded_values_are_announced() {
    let mut world = world();
    ask(&mut world, &byte(9));
    for (action, result, is_announced) in [
        (1.0, MavResult::ACCEPTED, false),
        (0.0, MavResult::FAILED, false),
        (0.0, MavResult::ACCEPTED, true),
        (2.0, MavResult::ACCEPTED, true),
        (2.0, MavResult::FAILED, false),
    ] {
        world.vehicle.backend.result = result;
        assert_eq!(storage(&mut world, action), result);
        world.run_for(secs(1));
        for link in 0..2 {
            let expected = if is_announced { all(&world) } else { vec![] };
            assert_eq!(values(&mut world, link), expected, "{action} {result:?}");
        }
    }
}

/// C-15: a flood of saves writes 128 times, then once in 15 minutes. Reading again takes no token, but waits for one: what the backend has
/// acknowledged may be unsaved.
#[test]
fn saves_are_limited() {
    let mut world = world();
    let mut accepted = 0;
    for _ in 0..200 {
        let result = storage(&mut world, 1.0);
        assert!(matches!(result, MavResult::ACCEPTED | MavResult::TEMPORARILY_REJECTED));
        accepted += usize::from(result == MavResult::ACCEPTED);
    }
    assert_eq!((accepted, world.vehicle.backend.actions.len()), (128, 128));
    assert_eq!(storage(&mut world, 2.0), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(storage(&mut world, 0.0), MavResult::TEMPORARILY_REJECTED);
    let later = world.now() + secs(901);
    world.step_to(later);
    assert_eq!(storage(&mut world, 0.0), MavResult::ACCEPTED);
    assert_eq!(storage(&mut world, 1.0), MavResult::ACCEPTED);
    assert_eq!(storage(&mut world, 1.0), MavResult::TEMPORARILY_REJECTED);
}

/// P-16, P-11: if anything may have changed, each link gets all values at the pace of a list. A list that is being sent ends
/// first, however often that happens, and nothing is sent without end.
#[test]
fn all_values_are_sent_at_the_pace_of_a_list() {
    let mut world: Place<Sorted> = Sorted::world(Setup { links: [LinkConfig::uart(57_600); 2], ..Setup::new() });
    world.run_for(millis(10));
    world.vehicle.backend.values[1] = 33;
    world.vehicle.backend.updates.push_back(ParamUpdate::All);
    world.run_for(secs(1));
    for link in 0..2 {
        let times: Vec<_> = world.gcs[link].all::<ParamValue>().into_iter().map(|(at, _)| at).collect();
        assert!(times.windows(2).all(|pair| pair[1] - pair[0] >= millis(15)), "{times:?}");
        assert_eq!(values(&mut world, link), all(&world));
    }
    let now = world.now();
    assert!(world.stack.next_deadline(now) > now, "nothing is pending");

    world.gcs[0].send(&LIST);
    world.run_for(millis(5));
    for _ in 0..100 {
        world.vehicle.backend.updates.push_back(ParamUpdate::All);
        world.run_for(millis(1));
    }
    world.run_for(secs(2));
    let indices: Vec<_> = values(&mut world, 0).into_iter().map(|value| value.0).collect();
    let twice: Vec<_> = (0..2).flat_map(|_| 0..COUNT as u16).collect();
    assert_eq!(indices, twice, "the list, and then all values once");
}

/// P-1: the number of parameters is that of the first poll, and at most that for which there is room.
#[test]
fn the_number_of_parameters_stays() {
    let mut world = world();
    world.run_for(millis(10));
    let more = ParamInfo::new("ZZZ", 0u8, 0..=1).expect("valid");
    world.vehicle.backend.info.push(more);
    world.vehicle.backend.values.push(0);
    world.vehicle.backend.updates.push_back(ParamUpdate::One(COUNT as u16));
    let error = (MavParamError::DOES_NOT_EXIST, -1, "ZZZ".to_owned());
    assert_eq!(ask(&mut world, &read(-1, "ZZZ")), (vec![error], [vec![], vec![]]));
    world.gcs[0].send(&LIST);
    world.run_for(secs(1));
    assert_eq!(values(&mut world, 0), all(&world));

    let mut world = self::world();
    let names = (0..20).map(|number| format!("P{number:02}"));
    let info = names.map(|name| ParamInfo::new(&name, 0u8, 0..=1).expect("valid")).collect();
    world.vehicle.backend = Backend::new(info);
    assert_eq!(world.vehicle.check_params(ROOM), Err(ParamFault::NoRoom));
    world.gcs[0].send(&LIST);
    world.run_for(secs(1));
    let listed = values(&mut world, 0);
    assert_eq!((listed.len(), usize::from(listed[0].1)), (ROOM, ROOM));
}

/// D-3: a backend that loses a parameter, or reports one that never was, keeps nothing else from being answered.
#[test]
fn a_lost_parameter_blocks_nothing() {
    let mut world = world();
    world.run_for(millis(10));
    for index in [3, COUNT as u16, u16::MAX] {
        world.vehicle.backend.updates.push_back(ParamUpdate::One(index));
    }
    world.vehicle.backend.info.truncate(3);
    world.run_for(millis(50));
    assert_eq!(values(&mut world, 0), []);
    let now = world.now();
    assert!(world.stack.next_deadline(now) > now, "nothing is pending");
    let value = shown::<Sorted>(2, world.vehicle.backend.values[2]);
    assert_eq!(ask(&mut world, &read(2, "")), (vec![], [vec![value], vec![]]));
    world.gcs[0].send(&LIST);
    world.run_for(secs(1));
    assert_eq!(values(&mut world, 0).len(), 3);
    assert_eq!(world.vehicle.check_params(ROOM), Ok(()));
}

/// P-14, P-15: the answer has the value that the backend has really set.
#[test]
fn the_answer_is_the_actual_value() {
    let mut world = world();
    world.vehicle.backend.rounds = |bits| bits / 10 * 10;
    let value = vec![shown::<Sorted>(1, 20)];
    assert_eq!(ask(&mut world, &byte(29)), (vec![], [value.clone(), value]));
}

/// SEC-2: a frame causes one search for a name: a binary one, or one through all names, and a few more declarations.
#[test]
fn a_frame_causes_one_search() {
    fn cost<const N: usize>(names: impl Iterator<Item = String>, name: &str) -> usize
    where
        ExternalParams<N>: Kind<Service: mavstack::__private::Persistent<Declared<ExternalParams<N>, false>>>,
    {
        let mut world: Place<ExternalParams<N>> = World::of(Setup::new());
        let info = names.map(|name| ParamInfo::new(&name, 0u8, 0..=9).expect("valid")).collect();
        world.vehicle.backend = Backend::new(info);
        world.run_for(millis(10));
        let frame = world.gcs[0].frame_from(STATION, &set(name, MavParamType::UINT8, f32::from_bits(10)));
        world.vehicle.backend.lookups.set(0);
        let now = world.now();
        world.stack.receive(now, LinkId(0), &frame, &mut world.vehicle);
        world.vehicle.backend.lookups.get()
    }
    let names = || (0..2_000).map(|number| format!("P{number:04}"));
    for name in ["P0000", "P0999", "P1999", "NOTHING", "ZZZ"] {
        assert!(cost::<2_000>(names(), name) <= 13, "{name}");
    }
    let few = || (0..COUNT).map(|number| format!("P{}", COUNT - number));
    for name in ["P8", "P1", "NOTHING"] {
        assert!(cost::<UNSORTED>(few(), name) <= COUNT + 2, "{name}");
    }
}

/// P-20: unsorted names have no hash, because a ground station computes it in the order of the names.
#[test]
fn unsorted_names_have_no_hash() {
    let mut world = Shuffled::world::<false>(Setup::new());
    let error = (MavParamError::DOES_NOT_EXIST, -1, "_HASH_CHECK".to_owned());
    assert_eq!(ask(&mut world, &read(-1, "_HASH_CHECK")), (vec![error], [vec![], vec![]]));
}

/// P-1: what the stack takes for granted can be checked.
#[test]
fn a_backend_is_checked() {
    let check = |change: fn(&mut Backend)| {
        let mut world = world();
        change(&mut world.vehicle.backend);
        world.vehicle.check_params(ROOM)
    };
    assert_eq!(check(|_| {}), Ok(()));
    let swap = |backend: &mut Backend| {
        backend.info.swap(0, 1);
        backend.values.swap(0, 1);
    };
    assert_eq!(check(swap), Err(ParamFault::Order));
    let copy = |backend: &mut Backend| {
        backend.info[1] = backend.info[0];
        backend.values[1] = backend.values[0];
    };
    assert_eq!(check(copy), Err(ParamFault::Taken));
    assert_eq!(check(|backend| backend.values[1] = 0), Err(ParamFault::Missing));
    assert_eq!(check(|backend| backend.values.truncate(3)), Err(ParamFault::Missing));
    assert_eq!(world().vehicle.check_params(COUNT - 1), Err(ParamFault::NoRoom));
    let mut unsorted = Shuffled::world::<false>(Setup::new());
    assert_eq!(unsorted.vehicle.check_params(UNSORTED), Ok(()));
    unsorted.vehicle.backend.info[5] = unsorted.vehicle.backend.info[2];
    unsorted.vehicle.backend.values[5] = unsorted.vehicle.backend.values[2];
    assert_eq!(unsorted.vehicle.check_params(UNSORTED), Err(ParamFault::Taken));
}

/// A reopened link starts again: it sends no list that was announced to the previous peers.
#[test]
fn a_reopened_link_has_nothing_pending() {
    let mut world = world();
    world.run_for(secs(1));
    world.uarts[0].stall_writes_until(world.now() + secs(60));
    world.vehicle.backend.updates.push_back(ParamUpdate::All);
    world.run_for(millis(20));
    world.stack.restart_link(LinkId(0));
    world.uarts[0].stall_writes_until(world.now());
    world.run_for(secs(2));
    assert!(values(&mut world, 0).len() <= 1, "at most the frame that was under way");
    assert_eq!(values(&mut world, 1), all(&world));
}

/// The stack stores none of it.
#[cfg(feature = "storage")]
#[test]
fn nothing_is_stored() {
    use crate::support::flash::RamFlash;
    use mavstack::storage::Store;

    type Flash = RamFlash<8, 512>;
    const LEN: u32 = Store::<Flash>::region_len::<Declared<Sorted, false>>();
    assert_eq!(LEN, 0);
    let mut flash = Flash::new(512);
    let mut store = Store::new(&mut flash, 0..0);
    let mut world = world();
    world.stack.restore(world.now(), &mut store, &mut world.vehicle).expect("nothing to read");
    ask(&mut world, &byte(9));
    storage(&mut world, 1.0);
    assert!(!world.stack.persist(world.now(), &mut store, &mut world.vehicle));
    assert_eq!(store.flash().writes, 0);
}

/// A backend that neither stores nor resets.
struct Plain;

#[derive(mavstack::Stack)]
#[stack(vehicle: Plain, links: 1, parameters: mavstack::param::ExternalParams<1>)]
struct OfPlain;

impl mavstack::Vehicle for Plain {
    fn state(&self) -> Option<mavstack::VehicleState> {
        None
    }
}

without_commands!(Plain);

impl mavstack::ParamBackend for Plain {
    fn param_count(&self) -> u16 {
        1
    }

    fn param_info(&self, _: u16) -> Option<ParamInfo> {
        ParamInfo::new("A", 0i32, 0..=1).ok()
    }

    fn param_bits(&self, _: u16) -> Option<u32> {
        Some(0)
    }

    fn set_param(
        &mut self,
        _: &mut mavstack::Context<'_>,
        _: &mavstack::param::ParamWrite,
    ) -> Result<(), MavParamError> {
        Ok(())
    }
}

impl Default for Plain {
    fn default() -> Self {
        Self
    }
}

/// C-16: what a backend cannot do is refused with its reason.
#[test]
fn a_backend_without_storage_says_so() {
    let mut world: World<1, OfPlain> = World::of(Setup::new());
    for (action, text) in [
        (0.0, "Parameters are not stored"),
        (1.0, "Parameters are not stored"),
        (2.0, "Parameters cannot be reset"),
        (4.0, "Parameters cannot be reset"),
    ] {
        world.run_for(secs(3));
        world.gcs[0].forget();
        world.gcs[0].command_long(MavCmd::PREFLIGHT_STORAGE, [action, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(world.expect::<CommandAck>(0, millis(100)).result, MavResult::DENIED);
        world.run_for(millis(100));
        let texts = world.gcs[0].all::<Statustext>();
        let texts: Vec<_> = texts.iter().map(|(_, text)| text.text.as_str()).collect();
        assert_eq!(texts, [Some(text)], "{action}");
    }
}
