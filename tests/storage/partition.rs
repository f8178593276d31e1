//! One flash with several users: each sees its own part only.

use crate::support::flash::{Fault, FlashError, RamFlash};
use crate::support::*;
use embedded_storage::nor_flash::{NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use mavstack::dialect::MavCmd;
use mavstack::storage::{Partition, PartitionError, Store};
use mavstack::{Instant, Item, PlanType};
use std::cell::RefCell;

#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: 1,
    plans: { mission: 20, fence: 4, rally: 2 },
    commands: { slots: 1 },
    storage,
)]
struct Mavlink;

type Flash = RamFlash<8, 1024>;

#[test]
fn addresses_begin_at_the_partition() {
    let flash = RefCell::new(Flash::new(0x2000));
    let mut first = Partition::new::<0x400, 0xC00>(&flash);
    let mut second = Partition::new::<0xC00, 0x2000>(&flash);
    assert_eq!((first.capacity(), second.capacity()), (0x800, 0x1400));
    first.write(0x7F8, &[1; 8]).unwrap();
    second.write(0, &[2; 8]).unwrap();
    assert_eq!(flash.borrow().bytes[0xBF8..0xC08], [[1; 8], [2; 8]].concat());
    let mut bytes = [0; 4];
    first.read(0x7FC, &mut bytes).unwrap();
    assert_eq!(bytes, [1; 4]);
    first.erase(0x400, 0x800).unwrap();
    assert_eq!(flash.borrow().bytes[0xBF8..0xC08], [[0xFF; 8], [2; 8]].concat());
    assert!(flash.borrow().bytes.iter().filter(|byte| **byte != 0xFF).count() == 8);
}

#[test]
fn no_call_reaches_beyond_a_partition() {
    let flash = RefCell::new(Flash::new(0x2000));
    let mut partition = Partition::new::<0x400, 0xC00>(&flash);
    let out = Err(PartitionError::OutOfBounds);
    for offset in [0x7FC, 0x800, 0x1000, u32::MAX - 7, u32::MAX - 0x3FF] {
        assert_eq!(partition.read(offset, &mut [0; 8]), out, "{offset:#X}");
    }
    assert_eq!(partition.write(0x7F8, &[0; 16]), out);
    assert_eq!(partition.write(u32::MAX - 7, &[0; 8]), out);
    assert_eq!(partition.erase(0x400, 0xC00), out);
    assert_eq!(partition.erase(0x400, 0), out, "the end is before the start");
    assert_eq!(partition.erase(u32::MAX - 0x3FF, 0), out);
    assert!(partition.erase(0x800, 0x800).is_ok(), "nothing, at the end");
    // What the flash refuses, and what it says.
    let of_flash = |kind| Err(PartitionError::Flash(FlashError::Call(kind)));
    assert_eq!(partition.write(4, &[0; 8]), of_flash(NorFlashErrorKind::NotAligned));
    assert_eq!(partition.erase(0x200, 0x400), of_flash(NorFlashErrorKind::NotAligned));
    assert_eq!(flash.borrow().erases + flash.borrow().writes, 0);
    flash.borrow_mut().fault = Fault::Read(0x400..0x500);
    assert_eq!(partition.read(0, &mut [0; 8]), Err(PartitionError::Flash(FlashError::Fault)));
    let kinds = [
        PartitionError::Flash(FlashError::Call(NorFlashErrorKind::NotAligned)),
        PartitionError::OutOfBounds,
        PartitionError::InUse,
    ]
    .map(|error| error.kind());
    use NorFlashErrorKind::{NotAligned, Other, OutOfBounds};
    assert_eq!(kinds, [NotAligned, OutOfBounds, Other]);
    for (error, text) in [
        (PartitionError::Flash(()), "the flash failed: ()"),
        (PartitionError::OutOfBounds, "the call reaches beyond the end of the partition: make the region smaller"),
        (PartitionError::InUse, "another user holds the flash: borrow it for one call at a time"),
    ] {
        assert_eq!(error.to_string(), text);
    }
    assert_eq!(partition.clone().capacity(), partition.capacity());
}

/// A part that is longer than the flash is: its end fails, and its start works.
#[test]
fn a_partition_beyond_the_flash_fails_there() {
    let flash = RefCell::new(Flash::new(0x800));
    let mut partition = Partition::new::<0x400, 0x1000>(&flash);
    assert!(partition.write(0, &[0; 8]).is_ok());
    let out = Err(PartitionError::Flash(FlashError::Call(NorFlashErrorKind::OutOfBounds)));
    assert_eq!(partition.write(0x400, &[0; 8]), out);
}

/// A user that holds the flash makes the others fail, and nothing panics.
#[test]
fn a_flash_that_is_held_is_an_error() {
    let flash = RefCell::new(Flash::new(0x800));
    let mut partition = Partition::new::<0x400, 0x800>(&flash);
    let held = flash.borrow();
    assert_eq!(partition.read(0, &mut [0; 8]), Err(PartitionError::InUse));
    assert_eq!(partition.write(0, &[0; 8]), Err(PartitionError::InUse));
    drop(held);
    assert!(partition.write(0, &[0; 8]).is_ok());
}

/// Two stores and another user in one flash: each restores its own, and the rest is not touched.
#[test]
fn two_stores_share_a_flash() {
    const LEN: u32 = Store::<Flash>::region_len::<Mavlink>();
    const { assert!(LEN <= 0x2000) };
    let flash = RefCell::new(Flash::new(0x6000));
    let mut other = Partition::new::<0x2000, 0x4000>(&flash);
    let content: Vec<u8> = (0..0x2000).map(|index: u32| (index * 7) as u8).collect();
    other.write(0, &content).unwrap();
    let start = |partition, count: Option<i32>| {
        let mut store = Store::new(partition, 0..LEN);
        let setup = Setup::<1>::new();
        let mut stack = begun::<Mavlink, 1>(setup.config, setup.links);
        let mut vehicle = TestVehicle::new();
        stack.restore(Instant::ZERO, &mut store, &mut vehicle).unwrap();
        let restored = stack.mission().items().len();
        if let Some(count) = count {
            let item = |x| Item { command: MavCmd::NAV_WAYPOINT, autocontinue: 1, x, y: 1, ..Item::default() };
            stack.load_plan(Instant::ZERO, PlanType::Mission, (0..count).map(item), &mut vehicle).unwrap();
            while stack.persist(Instant::ZERO, &mut store, &mut vehicle) {}
        }
        restored
    };
    for count in 1..20 {
        let (first, second) = (Partition::new::<0, 0x2000>(&flash), Partition::new::<0x4000, 0x6000>(&flash));
        assert_eq!(start(first, Some(count)), count as usize - 1);
        assert_eq!(start(second, Some(20 - count)), if count == 1 { 0 } else { 21 - count as usize });
    }
    assert_eq!(flash.borrow().bytes[0x2000..0x4000], content);
}
