//! Damaged or unreadable stored data is reported, never counts as empty, and nothing that can be read is lost (G-18, P-17).

mod unread;

use crate::support::flash::{Fault, FlashError, RamFlash};
use crate::support::signer::*;
use crate::support::*;
use crate::{OnlyKey, of_key, of_parameters, of_plans};
use mavstack::dialect::*;
use mavstack::frame::Version;
use mavstack::message::Secret;
use mavstack::param::ParamTable;
use mavstack::plan::Durability;
use mavstack::signing::{LinkSigning, SigningKey};
use mavstack::storage::{RestoreError, Store};
use mavstack::{LinkConfig, Text};

mavstack::stack! {
    struct OnlyPlans for TestVehicle { links: 1, plans: { mission: 12, fence: 4, rally: 2 }, commands: { slots: 1 } }
}

type Flash = RamFlash<8, 512>;
type Keys<'a> = Store<&'a mut Flash>;
type Params<'a> = Store<&'a mut Flash>;
type Plans<'a> = Store<&'a mut Flash>;
type PlanWorld = World<1, OnlyPlans>;

const KEYS: u32 = Store::<Flash>::region_len::<OnlyKey>();
const PARAMS: u32 = Store::<Flash>::region_len::<Tested>();
const PLANS: u32 = Store::<Flash>::region_len::<OnlyPlans>();

/// Returns the bits of the only record in this flash: those of its header, and of the first `body` bytes of its body.
fn bits(flash: &Flash, body: usize) -> impl Iterator<Item = usize> + use<> {
    let half = flash.bytes.len() / 2;
    let slots = [0, half].map(|slot| flash.bytes[slot..].starts_with(b"MVSR"));
    let slot = match slots {
        [true, false] => 0,
        [false, true] => half,
        _ => panic!("there is one record"),
    };
    (slot..slot + 32).chain(slot + 256..slot + 256 + body).flat_map(|byte| byte * 8..byte * 8 + 8)
}

fn flipped(flash: &Flash, bit: usize) -> Flash {
    let mut flash = flash.clone();
    flash.bytes[bit / 8] ^= 1 << (bit % 8);
    flash
}

/// A radio that must sign once there is a key, a provisioning wire, and a wire without signing.
fn signing_rig() -> Rig<3> {
    let unsigned = LinkSigning { sign_out: false, ..LinkSigning::OPEN };
    let links = [LinkSigning::SIGNED, LinkSigning::OPEN.with_provisioning(), unsigned];
    Rig::new(links.map(|signing| LinkConfig::uart(115_200).with_signing(signing)))
}

fn settle(rig: &mut Rig<3>, store: &mut Keys<'_>) {
    for _ in 0..100 {
        if !rig.stack.persist(rig.now, store, &mut rig.vehicle) {
            return;
        }
    }
    panic!("it never ends");
}

/// Flash of a vehicle that has a key.
fn with_key() -> Flash {
    let mut flash = Flash::new(KEYS);
    let mut store = Keys::new(&mut flash, 0..KEYS);
    let mut rig = signing_rig();
    assert_eq!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)), Ok(()));
    rig.set_key(KEY);
    settle(&mut rig, &mut store);
    flash
}

fn arm() -> CommandLong {
    CommandLong { command: MavCmd::COMPONENT_ARM_DISARM, target_system: 1, param1: 1.0, ..Default::default() }
}

fn setup(key: [u8; 32]) -> SetupSigning {
    SetupSigning { initial_timestamp: NOW, target_system: 1, target_component: 1, secret_key: Secret(key) }
}

/// Sends an unsigned command to arm on each link and returns on which links it was carried out.
fn armed_by(rig: &mut Rig<3>) -> [bool; 3] {
    [0, 1, 2].map(|link| {
        let before = rig.vehicle.commands().len();
        rig.receive(link, &Signer::new(KEY).unsigned(Version::V2, &arm()));
        rig.vehicle.commands().len() > before
    })
}

/// G-18: whichever bit of a stored key flips, the links that would sign stay closed, also after another restart, until a key is
/// set on the provisioning link; an unsigned text says so.
#[test]
fn a_damaged_key_opens_no_link() {
    let whole = with_key();
    for bit in bits(&whole, 64) {
        let mut flash = flipped(&whole, bit);
        for restart in 0..2 {
            let mut store = Keys::new(&mut flash, 0..KEYS);
            let mut rig = signing_rig();
            let result = of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle));
            assert_eq!(result, Err(RestoreError::Damaged), "bit {bit}, restart {restart}");
            assert_eq!(armed_by(&mut rig), [false, false, true], "bit {bit}");
            let sent = rig.transmit(0);
            assert!(sent.iter().all(|frame| !frame.is_signed()));
            let texts: Vec<_> = sent.iter().filter_map(Sent::decode::<Statustext>).collect();
            assert_eq!(texts.len(), 1, "bit {bit}");
            assert_eq!(texts[0].severity, MavSeverity::ERROR);
            // The stored data does not change, however much time passes.
            rig.run_for(secs(120));
            settle(&mut rig, &mut store);

            // The radio accepts neither an unsigned SETUP_SIGNING nor a signed command.
            rig.receive(0, &Signer::new(KEY).unsigned(Version::V2, &setup(OTHER_KEY)));
            rig.receive(0, &Signer::new(KEY).frame(&arm()));
            assert_eq!((armed_by(&mut rig), rig.vehicle.commands().len()), ([false, false, true], 2));
        }
        let mut store = Keys::new(&mut flash, 0..KEYS);
        let mut rig = signing_rig();
        assert!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)).is_err());
        rig.receive(1, &Signer::new(KEY).unsigned(Version::V2, &setup(OTHER_KEY)));
        assert!(rig.sent::<Heartbeat>(1)[0].is_signed_with(OTHER_KEY));
        assert_eq!(armed_by(&mut rig), [false, true, true], "as they are configured");
        rig.receive(0, &Signer::new(OTHER_KEY).frame(&arm()));
        assert_eq!(rig.vehicle.commands().len(), 3);
        settle(&mut rig, &mut store);
        let mut rig = signing_rig();
        assert_eq!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)), Ok(()));
        assert!(rig.transmit(0)[0].is_signed_with(OTHER_KEY));
    }
}

/// G-11, G-18: a peer that may set the key may also remove it; links are then open as in a vehicle that never had a
/// key.
#[test]
fn a_damaged_key_is_taken_away() {
    let whole = with_key();
    let bit = bits(&whole, 64).last().expect("there is a record");
    let mut flash = flipped(&whole, bit);
    let mut store = Keys::new(&mut flash, 0..KEYS);
    let mut rig = signing_rig();
    assert!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)).is_err());
    let off = SetupSigning { initial_timestamp: 0, secret_key: Secret([0; 32]), ..setup(KEY) };
    rig.receive(1, &Signer::new(KEY).unsigned(Version::V2, &off));
    assert_eq!(armed_by(&mut rig), [true; 3]);
    settle(&mut rig, &mut store);
    let mut rig = signing_rig();
    assert_eq!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)), Ok(()));
    assert_eq!(armed_by(&mut rig), [true; 3]);
}

/// G-18: an older key does not replace a damaged newer one: it may have been replaced because it was compromised.
#[test]
fn an_older_key_does_not_stand_in() {
    let mut flash = with_key();
    let mut store = Keys::new(&mut flash, 0..KEYS);
    let mut rig = signing_rig();
    assert_eq!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)), Ok(()));
    rig.set_key(OTHER_KEY);
    // Stop when the new key is written, before the older one is erased.
    let count = |flash: &Flash| [0, 512].into_iter().filter(|slot| flash.bytes[*slot..].starts_with(b"MVSR")).count();
    while count(store.flash()) < 2 {
        assert!(rig.stack.persist(rig.now, &mut store, &mut rig.vehicle));
    }
    let at = flash.bytes.windows(32).position(|bytes| bytes == OTHER_KEY).expect("it is written");
    flash.bytes[at] ^= 1;
    for _ in 0..2 {
        let mut store = Keys::new(&mut flash, 0..KEYS);
        let mut rig = signing_rig();
        let result = of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle));
        assert_eq!(result, Err(RestoreError::Damaged));
        rig.receive(0, &Signer::new(KEY).frame(&arm()));
        assert_eq!(armed_by(&mut rig), [false, false, true]);
        settle(&mut rig, &mut store);
    }
}

/// G-18: any one read fails at a start: links are closed until the key can be read, soon after.
#[test]
fn a_key_that_cannot_be_read_comes_back() {
    let whole = with_key();
    for (first, is_default_set) in (0..12).flat_map(|first| [(first, false), (first, true)]) {
        let mut flash = whole.clone();
        (flash.reads, flash.fault) = (0, Fault::Reads(first..first + 1));
        let mut store = Keys::new(&mut flash, 0..KEYS);
        let mut rig = signing_rig();
        if is_default_set {
            // The stored key replaces a factory key.
            rig.set_key(OTHER_KEY);
        }
        match of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)) {
            Ok(()) => {}
            Err(error) => {
                assert_eq!(error, RestoreError::Storage(FlashError::Fault));
                assert_eq!(armed_by(&mut rig), [false, is_default_set, true]);
            }
        }
        settle(&mut rig, &mut store);
        assert!(rig.transmit(1)[0].is_signed_with(KEY), "read {first}");
        rig.receive(0, &Signer::new(KEY).frame(&Gcs::heartbeat()));
        assert_eq!(rig.counters().verified, 1);
    }
}

/// G-18: the storage of a new vehicle cannot be read at the start: links are closed until it is known that there is no
/// key.
#[test]
fn no_key_that_cannot_be_read_is_none() {
    for has_key in [false, true] {
        let mut flash = Flash::new(KEYS);
        flash.fault = Fault::Reads(0..3);
        let mut store = Keys::new(&mut flash, 0..KEYS);
        let mut rig = signing_rig();
        if has_key {
            rig.set_key(KEY);
        }
        assert!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)).is_err());
        assert_eq!(armed_by(&mut rig), [false, has_key, true]);
        for _ in 0..3 {
            settle(&mut rig, &mut store);
            rig.run_for(secs(1));
        }
        assert_eq!(armed_by(&mut rig), [!has_key, true, true]);
        let mut rig = signing_rig();
        assert_eq!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)), Ok(()));
        assert_eq!(rig.transmit(0)[0].is_signed(), has_key);
    }
}

/// G-18: a key that is set while the stored one cannot be read takes precedence.
#[test]
fn a_new_key_replaces_what_cannot_be_read() {
    let mut flash = with_key();
    (flash.reads, flash.fault) = (0, Fault::Reads(0..8));
    let mut store = Keys::new(&mut flash, 0..KEYS);
    let mut rig = signing_rig();
    assert!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)).is_err());
    rig.receive(1, &Signer::new(KEY).unsigned(Version::V2, &setup(OTHER_KEY)));
    for _ in 0..30 {
        settle(&mut rig, &mut store);
        rig.run_for(secs(1));
    }
    assert!(rig.transmit(0)[0].is_signed_with(OTHER_KEY));
    let mut rig = signing_rig();
    assert_eq!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)), Ok(()));
    rig.signing().set_key(mavstack::Instant::ZERO, SigningKey::new(OTHER_KEY), NOW);
    assert!(rig.transmit(0)[0].is_signed_with(OTHER_KEY));
}

/// Runs the world with storage for parameters.
fn run(world: &mut World<1>, store: &mut Params<'_>, time: mavstack::Duration) {
    let end = world.now().after(time);
    while world.now() < end && !store.flash().is_off() {
        world.step();
        world.stack.persist(world.now(), store, &mut world.vehicle);
    }
}

fn set(name: &str, param_value: f32) -> ParamSet {
    let param_type = MavParamType::REAL32;
    ParamSet { param_value, target_system: 1, target_component: 1, param_id: Text::new(name), param_type }
}

/// Flash of a vehicle with two parameters that are not the default.
fn with_params() -> Flash {
    let mut flash = Flash::new(PARAMS);
    let mut store = Params::new(&mut flash, 0..PARAMS);
    let mut world = World::new(Setup::<1>::new());
    assert_eq!(of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle)), Ok(()));
    world.gcs[0].send(&set("CRUISE", 7.0));
    world.gcs[0].send(&set("RTL_ALT", 99.0));
    run(&mut world, &mut store, secs(3));
    flash
}

fn cruise_and_altitude(world: &World<1>) -> (f32, f32) {
    (world.stack.parameters().get(Tuning::CRUISE), world.stack.parameters().get(Tuning::RTL_ALT))
}

/// G-18: whichever bit of the stored parameters flips, falling back to the defaults is reported.
#[test]
fn damaged_parameters_are_told() {
    let whole = with_params();
    for bit in bits(&whole, Tuning::INFO.len() * 32) {
        let mut flash = flipped(&whole, bit);
        for _ in 0..2 {
            let mut store = Params::new(&mut flash, 0..PARAMS);
            let mut world = World::new(Setup::<1>::new());
            let result = of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
            assert_eq!(result, Err(RestoreError::Damaged), "bit {bit}");
            assert_eq!(cruise_and_altitude(&world), (5.0, 30.0));
            run(&mut world, &mut store, millis(50));
            let text: Statustext = world.expect(0, millis(10));
            assert_eq!(text.text.as_str(), Some("Stored parameters are damaged"));
        }
    }
}

/// G-18, P-17: any one read or eight consecutive reads fail at the start; then a parameter is set, and the power fails at
/// any byte of the write. The other parameters are unchanged, and this one has its old or its new value.
#[test]
fn a_read_that_fails_costs_no_parameter() {
    let whole = with_params();
    let mut counted = whole.clone();
    counted.reads = 0;
    let mut world = World::new(Setup::<1>::new());
    let mut store = Params::new(&mut counted, 0..PARAMS);
    of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle)).expect("readable");
    let reads = counted.reads;
    assert!(reads > 12, "{reads}");
    for (read, len) in (0..reads).flat_map(|read| [(read, 1), (read, 8)]) {
        let change = |flash: &mut Flash| {
            (flash.reads, flash.fault) = (0, Fault::Reads(read..read + len));
            let mut store = Params::new(flash, 0..PARAMS);
            let mut world = World::new(Setup { step: millis(20), ..Setup::<1>::new() });
            let _ = of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
            world.gcs[0].send(&set("CRUISE", 8.0));
            run(&mut world, &mut store, secs(25));
            flash.power_on();
            flash.fault = Fault::None;
            let mut store = Params::new(flash, 0..PARAMS);
            let mut world = World::new(Setup::<1>::new());
            assert_eq!(of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle)), Ok(()));
            cruise_and_altitude(&world)
        };
        let mut uncut = whole.clone();
        assert_eq!(change(&mut uncut), (8.0, 99.0), "read {read}, {len}");
        let cost = uncut.cost() - whole.cost();
        for fuel in (1..=cost).step_by(if len == 1 { 29 } else { 97 }) {
            let mut flash = whole.clone();
            flash.fuel = Some(fuel);
            let found = change(&mut flash);
            assert!([(7.0, 99.0), (8.0, 99.0)].contains(&found), "read {read}, {len}, cut after {fuel}: {found:?}");
        }
    }
}

/// Runs the world with storage for plans until nothing is left to write.
fn run_plans(world: &mut PlanWorld, store: &mut Plans<'_>, time: mavstack::Duration) {
    let end = world.now().after(time);
    while world.now() < end {
        world.step();
        world.stack.persist(world.now(), store, &mut world.vehicle);
    }
}

fn fence() -> Vec<MissionItemInt> {
    let mut items = plan(2, 3);
    for item in &mut items {
        item.mission_type = MavMissionType::FENCE;
        (item.frame, item.command) = (MavFrame::GLOBAL, MavCmd::NAV_FENCE_CIRCLE_INCLUSION);
        (item.param1, item.param2) = (100.0, 0.0);
    }
    items
}

fn upload(world: &mut PlanWorld, store: &mut Plans<'_>, items: &[MissionItemInt]) -> MavMissionResult {
    let mut upload = Upload::new(&world.gcs[0], items);
    while upload.result().is_none() {
        run_plans(world, store, millis(1));
        upload.poll(world.now(), &mut world.gcs[0]);
    }
    match upload.result() {
        Some(Ok(ack)) => ack.r#type,
        Some(Err(TransferError::Refused(result))) => result,
        other => panic!("{other:?}"),
    }
}

/// Flash of a vehicle with a fence.
fn with_fence() -> Flash {
    let mut flash = Flash::new(PLANS);
    let mut store = Plans::new(&mut flash, 0..PLANS);
    let mut world = PlanWorld::of(Setup::new());
    assert_eq!(of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle)), Ok(()));
    assert_eq!(upload(&mut world, &mut store, &fence()), MavMissionResult::ACCEPTED);
    run_plans(&mut world, &mut store, secs(1));
    flash
}

/// G-18: whichever bit of a stored fence flips, it is not restored as an empty fence without a report; and it stays damaged until
/// a plan is stored.
#[test]
fn a_damaged_fence_is_no_empty_fence() {
    let whole = with_fence();
    for bit in bits(&whole, 3 * 32) {
        let mut flash = flipped(&whole, bit);
        for _ in 0..2 {
            let mut store = Plans::new(&mut flash, 0..PLANS);
            let mut world = PlanWorld::of(Setup::new());
            let result = of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
            assert_eq!(result, Err(RestoreError::Damaged), "bit {bit}");
            assert_eq!(world.stack.fence().items(), []);
            run_plans(&mut world, &mut store, millis(300));
            let text: Statustext = world.expect(0, millis(10));
            assert_eq!(text.text.as_str(), Some("Stored plans are damaged"));
        }
        let mut store = Plans::new(&mut flash, 0..PLANS);
        let mut world = PlanWorld::of(Setup::new());
        let result = of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
        assert!(result.is_err());
        assert_eq!(upload(&mut world, &mut store, &fence()), MavMissionResult::ACCEPTED);
        let mut world = PlanWorld::of(Setup::new());
        let result = of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
        assert_eq!((result, world.stack.fence().items().len()), (Ok(()), 2));
    }
}

/// G-18, M-44: any one read fails at the start: the fence is restored late, the vehicle is told, and a mission that is
/// uploaded meanwhile does not replace it.
#[test]
fn a_read_that_fails_costs_no_fence() {
    let whole = with_fence();
    let mut late = 0;
    for (read, durability) in (0..16).flat_map(|read| [(read, Durability::Durable), (read, Durability::Deferred)]) {
        for is_slow in [false, true] {
            let mut flash = whole.clone();
            (flash.reads, flash.fault) = (0, Fault::Reads(read..read + 1));
            let mut store = Plans::new(&mut flash, 0..PLANS);
            let mut world = PlanWorld::of(crate::setup(durability));
            let result = of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
            late += u32::from(result.is_err());
            // Storage can be read again only when the upload is over.
            world.vehicle.may_persist = !is_slow;
            let mission = plan(5, 1);
            if is_slow && durability == Durability::Deferred {
                assert_eq!(upload(&mut world, &mut store, &mission), MavMissionResult::ACCEPTED);
            }
            world.vehicle.may_persist = true;
            let mut result = upload(&mut world, &mut store, &mission);
            if result != MavMissionResult::ACCEPTED {
                result = upload(&mut world, &mut store, &mission);
            }
            assert_eq!(result, MavMissionResult::ACCEPTED);
            run_plans(&mut world, &mut store, secs(12));
            assert_eq!(world.stack.fence().items().len(), 2, "read {read}");
            let fences =
                world.vehicle.plan_changes().into_iter().filter(|(plan, ..)| *plan == mavstack::PlanType::Fence);
            assert_eq!(fences.count(), 1, "the vehicle is told once");
            let mut world = PlanWorld::of(crate::setup(durability));
            let result = of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
            assert_eq!(result, Ok(()));
            assert_eq!((world.stack.mission().items().len(), world.stack.fence().items().len()), (5, 2), "read {read}");
        }
    }
    assert!(late > 8, "{late} starts without the plans");
}
