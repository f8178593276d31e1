//! The EEPROM driver: every byte on the bus, and a chip that behaves as the datasheets say.

use crate::bus::*;
use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};
use embedded_hal_mock::eh1::delay::NoopDelay;
use embedded_hal_mock::eh1::spi::Mock;
use embedded_storage::nor_flash::{NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use mavstack_fram::{Eeprom, Error};
use std::cell::RefCell;
use std::rc::Rc;

fn status(status: u8) -> Bus {
    question(&[0x05], &[status])
}

fn start() -> Bus {
    [status(0), command(&[0x06]), status(0x02), command(&[0x04])].concat()
}

/// A 25LC256 on a bus that sees a good start and then exactly this.
fn with(bus: &[Bus], test: impl FnOnce(&mut Eeprom<&mut Mock<u8>, NoopDelay>)) {
    let mut mock = Mock::new(&[start(), bus.concat()].concat());
    test(&mut Eeprom::new::<0x8000, 64>(&mut mock, NoopDelay).unwrap());
    mock.done();
}

#[test]
fn what_does_not_answer_or_is_protected_is_refused() {
    let open = |bus: &[Bus]| {
        let mut mock = Mock::new(&bus.concat());
        let error = Eeprom::new::<0x8000, 64>(&mut mock, NoopDelay).err();
        mock.done();
        error
    };
    assert_eq!(open(&[status(0), command(&[0x06]), status(0)]), Some(Error::NoAnswer(0)));
    assert_eq!(open(&[status(0x04), command(&[0x06]), status(0x06)]), Some(Error::Protected));
    assert_eq!(open(&[status(0x8C), command(&[0x06]), status(0x8E)]), Some(Error::Protected));
    assert_eq!(open(&vec![status(0xFF); 200]), Some(Error::Busy), "an open line reads as ones");
    // An M95040's four upper bits are ones.
    assert_eq!(open(&[status(0xF0), command(&[0x06]), status(0xF2), command(&[0x04])]), None);
}

/// Addresses as in FRAM of the same capacity; a read crosses pages in one selection.
#[test]
fn reading() {
    with(&[status(0x01), status(0x00), question(&[0x03, 0x01, 0x02], &[0xAB; 300])], |eeprom| {
        let mut bytes = [0; 300];
        eeprom.read(0x102, &mut bytes).unwrap();
        assert_eq!(bytes, [0xAB; 300]);
    });
    let mut mock = Mock::new(&[start(), status(0), question(&[0x03, 0x01, 0xFF, 0xFF], &[9])].concat());
    let mut eeprom = Eeprom::new::<0x2_0000, 256>(&mut mock, NoopDelay).unwrap();
    let mut byte = [0];
    eeprom.read(0x1_FFFF, &mut byte).unwrap();
    assert_eq!(byte, [9]);
    mock.done();
}

/// A write is split at the ends of pages. Each part is enabled by itself, and waited for.
#[test]
fn writing() {
    let data: Vec<u8> = (0..100).collect();
    let bus = [
        status(0),
        command(&[0x06]),
        written(&[0x02, 0x00, 0x3C], &data[..4]),
        status(0x03),
        status(0x01),
        status(0x00),
        command(&[0x06]),
        written(&[0x02, 0x00, 0x40], &data[4..68]),
        status(0x00),
        command(&[0x06]),
        written(&[0x02, 0x00, 0x80], &data[68..]),
        status(0x03),
        status(0x00),
    ];
    with(&bus, |eeprom| eeprom.write(0x3C, &data).unwrap());
}

#[test]
fn beyond_the_end() {
    with(&[], |eeprom| {
        assert_eq!(eeprom.read(0x8000, &mut [0]), Err(Error::OutOfBounds));
        assert_eq!(eeprom.write(0x7FFF, &[0; 2]), Err(Error::OutOfBounds));
        assert_eq!(eeprom.erase(0x7F00, 0x8100), Err(Error::OutOfBounds));
        assert_eq!(eeprom.erase(0x80, 0x180), Err(Error::NotAligned));
    });
    let kinds =
        [Error::NotAligned, Error::OutOfBounds, Error::Bus(()), Error::Busy, Error::NoAnswer(0), Error::Protected]
            .map(|error| error.kind());
    use NorFlashErrorKind::{NotAligned, Other, OutOfBounds};
    assert_eq!(kinds, [NotAligned, OutOfBounds, Other, Other, Other, Other]);
    for (error, text) in [
        (Error::Bus(()), "the bus failed: ()"),
        (Error::Busy, "the chip stays busy, or none answers: check the wiring and the chip select"),
        (Error::NoAnswer(0), "no chip answers, its status reads as 0x00: check the wiring and the chip select"),
        (Error::Protected, "the chip's status register protects memory: clear its bits BP0 and BP1"),
    ] {
        assert_eq!(error.to_string(), text);
    }
}

/// A chip as its datasheet describes it: a page latch that rolls over, and a write that takes 5 ms, during which it answers
/// to nothing but RDSR.
pub struct Chip {
    pub memory: Vec<u8>,
    page: usize,
    enabled: bool,
    busy_until: u64,
    now: u64,
    writes: u32,
    /// The write with this number is cut off: half of its page is garbage, and the chip is off.
    pub cut: Option<u32>,
    pub is_off: bool,
    /// It never completes a write.
    is_stuck: bool,
}

#[derive(Clone)]
pub struct Shared(pub Rc<RefCell<Chip>>);

impl DelayNs for Shared {
    fn delay_ns(&mut self, ns: u32) {
        self.0.borrow_mut().now += u64::from(ns);
    }
}

impl ErrorType for Shared {
    type Error = ErrorKind;
}

impl SpiDevice for Shared {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        let chip = &mut *self.0.borrow_mut();
        if chip.is_off {
            return Err(ErrorKind::Other);
        }
        let is_busy = chip.now < chip.busy_until;
        match operations {
            [Operation::Write([0x05]), Operation::Read(answer)] => {
                answer[0] = u8::from(is_busy) | u8::from(chip.enabled) << 1;
            }
            _ if is_busy => panic!("a busy chip ignores this: {operations:?}"),
            [Operation::Write([0x06])] => chip.enabled = true,
            [Operation::Write([0x04])] => chip.enabled = false,
            [Operation::Write([0x03, high, low]), Operation::Read(bytes)] => {
                let at = usize::from(u16::from_be_bytes([*high, *low]));
                bytes.copy_from_slice(&chip.memory[at..at + bytes.len()]);
            }
            [Operation::Write([0x02, high, low]), Operation::Write(bytes)] => {
                assert!(std::mem::take(&mut chip.enabled));
                let at = usize::from(u16::from_be_bytes([*high, *low]));
                let page = at / chip.page * chip.page;
                chip.writes += 1;
                if chip.cut == Some(chip.writes) {
                    chip.memory[page..page + chip.page].iter_mut().for_each(|byte| *byte ^= 0xA5);
                    chip.is_off = true;
                    return Err(ErrorKind::Other);
                }
                for (index, byte) in bytes.iter().enumerate() {
                    chip.memory[page + (at + index) % chip.page] = *byte;
                }
                chip.busy_until = if chip.is_stuck { u64::MAX } else { chip.now + 5_000_000 };
            }
            other => panic!("{other:?}"),
        }
        Ok(())
    }
}

pub fn chip(memory: Vec<u8>) -> Shared {
    Shared(Rc::new(RefCell::new(Chip {
        memory,
        page: 64,
        enabled: false,
        busy_until: 3_000_000, // a write that a restart has interrupted
        now: 0,
        writes: 0,
        cut: None,
        is_off: false,
        is_stuck: false,
    })))
}

pub fn open(chip: &Shared) -> Eeprom<Shared, Shared> {
    Eeprom::new::<0x8000, 64>(chip.clone(), chip.clone()).unwrap()
}

/// Every offset and length of some pages is written where it belongs, and read back.
#[test]
fn what_is_written_is_read() {
    let chip = chip(vec![0xFF; 0x8000]);
    let mut eeprom = open(&chip);
    let mut expected = vec![0xFF; 0x8000];
    for offset in 0..130 {
        for len in [1, 2, 63, 64, 65, 130, 256] {
            let data: Vec<u8> = (0..len).map(|index| (index * 7 + offset * 13) as u8).collect();
            expected[offset..offset + len].copy_from_slice(&data);
            eeprom.write(offset as u32, &data).unwrap();
            let mut bytes = vec![0; len];
            eeprom.read(offset as u32, &mut bytes).unwrap();
            assert_eq!(bytes, data);
        }
    }
    assert!(chip.0.borrow().memory == expected);
    eeprom.erase(0x100, 0x200).unwrap();
    expected[0x100..0x200].fill(0xFF);
    assert!(chip.0.borrow().memory == expected);
}

/// A write of 256 bytes takes as long as four writes of a page; a chip that never completes one is given up after 20 ms.
#[test]
fn no_call_blocks_for_ever() {
    let chip = chip(vec![0xFF; 0x8000]);
    let mut eeprom = open(&chip);
    let before = chip.0.borrow().now;
    eeprom.write(0, &[0; 256]).unwrap();
    let took = chip.0.borrow().now - before;
    assert!((20_000_000..=21_000_000).contains(&took), "{took} ns");
    chip.0.borrow_mut().is_stuck = true;
    assert_eq!(eeprom.write(0, &[0; 1]), Err(Error::Busy));
    for _ in 0..2 {
        let before = chip.0.borrow().now;
        assert_eq!(eeprom.read(0, &mut [0]), Err(Error::Busy));
        assert_eq!(chip.0.borrow().now - before, 20_000_000);
    }
    assert!(Eeprom::new::<0x8000, 64>(chip.clone(), chip.clone()).is_err());
}
