//! The FRAM driver: each byte on the bus.

use crate::bus::*;
use embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};
use embedded_hal_mock::eh1::spi::Mock;
use embedded_storage::nor_flash::{NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use mavstack_fram::{Error, Fram};

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
        assert_eq!(Fram::new(&mut mock).err(), Some(Error::Id(answer)));
        mock.done();
    }
}

/// A write-protected chip is refused.
#[test]
fn protected_chips_are_refused() {
    for status in [0x04, 0x08, 0x0C, 0x8E] {
        let mut mock = Mock::new(&start(id(0x22, 0), status));
        assert_eq!(Fram::new(&mut mock).err(), Some(Error::Protected));
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
        assert_eq!(fram.read(0x4000, &mut [0]), Err(Error::OutOfBounds));
        assert_eq!(fram.read(0x3FFF, &mut [0; 2]), Err(Error::OutOfBounds));
        assert_eq!(fram.write(u32::MAX, &[0]), Err(Error::OutOfBounds));
        assert_eq!(fram.erase(0x3F00, 0x4100), Err(Error::OutOfBounds));
        assert_eq!(fram.erase(0x80, 0x180), Err(Error::NotAligned));
    });
    let kinds = [Error::NotAligned, Error::OutOfBounds, Error::Bus(()), Error::Protected].map(|error| error.kind());
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
pub struct Chip {
    pub memory: Vec<u8>,
    pub enabled: bool,
    /// Transactions until the bus fails.
    pub good_for: Option<u32>,
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

pub fn chip(good_for: Option<u32>) -> Chip {
    Chip { memory: vec![0x55; 0x8000], enabled: false, good_for }
}

/// Errors of the bus are returned.
#[test]
fn bus_errors_are_returned() {
    for good_for in 0..2 {
        assert_eq!(Fram::new(chip(Some(good_for))).err(), Some(Error::Bus(ErrorKind::Overrun)));
    }
    let mut fram = Fram::new(chip(Some(2))).unwrap();
    assert_eq!(fram.read(0, &mut [0]), Err(Error::Bus(ErrorKind::Overrun)));
    for good_for in 2..4 {
        let mut fram = Fram::new(chip(Some(good_for))).unwrap();
        assert_eq!(fram.write(0, &[0]), Err(Error::Bus(ErrorKind::Overrun)));
        assert_eq!(fram.erase(0, 256), Err(Error::Bus(ErrorKind::Overrun)));
        assert_eq!(fram.into_inner().memory, chip(None).memory);
    }
}

#[test]
fn errors_say_what_to_do() {
    for (error, word) in [
        (Error::Bus(ErrorKind::Overrun), "the bus failed: Overrun"),
        (Error::Id(id(0xFF, 0x08)), "C2, FF, 08"),
        (Error::Protected, "BP0 and BP1"),
        (Error::NotAligned, "multiple of its unit"),
        (Error::OutOfBounds, "beyond the end"),
    ] {
        assert!(error.to_string().contains(word), "{error}");
    }
}
