//! The flash driver of `examples/boards/stm32f405` on a model of the controller: a mission survives power cuts in each erase and
//! program.

#[path = "../../examples/boards/stm32f405/src/flash/driver.rs"]
#[allow(dead_code, reason = "it is a module of a firmware")]
mod driver;

use crate::support::*;
use crate::{of_plans, setup};
use driver::{Driver, Error, Hardware, REGION, Register};
use embedded_storage::nor_flash::{NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use mavstack::dialect::MavCmd;
use mavstack::plan::Durability;
use mavstack::storage::Store;
use mavstack::{Config, Instant, Item, PlanType};
use std::cell::RefCell;
use std::ops::Range;

#[derive(mavstack::Stack)]
#[stack(vehicle: TestVehicle, links: 1, plans: { mission: 20 }, commands: { slots: 1 }, storage)]
struct Mavlink;

/// A boot loader, the firmware, and the region: 16, 64 and 128 KiB.
const SECTORS: [u32; 12] = [16, 16, 16, 16, 64, 128, 128, 128, 128, 128, 128, 128];
const LAST: [usize; 2] = [10, 11];

const WRITE_PROTECTED: u32 = 1 << 4;
const WRONG_SIZE: u32 = 1 << 6;
const WRONG_SEQUENCE: u32 = 1 << 7;
const BUSY: u32 = 1 << 16;
const PROGRAM: u32 = 1 << 0;
const ERASE: u32 = 1 << 1;
const SIZE: u32 = 0b11 << 8;
const START: u32 = 1 << 16;
const LOCK: u32 = 1 << 31;
const CACHE: u32 = 1 << 10;
const CACHE_RESET: u32 = 1 << 12;

/// The number of reads of the status for which an operation is busy.
const ERASE_TIME: u32 = 1_000;
const PROGRAM_TIME: u32 = 2;
/// The steps of an erase: before, in the middle, almost finished.
const ERASE_STEPS: u64 = 3;
/// The lines of the data cache, and their length in bytes.
const LINES: usize = 8;
const LINE: usize = 16;

/// An STM32F405's flash and its controller, by RM0090, section 3. What hardware ignores or forbids fails the test, unless it has an error
/// flag.
#[derive(Clone)]
struct Chip {
    bytes: Vec<u8>,
    status: u32,
    control: u32,
    access: u32,
    /// The keys that were received, and whether a wrong one was.
    keys: usize,
    is_blocked: bool,
    /// Reads of the status until the operation has ended.
    busy: u32,
    /// The lines of the data cache: their number and content. The oldest is the first.
    cache: Vec<(usize, Vec<u8>)>,
    /// Sectors that the option bytes protect.
    protected: Vec<usize>,
    erases: [u32; 12],
    /// The steps so far: a programmed byte is one, an erase is three. And at which the power is cut.
    steps: u64,
    cut: Option<u64>,
}

/// Returns where a sector is.
fn place(sector: usize) -> Range<usize> {
    let start: u32 = SECTORS[..sector].iter().sum();
    start as usize * 1024..(start + SECTORS[sector]) as usize * 1024
}

impl Chip {
    /// A flash whose sectors are filled with their number.
    fn new() -> Self {
        let bytes = (0..SECTORS.len()).flat_map(|sector| place(sector).map(move |_| sector as u8)).collect();
        let (cache, protected) = (Vec::new(), Vec::new());
        Self {
            bytes,
            status: 0,
            control: LOCK,
            access: 0,
            keys: 0,
            is_blocked: false,
            busy: 0,
            cache,
            protected,
            erases: [0; 12],
            steps: 0,
            cut: None,
        }
    }

    /// Resets the controller, and restores the power.
    fn restart(&mut self) {
        (self.status, self.control, self.access, self.keys, self.is_blocked, self.busy) = (0, LOCK, 0, 0, false, 0);
        self.cache.clear();
        self.cut = None;
    }

    fn is_off(&self) -> bool {
        self.cut.is_some_and(|cut| self.steps >= cut)
    }

    /// Takes up to this many steps. Returns how many the power sufficed for.
    fn step(&mut self, steps: u64) -> u64 {
        let taken = self.cut.map_or(steps, |cut| steps.min(cut - self.steps));
        self.steps += taken;
        taken
    }

    fn is_protected(&self, offset: usize) -> bool {
        self.protected.iter().any(|sector| place(*sector).contains(&offset))
    }

    fn erase(&mut self) {
        let sector = (self.control >> 3 & 0xF) as usize;
        let place = place(sector);
        if self.is_protected(place.start) {
            self.status |= WRITE_PROTECTED;
            return;
        }
        let steps = self.step(ERASE_STEPS);
        let middle = (place.start + place.end) / 2;
        let bytes = &mut self.bytes;
        match steps {
            0 => {}
            1 => bytes[place.start..middle].fill(0xFF),
            // Weakly erased.
            2 => bytes[place].iter_mut().enumerate().for_each(|(index, byte)| *byte |= index as u8 | 0x5A),
            _ => {
                bytes[place].fill(0xFF);
                self.erases[sector] += 1;
            }
        }
        self.busy = ERASE_TIME;
    }

    /// The sectors that have not their first content any more.
    fn changed(&self) -> Vec<usize> {
        (0..SECTORS.len())
            .filter(|sector| self.bytes[place(*sector)].iter().any(|byte| *byte != *sector as u8))
            .collect()
    }
}

impl Hardware for &RefCell<Chip> {
    fn read(&mut self, register: Register) -> u32 {
        let mut chip = self.borrow_mut();
        match register {
            _ if chip.is_off() => 0,
            Register::Access => chip.access,
            Register::Key => 0,
            Register::Control => chip.control,
            Register::Status => {
                chip.busy = chip.busy.saturating_sub(1);
                chip.status | if chip.busy > 0 { BUSY } else { 0 }
            }
        }
    }

    fn write(&mut self, register: Register, value: u32) {
        let mut chip = self.borrow_mut();
        match register {
            _ if chip.is_off() => {}
            Register::Access => {
                if value & CACHE_RESET != 0 {
                    assert_eq!(value & CACHE, 0, "the cache is reset while it is enabled");
                    chip.cache.clear();
                }
                chip.access = value;
            }
            Register::Key => {
                let keys = [0x4567_0123, 0xCDEF_89AB];
                chip.is_blocked |= chip.control & LOCK == 0 || keys[chip.keys] != value;
                chip.keys = (chip.keys + 1) % 2;
                if chip.keys == 0 && !chip.is_blocked {
                    chip.control &= !LOCK;
                }
            }
            Register::Status => chip.status &= !value,
            Register::Control => {
                assert_eq!(chip.busy, 0, "the control register is written while the controller is busy");
                if chip.control & LOCK != 0 {
                    return;
                }
                chip.control = value & !START;
                assert_ne!(value & (PROGRAM | ERASE), PROGRAM | ERASE, "it erases and programs");
                if value & START != 0 {
                    assert_ne!(value & ERASE, 0, "it starts nothing");
                    chip.erase();
                }
            }
        }
    }

    /// Waits for the end of an operation, as the bus does.
    fn load(&mut self, offset: u32) -> u8 {
        let chip = &mut *self.borrow_mut();
        if chip.is_off() {
            return 0;
        }
        chip.busy = 0;
        let offset = offset as usize;
        if chip.access & CACHE == 0 {
            return chip.bytes[offset];
        }
        let number = offset / LINE;
        let line = match chip.cache.iter().rposition(|(line, _)| *line == number) {
            Some(line) => line,
            None => {
                chip.cache.drain(..(chip.cache.len() + 1).saturating_sub(LINES));
                chip.cache.push((number, chip.bytes[number * LINE..][..LINE].to_vec()));
                chip.cache.len() - 1
            }
        };
        chip.cache[line].1[offset % LINE]
    }

    /// Programming only clears bits, in the flash and in the cache.
    fn store(&mut self, offset: u32, byte: u8) {
        let chip = &mut *self.borrow_mut();
        if chip.is_off() {
            return;
        }
        chip.busy = 0;
        let offset = offset as usize;
        if chip.control & (LOCK | PROGRAM) != PROGRAM {
            chip.status |= WRONG_SEQUENCE;
        } else if chip.control & SIZE != 0 {
            chip.status |= WRONG_SIZE;
        } else if chip.is_protected(offset) {
            chip.status |= WRITE_PROTECTED;
        } else {
            // The last byte before a cut is half programmed.
            let byte = if chip.step(1) == 0 || chip.is_off() { byte | 0x0F } else { byte };
            chip.bytes[offset] &= byte;
            if let Some((_, line)) = chip.cache.iter_mut().find(|(line, _)| *line == offset / LINE) {
                line[offset % LINE] = chip.bytes[offset];
            }
            chip.busy = PROGRAM_TIME;
        }
    }
}

fn read<const N: usize>(flash: &mut impl ReadNorFlash<Error = Error>, offset: u32) -> [u8; N] {
    let mut bytes = [0; N];
    flash.read(offset, &mut bytes).unwrap();
    bytes
}

/// The first sectors have other lengths, and the controller counts sectors, not bytes.
#[test]
fn only_the_last_two_sectors_are_erased_and_programmed() {
    let chip = RefCell::new(Chip::new());
    let mut flash = Driver::new(&chip);
    let middle = REGION.start + 0x2_0000;
    flash.erase(middle, REGION.end).unwrap();
    assert_eq!((chip.borrow().changed(), chip.borrow().erases[LAST[1]]), (vec![LAST[1]], 1));
    flash.erase(REGION.start, REGION.end).unwrap();
    assert_eq!((chip.borrow().changed(), &chip.borrow().erases[LAST[0]..]), (LAST.to_vec(), &[1, 2][..]));
    // At the end of the first sector, across its border, and at the end of the region.
    for offset in [middle - 8, middle - 4, REGION.end - 8] {
        flash.write(offset, &[0x3C; 8]).unwrap();
        assert_eq!(read(&mut flash, offset), [0x3C; 8]);
    }
    // Bits are only cleared.
    flash.write(REGION.end - 8, &[0xF0; 8]).unwrap();
    assert_eq!(read(&mut flash, REGION.end - 8), [0x30; 8]);
    assert_eq!(chip.borrow().changed(), LAST);
    assert_eq!(chip.borrow().control & LOCK, LOCK, "it is left unlocked");
}

#[test]
fn calls_beyond_the_region_are_refused() {
    let chip = RefCell::new(Chip::new());
    let mut flash = Driver::new(&chip);
    let (start, end) = (REGION.start, REGION.end);
    for offset in [0, start - 1, end - 3, end, u32::MAX - 1] {
        assert_eq!(flash.write(offset, &[0; 4]), Err(Error::OutOfBounds), "{offset:#X}");
        assert_eq!(flash.read(offset, &mut [0; 4]), Err(Error::OutOfBounds), "{offset:#X}");
    }
    for (from, to) in [(0, 0x4000), (start - 0x2_0000, end), (start, end + 0x2_0000), (end, start)] {
        assert_eq!(flash.erase(from, to), Err(Error::OutOfBounds), "{from:#X}");
    }
    for (from, to) in [(start + 0x4000, end), (start, start + 0x4000)] {
        assert_eq!(flash.erase(from, to), Err(Error::NotAligned), "{from:#X}");
    }
    let kinds = [Error::OutOfBounds, Error::NotAligned, Error::Locked, Error::Protected].map(|error| error.kind());
    use NorFlashErrorKind::{NotAligned, Other, OutOfBounds};
    assert_eq!(kinds, [OutOfBounds, NotAligned, Other, Other]);
    assert_eq!((chip.borrow().changed(), flash.capacity()), (vec![], end as usize));
}

/// A stray write finds the flash locked. Its error, which the controller keeps, does not make later operations fail.
#[test]
fn a_write_while_the_flash_is_locked_changes_nothing() {
    let chip = RefCell::new(Chip::new());
    let mut flash = Driver::new(&chip);
    flash.erase(REGION.start, REGION.end).unwrap();
    (&chip).store(REGION.start, 0);
    assert_eq!(chip.borrow().status, WRONG_SEQUENCE);
    assert_eq!(read(&mut flash, REGION.start), [0xFF]);
    flash.write(REGION.start, &[0x12]).unwrap();
    assert_eq!(chip.borrow().status, 0);
    assert_eq!(read(&mut flash, REGION.start), [0x12]);
}

#[test]
fn errors_of_the_controller_are_reported() {
    let chip = RefCell::new(Chip::new());
    let mut flash = Driver::new(&chip);
    chip.borrow_mut().protected = vec![LAST[1]];
    assert_eq!(flash.erase(REGION.start, REGION.end), Err(Error::Protected));
    assert_eq!(flash.write(REGION.end - 1, &[0]), Err(Error::Protected));
    assert_eq!(chip.borrow().changed(), [LAST[0]]);
    flash.write(REGION.start, &[0]).unwrap();
    chip.borrow_mut().protected.clear();
    flash.erase(REGION.start, REGION.end).unwrap();
    // A wrong key blocks the controller until it is reset.
    (&chip).write(Register::Key, 0);
    assert_eq!(flash.write(REGION.start, &[0]), Err(Error::Locked));
    assert_eq!(flash.erase(REGION.start, REGION.end), Err(Error::Locked));
    chip.borrow_mut().restart();
    flash.write(REGION.start, &[0]).unwrap();
    assert_eq!(read(&mut flash, REGION.start), [0, 0xFF]);
}

/// The data cache keeps what an erase has removed from the flash.
#[test]
fn an_erase_empties_the_data_cache() {
    let chip = RefCell::new(Chip::new());
    let mut flash = Driver::new(&chip);
    chip.borrow_mut().access = CACHE;
    assert_eq!(read(&mut flash, REGION.start), [LAST[0] as u8; LINES * LINE]);
    flash.erase(REGION.start, REGION.end).unwrap();
    assert_eq!(read(&mut flash, REGION.start), [0xFF; LINES * LINE]);
    flash.write(REGION.start, &[0x3C; 4]).unwrap();
    assert_eq!(read(&mut flash, REGION.start), [0x3C, 0x3C, 0x3C, 0x3C, 0xFF]);
    assert_eq!(chip.borrow().access, CACHE, "the cache stays enabled");
}

/// Starts the vehicle with this chip, as the board does: with the data cache. Restores the mission, and returns its number. Then stores
/// the missions with these numbers, and calls `stored` after each.
fn run(chip: &RefCell<Chip>, missions: Range<i32>, mut stored: impl FnMut(i32)) -> i32 {
    chip.borrow_mut().access = CACHE;
    let mut store = Store::new(Driver::new(chip), REGION);
    let setup = setup(Durability::Deferred);
    // The vehicle's own writes are not rate-limited.
    let config = Config { storage_refill: mavstack::Duration::ZERO, ..setup.config };
    let mut stack = begun::<Mavlink, 1>(config, setup.links);
    let mut vehicle = TestVehicle::new();
    let mut now = Instant::from_millis(1_000);
    of_plans(stack.restore(now, &mut store, &mut vehicle)).expect("no damage");
    let items = stack.mission().items();
    let restored = items.first().map_or(0, |item| item.x);
    assert!(items.iter().all(|item| item.x == restored) && [0, 20].contains(&items.len()), "{items:?}");
    for x in missions {
        let item = Item { command: MavCmd::NAV_WAYPOINT, autocontinue: 1, x, y: 1, ..Item::default() };
        stack.load_plan(now, PlanType::Mission, (0..20).map(|_| item), &mut vehicle).unwrap();
        for _ in 0..20 {
            now += secs(1);
            while !chip.borrow().is_off() && stack.persist(now, &mut store, &mut vehicle) {}
        }
        stored(x);
    }
    restored
}

/// SEC-11: cuts in each step of the erases, and at many bytes, of the saves that erase.
#[test]
fn a_mission_survives_power_cuts_in_each_erase_and_program() {
    let chip = RefCell::new(Chip::new());
    let mut before = chip.borrow().clone();
    let mut saves = Vec::new();
    run(&chip, 1..450, |x| {
        let chip = chip.borrow();
        if chip.erases != before.erases {
            saves.push((x, before.clone(), chip.steps));
        }
        before = chip.clone();
    });
    assert_eq!(chip.borrow().changed(), LAST);
    // Of the first save, and of one at the end of each sector.
    assert!(saves.len() >= 3, "only {} saves erase", saves.len());
    for (x, before, end) in saves {
        let (mut old, mut new) = (0, 0);
        let near = |place: u64, at: u64| place.abs_diff(at) < 5;
        let is_chosen = |at: &u64| {
            near(before.steps, *at) || near(end, *at) || (at - before.steps) % 256 < 3 || at.is_multiple_of(61)
        };
        for at in (before.steps + 1..end).filter(is_chosen) {
            let chip = RefCell::new(Chip { cut: Some(at), ..before.clone() });
            assert_eq!(run(&chip, x..x + 1, |_| ()), x - 1);
            assert!(chip.borrow().is_off(), "no cut at step {at}");
            chip.borrow_mut().restart();
            match run(&chip, x + 1..x + 2, |_| ()) {
                restored if restored == x => new += 1,
                restored if restored == x - 1 => old += 1,
                restored => panic!("cut at step {at} of {}..{end}: mission {restored}", before.steps),
            }
            // The next one was stored.
            assert_eq!(run(&chip, 0..0, |_| ()), x + 1);
        }
        println!("mission {x}, {} steps: {old} old ones, {new} new ones", end - before.steps);
        assert!(old > 10);
    }
}
