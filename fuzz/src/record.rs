//! Any flash contents, any damage and any power cut: a vehicle boots with complete content, or reports what is damaged (G-13, G-18,
//! M-5, M-44, P-17, SEC-11).
//!
//! ```text
//!   0  an image     geometry; where it begins (2 bytes); bytes of the flash
//!   1  records      geometry; then for each: kind, flags, length, content; the pages and their checksums are valid
//!   2  a journal      geometry, effect of a power cut; then a script of saves, cuts and damage
//! ```

mod model;
mod pages;

use crate::flash::{RamFlash, Torn};
use crate::support::{Tuning, millis};
use arbitrary::{Result, Unstructured};
use mavstack::dialect::{MavCmd, MavFrame, MavResult, MissionState, rules};
use mavstack::param::ParamTable;
use mavstack::plan::PlanView;
use mavstack::signing::SigningKey;
use mavstack::storage::{Records, RestoreError, RestoreErrors, Store};
use mavstack::{
    Address, Command, CommandRule, Commands, Config, Context, Instant, Item, LinkConfig, Outcome, Parameters,
    PlanChange, PlanType, Plans, Progress, Pulse, StackOf, Vehicle, VehicleState,
};

/// The number of the vehicle's own records.
const RECORDS: usize = 3;

#[derive(mavstack::Stack)]
#[stack(
    vehicle: Keeper,
    links: 1,
    plans: { mission: 12, fence: 2, rally: 2 },
    parameters: Tuning,
    signing,
    storage: { records: RECORDS },
)]
struct Keeping;

static PULSE: Pulse = Pulse::new();
const CONFIG: Config = Config::new(Address::new(1, 1), &PULSE);
const LINKS: [LinkConfig; 1] = [LinkConfig::uart(115_200)];
/// The time of the first key, in units of 10 µs, and the time between two keys: two days. Each restart moves the time on by a minute.
const KEY_TIME: u64 = 37_000_000_000_000;
const KEY_STEP: u64 = 20_000_000_000;

/// A vehicle that keeps records.
#[derive(Default)]
struct Keeper {
    records: [Vec<u8>; RECORDS],
}

impl Vehicle for Keeper {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(false))
    }
}

impl Commands for Keeper {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}

impl Plans for Keeper {
    const MISSION_COMMANDS: &'static [CommandRule] = &[rules::NAV_WAYPOINT];

    fn plan_changed(&mut self, _: &mut Context<'_>, _: PlanChange<'_>) {}

    fn progress(&self) -> Progress {
        Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
    }
}

impl Parameters for Keeper {
    type Table = Tuning;
}

impl Records for Keeper {
    fn load_record(&mut self, _: &mut Context<'_>, number: u8, bytes: &[u8]) {
        self.records[usize::from(number)] = bytes.to_vec();
    }

    fn save_record(&mut self, _: &mut Context<'_>, number: u8, bytes: &mut [u8]) -> usize {
        let record = &self.records[usize::from(number)];
        bytes[..record.len()].copy_from_slice(record);
        record.len()
    }
}

/// What a vehicle keeps: one value for each kind. Empty if nothing is stored.
pub(crate) type Values = [Vec<u8>; KINDS.len()];

/// The kinds of records: plans, parameters, key, and the vehicle's own.
pub(crate) const KINDS: [u8; 3 + RECORDS] = [1, 2, 3, 128, 129, 130];
const PLANS: usize = 0;
const PARAMETERS: usize = 1;
const KEY: usize = 2;
const OWN: usize = 3;

/// A vehicle with its flash.
pub(crate) struct Device<const W: usize, const E: usize> {
    stack: Box<StackOf<Keeping>>,
    keeper: Keeper,
    pub(crate) store: Store<RamFlash<W, E>>,
    now: Instant,
}

impl<const W: usize, const E: usize> Device<W, E> {
    /// Boots with these contents, and waits for everything that is read late or written on its own.
    pub(crate) fn boot(mut flash: RamFlash<W, E>) -> Self {
        flash.power_on();
        let len = flash.bytes.len() as u32;
        assert!(Store::<RamFlash<W, E>>::region_len::<Keeping>() <= len, "the region has room for everything");
        let (stack, keeper) = (Box::new(StackOf::<Keeping>::new(CONFIG, LINKS)), Keeper::default());
        let mut device = Self { stack, keeper, store: Store::new(flash, 0..len), now: Instant::ZERO };
        let result = device.stack.restore(device.now, &mut device.store, &mut device.keeper);
        assert_eq!(result.err().unwrap_or_default(), device.stack.restore_errors());
        device.settle();
        // Many pages that cannot be read are given up after a minute.
        for _ in 0..10 {
            if device.errors().plans == Some(RestoreError::Unreadable) {
                device.settle();
            }
        }
        device
    }

    /// Boots again with the same flash.
    pub(crate) fn reboot(self) -> Self {
        Self::boot(self.store.into_inner())
    }

    /// Runs for some seconds. Storage then has nothing to do, because it does not wait longer for anything.
    pub(crate) fn settle(&mut self) {
        for _ in 0..12 {
            self.now += millis(1_000);
            self.stack.poll(self.now, &mut self.keeper);
            let mut steps = 0;
            while self.stack.persist(self.now, &mut self.store, &mut self.keeper) {
                steps += 1;
                assert!(steps < 2_000, "persisting does not end");
            }
        }
    }

    pub(crate) fn errors(&self) -> RestoreErrors {
        self.stack.restore_errors()
    }

    /// Returns for each kind whether it is reported as damaged. The vehicle's own records share an error.
    pub(crate) fn damaged(&self) -> [bool; KINDS.len()] {
        let RestoreErrors { signing, parameters, plans, records, .. } = self.errors();
        let of = |index| [plans, parameters, signing, records][std::cmp::min(index, OWN)];
        std::array::from_fn(|index| match of(index) {
            None => false,
            Some(RestoreError::Damaged) => true,
            Some(error) => panic!("kind {}: {error}", KINDS[index]),
        })
    }

    /// Returns what the vehicle has.
    pub(crate) fn values(&self) -> Values {
        let tuning = self.stack.parameters();
        assert_in_range(tuning);
        let trim = tuning.get(Tuning::TRIM_ROLL);
        let parameters = if trim == -3 { Vec::new() } else { trim.to_le_bytes().to_vec() };
        let signing = self.stack.signing();
        let time = signing.timestamp(self.now);
        assert!(time < 1 << 48, "a timestamp has 48 bits");
        let key = if signing.is_active() { vec![(time.saturating_sub(KEY_TIME) / KEY_STEP) as u8] } else { Vec::new() };
        let [a, b, c] = self.keeper.records.clone();
        [live(&self.stack), parameters, key, a, b, c]
    }

    /// Changes a kind to a value of this variant, which is not 0, and returns what the vehicle will have.
    pub(crate) fn change(&mut self, index: usize, variant: u8) -> Vec<u8> {
        assert!(variant > 0);
        match index {
            PLANS => {
                let plan = mission(1 + variant % 12, variant);
                let loaded = self.stack.load_plan(self.now, PlanType::Mission, plan.iter().copied(), &mut self.keeper);
                assert_eq!(loaded, Ok(()));
                // The other plans are not changed.
                live_with(&self.stack, Some(&plan))
            }
            PARAMETERS => {
                let trim = variant.cast_signed() % 20;
                let trim = if trim == -3 { 20 } else { trim };
                self.stack.parameters_mut().set(Tuning::TRIM_ROLL, trim);
                self.stack.save_parameters(self.now);
                trim.to_le_bytes().to_vec()
            }
            KEY => {
                let time = KEY_TIME + u64::from(variant) * KEY_STEP;
                self.stack.signing_mut().set_key(self.now, SigningKey::new([variant; 32]), time);
                vec![variant]
            }
            _ => {
                let number = index - OWN;
                let record = vec![variant; 1 + usize::from(variant) % 224];
                self.keeper.records[number].clone_from(&record);
                self.stack.save_record(number as u8);
                record
            }
        }
    }

    /// P-17, M-5: whatever was restored is valid.
    fn check(&self) {
        for (plan, view) in [PlanType::Mission, PlanType::Fence, PlanType::Rally].into_iter().zip(plans(&self.stack)) {
            let mut other = Box::new(StackOf::<Keeping>::new(CONFIG, LINKS));
            let items = view.items().iter().copied();
            // Restored plans are checked like uploads, so the same plan is accepted again.
            let loaded = other.load_plan(Instant::ZERO, plan, items, &mut Keeper::default());
            assert_eq!(loaded, Ok(()), "the restored {plan:?} is valid");
        }
    }
}

fn plans(stack: &StackOf<Keeping>) -> [PlanView<'_>; 3] {
    [stack.mission(), stack.fence(), stack.rally()]
}

fn live(stack: &StackOf<Keeping>) -> Vec<u8> {
    live_with(stack, None)
}

/// Returns the live plans in their stored form, or these plans with another mission.
fn live_with(stack: &StackOf<Keeping>, mission: Option<&[Item]>) -> Vec<u8> {
    let mut all = Vec::new();
    for (index, plan) in plans(stack).into_iter().enumerate() {
        let items = bytes_of(plan.items());
        // M-5: the id is computed from the items; 0 for an empty plan.
        let id = if items.is_empty() { 0 } else { pages::crc(&items).max(1) };
        assert_eq!(plan.id(), id);
        let items = if index == 0 { mission.map_or(items, bytes_of) } else { items };
        if !items.is_empty() {
            all.push(index as u8);
            all.extend(items);
        }
    }
    all
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
    (0..len).map(item).collect()
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

/// Runs the target.
pub fn run(data: &[u8]) {
    let mut u = Unstructured::new(data);
    let [mode, geometry] = [0; 2].map(|_: u8| u.arbitrary::<u8>().unwrap_or(0));
    // Write unit, erase unit, length: flash of serial NOR, of an STM32G4, an FRAM, flash with ECC, with an odd number of units.
    let _ = match geometry % 5 {
        0 => play::<4, 4_096>(mode, 4, u),
        1 => play::<8, 2_048>(mode, 8, u),
        2 => play::<1, 256>(mode, 20, u),
        3 => play::<32, 1_024>(mode, 7, u),
        _ => play::<256, 512>(mode, 11, u),
    };
}

fn play<const W: usize, const E: usize>(mode: u8, units: usize, mut u: Unstructured<'_>) -> Result<()> {
    let least = Store::<RamFlash<W, E>>::region_len::<Keeping>() as usize / E;
    let flash = RamFlash::<W, E>::new((units.max(least) * E) as u32);
    match mode % 3 {
        0 => image(flash, u),
        1 => {
            let flash = pages::records(flash, &mut u)?;
            start(flash);
            Ok(())
        }
        _ => {
            let torn = [Torn::Prefix, Torn::Garbage, Torn::Unreadable][usize::from(u.arbitrary::<u8>()? % 3)];
            model::play(RamFlash { torn, ..flash }, u)
        }
    }
}

/// Arbitrary flash contents.
fn image<const W: usize, const E: usize>(mut flash: RamFlash<W, E>, mut u: Unstructured<'_>) -> Result<()> {
    let at = usize::from(u.arbitrary::<u16>()?) % flash.bytes.len();
    let image = u.take_rest();
    let len = image.len().min(flash.bytes.len() - at);
    flash.bytes[at..at + len].copy_from_slice(&image[..len]);
    start(flash);
    Ok(())
}

/// Boots with any contents. What is written then is found again, and everything else remains as it was restored.
fn start<const W: usize, const E: usize>(flash: RamFlash<W, E>) {
    let device = Device::boot(flash);
    device.check();
    if device.errors().region == Some(RestoreError::Foreign) {
        // Newer firmware wrote the journal: not a byte of it changes.
        let before = device.store.flash().bytes.clone();
        let mut device = device;
        for index in 0..KINDS.len() {
            device.change(index, 7);
        }
        device.settle();
        assert!(device.store.flash().bytes == before, "a journal of another version was written");
        return;
    }
    let foreign = pages::kept(&device.store.flash().bytes);
    let mut device = device.reboot();
    let mut expected = device.values();
    for index in 0..KINDS.len() {
        expected[index] = device.change(index, 7);
        device.settle();
        device = device.reboot();
        assert_eq!(device.values(), expected, "after kind {} was written", KINDS[index]);
    }
    assert_eq!(device.errors(), RestoreErrors::default(), "everything is new");
    let kept = pages::kept(&device.store.flash().bytes);
    for (kind, content) in foreign {
        assert_eq!(kept.get(&kind), Some(&content), "a record of other firmware is lost");
    }
}

#[cfg(test)]
mod tests {
    /// The newest record of the key begins a unit and is damaged. The write of a plan erased it and was cut off, and an older key
    /// took its place unreported (G-18).
    #[test]
    fn evidence_of_damage_at_the_beginning_of_a_unit_stays() {
        const SCRIPT: &[u8] = &[
            2, 2, 0, 0, 20, 255, 255, 2, 7, 255, 255, 6, 3, 3, 255, 0, 0, 0, 0, 0, 0, 0, 33, 0, 230, 1, 6, 4, 15, 1, 2,
            255, 255,
        ];
        super::run(SCRIPT);
    }

    /// The pages that opened the two newest segments are both damaged. The kind of the newest one was reported, and the other kind
    /// had an older value (G-18).
    #[test]
    fn two_damaged_openings_are_both_reported() {
        const SCRIPT: &[u8] = &[
            2, 4, 5, 89, 153, 42, 220, 136, 220, 111, 0, 89, 201, 161, 210, 64, 217, 227, 5, 214, 67, 136, 137, 216,
            108, 80, 0, 120, 161, 175, 159, 119, 129, 69, 5, 24, 47, 248, 28, 177, 40, 46, 2, 96, 111,
        ];
        super::run(SCRIPT);
    }

    /// The newest plans are damaged, and an older record is live. To load the same plan again wrote nothing, so the damage stayed on
    /// record (G-18).
    #[test]
    fn a_plan_that_is_live_replaces_a_damaged_one() {
        const SCRIPT: &[u8] = &[
            2, 4, 7, 163, 97, 105, 182, 194, 255, 25, 4, 252, 184, 182, 208, 242, 13, 198, 5, 200, 6, 142, 86, 68, 18,
            176, 2, 49, 133, 186, 80, 168, 20, 84, 2, 127, 50, 251, 15, 113, 167, 95, 7, 67, 10, 168, 107, 188, 178,
            96, 6, 219, 4, 0, 76, 142, 0, 70, 4, 13, 15, 7, 186, 69,
        ];
        super::run(SCRIPT);
    }

    /// The page that opened the only segment, and one after it, are damaged. The kind of the first one was not reported (G-18).
    #[test]
    fn a_record_before_a_damaged_opening_is_reported() {
        const SCRIPT: &[u8] = &[
            2, 3, 4, 239, 168, 180, 28, 202, 237, 9, 0, 92, 86, 147, 84, 65, 54, 135, 1, 158, 110, 51, 191, 129, 221,
            86, 3, 215, 71, 224, 127, 233, 139, 27,
        ];
        super::run(SCRIPT);
    }

    /// The page that opened the newest segment is damaged, and a page of a much older one is whole. Its parameters were restored,
    /// unreported (G-18).
    #[test]
    fn a_remnant_of_an_old_segment_is_not_restored_unreported() {
        const SCRIPT: &[u8] = &[
            2, 3, 2, 110, 241, 100, 249, 19, 9, 101, 5, 64, 79, 32, 120, 5, 145, 19, 6, 97, 227, 228, 176, 183, 64,
            121, 4, 160, 109, 36, 5, 59, 85, 198, 5, 82, 180, 61, 46, 249, 243, 181, 2, 208, 186, 121, 165, 179, 223,
            45, 3, 63, 238, 252, 92, 180, 243, 255,
        ];
        super::run(SCRIPT);
    }

    /// Both pages of the newest plans are damaged, the second at its end, and so is the page of a write that was cut off after
    /// them: nothing shows that the plans were ever whole.
    #[test]
    fn three_damaged_pages_look_like_two_cuts() {
        const SCRIPT: &[u8] =
            &[2, 3, 5, 132, 72, 114, 18, 80, 223, 23, 7, 208, 188, 3, 33, 119, 8, 99, 5, 237, 172, 162, 144, 120, 204];
        super::run(SCRIPT);
    }

    /// Plays random scripts, this many of each mode and geometry: a search without the fuzzer.
    fn search(count: u32, seed: u64) {
        let mut state = 0x9E37_79B9_7F4A_7C15 ^ seed;
        let mut random = move || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 32) as u8
        };
        for _ in 0..count {
            for mode in 0..3 {
                for geometry in 0..5 {
                    let len = 4 + usize::from(random()) % 60;
                    let mut script = vec![mode, geometry];
                    script.extend((0..len).map(|_| random()));
                    if mode == 2 {
                        // Damage usually meets one of the newest pages.
                        (0..len).step_by(8).for_each(|at| script[2 + at] &= 0x07);
                    }
                    if let Err(panic) = std::panic::catch_unwind(|| super::run(&script)) {
                        println!("{script:?}");
                        std::panic::resume_unwind(panic);
                    }
                }
            }
        }
    }

    #[test]
    fn random_scripts_pass() {
        search(20, 0);
    }

    /// `MAVSTACK_SEED` begins another search.
    #[test]
    #[ignore = "takes an hour; `cargo measure nightly` runs it"]
    fn ten_million_random_scripts_pass() {
        let seed = std::env::var("MAVSTACK_SEED").map_or(0, |seed| seed.parse().expect("a number"));
        search(670_000, seed);
    }
}
