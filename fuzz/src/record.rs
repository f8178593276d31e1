//! Any flash contents and any power cut: a vehicle boots with nothing, with a complete record, or with an error (G-13, G-18,
//! M-5, M-44, P-17, SEC-11).
//!
//! ```text
//!   0  an image     bytes for both slots of a record of each kind
//!   1  a record     sequence number, body; the header and checksums are valid
//!   2  changes      effect of a power cut; then for each change: length, variant, steps until the cut (2 bytes)
//! ```

use crate::flash::{RamFlash, Torn};
use crate::support::{TestVehicle, Tuning};
use arbitrary::{Result, Unstructured};
use mavstack::dialect::{MavCmd, MavFrame};
use mavstack::param::ParamTable;
use mavstack::plan::PlanView;
use mavstack::signing::SigningKey;
use mavstack::storage::{RestoreError, RestoreErrors, Store};
use mavstack::{Address, Config, Instant, Item, LinkConfig, PlanType, Pulse};

mavstack::stack! {
    struct PlanStack for TestVehicle { links: 1, plans: { mission: 6, fence: 2, rally: 2 }, commands: { slots: 1 } }
}

mavstack::stack! {
    struct ParamStack for TestVehicle { links: 1, parameters: Tuning, commands: { slots: 1 } }
}

mavstack::stack! {
    struct SigningStack for TestVehicle { links: 1, signing, commands: { slots: 1 } }
}

type Flash = RamFlash<4, 256>;

const SLOT: usize = 768;
const REGION: u32 = 2 * SLOT as u32;
static PULSE: Pulse = Pulse::new();
const CONFIG: Config = Config::new(Address::new(1, 1), &PULSE);
const LINKS: [LinkConfig; 1] = [LinkConfig::uart(115_200)];

/// Runs the target.
pub fn run(data: &[u8]) {
    let mut u = Unstructured::new(data);
    let _ = match u.arbitrary::<u8>().unwrap_or(0) % 3 {
        0 => image(u),
        1 => record(u),
        _ => changes(u),
    };
}

/// Arbitrary flash contents.
fn image(mut u: Unstructured<'_>) -> Result<()> {
    let at = usize::from(u.arbitrary::<u16>()?) % (2 * SLOT);
    let mut bytes = vec![0xFF; 2 * SLOT];
    let image = u.take_rest();
    let len = image.len().min(bytes.len() - at);
    bytes[at..at + len].copy_from_slice(&image[..len]);
    let flash = Flash::of(bytes);
    start_plans(flash.clone());
    start_params(flash.clone());
    start_signing(flash);
    Ok(())
}

/// A record in the library's format with an arbitrary body and valid checksums.
fn record(mut u: Unstructured<'_>) -> Result<()> {
    let (kind, schema, sequence): (u8, u8, u32) = (u.arbitrary()?, u.arbitrary()?, u.arbitrary()?);
    let kind = 1 + kind % 3;
    let body = u.take_rest();
    let body = &body[..body.len().min(SLOT - 256) / 32 * 32];
    let mut slot = b"MVSR\x01".to_vec();
    slot.extend([0, kind, if schema < 250 { 0 } else { schema }]);
    slot.extend(sequence.to_le_bytes());
    slot.extend((body.len() as u32).to_le_bytes());
    slot.extend(crc(body));
    slot.extend([0; 8]);
    slot.extend(crc(&slot));
    slot.resize(256, 0xFF);
    slot.extend(body);
    slot.resize(2 * SLOT, 0xFF);
    let flash = Flash::of(slot);
    match kind {
        1 => start_plans(flash),
        2 => start_params(flash),
        _ => start_signing(flash),
    }
    Ok(())
}

fn crc(bytes: &[u8]) -> [u8; 4] {
    let mut crc = crc_any::CRCu32::crc32();
    crc.digest(bytes);
    crc.get_crc().to_le_bytes()
}

/// Returns the stored form of items, from which the plan id is computed.
fn bytes_of(items: &[Item]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for item in items {
        bytes.push(item.frame.0);
        bytes.extend(item.command.0.to_le_bytes());
        bytes.push(item.autocontinue);
        bytes.extend(item.params.iter().flat_map(|param| param.to_bits().to_le_bytes()));
        bytes.extend([item.x.to_le_bytes(), item.y.to_le_bytes(), item.z.to_bits().to_le_bytes()].concat());
    }
    bytes
}

fn new_stack() -> Box<PlanStack> {
    Box::new(PlanStack::new(CONFIG, LINKS))
}

/// Returns the live plans in their stored form.
fn live(stack: &PlanStack) -> [Vec<u8>; 3] {
    [stack.mission(), stack.fence(), stack.rally()].map(|plan: PlanView| {
        let items = bytes_of(plan.items());
        // M-5: the id is computed from the items; 0 for an empty plan.
        let id = if items.is_empty() { 0 } else { u32::from_le_bytes(crc(&items)).max(1) };
        assert_eq!(plan.id(), id);
        items
    })
}

fn restored(store: &mut Store<&mut Flash>, vehicle: &mut TestVehicle) -> Box<PlanStack> {
    let mut stack = new_stack();
    let result = stack.restore(Instant::ZERO, store, vehicle);
    assert!(store.flash().torn == Torn::Unreadable || is_readable(&result), "{result:?}");
    if !is_readable(&result) {
        // The header of an interrupted write cannot be read. It is read again once a second, and then ignored.
        for seconds in 1..=10 {
            let now = Instant::from_millis(seconds * 1_000);
            stack.poll(now, vehicle);
            stack.persist(now, store, vehicle);
        }
    }
    stack
}

/// Whether the flash was readable. It then has a complete record, is empty, or is reported as damaged or foreign (G-18).
fn is_readable<E>(result: &core::result::Result<(), RestoreErrors<E>>) -> bool {
    let Err(RestoreErrors { signing, parameters, plans, .. }) = result else { return true };
    [signing, parameters, plans].into_iter().flatten().all(|error| !matches!(error, RestoreError::Storage(_)))
}

/// Returns a mission. Missions of different `variant` differ.
fn mission(len: u8, variant: u8) -> Vec<Item> {
    let item = |seq| Item {
        frame: MavFrame::GLOBAL_RELATIVE_ALT,
        command: MavCmd::NAV_WAYPOINT,
        autocontinue: 1,
        params: [f32::from(variant), 0.0, 0.0, f32::NAN],
        // Never 0, 0, which is not a valid waypoint (M-48).
        x: i32::from(seq) + 1,
        y: i32::from(variant),
        z: 20.0,
    };
    (0..len % 7).map(item).collect()
}

fn start_plans(mut flash: Flash) {
    let mut vehicle = TestVehicle::new();
    let mut store = Store::new(&mut flash, 0..REGION);
    let mut stack = restored(&mut store, &mut vehicle);
    let [_, fence, rally] = live(&stack);
    // Restored plans are checked like uploads, so the same plan is accepted again.
    let items = stack.mission().items().to_vec();
    let loaded = new_stack().load_plan(Instant::ZERO, PlanType::Mission, items, &mut vehicle);
    assert_eq!(loaded, Ok(()), "the restored mission is valid");
    // A new plan is accepted, whatever the flash contained.
    let plan = mission(3, 7);
    assert_eq!(stack.load_plan(Instant::ZERO, PlanType::Mission, plan.iter().copied(), &mut vehicle), Ok(()));
    let mut steps = 0;
    while stack.persist(Instant::ZERO, &mut store, &mut vehicle) {
        steps += 1;
        assert!(steps < 1_000, "persisting does not end");
    }
    let again = restored(&mut store, &mut vehicle);
    assert_eq!(live(&again), [bytes_of(&plan), fence, rally]);
}

fn start_params(mut flash: Flash) {
    let mut vehicle = TestVehicle::new();
    let mut store = Store::new(&mut flash, 0..REGION);
    let mut stack = ParamStack::new(CONFIG, LINKS);
    let result = stack.restore(Instant::ZERO, &mut store, &mut vehicle);
    assert!(is_readable(&result), "{result:?}");
    assert_in_range(stack.parameters());
    // A change is stored, whatever the flash contained.
    stack.parameters_mut().set(Tuning::TRIM_ROLL, 11);
    stack.save_parameters(Instant::ZERO);
    let mut now = Instant::ZERO;
    for _ in 0..200 {
        now = now.after(crate::support::millis(100));
        stack.poll(now, &mut vehicle);
        stack.persist(now, &mut store, &mut vehicle);
    }
    let (mut again, mut vehicle) = (ParamStack::new(CONFIG, LINKS), TestVehicle::new());
    again.restore(Instant::ZERO, &mut store, &mut vehicle).expect("readable flash");
    assert_in_range(again.parameters());
    assert_eq!(again.parameters().get(Tuning::TRIM_ROLL), 11);
}

/// P-17: a stored value that is out of range is replaced by the default.
fn assert_in_range(tuning: &Tuning) {
    assert!((9.0..=12.6).contains(&tuning.get(Tuning::BAT_LOW)));
    assert!((0.5..=20.0).contains(&tuning.get(Tuning::CRUISE)));
    assert!((0..=4).contains(&tuning.get(Tuning::FENCE_ACT)));
    assert!((0.1..=3.0).contains(&tuning.get(Tuning::LAND_SPEED)));
    assert!((0.0..=120.0).contains(&tuning.get(Tuning::RTL_ALT)));
    assert!((1..=254).contains(&tuning.get(Tuning::SYS_ID)));
    assert!((-20..=20).contains(&tuning.get(Tuning::TRIM_ROLL)));
    assert!((-180.0..=180.0).contains(&tuning.get(Tuning::YAW_NOW)));
    assert_eq!(Tuning::INFO.len(), 9);
}

fn start_signing(mut flash: Flash) {
    let mut vehicle = TestVehicle::new();
    let mut store = Store::new(&mut flash, 0..REGION);
    let mut stack = SigningStack::new(CONFIG, LINKS);
    let result = stack.restore(Instant::ZERO, &mut store, &mut vehicle);
    assert!(is_readable(&result), "{result:?}");
    let signing = stack.signing_mut();
    let time = signing.timestamp(Instant::ZERO);
    assert!(time < 1 << 48, "a timestamp has 48 bits");
    signing.set_key(Instant::ZERO, SigningKey::new([9; 32]), 37_000_000_000_000);
    // A new key starts with its own timestamp (G-17).
    let time = signing.timestamp(Instant::ZERO);
    let mut steps = 0;
    while stack.persist(Instant::ZERO, &mut store, &mut vehicle) {
        steps += 1;
        assert!(steps < 1_000, "persisting does not end");
    }
    let mut again = SigningStack::new(CONFIG, LINKS);
    again.restore(Instant::ZERO, &mut store, &mut vehicle).expect("readable flash");
    let signing = again.signing();
    assert!(signing.is_active(), "the key is restored");
    assert!(signing.timestamp(Instant::ZERO) >= time, "G-15: the timestamp does not go back");
}

/// Changes plans one after the other and cuts the power at any step. After each cut the old or the new plan is present.
fn changes(mut u: Unstructured<'_>) -> Result<()> {
    let mut flash = Flash::new(REGION);
    flash.torn = [Torn::Prefix, Torn::Garbage, Torn::Unreadable][usize::from(u.arbitrary::<u8>()? % 3)];
    let mut old = [vec![], vec![], vec![]];
    for _ in 0..16 {
        if u.is_empty() {
            break;
        }
        let (len, variant, fuel): (u8, u8, u16) = (u.arbitrary()?, u.arbitrary()?, u.arbitrary()?);
        flash.fuel = (fuel < 0xFF00).then_some(u64::from(fuel % 1_200));
        let mut vehicle = TestVehicle::new();
        // No power cut while restoring.
        let fuel = flash.fuel.take();
        let mut store = Store::new(&mut flash, 0..REGION);
        let mut stack = restored(&mut store, &mut vehicle);
        assert_eq!(live(&stack), old, "the same plan is found again");
        store.flash_mut().fuel = fuel;
        let plan = mission(len, variant);
        let new = [bytes_of(&plan), vec![], vec![]];
        assert_eq!(stack.load_plan(Instant::ZERO, PlanType::Mission, plan, &mut vehicle), Ok(()));
        // Later than the time that restoring may have used.
        let mut now = Instant::from_millis(20_000);
        for _ in 0..100 {
            now = now.after(crate::support::millis(50));
            stack.poll(now, &mut vehicle);
            stack.persist(now, &mut store, &mut vehicle);
        }
        let is_complete = !store.flash().is_off();
        store.flash_mut().power_on();
        let found = live(&restored(&mut store, &mut vehicle));
        assert!(found == new || (!is_complete && found == old), "neither the old plan nor the new one");
        old = found;
    }
    Ok(())
}
