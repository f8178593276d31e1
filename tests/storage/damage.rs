//! Stored data that is damaged or unreadable is reported, and never counts as empty. Nothing that can be read is lost (G-18, P-17).

mod plans;
mod unread;

use crate::pages::{self, KEY as KIND_OF_KEY, PAGE, PARAMETERS, PLANS as KIND_OF_PLANS};
use crate::support::flash::{Fault, RamFlash};
use crate::support::signer::*;
use crate::support::*;
use crate::{OnlyKey, of_key, of_parameters, of_plans, upload};
use mavstack::dialect::*;
use mavstack::frame::Version;
use mavstack::message::Secret;
use mavstack::param::ParamTable;
use mavstack::plan::Durability;
use mavstack::signing::{LinkSigning, SigningKey};
use mavstack::storage::{RestoreError, Store};
use mavstack::{LinkConfig, Text};

#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: 1,
    plans: { mission: 12, fence: 4, rally: 2 },
    commands: { slots: 1 },
    storage,
)]
struct OnlyPlans;

pub(crate) type Flash = RamFlash<8, 512>;
pub(crate) type Keys<'a> = Store<&'a mut Flash>;
pub(crate) type Params<'a> = Store<&'a mut Flash>;
type Plans<'a> = Store<&'a mut Flash>;
type PlanWorld = World<1, OnlyPlans>;

pub(crate) const KEYS: u32 = Store::<Flash>::region_len::<OnlyKey>();
pub(crate) const PARAMS: u32 = Store::<Flash>::region_len::<Tested>();
const PLANS: u32 = Store::<Flash>::region_len::<OnlyPlans>();

/// Returns the bits of the only page in this flash.
fn bits(flash: &Flash) -> impl Iterator<Item = usize> + use<> {
    let pages = pages::pages(&flash.bytes);
    let [(at, _)] = pages[..] else { panic!("{} pages", pages.len()) };
    at * 8..(at + PAGE) * 8
}

/// Returns the bits of the newest page of this kind.
fn bits_of_newest(flash: &Flash, kind: u8) -> impl Iterator<Item = usize> + use<> {
    let (at, _) = pages::newest(&flash.bytes, kind);
    at * 8..(at + PAGE) * 8
}

/// Returns this flash with one flipped bit.
fn flipped(flash: &Flash, bit: usize) -> Flash {
    let mut flash = flash.clone();
    flash.bytes[bit / 8] ^= 1 << (bit % 8);
    flash
}

/// Creates a vehicle with a radio that must sign once there is a key, a wire for provisioning, and a wire without signing.
pub(crate) fn signing_rig() -> Rig<3> {
    let unsigned = LinkSigning { sign_out: false, ..LinkSigning::OPEN };
    let links = [LinkSigning::SIGNED, LinkSigning::OPEN.with_provisioning(), unsigned];
    Rig::new(links.map(|signing| LinkConfig::uart(115_200).with_signing(signing)))
}

pub(crate) fn settle(rig: &mut Rig<3>, store: &mut Keys<'_>) {
    for _ in 0..100 {
        if !rig.stack.persist(rig.now, store, &mut rig.vehicle) {
            return;
        }
    }
    panic!("it never ends");
}

/// Starts a vehicle. Returns its store, and whether the key was restored.
pub(crate) fn start_rig(flash: &mut Flash) -> (Keys<'_>, Rig<3>, Result<(), RestoreError>) {
    let mut store = Keys::new(flash, 0..KEYS);
    let mut rig = signing_rig();
    let result = of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle));
    (store, rig, result)
}

/// Returns the flash of a vehicle that has a key.
pub(crate) fn with_key() -> Flash {
    let mut flash = Flash::new(KEYS);
    let (mut store, mut rig, result) = start_rig(&mut flash);
    assert_eq!(result, Ok(()));
    rig.set_key(KEY);
    settle(&mut rig, &mut store);
    flash
}

pub(crate) fn arm() -> CommandLong {
    CommandLong { command: MavCmd::COMPONENT_ARM_DISARM, target_system: 1, param1: 1.0, ..Default::default() }
}

pub(crate) fn setup(key: [u8; 32]) -> SetupSigning {
    SetupSigning { initial_timestamp: NOW, target_system: 1, target_component: 1, secret_key: Secret(key) }
}

/// Sends an unsigned command to arm on each link. Returns on which links it was carried out.
pub(crate) fn armed_by(rig: &mut Rig<3>) -> [bool; 3] {
    [0, 1, 2].map(|link| {
        let before = rig.vehicle.commands().len();
        rig.receive(link, &Signer::new(KEY).unsigned(Version::V2, &arm()));
        rig.vehicle.commands().len() > before
    })
}

/// G-18: whichever bit of the page with the key flips, links that would sign stay closed, also after another restart, until a key
/// is set on the link for provisioning. An unsigned text reports it. The damaged key is then erased.
#[test]
fn a_damaged_key_opens_no_link() {
    let whole = with_key();
    for bit in bits(&whole) {
        let mut flash = flipped(&whole, bit);
        for restart in 0..2 {
            let (mut store, mut rig, result) = start_rig(&mut flash);
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
            assert_eq!((store.flash().writes, store.flash().erases), (whole.writes, whole.erases), "bit {bit}");

            // The radio accepts neither an unsigned SETUP_SIGNING nor a signed command.
            rig.receive(0, &Signer::new(KEY).unsigned(Version::V2, &setup(OTHER_KEY)));
            rig.receive(0, &Signer::new(KEY).frame(&arm()));
            assert_eq!((armed_by(&mut rig), rig.vehicle.commands().len()), ([false, false, true], 2));
        }
        let (mut store, mut rig, result) = start_rig(&mut flash);
        assert!(result.is_err());
        rig.receive(1, &Signer::new(KEY).unsigned(Version::V2, &setup(OTHER_KEY)));
        assert!(rig.sent::<Heartbeat>(1)[0].is_signed_with(OTHER_KEY));
        assert_eq!(armed_by(&mut rig), [false, true, true], "as they are configured");
        rig.receive(0, &Signer::new(OTHER_KEY).frame(&arm()));
        assert_eq!(rig.vehicle.commands().len(), 3);
        settle(&mut rig, &mut store);
        assert!(!store.flash().bytes.windows(8).any(|bytes| KEY.windows(8).any(|part| part == bytes)), "bit {bit}");
        let mut rig = signing_rig();
        assert_eq!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)), Ok(()));
        assert!(rig.transmit(0)[0].is_signed_with(OTHER_KEY));
    }
}

/// G-11, G-18: a peer that may set the key may also remove a damaged one. Links are then open as in a vehicle that never had a
/// key.
#[test]
fn a_damaged_key_can_be_removed() {
    let whole = with_key();
    let bit = bits(&whole).last().expect("there is a record");
    let mut flash = flipped(&whole, bit);
    let (mut store, mut rig, result) = start_rig(&mut flash);
    assert!(result.is_err());
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
    let mut whole = with_key();
    let (mut store, mut rig, result) = start_rig(&mut whole);
    assert_eq!(result, Ok(()));
    rig.set_key(OTHER_KEY);
    // Stop when the new key is written, before the older one is erased.
    while pages::pages(&store.flash().bytes).len() < 2 {
        assert!(rig.stack.persist(rig.now, &mut store, &mut rig.vehicle));
    }
    let (_, newest) = pages::newest(&whole.bytes, KIND_OF_KEY);
    assert_eq!(newest.payload[..32], OTHER_KEY);
    for bit in bits_of_newest(&whole, KIND_OF_KEY) {
        let mut flash = flipped(&whole, bit);
        for _ in 0..2 {
            let (mut store, mut rig, result) = start_rig(&mut flash);
            assert_eq!(result, Err(RestoreError::Damaged), "bit {bit}");
            rig.receive(0, &Signer::new(KEY).frame(&arm()));
            assert_eq!(armed_by(&mut rig), [false, false, true], "bit {bit}");
            settle(&mut rig, &mut store);
        }
    }
}

/// G-18: any one read fails at the start. Links are closed until the key can be read, a second later.
#[test]
fn a_key_that_cannot_be_read_is_restored_late() {
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
                assert_eq!(error, RestoreError::Unreadable);
                assert_eq!(armed_by(&mut rig), [false, is_default_set, true]);
                settle(&mut rig, &mut store);
                rig.run_for(secs(1));
            }
        }
        settle(&mut rig, &mut store);
        assert!(rig.transmit(1)[0].is_signed_with(KEY), "read {first}");
        rig.receive(0, &Signer::new(KEY).frame(&Gcs::heartbeat()));
        assert_eq!(rig.counters().verified, 1);
        assert_eq!(rig.stack.restore_errors().signing, None);
    }
}

/// G-18: the storage of a new vehicle cannot be read at the start. Links are closed until it is known that there is no key.
#[test]
fn unreadable_storage_may_have_a_key() {
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
    let (mut store, mut rig, result) = start_rig(&mut flash);
    assert!(result.is_err());
    rig.receive(1, &Signer::new(KEY).unsigned(Version::V2, &setup(OTHER_KEY)));
    for _ in 0..30 {
        settle(&mut rig, &mut store);
        rig.run_for(secs(1));
    }
    assert!(rig.transmit(0)[0].is_signed_with(OTHER_KEY));
    assert!(!store.flash().bytes.windows(32).any(|bytes| bytes == KEY), "the old key is still stored");
    let mut rig = signing_rig();
    assert_eq!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)), Ok(()));
    rig.signing().set_key(mavstack::Instant::ZERO, SigningKey::new(OTHER_KEY), NOW);
    assert!(rig.transmit(0)[0].is_signed_with(OTHER_KEY));
}

/// Runs the world while storage runs, until the power is cut.
pub(crate) fn run(world: &mut World<1>, store: &mut Params<'_>, time: mavstack::Duration) {
    let end = world.now() + time;
    while world.now() < end && !store.flash().is_off() {
        world.step();
        world.stack.persist(world.now(), store, &mut world.vehicle);
    }
}

pub(crate) fn set(name: &str, param_value: f32) -> ParamSet {
    let param_type = MavParamType::REAL32;
    ParamSet { param_value, target_system: 1, target_component: 1, param_id: Text::new(name), param_type }
}

/// Starts a vehicle. Returns its store, and whether the parameters were restored.
pub(crate) fn start(flash: &mut Flash) -> (Params<'_>, World<1>, Result<(), RestoreError>) {
    let mut store = Params::new(flash, 0..PARAMS);
    let mut world = World::new(Setup::new());
    let result = of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
    (store, world, result)
}

/// Returns the flash of a vehicle with two parameters that do not have their defaults.
pub(crate) fn with_params() -> Flash {
    let mut flash = Flash::new(PARAMS);
    let (mut store, mut world, result) = start(&mut flash);
    assert_eq!(result, Ok(()));
    world.gcs[0].send(&set("CRUISE", 7.0));
    world.gcs[0].send(&set("RTL_ALT", 99.0));
    run(&mut world, &mut store, secs(3));
    flash
}

pub(crate) fn cruise_and_altitude(world: &World<1>) -> (f32, f32) {
    (world.stack.parameters().get(Tuning::CRUISE), world.stack.parameters().get(Tuning::RTL_ALT))
}

/// G-18: whichever bit of the page with the parameters flips, a text reports it, and they have their defaults.
#[test]
fn damaged_parameters_are_reported() {
    let whole = with_params();
    for bit in bits(&whole) {
        let mut flash = flipped(&whole, bit);
        for _ in 0..2 {
            let (mut store, mut world, result) = start(&mut flash);
            assert_eq!(result, Err(RestoreError::Damaged), "bit {bit}");
            assert_eq!(cruise_and_altitude(&world), (5.0, 30.0));
            run(&mut world, &mut store, millis(50));
            let text: Statustext = world.expect(0, millis(10));
            assert_eq!(text.text.as_str(), Some("Stored parameters are damaged"));
        }
    }
}

/// G-18, P-17: the newest parameters are damaged, and an older record is whole. It is restored, and the damage is reported until
/// parameters are stored again.
#[test]
fn older_parameters_replace_damaged_ones() {
    let mut whole = with_params();
    let (mut store, mut world, result) = start(&mut whole);
    assert_eq!(result, Ok(()));
    world.gcs[0].send(&set("RTL_ALT", 55.0));
    run(&mut world, &mut store, secs(3));
    for bit in bits_of_newest(&whole, PARAMETERS) {
        let mut flash = flipped(&whole, bit);
        for _ in 0..2 {
            let (mut store, mut world, result) = start(&mut flash);
            assert_eq!(result, Err(RestoreError::Damaged), "bit {bit}");
            assert_eq!(cruise_and_altitude(&world), (7.0, 99.0));
            run(&mut world, &mut store, millis(50));
            let text: Statustext = world.expect(0, millis(10));
            assert_eq!(text.text.as_str(), Some("Stored parameters are damaged"));
        }
        if bit % 61 != 0 {
            continue;
        }
        let mut store = Params::new(&mut flash, 0..PARAMS);
        let mut world = World::new(Setup { step: millis(20), ..Setup::<1>::new() });
        assert!(world.stack.restore(world.now(), &mut store, &mut world.vehicle).is_err());
        world.gcs[0].send(&set("CRUISE", 8.0));
        run(&mut world, &mut store, secs(3));
        let mut world = World::new(Setup::<1>::new());
        assert_eq!(of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle)), Ok(()));
        assert_eq!(cruise_and_altitude(&world), (8.0, 99.0));
    }
}

/// G-18: a request to store the parameters ends the report of damage, even if none has changed.
#[test]
fn a_request_to_save_ends_the_report_of_damaged_parameters() {
    let whole = with_params();
    let bit = bits(&whole).next().unwrap();
    for is_command in [false, true] {
        let mut flash = flipped(&whole, bit);
        let mut store = Params::new(&mut flash, 0..PARAMS);
        let mut world = World::new(Setup { step: millis(20), ..Setup::<1>::new() });
        let result = of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
        assert_eq!(result, Err(RestoreError::Damaged));
        // Nothing is written on its own.
        run(&mut world, &mut store, secs(30));
        assert_eq!(store.flash().bytes, flipped(&whole, bit).bytes);
        if is_command {
            world.gcs[0].command_long(MavCmd::PREFLIGHT_STORAGE, [1.0, f32::NAN, f32::NAN, 0.0, 0.0, 0.0, 0.0]);
        } else {
            world.stack.save_parameters(world.now());
        }
        run(&mut world, &mut store, secs(3));
        let mut world = World::new(Setup::<1>::new());
        assert_eq!(of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle)), Ok(()));
        assert_eq!(cruise_and_altitude(&world), (5.0, 30.0));
    }
}

/// P-17: the stored bytes, one by one: later versions must be able to read them. A row is the key of a parameter and its value. The
/// key is a checksum of the name and the type; its top bit says that the parameter has its default.
#[test]
fn the_layout_of_parameters_is_as_documented() {
    let flash = with_params();
    let (at, page) = pages::newest(&flash.bytes, PARAMETERS);
    assert_eq!((at, flash.bytes[..4].to_vec(), page.index, page.schema), (0, b"ML\x01\x02".to_vec(), 0, 1));
    let mut expected = Vec::new();
    for info in Tuning::INFO {
        let mut name = info.name().as_bytes().to_vec();
        name.resize(16, 0);
        let mut crc = crc_any::CRCu32::crc32();
        crc.digest(&name);
        crc.digest(&[info.param_type().0]);
        let (bits, is_default) = match info.name() {
            "CRUISE" => (7.0f32.to_bits(), false),
            "RTL_ALT" => (99.0f32.to_bits(), false),
            _ => (info.default_bits(), true),
        };
        let key = crc.get_crc() & !(1 << 31) | u32::from(is_default) << 31;
        expected.extend([key.to_le_bytes(), bits.to_le_bytes()].concat());
    }
    assert_eq!(page.payload, expected);
}

/// G-18, P-17: one read or eight consecutive reads fail at the start. Then a parameter is set, and the power is cut at any byte of
/// the write. The other parameters are unchanged, and this one has its old or its new value.
#[test]
fn a_failed_read_loses_no_parameter() {
    let whole = with_params();
    let mut counted = whole.clone();
    counted.reads = 0;
    let mut world = World::new(Setup::<1>::new());
    let mut store = Params::new(&mut counted, 0..PARAMS);
    of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle)).expect("readable");
    let reads = counted.reads;
    // The end of each page, each page of the segment, and the record.
    assert_eq!(reads, PARAMS / 256 + PARAMS / 512 + 1);
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
            let (_, world, result) = start(flash);
            assert_eq!(result, Ok(()));
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

/// Returns this flash with its only page changed. All checksums are correct.
fn with_page(flash: &Flash, change: impl FnOnce(&mut [u8; PAGE])) -> Flash {
    let mut flash = flash.clone();
    let [(at, page)] = &pages::pages(&flash.bytes)[..] else { panic!("there is one page") };
    let mut bytes = page.encode();
    change(&mut bytes);
    pages::seal(&mut bytes);
    flash.bytes[*at..at + PAGE].copy_from_slice(&bytes);
    flash
}

/// G-18: newer firmware wrote the key in a format that is not known. Links stay closed, and the record remains until a key is set.
#[test]
fn a_key_of_another_format_opens_no_link() {
    let mut flash = with_page(&with_key(), |page| page[236] = 2);
    let bytes = flash.bytes.clone();
    let (mut store, mut rig, result) = start_rig(&mut flash);
    assert_eq!(result, Err(RestoreError::Foreign));
    rig.run_for(secs(120));
    settle(&mut rig, &mut store);
    assert_eq!(armed_by(&mut rig), [false, false, true]);
    assert_eq!(store.flash().bytes, bytes);
    rig.receive(1, &Signer::new(KEY).unsigned(Version::V2, &setup(OTHER_KEY)));
    settle(&mut rig, &mut store);
    let mut rig = signing_rig();
    assert_eq!(of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle)), Ok(()));
    assert!(rig.transmit(0)[0].is_signed_with(OTHER_KEY));
}

/// G-18: newer firmware wrote the journal in a version that is not known. Everything counts as stored in another format, links stay
/// closed, and nothing is written, so that the newer firmware finds its data.
#[test]
fn a_log_of_another_version_is_not_written() {
    let another_version = |page: &mut [u8; PAGE]| (page[2], page[239]) = (2, page[239] & 0x0F | 2 << 4);
    let mut flash = with_page(&with_key(), another_version);
    let bytes = flash.bytes.clone();
    let mut store = Keys::new(&mut flash, 0..KEYS);
    let mut rig = signing_rig();
    let errors = rig.stack.restore(rig.now, &mut store, &mut rig.vehicle).expect_err("another version");
    let foreign = Some(RestoreError::Foreign);
    assert_eq!((errors.signing, errors.parameters, errors.region), (foreign, foreign, foreign));
    assert_eq!(armed_by(&mut rig), [false, false, true]);
    rig.set_key(OTHER_KEY);
    for _ in 0..100 {
        rig.run_for(secs(1));
        settle(&mut rig, &mut store);
    }
    assert_eq!(store.flash().bytes, bytes);

    // Parameters stay as they are set, and a sleeping loop is not woken for them. Uploads are answered ERROR at once.
    let mut flash = with_page(&with_fence(), another_version);
    let bytes = flash.bytes.clone();
    let (mut store, mut world, result) = start_plans(&mut flash);
    assert_eq!((result, world.stack.fence().items().len()), (Err(RestoreError::Foreign), 0));
    let began = world.now();
    assert_eq!(upload(&mut world, &mut store, &fence()), MavMissionResult::ERROR);
    assert!(world.now() - began <= secs(1));
    assert_eq!(store.flash().bytes, bytes);
    let mut flash = with_page(&with_params(), another_version);
    let mut store = Params::new(&mut flash, 0..PARAMS);
    let mut world = World::new(Setup::<1>::new());
    assert!(world.stack.restore(world.now(), &mut store, &mut world.vehicle).is_err());
    world.gcs[0].send(&set("CRUISE", 8.0));
    run(&mut world, &mut store, secs(3));
    assert!(passes(&mut world, &mut store) < 1_000);
    assert_eq!(cruise_and_altitude(&world), (8.0, 30.0));
}

/// Returns the number of passes of a sleeping loop in a minute.
fn passes(world: &mut World<1>, store: &mut Params<'_>) -> usize {
    let mut passes = 0;
    let end = world.now() + secs(60);
    while world.now() < end {
        world.skip_to(end);
        while world.stack.persist(world.now(), store, &mut world.vehicle) {}
        passes += 1;
    }
    passes
}

/// P-14, M-44: the region is too small for anything. Texts report what is not stored.
#[test]
fn a_region_that_is_too_small_is_reported() {
    let mut flash = Flash::new(PARAMS);
    for region in [0..0, 0..512, 1..1024, 256..1024] {
        let mut store = Params::new(&mut flash, region);
        let mut world = World::new(Setup::<1>::new());
        assert_eq!(world.stack.restore(world.now(), &mut store, &mut world.vehicle), Ok(()));
        assert!(!world.stack.is_restoring());
        world.gcs[0].send(&set("CRUISE", 8.0));
        run(&mut world, &mut store, secs(3));
        let text: Statustext = world.expect(0, millis(10));
        assert_eq!(text.text.as_str(), Some("Parameters not saved"));
        assert!(passes(&mut world, &mut store) < 1_000);
        let mut store = Plans::new(&mut flash, 0..0);
        let mut world = PlanWorld::of(Setup::new());
        assert_eq!(world.stack.restore(world.now(), &mut store, &mut world.vehicle), Ok(()));
        assert_eq!(upload(&mut world, &mut store, &fence()), MavMissionResult::ERROR);
    }
    assert_eq!((flash.writes, flash.erases), (0, 0));
}

/// Runs the world while storage runs.
fn run_plans(world: &mut PlanWorld, store: &mut Plans<'_>, time: mavstack::Duration) {
    let end = world.now() + time;
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

/// Starts a vehicle. Returns its store, and whether the plans were restored.
fn start_plans(flash: &mut Flash) -> (Plans<'_>, PlanWorld, Result<(), RestoreError>) {
    let mut store = Plans::new(flash, 0..PLANS);
    let mut world = PlanWorld::of(Setup::new());
    let result = of_plans(world.stack.restore(world.now(), &mut store, &mut world.vehicle));
    (store, world, result)
}

/// Returns the flash of a vehicle with a fence.
fn with_fence() -> Flash {
    let mut flash = Flash::new(PLANS);
    let (mut store, mut world, result) = start_plans(&mut flash);
    assert_eq!(result, Ok(()));
    assert_eq!(upload(&mut world, &mut store, &fence()), MavMissionResult::ACCEPTED);
    run_plans(&mut world, &mut store, secs(1));
    flash
}
