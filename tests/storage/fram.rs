//! The FRAM driver: each byte on the bus, and plans and parameters that are stored in an FRAM.

use super::spi::*;
use crate::support::{Setup, TestVehicle, Tuning, World, millis};
use crate::support::{Tested, begun};
use crate::{of_parameters, of_plans};
use embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};
use embedded_hal_mock::eh1::spi::Mock;
use embedded_storage::nor_flash::{NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use mavstack::dialect::{MavCmd, MavParamType, ParamSet, Statustext};
use mavstack::storage::{Fram, FramError, Store};
use mavstack::{Instant, Item, PlanType, Text, plan_memory};

fn id(product: u8, revision: u8) -> [u8; 9] {
    [0x7F, 0x7F, 0x7F, 0x7F, 0x7F, 0x7F, 0xC2, product, revision]
}

/// The first transactions: the driver reads the id and the status register.
fn start(id: [u8; 9], status: u8) -> Bus {
    [question(&[0x9F], &id), question(&[0x05], &[status])].concat()
}

/// Runs `test` with the driver, on a bus that expects a start and then exactly these transactions.
fn with(product: u8, bus: &[Bus], test: impl FnOnce(&mut Fram<&mut Mock<u8>>)) {
    let mut mock = Mock::new(&[start(id(product, 0x08), 0x40), bus.concat()].concat());
    test(&mut Fram::new(&mut mock).unwrap());
    mock.done();
}

/// The id encodes the capacity.
#[test]
fn capacity_is_read_from_the_id() {
    for (product, revision, kib) in [
        (0x21, 0x00, 16),  // FM25V01
        (0x21, 0x08, 16),  // FM25V01A
        (0x22, 0x00, 32),  // FM25V02
        (0x22, 0x48, 32),  // FM25V02A, extended temperature
        (0x23, 0x01, 64),  // FM25VN05
        (0x24, 0x00, 128), // FM25V10
        (0x25, 0x08, 256), // FM25V20A
        (0x26, 0x08, 512), // CY15B104Q
    ] {
        let mut mock = Mock::new(&start(id(product, revision), 0x02));
        assert_eq!(Fram::new(&mut mock).unwrap().capacity(), kib * 1024);
        mock.done();
    }
}

/// A chip with another id is refused.
#[test]
fn unknown_ids_are_refused() {
    let mut shifted = id(0x22, 0);
    shifted.rotate_left(1);
    let mut other_maker = id(0x22, 0);
    other_maker[6] = 0xC3;
    let others = [[0; 9], [0xFF; 9], shifted, other_maker, id(0x20, 0), id(0x27, 0), id(0x02, 0), id(0x42, 0)];
    for answer in others {
        let mut mock = Mock::new(&question(&[0x9F], &answer));
        assert_eq!(Fram::new(&mut mock).err(), Some(FramError::Id(answer)));
        mock.done();
    }
}

/// A write-protected chip is refused.
#[test]
fn protected_chips_are_refused() {
    for status in [0x04, 0x08, 0x0C, 0x8E] {
        let mut mock = Mock::new(&start(id(0x22, 0), status));
        assert_eq!(Fram::new(&mut mock).err(), Some(FramError::Protected));
        mock.done();
    }
}

/// Addresses have two bytes up to 64 KiB, and three bytes beyond. A read of any length is one transaction.
#[test]
fn reading() {
    with(0x23, &[question(&[0x03, 0xFF, 0xFE], &[7, 8]), question(&[0x03, 0x01, 0x02], &[0xAB; 1000])], |fram| {
        let mut bytes = [0; 2];
        fram.read(0xFFFE, &mut bytes).unwrap();
        assert_eq!(bytes, [7, 8]);
        let mut bytes = [0; 1000];
        fram.read(0x0102, &mut bytes).unwrap();
        assert_eq!(bytes, [0xAB; 1000]);
    });
    with(0x24, &[question(&[0x03, 0x01, 0xFF, 0xFF], &[9])], |fram| {
        let mut byte = [0];
        fram.read(0x1_FFFF, &mut byte).unwrap();
        assert_eq!(byte, [9]);
    });
}

/// Each write is enabled by its own transaction, and may have any length.
#[test]
fn writing() {
    let data: Vec<u8> = (0..=255).chain(0..=255).collect();
    let wide = [
        command(&[0x06]),
        written(&[0x02, 0x01, 0x00, 0x81], &data),
        command(&[0x06]),
        written(&[0x02, 0x00, 0x00, 0x00], &[1]),
    ];
    with(0x25, &wide, |fram| {
        fram.write(0x1_0081, &data).unwrap();
        fram.write(0, &[1]).unwrap();
    });
    with(0x21, &[command(&[0x06]), written(&[0x02, 0x3F, 0xFF], &[5])], |fram| fram.write(0x3FFF, &[5]).unwrap());
}

/// An erase unit is 256 bytes of 0xFF.
#[test]
fn erasing() {
    let unit = [0xFF; 256];
    let bus =
        [command(&[0x06]), written(&[0x02, 0x01, 0x00], &unit), command(&[0x06]), written(&[0x02, 0x02, 0x00], &unit)];
    with(0x22, &bus, |fram| fram.erase(0x100, 0x300).unwrap());
    with(0x22, &[], |fram| fram.erase(0x100, 0x100).unwrap());
}

/// Calls that the trait forbids do not reach the bus, because the chip would wrap around at its end.
#[test]
fn calls_beyond_the_end_are_refused() {
    with(0x21, &[], |fram| {
        assert_eq!(fram.read(0x4000, &mut [0]), Err(FramError::OutOfBounds));
        assert_eq!(fram.read(0x3FFF, &mut [0; 2]), Err(FramError::OutOfBounds));
        assert_eq!(fram.write(u32::MAX, &[0]), Err(FramError::OutOfBounds));
        assert_eq!(fram.erase(0x3F00, 0x4100), Err(FramError::OutOfBounds));
        assert_eq!(fram.erase(0x80, 0x180), Err(FramError::NotAligned));
    });
    let kinds = [FramError::NotAligned, FramError::OutOfBounds, FramError::Bus(()), FramError::Protected]
        .map(|error| error.kind());
    assert_eq!(
        kinds,
        [
            NorFlashErrorKind::NotAligned,
            NorFlashErrorKind::OutOfBounds,
            NorFlashErrorKind::Other,
            NorFlashErrorKind::Other
        ]
    );
}

/// A simulated chip: memory, and a write enable latch that each write resets. The bus fails on demand.
struct Chip {
    memory: Vec<u8>,
    enabled: bool,
    /// Transactions until the bus fails.
    good_for: Option<u32>,
}

impl ErrorType for Chip {
    type Error = ErrorKind;
}

impl SpiDevice for Chip {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        if let Some(good_for) = &mut self.good_for {
            *good_for = good_for.checked_sub(1).ok_or(ErrorKind::Overrun)?;
        }
        match operations {
            [Operation::Write([0x9F]), Operation::Read(answer)] => answer.copy_from_slice(&id(0x22, 0x08)),
            [Operation::Write([0x05]), Operation::Read(answer)] => answer.copy_from_slice(&[0]),
            [Operation::Write([0x06])] => self.enabled = true,
            [Operation::Write([0x03, high, low]), Operation::Read(bytes)] => {
                let at = usize::from(u16::from_be_bytes([*high, *low]));
                bytes.copy_from_slice(&self.memory[at..at + bytes.len()]);
            }
            [Operation::Write([0x02, high, low]), Operation::Write(bytes)] => {
                assert!(std::mem::take(&mut self.enabled));
                let at = usize::from(u16::from_be_bytes([*high, *low]));
                self.memory[at..at + bytes.len()].copy_from_slice(bytes);
            }
            other => panic!("{other:?}"),
        }
        Ok(())
    }
}

fn chip(good_for: Option<u32>) -> Chip {
    Chip { memory: vec![0x55; 0x8000], enabled: false, good_for }
}

/// Errors of the bus are returned.
#[test]
fn bus_errors_are_returned() {
    for good_for in 0..2 {
        assert_eq!(Fram::new(chip(Some(good_for))).err(), Some(FramError::Bus(ErrorKind::Overrun)));
    }
    let mut fram = Fram::new(chip(Some(2))).unwrap();
    assert_eq!(fram.read(0, &mut [0]), Err(FramError::Bus(ErrorKind::Overrun)));
    for good_for in 2..4 {
        let mut fram = Fram::new(chip(Some(good_for))).unwrap();
        assert_eq!(fram.write(0, &[0]), Err(FramError::Bus(ErrorKind::Overrun)));
        assert_eq!(fram.erase(0, 256), Err(FramError::Bus(ErrorKind::Overrun)));
        assert_eq!(fram.into_inner().memory, chip(None).memory);
    }
}

/// M-44: plans of the usual size in a chip of 32 KiB survive restarts, and memory outside of the region is not written.
#[test]
fn plans_survive_restarts() {
    type Plans = Tested<plan_memory!(mission: 250, fence: 64, rally: 16)>;
    const REGION: u32 = Store::<Fram<&mut Chip>>::region_len::<Plans>();
    const { assert!(REGION <= 0x8000) };

    let mut chip = chip(None);
    let setup = Setup::<1>::new();
    let mut before = Vec::new();
    for count in [250, 3, 0, 17] {
        let mut store = Store::new(Fram::new(&mut chip).unwrap(), 0..REGION);
        let mut stack = begun::<Plans, 1>(setup.config, setup.links);
        let mut vehicle = TestVehicle::new();
        of_plans(stack.restore(Instant::ZERO, &mut store, &mut vehicle)).unwrap();
        assert_eq!(stack.mission().items(), before);
        let item = |x| Item { command: MavCmd::NAV_WAYPOINT, autocontinue: 1, x, y: 1, ..Item::default() };
        before = (0..count).map(item).collect();
        stack.load_plan(Instant::ZERO, PlanType::Mission, before.iter().copied(), &mut vehicle).unwrap();
        while stack.persist(Instant::ZERO, &mut store, &mut vehicle) {}
    }
    assert!(chip.memory[REGION as usize..].iter().all(|byte| *byte == 0x55), "memory outside of the region");
}

/// G-18: the bus fails at any transaction of a restart. That is an error, and each plan is whole or empty.
#[test]
fn plans_that_cannot_be_read_are_empty() {
    type Plans = Tested<plan_memory!(mission: 5, fence: 0, rally: 0)>;
    const REGION: u32 = Store::<Fram<&mut Chip>>::region_len::<Plans>();

    let setup = Setup::<1>::new();
    let mut vehicle = TestVehicle::new();
    let start = |chip: &mut Chip, vehicle: &mut TestVehicle| {
        let mut store = Store::new(Fram::new(chip).unwrap(), 0..REGION);
        let mut stack = begun::<Plans, 1>(setup.config, setup.links);
        let restored = of_plans(stack.restore(Instant::ZERO, &mut store, vehicle));
        if restored == Ok(()) && stack.mission().items().is_empty() {
            let items =
                (0..5).map(|x| Item { command: MavCmd::NAV_WAYPOINT, autocontinue: 1, x, y: 1, ..Item::default() });
            stack.load_plan(Instant::ZERO, PlanType::Mission, items, vehicle).unwrap();
            while stack.persist(Instant::ZERO, &mut store, vehicle) {}
        }
        (restored.is_ok(), stack.mission().items().len())
    };
    let mut whole = chip(None);
    assert_eq!(start(&mut whole, &mut vehicle), (true, 5));
    let mut failures = 0;
    loop {
        let good_for = failures + 2;
        let mut chip = Chip { memory: whole.memory.clone(), enabled: false, good_for: Some(good_for) };
        match start(&mut chip, &mut vehicle) {
            (true, len) => {
                assert_eq!(len, 5);
                break;
            }
            (false, len) => assert!(len == 0 || len == 5, "{len} items after {good_for} transfers"),
        }
        failures += 1;
    }
    assert!(failures > 5, "{failures}");
}

/// G-18: the same with parameters. Each has the stored value or its default, and a text reports the error.
#[test]
fn parameters_that_cannot_be_read_have_their_defaults() {
    const REGION: u32 = Store::<Fram<&mut Chip>>::region_len::<Tested>();

    let cruise = |world: &World<1>| world.stack.parameters().get(Tuning::CRUISE);
    let default = cruise(&World::new(Setup::new()));
    let mut whole = chip(None);
    let mut world = World::<1>::new(Setup::new());
    let mut store = Store::new(Fram::new(&mut whole).unwrap(), 0..REGION);
    of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle)).unwrap();
    let param_id = Text::new("CRUISE");
    let (param_value, param_type) = (default + 1.0, MavParamType::REAL32);
    world.gcs[0].send(&ParamSet { param_value, target_system: 1, target_component: 1, param_id, param_type });
    for _ in 0..20_000 {
        world.step();
        world.stack.persist(world.now(), &mut store, &mut world.vehicle);
    }
    let mut failures = 0;
    loop {
        let good_for = failures + 2;
        let mut chip = Chip { memory: whole.memory.clone(), enabled: false, good_for: Some(good_for) };
        let mut world = World::<1>::new(Setup::new());
        let mut store = Store::new(Fram::new(&mut chip).unwrap(), 0..REGION);
        if of_parameters(world.stack.restore(world.now(), &mut store, &mut world.vehicle)).is_ok() {
            assert_eq!(cruise(&world), default + 1.0);
            break;
        }
        assert!([default, default + 1.0].contains(&cruise(&world)));
        let text: Statustext = world.expect(0, millis(100));
        assert_eq!(text.text.as_str(), Some("Stored parameters cannot be read"));
        failures += 1;
    }
    // The end of each page, the pages of a segment, and the record.
    assert!(failures > REGION / 256 + REGION / 512, "{failures}");
}
