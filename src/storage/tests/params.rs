//! Stored parameters: power cuts at every byte, and firmware with another table (P-17).

use super::flash::{Fault, FlashError, RamFlash, Torn};
use super::*;
use crate::dialect::MavParamType;
use crate::param::{ParamTable, ParamType};
use crate::service::Service;
use crate::service::param::{ParamChange, ParamService, Parameters, Stored, TableMut};
use crate::service::rest::Rest;
use crate::storage::Persistent;
use crate::time::Instant;
use crate::types::{Context, Firmware, NoPlans};
use crate::{Param, Vehicle, VehicleState};
use core::marker::PhantomData;

crate::parameters! {
    /// The parameters of the current firmware.
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
    /// The parameters of a later firmware. One was added before all others, one was removed, one has another type, one
    /// has a narrower range, two have another default, and one is no longer stored.
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

/// A vehicle with this table.
#[derive(Debug)]
struct Rover<T> {
    /// The indices of the parameters that changed.
    changes: Vec<u16>,
    table: PhantomData<T>,
}

impl<T: ParamTable> Vehicle for Rover<T> {
    fn state(&self) -> Option<VehicleState> {
        None
    }
}

impl<T: ParamTable> Parameters for Rover<T> {
    type Table = T;

    fn parameter_changed(&mut self, _: &mut Context<'_>, change: &ParamChange<T>) {
        assert!(change.from().is_none());
        self.changes.push(change.index());
    }
}

/// Its firmware.
struct Board<T>(PhantomData<T>);

impl<T: ParamTable + Default + 'static> Firmware for Board<T> {
    type Vehicle = Rover<T>;
    type Plans = NoPlans;
    type Parameters = T;
}

/// A vehicle with its parameters.
#[derive(Debug)]
struct Tuned<T> {
    table: T,
    vehicle: Rover<T>,
}

impl<T: ParamTable + Default + 'static> Tuned<T> {
    /// A vehicle with default parameters.
    fn new() -> Self {
        Self { table: T::default(), vehicle: Rover { changes: Vec::new(), table: PhantomData } }
    }

    /// Takes a value from storage.
    fn load(&mut self, params: &mut ParamService, stored: &Stored) {
        let Self { table, vehicle } = self;
        params.load(&mut Rest::new().cx::<Board<T>>(Instant::ZERO, table, vehicle), stored, false);
    }

    fn bits(&mut self) -> Vec<u32> {
        let table = self.table.table_mut();
        (0..).map_while(|index| table.get(index)).map(|(_, bits)| bits).collect()
    }
}

impl<T: ParamTable> Tuned<T> {
    fn with<V: ParamType>(mut self, param: Param<T, V>, value: V) -> Self {
        assert!(self.table.table_mut().set(param, value));
        self
    }
}

fn service() -> ParamService {
    <ParamService as Service<Board<Today>>>::NEW
}

const FORMAT: Format = <ParamService as Persistent<Board<Today>>>::FORMAT;

/// A record of parameters in all of a flash.
struct ParamStore<F> {
    flash: F,
    record: Record,
}

impl<F: NorFlash> ParamStore<F> {
    fn region_len(count: usize) -> u32 {
        Record::region_len::<F>(32 * count as u32)
    }

    /// Returns the number of rows.
    fn open(&mut self) -> Result<u32, RestoreError<F::Error>> {
        Ok(self.record.open(&mut self.flash)?.map_or(0, |header| header.len / 32))
    }

    fn row(&mut self, index: u32) -> Result<Option<Stored>, F::Error> {
        let mut row = [0; ROW];
        Ok(self.record.row(&mut self.flash, index, &mut row)?.then(|| Stored::from_row(&row)))
    }

    fn step(&mut self, now: Instant, table: &TableMut<'_>, job: Option<u32>) -> Step {
        let job = job.map(|id| Job { id, len: u32::from(table.count()) * 32 });
        step(&mut self.record, &mut self.flash, now, job, |index| Some(table.stored(index as u16)?.to_row()))
    }

    fn into_inner(self) -> F {
        self.flash
    }
}

/// A store whose region is the whole flash.
fn param_store<F: NorFlash>(flash: F) -> ParamStore<F> {
    let len = flash.capacity() as u32;
    ParamStore { flash, record: Record::new::<F>(0..len, FORMAT) }
}

/// Starts a vehicle with the stored parameters.
fn start<T: ParamTable + Default + 'static, F: NorFlash>(flash: F) -> Result<Tuned<T>, RestoreError<F::Error>> {
    let mut store = param_store(flash);
    let (mut params, mut vehicle) = (service(), Tuned::<T>::new());
    // Repeat failed reads until they are given up.
    for _ in 0..4 {
        if !matches!(store.open(), Err(RestoreError::Storage(_))) {
            break;
        }
        let _ = store.step(later(), &vehicle.table.table_mut(), None);
    }
    for index in 0..store.open()? {
        let stored = store.row(index)?.expect("a row");
        vehicle.load(&mut params, &stored);
    }
    params.loaded(&mut vehicle.table, true);
    assert_eq!(params.pending_write(Instant::NEVER, &mut vehicle.table), None, "all parameters are stored");
    Ok(vehicle)
}

/// Stores the parameters, and erases the spare slot. Returns whether they were stored.
fn store_all<T: ParamTable, F: NorFlash>(store: &mut ParamStore<F>, vehicle: &mut Tuned<T>, job: u32) -> bool {
    let mut outcomes = [Some(job), None].map(|job| {
        (0..10_000).map(|_| store.step(later(), &vehicle.table.table_mut(), job)).find(|step| *step != Step::Busy)
    });
    outcomes[0].take() == Some(Step::Done)
}

fn holding<const W: usize, const E: usize, T: ParamTable>(vehicle: &mut Tuned<T>) -> RamFlash<W, E> {
    let len = ParamStore::<RamFlash<W, E>>::region_len(T::INFO.len());
    let mut store = param_store(RamFlash::new(len));
    assert_eq!(store.open(), Ok(0));
    assert!(store_all(&mut store, vehicle, 1));
    store.into_inner()
}

fn old() -> Tuned<Today> {
    Tuned::new().with(Today::ALT, 33.0).with(Today::BAT, -10).with(Today::STARTS, 41).with(Today::ZOOM, 9)
}

fn new() -> Tuned<Today> {
    old().with(Today::ALT, 20.0).with(Today::STARTS, 42).with(Today::YAW, -90).with(Today::SPEED, 0.25)
}

/// Power cuts at every byte written (P-17).
fn every_cut<const W: usize, const E: usize>(torn: Torn) {
    let mut flash = holding::<W, E, _>(&mut old());
    flash.torn = torn;
    let commit = |fuel| {
        let mut flash = flash.clone();
        flash.fuel = fuel;
        let mut store = param_store(flash);
        let _ = store.open();
        let is_done = store_all(&mut store, &mut new(), 7);
        let mut flash = store.into_inner();
        flash.power_on();
        (flash, is_done)
    };
    let (whole, is_done) = commit(None);
    assert!(is_done);
    let (mut was_old, mut was_new) = (0, 0);
    for fuel in 0..whole.cost() - flash.cost() {
        let (cut, is_done) = commit(Some(fuel));
        let found = start::<Today, _>(cut).expect("a record").bits();
        let is_new = found == new().bits();
        assert!(is_new || found == old().bits(), "cut after {fuel}: neither old nor new");
        assert!(!is_done || is_new, "cut after {fuel}: done but lost");
        if is_new {
            was_new += 1;
        } else {
            was_old += 1;
        }
    }
    assert!(was_old > 0 && was_new > 0, "both outcomes must occur");
}

#[test]
fn a_cut_anywhere_leaves_the_old_parameters_or_the_new() {
    every_cut::<1, 64>(Torn::Prefix);
    every_cut::<4, 4096>(Torn::Garbage);
    every_cut::<8, 2048>(Torn::Garbage);
    every_cut::<32, 1024>(Torn::Unreadable);
    every_cut::<256, 256>(Torn::Garbage);
}

/// P-17: parameters are restored, and the change hook is called for those that differ from their defaults.
#[test]
fn stored_parameters_are_restored() {
    let mut found = start::<Today, _>(holding::<4, 256, _>(&mut new())).expect("readable");
    assert_eq!(found.bits(), new().bits());
    assert_eq!(found.vehicle.changes, [1, 4, 5, 7, 8]);
}

/// P-17: a volatile parameter starts with its default.
#[test]
fn volatile_values_are_not_stored() {
    let mut found = start::<Today, _>(holding::<4, 256, _>(&mut new().with(Today::NOISE, 0.75))).expect("readable");
    assert_eq!(found.bits(), new().bits());
}

/// P-17: rows are matched by name and type, unknown rows are ignored, and parameters that were never set get the
/// default of the firmware that reads them.
#[test]
fn another_table_keeps_common_parameters() {
    let before = old().with(Today::ID_OF_16_LETTERS, 3).with(Today::SPEED, 1.0).with(Today::TURNS, -9);
    let flash = holding::<4, 256, _>(&mut before.with(Today::YAW, 1).with(Today::YAW, 0));
    let found = start::<Tomorrow, _>(flash.clone()).expect("readable").table;
    assert_eq!(found.get(Tomorrow::ACC), 2.0, "added");
    assert_eq!(found.get(Tomorrow::ALT), 33.0, "kept, though its index has changed");
    assert_eq!(found.get(Tomorrow::BAT), 10.5, "it has another type");
    assert_eq!(found.get(Tomorrow::ID_OF_16_LETTERS), 3);
    assert_eq!(found.get(Tomorrow::STARTS), 41, "read-only parameters are stored too");
    assert_eq!(found.get(Tomorrow::TURNS), 1, "-9 is out of its range now");
    assert_eq!(found.get(Tomorrow::YAW), 0);
    assert_eq!(found.get(Tomorrow::ZOOM), 1, "volatile now");
    // Parameters that were never set follow the default.
    let found = start::<Tomorrow, _>(holding::<4, 256, _>(&mut Tuned::<Today>::new())).expect("readable").table;
    assert_eq!((found.get(Tomorrow::ALT), found.get(Tomorrow::ID_OF_16_LETTERS)), (30.0, 8));
    // A downgrade restores everything until the later firmware stores its own parameters.
    assert_eq!(start::<Today, _>(flash).expect("readable").table.get(Today::SPEED), 1.0);
}

/// P-17: a value that changes while the record is written may be in it or not. All other values are correct.
#[test]
fn a_change_between_two_steps_affects_no_other_value() {
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

/// G-18: empty storage has no parameters; stored plans and unreadable storage are errors.
#[test]
fn storage_without_parameters() {
    let flash = RamFlash::<4, 256>::new(2048);
    assert_eq!(start::<Today, _>(flash).expect("readable").bits(), Tuned::<Today>::new().bits());
    let mut plans = store(RamFlash::<4, 256>::new(2048));
    assert_eq!(write(&mut plans, 1, &Content::new([3, 1, 1], 1)), Step::Done);
    assert_eq!(start::<Today, _>(plans.into_inner()).map(|_| ()), Err(RestoreError::Damaged));
    let mut flash = holding::<4, 256, _>(&mut old());
    flash.fault = Fault::Read(0..flash.bytes.len() as u32);
    assert_eq!(start::<Today, _>(flash).map(|_| ()), Err(RestoreError::Storage(FlashError::Fault)));
}

/// The bytes as documented in params.md.
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

/// Rows with arbitrary bits never set a parameter to a value outside of its range.
#[test]
fn values_out_of_range_are_not_applied() {
    let mut params = service();
    for bits in (0..u32::MAX).step_by(0x01FF_FFFF) {
        for r#type in (0..12).map(MavParamType) {
            for info in Today::INFO {
                let mut name = [0; 16];
                name[..info.name().len()].copy_from_slice(info.name().as_bytes());
                let mut vehicle = Tuned::<Today>::new();
                let stored = Stored { name, r#type, bits, is_default: false };
                vehicle.load(&mut params, &stored);
                let values = vehicle.bits();
                assert!(Today::INFO.iter().zip(values).all(|(info, bits)| info.has_room(bits)));
            }
        }
    }
}
