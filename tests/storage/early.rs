//! What happens between `attach_storage` and the end of reading: nothing is open that the key closes, and what is set meanwhile is
//! newer than what is stored (G-18, P-17).

use super::damage::{
    Flash, KEYS, Keys, PARAMS, Params, armed_by, cruise_and_altitude, run, set, settle, setup, signing_rig, start,
    start_rig, with_key, with_params,
};
use crate::support::flash::Fault;
use crate::support::signer::*;
use crate::support::*;
use mavstack::dialect::*;
use mavstack::frame::Version;
use mavstack::param::{ParamInfo, RuntimeTable};
use mavstack::storage::Store;
use mavstack::{Parameters, Vehicle, VehicleState};

/// G-18: links that need a key stay closed until it is known whether there is one.
#[test]
fn links_stay_closed_until_the_key_is_read() {
    for has_key in [false, true] {
        let mut flash = if has_key { with_key() } else { Flash::new(KEYS) };
        let mut store = Keys::new(&mut flash, 0..KEYS);
        let mut rig = signing_rig();
        rig.stack.attach_storage(rig.now, store.region(), &mut rig.vehicle);
        assert_eq!(armed_by(&mut rig), [false, false, true]);
        settle(&mut rig, &mut store);
        assert!(!rig.stack.is_restoring());
        // As configured: without a key, all are open.
        assert_eq!(armed_by(&mut rig), [!has_key, true, true]);
    }
}

/// G-11, G-18: a key that is set before the stored one is read stays, also after a restart, and the stored one is erased.
#[test]
fn a_key_that_is_set_before_reading_stays() {
    let mut flash = with_key();
    let mut store = Keys::new(&mut flash, 0..KEYS);
    let mut rig = signing_rig();
    rig.stack.attach_storage(rig.now, store.region(), &mut rig.vehicle);
    rig.receive(1, &Signer::new(KEY).unsigned(Version::V2, &setup(OTHER_KEY)));
    assert!(rig.sent::<Heartbeat>(1)[0].is_signed_with(OTHER_KEY));
    for _ in 0..3 {
        rig.run_for(secs(1));
        settle(&mut rig, &mut store);
    }
    rig.receive(0, &Signer::new(OTHER_KEY).frame(&super::damage::arm()));
    assert_eq!(rig.vehicle.commands().len(), 1);
    assert!(!flash.bytes.windows(32).any(|bytes| bytes == KEY), "the old key is erased");
    let (_, mut rig, result) = start_rig(&mut flash);
    assert_eq!(result, Ok(()));
    rig.run_for(secs(1));
    assert!(rig.transmit(1).iter().any(|frame| frame.is_signed_with(OTHER_KEY)));
}

/// G-11, G-18: the same at any time during reading, also while a page of the key is read.
#[test]
fn a_key_that_is_set_during_reading_stays() {
    for calls in 0.. {
        let mut flash = with_key();
        let mut store = Keys::new(&mut flash, 0..KEYS);
        let mut rig = signing_rig();
        rig.stack.attach_storage(rig.now, store.region(), &mut rig.vehicle);
        for _ in 0..calls {
            rig.stack.exchange_job(rig.now, store.slot(), &mut rig.vehicle);
            store.run();
        }
        if !rig.stack.is_restoring() {
            assert!(calls > 10);
            break;
        }
        rig.receive(1, &Signer::new(KEY).unsigned(Version::V2, &setup(OTHER_KEY)));
        while rig.stack.exchange_job(rig.now, store.slot(), &mut rig.vehicle) {
            store.run();
        }
        rig.run_for(secs(1));
        assert!(rig.transmit(1).iter().all(|frame| frame.is_signed_with(OTHER_KEY)), "after {calls} calls");
    }
}

/// G-11, G-18: a client sets or removes the key, and then the first read of the stored one fails. The change stays and is stored.
#[test]
fn a_key_that_is_set_before_an_outage_stays() {
    for (key, len) in [(OTHER_KEY, 1), (OTHER_KEY, 3), ([0; 32], 1)] {
        let mut flash = with_key();
        (flash.reads, flash.fault) = (0, Fault::Reads(0..len));
        let mut store = Keys::new(&mut flash, 0..KEYS);
        let mut rig = signing_rig();
        rig.stack.attach_storage(rig.now, store.region(), &mut rig.vehicle);
        let mut message = setup(key);
        message.initial_timestamp = if key == [0; 32] { 0 } else { NOW };
        rig.receive(1, &Signer::new(KEY).unsigned(Version::V2, &message));
        for _ in 0..20 {
            settle(&mut rig, &mut store);
            rig.run_for(secs(1));
        }
        assert_eq!(rig.signing().is_active(), key == OTHER_KEY);
        let is_signed = |rig: &mut Rig<3>| rig.transmit(1).iter().any(|frame| frame.is_signed_with(OTHER_KEY));
        assert_eq!(is_signed(&mut rig), key == OTHER_KEY);
        let (_, mut rig, result) = start_rig(&mut flash);
        assert_eq!((result, rig.signing().is_active()), (Ok(()), key == OTHER_KEY));
        rig.run_for(secs(1));
        assert_eq!(is_signed(&mut rig), key == OTHER_KEY);
    }
}

/// P-17: a parameter that is set before the stored ones are read keeps its value and is stored; the others are restored.
#[test]
fn a_parameter_that_is_set_before_reading_stays() {
    for is_stored in [false, true] {
        let mut flash = if is_stored { with_params() } else { Flash::new(PARAMS) };
        let mut store = Params::new(&mut flash, 0..PARAMS);
        let mut world = World::new(Setup { step: millis(20), ..Setup::<1>::new() });
        world.stack.attach_storage(world.now(), store.region(), &mut world.vehicle);
        world.gcs[0].send(&set("CRUISE", 8.0));
        world.run_for(millis(100));
        run(&mut world, &mut store, secs(25));
        let (cruise, altitude) = cruise_and_altitude(&world);
        assert_eq!((cruise, altitude == 99.0), (8.0, is_stored));
        let (_, world, result) = start(&mut flash);
        assert_eq!(result, Ok(()));
        assert_eq!(cruise_and_altitude(&world), (8.0, altitude));
    }
}

/// The number of parameters of a table that fills three pages.
const MANY: u16 = 70;
type Long = RuntimeTable<{ MANY as usize }>;
type LongWorld = World<1, LongTable>;
const LONG: u32 = Store::<Flash>::region_len::<LongTable>();

#[derive(mavstack::Stack)]
#[stack(vehicle: LongVehicle, links: 1, parameters: Long, commands: { slots: 1 }, storage)]
struct LongTable;

#[derive(Default)]
struct LongVehicle(TestVehicle);

impl Vehicle for LongVehicle {
    fn state(&self) -> Option<VehicleState> {
        self.0.state()
    }
}

without_commands!(LongVehicle);

impl Parameters for LongVehicle {
    type Table = Long;
}

/// Creates a vehicle with parameters `P000`, `P001`, … Their default is 1, and the stored value of each is 2.
fn long_world() -> LongWorld {
    let mut world = LongWorld::of(Setup::new());
    for index in 0..MANY {
        let info = ParamInfo::new(&format!("P{index:03}"), 1.0f32, 0.0..=9.0).expect("valid");
        world.stack.parameters_mut().add(info).expect("there is room");
    }
    world
}

fn long_values(world: &LongWorld) -> Vec<f32> {
    (0..MANY).filter_map(|index| world.stack.parameters().bits(index)).map(f32::from_bits).collect()
}

fn own(world: &mut LongWorld, index: u16, value: f32) {
    assert!(world.stack.parameters_mut().set_bits(index, value.to_bits()));
}

fn run_long(world: &mut LongWorld, store: &mut Store<&mut Flash>, time: mavstack::Duration) {
    let end = world.now() + time;
    while world.now() < end {
        world.stack.exchange_job(world.now(), store.slot(), &mut world.vehicle);
        store.run();
        world.step_to(world.now() + millis(20));
    }
}

fn with_long_table() -> Flash {
    let mut flash = Flash::new(LONG);
    let mut store = Store::new(&mut flash, 0..LONG);
    let mut world = long_world();
    assert_eq!(world.stack.restore(world.now(), &mut store, &mut world.vehicle), Ok(()));
    for index in 0..MANY {
        own(&mut world, index, 2.0);
    }
    run_long(&mut world, &mut store, secs(4));
    assert_eq!(crate::pages::pages(&flash.bytes).len(), 3);
    flash
}

/// When a table is loaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Load {
    AtStart,
    /// After a read has failed.
    Late,
    /// Because a client requests it.
    OnRequest,
}

/// Begins to load, and sets a parameter to 8 after `calls` calls of the storage's task. Returns all values after loading, and those
/// after another restart. `None` if loading was over.
fn set_during_loading(
    flash: &Flash,
    load: Load,
    calls: u32,
    (index, is_own): (u16, bool),
) -> Option<(Vec<f32>, Vec<f32>)> {
    let mut flash = flash.clone();
    flash.reads = 0;
    flash.fault = if load == Load::Late { Fault::Reads(0..1) } else { Fault::None };
    let mut store = Store::new(&mut flash, 0..LONG);
    let mut world = long_world();
    if load == Load::AtStart {
        world.stack.attach_storage(world.now(), store.region(), &mut world.vehicle);
    } else {
        let result = world.stack.restore(world.now(), &mut store, &mut world.vehicle);
        assert_eq!(result.is_ok(), load == Load::OnRequest);
        world.run_for(millis(1_100));
    }
    if load == Load::OnRequest {
        world.gcs[0].command_long(MavCmd::PREFLIGHT_STORAGE, [0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        world.run_for(millis(10));
    }
    for _ in 0..calls {
        if !world.stack.exchange_job(world.now(), store.slot(), &mut world.vehicle) {
            return None;
        }
        store.run();
    }
    if is_own {
        own(&mut world, index, 8.0);
    } else {
        world.gcs[0].send(&set(&format!("P{index:03}"), 8.0));
        world.run_for(millis(10));
    }
    run_long(&mut world, &mut store, secs(15));
    let values = long_values(&world);
    let mut world = long_world();
    let mut store = Store::new(&mut flash, 0..LONG);
    assert_eq!(world.stack.restore(world.now(), &mut store, &mut world.vehicle), Ok(()));
    Some((values, long_values(&world)))
}

/// P-17: a table of several pages is loaded by several jobs. A value that the firmware or a client sets between any two of them
/// stays and is stored, whatever page has it, also after a request for the stored values (C-15). All other values are loaded.
#[test]
fn a_parameter_that_is_set_during_reading_stays() {
    let flash = with_long_table();
    for load in [Load::AtStart, Load::Late, Load::OnRequest] {
        for (index, is_own) in [0, 28, MANY - 1].into_iter().flat_map(|at| [(at, false), (at, true)]) {
            let mut calls = 0;
            while let Some((values, stored)) = set_during_loading(&flash, load, calls, (index, is_own)) {
                let expected: Vec<_> = (0..MANY).map(|other| if other == index { 8.0 } else { 2.0 }).collect();
                assert_eq!(values, expected, "{load:?}, P{index:03}, own: {is_own}, after {calls} calls");
                assert_eq!(stored, expected, "{load:?}, P{index:03}, own: {is_own}, after {calls} calls: stored");
                calls += 1;
            }
            assert!(calls >= 6, "there are three pages");
        }
    }
}

/// SEC-12: nothing is written because values were loaded, also late, and whatever is polled meanwhile.
#[test]
fn values_that_were_loaded_are_not_written() {
    for fault in [Fault::None, Fault::Reads(0..1), Fault::Reads(40..41)] {
        let mut flash = with_long_table();
        (flash.reads, flash.fault) = (0, fault.clone());
        let (writes, mut store) = (flash.writes, Store::new(&mut flash, 0..LONG));
        let mut world = long_world();
        world.stack.attach_storage(world.now(), store.region(), &mut world.vehicle);
        run_long(&mut world, &mut store, secs(25));
        assert_eq!(long_values(&world), [2.0; MANY as usize]);
        assert_eq!(store.flash().writes, writes, "{fault:?}");
    }
}
