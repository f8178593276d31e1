//! The same behaviour, wherever the parameters are: in a table that the compiler checks, in one that is filled at run time, and in
//! a backend, whether its names are sorted or not.

use crate::support::tested::{HookServices, Hooks};
use crate::support::*;
use mavstack::__private::{Absent, Firmware, NoPlans, ParamMemory, Persistent, Values};
use mavstack::dialect::*;
use mavstack::param::{ExternalParams, ParamEncoding, ParamInfo, ParamTable, ParamUpdate, ParamWrite, RuntimeTable};
use mavstack::{
    Command, Commands, Context, Message, Outcome, ParamBackend, ParamChange, Parameters, Text, Vehicle, VehicleState,
};
use std::cell::Cell;
use std::collections::{BTreeMap, VecDeque};
use std::marker::PhantomData;

mavstack::parameters! {
    /// Parameters with every type and flag.
    pub struct Fixed {
        ALT_MIN: f32 = -5.0, -100.0..=100.0, "m";
        BYTE: u8 = 7, 1..=200, "";
        ID_OF_16_LETTERS: i32 = -2, -1_000..=1_000_000_000, "" { reboot_required };
        LOCKED: u32 = 4_000_000_000, 0..=u32::MAX, "" { read_only };
        NOISE: f32 = 0.5, 0.0..=1.0, "" { volatile };
        SMALL: i8 = -1, -10..=10, "";
        WIDE: i16 = -300, -1_000..=1_000, "";
        WORD: u16 = 60_000, 0..=u16::MAX, "";
    }
}

pub(super) const COUNT: usize = 8;

/// The capacity of a backend with unsorted names. That of the sorted one is [`ROOM`].
pub(super) const UNSORTED: usize = COUNT;
pub(super) const ROOM: usize = 12;

/// A vehicle with parameters in `T`.
pub(super) struct Car<T, const CAST: bool = false> {
    pub(super) verdict: Result<(), MavParamError>,
    pub(super) is_armed: bool,
    /// The changes by clients.
    pub(super) changed: Vec<(u16, u32)>,
    pub(super) backend: Backend,
    parameters: PhantomData<T>,
}

/// The settings store of a vehicle that has one.
pub(super) struct Backend {
    pub(super) info: Vec<ParamInfo>,
    pub(super) values: Vec<u32>,
    /// What it has stored.
    pub(super) stored: Vec<u32>,
    pub(super) updates: VecDeque<ParamUpdate>,
    /// Calls of the hooks of PREFLIGHT_STORAGE.
    pub(super) actions: Vec<&'static str>,
    pub(super) result: MavResult,
    /// The number of declarations that were asked for.
    pub(super) lookups: Cell<usize>,
    /// What it does with the values that clients set.
    pub(super) rounds: fn(u32) -> u32,
}

impl Backend {
    pub(super) fn new(info: Vec<ParamInfo>) -> Self {
        let values: Vec<_> = info.iter().map(ParamInfo::default_bits).collect();
        Self {
            info,
            stored: values.clone(),
            values,
            updates: VecDeque::new(),
            actions: Vec::new(),
            result: MavResult::ACCEPTED,
            lookups: Cell::new(0),
            rounds: |bits| bits,
        }
    }
}

impl<T: Kind, const CAST: bool> Default for Car<T, CAST> {
    fn default() -> Self {
        let backend = Backend::new(T::order());
        Self { verdict: Ok(()), is_armed: false, changed: Vec::new(), backend, parameters: PhantomData }
    }
}

impl<T, const CAST: bool> Vehicle for Car<T, CAST> {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(self.is_armed))
    }
}

impl<T, const CAST: bool> Commands for Car<T, CAST> {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}

const fn encoding(cast: bool) -> ParamEncoding {
    if cast { ParamEncoding::CCast } else { ParamEncoding::Bytewise }
}

impl<T: ParamTable, const CAST: bool> Parameters for Car<T, CAST> {
    type Table = T;
    const PARAM_ENCODING: ParamEncoding = encoding(CAST);

    fn may_set(&mut self, _: &mut Context<'_>, _: &ParamChange<T>) -> Result<(), MavParamError> {
        self.verdict
    }

    fn parameter_changed(&mut self, cx: &mut Context<'_>, change: &ParamChange<T>) {
        let bits = change.value(mavstack::Param::<T, u32>::__at(change.index())).expect("this parameter");
        assert_eq!(cx.parameter(mavstack::Param::<T, u32>::__at(change.index())), bits, "called after the change");
        self.changed.push((change.index(), bits));
    }
}

impl<const N: usize, const CAST: bool> ParamBackend for Car<ExternalParams<N>, CAST> {
    const SORTED: bool = N != UNSORTED;
    const PARAM_ENCODING: ParamEncoding = encoding(CAST);

    fn param_count(&self) -> u16 {
        self.backend.info.len() as u16
    }

    fn param_info(&self, index: u16) -> Option<ParamInfo> {
        self.backend.lookups.set(self.backend.lookups.get() + 1);
        self.backend.info.get(usize::from(index)).copied()
    }

    fn param_bits(&self, index: u16) -> Option<u32> {
        self.backend.values.get(usize::from(index)).copied()
    }

    fn set_param(&mut self, _: &mut Context<'_>, write: &ParamWrite) -> Result<(), MavParamError> {
        let value = &mut self.backend.values[usize::from(write.index())];
        assert_ne!(*value, write.bits(), "an equal value needs no decision");
        assert_eq!(write.from().address, STATION);
        self.verdict?;
        *value = (self.backend.rounds)(write.bits());
        self.changed.push((write.index(), write.bits()));
        Ok(())
    }

    fn take_update(&mut self) -> ParamUpdate {
        self.backend.updates.pop_front().unwrap_or(ParamUpdate::Nothing)
    }

    fn save_params(&mut self, _: &mut Context<'_>) -> MavResult {
        self.backend.actions.push("save");
        if self.backend.result == MavResult::ACCEPTED {
            self.backend.stored = self.backend.values.clone();
        }
        self.backend.result
    }

    fn load_params(&mut self, _: &mut Context<'_>) -> MavResult {
        self.backend.actions.push("load");
        if self.backend.result == MavResult::ACCEPTED {
            self.backend.values = self.backend.stored.clone();
        }
        self.backend.result
    }

    fn reset_params(&mut self, _: &mut Context<'_>, all: bool) -> MavResult {
        self.backend.actions.push(if all { "reset all" } else { "reset" });
        if self.backend.result == MavResult::ACCEPTED {
            for (value, info) in self.backend.values.iter_mut().zip(&self.backend.info) {
                *value = if all || !info.is_read_only() { info.default_bits() } else { *value };
            }
        }
        self.backend.result
    }
}

impl<T: Kind, const CAST: bool> Hooks for Car<T, CAST> {
    type Parameters = T;
}

impl<D, T, const CAST: bool> HookServices<D> for Car<T, CAST>
where
    D: Firmware<Vehicle = Self, Parameters = T>,
    T: Kind<Service: Persistent<D>>,
{
    type Param = T::Service;
    type Stream = Absent;
    type Mode = Absent;
}

pub(super) type Declared<T, const CAST: bool> = Tested<NoPlans, 8, Plain, Car<T, CAST>>;
pub(super) type Place<T, const CAST: bool = false> = World<2, Declared<T, CAST>>;

/// A place for parameters.
pub(super) trait Kind: ParamMemory + Values + Sized + 'static {
    /// The declarations, ordered by index.
    fn order() -> Vec<ParamInfo> {
        Fixed::INFO.to_vec()
    }

    /// Returns a world with its parameters.
    fn world<const CAST: bool>(setup: Setup<2>) -> Place<Self, CAST>
    where
        Self::Service: Persistent<Declared<Self, CAST>>;

    /// The value of a parameter.
    fn bits<const CAST: bool>(world: &Place<Self, CAST>, index: usize) -> u32
    where
        Self::Service: Persistent<Declared<Self, CAST>>;

    /// The vehicle itself sets a parameter to a valid value.
    fn own<const CAST: bool>(world: &mut Place<Self, CAST>, index: usize, bits: u32)
    where
        Self::Service: Persistent<Declared<Self, CAST>>;

    /// Its index.
    fn index_of(name: &str) -> usize {
        Self::order().iter().position(|info| info.name() == name).expect("declared")
    }
}

impl Kind for Fixed {
    fn world<const CAST: bool>(setup: Setup<2>) -> Place<Self, CAST> {
        World::of(setup)
    }

    fn bits<const CAST: bool>(world: &Place<Self, CAST>, index: usize) -> u32 {
        world.stack.parameters().values()[index]
    }

    fn own<const CAST: bool>(world: &mut Place<Self, CAST>, index: usize, bits: u32) {
        assert!(world.stack.parameters_mut().set(mavstack::Param::<Self, u32>::__at(index as u16), bits));
    }
}

/// The order in which a run-time table gets its parameters, and in which an unsorted backend has them.
pub(super) const SHUFFLED: [usize; COUNT] = [5, 2, 7, 0, 1, 6, 4, 3];

impl Kind for RuntimeTable<ROOM> {
    fn world<const CAST: bool>(setup: Setup<2>) -> Place<Self, CAST> {
        let mut world: Place<Self, CAST> = World::of(setup);
        for at in SHUFFLED {
            world.stack.parameters_mut().add(Fixed::INFO[at]).expect("valid");
        }
        world
    }

    fn bits<const CAST: bool>(world: &Place<Self, CAST>, index: usize) -> u32 {
        world.stack.parameters().bits(index as u16).expect("added")
    }

    fn own<const CAST: bool>(world: &mut Place<Self, CAST>, index: usize, bits: u32) {
        assert!(world.stack.parameters_mut().set_bits(index as u16, bits));
    }
}

impl<const N: usize> Kind for ExternalParams<N> {
    fn order() -> Vec<ParamInfo> {
        if N == UNSORTED { SHUFFLED.map(|at| Fixed::INFO[at]).to_vec() } else { Fixed::INFO.to_vec() }
    }

    fn world<const CAST: bool>(setup: Setup<2>) -> Place<Self, CAST>
    where
        Self::Service: Persistent<Declared<Self, CAST>>,
    {
        World::of(setup)
    }

    fn bits<const CAST: bool>(world: &Place<Self, CAST>, index: usize) -> u32
    where
        Self::Service: Persistent<Declared<Self, CAST>>,
    {
        world.vehicle.backend.values[index]
    }

    fn own<const CAST: bool>(world: &mut Place<Self, CAST>, index: usize, bits: u32)
    where
        Self::Service: Persistent<Declared<Self, CAST>>,
    {
        world.vehicle.backend.values[index] = bits;
        world.vehicle.backend.updates.push_back(ParamUpdate::One(index as u16));
    }
}

pub(super) const LIST: ParamRequestList = ParamRequestList { target_system: 1, target_component: 0 };

pub(super) fn read(index: i16, name: &str) -> ParamRequestRead {
    ParamRequestRead { param_index: index, target_system: 1, target_component: 1, param_id: Text::new(name) }
}

pub(super) fn set(name: &str, param_type: MavParamType, param_value: f32) -> ParamSet {
    ParamSet { param_value, target_system: 1, target_component: 1, param_id: Text::new(name), param_type }
}

/// What a PARAM_VALUE says: index, count, name, type, the bits of the value.
pub(super) type Seen = (u16, u16, String, MavParamType, u32);

pub(super) fn seen(value: &ParamValue) -> Seen {
    let name = value.param_id.as_str().expect("ASCII").to_owned();
    (value.param_index, value.param_count, name, value.param_type, value.param_value.to_bits())
}

/// What a PARAM_ERROR says: error, index, name.
pub(super) type Refusal = (MavParamError, i16, String);

/// What the PARAM_VALUE of a parameter with this value says.
pub(super) fn shown<T: Kind>(index: usize, bits: u32) -> Seen {
    let info = T::order()[index];
    (index as u16, COUNT as u16, info.name().to_owned(), info.param_type(), bits)
}

/// Takes all values that a link's ground station has got.
pub(super) fn values<T: Kind, const CAST: bool>(world: &mut Place<T, CAST>, link: usize) -> Vec<Seen>
where
    T::Service: Persistent<Declared<T, CAST>>,
{
    let mut values = Vec::new();
    while let Some((_, value)) = world.gcs[link].take::<ParamValue>() {
        values.push(seen(&value));
    }
    values
}

/// Sends a message from the first ground station, and returns the errors that it gets and the values that both get.
pub(super) fn ask<T: Kind, const CAST: bool, M: Message>(
    world: &mut Place<T, CAST>,
    message: &M,
) -> (Vec<Refusal>, [Vec<Seen>; 2])
where
    T::Service: Persistent<Declared<T, CAST>>,
{
    world.gcs[0].send(message);
    world.run_for(millis(100));
    let mut errors = Vec::new();
    while let Some((_, error)) = world.gcs[0].take::<ParamError>() {
        errors.push((error.error, error.param_index, error.param_id.as_str().expect("ASCII").to_owned()));
    }
    assert!(world.gcs[1].take::<ParamError>().is_none(), "only its sender learns of a refusal");
    let values = [values(world, 0), values(world, 1)];
    (errors, values)
}

/// The result of a PREFLIGHT_STORAGE.
pub(super) fn storage<T: Kind, const CAST: bool>(world: &mut Place<T, CAST>, action: f32) -> MavResult
where
    T::Service: Persistent<Declared<T, CAST>>,
{
    world.gcs[0].command_long(MavCmd::PREFLIGHT_STORAGE, [action, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    world.expect::<CommandAck>(0, millis(100)).result
}

/// A line that loses a third of all frames each way.
pub(super) fn lossy(seed: u64) -> Setup<2> {
    let mut line =
        LineConfig::both(Wire { bytes_per_second: 5_760, latency: millis(5), tx_fifo: 32, ..Wire::default() });
    line.up.faults = Faults::frames(0.33, 0.05);
    line.down.faults = Faults::frames(0.33, 0.05);
    Setup { lines: [line; 2], links: [mavstack::LinkConfig::uart(57_600); 2], seed, ..Setup::new() }
}

/// P-10, P-12: a client that asks for what it misses has all values in the end, with indices that never change.
fn every_value_arrives<T: Kind>()
where
    T::Service: Persistent<Declared<T, false>>,
{
    for seed in 0..5 {
        let mut world = T::world::<false>(lossy(seed));
        let mut known = BTreeMap::new();
        for round in 0.. {
            assert!(round < 60, "seed {seed}: {:?}", known.keys());
            known.extend(values(&mut world, 0).into_iter().map(|value| (value.0, value)));
            if known.is_empty() {
                world.gcs[0].send(&LIST);
            } else if known.len() == COUNT {
                break;
            }
            for index in (0..COUNT as u16).filter(|index| !known.is_empty() && !known.contains_key(index)) {
                world.gcs[0].send(&read(index as i16, ""));
            }
            world.run_for(secs(1));
        }
        let all: Vec<_> = (0..COUNT).map(|index| shown::<T>(index, T::order()[index].default_bits())).collect();
        assert_eq!(known.into_values().collect::<Vec<_>>(), all, "seed {seed}");
    }
}

/// P-13, P-30: a parameter is read by its index or its name, on the link of the request only. What does not exist is refused.
fn values_are_read<T: Kind>()
where
    T::Service: Persistent<Declared<T, false>>,
{
    let mut world = T::world::<false>(Setup::new());
    for (index, info) in T::order().iter().enumerate() {
        let value = shown::<T>(index, info.default_bits());
        assert_eq!(ask(&mut world, &read(index as i16, "no such")), (vec![], [vec![value.clone()], vec![]]));
        assert_eq!(ask(&mut world, &read(-1, info.name())), (vec![], [vec![value], vec![]]));
    }
    for (index, name) in [(8, "WORD"), (i16::MAX, ""), (-1, "word"), (-1, ""), (-1, "BYT"), (-1, "BYTES"), (-1, "ZZZ")]
    {
        let error = (MavParamError::DOES_NOT_EXIST, index, name.to_owned());
        assert_eq!(ask(&mut world, &read(index, name)), (vec![error], [vec![], vec![]]), "{index} {name}");
    }
}

/// P-14, P-15, P-19: every PARAM_SET is answered by one value, the actual one, on both links; a refusal by an error too.
fn every_verdict_is_answered<T: Kind>()
where
    T::Service: Persistent<Declared<T, false>>,
{
    use MavParamError as Error;
    use MavParamType as Type;
    let full = |value: f32| value.to_bits();
    for (name, r#type, bits, outcome) in [
        ("ALT_MIN", Type::REAL32, full(-100.0), Ok(full(-100.0))),
        ("BYTE", Type::UINT8, 0xFFFF_FF80, Ok(128)),
        ("BYTE", Type::UINT8, 0x3F80_0000, Ok(1)),
        ("BYTE", Type::REAL32, full(8.0), Ok(8)),
        // What MAVSDK 4.1's `set_param_int` sends (P-19).
        ("BYTE", Type::UINT8, 0x7FC0_0000, Err(Error::VALUE_OUT_OF_RANGE)),
        ("SMALL", Type::INT8, 0x7FC0_0000, Err(Error::VALUE_OUT_OF_RANGE)),
        ("WORD", Type::UINT16, 0x7FC0_0000, Err(Error::VALUE_OUT_OF_RANGE)),
        ("WIDE", Type::INT16, 0x7FC0_0000, Err(Error::VALUE_OUT_OF_RANGE)),
        ("BYTE", Type::UINT8, 0xFFFF_FF01, Err(Error::VALUE_OUT_OF_RANGE)),
        ("BYTE", Type::REAL32, full(8.5), Err(Error::VALUE_OUT_OF_RANGE)),
        ("BYTE", Type::UINT8, 7, Ok(7)),
        ("BYTE", Type::INT32, 200, Ok(200)),
        ("SMALL", Type::INT32, (-10i32).cast_unsigned(), Ok(0xF6)),
        ("WIDE", Type::INT8, 0xFF, Ok(0xFFFF)),
        ("WORD", Type::UINT16, 65_535, Ok(65_535)),
        ("ID_OF_16_LETTERS", Type::INT32, (-1_000i32).cast_unsigned(), Ok((-1_000i32).cast_unsigned())),
        ("NOISE", Type::REAL32, full(0.25), Ok(full(0.25))),
        ("BYTE", Type::UINT8, 201, Err(Error::VALUE_OUT_OF_RANGE)),
        ("SMALL", Type::INT8, 11, Err(Error::VALUE_OUT_OF_RANGE)),
        ("ALT_MIN", Type::REAL32, full(f32::NAN), Err(Error::VALUE_OUT_OF_RANGE)),
        ("ALT_MIN", Type::REAL32, full(f32::INFINITY), Err(Error::VALUE_OUT_OF_RANGE)),
        ("ALT_MIN", Type::UINT8, 8, Err(Error::TYPE_MISMATCH)),
        ("WORD", Type::UINT64, 8, Err(Error::TYPE_UNSUPPORTED)),
        ("LOCKED", Type::UINT32, 5, Err(Error::READ_ONLY)),
        ("LOCKED", Type::UINT32, 4_000_000_000, Err(Error::READ_ONLY)),
    ] {
        let mut world = T::world::<false>(Setup::new());
        let index = T::index_of(name);
        let old = T::order()[index].default_bits();
        let answer = ask(&mut world, &set(name, r#type, f32::from_bits(bits)));
        let row = format!("{name} {type:?} {bits:#x}");
        let value = vec![shown::<T>(index, outcome.unwrap_or(old))];
        let errors: Vec<_> = outcome.err().map(|error| (error, -1, name.to_owned())).into_iter().collect();
        assert_eq!(answer, (errors, [value.clone(), value]), "{row}");
        assert_eq!(T::bits(&world, index), outcome.unwrap_or(old), "{row}");
        let changes: Vec<_> =
            outcome.ok().filter(|bits| *bits != old).map(|bits| (index as u16, bits)).into_iter().collect();
        assert_eq!(world.vehicle.changed, changes, "{row}");
    }
    let mut world = T::world::<false>(Setup::new());
    world.vehicle.verdict = Err(Error::PERMISSION_DENIED);
    let index = T::index_of("BYTE");
    let old = vec![shown::<T>(index, 7)];
    let error = (Error::PERMISSION_DENIED, -1, "BYTE".to_owned());
    let byte = set("BYTE", Type::UINT8, f32::from_bits(9));
    assert_eq!(ask(&mut world, &byte), (vec![error], [old.clone(), old]));
    assert_eq!(world.vehicle.changed, []);
    // An unknown name has no value.
    let error = (Error::DOES_NOT_EXIST, -1, "NOTHING".to_owned());
    assert_eq!(ask(&mut world, &set("NOTHING", Type::UINT8, 0.0)), (vec![error], [vec![], vec![]]));
}

/// P-2, Q-9: with casts, each value is the number itself, and the client need not know the type.
fn casts_are_numbers<T: Kind>()
where
    T::Service: Persistent<Declared<T, true>>,
{
    let mut world = T::world::<true>(Setup::new());
    for (name, number) in [("SMALL", -1.0f32), ("WIDE", -300.0), ("WORD", 60_000.0), ("ALT_MIN", -5.0)] {
        let value = shown::<T>(T::index_of(name), number.to_bits());
        assert_eq!(ask(&mut world, &read(-1, name)), (vec![], [vec![value], vec![]]));
    }
    let value = vec![shown::<T>(T::index_of("SMALL"), (-3.0f32).to_bits())];
    let answer = ask(&mut world, &set("SMALL", MavParamType::REAL32, -3.0));
    assert_eq!(answer, (vec![], [value.clone(), value]));
    assert_eq!(T::bits(&world, T::index_of("SMALL")), 0xFD);
    world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [148.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let capabilities = world.expect::<AutopilotVersion>(0, millis(50)).capabilities;
    assert!(capabilities.contains(MavProtocolCapability::PARAM_ENCODE_C_CAST));
    assert!(!capabilities.contains(MavProtocolCapability::PARAM_ENCODE_BYTEWISE));
}

/// P-20, P-21: the hash is of all parameters that are not volatile, in the order of their names.
fn the_hash_is_that_of_the_values<T: Kind>()
where
    T::Service: Persistent<Declared<T, false>>,
{
    let mut world = T::world::<false>(Setup::new());
    for byte in [7, 9] {
        if byte != 7 {
            ask(&mut world, &set("BYTE", MavParamType::UINT8, f32::from_bits(byte)));
        }
        let mut crc = crc_any::CRCu32::create_crc(0xEDB8_8320, 32, 0, 0, true);
        for (index, info) in T::order().iter().enumerate().filter(|(_, info)| !info.is_volatile()) {
            let len = match info.param_type() {
                MavParamType::UINT8 | MavParamType::INT8 => 1,
                MavParamType::UINT16 | MavParamType::INT16 => 2,
                _ => 4,
            };
            crc.digest(info.name().as_bytes());
            crc.digest(&T::bits(&world, index).to_le_bytes()[..len]);
        }
        let hash = (u16::MAX, COUNT as u16, "_HASH_CHECK".to_owned(), MavParamType::UINT32, crc.get_crc());
        assert_eq!(ask(&mut world, &read(-1, "_HASH_CHECK")), (vec![], [vec![hash], vec![]]));
    }
}

/// P-16: whatever the vehicle itself sets, and however much at a time, each link gets the last value of each.
fn own_changes_are_announced<T: Kind>()
where
    T::Service: Persistent<Declared<T, false>>,
{
    let mut world = T::world::<false>(Setup::new());
    world.run_for(millis(50));
    let (small, locked) = (T::index_of("SMALL"), T::index_of("LOCKED"));
    T::own(&mut world, small, 5);
    T::own(&mut world, locked, 17);
    world.run_for(millis(50));
    for link in 0..2 {
        let mut sent = values(&mut world, link);
        sent.sort_by_key(|value| value.0);
        let mut expected = vec![shown::<T>(small, 5), shown::<T>(locked, 17)];
        expected.sort_by_key(|value| value.0);
        assert_eq!(sent, expected);
    }
    for round in 0..200u32 {
        T::own(&mut world, small, round % 11);
        world.run_for(millis(1));
    }
    world.run_for(millis(100));
    for link in 0..2 {
        assert_eq!(values(&mut world, link).last(), Some(&shown::<T>(small, 199 % 11)));
    }
    assert_eq!(world.vehicle.changed, [], "the vehicle knows");
    let now = world.now();
    assert!(world.stack.next_deadline(now) > now, "nothing is pending");
}

/// P-17, C-4, C-5: PREFLIGHT_STORAGE 2 resets what is not read-only, 4 everything, and both only while disarmed.
fn all_are_reset<T: Kind>()
where
    T::Service: Persistent<Declared<T, false>>,
{
    for (action, locked) in [(2.0, 5), (4.0, 4_000_000_000)] {
        let mut world = T::world::<false>(Setup::new());
        world.run_for(millis(50));
        let [byte, lock] = ["BYTE", "LOCKED"].map(T::index_of);
        T::own(&mut world, byte, 9);
        T::own(&mut world, lock, 5);
        world.run_for(millis(50));
        world.vehicle.is_armed = true;
        assert_eq!(storage(&mut world, action), MavResult::TEMPORARILY_REJECTED);
        assert_eq!(storage(&mut world, 3.0), MavResult::DENIED);
        assert_eq!([byte, lock].map(|index| T::bits(&world, index)), [9, 5]);
        world.vehicle.is_armed = false;
        (0..2).for_each(|link| drop(values(&mut world, link)));
        assert_eq!(storage(&mut world, action), MavResult::ACCEPTED);
        assert_eq!([byte, lock].map(|index| T::bits(&world, index)), [7, locked]);
        world.run_for(millis(200));
        for link in 0..2 {
            let sent = values(&mut world, link);
            assert!(sent.contains(&shown::<T>(byte, 7)), "{sent:?}");
            assert_eq!(sent.contains(&shown::<T>(lock, locked)), action == 4.0 || sent.len() == COUNT);
        }
    }
}

macro_rules! suite {
    ($($kind:ident: $parameters:ty, [$($test:ident),*];)*) => { $(
        mod $kind {
            use super::*;

            $(#[test]
            fn $test() {
                super::$test::<$parameters>();
            })*
        }
    )* };
}

suite! {
    table: Fixed, [
        every_value_arrives, values_are_read, every_verdict_is_answered, casts_are_numbers,
        the_hash_is_that_of_the_values, own_changes_are_announced, all_are_reset
    ];
    run_time_table: RuntimeTable<ROOM>, [
        every_value_arrives, values_are_read, every_verdict_is_answered, casts_are_numbers,
        the_hash_is_that_of_the_values, own_changes_are_announced, all_are_reset
    ];
    backend: ExternalParams<ROOM>, [
        every_value_arrives, values_are_read, every_verdict_is_answered, casts_are_numbers,
        the_hash_is_that_of_the_values, own_changes_are_announced, all_are_reset
    ];
    unsorted_backend: ExternalParams<UNSORTED>, [
        every_value_arrives, values_are_read, every_verdict_is_answered, casts_are_numbers, own_changes_are_announced,
        all_are_reset
    ];
}
