//! Storage is written when the vehicle permits it, one step per pass, and no more often than flash endures (C-15, D-5,
//! SEC-12).

use crate::pages::{COPY, KEY, LAST, PAGE, PARAMETERS, PLANS};
use crate::support::flash::{FlashError, RamFlash};
use crate::support::*;
use crate::upload;
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use mavstack::dialect::*;
use mavstack::message::Secret;
use mavstack::plan::Durability;
use mavstack::signing::{LinkSigning, SigningKey};
use mavstack::{Command, Commands, Config, Context, Duration, LinkConfig, Outcome, Text, Vehicle, VehicleState};

/// A flash that counts the records written to it, by kind.
#[derive(Clone, Debug)]
struct Counting<const ERASE: usize> {
    flash: RamFlash<8, ERASE>,
    records: [u32; 4],
}

impl<const ERASE: usize> ErrorType for Counting<ERASE> {
    type Error = FlashError;
}

impl<const ERASE: usize> ReadNorFlash for Counting<ERASE> {
    const READ_SIZE: usize = RamFlash::<8, ERASE>::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        self.flash.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.flash.capacity()
    }
}

impl<const ERASE: usize> NorFlash for Counting<ERASE> {
    const WRITE_SIZE: usize = 8;
    const ERASE_SIZE: usize = ERASE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        self.flash.erase(from, to)
    }

    /// The end of a record's last page is written last. Records that are moved to another segment do not count.
    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        self.flash.write(offset, bytes)?;
        if let (32, [.., kind, flags]) = (bytes.len(), &bytes[..16])
            && flags & (LAST | COPY) == LAST
        {
            self.records[usize::from(*kind)] += 1;
        }
        Ok(())
    }
}

type Flash = Counting<1024>;
#[derive(mavstack::Stack)]
#[stack(
    vehicle: Rover,
    links: 2,
    plans: { mission: 12, fence: 4, rally: 2 },
    parameters: Tuning,
    signing,
    storage,
)]
struct Mavlink;

type PaceWorld = World<2, Mavlink>;

/// Three pages of plans, one of parameters and one of the key: two units of 1 KiB in each segment.
const LEN: u32 = mavstack::storage::Store::<Flash>::region_len::<Mavlink>();
const _: () = assert!(LEN == 6 * 1024);
/// The region of a vehicle with a serial NOR flash.
const LONG: u32 = 16 * 4096;

/// The vehicle of the tests, but with the default `may_persist`.
#[derive(Debug, Default)]
struct Rover(TestVehicle);

impl Rover {
    fn arm(&mut self, is_armed: bool) {
        let state = self.0.state.as_mut().expect("it is well");
        state.base_mode = if is_armed { MavModeFlag::SAFETY_ARMED } else { MavModeFlag::EMPTY };
    }
}

impl Vehicle for Rover {
    fn state(&self) -> Option<VehicleState> {
        self.0.state
    }
}

impl Commands for Rover {
    fn command(&mut self, cx: &mut Context<'_>, command: &Command) -> Outcome {
        self.0.command(cx, command)
    }
}

wrap_plans!(Rover);

/// The store of a vehicle, with erase units of this length.
struct Store<const ERASE: usize = 1024>(mavstack::storage::Store<Counting<ERASE>>);

impl Store {
    fn new() -> Self {
        Self::of(LEN)
    }
}

impl<const ERASE: usize> Store<ERASE> {
    fn of(len: u32) -> Self {
        let flash = Counting { flash: RamFlash::new(len), records: [0; 4] };
        Self(mavstack::storage::Store::new(flash, 0..len))
    }

    fn flash(&self) -> &RamFlash<8, ERASE> {
        &self.0.flash().flash
    }

    fn restore(&mut self, world: &mut PaceWorld) {
        let now = world.now();
        assert_eq!(world.stack.restore(now, &mut self.0, &mut world.vehicle), Ok(()));
    }

    /// Does what one pass of the loop does.
    fn persist(&mut self, world: &mut PaceWorld) {
        let now = world.now();
        world.stack.persist(now, &mut self.0, &mut world.vehicle);
    }

    fn run(&mut self, world: &mut PaceWorld, time: Duration) {
        let end = world.now() + time;
        while world.now() < end {
            world.step();
            self.persist(world);
        }
    }

    /// Returns the number of records written: plans, parameters, keys.
    fn records(&self) -> [u32; 3] {
        [PLANS, PARAMETERS, KEY].map(|kind| self.0.flash().records[usize::from(kind)])
    }

    /// Returns the number of steps so far: erases and written pages.
    fn steps(&self) -> u32 {
        self.flash().erases + self.flash().bytes_written.div_ceil(PAGE as u64) as u32
    }
}

/// Creates a vehicle with a radio and a wire for provisioning.
fn world(config: impl FnOnce(Config) -> Config, step: Duration) -> PaceWorld {
    let setup = Setup::<2>::new();
    let wire = LinkConfig::uart(115_200).with_signing(LinkSigning::OPEN.with_provisioning());
    let links = [LinkConfig::uart(115_200), wire];
    PaceWorld::of(Setup { config: config(setup.config), links, step, ..setup })
}

fn set(name: &str, param_value: f32) -> ParamSet {
    let param_type = MavParamType::REAL32;
    ParamSet { param_value, target_system: 1, target_component: 1, param_id: Text::new(name), param_type }
}

fn store_now(action: f32) -> [f32; 7] {
    [action, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
}

fn clear_all() -> MissionClearAll {
    MissionClearAll { target_system: 1, target_component: 1, mission_type: MavMissionType::ALL }
}

fn items(plan: MavMissionType, len: u16, variant: u16) -> Vec<MissionItemInt> {
    let mut items = crate::support::plan(len, variant);
    for item in &mut items {
        item.mission_type = plan;
        match plan {
            MavMissionType::FENCE => {
                (item.frame, item.command) = (MavFrame::GLOBAL, MavCmd::NAV_FENCE_CIRCLE_INCLUSION);
                (item.param1, item.param2) = (100.0 + f32::from(variant), 0.0);
            }
            MavMissionType::RALLY => item.command = MavCmd::NAV_RALLY_POINT,
            _ => {}
        }
    }
    items
}

fn command(world: &mut PaceWorld, store: &mut Store, action: f32) -> MavResult {
    world.gcs[0].forget();
    world.gcs[0].command_long(MavCmd::PREFLIGHT_STORAGE, store_now(action));
    loop {
        store.run(world, millis(10));
        if let Some((_, ack)) = world.gcs[0].take::<CommandAck>() {
            return ack.result;
        }
    }
}

/// D-5, SEC-12: plans, parameters and key are due to be written at the same time. Each pass erases one unit or writes one page, and
/// all are written.
#[test]
fn each_pass_does_one_step() {
    let mut world = world(|config| Config { durability: Durability::Deferred, ..config }, millis(10));
    let mut store = Store::new();
    store.restore(&mut world);
    for round in 0..4u16 {
        world.gcs[0].send(&set("CRUISE", 6.0 + f32::from(round)));
        let now = world.now();
        let key = SigningKey::new([round as u8 + 1; 32]);
        world.stack.signing_mut().set_key(now, key, 1);
        assert_eq!(
            upload(&mut world, &mut store.0, &items(MavMissionType::MISSION, 9, round)),
            MavMissionResult::ACCEPTED
        );
        for _ in 0..1_500 {
            world.step();
            let before = store.steps();
            store.persist(&mut world);
            assert!(store.steps() - before <= 1, "more than one step per pass");
        }
        let written = u32::from(round) + 1;
        assert_eq!(store.records(), [written; 3]);
    }
}

/// D-5: before a reset, a loop that only calls `persist` until it returns false writes everything.
#[test]
fn a_loop_of_persist_ends() {
    let mut world = world(|config| Config { durability: Durability::Deferred, ..config }, millis(10));
    let mut store = Store::new();
    store.restore(&mut world);
    assert_eq!(upload(&mut world, &mut store.0, &items(MavMissionType::MISSION, 12, 1)), MavMissionResult::ACCEPTED);
    let now = world.now();
    assert!(world.stack.parameters_mut().set(Tuning::CRUISE, 9.0));
    world.stack.save_parameters(now);
    world.stack.signing_mut().set_key(now, SigningKey::new([3; 32]), 1);
    let mut steps = 0;
    let mut count = |is_busy: bool| {
        steps += 1;
        assert!(steps < 100, "it never ends");
        is_busy
    };
    while count(world.stack.persist(now, &mut store.0, &mut world.vehicle)) {}
    assert_eq!(store.records(), [1; 3]);
}

/// D-5, SEC-12, M-27, M-44, P-17: by default nothing is written while the vehicle is armed or in a fault. Plans are DENIED at
/// COUNT; parameters and key are written later.
#[test]
fn nothing_is_written_while_armed() {
    let mut world = world(|config| config, millis(10));
    let mut store = Store::new();
    store.restore(&mut world);
    let mission = items(MavMissionType::MISSION, 5, 1);
    let state = world.vehicle.0.state;
    for is_fault in [false, true] {
        world.vehicle.arm(true);
        if is_fault {
            world.vehicle.0.state = None;
        }
        world.gcs[0].forget();
        world.gcs[0].send(&set("CRUISE", 7.0 + f32::from(u8::from(is_fault))));
        let now = world.now();
        world.stack.signing_mut().set_key(now, SigningKey::new([3; 32]), 1);
        let before = (store.steps(), store.records());
        assert_eq!(upload(&mut world, &mut store.0, &mission), MavMissionResult::DENIED);
        world.expect::<Statustext>(0, millis(100));
        store.run(&mut world, secs(100));
        assert_eq!((store.steps(), store.records()), before);
        world.vehicle.0.state = state;
        store.run(&mut world, secs(12));
        assert!(store.records()[1] > before.1[1] && store.records()[2] > before.1[2]);
    }
    assert_eq!(upload(&mut world, &mut store.0, &mission), MavMissionResult::ACCEPTED);
}

/// The time in which a bucket regains a token by default, in seconds; and the number of tokens.
const REFILL: u32 = 15 * 60;
const TOKENS: u32 = 128;

/// C-15: for an hour a peer requests writes in every possible way, as fast as the link permits. The number of writes is
/// bounded by the buckets' capacity and refill, and every refusal is answered.
#[test]
fn a_flood_does_not_wear_the_flash_out() {
    for durability in [Durability::Durable, Durability::Deferred] {
        let mut world = world(|config| Config { durability, ..config }, millis(50));
        let mut store = Store::new();
        store.restore(&mut world);
        let [rejected, denied, refused] = flood(&mut world, &mut store, true);
        let [plans, params, keys] = store.records();
        let bound = TOKENS + 3_600 / REFILL + 1;
        // Deferred changes that follow each other at once are written together.
        let least = if durability == Durability::Durable { TOKENS / 2 } else { TOKENS / 8 };
        assert!((least..=bound).contains(&plans), "{plans} records of plans");
        assert!((TOKENS / 2..=bound).contains(&params), "{params} records of parameters");
        // Plus one every 50 s because time advances.
        assert!((TOKENS / 2..=bound + 3_600 / 50 + 1).contains(&keys), "{keys} records of keys");
        // In the smallest region, where each key erases all four units.
        let erases = store.flash().erases;
        assert!(erases <= 3 * bound + 3_600 / 50 + 1, "{erases} erases");
        let erases = &store.flash().erases_of;
        assert!(erases.iter().all(|erases| *erases <= bound), "{erases:?}");
        assert!(rejected > 100 && denied > 100 && refused > 100, "{rejected}, {denied}, {refused}");
        // The parameter that was set is stored later.
        let tuned = world.stack.parameters().get(Tuning::CRUISE);
        store.run(&mut world, secs(u64::from(REFILL) + 20));
        let mut again = PaceWorld::of(Setup::new());
        store.restore(&mut again);
        assert_eq!(again.stack.parameters().get(Tuning::CRUISE), tuned);
    }
}

/// C-15: an hour of explicit saves and uploads of one item, in a region of usual size: at most 60 erases, evenly spread.
#[test]
fn a_flood_of_saves_erases_little() {
    let mut world = world(|config| config, millis(50));
    let mut store = Store::<4096>::of(LONG);
    store.restore(&mut world);
    flood(&mut world, &mut store, false);
    let erases = &store.flash().erases_of;
    assert!(store.flash().erases <= 60, "{erases:?}");
    assert!(erases.iter().max() <= erases.iter().min().map(|least| least + 2).as_ref(), "{erases:?}");
}

/// Requests writes for an hour. Returns the number of refused saves, plans and keys.
fn flood<const ERASE: usize>(world: &mut PaceWorld, store: &mut Store<ERASE>, with_keys: bool) -> [u32; 3] {
    let end = world.now() + secs(3_600);
    let (mut rejected, mut denied, mut refused) = (0, 0, 0);
    let mut round = 0u16;
    while world.now() < end {
        round = round.wrapping_add(1);
        let gcs = &mut world.gcs[0];
        gcs.forget();
        gcs.send(&set("CRUISE", 1.0 + f32::from(round % 128) / 8.0));
        gcs.command_long(MavCmd::PREFLIGHT_STORAGE, store_now(if round.is_multiple_of(16) { 2.0 } else { 1.0 }));
        let mission_type =
            [MavMissionType::MISSION, MavMissionType::FENCE, MavMissionType::RALLY][usize::from(round % 3)];
        let result = upload(world, &mut store.0, &items(mission_type, 1, round));
        denied += u32::from(result == MavMissionResult::DENIED);
        world.gcs[0].send(&clear_all());
        if with_keys {
            let secret_key = Secret([round as u8 | 1; 32]);
            let setup = SetupSigning { initial_timestamp: 1, target_system: 1, target_component: 1, secret_key };
            world.gcs[1].forget();
            world.gcs[1].send(&setup);
        }
        store.run(world, millis(100));
        rejected += u32::from(
            world.gcs[0].take::<CommandAck>().is_some_and(|(_, ack)| ack.result == MavResult::TEMPORARILY_REJECTED),
        );
        refused += u32::from(world.gcs[1].count_of::<Statustext>() > 0);
    }
    [rejected, denied, refused]
}

/// C-15: the busiest day of regular use: 20 uploads of all plans at full capacity, one after the other, and 100 parameters, each
/// set and stored by command. Nothing is refused, and each change is stored at once.
#[test]
fn a_day_of_regular_use_is_never_refused() {
    let mut world = world(|config| config, millis(10));
    let mut store = Store::new();
    store.restore(&mut world);
    for variant in 0..20 {
        for (plan, len) in [(MavMissionType::MISSION, 12), (MavMissionType::FENCE, 4), (MavMissionType::RALLY, 2)] {
            let result = upload(&mut world, &mut store.0, &items(plan, len, variant));
            assert_eq!(result, MavMissionResult::ACCEPTED, "{variant}");
        }
    }
    assert_eq!(store.records()[0], 60);
    for round in 0..100u16 {
        world.gcs[0].send(&set("RTL_ALT", f32::from(round)));
        store.run(&mut world, millis(50));
        assert_eq!(command(&mut world, &mut store, 1.0), MavResult::ACCEPTED);
        store.run(&mut world, millis(100));
        assert_eq!(store.records()[1], u32::from(round) + 1, "it is stored");
    }
}

/// C-15: when a bucket is empty, a text reports the refusal, and an empty plan may still be cleared. A small change is accepted
/// when the bucket has regained one token; a large one needs more. A sleeping loop is not woken for parameters that wait for a
/// token.
#[test]
fn a_refusal_is_reported_and_temporary() {
    let mut world = world(|config| config, millis(20));
    let mut store = Store::new();
    store.restore(&mut world);
    let full = |variant| items(MavMissionType::MISSION, 12, variant);
    let began = world.now();
    let mut taken = 0;
    while upload(&mut world, &mut store.0, &full(taken)) == MavMissionResult::ACCEPTED {
        taken += 1;
        world.gcs[0].forget();
    }
    // Two thirds of plan memory are three tokens.
    assert_eq!(taken, 42);
    let text: Statustext = world.expect(0, millis(100));
    assert_eq!(text.text.as_str(), Some("Mission refused: stored too often, try later"));
    world.gcs[0].forget();
    assert_eq!(upload(&mut world, &mut store.0, &items(MavMissionType::FENCE, 1, 1)), MavMissionResult::ACCEPTED);
    assert_eq!(upload(&mut world, &mut store.0, &items(MavMissionType::FENCE, 2, 2)), MavMissionResult::ACCEPTED);
    assert_eq!(upload(&mut world, &mut store.0, &items(MavMissionType::FENCE, 1, 3)), MavMissionResult::DENIED);
    let clear = MissionClearAll { mission_type: MavMissionType::RALLY, ..clear_all() };
    world.gcs[0].forget();
    world.gcs[0].send(&clear);
    assert_eq!(world.expect::<MissionAck>(0, millis(100)).r#type, MavMissionResult::ACCEPTED);
    world.gcs[0].forget();
    world.gcs[0].send(&clear_all());
    assert_eq!(world.expect::<MissionAck>(0, millis(100)).r#type, MavMissionResult::DENIED);
    let left = (began + (secs(u64::from(REFILL) + 60))) - world.now();
    store.run(&mut world, left);
    assert_eq!(upload(&mut world, &mut store.0, &full(99)), MavMissionResult::DENIED);
    assert_eq!(upload(&mut world, &mut store.0, &items(MavMissionType::FENCE, 1, 3)), MavMissionResult::ACCEPTED);

    // Parameters are deferred without a text.
    for round in 0..u16::MAX {
        world.gcs[0].send(&set("RTL_ALT", f32::from(round % 100)));
        store.run(&mut world, millis(20));
        if command(&mut world, &mut store, 1.0) == MavResult::TEMPORARILY_REJECTED {
            break;
        }
        assert!(round < 200, "the bucket is never empty");
    }
    let before = world.stack.parameters().get(Tuning::RTL_ALT);
    assert_eq!(command(&mut world, &mut store, 2.0), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(world.stack.parameters().get(Tuning::RTL_ALT), before, "a reset that cannot be stored is refused");
    // It takes no token, but the value is not stored yet.
    assert_eq!(command(&mut world, &mut store, 0.0), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(world.stack.parameters().get(Tuning::RTL_ALT), before, "what was acknowledged is not taken back");
    world.gcs[0].send(&set("RTL_ALT", 101.0));
    store.run(&mut world, secs(30));
    let passes = world.sleep_for(secs(10));
    assert!(passes < 150, "{passes} passes in 10 s");
    // The vehicle's own request is granted, before a reset for example.
    let records = store.records()[1];
    let now = world.now();
    world.stack.save_parameters(now);
    store.run(&mut world, secs(1));
    assert_eq!(store.records()[1], records + 1);
}

/// C-15: a stranger requests the stored values 20 times a second, also while the bucket is empty. 18 of 20 values that a client set, and
/// that were acknowledged, were taken back; now none.
#[test]
fn read_takes_nothing_back() {
    for is_empty in [false, true] {
        let mut world = world(|config| config, millis(10));
        let mut store = Store::new();
        store.restore(&mut world);
        let mut saves = if is_empty { 200 } else { 0 };
        while saves > 0 {
            world.gcs[0].send(&set("RTL_ALT", saves as f32 / 4.0));
            command(&mut world, &mut store, 1.0);
            saves -= 1;
        }
        let mut kept = 0;
        for round in 0..20u16 {
            let value = 1.0 + f32::from(round) / 2.0;
            world.gcs[0].forget();
            world.gcs[0].send(&set("CRUISE", value));
            for _ in 0..20 {
                world.gcs[1].command_long(MavCmd::PREFLIGHT_STORAGE, store_now(0.0));
                store.run(&mut world, millis(50));
            }
            let acknowledged = world.gcs[0].all::<ParamValue>().into_iter().any(|(_, told)| told.param_value == value);
            assert!(acknowledged, "{value}");
            kept += usize::from(world.stack.parameters().get(Tuning::CRUISE) == value);
        }
        assert_eq!(kept, 20, "is the bucket empty: {is_empty}");
    }
}

/// C-15: without storage, or with storage that does not wear, nothing is limited.
#[test]
fn storage_without_wear_is_not_limited() {
    for has_storage in [false, true] {
        let mut world = world(|config| Config { storage_refill: Duration::ZERO, ..config }, millis(10));
        if !has_storage {
            world = self::world(|config| config, millis(10));
        }
        let mut store = Store::new();
        if has_storage {
            store.restore(&mut world);
        }
        for round in 0..300 {
            let result = upload(&mut world, &mut store.0, &items(MavMissionType::MISSION, 2, round));
            assert_eq!(result, MavMissionResult::ACCEPTED);
            world.gcs[0].send(&set("RTL_ALT", f32::from(round % 100)));
            assert_eq!(command(&mut world, &mut store, 2.0), MavResult::ACCEPTED);
        }
        assert_eq!(store.records()[0], if has_storage { 300 } else { 0 });
    }
}
