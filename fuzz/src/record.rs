//! Any flash content and any power cut: a vehicle starts with nothing, with a whole record, or with an error (G-13, G-18,
//! GOAL-8, GOAL-9, M-5, M-44, P-17).
//!
//! ```text
//!   0  the image      bytes, spread over both slots of all three stores
//!   1  a record       sequence number, body: everything around it is right
//!   2  changes        what a cut leaves behind; each: length, number, how far the power lasts (2 bytes)
//! ```

use crate::flash::{RamFlash, Torn};
use crate::support::TestVehicle;
use arbitrary::{Result, Unstructured};
use mavstack::dialect::{MavCmd, MavFrame};
use mavstack::{
    Address, Config, Durability, Instant, Item, LinkConfig, ParamStore, ParamTable, PlanStore, PlanType, PlanView,
    Pulse, RestoreError, SigningKey, SigningMemory, SigningStore, Stack, plan_memory,
};

type Plans = plan_memory!(mission: 6, fence: 2, rally: 2);
type TestStack = Stack<1, Plans>;
type Flash = RamFlash<4, 256>;

const SLOT: usize = 768;
const REGION: u32 = 2 * SLOT as u32;
static PULSE: Pulse = Pulse::new();

/// Fills flash, or changes what is stored and cuts the power.
pub fn run(data: &[u8]) {
    let mut u = Unstructured::new(data);
    let _ = match u.arbitrary::<u8>().unwrap_or(0) % 3 {
        0 => image(u),
        1 => record(u),
        _ => changes(u),
    };
}

/// Whatever lies there.
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

/// A record of our format with this body; every checksum is right.
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

/// What is stored of items, and what their id is computed from.
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

fn new_stack() -> Box<TestStack> {
    Box::new(Stack::new(Config::new(Address::new(1, 1), &PULSE), [LinkConfig::uart(115_200)]))
}

/// What is live, bit by bit.
fn live(stack: &TestStack) -> [Vec<u8>; 3] {
    [stack.mission(), stack.fence(), stack.rally()].map(|plan: PlanView| {
        let items = bytes_of(plan.items());
        // M-5: an id is that of the items, or 0 for none.
        let id = if items.is_empty() { 0 } else { u32::from_le_bytes(crc(&items)).max(1) };
        assert_eq!(plan.id(), id);
        items
    })
}

fn restored(store: &mut PlanStore<&mut Flash>, vehicle: &mut TestVehicle) -> Box<TestStack> {
    let mut stack = new_stack();
    let result = stack.restore_plans(Instant::ZERO, store, Durability::Durable, vehicle);
    assert!(store.flash().torn == Torn::Unreadable || is_readable(&result), "{result:?}");
    if !is_readable(&result) {
        // A header that was cut off and cannot be read: it is read again, once a second, and then it does not count.
        for seconds in 1..=10 {
            let now = Instant::from_millis(seconds * 1_000);
            stack.poll(now, vehicle);
            stack.persist_plans(now, store, vehicle);
        }
    }
    stack
}

/// Readable flash has a whole record, is empty, or is reported as damaged or foreign (G-18).
fn is_readable<E>(result: &core::result::Result<(), RestoreError<E>>) -> bool {
    !matches!(result, Err(RestoreError::Storage(_)))
}

/// A number of waypoints, no two plans of different `variant` alike.
fn mission(len: u8, variant: u8) -> Vec<Item> {
    let item = |seq| Item {
        frame: MavFrame::GLOBAL_RELATIVE_ALT,
        command: MavCmd::NAV_WAYPOINT,
        autocontinue: 1,
        params: [f32::from(variant), 0.0, 0.0, f32::NAN],
        // Never 0, 0, which is no waypoint (M-48).
        x: i32::from(seq) + 1,
        y: i32::from(variant),
        z: 20.0,
    };
    (0..len % 7).map(item).collect()
}

fn start_plans(mut flash: Flash) {
    let mut vehicle = TestVehicle::new();
    let mut store = PlanStore::new(&mut flash, 0..REGION);
    let mut stack = restored(&mut store, &mut vehicle);
    let [_, fence, rally] = live(&stack);
    // What is live was checked as an upload is, so uploading it again is accepted.
    let items = stack.mission().items().to_vec();
    let loaded = new_stack().load_plan(Instant::ZERO, PlanType::Mission, items, &mut vehicle);
    assert_eq!(loaded, Ok(()), "what was restored can be flown");
    // And it takes a plan, whatever there was.
    let plan = mission(3, 7);
    assert_eq!(stack.load_plan(Instant::ZERO, PlanType::Mission, plan.iter().copied(), &mut vehicle), Ok(()));
    let mut steps = 0;
    while stack.persist_plans(Instant::ZERO, &mut store, &mut vehicle) {
        steps += 1;
        assert!(steps < 1_000, "it ends");
    }
    let again = restored(&mut store, &mut vehicle);
    assert_eq!(live(&again), [bytes_of(&plan), fence, rally]);
}

fn start_params(mut flash: Flash) {
    let mut vehicle = TestVehicle::new();
    let mut store = ParamStore::new(&mut flash, 0..REGION);
    let mut stack = new_stack();
    let result = stack.restore_parameters(Instant::ZERO, &mut store, &mut vehicle);
    assert!(is_readable(&result), "{result:?}");
    within_bounds(&vehicle);
    // And it keeps a change, whatever there was.
    vehicle.tuning.set(crate::support::Tuning::TRIM_ROLL, 11);
    stack.save_parameters(Instant::ZERO, &mut vehicle);
    let mut now = Instant::ZERO;
    for _ in 0..200 {
        now = now.after(crate::support::millis(100));
        stack.poll(now, &mut vehicle);
        stack.persist_parameters(now, &mut store, &mut vehicle);
    }
    let mut again = TestVehicle::new();
    new_stack().restore_parameters(Instant::ZERO, &mut store, &mut again).expect("flash that can be read");
    within_bounds(&again);
    assert_eq!(again.tuning.get(crate::support::Tuning::TRIM_ROLL), 11);
}

/// P-17: a value that is out of its range is the default.
fn within_bounds(vehicle: &TestVehicle) {
    use crate::support::Tuning;
    let tuning = &vehicle.tuning;
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
    vehicle.signing = Some(SigningMemory::new());
    let mut store = SigningStore::new(&mut flash, 0..REGION);
    let mut stack = new_stack();
    let result = stack.restore_signing(Instant::ZERO, &mut store, &mut vehicle);
    assert!(is_readable(&result), "{result:?}");
    let signing = vehicle.signing.as_mut().expect("a memory for signing");
    let time = signing.timestamp(Instant::ZERO);
    assert!(time < 1 << 48, "a timestamp has 48 bits");
    signing.set_key(Instant::ZERO, SigningKey::new([9; 32]), 37_000_000_000_000);
    // Another key begins with its own time (G-17).
    let time = signing.timestamp(Instant::ZERO);
    let mut steps = 0;
    while stack.persist_signing(Instant::ZERO, &mut store, &mut vehicle) {
        steps += 1;
        assert!(steps < 1_000, "it ends");
    }
    let mut again = TestVehicle::new();
    again.signing = Some(SigningMemory::new());
    new_stack().restore_signing(Instant::ZERO, &mut store, &mut again).expect("flash that can be read");
    let signing = again.signing.as_mut().expect("a memory for signing");
    assert!(signing.is_active(), "the key is there");
    assert!(signing.timestamp(Instant::ZERO) >= time, "G-15: time goes on");
}

/// Plans are changed, one after the other, with the power cut anywhere: there is always the old one, or the new.
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
        // The power may go while it is read, too.
        let fuel = flash.fuel.take();
        let mut store = PlanStore::new(&mut flash, 0..REGION);
        let mut stack = restored(&mut store, &mut vehicle);
        assert_eq!(live(&stack), old, "what was found is found again");
        store.flash_mut().fuel = fuel;
        let plan = mission(len, variant);
        let new = [bytes_of(&plan), vec![], vec![]];
        assert_eq!(stack.load_plan(Instant::ZERO, PlanType::Mission, plan, &mut vehicle), Ok(()));
        // After what restoring took.
        let mut now = Instant::from_millis(20_000);
        for _ in 0..100 {
            now = now.after(crate::support::millis(50));
            stack.poll(now, &mut vehicle);
            stack.persist_plans(now, &mut store, &mut vehicle);
        }
        let is_whole = !store.flash().is_off();
        store.flash_mut().power_on();
        let found = live(&restored(&mut store, &mut vehicle));
        assert!(found == new || (!is_whole && found == old), "neither the old one nor the new");
        old = found;
    }
    Ok(())
}
