//! The parameters: power cuts at every byte, and firmware with another table (P-17, GOAL-8).

use super::flash::{Fault, FlashError, RamFlash, Torn};
use super::*;
use crate::dialect::MavParamType;
use crate::link::LinkMask;
use crate::service::param::{ParamChange, Parameters, Params};
use crate::storage::params::ParamStore;
use crate::time::Instant;
use crate::{Param, ParamTable, ParamType};

crate::parameters! {
    /// What the vehicle has today.
    struct Today {
        ALT: f32 = 20.0, 0.0..=100.0, "m";
        BAT: i8 = -4, -10..=10, "V";
        ID_OF_16_LETTERS: u32 = 7, 0..=u32::MAX, "";
        NOISE: f32 = 0.5, 0.0..=1.0, "", [volatile];
        SPEED: f32 = 5.0, 0.0..=20.0, "m/s";
        STARTS: u16 = 0, 0..=u16::MAX, "", [read_only];
        TURNS: i16 = -1, -10..=10, "";
        YAW: i32 = 0, -180..=180, "deg";
        ZOOM: u8 = 1, 1..=9, "";
    }
}

crate::parameters! {
    /// Tomorrow: one was added before all others, one was taken out, one has another type, one a narrower range, two others
    /// another default, and one is not stored any more.
    struct Tomorrow {
        ACC: f32 = 2.0, 0.0..=5.0, "m/s/s";
        ALT: f32 = 30.0, 0.0..=100.0, "m";
        BAT: f32 = 10.5, -100.0..=100.0, "V";
        ID_OF_16_LETTERS: u32 = 8, 0..=u32::MAX, "";
        NOISE: f32 = 0.5, 0.0..=1.0, "", [volatile];
        STARTS: u16 = 0, 0..=u16::MAX, "", [read_only];
        TURNS: i16 = 1, -2..=2, "";
        YAW: i32 = 0, -180..=180, "deg";
        ZOOM: u8 = 1, 1..=9, "", [volatile];
    }
}

#[derive(Debug)]
struct Vehicle<T> {
    table: T,
    changes: Vec<u16>,
}

impl<T: ParamTable> Parameters for Vehicle<T> {
    type Table = T;

    fn parameters_mut(&mut self) -> Option<&mut T> {
        Some(&mut self.table)
    }

    fn parameter_changed(&mut self, change: &ParamChange<T>) {
        assert!(change.from().is_none());
        self.changes.push(change.index());
    }
}

impl<T: ParamTable + Default> Vehicle<T> {
    /// As it comes from the factory.
    fn new() -> Self {
        Self { table: T::default(), changes: Vec::new() }
    }

    fn bits(&mut self) -> Vec<u32> {
        let table = self.table.table_mut();
        (0..).map_while(|index| table.get(index)).map(|(_, bits)| bits).collect()
    }
}

impl<T: ParamTable> Vehicle<T> {
    fn with<V: ParamType>(mut self, param: Param<T, V>, value: V) -> Self {
        assert!(self.table.table_mut().set(param, value));
        self
    }
}

/// The whole of the flash is the region.
fn param_store<F: NorFlash>(flash: F) -> ParamStore<F> {
    let len = flash.capacity() as u32;
    ParamStore::new(flash, 0..len)
}

/// A start: what the flash has comes back.
fn start<T: ParamTable + Default, F: NorFlash>(flash: F) -> Result<Vehicle<T>, RestoreError<F::Error>> {
    let mut store = param_store(flash);
    let (mut params, mut vehicle) = (Params::new(), Vehicle::<T>::new());
    // What cannot be read is looked at until it is given up.
    for _ in 0..4 {
        if !matches!(store.open(), Err(RestoreError::Storage(_))) {
            break;
        }
        let _ = store.step(later(), &vehicle.table.table_mut(), None);
    }
    for index in 0..store.open()? {
        let stored = store.row(index)?.expect("announced");
        params.load(&mut vehicle, &stored, LinkMask::NONE, false);
    }
    params.loaded(&mut vehicle, true);
    assert_eq!(params.unsaved(Instant::NEVER, &mut vehicle), None, "it is as the storage has it");
    Ok(vehicle)
}

/// Writes all of it, and erases ahead. Whether it was written.
fn keep<T: ParamTable, F: NorFlash>(store: &mut ParamStore<F>, vehicle: &mut Vehicle<T>, job: u32) -> bool {
    let mut outcomes = [Some(job), None].map(|job| {
        (0..10_000).map(|_| store.step(later(), &vehicle.table.table_mut(), job)).find(|step| *step != Step::Busy)
    });
    outcomes[0].take() == Some(Step::Done)
}

fn holding<const W: usize, const E: usize, T: ParamTable>(vehicle: &mut Vehicle<T>) -> RamFlash<W, E> {
    let len = ParamStore::<RamFlash<W, E>>::region_len(T::INFO.len());
    let mut store = param_store(RamFlash::new(len));
    assert_eq!(store.open(), Ok(0));
    assert!(keep(&mut store, vehicle, 1));
    store.into_inner()
}

fn old() -> Vehicle<Today> {
    Vehicle::new().with(Today::ALT, 33.0).with(Today::BAT, -10).with(Today::STARTS, 41).with(Today::ZOOM, 9)
}

fn new() -> Vehicle<Today> {
    old().with(Today::ALT, 20.0).with(Today::STARTS, 42).with(Today::YAW, -90).with(Today::SPEED, 0.25)
}

/// GOAL-8: the power goes at every byte of a write.
fn every_cut<const W: usize, const E: usize>(torn: Torn) {
    let mut flash = holding::<W, E, _>(&mut old());
    flash.torn = torn;
    let commit = |fuel| {
        let mut flash = flash.clone();
        flash.fuel = fuel;
        let mut store = param_store(flash);
        let _ = store.open();
        let is_done = keep(&mut store, &mut new(), 7);
        let mut flash = store.into_inner();
        flash.power_on();
        (flash, is_done)
    };
    let (whole, is_done) = commit(None);
    assert!(is_done);
    let (mut was_old, mut was_new) = (0, 0);
    for fuel in 0..whole.cost() - flash.cost() {
        let (cut, is_done) = commit(Some(fuel));
        let found = start::<Today, _>(cut).expect("never nothing").bits();
        let is_new = found == new().bits();
        assert!(is_new || found == old().bits(), "cut after {fuel}: a mix");
        assert!(!is_done || is_new, "cut after {fuel}: done and lost");
        if is_new {
            was_new += 1;
        } else {
            was_old += 1;
        }
    }
    assert!(was_old > 0 && was_new > 0, "both must have happened");
}

#[test]
fn a_cut_anywhere_leaves_the_old_parameters_or_the_new() {
    every_cut::<1, 64>(Torn::Prefix);
    every_cut::<4, 4096>(Torn::Garbage);
    every_cut::<8, 2048>(Torn::Garbage);
    every_cut::<32, 1024>(Torn::Unreadable);
    every_cut::<256, 256>(Torn::Garbage);
}

/// P-17: the vehicle is told of what is not its default.
#[test]
fn what_was_stored_comes_back() {
    let mut found = start::<Today, _>(holding::<4, 256, _>(&mut new())).expect("readable");
    assert_eq!(found.bits(), new().bits());
    assert_eq!(found.changes, [1, 4, 5, 7, 8]);
}

/// P-17: a volatile parameter begins anew.
#[test]
fn a_volatile_value_is_not_kept() {
    let mut found = start::<Today, _>(holding::<4, 256, _>(&mut new().with(Today::NOISE, 0.75))).expect("readable");
    assert_eq!(found.bits(), new().bits());
}

/// P-17: matched by name and type; what is unknown is dropped, what was never set has the default of today.
#[test]
fn another_table_keeps_what_both_have() {
    let before = old().with(Today::ID_OF_16_LETTERS, 3).with(Today::SPEED, 1.0).with(Today::TURNS, -9);
    let flash = holding::<4, 256, _>(&mut before.with(Today::YAW, 1).with(Today::YAW, 0));
    let found = start::<Tomorrow, _>(flash.clone()).expect("readable").table;
    assert_eq!(found.get(Tomorrow::ACC), 2.0, "added");
    assert_eq!(found.get(Tomorrow::ALT), 33.0, "kept, though it stands elsewhere");
    assert_eq!(found.get(Tomorrow::BAT), 10.5, "it has another type");
    assert_eq!(found.get(Tomorrow::ID_OF_16_LETTERS), 3);
    assert_eq!(found.get(Tomorrow::STARTS), 41, "also what is read-only");
    assert_eq!(found.get(Tomorrow::TURNS), 1, "-9 is out of its range now");
    assert_eq!(found.get(Tomorrow::YAW), 0);
    assert_eq!(found.get(Tomorrow::ZOOM), 1, "volatile now");
    // What was never set follows the default.
    let found = start::<Tomorrow, _>(holding::<4, 256, _>(&mut Vehicle::<Today>::new())).expect("readable").table;
    assert_eq!((found.get(Tomorrow::ALT), found.get(Tomorrow::ID_OF_16_LETTERS)), (30.0, 8));
    // And back: what tomorrow has not written over is still there.
    assert_eq!(start::<Today, _>(flash).expect("readable").table.get(Today::SPEED), 1.0);
}

/// P-17: a value that changes while a record is written is in it or not, and all others are as they are.
#[test]
fn a_change_between_two_steps_spoils_nothing() {
    let len = ParamStore::<RamFlash<8, 64>>::region_len(Today::INFO.len());
    for at in 0..40 {
        let mut store = param_store(RamFlash::<8, 64>::new(len));
        assert_eq!(store.open(), Ok(0));
        let mut vehicle = old();
        let mut outcome = Step::Busy;
        for step in 0..200 {
            if step == at {
                vehicle = vehicle.with(Today::ALT, 1.0).with(Today::ZOOM, 2);
            }
            outcome = store.step(later(), &vehicle.table.table_mut(), Some(1));
            if outcome != Step::Busy {
                break;
            }
        }
        assert_eq!(outcome, Step::Done);
        let found = start::<Today, _>(store.into_inner()).expect("readable").table;
        assert!([33.0, 1.0].contains(&found.get(Today::ALT)) && [9, 2].contains(&found.get(Today::ZOOM)));
        assert_eq!((found.get(Today::BAT), found.get(Today::STARTS)), (-10, 41));
    }
}

/// G-18: empty storage has no parameters; storage of plans and unreadable storage are errors.
#[test]
fn what_is_no_record_of_parameters() {
    let flash = RamFlash::<4, 256>::new(2048);
    assert_eq!(start::<Today, _>(flash).expect("readable").bits(), Vehicle::<Today>::new().bits());
    let mut plans = store(RamFlash::<4, 256>::new(2048));
    assert_eq!(write(&mut plans, 1, &Content::new([3, 1, 1], 1)), Step::Done);
    assert_eq!(start::<Today, _>(plans.into_inner()).map(|_| ()), Err(RestoreError::Damaged));
    let mut flash = holding::<4, 256, _>(&mut old());
    flash.fault = Fault::Read(0..flash.bytes.len() as u32);
    assert_eq!(start::<Today, _>(flash).map(|_| ()), Err(RestoreError::Storage(FlashError::Fault)));
}

/// What params.md says, byte by byte.
#[test]
fn rows_are_as_documented() {
    let flash = holding::<4, 256, _>(&mut old());
    let header = &flash.bytes[..32];
    assert_eq!((&header[..8], &header[12..16]), (&b"MVSR\x02\0\x01\0"[..], &(9u32 * 32).to_le_bytes()[..]));
    let row = |index: usize| <[u8; 32]>::try_from(&flash.bytes[256 + 32 * index..][..32]).expect("32 bytes");
    let expected = |name: &[u8], value: u32, r#type: MavParamType, is_default: u8| {
        let mut row = [0; 32];
        row[..name.len()].copy_from_slice(name);
        row[16..20].copy_from_slice(&value.to_le_bytes());
        row[20..22].copy_from_slice(&[r#type.0, is_default]);
        row
    };
    assert_eq!(row(0), expected(b"ALT", 33.0f32.to_bits(), MavParamType::REAL32, 0));
    assert_eq!(row(1), expected(b"BAT", 0xF6, MavParamType::INT8, 0));
    assert_eq!(row(2), expected(b"ID_OF_16_LETTERS", 7, MavParamType::UINT32, 1));
    assert_eq!(row(3), expected(b"NOISE", 0.5f32.to_bits(), MavParamType::REAL32, 1));
    assert_eq!(row(5), expected(b"STARTS", 41, MavParamType::UINT16, 0));
    assert_eq!(row(8), expected(b"ZOOM", 9, MavParamType::UINT8, 0));
}

/// Any bits in a whole record: no value that the parameter cannot have.
#[test]
fn garbage_rows_change_nothing() {
    let mut params = Params::new();
    for bits in (0..u32::MAX).step_by(0x01FF_FFFF) {
        for r#type in (0..12).map(MavParamType) {
            for info in Today::INFO {
                let mut name = [0; 16];
                name[..info.name().len()].copy_from_slice(info.name().as_bytes());
                let mut vehicle = Vehicle::<Today>::new();
                let stored = crate::service::param::Stored { name, r#type, bits, is_default: false };
                params.load(&mut vehicle, &stored, LinkMask::NONE, false);
                let values = vehicle.bits();
                assert!(Today::INFO.iter().zip(values).all(|(info, bits)| info.has_room(bits)));
            }
        }
    }
}
